"""The sky that points of the wall see through small openings, which rays in all directions seldom meet.

The sky's light enters through the box around all surfaces. Where rays have found a way out, cells of that box are
summed over, as if they glowed: the share of the sky in what a point of the wall sees is

    sum over points of cells of A cos_w cos_c V / (pi d^2)

with V whether nothing is in between. So each point needs only that the rays of all of them together find an opening.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.transport.light.spread import shifted
from generator.transport.rays import Surfaces

Floats = NDArray[Any]
Numbers = NDArray[np.int64]

_SIDE = 32
"""Cells along a side of each face of the box."""
_SUM, _MOST = 1 << 14, 256
"""Points of all cells that are summed over, about, and at most of one."""
_NEAR = 0.5
"""Size of a cell, in units of its distance, above which rays tell its share."""
_BEYOND = 1.01
"""End of lines to the box, in units of their length: what lies in a face of the box is in their way."""


def through_openings(places: Floats, owner: Numbers, way: Floats, rays: int, surfaces: Surfaces) -> Floats:
    """Return the share (n,) of the sky in what points of the wall see.

    Parameters
    ----------
    places : ndarray of shape (n, 3)
        The points; the wall's normal is the third axis.
    owner, way : ndarray of shape (m,) and (m, 3)
        Of rays of cosine density that met nothing: their points, and their directions.
    rays : int
        Number of rays from each point, those that met something included.
    surfaces : Surfaces
        What may be in the way.
    """
    low, high = surfaces.box
    low, high = np.minimum(low, places.min(axis=0)), np.maximum(high, places.max(axis=0))
    left_by = _cell(places[owner], way, low, high)
    cells = _beside(left_by)
    corner, first, second, normal = _placed(cells, low, high)
    area = np.linalg.norm(np.cross(first, second), axis=1)
    size, middle = np.linalg.norm(first + second, axis=1), corner + (first + second) / 2.0
    count = int(np.clip(_SUM // len(cells), 1, _MOST))
    left = np.zeros((len(places), len(cells)))
    np.add.at(left, (owner, np.searchsorted(cells, left_by)), 1.0 / rays)
    share = np.empty(len(places))
    for k, place in enumerate(places):
        is_far = size < _NEAR * np.linalg.norm(middle - place, axis=1)
        far = np.flatnonzero(is_far)
        spread = shifted(count, 2, k * len(cells) + far)
        points = corner[far, None] + spread[..., :1] * first[far, None] + spread[..., 1:] * second[far, None]
        to = (points - place).reshape(-1, 3)
        facing = np.abs(np.take_along_axis(to, np.repeat(normal[far], count)[:, None], axis=1)[:, 0])
        light = to[:, 2] * facing / (np.pi * (to * to).sum(axis=1) ** 2) * np.repeat(area[far] / count, count)
        light[surfaces.blocked(np.tile(place, (len(to), 1)), place + _BEYOND * to)] = 0.0
        share[k] = light.sum() + left[k, ~is_far].sum()
    return share


def _cell(start: Floats, way: Floats, low: Floats, high: Floats) -> Numbers:
    """Return the cells (n,) of the box by which rays (n, 3) leave it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.where(way == 0.0, np.inf, (np.where(way > 0.0, high, low) - start) / way)
    axis = far.argmin(axis=1)
    at = (start + far.min(axis=1, keepdims=True) * way - low) / (high - low)
    inner = np.clip((at * _SIDE).astype(np.int64), 0, _SIDE - 1)
    row = np.arange(len(way))
    face = 2 * axis + (way[row, axis] > 0.0)
    cells: Numbers = (face * _SIDE + inner[row, (axis + 1) % 3]) * _SIDE + inner[row, (axis + 2) % 3]
    return cells


def _beside(cells: Numbers) -> Numbers:
    """Return cells of the box and those beside them on the same face, in order."""
    found = np.zeros((6, _SIDE + 2, _SIDE + 2), dtype=bool)
    face, i, j = np.unravel_index(cells, (6, _SIDE, _SIDE))
    for di in range(3):
        for dj in range(3):
            found[face, i + di, j + dj] = True
    return np.flatnonzero(found[:, 1:-1, 1:-1])


def _placed(cells: Numbers, low: Floats, high: Floats) -> tuple[Floats, Floats, Floats, Numbers]:
    """Return corners and edges (n, 3) of cells of the box, and the axes (n,) that they are normal to."""
    face, i, j = np.unravel_index(cells, (6, _SIDE, _SIDE))
    axis, row = face // 2, np.arange(len(cells))
    one, other = (axis + 1) % 3, (axis + 2) % 3
    step = (high - low) / _SIDE
    corner, first, second = np.tile(low, (len(cells), 1)), *np.zeros((2, len(cells), 3))
    corner[row, axis] = np.where(face % 2, high[axis], low[axis])
    corner[row, one] += i * step[one]
    corner[row, other] += j * step[other]
    first[row, one], second[row, other] = step[one], step[other]
    return corner, first, second, axis
