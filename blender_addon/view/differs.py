"""Which settings of the panels are not in the scene, which results are of another one, and what Build would discard.

A handler only counts changes. Panels ask while they are drawn, where the scene must not be read; a timer reads it.
"""

from __future__ import annotations

import time
from typing import Any

import bpy
from bpy.app.handlers import persistent

from generator.blender.engines import survey
from generator.blender.scene import roles
from generator.blender.scene.description import read_scene
from generator.model.errors import NlosError
from generator.model.scene import Scene
from generator.transport.world_file import world_hash

from ..draft import differing
from ..session import state
from . import live

_AFTER = 0.2
"""Seconds from the last of several quick changes until the scene is read."""
_PIXELS = 8
_BUILT_AS = "nlos_built_as"

_changes = 0
_changed_at = 0.0
_read_at = -1
_found: tuple[list[str], list[str]] = [], []
_described: Scene | None = None
_now = ""
_hashed: tuple[tuple[Any, ...], str] = (), ""
"""The last hash, and what it is of: reading a scene takes its time."""


def found() -> tuple[list[str], list[str]]:
    """Return the settings that Apply would write, and those that only Build would; as they were a moment ago."""
    if _read_at != _changes:
        state.once(_read, _AFTER)
    return _found


def described() -> Scene | None:
    """Return the scene's description as it was a moment ago; None if it cannot be read, or has not been yet."""
    found()
    return _described


def note(topic: str) -> None:
    """Note that a result is of the scene as it stands."""
    global _now
    with state.reading():
        _now = state.of[topic] = _fingerprint(bpy.context.scene)


def is_stale(topic: str) -> bool:
    """Return whether a result is of another scene than there was a moment ago; False again after undo."""
    found()
    return topic in state.of and state.of[topic] != _now


def mark(scene: Any) -> None:
    """Note in the scene what was built, so that `edited` can tell."""
    if hashed := _hash(scene):
        scene[_BUILT_AS] = hashed


def edited(scene: Any) -> bool:
    """Return whether a scene that was built differs from what was built then, as far as light is concerned."""
    built = scene.get(_BUILT_AS)
    return bool(built) and _hash(scene) != built


def _fingerprint(scene: Any, described: Scene | None = None) -> str:
    """Return a text that changes with the scene's light and with the target's pose."""
    try:
        place, turn, scale = roles.find(scene, "target").matrix_world.decompose()
        pose = [f"{v:.5f}" for v in (*place, *turn, *scale)]
        return f"{_hash(scene)} {described or read_scene(scene)} {pose}"
    except NlosError as error:
        return str(error)


def _hash(scene: Any) -> str:
    """Return a text that changes with the scene's light; empty where there is none to tell."""
    global _hashed
    with state.reading():
        key = (scene.name, _changes, live.around(scene))  # after reading has told of what was changed before it
        if _hashed[0] == key:
            return _hashed[1]
        try:
            world, _ = survey.world(scene, resolution=(_PIXELS, _PIXELS))
        except NlosError:
            world = None
    _hashed = key, "" if world is None else world_hash(world)
    return _hashed[1]


def _read() -> float | None:
    """Read the scene once it rests; return the seconds until another try, None for none."""
    if time.monotonic() - _changed_at < _AFTER:
        return _AFTER
    read()
    return None


def read() -> None:
    """Read the scene as it is."""
    global _read_at, _found, _now, _described
    scene = bpy.context.scene
    if scene is None or state.rendering_now():
        return
    before, _read_at = (_found, _now, _described), _changes
    with state.reading():
        try:
            _described = read_scene(scene) if roles.GRID_SHAPE in scene else None
        except NlosError:  # it is told elsewhere
            _described = None
        _found = differing(scene.nlos, _described) if _described else ([], [])
        if state.of:
            _now = _fingerprint(scene, _described)
    if (_found, _now, _described) != before:
        state.redraw("VIEW_3D")


@persistent  # type: ignore[untyped-decorator]
def _changed(*_: Any) -> None:
    global _changes, _changed_at
    if not state.is_reading:
        _changes, _changed_at = _changes + 1, time.monotonic()
        if not bpy.app.background:
            state.once(_remind, _AFTER)


def _remind() -> None:
    """Have panels that are shown ask again: not every change makes Blender draw them."""
    state.redraw("VIEW_3D")


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
    for timer in (_read, _remind):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
