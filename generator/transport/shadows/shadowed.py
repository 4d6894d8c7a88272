"""Light that passes a few convex surfaces, with their shadows cut exactly.

Seen from a point, a convex surface hides an intersection of half-spaces, and on a plane behind it a convex polygon.
So the part of a facet that is left after all shadows on both legs - towards the wall point, and towards a point of
the lit patch - is a few polygons, and light is smooth on each. No ray is tested; the result is as smooth in pose and
wall point as the scene allows, and its derivatives are integrals along the polygons' moving edges.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from generator.transport import elements, kernel
from generator.transport.compiled import NONE, ONE, jit, jit_in_place, jit_released
from generator.transport.lit import Rules
from generator.transport.polygons import (
    AREA,
    CORNERS,
    FACET,
    NORMAL,
    PIECES,
    SIDED,
    copy,
    fan,
    height_of,
    lay,
    next_points,
    start_triangle,
)
from generator.transport.records import Disc, Panels, Poses, Target
from generator.transport.shadows.cones import (
    Cones,
    Floats,
    Occluders,
    all_hidden,
    all_parts,
    hidden_from_each,
    no_cones,
    target_parts,
)
from generator.transport.shadows.light import Kept, add_kept, add_seen
from generator.transport.shadows.pieces import (
    Scene,
    TargetShadows,
    View,
    Work,
    above,
    cleared,
    covered,
    may_meet,
    room_to_work,
)


class Room(NamedTuple):
    """The room, and how shadows in it are cut.

    Attributes
    ----------
    facets : ndarray of shape (m, FACET)
    tint : ndarray of shape (m, groups)
        Albedo.
    sides : ndarray
        As `cones.ring` returns them.
    disjoint : bool
        Whether shadows of the target's flat cells do not overlap, except those of a solid's far side.
    """

    facets: Floats
    tint: Floats
    sides: Floats
    disjoint: bool


@jit
def _placed(target: Target, turn: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Return a target's cells as facets, and its spheres (centre, radius), at a pose."""
    flat, balls = target.flat, target.balls
    parts, spheres = np.zeros((flat.shape[0], FACET)), np.empty((balls.shape[0], 4))
    cell = np.empty(elements.WIDTH)
    origin, first, second, end = elements.ORIGIN, elements.FIRST, elements.SECOND, elements.LOW
    for k in range(flat.shape[0]):
        elements.place(flat[k], turn, at, cell)
        triangle = cell[elements.KIND] == elements.TRIANGLE
        lay(cell[origin:first], cell[first:second], cell[second:end], triangle, parts[k])
        parts[k, SIDED] = cell[elements.SIDED]
    for k in range(balls.shape[0]):
        elements.place(balls[k], turn, at, cell)
        spheres[k, :3], spheres[k, 3] = cell[origin:first], cell[elements.RADIUS]
    return parts, spheres


@jit
def _lamps(rules: Rules, order: int) -> tuple[Floats, Floats]:
    """Return the points of the patch that throw shadows (n, 3): with radiance times area, and as points in space."""
    nodes = np.ascontiguousarray(rules.whole[order, :, : order**2].T)
    lamps = nodes.copy()
    lamps[:, 2] = 0.0
    return nodes, lamps


@jit
def _around(walls: Floats) -> Disc:
    """Return a disc around a panel's points, whose last four are its corners."""
    ends = walls[walls.shape[0] - 4 :]
    centre = np.zeros(3)
    for e in range(4):
        centre[0] += ends[e, 0] / 4.0
        centre[1] += ends[e, 1] / 4.0
    radius = 0.0
    for e in range(4):
        radius = max(radius, math.hypot(ends[e, 0] - centre[0], ends[e, 1] - centre[1]))
    return Disc(centre, radius)


@jit_released
def hidden_panels(
    start: int, stop: int, panels: Panels, target: Target, poses: Poses, room: Room, rules: Rules, values: Floats
) -> None:
    """Evaluate `shaded.hidden` on panels ``start`` to ``stop``, and its derivatives.

    The target hides a point y of the room from a wall point w, or a point q of the patch, if y lies in its shadow
    as seen from w, or from q. The sum is therefore over the region of w's shadow, with all of the light that y would
    have; and over the region of q's shadow, except where it overlaps w's.

    Parameters
    ----------
    start, stop : int
    panels : Panels
    target : Target
    poses : Poses
    room : Room
    rules : Rules
    values : ndarray of shape (n, groups, 1 or 7, k), written
        Not a number where shadows fall into too many pieces. With seven channels, the derivatives for the target's
        position (3) and its rotation about the three axes (3) follow.
    """
    for item in range(start, stop):
        pose = panels.owner[item]
        parts, spheres = _placed(target, poses.turns[pose], poses.places[pose])
        facets = np.concatenate((parts, room.facets[: poses.hiders[pose]]))
        occluders = Occluders(facets, parts.shape[0], spheres, room.sides)
        nodes, lamps = _lamps(rules, poses.orders[pose])
        hidden = hidden_from_each(lamps, occluders)
        shadows = TargetShadows(target_parts(occluders), room.disjoint)
        scene = Scene(occluders, room.facets, shadows.parts, shadows, poses.places[pose], nodes, lamps, hidden, rules)
        values[item] = 0.0
        _hidden_panel(panels.walls[item], scene, room.tint, values[item])


