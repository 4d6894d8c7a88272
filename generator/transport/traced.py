"""Light by way of a round target that is partly in shadow: ray tests in compiled loops, where surfaces are few.

Every point of the wall has elements of its own: a cell of the target whose corners do not agree on whether a ray gets
there is cut until it is small; all others keep the few points that smooth light needs. So the cost of a shadow's edge
grows with its length, not with an area.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.transport import elements, integral
from generator.transport.compiled import jit, jit_released
from generator.transport.rays import Surfaces

Floats = NDArray[Any]

_NEAR = 1e-6
_STACK = 512

Scene = tuple[Floats, int, Floats, Floats, Floats, Floats, bool]
"""Room, how many of it can hide something, the target's surfaces, spheres, turn and place, and if it is convex."""

Rule = tuple[Floats, float, float, float, Floats]
"""Gauss points, digits, finest and widest cell, and the lit patch."""


def rows(surfaces: Surfaces) -> Floats:
    """Return flat surfaces as rows (n, 14): normal, level, origin, dual vectors (6), whether a triangle."""
    made = np.zeros((len(surfaces.origin), 14))
    made[:, 0:3], made[:, 3], made[:, 4:7] = surfaces.normal, surfaces.level, surfaces.origin
    made[:, 7:13], made[:, 13] = surfaces.dual.reshape(-1, 6), surfaces.triangle
    return made


@jit
def _inside(row: Floats, start: Floats, way: Floats, t: float) -> bool:
    p0, p1, p2 = start[0] + t * way[0] - row[4], start[1] + t * way[1] - row[5], start[2] + t * way[2] - row[6]
    u, v = p0 * row[7] + p1 * row[8] + p2 * row[9], p0 * row[10] + p1 * row[11] + p2 * row[12]
    return u >= 0.0 and v >= 0.0 and (u + v if row[13] else max(u, v)) <= 1.0


@jit
def _blocked(room: Floats, hiders: int, start: Floats, way: Floats) -> bool:
    """Whether one of the first ``hiders`` surfaces stands between a point and that point plus a way."""
    for k in range(hiders):
        row = room[k]
        t = (row[3] - (start[0] * row[0] + start[1] * row[1] + start[2] * row[2])) / (
            way[0] * row[0] + way[1] * row[1] + way[2] * row[2]
        )
        if t > _NEAR and t < 1.0 - _NEAR and _inside(row, start, way, t):
            return True
    return False


@jit
def _met_by_target(
    target: Floats, spheres: Floats, turn: Floats, at: Floats, start: Floats, way: Floats, own: Floats
) -> bool:
    """Whether the target stands between a point and that point plus a way; ``own`` (6,) is room to work in."""
    for c in range(3):
        s, w = 0.0, 0.0
        for r in range(3):
            s += turn[r, c] * (start[r] - at[r])
            w += turn[r, c] * way[r]
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
        # As in `rays`: a chord of nothing is the point's own surface.
        if leaves - enters > 1e-5 * half:
            return True
    return False


@jit
def _sees(origin: Floats, point: Floats, scene: Scene, work: Floats) -> bool:
    """Whether nothing is between an origin and a point of the target."""
    room, hiders, target, spheres, turn, at, convex = scene
    way, own = work[0:3], work[3:9]
    for r in range(3):
        way[r] = point[r] - origin[r]
    if _blocked(room, hiders, origin, way):
        return False
    return convex or not _met_by_target(target, spheres, turn, at, origin, way, own)


