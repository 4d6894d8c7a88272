"""Very large sets: a million pictures of the engine `surfel` in a few hundred HDF5 files.

A bulk set is a folder::

    bulk.toml           format version, settings, scene, radiometry, software
    scene.blend         the scene as rendered
    world.npz           data that the pictures were computed from, as plain arrays; readable without Blender
    background.exr      no hidden object
    part-1f0c9a27-000000.h5 ...   some thousand pictures each, with their poses; the middle is the set's fingerprint
    set.h5              all parts as one, once they are all there (HDF5 virtual datasets)

Picture number i shows voxel i % n_voxels with pose i // n_voxels, so the first pictures of a set, up to any number,
are spread evenly over the voxels. Poses follow from the seed, but are not those that a sweep with the same seed draws
(`Settings.stream`). The datasets, one row per picture, are

    pictures    (n, height, width) float32, W/m^2/sr, row 0 the top; (n, height, width, 3) where the scene has colours
    position    (n, 3) float64, m, of the target's origin
    rotation    (n, 3) float64, degrees about x, then y, then z
    voxel       (n,) int64
    index       (n,) int64, of the pose within its voxel
    values      (n, variations) float64, what varies from pose to pose, if anything does
    other_positions, other_rotations, other_voxels   (n, objects - 1, ...), of the objects besides the first, if any
    backgrounds as pictures, without the hidden object, where more than the target varies

A part is put in place by rename when it is whole, so a killed run loses only the parts in progress, and a shard needs
nothing but the folder.

The names of parts contain the fingerprint because HDF5 also looks for a missing part in the current directory, and
would use another set's part.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.files.pictures import COLOUR_SPACE, Picture, pixel_hash, read_picture, write_picture
from generator.files.toml import dump_toml, from_dict, read_toml, to_dict
from generator.files.writing import atomic, file_hash, fingerprint, write_text
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.quantities import Progress
from generator.sets import audit, seal
from generator.sets.bulk_master import Master
from generator.sets.bulk_part import Alike, Part
from generator.sets.bulk_settings import Layout, Settings
from generator.sets.hdf5 import OPENED, Rows
from generator.sets.manifest import BACKGROUND, SCENE, check_meta, check_no_set
from generator.sets.readable import as_read
from generator.transport.world import World
from generator.transport.world_file import load_world, save_world, world_hash

FORMAT = 5
"""Format 1 had no seal; up to format 2, the seed drew the poses of a sweep; up to format 3, nothing varied from pose
to pose and there was one object; up to format 4, no scene was uncertain. A set has the oldest format that holds it,
so that older versions read it."""
MANIFEST = "bulk.toml"
WORLD = "world.npz"
MASTER = "set.h5"

_TOO_MANY = 2**19
"""Largest number of parts; a billion pictures of 64 x 64 take half as many."""
_CHECKED = ".checked.json"
"""File that records which parts were found valid."""


def check_free(path: Path) -> None:
    """Raise NlosError unless a bulk set can be created at that path."""
    leftovers = {SCENE, WORLD, BACKGROUND}  # files that planning leaves when it is killed
    if path.is_dir():
        names = {p.name for p in path.iterdir() if not p.name.endswith(".tmp")}
        if names and names <= leftovers:
            return
    check_no_set(path)


def is_grey(world: World) -> bool:
    """Whether light and surfaces are the same in all three colour channels, and hence every picture."""
    light = [world.patch.intensity, world.patch.albedo, world.watched.albedo]
    if world.ambient is not None:
        light.append(world.ambient.radiance)
    if world.emitters is not None:
        light += [world.emitters.radiance, world.emitters.intensity]
    if world.wall is not None:
        light.append(world.wall.albedo)
    for body in world.target:
        light += [] if body.gloss is None else [body.gloss.tint, body.gloss.multiple]
    colours = [np.atleast_2d(c) for c in (*light, *(body.albedo for body in (*world.target, *world.room)))]
    return all(bool((c == c[:, :1]).all()) for c in colours)


class Bulk:
    """A bulk set on disk, finished or not.

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
        """Whether there is a bulk set at that path, finished or not."""
        return (Path(path) / MANIFEST).is_file()

    @classmethod
    def open(cls, path: Path | str, *, check: bool = True) -> Bulk:
        """Open a bulk set.

        Parameters
        ----------
        path : Path
        check : bool
            Refuse a set that was changed after it was planned (`changed`). `refuse_changed_parts` checks the parts.

        Raises
        ------
        NlosError
            There is no bulk set, its format is newer than this software, its manifest is broken, or it was changed.
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
            bulk.grid  # noqa: B018 (raises if it is not valid)
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
        """Write a new set, with no part yet; ``bulk.toml`` is written last and makes the folder a set.

        Parameters
        ----------
        path : Path
            Folder that is empty, or holds ``scene.blend``.
        plan : Settings
        meta : mapping
            ``scene`` (table), ``reference_radiance`` (float, W/m^2/sr), ``software`` (table).
        world : World
        background : ndarray of shape (height, width, 3), float32
            W/m^2/sr.
        scene_sha256 : str
            Hash of the file that the scene was opened from.

        Raises
        ------
        NlosError
            Something cannot be written.
        """
        channels = 1 if is_grey(world) else 3
        settings = {
            **{name: value for name, value in to_dict(plan.with_part(channels)).items() if name not in plan.unused},
            "engine": "surfel",
            "scene_sha256": scene_sha256,
            "world_sha256": world_hash(world),
        }
        full = {
            "format": 5 if plan.uncertain else 4 if plan.vary or plan.targets > 1 else 3,
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
        hashes: dict[str, str] = self.meta.get(seal.SEAL, {})
        return hashes

    def changed(self) -> Iterator[str]:
        """Look for changes after the set was planned: of manifest, scene, world and background, or by foreign files.

        Parts are not read.

        Yields
        ------
        str
            One sentence per fault, which begins with the file that it is in.
        """
        if words := audit.manifest_fault(self.meta):
            yield f"{self.path / MANIFEST}: {words}; {audit.PUT_BACK}"
            return  # all other checks rely on the manifest
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
        """Radiance of the directly lit patch around w1, W/m^2/sr, which sets the scale of the scene's radiance."""
        return float(self.meta["reference_radiance"])

    @property
    def target_kind(self) -> str:
        """The kind of target: sheet, sphere or mesh; or box, for unknown objects."""
        if self.plan.unknown:
            return "box"
        return str(self.meta["scene"].get("target", {}).get("kind", "mesh"))

    @property
    def planned(self) -> int:
        """Number of pictures of the finished set."""
        return self.plan.pictures

    @cached_property
    def layout(self) -> Layout:
        """Layout of its parts."""
        meta = self.meta
        return Layout(self.path, meta["fingerprint"], self.plan, meta["channels"], self.grid, meta["scene"])

    @property
    def parts(self) -> int:
        """Number of parts of the finished set."""
        return self.layout.parts

    @property
    def picture_shape(self) -> tuple[int, ...]:
        """Shape of one picture: (height, width), or (height, width, 3) where the scene has colours."""
        return self.layout.picture_shape

    @property
    def background(self) -> Picture:
        """The picture without the hidden object, (height, width, 3), W/m^2/sr.

        Raises
        ------
        NlosError
            The picture is missing, broken, or another one.
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
        """Linear colour space of the three channels: Rec.709, Rec.2020 or ACEScg."""
        return str(self.meta.get("colour_space", COLOUR_SPACE))

    @property
    def pictures(self) -> Rows:
        """The pictures, W/m^2/sr, which are read when they are indexed: ``pictures[7]``, ``pictures[100:200]``."""
        return Rows(self, "pictures", self.picture_shape, np.dtype(np.float32))

    @cached_property
    def positions(self) -> Array:
        """Positions of the target's origin, (n, 3), metres; all are read at once."""
        return np.asarray(Rows(self, "position", (3,), np.dtype(np.float64)))

    @cached_property
    def rotations(self) -> Array:
        """Rotations about x, then y, then z, (n, 3), degrees; all are read at once."""
        return np.asarray(Rows(self, "rotation", (3,), np.dtype(np.float64)))

    @property
    def backgrounds(self) -> Rows | None:
        """The background of each picture, read as `pictures` are; None where all have the same, `background`."""
        if not self.plan.own_backgrounds:
            return None
        return Rows(self, "backgrounds", self.picture_shape, np.dtype(np.float32))

    @cached_property
    def values(self) -> Array:
        """What varies, (n, variations), in the order of `Settings.varying`; all are read at once."""
        count = len(self.plan.varying)
        if not count:
            return np.zeros((self.planned, 0))
        return np.asarray(Rows(self, "values", (count,), np.dtype(np.float64)))

    @cached_property
    def others(self) -> dict[str, NDArray[Any]]:
        """Voxels, positions and rotations of the objects besides the first, (n, objects - 1, ...); empty if none."""
        names = [name for name in self.layout.columns if name.startswith("other_")]
        columns = {name: self.layout.columns[name] for name in names}
        return {name: np.asarray(Rows(self, name, shape, np.dtype(kind))) for name, (shape, kind) in columns.items()}

    @property
    def voxels(self) -> NDArray[np.int64]:
        """Number of the voxel that the target stands in, (n,)."""
        return np.arange(self.planned) % self.grid.n_voxels

    @property
    def labels(self) -> NDArray[np.str_]:
        """Names of these voxels, (n,)."""
        return np.array(self.grid.labels)[self.voxels]

    def world(self) -> World:
        """Return the data that the pictures were computed from.

        Raises
        ------
        NlosError
            The file is missing, or is not the one this set was begun with.
        """
        world = load_world(self.path / WORLD)
        if world_hash(world) != self.settings.get("world_sha256"):
            raise NlosError(f"{self.path / WORLD}: is not the world that this set was begun with")
        return world

    def part_path(self, number: int) -> Path:
        """Return the file of a part."""
        return self.layout.part_path(number)

    def part_range(self, number: int) -> range:
        """Return the numbers of a part's pictures."""
        return self.layout.part_range(number)

    def part(self, number: int) -> Part:
        """Return a part."""
        return Part(self.layout, number)

    def missing(self) -> list[int]:
        """Return the numbers of the missing parts; a part that exists is taken to be whole (`Part.is_there`)."""
        return [number for number in range(self.parts) if not self.part(number).is_there]

    def refuse_unfinished(self) -> None:
        """Raise NlosError if parts are missing."""
        if missing := self.missing():
            raise NlosError(f"{self.path}: {len(missing)} of {self.parts} parts are missing; finish the set first")

    def rows(self, number: int, name: str) -> Any:
        """Return a part's dataset, of type h5py.Dataset; the parts used last are kept open."""
        # A file that was opened before a fork must not be used after it, so the process is part of the key. Datasets
        # are kept and not the file alone, since looking one up takes longer than reading a picture from it.
        key = (number, os.getpid())
        datasets = self._opened.pop(key, None)
        if datasets is None:
            file = self.part(number).open()
            names = (*self.layout.images, *self.layout.columns)
            datasets = {"file": file} | {each: file[each] for each in names}
        self._opened[key] = datasets  # the last used comes last
        if len(self._opened) > OPENED:
            del self._opened[next(iter(self._opened))]
        return datasets[name]

    def close(self) -> None:
        """Close the parts that are kept open; they open again when they are read."""
        for datasets in self._opened.values():
            datasets["file"].close()
        self._opened.clear()

    def finish(self) -> None:
        """Write ``set.h5``, which shows all parts as one, unless it exists; remove temporary files of killed runs."""
        for leftover in self.path.glob(".part-*.tmp"):
            leftover.unlink(missing_ok=True)
        master = self._master()
        if not master.is_in(self.path / MASTER):
            with atomic(self.path / MASTER) as temporary:
                temporary.write_bytes(master.image())

    def _master(self) -> Master:
        return Master(self.layout, self.background, self.reference_radiance)

    def refuse_changed_parts(self, count: int = 0) -> None:
        """Raise NlosError if parts are not as they were rendered.

        A part that was found valid is recorded, with its size and the time of its last change, and is read again only
        when those differ; `verify` reads all parts.

        Parameters
        ----------
        count : int
            Number of pictures, from the first, that are to be used; 0 is all.
        """
        sound = self._sound()
        before = dict(sound)
        for number in range(math.ceil((count or self.planned) / self.plan.part)):
            part = self.part(number)
            if sound.get(part.path.name) != (state := part.state):
                if fault := part.fault():
                    raise NlosError(fault)
                sound[part.path.name] = state
        self._remember(sound, before)

    def _sound(self) -> dict[str, Any]:
        """Return the recorded states of the parts that were found valid, by name of their file."""
        try:
            states = json.loads((self.path / _CHECKED).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return {}
        return states if isinstance(states, dict) else {}

    def _remember(self, sound: dict[str, Any], before: dict[str, Any]) -> None:
        if sound != before:
            with contextlib.suppress(NlosError):  # parts of a read-only set are read again each time
                write_text(self.path / _CHECKED, json.dumps(sound))

    def verify(self, progress: Progress = lambda done, total: None) -> list[str]:
        """Read everything again; return one sentence per fault, which begins with the file that it is in."""
        faults, sound = list(self.changed()), {}
        try:
            alike = Alike(self.layout, self.background)
        except NlosError:  # `changed` has reported it
            alike = Alike(self.layout, np.zeros((0, 0, 3), dtype=np.float32))
        for number in range(self.parts):
            progress(number, self.parts)
            part = self.part(number)
            if fault := part.fault(alike):
                faults.append(fault)
            else:
                sound[part.path.name] = part.state
        progress(self.parts, self.parts)
        self._remember(sound, {})
        faults += alike.faults()
        if not faults and not self._master().is_in(self.path / MASTER):
            faults.append(f"{self.path / MASTER}: missing, broken or changed; run the same command again to make it")
        return faults


_FIELDS = frozenset(Settings.__dataclass_fields__)
