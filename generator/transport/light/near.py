"""Small cells on surfaces that a target is near: its shadow there is sharper than the room's cells are small.

Light that a target takes from a surface right behind it is seen by nobody, for the target hides it too. Cells that
reach beyond the target's edge would take it from what is seen.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport.compiled import jit_in_place
from generator.transport.light.cells import Cells, Hits
from generator.transport.rays import Planes, Surfaces

Floats = NDArray[Any]
Numbers = NDArray[np.int64]

_GAP, _FINEST = 1.0, 1.0 / 24.0
"""Distance between target and surface below which cells are small, and their least size, in units of the radius of
the ball around the target."""
_SHARP = 1.0 / 3.0
"""Size of such a cell, in units of that distance."""


class Near(NamedTuple):
    """Small cells beside those of a room. Values of rays are summed over rows of a list of values,

    - those of the room's cells and the sky;
    - the same, of what is not in the small cells: the light of the empty room, and what varies slowly;
    - what is added to that in the small cells.

    Without small cells there is the first part only.

    Attributes
    ----------
    first : ndarray of shape (flat surfaces,), int
        Where a surface's small cells begin, -1 if it has none.
    back : ndarray of shape (flat surfaces,), int
        Whether they are on its back.
    low, step : ndarray of shape (flat surfaces, 2)
        Where on its edges they begin, and how long they are, in units of the edges.
    number : ndarray of shape (flat surfaces, 2), int
        How many they are along the edges.
    owner : ndarray of shape (n,), int
        Surface of each.
    rows : int
        Number of the room's cells and the sky.
    """

    first: Numbers
    back: Numbers
    low: Floats
    step: Floats
    number: Numbers
    owner: Numbers
    rows: int

    @property
    def there(self) -> bool:
        """Whether there are any."""
        return len(self.owner) > 0

    @property
    def length(self) -> int:
        """Length of a list of values."""
        return 2 * self.rows + len(self.owner) if self.there else self.rows

    def area(self, surfaces: Surfaces) -> Floats:
        """Return the area of each, (n, 1)."""
        size: Floats = (surfaces.area * self.step.prod(axis=1))[self.owner, None]
        return size

    def marked(self, hits: Hits, start: Floats, way: Floats, cells: Cells) -> Hits:
        """Return what rays (n, 3) meet with five places each: those of `Hits`, and that of a small cell."""
        if not self.there:
            return hits
        surface, back = cells.sides(hits.cell)
        some = np.flatnonzero(surface >= 0)
        some = some[(self.first[surface[some]] >= 0) & (self.back[surface[some]] == back[some])]
        which, planes = surface[some], cells.grid.planes
        offset = start[some] + hits.far[some, None] * way[some] - planes.origin[which]
        uv = np.einsum("nij,nj->ni", planes.dual[which], offset)
        inner = np.floor((uv - self.low[which]) / self.step[which]).astype(np.int64)
        inside = ((inner >= 0) & (inner < self.number[which])).all(axis=1)
        some, which, inner = some[inside], which[inside], inner[inside]
        corners, shares = (
            np.append(hits.corners, hits.corners[:, :1], axis=1),
            np.append(hits.shares, np.zeros((len(surface), 1)), axis=1),
        )
        corners[some] += self.rows
        corners[some, 4] = 2 * self.rows + self.first[which] + inner[:, 0] * self.number[which, 1] + inner[:, 1]
        shares[some, 4] = 1.0
        return Hits(hits.cell, hits.far, corners, shares)

    def joined(self, usual: Floats, change: Floats, even: Floats, small: Floats) -> Floats:
        """Return the list of values of the room's cells and the sky.

        Parameters
        ----------
        usual, change : ndarray of shape (rows, columns)
            Light of the empty room, and its change.
        even : ndarray of shape (rows, columns)
            That part of the change which varies slowly.
        small : ndarray of shape (n, columns)
            The other part in the small cells.
        """
        return np.concatenate([usual + change, usual + even, small]) if self.there else usual + change

    def parted(self, values: Floats) -> tuple[Floats, Floats]:
        """Return what a list of values that were summed has for the room's cells, (cells, columns), and the small."""
        cells = self.rows - 1
        if not self.there:
            return values[:cells], values[:0]
        return values[:cells] + values[self.rows : self.rows + cells], values[2 * self.rows :]


