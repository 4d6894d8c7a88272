"""How long a run still takes; there is no estimate before enough pictures are done."""

from __future__ import annotations

import time
from collections.abc import Callable

_ENOUGH = 3
"""Least number of pictures after the first that a rate is computed from."""


def rate(done: int, seconds: float, first: int, first_seconds: float) -> float:
    """Return the pictures per second, or 0 while there is no estimate.

    The time of the first picture includes the start of Blender, and with many workers the first pictures of all come
    at once. So the rate is computed from the pictures after it, once as much time has passed as it took itself.

    Parameters
    ----------
    done : int
        Pictures so far.
    seconds : float
        Time since the run began.
    first : int
        Number of pictures when any were done for the first time.
    first_seconds : float
        Time of that, since the run began.
    """
    since, count = seconds - first_seconds, done - first
    return count / since if first and count >= _ENOUGH and since >= max(first_seconds, 1e-3) else 0.0


class Remaining:
    """Estimates the time that a run still takes.

    Parameters
    ----------
    clock : callable
        Returns the time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._begun = clock()
        self.first, self.first_seconds = 0, 0.0

    def told(self, done: int, total: int) -> float | None:
        """Record the progress of the run, and return the seconds that are left; None while there is no estimate."""
        now = self._clock() - self._begun
        if done and not self.first:
            self.first, self.first_seconds = done, now
        speed = rate(done, now, self.first, self.first_seconds)
        return (total - done) / speed if speed else None