@jit
def _hidden_panel(walls: Floats, scene: Scene, tint: Floats, total: Floats) -> None:
    from_wall = no_cones(scene.occluders)
    work = room_to_work(from_wall)
    polygon, light = np.empty((CORNERS, 2)), np.zeros(total.shape[1])
    kept = _kept_by_nodes(scene, polygon, work)
    if kept.number < 0:
        total[:] = np.nan
        return
    together, apart = _sorted(walls, kept, scene, work.cutting.lines)
    if total.shape[1] > 1:
        together[:] = False
        apart[:] = True
    _add_together(walls, kept, together, scene, tint, work, total)
    first, last = scene.first, all_parts(scene.occluders)
    pieces, cutting = work.pieces, work.cutting
    for w in range(walls.shape[0]):
        all_hidden(walls[w], scene.occluders, from_wall)
        eye = View(walls[w], from_wall)
        for s in range(scene.surfaces.shape[0]):
            facet = scene.surfaces[s]
            n = above(facet, polygon, cutting.lines, cutting.spare[0])
            count = covered(facet, polygon, n, from_wall, scene.target, pieces, NONE[0], cutting)
            count = cleared(facet, first + s, pieces, count, from_wall, first, last, cutting)
            light[:] = 0.0 if count >= 0 else np.nan
            add_seen(light, s, eye, pieces, count, scene, work)
            for g in range(tint.shape[1]):
                total[g, :, w] += light * tint[s, g]
        for p in range(kept.number):
            if together[p] and not apart[p]:
                continue
            light[:] = 0.0
            add_kept(light, not together[p], kept, p, eye, scene, work)
            for g in range(tint.shape[1]):
                total[g, :, w] += light * tint[kept.of[p, 0], g]


@jit
def _kept_by_nodes(scene: Scene, polygon: Floats, work: Work) -> Kept:
    """Return the regions that the nodes' shadows cover, node by node; ``polygon`` is scratch space."""
    size = PIECES + scene.nodes.shape[0] * scene.surfaces.shape[0]
    kept, corners, of = np.empty((size, CORNERS, 2)), np.empty(size, np.int64), np.empty((size, 2), np.int64)
    first, last = scene.first, all_parts(scene.occluders)
    pieces, cutting, number = work.pieces, work.cutting, NONE[0]
    for s in range(scene.surfaces.shape[0]):
        facet = scene.surfaces[s]
        n = above(facet, polygon, cutting.lines, cutting.spare[0])
        for q in range(scene.nodes.shape[0] if n else 0):
            cones = Cones(scene.from_lamps.spaces[q], scene.from_lamps.counts[q])
            count = covered(facet, polygon, n, cones, scene.target, pieces, NONE[0], cutting)
            count = cleared(facet, first + s, pieces, count, cones, first, last, cutting)
            if count < 0:
                return Kept(kept, corners, of, -ONE[0])
            if number + count > len(kept):
                size = 2 * (number + count)
                grown = np.empty((size, CORNERS, 2)), np.empty(size, np.int64), np.empty((size, 2), np.int64)
                grown[0][:number], grown[1][:number], grown[2][:number] = kept[:number], corners[:number], of[:number]
                kept, corners, of = grown
            for p in range(count):
                corners[number], of[number, 0], of[number, 1] = pieces.corners[p], s, q
                copy(pieces.polygons[p], corners[number], kept[number])
                number += 1
    return Kept(kept, corners, of, number)


@jit
def _sorted(walls: Floats, kept: Kept, scene: Scene, lines: Floats) -> tuple[Floats, Floats]:
    """Return which nodes' shadows the room hides nowhere from a panel, and which a point's own shadow may overlap."""
    occluders, target, last = scene.occluders, scene.first, all_parts(scene.occluders)
    flat = occluders.flat
    ends = hidden_from_each(walls[walls.shape[0] - 4 :], occluders)
    outside = np.empty(ends.spaces.shape[2], dtype=np.bool_)
    together = np.ones(kept.number, dtype=np.bool_)
    apart = np.full(kept.number, flat < target)  # a sphere's outline differs from point to point
    for p in range(kept.number):
        s = kept.of[p, 0]
        facet = scene.surfaces[s]
        for part in range(last):
            if part == target + s or flat <= part < target or (apart[p] if part < flat else not together[p]):
                continue
            if may_meet(facet, kept.polygons[p], kept.corners[p], ends, part, lines, outside):
                if part < flat:
                    apart[p] = True
                else:
                    together[p] = False
    return together, apart


