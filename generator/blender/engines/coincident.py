"""Finds coincident triangles: light meets only one of them, but a sum over surfaces would count both."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from generator.model.arrays import Array

_LEAF = 48
"""Largest number of triangles that are compared pairwise."""
_DEEP = 40
_PARALLEL = 1e-3
"""Largest angle between planes that count as one, radians."""
NEAR = 2e-6
"""A distance that counts as none, in units of the largest coordinate: the error of a plane in float32."""
_TOUCH = 1e-4
"""An overlap that counts as none, in units of the triangles' size: neighbours share an edge."""


def overlapping(triangles: Array) -> Array:
    """Return pairs of triangles that coincide, at least in part.

    Parameters
    ----------
    triangles : ndarray of shape (n, 3, 3)
        Corners; triangles without area coincide with none.

    Returns
    -------
    ndarray of shape (k, 2), int
        Indices of each pair once, the smaller first.
    """
    empty = np.zeros((0, 2), dtype=int)
    if len(triangles) < 2:
        return empty
    middle = triangles.reshape(-1, 3).mean(axis=0)
    size = float(np.abs(triangles).max())
    local = triangles - middle
    sides = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
    with np.errstate(invalid="ignore"):  # a triangle without area has no normal, and coincides with none
        normals = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    slack = NEAR * size
    low, high = local.min(axis=1) - slack, local.max(axis=1) + slack
    pair_lists = [empty]
    for group in _groups(low, high):
        a, b = (group[i] for i in np.triu_indices(len(group), 1))
        near = ((low[a] <= high[b]) & (low[b] <= high[a])).all(axis=1)
        a, b = a[near], b[near]
        parallel = np.linalg.norm(np.cross(normals[a], normals[b]), axis=1) < _PARALLEL
        a, b = a[parallel], b[parallel]
        apart = np.abs(((local[b] - local[a, :1]) * normals[a, None]).sum(axis=2)).max(axis=1)
        back = np.abs(((local[a] - local[b, :1]) * normals[b, None]).sum(axis=2)).max(axis=1)
        coplanar = np.minimum(apart, back) <= slack
        a, b = a[coplanar], b[coplanar]
        pair_lists.append(np.column_stack([a, b])[_cross(local[a], local[b], normals[a])])
    pairs: Array = np.unique(np.sort(np.concatenate(pair_lists), axis=1), axis=0)
    return pairs


def _groups(low: Array, high: Array) -> Iterator[Any]:
    """Split boxes into groups, so that any two boxes that meet share a group."""
    todo = [(np.arange(len(low)), 0)]
    while todo:
        group, depth = todo.pop()
        if len(group) <= _LEAF or depth == _DEEP:
            yield group
            continue
        centres = (low[group] + high[group]) / 2.0
        axis = int(np.ptp(centres, axis=0).argmax())
        cut = float(np.median(centres[:, axis]))
        below, above = group[low[group, axis] <= cut], group[high[group, axis] >= cut]
        # Boxes that straddle every cut are finally compared pairwise.
        next_depth = _DEEP if max(len(below), len(above)) > 0.95 * len(group) else depth + 1
        todo += [(below, next_depth), (above, next_depth)] if next_depth < _DEEP else [(group, _DEEP)]


def _cross(first: Array, second: Array, normals: Array) -> Array:
    """Whether coplanar triangles (k, 3, 3) overlap: no line along a side separates them (separating axes)."""
    overlap = np.ones(len(first), dtype=bool)
    for triangle in (first, second):
        for corner in range(3):
            side = triangle[:, corner] - triangle[:, corner - 1]
            across = np.cross(normals, side)
            across = across / np.linalg.norm(across, axis=1, keepdims=True)
            a, b = ((corners * across[:, None]).sum(axis=2) for corners in (first, second))
            shared = np.minimum(a.max(axis=1), b.max(axis=1)) - np.maximum(a.min(axis=1), b.min(axis=1))
            overlap &= shared > _TOUCH * np.minimum(np.ptp(a, axis=1), np.ptp(b, axis=1))
    return overlap
