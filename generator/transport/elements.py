"""Surfaces cut into cells, and cells into quadrature points, as fine as the points that look at them ask.

A cell is a parallelogram, a triangle, or a piece of a sphere. Its Gauss-Legendre points converge geometrically with
their number, the faster the farther the cell is from the light's next corner compared with its own size; that ratio
alone decides how many points a cell gets and when it is cut, so nothing has to be told that it is near.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from generator.transport.compiled import jit
from generator.transport.world import Body, Mesh

Floats = NDArray[Any]

PARALLELOGRAM, TRIANGLE, SPHERE = 0, 1, 2

WIDTH = 16
"""Of a cell's row: kind, sided, origin (3), two edges (3 + 3), range on the sphere (4), radius."""

MAX_POINTS = 6
"""Along one side of a cell: a cell that wants more is cut."""


def _gauss() -> Floats:
    """Gauss points and weights on [0, 1], row k holding the rule of k points: plain, and for the weight 2u."""
    nodes, weights = np.zeros((MAX_POINTS + 1, MAX_POINTS)), np.zeros((MAX_POINTS + 1, MAX_POINTS))
    corner, corner_weights = np.zeros_like(nodes), np.zeros_like(nodes)
    for k in range(1, MAX_POINTS + 1):
        x, w = leggauss(k)
        nodes[k, :k], weights[k, :k] = (x + 1.0) / 2.0, w / 2.0
        # Golub and Welsch 1969: the rule of a weight is in the eigenvectors of its polynomials' recurrence; Jacobi
        # polynomials with alpha = 0, beta = 1.
        i = np.arange(k)
        diagonal = 1.0 / ((2.0 * i + 1.0) * (2.0 * i + 3.0))
        j = np.arange(1, k)
        beside = np.sqrt(j * (j + 1.0)) / (2.0 * j + 1.0)
        values, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1))
        corner[k, :k], corner_weights[k, :k] = (values + 1.0) / 2.0, vectors[0] ** 2
    return np.stack([nodes, weights, corner, corner_weights])


GAUSS = _gauss()


def cells(bodies: tuple[Body, ...]) -> tuple[Floats, Floats, Floats]:
    """Return a target's cells, in its own frame.

    Parameters
    ----------
    bodies : tuple of Sphere or Mesh

    Returns
    -------
    flat : ndarray of shape (n, WIDTH)
    spheres : ndarray of shape (s, WIDTH)
        Whole: where they are cut depends on where the light comes from (`cap_cell`).
    albedo : ndarray of shape (n + s, 3)
    """
    flat, flat_albedo = [np.zeros((0, WIDTH))], [np.zeros((0, 3))]
    balls, ball_albedo = [np.zeros((0, WIDTH))], [np.zeros((0, 3))]
    for body in bodies:
        if isinstance(body, Mesh):
            made, albedo = _flat_cells(body)
            flat.append(made)
            flat_albedo.append(albedo)
        else:
            ball = np.zeros((1, WIDTH))
            ball[0, 0], ball[0, 1], ball[0, 2:5], ball[0, 15] = SPHERE, 1.0, body.centre, body.radius
            balls.append(ball)
            ball_albedo.append(body.albedo[None])
    return np.concatenate(flat), np.concatenate(balls), np.concatenate(flat_albedo + ball_albedo)


def _flat_cells(mesh: Mesh) -> tuple[Floats, Floats]:
    origin, first, second, kind, kept = merge_parallelograms(mesh.triangles, mesh.albedo)
    made = np.zeros((len(origin), WIDTH))
    made[:, 0] = kind
    made[:, 2:5], made[:, 5:8], made[:, 8:11] = origin, first, second
    outward = is_convex_solid(mesh.triangles)
    if outward:
        made[:, 1] = 1.0
        centre = mesh.triangles.reshape(-1, 3).mean(axis=0)
        normal = np.cross(first, second)
        inward = ((origin - centre) * normal).sum(axis=1) < 0.0
        # Swapping the edges turns a normal round: a mesh's own orientation may be inside out.
        swapped = made[inward][:, [*range(5), 8, 9, 10, 5, 6, 7, *range(11, WIDTH)]]
        made[inward] = swapped
    return made, mesh.albedo[kept]


