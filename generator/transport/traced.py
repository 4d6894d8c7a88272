"""Light by way of a round target that is partly in shadow: ray tests in compiled loops, if surfaces are few.

Every point of the wall has its own elements: a cell of the target is cut until it is small if rays reach some but not
all of its corners; all other cells keep the few points that smooth light needs. The cost of a shadow's edge therefore
grows with its length, not with an area.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport import elements
from generator.transport.compiled import jit_in_place, jit_parts, jit_within
from generator.transport.elements import AREA, CELL, ONE_SIDED, POINT
from generator.transport.gloss import Glossy, Shine, more, pair, turns_over
from generator.transport.integral import Covering, room_to_cover
from generator.transport.lit import Rules, distance_to, order_at, order_for, radius_of
from generator.transport.rays import Surfaces
from generator.transport.records import Poses, Target

Floats = NDArray[Any]

_NEAR = 1e-6
_ROWS = 512

NORMAL, LEVEL, ORIGIN, DUAL, TRIANGLE, WIDTH = 0, 3, 4, 7, 13, 14
"""Columns of a flat surface's row: unit normal (3), level of its plane, a corner (3), the two dual vectors that give
a point's coordinates along the sides (3 + 3), whether it is a triangle; and the number of columns."""


class Obstacles(NamedTuple):
    """Surfaces that rays can meet.

    Attributes
    ----------
    room, target : ndarray of shape (n, WIDTH)
        As `rows` returns them; the target in its own frame.
    spheres : ndarray of shape (s, 4)
        Spheres of the target, in its own frame: centre and radius.
    convex : bool
        Whether the target is one convex body or one flat sheet, which a ray enters only once.
    """

    room: Floats
    target: Floats
    spheres: Floats
    convex: bool


class _Scene(NamedTuple):
    """Surfaces that rays can meet, the number of the room's that can stand in the way, and the target's pose."""

    obstacles: Obstacles
    hiders: int
    turn: Floats
    at: Floats


class Points(NamedTuple):
    """Points of the wall, and how finely the edges of their shadows are resolved.

    Attributes
    ----------
    owner : ndarray of shape (n,), int
        Index of the pose that each belongs to.
    walls : ndarray of shape (n, 3)
    finest : ndarray of shape (poses,)
        Cells are not cut to half widths below this.
    widest : float
        No cell keeps a half width above this: an edge must not pass between its corners.
    """

    owner: Floats
    walls: Floats
    finest: Floats
    widest: float


class _Job(NamedTuple):
    """Points, and what they receive light from: see `reflected_points`."""

    points: Points
    target: Target
    shine: Shine
    poses: Poses
    obstacles: Obstacles
    rules: Rules


class _Space(NamedTuple):
    """Scratch space, and where a wall point's rays begin (2, 3): at itself, and in the middle of the patch."""

    covering: Covering
    origins: Floats
    work: Floats


def _space(job: _Job, rows: int) -> _Space:
    """Return scratch space with room for a number of quadrature points."""
    patch = job.rules.patch
    return _Space(room_to_cover(rows), np.array([[0.0, 0.0, 0.0], [patch.x, patch.y, 0.0]]), np.empty(15))


def rows(surfaces: Surfaces) -> Floats:
    """Return flat surfaces as rows (n, WIDTH)."""
    table = np.zeros((len(surfaces.origin), WIDTH))
    table[:, NORMAL:LEVEL], table[:, LEVEL], table[:, ORIGIN:DUAL] = surfaces.normal, surfaces.level, surfaces.origin
    table[:, DUAL:TRIANGLE], table[:, TRIANGLE] = surfaces.dual.reshape(-1, 6), surfaces.triangle
    return table


