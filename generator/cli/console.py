"""Standard output and error of a command: who reads them may leave, and the disk below them may be full."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


class Unwritable(Exception):
    """Standard output takes no more; it is no OSError, lest it be taken for another file's.

    Attributes
    ----------
    unread : bool
        Whoever read it has left.
    """

    def __init__(self, error: OSError) -> None:
        super().__init__(error.strerror or str(error))
        self.unread = isinstance(error, BrokenPipeError)


class _Output:
    """A stream whose failures are `Unwritable`; whatever else is asked of it, the stream itself answers."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write, as a stream does."""
        with self._told():
            return int(self._stream.write(text))

    def flush(self) -> None:
        """Flush, as a stream does."""
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
    """Let standard output's failures be `Unwritable`, those of the last words too, which Python keeps to its end."""
    before = sys.stdout
    if before is None:  # closed; the next file opened would be taken for it, by Blender at least
        before = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 (stays open as long as the process)
    output = _Output(before)
    sys.stdout = output  # type: ignore[assignment]
    try:
        yield
    except SystemExit:  # of argparse, which has printed its help
        output.flush()
        raise
    except Unwritable:
        raise
    except BaseException:
        with contextlib.suppress(Unwritable):  # there is worse to tell then
            output.flush()
        raise
    else:
        output.flush()
    finally:
        sys.stdout = before


def complain(words: str) -> None:
    """Print on standard error, if it can be written."""
    if sys.stderr is None:
        return
    try:
        print(words, file=sys.stderr, flush=True)
    except OSError:
        _discard(sys.stderr)


def _discard(stream: Any) -> None:
    """Let what a stream still holds go nowhere, or Python complains of it on its end and exits with another code."""
    with contextlib.suppress(OSError, ValueError):  # no file at all
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
