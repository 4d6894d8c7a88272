"""Light that comes and goes past a few convex surfaces, with their shadows cut exactly.

Seen from a point, a convex surface hides an intersection of half-spaces, and on a plane behind it a convex polygon.
So what is left of a facet after all shadows on both legs - towards the wall point, and towards a point of the lit
patch - is a handful of polygons, and light is smooth on each. No ray is tested; the result is as smooth in pose and
wall point as the scene allows, and its derivatives are integrals along the polygons' moving edges.
"""

from __future__ import annotations

import math

import numpy as np

from generator.transport import elements, kernel
from generator.transport.compiled import NONE, ONE, jit, jit_released
from generator.transport.polygons import CORNERS, FACET, PIECES, lay, spread
from generator.transport.shadows.cones import Floats, Occluders, all_hidden, hidden_from_nodes, no_cones
from generator.transport.shadows.light import Rules, add_kept, add_seen
from generator.transport.shadows.pieces import Work, above, cleared, covered, may_meet, no_pieces, room_to_work

# --- what is hidden from a point ------------------------------------------------------------------------------------


# --- on a facet -----------------------------------------------------------------------------------------------------


# --- light ----------------------------------------------------------------------------------------------------------


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
    from_wall = no_cones(occluders)
    from_nodes = hidden_from_nodes(nodes, occluders)
    work, pieces, held = room_to_work(from_wall), no_pieces(), no_pieces()
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
        n = above(room[s], polygon, lines, spare[0])
        for q in range(nodes.shape[1] if n else 0):
            cones = (from_nodes[0][q], from_nodes[1][q])
            count = covered(room[s], polygon, n, cones, target, disjoint, pieces, NONE[0], work)
            count = cleared(room[s], target + s, pieces, count, cones, target, last, left, work)
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
        all_hidden(wall, occluders, from_wall)
        for s in range(room.shape[0]):
            n = above(room[s], polygon, lines, spare[0])
            count = covered(room[s], polygon, n, from_wall, target, disjoint, pieces, NONE[0], work)
            count = cleared(room[s], target + s, pieces, count, from_wall, target, last, left, work)
            light[:] = 0.0 if count >= 0 else np.nan
            found = add_seen(
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
            found = add_kept(
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
    ends = np.empty((4, *no_cones(occluders)[0].shape))
    end_counts = np.empty((4, last), dtype=np.int64)
    for e in range(4):
        all_hidden(walls[walls.shape[0] - 4 + e], occluders, (ends[e], end_counts[e]))
    outside = np.empty(ends.shape[2], dtype=np.bool_)
    lines = work[3]
    together = np.ones(number, dtype=np.bool_)
    apart = np.full(number, balls.shape[0] > 0)  # a sphere's outline differs from point to point
    for p in range(number):
        facet = room[of[p, 0]]
        for part in range(last):
            if part == target + of[p, 0] or flat <= part < target or (apart[p] if part < flat else not together[p]):
                continue
            if may_meet(facet, kept[p], corners[p], (ends, end_counts), part, lines, outside):
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
    from_wall, from_nodes = no_cones(occluders), hidden_from_nodes(nodes, occluders)
    work, pieces = room_to_work(from_wall), no_pieces()
    _, left, spare, lines, _ = work
    found, light, at = np.empty((256, 5)), np.zeros(1), np.zeros(3)
    for w in range(walls.shape[0]):
        wall = walls[w]
        all_hidden(wall, occluders, from_wall)
        for s in range(parts.shape[0]):
            facet = parts[s]
            if facet[34] == 1.0 and facet[9] * wall[0] + facet[10] * wall[1] < facet[12]:
                continue
            pieces[1][0] = above(facet, pieces[0][0], lines, spare[0])
            count = ONE[0] if pieces[1][0] else NONE[0]
            count = cleared(facet, s, pieces, count, from_wall, NONE[0], last, left, work)
            light[:] = 0.0 if count >= 0 else np.nan
            found = add_seen(
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
