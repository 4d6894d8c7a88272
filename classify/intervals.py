"""Values with 95 % confidence intervals, also where pictures are not independent.

Dependent pictures count as an effective number of independent ones (design effect: Kish 1965), whose
interval is Wilson's for a share (Korn and Graubard 1998) and order statistics' for a median (Woodruff 1952). The
design effect is the variance of a mean over that of independent values. It is estimated

- over groups, which share something (a background's noise, a pose), from the sums of each group;
- over the frames of a walk, from the slowest cosines of the sequence.

Student's t takes the place of the normal distribution, with as many degrees of freedom as the estimate has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, special, stats

from generator.measure import intervals
from generator.model.arrays import Array

_Z = float(stats.norm.ppf(0.975))
_DOUBT, _ALIKE = 0.5, 5.0
"""Number of wrong answers that a design effect is estimated with as well, and the design effect of these: so many are
wrong at once. With few wrong answers the estimate alone would be too small too often. By simulation
(benchmarks/interval_coverage.py), as the next."""
_COSINES = 0.3
"""Number of slow cosines over the root of the number of frames."""


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % confidence interval."""

    value: float
    low: float
    high: float

    def percent(self) -> str:
        """Return a proportion as text."""
        return f"{100 * self.value:.1f} % ({100 * self.low:.1f} to {100 * self.high:.1f})"

    def centimetres(self) -> str:
        """Return a length in metres as text."""
        high = f"{100 * self.high:.2f}" if math.isfinite(self.high) else "any"
        return f"{100 * self.value:.2f} cm ({100 * self.low:.2f} to {high})"


@dataclass(frozen=True)
class Effective:
    """What dependent values are worth.

    Attributes
    ----------
    trials : float
        Number of independent values that tell as much.
    z : float
        Half width of a 95 % interval in standard errors.
    """

    trials: float
    z: float = _Z


def score_interval(value: float, trials: float, z: float = _Z) -> Interval:
    """Return a proportion of a number of trials, which need not be whole, with its 95 % interval (Wilson 1927).

    Of one to three successes, or two in 50 trials or fewer, the lower end would be too high too often. It then is
    that of a Poisson distribution, with both tails in one (Brown, Cai and DasGupta 2001, section 4.1.1); and so is
    the upper end for as few failures.
    """
    middle = (value + z * z / (2.0 * trials)) / (1.0 + z * z / trials)
    half = z / (1.0 + z * z / trials) * math.sqrt(value * (1.0 - value) / trials + (z / (2.0 * trials)) ** 2)
    low, high = middle - half, middle + half
    few, tails = 3.0 if trials > 50.0 else 2.0, 2.0 * float(special.ndtr(-z))
    if 0.0 < value * trials <= few:
        low = min(low, float(special.gammaincinv(value * trials, tails)) / trials)
    if 0.0 < (1.0 - value) * trials <= few:
        high = max(high, 1.0 - float(special.gammaincinv((1.0 - value) * trials, tails)) / trials)
    # Rounding must not put the value itself outside.
    return Interval(value, max(0.0, min(value, low)), min(1.0, max(value, high)))


def wilson(successes: int, trials: int, *, of: float = 1.0, effect: float = 1.0) -> Interval:
    """Return a proportion of trials with its interval; see `score_interval`.

    Parameters
    ----------
    successes, trials : int
    of : float
        Number of such intervals that hold together in 95 % (Bonferroni; Dunn 1961), as where the best is chosen.
    effect : float
        Variance over that of independent trials (design effect).
    """
    return score_interval(successes / trials, trials / effect, _quantile(of))


def _quantile(of: float) -> float:
    """Return the half width, in standard errors, of each of several intervals that hold together in 95 %."""
    return float(stats.norm.isf(0.025 / of))


def grouped(values: NDArray[Any], groups: NDArray[Any]) -> Effective:
    """Return what truth values (n,) are worth if those of a group are not independent.

    The variance of their mean is that between the sums of groups (Cochran 1977). Groups that are drawn from all
    voxels alike make it smaller than that of independent pictures.

    Parameters
    ----------
    values : ndarray of shape (n,)
    groups : ndarray of shape (n,)
        Name of each one's group.
    """
    count = len(values)
    names, index = np.unique(groups, return_inverse=True)
    if len(names) in (1, count):
        return Effective(float(count))
    mean = float(np.mean(values))
    sums = np.bincount(index, values - mean)
    excess = float((sums**2).sum()) * len(names) / (len(names) - 1)
    binomial = count * mean * (1.0 - mean)
    effect = excess / binomial if binomial else 1.0
    return _doubted(count, mean, effect, min(count / len(names), _ALIKE), len(names) - 1)


def serial(values: NDArray[Any]) -> Effective:
    """Return what the truth values (n,) of a walk's frames, in their order, are worth.

    The variance of their mean is that of the sequence's slowest cosines, about 0.3 sqrt(n) of them, which see no more
    of its correlation than the mean does (Lazarus, Lewis, Stock and Watson 2018).
    """
    count, mean = len(values), float(np.mean(values))
    cosines = max(2, round(_COSINES * math.sqrt(count)))
    if count <= cosines:
        return Effective(float(count))
    variance = float((fft.dct(values - mean, norm="ortho")[1 : cosines + 1] ** 2).mean())
    binomial = mean * (1.0 - mean)
    return _doubted(count, mean, variance / binomial if binomial else 1.0, min(count, _ALIKE), cosines)


