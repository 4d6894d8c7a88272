"""Progress, tables and errors for people at a terminal."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence

from generator.cli import console, volume
from generator.jobs.remaining import Remaining
from generator.jobs.workers import NO_BLENDER
from generator.model.errors import NlosError
from generator.model.quantities import clock


def guarded(work: Callable[[], int], interrupted: str = "interrupted; the same command goes on from here") -> int:
    """Run a command and return its exit code.

    Bad input, a missing Blender or an output that cannot be written give one sentence and exit code 2; Ctrl-C gives a
    short message and 130. When the reader of the output has closed it, as ``head`` does, the command ends silently
    and with 141, like a command that SIGPIPE ends. An unexpected error gives 70 and one sentence with its place in
    the code, after the traceback if the command is to be verbose.
    """
    with volume.separate():
        return _guarded(work, interrupted)


def _guarded(work: Callable[[], int], interrupted: str) -> int:
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
            return _unexpected(error)
        missing = isinstance(error, ModuleNotFoundError)
        broken = f"Blender's module bpy does not load, for a system library is missing: {error}"
        return refused(NO_BLENDER if missing else broken)
    except KeyboardInterrupt:
        console.complain(f"\n{interrupted}")
        return 130
    except Exception as error:
        return _unexpected(error)


def _unexpected(error: Exception) -> int:
    """Print an error that nobody foresaw; return its exit code, EX_SOFTWARE of sysexits.h."""
    import traceback

    if volume.current().verbose:
        console.complain("".join(traceback.format_exception(error)).rstrip())
    last = traceback.extract_tb(error.__traceback__)[-1]
    words = " ".join(str(error).split())
    more = "" if volume.current().verbose else "; -v prints the traceback"
    console.complain(f"error: unexpected {type(error).__name__} in {last.filename}:{last.lineno}: {words}{more}")
    return 70


def refused(why: object) -> int:
    """Print why a command is refused; return its exit code."""
    console.complain(f"error: {why}")
    return 2


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
        volume.note(f"{done} of {total} {self._what}{left_words(left if done < total else None)}")


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
        self._live = sys.stderr is not None and sys.stderr.isatty() and not volume.current().quiet
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
            volume.note(words)
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
                        volume.note(f"... {self._words(now)}")

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
    with volume.stage("rendering"):
        if volume.current().quiet or not sys.stderr.isatty():
            yield LineProgress()  # says nothing if it is to be quiet
            return
        with _bar() as show:
            yield show


@contextlib.contextmanager
def _bar() -> Iterator[Callable[[int, int], None]]:
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
