"""Checks that an existing set is the one that is asked for, so that it may be continued."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from generator.model.engines import AUTO
from generator.model.errors import NlosError
from generator.model.quantities import parse_resolution
from generator.model.settings import Sweep
from generator.sets import links
from generator.sets.manifest import SCENE, scene_hash


class HasSettings(Protocol):
    """A set on disk and the settings that it was made with."""

    path: Path
    meta: dict[str, Any]

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that the set was made with."""


def check_same(dataset: HasSettings, scene: Path, chosen: Mapping[str, Any]) -> None:
    """Raise NlosError, naming each difference, if a data set was made from another scene or with other settings.

    NlosError is also raised if files that its scene refers to have changed, or may not be read (`links.check`).
    """
    older = {"device": Sweep.device, "denoise": Sweep.denoise, "stream": "sweep", "unknown": False, "uncertain": None}
    settings = {"vary": [], "targets": 1, "timeline": [], **older, **dataset.settings}  # older sets lack these
    width, height = settings["resolution"]
    differences = []
    for name, value in chosen.items():
        if name == "resolution" and isinstance(value, str):
            value = parse_resolution(value, width / height)
        value = list(value) if isinstance(value, tuple) else value  # as TOML gives it back
        if name == "engine" and value == AUTO:
            continue
        if name in Sweep.idle(settings["engine"]) and chosen.get("engine", AUTO) != AUTO:
            differences.append(f"{name} means nothing to its engine {settings['engine']!r}")
        if name in settings and settings[name] != value:
            told = f"{name} is {settings[name]} there and {value} here"
            differences.append("what is uncertain is not the same there" if name == "uncertain" else told)
        elif name == "frames" and name not in settings:
            differences.append("its poses lie in voxels, not on a trajectory")
        elif name in ("poses", "inside") and name not in settings and "frames" in settings:
            differences.append("its poses lie on a trajectory, not in voxels")
    if scene_hash(scene) not in (settings.get("scene_sha256"), scene_hash(dataset.path / SCENE)):
        differences.append(f"{scene} is not the scene it was rendered from (or has been saved again since)")
    if differences:
        raise NlosError(
            f"{dataset.path}: holds a sweep with other settings: {'; '.join(differences)}; "
            "use the same settings or another folder"
        )
    links.check(dataset.meta.get("links", {}), dataset.path, scene)