@jit_in_place
def _inside(row: Floats, start: Floats, way: Floats, t: float) -> bool:
    p0 = start[0] + t * way[0] - row[ORIGIN]
    p1 = start[1] + t * way[1] - row[ORIGIN + 1]
    p2 = start[2] + t * way[2] - row[ORIGIN + 2]
    u = p0 * row[DUAL] + p1 * row[DUAL + 1] + p2 * row[DUAL + 2]
    v = p0 * row[DUAL + 3] + p1 * row[DUAL + 4] + p2 * row[DUAL + 5]
    return u >= 0.0 and v >= 0.0 and (u + v if row[TRIANGLE] else max(u, v)) <= 1.0


@jit_in_place
def _blocked(room: Floats, hiders: int, start: Floats, way: Floats) -> bool:
    """Whether one of the first ``hiders`` surfaces stands between ``start`` and ``start + way``."""
    for k in range(hiders):
        row = room[k]
        t = (row[LEVEL] - (start[0] * row[NORMAL] + start[1] * row[NORMAL + 1] + start[2] * row[NORMAL + 2])) / (
            way[0] * row[NORMAL] + way[1] * row[NORMAL + 1] + way[2] * row[NORMAL + 2]
        )
        if t > _NEAR and t < 1.0 - _NEAR and _inside(row, start, way, t):
            return True
    return False


@jit_in_place
def _met_by_target(scene: _Scene, start: Floats, way: Floats, own: Floats) -> bool:
    """Whether the target stands between ``start`` and ``start + way``; ``own`` (6,) is scratch space."""
    target, spheres = scene.obstacles.target, scene.obstacles.spheres
    for c in range(3):
        s, w = 0.0, 0.0
        for r in range(3):
            s += scene.turn[r, c] * (start[r] - scene.at[r])
            w += scene.turn[r, c] * way[r]
        own[c], own[3 + c] = s, w
    if _blocked(target, target.shape[0], own[:3], own[3:]):
        return True
    length = own[3] * own[3] + own[4] * own[4] + own[5] * own[5]
    for k in range(spheres.shape[0]):
        c0, c1, c2 = spheres[k, 0] - own[0], spheres[k, 1] - own[1], spheres[k, 2] - own[2]
        along = (c0 * own[3] + c1 * own[4] + c2 * own[5]) / length
        aside = c0 * c0 + c1 * c1 + c2 * c2 - along * along * length
        under = spheres[k, 3] ** 2 - aside
        if under <= 0.0:
            continue
        half = math.sqrt(under / length)
        enters, leaves = max(along - half, _NEAR), min(along + half, 1.0 - _NEAR)
        # As in `rays`: a chord of length zero is the point's own surface.
        if leaves - enters > 1e-5 * half:
            return True
    return False


@jit_in_place
def _hidden(scene: _Scene, start: Floats, way: Floats, own: Floats) -> bool:
    """Whether anything stands between ``start`` and ``start + way``; ``own`` (6,) is scratch space."""
    if _blocked(scene.obstacles.room, scene.hiders, start, way):
        return True
    return not scene.obstacles.convex and _met_by_target(scene, start, way, own)


@jit_within
def _disagree(cell: Floats, scene: _Scene, space: _Space) -> bool:
    """Whether some but not all of a cell's corners are hidden from one of the origins."""
    origins, work = space.origins, space.work
    point, way, scratch = work[0:3], work[3:6], work[6:12]
    for o in range(origins.shape[0]):
        hidden = False
        for corner in range(3 if cell[elements.KIND] == elements.TRIANGLE else 4):
            elements.corner_of(cell, corner, point)
            for r in range(3):
                way[r] = point[r] - origins[o, r]
            blocked = _hidden(scene, origins[o], way, scratch)
            if corner > 0 and blocked != hidden:
                return True
            hidden = blocked
    return False


