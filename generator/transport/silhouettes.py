"""Light that comes and goes past a few convex surfaces, with their shadows cut exactly.

Seen from a point, a convex surface hides an intersection of half-spaces, and on a plane behind it a convex polygon.
So what is left of a facet after all shadows on both legs - towards the wall point, and towards a point of the lit
patch - is a handful of polygons, and light is smooth on each. No ray is tested; the result is as smooth in pose and
wall point as the scene allows, and its derivatives are integrals along the polygons' moving edges.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.transport import elements, integral, kernel
from generator.transport.compiled import NONE, ONE, jit, jit_released
from generator.transport.polygons import CORNERS, FACET, PIECES, by_way_of, lay, outline, spread, within, without
from generator.transport.rays import Surfaces

Floats = NDArray[Any]

_TOUCH = 1e-9
_ON_LINE = 1e-9
_STACK = 128

Cones = tuple[Floats, Floats]
"""What each occluder hides from a point: half-spaces (occluders, k, 4), n . y + c >= 0, and how many of them
(occluders,), 0 if it hides nothing. The target's flat cells come first, then its spheres, then the room."""

Occluders = tuple[Floats, int, Floats, Floats]
"""Facets (n, FACET), how many of them are the target's, spheres (s, 4), and the sides of a sphere's outline."""

Rules = tuple[Floats, Floats, Floats, float]
"""Quadrature: the patch's rules, the patch, Gauss points, digits."""

Pieces = tuple[Floats, Floats]
"""Polygons (PIECES, CORNERS, 2) along a facet's axes, and how many corners each has (PIECES,)."""

Work = tuple[Pieces, Pieces, Floats, Floats, Floats]
"""Room to work in: pieces twice, spare polygons, lines, a stack of triangles."""


def facets(surfaces: Surfaces) -> Floats:
    """Return the flat surfaces as rows (n, FACET)."""
    made = np.zeros((len(surfaces.origin), FACET))
    for k, row in enumerate(made):
        lay(surfaces.origin[k], surfaces.first[k], surfaces.second[k], bool(surfaces.triangle[k]), row)
    return made


def ring(corners: int) -> Floats:
    """Return the sides of a regular polygon that has the unit circle's area.

    Returns
    -------
    ndarray of shape (corners + 1, 2)
        Their directions; and, as the last row's first number, their distance from the middle.
    """
    turn = 2.0 * np.pi * np.arange(corners) / corners
    step = np.pi / corners
    return np.vstack([np.column_stack([np.cos(turn), np.sin(turn)]), [math.sqrt(step / math.tan(step)), 0.0]])


# --- what is hidden from a point ------------------------------------------------------------------------------------


@jit
def _behind_facet(facet: Floats, view: Floats, spaces: Floats) -> int:
    """Write the half-spaces of what a facet hides from a point; return how many, or 0."""
    level = facet[9] * view[0] + facet[10] * view[1] + facet[11] * view[2] - facet[12]
    # Of a solid, the far side hides nothing that the near side does not.
    if abs(level) < _TOUCH or (facet[34] == 1.0 and level < 0.0):
        return 0
    side = 1.0 if level > 0.0 else -1.0
    n = int(facet[13])
    for k in range(n):
        i, j = 14 + 3 * k, 14 + 3 * ((k + 1) % n)
        a0, a1, a2 = facet[i] - view[0], facet[i + 1] - view[1], facet[i + 2] - view[2]
        b0, b1, b2 = facet[j] - view[0], facet[j + 1] - view[1], facet[j + 2] - view[2]
        row = spaces[k]
        row[0], row[1], row[2] = side * (a2 * b1 - a1 * b2), side * (a0 * b2 - a2 * b0), side * (a1 * b0 - a0 * b1)
        row[3] = -(row[0] * view[0] + row[1] * view[1] + row[2] * view[2])
    row = spaces[n]
    row[0], row[1], row[2], row[3] = -side * facet[9], -side * facet[10], -side * facet[11], side * facet[12] - _TOUCH
    return n + 1


