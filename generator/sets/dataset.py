"""The data set on disk: write, read, resume, verify.

A data set is a folder::

    dataset.toml        format version, sweep settings, scene, radiometry, software
    scene.blend         the scene as rendered
    background.exr      no hidden object; background-ambient.exr too where ambient light is on
    poses.csv           one row per planned pose; file, hash, seconds and samples once it is rendered
    A/0000.exr ...      one float32 picture per pose, in a folder per voxel

Each picture carries its pose, its pixels' hash and the fingerprint of its sweep in its header, so workers need no
common file: a picture that was put in place by rename is done, and the manifest is gathered from the pictures.

``dataset.toml`` holds hashes of its own values, of the scene, and of what ``poses.csv`` planned
(`generator.sets.seal`), so a set that was changed after it was planned is refused when it is opened.
`generator.sets.audit` re-reads everything.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import json
import math
import os
import re
import socket
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from generator.files import exr
from generator.model.spec import NlosError, Sweep, Vector, VoxelGrid, dump_toml, from_dict, read_toml
from generator.sets import seal

FORMAT = 2
"""1 had no seal."""
MANIFEST = "dataset.toml"
POSES = "poses.csv"
SCENE = "scene.blend"
BACKGROUND = "background.exr"
BACKGROUND_AMBIENT = "background-ambient.exr"
LOG = "log.txt"
PLAN = "plan.toml"

COLOUR_SPACE = "Rec.709"
"""What the three channels mean where nothing else is said: linear, with these primaries."""
_INTEROP = {"Rec.709": "lin_rec709_scene", "Rec.2020": "lin_rec2020_scene", "ACEScg": "lin_ap1_scene"}
"""Names of the Color Interop Forum, which Blender 5 and others write into EXR files as ``colorInteropID``."""

Picture = NDArray[np.float32]

_OURS = "nlos:"
_GREY = ("Y", "V")
"""Channels of grey pictures: OpenEXR's own name, and Blender's."""

_PLANNED = ["index", "voxel", "label", "x", "y", "z", "rx", "ry", "rz", "seed", "file"]
_COLUMNS = [*_PLANNED, "pixel_hash", "seconds", "samples"]
_NEWER = ("background", "colour_space")
"""Attributes of pictures that sets without seal may lack."""


@dataclass(frozen=True)
class PoseRecord:
    """One row of ``poses.csv``.

    Attributes
    ----------
    index : int
        Of the pose within its voxel.
    voxel, label : int, str
        Which voxel the target stands in.
    position : (float, float, float)
        Of the target's origin, metres.
    rotation : (float, float, float)
        Euler angles about x, then y, then z, degrees.
    seed : int
        Of the renderer's noise, 31 bits.
    file : str
        Picture, relative to the data set.
    pixel_hash : str
        Empty until the picture is rendered.
    seconds : float
        Spent on rendering it.
    samples : int
        Camera rays per pixel.
    """

    index: int
    voxel: int
    label: str
    position: Vector
    rotation: Vector
    seed: int
    file: str
    pixel_hash: str = ""
    seconds: float = 0.0
    samples: int = 0

    @property
    def plan(self) -> tuple[Any, ...]:
        """What was planned, without what rendering added."""
        return self.index, self.voxel, self.label, self.position, self.rotation, self.seed, self.file

    @property
    def done(self) -> bool:
        """Whether the picture has been rendered."""
        return bool(self.pixel_hash)

    def row(self) -> list[str]:
        """Return the record as strings, in the manifest's order; floats keep every digit."""
        plan = [self.index, self.voxel, self.label, *self.position, *self.rotation, self.seed, self.file]
        result = [self.pixel_hash, f"{self.seconds:.3f}", self.samples] if self.done else ["", "", ""]
        return [repr(float(v)) if isinstance(v, float) else str(v) for v in plan] + [str(v) for v in result]

    @classmethod
    def from_row(cls, row: Mapping[str, str]) -> PoseRecord:
        """Return the record of a manifest's row; ValueError or KeyError if it is none."""
        if set(row) - set(_COLUMNS):
            raise ValueError("it has more columns than this software writes")
        file = row["file"]
        if Path(file).is_absolute() or ".." in Path(file).parts:
            raise ValueError(f"file {file!r} lies outside the data set")
        x, y, z, rx, ry, rz = (float(row[name]) for name in ("x", "y", "z", "rx", "ry", "rz"))
        if not all(map(math.isfinite, (x, y, z, rx, ry, rz))):
            raise ValueError("its place or rotation is not finite")
        return cls(
            index=int(row["index"]),
            voxel=int(row["voxel"]),
            label=row["label"],
            position=(x, y, z),
            rotation=(rx, ry, rz),
            seed=int(row["seed"]),
            file=file,
            pixel_hash=row["pixel_hash"],
            seconds=float(row["seconds"] or 0.0),
            samples=int(row["samples"] or 0),
        )


