"""Files that a USD refers to, found in its bytes: Blender reads them without asking, and has no other way to tell.

Crate files (.usdc) keep all names, and so all paths, in one compressed table, the section TOKENS; its layout is that of
``pxr/usd/sdf/crateFile.cpp``, compressed in LZ4 blocks (``pxr/base/tf/fastCompression.cpp``).
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path

from generator.files.limits import exceeds_limit
from generator.model.errors import NlosError

_LAYER = re.compile(r"\.(?:usd[acz]?|abc|mtlx|sdf)(?=$|[:\[])", re.IGNORECASE)
"""What marks the path of another layer; the kind of a layer follows from its ending."""
_MOST = 2**24
"""Bytes of names that are looked through: they are unpacked by Python."""


def linked(path: Path) -> list[Path]:
    """Return the layers that a USD refers to, and those that they refer to.

    Raises
    ------
    NlosError
        It, or one of them, is no USD.
    """
    found: list[Path] = []
    todo = [path]
    while todo:
        layer = todo.pop()
        try:
            names = sorted(set(_names(layer.read_bytes(), layer)))
        except (ValueError, IndexError, struct.error, zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError):
            raise NlosError(f"target.mesh: {layer} is not a USD file") from None
        for name in names:
            other = layer.parent / re.split(r"[\[]|:SDF_FORMAT_ARGS:", name.removeprefix("file:"))[0]
            if other not in found:
                found.append(other)
                todo += [other] if other.is_file() and other.suffix.lower().startswith(".usd") else []
    return found


def _names(data: bytes, path: Path) -> Iterator[str]:
    """Yield the paths of layers in a file's bytes."""
    if data[:4] == b"PK\x03\x04":
        with zipfile.ZipFile(io.BytesIO(data)) as package:
            for member in package.infolist():
                if member.filename.lower().endswith((".usd", ".usda", ".usdc")):
                    if exceeds_limit(member.file_size, len(data)):
                        raise ValueError("unpacks to more than it can hold")
                    yield from _names(package.read(member), path)
    elif data[:8] == b"PXR-USDC":
        yield from (name for name in _tokens(data) if _LAYER.search(name))
    elif data[:5] == b"#usda" or data[:4] == b"#sdf":
        for long, short in re.findall(r"@@@(.+?)@@@|@([^@\n]+)@", data.decode("utf-8", "replace")):
            if _LAYER.search(long or short):
                yield long or short
    else:
        raise ValueError("neither text, crate nor package")


def _tokens(data: bytes) -> list[str]:
    """Return all names in a crate file."""
    [contents] = struct.unpack_from("<q", data, 16)
    [count] = struct.unpack_from("<Q", data, contents)
    if count > 64:
        raise ValueError("no table of contents")
    sections = [struct.unpack_from("<16sqq", data, contents + 8 + 32 * k) for k in range(count)]
    start = {name.rstrip(b"\0"): start for name, start, _ in sections}.get(b"TOKENS", len(data))
    _, full, packed = struct.unpack_from("<QQQ", data, start)
    if full > _MOST:
        raise ValueError("more names than are looked through")
    return _unpacked(data[start + 24 : start + 24 + packed], full).decode("utf-8", "replace").split("\0")


def _unpacked(packed: bytes, full: int) -> bytes:
    if packed[0] == 0:
        return _block(packed[1:], full)
    text, at = b"", 1
    for _ in range(packed[0]):
        [size] = struct.unpack_from("<i", packed, at)
        text += _block(packed[at + 4 : at + 4 + size], full)
        at += 4 + size
    return text


def _block(packed: bytes, full: int) -> bytes:
    """Unpack an LZ4 block of at most so many bytes."""
    text, at = bytearray(), 0

    def length(nibble: int) -> int:
        nonlocal at
        if nibble == 15:
            while True:
                more = packed[at]
                at, nibble = at + 1, nibble + more
                if more != 255:
                    break
        return nibble

    while at < len(packed):
        token = packed[at]
        at += 1
        literals = length(token >> 4)
        text += packed[at : at + literals]
        at += literals
        if at >= len(packed):
            break
        offset = packed[at] | packed[at + 1] << 8
        at += 2
        count, start = length(token & 15) + 4, len(text) - offset
        if not 0 < offset <= len(text) or len(text) + count > full:
            raise ValueError("no LZ4 block")
        if offset >= count:
            text += text[start : start + count]
        else:
            text += (bytes(text[start:]) * (count // offset + 1))[:count]
    return bytes(text)
