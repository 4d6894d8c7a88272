"""What a target at a pose changes of the light of many reflections, and of the sky.

Light travels along lines that meet the target. A line leaves the target's surface at y towards a place p of the
room, and backwards, through the target, reaches a place q behind it. In the empty room p sees q; now it sees y. So of
the light that has been reflected k times, with B_k the room's radiosity, dB_k its change, and b_k the target's,

    dE_(k+1)(p) = F dB_k + sum over lines of w (b_k(y) - B_k(q) - dB_k(q)),
    e_(k+1)(y) = sum over lines of w (B_k(p) + dB_k(p))

with the same lines for both sums, so that what the target takes is what it keeps from the room: with all surfaces as
bright as each other, nothing changes, to the last digit. Lines are spread by Sobol's sequence (Joe and Kuo 2008).
What the sums at p do to the picture, over any number of further reflections, is known from `field.LightField`.

The lamp's own light is exact up to the third reflection, elsewhere. Here, its first change is the target's shadow on
the room: the light that falls on the target would have met the room behind it.

From the wall, the target is looked at directly: by lines from points of the picture into the cone around the target.

The lines are four sets, and each gives a picture of its own. These differ by twice the error of their mean if lines
were drawn by chance, and by more as they are: lines are doubled until that is small enough.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport.compiled import COMPILED
from generator.transport.light.beams import Beams, arriving
from generator.transport.light.cells import Cells, summed
from generator.transport.light.field import FINEST, LightField
from generator.transport.light.follow import Between, Shade
from generator.transport.light.lines import SETS, Lines, completed, fair
from generator.transport.light.near import near_cells
from generator.transport.light.picture_points import PicturePoints, drawn
from generator.transport.light.spread import hemisphere, lattice, shifted, sobol, squares
from generator.transport.light.view import Eye, Pose, Skin, Sums, look, look_arrays, look_at, look_at_arrays
from generator.transport.prepared import Setting

Floats = NDArray[Any]
Numbers = NDArray[np.int64]

_BODY_CELL, _LIT_BALL = 0.25, 0.125
"""Size of a target's cell, of the target's radius; and of a sphere's that emitters light from one side."""
_LINES, _MOST_LINES = 1 << 14, 1 << 19
"""Number of lines through the target, at first and at most."""
_SURE = 0.6
"""Share of the error asked for that sets of lines may differ by: so few of them tell no more than its size."""
_RATE = 4.0 / 3.0
"""How many times lines are doubled to halve the error, as measured."""
_LIT, _PER_LIT = 1 << 10, 16
"""How many of the target's places the lamp's light is computed for at least; else one for so many lines."""
_FROM = 8
"""How many of a source's points light each of those places."""
_VIEWS = ((12, 0), (24, 0), (12, 128), (12, 512), (24, 512), (48, 512), (48, 2048))
"""Points along a side of the picture, and lines from each towards the target, or none where points of its surface are
summed; the next where polynomials fit the light worse than is asked for, it is noisy or rough, until that changes the
picture no more."""
_ALIKE = 0.5
"""Difference of two such pictures that counts as none, in units of the error asked for."""
_FITS = 0.3
"""Share of the error asked for that polynomials may differ from the light by at the points that they are fitted to:
between them, they differ by more."""
_FIRST_LINES = 2
_APART, _ROUND, _MOST_CUTS = 0.15, 3, 4
"""Distance of points on the target, in units of theirs from the picture; and into how many parts along a side cells
are cut for that, at least on a sphere, whose horizon runs through cells, and at most: else, lines are followed."""
_STEP = 0.25
"""Step of central differences, radians, and in units of the target's radius."""
_MOST_PARTS, _PARTS = 512, 4
"""Largest number of cells that are parts of their own, and of parts of a fine mesh along each axis."""


class _Samples(NamedTuple):
    """Lines in the target's own frame: where they start, their directions, and what of the target they meet.

    ``received`` (target's cells, sets) is the area that the lines of each cell stand for, by set.
    """

    owner: Numbers
    flux: Floats
    places: Floats
    normals: Floats
    ways: Floats
    own: Numbers
    own_far: Floats
    received: Floats


class _Choice(NamedTuple):
    """How many lines a picture took, and which of ``_VIEWS``; -1 if that is to be found."""

    lines: int
    view: int


class Followed(NamedTuple):
    """Change of a source's light by a target.

    Attributes
    ----------
    picture : ndarray of shape (groups, height, width)
    error : float
        What the lines may still be off by, as their sets tell: a root mean square, relative to that of this change
        and of what is known besides, joined as squares.
    choice : _Choice
        How many lines it took.
    """

    picture: Floats
    error: float
    choice: _Choice