def merge_parallelograms(triangles: Floats, albedo: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Join neighbouring triangles that make a parallelogram of one colour; drop those without area.

    Returns
    -------
    origin, first, second : ndarray of shape (n, 3)
        Corner and the two edges that leave it.
    kind : ndarray of shape (n,)
        PARALLELOGRAM or TRIANGLE.
    kept : ndarray of shape (n,), int
        A triangle that each came from.
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    size = np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    whole = np.flatnonzero(area > 1e-12 * size)
    rows: list[tuple[Floats, Floats, Floats, int, int]] = []
    at = 0
    while at < len(whole):
        i = whole[at]
        at += 1
        made = None
        if at < len(whole) and (albedo[i] == albedo[whole[at]]).all():
            made = _parallelogram(triangles[i], triangles[whole[at]])
        if made is None:
            rows.append((a[i], b[i] - a[i], c[i] - a[i], TRIANGLE, i))
        else:
            rows.append((*made, PARALLELOGRAM, i))
            at += 1
    edges = np.array([row[:3] for row in rows], dtype=float).reshape(-1, 3, 3)
    kind = np.array([row[3] for row in rows], dtype=float)
    kept = np.array([row[4] for row in rows], dtype=np.int64)
    return edges[:, 0], edges[:, 1], edges[:, 2], kind, kept


def _parallelogram(one: Floats, two: Floats) -> tuple[Floats, Floats, Floats] | None:
    """Corner and edges of the parallelogram that two triangles make, if they do."""
    gap = 1e-6 * float(np.abs(one - one[0]).max())
    for i in range(3):
        apex, left, right = one[i], one[(i + 1) % 3], one[(i + 2) % 3]
        # The far corner of a parallelogram whose diagonal is the side opposite the apex.
        far = left + right - apex
        wanted = (left, right, far)
        if all((np.abs(two - w).max(axis=1) < gap).any() for w in wanted):
            return apex, left - apex, right - apex
    return None


def is_convex_solid(triangles: Floats) -> bool:
    """Whether triangles enclose one convex solid, so that it cannot hide a part of itself that faces the light.

    A closed connected surface that is convex at every edge bounds a convex body (Tietze 1928, Nakajima 1928).
    """
    if len(triangles) < 4:
        return False
    extent = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    _, index = np.unique(np.round(triangles.reshape(-1, 3) / (1e-7 * extent)), axis=0, return_inverse=True)
    corners = index.reshape(-1, 3)
    corners_of: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for face, (i, j, k) in enumerate(corners):
        if i == j or j == k or k == i:
            continue
        for edge, opposite in (((i, j), k), ((j, k), i), ((k, i), j)):
            corners_of.setdefault((min(edge), max(edge)), []).append((face, opposite))
    if any(len(faces) != 2 for faces in corners_of.values()):
        return False
    points = np.zeros((int(index.max()) + 1, 3))
    points[index.ravel()] = triangles.reshape(-1, 3)
    middle = points.mean(axis=0)
    parent = list(range(len(triangles)))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    used: set[int] = set()
    for (face, _), (other, across) in corners_of.values():
        used.update((face, other))
        parent[root(face)] = root(other)
        a, b, c = points[corners[face]]
        normal = np.cross(b - a, c - a)
        side = float((points[across] - a) @ normal)
        inside = float((middle - a) @ normal)
        slack = 1e-6 * extent * float(np.linalg.norm(normal))
        if side * inside < 0.0 and abs(side) > slack:
            return False
    return len({root(i) for i in used}) == 1


@jit
def beside(axis: Floats, side: Floats) -> None:
    """Write some unit vector at right angles to a unit vector."""
    least = 0
    for r in range(1, 3):
        if abs(axis[r]) < abs(axis[least]):
            least = r
    squared = 0.0
    for r in range(3):
        side[r] = (1.0 if r == least else 0.0) - axis[least] * axis[r]
        squared += side[r] ** 2
    for r in range(3):
        side[r] /= math.sqrt(squared)


@jit
def cap_cell(ball: Floats, rim: float, ring: int, step: int, rings: int) -> None:
    """Make a sphere's row one of the 4 rings^2 cells of the cap around its pole.

    Parameters
    ----------
    rim : float
        The cap's angle, radians. Cells are equal steps of it: equal steps of the cosine would be coarse at the rim.
    """
    ball[11], ball[12] = math.cos(rim * (ring + 1) / rings), math.cos(rim * ring / rings)
    ball[13], ball[14] = 0.5 * math.pi * step / rings, 0.5 * math.pi * (step + 1) / rings


@jit
def place(cell: Floats, turn: Floats, at: Floats, placed: Floats) -> None:
    """Write a cell turned by a matrix (3, 3) and moved."""
    placed[:] = cell
    for r in range(3):
        o, f, s = at[r], 0.0, 0.0
        for c in range(3):
            o += turn[r, c] * cell[2 + c]
            f += turn[r, c] * cell[5 + c]
            s += turn[r, c] * cell[8 + c]
        placed[2 + r], placed[5 + r], placed[8 + r] = o, f, s


@jit
def turn_to(ball: Floats, pole: Floats, spread: float) -> float:
    """Turn a sphere's row to a point; return the angle of the cap that is seen from within ``spread`` of it."""
    far = 0.0
    for r in range(3):
        ball[5 + r] = pole[r] - ball[2 + r]
        far += ball[5 + r] ** 2
    far = math.sqrt(far)
    for r in range(3):
        ball[5 + r] /= far
    beside(ball[5:8], ball[8:11])
    return min(math.pi, math.acos(min(1.0, ball[15] / far)) + math.asin(min(1.0, spread / far)))


@jit
def corner_of(cell: Floats, corner: int, point: Floats) -> None:
    """Write one of a cell's corners: four, or a triangle's three."""
    if cell[0] == 2.0:
        _on_sphere(cell, cell[11 + corner % 2], cell[13 + corner // 2], point)
        for r in range(3):
            point[r] = cell[2 + r] + cell[15] * point[r]
        return
    first, second = corner == 1 or corner == 3, corner == 2 or corner == 3
    for r in range(3):
        point[r] = cell[2 + r] + (cell[5 + r] if first else 0.0) + (cell[8 + r] if second else 0.0)


@jit
def points_wanted(width: float, distance: float, digits: float) -> int:
    """Gauss points along a side of half-width ``width`` for an error of exp(-digits).

    The integrand is analytic but for the points it looks at, at least ``distance`` from the middle: inside the
    ellipse through them Gauss's rule of k points errs by rho^(-2 k) (Trefethen 2008, theorem 4.5), times (2 k)^3
    because 1 / r^4 has a pole of the fourth order there. Too near a pole for that, the cell is to be cut.
    """
    ratio = distance / max(width, 1e-300)
    if ratio <= 1.6:
        return MAX_POINTS + 1
    rate = 2.0 * math.log(ratio + math.sqrt(ratio * ratio - 1.0))
    for k in range(1, MAX_POINTS + 1):
        if k * rate - 3.0 * math.log(2.0 * k) >= digits:
            return k
    return MAX_POINTS + 1


@jit
def middle_of(cell: Floats, middle: Floats) -> tuple[float, float]:
    """Write a cell's middle; return half of its widths along its two directions."""
    if cell[0] == 2.0:
        radius = cell[15]
        low, high = math.acos(min(1.0, cell[12])), math.acos(max(-1.0, cell[11]))
        polar, turn = (low + high) / 2.0, (cell[13] + cell[14]) / 2.0
        _on_sphere(cell, math.cos(polar), turn, middle)
        for r in range(3):
            middle[r] = cell[2 + r] + radius * middle[r]
        widest = math.sin(min(high, math.pi / 2.0)) if low < math.pi / 2.0 else math.sin(low)
        return radius * (high - low) / 2.0, radius * widest * (cell[14] - cell[13]) / 2.0
    first, second, across = 0.0, 0.0, 0.0
    share = 0.5 if cell[0] == 0.0 else 1.0 / 3.0
    for r in range(3):
        middle[r] = cell[2 + r] + share * (cell[5 + r] + cell[8 + r])
        first += cell[5 + r] ** 2
        second += cell[8 + r] ** 2
        across += (cell[8 + r] - cell[5 + r]) ** 2
    if cell[0] == 0.0:
        return math.sqrt(first) / 2.0, math.sqrt(second) / 2.0
    return math.sqrt(max(first, second)) / 2.0, math.sqrt(across) / 2.0


@jit
def _on_sphere(cell: Floats, cosine: float, turn: float, normal: Floats) -> None:
    """Write the unit normal at a polar cosine and an angle around the pole."""
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    c, s = sine * math.cos(turn), sine * math.sin(turn)
    p0, p1, p2, q0, q1, q2 = cell[5], cell[6], cell[7], cell[8], cell[9], cell[10]
    normal[0] = cosine * p0 + c * q0 + s * (p1 * q2 - p2 * q1)
    normal[1] = cosine * p1 + c * q1 + s * (p2 * q0 - p0 * q2)
    normal[2] = cosine * p2 + c * q2 + s * (p0 * q1 - p1 * q0)


@jit
def cut(cell: Floats, stack: Floats, top: int, along_first: bool, along_second: bool) -> int:
    """Push a cell's halves, quarters or (of a triangle) its four triangles; return the new top of the stack."""
    if cell[0] == 1.0:
        for part in range(4):
            row = stack[top + part]
            row[:] = cell
            for r in range(3):
                e, f = cell[5 + r] / 2.0, cell[8 + r] / 2.0
                row[5 + r], row[8 + r] = e, f
                if part == 1:
                    row[2 + r] = cell[2 + r] + e
                elif part == 2:
                    row[2 + r] = cell[2 + r] + f
                elif part == 3:  # the middle one stands on its head
                    row[2 + r], row[5 + r], row[8 + r] = cell[2 + r] + e + f, -e, -f
        return top + 4
    parts = 0
    for i in range(2 if along_first else 1):
        for j in range(2 if along_second else 1):
            row = stack[top + parts]
            row[:] = cell
            parts += 1
            if cell[0] == 2.0:
                if along_first:
                    low, high = math.acos(min(1.0, cell[12])), math.acos(max(-1.0, cell[11]))
                    between = math.cos((low + high) / 2.0)
                    row[12 if i else 11] = between
                if along_second:
                    row[14 - j] = (cell[13] + cell[14]) / 2.0
                continue
            for r in range(3):
                if along_first:
                    row[5 + r] = cell[5 + r] / 2.0
                if along_second:
                    row[8 + r] = cell[8 + r] / 2.0
                row[2 + r] = cell[2 + r] + i * row[5 + r] + j * row[8 + r]
    return top + parts


@jit
def cell_point(cell: Floats, i: int, j: int, ku: int, kv: int, gauss: Floats, point: Floats, normal: Floats) -> float:
    """Write quadrature point (i, j) of a cell and its unit normal; return its weight, an area."""
    nodes, weights, corner, corner_weights = gauss[0], gauss[1], gauss[2], gauss[3]
    if cell[0] == 2.0:
        u = cell[11] + nodes[ku, i] * (cell[12] - cell[11])
        _on_sphere(cell, u, cell[13] + nodes[kv, j] * (cell[14] - cell[13]), normal)
        for r in range(3):
            point[r] = cell[2 + r] + cell[15] * normal[r]
        area = cell[15] ** 2 * (cell[12] - cell[11]) * (cell[14] - cell[13])
        return weights[ku, i] * weights[kv, j] * area
    normal[0] = cell[6] * cell[10] - cell[7] * cell[9]
    normal[1] = cell[7] * cell[8] - cell[5] * cell[10]
    normal[2] = cell[5] * cell[9] - cell[6] * cell[8]
    area = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    for r in range(3):
        normal[r] /= area
    if cell[0] == 0.0:
        for r in range(3):
            point[r] = cell[2 + r] + nodes[ku, i] * cell[5 + r] + nodes[kv, j] * cell[8 + r]
        return weights[ku, i] * weights[kv, j] * area
    # Duffy 1982: the triangle as a square whose one side is shrunk to a corner.
    for r in range(3):
        point[r] = cell[2 + r] + corner[ku, i] * ((1.0 - nodes[kv, j]) * cell[5 + r] + nodes[kv, j] * cell[8 + r])
    return corner_weights[ku, i] * weights[kv, j] * area / 2.0


@jit
def distance_to_disc(x: Floats, c0: float, c1: float, radius: float) -> float:
    """From a point to a disc on the wall."""
    beside = max(0.0, math.sqrt((x[0] - c0) ** 2 + (x[1] - c1) ** 2) - radius)
    return math.sqrt(beside * beside + x[2] * x[2])


@jit
def clip_patch(x: Floats, n: Floats, patch: Floats, rule: Floats, order: int, nodes: Floats) -> int:
    """Write quadrature points of the part of the lit patch that a surface point can see; return how many.

    The surface's horizon cuts the ellipse along a chord. In the unit disc, with s across the chord and t along it,
    s = cos(alpha) turns the disc's edge into a smooth integrand over alpha, so Gauss's rule converges however small
    the part.

    Parameters
    ----------
    x, n : ndarray of shape (3,)
    patch : ndarray of shape (15,)
        Centre (2), major (2) and minor (2) semi-axis, lamp (3), height, axis (3), cos_outer, cos_width.
    rule : ndarray of shape (2, order)
        Gauss points and weights on [0, 1].
    order : int
    nodes : ndarray of shape (3, capacity), written
        As `kernel.irradiance` takes them.
    """
    c0, c1, j0, j1, m0, m1 = patch[0], patch[1], patch[2], patch[3], patch[4], patch[5]
    level = n[0] * (c0 - x[0]) + n[1] * (c1 - x[1]) - n[2] * x[2]
    g0, g1 = n[0] * j0 + n[1] * j1, n[0] * m0 + n[1] * m1
    steep = math.sqrt(g0 * g0 + g1 * g1)
    if level <= -steep:
        return 0
    start = math.pi
    if level < steep:
        start = math.acos(max(-1.0, -level / steep))
    if steep > 0.0:
        g0, g1 = g0 / steep, g1 / steep
    else:
        g0, g1 = 1.0, 0.0
    area = abs(j0 * m1 - j1 * m0)
    count = 0
    for i in range(order):
        alpha = start * rule[0, i]
        s, reach = math.cos(alpha), math.sin(alpha)
        for j in range(order):
            t = reach * (2.0 * rule[0, j] - 1.0)
            e, f = s * g0 - t * g1, s * g1 + t * g0
            p, q = c0 + e * j0 + f * m0, c1 + e * j1 + f * m1
            nodes[0, count], nodes[1, count] = p, q
            weight = reach * reach * start * rule[1, i] * 2.0 * rule[1, j] * area
            nodes[2, count] = weight * patch_radiance(p, q, patch)
            count += 1
    return count


@jit
def patch_radiance(p: float, q: float, patch: Floats) -> float:
    """Radiance of the lit patch at a wall point, in units of albedo / pi * intensity / height^2."""
    u, v, w = p - patch[6], q - patch[7], -patch[8]
    far = math.sqrt(u * u + v * v + w * w)
    ratio = patch[8] / far
    value = ratio * ratio * ratio
    if patch[13] > 0.0:
        cosine = (u * patch[9] + v * patch[10] + w * patch[11]) / far
        step = min(1.0, max(0.0, (cosine - patch[12]) / patch[13]))
        value *= step * step * (3.0 - 2.0 * step)
    return value
