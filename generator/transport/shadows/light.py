"""Light over pieces: quadrature, and its change where a shadow's edge moves."""

from __future__ import annotations

import math

import numpy as np

from generator.transport import elements, integral
from generator.transport.compiled import NONE, ONE, jit
from generator.transport.polygons import by_way_of, spread, within
from generator.transport.shadows.cones import Cones, Floats, Occluders
from generator.transport.shadows.pieces import ON_LINE, Pieces, Work, cleared, covered, on_plane

Rules = tuple[Floats, Floats, Floats, float]
"""Quadrature: the patch's rules, the patch, Gauss points, digits."""


@jit
def _add_light(
    light: Floats,
    sign: float,
    polygon: Floats,
    n: int,
    facet: Floats,
    wall: Floats,
    node: Floats,
    rules: Rules,
    stack: Floats,
    found: Floats,
) -> Floats:
    """Add to ``light[0]`` what a wall point receives by way of a polygon; return ``found``, perhaps grown."""
    whole, patch, gauss, digits = rules
    found, count = spread(polygon, n, facet, wall, 0.0, patch, gauss, digits, stack, found, NONE[0])
    light[0] += sign * by_way_of(found, count, facet, wall, node, whole)
    return found


@jit
def _facet_rates(facet: Floats, k: int, view: Floats, at: Floats, point: Floats, rates: Floats) -> None:
    """Write how the k-th half-space of what a facet hides changes at a point as the target moves and turns.

    With corners a and b as seen from the view and d the point, it is -(a x b) . d, and a moves by t + w x (a's arm).
    """
    level = facet[9] * view[0] + facet[10] * view[1] + facet[11] * view[2] - facet[12]
    side = 1.0 if level > 0.0 else -1.0
    n = int(facet[13])
    if k == n:
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            rates[r] = side * facet[9 + r]
            rates[3 + r] = -side * (facet[9 + s] * (point[t] - at[t]) - facet[9 + t] * (point[s] - at[s]))
        return
    i, j = 14 + 3 * k, 14 + 3 * ((k + 1) % n)
    left, right = np.empty(3), np.empty(3)
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


@jit
def _ball_rates(
    ball: Floats, space: Floats, apothem: float, view: Floats, at: Floats, point: Floats, rates: Floats
) -> None:
    """As `_facet_rates`, for one side of a sphere's outline, carried along without turning about its axis."""
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


@jit
def _add_rates(
    light: Floats,
    sign: float,
    polygon: Floats,
    n: int,
    facet: Floats,
    wall: Floats,
    node: Floats,
    view: Floats,
    cones: Cones,
    occluders: Occluders,
    at: Floats,
    rules: Rules,
    lines: Floats,
    found: Floats,
) -> None:
    """Add to ``light[1:]`` how light by way of a polygon changes as the target's shadows, seen from a point, move.

    By Reynolds' theorem that is an integral of the light along the edges that move, times how fast they do.
    """
    every, first, balls, sides = occluders
    spaces, counts = cones
    whole, patch, gauss, digits = rules
    patch_radius = math.sqrt(patch[2] ** 2 + patch[3] ** 2)
    rates, point = np.empty(6), np.empty(3)
    middle0, middle1 = polygon[:n, 0].mean(), polygon[:n, 1].mean()
    for part in range(first + balls.shape[0]):
        on_plane(facet, spaces[part], counts[part], lines)
        for i in range(counts[part]):
            a, b, c = lines[i, 0], lines[i, 1], lines[i, 2]
            steep = math.hypot(a, b)
            if steep == 0.0 or (part >= first and i == counts[part] - 1):
                continue
            inside = 1.0 if a * middle0 + b * middle1 + c > 0.0 else -1.0
            for j in range(n):
                u0, v0 = polygon[j, 0], polygon[j, 1]
                u1, v1 = polygon[(j + 1) % n, 0], polygon[(j + 1) % n, 1]
                if abs(a * u0 + b * v0 + c) > ON_LINE * steep or abs(a * u1 + b * v1 + c) > ON_LINE * steep:
                    continue
                length = math.hypot(u1 - u0, v1 - v0)
                for r in range(3):
                    point[r] = facet[r] + (u0 + u1) / 2.0 * facet[3 + r] + (v0 + v1) / 2.0 * facet[6 + r]
                distance = min(
                    elements.distance_to_disc(point, wall[0], wall[1], 0.0),
                    elements.distance_to_disc(point, patch[0], patch[1], patch_radius),
                )
                cuts = min(1000, 1 + int(length / distance))
                wanted = min(elements.MAX_POINTS, elements.points_wanted(length / cuts / 2.0, distance, digits))
                found[0, 3], found[0, 4] = 1.0, integral.patch_order(point, patch, digits)
                for piece in range(cuts):
                    for g in range(wanted):
                        share = (piece + gauss[0, wanted, g]) / cuts
                        for r in range(3):
                            point[r] = (
                                facet[r]
                                + (u0 + share * (u1 - u0)) * facet[3 + r]
                                + (v0 + share * (v1 - v0)) * facet[6 + r]
                            )
                            found[0, r] = point[r]
                        if part < first:
                            _facet_rates(every[part], i, view, at, point, rates)
                        else:
                            apothem = sides[sides.shape[0] - 1, 0]
                            _ball_rates(balls[part - first], spaces[part, i], apothem, view, at, point, rates)
                        weight = sign * inside * gauss[1, wanted, g] * length / cuts / steep
                        weight *= by_way_of(found, ONE[0], facet, wall, node, whole)
                        for r in range(6):
                            light[1 + r] += weight * rates[r]


