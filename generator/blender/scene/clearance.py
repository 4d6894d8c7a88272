"""Tests whether a target's pose is clear of all other surfaces and hidden from the lamp and from the camera."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import bpy
import mathutils
import numpy as np
from mathutils.bvhtree import BVHTree
from numpy.typing import NDArray

from generator.blender.scene import geometry, roles
from generator.model.arrays import Array, Vector, rotation_matrix
from generator.model.scene import Scene, Spot

_RIM = 32
"""Number of corners of the polygon around the area that the lamp lights."""

_SOME = 8
"""Number of corners of an object that are tested for lying inside solids."""
_LIFT = 1e-4
"""Distance from the wall of the point where light is taken to start, in units of the lamp's distance."""

Free = Callable[[Vector, Vector], bool]
"""Test whether an object at a position and rotation is clear of all others and hidden from lamp and camera."""


def clearance(scene: bpy.types.Scene, described: Scene, *, engine: str) -> Free:
    """Return a test of whether the target at a pose is clear of all else and hidden from lamp and camera.

    With the engine `path` the target may also stand in the lamp's cone or in the camera's view.
    """
    seen = geometry.snapshot(scene)
    return Surroundings(scene, described, engine=engine, seen=seen).free(*geometry.target_shape(scene, seen))


class Surroundings:
    """The surfaces and volumes that an object must be clear of.

    Parameters
    ----------
    scene : bpy.types.Scene
    described : Scene
    engine : str
    seen : Snapshot, optional
        Snapshot of the scene; taken if not given.
    """

    def __init__(
        self, scene: bpy.types.Scene, described: Scene, *, engine: str, seen: geometry.Snapshot | None = None
    ) -> None:
        seen = seen or geometry.snapshot(scene)
        shapes = others(scene, seen)
        self._surfaces = [_tree(shape.placed, shape.triangles) for shape in shapes]
        self._corners = [shape.placed[0] for shape in shapes]
        closed = [Solid.of(shape.placed, shape.triangles) for shape in shapes if shape.opaque]
        solids = [solid for solid in closed if solid]
        # Light starts at this point. A room that is one closed mesh contains it, and must contain the object too.
        lamp, lit = np.array(described.spot.location), np.array(described.spot.aim)
        start = lit + _LIFT * (lamp - lit)
        self._solids = [(solid, solid.holds(start)) for solid in solids]
        self._hidden_from = [] if engine == "path" else sights(scene, described.spot, seen)

    def free(self, vertices: Array, triangles: Any) -> Free:
        """Return the test for an object with vertices (n, 3), in its own frame, and triangles (m, 3)."""
        shape = vertices.reshape(-1, 3)
        radius = float(np.linalg.norm(shape, axis=1).max(initial=0.0))
        body = Solid.of(shape, np.asarray(triangles))
        samples = shape[np.unique(np.linspace(0, len(shape) - 1, _SOME).astype(int))]  # there may be several pieces

        def is_free(position: Vector, rotation: Vector) -> bool:
            turn = rotation_matrix(rotation)
            if any(
                solid.holds(turn @ point + position) != encloses
                for solid, encloses in self._solids
                for point in samples
            ):
                return False
            if body and any(body.holds((corner - position) @ turn) for corner in self._corners):
                return False
            near_trees = [
                tree
                for tree in self._surfaces
                if tree.find_nearest(mathutils.Vector(position), radius)[0] is not None
            ]
            near_sights = [sight for sight in self._hidden_from if sight.may_hold(position, radius)]
            if not near_trees and not near_sights:
                return True
            corners = shape @ turn.T + position
            if any(sight.holds(corners) for sight in near_sights):
                return False
            placed = _tree(corners, triangles)
            return not any(placed.overlap(tree) for tree in [*near_trees, *(sight.sides for sight in near_sights)])

        return is_free


class Solid:
    """A closed surface, with the volume inside.

    Parameters
    ----------
    corners : ndarray of shape (n, 3, 3)
        Corners of its triangles.
    """

    def __init__(self, corners: Array) -> None:
        self._corners = corners
        self._low, self._high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))

    @classmethod
    def of(cls, vertices: Array, triangles: Any) -> Solid | None:
        """Return the solid that triangles (m, 3) of vertices (n, 3) enclose, or None if they leave an edge open."""
        if not len(triangles):
            return None
        _, indices = np.unique(vertices, axis=0, return_inverse=True)  # a corner may be stored once per face
        welded = indices.reshape(-1)[triangles]
        edges = np.sort(np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]]), axis=1)
        edges = edges[edges[:, 0] != edges[:, 1]]
        _, counts = np.unique(edges, axis=0, return_counts=True)
        return cls(vertices[triangles]) if len(counts) and (counts % 2 == 0).all() else None

    def holds(self, point: Array) -> bool:
        """Whether a point (3,) is inside: a ray from it crosses the surface an odd number of times."""
        if not ((point > self._low) & (point < self._high)).all():
            return False
        direction = np.array([0.8164, 0.3333, 0.4714])  # unlikely to be parallel to modelled edges
        a = self._corners[:, 0] - point
        first, second = self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0]
        normals = np.cross(first, second)
        slope = normals @ direction
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (normals * a).sum(axis=1) / slope
            across = np.cross(direction, a)
            u, v = -(across * second).sum(axis=1) / slope, (across * first).sum(axis=1) / slope
        return bool(((slope != 0) & (distance > 0) & (u >= 0) & (v >= 0) & (u + v <= 1)).sum() % 2)


