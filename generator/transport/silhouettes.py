"""Light that comes and goes past a few convex surfaces, with their shadows cut exactly.

Seen from a point, a convex surface hides an intersection of half-spaces, and on a plane behind it a convex polygon.
So what is left of a facet after all shadows on both legs - towards the wall point, and towards a point of the lit
patch - is a handful of polygons, and light is smooth on each. No ray is tested; the result is as smooth in pose and
wall point as the scene allows.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.transport import elements, kernel
from generator.transport.compiled import jit, jit_parallel, prange
from generator.transport.polygons import (
    CORNERS,
    FACET,
    PIECES,
    by_way_of,
    lay,
    outline,
    spread,
    within,
    without,
)
from generator.transport.rays import Surfaces

Floats = NDArray[Any]

_TOUCH = 1e-9
_STACK = 128

Work = tuple[Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats]
"""Room to work in: pieces and how many corners each has, three times; spare polygons, lines, a stack of triangles."""


def facets(surfaces: Surfaces) -> Floats:
    """Return the flat surfaces as rows (n, FACET)."""
    made = np.zeros((len(surfaces.origin), FACET))
    for k, row in enumerate(made):
        lay(surfaces.origin[k], surfaces.first[k], surfaces.second[k], bool(surfaces.triangle[k]), row)
    return made


def ring(corners: int) -> Floats:
    """Return the sides of a regular polygon of the unit circle's area: directions (n, 2), and the last row's first
    number its apothem."""
    turn = 2.0 * np.pi * np.arange(corners) / corners
    step = np.pi / corners
    apothem = math.sqrt(step / math.tan(step))
    return np.vstack([np.column_stack([np.cos(turn), np.sin(turn)]), [apothem, 0.0]])


@jit
def _behind_facet(facet: Floats, view: Floats, spaces: Floats) -> int:
    """Write the half-spaces (k, 4), n . y + c >= 0, of what a facet hides from a point; return how many, or 0."""
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
        row[0], row[1], row[2] = (
            -side * (a1 * b2 - a2 * b1),
            -side * (a2 * b0 - a0 * b2),
            -side * (a0 * b1 - a1 * b0),
        )
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
def _all_hidden(
    view: Floats, parts: Floats, first: int, balls: Floats, sides: Floats, spaces: Floats, counts: Floats
) -> None:
    """Write what each occluder hides from a point: half-spaces (parts, k, 4) and how many.

    Spheres are counted after the ``first`` flat ones and before the others.
    """
    for k in range(parts.shape[0]):
        at = k if k < first else k + balls.shape[0]
        counts[at] = _behind_facet(parts[k], view, spaces[at])
    for k in range(balls.shape[0]):
        counts[first + k] = _behind_ball(balls[k], view, sides, spaces[first + k])


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
def _cleared(
    facet: Floats,
    own: int,
    pieces: Floats,
    corners: Floats,
    count: int,
    spaces: Floats,
    counts: Floats,
    first: int,
    last: int,
    others: Floats,
    other_corners: Floats,
    spare: Floats,
    lines: Floats,
) -> int:
    """Take the shadows of parts ``first`` to ``last`` but the facet's own from pieces on it; return their number."""
    for part in range(first, last):
        if part == own or counts[part] == 0 or count <= 0:
            continue
        k = counts[part]
        _on(facet, spaces[part], k, lines)
        touched = False
        for p in range(count):
            if within(pieces[p], corners[p], lines, k, spare[0], spare[1]):
                touched = True
                break
        if not touched:
            continue
        made = 0
        for p in range(count):
            made = without(pieces[p], corners[p], lines, k, others, other_corners, made, spare)
            if made < 0:
                return -1
        for p in range(made):
            pieces[p, : other_corners[p]] = others[p, : other_corners[p]]
            corners[p] = other_corners[p]
        count = made
    return count


