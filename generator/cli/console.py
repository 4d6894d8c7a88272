"""Standard output and error of a command, whose reader may close them and whose disk may be full."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


class Unwritable(Exception):
    """Standard output cannot be written; not an OSError, so that it is not mistaken for one of another file.

    Attributes
    ----------
    unread : bool
        Whether its reader has closed it.
    """

    def __init__(self, error: OSError) -> None:
        super().__init__(error.strerror or str(error))
        self.unread = isinstance(error, BrokenPipeError)


class _Output:
    """A stream whose failures raise `Unwritable`; all other attributes are those of the stream itself."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text to the stream."""
        with self._told():
            return int(self._stream.write(text))

    def flush(self) -> None:
        """Flush the stream."""
        with self._told():
            self._stream.flush()

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            _discard(self._stream)
            raise Unwritable(error) from None


@contextlib.contextmanager
def told_apart() -> Iterator[None]:
    """Let failures of standard output raise `Unwritable`, also for buffered text, which is flushed at the end."""
    original = sys.stdout
    if original is None:  # closed: the next file to be opened would take its place, at least in Blender
        original = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 (stays open as long as the process)
    output = _Output(original)
    sys.stdout = output  # type: ignore[assignment]
    try:
        yield
    except SystemExit:  # by argparse, after printing its help
        output.flush()
        raise
    except Unwritable:
        raise
    except BaseException:
        with contextlib.suppress(Unwritable):  # the first error matters more
            output.flush()
        raise
    else:
        output.flush()
    finally:
        sys.stdout = original


def complain(words: str) -> None:
    """Print on standard error, if it can be written."""
    if sys.stderr is None:
        return
    try:
        print(words, file=sys.stderr, flush=True)
    except OSError:
        _discard(sys.stderr)


def _discard(stream: Any) -> None:
    """Redirect a stream to the null device; else Python fails to flush it at its end, and changes the exit code."""
    with contextlib.suppress(OSError, ValueError):  # the stream has no file descriptor
        null_device = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null_device, stream.fileno())
        os.close(null_device)
