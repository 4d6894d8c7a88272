"""The light of the empty room, reflection by reflection, and what light that is added anywhere does to the picture.

All surfaces of the room, the relay wall included, are cut into cells. Light comes from sources: the lamp, of which
the first two reflections are exact, the sky, and emitters: surfaces that glow, and other lamps. With E_k the
irradiance and B_k = rho E_k the radiosity of reflection k, and F the share of each cell in what a cell sees (Goral et
al. 1984, equation 6, unrolled),

    E_(k+1) = F B_k.

Light s that is added to cells' irradiance changes the light on the watched wall, m reflections later at most, by

    R_m s = W (1 + rho F + ... + (rho F)^m) rho s

with W the share of each cell in what the wall's points see. R_m has as few rows as polynomials describe the picture,
so it is computed once a scene, from the wall backwards (adjoint light, as in Christensen 2003), and what a target at
a pose changes costs no more than its own light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.model.errors import NlosError
from generator.model.quantities import ALL_ORDERS
from generator.transport.light.beams import Beams, EmitterBeams, PatchBeams, irradiance
from generator.transport.light.cells import Cells, lit, summed
from generator.transport.light.exchange import Exchange
from generator.transport.light.openings import through_openings
from generator.transport.light.picture_points import PicturePoints
from generator.transport.light.spread import hemisphere, lattice, shifted, shifts, squares
from generator.transport.light.wall_shadow import WallShadow
from generator.transport.prepared import Setting
from generator.transport.rays import Surfaces
from generator.transport.world import MOST_SURFACES

Floats = NDArray[Any]
Numbers = NDArray[np.int64]

FINEST = 1e-2
"""Least error that is asked for: cells are no finer."""
_CELL, _COARSEST = 0.035, 0.1
"""Size of a cell in units of its distance from the watched patch, for that error, which is as its square; at most."""
_BLOCK = 6
"""Cells along a side of a coarse one."""
_ROWS, _WALL = 1024, 4096
"""Number of rays into the room from each cell, and from each point of the picture."""
_POINTS = 12
"""Points along a side of the picture."""
_WITHIN, _LEAST_WITHIN, _MOST_WITHIN = 4, 2, 24
"""Points within a cell, along a side, that the lit patch and emitters light: times its size in units of its distance
from these, at least, and at most."""
_CHUNK = 1 << 18
_NEAR, _CLOSE = 0.05, 2.0
"""Size of a part of a cell, in units of its distance, that a sum over a cell's parts allows; and of a whole cell,
above which rays tell its share instead."""
LEFT = 1e-4
"""Share of the light at which further reflections are left out."""
_FINE, _MOST_FINE, _LEFT_OF_ALL = 3, 8, 3e-4
"""Reflections on the way to the wall that are followed from cell to cell; further ones, from coarse to coarse. If all
count, how often at most that is repeated for what is missing, and what share may be."""
_OPEN = 0.1
"""Share of the sky in what the picture's points see, on average, above which rays alone tell it."""
_DENSE = 0.25
"""Share of cells with any light above which those without are not left out."""
_TOUCH, _FLAT = 1e-9, 1e-6
_LAMP, _SKY, _EMITTED = 2, 0, 1
"""Reflections of the light that sources begin with: on cells of the lamp's and of emitters', none of the sky's."""


@dataclass
class Source:
    """The light of one source in the empty room.

    Attributes
    ----------
    first : int
        Number of reflections of the light in ``levels[0]``.
    shown : int
        Fewest reflections of light on cells whose next reflection, on the wall, belongs to the picture; what comes
        before is exact elsewhere.
    levels : list of ndarray of shape (cells + 1, groups)
        Radiosity after each number of reflections, if not all count, else the first; the last row is the sky's.
    rest : ndarray of shape (cells + 1, groups)
        Sum of what comes after the last of ``levels``, if all reflections count.
    total : ndarray of shape (cells + 1, groups)
        Sum of all that.
    beams : Beams, optional
        Light that makes the first of ``levels``.
    """

    first: int
    shown: int
    levels: list[Floats]
    rest: Floats
    total: Floats
    beams: Beams | None = None


