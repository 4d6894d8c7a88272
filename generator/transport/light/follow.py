"""Light that is followed between a target at a pose and the room, reflection by reflection, or all of it at once.

Let L be the room's radiosity and b the target's, summed over all reflections, L_0 that of the empty room, S what the
target adds to and takes from the room along the lines that meet it, T what it receives along them, and F the exchange
of the empty room. Then

    b = b_0 + rho_t T(L, b),    L = L_0 + (1 - rho F)^-1 (s_0 + rho S(L, b))

with b_0 and s_0 the lamp's light on the target and the shadow that it casts. What comes back to the target from what
it changed is small, so a few steps of this fixed point are enough; where they are not, in a room that loses hardly
any light, the steps before are used to find the next one (Anderson 1965; Walker and Ni 2011, equation 1.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.model.quantities import ALL_ORDERS
from generator.transport.compiled import COMPILED, jit_released
from generator.transport.light.field import LEFT, LightField, Source, still_to_come
from generator.transport.light.lines import SETS, Lines, completed, leaving, onward, received
from generator.transport.light.view import Pose, Sums

Floats = NDArray[Any]

_LEFT_OF_ALL = 2e-4
"""Share of the change at which further steps are left out, where all reflections count."""
_SWEEPS = 4
"""How often the light that cells beside the target exchange is made even elsewhere, where all reflections count."""
_BESIDE = 4.0
"""Distance from the target's middle within which light goes from cell to cell, in units of the target's radius."""
_STEPS, _BEFORE = 64, 5
"""Most steps where all reflections count, and how many of those before are kept."""


@dataclass(frozen=True)
class Shade:
    """A lamp's light on a target, and its shadow.

    Attributes
    ----------
    lit : ndarray of shape (target's cells, sets * groups)
        Irradiance of the target's cells.
    taken : ndarray of shape (rows, sets * groups)
        Irradiance of the room's, what the target takes, times their area, as `Near` lists them.
    """

    lit: Floats
    taken: Floats


class Between:
    """Light of one source between a target at a pose and the room.

    Parameters
    ----------
    field : LightField
    source : Source
    lines : Lines
        Through the target.
    area : ndarray of shape (target's cells, sets)
        Area that the lines of each cell stand for.
    tint : ndarray of shape (target's cells, groups)
        Its albedo.
    pose : Pose
    shade : Shade, optional
        Of a source that lights the target itself.
    """

    def __init__(
        self,
        field: LightField,
        source: Source,
        lines: Lines,
        area: Floats,
        tint: Floats,
        pose: Pose,
        shade: Shade | None,
    ) -> None:
        self._field, self._source, self._lines, self._near = field, source, lines, pose.near
        self._beside = _beside(field, pose)
        self._groups = tint.shape[1]
        self._target_area = np.repeat(area, self._groups, axis=1)
        self._tint, self._room_tint = np.tile(tint, SETS), np.tile(field.tint, SETS)
        self._small_tint = np.tile(pose.near.tint, SETS)
        self._area, self._small_area = field.cells.area[:, None], pose.near.area
        # What the lamp changes of the first reflection.
        self._body, self._change = np.zeros_like(self._tint), np.zeros((len(self._area) + 1, SETS * self._groups))
        self._small, self._coefficients = np.zeros_like(self._small_tint), np.zeros((len(field.points.fit), 1))
        self._is_shaded = shade is not None and source.first < field.order
        if shade is not None and self._is_shaded:
            self._body = self._tint * shade.lit
            some, by = self._parted(shade.taken)
            self._change[:-1] = self._room_tint * onward(some, self._groups)
            self._small = self._small_tint * onward(by, self._groups)
            # Of the lamp's light, what the wall sees directly is exact elsewhere.
            directly = source.first == source.shown
            self._coefficients = field.shown(some, field.order - 1 - source.first, directly=directly)

    def sums(self) -> Sums:
        """Return what the wall sees of the target and of the room with it."""
        if self._source.first >= self._field.order:  # the wall is lit directly only
            none = np.zeros_like(self._change)
            level = self._near.joined(none, none, none, np.zeros_like(self._small))
            return Sums(level, self._body, np.zeros((len(self._field.points.fit), level.shape[1])))
        return self._all() if self._field.order == ALL_ORDERS else self._by_reflection()

    def _by_reflection(self) -> Sums:
        source, field = self._source, self._field
        level, body = self._next(source.levels[0], self._change, np.zeros_like(self._change), self._small), self._body
        change, room_sum, body_sum = self._change, np.zeros_like(level), np.zeros_like(body)
        coefficients = onward(self._coefficients, self._groups) + np.zeros((1, level.shape[1]))
        last, sizes = len(source.levels) - 1, [0.0]
        for index in range(last + 1):
            reflections = source.first + index
            if reflections >= source.shown:
                room_sum += level
                body_sum += body
            if reflections == field.order - 1:
                break
            added, by = self._parted(leaving(self._lines, level, body, self._groups))
            more = field.shown(added, field.order - 2 - reflections)
            coefficients += more
            sizes.append(float(np.abs(more).max()))
            if index == last or (index > 2 and still_to_come(sizes) <= LEFT * np.abs(coefficients).max()):
                break
            body = self._lit(level, body)
            even = np.zeros_like(change)
            even[:-1] = self._room_tint * self._exchanged(change[:-1], index == 0)
            change = even.copy()
            change[:-1] += self._room_tint * added
            level = self._next(source.levels[index + 1], change, even, self._small_tint * by)
        return Sums(room_sum, body_sum, onward(coefficients, self._groups, -1))

    def _exchanged(self, change: Floats, is_first: bool) -> Floats:
        """Return the irradiance of cells by the changed radiosity (cells, columns) of all others."""
        field = self._field
        if is_first and self._is_shaded:  # a lamp's shadow is small and sharp
            return field.spread(change)
        if self._beside is None:
            return field.evened(change)
        return np.where(self._beside, field.received(change, self._beside[:, 0]), field.evened(change))

    def _all(self) -> Sums:
        shadow = self._room_tint * self._field.spread(self._change[:-1]) if self._is_shaded else 0.0
        cells, small = len(self._area), len(self._small_area)

        def room(added: Floats) -> Floats:
            """Return the room's radiosity if the target adds so much to its cells, small ones too."""
            lit, by = self._room_tint * added[:cells], added[cells : cells + small]
            even, change = np.zeros_like(self._change), self._change.copy()
            even[:-1] = shadow + self._room_tint * self._field.evened(shadow + lit)
            change[:-1] += lit
            if self._beside is not None:
                for _ in range(_SWEEPS):
                    fine = self._room_tint * self._field.received((change + even)[:-1], self._beside[:, 0])
                    more = np.where(self._beside, fine - even[:-1], 0.0)
                    even[:-1] += more + self._room_tint * self._field.evened(more)
            change += even
            return self._next(self._source.total, change, even, self._small + self._small_tint * by)

        weights = np.concatenate([self._area, self._small_area, self._target_area.mean(axis=1, keepdims=True)])
        level: Floats = np.zeros((0, 0))

        def step(state: Floats) -> Floats:
            nonlocal level
            level = room(state)
            body = self._body + self._lit(level, state[cells + small :])
            return np.concatenate([*self._parted(leaving(self._lines, level, body, self._groups)), body])

        start = np.concatenate([np.zeros((cells + small, self._body.shape[1])), self._body])
        found = fixed_point(step, start, weights)
        added, body = found[:cells], found[cells + small :]
        if self._source.shown > self._source.first:
            none = np.zeros_like(self._change)
            level = level - self._next(self._source.levels[0], self._change, none, self._small)
            body = body - self._body
        return Sums(level, body, self._coefficients + onward(self._field.shown(added, ALL_ORDERS), self._groups, -1))

    def _lit(self, level: Floats, body: Floats) -> Floats:
        """Return the target's next radiosity.

        What it receives along one set's lines it sends along another's, as `leaving` does.
        """
        arriving = received(self._lines, level, body, self._groups) / np.maximum(self._target_area, 1e-300)
        by_set = completed(arriving, self._target_area == 0.0, self._groups)
        return self._tint * onward(by_set, self._groups)

    def _parted(self, values: Floats) -> tuple[Floats, Floats]:
        """Return the irradiance of the room's cells and of the small ones from a list of light times area."""
        some, by = self._near.parted(values)
        return some / self._area, by / self._small_area

    def _next(self, empty: Floats, change: Floats, even: Floats, small: Floats) -> Floats:
        """Return a list of radiosities."""
        return self._near.joined(np.tile(empty, SETS), change, even, small)


def _beside(field: LightField, pose: Pose) -> NDArray[np.bool_] | None:
    """Return which cells (cells, 1) are by a target that is near a surface: its shadow stays sharp there."""
    if not pose.near.there:
        return None
    away = np.linalg.norm(field.middles - pose.centre, axis=1)
    is_beside: NDArray[np.bool_] = (away < _BESIDE * pose.radius)[:, None]
    return is_beside


def _weighted_loops(there: Floats, at: Floats, weights: Floats) -> tuple[Floats, float, float]:
    """Return the weighted difference (n, columns) of two states, and the summed sizes of it and of the first."""
    gap = np.empty_like(there)
    size, whole = 0.0, 0.0
    for i in range(there.shape[0]):
        for c in range(there.shape[1]):
            gap[i, c] = weights[i, 0] * (there[i, c] - at[i, c])
            size += abs(gap[i, c])
            whole += abs(weights[i, 0] * there[i, c])
    return gap, size, whole


def weighted_arrays(there: Floats, at: Floats, weights: Floats) -> tuple[Floats, float, float]:
    """NumPy form of `_weighted_loops`."""
    gap = weights * (there - at)
    return gap, float(np.abs(gap).sum()), float(np.abs(weights * there).sum())


weighted = jit_released(_weighted_loops) if COMPILED else weighted_arrays


def fixed_point(step: Callable[[Floats], Floats], start: Floats, weights: Floats) -> Floats:
    """Return x for which step(x) is x, of a linear ``step``.

    Parameters
    ----------
    step : callable
    start : ndarray of shape (n, columns)
        Where to begin.
    weights : ndarray of shape (n, 1)
        What differences count for.
    """
    at = start
    states: list[Floats] = []
    gaps: list[Floats] = []
    sizes: list[float] = []
    for _ in range(_STEPS):
        there = step(at)
        gap, size, whole = weighted(there, at, weights)
        states, gaps = [*states[-_BEFORE:], there], [*gaps[-_BEFORE:], gap]
        sizes.append(size)
        # Each step comes nearer by a factor, as far as can be told.
        left = sizes[-1] * min(1.0, sizes[-1] / sizes[-2]) if len(sizes) > 1 else sizes[-1]
        if left <= _LEFT_OF_ALL * whole:
            break
        at = there
        if len(gaps) > 1:
            differences = np.stack([one - gap for one in gaps[:-1]]).reshape(len(gaps) - 1, -1)
            gram, right = differences @ differences.T, differences @ gap.reshape(-1)
            factors = np.linalg.lstsq(gram, right, rcond=1e-12)[0]
            for factor, one in zip(factors, states[:-1], strict=True):
                at = at - factor * (one - there)
    return there
