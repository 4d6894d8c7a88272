"""Convex polygons in a plane: cutting them along lines, subtracting them from each other, summing light over them.

How fast sums over a polygon converge depends only on how smooth the light on it is, so a shadow whose edges are the
edges of polygons costs no more than no shadow.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport import elements
from generator.transport.compiled import COMPILED, jit_in_place, jit_inlined
from generator.transport.lit import Rules, distance_to, order_at, radius_of
from generator.transport.records import Disc

Floats = NDArray[Any]

CORNERS = 128
"""Largest number of corners of a polygon."""
PIECES = 96
"""Largest number of pieces that a polygon may be cut into."""

ORIGIN, FIRST, SECOND, NORMAL, LEVEL, COUNT, CORNER, OUTLINE, SIDED, FACET = 0, 3, 6, 9, 12, 13, 14, 26, 34, 36
"""Columns of a facet's row: a corner (3), two unit axes in its plane (3 + 3), its unit normal (3), the level of its
plane, the number of its corners, these corners (4 x 3), their coordinates along the axes (4 x 2), whether it has only
one side; and the number of columns."""

AREA, ORDER = 3, 4
"""Columns of a quadrature point, after its position (3): its area, and the index of the patch's rule it needs."""

_STACK = 128


@jit_in_place
def lay(origin: Floats, first: Floats, second: Floats, triangle: bool, row: Floats) -> None:
    """Write a parallelogram or triangle, given by a corner and two edges, as a facet."""
    axis_u, axis_v, normal = row[FIRST:SECOND], row[SECOND:NORMAL], row[NORMAL:LEVEL]
    long, area = 0.0, 0.0
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        normal[r] = first[s] * second[t] - first[t] * second[s]
        long += first[r] ** 2
        area += normal[r] ** 2
    long, area = math.sqrt(long), math.sqrt(area)
    row[LEVEL] = 0.0
    for r in range(3):
        row[ORIGIN + r] = origin[r]
        axis_u[r] = first[r] / long
        normal[r] /= area
        row[LEVEL] += normal[r] * origin[r]
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        axis_v[r] = normal[s] * axis_u[t] - normal[t] * axis_u[s]
    row[COUNT] = 3 if triangle else 4
    for k in range(4):
        along, across = k == 1 or (k == 2 and not triangle), k >= 2
        u, v = 0.0, 0.0
        for r in range(3):
            arm = (first[r] if along else 0.0) + (second[r] if across else 0.0)
            row[CORNER + 3 * k + r] = origin[r] + arm
            u += arm * axis_u[r]
            v += arm * axis_v[r]
        row[OUTLINE + 2 * k], row[OUTLINE + 2 * k + 1] = u, v


@jit_inlined
def height_of(facet: Floats, u: float, v: float) -> float:
    """Return a wall point's height above a facet's plane."""
    return facet[NORMAL] * u + facet[NORMAL + 1] * v - facet[LEVEL]


@jit_inlined
def height_above(facet: Floats, point: Floats) -> float:
    """Return a point's height above a facet's plane."""
    normal = facet[NORMAL] * point[0] + facet[NORMAL + 1] * point[1] + facet[NORMAL + 2] * point[2]
    return normal - facet[LEVEL]


@jit_inlined
def on_facet(facet: Floats, u: float, v: float, point: Floats) -> None:
    """Write the point (3,) of a facet's plane at coordinates along its axes."""
    for r in range(3):
        point[r] = facet[ORIGIN + r] + u * facet[FIRST + r] + v * facet[SECOND + r]


@jit_in_place
def outline(facet: Floats, polygon: Floats) -> int:
    """Write a facet's own corners along its axes; return their number."""
    n = int(facet[COUNT])
    for k in range(n):
        polygon[k, 0], polygon[k, 1] = facet[OUTLINE + 2 * k], facet[OUTLINE + 2 * k + 1]
    return n


