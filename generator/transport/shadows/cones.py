"""Regions that are hidden from a point: cones behind facets and balls."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport import elements
from generator.transport.compiled import jit_in_place
from generator.transport.polygons import CORNER, COUNT, FACET, LEVEL, NORMAL, SIDED, height_above, lay
from generator.transport.rays import Surfaces

Floats = NDArray[Any]


TOUCH = 1e-9


class Cones(NamedTuple):
    """Regions that each occluder hides from a point, or, with one more leading axis, from each of several points.

    Attributes
    ----------
    spaces : ndarray of shape (occluders, k, 4)
        Half-spaces, n . y + c >= 0. The target's flat cells come first, then its spheres, then the room.
    counts : ndarray of shape (occluders,), int
        Number of half-spaces of each; 0 if it hides nothing.
    """

    spaces: Floats
    counts: Floats


class Occluders(NamedTuple):
    """Surfaces that can hide something.

    Attributes
    ----------
    facets : ndarray of shape (n, FACET)
    flat : int
        Number of facets, counted from the first, that are the target's.
    balls : ndarray of shape (s, 4)
        The target's spheres: centre, radius.
    sides : ndarray
        The sides of a sphere's outline, as `ring` returns them.
    """

    facets: Floats
    flat: int
    balls: Floats
    sides: Floats


@jit_in_place
def target_parts(occluders: Occluders) -> int:
    """Return how many of the occluders, from the first, are the target's."""
    return occluders.flat + occluders.balls.shape[0]


@jit_in_place
def all_parts(occluders: Occluders) -> int:
    """Return how many occluders there are."""
    return occluders.facets.shape[0] + occluders.balls.shape[0]


def facets(surfaces: Surfaces) -> Floats:
    """Return the flat surfaces as rows (n, FACET)."""
    rows = np.zeros((len(surfaces.origin), FACET))
    for k, row in enumerate(rows):
        lay(surfaces.origin[k], surfaces.first[k], surfaces.second[k], bool(surfaces.triangle[k]), row)
    return rows


def ring(corners: int) -> Floats:
    """Return the sides of a regular polygon that has the unit circle's area.

    Returns
    -------
    ndarray of shape (corners + 1, 2)
        Directions of the sides; and, as the last row's first number, their distance from the middle.
    """
    angles = 2.0 * np.pi * np.arange(corners) / corners
    step = np.pi / corners
    return np.vstack([np.column_stack([np.cos(angles), np.sin(angles)]), [math.sqrt(step / math.tan(step)), 0.0]])


@jit_in_place
def _behind_facet(facet: Floats, view: Floats, spaces: Floats) -> int:
    """Write the half-spaces of the region that a facet hides from a point; return their number, or 0."""
    level = height_above(facet, view)
    # The far side of a solid hides nothing that the near side does not hide.
    if abs(level) < TOUCH or (facet[SIDED] == 1.0 and level < 0.0):
        return 0
    side = 1.0 if level > 0.0 else -1.0
    n = int(facet[COUNT])
    for k in range(n):
        i, j = CORNER + 3 * k, CORNER + 3 * ((k + 1) % n)
        a0, a1, a2 = facet[i] - view[0], facet[i + 1] - view[1], facet[i + 2] - view[2]
        b0, b1, b2 = facet[j] - view[0], facet[j + 1] - view[1], facet[j + 2] - view[2]
        row = spaces[k]
        row[0], row[1], row[2] = side * (a2 * b1 - a1 * b2), side * (a0 * b2 - a2 * b0), side * (a1 * b0 - a0 * b1)
        row[3] = -(row[0] * view[0] + row[1] * view[1] + row[2] * view[2])
    row = spaces[n]
    for r in range(3):
        row[r] = -side * facet[NORMAL + r]
    row[3] = side * facet[LEVEL] - TOUCH
    return n + 1


@jit_in_place
def _behind_ball(ball: Floats, view: Floats, sides: Floats, spaces: Floats) -> int:
    """As `_behind_facet`, for a sphere (centre, radius), whose outline becomes a polygon of the same area."""
    n = sides.shape[0] - 1
    axis, across = spaces[n, :3], spaces[n + 1, :3]
    far = 0.0
    for r in range(3):
        axis[r] = ball[r] - view[r]
        far += axis[r] ** 2
    far = math.sqrt(far)
    for r in range(3):
        axis[r] /= far
    sine = min(ball[3] / far, 1.0 - 1e-9)
    elements.beside(axis, across)
    third0 = axis[1] * across[2] - axis[2] * across[1]
    third1 = axis[2] * across[0] - axis[0] * across[2]
    third2 = axis[0] * across[1] - axis[1] * across[0]
    opening = sine / math.sqrt(1.0 - sine * sine) * sides[n, 0]
    for k in range(n):
        row = spaces[k]
        row[3] = 0.0
        for r in range(3):
            third = third0 if r == 0 else third1 if r == 1 else third2
            row[r] = opening * axis[r] - (sides[k, 0] * across[r] + sides[k, 1] * third)
            row[3] -= row[r] * view[r]
    row = spaces[n]
    row[3] = -far * (1.0 - sine * sine)
    for r in range(3):
        row[3] -= axis[r] * view[r]
    return n + 1


@jit_in_place
def all_hidden(view: Floats, occluders: Occluders, cones: Cones) -> None:
    """Write the region that each occluder hides from a point."""
    facets, first, balls = occluders.facets, occluders.flat, occluders.balls
    for k in range(facets.shape[0]):
        index = k if k < first else k + balls.shape[0]
        cones.counts[index] = _behind_facet(facets[k], view, cones.spaces[index])
    for k in range(balls.shape[0]):
        cones.counts[first + k] = _behind_ball(balls[k], view, occluders.sides, cones.spaces[first + k])


@jit_in_place
def hidden_from_each(views: Floats, occluders: Occluders, cones: Cones) -> None:
    """Write the regions that are hidden from each of some points (n, 3)."""
    for q in range(views.shape[0]):
        all_hidden(views[q], occluders, Cones(cones.spaces[q], cones.counts[q]))


def room_for_cones(occluders: int, balls: int, sides: int, views: int) -> tuple[Cones, Cones]:
    """Return room for the regions that are hidden from one point, and from each of several.

    Parameters
    ----------
    occluders, balls : int
        Number of all occluders, and how many of them are spheres.
    sides : int
        Number of rows that `ring` returned.
    views : int
        Number of points.
    """
    depth = max(6, sides + 1 if balls else 0)
    return (
        Cones(np.empty((occluders, depth, 4)), np.zeros(occluders, dtype=np.int64)),
        Cones(np.empty((views, occluders, depth, 4)), np.zeros((views, occluders), dtype=np.int64)),
    )
