"""Flat faces of a target, whose light on the wall ends where their planes meet it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.transport.elements import FIRST, LOW, ORIGIN, SECOND, SIDED
from generator.transport.integral import BACK, FRONT, ON
from generator.transport.lit import Patch
from generator.transport.picture import Parts

Floats = NDArray[Any]

_MOST = 12
"""Most faces of a target: with more, each contributes too little to the picture to be drawn separately."""
_COPLANAR = 1e-9
_CORNERS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 1.0]])


class Faces:
    """Faces, each the cells in one plane, and where their planes cross the picture.

    Parameters
    ----------
    flat : ndarray of shape (n, WIDTH)
        Flat cells, in the target's frame.
    balls : int
        Number of spheres; with any, or with too many planes, all cells are one face that is never drawn separately.
    to_wall : ndarray of shape (3, 3)
    patch : lit.Patch

    Attributes
    ----------
    of : ndarray of shape (n + balls,), int
        Index of the face that each cell is in.
    """

    def __init__(self, flat: Floats, balls: int, to_wall: Floats, patch: Patch) -> None:
        self._to_wall = to_wall * np.sign(to_wall[2] @ [0.5, 0.5, 1.0])
        self._patch = patch
        self.of = np.zeros(len(flat) + balls, dtype=np.int64)
        planes = [] if balls else _planes(flat, self.of)
        self._normals, self._levels = np.array([p[:3] for p in planes]), np.array([p[3] for p in planes])
        self._one_sided = [bool(p[4]) for p in planes]

    def parts(self, turns: Floats, places: Floats) -> tuple[Parts, Floats]:
        """Return the parts whose sums are the pictures of poses.

        A side of a face whose plane crosses the picture is a separate part, if light falls on it; everything else is
        one part.

        Parameters
        ----------
        turns, places : ndarray of shape (n, 3, 3) and (n, 3)

        Returns
        -------
        parts : Parts
        wanted : ndarray of shape (parts, faces), int
            As in `records.Parts`.
        """
        faces = max(1, len(self._levels))
        rest = np.full((len(places), faces), FRONT | BACK)
        entries = [(k, np.array([0.0, 0.0, 1.0]), rest[k]) for k in range(len(places))]
        centre, major, minor = self._patch.centre, self._patch.major, self._patch.minor
        for f in range(len(self._levels)):
            normal = turns @ self._normals[f]
            level = self._levels[f] + (normal * places).sum(axis=1)
            # Height above the plane, times something positive: linear in u and v.
            line = np.column_stack([normal[:, :2], -level]) @ self._to_wall
            corners = line @ _CORNERS.T
            lit, reach = normal[:, :2] @ centre - level, np.hypot(normal[:, :2] @ major, normal[:, :2] @ minor)
            for k in np.flatnonzero((corners.min(axis=1) < 0.0) & (corners.max(axis=1) > 0.0)):
                rest[k, f] = 0
                for side, sign in ((FRONT, 1.0), (BACK, -1.0))[: 1 if self._one_sided[f] else 2]:
                    if sign * lit[k] > -reach[k]:
                        sides = np.zeros(faces, dtype=np.int64)
                        sides[f] = side | ON
                        entries.append((int(k), sign * line[k], sides))
        entries = [part for part in entries if part[2].any()]
        pictures = np.array([part[0] for part in entries], dtype=np.int64)
        lines = np.array([part[1] for part in entries]).reshape(-1, 3)
        return Parts(pictures, lines), np.array([part[2] for part in entries], dtype=np.int64).reshape(-1, faces)


def _planes(flat: Floats, of: Floats) -> list[Floats]:
    """Return planes (normal (3), level, one-sided), and write each cell's index into ``of``; none if too many."""
    origin, first, second = flat[:, ORIGIN:FIRST], flat[:, FIRST:SECOND], flat[:, SECOND:LOW]
    normal = np.cross(first, second)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rows = np.column_stack([normal, (normal * origin).sum(axis=1), flat[:, SIDED]])
    size = np.abs(flat[:, ORIGIN:LOW]).max()
    slack = _COPLANAR * np.array([1.0, 1.0, 1.0, size, 1.0])
    planes: list[Floats] = []
    for k, row in enumerate(rows):
        same = [f for f, plane in enumerate(planes) if (np.abs(row - plane) <= slack).all()]
        if not same and len(planes) == _MOST:
            of[:] = 0
            return []
        of[k] = same[0] if same else len(planes)
        if not same:
            planes.append(row)
    return planes