def _copy_loops(polygon: Floats, n: int, into: Floats) -> None:
    """Copy a polygon's corners."""
    for k in range(n):
        into[k, 0], into[k, 1] = polygon[k, 0], polygon[k, 1]


def _copy_arrays(polygon: Floats, n: int, into: Floats) -> None:
    """NumPy form of `_copy_loops`."""
    into[:n] = polygon[:n]


copy = jit_in_place(_copy_loops) if COMPILED else _copy_arrays


@jit_in_place
def clip(polygon: Floats, n: int, a: float, b: float, c: float, kept: Floats) -> int:
    """Write the part of a polygon where a u + b v + c >= 0 (Sutherland and Hodgman 1974); return its corner count."""
    m = 0
    if n == 0:
        return 0
    u0, v0 = polygon[n - 1, 0], polygon[n - 1, 1]
    previous = a * u0 + b * v0 + c
    for k in range(n):
        u, v = polygon[k, 0], polygon[k, 1]
        value = a * u + b * v + c
        if (value >= 0.0) != (previous >= 0.0):
            t = previous / (previous - value)
            kept[m, 0], kept[m, 1] = u0 + t * (u - u0), v0 + t * (v - v0)
            m += 1
        if value >= 0.0:
            kept[m, 0], kept[m, 1] = u, v
            m += 1
        u0, v0, previous = u, v, value
    return m


@jit_in_place
def within(polygon: Floats, n: int, lines: Floats, k: int, kept: Floats, spare: Floats) -> int:
    """Write the part of a polygon inside all of ``k`` lines (k, 3); return its number of corners, 0 if empty."""
    for i in range(k):
        inside = 0
        for j in range(n):
            if lines[i, 0] * polygon[j, 0] + lines[i, 1] * polygon[j, 1] + lines[i, 2] >= 0.0:
                inside += 1
        if inside == 0:
            return 0
    copy(polygon, n, kept)
    for i in range(k):
        inside = 0
        for j in range(n):
            if lines[i, 0] * kept[j, 0] + lines[i, 1] * kept[j, 1] + lines[i, 2] >= 0.0:
                inside += 1
        if inside == 0:
            return 0
        if inside < n:
            n = clip(kept, n, lines[i, 0], lines[i, 1], lines[i, 2], spare)
            copy(spare, n, kept)
    return n if n >= 3 else 0


@jit_in_place
def without(
    polygon: Floats, n: int, lines: Floats, k: int, pieces: Floats, corners: Floats, count: int, spare: Floats
) -> int:
    """Append the parts of a polygon outside at least one of ``k`` lines; return the new number of pieces.

    Parameters
    ----------
    polygon : ndarray of shape (CORNERS, 2)
    n : int
        Number of its corners.
    lines : ndarray of shape (k, 3)
    k : int
    pieces : ndarray of shape (PIECES, CORNERS, 2), written
    corners : ndarray of shape (PIECES,), int, written
    count : int
        Number of pieces before; negative if there were too many.
    spare : ndarray of shape (3, CORNERS, 2)
    """
    if count < 0 or count + k >= PIECES:
        return -1
    if within(polygon, n, lines, k, spare[0], spare[1]) == 0:
        copy(polygon, n, pieces[count])
        corners[count] = n
        return count + 1
    rest = spare[2]
    copy(polygon, n, rest)
    for i in range(k):
        m = clip(rest, n, -lines[i, 0], -lines[i, 1], -lines[i, 2], pieces[count])
        if m >= 3:
            corners[count] = m
            count += 1
        n = clip(rest, n, lines[i, 0], lines[i, 1], lines[i, 2], spare[0])
        if n < 3:
            break
        copy(spare[0], n, rest)
    return count


class Summing(NamedTuple):
    """Scratch space for summing light: a stack of triangles, a point, and rows of one cell's quadrature points."""

    stack: Floats
    point: Floats
    found: Floats


