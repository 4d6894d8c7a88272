"""What hides points: cones over facets and balls."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.transport import elements
from generator.transport.compiled import jit
from generator.transport.polygons import FACET, lay
from generator.transport.rays import Surfaces

Floats = NDArray[Any]


TOUCH = 1e-9


Cones = tuple[Floats, Floats]
"""What each occluder hides from a point: half-spaces (occluders, k, 4), n . y + c >= 0, and how many of them
(occluders,), 0 if it hides nothing. The target's flat cells come first, then its spheres, then the room."""


Occluders = tuple[Floats, int, Floats, Floats]
"""Facets (n, FACET), how many of them are the target's, spheres (s, 4), and the sides of a sphere's outline."""


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


@jit
def _behind_facet(facet: Floats, view: Floats, spaces: Floats) -> int:
    """Write the half-spaces of what a facet hides from a point; return how many, or 0."""
    level = facet[9] * view[0] + facet[10] * view[1] + facet[11] * view[2] - facet[12]
    # Of a solid, the far side hides nothing that the near side does not.
    if abs(level) < TOUCH or (facet[34] == 1.0 and level < 0.0):
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
    row[0], row[1], row[2], row[3] = -side * facet[9], -side * facet[10], -side * facet[11], side * facet[12] - TOUCH
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
def all_hidden(view: Floats, occluders: Occluders, cones: Cones) -> None:
    """Write what each occluder hides from a point."""
    every, first, balls, sides = occluders
    spaces, counts = cones
    for k in range(every.shape[0]):
        at = k if k < first else k + balls.shape[0]
        counts[at] = _behind_facet(every[k], view, spaces[at])
    for k in range(balls.shape[0]):
        counts[first + k] = _behind_ball(balls[k], view, sides, spaces[first + k])


@jit
def no_cones(occluders: Occluders) -> Cones:
    """Return room for what is hidden from a point."""
    every, _, balls, sides = occluders
    depth = max(6, sides.shape[0] + 1 if balls.shape[0] else 0)
    number = every.shape[0] + balls.shape[0]
    return np.empty((number, depth, 4)), np.zeros(number, dtype=np.int64)


@jit
def hidden_from_nodes(nodes: Floats, occluders: Occluders) -> tuple[Floats, Floats]:
    """Return cones from each point of the patch: (nodes, occluders, k, 4) and (nodes, occluders)."""
    spaces, counts = no_cones(occluders)
    every = np.empty((nodes.shape[1], *spaces.shape))
    numbers = np.empty((nodes.shape[1], counts.shape[0]), dtype=np.int64)
    view = np.zeros(3)
    for q in range(nodes.shape[1]):
        view[0], view[1] = nodes[0, q], nodes[1, q]
        all_hidden(view, occluders, (every[q], numbers[q]))
    return every, numbers
