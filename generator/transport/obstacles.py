"""Which surfaces can block which light: decided in advance, by half-spaces, so that few pairs need a ray test."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.model.errors import NlosError
from generator.transport.lit import Patch
from generator.transport.rays import Surfaces

Floats = NDArray[Any]
Flags = NDArray[np.bool_]

_TOUCH = 1e-9
SUNK = 1e-6
"""Depth below the wall, in half diagonals of the watched patch, that counts as rounding."""
_RIM = 1.0 - 1e-3
"""Share of the lit and of the watched patch that must be free: a target may touch the edge of what is lit or seen."""
_OUTLINE = 64


class Obstacles:
    """The surfaces of a scene, and tests of what they can hide.

    Everything is in the wall's frame (`prepared.Frame`).

    Parameters
    ----------
    room : Surfaces
    target : Surfaces
        Surfaces of the target, in its own frame.
    to_wall : ndarray of shape (3, 3)
    patch : lit.Patch
    eye : ndarray of shape (4,)

    Attributes
    ----------
    is_blocker : ndarray of shape (n,), bool
        Which of the room's flat surfaces are in ``static_blockers``.
    static_blockers : Surfaces
        Surfaces of the room that can stand between two points of room, patch and watched patch. The walls of a
        closed room are not among them: the whole scene is on one side of each.
    """

    def __init__(self, room: Surfaces, target: Surfaces, to_wall: Floats, patch: Patch, eye: Floats) -> None:
        self._room, self._target = room, target
        corners = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 1.0, 1.0]]) @ to_wall.T
        self._watched = np.column_stack([corners[:, :2] / corners[:, 2:], np.zeros(4)])
        angles = np.linspace(0.0, 2.0 * math.pi, 32, endpoint=False)
        rim = patch.centre + np.outer(np.cos(angles), patch.major) + np.outer(np.sin(angles), patch.minor)
        self._patch_rim = np.column_stack([rim, np.zeros(32)])
        self._lamp = np.array([patch.lamp_x, patch.lamp_y, patch.height, 1.0])
        self._patch_centre, self._patch_radius = (
            np.append(patch.centre, 0.0),
            math.hypot(patch.major_x, patch.major_y),
        )
        self._eye = eye
        self._cone = _pyramid(self._lamp, self._patch_centre + _RIM * (self._patch_rim - self._patch_centre))
        middle = self._watched.mean(axis=0)
        self._view = _pyramid(eye, middle + _RIM * (self._watched - middle))
        low, high = target.box
        self._box = np.array([[(low, high)[i >> r & 1][r] for r in range(3)] for i in range(8)])
        self._middle, self._radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
        # A surface is no blocker if the whole scene lies on one side of its plane.
        self._sides = np.zeros(len(room.origin))
        if len(room.origin):
            points = np.concatenate([*room.corners(), self._watched, self._patch_rim])
            size = float(np.ptp(points, axis=0).max())
            for k, (origin, normal) in enumerate(zip(room.origin, room.normal, strict=True)):
                height = (points - origin) @ normal
                if (height >= -1e-7 * size).all():
                    self._sides[k] = 1.0
                elif (height <= 1e-7 * size).all():
                    self._sides[k] = -1.0
        self.is_blocker = self._sides == 0.0
        self.static_blockers = room.subset(self.is_blocker)

    def blockers(self, place: Floats, turn: Floats) -> Surfaces:
        """Return the room's surfaces that can stand between two points of the scene with the target at a pose."""
        if not len(self._room.origin):
            return self.static_blockers
        middle = turn @ self._middle + place
        height = ((middle - self._room.origin) * self._room.normal).sum(axis=1) * self._sides
        outside = (self._sides != 0.0) & (height < -self._radius)
        return self._room.subset((self._sides == 0.0) | outside) if outside.any() else self.static_blockers

    def between(self, place: Floats, turn: Floats) -> Surfaces:
        """Return the surfaces that can stand between the target and the patch or the watched patch."""
        blockers = self.blockers(place, turn)
        if not len(blockers.origin):
            return blockers
        box = self._box @ turn.T + place
        keep = np.zeros(len(blockers.origin), dtype=bool)
        for ends in (self._watched, self._patch_rim):
            keep |= ~_clear(blockers, np.concatenate([box, ends]))
        return blockers.subset(keep)

    def may_hide(self, place: Floats, turn: Floats) -> bool:
        """Whether part of the target may be hidden from part of the patch or of the watched patch."""
        return bool(len(self.between(place, turn).origin))

    def refuse(self, places: Floats, turns: Floats, positions: Floats) -> None:
        """Raise NlosError if the target cannot be at a pose: through the wall, or in front of lamp or camera.

        Parameters
        ----------
        places, turns : ndarray of shape (n, 3) and (n, 3, 3)
        positions : ndarray of shape (n, 3)
            Positions by which messages name the poses, metres.
        """
        middles = turns @ self._middle + places
        lamp = self._lamp[:3]
        axis = self._patch_centre - lamp
        along = np.clip((middles - lamp) @ axis / (axis @ axis), 0.0, 1.0)
        distance = np.linalg.norm(middles - lamp - along[:, None] * axis, axis=1)
        low = middles[:, 2] < self._radius
        lit, seen = distance < self._radius + self._patch_radius, self._may_be_seen(middles)
        for k in np.flatnonzero(low | lit | seen):
            where = f"pose ({', '.join(f'{v:g}' for v in positions[k])})"
            if low[k]:
                lowest, highest = self._heights(places[k], turns[k])
                if lowest < -SUNK:
                    raise NlosError(f"{where}: the target reaches through the relay wall")
                if highest < SUNK:
                    raise NlosError(f"{where}: the target lies in the relay wall")
            if lit[k] and self._reaches_into(self._cone, self._lamp, places[k], turns[k]):
                raise NlosError(f"{where}: the target stands in the spot's cone; only --engine path can render it")
            if seen[k] and self._reaches_into(self._view, self._eye, places[k], turns[k]):
                raise NlosError(
                    f"{where}: the target stands between the camera and the relay wall; use --engine patch"
                )

    def _reaches_into(self, spaces: Floats, eye: Floats, place: Floats, turn: Floats) -> bool:
        """Whether the target reaches into the intersection of half-spaces (k, 4) whose apex is an eye."""
        target = self._target
        if len(target.origin):
            first, second = target.origin + target.first, target.origin + target.second
            last = np.where(target.triangle[:, None], second, first + target.second)
            flat = np.stack([target.origin, first, last, second], axis=1) @ turn.T + place
            if _reaches_into(spaces, flat):
                return True
        for x, y, z, radius in target.spheres:
            centre = turn @ [x, y, z] + place
            outline = _outline(centre, radius, eye)
            if outline is None or _reaches_into(spaces, outline[None]):
                return True
        return False

    def _may_be_seen(self, middles: Floats) -> Flags:
        """Whether a sphere around the target reaches into the camera's view of the watched patch."""
        apex = self._eye[:3] - self._eye[3] * self._watched
        sides = np.cross(np.roll(self._watched, -1, axis=0) - self._watched, apex)
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        sides *= np.sign(((self._watched.mean(axis=0) - self._watched) * sides).sum(axis=1))[:, None]
        inside = ((middles[:, None] - self._watched) * sides).sum(axis=2) > -self._radius
        reaches: Flags = inside.all(axis=1) & (middles[:, 2] - self._radius <= self._eye[2])
        return reaches

    def _heights(self, place: Floats, turn: Floats) -> tuple[float, float]:
        """Return the heights of the target's lowest and highest point above the wall."""
        low, high = np.inf, -np.inf
        corners = np.concatenate(self._target.corners())
        if len(corners):
            heights = corners @ turn[2] + place[2]
            low, high = float(heights.min()), float(heights.max())
        if len(self._target.spheres):
            heights = self._target.spheres[:, :3] @ turn[2] + place[2]
            low = min(low, float((heights - self._target.spheres[:, 3]).min()))
            high = max(high, float((heights + self._target.spheres[:, 3]).max()))
        return low, high


