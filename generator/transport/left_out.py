"""Parts of a scene that the engine itself can leave out of any world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from generator.transport.world import World

SHADOW = "its shadow on the room"
PATCH = "the lit patch's extent"
PARTS = (SHADOW, PATCH)

_POINT = 1e-3
"""Factor by which the lit patch shrinks where it counts as a point."""


def without(world: World, dropped: Sequence[str]) -> tuple[World, bool]:
    """Return a world without the dropped parts, and whether the object's shadow on the room is kept.

    Parameters
    ----------
    world : World
    dropped : sequence of str
        Members of `PARTS`; other names are ignored.
    """
    if PATCH in dropped:
        patch = world.patch
        axes = {name: _POINT * getattr(patch, name) for name in ("major", "minor")}
        world = replace(world, patch=replace(patch, **axes, intensity=patch.intensity / _POINT**2))
    return world, SHADOW not in dropped
