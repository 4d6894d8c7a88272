"""Files that a scene refers to, as a data set remembers them: are they the same, and may they be read?"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection, Iterator, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from generator.files.writing import file_hash
from generator.model.errors import NlosError

_TRUSTED = ContextVar("links are trusted", default=False)
"""Of this thread; a request carries it to a worker (`generator.jobs.protocol.Request`)."""

MISSING = "missing"
"""In place of a hash."""


def trusted() -> bool:
    """Whether links may lead anywhere."""
    return _TRUSTED.get()


@contextlib.contextmanager
def trusting(yes: bool = True) -> Iterator[None]:
    """Follow links wherever they lead for a while, if that is wanted, in this thread and in workers that it asks."""
    before = _TRUSTED.set(yes or _TRUSTED.get())
    try:
        yield
    finally:
        _TRUSTED.reset(before)


def recorded(found: Collection[Path], folder: Path) -> dict[str, str]:
    """Return the hashes of files by their names as seen from a data set's folder: what it remembers of them."""
    return {_seen_from(path, folder): _hash(path) for path in found}


def of_dataset(links: Mapping[str, Any], folder: Path) -> list[Path]:
    """Return the files that a data set remembers."""
    return [folder / name for name in links]


def check(links: Mapping[str, Any], folder: Path, scene: Path) -> None:
    """Raise NlosError unless the files that a data set was begun with are still the same, and may be read.

    Parameters
    ----------
    links : mapping
        Of `recorded`.
    folder : Path
        Of the data set.
    scene : Path
        That the user named.
    """
    homes = (real(scene.parent), real(folder))
    for name, digest in links.items():
        path = real(folder / name)
        if not trusted() and not any(path.is_relative_to(home) for home in homes):
            raise NlosError(f"{folder}: refers to {path}, outside the folder of {scene}; allow it with --trust-links")
        if _hash(path) != digest:
            raise NlosError(
                f"{path}: is not the file that {folder} was begun with, so it would render other pixels; put that "
                "one back, or use another folder"
            )


def _hash(path: Path) -> str:
    return file_hash(path) if path.is_file() else MISSING


def real(path: Path) -> Path:
    """Return where a path leads, symbolic links followed."""
    return Path(os.path.realpath(path))


def _seen_from(path: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # on another drive
        return str(path)
