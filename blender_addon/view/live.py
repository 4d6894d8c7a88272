"""The live picture of the light that the hidden object changes on the wall, redrawn as the object is moved.

Handlers only record what has changed; timers ask for a picture and show it, between two of Blender's events. Another
process draws it (`session.resident`). The scene is read again only when something besides the object's pose has
changed, and only after the changes have stopped.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

from generator.blender import check, remedies
from generator.blender.engines import renderers, survey
from generator.blender.finding import WARNING, Finding
from generator.blender.scene import geometry, materials, roles
from generator.blender.scene.description import read_scene
from generator.jobs.protocol import Question
from generator.model.engines import AUTO
from generator.model.errors import NlosError
from generator.model.scene import Scene
from generator.transport.world_file import save_world

from ..session import background, environment, state
from ..session.resident import Resident, launches, pixels
from . import images, wall

ACCURACY = 1e-2
"""Accuracy of the live picture: errors of this size are not visible."""

_REST = 0.4
"""Seconds after the last change until the slower steps are done."""

_OFTEN, _SOON, _LONGEST = 0.01, 0.02, 0.03
"""Seconds between two looks for an answer; after which one that is not there yet is waited for elsewhere: Blender
draws its window next, which takes longer than most answers; and that a step may take with such a wait."""

_MOST_REASONS = 5
_NONE = "No live picture"
_TIMES, _MOST_STALLS = 400, 100_000


@dataclass(frozen=True)
class Whole:
    """A whole picture that is shown, and what it is of.

    Attributes
    ----------
    number : int
        Of its question; rises.
    fields : dict
        The answer of the process that drew it.
    world : str
        File of what it drew.
    scene : Scene
        The scene when it was read for that.
    """

    number: int
    fields: dict[str, Any]
    world: str
    scene: Scene


followers: list[Callable[[Whole | None], None]] = []
"""Called with each whole picture that is shown, and with None where what was shown is not so any more."""


@dataclass
class _Look:
    """State that is kept from picture to picture.

    Attributes
    ----------
    resident : Resident or None
        The process that draws.
    world : Path or None
        File of what it draws, as it is now; None if it could not be read.
    asked, first, latest, shown, shadowed : int
        Numbers of the last question, of the first one about this world, of the picture that is shown, of the last one
        that is whole, and of the last one with shadows.
    twice : list of Finding
        Roles that several objects play, so that there is no picture.
    reasons : list of Finding
        What else in the scene is in a picture's way.
    lacking : bool
        Whether what is in its way is that there is no environment.
    at : dict
        When questions were asked, by their number, `time.perf_counter`.
    """

    resident: Resident | None = None
    world: Path | None = None
    described: Scene | None = None
    last: Whole | None = None
    watched: Any = None
    reference: float = 0.0
    scene: str = ""
    around: tuple[Any, ...] = ()
    world_changed: bool = True
    last_change: float = 0.0
    words: str = ""
    twice: list[Finding] = field(default_factory=list)
    reasons: list[Finding] = field(default_factory=list)
    lacking: bool = False
    pose: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    asked: int = 0
    first: int = 0
    latest: int = 0
    shown: int = 0
    shadowed: int = 0
    at: dict[int, float] = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)
    with_shadows: list[float] = field(default_factory=list)
    whole: list[float] = field(default_factory=list)
    stalls: list[float] = field(default_factory=list)
    pictures: int = 0


_look = _Look()


def words() -> str:
    """Return the text for the panel: why there is no picture, or how long the last one took."""
    note = _look.resident.note if _look.resident is not None else ""
    return f"{_look.words}. {note}" if note else _look.words


def played_twice() -> list[Finding]:
    """Return the roles that several objects play, if that is why there is no picture."""
    return _look.twice if _noted in bpy.app.handlers.depsgraph_update_post else []


def reasons() -> list[Finding]:
    """Return what is in a picture's way, if that is why there is none."""
    return played_twice() or (_look.reasons if _look.words.startswith(_NONE) else [])


def needs_environment() -> bool:
    """Return whether there is no picture for want of an environment."""
    return _look.lacking and not environment.named()


def waits() -> bool:
    """Return whether a picture is on its way."""
    return _look.shown < _look.asked


def pictures() -> int:
    """Return how many pictures were drawn since the live picture was switched on."""
    return _look.pictures


