"""Uniform ambient light: what falls on the watched wall, and what the target changes of it.

The sky shines from everywhere where no surface is, and is reflected up to three times, the last time by the watched
wall. Surfaces are cut into cells, between whose middles radiosity is interpolated; where light comes from is found by
following rays from each cell back (gathering), their directions a low-discrepancy lattice, so that there is no noise
and one pose always gives one picture. What the target changes is gathered from the directions alone in which
a cell sees it: there its own light takes the place of what is behind it. The changes are what the lamp's pictures are
added to, so they need few digits.

With E_k the irradiance and B_k = rho E_k the radiosity after k reflections (Goral et al. 1984, equation 6, unrolled),
E_1 the visible share of the sky, all in units of pi times the sky's radiance L, and dB what the target changes:

    dE_(k+1) = F dB_k + sum over rays that meet the target of w (B_k(target) - B_k(behind it) - dB_k(behind it))

and the wall's radiance is rho L (E_1 + E_2 + E_3), as many as there may be reflections.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander
from numpy.typing import NDArray

from generator.model.errors import NlosError
from generator.transport import picture
from generator.transport.prepared import Setting
from generator.transport.rays import Surfaces

Floats = NDArray[Any]
Numbers = NDArray[np.int64]

_CELL, _BODY_CELL = 0.2, 0.25
"""Size of a cell, in units of its distance from the watched patch, and of the target's cells, of its radius."""
_ROWS, _WALL = 1024, 4096
"""Rays from each cell, and from each point of the picture, to the empty scene."""
_TOWARDS, _SEEN = 32, 256
"""Rays towards the target from each cell, and from each point of the picture."""
_LEAVE = 256
"""Rays from each cell of the target."""
_MOST_SURFACES = 2000
_POINTS, _MOST_POINTS = 12, 48
"""Of the picture, along a side: at first, and where polynomials do not hold its light well."""
_DEGREES = 0.6
"""Coefficients along a side for each point."""
_ROUGH = 0.1
"""Relative, root mean square: what polynomials may miss before there are more points; the lattice's noise counts."""
_NEAR = 1e-6
_CHUNK = 1 << 18


def lattice(count: int, dimensions: int) -> Floats:
    """Return points (count, dimensions) spread evenly over the unit cube: multiples of powers of the root of
    x^(d+1) = x + 1 (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
    """
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1)
    spread: Floats = (0.5 + np.arange(count)[:, None] * steps) % 1.0
    return spread


def _turned(count: int, dimensions: int, owners: Numbers) -> Floats:
    """The lattice (owners, count, dimensions), moved by another amount for each owner: their errors differ."""
    moves = np.random.default_rng(dimensions).random((int(owners.max(initial=-1)) + 1, dimensions))[owners]
    made: Floats = (lattice(count, dimensions)[None] + moves[:, None]) % 1.0
    return made


def _sums(owner: Numbers, values: Floats, count: int) -> Floats:
    """Sums (count, groups) of values (n, groups) that belong to owners (n,)."""
    made = np.zeros((count, values.shape[1]))
    if len(owner):  # of nothing, `bincount` makes integers, weights or no weights
        for group, one in enumerate(values.T):
            made[:, group] = np.bincount(owner, one, count)
    return made


def _dot(one: Floats, other: Floats) -> Floats:
    made: Floats = np.einsum("ni,ni->n", one, other)
    return made


