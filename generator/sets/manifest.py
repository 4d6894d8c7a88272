"""Names of the files in a data set's folder, and the checks of its tables when they are read."""

from __future__ import annotations

import csv
import hashlib
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from generator.files.writing import file_hash
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord

FORMAT = 3
"""Format 1 had no seal; up to format 2, nothing varied from pose to pose and there was one object. Such sets are
still written as 2, so that older versions read them."""


MANIFEST = "dataset.toml"


POSES = "poses.csv"


SCENE = "scene.blend"


BACKGROUND = "background.exr"


BACKGROUND_AMBIENT = "background-ambient.exr"


LOG = "log.txt"


PLAN = "plan.toml"


NEWER_ATTRIBUTES = ("background", "colour_space")
"""Attributes that pictures of sets without seal may lack."""


def plan_hash(poses: Iterable[PoseRecord]) -> str:
    """Return the SHA-256 of what ``poses.csv`` says was planned: all its columns before ``pixel_hash``."""
    digest = hashlib.sha256()
    for pose in poses:
        digest.update((",".join(pose.planned_row) + "\n").encode())
    return digest.hexdigest()


def scene_hash(path: Path) -> str:
    """Return the SHA-256 of a scene file.

    Raises
    ------
    NlosError
        The file cannot be read.
    """
    try:
        return file_hash(path)
    except OSError as error:
        raise NlosError(f"{path}: no such scene file ({error.strerror})") from None


_TABLES = {"sweep": dict, "scene": dict, "reference_radiance": float, "fingerprint": str}


_IN_SCENE = {"grid": (dict,), "target": (dict,), "ambient": (int, float), "reflection_order": (int,)}


_OPTIONAL = dict.fromkeys(("software", "links", "start_check", "light_check", "target_file"), dict) | dict.fromkeys(
    ("engine_reasons", "extra_objects", "replaced", "forced"), list
)


def check_meta(meta: Mapping[str, Any], **needed: type) -> None:
    """Raise NlosError unless a manifest has the fields that every set needs, and those of ``needed``."""
    for name, kind in {**_TABLES, **needed}.items():
        if not isinstance(meta.get(name), kind):
            raise NlosError(f"lacks the field '{name}'")
    for name, kind in _OPTIONAL.items():
        if name in meta and not isinstance(meta[name], kind):
            raise NlosError(f"{name}: must be a {'table' if kind is dict else 'list'}")
    scene = meta["scene"]
    for name, kinds in _IN_SCENE.items():
        if name in scene and not isinstance(scene[name], kinds):
            raise NlosError(f"scene.{name}: {scene[name]!r} cannot be")
    if "reflection_order" not in scene:
        raise NlosError("lacks the field 'scene.reflection_order'")
    if not isinstance(meta["sweep"].get("engine"), str):
        raise NlosError("lacks the field 'sweep.engine'")
    if not 0.0 <= meta["reference_radiance"] < math.inf:
        raise NlosError(f"reference_radiance: {meta['reference_radiance']} must be 0 or more")


def check_no_set(path: Path) -> None:
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


def read_poses(path: Path) -> list[PoseRecord]:
    """Return the poses of a file ``poses.csv``.

    Raises
    ------
    NlosError
        The file is missing, cannot be read, or is no table of poses.
    """
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