@jit
def _cover_cell(
    owner: int,
    wall: Floats,
    origins: Floats,
    scene: Scene,
    rule: Rule,
    stack: Floats,
    found: Floats,
    count: int,
) -> tuple[Floats, int]:
    """Cut the first cell of ``stack`` for one wall point, finer where a shadow's edge crosses it; append points."""
    gauss, digits, finest, widest, patch = rule
    point, normal, work = np.empty(3), np.empty(3), np.empty(9)
    cell = np.empty(elements.WIDTH)
    patch_radius = math.sqrt(patch[2] ** 2 + patch[3] ** 2)
    top = 1
    while top > 0:
        top -= 1
        cell[:] = stack[top]
        first, second = elements.middle_of(cell, point)
        distance = min(
            elements.distance_to_disc(point, wall[0], wall[1], 0.0),
            elements.distance_to_disc(point, patch[0], patch[1], patch_radius),
        )
        if cell[0] == elements.SPHERE:
            distance = min(distance, cell[15])
        ku, kv = elements.points_wanted(first, distance, digits), elements.points_wanted(second, distance, digits)
        cut_first = (ku > elements.MAX_POINTS and first > finest) or first > widest
        cut_second = (kv > elements.MAX_POINTS and second > finest) or second > widest
        if not cut_first and not cut_second and max(first, second) > finest:
            for o in range(origins.shape[0]):
                elements.corner_of(cell, 0, point)
                seen = _sees(origins[o], point, scene, work)
                for corner in range(1, 3 if cell[0] == elements.TRIANGLE else 4):
                    elements.corner_of(cell, corner, point)
                    if _sees(origins[o], point, scene, work) != seen:
                        cut_first, cut_second = first > 0.5 * second, second > 0.5 * first
                        break
                if cut_first or cut_second:
                    break
        if (cut_first or cut_second) and top + 4 <= stack.shape[0]:
            top = elements.cut(cell, stack, top, cut_first, cut_second)
            continue
        ku, kv = min(ku, elements.MAX_POINTS), min(kv, elements.MAX_POINTS)
        if cell[0] == elements.TRIANGLE:
            ku = kv = max(ku, kv)
        if count + ku * kv > found.shape[0]:
            grown = np.empty((2 * found.shape[0] + ku * kv, found.shape[1]))
            grown[:count] = found[:count]
            found = grown
        for i in range(ku):
            for j in range(kv):
                row = found[count]
                row[6] = elements.cell_point(cell, i, j, ku, kv, gauss, point, normal)
                row[7], row[8] = owner, cell[1]
                for r in range(3):
                    row[r], row[3 + r] = point[r], normal[r]
                count += 1
    return found, count


@jit
def _cover(
    flat: Floats,
    balls: Floats,
    pole: Floats,
    spread: float,
    rings: int,
    wall: Floats,
    origins: Floats,
    scene: Scene,
    rule: Rule,
    stack: Floats,
    found: Floats,
) -> tuple[Floats, int]:
    """As `integral.cover`, for one wall point and rays from some origins; return elements and how many they are."""
    turn, at = scene[4], scene[5]
    count = 0
    for c in range(flat.shape[0]):
        elements.place(flat[c], turn, at, stack[0])
        found, count = _cover_cell(c, wall, origins, scene, rule, stack, found, count)
    ball = np.empty(elements.WIDTH)
    for c in range(balls.shape[0]):
        elements.place(balls[c], turn, at, ball)
        rim = elements.turn_to(ball, pole, spread)
        for ring in range(rings):
            for step in range(4 * rings):
                stack[0] = ball
                elements.cap_cell(stack[0], rim, ring, step, rings)
                found, count = _cover_cell(flat.shape[0] + c, wall, origins, scene, rule, stack, found, count)
    return found, count


@jit
def _facing(element: Floats, start: Floats, way: Floats) -> float:
    """Write the way from a wall point to an element; return cos cos / distance^2 times area, 0 if it faces away."""
    for r in range(3):
        way[r] = element[r] - start[r]
    facing = -(element[3] * way[0] + element[4] * way[1] + element[5] * way[2])
    if element[8] == 0.0:
        facing = abs(facing)
    if facing <= 0.0 or way[2] <= 0.0:
        return 0.0
    squared = way[0] ** 2 + way[1] ** 2 + way[2] ** 2
    return facing * way[2] / (squared * squared) * element[6]


