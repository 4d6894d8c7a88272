"""Uniform ambient light: the light that falls on the watched wall, and how the target changes it.

The sky shines from every direction in which there is no surface, and its light is reflected up to three times, the
last time by the watched wall. Surfaces are cut into cells, between whose middles radiosity is interpolated. Incoming
light is found by following rays backwards from each cell (gathering). Their directions are a low-discrepancy lattice,
so that there is no noise and one pose always gives one picture. What the target changes is gathered only from the
directions in which a cell sees the target: there its light replaces the light from behind it. The changes are added
to the lamp's pictures, so they need few digits.

With E_k the irradiance and B_k = rho E_k the radiosity after k reflections (Goral et al. 1984, equation 6, unrolled),
E_1 the visible share of the sky, all in units of pi times the sky's radiance L, and dB the change due to the target:

    dE_(k+1) = F dB_k + sum over rays that meet the target of w (B_k(target) - B_k(behind it) - dB_k(behind it))

and the wall's radiance is rho L (E_1 + E_2 + E_3), with one term for each reflection that is allowed.
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
"""Size of a cell in units of its distance from the watched patch; of a target's cell, of the target's radius."""
_ROWS, _WALL = 1024, 4096
"""Number of rays into the empty scene from each cell, and from each point of the picture."""
_TOWARDS, _SEEN = 32, 256
"""Number of rays towards the target from each cell, and from each point of the picture."""
_LEAVE = 256
"""Number of rays from each cell of the target."""
_MOST_SURFACES = 2000
_POINTS, _MOST_POINTS = 12, 48
"""Points along a side of the picture: at first, and at most where polynomials fit its light badly."""
_DEGREES = 0.6
"""Polynomial coefficients per point, along a side."""
_ROUGH = 0.1
"""Relative root mean square error of the polynomials, lattice noise included, above which more points are taken."""
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
    """Return the lattice (owners, count, dimensions), shifted for each owner so that their errors differ."""
    shifts = np.random.default_rng(dimensions).random((int(owners.max(initial=-1)) + 1, dimensions))[owners]
    points: Floats = (lattice(count, dimensions)[None] + shifts[:, None]) % 1.0
    return points


def _sums(owner: Numbers, values: Floats, count: int) -> Floats:
    """Return the sums (count, groups) of the values (n, groups) that belong to each owner (n,)."""
    sums = np.zeros((count, values.shape[1]))
    if len(owner):  # `bincount` returns integers for empty arrays, even with weights
        for group, column in enumerate(values.T):
            sums[:, group] = np.bincount(owner, column, count)
    return sums


def _dot(one: Floats, other: Floats) -> Floats:
    product: Floats = np.einsum("ni,ni->n", one, other)
    return product


def _beside(axis: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors (n, 3) at right angles to unit vectors (n, 3) (Duff et al. 2017, listing 2)."""
    x, y, z = axis.T
    sign = np.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], 1), np.stack([b, sign + y * y * a, -y], 1)


def _around(axis: Floats, cosine: Floats, angle: Floats) -> Floats:
    """Return unit vectors (n, 3) at given cosines (n,) to axes (n, 3) and angles (n,) around them."""
    sine = np.sqrt(np.maximum(0.0, 1.0 - cosine**2))
    first, second = _beside(axis)
    across = (sine * np.cos(angle))[:, None] * first + (sine * np.sin(angle))[:, None] * second
    vectors: Floats = cosine[:, None] * axis + across
    return vectors


def _hemisphere(normals: Floats, spread: Floats) -> Floats:
    """Return directions (n, 3) about normals (n, 3), of cosine density, for points (n, 2) of the unit square."""
    return _around(normals, np.sqrt(1.0 - spread[:, 0]), 2.0 * math.pi * spread[:, 1])


