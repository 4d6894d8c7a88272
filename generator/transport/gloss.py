"""Glossy reflection by microfacets (`facets`): sums of the light that a glossy target sends to the wall.

A Lambertian target's light is a product of what it receives and what it sends. A glossy one couples the two
directions, so its sum goes over pairs of a point of the lit patch and a point of the target, for every point of the
wall.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport import elements, facets, integral
from generator.transport.compiled import COMPILED, jit_in_place, jit_loops, jit_parts
from generator.transport.elements import AREA, CELL, NORMAL, ONE_SIDED, POINT
from generator.transport.lit import ORDERS, Rules, distance_to, order_for, radius_of, seen_with
from generator.transport.records import Boxes, Disc, Parts, Target
from generator.transport.world import Body, Gloss, Mesh

Floats = NDArray[Any]

_TABLE = 256
"""Intervals of the cosine in which the light that leaves after one facet is tabulated."""

_ROWS = 256


class Shine(NamedTuple):
    """Glossy reflection of a target's cells.

    Attributes
    ----------
    tint, multiple : ndarray of shape (cells, groups)
        As in `world.Gloss`.
    alpha : ndarray of shape (cells,)
        Width of the slopes of the facets; 0 for a cell that is not glossy.
    sharp : ndarray of shape (cells,)
        The imaginary angle to the normal at which the slopes' distribution has its pole, where tan^2 = -alpha^2.
        Masking has its branch points as far from the horizon.
    table : ndarray of shape (cells,), int
        Row of ``missing`` of each.
    missing : ndarray of shape (materials, _TABLE + 1)
        `facets.missing`, at equal steps of the cosine from 0 to 1.
    """

    tint: Floats
    multiple: Floats
    alpha: Floats
    sharp: Floats
    table: Floats
    missing: Floats


class Glossy(NamedTuple):
    """A target whose cells are as fine as its gloss requires (`elements.SHARP`), and its gloss."""

    target: Target
    shine: Shine


def shine(bodies: Sequence[Body], kept: Floats, channels: list[int]) -> Shine:
    """Return the glossy reflection of a target's cells.

    Parameters
    ----------
    bodies : sequence of Sphere or Mesh
    kept : ndarray of shape (cells,), int
        Row of all bodies' rows that each cell has, meshes before spheres (`elements.cells`).
    channels : list of int
        Colour channel of each group.
    """
    ordered = sorted(bodies, key=lambda body: not isinstance(body, Mesh))
    glosses = [rows_of(body) for body in ordered]
    tint, multiple, roughness = (
        np.concatenate([getattr(gloss, name) for gloss in glosses])[kept]
        for name in ("tint", "multiple", "roughness")
    )
    alpha = np.where(tint.any(axis=1), roughness**2, 0.0)
    widths, table = np.unique(alpha, return_inverse=True)
    tables = [np.zeros(_TABLE + 1) if width == 0.0 else facets.missing(float(width), _TABLE) for width in widths]
    return Shine(
        np.ascontiguousarray(tint[:, channels]),
        np.ascontiguousarray(multiple[:, channels]),
        alpha,
        np.arctanh(np.minimum(alpha, 1.0 - 1e-9)),
        table.astype(np.int64),
        np.array(tables),
    )


def none(cells: int, groups: int) -> Shine:
    """Return the glossy reflection of cells of which none is glossy."""
    black, zeros = np.zeros((cells, groups)), np.zeros(cells)
    return Shine(black, black, zeros, zeros, np.zeros(cells, dtype=np.int64), np.zeros((1, _TABLE + 1)))


def rows_of(body: Body) -> Gloss:
    """Return a body's gloss, that of a body without it as black."""
    n = len(body.triangles) if isinstance(body, Mesh) else 1
    return body.gloss or Gloss(np.zeros((n, 3)), np.ones(n), np.zeros((n, 3)))


# --------------------------------------------------------------------------------------------------------------------
# The reflectance
# --------------------------------------------------------------------------------------------------------------------


