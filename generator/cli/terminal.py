"""Progress, tables and errors for people at a terminal."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from generator.cli import console
from generator.jobs.remaining import Remaining
from generator.jobs.workers import NO_BLENDER
from generator.model.errors import NlosError
from generator.model.quantities import clock

if TYPE_CHECKING:
    from generator.sets.bulk_set import Bulk
    from generator.sets.dataset import Dataset


def guarded(work: Callable[[], int], interrupted: str = "interrupted; the same command goes on from here") -> int:
    """Run a command and return its exit code.

    Bad input, a missing Blender or an output that cannot be written give one sentence and exit code 2; Ctrl-C gives a
    short message and 130. When the reader of the output has closed it, as ``head`` does, the command ends silently
    and with 141, like a command that SIGPIPE ends.
    """
    try:
        with console.told_apart():
            return work()
    except console.Unwritable as error:
        if error.unread:
            return 128 + 13  # SIGPIPE's number
        return refused(f"standard output cannot be written ({error})")
    except NlosError as error:
        return refused(error)
    except ImportError as error:
        if error.name != "bpy":
            raise
        missing = isinstance(error, ModuleNotFoundError)
        broken = f"Blender's module bpy does not load, for a system library is missing: {error}"
        return refused(NO_BLENDER if missing else broken)
    except KeyboardInterrupt:
        console.complain(f"\n{interrupted}")
        return 130


def refused(why: object) -> int:
    """Print why a command is refused; return its exit code."""
    console.complain(f"error: {why}")
    return 2


def summary(dataset: Dataset | Bulk, *, rendered: int, remaining: int) -> str:
    """Return the last line of a sweep or of a bulk set."""
    done = dataset.planned - remaining
    state = f"{dataset.path}: {done} of {dataset.planned} pictures"
    if rendered == 0 and remaining == 0:
        return f"{state}; the data set is finished, nothing to do"
    return f"{state}, {rendered} of them rendered now" + (f"; {remaining} remain" if remaining else "; finished")


class LineProgress:
    """Progress as plain lines, at most one every few seconds, for logs."""

    def __init__(self, what: str = "pictures", every: float = 10.0) -> None:
        self._what = what
        self._every = every
        self._remaining = Remaining()
        self._last = -every

    def __call__(self, done: int, total: int) -> None:
        now, left = time.monotonic(), self._remaining.told(done, total)
        if total == 0 or (now - self._last < self._every and done < total):
            return
        self._last = now
        print(f"{done} of {total} {self._what}{left_words(left if done < total else None)}", flush=True)


class Status:
    """Tells sentences, and between them every few seconds what is being done and for how long.

    At a terminal that is a line on standard error that changes; in a log, a line after some seconds of silence.

    Parameters
    ----------
    every : float
        Longest silence in a log, seconds.
    """

    def __init__(self, every: float = 5.0) -> None:
        self._every = every
        self._live = sys.stderr is not None and sys.stderr.isatty()
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._doing, self._count = "starting", ""
        self._since = self._last = time.monotonic()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Status:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._clear()

    def tell(self, words: str) -> None:
        """Print a sentence about what begins now, or has ended."""
        with self._lock:
            self._clear()
            print(words, flush=True)
            self._doing, self._count = words, ""
            self._since = self._last = time.monotonic()

    def progress(self, done: int, total: int) -> None:
        """Take note of how many pictures of what is being done are there."""
        self._count = f", {done} of {total} pictures" if total else ""

    def _watch(self) -> None:
        while not self._ended.wait(1.0 if self._live else 0.2 * self._every):
            with self._lock:
                now = time.monotonic()
                if self._live:
                    self._clear()
                    sys.stderr.write(f"{self._words(now)[:100]}")
                    sys.stderr.flush()
                elif now - self._last >= self._every:
                    self._last = now
                    with contextlib.suppress(console.Unwritable):  # the next sentence finds out
                        print(f"... {self._words(now)}", flush=True)

    def _words(self, now: float) -> str:
        return f"{self._doing.partition(':')[0]}{self._count}, {clock(now - self._since)}"

    def _clear(self) -> None:
        if self._live:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()


def left_words(left: float | None) -> str:
    """Return the remaining time as the end of a line; empty while it is unknown."""
    return "" if left is None else f", about {clock(left)} left"


def print_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; rows with the same first cell form a group, which shows it once and ends with a line."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading, no_wrap=True)
    repeated = len({row[0] for row in rows}) < len(rows)
    last = ""
    for first, *cells in rows:
        if repeated and last and first != last:
            table.add_section()
        table.add_row("" if first == last else first, *cells)
        last = first
    console = Console()
    # In a log or a pipe the table must not be squeezed into 80 columns.
    Console(width=None if console.is_terminal else 160).print(table)


@contextlib.contextmanager
def progress_bar() -> Iterator[Callable[[int, int], None]]:
    """Yield a callable that shows how many pictures are done: as a bar, or as lines in a log."""
    if not sys.stderr.isatty():
        yield LineProgress()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    remaining = Remaining()
    columns = (TextColumn("rendering"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=None)

        def show(done: int, total: int) -> None:
            left = left_words(remaining.told(done, total)).removeprefix(", ")
            bar.update(task, completed=done, total=total, description=left)

        yield show


def report(dataset: Dataset | Bulk, rendered: int, remaining: int, failed: list[str]) -> int:
    """Print how a run ended; return its exit code."""
    from generator.sets import audit
    from generator.sets.dataset import Dataset

    for failure in failed:
        console.complain(f"failed: {failure}")
    if isinstance(dataset, Dataset) and (warning := audit.words(dataset)):
        console.complain(warning)
    print(summary(dataset, rendered=rendered, remaining=remaining))
    return 1 if failed else 0