@jit
def add_seen(
    light: Floats,
    facet: Floats,
    own: int,
    wall: Floats,
    pieces: Pieces,
    count: int,
    nodes: Floats,
    from_nodes: Cones,
    first: int,
    last: int,
    occluders: Occluders,
    from_wall: Cones,
    at: Floats,
    rules: Rules,
    work: Work,
    found: Floats,
) -> Floats:
    """Add what a wall point receives by way of pieces of a facet that it sees, if occluders let the patch's light in.

    Returns
    -------
    ndarray
        ``found``, perhaps grown.
    """
    some, left, spare, lines, stack = work
    polygons, corners = pieces
    others, other_corners = some
    spaces, counts = from_nodes
    moving = light.shape[0] > 1
    nothing = np.zeros(3)
    for p in range(count):
        blocked = False
        for q in range(nodes.shape[1]):
            for part in range(first, last):
                k = counts[q, part]
                if blocked or part == own or k == 0:
                    continue
                on_plane(facet, spaces[q, part], k, lines)
                blocked = within(polygons[p], corners[p], lines, k, spare[0], spare[1]) > 0
        for q in range(nodes.shape[1] if blocked else 1):
            others[0, : corners[p]] = polygons[p, : corners[p]]
            other_corners[0] = corners[p]
            made, node = 1, nothing
            if blocked:
                node = nodes[:, q].copy()
                made = cleared(facet, own, some, ONE[0], (spaces[q], counts[q]), first, last, left, work)
            if made < 0:
                light[:] = np.nan
            for i in range(made):
                n = other_corners[i]
                found = _add_light(light, 1.0, others[i], n, facet, wall, node, rules, stack, found)
                if moving:
                    _add_rates(
                        light,
                        1.0,
                        others[i],
                        n,
                        facet,
                        wall,
                        node,
                        wall,
                        from_wall,
                        occluders,
                        at,
                        rules,
                        lines,
                        found,
                    )
    return found


@jit
def add_kept(
    light: Floats,
    whole: bool,
    polygon: Floats,
    n: int,
    facet: Floats,
    own: int,
    wall: Floats,
    node: Floats,
    from_node: Cones,
    from_wall: Cones,
    occluders: Occluders,
    target: int,
    last: int,
    disjoint: bool,
    at: Floats,
    held: Pieces,
    pieces: Pieces,
    rules: Rules,
    work: Work,
    found: Floats,
) -> Floats:
    """Add the light that a node's shadow keeps from a wall point, or (not ``whole``) take away what is hidden anyway.

    Returns
    -------
    ndarray
        ``found``, perhaps grown.
    """
    _, left, _, lines, stack = work
    moving = light.shape[0] > 1
    view = np.array([node[0], node[1], 0.0])
    held[0][0, :n] = polygon[:n]
    held[1][0] = n
    count = cleared(facet, own, held, ONE[0], from_wall, target, last, left, work) if whole else ONE[0]
    made = NONE[0]
    for p in range(count):
        made = covered(facet, held[0][p], held[1][p], from_wall, target, disjoint, pieces, made, work)
    if count < 0 or made < 0:
        light[:] = np.nan
        return found
    for p in range(count if whole else 0):
        some, n = held[0][p], held[1][p]
        found = _add_light(light, 1.0, some, n, facet, wall, node, rules, stack, found)
        if moving:
            _add_rates(light, 1.0, some, n, facet, wall, node, view, from_node, occluders, at, rules, lines, found)
    for p in range(made):
        some, n = pieces[0][p], pieces[1][p]
        found = _add_light(light, -1.0, some, n, facet, wall, node, rules, stack, found)
        if moving:
            _add_rates(light, -1.0, some, n, facet, wall, node, view, from_node, occluders, at, rules, lines, found)
            _add_rates(light, -1.0, some, n, facet, wall, node, wall, from_wall, occluders, at, rules, lines, found)
    return found