@jit_in_place
def _cover_cell(
    owner: int, scene: _Scene, widths: tuple[float, float], rules: Rules, space: _Space, count: int
) -> int:
    """Cut the first cell of the stack for one wall point, finer where a shadow's edge crosses it; append points.

    The wall point is the first of the origins; ``widths`` are the finest and the widest cell.

    Returns
    -------
    int
        Number of points; negative if there are more than rows.
    """
    finest, widest = widths
    cell, stack, origins = space.covering.cell, space.covering.stack, space.origins
    middle = space.covering.middle
    top = 1
    while top > 0 and count >= 0:
        top -= 1
        elements.copy_row(stack[top], cell)
        first, second = elements.middle_of(cell, middle)
        distance = min(
            elements.distance_to_disc(middle, origins[0, 0], origins[0, 1], 0.0), distance_to(middle, rules.patch)
        )
        if cell[elements.KIND] == elements.SPHERE:
            distance = min(distance, cell[elements.RADIUS])
        digits = rules.digits
        if cell[elements.SHARP] > 0.0:
            elements.normal_of(cell, middle, space.covering.normal)
            lit, faced = (origins[1, 0], origins[1, 1], radius_of(rules.patch)), (origins[0, 0], origins[0, 1], 0.0)
            between = elements.half_way(middle, space.covering.normal, lit, faced)
            varies, share = elements.varies_over(cell, max(first, second), between)
            distance = min(distance, varies)
            digits += math.log(share)
        ku = elements.points_wanted(first, distance, digits)
        kv = elements.points_wanted(second, distance, digits)
        cut_first = (ku > elements.MAX_POINTS and first > finest) or first > widest
        cut_second = (kv > elements.MAX_POINTS and second > finest) or second > widest
        if not cut_first and not cut_second and max(first, second) > finest and _disagree(cell, scene, space):
            cut_first, cut_second = first > 0.5 * second, second > 0.5 * first
        if (cut_first or cut_second) and top + 4 <= stack.shape[0]:
            top = elements.cut(cell, stack, top, cut_first, cut_second)
            continue
        ku, kv = min(ku, elements.MAX_POINTS), min(kv, elements.MAX_POINTS)
        if cell[elements.KIND] == elements.TRIANGLE:
            ku = kv = max(ku, kv)
        count = elements.add_points(cell, owner, ku, kv, rules.gauss, space.covering.points, count)
    return count


