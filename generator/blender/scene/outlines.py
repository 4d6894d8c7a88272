"""Line drawings of the parts of an experiment that are no objects: voxels, patches, light paths, poses."""

from __future__ import annotations

import math
from dataclasses import replace

import bpy
import numpy as np

from generator.blender.scene import clearance, geometry, roles
from generator.blender.scene.description import read_scene
from generator.blender.scene.words import numbers
from generator.model import poses
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.settings import Sweep

_TURNS = 64
_POSES = 8
"""Largest number of poses that are drawn: enough to show their distribution, and quick to draw."""


def voxels(grid: VoxelGrid) -> tuple[Array, Array]:
    """Return the edges of all voxels, (2 n, 3), two ends each, and the voxels' centres, (voxels, 3), metres."""
    lo, size, shape = np.array(grid.lo), np.array(grid.size), grid.shape
    ends = []
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        first, second = np.meshgrid(*(np.arange(shape[a] + 1) for a in others), indexing="ij")
        lines = np.zeros((first.size, 2, 3))
        lines[:, :, others[0]], lines[:, :, others[1]] = first.reshape(-1, 1), second.reshape(-1, 1)
        lines[:, 1, axis] = shape[axis]
        ends.append(lines)
    edges: Array = (lo + np.concatenate(ends) * size).reshape(-1, 3)
    bounds = [grid.bounds(voxel) for voxel in range(grid.n_voxels)]
    return edges, np.array([(low + high) / 2.0 for low, high in bounds])


def boxes(grid: VoxelGrid) -> Array:
    """Return the triangles of every voxel's box, (voxels, 36, 3), metres."""
    unit = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=np.float64)
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    corners = [corner for a, b, c, d in quads for corner in (a, b, c, a, c, d)]
    lows = np.array([grid.bounds(voxel)[0] for voxel in range(grid.n_voxels)])
    triangles: Array = lows[:, None] + unit[corners] * np.array(grid.size)
    return triangles


def lit_patch(lamp: bpy.types.Object) -> Array:
    """Return the rim of a spot lamp's lit area on the plane y = 0, (n, 3), metres; empty if it is no ellipse."""
    if lamp.type != "LIGHT" or lamp.data.type != "SPOT":
        return np.empty((0, 3))
    matrix = numbers(lamp.matrix_world)
    origin, axes = matrix[:3, 3], matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
    phi = np.linspace(0.0, 2.0 * math.pi, _TURNS, endpoint=False)[:, None]
    rays = -axes[:, 2] + math.tan(lamp.data.spot_size / 2.0) * (np.cos(phi) * axes[:, 0] + np.sin(phi) * axes[:, 1])
    if origin[1] <= 0.0 or (rays[:, 1] >= 0.0).any():
        return np.empty((0, 3))
    rim: Array = origin - rays * (origin[1] / rays[:, 1:2])
    return rim


def closed(corners: Array) -> Array:
    """Return the sides of a polygon (n, 3) as lines, (2 n, 3)."""
    sides: Array = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1).reshape(-1, 3)
    return sides


def watched(scene: bpy.types.Scene) -> Array:
    """Return the corners of the camera's view on the plane y = 0, (4, 3), metres; empty if there is none."""
    try:
        return geometry.view(scene, roles.find(scene, "camera"))[1]
    except NlosError:
        return np.empty((0, 3))


def legs(scene: bpy.types.Scene) -> Array:
    """Return the light path: lamp, w1, target, w2, camera, (5, 3), metres; empty if there is none."""
    rim, corners = lit_patch(roles.find(scene, "spot")), watched(scene)
    if not len(rim) or not len(corners):
        return np.empty((0, 3))
    lamp, target, camera = (roles.find(scene, role).matrix_world.translation for role in ("spot", "target", "camera"))
    axis = -numbers(roles.find(scene, "spot").matrix_world.to_3x3().col[2])
    w1 = numbers(lamp) - axis * (lamp.y / axis[1])
    return np.array([lamp, w1, target, corners.mean(axis=0), camera], dtype=np.float64)


def sampled(scene: bpy.types.Scene, sweep: Sweep) -> Array:
    """Return the target's positions in the first poses of a sweep, (n, 3), metres.

    Raises
    ------
    NlosError
        The scene cannot be read, or the target fits nowhere.
    """
    described = read_scene(scene)
    preview = replace(sweep, poses=min(sweep.poses, _POSES))
    is_free = clearance.clearance(scene, described, engine=preview.engine)
    return np.array([pose.position for pose in poses.plan(described.grid, preview, geometry.hull(scene), is_free)])