@jit_in_place
def pair(alpha: float, cos_in: float, cos_out: float, between: float) -> float:
    """Return pi times the reflectance of white facets, for light that comes and goes in two directions.

    With c and c' the cosines of the two to the normal, and s = sin^2 of the half vector h to it,

        f = D(h) G(c, c') / (4 c c'),     D = alpha^2 / (pi (s + alpha^2 cos^2(h))^2),
        G / (4 c c') = 1 / (2 (c' r(c) + c r(c'))),     r(c) = sqrt(alpha^2 + (1 - alpha^2) c^2)

    Parameters
    ----------
    alpha : float
    cos_in, cos_out : float
        Above 0.
    between : float
        Cosine of the angle between the two directions.
    """
    width = alpha * alpha
    rest = 1.0 - width
    half = 2.0 + 2.0 * between
    spread = half - rest * (cos_in + cos_out) ** 2
    masked = cos_out * math.sqrt(width + rest * cos_in**2) + cos_in * math.sqrt(width + rest * cos_out**2)
    return 0.5 * width * half * half / (spread * spread * masked)


def missing_at(cosines: Floats, cells: Floats, shine: Shine) -> Floats:
    """Return `more` for the cosines (n,) of ways from cells (n,)."""
    found = np.zeros(len(cosines))
    at = np.linspace(0.0, 1.0, shine.missing.shape[1])
    for row, missing in enumerate(shine.missing):
        chosen = shine.table[cells] == row
        found[chosen] = np.interp(cosines[chosen], at, missing)
    return found


@jit_in_place
def more(cosine: float, missing: Floats) -> float:
    """Return `facets.missing` at the cosine of the way that the light leaves, from a row of a table."""
    place = min(cosine, 1.0) * (missing.shape[0] - 1)
    k = max(0, min(int(place), missing.shape[0] - 2))
    return missing[k] + (place - k) * (missing[k + 1] - missing[k])


# --------------------------------------------------------------------------------------------------------------------
# Sums
# --------------------------------------------------------------------------------------------------------------------


class Look(NamedTuple):
    """A point's alpha^2, and whether its light goes on smoothly beyond its horizon, as negative values."""

    width: float
    beyond: bool


_LEAST = 0.1
"""Least share of masking by one of its two terms, which the other cancels deep below the horizon."""


def _sent_loops(
    wall: Floats, element: Floats, lamps: Floats, count: int, look: Look, ways: Floats, total: Floats
) -> None:
    """Write the light that wall points receive from a point of the target, per unit of tint.

        total_k = A cos cos / |w_k - x|^2  sum_q  E_q pi f(q, k)

    Parameters
    ----------
    wall : ndarray of shape (2, k)
        Wall points.
    element : ndarray of shape (7,)
        The point's position (3), unit normal (3) and area.
    lamps : ndarray of shape (6, capacity)
        To each point of the patch: unit direction (3), its cosine to the normal, r of that (`pair`), and the
        irradiance from there.
    count : int
        Number of columns of ``lamps`` that are filled.
    look : Look
    ways : ndarray of shape (6, k), written
        To each wall point: unit direction (3), its cosine to the normal, r of that, and the first factor of the sum,
        0 where the point does not face it.
    total : ndarray of shape (k,), written
    """
    width, beyond = look.width, look.beyond
    rest = 1.0 - width
    x, y, h, n0, n1, n2 = element[0], element[1], element[2], element[3], element[4], element[5]
    for k in range(wall.shape[1]):
        u, v = wall[0, k] - x, wall[1, k] - y
        squared = u * u + (v * v + h * h)
        near = 1.0 / math.sqrt(squared)
        cosine = (n0 * u + (n1 * v - n2 * h)) * near
        faces = cosine > 0.0 or beyond  # else any direction that the formula takes
        ways[0, k] = u * near if faces else n0
        ways[1, k] = v * near if faces else n1
        ways[2, k] = -h * near if faces else n2
        ways[3, k] = cosine if faces else 1.0
        ways[4, k] = math.sqrt(width + rest * ways[3, k] * ways[3, k])
        ways[5, k] = element[6] * cosine * h * near / squared if faces else 0.0
        total[k] = 0.0
    for q in range(count):
        d0, d1, d2, c, r = lamps[0, q], lamps[1, q], lamps[2, q], lamps[3, q], lamps[4, q]
        scaled = 0.5 * width * lamps[5, q]
        for k in range(wall.shape[1]):
            half = 2.0 + 2.0 * (d0 * ways[0, k] + (d1 * ways[1, k] + d2 * ways[2, k]))
            both = c + ways[3, k]
            spread = half - rest * (both * both)
            masked = max(ways[3, k] * r + c * ways[4, k], _LEAST * c * ways[4, k])
            total[k] += scaled * half * half / (spread * spread * masked)
    for k in range(wall.shape[1]):
        total[k] *= ways[5, k]