def _pyramid(eye: Floats, base: Floats) -> Floats:
    """Return the half-spaces (k, 4) between an eye (homogeneous) and a convex polygon (k - 1, 3) on the wall."""
    towards = eye[:3] - eye[3] * base
    normals = np.cross(np.roll(base, -1, axis=0) - base, towards)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    levels = (normals * base).sum(axis=1)
    middle = base.mean(axis=0)
    sign = np.sign(normals @ middle - levels)
    sides = sign[:, None] * np.column_stack([normals, -levels])
    # A parallel projection has no apex: its space ends at the camera's plane.
    way = (eye[:3] - eye[3] * middle) / np.linalg.norm(eye[:3] - eye[3] * middle)
    start = eye[:3] if eye[3] else middle + eye[:3]
    return np.concatenate([sides, [np.append(-way, way @ start)]])


def _outline(centre: Floats, radius: float, eye: Floats) -> Floats | None:
    """Return the polygon around a sphere's outline as seen from an eye (homogeneous); None from inside."""
    axis = centre - eye[:3] if eye[3] else -eye[:3]
    distance = float(np.linalg.norm(axis))
    axis = axis / distance
    if eye[3]:
        if distance <= radius:
            return None
        sine = radius / distance
        centre, radius = centre - sine * radius * axis, radius * math.sqrt(1.0 - sine * sine)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    angles = np.linspace(0.0, 2.0 * math.pi, _OUTLINE, endpoint=False)[:, None]
    directions = np.cos(angles) * across + np.sin(angles) * np.cross(axis, across)
    polygon: Floats = centre + radius / math.cos(math.pi / _OUTLINE) * directions
    return polygon


