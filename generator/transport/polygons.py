"""Convex polygons in a plane: cut along lines, taken from one another, and light summed over them.

Sums over a polygon converge as fast as the light on it is smooth, so a shadow whose edge is a polygon's edge costs no
more than no shadow.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.transport import elements, integral
from generator.transport.compiled import jit

Floats = NDArray[Any]

CORNERS = 128
"""Most that a polygon can have."""
PIECES = 96
"""Most that a polygon may fall into."""

FACET = 36
"""Width of a row: origin (3), two axes (3 + 3), normal (3), level, how many corners, corners (4 x 3), the same along
the axes (4 x 2), one-sided, 0."""

_TOUCH = 1e-9


@jit
def lay(origin: Floats, first: Floats, second: Floats, triangle: bool, row: Floats) -> None:
    """Write a parallelogram or triangle, given by a corner and two edges, as a facet."""
    row[0:3] = origin
    row[9], row[10], row[11] = (
        first[1] * second[2] - first[2] * second[1],
        first[2] * second[0] - first[0] * second[2],
        first[0] * second[1] - first[1] * second[0],
    )
    row[3:6] = first / math.sqrt((first * first).sum())
    row[9:12] /= math.sqrt((row[9:12] * row[9:12]).sum())
    row[6], row[7], row[8] = (
        row[10] * row[5] - row[11] * row[4],
        row[11] * row[3] - row[9] * row[5],
        row[9] * row[4] - row[10] * row[3],
    )
    row[12] = (row[9:12] * origin).sum()
    row[13] = 3 if triangle else 4
    row[14:17] = origin
    row[17:20] = origin + first
    row[20:23] = origin + second if triangle else origin + first + second
    row[23:26] = origin + second
    for k in range(4):
        for r in range(2):
            row[26 + 2 * k + r] = ((row[14 + 3 * k : 17 + 3 * k] - origin) * row[3 + 3 * r : 6 + 3 * r]).sum()


@jit
def outline(facet: Floats, polygon: Floats) -> int:
    """Write a facet's own corners along its axes; return how many."""
    n = int(facet[13])
    for k in range(n):
        polygon[k, 0], polygon[k, 1] = facet[26 + 2 * k], facet[27 + 2 * k]
    return n


@jit
def clip(polygon: Floats, n: int, a: float, b: float, c: float, kept: Floats) -> int:
    """Write the part of a polygon where a u + b v + c >= 0 (Sutherland and Hodgman 1974); return its corners."""
    m = 0
    if n == 0:
        return 0
    u0, v0 = polygon[n - 1, 0], polygon[n - 1, 1]
    before = a * u0 + b * v0 + c
    for k in range(n):
        u, v = polygon[k, 0], polygon[k, 1]
        here = a * u + b * v + c
        if (here >= 0.0) != (before >= 0.0):
            t = before / (before - here)
            kept[m, 0], kept[m, 1] = u0 + t * (u - u0), v0 + t * (v - v0)
            m += 1
        if here >= 0.0:
            kept[m, 0], kept[m, 1] = u, v
            m += 1
        u0, v0, before = u, v, here
    return m


@jit
def within(polygon: Floats, n: int, lines: Floats, k: int, kept: Floats, spare: Floats) -> int:
    """Write the part of a polygon inside all of ``k`` lines (k, 3); return its corners, 0 if there is none."""
    for i in range(k):
        inside = 0
        for j in range(n):
            if lines[i, 0] * polygon[j, 0] + lines[i, 1] * polygon[j, 1] + lines[i, 2] >= 0.0:
                inside += 1
        if inside == 0:
            return 0
    kept[:n] = polygon[:n]
    for i in range(k):
        inside = 0
        for j in range(n):
            if lines[i, 0] * kept[j, 0] + lines[i, 1] * kept[j, 1] + lines[i, 2] >= 0.0:
                inside += 1
        if inside == 0:
            return 0
        if inside < n:
            n = clip(kept, n, lines[i, 0], lines[i, 1], lines[i, 2], spare)
            kept[:n] = spare[:n]
    return n if n >= 3 else 0


