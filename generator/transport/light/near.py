"""Small cells on surfaces that a target is near: its shadow there is sharper than the room's cells are small.

Light that a target takes from a surface right behind it is seen by nobody, for the target hides it too. Cells that
reach beyond the target's edge would take it from what is seen. So cells are divided into four until they are small
for their distance from the target; where it touches a surface, along the line of contact.
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

_GAP = 1.0
"""Distance between target and surface below which cells are small, in units of the radius of the ball around it."""
_COARSEST, _FINEST = 1.0 / 4.0, 1.0 / 64.0
"""Most size of such a cell, and about the least, in units of that radius."""
_SHARP = 1.0 / 3.0
"""Size of a cell, in units of its distance from the target."""
_TOUCH = 1e-6
"""Distance at which they touch, in units of the radius."""
_CORNERS = ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0))
_FACES = 256
"""Faces of the target, the nearest to a surface, from which distances are taken."""


class Near(NamedTuple):
    """Small cells beside those of a room. Values of rays are summed over rows of a list of values,

    - those of the room's cells and the sky;
    - the same, of what is not in the small cells: the light of the empty room, and what varies slowly;
    - what is added to that in the small cells.

    Without small cells there is the first part only.

    Attributes
    ----------
    first : ndarray of shape (flat surfaces,), int
        Where in ``tree`` a surface's largest cells are, -1 if it has none.
    back : ndarray of shape (flat surfaces,), int
        Whether they are on its back.
    low, step : ndarray of shape (flat surfaces, 2)
        Where on its edges they begin, and how long they are, in units of the edges.
    number : ndarray of shape (flat surfaces, 2), int
        How many they are along the edges.
    tree : ndarray of shape (cells of all sizes,), int
        Where the four parts of each cell are; of an undivided one, -1 less its number.
    owner : ndarray of shape (n,), int
        Surface of each undivided cell.
    area, tint : ndarray of shape (n, 1) and (n, groups)
        Its area and albedo.
    rows : int
        Number of the room's cells and the sky.
    """

    first: Numbers
    back: Numbers
    low: Floats
    step: Floats
    number: Numbers
    tree: Numbers
    owner: Numbers
    area: Floats
    tint: Floats
    rows: int

    @property
    def there(self) -> bool:
        """Whether there are any."""
        return len(self.owner) > 0

    @property
    def length(self) -> int:
        """Length of a list of values."""
        return 2 * self.rows + len(self.owner) if self.there else self.rows

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
        at = (uv - self.low[which]) / self.step[which]
        inner = np.floor(at).astype(np.int64)
        inside = ((inner >= 0) & (inner < self.number[which])).all(axis=1)
        some, which, inner, at = some[inside], which[inside], inner[inside], (at - inner)[inside]
        corners, shares = (
            np.append(hits.corners, hits.corners[:, :1], axis=1),
            np.append(hits.shares, np.zeros((len(surface), 1)), axis=1),
        )
        corners[some] += self.rows
        entry = self.tree[self.first[which] + inner[:, 0] * self.number[which, 1] + inner[:, 1]]
        while (entry >= 0).any():
            half = at >= 0.5
            at = 2.0 * at - half
            entry = np.where(entry >= 0, self.tree[entry + 2 * half[:, 0] + half[:, 1]], entry)
        corners[some, 4] = 2 * self.rows - 1 - entry
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
    cells: Cells, surfaces: Surfaces, body: Surfaces, turn: Floats, place: Floats, ball: Floats, factor: float = 1.0
) -> Near:
    """Return the small cells near a target.

    Parameters
    ----------
    cells, surfaces : Cells, Surfaces
        Of the room.
    body : Surfaces
        Of the target, in its own frame.
    turn, place : ndarray of shape (3, 3) and (3,)
        Its pose.
    ball : ndarray of shape (4,)
        Centre and radius of the ball around it, where it is.
    factor : float, default=1
        How much larger than usual the small cells are.
    """
    n, centre, radius = len(surfaces.origin), ball[:3], ball[3]
    first, number = np.full(n, -1), np.zeros((n, 2), dtype=np.int64)
    low, step = np.zeros((n, 2)), np.ones((n, 2))
    edges = np.stack([surfaces.first, surfaces.second], axis=1)
    long = np.linalg.norm(edges, axis=2)
    is_behind = ((centre - surfaces.origin) * surfaces.normal).sum(axis=1) < 0.0
    toward = np.where(is_behind, -1.0, 1.0)[:, None] * surfaces.normal
    gap = np.maximum(_lowest(body, toward @ turn) + toward @ place - (toward * surfaces.origin).sum(axis=1), 0.0)
    foot = np.einsum("nij,nj->ni", surfaces.dual, centre - surfaces.origin)
    # Along slanted edges a circle reaches further.
    slant = surfaces.area / (long.prod(axis=1) * np.where(surfaces.triangle, 0.5, 1.0))
    reach = (radius + gap)[:, None] / long / slant[:, None]
    lowest, highest = np.clip(foot - reach, 0.0, 1.0), np.clip(foot + reach, 0.0, 1.0)
    count = np.ceil((highest - lowest) * long / (factor * _COARSEST * radius)).astype(np.int64)
    tree, owner, area = np.zeros(0, dtype=np.int64), [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    leaves = 0
    for i in np.flatnonzero((gap < _GAP * radius) & ~surfaces.triangle & (count > 0).all(axis=1)):
        first[i], number[i], low[i] = len(tree), count[i], lowest[i]
        step[i] = (highest[i] - lowest[i]) / count[i]
        corner = (surfaces.origin[i] + low[i] @ edges[i] - place) @ turn
        faces = _nearest(body, toward[i] @ turn)
        grown, level = _divided(faces, corner, (step[i, :, None] * edges[i]) @ turn, count[i], radius, factor)
        undivided = grown < 0
        tree = np.append(tree, np.where(undivided, -leaves - np.cumsum(undivided), grown + len(tree)))
        part = surfaces.area[i] * step[i].prod() * 0.25 ** level[undivided]
        owner.append(np.full(len(part), i))
        area.append(part)
        leaves += len(part)
    rows = cells.count + 1
    owners, areas = np.concatenate(owner), np.concatenate(area)[:, None]
    tint = surfaces.tint[owners]
    return Near(first, is_behind.astype(np.int64), low, step, number, tree, owners, areas, tint, rows)


def _lowest(body: Surfaces, up: Floats) -> Floats:
    """Return the least height (n,) of a target's places in directions (n, 3), unit vectors."""
    ends = [np.concatenate(body.corners()) @ up.T, (body.spheres[:, :3] @ up.T) - body.spheres[:, 3:]]
    lowest: Floats = np.concatenate(ends).min(axis=0)
    return lowest


