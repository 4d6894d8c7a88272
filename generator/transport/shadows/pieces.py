"""Pieces of polygons that remain when shadows are cut out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from generator.transport.compiled import jit_in_place
from generator.transport.lit import Rules
from generator.transport.polygons import (
    CORNERS,
    FIRST,
    ORIGIN,
    PIECES,
    SECOND,
    Summing,
    copy,
    outline,
    room_to_sum,
    within,
    without,
)
from generator.transport.shadows.cones import Cones, Floats, Occluders

ON_LINE = 1e-9


class Pieces(NamedTuple):
    """Polygons on a facet.

    Attributes
    ----------
    polygons : ndarray of shape (PIECES, CORNERS, 2)
        Along the facet's axes.
    corners : ndarray of shape (PIECES,), int
        Number of corners of each.
    """

    polygons: Floats
    corners: Floats


class Cutting(NamedTuple):
    """Scratch space for cutting: pieces, spare polygons, lines."""

    some: Pieces
    left: Pieces
    spare: Floats
    lines: Floats


class Work(NamedTuple):
    """Scratch space: pieces twice, that of cutting and of summing, rows for an edge that moves; and three zeros."""

    pieces: Pieces
    held: Pieces
    cutting: Cutting
    summing: Summing
    edge: Floats
    zeros: Floats


class TargetShadows(NamedTuple):
    """Number of occluders, counted from the first, that are the target's; and whether shadows of its flat cells do
    not overlap, except those of a solid's far side.
    """

    parts: int
    disjoint: bool


class View(NamedTuple):
    """A point, and the regions that are hidden from it."""

    point: Floats
    cones: Cones


class Scene(NamedTuple):
    """Surfaces that light comes by way of, and what is in its way.

    Attributes
    ----------
    occluders : Occluders
    surfaces : ndarray of shape (n, FACET)
        Surfaces that the light comes by way of.
    first : int
        Occluders from this one on can hide the surfaces; surface ``s`` is itself the occluder ``first + s``.
    target : TargetShadows
    at : ndarray of shape (3,)
        Point that the target turns about.
    nodes : ndarray of shape (n, 3)
        Points of the patch that throw shadows: position on the wall, radiance times area.
    lamps : ndarray of shape (n, 3)
        The same as points.
    from_lamps : Cones
        Regions that are hidden from each.
    rules : Rules
    """

    occluders: Occluders
    surfaces: Floats
    first: int
    target: TargetShadows
    at: Floats
    nodes: Floats
    lamps: Floats
    from_lamps: Cones
    rules: Rules


@jit_in_place
def on_plane(facet: Floats, spaces: Floats, k: int, lines: Floats) -> None:
    """Write the lines (k, 3) in which the borders of half-spaces cut a facet's plane."""
    for i in range(k):
        for r in range(2):
            lines[i, r] = 0.0
            for c in range(3):
                lines[i, r] += spaces[i, c] * facet[FIRST + 3 * r + c]
        lines[i, 2] = spaces[i, 3]
        for c in range(3):
            lines[i, 2] += spaces[i, c] * facet[ORIGIN + c]


@jit_in_place
def above(facet: Floats, polygon: Floats, lines: Floats, spare: Floats) -> int:
    """Write the corners of the part of a facet that is above the relay wall; return their number."""
    n = outline(facet, polygon)
    lines[0, 0], lines[0, 1], lines[0, 2] = facet[FIRST + 2], facet[SECOND + 2], facet[ORIGIN + 2]
    return within(polygon, n, lines, 1, polygon, spare)


@jit_in_place
def cleared(
    facet: Floats, own: int, pieces: Pieces, count: int, cones: Cones, first: int, last: int, work: Cutting
) -> int:
    """Cut the shadows of occluders ``first`` to ``last``, except the facet itself (``own``), out of pieces on it.

    Returns
    -------
    int
        New number of pieces; negative if there were too many.
    """
    polygons, corners = pieces
    rest, rest_corners = work.left
    lines, spare = work.lines, work.spare
    for part in range(first, last):
        k = cones.counts[part]
        if part == own or k == 0 or count <= 0:
            continue
        on_plane(facet, cones.spaces[part], k, lines)
        touched = False
        for p in range(count):
            if within(polygons[p], corners[p], lines, k, spare[0], spare[1]):
                touched = True
                break
        if not touched:
            continue
        remaining = 0
        for p in range(count):
            remaining = without(polygons[p], corners[p], lines, k, rest, rest_corners, remaining, spare)
        if remaining < 0:
            return -1
        for p in range(remaining):
            copy(rest[p], rest_corners[p], polygons[p])
            corners[p] = rest_corners[p]
        count = remaining
    return count


@jit_in_place
def covered(
    facet: Floats,
    polygon: Floats,
    n: int,
    cones: Cones,
    target: TargetShadows,
    pieces: Pieces,
    count: int,
    work: Cutting,
) -> int:
    """Append the part of a polygon on a facet that the target hides, in pieces that do not overlap.

    Returns
    -------
    int
        New number of pieces; negative if there were too many.
    """
    polygons, corners = pieces
    shadow, shadow_corners = work.some
    lines = work.lines
    for part in range(target.parts):
        k = cones.counts[part]
        if k == 0 or count < 0:
            continue
        on_plane(facet, cones.spaces[part], k, lines)
        shadow_corners[0] = within(polygon, n, lines, k, shadow[0], work.spare[0])
        if shadow_corners[0] == 0:
            continue
        added = 1
        if not target.disjoint and part > 0:
            added = cleared(facet, -1, work.some, 1, cones, 0, part, work)
        if added < 0 or count + added > PIECES:
            return -1
        for p in range(added):
            copy(shadow[p], shadow_corners[p], polygons[count])
            corners[count] = shadow_corners[p]
            count += 1
    return count


@jit_in_place
def may_meet(facet: Floats, polygon: Floats, n: int, ends: Cones, part: int, lines: Floats, outside: Floats) -> bool:
    """Whether a flat part's shadow, seen from anywhere between some points, may reach a polygon on a facet.

    The side of an edge's plane on which y lies, as seen from w, is a determinant that is affine in w and in y: with
    one sign for all corners of both, it has that sign everywhere between them.
    """
    k = ends.counts[0, part]
    for i in range(outside.shape[0]):
        outside[i] = True
    for e in range(ends.counts.shape[0]):
        if ends.counts[e, part] != k or k == 0:
            return True
        on_plane(facet, ends.spaces[e, part], k, lines)
        for i in range(k):
            for j in range(n):
                if lines[i, 0] * polygon[j, 0] + lines[i, 1] * polygon[j, 1] + lines[i, 2] > 0.0:
                    outside[i] = False
    separated = False
    for i in range(k):
        separated = separated or outside[i]
    return not separated


def room_to_work(cones: Cones) -> Work:
    """Return scratch space for cones of as many half-spaces as ``cones`` have."""
    lines = np.empty((cones.spaces.shape[1], 3))
    four = [Pieces(np.empty((PIECES, CORNERS, 2)), np.empty(PIECES, dtype=np.int64)) for _ in range(4)]
    cutting = Cutting(four[2], four[3], np.empty((3, CORNERS, 2)), lines)
    return Work(four[0], four[1], cutting, room_to_sum(), np.empty((4, 6)), np.zeros(3))