@jit
def _behind_ball(ball: Floats, view: Floats, sides: Floats, spaces: Floats) -> int:
    """As `_behind_facet`, for a sphere (centre, radius), whose outline becomes a polygon of the same area."""
    axis, across, third = np.empty(3), np.empty(3), np.empty(3)
    far = 0.0
    for r in range(3):
        axis[r] = ball[r] - view[r]
        far += axis[r] ** 2
    far = math.sqrt(far)
    for r in range(3):
        axis[r] /= far
    sine = min(ball[3] / far, 1.0 - 1e-9)
    elements.beside(axis, across)
    for r in range(3):
        s, t = (r + 1) % 3, (r + 2) % 3
        third[r] = axis[s] * across[t] - axis[t] * across[s]
    n = sides.shape[0] - 1
    opening = sine / math.sqrt(1.0 - sine * sine) * sides[n, 0]
    for k in range(n):
        row = spaces[k]
        row[3] = 0.0
        for r in range(3):
            row[r] = opening * axis[r] - (sides[k, 0] * across[r] + sides[k, 1] * third[r])
            row[3] -= row[r] * view[r]
    row = spaces[n]
    row[3] = -far * (1.0 - sine * sine)
    for r in range(3):
        row[r] = axis[r]
        row[3] -= axis[r] * view[r]
    return n + 1


@jit
def _all_hidden(view: Floats, occluders: Occluders, cones: Cones) -> None:
    """Write what each occluder hides from a point."""
    every, first, balls, sides = occluders
    spaces, counts = cones
    for k in range(every.shape[0]):
        at = k if k < first else k + balls.shape[0]
        counts[at] = _behind_facet(every[k], view, spaces[at])
    for k in range(balls.shape[0]):
        counts[first + k] = _behind_ball(balls[k], view, sides, spaces[first + k])


@jit
def _no_cones(occluders: Occluders) -> Cones:
    """Return room for what is hidden from a point."""
    every, _, balls, sides = occluders
    depth = max(6, sides.shape[0] + 1 if balls.shape[0] else 0)
    number = every.shape[0] + balls.shape[0]
    return np.empty((number, depth, 4)), np.zeros(number, dtype=np.int64)


@jit
def _from_nodes(nodes: Floats, occluders: Occluders) -> tuple[Floats, Floats]:
    """Return cones from each point of the patch: (nodes, occluders, k, 4) and (nodes, occluders)."""
    spaces, counts = _no_cones(occluders)
    every = np.empty((nodes.shape[1], *spaces.shape))
    numbers = np.empty((nodes.shape[1], counts.shape[0]), dtype=np.int64)
    view = np.zeros(3)
    for q in range(nodes.shape[1]):
        view[0], view[1] = nodes[0, q], nodes[1, q]
        _all_hidden(view, occluders, (every[q], numbers[q]))
    return every, numbers


# --- on a facet -----------------------------------------------------------------------------------------------------


@jit
def _on(facet: Floats, spaces: Floats, k: int, lines: Floats) -> None:
    """Write the lines (k, 3) in which half-spaces' borders cut a facet's plane."""
    for i in range(k):
        for r in range(2):
            lines[i, r] = 0.0
            for c in range(3):
                lines[i, r] += spaces[i, c] * facet[3 + 3 * r + c]
        lines[i, 2] = spaces[i, 3]
        for c in range(3):
            lines[i, 2] += spaces[i, c] * facet[c]


@jit
def _above(facet: Floats, polygon: Floats, lines: Floats, spare: Floats) -> int:
    """Write the corners of the part of a facet that is above the relay wall; return how many."""
    n = outline(facet, polygon)
    lines[0, 0], lines[0, 1], lines[0, 2] = facet[5], facet[8], facet[2]
    return within(polygon, n, lines, ONE[0], polygon, spare)


@jit
def _cleared(
    facet: Floats, own: int, pieces: Pieces, count: int, cones: Cones, first: int, last: int, left: Pieces, work: Work
) -> int:
    """Take the shadows of occluders ``first`` to ``last`` but the facet's own from pieces on it.

    Parameters
    ----------
    left : Pieces, room to work in

    Returns
    -------
    int
        How many pieces there are then; below 0, there were too many.
    """
    spaces, counts = cones
    polygons, corners = pieces
    others, other_corners = left
    _, _, spare, lines, _ = work
    for part in range(first, last):
        if part == own or counts[part] == 0 or count <= 0:
            continue
        k = counts[part]
        _on(facet, spaces[part], k, lines)
        touched = False
        for p in range(count):
            if within(polygons[p], corners[p], lines, k, spare[0], spare[1]):
                touched = True
                break
        if not touched:
            continue
        made = NONE[0]
        for p in range(count):
            made = without(polygons[p], corners[p], lines, k, others, other_corners, made, spare)
        if made < 0:
            return -1
        for p in range(made):
            polygons[p, : other_corners[p]] = others[p, : other_corners[p]]
            corners[p] = other_corners[p]
        count = made
    return count


