"""Frames that a camera puts into a folder, as they come."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from classify.pictures.frames import LOSSY, SUFFIXES, Frame, natural, read
from generator.model.errors import NlosError

_PAUSE = 0.005
"""Seconds between two looks at a folder in which nothing is new."""
_WRITTEN = 0.5
"""Seconds for which a file that cannot be read has to be left as it is, before it counts as broken."""
_UNSURE = (".tif", ".tiff", ".npy")
"""Formats of which half a file can look like a whole one."""
_SETTLED = 0.02
"""Seconds for which a file of these has to be left as it is."""


def come(
    folder: Path, patience: float | None, *, complain: Callable[[str], None] = lambda words: None
) -> Iterator[Frame]:
    """Yield the frames of files in a folder: those that are there first, then new ones, in natural order.

    Parameters
    ----------
    folder : Path
    patience : float, optional
        Seconds without a new file after which it ends; else it goes on.
    complain : callable
        Called with a sentence for a file that is none of a camera's, or broken.

    Raises
    ------
    NlosError
        There is no such folder.
    """
    if not folder.is_dir():
        raise NlosError(f"{folder}: no such folder")
    known: set[str] = set()
    waiting: dict[Path, tuple[int, float]] = {}
    last = time.monotonic()
    while patience is None or time.monotonic() - last < patience:
        came = False
        for path in sorted(_new(folder, known), key=natural):
            try:
                size = path.stat().st_size
            except OSError:
                continue  # it was taken away again
            now = time.monotonic()
            if waiting.get(path, (-1, 0.0))[0] != size:
                waiting[path] = (size, now)
            rested = now - waiting[path][1]
            if path.suffix.lower() in _UNSURE and rested < _SETTLED:
                continue
            try:
                frames = list(read(path)) if path.suffix.lower() not in LOSSY else []
                if not frames:
                    raise NlosError(f"{path}: is compressed with loss; let the camera write PNG, TIFF or raw files")
            except NlosError as error:
                if rested < _WRITTEN:
                    continue
                complain(f"warning: {error}")
                frames = []
            known.add(path.name)
            waiting.pop(path, None)
            yield from frames
            came, last = True, time.monotonic()
        if not came:
            time.sleep(_PAUSE)


def _new(folder: Path, known: set[str]) -> list[Path]:
    endings = (*SUFFIXES, *LOSSY)
    inside = (path for path in folder.iterdir() if path.name not in known and not path.name.startswith("."))
    return [path for path in inside if path.suffix.lower() in endings]
