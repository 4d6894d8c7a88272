"""Very large sets: a million pictures of the engine `surfel` in a few hundred HDF5 files.

A bulk set is a folder::

    bulk.toml           format version, settings, scene, radiometry, software
    scene.blend         the scene as rendered
    world.npz           what the pictures were computed from, as plain arrays; no Blender is needed to read it
    background.exr      no hidden object
    part-1f0c9a27-000000.h5 ...   some thousand pictures each, with their poses; the middle is the set's fingerprint
    set.h5              all parts as one, once they are all there (HDF5 virtual datasets)

Picture number i shows voxel i % n_voxels with pose i // n_voxels, the very pose that a sweep with the same seed draws
there; so any first pictures of a set have seen every voxel. The datasets, one row per picture, are

    pictures    (n, height, width) float32, W/m^2/sr, row 0 the top; (n, height, width, 3) where the scene has colours
    position    (n, 3) float64, m, of the target's origin
    rotation    (n, 3) float64, degrees about x, then y, then z
    voxel       (n,) int64
    index       (n,) int64, of the pose within its voxel

A part is put in place by rename when it is whole, so a run that is killed loses the parts in hand and no other, and a
shard needs nothing but the folder.

The fingerprint stands in the parts' names because HDF5 looks for a part that is missing in the current directory too,
and would take another set's for it.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Protocol

import h5py
import numpy as np
from numpy.typing import NDArray

from generator.files.limits import MUCH, check_heaps, exceeds_limit, limited
from generator.files.pictures import COLOUR_SPACE, Picture, pixel_hash, read_picture, write_picture
from generator.files.toml import dump_toml, from_dict, read_toml, to_dict
from generator.files.writing import atomic, file_hash, fingerprint, write_text
from generator.model.arrays import Array, Vector
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.poses import Pose
from generator.model.quantities import Progress
from generator.model.settings import Sweep
from generator.sets import audit, seal
from generator.sets.hdf5 import OPENED, Rows, describe_file, short_size, write_image
from generator.sets.manifest import BACKGROUND, SCENE, check_meta, check_no_set
from generator.sets.readable import as_read
from generator.transport.world import World
from generator.transport.world_file import load_world, save_world, world_hash

FORMAT = 2
"""1 had no seal."""
_PART_FORMAT = 1
MANIFEST = "bulk.toml"
WORLD = "world.npz"
MASTER = "set.h5"

COLUMNS = ("position", "rotation", "voxel", "index")


# Files that HDF5 1.10 can read, the first that knows virtual datasets, whatever is newest here.
_VERSIONS = ("v110", "v110")

_CHUNK = 64 * 1024
_PART = 64 * 1024**2
_LARGEST_PART = 1024**3
_MOST_PARTS = 512
"""HDF5 holds every part open that it has read through the master, and a process may have 1024 files open."""
_SMALL = 2**24
"""Bytes of a part that is looked through before it is opened; to read more would take longer than to use it."""
_TOO_MANY = 2**19
"""Parts; a billion pictures of 64 x 64 are half of these."""
_BATCH = 16 * 1024**2
_CHECKED = ".checked.json"
"""Remembers which parts were found sound."""

Pictures = NDArray[np.float32]


class Renderer(Protocol):
    """What renders the pictures: `Engine`, or a stand-in."""

    def pictures(self, numbers: NDArray[np.int64], positions: Array, rotations: Array) -> Pictures:
        """Return pictures (n, height, width, 3), given their numbers (n,), in order, and poses.

        Positions (n, 3) are in metres, rotations (n, 3) in degrees.
        """


@dataclass(frozen=True, kw_only=True)
class Settings:
    """All that decides a bulk set besides the scene.

    Attributes
    ----------
    pictures : int
        In all voxels together.
    seed, inside, rotation, resolution
        As of `Sweep`.
    accuracy : float
        Relative, of the engine.
    part : int
        Pictures per file; 0 chooses.
    compress : bool
        Smaller files (gzip, which every HDF5 reader knows), slower to write and to read.
    unknown : bool
        Whether another object stands in for the scene's target at every pose index
        (`generator.sets.unknown_objects`), so that the set shows what an unknown object may look like.
    """

    pictures: int
    seed: int = 0
    resolution: tuple[int, int] = (64, 64)
    accuracy: float = 1e-3
    inside: Literal["whole", "centre"] = "whole"
    rotation: Vector = (0.0, 0.0, 0.0)
    part: int = 0
    compress: bool = False
    unknown: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.pictures <= 10**9:
            raise NlosError(f"pictures: {self.pictures} must be from 1 to {10**9}")
        if not 1e-9 <= self.accuracy <= 0.5:
            raise NlosError(f"accuracy: {self.accuracy} must be from 1e-9 to 0.5")
        if self.part < 0:
            raise NlosError(f"part: {self.part} must be 1 or more, or 0 to choose")
        self.sweep  # noqa: B018 (refuses what a sweep refuses)

    @property
    def sweep(self) -> Sweep:
        """The sweep whose poses these are."""
        return Sweep(seed=self.seed, resolution=self.resolution, inside=self.inside, rotation=self.rotation)

    def chunk(self, channels: int) -> int:
        """Pictures per HDF5 chunk: what is read from the disk to see one picture, about 64 KiB."""
        return max(1, min(1024, _CHUNK // self.picture_bytes(channels)))

    def picture_bytes(self, channels: int) -> int:
        """Bytes of one picture."""
        return math.prod(self.resolution) * channels * 4

    def with_part(self, channels: int) -> Settings:
        """Return the settings with a size of part chosen, if there is none yet.

        About 64 MiB, but enough parts to share among workers, and not so many that they cannot all be open at once.
        """
        if self.part:
            return self
        size = self.picture_bytes(channels)
        wanted = min(4096, _PART // size, max(64, math.ceil(self.pictures / 64)))
        wanted = max(1, min(max(wanted, math.ceil(self.pictures / _MOST_PARTS)), _LARGEST_PART // size))
        chunk = self.chunk(channels)
        return replace(self, part=math.ceil(wanted / chunk) * chunk)


def check_free(path: Path) -> None:
    """Raise NlosError unless a bulk set can be created at that path."""
    ours = {SCENE, WORLD, BACKGROUND}  # what planning leaves when it is killed
    if path.is_dir():
        names = {p.name for p in path.iterdir() if not p.name.endswith(".tmp")}
        if names and names <= ours:
            return
    check_no_set(path)


def is_grey(world: World) -> bool:
    """Whether light and surfaces are the same in all three colour channels, and hence every picture."""
    light = [world.patch.intensity, world.patch.albedo, world.watched.albedo]
    if world.ambient is not None:
        light += [world.ambient.radiance, world.ambient.wall.albedo]
    colours = [np.atleast_2d(c) for c in (*light, *(body.albedo for body in (*world.target, *world.room)))]
    return all(bool((c == c[:, :1]).all()) for c in colours)


class Bulk:
    """A bulk set on disk, whole or not.

    Attributes
    ----------
    path : Path
    meta : dict
        All of ``bulk.toml``.

    Examples
    --------
    >>> bulk = Bulk.open("million")  # doctest: +SKIP
    >>> bulk.pictures[123456].shape, bulk.pictures[:256].shape  # doctest: +SKIP
    ((64, 64), (256, 64, 64))
    """

    def __init__(self, path: Path, meta: dict[str, Any]) -> None:
        self.path = path
        self.meta = meta
        self.plan: Settings = from_dict(Settings, {k: v for k, v in self.settings.items() if k in _FIELDS}, "sweep.")
        self._opened: dict[tuple[int, int], dict[str, Any]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return Bulk, (self.path, self.meta)

    @classmethod
    def exists(cls, path: Path) -> bool:
        """Whether a bulk set stands at that path, finished or not."""
        return (Path(path) / MANIFEST).is_file()

    @classmethod
    def open(cls, path: Path | str, *, check: bool = True) -> Bulk:
        """Open a bulk set.

        Parameters
        ----------
        path : Path
        check : bool
            Refuse one that was changed after it was planned (`changed`). Parts are looked at by
            `refuse_changed_parts`.

        Raises
        ------
        NlosError
            There is none, its format is newer than this software, its manifest is broken, or it was changed.
        """
        path = Path(path)
        if not cls.exists(path):
            raise NlosError(f"{path}: is not a bulk set (it holds no {MANIFEST})")
        meta = read_toml(path / MANIFEST)
        version = meta.get("format")
        if not isinstance(version, int):
            raise NlosError(f"{path / MANIFEST}: lacks the field 'format'")
        if version > FORMAT:
            raise NlosError(f"{path}: has bulk format {version}; this software reads up to {FORMAT}, so update it")
        try:
            check_meta(meta, channels=int)
            bulk = cls(path, meta)
            bulk.grid  # noqa: B018 (refuses what cannot be one)
        except NlosError as error:
            raise NlosError(f"{path / MANIFEST}: {error}") from None
        if bulk.plan.part < 1 or meta["channels"] not in (1, 3):
            raise NlosError(f"{path / MANIFEST}: sweep.part must be 1 or more, and channels 1 or 3")
        if bulk.parts > _TOO_MANY:
            raise NlosError(f"{path / MANIFEST}: sweep.part: {bulk.plan.part} makes {bulk.parts} files, too many")
        if check and (fault := next(bulk.changed(), "")):
            raise NlosError(fault)
        return bulk

    @classmethod
    def create(
        cls, path: Path, plan: Settings, meta: Mapping[str, Any], world: World, background: Picture, scene_sha256: str
    ) -> Bulk:
        """Put a new set in place, with no part yet; ``bulk.toml`` comes last and makes it one.

        Parameters
        ----------
        path : Path
            Holds nothing, or ``scene.blend``.
        plan : Settings
        meta : mapping
            ``scene`` (table), ``reference_radiance`` (float, W/m^2/sr), ``software`` (table).
        world : World
        background : ndarray of shape (height, width, 3), float32
            W/m^2/sr.
        scene_sha256 : str
            Of the file that the scene was opened from.

        Raises
        ------
        NlosError
            Something cannot be written.
        """
        channels = 1 if is_grey(world) else 3
        settings = {
            **to_dict(plan.with_part(channels)),
            "engine": "surfel",
            "scene_sha256": scene_sha256,
            "world_sha256": world_hash(world),
        }
        full = {
            "format": FORMAT,
            "fingerprint": fingerprint(settings),
            "channels": channels,
            **meta,
            "sweep": settings,
        }
        save_world(path / WORLD, world)
        header = {"sweep": full["fingerprint"], "units": "W/m^2/sr", "background": BACKGROUND}
        space = {"colour_space": full["colour_space"]} if "colour_space" in full else {}
        hashes = {"background": write_picture(path / BACKGROUND, background, {**header, **space})}
        if (path / SCENE).is_file():
            hashes["scene"] = file_hash(path / SCENE)
        write_text(path / MANIFEST, dump_toml(seal.sealed(as_read(full), **hashes)))
        return cls.open(path)

    @property
    def seal(self) -> dict[str, str]:
        """The hashes of what was planned; empty in sets of older versions."""
        found: dict[str, str] = self.meta.get(seal.SEAL, {})
        return found

    def changed(self) -> Iterator[str]:
        """Look for what was changed after the set was planned: manifest, scene, world, background, files of others.

        Parts are not read.

        Yields
        ------
        str
            One sentence per fault, which begins with the file that it is in.
        """
        if words := audit.manifest_fault(self.meta, FORMAT):
            yield f"{self.path / MANIFEST}: {words}; {audit.PUT_BACK}"
            return  # all else is judged by it
        if words := audit.scene_fault(self.path / SCENE, self.seal.get("scene", "")):
            yield words
        for read in (self.world, lambda: self.background):
            try:
                read()
            except NlosError as error:
                yield str(error)
        parts = {self.part_path(number).name for number in range(self.parts)}
        yield from audit.foreign(self.path, {MANIFEST, SCENE, WORLD, BACKGROUND, MASTER, *parts})

    @property
    def settings(self) -> dict[str, Any]:
        """The set's settings, with the hashes of its scene."""
        settings: dict[str, Any] = self.meta["sweep"]
        return settings

    @cached_property
    def grid(self) -> VoxelGrid:
        """The voxel grid."""
        grid: VoxelGrid = from_dict(VoxelGrid, self.meta["scene"].get("grid", {}), "grid.")
        return grid

    @property
    def reference_radiance(self) -> float:
        """Radiance of the directly lit patch around w1, W/m^2/sr: the scene's own scale of light."""
        return float(self.meta["reference_radiance"])

    @property
    def target_kind(self) -> str:
        """The kind of target: sheet, sphere or mesh; or box, where it is unknown."""
        if self.plan.unknown:
            return "box"
        return str(self.meta["scene"].get("target", {}).get("kind", "mesh"))

    @property
    def planned(self) -> int:
        """How many pictures the set has when it is finished."""
        return self.plan.pictures

    @property
    def parts(self) -> int:
        """How many parts the set has when it is finished."""
        return math.ceil(self.plan.pictures / self.plan.part)

    @property
    def picture_shape(self) -> tuple[int, ...]:
        """Shape of one picture: (height, width), or (height, width, 3) where the scene has colours."""
        width, height = self.plan.resolution
        return (height, width) if self.meta["channels"] == 1 else (height, width, 3)

    @property
    def background(self) -> Picture:
        """The picture without the hidden object, (height, width, 3), W/m^2/sr.

        Raises
        ------
        NlosError
            It is missing, broken, or another picture.
        """
        pixels, header = read_picture(self.path / BACKGROUND)
        digest = pixel_hash(pixels)
        known = self.seal.get("background", header.get("pixel_hash"))
        if digest != known or header.get("sweep") != self.meta["fingerprint"]:
            raise NlosError(
                f"{self.path / BACKGROUND}: is not the background that this set was begun with; {audit.PUT_BACK}"
            )
        return pixels

    @property
    def colour_space(self) -> str:
        """The linear space that the three channels are of: Rec.709, Rec.2020 or ACEScg."""
        return str(self.meta.get("colour_space", COLOUR_SPACE))

    @property
    def pictures(self) -> Rows:
        """The pictures, W/m^2/sr, read as they are asked for: ``pictures[7]``, ``pictures[100:200]``."""
        return Rows(self, "pictures", self.picture_shape, np.dtype(np.float32))

    @cached_property
    def positions(self) -> Array:
        """Of the target's origin, (n, 3), metres; all are read."""
        return np.asarray(Rows(self, "position", (3,), np.dtype(np.float64)))

    @cached_property
    def rotations(self) -> Array:
        """About x, then y, then z, (n, 3), degrees; all are read."""
        return np.asarray(Rows(self, "rotation", (3,), np.dtype(np.float64)))

    @property
    def voxels(self) -> NDArray[np.int64]:
        """Which voxel the target stands in, (n,)."""
        return np.arange(self.planned) % self.grid.n_voxels

    @property
    def labels(self) -> NDArray[np.str_]:
        """The voxels' names, (n,)."""
        return np.array(self.grid.labels)[self.voxels]

    def world(self) -> World:
        """What the pictures were computed from.

        Raises
        ------
        NlosError
            It is missing, or not the one this set was begun with.
        """
        world = load_world(self.path / WORLD)
        if world_hash(world) != self.settings.get("world_sha256"):
            raise NlosError(f"{self.path / WORLD}: is not the world that this set was begun with")
        return world

    def part_path(self, number: int) -> Path:
        """Return the file of a part."""
        return self.path / f"part-{self.meta['fingerprint'][:8]}-{number:06d}.h5"

    def part_range(self, number: int) -> range:
        """Return the numbers of a part's pictures."""
        return range(number * self.plan.part, min((number + 1) * self.plan.part, self.plan.pictures))

    def missing(self) -> list[int]:
        """Return the parts that are not there; a part that was renamed into place is believed to be whole."""
        return [number for number in range(self.parts) if not self._is_there(number)]

    def refuse_unfinished(self) -> None:
        """Raise NlosError if parts are missing."""
        if missing := self.missing():
            raise NlosError(f"{self.path}: {len(missing)} of {self.parts} parts are missing; finish the set first")

    def _is_there(self, number: int) -> bool:
        try:
            self._open_part(number).close()
        except NlosError:
            return False
        return True

    def _open_part(self, number: int) -> Any:
        path = self.part_path(number)
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
        count = len(self.part_range(number))
        try:
            with limited(MUCH):
                fingerprint_there, number_there = (file.attrs.get(name) for name in ("fingerprint", "part"))
            if fingerprint_there != self.meta["fingerprint"] or number_there != number:
                raise ValueError("is of another set")
            claimed = 0
            for name in ("pictures", *COLUMNS):
                if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                    raise ValueError(f"has no {name} of its own")
                if file[name].external or file[name].is_virtual:  # HDF5 would read any file that is named there
                    raise ValueError(f"keeps {name} in another file, which is not followed")
                inner = self.picture_shape if name == "pictures" else (3,) if name in COLUMNS[:2] else ()
                if file[name].shape != (count, *inner):
                    raise ValueError(f"holds {name} of shape {file[name].shape}, not {(count, *inner)}")
                if file[name].dtype.kind != ("i" if name in COLUMNS[2:] else "f"):
                    raise ValueError(f"holds {name} as {file[name].dtype}")
                claimed += file[name].nbytes
            if exceeds_limit(claimed, path.stat().st_size):
                raise ValueError(f"claims {claimed} bytes in {path.stat().st_size}")
        except Exception as error:  # HDF5's and h5py's, of many kinds
            file.close()
            raise NlosError(f"{path}: {short_size(error)}; run the same command again to make it anew") from None
        return file

    def rows(self, number: int, name: str) -> Any:
        """Return a part's dataset, as h5py gives it; some parts are kept open."""
        # A file that was opened before a fork must not be used after it, so the process is part of the key. Datasets
        # are kept and not the file alone, since to look one up takes longer than to read a picture from it.
        key = (number, os.getpid())
        kept = self._opened.pop(key, None)
        if kept is None:
            file = self._open_part(number)
            kept = {"file": file} | {column: file[column] for column in ("pictures", *COLUMNS)}
        self._opened[key] = kept  # the last used comes last
        if len(self._opened) > OPENED:
            del self._opened[next(iter(self._opened))]
        return kept[name]

    def close(self) -> None:
        """Close the parts that are kept open; they open again when they are read."""
        for kept in self._opened.values():
            kept["file"].close()
        self._opened.clear()

    def write_part(self, number: int, draw: Callable[[int, int], Pose], renderer: Renderer) -> None:
        """Render a part and put it in place.

        Parameters
        ----------
        number : int
        draw : callable
            Returns the pose of (voxel, index).
        renderer : Renderer

        Raises
        ------
        NlosError
            A picture is not finite or of the wrong shape, or the part cannot be written.
        """
        numbers = np.array(self.part_range(number), dtype=np.int64)
        voxel, index = numbers % self.grid.n_voxels, numbers // self.grid.n_voxels
        drawn = [draw(v, i) for v, i in zip(voxel.tolist(), index.tolist(), strict=True)]
        position = np.array([p for p, _ in drawn], dtype=np.float64)
        rotation = np.array([r for _, r in drawn], dtype=np.float64)
        digest = hashlib.sha256()
        channels = self.meta["channels"]
        batch = max(1, min(1024, _BATCH // self.plan.picture_bytes(3)))
        chunk = min(self.plan.chunk(channels), len(numbers))
        # In memory first: HDF5 that finds the disk full in the middle of a file ends the process, not the call.
        with h5py.File(f"part {number}", "w", driver="core", backing_store=False, libver=_VERSIONS) as file:
            packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if self.plan.compress else {}
            shape = (len(numbers), *self.picture_shape)
            pictures = file.create_dataset("pictures", shape, "<f4", chunks=(chunk, *self.picture_shape), **packed)
            for start in range(0, len(numbers), batch):
                some = slice(start, start + batch)
                made = renderer.pictures(numbers[some], position[some], rotation[some])
                made = self._checked(made, numbers[some])
                digest.update(made.tobytes())
                pictures[some] = made
            for name, column in zip(COLUMNS, (position, rotation, voxel, index), strict=True):
                file.create_dataset(name, data=column, dtype=column.dtype.newbyteorder("<"))
                digest.update(file[name][()].tobytes())
            describe_file(file)
            file.attrs.update(
                format=_PART_FORMAT, fingerprint=self.meta["fingerprint"], part=number, first=int(numbers[0])
            )
            file.attrs["sha256"] = digest.hexdigest()
            write_image(self.part_path(number), file)

    def _checked(self, made: Pictures, numbers: NDArray[np.int64]) -> NDArray[Any]:
        """Return pictures as they are stored, once they are known to be sound."""
        width, height = self.plan.resolution
        if made.shape != (len(numbers), height, width, 3):
            raise NlosError(f"{self.path}: the renderer made {made.shape}, not {(len(numbers), height, width, 3)}")
        whole = np.isfinite(made).all(axis=(1, 2, 3))
        if not whole.all():
            raise NlosError(f"{self.path}: picture {numbers[~whole][0]} holds NaN or infinite pixels")
        if self.meta["channels"] == 1:
            if not ((made[..., 0] == made[..., 1]) & (made[..., 0] == made[..., 2])).all():
                raise NlosError(f"{self.path}: the scene is grey, but the renderer made coloured pictures of it")
            made = made[..., 0]
        return np.ascontiguousarray(made, dtype="<f4")

    def finish(self) -> None:
        """Write ``set.h5``, which shows all parts as one, unless it is there; clear away what killed runs left."""
        for left in self.path.glob(".part-*.tmp"):
            left.unlink(missing_ok=True)
        if self._has_master():
            return
        with atomic(self.path / MASTER) as temporary:
            temporary.write_bytes(self._master())

    def _master(self) -> bytes:
        """What ``set.h5`` holds: all parts as one."""
        with h5py.File("set", "w", driver="core", backing_store=False, libver=_VERSIONS) as file:
            self._describe_all(file)
            file.flush()
            image: bytes = file.id.get_file_image()
        return image

    def _describe_all(self, file: Any) -> None:
        columns = {
            "pictures": (self.picture_shape, "<f4", np.nan),
            "position": ((3,), "<f8", np.nan),
            "rotation": ((3,), "<f8", np.nan),
            "voxel": ((), "<i8", -1),
            "index": ((), "<i8", -1),
        }
        # A part that is taken away later reads as the fill value: NaN, which nobody takes for a picture.
        for name, (shape, dtype, fill) in columns.items():
            layout = h5py.VirtualLayout((self.planned, *shape), dtype)
            for number in range(self.parts):
                rows = self.part_range(number)
                source = h5py.VirtualSource(self.part_path(number).name, name, (len(rows), *shape), dtype)
                layout[rows.start : rows.stop] = source
            file.create_virtual_dataset(name, layout, fillvalue=fill)
        describe_file(file)
        file["background"] = self.background
        file["background"].attrs["units"] = "W/m^2/sr"
        file.create_dataset("label", data=self.grid.labels, dtype=h5py.string_dtype())
        file["label"].attrs["about"] = "names of the voxels: row v is voxel v's"
        file.attrs.update(
            format=_PART_FORMAT,
            fingerprint=self.meta["fingerprint"],
            reference_radiance=self.reference_radiance,
            **{f"grid_{name}": value for name, value in to_dict(self.grid).items()},
        )

    def _has_master(self) -> bool:
        """Whether ``set.h5`` is there, and says what it was written with."""
        try:
            check_heaps(self.path / MASTER)
            with (
                h5py.File(self.path / MASTER, "r") as file,
                h5py.File(io.BytesIO(self._master()), "r") as wanted,
                limited(MUCH),
            ):
                return set(file) == set(wanted) and all(
                    _told(file, name) == _told(wanted, name) for name in ("/", *wanted)
                )
        except Exception:  # HDF5's and h5py's, of many kinds
            return False

    def refuse_changed_parts(self, count: int = 0) -> None:
        """Raise NlosError if parts are not as they were rendered.

        A part that was found sound is remembered, with its size and the time of its last change, and is read again
        only when those differ; `verify` reads all.

        Parameters
        ----------
        count : int
            Of pictures, from the first, that are to be used; 0 is all.
        """
        known = self._sound()
        before = dict(known)
        for number in range(math.ceil((count or self.planned) / self.plan.part)):
            path = self.part_path(number)
            if known.get(path.name) != (state := _state(path)):
                if fault := self._fault(number):
                    raise NlosError(fault)
                known[path.name] = state
        self._remember(known, before)

    def _sound(self) -> dict[str, Any]:
        """What is remembered of parts that were found sound."""
        try:
            found = json.loads((self.path / _CHECKED).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return {}
        return found if isinstance(found, dict) else {}

    def _remember(self, sound: dict[str, Any], before: dict[str, Any]) -> None:
        if sound != before:
            with contextlib.suppress(NlosError):  # of a set that one may only read, parts are read again
                write_text(self.path / _CHECKED, json.dumps(sound))

    def verify(self, progress: Progress = lambda done, total: None) -> list[str]:
        """Re-read everything; return what is wrong, a sentence each, which begins with the file that it is in."""
        faults, sound = list(self.changed()), {}
        alike = _Alike(self)
        for number in range(self.parts):
            progress(number, self.parts)
            if fault := self._fault(number, alike):
                faults.append(fault)
            else:
                sound[self.part_path(number).name] = _state(self.part_path(number))
        progress(self.parts, self.parts)
        self._remember(sound, {})
        faults += alike.faults()
        if not faults and not self._has_master():
            faults.append(f"{self.path / MASTER}: missing, broken or changed; run the same command again to make it")
        return faults

    def _fault(self, number: int, alike: _Alike | None = None) -> str:
        path = self.part_path(number)
        try:
            file = self._open_part(number)
        except NlosError as error:
            return str(error)
        digest, finite = hashlib.sha256(), True
        numbers = np.array(self.part_range(number), dtype=np.int64)
        batch = max(1, _BATCH // self.plan.picture_bytes(self.meta["channels"]))
        try:
            with file:
                for start in range(0, len(numbers), batch):
                    pictures = np.ascontiguousarray(file["pictures"][start : start + batch], dtype="<f4")
                    finite &= bool(np.isfinite(pictures).all())
                    digest.update(pictures.tobytes())
                    if alike:
                        alike.look(numbers[start : start + batch], pictures)
                for name in COLUMNS:
                    digest.update(file[name][()].tobytes())
                order = np.array_equal(file["voxel"][()], numbers % self.grid.n_voxels)
                order &= np.array_equal(file["index"][()], numbers // self.grid.n_voxels)
                placed = self._stand_right(file["position"][()], file["rotation"][()], numbers % self.grid.n_voxels)
                with limited(MUCH):
                    told = str(file.attrs.get("sha256"))
        except Exception as error:  # HDF5's and h5py's, of many kinds
            return f"{path}: is broken ({short_size(error)}); take it away and run the same command again"
        if digest.hexdigest() != told:
            return f"{path}: its contents differ from their hash; take it away and run the same command again"
        if not finite:
            return f"{path}: holds NaN or infinite pixels"
        if not order:
            return f"{path}: its voxels and indices are not those of this part"
        return "" if placed else f"{path}: its poses are not in their voxels, or turned by more than the set allows"

    def _stand_right(self, positions: Array, rotations: Array, voxels: NDArray[np.int64]) -> bool:
        """Whether poses are such as the settings allow, as far as that can be told without the object."""
        turned = self.plan.unknown or bool((np.abs(rotations) <= np.array(self.plan.rotation) * (1 + 1e-9)).all())
        if self.plan.inside == "whole":  # the origin of an object may lie beside it
            return turned
        lo, hi = np.array([self.grid.bounds(v) for v in range(self.grid.n_voxels)]).transpose(1, 0, 2)
        slack = 1e-9 * np.abs([self.grid.lo, self.grid.hi]).max()
        return turned and bool(((lo[voxels] - slack <= positions) & (positions <= hi[voxels] + slack)).all())


class _Alike:
    """Looks for pictures of a set that equal its background to the bit, or each other."""

    def __init__(self, bulk: Bulk) -> None:
        self._bulk = bulk
        self._empty: list[int] = []
        self._same: list[tuple[int, int]] = []
        self._first: dict[bytes, int] = {}
        try:
            background = bulk.background
        except NlosError:  # which is told elsewhere
            background = np.zeros((0, 0, 3), dtype=np.float32)
        grey = background if bulk.meta["channels"] == 3 else background[..., 0]
        self._background = np.ascontiguousarray(grey, dtype="<f4").tobytes()

    def look(self, numbers: NDArray[np.int64], pictures: Pictures) -> None:
        """Take note of pictures."""
        for number, picture in zip(numbers.tolist(), pictures, strict=True):
            if (data := picture.tobytes()) == self._background:
                self._empty.append(number)
                continue
            digest = hashlib.blake2b(data, digest_size=16).digest()
            if (first := self._first.setdefault(digest, number)) != number:
                self._same.append((first, number))

    def faults(self) -> list[str]:
        """Return a sentence per voxel whose pictures are the background, and one for those that equal each other."""
        bulk, found = self._bulk, []
        n, labels = bulk.grid.n_voxels, bulk.grid.labels
        for voxel, count in sorted(Counter(number % n for number in self._empty).items()):
            first = next(number for number in self._empty if number % n == voxel)
            found.append(
                f"{self._named(first)} equals the background to the bit, as {count} of "
                f"{len(range(voxel, bulk.planned, n))} pictures of voxel {labels[voxel]} do: the object changes "
                "nothing there, so it is in full shadow or hidden by something"
            )
        if self._same:
            first, second = self._same[0]
            more = f"; so do {len(self._same) - 1} more" if len(self._same) > 1 else ""
            found.append(f"{self._named(second)} equals picture {first} to the bit, though the poses differ{more}")
        return found

    def _named(self, number: int) -> str:
        return f"{self._bulk.part_path(number // self._bulk.plan.part)}: picture {number}"


def _state(path: Path) -> list[int]:
    """What of a file tells that it was not changed since."""
    found = path.stat()
    return [found.st_size, found.st_mtime_ns]


def _told(file: Any, name: str) -> Any:
    """The attributes of an HDF5 dataset or group, and what a dataset holds, or where it says that it lies."""
    if name != "/" and not isinstance(file.get(name, getlink=True), h5py.HardLink):
        return None
    thing = file[name]
    attributes = {name: np.asarray(value).tolist() for name, value in thing.attrs.items()}
    if not isinstance(thing, h5py.Dataset) or thing.external:
        return attributes
    if not thing.is_virtual:
        return attributes, thing.shape, thing.dtype.str, np.asarray(thing[()]).tolist()
    places = [
        (m.file_name, m.dset_name, m.vspace.get_select_bounds(), m.src_space.get_select_type())
        for m in thing.virtual_sources()
    ]
    return attributes, thing.shape, thing.dtype.str, repr(thing.fillvalue), sorted(places)


_FIELDS = frozenset(Settings.__dataclass_fields__)
