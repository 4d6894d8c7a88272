"""Confidence intervals of statistics over many values."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import stats

from generator.model.arrays import Array

_RESAMPLES = 2000


def bootstrap(values: Array, what: Callable[..., Any] = np.mean) -> tuple[float, float, float]:
    """Return a statistic of values (n,), and its 95 % percentile interval of a bootstrap (Efron 1979).

    A single value gives no estimate of its own error: the ends of its interval are NaN.
    """
    if len(values) < 2:
        return float(what(values)), math.nan, math.nan
    rng = np.random.default_rng(0)
    options: dict[str, Any] = {"n_resamples": _RESAMPLES, "method": "percentile", "vectorized": True, "rng": rng}
    interval = stats.bootstrap((values,), what, **options).confidence_interval
    return float(what(values)), float(interval.low), float(interval.high)


def relative(error: Array, signal: Array) -> tuple[float, float, float]:
    """Return a relative error, root mean square over places, and its 95 % interval.

    Parameters
    ----------
    error, signal : ndarray of shape (rounds, places)
        Mean squares of an error and of the signal that it belongs to; each round takes other samples of the same
        places. Every place has the same weight and is divided by its signal's mean over the rounds, since the signal
        of a single round may nearly vanish.

    Returns
    -------
    (float, float, float)
        Value, low and high end, by Student's t over the rounds; with a single round the ends are 0 and infinity, and
        the value is NaN where noise hides the signal.
    """
    level = signal.mean(axis=0)
    if (level <= 0.0).any():
        return math.nan, 0.0, math.inf
    ratios = (error / level).mean(axis=1)
    if len(ratios) < 2:
        return math.sqrt(max(0.0, float(ratios.mean()))), 0.0, math.inf
    half = float(stats.t.ppf(0.975, len(ratios) - 1) * ratios.std(ddof=1) / math.sqrt(len(ratios)))
    low, value, high = (math.sqrt(max(0.0, float(ratios.mean()) + x)) for x in (-half, 0.0, half))
    return value, low, high
