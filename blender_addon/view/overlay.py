"""Draws in the 3D views the parts of the experiment that are not objects. Nothing runs while it is off."""

from __future__ import annotations

from typing import Any

import blf
import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

from generator.blender.scene import geometry, outlines, roles
from generator.model.errors import NlosError

from ..session import state
from . import caption, differs

_COLOURS = {
    "voxels": (0.35, 0.75, 1.0, 0.75),
    "lit": (1.0, 0.85, 0.2, 1.0),
    "watched": (0.4, 1.0, 0.5, 1.0),
    "legs": (1.0, 0.55, 0.15, 0.9),
    "poses": (1.0, 0.35, 0.6, 0.9),
}
_SIZE = 15.0
_PROBABLE, _STALE = (1.0, 0.3, 0.1), (0.5, 0.5, 0.5)
_TOLD = 0.05
"""Probability from which on a voxel's is written: the figures of many would cover one another."""
_MOST_LETTERS = 200
"""Most labels of voxels that are drawn; more would hide the scene."""
_PASSES = (("NONE", 0.35), ("LESS_EQUAL", 1.0))
"""Depth test and strength: first faintly and through all surfaces, since a room's walls stand before the lines."""
_SETTLED = 0.15
"""Seconds from a change until poses are planned, so that they are planned once for several quick changes."""

_handles: list[Any] = []
_lines: dict[str, Any] | None = None
_passes = 0
"""How many of the passes of `_PASSES` are drawn: at each drawing one more, since each compiles shaders first."""
_poses: tuple[Any, Any] | None = None


def switch(on: bool) -> None:
    """Start or stop drawing."""
    if on and not _handles:
        add, region = bpy.types.SpaceView3D.draw_handler_add, "WINDOW"
        _handles.extend([add(_draw_lines, (), region, "POST_VIEW"), add(_draw_letters, (), region, "POST_PIXEL")])
        for handlers in _watched():
            handlers.append(_scene_changed)
    elif not on and _handles:
        for handle in _handles:
            bpy.types.SpaceView3D.draw_handler_remove(handle, "WINDOW")
        _handles.clear()
        for handlers in _watched():
            handlers.remove(_scene_changed)
    changed()


def _watched() -> list[Any]:
    handlers = bpy.app.handlers
    return [handlers.depsgraph_update_post, handlers.frame_change_post, handlers.undo_post, handlers.redo_post]


def changed() -> None:
    """Measure the scene again, since something may have moved, and redraw the views."""
    global _lines
    _lines = None
    state.redraw("VIEW_3D")


@persistent  # type: ignore[untyped-decorator]
def _scene_changed(*_: Any) -> None:
    global _lines
    _lines = None


def _measure(scene: Any, session: Any) -> dict[str, Any]:
    """Return everything to draw of the current scene: lines (2 n, 3) by name, and labels with their positions."""
    shapes: dict[str, Any] = {"letters": [], "boxes": []}
    grid = _grid(scene)
    if grid is not None and session.show_voxels:
        shapes["voxels"], centres = outlines.voxels(grid)
        if len(centres) <= _MOST_LETTERS:
            shapes["letters"] = list(zip(grid.labels, centres, strict=True))
    if grid is not None and state.answer:
        shapes["boxes"] = [
            (state.answer.get(label, 0.0), triangles)
            for label, triangles in zip(grid.labels, outlines.boxes(grid), strict=True)
        ]
    try:
        if session.show_patches:
            shapes["lit"] = outlines.closed(outlines.lit_patch(roles.find(scene, "spot")))
            shapes["watched"] = outlines.closed(outlines.watched(scene))
        if session.show_legs:
            path = outlines.legs(scene)
            shapes["legs"] = np.repeat(path, 2, axis=0)[1:-1]
        if session.show_poses:
            shapes["poses"] = _crosses(scene)
    except NlosError:  # no object has the role; the Check panel reports that
        pass
    return shapes


def _grid(scene: Any) -> Any:
    try:
        return roles.read_grid(scene)
    except NlosError:
        return None


