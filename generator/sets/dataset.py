"""The data set on disk: write, read, resume, verify.

A data set is a folder::

    dataset.toml        format version, sweep settings, scene, radiometry, software
    scene.blend         the scene as rendered
    background.exr      no hidden object; background-ambient.exr too where ambient light is on
    poses.csv           one row per planned pose; file, hash, seconds and samples once it is rendered
    A/0000.exr ...      one float32 picture per pose, in a folder per voxel
    A/0000-background.exr ...   its own background, where more than the target varies from pose to pose

Each picture carries its pose, its pixels' hash and the fingerprint of its sweep in its header, so workers need no
common file: a picture that was put in place by rename is done, and the manifest is gathered from the pictures.

``dataset.toml`` holds hashes of its own values, of the scene, and of the planned poses in ``poses.csv``
(`generator.sets.seal`), so a set that was changed after it was planned is refused when it is opened.
`generator.sets.audit` reads everything again.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from generator.files.pictures import COLOUR_SPACE, Picture, pixel_hash, read_picture, write_picture
from generator.files.toml import dump_toml, from_dict, read_toml
from generator.files.writing import HOST, csv_text, file_hash, fingerprint, is_alive, write_text
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.poses import PoseRecord, pose_columns
from generator.model.settings import Sweep
from generator.sets import audit, seal
from generator.sets.manifest import (
    BACKGROUND,
    BACKGROUND_AMBIENT,
    FORMAT,
    MANIFEST,
    NEWER_ATTRIBUTES,
    POSES,
    SCENE,
    check_meta,
    check_no_set,
    plan_hash,
    read_poses,
)
from generator.sets.readable import RENDER_AGAIN, Seen, as_read, others_text, rendered, values_text, vector_text


class Dataset:
    """A data set on disk.

    Attributes
    ----------
    path : Path
    meta : dict
        All of ``dataset.toml``.
    poses : list of PoseRecord
        Every planned pose, rendered or not.
    """

    def __init__(self, path: Path, meta: dict[str, Any], poses: list[PoseRecord]) -> None:
        self.path = path
        self.meta = meta
        self.poses = poses

    @classmethod
    def exists(cls, path: Path) -> bool:
        """Whether there is a data set at that path, finished or not."""
        return (path / MANIFEST).is_file()

    @classmethod
    def open(cls, path: Path, *, check: bool = True) -> Dataset:
        """Open a data set.

        Parameters
        ----------
        path : Path
        check : bool
            Refuse a set that was changed after it was planned (`audit.changed`). Pictures are checked when they are
            read.

        Raises
        ------
        NlosError
            There is no data set, its format is newer than this software, its manifest is broken, or it was changed.
        """
        path = Path(path)
        if not cls.exists(path):
            raise NlosError(f"{path}: is not a data set (it holds no {MANIFEST})")
        meta = read_toml(path / MANIFEST)
        version = meta.get("format")
        if not isinstance(version, int):
            raise NlosError(f"{path / MANIFEST}: lacks the field 'format'")
        if "measured" in meta:
            raise NlosError(f"{path}: holds measured pictures, and no sweep's; this command takes rendered sets only")
        if version > FORMAT:
            raise NlosError(
                f"{path}: has data set format {version}; this software reads up to {FORMAT}, so update it"
            )
        try:
            check_meta(meta)
            dataset = cls(path, meta, read_poses(path / POSES))
            dataset.sweep, dataset.grid  # noqa: B018 (raise if they are not valid)
        except NlosError as error:
            raise NlosError(f"{path / MANIFEST}: {error}") from None
        if check:
            dataset.refuse_changed()
        return dataset

    @classmethod
    def create(cls, path: Path, meta: Mapping[str, Any], poses: Sequence[PoseRecord]) -> Dataset:
        """Write a new data set, with no picture yet; ``dataset.toml`` is written last and makes it a data set.

        Parameters
        ----------
        path : Path
            A new or empty folder.
        meta : mapping
            ``sweep``, ``scene`` (tables), ``reference_radiance`` (float, W/m^2/sr), ``software`` (table).
        poses : sequence of PoseRecord

        Raises
        ------
        NlosError
            The folder holds something else, or cannot be written.
        """
        check_no_set(path)
        version = FORMAT if {"vary", "targets"} & set(meta["sweep"]) else FORMAT - 1
        full = {"format": version, "fingerprint": fingerprint(meta["sweep"]), **meta}
        plain = as_read(full)
        hashes = {"poses": plan_hash(poses)}
        if (path / SCENE).is_file():
            hashes["scene"] = file_hash(path / SCENE)
        dataset = cls(path, seal.sealed(plain, **hashes), list(poses))
        dataset.write_manifest()
        write_text(path / MANIFEST, dump_toml(dataset.meta))
        return dataset

    @property
    def seal(self) -> dict[str, str]:
        """The hashes of what was planned; empty in sets of older versions."""
        hashes: dict[str, str] = self.meta.get(seal.SEAL, {})
        return hashes

    def refuse_changed(self) -> None:
        """Raise NlosError, naming the first fault, if the set was changed after it was planned (`audit.changed`)."""
        if fault := next(audit.changed(self), ""):
            raise NlosError(fault)

    @cached_property
    def grid(self) -> VoxelGrid:
        """The voxel grid."""
        grid: VoxelGrid = from_dict(VoxelGrid, self.meta["scene"].get("grid", {}), "grid.")
        return grid

    @property
    def settings(self) -> dict[str, Any]:
        """The sweep's settings."""
        settings: dict[str, Any] = self.meta["sweep"]
        return settings

    @property
    def sweep(self) -> Sweep:
        """The sweep's settings, typed."""
        known = {name: value for name, value in self.settings.items() if name in Sweep.__dataclass_fields__}
        sweep: Sweep = from_dict(Sweep, known, "sweep.")
        return sweep

    @property
    def background_names(self) -> list[str]:
        """Names of the background pictures: there is a second one where ambient light is on."""
        return [BACKGROUND] + [BACKGROUND_AMBIENT] * (float(self.meta["scene"].get("ambient", 0.0)) > 0)

    @property
    def target_kind(self) -> str:
        """The kind of target: sheet, sphere or mesh."""
        return str(self.meta["scene"].get("target", {}).get("kind", "mesh"))

    @property
    def reference_radiance(self) -> float:
        """Radiance of the directly lit patch around w1, W/m^2/sr, which sets the scale of the scene's radiance."""
        return float(self.meta["reference_radiance"])

    @property
    def records(self) -> list[PoseRecord]:
        """The poses whose pictures are rendered."""
        return [pose for pose in self.poses if pose.done]

    @property
    def colour_space(self) -> str:
        """Linear colour space of the three channels: Rec.709, Rec.2020 or ACEScg."""
        return str(self.meta.get("colour_space", COLOUR_SPACE))

    @property
    def planned(self) -> int:
        """Number of poses of the sweep."""
        return len(self.poses)

    @property
    def own_backgrounds(self) -> bool:
        """Whether each picture has a background of its own, since more than the target varies."""
        return self.sweep.own_backgrounds

    def background(self) -> Picture:
        """Return the picture without the hidden object, (height, width, 3), ambient light included where it is on.

        Raises
        ------
        NlosError
            The picture is missing, broken, or another one.
        """
        return self._background(self.background_names[-1])

    def background_of(self, record: PoseRecord) -> Picture:
        """Return the background of a pose's picture: its own, or `background` where all have the same.

        Raises
        ------
        NlosError
            The picture is missing, broken, or another one.
        """
        if not self.own_backgrounds:
            return self.background()
        pixels, fault = self.see_background_of(record, self.see(record))
        if pixels is None or fault:
            raise NlosError(f"{self.path / record.background_file}: {fault}; {RENDER_AGAIN}")
        return pixels

    def ambient_background(self) -> Picture | None:
        """Return what ambient light alone adds to the background, (height, width, 3); None where it is off."""
        pictures = list(map(self._background, self.background_names))
        return pictures[1] - pictures[0] if len(pictures) > 1 else None

    def _background(self, name: str) -> Picture:
        seen = self.see_background(name)
        if seen.pixels is None:
            raise NlosError(seen.fault)
        if seen.fault:
            raise NlosError(f"{self.path / name}: {seen.fault}; {RENDER_AGAIN}")
        return seen.pixels

    def picture(self, record: PoseRecord) -> Picture:
        """Return a pose's picture, (height, width, 3), W/m^2/sr.

        Raises
        ------
        NlosError
            The picture is truncated, its pixels are not those that were rendered, or it is of another pose.
        """
        seen = self.see(record)
        if seen.pixels is None:
            raise NlosError(seen.fault)
        if seen.digest != record.pixel_hash:
            raise NlosError(f"{self.path / record.file}: its pixels differ from the hash in {POSES}")
        if seen.fault:
            raise NlosError(f"{self.path / record.file}: {seen.fault}; {RENDER_AGAIN}")
        return seen.pixels

    def write_pose(
        self, pose: PoseRecord, pixels: Picture, *, seconds: float, samples: int, background: Picture | None = None
    ) -> PoseRecord:
        """Write a pose's picture and return its finished record; the manifest is left to `gather`.

        The picture's header holds the hash of its own background, if it has one, which is written first.
        """
        header = {**self._identity(pose), "seconds": f"{seconds:.3f}", "samples": str(samples)}
        if background is not None:
            of_pose = {**self._identity(pose), "background": pose.background_file}
            header["background_hash"] = write_picture(self.path / pose.background_file, background, of_pose)
        digest = write_picture(self.path / pose.file, pixels, header)
        return replace(pose, pixel_hash=digest, seconds=round(seconds, 3), samples=samples)

    def write_background(self, name: str, pixels: Picture, *, seed: int, samples: int) -> None:
        """Write a background picture."""
        header = {**self._common(), "background": name, "seed": str(seed), "samples": str(samples)}
        write_picture(self.path / name, pixels, header)

    def has_background(self, name: str) -> bool:
        """Whether there is a valid background picture of this sweep.

        Raises
        ------
        NlosError
            There is another valid picture: somebody put it in place, and rendering would overwrite it.
        """
        seen = self.see_background(name)
        if seen.pixels is not None and seen.fault:
            raise NlosError(f"{self.path / name}: {seen.fault}; {RENDER_AGAIN}")
        return seen.pixels is not None

    def see_background(self, name: str) -> Seen:
        """Read a background picture on disk, and find how it differs from the expected one."""
        return self._see(self.path / name, {**self._common(), "background": name}, unlike="label")

    def _common(self) -> dict[str, str]:
        return {
            "sweep": self.meta["fingerprint"],
            "engine": str(self.settings["engine"]),
            "reflection_order": str(self.meta["scene"]["reflection_order"]),
            "units": "W/m^2/sr",
            "colour_space": self.colour_space,
        }

    def _identity(self, pose: PoseRecord) -> dict[str, str]:
        return {
            **self._common(),
            "label": pose.label,
            "index": str(pose.index),
            "seed": str(pose.seed),
            "position": vector_text(pose.position),
            "rotation": vector_text(pose.rotation),
            **({"values": values_text(pose.values)} if pose.values else {}),
            **({"others": others_text(pose.others)} if pose.others else {}),
        }

    def see(self, pose: PoseRecord) -> Seen:
        """Read a pose's picture on disk, and find how it differs from the expected one."""
        return self._see(self.path / pose.file, self._identity(pose), unlike="background")

    def see_background_of(self, pose: PoseRecord, picture: Seen) -> tuple[Picture | None, str]:
        """Read the own background of a pose, whose picture was seen; return it, if it is whole, and what is wrong."""
        expected = {**self._identity(pose), "background": pose.background_file}
        seen = self._see(self.path / pose.background_file, expected, unlike="")
        if seen.pixels is not None and not seen.fault and seen.digest != picture.header.get("background_hash"):
            return seen.pixels, f"is not the background that {pose.file} was rendered with"
        return seen.pixels, seen.fault

    def _see(self, path: Path, expected: Mapping[str, str], *, unlike: str) -> Seen:
        """Read and check a picture; ``unlike`` is an attribute that pictures of the other kind have."""
        try:
            pixels, header = read_picture(path)
        except NlosError as error:
            return Seen(None, {}, "", str(error))
        digest = pixel_hash(pixels)
        return Seen(pixels, header, digest, self._unexpected(pixels.shape, header, digest, expected, unlike))

    def _unexpected(
        self, shape: tuple[int, ...], header: Mapping[str, str], digest: str, expected: Mapping[str, str], unlike: str
    ) -> str:
        width, height = self.sweep.resolution
        if "pixel_hash" not in header:
            return "was not rendered by this sweep"
        if digest != header["pixel_hash"]:
            return "its pixels were changed after they were rendered"
        if shape[:2] != (height, width):
            return f"has {shape[1]} x {shape[0]} pixels, not {width} x {height}"
        if unlike in header:
            is_background = unlike == "background"
            actual = f"the background {header[unlike]}" if is_background else f"a picture of voxel {header[unlike]}"
            return f"is {actual}, not {'a picture of a pose' if is_background else 'the background'}"
        for name, value in expected.items():
            if header.get(name) != value and (name in header or self.seal or name not in NEWER_ATTRIBUTES):
                return f"is a picture of {name.replace('_', ' ')} {header.get(name)}, not {value}"
        return ""

    def inspect(self, pose: PoseRecord) -> PoseRecord:
        """Return the pose with the values of its picture on disk: finished if the picture is whole.

        Raises
        ------
        NlosError
            There is a valid picture that is not this pose's: somebody put it in place, and rendering would overwrite
            it.
        """
        seen = self.see(pose)
        if seen.pixels is None:
            return replace(pose, pixel_hash="", seconds=0.0, samples=0)
        if seen.fault:
            raise NlosError(f"{self.path / pose.file}: {seen.fault}; {RENDER_AGAIN}")
        if self.own_backgrounds:
            pixels, fault = self.see_background_of(pose, seen)
            if pixels is None:
                return replace(pose, pixel_hash="", seconds=0.0, samples=0)
            if fault:
                raise NlosError(f"{self.path / pose.background_file}: {fault}; {RENDER_AGAIN}")
        return rendered(pose, seen)

    def gather(self, some: Collection[int] | None = None) -> list[PoseRecord]:
        """Check pictures on disk, bring the manifest up to date, and return the poses still to render.

        Parameters
        ----------
        some : collection of int, optional
            Positions of poses whose pictures are read; other pictures are read only if the manifest does not list
            them yet, so that the last of many shards that end together leaves it complete. By default, all are read.
        """
        known = self.poses if some is None else self._read_again()
        chosen = range(len(known)) if some is None else set(some)
        self.poses = [
            self.inspect(pose) if position in chosen or not pose.done else pose for position, pose in enumerate(known)
        ]
        self.write_manifest()
        return [pose for pose in self.poses if not pose.done]

    def tidy(self) -> None:
        """Remove half-written files that killed runs on this machine left; those of running processes stay."""
        for folder in {(self.path / pose.file).parent for pose in self.poses} | {self.path}:
            for leftover in folder.glob(f".*.{HOST}-*.tmp"):
                pid = leftover.name.rpartition("-")[2].partition(".")[0]
                if not (pid.isdecimal() and is_alive(int(pid))):
                    leftover.unlink(missing_ok=True)

    def write_manifest(self) -> None:
        """Write ``poses.csv`` by temporary name and rename."""
        write_text(self.path / POSES, csv_text(pose_columns(self.poses), (pose.row() for pose in self.poses)))

    def _read_again(self) -> list[PoseRecord]:
        """Read ``poses.csv``, to which other shards may have added the poses that they rendered."""
        poses = read_poses(self.path / POSES)
        if [pose.plan for pose in poses] != [pose.plan for pose in self.poses]:
            raise NlosError(f"{self.path / POSES}: its poses are not those that were planned; put the file back")
        return poses

    def verify(self) -> list[str]:
        """Read everything again; return a sentence per fault (`generator.sets.audit`)."""
        return audit.faults(self)
