"""Where a target may stand: clear of all other surfaces, and hidden from the lamp and from the camera."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector
from mathutils.bvhtree import BVHTree
from numpy.typing import NDArray

from generator import spec, stage
from generator.spec import Array

_RIM = 32
"""Corners of the polygon around what the lamp lights."""

_SURFACES = ("MESH", "CURVE", "SURFACE", "META", "FONT")


Free = Callable[[spec.Vector, spec.Vector], bool]
"""Whether an object at a position and rotation cuts no other surface and is hidden from lamp and camera."""


def clearance(scene: bpy.types.Scene, described: spec.Scene, *, engine: str) -> Free:
    """Return the test whether the target at a pose cuts no other surface and is hidden from lamp and camera.

    The engine `path` renders a target in the lamp's cone or in the camera's view too, so it may stand there.
    """
    target = stage.find(scene, "target")
    vertices, faces = _polygons(target, bpy.context.evaluated_depsgraph_get())
    scale = Matrix.LocRotScale(None, None, target.matrix_world.to_scale())
    return Surroundings(scene, described, engine=engine).free(np.array([scale @ v for v in vertices]), faces)


class Surroundings:
    """What an object must be clear of.

    Parameters
    ----------
    scene : bpy.types.Scene
    described : spec.Scene
    engine : str
    """

    def __init__(self, scene: bpy.types.Scene, described: spec.Scene, *, engine: str) -> None:
        self._surfaces = obstacles(scene)
        self._hidden_from = [] if engine == "path" else sights(scene, described.spot)

    def free(self, vertices: Array, faces: Sequence[Sequence[int]]) -> Free:
        """Return the test for an object of some vertices (n, 3), in its own frame, and faces."""
        shape = vertices.reshape(-1, 3)
        radius = float(np.linalg.norm(shape, axis=1).max(initial=0.0))

        def is_free(position: spec.Vector, rotation: spec.Vector) -> bool:
            near = [tree for tree in self._surfaces if tree.find_nearest(Vector(position), radius)[0] is not None]
            sighted = [sight for sight in self._hidden_from if sight.may_hold(position, radius)]
            if not near and not sighted:
                return True
            turn = spec.rotation_matrix(rotation)
            corners = shape @ turn.T + position
            if any(sight.holds(corners) for sight in sighted):
                return False
            placed = BVHTree.FromPolygons(corners.tolist(), faces)
            return not any(placed.overlap(tree) for tree in [*near, *(sight.sides for sight in sighted)])

        return is_free


def obstacles(scene: bpy.types.Scene) -> list[BVHTree]:
    """Return every rendered surface but the target's, as a tree each; instances of collections too."""
    parts = stage.target_parts(scene)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    rendered = [obj for obj in scene.objects if obj not in parts and not stage.unseen(scene, obj)]
    trees = []
    for obj in rendered:
        if obj.type in _SURFACES:
            vertices, faces = _polygons(obj, depsgraph)
            trees.append(BVHTree.FromPolygons([obj.matrix_world @ v for v in vertices], faces))
    for instance in depsgraph.object_instances:
        if not instance.is_instance or instance.object.type not in _SURFACES:
            continue
        if instance.parent.original in rendered and not instance.object.hide_render:
            vertices, faces = _mesh_of(instance.object)
            trees.append(BVHTree.FromPolygons([instance.matrix_world @ v for v in vertices], faces))
    return trees


def sights(scene: bpy.types.Scene, spot: spec.Spot) -> list[Sight]:
    """Return what the lamp lights and what the camera sees on its way to the wall, the plane y = 0."""
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

    return [Sight(np.tile(lamp, (_RIM, 1)), lit), Sight(*stage.view(scene, stage.find(scene, "camera")))]


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

    def may_hold(self, centre: spec.Vector, radius: float) -> bool:
        """Whether part of a sphere may be inside; a no is sure."""
        return bool((self._normals @ centre - self._levels > -radius).all())

    def holds(self, points: Array) -> bool:
        """Whether one of points (n, 3) is inside."""
        return bool(self.inside(points).any())

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Return which of points (n, 3) are inside."""
        within: NDArray[np.bool_] = (points @ self._normals.T > self._levels).all(axis=1)
        return within


def _polygons(obj: bpy.types.Object, depsgraph: Any) -> tuple[list[Vector], list[tuple[int, ...]]]:
    return _mesh_of(obj.evaluated_get(depsgraph))


def _mesh_of(evaluated: bpy.types.Object) -> tuple[list[Vector], list[tuple[int, ...]]]:
    mesh = evaluated.to_mesh()
    if mesh is None:  # its modifiers leave only curves, points or a volume
        return [], []
    vertices = [v.co.copy() for v in mesh.vertices]
    faces = [tuple(p.vertices) for p in mesh.polygons]
    evaluated.to_mesh_clear()
    return vertices, faces
