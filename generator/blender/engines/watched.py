"""The part of the wall that the camera sees, which holds w2 of every path."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from generator.blender.engines.planes import (
    NOTHING,
    Plane,
    colour_within,
    covered,
    cut_areas,
    near_plane,
    plane_of,
    polygon_area,
    pyramid,
)
from generator.blender.engines.surface import CORNERS, EDGE, Reading
from generator.blender.scene import roles
from generator.blender.scene.words import numbers
from generator.model.arrays import Array
from generator.transport.world import Watched


def read_watched(
    scene: bpy.types.Scene, reading: Reading, resolution: tuple[int, int]
) -> tuple[Watched | None, list[str]]:
    """Return the part of the wall that the camera sees, or None, and what an engine cannot honour about it."""
    camera, wall = roles.find(scene, "camera"), roles.find(scene, "relay_wall")
    name = f"the camera {camera.name!r}"
    if camera.type != "CAMERA" or camera.data.type not in ("PERSP", "ORTHO"):
        return None, [f"{name} is neither perspective nor orthographic"]
    lens = camera.data
    reasons = []
    if lens.dof.use_dof:
        reasons.append(f"{name} has depth of field")
    surfaces = [s for s in reading.surfaces if s.role != "target"]
    walls = [s.triangles for s in surfaces if s.role == "relay_wall"]
    if not walls:
        return None, [*reasons, f"the relay wall {wall.name!r} is hidden from renders, or has no surface"]
    triangles = np.concatenate(walls)
    point, normal = plane_of(triangles)
    size = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    matrix = reading.places.get("camera", numbers(camera.matrix_world))
    # Blender ignores the scale of cameras.
    frame, eye = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0), matrix[:3, 3]
    if (eye - point) @ normal < 0:
        normal = -normal
    corners = [frame @ np.asarray(c, dtype=np.float64) for c in lens.view_frame(scene=scene)]
    forward = -frame[:, 2]
    project = _parallel if lens.type == "ORTHO" else _central
    projected = project(corners, forward, eye, normal, point, size)
    if projected is None:
        return None, [*reasons, f"{name} sees beyond the plane of the relay wall {wall.name!r}"]
    to_wall, seen_from = projected
    watched = Watched(
        to_wall=to_wall,
        eye=seen_from,
        normal=normal,
        albedo=np.zeros(3),
        resolution=resolution,
    )
    depths = (watched.points(CORNERS) - eye) @ forward
    if depths.min() < lens.clip_start or depths.max() > lens.clip_end:
        reasons.append(f"{name} clips the relay wall {wall.name!r}")
    outline = watched.points(EDGE + (1.0 - 2.0 * EDGE) * CORNERS)
    sides = pyramid(outline, seen_from)
    slack = 1e-4 * float(depths.min())
    colour = colour_within(
        [s for s in surfaces if s.role == "relay_wall"], [*sides, *near_plane(normal, point, slack)]
    )
    if colour is None:
        reasons.append(f"the relay wall {wall.name!r} has more than one colour where {name} sees it")
    else:
        watched = replace(watched, albedo=colour)
    view_volume = [
        *sides,
        Plane(normal, float(normal @ point) + slack),
        Plane(forward, float(forward @ eye) + lens.clip_start),
    ]
    threshold = NOTHING * polygon_area(outline)
    for surface in surfaces:
        if surface.seen and surface.role == "room" and cut_areas(surface.triangles, view_volume).sum() > threshold:
            reasons.append(f"{surface.label} stands between {name} and the relay wall")
    for lamp in reading.glowing:
        if lamp.seen and cut_areas(lamp.triangles, view_volume).sum() > threshold:
            reasons.append(f"the lamp {lamp.name!r} stands between {name} and the relay wall")
    if not covered(surfaces, sides, point, normal, outline, slack):
        reasons.append(f"{name} sees beyond the edge of the relay wall {wall.name!r}")
    return watched, list(dict.fromkeys(reasons))


def _parallel(
    corners: list[Array], forward: Array, eye: Array, normal: Array, point: Array, _: float
) -> tuple[Array, Array] | None:
    """Return an orthographic camera's map from the picture, (u, v, 1), to the wall, and its eye, both homogeneous;
    None if it sees beyond the wall's plane.

    ``corners`` (3,) of its frame are relative to the eye, as Blender orders them; ``normal`` and ``point`` are the
    wall's.
    """
    slope = float(-forward @ normal)
    if slope <= 1e-9:
        return None
    right_top, _bottom, left_bottom, left_top = corners
    # The frame's corners lie in front of the camera; only their position across its axis matters.
    start = np.column_stack([right_top - left_top, left_bottom - left_top, eye + left_top])
    start_height = normal @ start - np.array([0.0, 0.0, normal @ point])
    to_wall = np.zeros((4, 3))
    to_wall[:3] = start + np.outer(forward, start_height / slope)
    to_wall[3] = 0.0, 0.0, 1.0
    middle = to_wall[:3] @ np.array([0.5, 0.5, 1.0])
    return to_wall, np.append(-forward * float((middle - eye) @ forward), 0.0)


def _central(
    corners: list[Array], _: Array, eye: Array, normal: Array, point: Array, size: float
) -> tuple[Array, Array] | None:
    """As `_parallel`, for a perspective camera; ``size`` is the wall's."""
    right_top, _bottom, left_bottom, left_top = corners
    height = float((eye - point) @ normal)
    rays = np.column_stack([right_top - left_top, left_bottom - left_top, left_top])
    rays = rays / np.abs(rays).max()
    # The homogeneous point where a ray meets the plane has the ray's slope towards the wall as last component.
    slopes = -normal @ rays
    if (np.column_stack([CORNERS, np.ones(4)]) @ slopes <= 1e-9).any() or height <= 1e-9 * size:
        return None
    return np.concatenate([height * rays + np.outer(eye, slopes), [slopes]]), np.append(eye, 1.0)
