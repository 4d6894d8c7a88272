"""Where a target may stand: clear of all other surfaces, and hidden from the lamp and from the camera."""

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
"""Corners of the polygon around what the lamp lights."""

_SOME = 8
"""Corners of an object that are looked for inside solids."""
_LIFT = 1e-4
"""How far before the wall one looks from where the lamp shines, in the lamp's distance."""

Free = Callable[[Vector, Vector], bool]
"""Whether an object at a position and rotation is clear of all others and hidden from lamp and camera."""


def clearance(scene: bpy.types.Scene, described: Scene, *, engine: str) -> Free:
    """Return the test whether the target at a pose is clear of all else and hidden from lamp and camera.

    The engine `path` renders a target in the lamp's cone or in the camera's view too, so it may stand there.
    """
    seen = geometry.snapshot(scene)
    return Surroundings(scene, described, engine=engine, seen=seen).free(*geometry.target_shape(scene, seen))


class Surroundings:
    """What an object must be clear of.

    Parameters
    ----------
    scene : bpy.types.Scene
    described : Scene
    engine : str
    seen : Snapshot, optional
        Of the scene; it is looked at if not given.
    """

    def __init__(
        self, scene: bpy.types.Scene, described: Scene, *, engine: str, seen: geometry.Snapshot | None = None
    ) -> None:
        seen = seen or geometry.snapshot(scene)
        around = others(scene, seen)
        self._surfaces = [_tree(shape.placed, shape.triangles) for shape in around]
        self._corners = [shape.placed[0] for shape in around]
        closed = [Solid.of(shape.placed, shape.triangles) for shape in around if shape.opaque]
        solids = [solid for solid in closed if solid]
        # Light starts here. A room that is one closed mesh holds this point too, and is not in the way.
        lamp, lit = np.array(described.spot.location), np.array(described.spot.aim)
        start = lit + _LIFT * (lamp - lit)
        self._solids = [(solid, solid.holds(start)) for solid in solids]
        self._hidden_from = [] if engine == "path" else sights(scene, described.spot, seen)

    def free(self, vertices: Array, triangles: Any) -> Free:
        """Return the test for an object of some vertices (n, 3), in its own frame, and triangles (m, 3)."""
        shape = vertices.reshape(-1, 3)
        radius = float(np.linalg.norm(shape, axis=1).max(initial=0.0))
        own = Solid.of(shape, np.asarray(triangles))
        some = shape[np.unique(np.linspace(0, len(shape) - 1, _SOME).astype(int))]  # it may be of several pieces

        def is_free(position: Vector, rotation: Vector) -> bool:
            turn = rotation_matrix(rotation)
            if any(
                solid.holds(turn @ point + position) != around for solid, around in self._solids for point in some
            ):
                return False
            if own and any(own.holds((corner - position) @ turn) for corner in self._corners):
                return False
            near = [
                tree
                for tree in self._surfaces
                if tree.find_nearest(mathutils.Vector(position), radius)[0] is not None
            ]
            sighted = [sight for sight in self._hidden_from if sight.may_hold(position, radius)]
            if not near and not sighted:
                return True
            corners = shape @ turn.T + position
            if any(sight.holds(corners) for sight in sighted):
                return False
            placed = _tree(corners, triangles)
            return not any(placed.overlap(tree) for tree in [*near, *(sight.sides for sight in sighted)])

        return is_free


class Solid:
    """A closed surface, which has an inside.

    Parameters
    ----------
    corners : ndarray of shape (n, 3, 3)
        Of its triangles.
    """

    def __init__(self, corners: Array) -> None:
        self._corners = corners
        self._low, self._high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))

    @classmethod
    def of(cls, vertices: Array, triangles: Any) -> Solid | None:
        """Return the solid that triangles (m, 3) of vertices (n, 3) enclose, or None if they leave an edge open."""
        if not len(triangles):
            return None
        _, same = np.unique(vertices, axis=0, return_inverse=True)  # corners may be split, one for each face
        welded = same.reshape(-1)[triangles]
        edges = np.sort(np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]]), axis=1)
        edges = edges[edges[:, 0] != edges[:, 1]]
        _, counts = np.unique(edges, axis=0, return_counts=True)
        return cls(vertices[triangles]) if len(counts) and (counts % 2 == 0).all() else None

    def holds(self, point: Array) -> bool:
        """Whether a point (3,) is inside: a ray from there leaves through the surface an odd number of times."""
        if not ((point > self._low) & (point < self._high)).all():
            return False
        way = np.array([0.8164, 0.3333, 0.4714])  # along no edge of what people build
        a = self._corners[:, 0] - point
        first, second = self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0]
        normals = np.cross(first, second)
        slope = normals @ way
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (normals * a).sum(axis=1) / slope
            across = np.cross(way, a)
            u, v = -(across * second).sum(axis=1) / slope, (across * first).sum(axis=1) / slope
        return bool(((slope != 0) & (distance > 0) & (u >= 0) & (v >= 0) & (u + v <= 1)).sum() % 2)