@jit
def _covered(
    facet: Floats,
    polygon: Floats,
    n: int,
    spaces: Floats,
    counts: Floats,
    parts: int,
    disjoint: bool,
    pieces: Floats,
    corners: Floats,
    count: int,
    others: Floats,
    other_corners: Floats,
    more: Floats,
    more_corners: Floats,
    spare: Floats,
    lines: Floats,
) -> int:
    """Append what the first ``parts`` parts together hide of a polygon on a facet, as pieces that do not overlap."""
    for part in range(parts):
        k = counts[part]
        if k == 0:
            continue
        _on(facet, spaces[part], k, lines)
        m = within(polygon, n, lines, k, others[0], spare[0])
        if m == 0:
            continue
        other_corners[0] = m
        made = 1
        if not disjoint and part > 0:
            made = _cleared(
                facet, -1, others, other_corners, 1, spaces, counts, 0, part, more, more_corners, spare, lines
            )
        if made < 0 or count + made > PIECES:
            return -1
        for p in range(made):
            pieces[count, : other_corners[p]] = others[p, : other_corners[p]]
            corners[count] = other_corners[p]
            count += 1
    return count


@jit
def _may_meet(
    facet: Floats,
    polygon: Floats,
    n: int,
    ends: Floats,
    end_counts: Floats,
    part: int,
    lines: Floats,
    outside: Floats,
) -> bool:
    """Whether a flat part's shadow, seen from anywhere between some points, may reach a polygon on a facet.

    The side of an edge's plane on which y lies, as seen from w, is a determinant that is affine in w and in y: with
    one sign for all corners of both, it has that sign everywhere between them.
    """
    k = end_counts[0, part]
    outside[:] = True
    for e in range(ends.shape[0]):
        if end_counts[e, part] != k or k == 0:
            return True
        _on(facet, ends[e, part], k, lines)
        for i in range(k):
            for j in range(n):
                if lines[i, 0] * polygon[j, 0] + lines[i, 1] * polygon[j, 1] + lines[i, 2] > 0.0:
                    outside[i] = False
    return not outside[:k].any()


@jit
def _above(facet: Floats, polygon: Floats, lines: Floats, spare: Floats) -> int:
    """Write the corners of the part of a facet that is above the relay wall; return how many."""
    n = outline(facet, polygon)
    lines[0, 0], lines[0, 1], lines[0, 2] = facet[5], facet[8], facet[2]
    return within(polygon, n, lines, 1, polygon, spare)


@jit
def _seen(
    facet: Floats,
    own: int,
    view: Floats,
    pieces: Floats,
    corners: Floats,
    count: int,
    nodes: Floats,
    from_nodes: Floats,
    node_counts: Floats,
    first: int,
    last: int,
    whole: Floats,
    patch: Floats,
    gauss: Floats,
    digits: float,
    work: Work,
    found: Floats,
) -> tuple[float, Floats]:
    """Return what a wall point receives by way of pieces of a facet that it sees, and ``found``, perhaps grown."""
    others, other_corners, more, more_corners, _, _, spare, lines, stack = work
    total = 0.0
    nothing = np.zeros(3)
    for p in range(count):
        blocked = False
        for q in range(nodes.shape[1]):
            for part in range(first, last):
                k = node_counts[q, part]
                if part == own or k == 0:
                    continue
                _on(facet, from_nodes[q, part], k, lines)
                if within(pieces[p], corners[p], lines, k, spare[0], spare[1]):
                    blocked = True
                    break
            if blocked:
                break
        if not blocked:
            found, n = spread(pieces[p], corners[p], facet, view, 0.0, patch, gauss, digits, stack, found, 0)
            total += by_way_of(found, n, facet, view, nothing, whole)
            continue
        for q in range(nodes.shape[1]):
            others[0, : corners[p]] = pieces[p, : corners[p]]
            other_corners[0] = corners[p]
            made = _cleared(
                facet,
                own,
                others,
                other_corners,
                1,
                from_nodes[q],
                node_counts[q],
                first,
                last,
                more,
                more_corners,
                spare,
                lines,
            )
            if made < 0:
                return np.nan, found
            for i in range(made):
                found, n = spread(
                    others[i], other_corners[i], facet, view, 0.0, patch, gauss, digits, stack, found, 0
                )
                total += by_way_of(found, n, facet, view, nodes[:, q], whole)
    return total, found


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
def _room_to_work(depth: int) -> Work:
    return (
        np.empty((PIECES, CORNERS, 2)),
        np.empty(PIECES, dtype=np.int64),
        np.empty((PIECES, CORNERS, 2)),
        np.empty(PIECES, dtype=np.int64),
        np.empty((PIECES, CORNERS, 2)),
        np.empty(PIECES, dtype=np.int64),
        np.empty((3, CORNERS, 2)),
        np.empty((depth, 3)),
        np.empty((_STACK, 6)),
    )