@jit
def _covered(
    facet: Floats,
    polygon: Floats,
    n: int,
    cones: Cones,
    parts: int,
    disjoint: bool,
    pieces: Pieces,
    count: int,
    work: Work,
) -> int:
    """Append what the first ``parts`` occluders together hide of a polygon on a facet, in pieces that do not overlap.

    Returns
    -------
    int
        How many pieces there are then; below 0, there were too many.
    """
    some, left, spare, lines, _ = work
    spaces, counts = cones
    polygons, corners = pieces
    others, other_corners = some
    for part in range(parts):
        k = counts[part]
        if k == 0 or count < 0:
            continue
        _on(facet, spaces[part], k, lines)
        other_corners[0] = within(polygon, n, lines, k, others[0], spare[0])
        if other_corners[0] == 0:
            continue
        made = (
            1 if disjoint or part == 0 else _cleared(facet, -ONE[0], some, ONE[0], cones, NONE[0], part, left, work)
        )
        if made < 0 or count + made > PIECES:
            return -1
        for p in range(made):
            polygons[count, : other_corners[p]] = others[p, : other_corners[p]]
            corners[count] = other_corners[p]
            count += 1
    return count


@jit
def _may_meet(facet: Floats, polygon: Floats, n: int, ends: Cones, part: int, lines: Floats, outside: Floats) -> bool:
    """Whether a flat part's shadow, seen from anywhere between some points, may reach a polygon on a facet.

    The side of an edge's plane on which y lies, as seen from w, is a determinant that is affine in w and in y: with
    one sign for all corners of both, it has that sign everywhere between them.
    """
    spaces, counts = ends
    k = counts[0, part]
    outside[:] = True
    for e in range(spaces.shape[0]):
        if counts[e, part] != k or k == 0:
            return True
        _on(facet, spaces[e, part], k, lines)
        for i in range(k):
            for j in range(n):
                if lines[i, 0] * polygon[j, 0] + lines[i, 1] * polygon[j, 1] + lines[i, 2] > 0.0:
                    outside[i] = False
    return not outside[:k].any()


