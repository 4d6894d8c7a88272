"""Questions on standard input of which only the newest counts."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Asked = TypeVar("Asked")


class DroppedError(BaseException):
    """Raised in what is being computed when its answer is not wanted any more; no error that anything may catch."""


class Desk(Generic[Asked]):
    """Reads questions in a thread; only the newest counts. The process ends when its standard input does.

    Parameters
    ----------
    read : callable
        Returns the question in a line.
    """

    def __init__(self, read: Callable[[str], Asked]) -> None:
        self._read_line = read
        self._newest: Asked | None = None
        self._came = threading.Event()
        self._may_drop = False
        signal.signal(signal.SIGINT, self._signalled)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in sys.stdin:
            self._newest = self._read_line(line)
            self._came.set()
            if self._may_drop:
                signal.raise_signal(signal.SIGINT)
        os._exit(0)

    def _signalled(self, *_: object) -> None:
        # Handlers run in the main thread: what it does now is what may be dropped.
        if self._may_drop and self._came.is_set():
            self._may_drop = False
            raise DroppedError

    def next(self) -> Asked:
        """Wait for a question that was not taken yet, and return it."""
        self._came.wait()
        self._came.clear()
        assert self._newest is not None
        return self._newest

    def droppable(self, on: bool) -> None:
        """Say whether what follows may be dropped for a newer question."""
        self._may_drop = on
        if on and self._came.is_set():  # it came while that could not be
            self._may_drop = False
            raise DroppedError
