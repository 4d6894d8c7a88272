"""Surfaces cut into cells, over which light is taken as constant or interpolated, and what rays meet of them."""

from __future__ import annotations

import copy
import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport.compiled import COMPILED, jit_in_place, jit_released
from generator.transport.light.spread import hemisphere
from generator.transport.rays import Planes, Surfaces, nearest

Floats = NDArray[Any]
Numbers = NDArray[np.int64]

_NEAR = 1e-6
_TOUCH = 1e-6
"""Distance from a plane, in units of the scene, within which a corner lies on it."""
_GAP = 0.3
"""Distance between surfaces, in units of the smaller one's shorter side, within which it counts as touching the
larger one: light between them does not leave along the way that light beside them does."""
_BENEATH, _HALVINGS = 0.4, 6
"""Size of a cell, in units of its distance from a lamp; and how often cells are halved for that, at most."""
_SLIVER = 1e-4
"""Width, in units of a surface, below which no cell is made."""
_BINS = 256
"""Equal parts of an edge, which tell where to look for a cell; a power of two, by which products are exact."""


class Hits(NamedTuple):
    """What rays meet first.

    Attributes
    ----------
    cell : ndarray of shape (n,), int
        Cell that each ray meets; the number of cells where it meets none.
    far : ndarray of shape (n,)
        Distance; infinite where a ray meets nothing.
    corners, shares : ndarray of shape (n, 4) or (n, 5)
        Four cells and their weights, which interpolate between the cells' middles; and another, if any (`near.Near`).
    """

    cell: Numbers
    far: Floats
    corners: Numbers
    shares: Floats

    def of(self, values: Floats) -> Floats:
        """Interpolate cells' values (cells + 1, columns) for each ray, (n, columns)."""
        return interpolated(values, self.corners, self.shares)

    def spread(self, values: Floats, count: int) -> Floats:
        """Sum values (n, columns) of rays over the cells between which `of` interpolates, (count, columns)."""
        return deposited(values, self.corners, self.shares, count)


class _Axis(NamedTuple):
    """Cells along one edge of all surfaces, one surface after the other.

    Attributes
    ----------
    low, high : ndarray of shape (n,)
        Ends of each, in units of the edge.
    piece : ndarray of shape (n,), int
        Number of the part of the edge that each is in: values are not interpolated from one part to another.
    first, cells : ndarray of shape (surfaces,), int
        Where a surface's cells begin, and how many they are.
    bins : ndarray of shape (surfaces, m), int
        The cells that m equal parts of each edge begin in.
    middle : ndarray of shape (n,)
    pair : ndarray of shape (2 * n, 2), int
        For the lower and the upper half of each cell, the two cells between whose middles values are interpolated,
        counted from the surface's first one.
    base, slope : ndarray of shape (2 * n,)
        The weight of the second is ``slope`` times the distance from ``base``.
    """

    low: Floats
    high: Floats
    piece: Numbers
    first: Numbers
    cells: Numbers
    bins: Numbers
    middle: Floats
    pair: Numbers
    base: Floats
    slope: Floats


class Grid(NamedTuple):
    """Cells of surfaces, as compiled functions take them.

    Attributes
    ----------
    planes : Planes
        The flat surfaces.
    along, across : _Axis
        Cells along their edges.
    start : ndarray of shape (2, surfaces), int
        The first cell of each flat surface's front, and of its back.
    row, step : ndarray of shape (2, surfaces), int
        How many numbers on the next cell is along and across; 0 for a side all of which has one number.
    flat : int
        Number of cells of flat surfaces; those of spheres follow.
    spheres : ndarray of shape (spheres, 4)
    bands : int
        Bands of a sphere's cells, of equal height; each has twice as many cells.
    """

    planes: Planes
    along: _Axis
    across: _Axis
    start: Numbers
    row: Numbers
    step: Numbers
    flat: int
    spheres: Floats
    bands: int


class Spots(NamedTuple):
    """Points that give light.

    Attributes
    ----------
    places, normals : ndarray of shape (n, 3)
        Of surfaces that glow; normals are zero for lamps without extent.
    least : ndarray of shape (n,)
        Distance below which their light is as even as there.
    """

    places: Floats
    normals: Floats
    least: Floats

    def near(self, surfaces: Surfaces) -> Floats:
        """Return the distance (n, flat surfaces) of each from each surface's plane; infinite where it sends none."""
        height = np.abs((self.places[:, None] - surfaces.origin) @ surfaces.normal.T).diagonal(axis1=1, axis2=2)
        ahead = np.stack(
            [((c - self.places[:, None]) * self.normals[:, None]).sum(axis=2) for c in _corners(surfaces)]
        )
        sends = (ahead > _TOUCH).any(axis=0) | ~self.normals.any(axis=1, keepdims=True)
        return np.where(sends, np.maximum(height, self.least[:, None]), np.inf)