def _reaches_into(spaces: Floats, polygons: Floats) -> bool:
    """Whether one of the convex polygons (n, corners, 3) reaches into the intersection of half-spaces (k, 4)."""
    inside, is_candidate = np.ones(polygons.shape[:2], dtype=bool), np.ones(len(polygons), dtype=bool)
    for space in spaces:
        within = polygons @ space[:3] + space[3] > _TOUCH
        inside &= within
        is_candidate &= within.any(axis=1)
    return bool(inside.any()) or any(_is_left(polygon, spaces) for polygon in polygons[is_candidate])


def _is_left(polygon: Floats, spaces: Floats) -> bool:
    """Whether cutting a polygon (corners, 3) by half-spaces leaves any of it (Sutherland and Hodgman 1974)."""
    for space in spaces:
        height = polygon @ space[:3] + space[3] - _TOUCH
        kept = []
        for k in range(len(polygon)):
            if (height[k] > 0.0) != (height[k - 1] > 0.0):
                share = height[k - 1] / (height[k - 1] - height[k])
                kept.append(polygon[k - 1] + share * (polygon[k] - polygon[k - 1]))
            if height[k] > 0.0:
                kept.append(polygon[k])
        if not kept:
            return False
        polygon = np.array(kept)
    return True


def _clear(surfaces: Surfaces, points: Floats) -> Flags:
    """Return which surfaces cannot stand between any two of some points: those that a plane separates from them."""
    clear = np.zeros(len(surfaces.origin), dtype=bool)
    for k in range(len(clear)):
        height = (points - surfaces.origin[k]) @ surfaces.normal[k]
        if (height >= -_TOUCH).all() or (height <= _TOUCH).all():
            clear[k] = True
            continue
        corner, first, second = surfaces.origin[k], surfaces.first[k], surfaces.second[k]
        if surfaces.triangle[k]:
            edges = [(corner, first, second), (corner, second, first), (corner + first, second - first, -first)]
        else:
            edges = [
                (corner, first, second),
                (corner, second, first),
                (corner + first, second, -first),
                (corner + second, first, -second),
            ]
        clear[k] = any(_parted(start, edge, inward, surfaces.normal[k], points) for start, edge, inward in edges)
    return clear


def _parted(start: Floats, edge: Floats, inward: Floats, normal: Floats, points: Floats) -> bool:
    """Whether some plane through an edge has the surface on one side and the points on the other.

    Seen along the edge, the surface is a ray; the angles of the points, counted from the opposite ray, must span less
    than half a turn.
    """
    out = np.cross(edge, normal)
    out /= np.linalg.norm(out)
    if out @ inward > 0.0:
        out = -out
    way = points - start
    angle = np.arctan2(way @ normal, way @ out)
    return bool(angle.max() - angle.min() < math.pi - 1e-9)