@dataclass(frozen=True)
class Hits:
    """What rays meet: four cells (n, 4), or -1 where they meet only the sky, and the share of each (n, 4)."""

    cells: Numbers
    shares: Floats

    def __getitem__(self, some: Any) -> Hits:
        return Hits(self.cells[some], self.shares[some])

    @property
    def sky(self) -> NDArray[np.bool_]:
        """Whether each ray met no surface (n,)."""
        return self.cells[:, 0] < 0

    def of(self, values: Floats) -> Floats:
        """Interpolate cells' values (cells, groups) for each ray, (n, groups); zero where no surface was met."""
        interpolated: Floats = np.einsum("nkg,nk->ng", values[self.cells], self.shares)
        return interpolated


class Cells:
    """Surfaces cut into cells, each side of a flat one separately: small near a place, larger away from it.

    Parameters
    ----------
    surfaces : Surfaces
    ball_tint : ndarray of shape (spheres, groups)
        Albedo of the spheres; that of flat surfaces is in ``surfaces``.
    size : float
        Size of a cell, in units of its distance from the place, which counts as ``least`` where it is smaller.
    place : ndarray of shape (3,)
    least : float

    Attributes
    ----------
    tint : ndarray of shape (cells, groups)
        Albedo of each cell.
    """

    def __init__(self, surfaces: Surfaces, ball_tint: Floats, size: float, place: Floats, least: float) -> None:
        self._surfaces = surfaces
        edges = np.stack([surfaces.first, surfaces.second], axis=1)
        self._long = np.linalg.norm(edges, axis=2)
        offsets = place - surfaces.origin
        distance = np.abs((offsets * surfaces.normal).sum(axis=1))
        foot = (surfaces.dual * offsets[:, None]).sum(axis=2) * self._long
        centres = surfaces.origin + edges.sum(axis=1) / 3.0
        triangle = surfaces.triangle  # cells of one size, since they are mapped by area, not along the edges
        distance = np.maximum(least, np.where(triangle, np.linalg.norm(centres - place, axis=1), distance))
        self._foot = np.where(triangle[:, None], 0.5 * self._long, foot)
        self._away = distance
        low, high = self._scale(-self._foot), self._scale(self._long - self._foot)
        self._count = np.maximum(1, np.ceil((high - low) / size)).astype(np.int64)
        self._low, self._step = low, (high - low) / self._count
        counts = self._count.prod(axis=1)
        self._start = np.cumsum(counts) - counts
        self._half = int(counts.sum())
        self._bands = max(2, math.ceil(2.0 / size))
        self.count = 2 * self._half + 2 * self._bands**2 * len(surfaces.spheres)
        flat = np.repeat(surfaces.tint, counts, axis=0)
        self.tint = np.concatenate([flat, flat, np.repeat(ball_tint, 2 * self._bands**2, axis=0)])
        self._owner = np.repeat(np.arange(len(counts)), counts)

    def _scale(self, along: Floats) -> Floats:
        scaled: Floats = np.arcsinh(along / self._away[:, None])
        return scaled

    def hit(self, start: Floats, way: Floats) -> tuple[Hits, Floats]:
        """Follow rays (n, 3) of unit length to the first surface; return what they meet, and the distance (n,)."""
        surfaces = self._surfaces
        cells, shares = np.full((len(start), 4), -1), np.zeros((len(start), 4))
        far = np.full(len(start), np.inf)
        if len(surfaces.origin):
            which, far = surfaces.first_hit(start, way)
            met = which >= 0
            points = start[met] + far[met, None] * way[met]
            cells[met], shares[met] = self._flat(which[met], points, way[met])
        for number, ball in enumerate(surfaces.spheres):
            offset = start - ball[:3]
            along, beyond = _dot(offset, way), _dot(offset, offset) - ball[3] ** 2
            discriminant = along**2 - beyond
            enters = -along - np.sqrt(np.maximum(discriminant, 0.0))
            met = (discriminant > 0.0) & (enters > _NEAR * ball[3]) & (enters < far)
            place = (offset[met] + enters[met, None] * way[met]) / ball[3]
            far[met], cells[met], shares[met] = enters[met], self._round(number, place)[:, None], [1.0, 0.0, 0.0, 0.0]
        return Hits(cells, shares), far

    def _flat(self, which: Numbers, place: Floats, way: Floats) -> tuple[Numbers, Floats]:
        """Return the four cells of flat surfaces around places, (n, 4), and their weights in linear interpolation."""
        surfaces = self._surfaces
        offset = place - surfaces.origin[which]
        u, v = np.einsum("nij,nj->in", surfaces.dual[which], offset)
        triangle = surfaces.triangle[which]
        rest = np.maximum(1.0 - u, 1e-12)
        uv = np.stack([np.where(triangle, 1.0 - rest**2, u), np.where(triangle, v / rest, v)], axis=1)
        scale = np.arcsinh((uv * self._long[which] - self._foot[which]) / self._away[which, None])
        count = self._count[which]
        step = (scale - self._low[which]) / self._step[which] - 0.5
        low = np.clip(np.floor(step).astype(np.int64), 0, np.maximum(count - 2, 0))
        high, share = np.minimum(low + 1, count - 1), step - low  # extrapolated at a surface's edge
        first = self._start[which] + self._half * (_dot(way, surfaces.normal[which]) > 0.0)
        ends, parts = (low, high), (1.0 - share, share)
        pairs = [(i, j) for i in range(2) for j in range(2)]
        cells = np.stack([first + ends[i][:, 0] * count[:, 1] + ends[j][:, 1] for i, j in pairs], axis=1)
        return cells, np.stack([parts[i][:, 0] * parts[j][:, 1] for i, j in pairs], axis=1)

    def _round(self, number: int, place: Floats) -> Numbers:
        """Return the cells of a sphere at unit vectors (n, 3): bands of equal height, and twice as many meridians."""
        band = np.clip(((place[:, 2] + 1.0) / 2.0 * self._bands).astype(np.int64), 0, self._bands - 1)
        turn = np.arctan2(place[:, 1], place[:, 0]) / (2.0 * math.pi) % 1.0
        meridian = np.minimum((turn * 2 * self._bands).astype(np.int64), 2 * self._bands - 1)
        cells: Numbers = 2 * self._half + number * 2 * self._bands**2 + band * 2 * self._bands + meridian
        return cells

    def places(self, cells: Numbers, spread: Floats) -> tuple[Floats, Floats]:
        """Return places in cells (n,) and the normals there, (n, 3) each, for points (n, 2) of the unit square."""
        surfaces = self._surfaces
        points, normals = np.zeros((2, len(cells), 3))
        flat = cells < 2 * self._half
        back, inner = np.divmod(cells[flat], max(1, self._half))
        which = self._owner[inner]
        step = np.stack(np.divmod(inner - self._start[which], self._count[which, 1]), axis=1)
        # The ends of a cell; points are uniform between them.
        low, high = (self._low[which] + (step + k) * self._step[which] for k in (0, 1))
        low, high = np.sinh(low), np.sinh(high)
        along = self._away[which, None] * (low + spread[flat] * (high - low)) + self._foot[which]
        u, v = np.clip(along / self._long[which], 0.0, 1.0).T
        rest = np.sqrt(1.0 - u)
        triangle = surfaces.triangle[which]
        u, v = np.where(triangle, 1.0 - rest, u), np.where(triangle, v * rest, v)
        points[flat] = (
            surfaces.origin[which] + u[:, None] * surfaces.first[which] + v[:, None] * surfaces.second[which]
        )
        normals[flat] = np.where(back[:, None] > 0, -1.0, 1.0) * surfaces.normal[which]
        number, inner = np.divmod(cells[~flat] - 2 * self._half, 2 * self._bands**2)
        step = np.stack(np.divmod(inner, 2 * self._bands), axis=1) + spread[~flat]
        z, angle = 2.0 * step[:, 0] / self._bands - 1.0, math.pi * step[:, 1] / self._bands
        ring = np.sqrt(np.maximum(0.0, 1.0 - z**2))
        outward = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
        balls = surfaces.spheres[number]
        points[~flat], normals[~flat] = balls[:, :3] + balls[:, 3:] * outward, outward
        return points, normals


