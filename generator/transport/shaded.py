"""The three-reflection integral where something may be in the way, and the light of the room that the target hides.

Everything here is a sum over quadrature points with a ray test for each pair; the error at the edges of shadows falls
as the points get finer, and callers refine until two sums agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.transport.elements import AREA, CELL, GRAZING, NORMAL, ONE_SIDED, POINT
from generator.transport.facets import pairs
from generator.transport.gloss import Shine, missing_at
from generator.transport.lit import Patch, distance_to, order_at, order_for
from generator.transport.rays import Placed, Surfaces

Floats = NDArray[Any]
Hider = Surfaces | Placed

_AT_ONCE = 400_000
"""Most pairs held in memory at once."""


class Light:
    """The lit patch as a few points, for many receivers at once.

    Parameters
    ----------
    patch : lit.Patch
    whole : ndarray
        Quadrature rules of the patch (`lit.whole_rules`).
    digits : float
        Natural logarithm of one over the relative accuracy.
    """

    def __init__(self, patch: Patch, whole: Floats, digits: float) -> None:
        self._patch, self._whole, self._digits = patch, whole, digits

    def order(self, points: Floats, reach: float = 0.0) -> int:
        """Return the order of the patch's rule that surfaces within ``reach`` of points (k, 3) need."""
        if not len(points):
            return 1
        lateral = np.linalg.norm(points[:, :2] - self._patch.centre, axis=1)
        lateral -= math.hypot(self._patch.major_x, self._patch.major_y)
        distance = np.hypot(np.maximum(lateral, 0.0), points[:, 2]).min() - reach
        above = np.array([self._patch.x, self._patch.y, max(float(distance), 0.0)])
        # More points than this do not resolve the edges of shadows better.
        return min(12, order_at(above, self._patch, self._digits))

    def nodes(self, points: Floats, sharp: float = math.inf) -> Floats:
        """Return the patch's points (3, n) that receivers (k, 3) need: position on the wall, radiance times area.

        ``sharp`` is the angle over which the receivers' reflectance varies (`gloss.Shine.sharp`).
        """
        order = self.order(points)
        if sharp < math.inf and len(points):
            distance = min(distance_to(point, self._patch) for point in points)
            turn = min(1.0, 2.0 * sharp * GRAZING)
            order = max(order, order_for(turn * distance, self._patch, self._digits))
        chosen: Floats = self._whole[order, :, : order * order]
        return chosen

    def irradiance(self, points: Floats, normals: Floats, hidden_by: Sequence[Hider]) -> Floats:
        """Return the irradiance (k,) of surface points (k, 3) on the side of their normals (k, 3)."""
        if not len(points):
            return np.zeros(0)
        nodes = self.nodes(points)
        total = np.zeros(len(points))
        for q in range(nodes.shape[1]):
            way = -points
            way[:, 0] += nodes[0, q]
            way[:, 1] += nodes[1, q]
            squared = (way * way).sum(axis=1)
            term = nodes[2, q] * np.maximum((normals * way).sum(axis=1), 0.0) * points[:, 2]
            term = term / (squared * squared)
            facing = np.flatnonzero(term > 0.0)
            if len(facing):
                source = np.broadcast_to(np.array([nodes[0, q], nodes[1, q], 0.0]), (len(facing), 3))
                term[facing[any_blocks(hidden_by, source, points[facing])]] = 0.0
                total += term
        return total


def any_blocks(surfaces: Sequence[Hider], start: Floats, end: Floats) -> NDArray[np.bool_]:
    """Return whether any of several sets of surfaces stands between points (n, 3) and points (n, 3)."""
    blocked = np.zeros(len(start), dtype=np.bool_)
    for hider in surfaces:
        if len(hider):
            rest = np.flatnonzero(~blocked)
            blocked[rest] = hider.blocked(start[rest], end[rest])
    return blocked