@jit_released
def reflected_points(
    start: int,
    stop: int,
    owner: Floats,
    walls: Floats,
    flat: Floats,
    balls: Floats,
    albedo: Floats,
    turns: Floats,
    places: Floats,
    hiders: Floats,
    convex: bool,
    rings: int,
    room: Floats,
    target: Floats,
    spheres: Floats,
    whole: Floats,
    patch: Floats,
    gauss: Floats,
    digits: float,
    finest: Floats,
    widest: float,
    values: Floats,
    used: Floats,
) -> None:
    """Evaluate `shaded.reflected` at points of the wall.

    Parameters
    ----------
    start, stop : int
        Which of them.
    owner : ndarray of shape (n,), int
        Which pose each point belongs to.
    walls : ndarray of shape (n, 3)
    flat, balls, albedo, turns, places, rings, whole, patch, gauss, digits
        As for `integral.panels`.
    hiders : ndarray of shape (poses,), int
        How many of the room's surfaces, from the first, can stand in the way.
    convex : bool
        Whether the target is one convex body or one flat sheet, which a ray enters only once.
    room, target : ndarray of shape (n, 14)
        As `rows` gives them; the target in its own frame.
    spheres : ndarray of shape (s, 4)
        Of the target, in its own frame.
    finest : ndarray of shape (poses,)
        Half widths of cells are not cut below this.
    widest : float
        No cell keeps a half width above this: an edge must not slip between its corners.
    values : ndarray of shape (n, groups), written
    used : ndarray of shape (n,), written
        Elements.
    """
    for item in range(start, stop):
        pose, wall = owner[item], walls[item]
        scene = (room, hiders[pose], target, spheres, turns[pose], places[pose], convex)
        rule = (gauss, digits, finest[pose], max(widest, finest[pose]), patch)
        stack, found = np.empty((_STACK, elements.WIDTH)), np.empty((512, 9))
        pole, total = np.array([patch[0], patch[1], 0.0]), np.zeros(values.shape[1])
        spread = math.sqrt(patch[2] ** 2 + patch[3] ** 2)
        origins = np.empty((2, 3))
        origins[0], origins[1] = wall, pole
        found, count = _cover(flat, balls, pole, spread, rings, wall, origins, scene, rule, stack, found)
        _reflect(wall, found, count, albedo, scene, whole, patch, digits, total)
        used[item] = count
        values[item] = total


@jit
def _reflect(
    wall: Floats,
    found: Floats,
    count: int,
    albedo: Floats,
    scene: Scene,
    whole: Floats,
    patch: Floats,
    digits: float,
    total: Floats,
) -> None:
    """Add to ``total`` (groups,) what a wall point receives by way of elements."""
    room, hiders, target, spheres, turn, at, convex = scene
    way, step, start, own = np.empty(3), np.empty(3), np.zeros(3), np.empty(6)
    for j in range(count):
        # Which side of the element the wall point is on: only light on that side counts.
        term = _facing(found[j], wall, way)
        if term == 0.0 or _blocked(room, hiders, wall, way):
            continue
        if not convex and _met_by_target(target, spheres, turn, at, wall, way, own):
            continue
        side = found[j, 3] * way[0] + found[j, 4] * way[1] + found[j, 5] * way[2]
        order = integral.patch_order(found[j], patch, digits)
        light = 0.0
        for q in range(order * order):
            start[0], start[1] = whole[order, 0, q], whole[order, 1, q]
            share = whole[order, 2, q] * _facing(found[j], start, step)
            if share == 0.0 or side * (found[j, 3] * step[0] + found[j, 4] * step[1] + found[j, 5] * step[2]) <= 0.0:
                continue
            if _blocked(room, hiders, start, step):
                continue
            if not convex and _met_by_target(target, spheres, turn, at, start, step, own):
                continue
            light += share / found[j, 6]
        for g in range(total.shape[0]):
            total[g] += term * light * albedo[int(found[j, 7]), g]