@dataclass(frozen=True)
class _Starts:
    """Rays that leave cells or points: origins and normals (n, 3), the receiver of each (n,), the point of the unit
    square for its direction (n, 2), the number of rays of each receiver, and the number of receivers."""

    places: Floats
    normals: Floats
    owner: Numbers
    spread: Floats
    rays: int
    receivers: int

    @classmethod
    def of(cls, cells: Cells, some: Numbers, rays: int) -> _Starts:
        """Return rays that start all over some cells."""
        spread = _turned(rays, 4, some).reshape(-1, 4)
        owner = np.repeat(some, rays)
        return cls(*cells.places(owner, spread[:, 2:]), owner, spread[:, :2], rays, cells.count)


@dataclass(frozen=True)
class Rows:
    """Irradiance of receivers per radiosity of each cell: a sparse matrix (receivers, cells), as its entries.

    Blender's Python has NumPy only; a product with the matrix takes a hundredth of a picture's time.

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
        empty = np.zeros(0, dtype=np.int64)
        owner, cell = (np.concatenate([empty, *(getattr(p, name) for p in parts)]) for name in ("owner", "cell"))
        return cls(shape, owner, cell, np.concatenate([np.zeros(0), *(p.weight for p in parts)]))

    def __matmul__(self, values: Floats) -> Floats:
        """Return what receivers obtain (receivers, groups) from cells' values (cells, groups)."""
        return _sums(self.owner, self.weight[:, None] * values[self.cell], self.shape[0])


