"""How much a command says: ``-q``, ``-v`` and ``--json``, which keeps standard output for the answer alone."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

from generator.cli import console


@dataclass
class Volume:
    """How much is said.

    Attributes
    ----------
    quiet, verbose, json : bool
        As the options of these names.
    begun : float
        When the command began, seconds of `time.monotonic`.
    stages : list of (str, float)
        What took time, and how many seconds.
    """

    quiet: bool = False
    verbose: bool = False
    json: bool = False
    begun: float = field(default_factory=time.monotonic)
    stages: list[tuple[str, float]] = field(default_factory=list)


_volumes = [Volume()]
"""The last is that of the command that runs; threads report progress, so this is no context variable."""


def current() -> Volume:
    """Return how much the command that runs says."""
    return _volumes[-1]


@contextlib.contextmanager
def chosen(options: argparse.Namespace) -> Iterator[Volume]:
    """Let a command say as much as its options ask for; all but a JSON answer goes to standard error."""
    volume = current()
    volume.quiet, volume.verbose, volume.json = (getattr(options, n, False) for n in ("quiet", "verbose", "json"))
    with contextlib.ExitStack() as stack:
        if volume.json:
            stack.enter_context(contextlib.redirect_stdout(_Complaint()))  # type: ignore[type-var]
        yield volume
    detail(_summary(volume))


@contextlib.contextmanager
def separate() -> Iterator[Volume]:
    """Begin with a volume of its own, which ends with the block: one process may run several commands."""
    _volumes.append(Volume())
    try:
        yield current()
    finally:
        _volumes.pop()


def note(words: str) -> None:
    """Tell how the work goes, unless that is to be quiet."""
    volume = current()
    if volume.quiet:
        return
    if volume.verbose:
        words = f"[{time.monotonic() - volume.begun:.1f} s] {words}"
    if volume.json:
        console.complain(words)
    else:
        print(words, flush=True)


def detail(words: str) -> None:
    """Tell on standard error what only ``--verbose`` asks for."""
    if current().verbose:
        console.complain(f"[{time.monotonic() - current().begun:.1f} s] {words}")


@contextlib.contextmanager
def stage(name: str) -> Iterator[None]:
    """Measure how long a part of the work takes."""
    begun = time.monotonic()
    try:
        yield
    finally:
        current().stages.append((name, time.monotonic() - begun))


def _summary(volume: Volume) -> str:
    """Return where the time went."""
    spent, times = time.monotonic() - volume.begun, os.times()
    rest = spent - sum(seconds for _, seconds in volume.stages)
    stages = [f"{name} {seconds:.1f} s" for name, seconds in [*volume.stages, ("the rest", rest)]]
    return (
        f"time: {', '.join(stages)}; {spent:.1f} s in all. CPU: {times.user + times.system:.1f} s here, "
        f"{times.children_user + times.children_system:.1f} s in other processes"
    )


class _Complaint:
    """A stream that writes to standard error, if there is one and it can be written."""

    def write(self, text: str) -> int:
        """Write a text."""
        with contextlib.suppress(OSError):
            if sys.stderr is not None:
                sys.stderr.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush what was written."""
        with contextlib.suppress(OSError):
            if sys.stderr is not None:
                sys.stderr.flush()

    def isatty(self) -> bool:
        """Return False: what is written here is a log."""
        return False
