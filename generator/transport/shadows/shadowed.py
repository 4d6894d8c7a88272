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
from generator.transport.compiled import jit_in_place, jit_parts, jit_within
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
    room_for_cones,
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


class _Job(NamedTuple):
    """Panels, and what light they receive: of ``hidden_panels`` if ``hides``, else of ``received_panels``."""

    panels: Panels
    target: Target
    poses: Poses
    room: Room
    rules: Rules
    hides: bool


class _Space(NamedTuple):
    """Scratch space: compiled functions that create no arrays are compiled in a third of the time.

    Attributes
    ----------
    facets : ndarray of shape (target's cells + m, FACET)
        The target's at a pose, and the room's.
    spheres : ndarray of shape (s, 4)
    cell : ndarray of shape (elements.WIDTH,)
    nodes, lamps : ndarray of shape (n, 3)
        As in `Scene`, for the pose with the most.
    from_wall, from_lamps, ends : Cones
        Regions hidden from a point of a panel, from each of the lamps, from the panel's corners.
    kept : Kept
    together, apart : ndarray
        Of each region that is kept.
    outside : ndarray of shape (k,), bool
    light : ndarray of shape (1 or 7,)
    wall : ndarray of shape (2, points of a panel)
    sent : ndarray of shape (groups, 6, elements of a sum)
    polygon : ndarray of shape (CORNERS, 2)
    work : Work
    """

    facets: Floats
    spheres: Floats
    cell: Floats
    nodes: Floats
    lamps: Floats
    from_wall: Cones
    from_lamps: Cones
    ends: Cones
    kept: Kept
    together: Floats
    apart: Floats
    outside: Floats
    light: Floats
    wall: Floats
    sent: Floats
    polygon: Floats
    work: Work


_SUM = 256
"""Elements that are summed at once."""


def _space(job: _Job, channels: int, kept: int) -> _Space:
    """Return scratch space for panels, with room for a number of regions that nodes' shadows cover."""
    cells, balls, room = len(job.target.flat), len(job.target.balls), job.room
    lamps = int(job.poses.orders.max()) ** 2
    occluders = cells + balls + int(job.poses.hiders.max())
    from_wall, from_lamps = room_for_cones(occluders, balls, len(room.sides), lamps)
    _, ends = room_for_cones(occluders, balls, len(room.sides), 4)
    tint = room.tint if job.hides else job.target.albedo
    return _Space(
        np.concatenate([np.zeros((cells, FACET)), room.facets]),
        np.empty((balls, 4)),
        np.empty(elements.WIDTH),
        np.zeros((lamps, 3)),
        np.zeros((lamps, 3)),
        from_wall,
        from_lamps,
        ends,
        Kept(np.empty((kept, CORNERS, 2)), np.empty(kept, dtype=np.int64), np.empty((kept, 2), dtype=np.int64), 0),
        np.empty(kept, dtype=np.bool_),
        np.empty(kept, dtype=np.bool_),
        np.empty(from_wall.spaces.shape[1], dtype=np.bool_),
        np.empty(channels),
        np.empty((2, job.panels.walls.shape[1])),
        np.empty((tint.shape[1], 6, _SUM)),
        np.empty((CORNERS, 2)),
        room_to_work(from_wall),
    )


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
    job = _Job(panels, target, poses, room, rules, True)
    kept = PIECES + int(poses.orders.max()) ** 2 * len(room.facets)
    while start < stop:
        start = _evaluate(start, stop, job, _space(job, values.shape[2], kept), values)
        kept *= 2


def received_panels(
    start: int, stop: int, panels: Panels, cells: Target, poses: Poses, room: Room, rules: Rules, values: Floats
) -> None:
    """Evaluate `shaded.reflected` on panels, for flat cells that may hide each other and be hidden by the room.

    Parameters are those of `hidden_panels`, except that the light comes by way of ``cells``.
    """
    job = _Job(panels, cells, poses, room, rules, False)
    _evaluate(start, stop, job, _space(job, values.shape[2], 1), values)


