"""Light on pieces: quadrature, and its change where a shadow's edge moves."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from generator.transport import elements
from generator.transport.compiled import jit_in_place, jit_within
from generator.transport.lit import distance_to, order_at
from generator.transport.polygons import (
    AREA,
    CORNER,
    COUNT,
    NORMAL,
    ORDER,
    Path,
    add_by_way_of,
    copy,
    height_above,
    height_of,
    is_lit,
    light_of,
    middle,
    on_facet,
    within,
)
from generator.transport.shadows.cones import Cones, Floats, all_parts
from generator.transport.shadows.pieces import ON_LINE, Pieces, Scene, View, Work, cleared, covered, on_plane


class Kept(NamedTuple):
    """Regions of the surfaces that the shadows of the patch's points cover.

    Attributes
    ----------
    polygons : ndarray of shape (n, CORNERS, 2)
        Along the surface's axes.
    corners : ndarray of shape (n,), int
        Number of corners of each.
    of : ndarray of shape (n, 2), int
        Index of the surface that each is on, and of the point whose shadow it is.
    number : int
        Number of polygons; negative if there were too many.
    """

    polygons: Floats
    corners: Floats
    of: Floats
    number: int


@jit_in_place
def _facet_rates(facet: Floats, k: int, view: Floats, at: Floats, point: Floats, rates: Floats, work: Floats) -> None:
    """Write how the k-th half-space of what a facet hides changes at a point as the target moves and turns.

    With corners a and b and the point d relative to the view, it is -(a x b) . d, and a moves by t + w x (a's arm).
    """
    side = 1.0 if height_above(facet, view) > 0.0 else -1.0
    n = int(facet[COUNT])
    if k == n:
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            rates[r] = side * facet[NORMAL + r]
            rates[3 + r] = -side * (facet[NORMAL + s] * (point[t] - at[t]) - facet[NORMAL + t] * (point[s] - at[s]))
        return
    i, j = CORNER + 3 * k, CORNER + 3 * ((k + 1) % n)
    left, right = work[:3], work[3:]
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        ds, dt = point[s] - view[s], point[t] - view[t]
        left[r] = (facet[j + s] - view[s]) * dt - (facet[j + t] - view[t]) * ds
        right[r] = ds * (facet[i + t] - view[t]) - dt * (facet[i + s] - view[s])
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        rates[r] = -side * (left[r] + right[r])
        rates[3 + r] = -side * (
            (facet[i + s] - at[s]) * left[t]
            - (facet[i + t] - at[t]) * left[s]
            + (facet[j + s] - at[s]) * right[t]
            - (facet[j + t] - at[t]) * right[s]
        )


@jit_in_place
def _ball_rates(
    ball: Floats, space: Floats, apothem: float, view: Floats, at: Floats, point: Floats, rates: Floats
) -> None:
    """As `_facet_rates`, for one side of a sphere's outline, which moves along without turning about its axis."""
    far, along, sine = 0.0, 0.0, 0.0
    for r in range(3):
        far += (ball[r] - view[r]) ** 2
        along += (ball[r] - view[r]) * (point[r] - view[r])
    far = math.sqrt(far)
    along /= far
    sine = min(ball[3] / far, 1.0 - 1e-9)
    cosine = math.sqrt(1.0 - sine * sine)
    opening = apothem * sine / cosine
    slope = -apothem * sine / (far * cosine**3)
    for r in range(3):
        axis = (ball[r] - view[r]) / far
        radial = opening * axis - space[r]
        rates[r] = (slope - opening / far) * along * axis + (opening * (point[r] - view[r]) + along * radial) / far
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        rates[3 + r] = (ball[s] - at[s]) * rates[t] - (ball[t] - at[t]) * rates[s]


class _Edge(NamedTuple):
    """An edge of a polygon on the border of the region that a part of the target hides: that of half-space ``side``,
    whose value changes by ``steep`` per length in the plane; ``sign`` tells on which side of it the polygon is.
    """

    part: int
    side: int
    start: Floats
    end: Floats
    sign: float
    steep: float


@jit_in_place
def _add_edge(light: Floats, edge: _Edge, path: Path, view: View, scene: Scene, work: Floats) -> None:
    """Add to ``light[1:]`` the light along an edge, times how fast it moves; ``work`` (4, 6) is scratch space."""
    if not is_lit(path):
        return
    occluders, rules = scene.occluders, scene.rules
    gauss = rules.gauss
    sample, rates, point = work[:1], work[1], work[2, :3]
    u0, v0, u1, v1 = edge.start[0], edge.start[1], edge.end[0], edge.end[1]
    length = math.hypot(u1 - u0, v1 - v0)
    on_facet(path.facet, (u0 + u1) / 2.0, (v0 + v1) / 2.0, point)
    distance = min(elements.distance_to_disc(point, path.wall[0], path.wall[1], 0.0), distance_to(point, rules.patch))
    cuts = 1 + int(length / distance) if length < 999.0 * distance else 1000
    number = min(elements.MAX_POINTS, elements.points_wanted(length / cuts / 2.0, distance, rules.digits))
    sample[0, AREA], sample[0, ORDER] = 1.0, order_at(point, rules.patch, rules.digits)
    level = abs(height_of(path.facet, path.wall[0], path.wall[1]))
    for piece in range(cuts):
        for g in range(number):
            share = (piece + gauss[0, number, g]) / cuts
            on_facet(path.facet, u0 + share * (u1 - u0), v0 + share * (v1 - v0), point)
            for r in range(3):
                sample[0, r] = point[r]
            if edge.part < occluders.flat:
                _facet_rates(occluders.facets[edge.part], edge.side, view.point, scene.at, point, rates, work[3])
            else:
                ball, sides = occluders.balls[edge.part - occluders.flat], occluders.sides
                space = view.cones.spaces[edge.part, edge.side]
                _ball_rates(ball, space, sides[sides.shape[0] - 1, 0], view.point, scene.at, point, rates)
            weight = edge.sign * gauss[1, number, g] * length / cuts / edge.steep
            weight *= add_by_way_of(0.0, sample, 1, path, rules.whole) * level
            for r in range(6):
                light[1 + r] += weight * rates[r]


@jit_in_place
def _add_rates(
    light: Floats, sign: float, polygon: Floats, n: int, path: Path, view: View, scene: Scene, work: Work
) -> None:
    """Add to ``light[1:]`` how light by way of a polygon changes as the target's shadows, seen from a point, move.

    By Reynolds' theorem it is an integral of the light along the edges that move, times how fast they do.
    """
    lines, flat = work.cutting.lines, scene.occluders.flat
    middle0, middle1 = middle(polygon, n)
    for part in range(scene.target.parts):
        count = view.cones.counts[part]
        on_plane(path.facet, view.cones.spaces[part], count, lines)
        for i in range(count):
            a, b, c = lines[i, 0], lines[i, 1], lines[i, 2]
            steep = math.hypot(a, b)
            if steep == 0.0 or (part >= flat and i == count - 1):
                continue
            inside = 1.0 if a * middle0 + b * middle1 + c > 0.0 else -1.0
            for j in range(n):
                start, end = polygon[j], polygon[(j + 1) % n]
                if abs(a * start[0] + b * start[1] + c) > ON_LINE * steep:
                    continue
                if abs(a * end[0] + b * end[1] + c) > ON_LINE * steep:
                    continue
                _add_edge(light, _Edge(part, i, start, end, sign * inside, steep), path, view, scene, work.edge)


@jit_in_place
def add_seen(light: Floats, s: int, eye: View, pieces: Pieces, count: int, scene: Scene, work: Work) -> None:
    """Add what a wall point receives by way of pieces of a surface that it sees, where occluders let the light in."""
    facet, occluder, rules = scene.surfaces[s], scene.first + s, scene.rules
    spaces, counts = scene.from_lamps
    last = all_parts(scene.occluders)
    cutting = work.cutting
    lines, spare, lit = cutting.lines, cutting.spare, cutting.some
    moving = light.shape[0] > 1
    for p in range(count):
        polygon, corners = pieces.polygons[p], pieces.corners[p]
        blocked = False
        for q in range(counts.shape[0]):
            for part in range(scene.first, last):
                k = counts[q, part]
                if blocked or part == occluder or k == 0:
                    continue
                on_plane(facet, spaces[q, part], k, lines)
                blocked = within(polygon, corners, lines, k, spare[0], spare[1]) > 0
        for q in range(counts.shape[0] if blocked else 1):
            copy(polygon, corners, lit.polygons[0])
            lit.corners[0] = corners
            number, node = 1, work.zeros
            if blocked:
                node = scene.nodes[q]
                number = cleared(facet, occluder, lit, 1, Cones(spaces[q], counts[q]), scene.first, last, cutting)
            if number < 0:
                light[:] = np.nan
            path = Path(facet, eye.point, node)
            for i in range(number):
                light[0] += light_of(lit.polygons[i], lit.corners[i], path, rules, work.summing)
                if moving:
                    _add_rates(light, 1.0, lit.polygons[i], lit.corners[i], path, eye, scene, work)


@jit_within
def add_kept(light: Floats, whole: bool, kept: Kept, p: int, eye: View, scene: Scene, work: Work) -> None:
    """Add the light that a wall point loses to a lamp point's shadow; if not ``whole``, only subtract what is hidden
    from it anyway.
    """
    s, q = kept.of[p, 0], kept.of[p, 1]
    facet, rules = scene.surfaces[s], scene.rules
    lamp = View(scene.lamps[q], Cones(scene.from_lamps.spaces[q], scene.from_lamps.counts[q]))
    path = Path(facet, eye.point, scene.nodes[q])
    held, pieces, cutting = work.held, work.pieces, work.cutting
    moving = light.shape[0] > 1
    copy(kept.polygons[p], kept.corners[p], held.polygons[0])
    held.corners[0] = kept.corners[p]
    count = 1
    if whole:
        last = all_parts(scene.occluders)
        count = cleared(facet, scene.first + s, held, 1, eye.cones, scene.first, last, cutting)
    overlaps = 0
    for k in range(count):
        overlaps = covered(
            facet, held.polygons[k], held.corners[k], eye.cones, scene.target, pieces, overlaps, cutting
        )
    if count < 0 or overlaps < 0:
        light[:] = np.nan
        return
    for k in range(count if whole else 0):
        light[0] += light_of(held.polygons[k], held.corners[k], path, rules, work.summing)
        if moving:
            _add_rates(light, 1.0, held.polygons[k], held.corners[k], path, lamp, scene, work)
    for k in range(overlaps):
        light[0] -= light_of(pieces.polygons[k], pieces.corners[k], path, rules, work.summing)
        if moving:
            _add_rates(light, -1.0, pieces.polygons[k], pieces.corners[k], path, lamp, scene, work)
            _add_rates(light, -1.0, pieces.polygons[k], pieces.corners[k], path, eye, scene, work)