def _nearest(body: Surfaces, up: Floats) -> Surfaces:
    """Return the faces of a target that are lowest in a direction (3,), if it has many."""
    if len(body.origin) <= _FACES:
        return body
    low = body.origin @ up + np.minimum(body.first @ up, 0.0) + np.minimum(body.second @ up, 0.0)
    return body.subset(low <= np.partition(low, _FACES)[_FACES])


def _divided(
    body: Surfaces, corner: Floats, edges: Floats, count: Numbers, radius: float, factor: float
) -> tuple[Numbers, Numbers]:
    """Divide cells into four until they are small for their distance from a target.

    Parameters
    ----------
    body : Surfaces
        Of the target.
    corner, edges : ndarray of shape (3,) and (2, 3)
        Corner of the first of the largest cells, and its edges.
    count : ndarray of shape (2,), int
        Number of largest cells along both.
    radius : float
        Of the ball around the target.
    factor : float
        As for `near_cells`.

    Returns
    -------
    tree : ndarray of shape (n,), int
        Where the four parts of each cell are, -1 of undivided ones.
    level : ndarray of shape (n,), int
        How often a cell was halved.
    """
    low: Floats = np.stack(np.divmod(np.arange(count.prod()), count[1]), axis=1).astype(float)
    size, total = 1.0, 0
    trees: list[Numbers] = []
    levels: list[Numbers] = []
    long = float(np.linalg.norm(edges, axis=1).max())
    while len(low):
        gap = body.distance(corner + (low + 0.5 * size) @ edges)
        large = (size * long > factor * _FINEST * radius) & (size * long > factor * _SHARP * (gap - size * long))
        # Where the target lies on the surface with a face, no light is.
        inside = np.flatnonzero(large & (gap < _TOUCH * radius))
        ends = [body.distance(corner + (low[inside] + size * np.array(end)) @ edges) for end in _CORNERS]
        large[inside[np.max(ends, axis=0) < _TOUCH * radius]] = False
        total += len(low)
        trees.append(np.where(large, total + 4 * (np.cumsum(large) - 1), -1))
        levels.append(np.full(len(low), len(levels)))
        size *= 0.5
        low = (low[large, None] + size * np.array(_CORNERS)).reshape(-1, 2)
    return np.concatenate(trees), np.concatenate(levels)


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
    u, v = (u - near.low[i, 0]) / near.step[i, 0], (v - near.low[i, 1]) / near.step[i, 1]
    a, b = math.floor(u), math.floor(v)
    if (1 if cosine > 0.0 else 0) != near.back[i]:
        return
    if a < 0 or b < 0 or a >= near.number[i, 0] or b >= near.number[i, 1]:
        return
    for c in range(4):
        corners[c] += near.rows
    u, v = u - a, v - b
    entry = near.tree[near.first[i] + a * near.number[i, 1] + b]
    while entry >= 0:
        u, v = 2.0 * u, 2.0 * v
        if u >= 1.0:
            u -= 1.0
            entry += 2
        if v >= 1.0:
            v -= 1.0
            entry += 1
        entry = near.tree[entry]
    corners[4], shares[4] = 2 * near.rows - 1 - entry, 1.0
