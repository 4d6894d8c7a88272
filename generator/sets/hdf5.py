"""Rows of the datasets of a bulk set, read across its parts, and the writing of HDF5 files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from generator.files.writing import atomic
from generator.model.errors import NlosError

_ABOUT = {
    "pictures": {"units": "W/m^2/sr", "about": "scene-linear radiance of the relay wall; row 0 is the top"},
    "position": {"units": "m", "about": "of the target's origin"},
    "rotation": {"units": "degrees", "about": "about x, then y, then z"},
    "voxel": {"about": "where the target stands; x runs fastest, then y, then z"},
    "index": {"about": "of the pose within its voxel"},
    "backgrounds": {"units": "W/m^2/sr", "about": "the same without the hidden object"},
    "other_positions": {"units": "m", "about": "of the origins of the objects besides the first"},
    "other_rotations": {"units": "degrees", "about": "of the objects besides the first"},
    "other_voxels": {"about": "where the objects besides the first stand"},
    "values": {"about": "what varies from pose to pose, a column for each of its attribute vary"},
}


OPENED = 128

VERSIONS = ("v110", "v110")
"""Versions of the file format to write: HDF5 1.10, the first with virtual datasets, can read them."""


class Parts(Protocol):
    """A set whose rows are spread over parts."""

    @property
    def planned(self) -> int:
        """Number of rows of all parts."""

    @property
    def plan(self) -> Any:
        """Settings of the set; its attribute ``part`` is the number of rows of a part."""

    def rows(self, number: int, name: str) -> Any:
        """Return a dataset of a part."""

    def part_path(self, number: int) -> Path:
        """Return the file of a part."""


class Rows:
    """One row per picture, spread over the parts; rows are read when they are indexed.

    Parameters
    ----------
    bulk : Parts
        Set that they belong to.
    name : str
        Name of the dataset.
    shape : tuple of int
        Shape of one row.
    dtype : dtype
    """

    def __init__(self, bulk: Parts, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self._bulk = bulk
        self._name = name
        self.shape = (bulk.planned, *shape)
        self.dtype = dtype

    def __len__(self) -> int:
        return self.shape[0]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        whole: NDArray[Any] = self[:]
        return whole if dtype is None else whole.astype(dtype)

    def __getitem__(self, which: Any) -> Any:
        """Return one row, a slice of rows, or the rows that an array of numbers or of booleans selects."""
        part = self._bulk.plan.part
        if isinstance(which, int | np.integer):
            number = range(len(self))[which]
            return self._read(number // part, number % part)
        if isinstance(which, slice):
            start, stop, step = which.indices(len(self))
            if step != 1:
                return self[np.arange(start, stop, step)]
            rows = np.empty((max(0, stop - start), *self.shape[1:]), self.dtype)
            for number in range(start // part, math.ceil(stop / part) if stop > start else 0):
                low, high = max(start, number * part), min(stop, (number + 1) * part)
                first = number * part
                rows[low - start : high - start] = self._read(number, slice(low - first, high - first))
            return rows
        numbers = self._numbers(which)
        rows = np.empty((len(numbers), *self.shape[1:]), self.dtype)
        parts = numbers // part
        for number in np.unique(parts).tolist():
            positions = np.flatnonzero(parts == number)
            rows_of_part = numbers[positions] - number * part
            low, high = int(rows_of_part.min()), int(rows_of_part.max()) + 1
            # h5py's own indexing by lists of rows is slower than either of these.
            if high - low <= 4 * len(rows_of_part):
                rows[positions] = self._read(number, slice(low, high))[rows_of_part - low]
            else:
                for position, row in zip(positions.tolist(), rows_of_part.tolist(), strict=True):
                    rows[position] = self._read(number, row)
        return rows

    def _read(self, number: int, which: int | slice) -> Any:
        """Return rows of a part."""
        try:
            return self._bulk.rows(number, self._name)[which]
        except OSError as error:
            words = f"is broken ({short_size(error)}); take it away and run the same command again"
            raise NlosError(f"{self._bulk.part_path(number)}: {words}") from None

    def _numbers(self, which: Any) -> NDArray[np.int64]:
        numbers = np.asarray(which)
        if numbers.dtype == bool and numbers.shape == (len(self),):
            return np.flatnonzero(numbers)
        if numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in "iu"):
            raise IndexError(f"{self._name}: ask for a number, a slice, or one list of numbers or of truth values")
        numbers = numbers.astype(np.int64)
        numbers = np.where(numbers < 0, numbers + len(self), numbers)
        if numbers.size and (numbers.min() < 0 or numbers.max() >= len(self)):
            raise IndexError(f"{self._name}: holds rows 0 to {len(self) - 1}")
        return numbers


def describe_file(file: Any, vary: Sequence[str]) -> None:
    """Write units and meaning of a part's datasets into their attributes."""
    for name, attributes in _ABOUT.items():
        if name in file:
            file[name].attrs.update(attributes)
    if vary:
        file["values"].attrs["vary"] = list(vary)


def write_image(path: Path, file: Any) -> None:
    """Write an HDF5 file that was made in memory to disk, whole or not at all."""
    file.flush()
    with atomic(path) as temporary:
        temporary.write_bytes(file.id.get_file_image())


def short_size(error: Exception) -> str:
    """Return HDF5's message on one line, cut before its long details of addresses and times."""
    text = " ".join(str(error.args[0] if error.args else error).split())
    return text[:120]