HOST = re.sub(r"\W", "_", socket.gethostname())
"""In names of temporary files: process numbers are one machine's, and folders may be shared."""


def is_alive(pid: int) -> bool:
    """Whether a process of that number runs on this machine; where that cannot be told, it is said to."""
    if os.name == "nt":  # where the question would end it
        return True
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        pass
    return True


def pixel_hash(pixels: Picture) -> str:
    """Return the SHA-256 of a picture's shape and little-endian float32 pixels."""
    data = np.ascontiguousarray(pixels, dtype="<f4")
    return hashlib.sha256(repr(data.shape).encode() + data.tobytes()).hexdigest()


def plan_hash(poses: Iterable[PoseRecord]) -> str:
    """Return the SHA-256 of what ``poses.csv`` says was planned: all its columns up to ``file``."""
    digest = hashlib.sha256()
    for pose in poses:
        digest.update((",".join(pose.row()[: len(_PLANNED)]) + "\n").encode())
    return digest.hexdigest()


def fingerprint(settings: Mapping[str, Any]) -> str:
    """Return a short hash of settings: what two sweeps that render the same picture have in common."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]


def scene_hash(path: Path) -> str:
    """Return the SHA-256 of a scene file.

    Raises
    ------
    NlosError
        It cannot be read.
    """
    try:
        return file_hash(path)
    except OSError as error:
        raise NlosError(f"{path}: no such scene file ({error.strerror})") from None


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file, read piece by piece."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Give a temporary name beside ``path``; on success flush it to disk and rename it into place.

    Raises
    ------
    NlosError
        The file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{HOST}-{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise NlosError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        with contextlib.suppress(OSError):  # gone with its folder, or on a disk that takes no changes any more
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file by temporary name and rename."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")
    # A picture whose rename is lost with the power is rendered again; a manifest is what says that there is a set.
    with contextlib.suppress(OSError):  # not every system opens a folder
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as comma-separated text."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def write_picture(path: Path, pixels: Picture, header: Mapping[str, str]) -> str:
    """Write a float32 EXR, ZIP-compressed, by temporary name and rename.

    Parameters
    ----------
    path : Path
    pixels : ndarray of shape (height, width, 3), float32
        Scene-linear radiance, W/m^2/sr; row 0 is the top.
    header : mapping of str to str
        Attributes; each is stored as ``nlos:NAME``.

    Returns
    -------
    str
        The pixels' hash, stored in the header too.

    Raises
    ------
    NlosError
        The pixels have another shape or are not finite, or the file cannot be written.
    """
    if pixels.ndim != 3 or pixels.shape[2] != 3:
        raise NlosError(f"{path}: a picture must have shape (height, width, 3), not {pixels.shape}")
    if not np.isfinite(pixels).all():
        raise NlosError(f"{path}: the picture holds NaN or infinite pixels")
    digest = pixel_hash(pixels)
    attributes = {f"{_OURS}{key}": value for key, value in {**header, "pixel_hash": digest}.items()}
    if header.get("colour_space", COLOUR_SPACE) != COLOUR_SPACE:
        attributes[exr.SPACE] = _INTEROP.get(header["colour_space"], header["colour_space"])
    with atomic(path) as temporary:
        exr.write(temporary, {name: pixels[..., i] for i, name in enumerate("RGB")}, attributes)
    return digest


def read_picture(path: Path) -> tuple[Picture, dict[str, str]]:
    """Read an EXR.

    Parameters
    ----------
    path : Path
        A picture with channels R, G, B; or grey, as Y or V, which stands for all three.

    Returns
    -------
    pixels : ndarray of shape (height, width, 3), float32
        Scene-linear radiance, W/m^2/sr.
    header : dict of str to str
        The attributes that `write_picture` stored; ``colour_space`` too where the file says by other means that its
        channels are not `COLOUR_SPACE`.

    Raises
    ------
    NlosError
        The file is missing, truncated or no such picture, cropped, or holds other things than radiance.
    """
    path = Path(path)
    if not path.is_file():
        raise NlosError(f"{path}: no such picture")
    try:
        channels, attributes = exr.read(path)
    except exr.ExrError as error:
        raise NlosError(f"{path}: is not a whole EXR picture ({error})") from None
    except OSError as error:
        raise NlosError(f"{path}: cannot be read ({error.strerror})") from None
    header = {name.removeprefix(_OURS): value for name, value in attributes.items() if name.startswith(_OURS)}
    names = {interop: name for name, interop in _INTEROP.items()}
    if (other := names.get(attributes.get(exr.SPACE, ""), attributes.get(exr.SPACE, COLOUR_SPACE))) != COLOUR_SPACE:
        header.setdefault("colour_space", other)
    missing = [name for name in "RGB" if name not in channels]
    grey = [name for name in _GREY if name in channels]
    if len(missing) == 3 and len(grey) == 1 and not {"RY", "BY"} & set(channels):  # those make a colour of Y
        return np.repeat(channels[grey[0]][..., None], 3, axis=2), header
    if missing:
        raise NlosError(
            f"{path}: is no picture of radiance: it holds {', '.join(sorted(channels))}, and lacks "
            f"{', '.join(missing)} (or Y alone, for grey)"
        )
    return np.stack([channels[name] for name in "RGB"], axis=-1), header


class Readable(Protocol):
    """What pictures are read from: `Dataset`, or `generator.sets.simulated.Simulated`."""

    @property
    def path(self) -> Path:
        """Of the set."""

    @property
    def meta(self) -> dict[str, Any]:
        """All of its manifest."""

    @property
    def settings(self) -> dict[str, Any]:
        """What it was made with."""

    @property
    def grid(self) -> VoxelGrid:
        """The voxel grid."""

    @property
    def target_kind(self) -> str:
        """The kind of target: sheet, sphere or mesh."""

    @property
    def reference_radiance(self) -> float:
        """Radiance of the directly lit patch around w1, W/m^2/sr."""

    @property
    def colour_space(self) -> str:
        """The linear space that the three channels are of: Rec.709, Rec.2020 or ACEScg."""

    @property
    def planned(self) -> int:
        """How many pictures it has when it is finished."""

    @property
    def records(self) -> list[PoseRecord]:
        """The poses whose pictures are there."""

    def background(self) -> Picture:
        """Return the picture without the hidden object, (height, width, 3), W/m^2/sr."""

    def ambient_background(self) -> Picture | None:
        """Return what ambient light alone adds to it, or None."""

    def picture(self, record: PoseRecord) -> Picture:
        """Return a pose's picture, (height, width, 3), W/m^2/sr."""


