"""Visibility and direct light between points of a scene, as a render treats them."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from generator.blender.engines.surface import Light
from generator.blender.scene import clearance, geometry, roles
from generator.model.arrays import Array

_STEPS = np.linspace(0.0, 1.0, 200)
"""Sample points along a ray, relative to its length."""
_SHORT = 1e-4
"""Share of its length that a ray leaves out at both ends, where it would hit the surface that it starts from."""
_MOST = 24
"""Most points that represent a light with a surface."""
_NARROW = math.radians(60.0)
"""Largest half angle of a cone that may cross a voxel and still miss all of its sample points."""
_RAYS = ("diffuse", "glossy", "transmission")
_BARYCENTRIC = np.array(
    [[1, 1, 1], [5, 1, 1], [1, 5, 1], [1, 1, 5], [2, 2, 1], [1, 2, 2], [2, 1, 2]], dtype=np.float64
)


@dataclass(frozen=True)
class _Obstacle:
    objects: tuple[bpy.types.Object, ...]
    corners: Array
    triangles: Any


def _tree(obstacles: Sequence[_Obstacle]) -> BVHTree:
    """Return one tree of all triangles: a ray is cast once, not once an obstacle."""
    starts = np.cumsum([0, *(len(o.corners) for o in obstacles)])
    corners = [corner for o in obstacles for corner in o.corners.tolist()]
    triangles = [t for o, start in zip(obstacles, starts, strict=False) for t in (o.triangles + start).tolist()]
    return BVHTree.FromPolygons(corners, triangles)


class Eyes:
    """Visibility between points past all surfaces but the target.

    Parameters
    ----------
    obstacles : sequence of _Obstacle
    size : float
        Diagonal of the scene, metres: no two obstacles are farther apart.
    """

    def __init__(self, obstacles: Sequence[_Obstacle], size: float) -> None:
        self._obstacles = obstacles
        self._tree = _tree(obstacles)
        self.size = size

    @classmethod
    def of(cls, scene: bpy.types.Scene, seen: geometry.Snapshot) -> Eyes:
        """Return the visibility in a scene in which every surface is an obstacle."""
        obstacles, corners = [], [np.zeros((0, 3))]
        for shape in clearance.others(scene, seen):
            placed = shape.placed
            instanced = bpy.data.objects.get(shape.name)
            objects = (shape.owner, instanced) if instanced is not None else (shape.owner,)
            obstacles.append(_Obstacle(objects, placed, np.asarray(shape.triangles)))
            corners.append(placed)
        points = np.concatenate(corners)
        return cls(obstacles, float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 1.0)

    def rays(self, kind: str) -> Eyes:
        """Return the visibility if the only obstacles are those visible to a kind of rays ("shadow", "camera")."""
        kept = [o for o in self._obstacles if all(getattr(obj, f"visible_{kind}") for obj in o.objects)]
        return Eyes(kept, self.size)

    def of_lamp(self, lamp: bpy.types.Object | None) -> Eyes:
        """Return the visibility if the only obstacles are those that cast a shadow in a lamp's light."""
        if lamp is None:
            return self.rays("shadow")
        if lamp.type == "LIGHT" and not (lamp.data.use_shadow and getattr(lamp.data.cycles, "cast_shadow", True)):
            return Eyes([], self.size)
        blockers = getattr(getattr(lamp, "light_linking", None), "blocker_collection", None)
        return Eyes([o for o in self.rays("shadow")._obstacles if _linked(blockers, o.objects)], self.size)

    def open(self, start: Array, end: Array) -> bool:
        """Whether nothing stands between two points, each of shape (3,)."""
        return bool(self.clear(start[None], end[None])[0])

    def between(self, start: Array, end: Array) -> str:
        """Return the name of the first object between two points, each of shape (3,); empty if there is none."""
        way = Vector(end - start)
        index = self._tree.ray_cast(
            Vector(start) + _SHORT * way, way.normalized(), (1.0 - 2.0 * _SHORT) * way.length
        )[2]
        if index is None:
            return ""
        ends = np.cumsum([len(o.triangles) for o in self._obstacles])
        return str(self._obstacles[int(np.searchsorted(ends, index, side="right"))].objects[0].name)

    def clear(self, starts: Array, ends: Array) -> Array:
        """Return whether nothing stands between each of starts (n, 3) and its end (n, 3), as an array (n,)."""
        offsets = ends - starts
        lengths = np.linalg.norm(offsets, axis=1)
        directions = offsets / np.where(lengths > 0.0, lengths, 1.0)[:, None]
        origins, reaches = starts + _SHORT * offsets, (1.0 - 2.0 * _SHORT) * lengths
        lines = zip(origins.tolist(), directions.tolist(), reaches.tolist(), strict=True)
        cast = self._tree.ray_cast
        return np.array([not reach or cast(origin, way, reach)[0] is None for origin, way, reach in lines])

    def passed(self, starts: Array, ends: Array) -> Array:
        """Return points (m, 3) along rays from starts (n, 3) to ends (n, 3), each up to the first obstacle."""
        segments = []
        for start, end in zip(starts, ends, strict=True):
            origin, offset = Vector(start), Vector(end - start)
            length = offset.length
            hit = self._tree.ray_cast(origin, offset.normalized(), length)[3]
            reach = (length if hit is None else hit) / (length or 1.0)
            segments.append(start + reach * _STEPS[:, None] * (end - start))
        points: Array = np.concatenate(segments)
        return points

    def share(self, starts: Array, ends: Array) -> Array:
        """Return the unblocked share of the lines from each of starts (n, 3) to all ends (m, 3), as an array (n,)."""
        is_clear = self.clear(np.repeat(starts, len(ends), axis=0), np.tile(ends, (len(starts), 1)))
        shares: Array = is_clear.reshape(len(starts), len(ends)).mean(axis=1)
        return shares


