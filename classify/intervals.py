"""Values with 95 % confidence intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy import stats


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
        return f"{100 * self.value:.2f} cm ({100 * self.low:.2f} to {100 * self.high:.2f})"


def score_interval(value: float, trials: float) -> Interval:
    """Return a proportion of a number of trials, which need not be whole, with its 95 % interval (Wilson 1927)."""
    z = float(stats.norm.ppf(0.975))
    middle = (value + z * z / (2.0 * trials)) / (1.0 + z * z / trials)
    half = z / (1.0 + z * z / trials) * math.sqrt(value * (1.0 - value) / trials + (z / (2.0 * trials)) ** 2)
    # Rounding must not put the value itself outside.
    return Interval(value, max(0.0, min(value, middle - half)), min(1.0, max(value, middle + half)))


def wilson(successes: int, trials: int) -> Interval:
    """Return a proportion with its 95 % score interval (Wilson 1927)."""
    interval = stats.binomtest(successes, trials).proportion_ci(method="wilson")
    return Interval(successes / trials, float(interval.low), float(interval.high))