@jit_in_place
def _send(found: Floats, count: int, facet: Floats, node: Floats, tint: Floats, sent: Floats, filled: int) -> None:
    """Write points of a facet as elements (groups, 6, n) of `kernel.radiance`, lit by a point of the patch."""
    level = height_of(facet, node[0], node[1])
    for k in range(count):
        u, v = found[k, 0] - node[0], found[k, 1] - node[1]
        near = u * u + v * v + found[k, 2] ** 2
        # The sign of ``level`` turns the normal to the side that is lit.
        strength = found[k, AREA] * node[2] * level * found[k, 2] / (near * near)
        for g in range(tint.shape[0]):
            for r in range(3):
                sent[g, r, filled + k] = found[k, r]
                sent[g, 3 + r, filled + k] = facet[NORMAL + r] * strength * tint[g]


@jit
def _add_together(
    walls: Floats, kept: Kept, together: Floats, scene: Scene, tint: Floats, work: Work, total: Floats
) -> None:
    """Add the light of nodes' shadows that nothing hides from any point of a panel: one sum for all of its points."""
    disc, summing = _around(walls), work.summing
    sent, filled = np.empty((tint.shape[1], 6, 256)), 0
    for p in range(kept.number):
        if not together[p]:
            continue
        s, n = kept.of[p, 0], kept.corners[p]
        facet, node = scene.surfaces[s], scene.nodes[kept.of[p, 1]]
        middle0, middle1, start, end = fan(kept.polygons[p], n)
        for k in range(start, end):
            start_triangle(kept.polygons[p], n, k, middle0, middle1, summing.stack[0])
            top = 1
            while top > 0:
                top, count = next_points(facet, disc, scene.rules, summing, top)
                if filled + count > sent.shape[2]:
                    grown = np.empty((sent.shape[0], 6, 2 * (filled + count)))
                    grown[:, :, :filled] = sent[:, :, :filled]
                    sent = grown
                _send(summing.found, count, facet, node, tint[s], sent, filled)
                filled += count
    a, b = np.ascontiguousarray(walls[:, 0]), np.ascontiguousarray(walls[:, 1])
    for g in range(tint.shape[1]):
        kernel.radiance(a, b, sent[g], filled, 0.0, total[g, 0])


@jit_released
def received_panels(
    start: int, stop: int, panels: Panels, cells: Target, poses: Poses, room: Room, rules: Rules, values: Floats
) -> None:
    """Evaluate `shaded.reflected` on panels, for flat cells that may hide each other and be hidden by the room.

    Parameters are those of `hidden_panels`, except that the light comes by way of ``cells``.
    """
    for item in range(start, stop):
        pose = panels.owner[item]
        parts, spheres = _placed(cells, poses.turns[pose], poses.places[pose])
        facets = np.concatenate((parts, room.facets[: poses.hiders[pose]]))
        occluders = Occluders(facets, facets.shape[0], spheres, np.empty((1, 2)))
        nodes, lamps = _lamps(rules, poses.orders[pose])
        hidden = hidden_from_each(lamps, occluders)
        scene = Scene(
            occluders,
            parts,
            NONE[0],
            TargetShadows(NONE[0], room.disjoint),
            poses.places[pose],
            nodes,
            lamps,
            hidden,
            rules,
        )
        values[item] = 0.0
        _received_panel(panels.walls[item], scene, cells.albedo, values[item])


@jit
def _received_panel(walls: Floats, scene: Scene, tint: Floats, total: Floats) -> None:
    last = all_parts(scene.occluders)
    from_wall = no_cones(scene.occluders)
    work = room_to_work(from_wall)
    pieces, cutting, light = work.pieces, work.cutting, np.zeros(1)
    for w in range(walls.shape[0]):
        wall = walls[w]
        all_hidden(wall, scene.occluders, from_wall)
        eye = View(wall, from_wall)
        for s in range(scene.surfaces.shape[0]):
            facet = scene.surfaces[s]
            if facet[SIDED] == 1.0 and height_of(facet, wall[0], wall[1]) < 0.0:
                continue
            pieces.corners[0] = above(facet, pieces.polygons[0], cutting.lines, cutting.spare[0])
            count = ONE[0] if pieces.corners[0] else NONE[0]
            count = cleared(facet, s, pieces, count, from_wall, NONE[0], last, cutting)
            light[:] = 0.0 if count >= 0 else np.nan
            add_seen(light, s, eye, pieces, count, scene, work)
            for g in range(tint.shape[1]):
                total[g, 0, w] += light[0] * tint[s, g]