class LightChange:
    """Changes by one target of the light that `LightField` describes.

    Parameters
    ----------
    setting : Setting
    field : LightField
        Of the same room.
    accuracy : float
        Root mean square error that lines cause, relative to the root of the sum of squares of this change and of
        what is known besides; at least `FINEST`.
    """

    def __init__(self, setting: Setting, field: LightField, accuracy: float) -> None:
        self._setting, self._field, self._resolution = setting, field, setting.resolution
        self._accuracy = max(FINEST, accuracy)
        target, balls = setting.target, len(setting.target.spheres)
        low, high = target.box
        self._centre = (low + high) / 2.0
        corners = np.concatenate(target.corners())
        corner_reach = np.linalg.norm(corners - self._centre, axis=1).max(initial=0.0)
        ball_reach = np.linalg.norm(target.spheres[:, :3] - self._centre, axis=1) + target.spheres[:, 3]
        self._radius = float(max(corner_reach, ball_reach.max(initial=0.0)))
        tint = setting.tint[len(setting.tint) - balls :]
        self._cell = _LIT_BALL if balls and "emitters" in field.sources else _BODY_CELL
        self._body = Cells(target, self._cell, self._centre, self._radius, tint)
        self._part, self._area, self._tint = self._parts()
        self._count = len(self._area)
        # The back of a solid is part of no sum.
        sided = target.area.sum() * (2.0 if setting.outward is None else 1.0)
        self._sampled_area = float(sided + 4.0 * math.pi * (target.spheres[:, 3] ** 2).sum())
        self._corners = corners, target.spheres
        self._in_unit = _in_unit(setting)
        self._skins: dict[int, Skin] = {}
        self._samples: dict[tuple[int, bool], _Samples] = {}
        self._eyes: dict[int, tuple[PicturePoints, Eye]] = {}

    def followed(
        self, turn: Floats, place: Floats, exact: Floats | None = None, *, shadows: bool = True
    ) -> dict[str, Followed]:
        """Return the change of the picture by the target at a pose, for each of `LightField.sources`.

        Parameters
        ----------
        turn, place : ndarray of shape (3, 3) and (3,)
            Rotation and position in the wall's frame.
        exact : ndarray of shape (groups, height, width), optional
            What is known of the lamp's change, in the unit of its picture: errors are relative to it too, in all
            pictures.
        shadows : bool
            Whether to include the light that it hides from the wall; without, only the light that it sends there.

        Returns
        -------
        followed : dict of str to Followed
        """
        return self._settled(self._pose(turn, place), exact, shadows)

    def may_enclose_a_lamp(self, turn: Floats, place: Floats) -> bool:
        """Whether a solid target at a pose has something that gives light inside the ball around it."""
        beams = self._field.sources["emitters"].beams if "emitters" in self._field.sources else None
        if beams is None or (self._setting.outward is None and not len(self._setting.target.spheres)):
            return False
        away = np.linalg.norm(beams.finest.places - self._pose(turn, place).centre, axis=1)
        return bool(away.min() < self._radius)

    def slopes(self, turn: Floats, place: Floats, exact: Floats | None = None) -> dict[str, Floats]:
        """Return the derivatives of `followed`, by central differences with the same lines on both sides.

        Returns
        -------
        slopes : dict of str to ndarray of shape (7, groups, height, width)
            With respect to the target's place (3), its rotation about the frame's axes (3, per radian), and its
            strength (a factor on all its albedo).
        """
        step = _STEP * self._radius
        found = {}
        for name, (_, _, choice) in self._settled(self._pose(turn, place), exact, True).items():
            # A difference of two pictures keeps the noise of both.
            choice = choice._replace(lines=min(2 * choice.lines, _MOST_LINES))

            def at(turn: Floats, place: Floats, gain: float, name: str = name, choice: _Choice = choice) -> Floats:
                pose = self._pose(turn, place)
                lines = self._through(self._sampled(choice.lines, is_near=pose.near.there), pose)
                drawn, _, _ = self._several(name, lines, pose, exact, True, choice, gain)
                return drawn.mean(axis=0)

            moved = [[at(turn, place + sign * step * axis, 1.0) for sign in (1.0, -1.0)] for axis in np.eye(3)]
            turned = [
                [at(_turned(axis, sign * _STEP) @ turn, place, 1.0) for sign in (1.0, -1.0)] for axis in np.eye(3)
            ]
            gained = [at(turn, place, 1.0 + sign * _STEP) for sign in (1.0, -1.0)]
            pairs = [*((pair, step) for pair in moved), *((pair, _STEP) for pair in (*turned, gained))]
            found[name] = np.stack([(after - before) / (2.0 * width) for (after, before), width in pairs])
        return found

    def _pose(self, turn: Floats, place: Floats) -> Pose:
        centre, target = place + turn @ self._centre, self._setting.target
        ball = np.append(centre, self._radius)
        near = near_cells(self._field.cells, self._setting.around, target, turn, place, ball, self._field.factor)
        return Pose(turn, place, centre, self._radius, near)

    def _settled(self, pose: Pose, exact: Floats | None, shadows: bool) -> dict[str, Followed]:
        known = {name: None if exact is None else self._in_unit[name] * exact for name in self._field.sources}
        found: dict[str, Followed] = {}
        count = _LINES
        while known:
            lines, excess = self._through(self._sampled(count, is_near=pose.near.there), pose), 0.0
            for name in list(known):
                several, level, view = self._several(name, lines, pose, known[name], shadows, _Choice(count, -1))
                error = math.sqrt(several.var(axis=0, ddof=1).mean() / SETS) / max(level, 1e-300)
                if error <= _SURE * self._accuracy or count == _MOST_LINES:
                    found[name] = Followed(several.mean(axis=0), error, _Choice(count, view))
                    del known[name]
                excess = max(excess, error / (_SURE * self._accuracy))
            count = min(_MOST_LINES, count << max(1, round(_RATE * math.log2(max(1.0, min(excess, 1e3))))))
        return {name: found[name] for name in self._field.sources}

    def _several(
        self,
        name: str,
        lines: Lines,
        pose: Pose,
        exact: Floats | None,
        shadows: bool,
        choice: _Choice,
        gain: float = 1.0,
    ) -> tuple[Floats, float, int]:
        """Return the change of a source's light by each set of lines, (sets, groups, height, width), what errors are
        relative to (`_level`), and which of ``_VIEWS`` was taken.

        ``gain`` is a factor on the target's albedo.
        """
        source = self._field.sources[name]
        samples = self._sampled(choice.lines, is_near=pose.near.there)
        shade = None if source.beams is None else self._shade(source.beams, samples, pose)
        tint = gain * self._tint
        sums = Between(self._field, source, lines, samples.received, tint, pose, shade).sums()
        pictures, view = self._drawn(sums, pose, exact, choice.view)
        if not shadows:  # less what a black target changes
            black = np.zeros_like(self._tint)
            dark = Between(self._field, source, lines, samples.received, black, pose, shade).sums()
            pictures = pictures - self._drawn(dark, pose, exact, view)[0]
        elif name == "emitters" and self._field.shadow is not None:
            pictures = pictures - self._field.shadow.hidden(pose, choice.lines)
        return pictures, _level(pictures, exact), view

    def _parts(self) -> tuple[Numbers, Floats, Floats]:
        """Return the part of the target that each of its cells is in, (cells + 1,), and the parts' areas and albedos.

        A target of few cells has a part for each. Of a fine mesh, cells of one albedo that are near each other and
        face the same way are one part.
        """
        body = self._body
        if body.count <= _MOST_PARTS:
            return np.arange(body.count + 1), body.area, body.tint
        places, normals = body.places(np.arange(body.count), np.full((body.count, 2), 0.5))
        where = np.clip(((places - self._centre) / self._radius + 1.0) * (_PARTS / 2.0), 0, _PARTS - 1)
        keys = np.concatenate([where.astype(np.int64), np.rint(1.2 * normals).astype(np.int64), body.tint], axis=1)
        _, part = np.unique(keys, axis=0, return_inverse=True)
        part = part.reshape(-1)
        area = np.bincount(part, body.area)
        tint = summed(part, body.tint * body.area[:, None], len(area)) / area[:, None]
        return np.append(part, len(area)), area, tint

    def _sampled(self, count: int, *, is_near: bool = False) -> _Samples:
        """Return so many lines.

        Sets that are one net together sum up best, but each avoids the lines of the others. Where cells are so small
        that few lines meet each, what one set brings there would not be found by another as often as it should.
        """
        key = count, is_near
        if key not in self._samples:
            body, size = self._body, count // SETS
            apart = [sobol(size, 4, number) for number in range(SETS)] if is_near else [sobol(count, 4)]
            points = np.concatenate(apart)
            cell, places, normals = body.scattered(points[:, :2], self._setting.outward)
            owner, ways = self._part[cell], hemisphere(normals, points[:, 2:])
            number = np.stack([np.bincount(part, minlength=self._count) for part in owner.reshape(SETS, -1)], axis=1)
            received = self._seen_area(owner)[:, None] * fair(number)
            flux = (received / np.maximum(number, 1))[owner, np.arange(count) // size]
            met = body.meet(places, ways)
            self._samples[key] = _Samples(
                *(owner, flux, places, normals, ways, self._part[met.cell], met.far, received)
            )
        return self._samples[key]

    def _through(self, samples: _Samples, pose: Pose) -> Lines:
        places, ways = samples.places @ pose.turn.T + pose.place, samples.ways @ pose.turn.T
        cells = self._field.cells
        front, behind = (pose.near.marked(cells.meet(places, way), places, way, cells) for way in (ways, -ways))
        own = np.where(samples.own_far < front.far, samples.own, self._count)
        return Lines(samples.owner, samples.flux, own, front, behind)

    def _shade(self, beams: Beams, samples: _Samples, pose: Pose) -> Shade:
        """Return the light of beams on the target, and its shadow."""
        setting, cells = self._setting, self._field.cells
        size, first = len(samples.owner) // SETS, max(_LIT, len(samples.owner) // _PER_LIT) // SETS
        # The beginning of each set is spread evenly, too.
        some = (size * np.arange(SETS)[:, None] + np.arange(first)).reshape(-1)
        owner, part = samples.owner[some], some // size
        places, normals = samples.places[some] @ pose.turn.T + pose.place, samples.normals[some] @ pose.turn.T
        points = beams.points(pose.centre, pose.radius)
        groups, count = points.weights.shape[1], len(points.places)
        each = min(count, _FROM)
        offsets = (count * lattice(len(some), 1)).astype(np.int64)
        chosen = (offsets + np.arange(each) * count // each) % count
        light = arriving(beams, points, places, normals, chosen)
        weights = points.weights * (count / each)
        row, column = np.nonzero(light)
        node = chosen[row, column]
        if not setting.convex:
            start, end = (places[row] - pose.place) @ pose.turn, (points.places[node] - pose.place) @ pose.turn
            hidden = setting.target.blocked(start, end)
            light[row[hidden], column[hidden]] = 0.0
            row, column, node = (part[~hidden] for part in (row, column, node))
        number, received = np.zeros((self._count, SETS)), np.zeros((self._count, SETS, groups))
        np.add.at(number, (owner, part), 1.0)
        np.add.at(received, (owner, part), np.einsum("nk,nkg->ng", light, weights[chosen]))
        found = (received / np.maximum(number, 1.0)[:, :, None]).reshape(self._count, -1)
        found = completed(found, np.repeat(number == 0.0, groups, axis=1), groups)
        area = (self._seen_area(owner)[:, None] * fair(number) / np.maximum(number, 1.0))[owner, part]
        way = places[row] - points.places[node]
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        met = pose.near.marked(cells.meet(places[row], way), places[row], way, cells)
        taken = np.zeros((len(row), SETS, groups))
        taken[np.arange(len(row)), part[row]] = (light[row, column] * area[row])[:, None] * weights[node]
        return Shade(found, -met.spread(taken.reshape(len(row), SETS * groups), pose.near.length))

    def _drawn(self, sums: Sums, pose: Pose, exact: Floats | None, view: int) -> tuple[Floats, int]:
        """Return the pictures (sets, groups, height, width) of sums, with the target seen directly by one of
        ``_VIEWS``, or, for -1, by the first that is good enough; and which that is."""
        room = drawn(sums.coefficients, self._resolution)
        shape = (SETS, -1, *room.shape[1:])
        cuts = self._cuts(pose)
        fixed, view = view >= 0, max(view, 0 if cuts else _FIRST_LINES)
        sums = sums._replace(body=np.append(sums.body, np.zeros((1, sums.body.shape[1])), axis=0)[self._part])
        before = None
        while True:
            points, eye = self._eye(view)
            light = self._looked_at(eye, pose, sums, cuts) if view < _FIRST_LINES else self._looked(eye, pose, sums)
            fit = points.fit @ light
            pictures: Floats = (room + drawn(fit, self._resolution)).reshape(shape)
            if fixed or view + 1 == len(_VIEWS):
                return pictures, view
            most = self._accuracy * _level(pictures, exact)
            is_alike = before is not None and _differ(pictures, before) <= _ALIKE * most
            if is_alike or points.misfit(light, fit) <= _FITS * most:
                return pictures, view
            before, view = pictures, view + 1

    def _cuts(self, pose: Pose) -> int:
        """Return into how many parts along a side cells are cut to be seen from the picture; 0 if too many."""
        corners, spheres = self._corners
        if not self._body.few:
            return 0
        lowest = [corners @ pose.turn[2], spheres[:, :3] @ pose.turn[2] - spheres[:, 3]]
        height = pose.place[2] + float(np.concatenate(lowest).min())
        aside = max(0.0, float(np.linalg.norm(pose.centre[:2])) - self._radius - 1.0)
        cuts = math.ceil(self._cell * self._radius / (_APART * max(1e-9, math.hypot(aside, height))))
        cuts = max(cuts, _ROUND if len(spheres) else 1)
        return cuts if cuts <= _MOST_CUTS else 0

    def _skin(self, cuts: int) -> Skin:
        if cuts not in self._skins:
            body, hides = self._body, not self._setting.convex
            cells = np.repeat(body.outer(self._setting.outward), cuts**2)
            places, normals = body.places(cells, np.tile(squares(cuts), (len(cells) // cuts**2, 1)))
            self._skins[cuts] = Skin(places, normals, cells, body.area[cells] / cuts**2, hides)
        return self._skins[cuts]

    def _looked_at(self, eye: Eye, pose: Pose, sums: Sums, cuts: int) -> Floats:
        """As `_looked`, over points of the target's surface."""
        body, cells, skin = self._body, self._field.cells, self._skin(cuts)
        if COMPILED and cells.few:
            light = np.zeros((len(eye.places), sums.body.shape[1]))
            look_at(eye.places, pose, skin, body.grid, cells.grid, sums, light)
            return light
        return look_at_arrays(eye.places, pose, skin, self._setting.target, cells, sums)

    def _seen_area(self, owner: Numbers) -> Floats:
        """Return the area of each part, made larger where lines (n,) lead to others only: none of it is lost."""
        there = np.bincount(owner, minlength=self._count) > 0
        area: Floats = np.where(there, self._area * (self._sampled_area / self._area[there].sum()), 0.0)
        return area

    def _eye(self, view: int) -> tuple[PicturePoints, Eye]:
        if view not in self._eyes:
            side, rays = _VIEWS[view]
            points = PicturePoints(self._setting.to_wall, side)
            self._eyes[view] = points, Eye(points.places, shifted(rays, 2, np.arange(side * side)))
        return self._eyes[view]

    def _looked(self, eye: Eye, pose: Pose, sums: Sums) -> Floats:
        """Return the light (points, columns) that the target sends to the picture's points, less what it hides."""
        body, cells = self._body, self._field.cells
        if COMPILED and body.few and cells.few:
            light = np.zeros((len(eye.places), sums.body.shape[1]))
            look(eye, pose, body.grid, cells.grid, sums, light)
            return light
        return look_arrays(eye, pose, body, cells, sums)


def _turned(axis: Floats, angle: float) -> Floats:
    """Return the rotation matrix about one of the frame's axes (3,), a unit vector, by an angle."""
    cross = np.cross(np.eye(3), axis)
    turn: Floats = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    return turn


def _in_unit(setting: Setting) -> dict[str, float]:
    """Return the unit of the lamp's pictures in that of each source's (`LightField.sources`), of the mean colour."""
    lamp = math.pi * float(np.mean(setting.factor))
    units = {"lamp": lamp}
    if setting.sky is not None:
        units["sky"] = float(np.mean(setting.sky))
    if setting.emission is not None:
        units["emitters"] = float(np.mean(setting.emission.colour))
    return {name: lamp / max(unit, 1e-300) for name, unit in units.items()}


def _differ(one: Floats, other: Floats) -> float:
    """Return the root mean square difference of two pictures, each the mean of those of the sets (sets, ...)."""
    return math.sqrt(float(((one - other).mean(axis=0) ** 2).mean()))


def _level(pictures: Floats, exact: Floats | None) -> float:
    """Return what errors are relative to: the root mean square of pictures (sets, ...) and of what is known besides.

    The two are joined as squares, since they may cancel: what the target adds and what it hides are much of either.
    """
    parts = [pictures.mean(axis=0), *([] if exact is None else [exact])]
    return math.sqrt(sum(float((part**2).mean()) for part in parts))