@jit_parts
def _evaluate(start: int, stop: int, job: _Job, space: _Space, values: Floats) -> int:
    """Evaluate panels; return the first that was not, because ``space`` is too small for it."""
    target, room, poses = job.target, job.room, job.poses
    cells = target.flat.shape[0]
    for item in range(start, stop):
        pose = job.panels.owner[item]
        at, order = poses.places[pose], poses.orders[pose]
        _place(target, poses.turns[pose], at, space)
        parts, facets = space.facets[:cells], space.facets[: cells + poses.hiders[pose]]
        occluders = Occluders(facets, cells if job.hides else facets.shape[0], space.spheres, room.sides)
        nodes, lamps = space.nodes[: order * order], space.lamps[: order * order]
        for q in range(order * order):
            for r in range(3):
                nodes[q, r] = job.rules.whole[order, r, q]
            lamps[q, 0], lamps[q, 1] = nodes[q, 0], nodes[q, 1]
        hidden = Cones(space.from_lamps.spaces[: order * order], space.from_lamps.counts[: order * order])
        hidden_from_each(lamps, occluders, hidden)
        values[item] = 0.0
        first = target_parts(occluders) if job.hides else 0
        shadows = TargetShadows(first, room.disjoint)
        surfaces = room.facets if job.hides else parts
        scene = Scene(occluders, surfaces, first, shadows, at, nodes, lamps, hidden, job.rules)
        if not job.hides:
            _received_panel(job.panels.walls[item], scene, target.albedo, space, values[item])
        elif not _hidden_panel(job.panels.walls[item], scene, room.tint, space, values[item]):
            return item
    return stop


@jit_within
def _place(target: Target, turn: Floats, at: Floats, space: _Space) -> None:
    """Write a target's cells as facets, and its spheres (centre, radius), at a pose."""
    flat, balls, cell = target.flat, target.balls, space.cell
    origin, first, second, end = elements.ORIGIN, elements.FIRST, elements.SECOND, elements.LOW
    for k in range(flat.shape[0]):
        elements.place(flat[k], turn, at, cell)
        triangle = cell[elements.KIND] == elements.TRIANGLE
        lay(cell[origin:first], cell[first:second], cell[second:end], triangle, space.facets[k])
        space.facets[k, SIDED] = cell[elements.SIDED]
    for k in range(balls.shape[0]):
        elements.place(balls[k], turn, at, cell)
        for r in range(3):
            space.spheres[k, r] = cell[origin + r]
        space.spheres[k, 3] = cell[elements.RADIUS]


@jit_within
def _hidden_panel(walls: Floats, scene: Scene, tint: Floats, space: _Space, total: Floats) -> bool:
    """Add what one panel's points lose to ``total``; return whether ``space`` was large enough."""
    from_wall, polygon, light, work = space.from_wall, space.polygon, space.light, space.work
    number = _keep(scene, space)
    if number == _TOO_MANY:
        total[:] = np.nan
    if number < 0:
        return number == _TOO_MANY
    kept = Kept(space.kept.polygons, space.kept.corners, space.kept.of, number)
    moving = total.shape[1] > 1
    _sort(walls, kept, scene, space, moving)
    _add_together(walls, kept, scene, tint, space, total)
    first, last = scene.first, all_parts(scene.occluders)
    pieces, cutting = work.pieces, work.cutting
    for w in range(walls.shape[0]):
        all_hidden(walls[w], scene.occluders, from_wall)
        eye = View(walls[w], from_wall)
        for s in range(scene.surfaces.shape[0]):
            facet = scene.surfaces[s]
            n = above(facet, polygon, cutting.lines, cutting.spare[0])
            count = covered(facet, polygon, n, from_wall, scene.target, pieces, 0, cutting)
            count = cleared(facet, first + s, pieces, count, from_wall, first, last, cutting)
            light[:] = 0.0 if count >= 0 else np.nan
            add_seen(light, s, eye, pieces, count, scene, work)
            _tinted(light, tint, s, total, w)
        for p in range(kept.number):
            if space.together[p] and not space.apart[p]:
                continue
            light[:] = 0.0
            add_kept(light, not space.together[p], kept, p, eye, scene, work)
            _tinted(light, tint, kept.of[p, 0], total, w)
    return True


@jit_in_place
def _tinted(light: Floats, tint: Floats, surface: int, total: Floats, w: int) -> None:
    """Add to the total of wall point ``w`` the light by way of a surface."""
    for g in range(tint.shape[1]):
        for c in range(light.shape[0]):
            total[g, c, w] += light[c] * tint[surface, g]


_TOO_MANY, _NO_ROOM = -1, -2


