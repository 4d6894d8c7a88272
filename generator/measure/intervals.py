"""How sure a figure of many is."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import stats

from generator.model.arrays import Array

_RESAMPLES = 2000


def bootstrap(values: Array, what: Callable[..., Any] = np.mean) -> tuple[float, float, float]:
    """Return a figure of values (n,), and its 95 % percentile interval of a bootstrap (Efron 1979).

    One value alone tells nothing of how far it may be off: its interval is not a number.
    """
    if len(values) < 2:
        return float(what(values)), math.nan, math.nan
    rng = np.random.default_rng(0)
    options: dict[str, Any] = {"n_resamples": _RESAMPLES, "method": "percentile", "vectorized": True, "rng": rng}
    found = stats.bootstrap((values,), what, **options).confidence_interval
    return float(what(values)), float(found.low), float(found.high)


def relative(error: Array, signal: Array) -> tuple[float, float, float]:
    """Return a relative error, root mean square over places, and its 95 % interval.

    Parameters
    ----------
    error, signal : ndarray of shape (rounds, places)
        Mean squares of an error and of what it is an error of, each in other samples of the same places. Every place
        counts as much as any other, and is measured by its own mean signal: where that nearly vanishes in one sample,
        no finite relative error would do.

    Returns
    -------
    (float, float, float)
        By Student's t over the rounds; without an end where there is but one, and not a number where the signal is
        hidden by its noise.
    """
    level = signal.mean(axis=0)
    if (level <= 0.0).any():
        return math.nan, 0.0, math.inf
    each = (error / level).mean(axis=1)
    if len(each) < 2:
        return math.sqrt(max(0.0, float(each.mean()))), 0.0, math.inf
    half = float(stats.t.ppf(0.975, len(each) - 1) * each.std(ddof=1) / math.sqrt(len(each)))
    low, value, high = (math.sqrt(max(0.0, float(each.mean()) + x)) for x in (-half, 0.0, half))
    return value, low, high