class Beam:
    """Direct light of one lamp.

    Parameters
    ----------
    light : Light
    eyes : Eyes
        Visibility in the scene.

    Attributes
    ----------
    points : ndarray of shape (n, 3)
        Position of the light, or some points of its surface.
    """

    def __init__(self, light: Light, eyes: Eyes) -> None:
        self._object = bpy.data.objects.get(light.name)
        self._eyes = eyes.of_lamp(self._object)
        self._sun = light.kind == "SUN"
        self.points, self._half = _shape(light, self._object)
        axis = -light.matrix[:3, 2]
        self._axis = axis / (np.linalg.norm(axis) or 1.0)

    @property
    def counts(self) -> bool:
        """Whether the light illuminates anything at all."""
        return self._object is None or any(getattr(self._object, f"visible_{kind}") for kind in _RAYS)

    def meets(self, receiver: bpy.types.Object, points: Array) -> bool:
        """Whether the light reaches one of points (n, 3): of the target, at any place, or of the wall's front."""
        if self._object is not None and not self._lights(receiver):
            return False
        return any(self._reaches(point, front=receiver.get(roles.ROLE) == "relay_wall") for point in points)

    def passes(self, receiver: bpy.types.Object, low: Array, high: Array) -> bool:
        """Whether a narrow cone of light crosses a box, given by its lowest and highest corner (3,)."""
        if self._sun or self._half > _NARROW or (self._object is not None and not self._lights(receiver)):
            return False
        starts, directions = self._cone()
        along = self._eyes.passed(starts, starts + 2.0 * self._eyes.size * directions)
        return bool(((along > low) & (along < high)).all(axis=1).any())

    def _cone(self) -> tuple[Array, Array]:
        across = np.cross(self._axis, np.eye(3)[int(np.argmin(np.abs(self._axis)))])
        across /= np.linalg.norm(across)
        angles = np.linspace(0.0, 2.0 * math.pi, 12, endpoint=False)[:, None]
        radial = np.cos(angles) * across + np.sin(angles) * np.cross(self._axis, across)
        tangents = [math.tan(share * self._half) for share in (0.0, 0.5, 0.95)]
        directions = np.concatenate([self._axis + tangent * radial for tangent in tangents])
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return np.tile(self.points[0], (len(directions), 1)), directions

    def _reaches(self, point: Array, *, front: bool) -> bool:
        """Whether the light reaches a point; if `front`, from in front of the wall, which is the plane y = 0."""
        if self._sun:
            in_front = not front or self._axis[1] < 0.0
            return in_front and self._eyes.open(point - 2.0 * self._eyes.size * self._axis, point)
        offsets = point - self.points
        lengths = np.linalg.norm(offsets, axis=1)
        ahead = offsets @ self._axis >= math.cos(self._half) * lengths
        if front:
            ahead &= offsets[:, 1] < 0.0
        return any(self._eyes.open(start, point) for start in self.points[ahead])

    def _lights(self, receiver: bpy.types.Object) -> bool:
        """Whether an object may reflect the light's rays at all."""
        lamp: Any = self._object
        # The target's material may change, so every kind of ray counts; the wall is diffuse.
        kinds = _RAYS if receiver.get(roles.ROLE) == "target" else ("diffuse",)
        if not any(getattr(lamp, f"visible_{kind}") for kind in kinds):
            return False
        linking = getattr(lamp, "light_linking", None)
        return _linked(getattr(linking, "receiver_collection", None), (receiver,))


def _shape(light: Light, lamp: Any) -> tuple[Array, float]:
    """Return points of a light (n, 3), and the half angle of the cone around its axis into which it shines."""
    position = light.matrix[:3, 3]
    if light.kind == "SPOT" and lamp is not None:
        return position[None], lamp.data.spot_size / 2.0
    if light.kind == "AREA" and lamp is not None:
        data = lamp.data
        width = data.size
        height = data.size_y if data.shape in ("RECTANGLE", "ELLIPSE") else width
        local = np.array([[0.0, 0.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) * (
            0.35 * width,
            0.35 * height,
        )
        # An area lamp emits on one side only.
        return position + local @ light.matrix[:3, :2].T, min(data.spread / 2.0, math.radians(89.9))
    if not len(light.corners):
        return position[None], math.pi
    count = min(len(light.corners), _MOST)
    triangles = light.corners[np.linspace(0, len(light.corners) - 1, count).astype(int)]
    weights = _BARYCENTRIC[: max(1, _MOST // count)]
    weights = weights / weights.sum(axis=1, keepdims=True)
    return (weights @ triangles).reshape(-1, 3), math.pi


def _linked(collection: Any, objects: Collection[bpy.types.Object]) -> bool:
    """Whether light linking includes objects: those that it includes, if any, else all that are not excluded."""
    if collection is None:
        return True
    included: set[str] = set()
    excluded: set[str] = set()
    pairs = [
        *zip(([o] for o in collection.objects), collection.collection_objects, strict=True),
        *zip((c.all_objects for c in collection.children), collection.collection_children, strict=True),
    ]
    for members, entry in pairs:
        group = included if entry.light_linking.link_state == "INCLUDE" else excluded
        group |= {obj.name for obj in members}
    names = {obj.name for obj in objects}
    return not names & excluded and (not included or bool(names & included))
