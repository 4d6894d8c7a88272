"""Which settings of the panels are not in the scene, and whether Build would throw away what was edited by hand.

A handler only counts changes. Panels ask while they are drawn, where the scene must not be read; a timer reads it.
"""

from __future__ import annotations

from typing import Any

import bpy
from bpy.app.handlers import persistent

from generator.blender.engines import survey
from generator.blender.scene import roles
from generator.blender.scene.description import read_scene
from generator.model.errors import NlosError
from generator.transport.world_file import world_hash

from ..draft import differing
from ..session import state

_AFTER = 0.2
"""Seconds from a change until the scene is read, once for several quick changes."""
_PIXELS = 8
_BUILT_AS = "nlos_built_as"

_changes = 0
_read_at = -1
_found: tuple[list[str], list[str]] = [], []


def found() -> tuple[list[str], list[str]]:
    """Return the settings that Apply would write, and those that only Build would; as they were a moment ago."""
    if _read_at != _changes:
        state.once(_read, _AFTER)
    return _found


def mark(scene: Any) -> None:
    """Note in the scene what was built, so that `edited` can tell."""
    if hashed := _hash(scene):
        scene[_BUILT_AS] = hashed


def edited(scene: Any) -> bool:
    """Return whether a scene that was built differs from what was built then, as far as light is concerned."""
    built = scene.get(_BUILT_AS)
    return bool(built) and _hash(scene) != built


def _hash(scene: Any) -> str:
    try:
        world, _ = survey.world(scene, resolution=(_PIXELS, _PIXELS))
    except NlosError:
        return ""
    return "" if world is None else world_hash(world)


def _read() -> None:
    global _read_at, _found
    scene = bpy.context.scene
    if scene is None or state.rendering_now():
        return
    before, _read_at = _found, _changes
    try:
        _found = differing(scene.nlos, read_scene(scene)) if roles.GRID_SHAPE in scene else ([], [])
    except NlosError:  # it is told elsewhere
        _found = [], []
    if _found != before:
        state.redraw("VIEW_3D")


@persistent  # type: ignore[untyped-decorator]
def _changed(*_: Any) -> None:
    global _changes
    _changes += 1


def _handlers() -> tuple[Any, ...]:
    events = bpy.app.handlers
    return events.depsgraph_update_post, events.undo_post, events.redo_post, events.load_post


def register() -> None:
    """Count changes."""
    for callbacks in _handlers():
        callbacks.append(_changed)


def unregister() -> None:
    """Stop counting."""
    for callbacks in _handlers():
        callbacks.remove(_changed)
    if bpy.app.timers.is_registered(_read):
        bpy.app.timers.unregister(_read)