def room_to_sum() -> Summing:
    """Return scratch space for summing."""
    return Summing(np.empty((_STACK, 6)), np.empty(3), np.empty((elements.MAX_POINTS**2, 5)))


@jit_in_place
def middle(polygon: Floats, n: int) -> tuple[float, float]:
    """Return the mean of a polygon's corners."""
    u, v = 0.0, 0.0
    for k in range(n):
        u += polygon[k, 0]
        v += polygon[k, 1]
    return u / n, v / n


@jit_inlined
def fan(polygon: Floats, n: int) -> tuple[float, float, int, int]:
    """Return the point that a polygon's triangles share, and the first and last (exclusive) of the sides opposite it.

    A fan from the middle keeps the triangles of a round polygon slim; for few corners, large triangles are better.
    """
    if n <= 6:
        return polygon[0, 0], polygon[0, 1], 1, n - 1
    middle0, middle1 = middle(polygon, n)
    return middle0, middle1, 0, n


@jit_inlined
def start_triangle(polygon: Floats, n: int, k: int, middle0: float, middle1: float, row: Floats) -> None:
    """Write a triangle of `fan`, the one opposite a polygon's k-th side: a corner and two edges."""
    after = (k + 1) % n
    row[0], row[1] = middle0, middle1
    row[2], row[3] = polygon[k, 0] - middle0, polygon[k, 1] - middle1
    row[4], row[5] = polygon[after, 0] - middle0, polygon[after, 1] - middle1


@jit_inlined
def next_points(facet: Floats, view: Disc, rules: Rules, work: Summing, top: int) -> tuple[int, int]:
    """Cut the topmost triangle on a facet as finely as a disc on the wall and the lit patch require.

    Parameters
    ----------
    facet : ndarray of shape (FACET,)
    view : Disc
    rules : Rules
    work : Summing
        The first ``top`` rows of its stack are triangles, a corner and two edges along the facet's axes. Its rows
        ``found`` become the quadrature points of the first piece that need not be cut: position (3), area, and index
        of the patch's rule.
    top : int

    Returns
    -------
    top, count : int
        Number of triangles that are left, and of points that were written.
    """
    stack, point, rows = work
    nodes, weights, corner, corner_weights = rules.gauss[0], rules.gauss[1], rules.gauss[2], rules.gauss[3]
    least = 0.02 * radius_of(rules.patch)
    while top > 0:
        top -= 1
        o0, o1, e0, e1 = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        f0, f1 = stack[top, 4], stack[top, 5]
        area = abs(e0 * f1 - e1 * f0)
        if area == 0.0:
            continue
        on_facet(facet, o0 + (e0 + f0) / 3.0, o1 + (e1 + f1) / 3.0, point)
        distance = min(
            elements.distance_to_disc(point, view.centre[0], view.centre[1], view.radius),
            distance_to(point, rules.patch),
        )
        along = math.sqrt(max(e0 * e0 + e1 * e1, f0 * f0 + f1 * f1)) / 2.0
        across = math.sqrt((e0 - f0) ** 2 + (e1 - f1) ** 2) / 2.0
        ku = elements.points_wanted(along, distance, rules.digits)
        kv = elements.points_wanted(across, distance, rules.digits)
        if max(ku, kv) > elements.MAX_POINTS and max(along, across) > least and top + 4 <= stack.shape[0]:
            _quarter(o0, o1, e0 / 2.0, e1 / 2.0, f0 / 2.0, f1 / 2.0, stack[top : top + 4])
            top += 4
            continue
        ku, kv = min(ku, elements.MAX_POINTS), min(kv, elements.MAX_POINTS)
        order = order_at(point, rules.patch, rules.digits)
        count = 0
        for i in range(ku):
            for j in range(kv):
                # Duffy 1982, as in `elements.cell_point`.
                s, t = corner[ku, i] * (1.0 - nodes[kv, j]), corner[ku, i] * nodes[kv, j]
                row = rows[count]
                on_facet(facet, o0 + s * e0 + t * f0, o1 + s * e1 + t * f1, row)
                row[AREA], row[ORDER] = corner_weights[ku, i] * weights[kv, j] * area / 2.0, order
                count += 1
        return top, count
    return 0, 0