class Seen(NamedTuple):
    """A picture on disk: its pixels' own hash, and in what it is not the expected one; none if it is not whole."""

    pixels: Picture | None
    header: dict[str, str]
    digest: str
    fault: str


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
        """Whether a data set stands at that path, finished or not."""
        return (path / MANIFEST).is_file()

    @classmethod
    def open(cls, path: Path, *, check: bool = True) -> Dataset:
        """Open a data set.

        Parameters
        ----------
        path : Path
        check : bool
            Refuse one that was changed after it was planned (`audit.changed`). Pictures are looked at when they are
            read.

        Raises
        ------
        NlosError
            There is none, its format is newer than this software, its manifest is broken, or it was changed.
        """
        path = Path(path)
        if not cls.exists(path):
            raise NlosError(f"{path}: is not a data set (it holds no {MANIFEST})")
        meta = read_toml(path / MANIFEST)
        version = meta.get("format")
        if not isinstance(version, int):
            raise NlosError(f"{path / MANIFEST}: lacks the field 'format'")
        if version > FORMAT:
            raise NlosError(
                f"{path}: has data set format {version}; this software reads up to {FORMAT}, so update it"
            )
        try:
            check_meta(meta)
            dataset = cls(path, meta, _read_poses(path / POSES))
            dataset.sweep, dataset.grid  # noqa: B018 (refuse what cannot be one)
        except NlosError as error:
            raise NlosError(f"{path / MANIFEST}: {error}") from None
        if check:
            dataset.refuse_changed()
        return dataset

    @classmethod
    def create(cls, path: Path, meta: Mapping[str, Any], poses: Sequence[PoseRecord]) -> Dataset:
        """Put a new data set in place, with no picture yet; ``dataset.toml`` comes last and makes it one.

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
        check_free(path)
        full = {"format": FORMAT, "fingerprint": fingerprint(meta["sweep"]), **meta}
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
        found: dict[str, str] = self.meta.get(seal.SEAL, {})
        return found

    def refuse_changed(self) -> None:
        """Raise NlosError, naming the first fault, if the set was changed after it was planned (`audit.changed`)."""
        from generator.sets import audit  # which reads data sets

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
        """The background pictures this set has: a second one where ambient light is on."""
        return [BACKGROUND] + [BACKGROUND_AMBIENT] * (float(self.meta["scene"].get("ambient", 0.0)) > 0)

    @property
    def target_kind(self) -> str:
        """The kind of target: sheet, sphere or mesh."""
        return str(self.meta["scene"].get("target", {}).get("kind", "mesh"))

    @property
    def reference_radiance(self) -> float:
        """Radiance of the directly lit patch around w1, W/m^2/sr: the scene's own scale of light."""
        return float(self.meta["reference_radiance"])

    @property
    def records(self) -> list[PoseRecord]:
        """The poses whose pictures are rendered."""
        return [pose for pose in self.poses if pose.done]

    @property
    def colour_space(self) -> str:
        """The linear space that the three channels are of: Rec.709, Rec.2020 or ACEScg."""
        return str(self.meta.get("colour_space", COLOUR_SPACE))

    @property
    def planned(self) -> int:
        """How many poses the sweep has."""
        return len(self.poses)

    def background(self) -> Picture:
        """Return the picture without the hidden object, (height, width, 3), ambient light included where it is on.

        Raises
        ------
        NlosError
            It is missing, broken, or another picture.
        """
        return self._background(self.background_names[-1])

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
            It is truncated, its pixels are not those that were rendered, or it is of another pose.
        """
        seen = self.see(record)
        if seen.pixels is None:
            raise NlosError(seen.fault)
        if seen.digest != record.pixel_hash:
            raise NlosError(f"{self.path / record.file}: its pixels differ from the hash in {POSES}")
        if seen.fault:
            raise NlosError(f"{self.path / record.file}: {seen.fault}; {RENDER_AGAIN}")
        return seen.pixels

    def write_pose(self, pose: PoseRecord, pixels: Picture, *, seconds: float, samples: int) -> PoseRecord:
        """Write a pose's picture and return its finished record; the manifest is left to `gather`."""
        header = {**self._identity(pose), "seconds": f"{seconds:.3f}", "samples": str(samples)}
        digest = write_picture(self.path / pose.file, pixels, header)
        return replace(pose, pixel_hash=digest, seconds=round(seconds, 3), samples=samples)

    def write_background(self, name: str, pixels: Picture, *, seed: int, samples: int) -> None:
        """Write a background picture."""
        header = {**self._common(), "background": name, "seed": str(seed), "samples": str(samples)}
        write_picture(self.path / name, pixels, header)

    def has_background(self, name: str) -> bool:
        """Whether a sound background picture of this sweep is there.

        Raises
        ------
        NlosError
            Another sound picture is there: somebody put it in place, and rendering would overwrite it.
        """
        seen = self.see_background(name)
        if seen.pixels is not None and seen.fault:
            raise NlosError(f"{self.path / name}: {seen.fault}; {RENDER_AGAIN}")
        return seen.pixels is not None

    def see_background(self, name: str) -> Seen:
        """Look at a background picture on disk, and in what it is not that background."""
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
            "position": _words(pose.position),
            "rotation": _words(pose.rotation),
        }

    def see(self, pose: PoseRecord) -> Seen:
        """Look at a pose's picture on disk, and in what it is not that pose's."""
        return self._see(self.path / pose.file, self._identity(pose), unlike="background")

    def _see(self, path: Path, expected: Mapping[str, str], *, unlike: str) -> Seen:
        """Look at a picture; ``unlike`` is an attribute that pictures of the other kind have."""
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
            mine = f"the background {header[unlike]}" if is_background else f"a picture of voxel {header[unlike]}"
            return f"is {mine}, not {'a picture of a pose' if is_background else 'the background'}"
        for name, value in expected.items():
            if header.get(name) != value and (name in header or self.seal or name not in _NEWER):
                return f"is a picture of {name.replace('_', ' ')} {header.get(name)}, not {value}"
        return ""

    def inspect(self, pose: PoseRecord) -> PoseRecord:
        """Return the pose as its picture on disk tells it: finished if the picture is whole.

        Raises
        ------
        NlosError
            A sound picture is there that is not this pose's: somebody put it in place, and rendering would overwrite
            it.
        """
        seen = self.see(pose)
        if seen.pixels is None:
            return replace(pose, pixel_hash="", seconds=0.0, samples=0)
        if seen.fault:
            raise NlosError(f"{self.path / pose.file}: {seen.fault}; {RENDER_AGAIN}")
        return rendered(pose, seen)

    def gather(self, some: Collection[int] | None = None) -> list[PoseRecord]:
        """Look at pictures on disk, bring the manifest up to date, and return the poses still to render.

        Parameters
        ----------
        some : collection of int, optional
            Positions of poses whose pictures are looked at; of the others only those that the manifest does not know
            yet, so that of many shares that end together the last leaves it whole. Without it, all are.
        """
        known = self.poses if some is None else self._read_again()
        look = range(len(known)) if some is None else set(some)
        self.poses = [
            self.inspect(pose) if position in look or not pose.done else pose for position, pose in enumerate(known)
        ]
        self.write_manifest()
        return [pose for pose in self.poses if not pose.done]

    def tidy(self) -> None:
        """Clear away what killed runs on this machine left half-written; what a process is at work on stays."""
        for folder in {(self.path / pose.file).parent for pose in self.poses} | {self.path}:
            for left in folder.glob(f".*.{HOST}-*.tmp"):
                number = left.name.rpartition("-")[2].partition(".")[0]
                if not (number.isdecimal() and is_alive(int(number))):
                    left.unlink(missing_ok=True)

    def write_manifest(self) -> None:
        """Write ``poses.csv`` by temporary name and rename."""
        write_text(self.path / POSES, csv_text(_COLUMNS, (pose.row() for pose in self.poses)))

    def _read_again(self) -> list[PoseRecord]:
        """Read ``poses.csv``, to which other shares may have added what they rendered."""
        found = _read_poses(self.path / POSES)
        if [pose.plan for pose in found] != [pose.plan for pose in self.poses]:
            raise NlosError(f"{self.path / POSES}: its poses are not those that were planned; put the file back")
        return found

    def verify(self) -> list[str]:
        """Re-read everything; return a sentence per fault (`generator.sets.audit`)."""
        from generator.sets import audit  # which reads data sets

        return audit.faults(self)


