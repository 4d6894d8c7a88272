"""Limits on what a file may claim to hold: a few bytes that unpack to gigabytes are refused beforehand."""

from __future__ import annotations

import contextlib
import mmap
import os
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path

MUCH = 2**27
"""Bytes that a file of any size may hold."""
MOST = 100
"""Multiple of its own size that a file may hold where that is more than `MUCH`."""


def exceeds_limit(claimed: int, size: int) -> bool:
    """Whether a file claims to hold more bytes than a file of its size may."""
    return claimed > MUCH and claimed > MOST * size


@contextlib.contextmanager
def limited(spare: int) -> Iterator[None]:
    """Limit the bytes of memory that the code in this context may take in addition, where the system supports that.

    HDF5 took gigabytes for damaged files of a few kilobytes.
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
"""Start of a heap, where HDF5 keeps texts: objects, each with a header of 16 bytes, its size last, and contents."""
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_SIZES = {0: 13, 1: 13, 2: 9, 3: 9}
"""Offset at which a file says how many bytes its addresses and lengths take, by the version of its header."""


def check_heaps(path: Path) -> None:
    """Raise ValueError unless the texts of an HDF5 file follow one another within its heaps.

    HDF5 hung at a file where they did not.
    """
    if not path.stat().st_size:
        raise ValueError("it is empty")
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        head = data[:16]
        offset = _SIZES.get(head[8] if len(head) == 16 else -1)
        if head[:8] != _SIGNATURE or offset is None or head[offset : offset + 2] != b"\x08\x08":
            raise ValueError("it does not start like an HDF5 file of this software")
        start = data.find(_HEAP)
        while start >= 0:
            if len(data) >= start + 16:
                end = min(len(data), start + struct.unpack_from("<Q", data, start + 8)[0])
                _check_heap(data, start + 16, end)
            start = data.find(_HEAP, start + 1)


def _check_heap(data: mmap.mmap, at: int, end: int) -> None:
    while at + 16 <= end:
        number, _, _, size = struct.unpack_from("<HHIQ", data, at)
        step = size if number == 0 else 16 + -(-size // 8) * 8
        if step < 16 or at + step > end:
            raise ValueError("its texts lie where they cannot")
        at += step


def check_archive(path: Path) -> None:
    """Raise ValueError if the contents of a zip archive unpack to more than they may."""
    size = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        claimed = sum(member.file_size for member in archive.infolist())
    if exceeds_limit(claimed, size):
        raise ValueError(f"it claims {claimed} bytes in {size}")