@jit_in_place
def _quarter(o0: float, o1: float, e0: float, e1: float, f0: float, f1: float, rows: Floats) -> None:
    """Write the four triangles (4, 6) into which a triangle is cut by halving its edges, to e and f."""
    for part in range(4):
        row = rows[part]
        row[0], row[1], row[2], row[3], row[4], row[5] = o0, o1, e0, e1, f0, f1
        if part == 1:
            row[0], row[1] = o0 + e0, o1 + e1
        elif part == 2:
            row[0], row[1] = o0 + f0, o1 + f1
        elif part == 3:  # the middle one is inverted
            row[0], row[1] = o0 + e0 + f0, o1 + e1 + f1
            row[2], row[3], row[4], row[5] = -e0, -e1, -f0, -f1


class Path(NamedTuple):
    """The path of light from the patch by way of a facet to a point of the wall.

    Attributes
    ----------
    facet : ndarray of shape (FACET,)
    wall : ndarray of shape (3,)
    node : ndarray of shape (3,)
        One point (2) of the patch, and its radiance times area; if that is 0, light comes from the whole patch.
    """

    facet: Floats
    wall: Floats
    node: Floats


@jit_inlined
def add_by_way_of(total: float, found: Floats, count: int, path: Path, whole: Floats) -> float:
    """Return ``total`` plus what a wall point receives from the lit patch by way of points on a facet, unobstructed.

        sum_y  A_y cos_y / |w - y|^3 h  sum_q  L_q cos cos / |q - y|^2

    On a plane, cos_y |w - y| is the wall point's height above it, wherever y is; that factor, `height_of`, is left
    out of the sum.

    Parameters
    ----------
    total : float
    found, count
        As `next_points` writes them.
    path : Path
    whole : ndarray
        Quadrature rules of the patch.
    """
    facet, wall, node = path.facet, path.wall, path.node
    side = 1.0 if height_of(facet, wall[0], wall[1]) > 0.0 else -1.0
    single = node[2] != 0.0
    caught = side * height_of(facet, node[0], node[1]) * node[2]
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
            order = int(found[k, ORDER])
            for q in range(order * order):
                p0, p1 = whole[order, 0, q], whole[order, 1, q]
                u, v = p0 - x, p1 - y
                near = u * u + v * v + h * h
                above = side * height_of(facet, p0, p1)
                light += whole[order, 2, q] * max(0.0, above) / (near * near)
        total += found[k, AREA] * light * h * h / (far * far)
    return total


@jit_inlined
def is_lit(path: Path) -> bool:
    """Whether the side of a facet that a wall point sees can receive light."""
    level = height_of(path.facet, path.wall[0], path.wall[1])
    if level == 0.0:
        return False
    side = 1.0 if level > 0.0 else -1.0
    node = path.node
    return node[2] == 0.0 or side * height_of(path.facet, node[0], node[1]) * node[2] > 0.0


@jit_in_place
def light_of(polygon: Floats, n: int, path: Path, rules: Rules, work: Summing) -> float:
    """Return what a wall point receives by way of a polygon on a facet, if nothing is in between."""
    if not is_lit(path):
        return 0.0
    view, total = Disc(path.wall, 0.0), 0.0
    middle0, middle1, start, end = fan(polygon, n)
    for k in range(start, end):
        start_triangle(polygon, n, k, middle0, middle1, work.stack[0])
        top = 1
        while top > 0:
            top, count = next_points(path.facet, view, rules, work, top)
            total = add_by_way_of(total, work.found, count, path, rules.whole)
    return total * abs(height_of(path.facet, path.wall[0], path.wall[1]))
