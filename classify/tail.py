"""How rare a value is among others, also beyond the largest of them."""

from __future__ import annotations

import numpy as np
from scipy.stats import binom, genpareto

from generator.model.arrays import Array

RARE = 0.01
"""Probability below which a picture is counted as one that does not fit what it is compared with."""
_TAIL = 0.1
"""Share of the values that the tail is fitted to."""


def more_than_chance(probabilities: Array, chance: float = RARE) -> tuple[int, bool]:
    """Return how many of probabilities (n,) are `RARE`, and whether more are than chance would have it.

    ``chance`` is the probability with which so many would be.
    """
    count, rare = len(probabilities), int((probabilities < RARE).sum())
    return rare, rare > 0 and bool(binom.sf(rare - 1, count, RARE) < chance + 1e-12)


class Tail:
    """Estimates how probable it is that a value is exceeded.

    Up to a high threshold by counting; beyond it, excesses have a generalised Pareto distribution (Pickands 1975).

    Parameters
    ----------
    values : ndarray of shape (n,)
        What was observed, twenty values or more.
    """

    def __init__(self, values: Array) -> None:
        self._values = np.sort(values)
        self._threshold = float(np.quantile(self._values, 1.0 - _TAIL))
        excesses = self._values[self._values > self._threshold] - self._threshold
        if len(excesses):
            shape, _, scale = genpareto.fit(excesses, floc=0.0)
            self._beyond = genpareto(max(0.0, float(shape)), scale=float(scale))  # never a largest value
        else:  # many are equal
            self._beyond = genpareto(0.0, scale=max(abs(self._threshold), 1e-300))

    def exceeded(self, value: float) -> float:
        """Return the probability of a value at least as large."""
        if value > self._threshold:
            return _TAIL * float(self._beyond.sf(value - self._threshold))
        return float((len(self._values) - np.searchsorted(self._values, value)) / len(self._values))
