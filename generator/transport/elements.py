"""Surfaces cut into cells, and cells into quadrature points, as finely as the points that see them require.

A cell is a parallelogram, a triangle, or a piece of a sphere. Its Gauss-Legendre rule converges geometrically with
the number of points, at a rate that grows with the distance to the points that see the cell, in units of the cell's
size. That ratio alone decides how many points a cell gets and when it is cut, so near cells need no special case.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from generator.transport.compiled import COMPILED, jit_in_place
from generator.transport.world import Body, Mesh

Floats = NDArray[Any]

PARALLELOGRAM, TRIANGLE, SPHERE = 0, 1, 2

KIND, SIDED, ORIGIN, FIRST, SECOND, LOW, HIGH, START, END, RADIUS, SHARP = 0, 1, 2, 5, 8, 11, 12, 13, 14, 15, 16
"""Columns of a cell's row: its kind; whether it has only one side; the corner (3) and two edges (3 + 3) of a flat
one; of a sphere, the middle (3), the pole (3), a direction across it (3), the extent of the cell (lowest and highest
cosine to the pole, first and last angle around it), and the radius; of a glossy one, the angle over which its light
varies (`gloss.Shine.sharp`), else 0."""

WIDTH = 17

POINT, NORMAL, AREA, CELL, ONE_SIDED = 0, 3, 6, 7, 8
"""Columns of a quadrature point's row: position (3), unit normal (3), area, index of its cell, and `SIDED`."""

GRAZING = 0.25
"""Least cosine between the facets of a glossy cell and the light on them that points are made for: light that grazes
more is weak."""

MAX_POINTS = 6
"""Most points along one side of a cell: a cell that needs more is cut."""


def _gauss() -> Floats:
    """Return Gauss points and weights on [0, 1]: plain, and for the weight 2u; row k holds the rule of k points."""
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
        off_diagonal = np.sqrt(j * (j + 1.0)) / (2.0 * j + 1.0)
        values, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(off_diagonal, 1) + np.diag(off_diagonal, -1))
        corner[k, :k], corner_weights[k, :k] = (values + 1.0) / 2.0, vectors[0] ** 2
    return np.stack([nodes, weights, corner, corner_weights])


GAUSS = _gauss()


def cells(bodies: tuple[Body, ...]) -> tuple[Floats, Floats, Floats, Floats]:
    """Return a target's cells, in its own frame.

    Parameters
    ----------
    bodies : tuple of Sphere or Mesh

    Returns
    -------
    flat : ndarray of shape (n, WIDTH)
    spheres : ndarray of shape (s, WIDTH)
        Whole spheres: where they are cut depends on where the light comes from (`cap_cell`).
    albedo : ndarray of shape (n + s, 3)
    kept : ndarray of shape (n + s,), int
        For each, the index of a triangle that it came from, counted over all meshes; spheres follow.
    """
    flat, flat_albedo = [np.zeros((0, WIDTH))], [np.zeros((0, 3))]
    balls, ball_albedo = [np.zeros((0, WIDTH))], [np.zeros((0, 3))]
    kept, triangles = [np.zeros(0, dtype=np.int64)], 0
    for body in bodies:
        if isinstance(body, Mesh):
            rows, of = _flat_cells(body)
            flat.append(rows)
            flat_albedo.append(body.albedo[of])
            kept.append(triangles + of)
            triangles += len(body.triangles)
        else:
            ball = np.zeros((1, WIDTH))
            ball[0, KIND], ball[0, SIDED], ball[0, ORIGIN:FIRST], ball[0, RADIUS] = (
                SPHERE,
                1.0,
                body.centre,
                body.radius,
            )
            balls.append(ball)
            ball_albedo.append(body.albedo[None])
    kept.append(triangles + np.arange(len(balls) - 1))
    albedo = np.concatenate(flat_albedo + ball_albedo)
    return np.concatenate(flat), np.concatenate(balls), albedo, np.concatenate(kept)