def reflected(wall: Floats, found: Floats, albedo: Floats, light: Light, hidden_by: Sequence[Hider]) -> Floats:
    """Return the light that wall points receive by way of surface elements, as far as nothing hides it.

    Parameters
    ----------
    wall : ndarray of shape (k, 3)
    found : ndarray of shape (n, 9)
        As `integral.cover` returns them.
    albedo : ndarray of shape (rows, groups)
    light : Light
    hidden_by : sequence of Surfaces or Placed

    Returns
    -------
    ndarray of shape (groups, k)
    """
    total = np.zeros((albedo.shape[1], len(wall)))
    both = np.concatenate([found, _turned(found[found[:, ONE_SIDED] == 0.0])])
    lit = light.irradiance(both[:, POINT:NORMAL], both[:, NORMAL:AREA], hidden_by) * both[:, AREA]
    both, lit = both[lit > 0.0], lit[lit > 0.0]
    step = max(1, _AT_ONCE // max(1, len(wall)))
    for start in range(0, len(both), step):
        part = both[start : start + step]
        term = _exchange(wall, part[:, POINT:NORMAL], part[:, NORMAL:AREA])
        k, j = np.nonzero(term)
        blocked = any_blocks(hidden_by, part[j, POINT:NORMAL], wall[k])
        term[k[blocked], j[blocked]] = 0.0
        strength = lit[start : start + step, None] * albedo[part[:, CELL].astype(int)]
        total += (term @ strength).T
    return total


def shone(wall: Floats, found: Floats, shine: Shine, light: Light, hidden_by: Sequence[Hider]) -> Floats:
    """Return the light that wall points receive by way of glossy surface elements, as far as nothing hides it.

    Parameters and result are those of `reflected`, with the elements' gloss for their albedo.
    """
    total = np.zeros((shine.tint.shape[1], len(wall)))
    both = np.concatenate([found, _turned(found[found[:, ONE_SIDED] == 0.0])])
    both = both[shine.alpha[both[:, CELL].astype(int)] > 0.0]
    step = max(1, _AT_ONCE // max(1, len(wall)))
    for start in range(0, len(both), step):
        part = both[start : start + step]
        points, normals, cell = part[:, POINT:NORMAL], part[:, NORMAL:AREA], part[:, CELL].astype(int)
        term = _exchange(wall, points, normals) * part[:, AREA]
        k, j = np.nonzero(term)
        clear = ~any_blocks(hidden_by, points[j], wall[k])
        k, j = k[clear], j[clear]
        way = wall[k] - points[j]
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        cosine = (way * normals[j]).sum(axis=1)
        alpha, sent = shine.alpha[cell[j]], np.zeros(len(k))
        for x, y, power in light.nodes(points, float(shine.sharp[cell].min())).T:
            source = np.array([x, y, 0.0]) - points
            far = np.linalg.norm(source, axis=1)
            facing = (source * normals).sum(axis=1) / far
            lit = power * np.maximum(facing, 0.0) * points[:, 2] / far**3
            rows = np.flatnonzero(lit)
            lit[rows[any_blocks(hidden_by, points[rows] + source[rows], points[rows])]] = 0.0
            seen = np.flatnonzero(lit[j])
            i = j[seen]
            between = (way[seen] * source[i]).sum(axis=1) / far[i]
            sent[seen] += lit[i] * pairs(alpha[seen], facing[i], cosine[seen], between)
        again = missing_at(cosine, cell[j], shine)
        for g in range(len(total)):
            factor = shine.tint[cell[j], g] * (1.0 + shine.multiple[cell[j], g] * again)
            total[g] += np.bincount(k, weights=term[k, j] * sent * factor, minlength=len(wall))
    return total


def _turned(found: Floats) -> Floats:
    turned = found.copy()
    turned[:, NORMAL:AREA] *= -1.0
    return turned


def _exchange(wall: Floats, points: Floats, normals: Floats, *, two_sided: bool = False) -> Floats:
    """Return cos cos / r^2 between wall points (k, 3) and surface points (n, 3), as (k, n)."""
    u, v, w = (wall[:, r, None] - points[:, r] for r in range(3))
    squared = u * u + v * v + w * w
    facing = normals[:, 0] * u + normals[:, 1] * v + normals[:, 2] * w
    facing = np.abs(facing) if two_sided else np.maximum(facing, 0.0)
    factors: Floats = facing * np.maximum(-w, 0.0) / (squared * squared)
    return factors


def _between(wall: Floats, found: Floats) -> Floats:
    """As `_exchange`, for elements (n, 9), which may have two sides."""
    points, normals = found[:, POINT:NORMAL], found[:, NORMAL:AREA]
    both = _exchange(wall, points, normals, two_sided=True)
    factors: Floats = np.where(found[:, ONE_SIDED] == 0.0, both, _exchange(wall, points, normals))
    return factors


def hidden(
    wall: Floats,
    seen: Floats,
    lit: Floats,
    room: Surfaces,
    blockers: Sequence[Hider],
    target: Sequence[Hider],
    light: Light,
    *,
    convex: bool,
) -> Floats:
    """Return the light of the room that a target hides from wall points.

    The light goes patch, room, wall, and the target can block either leg. On the second leg it hides what is behind
    it as seen from the wall point: every element of the target that faces the point removes the radiance of the room
    behind it. On the first leg it hides what is behind it as seen from the patch: the light that falls on an element
    of the target would have lit a point of the room behind it, and is missing wherever that point can be seen. So
    both are integrals over the target's own surface, without singularities.

    Parameters
    ----------
    wall : ndarray of shape (k, 3)
    seen, lit : ndarray of shape (n, 9)
        Elements of the target, as `integral.cover` returns them: those that can face the wall points, and those that
        can face the patch.
    room : Surfaces
        All surfaces that reflect.
    blockers : sequence of Surfaces or Placed
        The room's surfaces that can stand between two points of the scene.
    target : sequence of Surfaces or Placed
        The target itself.
    light : Light
    convex : bool
        Whether the target is one convex body or one flat sheet, which a ray enters only once.

    Returns
    -------
    ndarray of shape (groups, k)
    """
    groups = room.tint.shape[1]
    total = np.zeros((groups, len(wall)))
    if not len(room.normal):
        return total
    within: Sequence[Hider] = [] if convex else target
    step = max(1, _AT_ONCE // max(1, len(wall)))
    for start in range(0, len(seen), step):
        part = seen[start : start + step]
        term = _between(wall, part) * part[:, AREA]
        k, j = np.nonzero(term)
        clear = ~any_blocks([*blockers, *within], wall[k], part[j, POINT:NORMAL])
        k, j = k[clear], j[clear]
        radiance = _room_radiance(part[j, POINT:NORMAL], part[j, POINT:NORMAL] - wall[k], room, blockers, light)
        for g in range(groups):
            total[g] += np.bincount(k, weights=term[k, j] * radiance[g], minlength=len(wall))
    total += _first_leg(wall, lit, room, blockers, target, within, light)
    return total


def _room_radiance(start: Floats, way: Floats, room: Surfaces, blockers: Sequence[Hider], light: Light) -> Floats:
    """Return the radiance (groups, n), times pi, of the points of the room that rays meet behind the target."""
    which, far = room.first_hit(start, way)
    met = np.flatnonzero(which >= 0)
    radiance = np.zeros((room.tint.shape[1], len(start)))
    if len(met):
        point = start[met] + far[met, None] * way[met]
        normal = room.normal[which[met]]
        normal = normal * -np.sign((normal * way[met]).sum(axis=1))[:, None]
        radiance[:, met] = light.irradiance(point, normal, blockers) * room.tint[which[met]].T
    return radiance


def _first_leg(
    wall: Floats,
    lit: Floats,
    room: Surfaces,
    blockers: Sequence[Hider],
    target: Sequence[Hider],
    within: Sequence[Hider],
    light: Light,
) -> Floats:
    total = np.zeros((room.tint.shape[1], len(wall)))
    if not len(lit):
        return total
    nodes = light.nodes(lit[:, POINT:NORMAL])
    for q in range(nodes.shape[1]):
        source = np.array([[nodes[0, q], nodes[1, q], 0.0]])
        caught = nodes[2, q] * _between(source, lit)[0] * lit[:, AREA]
        rows = np.flatnonzero(caught)
        start = lit[rows, POINT:NORMAL]
        sources = np.broadcast_to(source, start.shape)
        clear = ~any_blocks([*blockers, *within], sources, start)
        rows, start = rows[clear], start[clear]
        way = start - source
        which, far = room.first_hit(start, way)
        met = which >= 0
        rows, start, way, which, far = rows[met], start[met], way[met], which[met], far[met]
        point = start + far[:, None] * way
        normal = room.normal[which]
        normal = normal * -np.sign((normal * way).sum(axis=1))[:, None]
        term = _exchange(wall, point, normal)
        k, j = np.nonzero(term)
        blocked = any_blocks([*blockers, *target], point[j], wall[k])
        term[k[blocked], j[blocked]] = 0.0
        total += (term @ (caught[rows, None] * room.tint[which])).T
    return total
