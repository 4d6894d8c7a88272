"""The file of a plan, which a sweep follows and a data set keeps a copy of."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from generator.files.toml import read_toml
from generator.files.writing import write_text
from generator.model.errors import NlosError
from generator.sets.manifest import PLAN, scene_hash

FORMAT = 1


FILE = PLAN


SETTINGS = ("engine", "accuracy", "samples", "leave_out")
"""Settings of a sweep that follow from a plan."""


def followed(path: Path, scene: Path, chosen: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a sweep that follows a plan: those of the plan, and those that the user chose besides.

    Raises
    ------
    NlosError
        As `read`; or the user chose what follows from the plan.
    """
    settings = read(path, scene)
    free = {"samples"} - set(settings)  # of a plan that had no time to measure how many are needed
    if conflicts := [name for name in SETTINGS if name in chosen and name not in free]:
        raise NlosError(f"{conflicts[0]}: follows from --plan; leave it out, or leave --plan out")
    return {**chosen, **settings}


def keep(path: Path, dataset: Path) -> None:
    """Copy a plan, or the one in a folder, into the data set that was made from it."""
    write_text(dataset / FILE, _file(path).read_text(encoding="utf-8"))


def _file(path: Path) -> Path:
    return path / FILE if path.is_dir() else path


def read(path: Path, scene: Path) -> dict[str, Any]:
    """Return the settings of a sweep that follow from a plan.

    Parameters
    ----------
    path : Path
        The file, or the folder that holds it.
    scene : Path
        Scene file that is to be swept.

    Raises
    ------
    NlosError
        The file is no plan, is newer than this software, or is of another scene.
    """
    file = _file(path)
    plan = read_toml(file)
    settings = plan.get("settings")
    if not isinstance(settings, dict) or plan.get("format") != FORMAT or set(settings) - set(SETTINGS):
        raise NlosError(f"{file}: is no plan of format {FORMAT}; make one with nlos-generate plan")
    if plan.get("scene_sha256") != scene_hash(scene):
        raise NlosError(
            f"{file}: is a plan of another scene than {scene}, or of this one before it was edited; plan again"
        )
    return settings
