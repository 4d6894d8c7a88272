"""Pieces of polygons that are left when shadows are cut out."""

from __future__ import annotations

import numpy as np

from generator.transport.compiled import NONE, ONE, jit
from generator.transport.polygons import CORNERS, PIECES, outline, within, without
from generator.transport.shadows.cones import Cones, Floats

ON_LINE = 1e-9


_STACK = 128


Pieces = tuple[Floats, Floats]
"""Polygons (PIECES, CORNERS, 2) along a facet's axes, and how many corners each has (PIECES,)."""


Work = tuple[Pieces, Pieces, Floats, Floats, Floats]
"""Room to work in: pieces twice, spare polygons, lines, a stack of triangles."""


@jit
def on_plane(facet: Floats, spaces: Floats, k: int, lines: Floats) -> None:
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
def above(facet: Floats, polygon: Floats, lines: Floats, spare: Floats) -> int:
    """Write the corners of the part of a facet that is above the relay wall; return how many."""
    n = outline(facet, polygon)
    lines[0, 0], lines[0, 1], lines[0, 2] = facet[5], facet[8], facet[2]
    return within(polygon, n, lines, ONE[0], polygon, spare)


@jit
def cleared(
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
        on_plane(facet, spaces[part], k, lines)
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
def covered(
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
        on_plane(facet, spaces[part], k, lines)
        other_corners[0] = within(polygon, n, lines, k, others[0], spare[0])
        if other_corners[0] == 0:
            continue
        made = 1 if disjoint or part == 0 else cleared(facet, -ONE[0], some, ONE[0], cones, NONE[0], part, left, work)
        if made < 0 or count + made > PIECES:
            return -1
        for p in range(made):
            polygons[count, : other_corners[p]] = others[p, : other_corners[p]]
            corners[count] = other_corners[p]
            count += 1
    return count


@jit
def may_meet(facet: Floats, polygon: Floats, n: int, ends: Cones, part: int, lines: Floats, outside: Floats) -> bool:
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
        on_plane(facet, spaces[e, part], k, lines)
        for i in range(k):
            for j in range(n):
                if lines[i, 0] * polygon[j, 0] + lines[i, 1] * polygon[j, 1] + lines[i, 2] > 0.0:
                    outside[i] = False
    return not outside[:k].any()


@jit
def no_pieces() -> Pieces:
    """Return room for pieces of polygons: corners, and how many each has."""
    return np.empty((PIECES, CORNERS, 2)), np.empty(PIECES, dtype=np.int64)


@jit
def room_to_work(cones: Cones) -> Work:
    """Return the arrays that cutting works in, for as many cones as one can meet."""
    depth = cones[0].shape[1]
    return no_pieces(), no_pieces(), np.empty((3, CORNERS, 2)), np.empty((depth, 3)), np.empty((_STACK, 6))