def others(scene: bpy.types.Scene, seen: geometry.Snapshot) -> list[geometry.Shape]:
    """Return every rendered surface but the target's, instances too; fog is none."""
    parts = roles.target_parts(scene)
    return [s for s in seen.shapes if s.owner not in parts and len(s.triangles) and not s.air]


def obstacles(scene: bpy.types.Scene) -> list[BVHTree]:
    """Return every rendered surface but the target's, as a tree each; instances too."""
    return [_tree(shape.placed, shape.triangles) for shape in others(scene, geometry.snapshot(scene))]


def _tree(corners: Array, triangles: Any) -> BVHTree:
    return BVHTree.FromPolygons(corners.tolist(), np.asarray(triangles).tolist())


def sights(scene: bpy.types.Scene, spot: Spot, seen: geometry.Snapshot | None = None) -> list[Sight]:
    """Return what the lamp lights and what the camera sees on its way to the wall, the plane y = 0."""
    seen = seen or geometry.snapshot(scene)
    lamp, aim = np.array(spot.location), np.array(spot.aim)
    axis = (aim - lamp) / np.linalg.norm(aim - lamp)
    across = np.cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    turn = np.linspace(0.0, 2.0 * math.pi, _RIM, endpoint=False)[:, None]
    around = np.cos(turn) * across + np.sin(turn) * np.cross(axis, across)
    ways = axis + math.tan(math.radians(spot.half_angle)) / math.cos(math.pi / _RIM) * around
    # A cone so wide that some of it misses the wall ends far away.
    falls = np.maximum(-ways[:, 1:2], 1e-3)
    lit = lamp + ways * (lamp[1] / falls)

    starts, corners = geometry.view(scene, roles.find(scene, "camera"), seen.matrices["camera"])
    return [Sight(np.tile(lamp, (_RIM, 1)), lit), Sight(starts, corners)]


class Sight:
    """What a lamp lights or a camera sees on its way to the wall: a convex solid.

    Parameters
    ----------
    near, far : ndarray of shape (k, 3)
        Corners of its two ends, one as the other; those of the near one may be the same point.
    """

    def __init__(self, near: Array, far: Array) -> None:
        k = len(far)
        quads = [(i, (i + 1) % k, k + (i + 1) % k, k + i) for i in range(k)]
        ends = [tuple(range(k)), tuple(range(k, 2 * k))]
        self._near, self._far = near, far
        corners = np.concatenate([near, far])
        self.sides = BVHTree.FromPolygons(corners.tolist(), [*quads, *ends])
        after = np.roll(far, -1, axis=0)
        across, through = [np.cross(after - far, near - far)], [far]
        for end in (near, far):
            cap = np.cross(end[1:2] - end[:1], end[2:3] - end[:1])
            if cap.any():  # the near end of a cone has none
                across.append(cap)
                through.append(end[:1])
        normals, on = np.concatenate(across), np.concatenate(through)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        inward = np.sign(((corners.mean(axis=0) - on) * normals).sum(axis=1))
        self._normals, self._levels = inward[:, None] * normals, inward * (on * normals).sum(axis=1)

    def rays(self, rings: Sequence[float]) -> tuple[Array, Array]:
        """Return where rays through it start and end, (n, 3) each: along its edges, and in rings inside them."""
        made = [
            np.concatenate([e.mean(axis=0) + r * (e - e.mean(axis=0)) for r in rings])
            for e in (self._near, self._far)
        ]
        return made[0], made[1]

    def may_hold(self, centre: Vector, radius: float) -> bool:
        """Whether part of a sphere may be inside; a no is sure."""
        return bool((self._normals @ centre - self._levels > -radius).all())

    def holds(self, points: Array) -> bool:
        """Whether one of points (n, 3) is inside."""
        return bool(self.inside(points).any())

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Return which of points (n, 3) are inside."""
        within: NDArray[np.bool_] = (points @ self._normals.T > self._levels).all(axis=1)
        return within
