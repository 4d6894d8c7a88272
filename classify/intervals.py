"""Values with 95 % confidence intervals."""

from __future__ import annotations

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


def wilson(successes: int, trials: int) -> Interval:
    """Return a proportion with its 95 % score interval (Wilson 1927)."""
    interval = stats.binomtest(successes, trials).proportion_ci(method="wilson")
    return Interval(successes / trials, float(interval.low), float(interval.high))
