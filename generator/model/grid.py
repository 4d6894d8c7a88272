"""The grid of voxels that the hidden object stands in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from generator.model.arrays import Array, Vector
from generator.model.described import described, documented
from generator.model.errors import require

_SAME_VOLUME = 1e-4
"""Share of its size by which a volume may differ from itself: a scene keeps its numbers in single precision."""


@documented
@dataclass(frozen=True, kw_only=True)
class VoxelGrid:
    """The hidden volume, cut into equal boxes, which are numbered along x first, then y, then z."""

    lo: Vector = described("corner of the hidden volume with the smallest coordinates, metres")
    hi: Vector = described("corner of the hidden volume with the largest coordinates, metres")
    shape: tuple[int, int, int] = described(
        "how many voxels the hidden volume is cut into along x, y and z; they are named A, B, C and so on, along x "
        "first, then y, then z",
        (3, 3, 1),
    )

    def __post_init__(self) -> None:
        require(all(n >= 1 for n in self.shape), f"grid.shape: {self.shape} has a count below 1")
        require(self.n_voxels <= 100_000, f"grid.shape: {self.n_voxels} voxels; at most 100000 can be labelled")
        require(
            all(math.isfinite(a) and math.isfinite(b) and a < b for a, b in zip(self.lo, self.hi, strict=True)),
            f"grid: lo {self.lo} must lie below hi {self.hi} on every axis",
        )

    @property
    def n_voxels(self) -> int:
        """Number of voxels."""
        return math.prod(self.shape)

    @property
    def size(self) -> Vector:
        """Edge lengths of one voxel, metres."""
        x, y, z = ((b - a) / n for a, b, n in zip(self.lo, self.hi, self.shape, strict=True))
        return (x, y, z)

    @cached_property
    def labels(self) -> list[str]:
        """Names of the voxels in order: A, B, ... Z, AA, AB, ..., like the columns of a spreadsheet."""
        return [voxel_label(i) for i in range(self.n_voxels)]

    def covers_same(self, other: VoxelGrid) -> bool:
        """Whether another grid covers the same volume, however it cuts it."""
        size = np.subtract(self.hi, self.lo)
        ends = (np.subtract(getattr(other, end), getattr(self, end)) for end in ("lo", "hi"))
        return not any((np.abs(end) > _SAME_VOLUME * size).any() for end in ends)

    def cell(self, voxel: int) -> tuple[int, int, int]:
        """Indices of a voxel along x, y, z."""
        nx, ny, _ = self.shape
        return voxel % nx, voxel // nx % ny, voxel // (nx * ny)

    def bounds(self, voxel: int) -> tuple[Array, Array]:
        """Lowest and highest corner of a voxel, each of shape (3,), metres."""
        lo = np.asarray(self.lo) + np.asarray(self.cell(voxel)) * np.asarray(self.size)
        return lo, lo + np.asarray(self.size)

    def voxel(self, place: Array) -> int:
        """Return the voxel that a place (3,), metres, lies in, or the nearest voxel if it lies outside the grid."""
        return int(self.voxels(np.asarray(place)[None])[0])

    def voxels(self, places: Array) -> NDArray[np.int64]:
        """Return the voxel of each of the places (n, 3), as `voxel` does."""
        steps = np.floor((places - self.lo) / np.asarray(self.size)).astype(np.int64)
        i, j, k = np.clip(steps, 0, np.array(self.shape) - 1).T
        numbers: NDArray[np.int64] = i + self.shape[0] * (j + self.shape[1] * k)
        return numbers


def voxel_label(index: int) -> str:
    """Return the spreadsheet-style name of a voxel: 0 is A, 25 is Z, 26 is AA."""
    label = ""
    index += 1
    while index:
        index, letter = divmod(index - 1, 26)
        label = chr(ord("A") + letter) + label
    return label