@jit_parallel
def hidden_panels(
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
    """Evaluate `shaded.hidden` on panels.

    The target hides y from w, or from a point q of the patch, where y is in the one or the other's shadow. So the sum
    is over what w's shadow covers, with all of the light that y would have; and over what q's shadow covers, but for
    what w's covers too.

    Parameters
    ----------
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
    values : ndarray of shape (n, groups, k), written
        Not a number where shadows fall into too many pieces.
    """
    for item in prange(owner.shape[0]):
        pose = owner[item]
        parts, spheres = _placed(flat, balls, turns[pose], places[pose])
        order, blockers = orders[pose], hiders[pose]
        nodes = np.ascontiguousarray(whole[order, :, : order * order])
        values[item] = _hidden_panel(
            walls[item], parts, spheres, disjoint, sides, room, tint, blockers, nodes, whole, patch, gauss, digits
        )


@jit
def _hidden_panel(
    walls: Floats,
    parts: Floats,
    spheres: Floats,
    disjoint: bool,
    sides: Floats,
    room: Floats,
    tint: Floats,
    blockers: int,
    nodes: Floats,
    whole: Floats,
    patch: Floats,
    gauss: Floats,
    digits: float,
) -> Floats:
    target = parts.shape[0] + spheres.shape[0]
    last = target + blockers
    depth = max(6, sides.shape[0] + 1 if spheres.shape[0] else 0)
    every = np.concatenate((parts, room[:blockers]))
    total = np.zeros((tint.shape[1], walls.shape[0]))
    work = _room_to_work(depth)
    others, other_corners, more, more_corners, _, _, spare, lines, stack = work
    pieces, corners = np.empty((PIECES, CORNERS, 2)), np.empty(PIECES, dtype=np.int64)
    polygon, found = np.empty((CORNERS, 2)), np.empty((256, 5))
    numbers = nodes.shape[1]

    # What each node of the patch, and each corner of the panel, sees hidden.
    from_nodes, node_counts = np.empty((numbers, last, depth, 4)), np.empty((numbers, last), dtype=np.int64)
    view = np.zeros(3)
    for q in range(numbers):
        view[0], view[1] = nodes[0, q], nodes[1, q]
        _all_hidden(view, every, parts.shape[0], spheres, sides, from_nodes[q], node_counts[q])
    from_ends, end_counts = np.empty((4, last, depth, 4)), np.empty((4, last), dtype=np.int64)
    for e in range(4):
        _all_hidden(walls[walls.shape[0] - 4 + e], every, parts.shape[0], spheres, sides, from_ends[e], end_counts[e])

    # What the nodes' shadows cover, node by node.
    most = PIECES + 2 * numbers * room.shape[0]
    kept, kept_corners = np.empty((most, CORNERS, 2)), np.empty(most, dtype=np.int64)
    kept_of = np.empty((most, 2), dtype=np.int64)
    number = 0
    for s in range(room.shape[0]):
        n = _above(room[s], polygon, lines, spare[0])
        for q in range(numbers if n else 0):
            count = _covered(
                room[s],
                polygon,
                n,
                from_nodes[q],
                node_counts[q],
                target,
                disjoint,
                pieces,
                corners,
                0,
                others,
                other_corners,
                more,
                more_corners,
                spare,
                lines,
            )
            count = _cleared(
                room[s],
                target + s,
                pieces,
                corners,
                count,
                from_nodes[q],
                node_counts[q],
                target,
                last,
                others,
                other_corners,
                spare,
                lines,
            )
            if count < 0 or number + count > most:
                total[:] = np.nan
                return total
            for p in range(count):
                kept[number, : corners[p]] = pieces[p, : corners[p]]
                kept_corners[number], kept_of[number, 0], kept_of[number, 1] = corners[p], s, q
                number += 1

    # Light of those that nothing keeps from any point of the panel: one sum for all of its points.
    centre, radius = _around(walls)
    may_block, may_cover = np.zeros(number, dtype=np.bool_), np.zeros(number, dtype=np.bool_)
    outside = np.empty(depth, dtype=np.bool_)
    sent, filled = np.empty((tint.shape[1], 6, 256)), 0
    for p in range(number):
        s, q = kept_of[p, 0], kept_of[p, 1]
        facet, n = room[s], kept_corners[p]
        may_cover[p] = spheres.shape[0] > 0  # whose outline differs from point to point
        for part in range(parts.shape[0]):
            if _may_meet(facet, kept[p], n, from_ends, end_counts, part, lines, outside):
                may_cover[p] = True
                break
        for part in range(target, last):
            if part != target + s and _may_meet(facet, kept[p], n, from_ends, end_counts, part, lines, outside):
                may_block[p] = True
                break
        if may_block[p]:
            continue
        found, n = spread(kept[p], n, facet, centre, radius, patch, gauss, digits, stack, found, 0)
        level = facet[9] * nodes[0, q] + facet[10] * nodes[1, q] - facet[12]
        side = 1.0 if level > 0.0 else -1.0
        if filled + n > sent.shape[2]:
            grown = np.empty((sent.shape[0], 6, 2 * (filled + n)))
            grown[:, :, :filled] = sent[:, :, :filled]
            sent = grown
        for k in range(n):
            u, v = found[k, 0] - nodes[0, q], found[k, 1] - nodes[1, q]
            near = u * u + v * v + found[k, 2] ** 2
            strength = side * found[k, 3] * nodes[2, q] * abs(level) * found[k, 2] / (near * near)
            for g in range(tint.shape[1]):
                for r in range(3):
                    sent[g, r, filled] = found[k, r]
                    sent[g, 3 + r, filled] = facet[9 + r] * strength * tint[s, g]
            filled += 1
    a, b = np.ascontiguousarray(walls[:, 0]), np.ascontiguousarray(walls[:, 1])
    for g in range(tint.shape[1]):
        kernel.radiance(a, b, sent[g], filled, total[g])

    from_wall, wall_counts = np.empty((last, depth, 4)), np.empty(last, dtype=np.int64)
    for w in range(walls.shape[0]):
        wall = walls[w]
        _all_hidden(wall, every, parts.shape[0], spheres, sides, from_wall, wall_counts)
        for s in range(room.shape[0]):
            n = _above(room[s], polygon, lines, spare[0])
            count = _covered(
                room[s],
                polygon,
                n,
                from_wall,
                wall_counts,
                target,
                disjoint,
                pieces,
                corners,
                0,
                others,
                other_corners,
                more,
                more_corners,
                spare,
                lines,
            )
            count = _cleared(
                room[s],
                target + s,
                pieces,
                corners,
                count,
                from_wall,
                wall_counts,
                target,
                last,
                others,
                other_corners,
                spare,
                lines,
            )
            if count == 0:
                continue
            light = np.nan
            if count > 0:
                light, found = _seen(
                    room[s],
                    target + s,
                    wall,
                    pieces,
                    corners,
                    count,
                    nodes,
                    from_nodes,
                    node_counts,
                    target,
                    last,
                    whole,
                    patch,
                    gauss,
                    digits,
                    work,
                    found,
                )
            for g in range(tint.shape[1]):
                total[g, w] += light * tint[s, g]
        for p in range(number):
            if not may_block[p] and not may_cover[p]:
                continue
            s, q = kept_of[p, 0], kept_of[p, 1]
            light, found = _kept_light(
                kept[p],
                kept_corners[p],
                room[s],
                target + s,
                wall,
                nodes[:, q],
                from_wall,
                wall_counts,
                target,
                last,
                may_block[p],
                disjoint,
                pieces,
                corners,
                work,
                whole,
                patch,
                gauss,
                digits,
                found,
            )
            for g in range(tint.shape[1]):
                total[g, w] += light * tint[s, g]
    return total


@jit
def _kept_light(
    polygon: Floats,
    n: int,
    facet: Floats,
    own: int,
    wall: Floats,
    node: Floats,
    from_wall: Floats,
    wall_counts: Floats,
    target: int,
    last: int,
    may_block: bool,
    disjoint: bool,
    pieces: Floats,
    corners: Floats,
    work: Work,
    whole: Floats,
    patch: Floats,
    gauss: Floats,
    digits: float,
    found: Floats,
) -> tuple[float, Floats]:
    """Return what is still to be added of the light that a node's shadow keeps from a wall point."""
    others, other_corners, more, more_corners, held, held_corners, spare, lines, stack = work
    held[0, :n] = polygon[:n]
    held_corners[0] = n
    count, light = 1, 0.0
    if may_block:
        count = _cleared(
            facet,
            own,
            held,
            held_corners,
            1,
            from_wall,
            wall_counts,
            target,
            last,
            others,
            other_corners,
            spare,
            lines,
        )
        for p in range(count):
            found, n = spread(held[p], held_corners[p], facet, wall, 0.0, patch, gauss, digits, stack, found, 0)
            light += by_way_of(found, n, facet, wall, node, whole)
    made = 0
    for p in range(count):
        made = _covered(
            facet,
            held[p],
            held_corners[p],
            from_wall,
            wall_counts,
            target,
            disjoint,
            pieces,
            corners,
            made,
            others,
            other_corners,
            more,
            more_corners,
            spare,
            lines,
        )
        if made < 0:
            break
    if count < 0 or made < 0:
        return np.nan, found
    for p in range(made):
        found, n = spread(pieces[p], corners[p], facet, wall, 0.0, patch, gauss, digits, stack, found, 0)
        light -= by_way_of(found, n, facet, wall, node, whole)
    return light, found


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


@jit_parallel
def received_panels(
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
    for item in prange(owner.shape[0]):
        pose = owner[item]
        parts, _ = _placed(flat, np.empty((0, elements.WIDTH)), turns[pose], places[pose])
        order = orders[pose]
        nodes = np.ascontiguousarray(whole[order, :, : order * order])
        values[item] = _received_panel(
            walls[item], parts, tint, room[: hiders[pose]], nodes, whole, patch, gauss, digits
        )


@jit
def _received_panel(
    walls: Floats,
    parts: Floats,
    tint: Floats,
    blockers: Floats,
    nodes: Floats,
    whole: Floats,
    patch: Floats,
    gauss: Floats,
    digits: float,
) -> Floats:
    every, none, sides = np.concatenate((parts, blockers)), np.empty((0, 4)), np.empty((1, 2))
    last, depth, numbers = len(every), 6, nodes.shape[1]
    total = np.zeros((tint.shape[1], walls.shape[0]))
    work = _room_to_work(depth)
    others, other_corners, _, _, _, _, spare, lines, _ = work
    pieces, corners = np.empty((PIECES, CORNERS, 2)), np.empty(PIECES, dtype=np.int64)
    found, view = np.empty((256, 5)), np.zeros(3)
    from_nodes, node_counts = np.empty((numbers, last, depth, 4)), np.empty((numbers, last), dtype=np.int64)
    for q in range(numbers):
        view[0], view[1] = nodes[0, q], nodes[1, q]
        _all_hidden(view, every, last, none, sides, from_nodes[q], node_counts[q])
    from_wall, wall_counts = np.empty((last, depth, 4)), np.empty(last, dtype=np.int64)
    for w in range(walls.shape[0]):
        wall = walls[w]
        _all_hidden(wall, every, last, none, sides, from_wall, wall_counts)
        for s in range(parts.shape[0]):
            facet = parts[s]
            if facet[34] == 1.0 and facet[9] * wall[0] + facet[10] * wall[1] < facet[12]:
                continue
            corners[0] = _above(facet, pieces[0], lines, spare[0])
            if corners[0] == 0:
                continue
            count = _cleared(
                facet, s, pieces, corners, 1, from_wall, wall_counts, 0, last, others, other_corners, spare, lines
            )
            light = np.nan
            if count >= 0:
                light, found = _seen(
                    facet,
                    s,
                    wall,
                    pieces,
                    corners,
                    count,
                    nodes,
                    from_nodes,
                    node_counts,
                    0,
                    last,
                    whole,
                    patch,
                    gauss,
                    digits,
                    work,
                    found,
                )
            for g in range(tint.shape[1]):
                total[g, w] += light * tint[s, g]
    return total