@jit_within
def _keep(scene: Scene, space: _Space) -> int:
    """Write the regions that the nodes' shadows cover, node by node; return their number.

    It is `_TOO_MANY` where shadows fall into too many pieces, `_NO_ROOM` where there are more than there is room for.
    """
    kept, polygon, work = space.kept, space.polygon, space.work
    first, last = scene.first, all_parts(scene.occluders)
    pieces, cutting, number = work.pieces, work.cutting, 0
    for s in range(scene.surfaces.shape[0]):
        facet = scene.surfaces[s]
        n = above(facet, polygon, cutting.lines, cutting.spare[0])
        for q in range(scene.nodes.shape[0] if n else 0):
            cones = Cones(scene.from_lamps.spaces[q], scene.from_lamps.counts[q])
            count = covered(facet, polygon, n, cones, scene.target, pieces, 0, cutting)
            count = cleared(facet, first + s, pieces, count, cones, first, last, cutting)
            if count < 0:
                return _TOO_MANY
            if number + count > kept.corners.shape[0]:
                return _NO_ROOM
            for p in range(count):
                kept.corners[number], kept.of[number, 0], kept.of[number, 1] = pieces.corners[p], s, q
                copy(pieces.polygons[p], pieces.corners[p], kept.polygons[number])
                number += 1
    return number


@jit_within
def _sort(walls: Floats, kept: Kept, scene: Scene, space: _Space, moving: bool) -> None:
    """Write which nodes' shadows the room hides nowhere from a panel, and which a point's own shadow may overlap.

    For derivatives, all are taken as neither free nor apart.
    """
    occluders, target, last = scene.occluders, scene.first, all_parts(scene.occluders)
    flat, together, apart = occluders.flat, space.together, space.apart
    if not moving:
        hidden_from_each(walls[walls.shape[0] - 4 :], occluders, space.ends)
    for p in range(kept.number):
        together[p] = not moving
        apart[p] = moving or flat < target  # a sphere's outline differs from point to point
        if moving:
            continue
        s = kept.of[p, 0]
        facet = scene.surfaces[s]
        for part in range(last):
            if part == target + s or flat <= part < target or (apart[p] if part < flat else not together[p]):
                continue
            meets = may_meet(
                facet, kept.polygons[p], kept.corners[p], space.ends, part, space.work.cutting.lines, space.outside
            )
            if meets and part < flat:
                apart[p] = True
            elif meets:
                together[p] = False


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


@jit_within
def _add_together(walls: Floats, kept: Kept, scene: Scene, tint: Floats, space: _Space, total: Floats) -> None:
    """Add the light of nodes' shadows that nothing hides from any point of a panel: one sum for all of its points."""
    sent, filled, wall, summing = space.sent, 0, space.wall, space.work.summing
    disc = Disc(space.cell[:3], _around(walls, space.cell[:3]))
    for w in range(walls.shape[0]):
        wall[0, w], wall[1, w] = walls[w, 0], walls[w, 1]
    for p in range(kept.number):
        if not space.together[p]:
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
                    _sum(wall, sent, filled, total)
                    filled = 0
                _send(summing.found, count, facet, node, tint[s], sent, filled)
                filled += count
    _sum(wall, sent, filled, total)


@jit_in_place
def _sum(wall: Floats, sent: Floats, filled: int, total: Floats) -> None:
    for g in range(sent.shape[0]):
        kernel.radiance(wall[0], wall[1], sent[g], filled, 0.0, total[g, 0])


@jit_in_place
def _around(walls: Floats, centre: Floats) -> float:
    """Write the centre of a disc around a panel's points, whose last four are its corners; return its radius."""
    ends, radius = walls[walls.shape[0] - 4 :], 0.0
    centre[0], centre[1], centre[2] = 0.0, 0.0, 0.0
    for e in range(4):
        centre[0] += ends[e, 0] / 4.0
        centre[1] += ends[e, 1] / 4.0
    for e in range(4):
        radius = max(radius, math.hypot(ends[e, 0] - centre[0], ends[e, 1] - centre[1]))
    return radius


@jit_within
def _received_panel(walls: Floats, scene: Scene, tint: Floats, space: _Space, total: Floats) -> None:
    """Add what one panel's points receive to ``total``."""
    last, from_wall, work, light = all_parts(scene.occluders), space.from_wall, space.work, space.light
    pieces, cutting = work.pieces, work.cutting
    for w in range(walls.shape[0]):
        wall = walls[w]
        all_hidden(wall, scene.occluders, from_wall)
        eye = View(wall, from_wall)
        for s in range(scene.surfaces.shape[0]):
            facet = scene.surfaces[s]
            if facet[SIDED] == 1.0 and height_of(facet, wall[0], wall[1]) < 0.0:
                continue
            pieces.corners[0] = above(facet, pieces.polygons[0], cutting.lines, cutting.spare[0])
            count = cleared(facet, s, pieces, 1 if pieces.corners[0] else 0, from_wall, 0, last, cutting)
            light[:] = 0.0 if count >= 0 else np.nan
            add_seen(light, s, eye, pieces, count, scene, work)
            _tinted(light, tint, s, total, w)
