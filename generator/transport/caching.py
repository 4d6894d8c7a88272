"""Cache folder of compiled functions. Does not import numba, so that finding the folder does not load it."""

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
    """Return a cache folder that can be written to, or None: each process then compiles the functions anew.

    It is the first writable one of: the folder that ``NUMBA_CACHE_DIR`` names, one next to the sources, the user's
    cache, a private temporary folder. numba renews its cache when a function's own file changes, but not when the
    file of a function that it calls does. Therefore each state of the sources has a cache folder of its own, and so
    has each name under which the package is imported, as in an extension: what is kept names its modules.
    """
    digest = hashlib.sha256(__name__.encode())
    for source in sources():
        digest.update(source.read_bytes())
    for parent in _parents():
        cache = parent / f"numba-{digest.hexdigest()[:12]}"
        with contextlib.suppress(OSError):
            cache.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=cache):
                return cache
    return None


def _compiles() -> bool:
    try:
        return importlib.util.find_spec("numba") is not None
    except ImportError:
        return False


def _parents() -> Iterator[Path]:
    if configured := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(configured).absolute()
    yield _HERE / "__pycache__"
    if user_cache := os.environ.get("LOCALAPPDATA" if os.name == "nt" else "XDG_CACHE_HOME"):
        yield Path(user_cache).absolute() / "nlos-lab"
    with contextlib.suppress(RuntimeError):  # no home directory
        yield Path.home() / ".cache" / "nlos-lab"
    with contextlib.suppress(OSError):
        yield _private()


def _private() -> Path:
    """Return a temporary folder that nobody else can write to, because code in it is executed."""
    if os.name == "nt":
        return Path(tempfile.gettempdir(), "nlos-lab")  # a folder of the user's own on Windows
    path = Path(tempfile.gettempdir(), f"nlos-lab-{os.getuid()}")
    with contextlib.suppress(FileExistsError):
        path.mkdir(mode=0o700)
    status = path.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise PermissionError(f"{path}: is not this user's alone")
    return path


def compiling_words(engine: str | None) -> str:
    """Return the message to show before an engine's first run, which compiles it; empty if there is no wait."""
    if not _compiles():
        return ""
    newest = max(source.stat().st_mtime for source in caching.sources())
    cache = caching.folder()
    compiled = cache is not None and any(index.stat().st_mtime > newest for index in cache.glob("*/*.nbi"))
    if compiled or engine not in ("surfel", "auto"):
        return ""
    subject = "engine surfel" if engine == "surfel" else "engine auto: surfel, if the scene allows it,"
    frequency = "once" if cache else "by every process, for nothing that it makes can be kept (set NUMBA_CACHE_DIR)"
    return f"{subject} is compiled for this machine first, {frequency}; that takes half a minute or so"
