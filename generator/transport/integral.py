"""Light from the patch by way of the target to a panel of the watched patch, with nothing in between."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport import elements, kernel
from generator.transport.compiled import NONE, jit, jit_in_place, jit_released
from generator.transport.elements import AREA, CELL, NORMAL, ONE_SIDED, POINT
from generator.transport.lit import ORDERS, Patch, Rules, distance_to, radius_of, seen_from
from generator.transport.records import Boxes, Disc, Parts, Target

Floats = NDArray[Any]

FRONT, BACK, ON = 1, 2, 4
"""Flags: sides of a face, and that its light continues beyond its horizon (`kernel.BEYOND`)."""

_STACK = 512


@jit
def _cover_cell(
    stack: Floats, owner: int, view: Disc, rules: Rules, widest: float, found: Floats, count: int
) -> tuple[Floats, int, float]:
    """Cut the first cell of ``stack`` as finely as panel and patch require, and append its quadrature points."""
    middle = np.empty(3)
    cell = np.empty(elements.WIDTH)
    radius = radius_of(rules.patch)
    nearest = np.inf
    top = 1
    while top > 0:
        top -= 1
        elements.copy_row(stack[top], cell)
        first, second = elements.middle_of(cell, middle)
        to_panel = elements.distance_to_disc(middle, view.centre[0], view.centre[1], view.radius)
        to_patch = distance_to(middle, rules.patch)
        distance = min(to_panel, to_patch)
        if cell[elements.KIND] == elements.SPHERE:  # its normal varies over a length of its radius
            distance = min(distance, cell[elements.RADIUS])
        ku = elements.points_wanted(first, distance, rules.digits)
        kv = elements.points_wanted(second, distance, rules.digits)
        # The light of a cell smaller than this is uniform over the panel, or the patch's light over the cell.
        least = 0.02 * (view.radius if to_panel < to_patch else radius)
        cut_first = (ku > elements.MAX_POINTS and first > least) or first > widest
        cut_second = (kv > elements.MAX_POINTS and second > least) or second > widest
        if (cut_first or cut_second) and top + 4 <= stack.shape[0]:
            top = elements.cut(cell, stack, top, cut_first, cut_second)
            continue
        nearest = min(nearest, max(to_panel - math.hypot(first, second), to_panel / 4.0))
        ku, kv = min(ku, elements.MAX_POINTS), min(kv, elements.MAX_POINTS)
        if widest == np.inf:
            # The four cosines may all vanish at one edge of the cell: a rule must be exact for the fourth degree.
            ku, kv = max(ku, 3), max(kv, 3)
        if cell[elements.KIND] == elements.TRIANGLE:
            ku = kv = max(ku, kv)
        found = elements.with_room_for(found, count, ku * kv)
        count = elements.add_points(cell, owner, ku, kv, rules.gauss, found, count)
    return found, count, nearest


@jit
def cover(
    target: Target,
    turn: Floats,
    at: Floats,
    faced: Disc,
    view: Disc,
    rules: Rules,
    widest: float,
    wanted: Floats,
) -> tuple[Floats, float]:
    """Return quadrature points on the target, as fine as a panel of the wall and the lit patch require.

    Parameters
    ----------
    target : Target
    turn, at : ndarray of shape (3, 3) and (3,)
        Rotation and position of the target.
    faced : Disc
        Spheres are covered where they can be seen from within this disc.
    view : Disc
        Disc around the panel.
    rules : Rules
    widest : float
        No cell is left with half widths above this.
    wanted : ndarray of shape (flat cells + spheres,), int
        0 leaves a cell out.

    Returns
    -------
    points : ndarray of shape (n, 9)
        Rows with the columns that `elements.POINT` and so on name; those of flat cells come first.
    nearest : float
        Distance from the panel to the target.
    """
    flat, balls, rings = target.flat, target.balls, target.rings
    stack = np.empty((_STACK, elements.WIDTH))
    points = np.empty((256, 9))
    count, nearest = NONE[0], np.inf
    for c in range(flat.shape[0]):
        if wanted[c] == 0:
            continue
        elements.place(flat[c], turn, at, stack[0])
        points, count, near = _cover_cell(stack, c, view, rules, widest, points, count)
        nearest = min(nearest, near)
    ball = np.empty(elements.WIDTH)
    for c in range(balls.shape[0]):
        if wanted[flat.shape[0] + c] == 0:
            continue
        elements.place(balls[c], turn, at, ball)
        rim = elements.turn_to(ball, faced.centre, faced.radius)
        for ring in range(rings):
            for step in range(4 * rings):
                elements.copy_row(ball, stack[0])
                elements.cap_cell(stack[0], rim, ring, step, rings)
                points, count, near = _cover_cell(stack, flat.shape[0] + c, view, rules, widest, points, count)
                nearest = min(nearest, near)
    return points[:count], nearest


@jit
def around_patch(patch: Patch) -> Disc:
    """Return a disc around the lit patch."""
    return Disc(np.array([patch.x, patch.y, 0.0]), radius_of(patch))


@jit_in_place
def _moves(
    point: Floats, normal: Floats, at: Floats, area: float, seen: Floats, number: int, gradient: Floats, moves: Floats
) -> float:
    """Write a point's column (10,) of ``moves`` for `kernel.radiance_gradient`; return the point's irradiance.

    ``gradient`` (6,) is scratch space.
    """
    light = kernel.irradiance_gradient(point, normal, seen, number, gradient)
    moves[0] = light * area
    for r in range(3):
        moves[7 + r] = point[r] - at[r]
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        moves[1 + r] = gradient[r] * area
        moves[4 + r] = area * (
            moves[7 + s] * gradient[t]
            - moves[7 + t] * gradient[s]
            + normal[s] * gradient[3 + t]
            - normal[t] * gradient[3 + s]
        )
    return light


class Panel(NamedTuple):
    """A panel's points, ``a`` and ``b`` (k,), relative to the centre of a disc around them."""

    a: Floats
    b: Floats
    disc: Disc


