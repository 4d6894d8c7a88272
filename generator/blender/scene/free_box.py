"""The largest box around a point, up to a wanted size, that is clear of surfaces and hidden from lamp and camera."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from generator.blender.scene import clearance, geometry, roles
from generator.blender.scene.description import read_spot
from generator.model.arrays import Array
from generator.model.errors import NlosError

_STEPS = 16
"""Steps in which a box reaches the wanted size; it ends at most one of them before what is in its way."""
_APART = 0.25
"""Distance that is kept from what is in the way, in steps."""
_QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
_LATTICE = np.array(list(itertools.product(np.linspace(0.0, 1.0, 4), repeat=2)))
"""Points of a face at which it is tested whether lamp and camera see them."""


def free_box(
    scene: bpy.types.Scene, seen: geometry.Snapshot, around: Array, least: Array, wanted: Array
) -> tuple[Array, Array] | None:
    """Return the low and the high corner (3,) of a box around a point; None if the least one is not free.

    The box grows from the least one, evenly to both sides, and where one is blocked to the other only.

    Parameters
    ----------
    scene : bpy.types.Scene
    seen : Snapshot
    around : ndarray of shape (3,)
    least, wanted : ndarray of shape (3,)
        Edges of the smallest and of the largest box, metres.
    """
    step = (wanted - least) / _STEPS
    space = _Space(scene, seen, around, around - wanted - step, around + wanted + step)
    apart = _APART * np.maximum(step, 0.0)
    low, high = around - least / 2.0, around + least / 2.0
    if not space.is_free(low, high):
        return None
    grows = {(axis, side) for axis in range(3) for side in (0, 1) if step[axis] > 0.0}
    while grows:
        for axis, side in sorted(grows):
            left = wanted[axis] - (high[axis] - low[axis])
            move = np.zeros(3)
            move[axis] = min(step[axis] / 2.0, left)
            new_low, new_high = (low, high + move) if side else (low - move, high)
            margin = apart * (move > 0.0)
            if (
                left < 1e-9
                or not space.is_free(new_low - margin, new_high + margin)
                or space.is_seen(new_low, new_high, axis, side)
            ):
                grows.discard((axis, side))
            else:
                low, high = new_low, new_high
    return low, high


class _Space:
    """What a box must be clear of, near enough to matter: between two corners."""

    def __init__(
        self, scene: bpy.types.Scene, seen: geometry.Snapshot, around: Array, low: Array, high: Array
    ) -> None:
        shapes = clearance.others(scene, seen)
        every = [shape.placed[shape.triangles] for shape in shapes]
        corners = np.concatenate([np.zeros((0, 3, 3)), *every])
        near = ((corners.min(axis=1) < high) & (corners.max(axis=1) > low)).all(axis=1)
        self._points = corners[near].reshape(-1, 3)
        self._near = _tree(self._points)
        self._sights: Sequence[clearance.Sight] = ()
        self._eyes = [seen.matrices[role][:3, 3] for role in ("spot", "camera") if role in seen.matrices]
        try:
            spot = read_spot(roles.find(scene, "spot"), seen.matrices["spot"])
            self._sights = clearance.sights(scene, spot, seen)
        except (NlosError, KeyError):  # lamp or camera is missing, or looks elsewhere, which Check tells
            pass
        stops = [t for shape, t in zip(shapes, every, strict=True) if shape.opaque]
        self._all = _tree(np.concatenate([np.zeros((0, 3, 3)), *stops]).reshape(-1, 3))
        # Only from what does not see the object where it stands can all of the box be hidden.
        self._eyes = [eye for eye in self._eyes if self._hides(eye, around[None])]

    def is_free(self, low: Array, high: Array) -> bool:
        """Whether no surface reaches into a box, nor the lamp's cone or the camera's view."""
        if low[1] <= 0.0 or ((self._points > low) & (self._points < high)).all(axis=1).any():
            return False
        corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
        box = BVHTree.FromPolygons(corners.tolist(), _QUADS)
        if box.overlap(self._near):
            return False
        return not any(sight.holds(corners) or box.overlap(sight.sides) for sight in self._sights)

    def is_seen(self, low: Array, high: Array, axis: int, side: int) -> bool:
        """Whether lamp or camera, turned there, would see a point of a box's face."""
        points = low + np.insert(_LATTICE, axis, float(side), axis=1) * (high - low)
        return not all(self._hides(eye, points) for eye in self._eyes)

    def _hides(self, eye: Array, points: Array) -> bool:
        """Whether something stands between an eye and each of points (n, 3)."""
        lengths = np.linalg.norm(points - eye, axis=1)
        ways = ((points - eye) / lengths[:, None]).tolist()
        cast, start = self._all.ray_cast, Vector(eye)
        return all(cast(start, way, far)[0] is not None for way, far in zip(ways, lengths.tolist(), strict=True))


def _tree(points: Array) -> BVHTree:
    """Return a tree of triangles (3 n, 3), corner by corner."""
    return BVHTree.FromPolygons(points.tolist(), np.arange(len(points)).reshape(-1, 3).tolist())