def _flat_cells(mesh: Mesh) -> tuple[Floats, Floats]:
    gloss, look = mesh.gloss, mesh.albedo
    if gloss is not None:
        look = np.column_stack([look, gloss.tint, gloss.roughness, gloss.multiple])
    origin, first, second, kind, kept = merge_parallelograms(mesh.triangles, look)
    rows = np.zeros((len(origin), WIDTH))
    rows[:, KIND] = kind
    rows[:, ORIGIN:FIRST], rows[:, FIRST:SECOND], rows[:, SECOND:LOW] = origin, first, second
    is_solid = is_convex_solid(mesh.triangles)
    if is_solid:
        rows[:, SIDED] = 1.0
        centre = mesh.triangles.reshape(-1, 3).mean(axis=0)
        normal = np.cross(first, second)
        inward = ((origin - centre) * normal).sum(axis=1) < 0.0
        # Swapping the edges reverses a normal: a mesh's own orientation may be inside out.
        rows[inward, FIRST:SECOND], rows[inward, SECOND:LOW] = second[inward], first[inward]
    return rows, kept


def merge_parallelograms(triangles: Floats, look: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Join consecutive triangles that form a parallelogram of one look (n, k); drop those without area.

    Returns
    -------
    origin, first, second : ndarray of shape (n, 3)
        Corner and the two edges that leave it.
    kind : ndarray of shape (n,)
        PARALLELOGRAM or TRIANGLE.
    kept : ndarray of shape (n,), int
        Index of a triangle that each came from.
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    size = np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    valid = np.flatnonzero(area > 1e-12 * size)
    rows: list[tuple[Floats, Floats, Floats, int, int]] = []
    index = 0
    while index < len(valid):
        i = valid[index]
        index += 1
        parallelogram = None
        if index < len(valid) and (look[i] == look[valid[index]]).all():
            parallelogram = _parallelogram(triangles[i], triangles[valid[index]])
        if parallelogram is None:
            rows.append((a[i], b[i] - a[i], c[i] - a[i], TRIANGLE, i))
        else:
            rows.append((*parallelogram, PARALLELOGRAM, i))
            index += 1
    edges = np.array([row[:3] for row in rows], dtype=float).reshape(-1, 3, 3)
    kind = np.array([row[3] for row in rows], dtype=float)
    kept = np.array([row[4] for row in rows], dtype=np.int64)
    return edges[:, 0], edges[:, 1], edges[:, 2], kind, kept


def _parallelogram(one: Floats, two: Floats) -> tuple[Floats, Floats, Floats] | None:
    """Return the corner and edges of the parallelogram that two triangles form, None if they form none."""
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
    for (face, _), (neighbour, across) in corners_of.values():
        used.update((face, neighbour))
        parent[root(face)] = root(neighbour)
        a, b, c = points[corners[face]]
        normal = np.cross(b - a, c - a)
        side = float((points[across] - a) @ normal)
        inside = float((middle - a) @ normal)
        slack = 1e-6 * extent * float(np.linalg.norm(normal))
        if side * inside < 0.0 and abs(side) > slack:
            return False
    return len({root(i) for i in used}) == 1


def _copy_loops(row: Floats, into: Floats) -> None:
    """Copy a row."""
    for k in range(row.shape[0]):
        into[k] = row[k]


def _copy_arrays(row: Floats, into: Floats) -> None:
    """NumPy form of `_copy_loops`."""
    into[:] = row


copy_row = jit_in_place(_copy_loops) if COMPILED else _copy_arrays


@jit_in_place
def beside(axis: Floats, side: Floats) -> None:
    """Write a unit vector at right angles to a unit vector."""
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


@jit_in_place
def cap_cell(ball: Floats, rim: float, ring: int, step: int, rings: int) -> None:
    """Make a sphere's row one of the 4 rings^2 cells of the cap around its pole.

    Parameters
    ----------
    rim : float
        The cap's angle, radians. Cells are equal steps of it: equal steps of the cosine would be coarse at the rim.
    """
    ball[LOW], ball[HIGH] = math.cos(rim * (ring + 1) / rings), math.cos(rim * ring / rings)
    ball[START], ball[END] = 0.5 * math.pi * step / rings, 0.5 * math.pi * (step + 1) / rings


@jit_in_place
def place(cell: Floats, turn: Floats, at: Floats, placed: Floats) -> None:
    """Write a cell turned by a matrix (3, 3) and moved."""
    copy_row(cell, placed)
    for r in range(3):
        o, f, s = at[r], 0.0, 0.0
        for c in range(3):
            o += turn[r, c] * cell[ORIGIN + c]
            f += turn[r, c] * cell[FIRST + c]
            s += turn[r, c] * cell[SECOND + c]
        placed[ORIGIN + r], placed[FIRST + r], placed[SECOND + r] = o, f, s


@jit_in_place
def turn_to(ball: Floats, pole: Floats, spread: float) -> float:
    """Turn a sphere's pole to a point; return the angle of the cap seen from within ``spread`` of that point."""
    far = 0.0
    for r in range(3):
        ball[FIRST + r] = pole[r] - ball[ORIGIN + r]
        far += ball[FIRST + r] ** 2
    far = math.sqrt(far)
    for r in range(3):
        ball[FIRST + r] /= far
    beside(ball[FIRST:SECOND], ball[SECOND:LOW])
    return min(math.pi, math.acos(min(1.0, ball[RADIUS] / far)) + math.asin(min(1.0, spread / far)))


@jit_in_place
def corner_of(cell: Floats, corner: int, point: Floats) -> None:
    """Write one of a cell's corners: four, or a triangle's three."""
    if cell[KIND] == SPHERE:
        _on_sphere(cell, cell[LOW + corner % 2], cell[START + corner // 2], point)
        for r in range(3):
            point[r] = cell[ORIGIN + r] + cell[RADIUS] * point[r]
        return
    first, second = corner == 1 or corner == 3, corner == 2 or corner == 3
    for r in range(3):
        point[r] = cell[ORIGIN + r] + (cell[FIRST + r] if first else 0.0) + (cell[SECOND + r] if second else 0.0)


@jit_in_place
def points_wanted(width: float, distance: float, digits: float) -> int:
    """Return the number of Gauss points along a side of half-width ``width`` for an error of exp(-digits).

    The integrand is analytic except at the points that see the cell, at least ``distance`` from its middle: for the
    ellipse through them Gauss's rule of k points errs by rho^(-2 k) (Trefethen 2008, theorem 4.5), times (2 k)^3
    because 1 / r^4 has a pole of the fourth order there. A cell too near a pole for that must be cut.
    """
    ratio = distance / max(width, 1e-300)
    if ratio <= 1.6:
        return MAX_POINTS + 1
    rate = 2.0 * math.log(ratio + math.sqrt(ratio * ratio - 1.0))
    for k in range(1, MAX_POINTS + 1):
        if k * rate - 3.0 * math.log(2.0 * k) >= digits:
            return k
    return MAX_POINTS + 1


class Between(NamedTuple):
    """The half vector of the ways from a point of a glossy surface to two discs on the wall, around x, y.

    Attributes
    ----------
    near, far : float
        Distances of their centres.
    cosine : float
        Between the half vector and the ways, but at least `GRAZING`.
    lean : float
        Least angle between the half vector and the normal, for any two points of the discs.
    """

    near: float
    far: float
    cosine: float
    lean: float


@jit_in_place
def half_way(
    point: Floats, normal: Floats, one: tuple[float, float, float], two: tuple[float, float, float]
) -> Between:
    """Return the half vector of the ways from a point to two discs (x, y, radius)."""
    u, v, s, t, h = one[0] - point[0], one[1] - point[1], two[0] - point[0], two[1] - point[1], point[2]
    near, far = math.sqrt(u * u + v * v + h * h), math.sqrt(s * s + t * t + h * h)
    length = math.sqrt(max(0.0, 2.0 + 2.0 * (u * s + v * t + h * h) / (near * far)))
    along = (
        normal[0] * (u / near + s / far) + normal[1] * (v / near + t / far) - normal[2] * h * (1.0 / near + 1.0 / far)
    )
    cosine = max(length / 2.0, GRAZING)
    lean = math.acos(min(1.0, abs(along) / max(length, 1e-12)))
    return Between(near, far, cosine, max(0.0, lean - (one[2] / near + two[2] / far) / (2.0 * cosine)))


@jit_in_place
def varies_over(cell: Floats, width: float, between: Between) -> tuple[float, float]:
    """Return over which distance a glossy cell's light varies, and the share of all that cells like it send.

    The reflectance has poles where the half vector leans to the normal by `SHARP`, an imaginary angle. From place to
    place it turns by half of what the two ways do, over the cosine between it and them; on a sphere the normal turns
    as well, so that some other cell is in the middle of the highlight.

    Parameters
    ----------
    cell : ndarray of shape (WIDTH,)
    width : float
        The cell's half width.
    between : Between
        Of its middle.
    """
    rate = (1.0 / between.near + 1.0 / between.far) / (2.0 * between.cosine)
    if cell[KIND] == SPHERE:
        rate += 1.0 / cell[RADIUS]
    sharp, lean = cell[SHARP], max(0.0, between.lean - rate * width)
    squared = sharp * sharp + lean * lean
    share = 1.0
    if cell[KIND] == SPHERE:
        share = sharp * sharp / squared
    return math.sqrt(squared) / rate, share


@jit_in_place
def middle_of(cell: Floats, middle: Floats) -> tuple[float, float]:
    """Write a cell's middle; return half of its widths along its two directions."""
    if cell[KIND] == SPHERE:
        radius = cell[RADIUS]
        low, high = math.acos(min(1.0, cell[HIGH])), math.acos(max(-1.0, cell[LOW]))
        polar, turn = (low + high) / 2.0, (cell[START] + cell[END]) / 2.0
        _on_sphere(cell, math.cos(polar), turn, middle)
        for r in range(3):
            middle[r] = cell[ORIGIN + r] + radius * middle[r]
        widest = math.sin(min(high, math.pi / 2.0)) if low < math.pi / 2.0 else math.sin(low)
        return radius * (high - low) / 2.0, radius * widest * (cell[END] - cell[START]) / 2.0
    first, second, across = 0.0, 0.0, 0.0
    share = 0.5 if cell[KIND] == PARALLELOGRAM else 1.0 / 3.0
    for r in range(3):
        middle[r] = cell[ORIGIN + r] + share * (cell[FIRST + r] + cell[SECOND + r])
        first += cell[FIRST + r] ** 2
        second += cell[SECOND + r] ** 2
        across += (cell[SECOND + r] - cell[FIRST + r]) ** 2
    if cell[KIND] == PARALLELOGRAM:
        return math.sqrt(first) / 2.0, math.sqrt(second) / 2.0
    return math.sqrt(max(first, second)) / 2.0, math.sqrt(across) / 2.0


@jit_in_place
def normal_of(cell: Floats, middle: Floats, normal: Floats) -> None:
    """Write a cell's unit normal at its middle."""
    if cell[KIND] == SPHERE:
        for r in range(3):
            normal[r] = (middle[r] - cell[ORIGIN + r]) / cell[RADIUS]
        return
    squared = 0.0
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        normal[r] = cell[FIRST + s] * cell[SECOND + t] - cell[FIRST + t] * cell[SECOND + s]
        squared += normal[r] ** 2
    for r in range(3):
        normal[r] /= math.sqrt(squared)


@jit_in_place
def _on_sphere(cell: Floats, cosine: float, turn: float, normal: Floats) -> None:
    """Write the unit normal at a polar cosine and an angle around the pole."""
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    c, s = sine * math.cos(turn), sine * math.sin(turn)
    p0, p1, p2 = cell[FIRST], cell[FIRST + 1], cell[FIRST + 2]
    q0, q1, q2 = cell[SECOND], cell[SECOND + 1], cell[SECOND + 2]
    normal[0] = cosine * p0 + c * q0 + s * (p1 * q2 - p2 * q1)
    normal[1] = cosine * p1 + c * q1 + s * (p2 * q0 - p0 * q2)
    normal[2] = cosine * p2 + c * q2 + s * (p0 * q1 - p1 * q0)


@jit_in_place
def cut(cell: Floats, stack: Floats, top: int, along_first: bool, along_second: bool) -> int:
    """Push a cell's halves, quarters or (of a triangle) its four triangles; return the new top of the stack."""
    if cell[KIND] == TRIANGLE:
        for part in range(4):
            row = stack[top + part]
            copy_row(cell, row)
            for r in range(3):
                e, f = cell[FIRST + r] / 2.0, cell[SECOND + r] / 2.0
                row[FIRST + r], row[SECOND + r] = e, f
                if part == 1:
                    row[ORIGIN + r] = cell[ORIGIN + r] + e
                elif part == 2:
                    row[ORIGIN + r] = cell[ORIGIN + r] + f
                elif part == 3:  # the middle one is inverted
                    row[ORIGIN + r], row[FIRST + r], row[SECOND + r] = cell[ORIGIN + r] + e + f, -e, -f
        return top + 4
    parts = 0
    for i in range(2 if along_first else 1):
        for j in range(2 if along_second else 1):
            row = stack[top + parts]
            copy_row(cell, row)
            parts += 1
            if cell[KIND] == SPHERE:
                if along_first:
                    low, high = math.acos(min(1.0, cell[HIGH])), math.acos(max(-1.0, cell[LOW]))
                    cosine = math.cos((low + high) / 2.0)
                    row[HIGH if i else LOW] = cosine
                if along_second:
                    row[END - j] = (cell[START] + cell[END]) / 2.0
                continue
            for r in range(3):
                if along_first:
                    row[FIRST + r] = cell[FIRST + r] / 2.0
                if along_second:
                    row[SECOND + r] = cell[SECOND + r] / 2.0
                row[ORIGIN + r] = cell[ORIGIN + r] + i * row[FIRST + r] + j * row[SECOND + r]
    return top + parts


@jit_in_place
def cell_point(cell: Floats, i: int, j: int, ku: int, kv: int, gauss: Floats, point: Floats, normal: Floats) -> float:
    """Write quadrature point (i, j) of a cell and its unit normal; return its weight, an area."""
    nodes, weights, corner, corner_weights = gauss[0], gauss[1], gauss[2], gauss[3]
    if cell[KIND] == SPHERE:
        u = cell[LOW] + nodes[ku, i] * (cell[HIGH] - cell[LOW])
        _on_sphere(cell, u, cell[START] + nodes[kv, j] * (cell[END] - cell[START]), normal)
        for r in range(3):
            point[r] = cell[ORIGIN + r] + cell[RADIUS] * normal[r]
        area = cell[RADIUS] ** 2 * (cell[HIGH] - cell[LOW]) * (cell[END] - cell[START])
        return weights[ku, i] * weights[kv, j] * area
    normal[0] = cell[FIRST + 1] * cell[SECOND + 2] - cell[FIRST + 2] * cell[SECOND + 1]
    normal[1] = cell[FIRST + 2] * cell[SECOND] - cell[FIRST] * cell[SECOND + 2]
    normal[2] = cell[FIRST] * cell[SECOND + 1] - cell[FIRST + 1] * cell[SECOND]
    area = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    for r in range(3):
        normal[r] /= area
    if cell[KIND] == PARALLELOGRAM:
        for r in range(3):
            point[r] = cell[ORIGIN + r] + nodes[ku, i] * cell[FIRST + r] + nodes[kv, j] * cell[SECOND + r]
        return weights[ku, i] * weights[kv, j] * area
    # Duffy 1982: the triangle as a square of which one side is shrunk to a corner.
    for r in range(3):
        across = (1.0 - nodes[kv, j]) * cell[FIRST + r] + nodes[kv, j] * cell[SECOND + r]
        point[r] = cell[ORIGIN + r] + corner[ku, i] * across
    return corner_weights[ku, i] * weights[kv, j] * area / 2.0


@jit_in_place
def add_points(cell: Floats, owner: int, ku: int, kv: int, gauss: Floats, found: Floats, count: int) -> int:
    """Append a cell's quadrature points, ku along its first side, kv along its second.

    Returns
    -------
    int
        The new count; negative if ``found`` has too few rows.
    """
    if count + ku * kv > found.shape[0]:
        return -1
    for i in range(ku):
        for j in range(kv):
            row = found[count]
            row[AREA] = cell_point(cell, i, j, ku, kv, gauss, row[POINT:NORMAL], row[NORMAL:AREA])
            row[CELL], row[ONE_SIDED] = owner, cell[SIDED]
            count += 1
    return count


@jit_in_place
def distance_to_disc(x: Floats, c0: float, c1: float, radius: float) -> float:
    """Return the distance from a point to a disc on the wall."""
    lateral = max(0.0, math.sqrt((x[0] - c0) ** 2 + (x[1] - c1) ** 2) - radius)
    return math.sqrt(lateral * lateral + x[2] * x[2])