@jit_within
def _cover(target: Target, scene: _Scene, widths: tuple[float, float], rules: Rules, space: _Space) -> int:
    """As `integral.cover`, for one wall point, finer at shadows' edges; return the number of points.

    It is negative if there are more than rows.
    """
    flat, balls, rings = target.flat, target.balls, target.rings
    stack, ball, faced, count = space.covering.stack, space.covering.ball, space.origins[1], 0
    for c in range(flat.shape[0]):
        if count < 0:
            break
        elements.place(flat[c], scene.turn, scene.at, stack[0])
        count = _cover_cell(c, scene, widths, rules, space, count)
    for c in range(balls.shape[0]):
        elements.place(balls[c], scene.turn, scene.at, ball)
        rim = elements.turn_to(ball, faced, radius_of(rules.patch))
        for cap in range(4 * rings * rings):
            if count < 0:
                break
            elements.copy_row(ball, stack[0])
            elements.cap_cell(stack[0], rim, cap // (4 * rings), cap % (4 * rings), rings)
            count = _cover_cell(flat.shape[0] + c, scene, widths, rules, space, count)
    return count


@jit_in_place
def _facing(element: Floats, start: Floats, way: Floats) -> float:
    """Write the vector from a wall point to an element; return cos cos / distance^2 * area, 0 if it faces away."""
    for r in range(3):
        way[r] = element[POINT + r] - start[r]
    facing = -_along(element, way)
    if element[ONE_SIDED] == 0.0:
        facing = abs(facing)
    if facing <= 0.0 or way[2] <= 0.0:
        return 0.0
    squared = way[0] ** 2 + way[1] ** 2 + way[2] ** 2
    return facing * way[2] / (squared * squared) * element[AREA]


@jit_in_place
def _along(element: Floats, way: Floats) -> float:
    normal = elements.NORMAL
    return element[normal] * way[0] + element[normal + 1] * way[1] + element[normal + 2] * way[2]


def reflected_points(
    start: int,
    stop: int,
    points: Points,
    glossy: Glossy,
    poses: Poses,
    obstacles: Obstacles,
    rules: Rules,
    values: Floats,
) -> None:
    """Evaluate `shaded.reflected` at points ``start`` to ``stop`` of the wall.

    Parameters
    ----------
    start, stop : int
    points : Points
    glossy : gloss.Glossy
    poses : Poses
    obstacles : Obstacles
    rules : Rules
    values : ndarray of shape (n, groups + 1), written
        The last column is the number of elements that each point took.
    """
    job, rows = _Job(points, glossy.target, glossy.shine, poses, obstacles, rules), _ROWS
    while start < stop:
        start = _evaluate(start, stop, job, _space(job, rows), values)
        rows *= 2


@jit_parts
def _evaluate(start: int, stop: int, job: _Job, space: _Space, values: Floats) -> int:
    """Evaluate points of the wall; return the first that was not, because ``space`` is too small for it."""
    points, poses, target, rules = job.points, job.poses, job.target, job.rules
    for item in range(start, stop):
        pose, wall = points.owner[item], points.walls[item]
        scene = _Scene(job.obstacles, poses.hiders[pose], poses.turns[pose], poses.places[pose])
        finest = points.finest[pose]
        elements.copy_row(wall, space.origins[0])
        count = _cover(target, scene, (finest, max(points.widest, finest)), rules, space)
        if count < 0:
            return item
        values[item] = 0.0
        found, looks = space.covering.points[:count], (target.albedo, job.shine)
        _reflect(wall, found, looks, scene, rules, space.work, values[item])
        values[item, values.shape[1] - 1] = count
    return stop


@jit_within
def _reflect(
    wall: Floats, found: Floats, looks: tuple[Floats, Shine], scene: _Scene, rules: Rules, work: Floats, total: Floats
) -> None:
    """Add to ``total`` (groups + 1,) the light that a wall point receives by way of elements."""
    way, step, start, scratch = work[0:3], work[3:6], work[6:9], work[9:15]
    albedo, shine = looks
    patch = rules.patch
    start[2] = 0.0
    for j in range(found.shape[0]):
        element = found[j]
        term = _facing(element, wall, way)
        if term == 0.0 or _hidden(scene, wall, way, scratch):
            continue
        # Only light on the side of the element that faces the wall point counts.
        side = _along(element, way)
        cell = int(element[CELL])
        alpha, order, far = shine.alpha[cell], order_at(element, patch, rules.digits), 1.0
        if alpha > 0.0:
            lit, faced = (patch.x, patch.y, radius_of(patch)), (wall[0], wall[1], 0.0)
            between_them = elements.half_way(element, element[elements.NORMAL : AREA], lit, faced)
            angle = turns_over(shine.sharp[cell], between_them)
            order = max(order, order_for(angle * distance_to(element, patch), patch, rules.digits))
            far = math.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
        light, shone = 0.0, 0.0
        for q in range(order * order):
            start[0], start[1] = rules.whole[order, 0, q], rules.whole[order, 1, q]
            share = rules.whole[order, 2, q] * _facing(element, start, step)
            if share == 0.0 or side * _along(element, step) <= 0.0 or _hidden(scene, start, step, scratch):
                continue
            light += share / element[AREA]
            if alpha > 0.0:
                near = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
                between = (way[0] * step[0] + way[1] * step[1] + way[2] * step[2]) / (near * far)
                cosine = abs(_along(element, step)) / near
                shone += share / element[AREA] * pair(alpha, cosine, abs(side) / far, between)
        for g in range(albedo.shape[1]):
            total[g] += term * light * albedo[cell, g]
            if alpha > 0.0:
                again = shine.multiple[cell, g] * more(abs(side) / far, shine.missing[shine.table[cell]])
                total[g] += term * shone * shine.tint[cell, g] * (1.0 + again)