def _sent_arrays(
    wall: Floats, element: Floats, lamps: Floats, count: int, look: Look, ways: Floats, total: Floats
) -> None:
    """NumPy form of `_sent_loops`."""
    width, (x, y, h), normal = look.width, element[:3], element[3:6, None]
    rest = 1.0 - width
    way = np.stack([wall[0] - x, wall[1] - y, np.full(wall.shape[1], -h)])
    squared = (way * way).sum(axis=0)
    near = 1.0 / np.sqrt(squared)
    cosine = (normal * way).sum(axis=0) * near
    faces = (cosine > 0.0) | look.beyond
    ways[:3] = np.where(faces, way * near, normal)
    ways[3] = np.where(faces, cosine, 1.0)
    ways[4] = np.sqrt(width + rest * ways[3] ** 2)
    ways[5] = np.where(faces, element[6] * cosine * h * near / squared, 0.0)
    c, r, sent = lamps[3:, :count, None]
    half = 2.0 + 2.0 * (lamps[:3, :count].T @ ways[:3])
    spread = half - rest * (c + ways[3]) ** 2
    masked = np.maximum(ways[3] * r + c * ways[4], _LEAST * c * ways[4])
    terms = 0.5 * width * sent * half * half / (spread * spread * masked)
    total[:] = terms.sum(axis=0) * ways[5]


sent = jit_loops(_sent_loops) if COMPILED else _sent_arrays


@jit_in_place
def receive(point: Floats, normal: Floats, nodes: Floats, number: int, width: float, lamps: Floats) -> int:
    """Write the rows of `sent` for points of the patch; return the number of those that a surface point faces.

    ``nodes`` are as `kernel.irradiance` takes them.
    """
    count = 0
    for q in range(number):
        u, v = nodes[0, q] - point[0], nodes[1, q] - point[1]
        squared = u * u + v * v + point[2] * point[2]
        near = 1.0 / math.sqrt(squared)
        cosine = (normal[0] * u + normal[1] * v - normal[2] * point[2]) * near
        if cosine <= 0.0:
            continue
        lamps[0, count], lamps[1, count], lamps[2, count] = u * near, v * near, -point[2] * near
        lamps[3, count], lamps[4, count] = cosine, math.sqrt(width + (1.0 - width) * cosine * cosine)
        lamps[5, count] = nodes[2, q] * cosine * point[2] * near / squared
        count += 1
    return count


@jit_in_place
def turns_over(sharp: float, between: elements.Between) -> float:
    """Return the angle by which the way to the patch, or to the wall, must turn for the light of a point to vary."""
    return 2.0 * between.cosine * math.sqrt(sharp * sharp + between.lean * between.lean)


class _Job(NamedTuple):
    """Panels, and what they receive light from: see `panels`."""

    boxes: Boxes
    target: Target
    shine: Shine
    parts: Parts
    rules: Rules


class _Space(NamedTuple):
    """Scratch space.

    Attributes
    ----------
    covering : integral.Covering
    faced, centre : ndarray of shape (3,)
        Centres of discs around the patch and the panel.
    wall : ndarray of shape (2, k)
        The panel's points, relative to the centre.
    element : ndarray of shape (7,)
    ways, total : ndarray of shape (6, k) and (k,)
        As in `sent`.
    nodes, lamps : ndarray of shape (3, ORDERS^2) and (6, ORDERS^2)
    wanted : ndarray of shape (cells,), int
    """

    covering: integral.Covering
    faced: Floats
    centre: Floats
    wall: Floats
    element: Floats
    ways: Floats
    total: Floats
    nodes: Floats
    lamps: Floats
    wanted: Floats


def _space(job: _Job, rows: int) -> _Space:
    points = len(job.boxes.places)
    return _Space(
        integral.room_to_cover(rows),
        np.array([job.rules.patch.x, job.rules.patch.y, 0.0]),
        np.zeros(3),
        np.empty((2, points)),
        np.empty(7),
        np.empty((6, points)),
        np.empty(points),
        np.empty((3, ORDERS * ORDERS)),
        np.empty((6, ORDERS * ORDERS)),
        np.empty(len(job.shine.alpha), dtype=np.int64),
    )