def _crosses(scene: Any) -> Any:
    """Return a small cross for each pose; empty until the poses are planned, since drawing does not wait for that."""
    key = _deciding(scene)
    if _poses is None or _poses[0] != key:
        state.once(_plan, after=_SETTLED)
        return np.empty((0, 3))
    points = _poses[1]
    arm = 0.05 * min(key[0].size)
    return np.concatenate([np.stack([points - arm * e, points + arm * e], axis=1) for e in np.eye(3)]).reshape(-1, 3)


def _deciding(scene: Any) -> tuple[Any, ...]:
    """Return what determines the poses, as far as it can be read while drawing, when nothing may be rendered."""
    from ..draft import sweep_of

    objects = tuple(
        (o.name, o.hide_render, tuple(map(tuple, o.matrix_world)))
        for o in scene.objects
        if o.type in ("MESH", "LIGHT", "CAMERA")
    )
    target = roles.find(scene, "target")
    around = tuple(entry for entry in objects if entry[0] != target.name)
    corners = geometry.evaluated_vertices(target) @ np.diag(target.matrix_world.to_scale())
    chosen = sorted((name, str(value)) for name, value in sweep_of(scene.nlos).items())
    return roles.read_grid(scene), tuple(chosen), corners.tobytes(), around


def _plan() -> float | None:
    """Plan the poses from the event loop: the clearance test takes too long for a frame."""
    global _poses
    context: Any = bpy.context
    if not _handles or not context.window_manager.nlos.show_poses:
        return None
    if state.rendering_now():
        return _SETTLED
    try:
        from ..draft import resolved_sweep

        key = _deciding(context.scene)
        _poses = key, np.empty((0, 3))  # if no pose fits, planning is not tried again until something changes
        _poses = key, outlines.sampled(context.scene, resolved_sweep(context.scene))
    except NlosError:  # the Check panel reports the reason
        pass
    changed()
    return None


def _draw_lines() -> None:
    global _lines, _passes
    context = bpy.context
    if _lines is None:
        _lines = {"letters": [], "boxes": []}  # if measuring fails, that is reported once and not with every redraw
        _lines = _measure(context.scene, context.window_manager.nlos)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    colour = _STALE if differs.is_stale("answer") else _PROBABLE
    fill_shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    for probability, triangles in _lines["boxes"]:
        fill_shader.bind()
        fill_shader.uniform_float("color", (*colour, 0.4 * probability))
        batch_for_shader(fill_shader, "TRIS", {"pos": triangles.astype(np.float32)}).draw(fill_shader)
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    region = context.region
    for depth_test, strength in _PASSES[:_passes]:
        gpu.state.depth_test_set(depth_test)
        for name, (red, green, blue, alpha) in _COLOURS.items():
            ends = _lines.get(name)
            if ends is None or not len(ends):
                continue
            shader.bind()
            shader.uniform_float("viewportSize", (region.width, region.height))
            shader.uniform_float("lineWidth", 1.5 if name == "voxels" else 2.0)
            shader.uniform_float("color", (red, green, blue, alpha * strength))
            batch_for_shader(shader, "LINES", {"pos": ends.astype(np.float32)}).draw(shader)
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")
    if _passes < len(_PASSES):
        _passes += 1
        state.once(_redraw)


def _redraw() -> None:
    state.redraw("VIEW_3D")


def _draw_letters() -> None:
    context = bpy.context
    if not _lines:
        return
    scale = context.preferences.system.ui_scale
    for label, centre in _lines["letters"]:
        place = location_3d_to_region_2d(context.region, context.region_data, Vector(centre))
        if place is None:
            continue
        text = label
        if (probability := state.answer.get(label, 0.0)) >= _TOLD:
            text = f"{label} {probability:.0%}"
        blf.size(0, _SIZE * scale)
        width, height = blf.dimensions(0, text)
        caption.write(text, place.x - width / 2.0, place.y - height / 2.0, scale, _SIZE)


def register() -> None:
    """Do nothing: the overlay is drawn only once it is switched on."""


def unregister() -> None:
    """Switch the overlay off."""
    switch(False)
