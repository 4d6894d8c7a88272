"""Settings of a sweep, completed from the scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import bpy

from generator.blender.engines import renderers
from generator.files.toml import from_dict
from generator.model.engines import AUTO
from generator.model.errors import NlosError
from generator.model.quantities import parse_resolution
from generator.model.scene import Scene
from generator.model.settings import Sweep

_SMALLEST = 4
"""Least number of pixels of a picture's sides in Blender."""


TURNS = {"sphere": (0.0, 0.0, 0.0), "sheet": (15.0, 15.0, 90.0), "mesh": (15.0, 15.0, 90.0)}
"""Largest rotations, degrees, unless the user sets them. About z, +-90 covers a two-sided sheet once."""


def settled(scene: bpy.types.Scene, described: Scene, chosen: Mapping[str, Any]) -> tuple[Sweep, list[str]]:
    """Return the sweep of a scene that the user's settings define, and why `auto` took no cheaper engine."""
    settings = {"engine": AUTO, **with_defaults(described, chosen)}
    reasons: list[str] = []
    if settings["engine"] == AUTO:
        settings["engine"], reasons = renderers.choose(scene)
    sweep: Sweep = from_dict(Sweep, settings, "")
    width, height = sweep.resolution
    if sweep.noisy and min(width, height) < _SMALLEST:  # Blender would render its own minimum instead
        raise NlosError(
            f"resolution: {width} x {height} is less than Blender renders, {_SMALLEST} pixels a side; ask for more, "
            "or take the engine 'surfel'"
        )
    return sweep, reasons


def with_defaults(described: Scene, chosen: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that the user chose, completed by those that follow from the scene."""
    width, height = described.resolution
    settings = {
        "resolution": [width, height],
        "rotation": list(TURNS[described.target.kind]),
        **chosen,
    }
    if isinstance(settings["resolution"], str):
        settings["resolution"] = list(parse_resolution(settings["resolution"], width / height))
    return settings
