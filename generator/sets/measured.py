"""A set of measured pictures: photographs of a real wall, or pictures that another program made.

Such a set is a folder::

    dataset.toml      format version, scene, how the pictures came about
    poses.csv         a row per picture: its file, and what is known of where the object stood
    background.exr    without the hidden object
    ...exr            the pictures, named in poses.csv

It can be written by hand: nothing in it has to be computed, and ``docs/reference/files.md`` says what each key is.
`MeasuredSet.create` adds hashes, so that a later change is noticed.
"""

from __future__ import annotations

import csv
import hashlib
import math
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from generator.files.pictures import COLOUR_SPACE, Picture, pixel_hash, read_picture, write_picture
from generator.files.toml import dump_toml, from_dict, read_toml
from generator.files.writing import csv_text, fingerprint, write_text
from generator.model.arrays import Vector
from generator.model.errors import NlosError, instead
from generator.model.grid import VoxelGrid
from generator.model.poses import PoseRecord
from generator.sets import audit, seal
from generator.sets.manifest import BACKGROUND, LOG, MANIFEST, POSES, SCENE, check_no_set, plan_hash
from generator.sets.readable import PictureSet, as_read

FORMAT = 4
"""Format of a manifest with the table `MEASURED`; older versions, which know no such table, refuse it."""
MEASURED = "measured"
"""Table of the manifest that tells measured sets from rendered ones."""
ENGINE = "measured"
_UNKNOWN: Vector = (math.nan, math.nan, math.nan)
_COLUMNS = ("file", "label", "x", "y", "z", "rx", "ry", "rz", "pixel_hash")
_MOST = 1_000_000
"""Pictures in a set."""
_LONGEST = 2**28
"""Bytes of ``poses.csv``."""


def has_own_noise(dataset: PictureSet) -> bool:
    """Whether a set's pictures were taken by a camera, so that no noise may be added to them."""
    table = dataset.meta.get(MEASURED)
    return isinstance(table, Mapping) and bool(table.get("noise"))