@jit
def without(
    polygon: Floats, n: int, lines: Floats, k: int, pieces: Floats, corners: Floats, count: int, spare: Floats
) -> int:
    """Append the parts of a polygon outside one of ``k`` lines; return how many pieces there are then.

    Parameters
    ----------
    polygon : ndarray of shape (CORNERS, 2)
    n : int
        Its corners.
    lines : ndarray of shape (k, 3)
    k : int
    pieces : ndarray of shape (PIECES, CORNERS, 2), written
    corners : ndarray of shape (PIECES,), int, written
    count : int
        How many pieces there are; below 0, there were too many.
    spare : ndarray of shape (3, CORNERS, 2)
    """
    if count < 0 or count + k >= PIECES:
        return -1
    if within(polygon, n, lines, k, spare[0], spare[1]) == 0:
        pieces[count, :n] = polygon[:n]
        corners[count] = n
        return count + 1
    rest = spare[2]
    rest[:n] = polygon[:n]
    for i in range(k):
        m = clip(rest, n, -lines[i, 0], -lines[i, 1], -lines[i, 2], pieces[count])
        if m >= 3:
            corners[count] = m
            count += 1
        n = clip(rest, n, lines[i, 0], lines[i, 1], lines[i, 2], spare[0])
        if n < 3:
            break
        rest[:n] = spare[0][:n]
    return count


@jit
def spread(
    polygon: Floats,
    n: int,
    facet: Floats,
    centre: Floats,
    radius: float,
    patch: Floats,
    gauss: Floats,
    digits: float,
    stack: Floats,
    found: Floats,
    count: int,
) -> tuple[Floats, int]:
    """Append quadrature points of a polygon on a facet, as fine as a disc on the wall and the lit patch ask.

    Parameters
    ----------
    polygon : ndarray of shape (CORNERS, 2)
        Along the facet's axes.
    n : int
    facet : ndarray of shape (FACET,)
    centre, radius
        Of the disc.
    patch, gauss
        As for `integral.panels`.
    digits : float
    stack : ndarray of shape (s, 6), room to work in
    found : ndarray of shape (capacity, 5)
        Rows: position (3), area, and which of the patch's rules it asks for.
    count : int

    Returns
    -------
    found, count
        The same array, or a larger one, and how many rows of it are filled.
    """
    nodes, weights, corner, corner_weights = gauss[0], gauss[1], gauss[2], gauss[3]
    patch_radius = math.sqrt(patch[2] ** 2 + patch[3] ** 2)
    least = 0.02 * patch_radius
    point = np.empty(3)
    # A fan from the middle keeps the triangles of a round polygon slim; those of a few corners are better left large.
    middle0, middle1, start, end = polygon[0, 0], polygon[0, 1], 1, n - 1
    if n > 6:
        middle0, middle1, start, end = polygon[:n, 0].mean(), polygon[:n, 1].mean(), 0, n
    for k in range(start, end):
        after = (k + 1) % n
        stack[0, 0], stack[0, 1] = middle0, middle1
        stack[0, 2], stack[0, 3] = polygon[k, 0] - middle0, polygon[k, 1] - middle1
        stack[0, 4], stack[0, 5] = polygon[after, 0] - middle0, polygon[after, 1] - middle1
        top = 1
        while top > 0:
            top -= 1
            o0, o1, e0, e1 = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
            f0, f1 = stack[top, 4], stack[top, 5]
            area = abs(e0 * f1 - e1 * f0)
            if area == 0.0:
                continue
            m0, m1 = o0 + (e0 + f0) / 3.0, o1 + (e1 + f1) / 3.0
            for r in range(3):
                point[r] = facet[r] + m0 * facet[3 + r] + m1 * facet[6 + r]
            distance = min(
                elements.distance_to_disc(point, centre[0], centre[1], radius),
                elements.distance_to_disc(point, patch[0], patch[1], patch_radius),
            )
            along = math.sqrt(max(e0 * e0 + e1 * e1, f0 * f0 + f1 * f1)) / 2.0
            across = math.sqrt((e0 - f0) ** 2 + (e1 - f1) ** 2) / 2.0
            ku = elements.points_wanted(along, distance, digits)
            kv = elements.points_wanted(across, distance, digits)
            if max(ku, kv) > elements.MAX_POINTS and max(along, across) > least and top + 4 <= stack.shape[0]:
                e0, e1, f0, f1 = e0 / 2.0, e1 / 2.0, f0 / 2.0, f1 / 2.0
                for part in range(4):
                    row = stack[top + part]
                    row[0], row[1], row[2], row[3], row[4], row[5] = o0, o1, e0, e1, f0, f1
                    if part == 1:
                        row[0], row[1] = o0 + e0, o1 + e1
                    elif part == 2:
                        row[0], row[1] = o0 + f0, o1 + f1
                    elif part == 3:  # the middle one stands on its head
                        row[0], row[1] = o0 + e0 + f0, o1 + e1 + f1
                        row[2], row[3], row[4], row[5] = -e0, -e1, -f0, -f1
                top += 4
                continue
            ku, kv = min(ku, elements.MAX_POINTS), min(kv, elements.MAX_POINTS)
            if count + ku * kv > found.shape[0]:
                grown = np.empty((2 * found.shape[0] + ku * kv, found.shape[1]))
                grown[:count] = found[:count]
                found = grown
            order = integral.patch_order(point, patch, digits)
            for i in range(ku):
                for j in range(kv):
                    # Duffy 1982, as in `elements.cell_point`.
                    s, t = corner[ku, i] * (1.0 - nodes[kv, j]), corner[ku, i] * nodes[kv, j]
                    p0, p1 = o0 + s * e0 + t * f0, o1 + s * e1 + t * f1
                    row = found[count]
                    for r in range(3):
                        row[r] = facet[r] + p0 * facet[3 + r] + p1 * facet[6 + r]
                    row[3], row[4] = corner_weights[ku, i] * weights[kv, j] * area / 2.0, order
                    count += 1
    return found, count


