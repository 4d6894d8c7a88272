"""What a scene's lights shine on directly, and what sees what: as a render has it."""

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
"""Where a cone of light is looked at, along it."""
_SHORT = 1e-4
"""What a ray leaves out at both ends, in its length: there it meets what it starts from."""
_MOST = 24
"""Points that stand for a light with a surface."""
_NARROW = math.radians(60.0)
"""Half angle of a cone that points of a voxel may all be beside though it meets the voxel."""
_RAYS = ("diffuse", "glossy", "transmission")
_BARYCENTRIC = np.array(
    [[1, 1, 1], [5, 1, 1], [1, 5, 1], [1, 1, 5], [2, 2, 1], [1, 2, 2], [2, 1, 2]], dtype=np.float64
)


@dataclass(frozen=True)
class _Obstacle:
    objects: tuple[bpy.types.Object, ...]
    tree: BVHTree


class Eyes:
    """What sees what past everything but the target.

    Parameters
    ----------
    obstacles : sequence of _Obstacle
    size : float
        Of the scene, metres: no obstacle is farther from another.
    """

    def __init__(self, obstacles: Sequence[_Obstacle], size: float) -> None:
        self._obstacles = obstacles
        self.size = size

    @classmethod
    def of(cls, scene: bpy.types.Scene, seen: geometry.Snapshot) -> Eyes:
        """Return those of a scene in which everything is in the way."""
        obstacles, corners = [], [np.zeros((0, 3))]
        for shape in clearance.others(scene, seen):
            placed = shape.placed
            instanced = bpy.data.objects.get(shape.name)
            objects = (shape.owner, instanced) if instanced is not None else (shape.owner,)
            tree = BVHTree.FromPolygons(placed.tolist(), np.asarray(shape.triangles).tolist())
            obstacles.append(_Obstacle(objects, tree))
            corners.append(placed)
        every = np.concatenate(corners)
        return cls(obstacles, float(np.linalg.norm(np.ptp(every, axis=0))) if len(every) else 1.0)

    def rays(self, kind: str) -> Eyes:
        """Return those for which only what is visible to a kind of rays ("shadow", "camera") is in the way."""
        kept = [o for o in self._obstacles if all(getattr(obj, f"visible_{kind}") for obj in o.objects)]
        return Eyes(kept, self.size)

    def of_lamp(self, lamp: bpy.types.Object | None) -> Eyes:
        """Return those for which only what casts a shadow in a lamp's light is in the way."""
        if lamp is None:
            return self.rays("shadow")
        if lamp.type == "LIGHT" and not (lamp.data.use_shadow and getattr(lamp.data.cycles, "cast_shadow", True)):
            return Eyes([], self.size)
        linked = getattr(getattr(lamp, "light_linking", None), "blocker_collection", None)
        return Eyes([o for o in self.rays("shadow")._obstacles if _linked(linked, o.objects)], self.size)

    def open(self, start: Array, end: Array) -> bool:
        """Whether nothing stands between two points, each of shape (3,)."""
        way = end - start
        length = float(np.linalg.norm(way))
        if length == 0.0:
            return True
        origin, unit = Vector(start + _SHORT * way), Vector(way / length)
        reach = (1.0 - 2.0 * _SHORT) * length
        return all(o.tree.ray_cast(origin, unit, reach)[0] is None for o in self._obstacles)

    def passed(self, starts: Array, ends: Array) -> Array:
        """Return points along rays from starts (n, 3) to ends (n, 3), as far as nothing is in the way, (m, 3)."""
        found = []
        for start, end in zip(starts, ends, strict=True):
            origin, way = Vector(start), Vector(end - start)
            length = way.length
            hits = [o.tree.ray_cast(origin, way.normalized(), length)[3] for o in self._obstacles]
            reach = min([hit for hit in hits if hit is not None], default=length) / (length or 1.0)
            found.append(start + reach * _STEPS[:, None] * (end - start))
        every: Array = np.concatenate(found)
        return every

    def share(self, starts: Array, ends: Array) -> Array:
        """Return the open share of the ways from each of starts (n, 3) to ends (m, 3), (n,)."""
        return np.array([np.mean([self.open(a, b) for b in ends]) for a in starts])


