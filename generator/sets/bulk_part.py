"""A part of a bulk set: some thousand pictures and their poses in one HDF5 file."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np
from numpy.typing import NDArray

from generator.files.limits import MUCH, check_heaps, exceeds_limit, limited
from generator.model.arrays import Array, Vector
from generator.model.errors import NlosError
from generator.model.poses import Other, Pose
from generator.model.quantities import NO_CHANGE
from generator.model.uncertainty import ATTEMPTS
from generator.sets.bulk_settings import Layout
from generator.sets.hdf5 import VERSIONS, describe_file, short_size, write_image

PART_FORMAT = 1

_SMALL = 2**24
"""Most bytes of a part whose heaps are checked before it is opened: for more, checking takes longer than using it."""
_BATCH = 16 * 1024**2

Pictures = NDArray[np.float32]
DrawOthers = Callable[[int, int, Vector], Sequence[Other]]


class Renderer(Protocol):
    """Renders the pictures: `generator.jobs.bulk.Engine`, or a stand-in."""

    def pictures(self, numbers: NDArray[np.int64], positions: Array, rotations: Array) -> Pictures:
        """Return pictures (n, height, width, 3), given their numbers (n,), in order, and poses.

        Positions (n, 3) are in metres, rotations (n, 3) in degrees; of several objects, (n, objects, 3).
        """

    def varied(self, numbers: NDArray[np.int64], positions: Array, rotations: Array) -> tuple[Pictures, Pictures]:
        """Return pictures as `pictures` does, and the background of each, where more than the target varies."""

    def uncertain(
        self, numbers: NDArray[np.int64], positions: Array, rotations: Array
    ) -> tuple[Pictures, Pictures, Array]:
        """Return what `varied` does, and the values (n, names) that were drawn, where the scene is uncertain."""


class Part:
    """A part of a bulk set.

    Parameters
    ----------
    layout : Layout
    number : int
    """

    def __init__(self, layout: Layout, number: int) -> None:
        self._layout, self._number = layout, number

    @property
    def path(self) -> Path:
        """Its file."""
        return self._layout.part_path(self._number)

    @property
    def numbers(self) -> range:
        """The numbers of its pictures."""
        return self._layout.part_range(self._number)

    @property
    def state(self) -> list[int]:
        """Size and time of the last change of its file, by which later changes are noticed."""
        status = self.path.stat()
        return [status.st_size, status.st_mtime_ns]

    @property
    def is_there(self) -> bool:
        """Whether its file exists and is this part; it is taken to be whole, since it was put in place by rename."""
        try:
            self.open().close()
        except NlosError:
            return False
        return True

    def _columns(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return the numbers of its pictures, the voxel that each shows, and the index of the pose in the voxel."""
        numbers = np.array(self.numbers, dtype=np.int64)
        return numbers, numbers % self._layout.grid.n_voxels, numbers // self._layout.grid.n_voxels

    def open(self) -> Any:
        """Open its file.

        Returns
        -------
        h5py.File

        Raises
        ------
        NlosError
            The file is missing, broken, or of another set.
        """
        path, layout = self.path, self._layout
        if not path.is_file():
            raise NlosError(f"{path}: is not there yet; run the same command again to make it")
        try:
            if path.stat().st_size <= _SMALL:
                check_heaps(path)
            file = h5py.File(path, "r")
        except (OSError, ValueError) as error:
            raise NlosError(
                f"{path}: is broken ({short_size(error)}); run the same command again to make it"
            ) from None
        count = len(self.numbers)
        try:
            with limited(MUCH):
                fingerprint_there, number_there = (file.attrs.get(name) for name in ("fingerprint", "part"))
            if fingerprint_there != layout.fingerprint or number_there != self._number:
                raise ValueError("is of another set")
            claimed = 0
            for name in (*layout.images, *layout.columns):
                if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                    raise ValueError(f"has no {name} of its own")
                if file[name].external or file[name].is_virtual:  # HDF5 would read any file that is named there
                    raise ValueError(f"keeps {name} in another file, which is not followed")
                inner, dtype = layout.columns.get(name, (layout.picture_shape, "<f4"))
                if file[name].shape != (count, *inner):
                    raise ValueError(f"holds {name} of shape {file[name].shape}, not {(count, *inner)}")
                if file[name].dtype.kind != np.dtype(dtype).kind:
                    raise ValueError(f"holds {name} as {file[name].dtype}")
                claimed += file[name].nbytes
            if exceeds_limit(claimed, path.stat().st_size):
                raise ValueError(f"claims {claimed} bytes in {path.stat().st_size}")
        except Exception as error:  # HDF5 and h5py raise errors of many kinds
            file.close()
            raise NlosError(f"{path}: {short_size(error)}; run the same command again to make it anew") from None
        return file

    def write(
        self, draw: Callable[[int, int], Pose], renderer: Renderer, draw_others: DrawOthers | None = None
    ) -> None:
        """Render its pictures and write its file.

        Parameters
        ----------
        draw : callable
            Returns the pose of (voxel, index).
        renderer : Renderer
        draw_others : callable, optional
            Returns the objects besides the first of (voxel, index, position of the first); of a set with several.

        Raises
        ------
        NlosError
            A picture is not finite or of the wrong shape, or the part cannot be written.
        """
        layout, plan = self._layout, self._layout.plan
        numbers, voxel, index = self._columns()
        poses = [draw(v, i) for v, i in zip(voxel.tolist(), index.tolist(), strict=True)]
        position = np.array([p for p, _ in poses], dtype=np.float64)
        rotation = np.array([r for _, r in poses], dtype=np.float64)
        columns = {"position": position, "rotation": rotation, "voxel": voxel, "index": index, **self._values()}
        drawn = columns.get("values", np.zeros((len(numbers), 0)))
        if draw_others:
            rows_of_others = [
                draw_others(v, i, place)
                for v, i, (place, _) in zip(voxel.tolist(), index.tolist(), poses, strict=True)
            ]
            columns |= {
                "other_positions": np.array([[o.position for o in others] for others in rows_of_others]),
                "other_rotations": np.array([[o.rotation for o in others] for others in rows_of_others]),
                "other_voxels": np.array([[o.voxel for o in others] for others in rows_of_others], dtype=np.int64),
            }
            position = np.concatenate([position[:, None], columns["other_positions"]], axis=1)
            rotation = np.concatenate([rotation[:, None], columns["other_rotations"]], axis=1)
        digest = hashlib.sha256()
        batch = max(1, min(1024, _BATCH // plan.picture_bytes(3)))
        chunk = min(plan.chunk(layout.channels), len(numbers))
        # In memory first: HDF5 that finds the disk full in the middle of a file ends the process, not only the call.
        with h5py.File(f"part {self._number}", "w", driver="core", backing_store=False, libver=VERSIONS) as file:
            packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if plan.compress else {}
            shape = (len(numbers), *layout.picture_shape)
            images = [
                file.create_dataset(name, shape, "<f4", chunks=(chunk, *layout.picture_shape), **packed)
                for name in layout.images
            ]
            for start in range(0, len(numbers), batch):
                rows = slice(start, start + batch)
                posed = (numbers[rows], position[rows], rotation[rows])
                rendered: tuple[Pictures, ...]
                if plan.uncertain:
                    *rendered, drawn[rows] = renderer.uncertain(*posed)  # type: ignore[assignment]
                else:
                    rendered = renderer.varied(*posed) if len(images) > 1 else (renderer.pictures(*posed),)
                for image, made in zip(images, rendered, strict=True):
                    checked = self._checked(made, numbers[rows])
                    digest.update(checked.tobytes())
                    image[rows] = checked
            for name in layout.columns:
                column = columns[name]
                file.create_dataset(name, data=column, dtype=column.dtype.newbyteorder("<"))
                digest.update(file[name][()].tobytes())
            describe_file(file, layout.plan.varying)
            file.attrs.update(
                format=PART_FORMAT, fingerprint=layout.fingerprint, part=self._number, first=int(numbers[0])
            )
            file.attrs["sha256"] = digest.hexdigest()
            write_image(self.path, file)

    def _values(self) -> dict[str, Array]:
        """Return the column of what varies from pose to pose, (n, variations), if anything does."""
        layout, (_, voxel, index) = self._layout, self._columns()
        if not layout.plan.varying:
            return {}
        drawn = [layout.values(v, i) for v, i in zip(voxel.tolist(), index.tolist(), strict=True)]
        return {"values": np.array([[value for _, value in values] for values in drawn])}

    def _drawn(self, file: Any) -> bool:
        """Whether the seed draws the values of what varies that a part holds."""
        for name, column in self._values().items():
            there, (_, voxels, indices) = file[name][()], self._columns()
            for row in np.flatnonzero((there != column).any(axis=1)):
                place = int(voxels[row]), int(indices[row])
                attempts = range(1, ATTEMPTS if self._layout.plan.uncertain else 1)
                draws = (self._layout.values(*place, attempt) for attempt in attempts)
                if not any(np.array_equal(there[row], [value for _, value in values]) for values in draws):
                    return False
        return True

    def _checked(self, made: Pictures, numbers: NDArray[np.int64]) -> NDArray[Any]:
        """Return pictures as they are stored; raise NlosError if they are not valid."""
        path, (width, height) = self._layout.path, self._layout.plan.resolution
        if made.shape != (len(numbers), height, width, 3):
            raise NlosError(f"{path}: the renderer made {made.shape}, not {(len(numbers), height, width, 3)}")
        finite = np.isfinite(made).all(axis=(1, 2, 3))
        if not finite.all():
            raise NlosError(f"{path}: picture {numbers[~finite][0]} holds NaN or infinite pixels")
        if self._layout.channels == 1:
            if not ((made[..., 0] == made[..., 1]) & (made[..., 0] == made[..., 2])).all():
                raise NlosError(f"{path}: the scene is grey, but the renderer made coloured pictures of it")
            made = made[..., 0]
        return np.ascontiguousarray(made, dtype="<f4")

    def fault(self, alike: Alike | None = None) -> str:
        """Read the whole part; return what is wrong, or an empty text. Its pictures are passed to ``alike``."""
        path, layout = self.path, self._layout
        try:
            file = self.open()
        except NlosError as error:
            return str(error)
        digest, finite = hashlib.sha256(), True
        numbers, voxels, indices = self._columns()
        batch = max(1, _BATCH // layout.plan.picture_bytes(layout.channels))
        try:
            with file:
                for start in range(0, len(numbers), batch):
                    rows = slice(start, start + batch)
                    images = [np.ascontiguousarray(file[name][rows], dtype="<f4") for name in layout.images]
                    for image in images:
                        finite &= bool(np.isfinite(image).all())
                        digest.update(image.tobytes())
                    if alike:
                        alike.look(numbers[rows], *images)
                for name in layout.columns:
                    digest.update(file[name][()].tobytes())
                in_order = np.array_equal(file["voxel"][()], voxels)
                in_order &= np.array_equal(file["index"][()], indices)
                drawn = self._drawn(file)
                placed = self._stand_right(file["position"][()], file["rotation"][()], voxels)
                with limited(MUCH):
                    recorded = str(file.attrs.get("sha256"))
        except Exception as error:  # HDF5 and h5py raise errors of many kinds
            return f"{path}: is broken ({short_size(error)}); take it away and run the same command again"
        if digest.hexdigest() != recorded:
            return f"{path}: its contents differ from their hash; take it away and run the same command again"
        if not finite:
            return f"{path}: holds NaN or infinite pixels"
        if not in_order:
            return f"{path}: its voxels and indices are not those of this part"
        if not drawn:
            return f"{path}: its values are not those that the seed draws"
        return "" if placed else f"{path}: its poses are not in their voxels, or turned by more than the set allows"

    def _stand_right(self, positions: Array, rotations: Array, voxels: NDArray[np.int64]) -> bool:
        """Whether the settings allow the poses, as far as that can be checked without the object."""
        plan, grid = self._layout.plan, self._layout.grid
        rotations_valid = plan.unknown or bool((np.abs(rotations) <= np.array(plan.rotation) * (1 + 1e-9)).all())
        if plan.inside == "whole":  # the origin of an object may lie outside
            return rotations_valid
        lo, hi = np.array([grid.bounds(v) for v in range(grid.n_voxels)]).transpose(1, 0, 2)
        slack = 1e-9 * np.abs([grid.lo, grid.hi]).max()
        return rotations_valid and bool(((lo[voxels] - slack <= positions) & (positions <= hi[voxels] + slack)).all())


class Alike:
    """Looks for pictures of a set that are bitwise equal to its background or to each other.

    Parameters
    ----------
    layout : Layout
    background : ndarray of shape (height, width, 3), float32
        Without pixels if it cannot be read.
    """

    def __init__(self, layout: Layout, background: NDArray[np.float32]) -> None:
        self._layout = layout
        self._empty: list[int] = []
        self._same: list[tuple[int, int]] = []
        self._first: dict[bytes, int] = {}
        grey = background if layout.channels == 3 else background[..., 0]
        self._background = np.ascontiguousarray(grey, dtype="<f4").tobytes()

    def look(self, numbers: NDArray[np.int64], pictures: Pictures, backgrounds: Pictures | None = None) -> None:
        """Compare pictures with the background, or with one each, and with those before."""
        for k, (number, picture) in enumerate(zip(numbers.tolist(), pictures, strict=True)):
            background = self._background if backgrounds is None else backgrounds[k].tobytes()
            if (data := picture.tobytes()) == background:
                self._empty.append(number)
                continue
            digest = hashlib.blake2b(data, digest_size=16).digest()
            if (first := self._first.setdefault(digest, number)) != number:
                self._same.append((first, number))

    def faults(self) -> list[str]:
        """Return a sentence per voxel in which pictures equal the background, and one for pictures that are equal."""
        layout, faults = self._layout, []
        n, labels = layout.grid.n_voxels, layout.grid.labels
        for voxel, count in sorted(Counter(number % n for number in self._empty).items()):
            first = next(number for number in self._empty if number % n == voxel)
            faults.append(
                f"{self._named(first)} equals the background to the bit, as {count} of "
                f"{len(range(voxel, layout.plan.pictures, n))} pictures of voxel {labels[voxel]} do: "
                f"{NO_CHANGE}, so it is in full shadow or hidden by something"
            )
        if self._same:
            first, second = self._same[0]
            more = f"; so do {len(self._same) - 1} more" if len(self._same) > 1 else ""
            faults.append(f"{self._named(second)} equals picture {first} to the bit, though the poses differ{more}")
        return faults

    def _named(self, number: int) -> str:
        return f"{self._layout.part_path(number // self._layout.plan.part)}: picture {number}"
