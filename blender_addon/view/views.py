"""Sets up the 3D views for a scene that was just made: the tab at hand, the scene framed, its inside seen."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from generator.blender.scene import roles
from generator.model.errors import NlosError

from ..session import state

TAB = "NLOS"
_FROM = Vector((-0.75, 0.9, 0.45))
"""Direction from the watched wall, which faces y, to the eye: from the side and above, into the hidden part."""
_AROUND = 1.5
"""Distance of the eye, as a multiple of the diagonal of what is looked at."""
_TRIES = 20


def enter() -> None:
    """Open the sidebar's tab in every 3D view, and look at the wall and the voxels."""
    for window in bpy.context.window_manager.windows:
        for area in (a for a in window.screen.areas if a.type == "VIEW_3D"):
            area.spaces.active.show_region_ui = True
            _frame(area.spaces.active.region_3d)
    state.after_drawing(lambda: _bring_forward(_TRIES))


def _frame(view: Any) -> None:
    try:
        grid = roles.read_grid(bpy.context.scene)
        wall = roles.find(bpy.context.scene, "relay_wall")
    except NlosError:
        return
    corners = np.array([*(wall.matrix_world @ Vector(corner) for corner in wall.bound_box), grid.lo, grid.hi])
    low, high = corners.min(axis=0), corners.max(axis=0)
    view.view_perspective = "PERSP"
    view.view_location = Vector((low + high) / 2.0)
    view.view_rotation = _FROM.to_track_quat("Z", "Y")
    view.view_distance = _AROUND * float(np.linalg.norm(high - low))


def _bring_forward(tries: int) -> None:
    """Choose our tab: Blender knows the tabs of a sidebar only once it has been drawn."""
    waits = False
    for window in bpy.context.window_manager.windows:
        for area in (a for a in window.screen.areas if a.type == "VIEW_3D"):
            for region in (r for r in area.regions if r.type == "UI"):
                try:
                    region.active_panel_category = TAB
                except (TypeError, AttributeError):  # not drawn yet
                    waits = True
    if waits and tries:
        state.after_drawing(lambda: _bring_forward(tries - 1))
