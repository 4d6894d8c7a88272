"""The live picture of the light that the hidden object changes on the wall, redrawn as the object is moved.

Handlers only record what has changed; a timer draws, between two of Blender's events. The scene is read again only
when something besides the object's pose has changed, and only after the changes have stopped.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent

from generator.blender.engines import renderers, survey
from generator.blender.scene import materials, roles
from generator.blender.scene.description import read_scene
from generator.model.engines import AUTO
from generator.model.errors import NlosError
from generator.transport import Transport
from generator.transport.compiled import COMPILED

from ..session import state
from . import images

ACCURACY = 1e-2
"""Accuracy of the live picture: errors of this size are not visible."""

_REST = 0.4
"""Seconds after the last change until the slower steps are done."""

_TIMES = 400


@dataclass
class _Look:
    """State that is kept from picture to picture."""

    transport: Transport | None = None
    reference: float = 0.0
    scene: str = ""
    around: tuple[Any, ...] = ()
    exact: bool = False
    world_changed: bool = True
    last_change: float = 0.0
    busy: bool = False
    shadows: bool = False
    words: str = ""
    pose: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    seconds: list[float] = field(default_factory=list)
    pictures: int = 0


_look = _Look()


def words() -> str:
    """Return the text for the panel: why there is no picture, or how long the last one took."""
    return _look.words


def pictures() -> int:
    """Return how many pictures were drawn since the live picture was switched on."""
    return _look.pictures


def seconds() -> list[float]:
    """Return the seconds from change to image of the last pictures that were drawn while the object was moved."""
    return list(_look.seconds)


def switch(on: bool) -> None:
    """Start or stop following the scene."""
    global _look
    handlers = _handlers()
    running = _noted in handlers[0][0]
    if on and not running:
        _look = _Look()
        for callbacks, function in handlers:
            callbacks.append(function)
        changed()
    elif not on and running:
        for callbacks, function in handlers:
            callbacks.remove(function)
        if bpy.app.timers.is_registered(_draw):
            bpy.app.timers.unregister(_draw)
        _look = _Look()


def _handlers() -> list[tuple[Any, Any]]:
    events = bpy.app.handlers
    return [(events.depsgraph_update_post, _noted), (events.undo_post, _restored), (events.redo_post, _restored)]


def changed() -> None:
    """Have the scene read again, since something besides the pose has changed."""
    if _noted in bpy.app.handlers.depsgraph_update_post:
        _look.world_changed, _look.last_change = True, time.monotonic() - _REST
        state.once(_draw)


@persistent  # type: ignore[untyped-decorator]
def _restored(*_: Any) -> None:
    changed()


@persistent  # type: ignore[untyped-decorator]
def _noted(scene: Any, depsgraph: Any) -> None:
    """Record an update of the scene."""
    if _look.busy:
        return
    players = roles.players(scene, "target")
    moved = False
    for update in depsgraph.updates:
        data_block = update.id.original
        if isinstance(data_block, bpy.types.Object):
            # Selecting an object is an update too, but of neither kind.
            if update.is_updated_geometry or (update.is_updated_transform and data_block not in players):
                _look.world_changed = True
            moved = moved or update.is_updated_transform or update.is_updated_geometry
        elif isinstance(data_block, bpy.types.Mesh | bpy.types.Material | bpy.types.Light | bpy.types.Camera):
            _look.world_changed = moved = True
    if moved:
        _look.last_change = time.monotonic()
    state.once(_draw)


def _around(scene: Any) -> tuple[Any, ...]:
    """Return what affects a picture but causes no update of an object; it is cheap to compare."""
    layers: list[Any] = [layer.layer_collection for layer in scene.view_layers]
    shown = []
    while layers:
        layer = layers.pop()
        shown.append((layer.name, layer.exclude, layer.collection.hide_render))
        layers += layer.children
    objects = tuple((o.name, o.hide_render, len(o.constraints), o.get(roles.ROLE)) for o in scene.objects)
    cycles = getattr(scene, "cycles", None)
    bounces = (cycles.max_bounces, cycles.diffuse_bounces) if cycles else ()
    return objects, tuple(shown), bounces, materials.ambient(scene), scene.camera and scene.camera.name


def _draw() -> float | None:
    """Draw what has changed; return the seconds until the next call, None for no further call."""
    manager = bpy.context.window_manager
    scene = bpy.context.scene
    if manager is None or scene is None:  # for a moment, while a file opens
        return _REST
    if not manager.nlos.look:
        return None
    if state.rendering_now():
        return _REST
    start = time.perf_counter()
    rest = time.monotonic() - _look.last_change
    _look.busy = True  # reading the scene moves the target and puts it back
    try:
        place, turn, scale = _pose(scene)
        around = (*_around(scene), *(f"{s:.5g}" for s in scale))  # rotation changes its last digits
        if _look.scene != scene.name or _look.around != around:
            _look.world_changed, _look.around = True, around
        if _look.transport is None and _look.pose != (place, turn):
            _look.world_changed = True
        if _look.world_changed:
            if _look.transport is not None and rest < _REST:
                return _REST
            _look.pose = place, turn  # a scene that cannot be read is not tried again until the pose changes
            _read(scene)
        if _look.transport is None:
            return None
        exact = scene.nlos.look_shadows and (_look.shadows or rest >= _REST)
        shadows_follow = scene.nlos.look_shadows and not exact
        if (place, turn) == _look.pose and (_look.exact or not exact):
            return None if _look.exact else _REST
        picture = _look.transport.difference(place, turn, shadows=exact)
        _look.pose, _look.exact = (place, turn), exact or not shadows_follow
        images.look(picture.astype(np.float32), _look.transport.world.watched, _look.reference)
        duration = time.perf_counter() - start
        if shadows_follow or exact == _look.shadows:  # nobody waits for those at rest, so they are not timed
            _look.seconds = [*_look.seconds[-_TIMES:], duration]
        _look.pictures += 1
        _look.words = f"{1e3 * duration:.0f} ms" + (", shadows follow" if shadows_follow else "")
        state.redraw("IMAGE_EDITOR", "VIEW_3D")
        return _REST if shadows_follow else None
    except NlosError as error:
        if _look.words != str(error):
            _look.words = str(error)
            state.redraw("VIEW_3D")
        return None
    finally:
        bpy.context.view_layer.update()
        _look.busy = False


def _pose(scene: Any) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Return the target's position (metres), rotation (degrees about x, then y, then z) and scale."""
    place, turn, scale = roles.find(scene, "target").matrix_world.decompose()
    return tuple(place), tuple(math.degrees(angle) for angle in turn.to_euler("XYZ")), tuple(scale)