def seconds() -> list[float]:
    """Return the seconds from a change to its first image, coarse or whole, of the last pictures."""
    return list(_look.seconds)


def whole() -> tuple[list[float], list[float]]:
    """Return the seconds from a change to its first picture with shadows and to its whole one, of the last ones."""
    return list(_look.with_shadows), list(_look.whole)


def first() -> int:
    """Return the number of the first question about the scene as it is."""
    return _look.first


def last() -> Whole | None:
    """Return the last whole picture that was shown; None if what was shown is not so any more."""
    return _look.last


def stalls(*, clear: bool = False) -> list[float]:
    """Return the seconds that steps of the live look have kept Blender's window; optionally, forget them."""
    found = list(_look.stalls)
    if clear:
        _look.stalls.clear()
    return found


def switch(on: bool) -> None:
    """Start or stop following the scene."""
    global _look
    handlers = _handlers()
    running = _noted in handlers[0][0]
    if on and not running:
        _look = _Look(resident=Resident(launches()))
        for callbacks, function in handlers:
            callbacks.append(function)
        wall.switch(True)
        changed()
    elif not on and running:
        for callbacks, function in handlers:
            callbacks.remove(function)
        for timer in (_ask, _show):
            if bpy.app.timers.is_registered(timer):
                bpy.app.timers.unregister(timer)
        assert _look.resident is not None
        _look.resident.stop()
        wall.switch(False)
        images.darken()
        state.redraw("IMAGE_EDITOR", "VIEW_3D")
        if _look.world is not None:
            _look.world.unlink(missing_ok=True)
        _look = _Look()


def restart() -> None:
    """Have another process draw, since a Python is named that may be quicker."""
    if _noted in bpy.app.handlers.depsgraph_update_post:
        switch(False)
        switch(True)


def _handlers() -> list[tuple[Any, Any]]:
    events = bpy.app.handlers
    return [(events.depsgraph_update_post, _noted), (events.undo_post, _restored), (events.redo_post, _restored)]


def changed() -> None:
    """Have the scene read again, since something besides the pose has changed."""
    if _noted in bpy.app.handlers.depsgraph_update_post:
        _look.world_changed, _look.last_change = True, time.monotonic() - _REST
        state.once(_ask)


@persistent  # type: ignore[untyped-decorator]
def _restored(*_: Any) -> None:
    changed()


@persistent  # type: ignore[untyped-decorator]
def _noted(scene: Any, depsgraph: Any) -> None:
    """Record an update of the scene."""
    if state.is_reading:
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
    state.once(_ask)


def around(scene: Any) -> tuple[Any, ...]:
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


def _ask() -> float | None:
    """Ask for a picture of what has changed; return the seconds until the next call, None for no further call."""
    manager = bpy.context.window_manager
    scene = bpy.context.scene
    if manager is None or scene is None:  # for a moment, while a file opens
        return _REST
    if not manager.nlos.look or _look.resident is None:
        return None
    if state.rendering_now():
        return _REST
    start = time.perf_counter()
    try:
        with state.reading():
            rest = time.monotonic() - _look.last_change
            place, turn, scale = _pose(scene)
            beside = (*around(scene), *(f"{s:.5g}" for s in scale))  # rotation changes its last digits
            if _look.scene != scene.name or _look.around != beside:
                _look.world_changed, _look.around = True, beside
            if _look.world is None and _look.pose != (place, turn):
                _look.world_changed = True
            if _look.world_changed:
                if _look.world is not None and rest < _REST:
                    return _REST
                _look.pose = place, turn  # a scene that cannot be read is not tried again until the pose changes
                _read(scene)
                return 0.0  # the window goes on between reading and asking
            if _look.world is None or (place, turn) == _look.pose:
                return None
            _look.pose, _look.asked = (place, turn), _look.asked + 1
            _look.at = {**dict(list(_look.at.items())[-_TIMES:]), _look.asked: start}
            _look.resident.ask(
                Question(
                    number=_look.asked,
                    world=str(_look.world),
                    accuracy=ACCURACY,
                    position=place,
                    rotation=turn,
                    shadows=scene.nlos.look_shadows,
                )
            )
            is_new_world = _look.first == _look.asked  # its first picture takes its time
            left = start + _LONGEST - time.perf_counter()
            if _show(0.0 if is_new_world else max(0.0, min(_SOON, left))) is not None:
                state.once(_show, _OFTEN)
            return None
    except NlosError as error:
        _look.twice = check.played_twice(scene)
        _refuse(str(error))
        return None
    finally:
        _note_stall(start)


