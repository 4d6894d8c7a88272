"""What a panel of the watched patch receives by way of the target: patch, target, wall; nothing in between."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from generator.transport import elements, kernel
from generator.transport.compiled import NONE, jit, jit_released

Floats = NDArray[Any]

PATCH_ORDERS = 40
"""Most quadrature points along a diameter of the lit patch: enough at a hundredth of its radius."""

FRONT, BACK, ON = 1, 2, 4
"""Sides of a face, and that its light goes on beyond its horizon (`kernel.BEYOND`)."""

_STACK = 512

# A set of many objects makes a setting for each, and the rules are most of the work of it.
leggauss = cache(legendre.leggauss)


def patch_rules(patch: Floats) -> Floats:
    """Return quadrature rules of the whole lit patch, (PATCH_ORDERS + 1, 3, PATCH_ORDERS^2), rule k with k^2 points.

    Chebyshev points of the second kind across the disc (their weight, the square of the sine, is the disc's own) and
    Gauss points along each chord.
    """
    rules = np.zeros((PATCH_ORDERS + 1, 3, PATCH_ORDERS**2))
    centre, major, minor = patch[0:2], patch[2:4], patch[4:6]
    area = abs(major[0] * minor[1] - major[1] * minor[0])
    for k in range(1, PATCH_ORDERS + 1):
        alpha = np.pi * np.arange(1, k + 1) / (k + 1)
        t, weight = leggauss(k)
        s, reach = np.cos(alpha)[:, None] + 0.0 * t, np.sin(alpha)[:, None] * t
        points = centre + s.reshape(-1, 1) * major + reach.reshape(-1, 1) * minor
        weights = area * (np.pi / (k + 1) * np.sin(alpha) ** 2)[:, None] * weight
        rules[k, 0, : k * k], rules[k, 1, : k * k] = points.T
        radiance = [elements.patch_radiance(float(p), float(q), patch) for p, q in points]
        rules[k, 2, : k * k] = weights.ravel() * radiance
    return rules


@cache
def chord_rules() -> Floats:
    """Return Gauss points and weights on [0, 1], (PATCH_ORDERS + 1, 2, PATCH_ORDERS), for `elements.clip_patch`."""
    rules = np.zeros((PATCH_ORDERS + 1, 2, PATCH_ORDERS))
    for k in range(1, PATCH_ORDERS + 1):
        x, w = leggauss(k)
        rules[k, 0, :k], rules[k, 1, :k] = (x + 1.0) / 2.0, w / 2.0
    return rules


@jit
def patch_order(x: Floats, patch: Floats, digits: float) -> int:
    """Points along the patch's diameter that a surface point needs: fewer the farther it is."""
    radius = math.sqrt(patch[2] ** 2 + patch[3] ** 2)
    ratio = elements.distance_to_disc(x, patch[0], patch[1], radius) / radius
    rate = 2.0 * math.log(ratio + math.sqrt(1.0 + ratio * ratio))
    order = 1 if patch[13] == 0.0 else 12  # a soft edge is smooth only piecewise
    # As for cells (`elements.points_wanted`), with the pole above the disc's middle in place of beside its rim.
    while order < PATCH_ORDERS - 4 and order * rate - 3.0 * math.log(2.0 * order) < digits:
        order += 1
    return order


@jit
def see_patch(
    x: Floats, n: Floats, patch: Floats, digits: float, whole: Floats, chords: Floats, nodes: Floats
) -> tuple[Floats, int]:
    """Return the quadrature points of what a surface point sees of the patch, and how many they are."""
    order = patch_order(x, patch, digits)
    level = n[0] * (patch[0] - x[0]) + n[1] * (patch[1] - x[1]) - n[2] * x[2]
    steep = math.sqrt((n[0] * patch[2] + n[1] * patch[3]) ** 2 + (n[0] * patch[4] + n[1] * patch[5]) ** 2)
    if level >= steep:
        return whole[order], order * order
    if level <= -steep:
        return nodes, 0
    order = chord_order(order, math.acos(max(-1.0, min(1.0, -level / steep))), digits)
    return nodes, elements.clip_patch(x, n, patch, chords[order], order, nodes)


@jit
def chord_order(order: int, arc: float, digits: float) -> int:
    """Points that half of the part of the patch's edge that is seen, an arc of the unit circle, needs.

    Gauss's rule needs arc / 2 times the points that equal steps take around the circle (Trefethen 2008, section 5),
    and as many as the light's own Fourier series, up to cos(3 alpha) / 4, asks: its error is a Bessel function of
    order 2 k at 3 arc / 2 (Abramowitz and Stegun 9.1.62).
    """
    k = order + 3 if arc < 2.0 else math.ceil(order * arc / 2.0) + 3
    while k < PATCH_ORDERS and 2.0 * k * math.log(0.75 * arc) - math.lgamma(2.0 * k + 1.0) > math.log(4.0) - digits:
        k += 1
    return min(k, PATCH_ORDERS)


@jit
def _cover_cell(
    stack: Floats,
    owner: int,
    centre: Floats,
    radius: float,
    patch: Floats,
    gauss: Floats,
    digits: float,
    widest: float,
    found: Floats,
    count: int,
) -> tuple[Floats, int, float]:
    """Cut the first cell of ``stack`` as finely as panel and patch ask, and append its quadrature points."""
    middle, point, normal = np.empty(3), np.empty(3), np.empty(3)
    cell = np.empty(elements.WIDTH)
    patch_radius = math.sqrt(patch[2] ** 2 + patch[3] ** 2)
    nearest = np.inf
    top = 1
    while top > 0:
        top -= 1
        cell[:] = stack[top]
        first, second = elements.middle_of(cell, middle)
        to_panel = elements.distance_to_disc(middle, centre[0], centre[1], radius)
        to_patch = elements.distance_to_disc(middle, patch[0], patch[1], patch_radius)
        distance = min(to_panel, to_patch)
        if cell[0] == elements.SPHERE:  # whose normal turns within its radius
            distance = min(distance, cell[15])
        ku = elements.points_wanted(first, distance, digits)
        kv = elements.points_wanted(second, distance, digits)
        # Smaller than this, a cell's light is spread evenly over the panel, or the patch's over the cell.
        least = 0.02 * (radius if to_panel < to_patch else patch_radius)
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
    return found, count, nearest


@jit
def cover(
    flat: Floats,
    balls: Floats,
    turn: Floats,
    at: Floats,
    pole: Floats,
    spread: float,
    rings: int,
    centre: Floats,
    radius: float,
    patch: Floats,
    gauss: Floats,
    digits: float,
    widest: float,
    wanted: Floats,
) -> tuple[Floats, float]:
    """Return quadrature points on the target, as fine as a panel of the wall and the lit patch ask.

    Parameters
    ----------
    flat, balls : ndarray of shape (n, WIDTH)
        In the target's frame.
    turn, at : ndarray of shape (3, 3) and (3,)
        The target's rotation and position.
    pole : ndarray of shape (3,)
        Spheres are covered where they can be seen from within ``spread`` of this point.
    spread : float
    rings : int
        How finely spheres are cut.
    centre, radius
        Of the panel, on the wall.
    patch, gauss, digits
        As for `panels`.
    widest : float
        No cell is left with half widths above this.
    wanted : ndarray of shape (flat cells + spheres,), int
        0 leaves a cell out.

    Returns
    -------
    found : ndarray of shape (n, 9)
        Position (3), unit normal (3), area, row of the albedo (flat cells first), one-sided.
    nearest : float
        Distance from the panel to the target.
    """
    stack = np.empty((_STACK, elements.WIDTH))
    found = np.empty((256, 9))
    count, nearest = NONE[0], np.inf
    for c in range(flat.shape[0]):
        if wanted[c] == 0:
            continue
        elements.place(flat[c], turn, at, stack[0])
        found, count, near = _cover_cell(stack, c, centre, radius, patch, gauss, digits, widest, found, count)
        nearest = min(nearest, near)
    ball = np.empty(elements.WIDTH)
    for c in range(balls.shape[0]):
        if wanted[flat.shape[0] + c] == 0:
            continue
        elements.place(balls[c], turn, at, ball)
        rim = elements.turn_to(ball, pole, spread)
        for ring in range(rings):
            for step in range(4 * rings):
                stack[0] = ball
                elements.cap_cell(stack[0], rim, ring, step, rings)
                found, count, near = _cover_cell(
                    stack, flat.shape[0] + c, centre, radius, patch, gauss, digits, widest, found, count
                )
                nearest = min(nearest, near)
    return found[:count], nearest


@jit
def _target_panel(
    a: Floats,
    b: Floats,
    centre: Floats,
    radius: float,
    flat: Floats,
    balls: Floats,
    albedo: Floats,
    turn: Floats,
    at: Floats,
    rings: int,
    patch: Floats,
    whole: Floats,
    chords: Floats,
    gauss: Floats,
    digits: float,
    moving: bool,
    wanted: Floats,
    total: Floats,
    report: Floats,
) -> None:
    """Add to ``total`` what one panel's points, ``a`` and ``b`` from its centre, receive from the target."""
    pole = np.array([patch[0], patch[1], 0.0])
    spread = math.sqrt(patch[2] ** 2 + patch[3] ** 2)
    found, nearest = cover(
        flat, balls, turn, at, pole, spread, rings, centre, radius, patch, gauss, digits, np.inf, wanted
    )
    groups = albedo.shape[1]
    sent = np.empty((groups, 6, 2 * found.shape[0]), dtype=a.dtype)
    moves = np.empty((10, 2 * found.shape[0] if moving else 0))
    nodes = np.empty((3, PATCH_ORDERS * PATCH_ORDERS))
    normal, gradient = np.empty(3), np.empty(6)
    count, most = 0, 0
    for k in range(found.shape[0]):
        point, area, row = found[k, 0:3], found[k, 6], int(found[k, 7])
        for side in range(1 if found[k, 8] else 2):
            if wanted[row] & (side + 1) == 0:
                continue
            for r in range(3):
                normal[r] = -found[k, 3 + r] if side else found[k, 3 + r]
            u, v = centre[0] - point[0], centre[1] - point[1]
            if normal[0] * u + normal[1] * v - normal[2] * point[2] < -radius:
                continue  # faces away from all of the panel
            seen, number = see_patch(point, normal, patch, digits, whole, chords, nodes)
            if number == 0:
                continue
            if moving:
                light = kernel.irradiance_gradient(point, normal, seen, number, gradient)
                moves[0, count] = light * area
                for r in range(3):
                    moves[7 + r, count] = point[r] - at[r]
                for r in range(3):
                    s, t = (r + 1) % 3, (r + 2) % 3
                    moves[1 + r, count] = gradient[r] * area
                    moves[4 + r, count] = area * (
                        moves[7 + s, count] * gradient[t]
                        - moves[7 + t, count] * gradient[s]
                        + normal[s] * gradient[3 + t]
                        - normal[t] * gradient[3 + s]
                    )
            else:
                light = kernel.irradiance(point, normal, seen, number)
            if light <= 0.0:
                continue
            most = max(most, number)
            for g in range(groups):
                sent[g, 0, count], sent[g, 1, count] = -u, -v
                sent[g, 2, count] = point[2]
                strength = albedo[row, g] if moving else albedo[row, g] * light * area
                for r in range(3):
                    sent[g, 3 + r, count] = normal[r] * strength
            count += 1
    floor = kernel.BEYOND if (wanted & ON != 0).any() else 0.0
    for g in range(groups):
        if moving:
            kernel.radiance_gradient(a, b, sent[g], moves, count, floor, total[g])
        else:
            kernel.radiance(a, b, sent[g], count, floor, total[g, 0])
    report[0], report[1], report[2], report[3] = count, most, nearest, radius


@jit
def panel_points(box: Floats, places: Floats, to_wall: Floats, like: Floats) -> tuple[Floats, Floats, Floats, float]:
    """Return a panel's points from its centre (two arrays), the centre, and the radius around it.

    The last four of ``places`` are the corners.
    """
    n = places.shape[0]
    wall = np.empty((2, n))
    for k in range(n):
        u = box[0] + places[k, 0] * (box[1] - box[0])
        v = box[2] + places[k, 1] * (box[3] - box[2])
        far = to_wall[2, 0] * u + to_wall[2, 1] * v + to_wall[2, 2]
        wall[0, k] = (to_wall[0, 0] * u + to_wall[0, 1] * v + to_wall[0, 2]) / far
        wall[1, k] = (to_wall[1, 0] * u + to_wall[1, 1] * v + to_wall[1, 2]) / far
    centre = np.empty(2)
    centre[0], centre[1] = wall[0, n - 4 :].mean(), wall[1, n - 4 :].mean()
    radius = 0.0
    for k in range(n - 4, n):
        radius = max(radius, math.hypot(wall[0, k] - centre[0], wall[1, k] - centre[1]))
    a, b = np.empty(n, dtype=like.dtype), np.empty(n, dtype=like.dtype)
    for k in range(n):
        a[k], b[k] = wall[0, k] - centre[0], wall[1, k] - centre[1]
    return a, b, centre, radius


@jit_released
def panels(
    start: int,
    stop: int,
    owner: Floats,
    boxes: Floats,
    to_wall: Floats,
    places_on: Floats,
    flat: Floats,
    balls: Floats,
    albedo: Floats,
    faces: Floats,
    poses: Floats,
    wanted: Floats,
    turns: Floats,
    places: Floats,
    rings: int,
    patch: Floats,
    whole: Floats,
    chords: Floats,
    gauss: Floats,
    digits: float,
    moving: bool,
    like: Floats,
    values: Floats,
    reports: Floats,
) -> None:
    """Evaluate panels of pictures: what their points receive from the target.

    Lengths are in the wall's frame: origin on the wall, third axis its normal.

    Parameters
    ----------
    start, stop : int
        Which of them.
    owner : ndarray of shape (n,), int
        Which part of a picture each panel belongs to.
    boxes : ndarray of shape (n, 4)
        Each panel's u and v range in its picture.
    to_wall : ndarray of shape (3, 3)
        The projective map from (u, v, 1) to the wall's two axes.
    places_on : ndarray of shape (k, 2)
        A panel's points, on [0, 1], the last four its corners.
    flat, balls : ndarray of shape (n, WIDTH)
        The target's flat cells and spheres, in its own frame.
    albedo : ndarray of shape (cells + spheres, groups)
    faces : ndarray of shape (cells + spheres,), int
        Which of the target's faces each is in.
    poses : ndarray of shape (parts,), int
    wanted : ndarray of shape (parts, faces), int
        Which sides of a face a part is made of: `FRONT`, `BACK`, both, or neither; and with `ON`, whether its light
        goes on beyond its horizon.
    turns, places : ndarray of shape (poses, 3, 3) and (poses, 3)
        The target's rotation and position.
    rings : int
        How finely spheres are cut.
    patch, whole, chords, gauss : ndarray
        The lit patch and the rules of `patch_rules`, `chord_rules` and `elements.GAUSS`.
    digits : float
        Natural logarithm of one over the quadrature's relative accuracy.
    moving : bool
        With derivatives.
    like : ndarray
        Of the type, float32 or float64, in which to sum.
    values : ndarray of shape (n, groups, 1 or 7, k), written
    reports : ndarray of shape (n, 4), written
        Quadrature points on the target, most points on the patch, distance from panel to target, panel's radius.
    """
    for item in range(start, stop):
        a, b, centre, radius = panel_points(boxes[item], places_on, to_wall, like)
        total = np.zeros((values.shape[1], values.shape[2], places_on.shape[0]), dtype=like.dtype)
        part = owner[item]
        pose = poses[part]
        sides = np.empty(faces.shape[0], dtype=np.int64)
        for k in range(faces.shape[0]):
            sides[k] = wanted[part, faces[k]]
        _target_panel(
            a,
            b,
            centre,
            radius,
            flat,
            balls,
            albedo,
            turns[pose],
            places[pose],
            rings,
            patch,
            whole,
            chords,
            gauss,
            digits,
            moving,
            sides,
            total,
            reports[item],
        )
        values[item] = total