class MeasuredSet:
    """A set of measured pictures on disk, read like any other (`generator.sets.readable.PictureSet`).

    Attributes
    ----------
    path : Path
    meta : dict
        All of ``dataset.toml``, and what other sets have besides: ``fingerprint`` and ``sweep``.
    records : list of PoseRecord
        The pictures in their order. Where no voxel is known, it is -1 and the label empty; where no position is
        known, it is NaN.
    """

    def __init__(self, path: Path, meta: dict[str, Any], records: list[PoseRecord]) -> None:
        self.path = path
        self.meta = meta
        self.records = records

    @classmethod
    def exists(cls, path: Path) -> bool:
        """Whether there is a data set of measured pictures at that path."""
        return (Path(path) / MANIFEST).is_file() and MEASURED in read_toml(Path(path) / MANIFEST)

    @classmethod
    def open(cls, path: Path, *, check: bool = True) -> MeasuredSet:
        """Open a set.

        Parameters
        ----------
        path : Path
        check : bool
            Refuse a set that was changed after it was written, as far as it has hashes (`changed`).

        Raises
        ------
        NlosError
            There is no such set, its format is newer than this software, or manifest or table are not valid.
        """
        path = Path(path)
        if not cls.exists(path):
            raise NlosError(f"{path}: is not a set of measured pictures (its {MANIFEST} has no table '{MEASURED}')")
        meta = read_toml(path / MANIFEST)
        version = meta.get("format")
        if not isinstance(version, int):
            raise NlosError(f"{path / MANIFEST}: lacks the field 'format', which is {FORMAT}")
        if version > FORMAT:
            raise NlosError(
                f"{path}: has data set format {version}; this software reads up to {FORMAT}, so update it"
            )
        try:
            _check(meta)
            made = cls(path, meta, [])
            made.grid_or_none  # noqa: B018 (raises if it is not valid)
        except NlosError as error:
            raise NlosError(f"{path / MANIFEST}: {error}") from None
        made.records = list(_rows(path / POSES, made.grid_or_none))
        meta.setdefault("sweep", {"engine": ENGINE, "frames": len(made.records)})
        meta.setdefault("fingerprint", fingerprint({"poses": plan_hash(made.records)}))
        if check and (fault := next(made.changed(), "")):
            raise NlosError(fault)
        return made

    @classmethod
    def create(
        cls,
        path: Path,
        meta: Mapping[str, Any],
        pictures: Iterator[tuple[PoseRecord, Picture]],
        background: Picture | None,
        files: Mapping[str, Callable[[Path], None]],
    ) -> MeasuredSet:
        """Write a new set: all of it, or nothing.

        Parameters
        ----------
        path : Path
            A new or empty folder.
        meta : mapping
            ``measured`` (table); ``scene`` (table), ``sensor`` (table), ``reference_radiance`` where they are known.
        pictures : iterator of (PoseRecord, ndarray of shape (height, width, 3))
            W/m^2/sr.
        background : ndarray of shape (height, width, 3), optional
        files : mapping of str to callable
            Further files of the set by name, each with a function that writes it.

        Raises
        ------
        NlosError
            The folder holds something else or cannot be written, or a picture cannot be made.
        """
        check_no_set(path)
        path = Path(path)
        path.absolute().parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.absolute().parent, prefix=f".{path.name}.") as temporary:
            folder = Path(temporary, "set")
            records = []
            for record, pixels in pictures:
                records.append(replace(record, pixel_hash=write_picture(folder / record.file, pixels, {})))
            hashes = {"poses": _table_hash(records)}
            if background is not None:
                hashes["background"] = write_picture(folder / BACKGROUND, background, {})
            for name, write in files.items():
                write(folder / name)
            plain = as_read({"format": FORMAT, **meta})
            write_text(folder / POSES, _table(records))
            write_text(folder / MANIFEST, dump_toml(seal.sealed(plain, **hashes)))
            try:
                if path.exists():
                    path.rmdir()
                os.rename(folder, path)
            except OSError as error:
                raise NlosError(f"{path}: cannot be written ({error.strerror})") from None
        return cls.open(path)

    @property
    def seal(self) -> dict[str, str]:
        """Hashes of what was written; empty in sets that were written by hand."""
        hashes: dict[str, str] = self.meta.get(seal.SEAL, {})
        return hashes

    @cached_property
    def grid_or_none(self) -> VoxelGrid | None:
        """The voxel grid; None if the set names no scene."""
        scene = self.meta.get("scene", {})
        grid: VoxelGrid | None = from_dict(VoxelGrid, scene["grid"], "scene.grid.") if "grid" in scene else None
        return grid

    @property
    def grid(self) -> VoxelGrid:
        """The voxel grid; NlosError if the set names no scene."""
        if self.grid_or_none is None:
            raise NlosError(f"{self.path}: names no scene, so its voxels are not known; import it with --like")
        return self.grid_or_none

    @property
    def settings(self) -> dict[str, Any]:
        """Stands for the settings of a sweep: the engine `ENGINE`, and the number of frames."""
        settings: dict[str, Any] = self.meta["sweep"]
        return settings

    @property
    def target_kind(self) -> str:
        """The kind of target: sheet, sphere or mesh."""
        return str(self.meta.get("scene", {}).get("target", {}).get("kind", "mesh"))

    @property
    def reference_radiance(self) -> float:
        """Radiance of the directly lit patch around w1, W/m^2/sr."""
        return float(self.meta.get("reference_radiance", 1.0))

    @property
    def colour_space(self) -> str:
        """Linear colour space of the three channels."""
        return str(self.meta.get("colour_space", COLOUR_SPACE))

    @property
    def planned(self) -> int:
        """Number of pictures."""
        return len(self.records)

    @property
    def poses(self) -> list[PoseRecord]:
        """The pictures; all are there."""
        return self.records

    @property
    def own_backgrounds(self) -> bool:
        """Whether each picture has a background of its own: never."""
        return False

    def background(self) -> Picture:
        """Return the picture without the hidden object, (height, width, 3), W/m^2/sr.

        Raises
        ------
        NlosError
            There is none, or it is broken or was changed.
        """
        if not self.has_background:
            raise NlosError(f"{self.path}: holds no picture of the empty scene ({BACKGROUND}); import one with it")
        return self._fitting(BACKGROUND, self.seal.get("background", ""))

    @property
    def has_background(self) -> bool:
        """Whether there is a picture without the hidden object."""
        return (self.path / BACKGROUND).is_file()

    def background_of(self, record: PoseRecord) -> Picture:
        """Return `background`, which is the same for all."""
        return self.background()

    def ambient_background(self) -> Picture | None:
        """Return None: what ambient light adds is not known apart."""
        return None

    def picture(self, record: PoseRecord) -> Picture:
        """Return a picture, (height, width, 3), W/m^2/sr.

        Raises
        ------
        NlosError
            It is missing or broken, was changed, or has another size than the first.
        """
        return self._fitting(record.file, record.pixel_hash)

    def _fitting(self, name: str, digest: str) -> Picture:
        """Return a picture of the first one's size."""
        pixels = self._read(name, digest)
        if pixels.shape != self._shape:
            (height, width), (wanted_height, wanted_width) = pixels.shape[:2], self._shape[:2]
            raise NlosError(
                f"{self.path / name}: has {width} x {height} pixels, and the set's first picture "
                f"{wanted_width} x {wanted_height}"
            )
        return pixels

    @cached_property
    def _shape(self) -> tuple[int, ...]:
        return read_picture(self.path / self.records[0].file)[0].shape

    def _read(self, name: str, digest: str) -> Picture:
        pixels, _ = read_picture(self.path / name)
        if digest and pixel_hash(pixels) != digest:
            raise NlosError(f"{self.path / name}: its pixels were changed after the set was written")
        return pixels

    def changed(self) -> Iterator[str]:
        """Yield a sentence for each change of manifest and table after the set was written, as far as hashes tell."""
        kept = {name: value for name, value in self.meta.items() if name not in ("sweep", "fingerprint")}
        if words := seal.broken(kept):
            yield f"{self.path / MANIFEST}: {words.replace('planned', 'written')}; put the file back as it was"
        elif self.seal and self.seal.get("poses") != _table_hash(self.records):
            yield f"{self.path / POSES}: was changed after the set was written; put the file back as it was"

    def unchecked(self) -> str:
        """Return what cannot be checked in a set without hashes; empty if everything can."""
        return "" if self.seal else f"{self.path / MANIFEST}: has no hashes, so that a change cannot be seen"

    def verify(self) -> list[str]:
        """Read everything again; return a sentence per fault."""
        faults = list(self.changed())
        for record in self.records:
            try:
                self.picture(record)
            except NlosError as error:
                faults.append(str(error))
        if self.has_background or "background" in self.seal:
            try:
                self.background()
            except NlosError as error:
                faults.append(str(error))
        known = {MANIFEST, POSES, SCENE, LOG, BACKGROUND, *(record.file for record in self.records)}
        known |= set(self.meta[MEASURED].get("files", []))
        return [*faults, *audit.foreign(self.path, known)]