def _show(patience: float = 0.0) -> float | None:
    """Show a picture that has come, or comes within a time; return the seconds to the next call, None if none is."""
    if _look.resident is None:
        return None
    if state.rendering_now():
        return _REST
    start = time.perf_counter()
    fields = _look.resident.take(patience)
    if fields is None:
        if _look.resident.words:
            _say(_look.resident.words)
        return _OFTEN if waits() and not _look.resident.ended else None
    number = int(fields["number"])
    if number < _look.first or number not in _look.at:
        return _OFTEN
    if "refused" in fields:
        _look.shown = number
        _refuse(fields["refused"])
        return _OFTEN if waits() else None
    images.look(pixels(fields), _look.watched, _look.reference)
    since = time.perf_counter() - _look.at[number]
    is_whole, is_shadowed = bool(fields["whole"]), bool(fields["shadows"])
    if number != _look.latest:
        _look.seconds = [*_look.seconds[-_TIMES:], since]
    _look.latest, _look.pictures = number, _look.pictures + 1
    if is_whole:
        _look.shown, _look.whole = number, [*_look.whole[-_TIMES:], since]
        assert _look.described is not None
        _tell(Whole(number, fields, str(_look.world), _look.described))
    if is_shadowed and _look.shadowed < number:
        _look.shadowed, _look.with_shadows = number, [*_look.with_shadows[-_TIMES:], since]
    follows = "" if is_whole else ", a finer one follows" if is_shadowed else ", shadows follow"
    _look.words = f"Drawn in {1e3 * since:.0f} ms{follows}"
    state.redraw("IMAGE_EDITOR", "VIEW_3D")
    _note_stall(start)
    return _OFTEN if waits() else None


def _refuse(text: str) -> None:
    _say(text)
    images.darken()
    state.redraw("IMAGE_EDITOR", "VIEW_3D")
    _tell(None)


def _tell(shown: Whole | None) -> None:
    _look.last = shown
    for follow in followers:
        follow(shown)


def _say(text: str) -> None:
    if _look.words != text:
        _look.words = text
        state.redraw("VIEW_3D")


def _note_stall(start: float) -> None:
    _look.stalls.append(time.perf_counter() - start)
    del _look.stalls[:-_MOST_STALLS]


def _pose(scene: Any) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Return the target's position (metres), rotation (degrees about x, then y, then z) and scale."""
    target = roles.find(scene, "target")
    place, turn, scale = geometry.pose_of(target, target.matrix_world)
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
    """Read from the scene what a picture needs besides the pose, and write it for the process that draws."""
    old, _look.world_changed, _look.world = _look.world, False, None
    _look.reasons, _look.lacking = [], False
    if old is not None:
        old.unlink(missing_ok=True)
    resolution = int(scene.nlos.look_resolution)
    _look.scene = scene.name
    described = read_scene(scene)
    width, height = described.resolution
    size = (resolution, max(1, round(resolution * height / width)))
    surveyed = survey.survey(scene, resolution=size)
    world = surveyed.world
    if world is None:
        found = [remedies.finding(scene, WARNING, why) for why in surveyed.reasons("surfel")]
        _look.reasons = found[:_MOST_REASONS]
        count = "1 thing is" if len(found) == 1 else f"{len(found)} things are"
        shown = f", the first {_MOST_REASONS} of them here" if len(found) > _MOST_REASONS else ""
        raise NlosError(f"{_NONE}: {count} in its way{shown}{_instead(scene, surveyed)}")
    _look.lacking = bool(renderers.lacking(surveyed))
    if _look.lacking and not environment.named():
        raise NlosError(
            f"{_NONE}: a furnished room needs packages that Blender's own Python lacks; Make "
            "Environment makes one that has them"
        )
    _look.first, _look.watched, _look.reference = _look.asked + 1, world.watched, described.reference_radiance
    _look.described = described
    path = background.folder() / f"look-{_look.first}.npz"
    save_world(path, world)
    _look.world, _look.pose, _look.twice = path, None, []


def register() -> None:
    """Do nothing: the live picture runs only once it is switched on."""


def unregister() -> None:
    """Switch the live picture off."""
    switch(False)