def _doubted(count: int, mean: float, effect: float, prior: float, freedom: int) -> Effective:
    """Return what values are worth, by the mean of a design effect that is estimated and one that allows for doubt.

    The estimate has the weight of the wrong answers, or right ones, if fewer; the other that of `_DOUBT`. Only the
    estimate varies, so the mean has more degrees of freedom (Satterthwaite 1946).
    """
    wrong = count * min(mean, 1.0 - mean)
    weight = wrong / (wrong + _DOUBT)
    effect = weight * effect + (1.0 - weight) * prior
    return Effective(count / effect, float(stats.t.ppf(0.975, freedom / max(weight, 1e-6) ** 2)))


def share(right: NDArray[np.bool_], groups: NDArray[Any] | None = None) -> Interval:
    """Return the share of truth values (n,) that are true, with its 95 % interval; see `grouped`."""
    worth = Effective(float(len(right))) if groups is None else grouped(right, groups)
    return score_interval(float(np.mean(right)), worth.trials, worth.z)


def share_of_walk(right: NDArray[np.bool_]) -> Interval:
    """Return the share of a walk's frames (n,), in order, that are true, with its 95 % interval; see `serial`."""
    worth = serial(right)
    return score_interval(float(np.mean(right)), worth.trials, worth.z)


def median(values: Array, groups: NDArray[Any] | None = None) -> Interval:
    """Return the median of lengths (n,) with its 95 % interval; see `grouped`."""
    worth = Effective(float(len(values))) if groups is None else grouped(values <= np.median(values), groups)
    return median_of(values, worth)


def median_of_walk(values: Array) -> Interval:
    """Return the median of a walk's lengths (n,), frame by frame, with its 95 % interval; see `serial`."""
    return median_of(values, serial(values <= np.median(values)))


def median_of(values: Array, worth: Effective) -> Interval:
    """Return the median of lengths (n,) that are worth a number of independent ones, with its 95 % interval."""
    value, low, high = intervals.median(values, trials=worth.trials, z=worth.z)
    return Interval(value, max(low, 0.0), high)


def exceedance(values: Array, threshold: float, groups: NDArray[Any]) -> Interval:
    """Return the share of values (n,) above a threshold, with its 95 % interval.

    Too few are above it to estimate a design effect from these alone. So the correlation within groups is taken from
    all values, put on a normal scale (analysis of variance: Donner 1986), and the correlation of being above from the
    bivariate normal distribution with it (Owen 1956).

    Parameters
    ----------
    values : ndarray of shape (n,)
    threshold : float
    groups : ndarray of shape (n,)
        Name of each one's group.
    """
    count = len(values)
    above = float((values > threshold).mean())
    names, index, sizes = np.unique(groups, return_inverse=True, return_counts=True)
    if len(names) in (1, count):
        return score_interval(above, count)
    scores = stats.norm.ppf((stats.rankdata(values) - 0.5) / count)
    means = np.bincount(index, scores) / sizes
    between = float((sizes * means**2).sum()) / (len(names) - 1)
    within = float(((scores - means[index]) ** 2).sum()) / (count - len(names))
    size = (count - float((sizes**2).sum()) / count) / (len(names) - 1)
    correlation = max(0.0, (between - within) / (between + (size - 1.0) * within))
    rate = (above * count + 0.5) / (count + 1.0)
    cut = math.sqrt((1.0 - correlation) / (1.0 + correlation))
    both = rate - 2.0 * float(special.owens_t(special.ndtri(rate), cut))
    effect = 1.0 + (float((sizes**2).sum()) / count - 1.0) * max(0.0, both - rate * rate) / (rate - rate * rate)
    return score_interval(above, count / effect, float(stats.t.ppf(0.975, len(names) - 1)))


def paired_difference(
    one: NDArray[np.bool_], other: NDArray[np.bool_], *, of: float = 1.0, effect: float = 1.0
) -> Interval:
    """Return the difference of two shares over the same pictures, with its interval.

    Wald's with one more picture for either way to differ (Bonett and Price 2012).

    Parameters
    ----------
    one, other : ndarray of shape (n,)
    of : float
        Number of differences whose intervals hold together in 95 %, as for `wilson`.
    effect : float
        Variance over that of independent pictures (design effect).
    """
    count = len(one)
    gained, lost = (float((a & ~b).sum() + 1.0) / (count + 2.0) for a, b in ((one, other), (other, one)))
    half = _quantile(of) * math.sqrt(effect * (gained + lost - (gained - lost) ** 2) / (count + 2.0))
    middle = gained - lost
    value = float(np.mean(one)) - float(np.mean(other))
    return Interval(value, max(-1.0, middle - half), min(1.0, middle + half))