def _check(meta: Mapping[str, Any]) -> None:
    table = meta[MEASURED]
    if not isinstance(table, Mapping):
        raise NlosError(f"{MEASURED}: must be a table")
    if not isinstance(table.get("noise"), bool):
        raise NlosError(
            f"{MEASURED}.noise: must be true, if a camera took the pictures, or false, if they have no noise and a "
            "sensor's is to be added"
        )
    if not isinstance(table.get("files", []), list):
        raise NlosError(f"{MEASURED}.files: must be a list of file names")
    for name in ("scene", "sensor"):
        if not isinstance(meta.get(name, {}), Mapping):
            raise NlosError(f"{name}: must be a table")
    if not isinstance(meta.get("scene", {}).get("target", {}), Mapping):
        raise NlosError("scene.target: must be a table")
    radiance = meta.get("reference_radiance", 1.0)
    if isinstance(radiance, bool) or not isinstance(radiance, int | float) or not 0.0 <= radiance < math.inf:
        raise NlosError(f"reference_radiance: {radiance!r} must be a number of 0 or more")
    if not isinstance(meta.get("colour_space", ""), str):
        raise NlosError("colour_space: must be a text")


def _rows(path: Path, grid: VoxelGrid | None) -> Iterator[PoseRecord]:
    """Yield the records of a table of pictures."""
    try:
        if path.stat().st_size > _LONGEST:
            raise NlosError(f"{path}: has {path.stat().st_size} bytes, more than {_LONGEST}")
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.DictReader(file)
            if "file" not in (rows.fieldnames or ()):
                raise NlosError(f"{path}: lacks the column 'file'")
            for name in rows.fieldnames or ():
                if name not in _COLUMNS:
                    raise NlosError(f"{path}: has a column {name!r}; {instead(str(name), _COLUMNS)}")
            count = 0
            for count, row in enumerate(rows, start=1):
                if count > _MOST:
                    raise NlosError(f"{path}: has more than {_MOST} pictures")
                try:
                    yield record_of(row, count - 1, grid)
                except NlosError as error:
                    raise NlosError(f"{path}, line {count + 1}: {error}") from None
            if not count:
                raise NlosError(f"{path}: names no picture")
    except OSError as error:
        raise NlosError(f"{path}: cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise NlosError(f"{path}: is not a CSV file ({error})") from None


def record_of(row: Mapping[str, str | None], index: int, grid: VoxelGrid | None) -> PoseRecord:
    """Return what a table's row says of a picture: ``file``, and ``label``, ``x`` ... ``rz`` where they are known.

    Parameters
    ----------
    row : mapping of str to str
    index : int
        Number of the picture.
    grid : VoxelGrid, optional
        Where labels and positions must belong.

    Raises
    ------
    NlosError
        A value is not valid, or label and position contradict one another.
    """
    if None in row:
        raise NlosError("has more values than there are columns")
    file = (row.get("file") or "").strip()
    if not file or Path(file).is_absolute() or ".." in Path(file).parts:
        raise NlosError(f"file {file!r}: must name a file in the set's folder")
    position, rotation = _vector(row, ("x", "y", "z")), _vector(row, ("rx", "ry", "rz"))
    label, voxel = (row.get("label") or "").strip(), -1
    if (label or position) and grid is None:
        raise NlosError("says where the object stood, which means nothing without a scene (table 'scene')")
    if grid is not None and position:
        voxel = grid.voxel(np.array(position))
        if not all(a <= x <= b for a, x, b in zip(grid.lo, position, grid.hi, strict=True)):
            raise NlosError(f"position {position}: lies outside the hidden volume, from {grid.lo} to {grid.hi}")
        if label and label != grid.labels[voxel]:
            raise NlosError(f"label {label}: the position {position} lies in voxel {grid.labels[voxel]}")
        label = grid.labels[voxel]
    elif grid is not None and label:
        if label not in grid.labels:
            raise NlosError(f"label {label!r}: there is no such voxel; {instead(label, grid.labels)}")
        voxel = grid.labels.index(label)
    place = position or _UNKNOWN, rotation or ((0.0, 0.0, 0.0) if position else _UNKNOWN)
    digest = (row.get("pixel_hash") or "").strip()
    return PoseRecord(index, voxel, label, *place, 0, file=file, pixel_hash=digest)


def _vector(row: Mapping[str, str | None], names: Sequence[str]) -> Vector | None:
    """Return three values of a row; None if they are all empty."""
    texts = [(row.get(name) or "").strip() for name in names]
    if not any(texts):
        return None
    try:
        x, y, z = map(float, texts)
    except ValueError:
        raise NlosError(f"{', '.join(names)}: {texts} must be three numbers, or all empty") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise NlosError(f"{', '.join(names)}: {texts} must be finite")
    return x, y, z


def _table(records: Sequence[PoseRecord]) -> str:
    def text(vector: Vector) -> list[str]:
        return [repr(float(value)) if math.isfinite(value) else "" for value in vector]

    rows = ([r.file, r.label, *text(r.position), *text(r.rotation), r.pixel_hash] for r in records)
    return csv_text(_COLUMNS, rows)


def _table_hash(records: Sequence[PoseRecord]) -> str:
    return hashlib.sha256(_table(records).encode()).hexdigest()