def panels(
    start: int,
    stop: int,
    boxes: Boxes,
    glossy: Glossy,
    parts: Parts,
    rules: Rules,
    values: Floats,
    reports: Floats,
) -> None:
    """Evaluate panels ``start`` to ``stop`` of pictures: what a glossy target sends to their points, unobstructed.

    Parameters
    ----------
    start, stop : int
    boxes : Boxes
    glossy : Glossy
    parts : Parts
    rules : Rules
    values : ndarray of shape (n, groups, k), written
    reports : ndarray of shape (n, 4), written
        As for `integral.panels`; the distance is also one over which the light on the wall varies.
    """
    job, rows = _Job(boxes, glossy.target, glossy.shine, parts, rules), _ROWS
    while start < stop:
        start = _evaluate(start, stop, job, _space(job, rows), values, reports)
        rows *= 2


@jit_parts
def _evaluate(start: int, stop: int, job: _Job, space: _Space, values: Floats, reports: Floats) -> int:
    """Evaluate panels; return the first that was not, because ``space`` is too small for it."""
    boxes, target, shine, rules = job.boxes, job.target, job.shine, job.rules
    wall, centre, element, ways, total = space.wall, space.centre, space.element, space.ways, space.total
    points, normal, flat = space.covering.points, space.element[3:6], target.flat.shape[0]
    lit = (rules.patch.x, rules.patch.y, radius_of(rules.patch))
    for item in range(start, stop):
        part = boxes.owner[item]
        pose, beyond = job.parts.poses[part], False
        for c in range(shine.alpha.shape[0]):
            space.wanted[c] = job.parts.wanted[part, target.faces[c]] if shine.alpha[c] > 0.0 else 0
            beyond = beyond or space.wanted[c] & integral.ON != 0
        radius = integral.panel_at(boxes.boxes[item], boxes, wall, centre)
        view = Disc(centre, radius)
        seen = integral.Seen(Disc(space.faced, radius_of(rules.patch)), view, rules, np.inf)
        turn, at = job.parts.turns[pose], job.parts.places[pose]
        rows, nearest = integral.cover_in(target, turn, at, seen, space.wanted, space.covering)
        if rows < 0:
            return item
        values[item] = 0.0
        most = 0
        for k in range(rows):
            point, row = points[k, POINT:NORMAL], int(points[k, CELL])
            width, missing = shine.alpha[row] ** 2, shine.missing[shine.table[row]]
            between = elements.half_way(point, points[k, NORMAL:AREA], lit, (centre[0], centre[1], radius))
            angle = turns_over(shine.sharp[row], between)
            order = order_for(min(1.0, angle) * distance_to(point, rules.patch), rules.patch, rules.digits)
            u, v = centre[0] - point[0], centre[1] - point[1]
            if row < flat:
                nearest = min(nearest, angle * between.far)
            element[0], element[1], element[2], element[6] = -u, -v, point[2], points[k, AREA]
            for side in range(1 if points[k, ONE_SIDED] else 2):
                if space.wanted[row] & (side + 1) == 0:
                    continue
                for r in range(3):
                    normal[r] = -points[k, NORMAL + r] if side else points[k, NORMAL + r]
                if normal[0] * u + normal[1] * v - normal[2] * point[2] < -radius:
                    continue  # faces away from all of the panel
                whole, number = seen_with(point, normal, rules, order, space.nodes)
                nodes = rules.whole[whole] if whole >= 0 else space.nodes
                number = receive(point, normal, nodes, number, width, space.lamps)
                if number == 0:
                    continue
                most = max(most, number)
                sent(wall, element, space.lamps, number, Look(width, beyond), ways, total)
                _tint(row, shine, missing, ways[3], total, values[item])
        reports[item, 0], reports[item, 1], reports[item, 2], reports[item, 3] = rows, most, nearest, radius
    return stop


@jit_in_place
def _tint(row: int, shine: Shine, missing: Floats, cosines: Floats, total: Floats, values: Floats) -> None:
    """Add to ``values`` (groups, k) what a point of a cell sends, with the light that further facets send on."""
    for g in range(values.shape[0]):
        tint, again = shine.tint[row, g], shine.multiple[row, g]
        for k in range(total.shape[0]):
            factor = tint
            if again != 0.0:
                factor *= 1.0 + again * more(cosines[k], missing)
            values[g, k] += factor * total[k]
