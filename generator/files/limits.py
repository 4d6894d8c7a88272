"""What a file may claim to hold, for its size: a few bytes that unpack to gigabytes are refused before they do."""

from __future__ import annotations

import contextlib
import mmap
import os
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path

MUCH = 2**27
"""Bytes that any file may hold."""
MOST = 100
"""Times its own size that a larger one may unpack to."""


def exceeds_limit(claimed: int, size: int) -> bool:
    """Whether a file of a size claims to hold more bytes than one may."""
    return claimed > MUCH and claimed > MOST * size


@contextlib.contextmanager
def limited(spare: int) -> Iterator[None]:
    """Let what is done here take so many bytes of memory more and no others, where the system can see to that.

    HDF5 took gigabytes for spoilt files of a few kilobytes.
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


_HEAP = b"GCOL\x01\0\0\0"
"""Where HDF5 keeps texts: a collection of objects, each a head of 16 bytes, its size last, and what it holds."""
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_SIZES = {0: 13, 1: 13, 2: 9, 3: 9}
"""Where a file says how many bytes its addresses and lengths take, by the version of its head."""


def check_heaps(path: Path) -> None:
    """Raise ValueError unless the texts of an HDF5 file lie one behind the other.

    HDF5 hung at a file where they did not.
    """
    if not path.stat().st_size:
        raise ValueError("it is empty")
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        head = data[:16]
        where = _SIZES.get(head[8] if len(head) == 16 else -1)
        if head[:8] != _SIGNATURE or where is None or head[where : where + 2] != b"\x08\x08":
            raise ValueError("it does not start like an HDF5 file of this software")
        at = data.find(_HEAP)
        while at >= 0:
            if len(data) >= at + 16:
                end = min(len(data), at + struct.unpack_from("<Q", data, at + 8)[0])
                _check_heap(data, at + 16, end)
            at = data.find(_HEAP, at + 1)


def _check_heap(data: mmap.mmap, at: int, end: int) -> None:
    while at + 16 <= end:
        number, _, _, size = struct.unpack_from("<HHIQ", data, at)
        step = size if number == 0 else 16 + -(-size // 8) * 8
        if step < 16 or at + step > end:
            raise ValueError("its texts lie where they cannot")
        at += step


def check_archive(path: Path) -> None:
    """Raise ValueError if what is inside a zip archive unpacks to more than it may."""
    size = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        claimed = sum(inside.file_size for inside in archive.infolist())
    if exceeds_limit(claimed, size):
        raise ValueError(f"it claims {claimed} bytes in {size}")