def _instead(scene: Any, found: survey.Survey) -> str:
    """Return a hint at what can render a scene that has no live picture; empty if nothing can."""
    if found.never:
        return ""
    able_engine, _ = renderers.choose(scene, found)
    engine = scene.nlos.engine
    suitable = engine == AUTO or not found.reasons(engine)
    return ". Render Wall can show it" if suitable else f". Render Wall can show it by the engine {able_engine}"


def _read(scene: Any) -> None:
    """Read from the scene what a picture needs besides the pose."""
    _look.world_changed, _look.transport = False, None
    pixels = int(scene.nlos.look_resolution)
    _look.scene = scene.name
    described = read_scene(scene)
    width, height = described.resolution
    size = (pixels, max(1, round(pixels * height / width)))
    surveyed = survey.survey(scene, resolution=size)
    world = surveyed.world
    if world is None:
        raise NlosError(f"No live picture: {surveyed.reasons('surfel')[0]}{_instead(scene, surveyed)}")
    _look.transport, _look.pose = Transport(world, accuracy=ACCURACY), None
    _look.reference = described.reference_radiance
    # Shadows cost next to nothing if nothing can be shadowed, or if the compiler is available.
    _look.shadows = not world.room or bool(COMPILED)


def register() -> None:
    """Do nothing: the live picture runs only once it is switched on."""


def unregister() -> None:
    """Switch the live picture off."""
    switch(False)
