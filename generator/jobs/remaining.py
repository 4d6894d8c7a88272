"""How long a run still takes: nothing is said before it can be known."""

from __future__ import annotations

import time
from collections.abc import Callable

_ENOUGH = 3
"""Pictures after the first that a rate is made of."""


def rate(done: int, seconds: float, first: int, first_seconds: float) -> float:
    """Return pictures a second, or 0 while that cannot be told.

    The first picture holds the start of Blender, and with many workers all of theirs come at once. So a rate is made
    of what comes after it, and not before as much time has gone by as it took itself.

    Parameters
    ----------
    done : int
        Pictures so far.
    seconds : float
        Since the run began.
    first : int
        Pictures that were done when any were, for the first time.
    first_seconds : float
        When that was, since the run began.
    """
    since, made = seconds - first_seconds, done - first
    return made / since if first and made >= _ENOUGH and since >= max(first_seconds, 1e-3) else 0.0


class Remaining:
    """Tells the time that a run still takes.

    Parameters
    ----------
    clock : callable
        Returns seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._begun = clock()
        self.first, self.first_seconds = 0, 0.0

    def told(self, done: int, total: int) -> float | None:
        """Take note of how far the run is, and return the seconds that are left; None while that cannot be told."""
        now = self._clock() - self._begun
        if done and not self.first:
            self.first, self.first_seconds = done, now
        speed = rate(done, now, self.first, self.first_seconds)
        return (total - done) / speed if speed else None