class Beam:
    """Where a light shines directly.

    Parameters
    ----------
    light : Light
    eyes : Eyes
        Of the scene.

    Attributes
    ----------
    points : ndarray of shape (n, 3)
        Where it stands, or some points of its surface.
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
        """Whether it lights anything at all."""
        return self._object is None or any(getattr(self._object, f"visible_{kind}") for kind in _RAYS)

    def meets(self, receiver: bpy.types.Object, points: Array) -> bool:
        """Whether it lights one of points (n, 3) of the target, wherever it may be, or of the front of the wall."""
        if self._object is not None and not self._lights(receiver):
            return False
        return any(self._reaches(point, front=receiver.get(roles.ROLE) == "relay_wall") for point in points)

    def passes(self, receiver: bpy.types.Object, low: Array, high: Array) -> bool:
        """Whether a narrow cone of light goes through a box on its way, between its corners (3,)."""
        if self._sun or self._half > _NARROW or (self._object is not None and not self._lights(receiver)):
            return False
        starts, ways = self._cone()
        along = self._eyes.passed(starts, starts + 2.0 * self._eyes.size * ways)
        return bool(((along > low) & (along < high)).all(axis=1).any())

    def _cone(self) -> tuple[Array, Array]:
        across = np.cross(self._axis, np.eye(3)[int(np.argmin(np.abs(self._axis)))])
        across /= np.linalg.norm(across)
        turns = np.linspace(0.0, 2.0 * math.pi, 12, endpoint=False)[:, None]
        around = np.cos(turns) * across + np.sin(turns) * np.cross(self._axis, across)
        lean = [math.tan(share * self._half) for share in (0.0, 0.5, 0.95)]
        ways = np.concatenate([self._axis + tangent * around for tangent in lean])
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        return np.tile(self.points[0], (len(ways), 1)), ways

    def _reaches(self, point: Array, *, front: bool) -> bool:
        """Whether it reaches a point; if that is on the wall, the plane y = 0, from before it."""
        if self._sun:
            before = not front or self._axis[1] < 0.0
            return before and self._eyes.open(point - 2.0 * self._eyes.size * self._axis, point)
        ways = point - self.points
        lengths = np.linalg.norm(ways, axis=1)
        ahead = ways @ self._axis >= math.cos(self._half) * lengths
        if front:
            ahead &= ways[:, 1] < 0.0
        return any(self._eyes.open(start, point) for start in self.points[ahead])

    def _lights(self, receiver: bpy.types.Object) -> bool:
        """Whether its rays may be reflected by an object at all."""
        lamp: Any = self._object
        # What the target is made of may change; the wall is diffuse.
        kinds = _RAYS if receiver.get(roles.ROLE) == "target" else ("diffuse",)
        if not any(getattr(lamp, f"visible_{kind}") for kind in kinds):
            return False
        linking = getattr(lamp, "light_linking", None)
        return _linked(getattr(linking, "receiver_collection", None), (receiver,))


def _shape(light: Light, lamp: Any) -> tuple[Array, float]:
    """Points of a light (n, 3), and the half angle of the cone around its axis that it shines into."""
    place = light.matrix[:3, 3]
    if light.kind == "SPOT" and lamp is not None:
        return place[None], lamp.data.spot_size / 2.0
    if light.kind == "AREA" and lamp is not None:
        data = lamp.data
        wide = data.size
        high = data.size_y if data.shape in ("RECTANGLE", "ELLIPSE") else wide
        local = np.array([[0.0, 0.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) * (
            0.35 * wide,
            0.35 * high,
        )
        # An area lamp shines to one side.
        return place + local @ light.matrix[:3, :2].T, min(data.spread / 2.0, math.radians(89.9))
    if not len(light.corners):
        return place[None], math.pi
    count = min(len(light.corners), _MOST)
    triangles = light.corners[np.linspace(0, len(light.corners) - 1, count).astype(int)]
    weights = _BARYCENTRIC[: max(1, _MOST // count)]
    weights = weights / weights.sum(axis=1, keepdims=True)
    return (weights @ triangles).reshape(-1, 3), math.pi


def _linked(collection: Any, objects: Collection[bpy.types.Object]) -> bool:
    """Whether light linking lets objects count: those included, if any are, else all that are not excluded."""
    if collection is None:
        return True
    included: set[str] = set()
    excluded: set[str] = set()
    pairs = [
        *zip(([o] for o in collection.objects), collection.collection_objects, strict=True),
        *zip((c.all_objects for c in collection.children), collection.collection_children, strict=True),
    ]
    for members, entry in pairs:
        into = included if entry.light_linking.link_state == "INCLUDE" else excluded
        into |= {obj.name for obj in members}
    names = {obj.name for obj in objects}
    return not names & excluded and (not included or bool(names & included))