@dataclass(frozen=True)
class _Met:
    """Rays that meet the target: receiver and weight of each (n,), cells of the target, and cells behind it."""

    owner: Numbers
    weight: Floats
    body: Hits
    behind: Hits


@dataclass(frozen=True)
class _Leaving:
    """What rays that leave the target meet of the room, and whether they meet the target itself before that (n,)."""

    seen: Hits
    own: NDArray[np.bool_]


class _Watch:
    """Points where the picture's light is evaluated, and polynomials that are fitted to it (the rule of
    `picture.Rule`, with more points than coefficients).

    Attributes
    ----------
    starts : _Starts
    share : ndarray of shape (points,)
        Share of the sky that each point sees in the empty scene.
    matrix : Rows of shape (points, cells)
        Irradiance of each point per radiosity of each cell.
    """

    def __init__(self, sky: Sky, to_wall: Floats, points: int) -> None:
        nodes, weights = leggauss(points)
        degrees = math.ceil(_DEGREES * points)
        transform = (np.arange(degrees) + 0.5)[:, None] * (legvander(nodes, degrees - 1) * weights[:, None]).T
        basis = legvander(nodes, degrees - 1)
        self._forth, self._back = np.kron(transform, transform), np.kron(basis, basis)
        u, v = np.tile(nodes, points), np.repeat(nodes, points)
        uv = (np.stack([u, v], axis=1) + 1.0) / 2.0
        homogeneous = np.concatenate([uv, np.ones((len(uv), 1))], axis=1) @ to_wall.T
        places = np.append(homogeneous[:, :2] / homogeneous[:, 2:], np.zeros((len(uv), 1)), axis=1)
        self._places = places
        self.starts = self._rays(_SEEN)
        self.share, self.matrix = sky.rows(self._rays(_WALL))

    def _rays(self, count: int) -> _Starts:
        indices = np.arange(len(self._places))
        owner = np.repeat(indices, count)
        normals = np.tile([0.0, 0.0, 1.0], (len(owner), 1))
        spread = _turned(count, 2, indices).reshape(-1, 2)
        return _Starts(self._places[owner], normals, owner, spread, count, len(indices))

    def held(self, light: Floats) -> tuple[Floats, float]:
        """Return coefficients (groups, n) of light (points, groups), and their relative root mean square error."""
        coefficients = self._forth @ light
        missed: Floats = light - self._back @ coefficients
        total = float((light**2).sum())
        return coefficients.T, math.sqrt(float((missed**2).sum()) / total) if total else 0.0