@jit
def panel_at(box: Floats, boxes: Boxes) -> Panel:
    """Return the panel that a box (4,) of the picture shows."""
    places, to_wall = boxes.places, boxes.to_wall
    n = places.shape[0]
    wall = np.empty((2, n))
    for k in range(n):
        u = box[0] + places[k, 0] * (box[1] - box[0])
        v = box[2] + places[k, 1] * (box[3] - box[2])
        far = to_wall[2, 0] * u + to_wall[2, 1] * v + to_wall[2, 2]
        wall[0, k] = (to_wall[0, 0] * u + to_wall[0, 1] * v + to_wall[0, 2]) / far
        wall[1, k] = (to_wall[1, 0] * u + to_wall[1, 1] * v + to_wall[1, 2]) / far
    centre = np.zeros(3)
    centre[0], centre[1] = wall[0, n - 4 :].mean(), wall[1, n - 4 :].mean()
    radius = 0.0
    for k in range(n - 4, n):
        radius = max(radius, math.hypot(wall[0, k] - centre[0], wall[1, k] - centre[1]))
    a, b = np.empty(n, dtype=boxes.like.dtype), np.empty(n, dtype=boxes.like.dtype)
    for k in range(n):
        a[k], b[k] = wall[0, k] - centre[0], wall[1, k] - centre[1]
    return Panel(a, b, Disc(centre, radius))


@jit
def _target_panel(
    panel: Panel,
    target: Target,
    turn: Floats,
    at: Floats,
    wanted: Floats,
    rules: Rules,
    total: Floats,
    report: Floats,
) -> None:
    """Add to ``total`` (groups, 1 or 7, k) what one panel's points receive from the target at a pose."""
    centre, radius = panel.disc.centre, panel.disc.radius
    points, nearest = cover(target, turn, at, around_patch(rules.patch), panel.disc, rules, np.inf, wanted)
    groups, moving = target.albedo.shape[1], total.shape[1] > 1
    sent = np.empty((groups, 6, 2 * points.shape[0]), dtype=panel.a.dtype)
    moves = np.empty((10, 2 * points.shape[0] if moving else 0))
    nodes = np.empty((3, ORDERS * ORDERS))
    normal, gradient = np.empty(3), np.empty(6)
    count, most = 0, 0
    for k in range(points.shape[0]):
        point, area, row = points[k, POINT:NORMAL], points[k, AREA], int(points[k, CELL])
        for side in range(1 if points[k, ONE_SIDED] else 2):
            if wanted[row] & (side + 1) == 0:
                continue
            for r in range(3):
                normal[r] = -points[k, NORMAL + r] if side else points[k, NORMAL + r]
            u, v = centre[0] - point[0], centre[1] - point[1]
            if normal[0] * u + normal[1] * v - normal[2] * point[2] < -radius:
                continue  # faces away from all of the panel
            seen, number = seen_from(point, normal, rules, nodes)
            if number == 0:
                continue
            if moving:
                light = _moves(point, normal, at, area, seen, number, gradient, moves[:, count])
            else:
                light = kernel.irradiance(point, normal, seen, number)
            if light <= 0.0:
                continue
            most = max(most, number)
            for g in range(groups):
                sent[g, 0, count], sent[g, 1, count] = -u, -v
                sent[g, 2, count] = point[2]
                strength = target.albedo[row, g] if moving else target.albedo[row, g] * light * area
                for r in range(3):
                    sent[g, 3 + r, count] = normal[r] * strength
            count += 1
    floor = kernel.BEYOND if (wanted & ON != 0).any() else 0.0
    for g in range(groups):
        if moving:
            kernel.radiance_gradient(panel.a, panel.b, sent[g], moves, count, floor, total[g])
        else:
            kernel.radiance(panel.a, panel.b, sent[g], count, floor, total[g, 0])
    report[0], report[1], report[2], report[3] = count, most, nearest, radius


@jit_released
def panels(
    start: int,
    stop: int,
    boxes: Boxes,
    target: Target,
    parts: Parts,
    rules: Rules,
    values: Floats,
    reports: Floats,
) -> None:
    """Evaluate panels ``start`` to ``stop`` of pictures: what their points receive from the target.

    Parameters
    ----------
    start, stop : int
    boxes : Boxes
    target : Target
    parts : Parts
    rules : Rules
    values : ndarray of shape (n, groups, 1 or 7, k), written
        With seven channels, the derivatives for the target's position (3) and its rotation about the three axes (3)
        follow.
    reports : ndarray of shape (n, 4), written
        Quadrature points on the target, most points on the patch, distance from panel to target, panel's radius.
    """
    for item in range(start, stop):
        panel = panel_at(boxes.boxes[item], boxes)
        total = np.zeros((values.shape[1], values.shape[2], panel.a.shape[0]), dtype=boxes.like.dtype)
        part = boxes.owner[item]
        pose = parts.poses[part]
        sides = np.empty(target.faces.shape[0], dtype=np.int64)
        for k in range(target.faces.shape[0]):
            sides[k] = parts.wanted[part, target.faces[k]]
        turn, place = parts.turns[pose], parts.places[pose]
        _target_panel(panel, target, turn, place, sides, rules, total, reports[item])
        values[item] = total
