"""What the engine itself can leave out of any world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from generator.transport.world import World

SHADOW = "its shadow on the room"
PATCH = "the lit patch's extent"
PARTS = (SHADOW, PATCH)

_POINT = 1e-3
"""Of the lit patch, in itself, where it counts as a point."""


def without(world: World, dropped: Sequence[str]) -> tuple[World, bool]:
    """Return a world without some parts, and whether the object's shadow on its room is left.

    Parameters
    ----------
    world : World
    dropped : sequence of str
        Of `PARTS`; other names count nothing.
    """
    if PATCH in dropped:
        patch = world.patch
        small = {name: _POINT * getattr(patch, name) for name in ("major", "minor")}
        world = replace(world, patch=replace(patch, **small, intensity=patch.intensity / _POINT**2))
    return world, SHADOW not in dropped