def _rows(shape: tuple[int, int], owners: Numbers, found: Hits) -> Rows:
    """Sum, cell by cell, what the rays of each receiver (n,) meet, of which all have the same number."""
    rays = len(found.cells) // len(owners)
    row, corner = np.nonzero(found.shares)
    key = row // rays * shape[1] + found.cells[row, corner]
    dense = np.bincount(key, found.shares[row, corner] / rays, len(owners) * shape[1])
    filled = np.flatnonzero(dense)
    row, cell = np.divmod(filled, shape[1])
    return Rows(shape, owners[row], cell, dense[filled].astype(np.float64))


class Sky:
    """The sky over an empty scene, and how its light reaches the surfaces.

    Parameters
    ----------
    setting : Setting
        Setting of a world with ambient light, whatever its target.
    order : int
        Number of reflections.

    Attributes
    ----------
    cells : Cells
        Cells of the room and of the relay wall.
    first, second : ndarray of shape (cells, groups)
        Radiosities of the cells after one and two reflections.
    gather : Rows of shape (cells, cells)
        Irradiance of each cell per radiosity of each other cell.
    starts : _Starts
        Rays from the cells whose light can reach the picture.

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
        # Cells that the picture sees neither directly nor by way of others do not matter: a room's outer sides.
        share, reached = np.zeros(self.cells.count), np.zeros(self.cells.count, dtype=bool)
        gathered: list[Rows] = []
        fresh = np.unique(self.watch(_POINTS).matrix.cell)
        while len(fresh):
            reached[fresh] = True
            sky_share, rows = self.rows(_Starts.of(self.cells, fresh, _ROWS))
            share += sky_share
            gathered.append(rows)
            seen = np.unique(rows.cell)
            fresh = seen[~reached[seen]]
        self.gather = Rows.joined((self.cells.count, self.cells.count), gathered)
        self.first = self.cells.tint * share[:, None]
        self.second = self.cells.tint * (self.gather @ self.first)
        self.starts = _Starts.of(self.cells, np.flatnonzero(reached), _TOWARDS)

    def watch(self, points: int) -> _Watch:
        """Return the picture's points, ``points`` along each side."""
        if points not in self._watches:
            self._watches[points] = _Watch(self, self._to_wall, points)
        return self._watches[points]

    def rows(self, starts: _Starts) -> tuple[Floats, Rows]:
        """Return receivers' share of the sky (n,) and irradiance per cell's radiosity (n, cells) without a target."""
        shape = starts.receivers, self.cells.count
        sky, matrices = np.zeros(starts.receivers), []
        step = max(1, _CHUNK // starts.rays) * starts.rays  # whole receivers
        for start in range(0, len(starts.owner), step):
            part = slice(start, start + step)
            ways = _hemisphere(starts.normals[part], starts.spread[part])
            hits, _ = self.cells.hit(starts.places[part], ways)
            owners = starts.owner[part][:: starts.rays]
            sky[owners] = hits.sky.reshape(len(owners), -1).mean(axis=1)
            matrices.append(_rows(shape, owners, hits))
        return sky, Rows.joined(shape, matrices)

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
        Setting of a world with ambient light.
    sky : Sky
        Sky over the empty scene of that world.
    """

    def __init__(self, setting: Setting, sky: Sky) -> None:
        self._sky, self._resolution = sky, setting.resolution
        target, balls = setting.target, len(setting.target.spheres)
        low, high = target.box
        self._centre = (low + high) / 2.0
        corners = np.concatenate(target.corners())
        corner_reach = np.linalg.norm(corners - self._centre, axis=1).max(initial=0.0)
        ball_reach = np.linalg.norm(target.spheres[:, :3] - self._centre, axis=1) + target.spheres[:, 3]
        self._radius = float(max(corner_reach, ball_reach.max(initial=0.0)))
        tint = setting.tint[len(setting.tint) - balls :]
        self._body = Cells(target, tint, _BODY_CELL, self._centre, self._radius)
        self._leaving = _Starts.of(self._body, np.arange(self._body.count), _LEAVE)
        self._ways = _hemisphere(self._leaving.normals, self._leaving.spread)
        self._own, self._own_far = self._body.hit(self._leaving.places, self._ways)

    def background(self) -> Floats:
        """Return the picture of the empty scene, (groups, height, width)."""
        return self._drawn(self._sky.background())

    def change(self, turn: Floats, place: Floats, *, shadows: bool = True) -> Floats:
        """Return the change of the picture by the target at a pose, (groups, height, width).

        Parameters
        ----------
        turn, place : ndarray of shape (3, 3) and (3,)
            Rotation and position in the wall's frame.
        shadows : bool
            Whether to include the light that it hides from the wall; without, only the light that it sends there.
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
        """Follow rays into the cone around the target; return those that meet it before the room."""
        offset = place + turn @ self._centre - starts.places
        facing = _dot(offset, starts.normals) > -self._radius
        offset, origin, normal = offset[facing], starts.places[facing], starts.normals[facing]
        spread, owner = starts.spread[facing], starts.owner[facing]
        far = np.sqrt(_dot(offset, offset))
        sine = self._radius / np.maximum(far, self._radius)
        cos_cone = np.where(far > self._radius, np.sqrt(1.0 - sine**2), -1.0)
        axis = offset / np.maximum(far, 1e-300)[:, None]
        way = _around(axis, 1.0 - (1.0 - cos_cone) * spread[:, 0], 2.0 * math.pi * spread[:, 1])
        weight = _dot(way, normal) * 2.0 * (1.0 - cos_cone) / starts.rays
        rows = np.flatnonzero(weight > 0.0)
        body, near = self._body.hit((origin[rows] - place) @ turn, way[rows] @ turn)
        met = ~body.sky
        rows, body, near = rows[met], body[met], near[met]
        behind, beyond = self._sky.cells.hit(origin[rows], way[rows])
        free = beyond > near
        rows, body, behind = rows[free], body[free], behind[free]
        return _Met(owner[rows], weight[rows], body, behind)

    def _light(self, watch: _Watch, met: _Met, around: _Met, leaving: _Leaving, tint: Floats) -> Floats:
        """Return the target's change at the picture's points, (points, groups), if its cells have albedo ``tint``."""
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
        shape = (self._body.count, -1)
        share = (leaving.seen.sky & ~leaving.own).reshape(shape).mean(axis=1)
        body = tint * share[:, None]
        change = rho * sky(around, self._sky.starts)
        room = self._sky.first + change
        light += watch.matrix @ change + instead(met, watch.starts, body, room)
        if self._sky.order < 3:
            return light
        change = rho * (self._sky.gather @ change + instead(around, self._sky.starts, body, room))
        arriving = np.where(leaving.own[:, None], self._own.of(body), leaving.seen.of(room))
        body = tint * arriving.reshape(*shape, groups).mean(axis=1)
        return light + watch.matrix @ change + instead(met, watch.starts, body, self._sky.second + change)

    def _drawn(self, coefficients: Floats) -> Floats:
        """Return the picture (groups, height, width) with coefficients (groups, n)."""
        width, height = self._resolution
        out = np.zeros((1, len(coefficients), height, width))
        whole = np.array([[0.0, 1.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]])
        picture.deposit(
            out, np.zeros(1, dtype=np.int64), whole[0], np.ascontiguousarray(coefficients)[None], whole[1]
        )
        return out[0]
