"""What a file may claim to hold, for its size: a few bytes that unpack to gigabytes are refused before they do."""

from __future__ import annotations

import contextlib
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path

MUCH = 2**27
"""Bytes that any file may hold."""
MOST = 100
"""Times its own size that a larger one may unpack to."""


def excessive(claimed: int, size: int) -> bool:
    """Whether a file of a size claims to hold more bytes than one may."""
    return claimed > MUCH and claimed > MOST * size


@contextlib.contextmanager
def limited(spare: int) -> Iterator[None]:
    """Let what is done here take so many bytes of memory more and no others, where the system can see to that.

    HDF5 believes what a file says of the length of a text, up to 4 GiB, and asks for that much before it looks.
    """
    try:
        import resource

        taken = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except (ImportError, OSError):
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = taken + spare if soft == resource.RLIM_INFINITY else min(taken + spare, soft)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def check_archive(path: Path) -> None:
    """Raise ValueError if what is inside a zip archive unpacks to more than it may."""
    size = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        claimed = sum(inside.file_size for inside in archive.infolist())
    if excessive(claimed, size):
        raise ValueError(f"it claims {claimed} bytes in {size}")
