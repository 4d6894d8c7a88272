"""Float EXR pictures in plain Python, so that they can be written and read inside Blender.

The OpenEXR module is not reliable there: its wheel binds to the OpenEXR library that Blender has already loaded, of
another version, and crashes (seen with 3.5.3 in Debian's Blender 4.3.2). This module reads single-part scanline
files, uncompressed or ZIP, as Blender and this software write them; all others are read by the OpenEXR module, which
is installed wherever pictures from elsewhere are read. A test checks that the two agree.

Layout: "Technical Introduction to OpenEXR" and "OpenEXR File Layout", Academy Software Foundation.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.files.limits import exceeds_limit

Planes = dict[str, NDArray[np.float32]]

SPACE = "colorInteropID"
"""Attribute that names the linear space of the channels, as the Color Interop Forum does."""
_PRIMARIES = {
    "lin_rec709_scene": (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290),
    "lin_rec2020_scene": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    "lin_ap1_scene": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
}
"""The same spaces as the attribute ``chromaticities`` describes them: x and y of red, green, blue and white."""
_SAME = 2e-3

MAX_PIXELS = 2**28
_MAGIC = b"\x76\x2f\x31\x01"
_LONG_NAMES = 0x400
_TILED, _DEEP, _MULTIPART = 0x200, 0x800, 0x1000
_LINES = {0: 1, 2: 1, 3: 16}
_ZIP = 3
_LEVEL = 3  # of zlib: more takes 1.5 times as long, and makes radiance less than 1 % smaller
_TYPES = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}


class ExrError(Exception):
    """The file is not a whole EXR picture."""


class _ForeignError(Exception):
    """The file may be a valid EXR, but of a kind that this module cannot read."""


def write(path: Path, planes: Planes, attributes: Mapping[str, str]) -> None:
    """Write a ZIP-compressed float32 scanline file.

    Parameters
    ----------
    path : Path
    planes : dict of str to ndarray of shape (height, width), float32
        Channels by name.
    attributes : mapping of str to str
        Stored in the header as strings.
    """
    names = sorted(planes)
    height, width = planes[names[0]].shape
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    channels = b"".join(n.encode() + b"\0" + struct.pack("<iB3xii", 2, 0, 1, 1) for n in names) + b"\0"
    header = b"".join(
        [
            _attribute("channels", "chlist", channels),
            _attribute("compression", "compression", bytes([_ZIP])),
            _attribute("dataWindow", "box2i", window),
            _attribute("displayWindow", "box2i", window),
            _attribute("lineOrder", "lineOrder", b"\0"),
            _attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
            _attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
            _attribute("screenWindowWidth", "float", struct.pack("<f", 1.0)),
            *(_attribute(name, "string", value.encode()) for name, value in attributes.items()),
            b"\0",
        ]
    )
    rows = np.stack([planes[n] for n in names], axis=1).astype("<f4")  # (height, channel, width), as in the file
    chunks = []
    for y in range(0, height, _LINES[_ZIP]):
        raw = rows[y : y + _LINES[_ZIP]].tobytes()
        packed = zlib.compress(_shuffle(raw), _LEVEL)
        data = packed if len(packed) < len(raw) else raw
        chunks.append(struct.pack("<ii", y, len(data)) + data)
    start = _MAGIC + struct.pack("<I", 2 | _LONG_NAMES) + header
    position, offsets = len(start) + 8 * len(chunks), []
    for chunk in chunks:
        offsets.append(position)
        position += len(chunk)
    path.write_bytes(b"".join([start, struct.pack(f"<{len(offsets)}Q", *offsets), *chunks]))


def read(path: Path) -> tuple[Planes, dict[str, str]]:
    """Read a picture.

    Returns
    -------
    planes : dict of str to ndarray of shape (height, width), float32
    attributes : dict of str to str
        The header's string attributes; `SPACE` among them where the file gives its primaries as numbers.

    Raises
    ------
    ExrError
        The file is truncated, broken, larger than 2^28 pixels, cropped, or holds whole numbers.
    """
    data = path.read_bytes()
    if data[:4] != _MAGIC:
        raise ExrError("it does not start like an EXR file")
    try:
        return _read(data)
    except ExrError:
        raise
    except (struct.error, zlib.error, ValueError, IndexError, KeyError, UnicodeDecodeError) as error:
        raise ExrError(f"it is truncated or broken: {error}") from None
    except _ForeignError as kind:
        return _read_foreign(path, str(kind))


def _read(data: bytes) -> tuple[Planes, dict[str, str]]:
    flags = struct.unpack_from("<I", data, 4)[0]
    if flags & _DEEP:
        raise ExrError("it is deep: many values a pixel, which is no picture")
    header, position = _read_header(data)
    width, height, y0 = _claim(header, len(data))
    _refuse_cropped(header)
    if flags & _MULTIPART:
        while data[position]:
            part_header, position = _read_header(data, position)
            _claim(part_header, len(data))
            _refuse_cropped(part_header)
        raise _ForeignError("multi-part")
    if flags & _TILED:
        raise _ForeignError("tiled")
    compression = header["compression"][1][0]
    if compression not in _LINES:
        raise _ForeignError(f"compression {compression}")
    lines = _LINES[compression]
    kinds = _read_channels(header["channels"][1])
    if integer_channels := [name for name, kind in kinds if kind.kind == "u"]:
        raise ExrError(f"its channel {integer_channels[0]} holds whole numbers, which are no radiance")
    layout = np.dtype([(name, kind, (width,)) for name, kind in kinds])
    n_chunks = -(-height // lines)
    offsets = struct.unpack_from(f"<{n_chunks}Q", data, position)
    blocks: list[bytes] = [b""] * n_chunks
    for offset in offsets:
        if offset > len(data):  # more than struct accepts as an offset
            raise ValueError(f"a block claims to start at byte {offset}")
        y, size = struct.unpack_from("<ii", data, offset)
        index = (y - y0) // lines
        if not 0 <= index < n_chunks or size < 0:
            raise ValueError(f"a block claims line {y}")
        packed = data[offset + 8 : offset + 8 + size]
        wanted = layout.itemsize * min(lines, height - index * lines)
        if len(packed) == size == wanted:
            blocks[index] = packed
        else:
            blocks[index] = _unshuffle(zlib.decompressobj().decompress(packed, wanted))
        if len(blocks[index]) != wanted:
            raise ValueError(f"the block at line {y} is incomplete")
    rows = np.frombuffer(b"".join(blocks), dtype=layout)
    if len(rows) != height:
        raise ValueError("lines are missing")
    names = layout.names or ()
    strings = {name: value.decode() for name, (kind, value) in header.items() if kind == "string"}
    if "chromaticities" in header:
        strings.setdefault(SPACE, _space(struct.unpack("<8f", header["chromaticities"][1])))
    return {name: rows[name].astype(np.float32) for name in names}, strings


def _space(primaries: Sequence[float]) -> str:
    """Return the name of the linear space with these primaries and white; the numbers if its name is not known."""
    for name, known in _PRIMARIES.items():
        if max(abs(a - b) for a, b in zip(primaries, known, strict=True)) < _SAME:
            return name
    return "primaries " + " ".join(f"{value:.4g}" for value in primaries)


def _refuse_cropped(header: Mapping[str, tuple[str, bytes]]) -> None:
    """Raise ExrError unless the pixels in the file are exactly those of the picture."""
    data, display = (struct.unpack("<4i", header[name][1]) for name in ("dataWindow", "displayWindow"))
    if data != display:
        ranges = ("x {0} to {2}, y {1} to {3}".format(*window) for window in (data, display))
        raise ExrError("it is cropped: its pixels are those of {}, and the picture is {}".format(*ranges))


def _claim(header: Mapping[str, tuple[str, bytes]], size: int) -> tuple[int, int, int]:
    """Return width, height and first line that a header claims; raise ExrError if its file cannot hold them."""
    x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"][1])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ExrError(f"it claims {width} x {height} pixels")
    # A channel takes a name and 16 bytes of the header, and at least 2 bytes per pixel.
    raw = width * height * 2 * max(1, len(header["channels"][1]) // 18)
    if exceeds_limit(raw, size):
        raise ExrError(f"it claims {width} x {height} pixels in {size} bytes")
    return width, height, y0


def _read_header(data: bytes, position: int = 8) -> tuple[dict[str, tuple[str, bytes]], int]:
    header: dict[str, tuple[str, bytes]] = {}
    while data[position]:
        name, position = _read_name(data, position)
        kind, position = _read_name(data, position)
        size = struct.unpack_from("<i", data, position)[0]
        position += 4
        if size < 0 or position + size > len(data):
            raise ValueError(f"the attribute {name} is incomplete")
        header[name] = (kind, data[position : position + size])
        position += size
    return header, position + 1


def _read_channels(data: bytes) -> list[tuple[str, Any]]:
    channels, position = [], 0
    while data[position]:
        name, position = _read_name(data, position)
        kind, _, x_step, y_step = struct.unpack_from("<iB3xii", data, position)
        position += 16
        if (x_step, y_step) != (1, 1):
            raise _ForeignError("subsampled channels")
        channels.append((name, _TYPES[kind]))
    return channels


def _read_name(data: bytes, position: int) -> tuple[str, int]:
    end = data.index(b"\0", position, position + 256)
    return data[position:end].decode(), end + 1


def _read_foreign(path: Path, kind: str) -> tuple[Planes, dict[str, str]]:
    try:
        import OpenEXR
    except ImportError:
        raise ExrError(f"it is {kind}; reading that needs: python -m pip install OpenEXR") from None
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            planes = {name: np.array(c.pixels) for name, c in file.channels().items()}
            header = {name: value for name, value in file.header().items() if isinstance(value, str)}
            if (primaries := file.header().get("chromaticities")) is not None:
                header.setdefault(SPACE, _space(np.ravel(primaries).tolist()))
    except (RuntimeError, ValueError, TypeError) as error:
        raise ExrError(str(error).splitlines()[0] if str(error) else "it is unreadable") from None
    if integer_channels := [name for name, plane in planes.items() if plane.dtype.kind not in "f"]:
        raise ExrError(f"its channel {integer_channels[0]} holds whole numbers, which are no radiance")
    return {name: plane.astype(np.float32) for name, plane in planes.items()}, header


def _attribute(name: str, kind: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value


def _shuffle(raw: bytes) -> bytes:
    """Return the even bytes, then the odd ones, each as its difference from the byte before: this compresses well."""
    a = np.frombuffer(raw, dtype=np.uint8)
    b = np.concatenate([a[::2], a[1::2]])
    b[1:] = b[1:] - b[:-1] + np.uint8(128)
    return bytes(b)


def _unshuffle(packed: bytes) -> bytes:
    b = np.frombuffer(packed, dtype=np.uint8).copy()
    b[1:] -= np.uint8(128)
    b = np.cumsum(b, dtype=np.uint8)
    a = np.empty_like(b)
    half = (len(b) + 1) // 2
    a[::2], a[1::2] = b[:half], b[half:]
    return bytes(a)
