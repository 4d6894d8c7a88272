"""Light from the patch by way of the target to a panel of the watched patch, with nothing in between."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport import elements, kernel
from generator.transport.compiled import jit_in_place, jit_inlined, jit_parts, jit_within
from generator.transport.elements import AREA, CELL, NORMAL, ONE_SIDED, POINT
from generator.transport.lit import ORDERS, Patch, Rules, distance_to, radius_of, seen_from
from generator.transport.records import Boxes, Disc, Parts, Target

Floats = NDArray[Any]

FRONT, BACK, ON = 1, 2, 4
"""Flags: sides of a face, and that its light continues beyond its horizon (`kernel.BEYOND`)."""

_STACK = 512
_ROWS = 256


class Seen(NamedTuple):
    """From where a target's cells are seen, and how finely they are cut.

    Attributes
    ----------
    faced : Disc
        Spheres are covered where they can be seen from within this disc.
    panel : Disc
        Disc around the panel that light goes to.
    rules : Rules
    widest : float
        No cell is left with half widths above this.
    """

    faced: Disc
    panel: Disc
    rules: Rules
    widest: float


class Covering(NamedTuple):
    """Scratch space: cells to be cut, a cell, a point, a normal, a sphere; and rows of quadrature points.

    The rows have the columns that `elements.POINT` and so on name.
    """

    stack: Floats
    cell: Floats
    middle: Floats
    normal: Floats
    ball: Floats
    points: Floats


def room_to_cover(rows: int) -> Covering:
    """Return scratch space for a number of quadrature points."""
    width = elements.WIDTH
    return Covering(
        np.empty((_STACK, width)), np.empty(width), np.empty(3), np.empty(3), np.empty(width), np.empty((rows, 9))
    )


@jit_in_place
def _cover_cell(owner: int, seen: Seen, space: Covering, count: int) -> tuple[int, float]:
    """Cut the first cell of the stack as finely as panel and patch require, and append its quadrature points.

    Returns
    -------
    count : int
        Number of points; negative if there are more than rows.
    nearest : float
        Distance from the panel to the cell.
    """
    cell, middle, stack = space.cell, space.middle, space.stack
    view, rules, widest = seen.panel, seen.rules, seen.widest
    radius = radius_of(rules.patch)
    nearest = np.inf
    top = 1
    while top > 0 and count >= 0:
        top -= 1
        elements.copy_row(stack[top], cell)
        first, second = elements.middle_of(cell, middle)
        to_panel = elements.distance_to_disc(middle, view.centre[0], view.centre[1], view.radius)
        to_patch = distance_to(middle, rules.patch)
        distance = min(to_panel, to_patch)
        if cell[elements.KIND] == elements.SPHERE:  # its normal varies over a length of its radius
            distance = min(distance, cell[elements.RADIUS])
        # The light of a cell smaller than this is uniform over the panel, or the patch's light over the cell.
        least = 0.02 * (view.radius if to_panel < to_patch else radius)
        digits = rules.digits
        if cell[elements.SHARP] > 0.0:
            elements.normal_of(cell, middle, space.normal)
            lit, faced = (rules.patch.x, rules.patch.y, radius), (view.centre[0], view.centre[1], view.radius)
            between = elements.half_way(middle, space.normal, lit, faced)
            varies, share = elements.varies_over(cell, max(first, second), between)
            distance, least = min(distance, varies), min(least, 0.2 * varies)
            digits += math.log(share)
        ku = elements.points_wanted(first, distance, digits)
        kv = elements.points_wanted(second, distance, digits)
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
        count = elements.add_points(cell, owner, ku, kv, rules.gauss, space.points, count)
    return count, nearest


@jit_in_place
def cover_in(
    target: Target, turn: Floats, at: Floats, seen: Seen, wanted: Floats, space: Covering
) -> tuple[int, float]:
    """As `cover`; write the points to ``space`` and return their number, negative if there are more than rows."""
    flat, balls, rings = target.flat, target.balls, target.rings
    count, nearest = 0, np.inf
    for c in range(flat.shape[0]):
        if wanted[c] == 0 or count < 0:
            continue
        elements.place(flat[c], turn, at, space.stack[0])
        count, near = _cover_cell(c, seen, space, count)
        nearest = min(nearest, near)
    ball = space.ball
    for c in range(balls.shape[0]):
        if wanted[flat.shape[0] + c] == 0:
            continue
        elements.place(balls[c], turn, at, ball)
        rim = elements.turn_to(ball, seen.faced.centre, seen.faced.radius)
        for cap in range(4 * rings * rings):
            if count < 0:
                break
            elements.copy_row(ball, space.stack[0])
            elements.cap_cell(space.stack[0], rim, cap // (4 * rings), cap % (4 * rings), rings)
            count, near = _cover_cell(flat.shape[0] + c, seen, space, count)
            nearest = min(nearest, near)
    return count, nearest


def cover(target: Target, turn: Floats, at: Floats, seen: Seen, wanted: Floats) -> Floats:
    """Return quadrature points on the target, as fine as a panel of the wall and the lit patch require.

    Parameters
    ----------
    target : Target
    turn, at : ndarray of shape (3, 3) and (3,)
        Rotation and position of the target.
    seen : Seen
    wanted : ndarray of shape (flat cells + spheres,), int
        0 leaves a cell out.

    Returns
    -------
    points : ndarray of shape (n, 9)
        Rows with the columns that `elements.POINT` and so on name; those of flat cells come first.
    """
    rows, count = _ROWS, -1
    while count < 0:
        space = room_to_cover(rows)
        count = _covered(target, turn, at, seen, wanted, space)
        rows *= 2
    return space.points[:count]


@jit_parts
def _covered(target: Target, turn: Floats, at: Floats, seen: Seen, wanted: Floats, space: Covering) -> int:
    """Write the points of `cover`, for a call from Python; return their number, negative if there are too many."""
    return cover_in(target, turn, at, seen, wanted, space)[0]


def around_patch(patch: Patch) -> Disc:
    """Return a disc around the lit patch."""
    return Disc(np.array([patch.x, patch.y, 0.0]), radius_of(patch))


@jit_within
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


class _Job(NamedTuple):
    """Panels, and what they receive light from: see `panels`."""

    boxes: Boxes
    target: Target
    parts: Parts
    rules: Rules


class _Space(NamedTuple):
    """Scratch space: compiled functions that create no arrays are compiled in a third of the time.

    Attributes
    ----------
    covering : Covering
    faced, centre : ndarray of shape (3,)
        Centres of discs around the patch and the panel.
    wall : ndarray of shape (2, k)
        The panel's points, relative to the centre.
    near : ndarray of shape (2, k)
        The same, in the type of the sums.
    sent : ndarray of shape (groups, 6, n)
        Elements of `kernel.radiance`, in the type of the sums.
    sums : ndarray of shape (groups, k)
    exact, moves : ndarray of shape (groups, 6, n) and (10, n)
        Elements of `kernel.radiance_gradient`, and what they move by; derivatives are summed in double precision.
    nodes : ndarray of shape (3, ORDERS^2)
    normal, gradient : ndarray of shape (3,) and (6,)
    sides : ndarray of shape (cells,), int
    """

    covering: Covering
    faced: Floats
    centre: Floats
    wall: Floats
    near: Floats
    sent: Floats
    sums: Floats
    exact: Floats
    moves: Floats
    nodes: Floats
    normal: Floats
    gradient: Floats
    sides: Floats


def _space(job: _Job, channels: int, rows: int) -> _Space:
    """Return scratch space for panels, with room for a number of quadrature points."""
    groups, points, dtype = job.target.albedo.shape[1], len(job.boxes.places), job.boxes.like.dtype
    moving, elements_most = channels > 1, 2 * rows + 8  # no power of two: rows would share the lines of a cache
    return _Space(
        room_to_cover(rows),
        np.array([job.rules.patch.x, job.rules.patch.y, 0.0]),
        np.zeros(3),
        np.empty((2, points)),
        np.empty((2, points), dtype),
        np.empty((groups, 6, 0 if moving else elements_most), dtype),
        np.empty((groups, points), dtype),
        np.empty((groups, 6, elements_most if moving else 0)),
        np.empty((10, elements_most if moving else 0)),
        np.empty((3, ORDERS * ORDERS)),
        np.empty(3),
        np.empty(6),
        np.empty(len(job.target.faces), dtype=np.int64),
    )


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
    job, rows = _Job(boxes, target, parts, rules), max(_ROWS, 16 * len(target.faces))
    while start < stop:
        start = _evaluate(start, stop, job, _space(job, values.shape[2], rows), values, reports)
        rows *= 2


@jit_parts
def _evaluate(start: int, stop: int, job: _Job, space: _Space, values: Floats, reports: Floats) -> int:
    """Evaluate panels; return the first that was not, because ``space`` is too small for it."""
    boxes, target, parts = job.boxes, job.target, job.parts
    for item in range(start, stop):
        part = boxes.owner[item]
        pose = parts.poses[part]
        for k in range(target.faces.shape[0]):
            space.sides[k] = parts.wanted[part, target.faces[k]]
        turn, at = parts.turns[pose], parts.places[pose]
        view = Disc(space.centre, panel_at(boxes.boxes[item], boxes, space.wall, space.centre))
        for r in range(2):
            elements.copy_row(space.wall[r], space.near[r])
        if not _target_panel(target, turn, at, job.rules, view, space, values[item], reports[item]):
            return item
    return stop


@jit_within
def panel_at(box: Floats, boxes: Boxes, wall: Floats, centre: Floats) -> float:
    """Write the panel that a box (4,) of the picture shows, its points (2, k) relative to its centre (3,).

    Returns
    -------
    float
        Radius of a disc around it.
    """
    places, to_wall = boxes.places, boxes.to_wall
    n = places.shape[0]
    for k in range(n):
        u = box[0] + places[k, 0] * (box[1] - box[0])
        v = box[2] + places[k, 1] * (box[3] - box[2])
        far = to_wall[2, 0] * u + to_wall[2, 1] * v + to_wall[2, 2]
        wall[0, k] = (to_wall[0, 0] * u + to_wall[0, 1] * v + to_wall[0, 2]) / far
        wall[1, k] = (to_wall[1, 0] * u + to_wall[1, 1] * v + to_wall[1, 2]) / far
    radius = 0.0
    centre[0], centre[1] = 0.0, 0.0
    for k in range(n - 4, n):
        centre[0] += wall[0, k] / 4.0
        centre[1] += wall[1, k] / 4.0
    for k in range(n - 4, n):
        radius = max(radius, math.hypot(wall[0, k] - centre[0], wall[1, k] - centre[1]))
    for r in range(2):
        for k in range(n):
            wall[r, k] -= centre[r]
    return radius


@jit_within
def _target_panel(
    target: Target, turn: Floats, at: Floats, rules: Rules, view: Disc, space: _Space, values: Floats, report: Floats
) -> bool:
    """Write to ``values`` (groups, 1 or 7, k) what one panel's points receive from the target at a pose.

    Returns
    -------
    bool
        Whether ``space`` is large enough.
    """
    centre, radius, wanted, nodes = view.centre, view.radius, space.sides, space.nodes
    points, normal, gradient = space.covering.points, space.normal, space.gradient
    seen = Seen(Disc(space.faced, radius_of(rules.patch)), view, rules, np.inf)
    rows, nearest = cover_in(target, turn, at, seen, wanted, space.covering)
    if rows < 0:
        return False
    groups, moving = target.albedo.shape[1], values.shape[1] > 1
    count, most = 0, 0
    for k in range(rows):
        point, area, row = points[k, POINT:NORMAL], points[k, AREA], int(points[k, CELL])
        for side in range(1 if points[k, ONE_SIDED] else 2):
            if wanted[row] & (side + 1) == 0:
                continue
            for r in range(3):
                normal[r] = -points[k, NORMAL + r] if side else points[k, NORMAL + r]
            u, v = centre[0] - point[0], centre[1] - point[1]
            if normal[0] * u + normal[1] * v - normal[2] * point[2] < -radius:
                continue  # faces away from all of the panel
            whole, number = seen_from(point, normal, rules, nodes)
            if number == 0:
                continue
            lamps = rules.whole[whole] if whole >= 0 else nodes
            if moving:
                light = _moves(point, normal, at, area, lamps, number, gradient, space.moves[:, count])
            else:
                light = kernel.irradiance(point, normal, lamps, number)
            if light <= 0.0:
                continue
            most = max(most, number)
            for g in range(groups):
                if moving:
                    _send(space.exact[g], count, -u, -v, point[2], normal, target.albedo[row, g])
                else:
                    _send(space.sent[g], count, -u, -v, point[2], normal, target.albedo[row, g] * light * area)
            count += 1
    floor = 0.0
    for k in range(wanted.shape[0]):
        if wanted[k] & ON != 0:
            floor = kernel.BEYOND
    for g in range(groups):
        values[g] = 0.0
        if moving:
            wall, sent = space.wall, space.exact[g]
            kernel.radiance_gradient(wall[0], wall[1], sent, space.moves, count, floor, values[g])
            continue
        sums = space.sums[g]
        sums[:] = 0.0
        kernel.radiance(space.near[0], space.near[1], space.sent[g], count, floor, sums)
        elements.copy_row(sums, values[g, 0])
    report[0], report[1], report[2], report[3] = count, most, nearest, radius
    return True


@jit_inlined
def _send(sent: Floats, k: int, x: float, y: float, height: float, normal: Floats, strength: float) -> None:
    """Write an element (6, n) of `kernel.radiance`."""
    sent[0, k], sent[1, k], sent[2, k] = x, y, height
    for r in range(3):
        sent[3 + r, k] = normal[r] * strength
