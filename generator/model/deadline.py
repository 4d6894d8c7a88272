"""A span of time that some work has to keep."""

from __future__ import annotations

import math
import time
from collections.abc import Callable


class Late(Exception):
    """Work was given up because its time was over."""


class Deadline:
    """The end of a span of time that begins now.

    Parameters
    ----------
    seconds : float
        Length of the span.
    clock : callable
        Returns the time in seconds.
    """

    def __init__(self, seconds: float = math.inf, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self._end = clock() + seconds

    @property
    def left(self) -> float:
        """Seconds that are left; 0 when the span is over."""
        return max(0.0, self._end - self.clock())

    def check(self) -> None:
        """Raise `Late` if the span is over."""
        if not self.left:
            raise Late

    def extend(self, seconds: float) -> None:
        """Let the span end later, for work that does not count."""
        self._end += seconds

    def part(self, share: float) -> Deadline:
        """Return the end of a share of what is left."""
        return Deadline(share * self.left, self.clock)
