"""Where compiled functions are kept. Knows nothing of numba, so that asking does not load it."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from generator.transport import caching

_HERE = Path(__file__).resolve().parent


def sources() -> list[Path]:
    """Return the files whose functions are compiled, in order."""
    return sorted(_HERE.rglob("*.py"))


@functools.cache
def folder() -> Path | None:
    """Return a folder that can be written, or None: functions are compiled anew by each process then.

    The first of: what ``NUMBA_CACHE_DIR`` names, beside the sources, the user's own cache, a private temporary
    folder. numba renews its cache when a function's own file changes, but not when a function that it calls does. So
    the cache of each state of the sources has a folder of its own.
    """
    digest = hashlib.sha256()
    for source in sources():
        digest.update(source.read_bytes())
    for parent in _parents():
        made = parent / f"numba-{digest.hexdigest()[:12]}"
        with contextlib.suppress(OSError):
            made.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=made):
                return made
    return None


def _compiles() -> bool:
    try:
        return importlib.util.find_spec("numba") is not None
    except ImportError:
        return False


def _parents() -> Iterator[Path]:
    if named := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(named).absolute()
    yield _HERE / "__pycache__"
    if own := os.environ.get("LOCALAPPDATA" if os.name == "nt" else "XDG_CACHE_HOME"):
        yield Path(own).absolute() / "nlos-lab"
    with contextlib.suppress(RuntimeError):  # there is no home
        yield Path.home() / ".cache" / "nlos-lab"
    with contextlib.suppress(OSError):
        yield _private()


def _private() -> Path:
    """A temporary folder that nobody else can write to: what is in it is run."""
    if os.name == "nt":
        return Path(tempfile.gettempdir(), "nlos-lab")  # is the user's own there
    made = Path(tempfile.gettempdir(), f"nlos-lab-{os.getuid()}")
    with contextlib.suppress(FileExistsError):
        made.mkdir(mode=0o700)
    found = made.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise PermissionError(f"{made}: is not this user's alone")
    return made


def compiling_words(engine: str | None) -> str:
    """Return what to say before an engine's first run, which compiles it; nothing if there is nothing to wait for."""
    if not _compiles():
        return ""
    newest = max(source.stat().st_mtime for source in caching.sources())
    kept = caching.folder()
    compiled = kept is not None and any(index.stat().st_mtime > newest for index in kept.glob("*/*.nbi"))
    if compiled or engine not in ("surfel", "auto"):
        return ""
    when = "engine surfel" if engine == "surfel" else "engine auto: surfel, if the scene allows it,"
    again = "once" if kept else "by every process, for nothing that it makes can be kept (set NUMBA_CACHE_DIR)"
    return f"{when} is compiled for this machine first, {again}; that takes a minute or so"