class LightField:
    """Light of many reflections, and of the sky, in an empty room.

    Parameters
    ----------
    setting : Setting
        Setting of a world with a relay wall, whatever its target.
    order : int
        Largest number of reflections; `ALL_ORDERS` for all.
    accuracy : float, default=FINEST
        Error of what a target changes, relative to that; the size of cells follows from it.
    factor : float, default=1
        How much larger cells are than that.

    Attributes
    ----------
    cells : Cells
        Cells of the room and of the relay wall; those that neither picture nor wall see, directly or by way of
        others, are given no light, and sides with no other cells, as a room's outer ones, share one (`Cells.only`).
    tint : ndarray of shape (cells, groups)
        Albedo.
    extent, middles : ndarray of shape (cells,) and (cells, 3)
        The cells' diagonals, and their middles.
    sources : dict of str to Source
        "lamp" if light of it is followed, "sky" if there is one, and "emitters" likewise.
    shadow : WallShadow or None
        Of emitters' light straight onto the wall.

    Raises
    ------
    NlosError
        There are too many surfaces.
    """

    def __init__(self, setting: Setting, order: int, accuracy: float = FINEST, factor: float = 1.0) -> None:
        self.order, self.factor = order, factor
        if len(setting.around) > MOST_SURFACES:
            raise NlosError(
                f"light of more than three reflections, or of the sky: {len(setting.around)} surfaces are more than "
                f"{MOST_SURFACES}; use --engine patch"
            )
        groups = setting.tint.shape[1]
        beams = None if setting.emission is None else EmitterBeams(setting.emission, setting.around)
        spots = None if beams is None else beams.spots
        size = factor * min(_COARSEST, _CELL * math.sqrt(max(1.0, accuracy / FINEST)))
        self.cells = Cells(setting.around, size, np.zeros(3), 1.0, np.zeros((0, groups)), spots)
        self.extent, self.middles, self._normals = self.cells.extents()
        self.points = PicturePoints(setting.to_wall, _POINTS)
        self._wall_share, wall = self._seen_by_wall(setting)
        wall = self._refined(wall, setting)
        # The picture does not see the relay wall's front, but a target may.
        front = (np.abs(self.middles[:, 2]) < _FLAT) & (self._normals[:, 2] > 0.5)
        met, old = self._reduced(self._met(np.flatnonzero(wall.any(axis=0) | front)))
        self._wall = wall[:, old]
        self._exchange = Exchange(met, self.cells.area)
        self._block, self._block_area, self._coarse = self._coarsened()
        # Light after any number of reflections, and itself, from coarse cell to coarse cell.
        self._onward = [self._inverse(g) for g in range(groups)] if order == ALL_ORDERS else []
        self.sources: dict[str, Source] = {}
        if order > 3:
            self.sources["lamp"] = self._lit(PatchBeams(setting), _LAMP, _LAMP + 1)
        if setting.sky is not None:
            sky = np.zeros((self.cells.count + 1, groups))
            sky[-1] = 1.0
            self.sources["sky"] = self._source(_SKY, _SKY, sky)
        self.shadow: WallShadow | None = None
        if beams is not None:
            self.shadow = WallShadow(setting, beams)
            self.sources["emitters"] = self._lit(beams, _EMITTED, _EMITTED)
        # Read whole for every pose, or every reflection of it.
        self._responses = [[one.astype(np.float32) for one in self._response(g)] for g in range(groups)]
        coarse = self._coarse.astype(np.float32)
        self._evening = [coarse @ onward.astype(np.float32) for onward in self._onward] or [coarse]
        del self._coarse, self._onward

    def _seen_by_wall(self, setting: Setting) -> tuple[Floats, Floats]:
        """Return what the picture's points see: the share of the sky (points,), and of each cell (points, cells)."""
        places, n, rays, count = self.points.places, len(self.points.places), _WALL, self.cells.count
        spread = shifted(rays, 2, np.arange(n)).reshape(-1, 2)
        ways = hemisphere(np.tile([0.0, 0.0, 1.0], (len(spread), 1)), spread)
        cell = self.cells.meet(np.repeat(places, rays, axis=0), ways).cell
        seen = np.array([np.bincount(met, minlength=count + 1) / rays for met in cell.reshape(n, rays)])
        sky = seen[:, -1]
        if setting.sky is not None and 0.0 < sky.mean() < _OPEN:
            out = np.flatnonzero(cell == count)
            sky = through_openings(places, out // rays, ways[out], rays, setting.around)
        return sky, seen[:, :-1]

    def _refined(self, seen: Floats, setting: Setting) -> Floats:
        """Return the share of each cell in what the picture's points see, (points, cells), by sums over cells' parts.

        Rays, by which ``seen`` was found, meet distant cells too seldom, and everything that a target does to the
        room reaches the picture by way of these shares. They remain for cells that are as large as their distance.
        """
        found = seen.copy()
        extent, middles = self.extent, self.middles
        blockers = setting.obstacles.static_blockers
        for k, place in enumerate(self.points.places):
            ratio = extent / np.maximum(np.linalg.norm(middles - place, axis=1), 1e-300)
            parts = np.ceil(ratio / _NEAR).astype(np.int64)
            # A flat cell whose middle faces away has no part that faces the place.
            faces = np.einsum("ni,ni->n", middles - place, self._normals) < 0.0
            found[k, ~faces] = 0.0
            for count in np.unique(parts[faces & (ratio < _CLOSE)]):
                some = np.flatnonzero(faces & (parts == count) & (ratio < _CLOSE))
                found[k, some] = _share(place, some, squares(int(count)), self.cells, blockers)
        return found

    def _met(self, fresh: Numbers) -> list[tuple[Numbers, NDArray[np.int32]]]:
        """Return, in parts, the cells (n,) that are seen, directly or by way of others, from some, and which cells
        the rays of each meet (n, rays)."""
        is_reached, is_met = np.zeros((2, self.cells.count + 1), dtype=bool)
        found: list[tuple[Numbers, NDArray[np.int32]]] = []
        step = max(1, _CHUNK // _ROWS)
        points, moved = lattice(_ROWS, 4), shifts(4, np.arange(self.cells.count))
        while len(fresh):
            is_reached[fresh] = True
            for start in range(0, len(fresh), step):
                some = fresh[start : start + step]
                hits = self.cells.meet(*self.cells.fans(some, points, moved[some]))
                found.append((some, hits.cell.reshape(-1, _ROWS).astype(np.int32)))
                is_met[hits.cell] = True
            fresh = np.flatnonzero(is_met[:-1] & ~is_reached[:-1])
        return found

    def _reduced(self, met: list[tuple[Numbers, NDArray[np.int32]]]) -> tuple[NDArray[np.int32], Numbers]:
        """Leave out the sides of surfaces on which no cell is reached, which are half of a room's.

        Parameters
        ----------
        met : list
            As `_met` returns it; it is emptied, since two of it are too much to hold.

        Returns
        -------
        met : ndarray of shape (cells, rays), int
            Which cell each one's rays meet; all of those of a cell that is not reached meet itself, which is black.
        old : ndarray of shape (cells,), int
            Number that each had.
        """
        is_reached = np.zeros(self.cells.count, dtype=bool)
        for reached, _ in met:
            is_reached[reached] = True
        self.cells, old = self.cells.only(is_reached)
        self._is_reached = is_reached[old]
        self.tint = np.where(self._is_reached[:, None], self.cells.tint, 0.0)
        self.extent, self.middles, self._normals = self.extent[old], self.middles[old], self._normals[old]
        number = np.full(len(is_reached) + 1, self.cells.count, dtype=np.int32)
        number[old] = np.arange(len(old))
        every = np.repeat(np.arange(len(old), dtype=np.int32)[:, None], _ROWS, axis=1)
        while met:
            reached, rows = met.pop()
            every[number[reached]] = number[rows]
        return every, old

    def _coarsened(self) -> tuple[Numbers, Floats, Floats]:
        reached = self._is_reached
        blocks, inner = np.unique(self.cells.blocks(_BLOCK)[reached], return_inverse=True)
        inner = inner.reshape(-1)
        size = np.bincount(inner, self.cells.area[reached], len(blocks))
        block = np.full(self.cells.count, len(blocks))  # cells that are not reached are in none
        block[reached] = inner
        return block, size, self._exchange.between(block, np.append(size, 1.0))[:-1, :-1]

    def _lit(self, beams: Beams, first: int, shown: int) -> Source:
        """Return the source whose ``first`` reflection is of beams, on cells."""
        start = np.zeros((self.cells.count + 1, self.tint.shape[1]))
        if first < self.order:
            extent, middles = self.extent, self.middles
            near = np.full(len(extent), np.inf)
            for place in beams.finest.places:
                near = np.minimum(near, np.linalg.norm(middles - place, axis=1))
            ratio = extent / np.maximum(near - extent / 2.0, 1e-300)
            parts = np.clip(np.ceil(_WITHIN * ratio), _LEAST_WITHIN, _MOST_WITHIN).astype(np.int64)
            for count in np.unique(parts[self._is_reached]):
                cells = np.flatnonzero(self._is_reached & (parts == count))
                spread = squares(int(count))
                places, normals = self.cells.places(np.repeat(cells, count**2), np.tile(spread, (len(cells), 1)))
                light = irradiance(beams, beams.finest, places, normals)
                start[cells] = self.tint[cells] * light.reshape(len(cells), count**2, -1).mean(axis=1)
        source = self._source(first, shown, start)
        source.beams = beams
        return source

    def _source(self, first: int, shown: int, start: Floats) -> Source:
        levels, rest = [start], np.zeros_like(start)
        if self.order == ALL_ORDERS:
            rest[:-1] = self._all_reflections(start)
            return Source(first, shown, levels, rest, start + rest)
        for _ in range(first, self.order - 1):
            levels.append(np.zeros_like(start))
            levels[-1][:-1] = self._reflected(levels[-2])
        return Source(first, shown, levels, rest, sum(levels, start=rest))

    def _reflected(self, radiosity: Floats) -> Floats:
        """Return the radiosity (cells, groups) by light that cells and the sky (cells + 1, groups) send."""
        exchange = self._exchange
        return self.tint * (exchange.received(radiosity[:-1]) + exchange.open[:, None] * radiosity[-1])

    def _all_reflections(self, start: Floats) -> Floats:
        """Return the radiosity (cells, groups) by all reflections of what cells and the sky send at first.

        What is missing goes on from coarse cell to coarse cell, which is nearly right; what that leaves is missing.
        """
        first = more = self._reflected(start)
        found = np.zeros_like(first)
        for number in range(_MOST_FINE + 1):
            mean = self._coarse_mean(more)
            found += more
            for group, onward in enumerate(self._onward):
                found[:, group] += np.append(onward @ mean[:, group] - mean[:, group], 0.0)[self._block]
            if number == _MOST_FINE or np.abs(more).sum() <= _LEFT_OF_ALL * np.abs(found).sum():
                break
            more = first + self.tint * self._exchange.received(found) - found
        return found

    def _inverse(self, group: int) -> Floats:
        """Return (1 - rho F)^-1 of coarse cells."""
        onward: Floats = np.linalg.inv(np.eye(len(self._coarse)) - self._block_tint(group)[:, None] * self._coarse)
        return onward

    def _block_tint(self, group: int) -> Floats:
        """Return the albedo of the coarse cells (blocks,); each is of one surface."""
        tint = np.zeros(len(self._block_area))
        tint[self._block[self._is_reached]] = self.tint[self._is_reached, group]
        return tint

    def _coarse_mean(self, radiosity: Floats) -> Floats:
        """Return the mean (blocks, columns) over coarse cells of the radiosity (cells, columns) of cells."""
        sent = summed(self._block, radiosity * self.cells.area[:, None], len(self._block_area))
        mean: Floats = sent / self._block_area[:, None]
        return mean

    def _response(self, group: int) -> list[Floats]:
        """Return R_0, R_1, ... as (coefficients, cells) each, up to where they change no more.

        If all reflections count, they are the first and the last.
        """
        tint, block = self.tint[:, group, None], self._block
        share = self.cells.area[:, None] / np.append(self._block_area, np.inf)[block, None]
        first = (self.points.fit @ self._wall).T
        if self.order == ALL_ORDERS:
            onward, every, more = self._onward[group].T, np.zeros_like(first), first
            for number in range(_MOST_FINE + 1):
                # What is still missing, and where that goes on from coarse cell to coarse cell.
                coarse = summed(block, more, len(onward))
                every += more + share * _padded(onward @ coarse - coarse)[block]
                if number == _MOST_FINE or np.abs(more).sum() <= _LEFT_OF_ALL * np.abs(every).sum():
                    break
                more = first + self._exchange.sent(tint * every) - every
            return [np.ascontiguousarray((tint * one).T) for one in (first, every)]
        # After some reflections what cells send is as good as even over a coarse cell.
        fine, coarse, found = first, np.zeros((0, 0)), [tint * first]
        block_tint, sizes = self._block_tint(group)[:, None], [float(np.abs(found[0]).max(initial=0.0))]
        for number in range(1, max(1, self.order - 2) + 1):
            if number <= _FINE:
                fine = self._exchange.sent(tint * fine)
                more = fine
                coarse = summed(block, fine, len(block_tint))
            else:
                coarse = self._coarse.T @ (block_tint * coarse)
                more = share * _padded(coarse)[block]
            found.append(found[-1] + tint * more)
            sizes.append(float(np.abs(tint * more).max(initial=0.0)))
            if still_to_come(sizes) <= LEFT * np.abs(found[-1]).max(initial=0.0):
                break
        return [np.ascontiguousarray(one.T) for one in found]

    def shown(self, light: Floats, most: int, *, directly: bool = True) -> Floats:
        """Return what light that is added to cells changes of the picture, (coefficients, k * groups).

        Parameters
        ----------
        light : ndarray of shape (cells, k * groups)
            Irradiance; k columns for each group, which vary fastest.
        most : int
            Largest number of reflections on the way from there to the wall, besides those on the cells themselves.
        directly : bool, default=True
            Whether what the cells send to the wall without any further reflection counts.
        """
        coefficients = np.zeros((len(self.points.fit), light.shape[1]))
        groups = len(self._responses)
        rows = lit(light)
        is_dense = len(rows) > _DENSE * len(light)
        arriving = (light if is_dense else light[rows]).astype(np.float32)
        for group, responses in enumerate(self._responses):
            some = slice(group, None, groups)
            chosen = [responses[min(most, len(responses) - 1)], *([] if directly else [responses[0]])]
            seen = [(one if is_dense else one[:, rows]) @ arriving[:, some] for one in chosen]
            coefficients[:, some] = seen[0] - seen[1] if len(seen) > 1 else seen[0]
        return coefficients

    def spread(self, radiosity: Floats) -> Floats:
        """Return the irradiance of cells by the radiosity of a few, (cells, columns) both."""
        return self._exchange.spread(radiosity)

    def received(self, radiosity: Floats, some: NDArray[np.bool_]) -> Floats:
        """Return the irradiance of some of the cells (cells,) by the radiosity of all, (cells, columns) both."""
        found = np.zeros_like(radiosity)
        rows = np.flatnonzero(some)
        found[rows] = self._exchange.received(radiosity, rows)
        return found

    def evened(self, radiosity: Floats) -> Floats:
        """Return the irradiance of cells by the radiosity of all others, (cells, k * groups) both.

        If all reflections count, it is that after any number of them. What a target adds to it is a small part of a
        small change, so coarse cells are enough.
        """
        sent = self._coarse_mean(radiosity).astype(np.float32)
        found = np.zeros((len(sent) + 1, radiosity.shape[1]))
        for group, matrix in enumerate(self._evening):
            some = slice(group, None, len(self._evening))
            found[:-1, some] = matrix @ sent[:, some]
        even: Floats = found[self._block]
        return even

    def background(self, name: str) -> Floats:
        """Return the coefficients (n, groups) of the light of a source on the wall of the empty scene."""
        source = self.sources[name]
        total = source.rest.copy()
        for level in source.levels[source.shown - source.first :]:
            total += level
        light = self._wall @ total[:-1] + self._wall_share[:, None] * total[-1]
        coefficients: Floats = self.points.fit @ light
        return coefficients


def _padded(values: Floats) -> Floats:
    """Return coarse cells' values (blocks, columns) with zeros for cells that are in none."""
    return np.append(values, np.zeros((1, values.shape[1])), axis=0)


def still_to_come(sizes: list[float]) -> float:
    """Return what all further terms of a series come to, if they decrease as the last two did."""
    last, ratio = sizes[-1], min(sizes[-1] / max(sizes[-2], 1e-300), 1.0 - 1e-6)
    return last * max(1.0, ratio / (1.0 - ratio))


def _share(place: Floats, some: Numbers, spread: Floats, cells: Cells, blockers: Surfaces) -> Floats:
    """Return the share of some cells in what a wall point (3,) sees: a sum over points (k, 2) of the unit square."""
    n, k = len(some), len(spread)
    points, normals = cells.places(np.repeat(some, k), np.tile(spread, (n, 1)))
    way = points - place
    squared = np.einsum("ni,ni->n", way, way)
    facing = -np.einsum("ni,ni->n", way, normals)
    lit = np.flatnonzero((way[:, 2] > _TOUCH) & (facing > 0.0))
    if len(blockers):
        lit = lit[~blockers.blocked(np.tile(place, (len(lit), 1)), points[lit])]
    share = np.zeros(n * k)
    share[lit] = way[lit, 2] * facing[lit] / (np.pi * squared[lit] ** 2)
    found: Floats = share.reshape(n, k).mean(axis=1) * cells.area[some]
    return found