def check_colours(path: Path, own: str, wanted: str, what: str) -> None:
    """Raise NlosError unless channels of one linear space mean the same as those of another.

    Parameters
    ----------
    path : Path
        Of the picture or the set whose channels are of the space ``own``.
    own, wanted : str
    what : str
        Whose channels are of the space ``wanted``.
    """
    if own != wanted:
        raise NlosError(
            f"{path}: its three channels are linear {own}, and those of {what} linear {wanted}, so they mean other "
            "light; render both with one working space (Blender's scene properties)"
        )


def as_read(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest's values as they are read back: TOML knows no tuples."""
    return tomllib.loads(dump_toml(meta))


RENDER_AGAIN = "take it away and run the sweep again to render it"


def rendered(pose: PoseRecord, seen: Seen) -> PoseRecord:
    """Return a pose as its picture tells it."""
    try:
        seconds, samples = float(seen.header.get("seconds", "0")), int(seen.header.get("samples", "0"))
    except ValueError:
        seconds, samples = 0.0, 0
    return replace(pose, pixel_hash=seen.digest, seconds=seconds, samples=samples)


def _words(vector: Vector) -> str:
    return " ".join(repr(float(value)) for value in vector)


_TABLES = {"sweep": dict, "scene": dict, "reference_radiance": float, "fingerprint": str}
_IN_SCENE = {"grid": (dict,), "target": (dict,), "ambient": (int, float), "reflection_order": (int,)}
_OPTIONAL = dict.fromkeys(("software", "links", "start_check"), dict) | dict.fromkeys(
    ("engine_reasons", "extra_objects", "replaced", "forced"), list
)


def check_meta(meta: Mapping[str, Any], **needed: type) -> None:
    """Raise NlosError unless a manifest has what every set's has, and some fields more."""
    for name, kind in {**_TABLES, **needed}.items():
        if not isinstance(meta.get(name), kind):
            raise NlosError(f"lacks the field '{name}'")
    for name, kind in _OPTIONAL.items():
        if name in meta and not isinstance(meta[name], kind):
            raise NlosError(f"{name}: must be a {'table' if kind is dict else 'list'}")
    scene = meta["scene"]
    for name, some in _IN_SCENE.items():
        if name in scene and not isinstance(scene[name], some):
            raise NlosError(f"scene.{name}: {scene[name]!r} cannot be")
    if "reflection_order" not in scene:
        raise NlosError("lacks the field 'scene.reflection_order'")
    if not isinstance(meta["sweep"].get("engine"), str):
        raise NlosError("lacks the field 'sweep.engine'")
    if not 0.0 <= meta["reference_radiance"] < math.inf:
        raise NlosError(f"reference_radiance: {meta['reference_radiance']} must be 0 or more")


def check_free(path: Path) -> None:
    """Raise NlosError unless a data set can be created at that path."""
    if path.exists() and not path.is_dir():
        raise NlosError(f"{path}: is a file; name a folder for the data set")
    leftovers = {POSES, SCENE}
    foreign = (
        [p.name for p in path.iterdir() if p.name not in leftovers and not p.name.endswith(".tmp")]
        if path.exists()
        else []
    )
    if foreign:
        raise NlosError(f"{path}: holds other files ({', '.join(sorted(foreign)[:3])}); name a new or empty folder")
    parent = next(p for p in [path, *path.absolute().parents] if p.exists())
    if not os.access(parent, os.W_OK | os.X_OK):
        raise NlosError(f"{path}: cannot be written (no permission in {parent})")


def _read_poses(path: Path) -> list[PoseRecord]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return list(_parse_poses(csv.DictReader(file), path))
    except OSError as error:
        raise NlosError(f"{path}: cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise NlosError(f"{path}: is not a CSV file ({error})") from None


def _parse_poses(rows: Iterable[Mapping[str, str]], path: Path) -> Iterator[PoseRecord]:
    for line, row in enumerate(rows, start=2):
        try:
            yield PoseRecord.from_row(row)
        except (KeyError, ValueError, TypeError) as error:
            raise NlosError(f"{path}, line {line}: is not a pose ({error})") from None