def _corners(surfaces: Surfaces) -> list[Floats]:
    one, other = surfaces.origin + surfaces.first, surfaces.origin + surfaces.second
    return [surfaces.origin, one, other, np.where(surfaces.triangle[:, None], other, one + surfaces.second)]


class Cells:
    """Surfaces cut into cells, each side of a flat one separately: small near a place, larger away from it.

    Where another surface touches a surface along one of its own directions, cells end: on both sides of a screen that
    stands on a floor, the floor's light differs.

    Parameters
    ----------
    surfaces : Surfaces
    size : float
        Size of a cell, in units of its distance from the place, which counts as ``least`` where it is smaller.
    place : ndarray of shape (3,)
    least : float
    ball_tint : ndarray of shape (spheres, groups)
        Albedo of the spheres; that of flat surfaces is in ``surfaces``.
    spots : Spots, optional
        Points of lamps and of surfaces that glow, near which cells are smaller.

    Attributes
    ----------
    count : int
    tint : ndarray of shape (cells, groups)
        Albedo of each cell.
    area : ndarray of shape (cells,)
    grid : Grid
    """

    def __init__(
        self,
        surfaces: Surfaces,
        size: float,
        place: Floats,
        least: float,
        ball_tint: Floats,
        spots: Spots | None = None,
    ) -> None:
        self._surfaces = surfaces
        n = len(surfaces.origin)
        edges = np.stack([surfaces.first, surfaces.second], axis=1)
        long = np.linalg.norm(edges, axis=2)
        offsets = place - surfaces.origin
        foot = (surfaces.dual * offsets[:, None]).sum(axis=2) * long
        centres = surfaces.origin + edges.sum(axis=1) / 3.0
        triangle = surfaces.triangle  # cells of one size, since they are mapped by area, not along the edges
        distance = np.abs((offsets * surfaces.normal).sum(axis=1))
        away = np.maximum(least, np.where(triangle, np.linalg.norm(centres - place, axis=1), distance))
        foot = np.where(triangle[:, None], 0.5 * long, foot)
        axes = []
        breaks = _breaks(surfaces)
        for axis in range(2):
            cut = [_cut(breaks[i][axis], long[i, axis], foot[i, axis], away[i], size) for i in range(n)]
            if spots is not None:
                near = spots.near(surfaces)
                under = np.einsum("sic,ic->si", spots.places[:, None] - surfaces.origin, surfaces.dual[:, axis])
                cut = [_finer(*cut[i], long[i, axis], under[:, i] * long[i, axis], near[:, i]) for i in range(n)]
            axes.append(_joined(cut))
        self._bands = max(2, math.ceil(2.0 / size))
        self._ball = 2 * self._bands**2
        self._axes, self._ball_tint = axes, ball_tint
        self._number(np.ones((2, n), dtype=bool))

    def _number(self, kept: NDArray[np.bool_]) -> None:
        """Number the cells of the sides (2, flat surfaces) that are kept; those of all others have one number."""
        surfaces, (along, across) = self._surfaces, self._axes
        each = np.where(kept, along.cells * across.cells, 0)
        self._dark = int(each.sum())
        start = np.where(kept, np.cumsum(each).reshape(each.shape) - each, self._dark)
        side = np.append(np.repeat(np.arange(kept.size), each.ravel()), np.flatnonzero(~kept)[:1])
        self._back, self._owner = np.divmod(side, max(1, len(surfaces.origin)))
        self._inner = np.arange(len(side)) - start.ravel()[side]
        row, step = np.where(kept, across.cells, 0), kept.astype(np.int64)
        self.grid = Grid(surfaces.planes, along, across, start, row, step, len(side), surfaces.spheres, self._bands)
        self.count = len(side) + self._ball * len(surfaces.spheres)
        tint = surfaces.tint[self._owner]
        tint[self._dark :] = 0.0
        self.tint = np.concatenate([tint, np.repeat(self._ball_tint, self._ball, axis=0)])
        low, high = self._ends(np.arange(self.grid.flat))
        flat_area = (high - low).prod(axis=1) * surfaces.area[self._owner]
        ball_area = np.repeat(4.0 * math.pi * surfaces.spheres[:, 3] ** 2 / self._ball, self._ball)
        self.area = np.concatenate([flat_area, ball_area])

    def only(self, used: NDArray[np.bool_]) -> tuple[Cells, Numbers]:
        """Return the cells of those sides of surfaces of which some cell is used, and spheres'.

        Parameters
        ----------
        used : ndarray of shape (cells,), bool

        Returns
        -------
        cells : Cells
            The last one of flat surfaces, black, stands for all those of other sides.
        old : ndarray of shape (new cells,), int
            Number that each had.
        """
        cells = copy.copy(self)
        kept = np.zeros(self.grid.start.shape, dtype=bool)
        flat = np.flatnonzero(used[: self.grid.flat])
        kept[self._back[flat], self._owner[flat]] = True
        cells._number(kept)
        old = self.grid.start[cells._back, cells._owner] + cells._inner
        return cells, np.concatenate([old, np.arange(self.grid.flat, self.count)])

    @property
    def few(self) -> bool:
        """Whether rays are tested against the surfaces one by one."""
        return self._surfaces.few

    def _ends(self, cells: Numbers) -> tuple[Floats, Floats]:
        """Return the lowest and highest (u, v), (n, 2) each, of cells of flat surfaces."""
        grid, which = self.grid, self._owner[cells]
        i, j = np.divmod(self._inner[cells], np.maximum(grid.across.cells[which], 1))
        i, j = i + grid.along.first[which], j + grid.across.first[which]
        low = np.stack([grid.along.low[i], grid.across.low[j]], axis=1)
        return low, np.stack([grid.along.high[i], grid.across.high[j]], axis=1)

    def sides(self, cells: Numbers) -> tuple[Numbers, Numbers]:
        """Return the flat surface that cells (n,) are of, -1 for others, and whether of its back."""
        flat = cells < self._dark
        some = np.where(flat, cells, 0)
        if not self._dark:
            return np.full(len(cells), -1), some
        return np.where(flat, self._owner[some], -1), self._back[some]

    def blocks(self, side: int) -> Numbers:
        """Return for each cell (cells,) the number of the coarse cell that it is in, of ``side`` by ``side`` of one
        side."""
        grid, which = self.grid, self._owner
        i, j = np.divmod(self._inner, np.maximum(grid.across.cells[which], 1))
        piece = grid.along.piece[i + grid.along.first[which]], grid.across.piece[j + grid.across.first[which]]
        keys = np.stack([self._back, which, *piece, i // side, j // side], axis=1)
        keys[self._dark :] = -1
        _, block = np.unique(keys, axis=0, return_inverse=True)
        block = block.reshape(-1)
        flat = int(block.max(initial=-1)) + 1
        return np.concatenate([block, flat + np.arange(self.count - grid.flat)])

    def meet(self, start: Floats, way: Floats) -> Hits:
        """Follow rays (n, 3) of unit length to the first surface."""
        surfaces, n = self._surfaces, len(start)
        if COMPILED and surfaces.few:
            return Hits(*_meet(start, way, self.grid))
        cell, far = np.full(n, self.count), np.full(n, np.inf)
        corners, shares = np.full((n, 4), self.count), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
        if len(surfaces.origin):
            which, far = surfaces.first_hit(start, way)
            _locate(start, way, which, far, self.grid, cell, corners, shares)
        for number, ball in enumerate(surfaces.spheres):
            offset = start - ball[:3]
            along, beyond = _dot(offset, way), _dot(offset, offset) - ball[3] ** 2
            discriminant = along**2 - beyond
            enters = -along - np.sqrt(np.maximum(discriminant, 0.0))
            met = (discriminant > 0.0) & (enters > _NEAR * ball[3]) & (enters < far)
            outward = (offset[met] + enters[met, None] * way[met]) / ball[3]
            far[met], cell[met] = enters[met], self._round(number, outward)
            corners[met], shares[met] = cell[met, None], [1.0, 0.0, 0.0, 0.0]
        return Hits(cell, far, corners, shares)

    def _round(self, number: int, outward: Floats) -> Numbers:
        """Return the cells of a sphere at unit vectors (n, 3): bands of equal height, and twice as many meridians."""
        bands = self._bands
        band = np.clip(((outward[:, 2] + 1.0) / 2.0 * bands).astype(np.int64), 0, bands - 1)
        turn = np.arctan2(outward[:, 1], outward[:, 0]) / (2.0 * math.pi) % 1.0
        meridian = np.minimum((turn * 2 * bands).astype(np.int64), 2 * bands - 1)
        cells: Numbers = self.grid.flat + number * self._ball + band * 2 * bands + meridian
        return cells

    def places(self, cells: Numbers, spread: Floats) -> tuple[Floats, Floats]:
        """Return places in cells (n,) and the normals there, (n, 3) each, for points (n, 2) of the unit square."""
        surfaces = self._surfaces
        points, normals = np.zeros((2, len(cells), 3))
        flat = cells < self.grid.flat
        some = cells[flat]
        low, high = self._ends(some)
        points[flat] = surfaces.at(self._owner[some], low + spread[flat] * (high - low))
        normals[flat] = np.where(self._back[some, None] > 0, -1.0, 1.0) * surfaces.normal[self._owner[some]]
        number, inner = np.divmod(cells[~flat] - self.grid.flat, self._ball)
        step = np.stack(np.divmod(inner, 2 * self._bands), axis=1) + spread[~flat]
        z, angle = 2.0 * step[:, 0] / self._bands - 1.0, math.pi * step[:, 1] / self._bands
        ring = np.sqrt(np.maximum(0.0, 1.0 - z**2))
        outward = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
        balls = surfaces.spheres[number]
        points[~flat], normals[~flat] = balls[:, :3] + balls[:, 3:] * outward, outward
        return points, normals

    def fans(self, cells: Numbers, points: Floats, shifts: Floats) -> tuple[Floats, Floats]:
        """Return rays (cells * k, 3) from places in cells (n,), where they start and their directions, about normals.

        Parameters
        ----------
        cells : ndarray of shape (n,), int
        points : ndarray of shape (k, 4)
            Points of the unit cube: two numbers for a direction of cosine density, and two for a place.
        shifts : ndarray of shape (n, 4)
            By how much each cell's points are moved, over the cube's sides and in again.
        """
        rays = len(points)
        if not COMPILED or self._surfaces.triangle.any() or (cells >= self.grid.flat).any():
            spread = ((points + shifts[:, None]) % 1.0).reshape(-1, 4)
            places, normals = self.places(np.repeat(cells, rays), spread[:, 2:])
            return places, hemisphere(normals, spread[:, :2])
        (corners, normals), (ends, _), (others, _) = (
            self.places(cells, np.tile(at, (len(cells), 1))) for at in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
        )
        places, ways = np.empty((2, len(cells) * rays, 3))
        _fan(corners, ends - corners, others - corners, normals, points, shifts, places, ways)
        return places, ways

    def extents(self) -> tuple[Floats, Floats, Floats]:
        """Return the diagonals (cells,) of the cells, their middles (cells, 3), and the normals there (cells, 3)."""
        every = np.arange(self.count)
        (middles, normals), (low, _), (high, _) = (
            self.places(every, np.full((self.count, 2), at)) for at in (0.5, 0.0, 1.0)
        )
        return np.linalg.norm(high - low, axis=1), middles, normals

    def outer(self, outward: NDArray[np.bool_] | None) -> Numbers:
        """Return the cells that are not inside a solid; ``outward`` as for `scattered`."""
        every = np.arange(self.count)
        if outward is None:
            return every
        side = np.where(self._back > 0, ~outward[self._owner], outward[self._owner])
        kept: Numbers = every[np.append(side, np.ones(self.count - len(side), dtype=bool))]
        return kept

    def scattered(self, spread: Floats, outward: NDArray[np.bool_] | None) -> tuple[Numbers, Floats, Floats]:
        """Return places all over the surfaces, by area.

        Parameters
        ----------
        spread : ndarray of shape (n, 2)
            Points of the unit square. They are mapped to whole surfaces, not cell by cell: their evenness is kept.
        outward : ndarray of shape (flat surfaces,), bool, or None
            Which flat surfaces' normals lead outwards, to leave out their other sides; None takes both.

        Returns
        -------
        cells : ndarray of shape (n,), int
        places, normals : ndarray of shape (n, 3)
        """
        surfaces, sides = self._surfaces, 2 if outward is None else 1
        flat = sides * len(surfaces.origin)
        ends = np.cumsum(np.concatenate([np.tile(surfaces.area, sides), 4.0 * math.pi * surfaces.spheres[:, 3] ** 2]))
        ends /= ends[-1]
        which = np.minimum(np.searchsorted(ends, spread[:, 0], side="right"), len(ends) - 1)
        low = np.concatenate([[0.0], ends])[which]
        u, v = np.clip((spread[:, 0] - low) / (ends[which] - low), 0.0, 1.0), spread[:, 1]
        cells, places, normals = np.empty(len(which), dtype=np.int64), *np.empty((2, len(which), 3))
        some = which < flat
        back, surface = np.divmod(which[some], max(1, len(surfaces.origin)))
        if outward is not None:
            back = 1 - outward[surface].astype(np.int64)
        i = _on_axis_arrays(u[some], surface, self.grid.along)[0]
        j = _on_axis_arrays(v[some], surface, self.grid.across)[0]
        side = back, surface
        cells[some] = self.grid.start[side] + i * self.grid.row[side] + j * self.grid.step[side]
        places[some] = surfaces.at(surface, np.stack([u[some], v[some]], axis=1))
        normals[some] = np.where(back[:, None] > 0, -1.0, 1.0) * surfaces.normal[surface]
        for number, ball in enumerate(surfaces.spheres):
            here = which == flat + number
            z, angle = 2.0 * u[here] - 1.0, 2.0 * math.pi * v[here]
            ring = np.sqrt(np.maximum(0.0, 1.0 - z**2))
            normals[here] = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
            places[here] = ball[:3] + ball[3] * normals[here]
            cells[here] = self._round(number, normals[here])
        return cells, places, normals


def _breaks(surfaces: Surfaces) -> list[tuple[list[float], list[float]]]:
    """Return, for each surface, where along its two edges others touch it, or lie on it, in line with the other edge.

    A smaller one that is near counts as lying on it (`_GAP`).

    Triangles are not cut: their cells are mapped by area.
    """
    outlines = surfaces.outlines()
    found: list[tuple[list[float], list[float]]] = [([], []) for _ in outlines]
    if not outlines:
        return found
    size = float(np.ptp(np.concatenate(outlines), axis=0).max())
    lows, highs = (np.array([end(outline, axis=0) for outline in outlines]) for end in (np.min, np.max))
    short = np.minimum(*(np.linalg.norm(edge, axis=1) for edge in (surfaces.first, surfaces.second)))
    gaps = np.maximum(_TOUCH * size, _GAP * short)[:, None]
    for i in np.flatnonzero(~surfaces.triangle):
        near = ((lows <= highs[i] + gaps) & (highs >= lows[i] - gaps)).all(axis=1)
        near[i] = False
        for j in np.flatnonzero(near):
            height = (outlines[j] - surfaces.origin[i]) @ surfaces.normal[i]
            gap = float(gaps[j, 0]) if short[j] < short[i] else 0.0
            for one, other in _contact(outlines[j], height, size, gap):
                a, b = surfaces.dual[i] @ (one - surfaces.origin[i]), surfaces.dual[i] @ (other - surfaces.origin[i])
                for axis in range(2):
                    low, high = sorted((a[1 - axis], b[1 - axis]))
                    across = abs(a[axis] - b[axis]) < _TOUCH * 10.0 and high - low > _SLIVER
                    if across and _SLIVER < a[axis] < 1.0 - _SLIVER and high > _SLIVER and low < 1.0 - _SLIVER:
                        found[i][axis].append(float(a[axis]))
    return found


def _contact(outline: Floats, height: Floats, size: float, gap: float) -> list[tuple[Floats, Floats]]:
    """Return the lines that a polygon (k, 3) has in common with a plane above which its corners are at ``height``.

    A polygon within the distance ``gap`` counts as lying in it.
    """
    on, after = np.abs(height) < _TOUCH * size, np.roll(np.arange(len(outline)), -1)
    if on.all() or np.abs(height).max() < gap:
        return [(outline[k], outline[after[k]]) for k in range(len(outline))]
    points = []
    for k, n in enumerate(after):
        if on[k]:
            points.append(outline[k])
        elif height[k] * height[n] < 0.0 and not on[n]:
            points.append(outline[k] + (outline[n] - outline[k]) * height[k] / (height[k] - height[n]))
    return [(points[0], points[-1])] if len(points) >= 2 else []


def _cut(breaks: list[float], long: float, foot: float, away: float, size: float) -> tuple[Floats, Numbers]:
    """Return the ends of the cells along an edge, (n + 1,) on [0, 1], and the part (n,) that each cell is in.

    Parameters
    ----------
    breaks : list of float
        Where the edge is divided into parts.
    long : float
        Its length.
    foot, away : float
        Where along the edge the place is that cells are small at, and how far from it.
    size : float
        Size of a cell in units of its distance from that place.
    """
    parts = np.unique(np.concatenate([[0.0, 1.0], breaks]))
    parts = parts[np.append(True, np.diff(parts) > _SLIVER)]
    parts[-1] = 1.0
    ends, pieces = [np.zeros(1)], []
    for number, (low, high) in enumerate(itertools.pairwise(parts)):
        first, last = (math.asinh((end * long - foot) / away) for end in (low, high))
        count = max(1, math.ceil((last - first) / size - 1e-9))
        cut = (np.sinh(np.linspace(first, last, count + 1)) * away + foot) / long
        cut[-1] = high
        ends.append(cut[1:])
        pieces.append(np.full(count, number))
    return np.concatenate(ends), np.concatenate(pieces)


def _finer(ends: Floats, pieces: Numbers, long: float, under: Floats, height: Floats) -> tuple[Floats, Numbers]:
    """Return the cells of an edge, as `_cut` does, halved where they are large for their distance from a lamp.

    ``under`` (k,) is where along the edge lamps are, ``height`` (k,) how far from the surface (`Spots.near`).
    """
    low, high, pieces = ends[:-1], ends[1:], pieces.copy()
    for _ in range(_HALVINGS):
        aside = np.maximum(np.maximum(low * long - under[:, None], under[:, None] - high * long), 0.0)
        most = _BENEATH * np.hypot(aside, height[:, None]).min(axis=0)
        large = (high - low) * long > most
        if not large.any():
            break
        middle = 0.5 * (low + high)
        low, high = (
            np.sort(np.concatenate([low, middle[large]])),
            np.sort(np.concatenate([high, middle[large]])),
        )
        pieces = np.repeat(pieces, 1 + large)
    return np.append(low, high[-1]), pieces


def _joined(cuts: list[tuple[Floats, Numbers]]) -> _Axis:
    empty, none = np.zeros(0), np.zeros(0, dtype=np.int64)
    count = np.array([len(pieces) for _, pieces in cuts], dtype=np.int64)
    low = np.concatenate([empty, *(ends[:-1] for ends, _ in cuts)])
    high = np.concatenate([empty, *(ends[1:] for ends, _ in cuts)])
    piece, first, middle = np.concatenate([none, *(p for _, p in cuts)]), np.cumsum(count) - count, 0.5 * (low + high)
    parts = np.arange(_BINS) / _BINS
    within = [np.searchsorted(ends, parts, side="right") - 1 for ends, _ in cuts]
    bins = first[:, None] + np.array(within, dtype=np.int64).reshape(-1, _BINS)
    return _Axis(
        *(low, high, piece, first, count, bins, middle),
        *_between(middle, piece, np.repeat(first, count), np.repeat(first + count, count)),
    )


def _between(middle: Floats, piece: Numbers, first: Numbers, end: Numbers) -> tuple[Numbers, Floats, Floats]:
    """Return ``pair``, ``base`` and ``slope`` of `_Axis` for cells (n,), each of a surface's from first to end."""
    here, first, end = (np.repeat(each, 2) for each in (np.arange(len(middle)), first, end))
    one = here - np.tile([1, 0], len(middle))

    def is_between(one: Numbers) -> NDArray[np.bool_]:
        """Whether a cell and the next one are of one part of an edge."""
        is_one: NDArray[np.bool_] = (one >= first) & (one + 1 < end)
        return is_one & (piece[one * is_one] == piece[(one + 1) * is_one])

    # At an end of a part: what its last two lead on to.
    one = np.where(is_between(one), one, 2 * here - 1 - one)
    inside = is_between(one)
    one, two = np.where(inside, one, here), np.where(inside, one + 1, here)
    gap = np.where(inside, middle[two] - middle[one], 1.0)
    return np.stack([one, two], axis=1) - first[:, None], middle[one], inside / gap


def _dot(one: Floats, other: Floats) -> Floats:
    product: Floats = np.einsum("ni,ni->n", one, other)
    return product


@jit_in_place
def _on_axis(x: float, which: int, axis: _Axis) -> tuple[int, int, int, float]:
    """Return the cell at ``x`` on a surface's edge, the two to interpolate between, and the weight of the second."""
    first, here = axis.first[which], axis.bins[which, min(max(int(x * _BINS), 0), _BINS - 1)]
    last = first + axis.cells[which] - 1
    while here < last and axis.low[here + 1] <= x:
        here += 1
    half = 2 * here + (1 if x >= axis.middle[here] else 0)
    return here - first, axis.pair[half, 0], axis.pair[half, 1], (x - axis.base[half]) * axis.slope[half]


@jit_in_place
def locate(start: Floats, way: Floats, i: int, far: float, grid: Grid, corners: Numbers, shares: Floats) -> int:
    """Return the cell that a ray, start (3,) and way (3,), meets on flat surface ``i`` at a distance.

    Writes the four cells (4,) to interpolate between, and their weights (4,).
    """
    u, v, cosine = 0.0, 0.0, 0.0
    for r in range(3):
        offset = start[r] + far * way[r] - grid.planes.origin[i, r]
        u += grid.planes.dual[i, 0, r] * offset
        v += grid.planes.dual[i, 1, r] * offset
        cosine += way[r] * grid.planes.normal[i, r]
    if grid.planes.triangle[i]:
        rest = max(1.0 - u, 1e-12)
        u, v = 1.0 - rest * rest, v / rest
    a, a0, a1, s = _on_axis(u, i, grid.along)
    b, b0, b1, t = _on_axis(v, i, grid.across)
    side = 1 if cosine > 0.0 else 0
    first, row, step = grid.start[side, i], grid.row[side, i], grid.step[side, i]
    corners[0], corners[1] = first + a0 * row + b0 * step, first + a0 * row + b1 * step
    corners[2], corners[3] = first + a1 * row + b0 * step, first + a1 * row + b1 * step
    shares[0], shares[1] = (1.0 - s) * (1.0 - t), (1.0 - s) * t
    shares[2], shares[3] = s * (1.0 - t), s * t
    return int(first + a * row + b * step)


@jit_in_place
def meet_sphere(start: Floats, way: Floats, grid: Grid, far: float) -> tuple[int, float]:
    """Return the cell of a sphere that a ray enters before ``far``, -1 for none, and where."""
    cell, bands = -1, grid.bands
    for k in range(grid.spheres.shape[0]):
        x, y, z = start[0] - grid.spheres[k, 0], start[1] - grid.spheres[k, 1], start[2] - grid.spheres[k, 2]
        radius = grid.spheres[k, 3]
        along = x * way[0] + y * way[1] + z * way[2]
        discriminant = along * along - (x * x + y * y + z * z - radius * radius)
        if discriminant <= 0.0:
            continue
        enters = -along - math.sqrt(discriminant)
        if enters <= _NEAR * radius or enters >= far:
            continue
        far = enters
        band = min(bands - 1, max(0, int(((z + far * way[2]) / radius + 1.0) / 2.0 * bands)))
        turn = math.atan2(y + far * way[1], x + far * way[0]) / (2.0 * math.pi)
        if turn < 0.0:
            turn += 1.0
        cell = grid.flat + k * 2 * bands * bands + band * 2 * bands + min(2 * bands - 1, int(turn * 2 * bands))
    return cell, far


@jit_released
def _meet(start: Floats, way: Floats, grid: Grid) -> tuple[Numbers, Floats, Numbers, Floats]:
    """Return what `Hits` holds of rays (n, 3), tested against the surfaces one by one."""
    n = start.shape[0]
    none = grid.flat + 2 * grid.bands * grid.bands * grid.spheres.shape[0]
    cell, far = np.empty(n, dtype=np.int64), np.empty(n)
    corners, shares = np.empty((n, 4), dtype=np.int64), np.zeros((n, 4))
    for k in range(n):
        which, far[k] = nearest(start[k], way[k], grid.planes, np.inf)
        ball, near = meet_sphere(start[k], way[k], grid, far[k])
        if ball < 0 and which >= 0:
            cell[k] = locate(start[k], way[k], which, far[k], grid, corners[k], shares[k])
            continue
        cell[k] = ball if ball >= 0 else none
        far[k], shares[k, 0] = near, 1.0
        for c in range(4):
            corners[k, c] = cell[k]
    return cell, far, corners, shares


def _on_axis_arrays(x: Floats, which: Numbers, axis: _Axis) -> tuple[Numbers, Numbers, Numbers, Floats]:
    """NumPy form of `_on_axis`, for rays of many surfaces."""
    first, last = axis.first[which], axis.first[which] + axis.cells[which] - 1
    # Ends of cells ascend from 0 to 1 on each surface; two apart, they ascend throughout.
    owner = np.repeat(np.arange(len(axis.cells)), axis.cells)
    here = np.searchsorted(axis.low + 2.0 * owner, np.clip(x, 0.0, 1.0) + 2.0 * which, side="right") - 1
    here = np.clip(here, first, last)
    half = 2 * here + (x >= axis.middle[here])
    return here - first, *axis.pair[half].T, (x - axis.base[half]) * axis.slope[half]


def _locate(
    start: Floats,
    way: Floats,
    which: Numbers,
    far: Floats,
    grid: Grid,
    cell: Numbers,
    corners: Numbers,
    shares: Floats,
) -> None:
    """NumPy form of `locate`, for rays (n, 3) and the flat surfaces that they meet (n,), -1 for none."""
    met = np.flatnonzero(which >= 0)
    i = which[met]
    planes = grid.planes
    offset = start[met] + far[met, None] * way[met] - planes.origin[i]
    u, v = np.einsum("nij,nj->in", planes.dual[i], offset)
    rest = np.maximum(1.0 - u, 1e-12)
    u, v = np.where(planes.triangle[i], 1.0 - rest**2, u), np.where(planes.triangle[i], v / rest, v)
    a, a0, a1, s = _on_axis_arrays(u, i, grid.along)
    b, b0, b1, t = _on_axis_arrays(v, i, grid.across)
    side = (_dot(way[met], planes.normal[i]) > 0.0).astype(np.int64), i
    first, row, step = grid.start[side], grid.row[side], grid.step[side]
    cell[met] = first + a * row + b * step
    along, across = ((a0, 1.0 - s), (a1, s)), ((b0, 1.0 - t), (b1, t))
    pairs = [(first + x * row + y * step, g * h) for x, g in along for y, h in across]
    corners[met] = np.stack([corner for corner, _ in pairs], axis=1)
    shares[met] = np.stack([share for _, share in pairs], axis=1)


@jit_released
def _fan(
    corners: Floats,
    first: Floats,
    second: Floats,
    normals: Floats,
    points: Floats,
    shifts: Floats,
    places: Floats,
    ways: Floats,
) -> None:
    """Write the rays of `Cells.fans` from parallelograms, by corner and edges (n, 3)."""
    at = np.empty(4)
    for i in range(corners.shape[0]):
        x, y, z = normals[i]
        sign = 1.0 if z >= 0.0 else -1.0
        a = -1.0 / (sign + z)
        b = x * y * a
        for k in range(points.shape[0]):
            row = i * points.shape[0] + k
            for c in range(4):
                at[c] = (points[k, c] + shifts[i, c]) % 1.0
            sine, angle = math.sqrt(at[0]), 2.0 * math.pi * at[1]
            cosine, u, v = math.sqrt(1.0 - at[0]), sine * math.cos(angle), sine * math.sin(angle)
            ways[row, 0] = cosine * x + u * (1.0 + sign * x * x * a) + v * b
            ways[row, 1] = cosine * y + u * sign * b + v * (sign + y * y * a)
            ways[row, 2] = cosine * z - u * sign * x - v * y
            for r in range(3):
                places[row, r] = corners[i, r] + at[2] * first[i, r] + at[3] * second[i, r]


def lit(values: Floats) -> Numbers:
    """Return the rows in which not all values (n, columns) are zero."""
    return np.flatnonzero(np.einsum("nc,nc->n", values, values))


def _interpolated_loops(values: Floats, corners: Numbers, shares: Floats) -> Floats:
    """Return the sums (n, columns) of cells' values (cells + 1, columns) at corners (n, c), weighted by shares."""
    n, columns = corners.shape[0], values.shape[1]
    found = np.zeros((n, columns))
    for k in range(n):
        for c in range(corners.shape[1]):
            share = shares[k, c]
            if share != 0.0:
                for column in range(columns):
                    found[k, column] += share * values[corners[k, c], column]
    return found


def _interpolated_arrays(values: Floats, corners: Numbers, shares: Floats) -> Floats:
    """NumPy form of `_interpolated_loops`."""
    found: Floats = np.einsum("nkc,nk->nc", values[corners], shares)
    return found


interpolated = jit_released(_interpolated_loops) if COMPILED else _interpolated_arrays


def _deposited_loops(values: Floats, corners: Numbers, shares: Floats, count: int) -> Floats:
    """Return the sums (count, columns) of values (n, columns) over cells at corners (n, c), weighted by shares."""
    columns = values.shape[1]
    found = np.zeros((count, columns))
    for k in range(corners.shape[0]):
        for c in range(corners.shape[1]):
            share = shares[k, c]
            if share != 0.0 and corners[k, c] < count:
                for column in range(columns):
                    found[corners[k, c], column] += share * values[k, column]
    return found


def _deposited_arrays(values: Floats, corners: Numbers, shares: Floats, count: int) -> Floats:
    """NumPy form of `_deposited_loops`."""
    parts = (summed(corners[:, c], shares[:, c, None] * values, count) for c in range(corners.shape[1]))
    return sum(parts, start=np.zeros((count, values.shape[1])))


deposited = jit_released(_deposited_loops) if COMPILED else _deposited_arrays


def _summed_loops(owner: Numbers, values: Floats, count: int) -> Floats:
    """Return the sums (count, columns) of the values (n, columns) that belong to each owner (n,) below ``count``."""
    sums = np.zeros((count, values.shape[1]))
    for k in range(len(owner)):
        if owner[k] < count:
            for column in range(values.shape[1]):
                sums[owner[k], column] += values[k, column]
    return sums


def _summed_arrays(owner: Numbers, values: Floats, count: int) -> Floats:
    """NumPy form of `_summed_loops`."""
    sums = np.zeros((count + 1, values.shape[1]))
    for column in range(values.shape[1]):
        if len(owner):  # `bincount` returns integers for empty arrays, even with weights
            sums[:, column] = np.bincount(np.minimum(owner, count), values[:, column], count + 1)
    return sums[:count]


summed = jit_released(_summed_loops) if COMPILED else _summed_arrays