@jit
def by_way_of(found: Floats, count: int, facet: Floats, wall: Floats, node: Floats, whole: Floats) -> float:
    """Return what a wall point receives from the lit patch by way of points on a facet, if nothing is in between.

        sum_y  A_y cos cos / |w - y|^2  sum_q  L_q cos cos / |q - y|^2

    Parameters
    ----------
    found, count
        As `spread` returns them.
    facet : ndarray of shape (FACET,)
    wall : ndarray of shape (3,)
    node : ndarray of shape (3,)
        One point of the patch, and its radiance times area; if that is 0, the whole patch.
    whole : ndarray
        The patch's rules.
    """
    # On a plane, cos |w - y| is the wall point's height above it, wherever y is.
    level = facet[9] * wall[0] + facet[10] * wall[1] - facet[12]
    if level == 0.0:
        return 0.0
    side = 1.0 if level > 0.0 else -1.0
    single = node[2] != 0.0
    caught = side * (facet[9] * node[0] + facet[10] * node[1] - facet[12]) * node[2]
    if single and caught <= 0.0:
        return 0.0
    total = 0.0
    for k in range(count):
        x, y, h = found[k, 0], found[k, 1], found[k, 2]
        u, v = wall[0] - x, wall[1] - y
        far = u * u + v * v + h * h
        light = 0.0
        if single:
            u, v = node[0] - x, node[1] - y
            near = u * u + v * v + h * h
            light = caught / (near * near)
        else:
            order = int(found[k, 4])
            for q in range(order * order):
                p0, p1 = whole[order, 0, q], whole[order, 1, q]
                u, v = p0 - x, p1 - y
                near = u * u + v * v + h * h
                above = side * (facet[9] * p0 + facet[10] * p1 - facet[12])
                light += whole[order, 2, q] * max(0.0, above) / (near * near)
        total += found[k, 3] * light * h * h / (far * far)
    return total * abs(level)
