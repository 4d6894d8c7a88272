"""Sets up 3D views for a scene that was just made, so that wall and hidden volume are seen at once."""

from __future__ import annotations

import math

import bpy

# isort: split
import numpy as np
from mathutils import Vector

from generator.blender.scene import roles
from generator.model.errors import NlosError

_EYE = (0.75, 0.9, 0.45)
"""Direction from the watched wall, which faces y, to the eye, if the voxels lie at larger x than the lamp."""
_DISTANCE = 1.5
"""Distance of the eye, as a multiple of the diagonal of what is looked at."""


def frame(scene: bpy.types.Scene, screens: list[bpy.types.Screen]) -> None:
    """Have every 3D view of some screens look at a scene's relay wall and voxels.

    Parameters
    ----------
    scene : bpy.types.Scene
        Where it lacks a wall or voxels, the views stay as they are.
    screens : list of bpy.types.Screen
    """
    try:
        grid, wall, lamp = roles.read_grid(scene), roles.find(scene, "relay_wall"), roles.find(scene, "spot")
    except NlosError:
        return
    corners = np.array([*(wall.matrix_world @ Vector(corner) for corner in wall.bound_box), grid.lo, grid.hi])
    low, high = corners.min(axis=0), corners.max(axis=0)
    # From the side where the object hides, for what hides it would hide it here too.
    side = math.copysign(1.0, grid.lo[0] + grid.hi[0] - 2.0 * lamp.matrix_world.translation.x)
    eye = Vector((side * _EYE[0], *_EYE[1:]))
    for area in (a for screen in screens for a in screen.areas if a.type == "VIEW_3D"):
        view = area.spaces.active.region_3d
        view.view_perspective = "PERSP"
        view.view_location = Vector((low + high) / 2.0)
        view.view_rotation = eye.to_track_quat("Z", "Y")
        view.view_distance = _DISTANCE * float(np.linalg.norm(high - low))
