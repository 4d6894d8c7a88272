"""A bulk set (`generator.sets.bulk_set`), read as if it were a data set of pictures in files."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from generator.files.pictures import Picture
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.poses import Other, PoseRecord
from generator.sets.bulk_set import Bulk
from generator.sets.dataset import Dataset
from generator.sets.hdf5 import Rows
from generator.sets.measured import MeasuredSet
from generator.sets.readable import PictureSet


class SimulatedSet:
    """The first pictures of a finished bulk set.

    Parameters
    ----------
    bulk : Bulk
    count : int
        Number of pictures; 0 is all of them.
    check : bool
        Check that their parts are as they were rendered (`Bulk.refuse_changed_parts`).

    Raises
    ------
    NlosError
        The set is not finished, has fewer pictures, or was changed.
    """

    def __init__(self, bulk: Bulk, count: int = 0, *, check: bool = True) -> None:
        bulk.refuse_unfinished()
        if not 0 <= count <= bulk.planned:
            raise NlosError(f"{bulk.path}: holds {bulk.planned} pictures, so {count} cannot be taken")
        self._bulk = bulk
        self._count = count or bulk.planned
        if check:
            bulk.refuse_changed_parts(self._count)

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(SimulatedSet, check=False), (self._bulk, self._count)

    @property
    def path(self) -> Path:
        """Folder of the set."""
        return self._bulk.path

    @property
    def meta(self) -> dict[str, Any]:
        """All of ``bulk.toml``."""
        return self._bulk.meta

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the set, with the number of pictures that are taken."""
        return {**self._bulk.settings, "pictures": self._count}

    @property
    def grid(self) -> VoxelGrid:
        """The voxel grid."""
        return self._bulk.grid

    @property
    def target_kind(self) -> str:
        """The kind of target: sheet, sphere or mesh."""
        return self._bulk.target_kind

    @property
    def reference_radiance(self) -> float:
        """Radiance of the directly lit patch around w1, W/m^2/sr."""
        return self._bulk.reference_radiance

    @property
    def colour_space(self) -> str:
        """Linear colour space of the three channels: Rec.709, Rec.2020 or ACEScg."""
        return self._bulk.colour_space

    @property
    def planned(self) -> int:
        """Number of pictures that are taken."""
        return self._count

    @cached_property
    def records(self) -> list[PoseRecord]:
        """Poses of the pictures, in order; the files that they name do not exist."""
        labels, n = self.grid.labels, self.grid.n_voxels
        records = []
        names = [text.partition("=")[0] for text in self._bulk.plan.varying]
        poses = zip(self._bulk.positions[: self._count], self._bulk.rotations[: self._count], strict=True)
        for number, (position, rotation) in enumerate(poses):
            index, voxel = divmod(number, n)
            pose, file = (tuple(position), tuple(rotation)), f"{labels[voxel]}/{index:04d}"
            values = tuple(zip(names, self._bulk.values[number].tolist(), strict=True))
            others = self._others_of(number)
            records.append(PoseRecord(index, voxel, labels[voxel], *pose, 0, file=file, values=values, others=others))
        return records

    def _others_of(self, number: int) -> tuple[Other, ...]:
        """Return the objects of a picture besides the first."""
        columns, labels = self._bulk.others, self.grid.labels
        if not columns:
            return ()
        names = ("other_voxels", "other_positions", "other_rotations")
        rows = zip(*(columns[name][number].tolist() for name in names), strict=True)
        return tuple(Other(voxel, labels[voxel], tuple(place), tuple(turn)) for voxel, place, turn in rows)

    @property
    def own_backgrounds(self) -> bool:
        """Whether each picture has a background of its own, since more than the target varies."""
        return self._bulk.backgrounds is not None

    def background(self) -> Picture:
        """Return the picture without the hidden object, (height, width, 3), W/m^2/sr."""
        return self._bulk.background

    def background_of(self, record: PoseRecord) -> Picture:
        """Return the background of a pose's picture: its own, or `background` where all have the same."""
        backgrounds = self._bulk.backgrounds
        return self.background() if backgrounds is None else self._read(backgrounds, record)

    def ambient_background(self) -> Picture | None:
        """Return what ambient light alone adds to the background, (height, width, 3); None where it is off."""
        world = self._bulk.world()
        if world.ambient is None:
            return None
        from generator.transport import Transport  # imported here: readers of sets need no compiler

        lamp = Transport(replace(world, ambient=None), accuracy=self._bulk.plan.accuracy).background()
        return self.background() - lamp.astype(np.float32)

    def picture(self, record: PoseRecord) -> Picture:
        """Return a pose's picture, (height, width, 3), W/m^2/sr."""
        return self._read(self._bulk.pictures, record)

    def _read(self, rows: Rows, record: PoseRecord) -> Picture:
        pixels = rows[record.index * self.grid.n_voxels + record.voxel]
        return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)


def open_set(path: Path, count: int = 0) -> PictureSet:
    """Open a data set, rendered or measured, or a bulk set, all with the same interface.

    Parameters
    ----------
    path : Path
    count : int
        Pictures to take of a bulk set; 0 is all.

    Raises
    ------
    NlosError
        There is neither, or a number was given for a data set.
    """
    if Bulk.exists(path):
        return SimulatedSet(Bulk.open(path), count)
    if count:
        raise NlosError(f"{path}: is no simulated set (nlos-generate bulk), of which a number could be taken")
    return MeasuredSet.open(path) if MeasuredSet.exists(path) else Dataset.open(path)