def others(scene: bpy.types.Scene, seen: geometry.Snapshot) -> list[geometry.Shape]:
    """Return every rendered surface except the target's, including instances but not the bounds of volumes."""
    parts = roles.target_parts(scene)
    return [s for s in seen.shapes if s.owner not in parts and len(s.triangles) and not s.air]


def obstacles(scene: bpy.types.Scene) -> list[BVHTree]:
    """Return every rendered surface except the target's, including instances, as one BVH tree each."""
    return [_tree(shape.placed, shape.triangles) for shape in others(scene, geometry.snapshot(scene))]


def _tree(corners: Array, triangles: Any) -> BVHTree:
    return BVHTree.FromPolygons(corners.tolist(), np.asarray(triangles).tolist())


def sights(scene: bpy.types.Scene, spot: Spot, seen: geometry.Snapshot | None = None) -> list[Sight]:
    """Return the volumes that the lamp lights and that the camera sees, up to the wall, the plane y = 0."""
    seen = seen or geometry.snapshot(scene)
    lamp, aim = np.array(spot.location), np.array(spot.aim)
    axis = (aim - lamp) / np.linalg.norm(aim - lamp)
    across = np.cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    angles = np.linspace(0.0, 2.0 * math.pi, _RIM, endpoint=False)[:, None]
    rim = np.cos(angles) * across + np.sin(angles) * np.cross(axis, across)
    directions = axis + math.tan(math.radians(spot.half_angle)) / math.cos(math.pi / _RIM) * rim
    # A cone so wide that part of it misses the wall is cut off far away.
    slopes = np.maximum(-directions[:, 1:2], 1e-3)
    lit = lamp + directions * (lamp[1] / slopes)

    starts, corners = geometry.view(scene, roles.find(scene, "camera"), seen.matrices["camera"])
    return [Sight(np.tile(lamp, (_RIM, 1)), lit), Sight(starts, corners)]


class Sight:
    """The convex volume that a lamp lights or a camera sees, up to the wall.

    Parameters
    ----------
    near, far : ndarray of shape (k, 3)
        Corresponding corners of its two ends; those of the near end may coincide.
    """

    def __init__(self, near: Array, far: Array) -> None:
        k = len(far)
        quads = [(i, (i + 1) % k, k + (i + 1) % k, k + i) for i in range(k)]
        ends = [tuple(range(k)), tuple(range(k, 2 * k))]
        self._near, self._far = near, far
        corners = np.concatenate([near, far])
        self.sides = BVHTree.FromPolygons(corners.tolist(), [*quads, *ends])
        next_far = np.roll(far, -1, axis=0)
        face_normals, face_points = [np.cross(next_far - far, near - far)], [far]
        for end in (near, far):
            cap = np.cross(end[1:2] - end[:1], end[2:3] - end[:1])
            if cap.any():  # the near end of a cone has no area
                face_normals.append(cap)
                face_points.append(end[:1])
        normals, points = np.concatenate(face_normals), np.concatenate(face_points)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        inward = np.sign(((corners.mean(axis=0) - points) * normals).sum(axis=1))
        self._normals, self._levels = inward[:, None] * normals, inward * (points * normals).sum(axis=1)

    def rays(self, rings: Sequence[float]) -> tuple[Array, Array]:
        """Return the start and end points, (n, 3) each, of rays along its edges and in rings inside them."""
        ends = [
            np.concatenate([e.mean(axis=0) + r * (e - e.mean(axis=0)) for r in rings])
            for e in (self._near, self._far)
        ]
        return ends[0], ends[1]

    def may_hold(self, centre: Vector, radius: float) -> bool:
        """Whether part of a sphere may be inside; False is certain."""
        return bool((self._normals @ centre - self._levels > -radius).all())

    def holds(self, points: Array) -> bool:
        """Whether any of the points (n, 3) is inside."""
        return bool(self.inside(points).any())

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Return which of the points (n, 3) are inside."""
        within: NDArray[np.bool_] = (points @ self._normals.T > self._levels).all(axis=1)
        return within
