"""Tests whether two renderers agree on a picture, from the scatter of its pixels; needs neither Blender nor SciPy."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from generator.model.arrays import Array

SURE = 6.0
"""Standard errors beyond the tolerance from which on two figures differ. A normal figure goes so far once in 5e8; the
margin is for the tails of figures that are not normal, and for the many that are compared."""

HITS = 30.0
"""Fewest paths that must have found light before their scatter estimates the error of their mean."""

WHAT = ("background", "change by the target")

_LEAST = 32
"""Fewest pixels of a part of the picture that is compared by itself."""


@dataclass(frozen=True)
class Figure:
    """Mean radiance of a part of a picture, by plain Cycles and by an engine.

    Attributes
    ----------
    what : str
        One of `WHAT`.
    where : str
        Name of the part; empty for the whole picture.
    colour : str
        Name of the channel; empty if all are the same, or are averaged.
    plain, engine : float
        Mean radiance by each renderer, W/m^2/sr.
    error : float
        Standard error of their difference, W/m^2/sr.
    hits : float
        Approximate number of paths that found the light, as far as pixels tell them apart, or should have.
    tolerance : float
        Allowed error of the engine, relative to the larger of both.
    same : bool, optional
        For pictures with the same noise: whether they are equal up to rounding. Then no other field counts.
    """

    what: str
    where: str
    colour: str
    plain: float
    engine: float
    error: float
    hits: float
    tolerance: float = 0.0
    same: bool | None = None

    @property
    def excess(self) -> float:
        """Standard errors by which the two differ beyond the tolerance; 0 if too few paths found the light."""
        if self.same is not None:
            return 0.0 if self.same else math.inf
        allowed = self.tolerance * max(abs(self.plain), abs(self.engine))
        beyond = abs(self.plain - self.engine) - allowed
        if beyond <= 0.0 or self.hits < HITS:
            return 0.0
        return beyond / self.error if self.error > 0.0 else math.inf

    @property
    def differs(self) -> bool:
        """Whether the two differ by more than noise and tolerance."""
        return self.excess > SURE

    @property
    def precision(self) -> float:
        """Standard error relative to the engine's figure."""
        if self.hits < HITS or self.engine == 0.0:
            return 0.0 if self.error == 0.0 and self.plain == self.engine else math.inf
        return self.error / abs(self.engine)


def compare(
    plain: Array, engine: Array, *, samples: float, peak: float, tolerances: Sequence[float] = (0.0, 0.0)
) -> list[Figure]:
    """Compare a background, and its change by the target, in the whole picture and in its quarters.

    Pixels have independent noise, so the scatter of their differences gives the error of a mean. But where much light
    is found by rare chance, a sample that missed it scatters too little. So the error is never taken to be smaller
    than if the engine's figure were made of the brightest paths alone, whose number has a Poisson distribution.

    Parameters
    ----------
    plain, engine : ndarray of shape (2, height, width, 3)
        Background and difference by either, W/m^2/sr; or, of shape (1, height, width, 3), the background alone.
    samples : float
        Paths per pixel of ``plain``.
    peak : float
        Highest radiance that one path can find, W/m^2/sr.
    tolerances : two of float
        Allowed relative errors of the engine, of the background and of the difference.

    Returns
    -------
    list of Figure
        The first are of the whole picture, averaged over channels: one for each of `WHAT`.
    """
    grey = all(bool((a == a[..., :1]).all()) for a in (plain, engine))
    compared = WHAT[: len(plain)]
    figures = [
        _figure(name, "", "", plain[k].mean(axis=2), engine[k].mean(axis=2), samples, peak, tolerances[k])
        for k, name in enumerate(compared)
    ]
    for k, name in enumerate(compared):
        for where, part in _parts(*plain.shape[1:3]):
            for channel, colour in enumerate([""] if grey else ["red", "green", "blue"]):
                if where or colour:
                    pair = plain[k][part][..., channel], engine[k][part][..., channel]
                    figures.append(_figure(name, where, colour, *pair, samples, peak, tolerances[k]))
    return figures


def worst(figures: Sequence[Figure]) -> Figure:
    """Return the figure with the clearest difference; the whole picture's one instead, if that differs too."""
    most = max(figures, key=lambda figure: figure.excess)
    whole = (figure for figure in figures if not figure.where and not figure.colour and figure.what == most.what)
    return next((figure for figure in whole if figure.differs), most)


def _parts(height: int, width: int) -> Iterator[tuple[str, tuple[slice, slice]]]:
    yield "", (slice(None), slice(None))
    if (height // 2) * (width // 2) < _LEAST:
        return
    for row, rows in (("upper", slice(None, height // 2)), ("lower", slice(height // 2, None))):
        for side, columns in (("left", slice(None, width // 2)), ("right", slice(width // 2, None))):
            yield f"{row} {side} quarter", (rows, columns)


def _figure(
    what: str, where: str, colour: str, plain: Array, engine: Array, samples: float, peak: float, tolerance: float
) -> Figure:
    rays, expected = samples * plain.size, float(engine.mean())
    scatter = float((plain - engine).var(ddof=1)) / plain.size if plain.size > 1 else math.inf
    error = math.sqrt(max(scatter, abs(expected) * peak / rays))
    level, square = float(np.abs(plain).sum()), float((plain**2).sum())
    hits = max(level**2 / square if square > 0.0 else 0.0, rays * abs(expected) / peak if peak > 0.0 else math.inf)
    return Figure(what, where, colour, float(plain.mean()), expected, error, hits, tolerance)
