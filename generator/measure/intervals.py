"""Confidence intervals of statistics over many values."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq
from scipy.special import betainc, ndtr
from scipy.stats import t as student

from generator.model.arrays import Array

_SYMMETRIC = 1e-6
"""Skewness below which it is not removed, as rounding would be divided by it."""


def median(values: Array, *, trials: float = 0.0, z: float = 1.959964) -> tuple[float, float, float]:
    """Return the median of values (n,), and the ends of its interval.

    The ends are fractional order statistics (Hutson 1999), for values of any continuous distribution.

    Parameters
    ----------
    values : ndarray of shape (n,)
    trials : float
        Number of independent values that these tell as much as (Woodruff 1952); 0 if all are independent.
    z : float
        Half width of the interval in standard errors: the normal's 97.5 % quantile, or Student's.

    Returns
    -------
    (float, float, float)
        Median, low and high end; the ends are infinite where the values are too few (five or fewer).
    """
    n, effective, level = len(values), trials or float(len(values)), float(ndtr(z))
    rank = brentq(lambda r: float(betainc(r, effective + 1.0 - r, 0.5)) - level, 1e-9, 0.5 * (effective + 1.0))
    position = (n + 1.0) * rank / (effective + 1.0)
    ordered, ranks = np.sort(values), np.arange(1, n + 1)
    low = float(np.interp(position, ranks, ordered, left=-math.inf))
    high = float(np.interp(n + 1.0 - position, ranks, ordered, right=math.inf))
    return float(np.median(values)), low, high


def mean(values: Array) -> tuple[float, float, float]:
    """Return the mean of values (n,), and the ends of its 95 % interval, by Student's t (1908).

    A single value gives no estimate of its own error: the ends are infinite.
    """
    value, n = float(values.mean()), len(values)
    if n < 2:
        return value, -math.inf, math.inf
    half = float(student.ppf(0.975, n - 1) * values.std(ddof=1) / math.sqrt(n))
    return value, value - half, value + half


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
        Value, low and high end, from the rounds' residuals, since the signal is sampled too (ratio estimate: Cochran
        1977), by Student's t with its skewness removed: few poses may have most of an error. With a single round the
        ends are 0 and infinity, and the value is NaN where noise hides the signal.
    """
    level = signal.mean(axis=0)
    if (level <= 0.0).any():
        return math.nan, 0.0, math.inf
    shares = error.mean(axis=0) / level
    square, rounds = float(shares.mean()), len(error)
    if rounds < 2:
        return math.sqrt(max(0.0, square)), 0.0, math.inf
    below, above = _skewed((error - shares * signal) / level)
    low, value, high = (math.sqrt(max(0.0, square + x)) for x in (-below, 0.0, above))
    return value, low, high


def _skewed(residuals: Array) -> tuple[float, float]:
    """Return how far the 95 % interval of a mean over rounds and places (rounds, places) reaches below and above it.

    Student's t is made symmetric by a monotone cubic transformation (Hall 1992, On the removal of skewness by
    transformation). Places are drawn independently, so the third moment of a round's mean follows from that of all
    residuals, which are many where the rounds are few.
    """
    rounds, places = residuals.shape
    means = residuals.mean(axis=1)
    error = float(means.std(ddof=1)) / math.sqrt(rounds)
    quantile = float(student.ppf(0.975, rounds - 1))
    centred = residuals - residuals.mean(axis=0)
    variance = float((centred**2).sum()) / ((rounds - 1) * places**2)
    if rounds < 3 or variance == 0.0:  # two values are never skewed
        return quantile * error, quantile * error
    third = float((centred**3).sum()) * rounds / ((rounds - 1) * (rounds - 2) * places**3)
    skewness = third / (variance**1.5 * math.sqrt(rounds))
    if abs(skewness) < _SYMMETRIC:
        return quantile * error, quantile * error
    low, high = (
        3.0 / skewness * (math.cbrt(1.0 + skewness * (t - skewness / 6.0)) - 1.0) for t in (quantile, -quantile)
    )
    return low * error, -high * error