def near_cells(
    cells: Cells, surfaces: Surfaces, centre: Floats, radius: float, corners: Floats, balls: Floats
) -> Near:
    """Return the small cells near a target.

    Parameters
    ----------
    cells, surfaces : Cells, Surfaces
        Of the room.
    centre : ndarray of shape (3,)
        Of the ball around the target.
    radius : float
    corners, balls : ndarray of shape (n, 3) and (m, 4)
        Corners of the target, and its spheres, where they are.
    """
    n = len(surfaces.origin)
    first, number = np.full(n, -1), np.zeros((n, 2), dtype=np.int64)
    low, step = np.zeros((n, 2)), np.ones((n, 2))
    long = np.stack([np.linalg.norm(surfaces.first, axis=1), np.linalg.norm(surfaces.second, axis=1)], axis=1)
    is_behind = ((centre - surfaces.origin) * surfaces.normal).sum(axis=1) < 0.0
    toward = np.where(is_behind, -1.0, 1.0)[:, None] * surfaces.normal
    level = (toward * surfaces.origin).sum(axis=1)
    ends = [toward @ corners.T - level[:, None], toward @ balls[:, :3].T - balls[:, 3] - level[:, None]]
    gap = np.maximum(np.concatenate(ends, axis=1).min(axis=1, initial=np.inf), 0.0)
    foot = np.einsum("nij,nj->ni", surfaces.dual, centre - surfaces.origin)
    reach = (radius + gap)[:, None] / long
    size = np.maximum(_FINEST * radius, _SHARP * gap)[:, None] / long
    # Along slanted edges a circle reaches further.
    slant = surfaces.area / (long.prod(axis=1) * np.where(surfaces.triangle, 0.5, 1.0))
    reach /= slant[:, None]
    lowest, highest = np.clip(foot - reach, 0.0, 1.0), np.clip(foot + reach, 0.0, 1.0)
    count = np.ceil((highest - lowest) / size).astype(np.int64)
    start, owner = 0, []
    for i in np.flatnonzero((gap < _GAP * radius) & ~surfaces.triangle & (count > 0).all(axis=1)):
        first[i], number[i], low[i] = start, count[i], lowest[i]
        step[i] = (highest[i] - lowest[i]) / count[i]
        owner.append(np.full(count[i].prod(), i))
        start += int(count[i].prod())
    owners = np.concatenate([np.zeros(0, dtype=np.int64), *owner])
    return Near(first, is_behind.astype(np.int64), low, step, number, owners, cells.count + 1)


@jit_in_place
def mark(
    start: Floats, way: Floats, i: int, far: float, planes: Planes, near: Near, corners: Numbers, shares: Floats
) -> None:
    """As `Near.marked`, for what a ray meets on flat surface ``i``; places (5,) and shares (5,) are written."""
    shares[4] = 0.0
    if near.first[i] < 0:
        return
    u, v, cosine = 0.0, 0.0, 0.0
    for r in range(3):
        offset = start[r] + far * way[r] - planes.origin[i, r]
        u += planes.dual[i, 0, r] * offset
        v += planes.dual[i, 1, r] * offset
        cosine += way[r] * planes.normal[i, r]
    a, b = math.floor((u - near.low[i, 0]) / near.step[i, 0]), math.floor((v - near.low[i, 1]) / near.step[i, 1])
    if (1 if cosine > 0.0 else 0) != near.back[i]:
        return
    if a < 0 or b < 0 or a >= near.number[i, 0] or b >= near.number[i, 1]:
        return
    for c in range(4):
        corners[c] += near.rows
    corners[4], shares[4] = 2 * near.rows + near.first[i] + a * near.number[i, 1] + b, 1.0
