"""Files that a USD refers to, found in its bytes: Blender reads them without asking, and has no other way to tell.

Crate files (.usdc) keep all names, and so all paths, in one table, the section TOKENS, as in Pixar's
``pxr/usd/sdf/crateFile.cpp``; it is compressed in LZ4 blocks (``pxr/base/tf/fastCompression.cpp``).
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
from pathlib import Path

from generator.files.limits import exceeds_limit
from generator.model.errors import NlosError

_LAYER = re.compile(r"\.(?:usd[acz]?|abc|mtlx|sdf)(?=$|[:\[])", re.IGNORECASE)
"""What marks the path of another layer; the kind of a layer follows from its ending."""
_MOST = 2**24
"""Bytes of names that are looked through: they are unpacked by Python."""


_PATH = re.compile(r"@@@(.+?)@@@|@([^@\n]+)@")
_FAULTS = (ValueError, IndexError, struct.error, zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError)


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
        for name in sorted({name for text in _texts(layer) for name in _names(text) if _LAYER.search(name)}):
            other = layer.parent / re.split(r"\[|:SDF_FORMAT_ARGS:", name.removeprefix("file:"))[0]
            if other not in found:
                found.append(other)
                todo += [other] if other.is_file() and other.suffix.lower().startswith(".usd") else []
    return found


def _names(text: str) -> list[str]:
    in_text = [long or short for long, short in _PATH.findall(text)]
    return in_text + text.split("\0") if "\0" in text else in_text


def has_main_prim(path: Path) -> bool:
    """Return whether a USD names a prim that stands for it where another USD refers to it."""
    return any("defaultPrim" in text for text in _texts(path))


def _texts(path: Path) -> list[str]:
    """Return the text of each layer in a file; of a crate, its names, each followed by NUL."""
    try:
        data = path.read_bytes()
        if data[:4] != b"PK\x03\x04":
            return [_text(data)]
        with zipfile.ZipFile(io.BytesIO(data)) as package:
            layers = [m for m in package.infolist() if m.filename.lower().endswith((".usd", ".usda", ".usdc"))]
            if exceeds_limit(sum(layer.file_size for layer in layers), len(data)):
                raise ValueError("unpacks to more than it can hold")
            return [_text(package.read(layer)) for layer in layers]
    except _FAULTS:
        raise NlosError(f"target.mesh: {path} is not a USD file") from None


def _text(data: bytes) -> str:
    if data[:8] == b"PXR-USDC":
        return _tokens(data)
    if data[:5] == b"#usda":
        return data.decode("utf-8", "replace")
    raise ValueError("neither text nor crate")


def _tokens(data: bytes) -> str:
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
    return _unpacked(data[start + 24 : start + 24 + packed], full).decode("utf-8", "replace")


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