def _beside(axis: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (n, 3) at right angles to unit vectors (n, 3) (Duff et al. 2017, listing 2)."""
    x, y, z = axis.T
    sign = np.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], 1), np.stack([b, sign + y * y * a, -y], 1)


def _around(axis: Floats, cosine: Floats, angle: Floats) -> Floats:
    """Unit vectors (n, 3) at such cosines from axes (n, 3)."""
    sine = np.sqrt(np.maximum(0.0, 1.0 - cosine**2))
    first, second = _beside(axis)
    across = (sine * np.cos(angle))[:, None] * first + (sine * np.sin(angle))[:, None] * second
    made: Floats = cosine[:, None] * axis + across
    return made


def _hemisphere(normals: Floats, spread: Floats) -> Floats:
    """Directions (n, 3) above normals (n, 3), as dense as the cosine, of points (n, 2) of the unit square."""
    return _around(normals, np.sqrt(1.0 - spread[:, 0]), 2.0 * math.pi * spread[:, 1])


@dataclass(frozen=True)
class Hits:
    """What rays find: four cells (n, 4), or -1 where there is nothing but sky, and the share of each (n, 4)."""

    cells: Numbers
    shares: Floats

    def __getitem__(self, some: Any) -> Hits:
        return Hits(self.cells[some], self.shares[some])

    @property
    def sky(self) -> NDArray[np.bool_]:
        """Whether nothing was met (n,)."""
        return self.cells[:, 0] < 0

    def of(self, values: Floats) -> Floats:
        """Interpolate cells' values (cells, groups), (n, groups); nothing where nothing was met."""
        made: Floats = np.einsum("nkg,nk->ng", values[self.cells], self.shares)
        return made


class Cells:
    """Surfaces cut into cells, each side of a flat one by itself: small near a place, larger away from it.

    Parameters
    ----------
    surfaces : Surfaces
    ball_tint : ndarray of shape (spheres, groups)
        Albedo of its spheres; flat ones have theirs.
    size : float
        Of a cell, in units of its distance from the place, or the least distance.
    place : ndarray of shape (3,)
    least : float

    Attributes
    ----------
    tint : ndarray of shape (cells, groups)
    """

    def __init__(self, surfaces: Surfaces, ball_tint: Floats, size: float, place: Floats, least: float) -> None:
        self._surfaces = surfaces
        edges = np.stack([surfaces.first, surfaces.second], axis=1)
        self._long = np.linalg.norm(edges, axis=2)
        offset = place - surfaces.origin
        away = np.abs((offset * surfaces.normal).sum(axis=1))
        foot = (surfaces.dual * offset[:, None]).sum(axis=2) * self._long
        centre = surfaces.origin + edges.sum(axis=1) / 3.0
        bent = surfaces.triangle  # cells of one size: they are followed by area, not along the edges
        away = np.maximum(least, np.where(bent, np.linalg.norm(centre - place, axis=1), away))
        self._foot = np.where(bent[:, None], 0.5 * self._long, foot)
        self._away = away
        low, high = self._scale(-self._foot), self._scale(self._long - self._foot)
        self._count = np.maximum(1, np.ceil((high - low) / size)).astype(np.int64)
        self._low, self._step = low, (high - low) / self._count
        each = self._count.prod(axis=1)
        self._start = np.cumsum(each) - each
        self._half = int(each.sum())
        self._bands = max(2, math.ceil(2.0 / size))
        self.count = 2 * self._half + 2 * self._bands**2 * len(surfaces.spheres)
        flat = np.repeat(surfaces.tint, each, axis=0)
        self.tint = np.concatenate([flat, flat, np.repeat(ball_tint, 2 * self._bands**2, axis=0)])
        self._owner = np.repeat(np.arange(len(each)), each)

    def _scale(self, along: Floats) -> Floats:
        made: Floats = np.arcsinh(along / self._away[:, None])
        return made

    def hit(self, start: Floats, way: Floats) -> tuple[Hits, Floats]:
        """Follow rays (n, 3) of unit length to the first surface: what they find, and how far (n,)."""
        surfaces = self._surfaces
        cells, shares = np.full((len(start), 4), -1), np.zeros((len(start), 4))
        far = np.full(len(start), np.inf)
        if len(surfaces.origin):
            which, far = surfaces.first_hit(start, way)
            met = which >= 0
            there = start[met] + far[met, None] * way[met]
            cells[met], shares[met] = self._flat(which[met], there, way[met])
        for number, ball in enumerate(surfaces.spheres):
            offset = start - ball[:3]
            along, beyond = _dot(offset, way), _dot(offset, offset) - ball[3] ** 2
            inside = along**2 - beyond
            enters = -along - np.sqrt(np.maximum(inside, 0.0))
            met = (inside > 0.0) & (enters > _NEAR * ball[3]) & (enters < far)
            place = (offset[met] + enters[met, None] * way[met]) / ball[3]
            far[met], cells[met], shares[met] = enters[met], self._round(number, place)[:, None], [1.0, 0.0, 0.0, 0.0]
        return Hits(cells, shares), far

    def _flat(self, which: Numbers, place: Floats, way: Floats) -> tuple[Numbers, Floats]:
        """The four cells of flat surfaces around places, (n, 4), and the weight of each in linear interpolation."""
        surfaces = self._surfaces
        offset = place - surfaces.origin[which]
        u, v = np.einsum("nij,nj->in", surfaces.dual[which], offset)
        bent = surfaces.triangle[which]
        rest = np.maximum(1.0 - u, 1e-12)
        at = np.stack([np.where(bent, 1.0 - rest**2, u), np.where(bent, v / rest, v)], axis=1)
        scale = np.arcsinh((at * self._long[which] - self._foot[which]) / self._away[which, None])
        count = self._count[which]
        step = (scale - self._low[which]) / self._step[which] - 0.5
        low = np.clip(np.floor(step).astype(np.int64), 0, np.maximum(count - 2, 0))
        high, share = np.minimum(low + 1, count - 1), step - low  # at a surface's edge, it goes on straight
        first = self._start[which] + self._half * (_dot(way, surfaces.normal[which]) > 0.0)
        ends, parts = (low, high), (1.0 - share, share)
        pairs = [(i, j) for i in range(2) for j in range(2)]
        cells = np.stack([first + ends[i][:, 0] * count[:, 1] + ends[j][:, 1] for i, j in pairs], axis=1)
        return cells, np.stack([parts[i][:, 0] * parts[j][:, 1] for i, j in pairs], axis=1)

    def _round(self, number: int, place: Floats) -> Numbers:
        """Cells of a sphere at unit vectors (n, 3): bands of one height, and twice as many meridians."""
        band = np.clip(((place[:, 2] + 1.0) / 2.0 * self._bands).astype(np.int64), 0, self._bands - 1)
        turn = np.arctan2(place[:, 1], place[:, 0]) / (2.0 * math.pi) % 1.0
        meridian = np.minimum((turn * 2 * self._bands).astype(np.int64), 2 * self._bands - 1)
        made: Numbers = 2 * self._half + number * 2 * self._bands**2 + band * 2 * self._bands + meridian
        return made

    def places(self, cells: Numbers, spread: Floats) -> tuple[Floats, Floats]:
        """Return places in cells (n,), and normals there, (n, 3) each, of points (n, 2) of the unit square."""
        surfaces = self._surfaces
        made, normals = np.zeros((2, len(cells), 3))
        flat = cells < 2 * self._half
        back, inner = np.divmod(cells[flat], max(1, self._half))
        which = self._owner[inner]
        step = np.stack(np.divmod(inner - self._start[which], self._count[which, 1]), axis=1)
        # The ends of a cell, and between them evenly.
        low, high = (self._low[which] + (step + k) * self._step[which] for k in (0, 1))
        low, high = np.sinh(low), np.sinh(high)
        along = self._away[which, None] * (low + spread[flat] * (high - low)) + self._foot[which]
        u, v = np.clip(along / self._long[which], 0.0, 1.0).T
        rest = np.sqrt(1.0 - u)
        bent = surfaces.triangle[which]
        u, v = np.where(bent, 1.0 - rest, u), np.where(bent, v * rest, v)
        made[flat] = surfaces.origin[which] + u[:, None] * surfaces.first[which] + v[:, None] * surfaces.second[which]
        normals[flat] = np.where(back[:, None] > 0, -1.0, 1.0) * surfaces.normal[which]
        number, inner = np.divmod(cells[~flat] - 2 * self._half, 2 * self._bands**2)
        step = np.stack(np.divmod(inner, 2 * self._bands), axis=1) + spread[~flat]
        z, angle = 2.0 * step[:, 0] / self._bands - 1.0, math.pi * step[:, 1] / self._bands
        ring = np.sqrt(np.maximum(0.0, 1.0 - z**2))
        outward = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
        balls = surfaces.spheres[number]
        made[~flat], normals[~flat] = balls[:, :3] + balls[:, 3:] * outward, outward
        return made, normals


@dataclass(frozen=True)
class _Starts:
    """Rays that leave cells or points: origins and normals (n, 3), whose each is (n,), where in the unit square its
    direction lies (n, 2), how many each receiver has, and how many receivers there are."""

    places: Floats
    normals: Floats
    owner: Numbers
    spread: Floats
    rays: int
    receivers: int

    @classmethod
    def of(cls, cells: Cells, some: Numbers, rays: int) -> _Starts:
        """Rays from all over some cells."""
        spread = _turned(rays, 4, some).reshape(-1, 4)
        owner = np.repeat(some, rays)
        return cls(*cells.places(owner, spread[:, 2:]), owner, spread[:, :2], rays, cells.count)


@dataclass(frozen=True)
class Rows:
    """What receivers have of each cell's radiosity: a sparse matrix (receivers, cells), as its entries.

    NumPy alone is what Blender's Python has; a product with it takes a hundredth of a picture's time.

    Attributes
    ----------
    shape : (int, int)
    owner, cell : ndarray of shape (n,)
        Row and column of each entry.
    weight : ndarray of shape (n,)
    """

    shape: tuple[int, int]
    owner: Numbers
    cell: Numbers
    weight: Floats

    @classmethod
    def joined(cls, shape: tuple[int, int], parts: Sequence[Rows]) -> Rows:
        """Return the sum of matrices of one shape."""
        nothing = np.zeros(0, dtype=np.int64)
        owner, cell = (np.concatenate([nothing, *(getattr(p, name) for p in parts)]) for name in ("owner", "cell"))
        return cls(shape, owner, cell, np.concatenate([np.zeros(0), *(p.weight for p in parts)]))

    def __matmul__(self, values: Floats) -> Floats:
        """What receivers have of cells' values (cells, groups), (receivers, groups)."""
        return _sums(self.owner, self.weight[:, None] * values[self.cell], self.shape[0])


@dataclass(frozen=True)
class _Met:
    """Rays that meet the target: whose (n,), their weights (n,), what they find of it, and what is behind."""

    owner: Numbers
    weight: Floats
    body: Hits
    behind: Hits


@dataclass(frozen=True)
class _Leaving:
    """What rays that leave the target find of the room, and whether they meet the target itself before (n,)."""

    seen: Hits
    own: NDArray[np.bool_]


class _Watch:
    """The picture's points: where its light is asked for, and polynomials that hold it (the rule of `picture.Rule`,
    with more points than it has coefficients).

    Attributes
    ----------
    starts : _Starts
    share : ndarray of shape (points,)
        Of the sky that each sees, in the empty scene.
    matrix : Rows of shape (points, cells)
        What it has of each cell's radiosity.
    """

    def __init__(self, sky: Sky, to_wall: Floats, points: int) -> None:
        nodes, weights = leggauss(points)
        some = math.ceil(_DEGREES * points)
        one = (np.arange(some) + 0.5)[:, None] * (legvander(nodes, some - 1) * weights[:, None]).T
        back = legvander(nodes, some - 1)
        self._forth, self._back = np.kron(one, one), np.kron(back, back)
        u, v = np.tile(nodes, points), np.repeat(nodes, points)
        uv = (np.stack([u, v], axis=1) + 1.0) / 2.0
        lifted = np.concatenate([uv, np.ones((len(uv), 1))], axis=1) @ to_wall.T
        places = np.append(lifted[:, :2] / lifted[:, 2:], np.zeros((len(uv), 1)), axis=1)
        self._places = places
        self.starts = self._rays(_SEEN)
        self.share, self.matrix = sky.rows(self._rays(_WALL))

    def _rays(self, count: int) -> _Starts:
        many = np.arange(len(self._places))
        owner = np.repeat(many, count)
        normals = np.tile([0.0, 0.0, 1.0], (len(owner), 1))
        spread = _turned(count, 2, many).reshape(-1, 2)
        return _Starts(self._places[owner], normals, owner, spread, count, len(many))

    def held(self, light: Floats) -> tuple[Floats, float]:
        """Coefficients (groups, n) of light (points, groups), and what of it they miss, relative."""
        coefficients = self._forth @ light
        missed: Floats = light - self._back @ coefficients
        total = float((light**2).sum())
        return coefficients.T, math.sqrt(float((missed**2).sum()) / total) if total else 0.0


def _rows(shape: tuple[int, int], owners: Numbers, found: Hits) -> Rows:
    """Sum what the same number of rays from each receiver (n,) find, cell by cell."""
    rays = len(found.cells) // len(owners)
    row, corner = np.nonzero(found.shares)
    key = row // rays * shape[1] + found.cells[row, corner]
    dense = np.bincount(key, found.shares[row, corner] / rays, len(owners) * shape[1])
    filled = np.flatnonzero(dense)
    row, cell = np.divmod(filled, shape[1])
    return Rows(shape, owners[row], cell, dense[filled].astype(np.float64))


class Sky:
    """The sky over an empty scene: what of it reaches whom.

    Parameters
    ----------
    setting : Setting
        Of a world with ambient light, whatever its target.
    order : int
        Reflections.

    Attributes
    ----------
    cells : Cells
        The room's and the relay wall's.
    first, second : ndarray of shape (cells, groups)
        Their radiosities after one and two reflections.
    gather : Rows of shape (cells, cells)
        What each has of each other's radiosity.
    starts : _Starts
        Rays from those that the picture can have light of.

    Raises
    ------
    NlosError
        There are too many surfaces.
    """

    def __init__(self, setting: Setting, order: int) -> None:
        self.order, self._to_wall = order, setting.to_wall
        if len(setting.around) > _MOST_SURFACES:
            raise NlosError(
                f"ambient light: {len(setting.around)} surfaces are more than {_MOST_SURFACES}; use --engine patch"
            )
        groups = setting.tint.shape[1]
        self.cells = Cells(setting.around, np.zeros((0, groups)), _CELL, np.zeros(3), 1.0)
        self._watches: dict[int, _Watch] = {}
        # What cannot be seen by way of others changes nothing: the outer sides of a room's walls.
        share, reached = np.zeros(self.cells.count), np.zeros(self.cells.count, dtype=bool)
        gathered: list[Rows] = []
        fresh = np.unique(self.watch(_POINTS).matrix.cell)
        while len(fresh):
            reached[fresh] = True
            some, rows = self.rows(_Starts.of(self.cells, fresh, _ROWS))
            share += some
            gathered.append(rows)
            seen = np.unique(rows.cell)
            fresh = seen[~reached[seen]]
        self.gather = Rows.joined((self.cells.count, self.cells.count), gathered)
        self.first = self.cells.tint * share[:, None]
        self.second = self.cells.tint * (self.gather @ self.first)
        self.starts = _Starts.of(self.cells, np.flatnonzero(reached), _TOWARDS)

    def watch(self, points: int) -> _Watch:
        """Return the picture's points, so many along a side."""
        if points not in self._watches:
            self._watches[points] = _Watch(self, self._to_wall, points)
        return self._watches[points]

    def rows(self, starts: _Starts) -> tuple[Floats, Rows]:
        """Return what receivers have of the sky (n,) and of each cell's radiosity (n, cells), target or no target."""
        shape = starts.receivers, self.cells.count
        sky, made = np.zeros(starts.receivers), []
        step = max(1, _CHUNK // starts.rays) * starts.rays  # whole receivers
        for at in range(0, len(starts.owner), step):
            part = slice(at, at + step)
            ways = _hemisphere(starts.normals[part], starts.spread[part])
            found, _ = self.cells.hit(starts.places[part], ways)
            owners = starts.owner[part][:: starts.rays]
            sky[owners] = found.sky.reshape(len(owners), -1).mean(axis=1)
            made.append(_rows(shape, owners, found))
        return sky, Rows.joined(shape, made)

    def background(self) -> Floats:
        """Return coefficients (groups, n) of the picture of the empty scene."""
        watch = self.watch(_POINTS)
        light = watch.share[:, None].repeat(self.first.shape[1], axis=1)
        if self.order >= 2:
            light = light + watch.matrix @ self.first
        if self.order >= 3:
            light = light + watch.matrix @ self.second
        coefficients: Floats = watch.held(light)[0]
        return coefficients


class Ambient:
    """Ambient light on the watched wall, in units of its albedo times the sky's radiance.

    Parameters
    ----------
    setting : Setting
        Of a world with ambient light.
    sky : Sky
        Over its empty scene.
    """

    def __init__(self, setting: Setting, sky: Sky) -> None:
        self._sky, self._resolution = sky, setting.resolution
        target, balls = setting.target, len(setting.target.spheres)
        low, high = target.box
        self._centre = (low + high) / 2.0
        corners = np.concatenate(target.corners())
        reach = np.linalg.norm(corners - self._centre, axis=1).max(initial=0.0)
        rounds = np.linalg.norm(target.spheres[:, :3] - self._centre, axis=1) + target.spheres[:, 3]
        self._radius = float(max(reach, rounds.max(initial=0.0)))
        tint = setting.tint[len(setting.tint) - balls :]
        self._body = Cells(target, tint, _BODY_CELL, self._centre, self._radius)
        self._leaving = _Starts.of(self._body, np.arange(self._body.count), _LEAVE)
        self._ways = _hemisphere(self._leaving.normals, self._leaving.spread)
        self._own, self._own_far = self._body.hit(self._leaving.places, self._ways)

    def background(self) -> Floats:
        """Return the picture of the empty scene, (groups, height, width)."""
        return self._drawn(self._sky.background())

    def change(self, turn: Floats, place: Floats, *, shadows: bool = True) -> Floats:
        """Return what the target at a pose changes, (groups, height, width).

        Parameters
        ----------
        turn, place : ndarray of shape (3, 3) and (3,)
            In the wall's frame.
        shadows : bool
            With what it keeps from the wall; without, what it sends there alone.
        """
        points, tint = _POINTS, self._body.tint
        around = self._met(self._sky.starts, turn, place)
        seen, far = self._sky.cells.hit(self._leaving.places @ turn.T + place, self._ways @ turn.T)
        leaving = _Leaving(seen, self._own_far < far)
        while True:
            watch = self._sky.watch(points)
            met = self._met(watch.starts, turn, place)
            light = self._light(watch, met, around, leaving, tint)
            if not shadows:
                light -= self._light(watch, met, around, leaving, np.zeros_like(tint))
            coefficients, missed = watch.held(light)
            if missed <= _ROUGH or 2 * points > _MOST_POINTS:
                return self._drawn(coefficients)
            points *= 2

    def _met(self, starts: _Starts, turn: Floats, place: Floats) -> _Met:
        """Follow rays into the cone around the target."""
        offset = place + turn @ self._centre - starts.places
        facing = _dot(offset, starts.normals) > -self._radius
        offset, origin, normal = offset[facing], starts.places[facing], starts.normals[facing]
        spread, owner = starts.spread[facing], starts.owner[facing]
        far = np.sqrt(_dot(offset, offset))
        sine = self._radius / np.maximum(far, self._radius)
        widest = np.where(far > self._radius, np.sqrt(1.0 - sine**2), -1.0)
        axis = offset / np.maximum(far, 1e-300)[:, None]
        way = _around(axis, 1.0 - (1.0 - widest) * spread[:, 0], 2.0 * math.pi * spread[:, 1])
        weight = _dot(way, normal) * 2.0 * (1.0 - widest) / starts.rays
        some = np.flatnonzero(weight > 0.0)
        body, near = self._body.hit((origin[some] - place) @ turn, way[some] @ turn)
        met = ~body.sky
        some, body, near = some[met], body[met], near[met]
        behind, beyond = self._sky.cells.hit(origin[some], way[some])
        free = beyond > near
        some, body, behind = some[free], body[free], behind[free]
        return _Met(owner[some], weight[some], body, behind)

    def _light(self, watch: _Watch, met: _Met, around: _Met, leaving: _Leaving, tint: Floats) -> Floats:
        """What the target changes at the picture's points, (points, groups), with cells of such albedo."""
        groups, rho = tint.shape[1], self._sky.cells.tint

        def sky(hits: _Met, starts: _Starts) -> Floats:
            lost = (hits.weight * hits.behind.sky)[:, None]
            return -_sums(hits.owner, np.tile(lost, groups), starts.receivers)

        def instead(hits: _Met, starts: _Starts, body: Floats, room: Floats) -> Floats:
            gained = hits.weight[:, None] * (hits.body.of(body) - hits.behind.of(room))
            return _sums(hits.owner, gained, starts.receivers)

        light = sky(met, watch.starts)
        if self._sky.order < 2:
            return light
        every = (self._body.count, -1)
        share = (leaving.seen.sky & ~leaving.own).reshape(every).mean(axis=1)
        body = tint * share[:, None]
        change = rho * sky(around, self._sky.starts)
        room = self._sky.first + change
        light += watch.matrix @ change + instead(met, watch.starts, body, room)
        if self._sky.order < 3:
            return light
        change = rho * (self._sky.gather @ change + instead(around, self._sky.starts, body, room))
        arriving = np.where(leaving.own[:, None], self._own.of(body), leaving.seen.of(room))
        body = tint * arriving.reshape(*every, groups).mean(axis=1)
        return light + watch.matrix @ change + instead(met, watch.starts, body, self._sky.second + change)

    def _drawn(self, coefficients: Floats) -> Floats:
        """A picture (groups, height, width) of its coefficients (groups, n)."""
        width, height = self._resolution
        out = np.zeros((1, len(coefficients), height, width))
        whole = np.array([[0.0, 1.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]])
        picture.deposit(
            out, np.zeros(1, dtype=np.int64), whole[0], np.ascontiguousarray(coefficients)[None], whole[1]
        )
        return out[0]
