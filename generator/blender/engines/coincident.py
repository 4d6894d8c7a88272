"""Finds triangles that lie on one another: light meets one of them, and a sum over surfaces would count both."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from generator.model.arrays import Array

_LEAF = 48
"""So many triangles are compared each with each."""
_DEEP = 40
_PARALLEL = 1e-3
"""Radians between planes that are one."""
_NEAR = 2e-6
"""A distance that is none, in units of the largest coordinate: what float32 leaves of a plane."""
_TOUCH = 1e-4
"""An overlap that is none, in units of the triangles: neighbours share an edge."""


def overlapping(triangles: Array) -> Array:
    """Return pairs of triangles that lie on one another, at least in part.

    Parameters
    ----------
    triangles : ndarray of shape (n, 3, 3)
        Corners; none without area.

    Returns
    -------
    ndarray of shape (k, 2), int
        Each pair once, the smaller number first.
    """
    empty = np.zeros((0, 2), dtype=int)
    if len(triangles) < 2:
        return empty
    middle = triangles.reshape(-1, 3).mean(axis=0)
    size = float(np.abs(triangles).max())
    local = triangles - middle
    sides = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
    with np.errstate(invalid="ignore"):  # a triangle without area has no normal, and lies on nothing
        normals = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    slack = _NEAR * size
    low, high = local.min(axis=1) - slack, local.max(axis=1) + slack
    found = [empty]
    for group in _groups(low, high):
        a, b = (group[i] for i in np.triu_indices(len(group), 1))
        near = ((low[a] <= high[b]) & (low[b] <= high[a])).all(axis=1)
        a, b = a[near], b[near]
        flat = np.linalg.norm(np.cross(normals[a], normals[b]), axis=1) < _PARALLEL
        a, b = a[flat], b[flat]
        apart = np.abs(((local[b] - local[a, :1]) * normals[a, None]).sum(axis=2)).max(axis=1)
        back = np.abs(((local[a] - local[b, :1]) * normals[b, None]).sum(axis=2)).max(axis=1)
        level = np.minimum(apart, back) <= slack
        a, b = a[level], b[level]
        found.append(np.column_stack([a, b])[_cross(local[a], local[b], normals[a])])
    pairs: Array = np.unique(np.sort(np.concatenate(found), axis=1), axis=0)
    return pairs


def _groups(low: Array, high: Array) -> Iterator[Any]:
    """Split boxes into groups such that any two that meet are together in one."""
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
        # What straddles every cut is compared each with each in the end.
        again = _DEEP if max(len(below), len(above)) > 0.95 * len(group) else depth + 1
        todo += [(below, again), (above, again)] if again < _DEEP else [(group, _DEEP)]


def _cross(first: Array, second: Array, normals: Array) -> Array:
    """Whether triangles (k, 3, 3) in common planes overlap: no line along a side parts them (separating axes)."""
    overlap = np.ones(len(first), dtype=bool)
    for one in (first, second):
        for corner in range(3):
            side = one[:, corner] - one[:, corner - 1]
            across = np.cross(normals, side)
            across = across / np.linalg.norm(across, axis=1, keepdims=True)
            a, b = ((each * across[:, None]).sum(axis=2) for each in (first, second))
            shared = np.minimum(a.max(axis=1), b.max(axis=1)) - np.maximum(a.min(axis=1), b.min(axis=1))
            overlap &= shared > _TOUCH * np.minimum(np.ptp(a, axis=1), np.ptp(b, axis=1))
    return overlap