# --- light ----------------------------------------------------------------------------------------------------------


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
        _on(facet, spaces[part], counts[part], lines)
        for i in range(counts[part]):
            a, b, c = lines[i, 0], lines[i, 1], lines[i, 2]
            steep = math.hypot(a, b)
            if steep == 0.0 or (part >= first and i == counts[part] - 1):
                continue
            inside = 1.0 if a * middle0 + b * middle1 + c > 0.0 else -1.0
            for j in range(n):
                u0, v0 = polygon[j, 0], polygon[j, 1]
                u1, v1 = polygon[(j + 1) % n, 0], polygon[(j + 1) % n, 1]
                if abs(a * u0 + b * v0 + c) > _ON_LINE * steep or abs(a * u1 + b * v1 + c) > _ON_LINE * steep:
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
def _add_seen(
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
                _on(facet, spaces[q, part], k, lines)
                blocked = within(polygons[p], corners[p], lines, k, spare[0], spare[1]) > 0
        for q in range(nodes.shape[1] if blocked else 1):
            others[0, : corners[p]] = polygons[p, : corners[p]]
            other_corners[0] = corners[p]
            made, node = 1, nothing
            if blocked:
                node = nodes[:, q].copy()
                made = _cleared(facet, own, some, ONE[0], (spaces[q], counts[q]), first, last, left, work)
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
def _add_kept(
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
    count = _cleared(facet, own, held, ONE[0], from_wall, target, last, left, work) if whole else ONE[0]
    made = NONE[0]
    for p in range(count):
        made = _covered(facet, held[0][p], held[1][p], from_wall, target, disjoint, pieces, made, work)
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


# --- panels ---------------------------------------------------------------------------------------------------------


@jit
def _placed(flat: Floats, balls: Floats, turn: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Return a target's cells as facets, and its spheres (centre, radius), at a pose."""
    parts, spheres = np.zeros((flat.shape[0], FACET)), np.empty((balls.shape[0], 4))
    cell = np.empty(elements.WIDTH)
    for k in range(flat.shape[0]):
        elements.place(flat[k], turn, at, cell)
        lay(cell[2:5], cell[5:8], cell[8:11], cell[0] == 1.0, parts[k])
        parts[k, 34] = cell[1]
    for k in range(balls.shape[0]):
        elements.place(balls[k], turn, at, cell)
        spheres[k, :3], spheres[k, 3] = cell[2:5], cell[15]
    return parts, spheres


@jit
def _no_pieces() -> Pieces:
    return np.empty((PIECES, CORNERS, 2)), np.empty(PIECES, dtype=np.int64)


@jit
def _room_to_work(cones: Cones) -> Work:
    depth = cones[0].shape[1]
    return _no_pieces(), _no_pieces(), np.empty((3, CORNERS, 2)), np.empty((depth, 3)), np.empty((_STACK, 6))


@jit
def _around(walls: Floats) -> tuple[Floats, float]:
    """Return middle and radius of a circle around a panel's points, whose last four are its corners."""
    ends = walls[walls.shape[0] - 4 :]
    centre = np.zeros(2)
    for e in range(4):
        centre[0] += ends[e, 0] / 4.0
        centre[1] += ends[e, 1] / 4.0
    radius = 0.0
    for e in range(4):
        radius = max(radius, math.hypot(ends[e, 0] - centre[0], ends[e, 1] - centre[1]))
    return centre, radius


@jit_released
def hidden_panels(
    start: int,
    stop: int,
    owner: Floats,
    walls: Floats,
    flat: Floats,
    balls: Floats,
    turns: Floats,
    places: Floats,
    disjoint: bool,
    sides: Floats,
    room: Floats,
    tint: Floats,
    hiders: Floats,
    orders: Floats,
    whole: Floats,
    patch: Floats,
    gauss: Floats,
    digits: float,
    values: Floats,
) -> None:
    """Evaluate `shaded.hidden` on panels, and its derivatives.

    The target hides y from w, or from a point q of the patch, where y is in the one or the other's shadow. So the sum
    is over what w's shadow covers, with all of the light that y would have; and over what q's shadow covers, but for
    what w's covers too.

    Parameters
    ----------
    start, stop : int
        Which panels.
    owner : ndarray of shape (n,), int
        Which pose each panel belongs to.
    walls : ndarray of shape (n, k, 3)
        Each panel's points; the last four are its corners.
    flat, balls, turns, places, whole, patch, gauss, digits
        As for `integral.panels`.
    disjoint : bool
        Whether shadows of the target's flat cells do not overlap, but for those of a solid's far side.
    sides : ndarray
        As `ring` gives them.
    room : ndarray of shape (m, FACET)
    tint : ndarray of shape (m, groups)
    hiders : ndarray of shape (poses,), int
        How many of the room's facets, from the first, can stand in the way.
    orders : ndarray of shape (poses,), int
        Which of the rules ``whole`` stands for the lit patch where its points throw shadows one by one.
    values : ndarray of shape (n, groups, 1 or 7, k), written
        Not a number where shadows fall into too many pieces. With seven channels, the derivatives for the target's
        position (3) and its rotation about the three axes (3) follow.
    """
    rules = (whole, patch, gauss, digits)
    for item in range(start, stop):
        pose = owner[item]
        parts, spheres = _placed(flat, balls, turns[pose], places[pose])
        occluders = (np.concatenate((parts, room[: hiders[pose]])), parts.shape[0], spheres, sides)
        nodes = np.ascontiguousarray(whole[orders[pose], :, : orders[pose] ** 2])
        values[item] = 0.0
        _hidden_panel(walls[item], occluders, disjoint, room, tint, nodes, places[pose], rules, values[item])


@jit
def _hidden_panel(
    walls: Floats,
    occluders: Occluders,
    disjoint: bool,
    room: Floats,
    tint: Floats,
    nodes: Floats,
    at: Floats,
    rules: Rules,
    total: Floats,
) -> None:
    every, flat, balls, _ = occluders
    target, last = flat + balls.shape[0], every.shape[0] + balls.shape[0]
    from_wall = _no_cones(occluders)
    from_nodes = _from_nodes(nodes, occluders)
    work, pieces, held = _room_to_work(from_wall), _no_pieces(), _no_pieces()
    _, left, spare, lines, _ = work
    polygon, found = np.empty((CORNERS, 2)), np.empty((256, 5))
    light = np.zeros(total.shape[1])

    # What the nodes' shadows cover, node by node.
    most = PIECES + nodes.shape[1] * room.shape[0]
    kept, kept_corners, kept_of = (
        np.empty((most, CORNERS, 2)),
        np.empty(most, np.int64),
        np.empty((most, 2), np.int64),
    )
    number = NONE[0]
    for s in range(room.shape[0]):
        n = _above(room[s], polygon, lines, spare[0])
        for q in range(nodes.shape[1] if n else 0):
            cones = (from_nodes[0][q], from_nodes[1][q])
            count = _covered(room[s], polygon, n, cones, target, disjoint, pieces, NONE[0], work)
            count = _cleared(room[s], target + s, pieces, count, cones, target, last, left, work)
            if count < 0:
                total[:] = np.nan
                return
            if number + count > len(kept):
                room_for = 2 * (number + count)
                more, more_corners, more_of = (
                    np.empty((room_for, CORNERS, 2)),
                    np.empty(room_for, np.int64),
                    np.empty((room_for, 2), np.int64),
                )
                more[:number], more_corners[:number], more_of[:number] = (
                    kept[:number],
                    kept_corners[:number],
                    kept_of[:number],
                )
                kept, kept_corners, kept_of = more, more_corners, more_of
            for p in range(count):
                n_p = pieces[1][p]
                kept[number, :n_p] = pieces[0][p, :n_p]
                kept_corners[number], kept_of[number, 0], kept_of[number, 1] = n_p, s, q
                number += 1

    together, apart = _sorted(walls, kept, kept_corners, kept_of, number, occluders, target, room, work)
    if total.shape[1] > 1:
        together[:] = False
        apart[:] = True
    _add_together(walls, kept, kept_corners, kept_of, number, together, room, tint, nodes, rules, work, total)
    for w in range(walls.shape[0]):
        wall = walls[w]
        _all_hidden(wall, occluders, from_wall)
        for s in range(room.shape[0]):
            n = _above(room[s], polygon, lines, spare[0])
            count = _covered(room[s], polygon, n, from_wall, target, disjoint, pieces, NONE[0], work)
            count = _cleared(room[s], target + s, pieces, count, from_wall, target, last, left, work)
            light[:] = 0.0 if count >= 0 else np.nan
            found = _add_seen(
                light,
                room[s],
                target + s,
                wall,
                pieces,
                count,
                nodes,
                from_nodes,
                target,
                last,
                occluders,
                from_wall,
                at,
                rules,
                work,
                found,
            )
            for g in range(tint.shape[1]):
                total[g, :, w] += light * tint[s, g]
        for p in range(number):
            if together[p] and not apart[p]:
                continue
            s, q = kept_of[p, 0], kept_of[p, 1]
            light[:] = 0.0
            found = _add_kept(
                light,
                not together[p],
                kept[p],
                kept_corners[p],
                room[s],
                target + s,
                wall,
                nodes[:, q].copy(),
                (from_nodes[0][q], from_nodes[1][q]),
                from_wall,
                occluders,
                target,
                last,
                disjoint,
                at,
                held,
                pieces,
                rules,
                work,
                found,
            )
            for g in range(tint.shape[1]):
                total[g, :, w] += light * tint[s, g]


@jit
def _sorted(
    walls: Floats,
    kept: Floats,
    corners: Floats,
    of: Floats,
    number: int,
    occluders: Occluders,
    target: int,
    room: Floats,
    work: Work,
) -> tuple[Floats, Floats]:
    """Say of which nodes' shadows all of a panel sees everything, and which w's own shadow may overlap somewhere."""
    every, flat, balls, _ = occluders
    last = every.shape[0] + balls.shape[0]
    ends = np.empty((4, *_no_cones(occluders)[0].shape))
    end_counts = np.empty((4, last), dtype=np.int64)
    for e in range(4):
        _all_hidden(walls[walls.shape[0] - 4 + e], occluders, (ends[e], end_counts[e]))
    outside = np.empty(ends.shape[2], dtype=np.bool_)
    lines = work[3]
    together = np.ones(number, dtype=np.bool_)
    apart = np.full(number, balls.shape[0] > 0)  # a sphere's outline differs from point to point
    for p in range(number):
        facet = room[of[p, 0]]
        for part in range(last):
            if part == target + of[p, 0] or flat <= part < target or (apart[p] if part < flat else not together[p]):
                continue
            if _may_meet(facet, kept[p], corners[p], (ends, end_counts), part, lines, outside):
                if part < flat:
                    apart[p] = True
                else:
                    together[p] = False
    return together, apart


@jit
def _add_together(
    walls: Floats,
    kept: Floats,
    corners: Floats,
    of: Floats,
    number: int,
    together: Floats,
    room: Floats,
    tint: Floats,
    nodes: Floats,
    rules: Rules,
    work: Work,
    total: Floats,
) -> None:
    """Add the light of nodes' shadows that nothing keeps from any point of a panel: one sum for all of its points."""
    _, patch, gauss, digits = rules
    centre, radius = _around(walls)
    found, filled = np.empty((256, 5)), 0
    sent = np.empty((tint.shape[1], 6, 256))
    for p in range(number):
        if not together[p]:
            continue
        s, q = of[p, 0], of[p, 1]
        facet = room[s]
        found, n = spread(kept[p], corners[p], facet, centre, radius, patch, gauss, digits, work[4], found, NONE[0])
        level = facet[9] * nodes[0, q] + facet[10] * nodes[1, q] - facet[12]
        if filled + n > sent.shape[2]:
            grown = np.empty((sent.shape[0], 6, 2 * (filled + n)))
            grown[:, :, :filled] = sent[:, :, :filled]
            sent = grown
        for k in range(n):
            u, v = found[k, 0] - nodes[0, q], found[k, 1] - nodes[1, q]
            near = u * u + v * v + found[k, 2] ** 2
            # The sign of ``level`` turns the normal to the side that is lit.
            strength = found[k, 3] * nodes[2, q] * level * found[k, 2] / (near * near)
            for g in range(tint.shape[1]):
                for r in range(3):
                    sent[g, r, filled] = found[k, r]
                    sent[g, 3 + r, filled] = facet[9 + r] * strength * tint[s, g]
            filled += 1
    a, b = np.ascontiguousarray(walls[:, 0]), np.ascontiguousarray(walls[:, 1])
    for g in range(tint.shape[1]):
        kernel.radiance(a, b, sent[g], filled, 0.0, total[g, 0])


@jit_released
def received_panels(
    start: int,
    stop: int,
    owner: Floats,
    walls: Floats,
    flat: Floats,
    turns: Floats,
    places: Floats,
    room: Floats,
    tint: Floats,
    hiders: Floats,
    orders: Floats,
    whole: Floats,
    patch: Floats,
    gauss: Floats,
    digits: float,
    values: Floats,
) -> None:
    """Evaluate `shaded.reflected` on panels, for flat cells that may hide each other and be hidden by the room.

    Parameters are those of `hidden_panels`; ``tint`` is the cells'.
    """
    rules = (whole, patch, gauss, digits)
    for item in range(start, stop):
        pose = owner[item]
        parts, none = _placed(flat, np.empty((0, elements.WIDTH)), turns[pose], places[pose])
        every = np.concatenate((parts, room[: hiders[pose]]))
        nodes = np.ascontiguousarray(whole[orders[pose], :, : orders[pose] ** 2])
        values[item] = 0.0
        occluders = (every, every.shape[0], none, np.empty((1, 2)))
        _received_panel(walls[item], parts, occluders, tint, nodes, rules, values[item])


@jit
def _received_panel(
    walls: Floats, parts: Floats, occluders: Occluders, tint: Floats, nodes: Floats, rules: Rules, total: Floats
) -> None:
    last = occluders[1]
    from_wall, from_nodes = _no_cones(occluders), _from_nodes(nodes, occluders)
    work, pieces = _room_to_work(from_wall), _no_pieces()
    _, left, spare, lines, _ = work
    found, light, at = np.empty((256, 5)), np.zeros(1), np.zeros(3)
    for w in range(walls.shape[0]):
        wall = walls[w]
        _all_hidden(wall, occluders, from_wall)
        for s in range(parts.shape[0]):
            facet = parts[s]
            if facet[34] == 1.0 and facet[9] * wall[0] + facet[10] * wall[1] < facet[12]:
                continue
            pieces[1][0] = _above(facet, pieces[0][0], lines, spare[0])
            count = ONE[0] if pieces[1][0] else NONE[0]
            count = _cleared(facet, s, pieces, count, from_wall, NONE[0], last, left, work)
            light[:] = 0.0 if count >= 0 else np.nan
            found = _add_seen(
                light,
                facet,
                s,
                wall,
                pieces,
                count,
                nodes,
                from_nodes,
                NONE[0],
                last,
                occluders,
                from_wall,
                at,
                rules,
                work,
                found,
            )
            for g in range(tint.shape[1]):
                total[g, 0, w] += light[0] * tint[s, g]
