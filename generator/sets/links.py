"""Files that a scene refers to: whether they are those that a data set recorded, and whether they may be read."""

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
"""Holds for this thread; a request passes it on to a worker (`generator.jobs.protocol.Request`)."""

MISSING = "missing"
"""Recorded in place of the hash of a missing file."""


def trusted() -> bool:
    """Whether links may lead anywhere."""
    return _TRUSTED.get()


@contextlib.contextmanager
def trusting(yes: bool = True) -> Iterator[None]:
    """Follow links wherever they lead within this context, if ``yes``, in this thread and in workers it starts."""
    token = _TRUSTED.set(yes or _TRUSTED.get())
    try:
        yield
    finally:
        _TRUSTED.reset(token)


def recorded(found: Collection[Path], folder: Path) -> dict[str, str]:
    """Return the hashes of files by their paths relative to a data set's folder, as the set records them."""
    return {_seen_from(path, folder): _hash(path) for path in found}


def of_dataset(links: Mapping[str, Any], folder: Path) -> list[Path]:
    """Return the files that a data set has recorded."""
    return [folder / name for name in links]


def check(links: Mapping[str, Any], folder: Path, scene: Path) -> None:
    """Raise NlosError unless the files that a data set was begun with are still the same, and may be read.

    Parameters
    ----------
    links : mapping
        Result of `recorded`.
    folder : Path
        Folder of the data set.
    scene : Path
        Scene file that the user named.
    """
    allowed_folders = (real(scene.parent), real(folder))
    for name, digest in links.items():
        path = real(folder / name)
        if not trusted() and not any(path.is_relative_to(allowed) for allowed in allowed_folders):
            raise NlosError(f"{folder}: refers to {path}, outside the folder of {scene}; allow it with --trust-links")
        if _hash(path) != digest:
            raise NlosError(
                f"{path}: is not the file that {folder} was begun with, so it would render other pixels; put that "
                "one back, or use another folder"
            )


def _hash(path: Path) -> str:
    return file_hash(path) if path.is_file() else MISSING


def real(path: Path) -> Path:
    """Return a path with its symbolic links followed."""
    return Path(os.path.realpath(path))


def _seen_from(path: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # on another drive
        return str(path)
