"""Reads the files of cameras: values as the converter gave them, row by row, with what the file says of them.

Files come from anywhere, so what one claims to hold is held against its size before it is decoded, and whatever would
change values on the way (a palette, a gamma, JPEG) is refused or told.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from generator.files.limits import exceeds_limit
from generator.files.pictures import read_picture
from generator.model.errors import NlosError

Values = NDArray[Any]

MOST_PIXELS = 2**27
"""Pixels of a frame: more than any camera has."""
_MOST_FRAMES = 100_000
_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = {b"II*\0": "<", b"MM\0*": ">"}
RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw", ".raw")
VIDEO = (".avi", ".mkv", ".mp4", ".mov", ".m4v", ".webm")
PICTURES = (".png", ".tif", ".tiff", ".exr", ".npy")
LOSSY = (".jpg", ".jpeg", ".heic", ".webp", ".avif")
SUFFIXES = (*PICTURES, *RAW, *VIDEO)
"""Endings of the files that can be read."""


@dataclass(frozen=True)
class Frame:
    """A frame of a camera.

    Attributes
    ----------
    name : str
        File, and number in it if it holds several.
    values : ndarray of shape (height, width, channels)
        As in the file, in the order red, green, blue, or of one channel.
    white : float
        Largest value that the format has; infinite for floats.
    black : float
        Black level, if the file states it; else 0.
    gamma : str
        Transfer curve that the file states for its values; empty if it states none.
    exposure : float
        Exposure time in seconds times sensitivity (ISO / 100), as far as the file states them; else 0.
    lossy : bool
        Whether the values went through a lossy compression.
    """

    name: str
    values: Values
    white: float
    black: float = 0.0
    gamma: str = ""
    exposure: float = 0.0
    lossy: bool = False


def natural(path: Path) -> list[Any]:
    """Return a sort key by which 2.png comes before 10.png."""
    parts = re.split(r"(\d+)", str(path))
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts if part]


def expand(paths: Sequence[Path]) -> list[Path]:
    """Return files, and in place of folders the frames in them and in folders below, in natural order.

    Raises
    ------
    NlosError
        A file does not exist or cannot be a frame, or a folder holds none.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = [p for p in path.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file()]
            inside = [p for p in inside if not any(part.startswith(".") for part in p.relative_to(path).parts)]
            if not inside:
                raise NlosError(f"{path}: holds no picture ({', '.join(PICTURES)}, raw files, videos)")
            found += sorted(inside, key=natural)
        elif path.suffix.lower() in LOSSY:
            raise NlosError(
                f"{path}: is compressed with loss and through a gamma, and the hidden object changes less than that "
                "does; take the camera's raw files, or PNG or TIFF"
            )
        elif path.suffix.lower() not in SUFFIXES:
            raise NlosError(f"{path}: must end in {', '.join(PICTURES)}, or be a raw file or a video")
        elif not path.is_file():
            raise NlosError(f"{path}: no such file")
        else:
            found.append(path)
    return found


def read(path: Path) -> Iterator[Frame]:
    """Yield the frames of a file.

    Raises
    ------
    NlosError
        The file is broken, claims more than it can hold, or its values are not those of a camera.
    """
    suffix = path.suffix.lower()
    try:
        if suffix == ".png":
            yield _png(path)
        elif suffix in (".tif", ".tiff"):
            yield from _tiff(path)
        elif suffix == ".exr":
            yield Frame(path.name, read_picture(path)[0], math.inf)
        elif suffix == ".npy":
            yield from _npy(path)
        elif suffix in RAW:
            yield _raw(path)
        else:
            yield from _video(path)
    except NlosError:
        raise
    except OSError as error:
        raise NlosError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (struct.error, IndexError, ValueError, cv2.error) as error:
        raise NlosError(f"{path}: is truncated or broken ({' '.join(str(error).split())[:100]})") from None


def _check_size(path: Path, width: int, height: int, bytes_each: int) -> None:
    """Raise NlosError if a file cannot hold the pixels that it claims."""
    size = path.stat().st_size
    if not (0 < width * height <= MOST_PIXELS) or min(width, height) < 1:
        raise NlosError(f"{path}: claims {width} x {height} pixels; up to {MOST_PIXELS} are read")
    if exceeds_limit(width * height * bytes_each, size):
        raise NlosError(f"{path}: claims {width} x {height} pixels in {size} bytes")


def _decoded(path: Path, data: bytes, shape: tuple[int, int], number: int = 0) -> Values:
    """Decode a picture of a known size by OpenCV, channels in the order red, green, blue."""
    buffer = np.frombuffer(data, np.uint8)
    if number:
        _, pages = cv2.imdecodemulti(buffer, cv2.IMREAD_UNCHANGED, range=(number, number + 1))
        pixels = pages[0] if pages else None
    else:
        pixels = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise ValueError("it cannot be decoded")
    pixels = pixels if pixels.ndim == 3 else pixels[..., None]
    if pixels.shape[:2] != shape or pixels.shape[2] not in (1, 3):
        raise NlosError(f"{path}: has {pixels.shape[2]} channels; save it in grey, or in colour without transparency")
    return pixels if pixels.shape[2] == 1 else pixels[..., ::-1]


_KINDS = {0: 1, 2: 3}


def _png(path: Path) -> Frame:
    data = path.read_bytes()
    if data[:8] != _PNG or data[12:16] != b"IHDR":
        raise NlosError(f"{path}: does not start like a PNG file")
    width, height, bits, kind = struct.unpack(">IIBB", data[16:26])
    if kind not in _KINDS or bits not in (8, 16):
        raise NlosError(
            f"{path}: has a palette, transparency or {bits} bits; save it in grey or colour with 8 or 16 bits"
        )
    _check_size(path, width, height, _KINDS[kind] * bits // 8)
    gamma, exposure, at, ended = "", 0.0, 8, False
    while at + 12 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        body = data[at + 8 : at + 8 + length]
        if name == b"sRGB":
            gamma = "srgb"
        elif name == b"gAMA" and gamma != "srgb" and length == 4:
            value = struct.unpack(">I", body)[0] / 100_000.0
            gamma = "" if abs(value - 1.0) < 0.01 or not value else f"{1.0 / value:.3g}"
        elif name == b"iCCP" and not gamma:
            gamma = "that of a colour profile"
        elif name == b"acTL":
            raise NlosError(f"{path}: is an animation; save its frames as files of their own")
        elif name == b"eXIf":
            exposure = _exposure(body)
        ended |= name == b"IEND"
        at += 12 + length
    if not ended:
        raise ValueError("it ends too early")
    values = _decoded(path, data, (height, width))
    return Frame(path.name, values, float(2**bits - 1), gamma=gamma, exposure=exposure)


_TAGS = {"width": 256, "height": 257, "bits": 258, "photometric": 262, "turned": 274, "samples": 277, "format": 339}
_BYTES = {1: "B", 2: "c", 3: "H", 4: "I", 5: "II"}


def _directory(data: bytes, at: int, order: str) -> tuple[dict[int, Any], int]:
    """Return the tags of a TIFF directory (numbers and rationals), and where the next one is."""
    count = struct.unpack_from(f"{order}H", data, at)[0]
    tags: dict[int, Any] = {}
    for k in range(count):
        tag, kind, n, value = struct.unpack_from(f"{order}HHI4s", data, at + 2 + 12 * k)
        if kind not in (1, 3, 4, 5) or not 0 < n <= 8:
            continue
        form = f"{order}{_BYTES[kind] * n}"
        place = value if struct.calcsize(form) <= 4 else None
        numbers = struct.unpack_from(form, place) if place else _at(data, form, struct.unpack(f"{order}I", value)[0])
        tags[tag] = numbers
    following = struct.unpack_from(f"{order}I", data, at + 2 + 12 * count)[0]
    return tags, following


def _at(data: bytes, form: str, place: int) -> tuple[Any, ...]:
    if place > len(data):
        raise ValueError("a tag lies beyond its end")
    return struct.unpack_from(form, data, place)


def _exposure(data: bytes, tags: dict[int, Any] | None = None) -> float:
    """Return exposure time times ISO / 100 of EXIF data; 0 if it does not tell."""
    order = _TIFF.get(data[:4])
    if order is None:
        return 0.0
    try:
        tags = tags or _directory(data, struct.unpack_from(f"{order}I", data, 4)[0], order)[0]
        if 34665 in tags:
            tags = {**tags, **_directory(data, tags[34665][0], order)[0]}
    except (struct.error, ValueError):
        return 0.0
    time = tags.get(33434, ())
    if len(time) != 2 or not time[0] or not time[1]:
        return 0.0
    return float(time[0] / time[1] * tags.get(34855, (100,))[0] / 100.0)


def _tiff(path: Path) -> Iterator[Frame]:
    data = path.read_bytes()
    order = _TIFF.get(data[:4])
    if order is None:
        raise NlosError(f"{path}: does not start like a TIFF file")
    at, number = struct.unpack_from(f"{order}I", data, 4)[0], 0
    exposure = 0.0
    while at:
        if at > len(data) or number > _MOST_FRAMES:
            raise ValueError("its directory lies beyond its end")
        tags, at = _directory(data, at, order)
        if not {256, 257} <= set(tags):
            raise ValueError("it does not tell its size")
        found = {name: tags.get(tag, (1,)) for name, tag in _TAGS.items()}
        width, height, samples = (int(found[name][0]) for name in ("width", "height", "samples"))
        bits, form = found["bits"][0], found["format"][0]
        if samples not in (1, 3) or (bits, form) not in ((8, 1), (16, 1), (32, 3)):
            raise NlosError(f"{path}: has {samples} samples of {bits} bits; save it in grey or colour, 8 or 16 bits")
        if tags.get(262, (1,))[0] not in (1, 2) or found["turned"][0] != 1:
            raise NlosError(f"{path}: is turned, or its zero is white; save it upright, with zero black")
        _check_size(path, width, height, samples * bits // 8)
        exposure = exposure or _exposure(data, tags)
        values = _decoded(path, data, (height, width), number)
        name = path.name if not (number or at) else f"{path.name}, page {number + 1}"
        yield Frame(name, values, math.inf if form == 3 else float(2**bits - 1), exposure=exposure)
        number += 1


def _npy(path: Path) -> Iterator[Frame]:
    values = np.load(path, mmap_mode="r", allow_pickle=False)
    if values.dtype.kind not in "uf" or values.ndim not in (2, 3, 4) or not values.size:
        raise NlosError(
            f"{path}: holds {values.dtype} of shape {values.shape}; frames are unsigned whole numbers or floats of "
            "shape (height, width), (height, width, 3), (n, height, width) or (n, height, width, 3)"
        )
    if values.ndim == 2 or (values.ndim == 3 and values.shape[2] == 3):
        values = values[None]
    if values.ndim == 3:
        values = values[..., None]
    if values.shape[3] not in (1, 3) or len(values) > _MOST_FRAMES:
        raise NlosError(f"{path}: holds {values.shape[3]} channels; frames have 1 or 3")
    _check_size(path, values.shape[2], values.shape[1], 1)
    white = math.inf if values.dtype.kind == "f" else float(np.iinfo(values.dtype).max)
    for number, frame in enumerate(values):
        name = path.name if len(values) == 1 else f"{path.name}, frame {number + 1}"
        yield Frame(name, np.array(frame), white)


def _raw(path: Path) -> Frame:
    """Read a raw file: every 2 x 2 sensor pixels as one pixel in three channels, of their own values alone."""
    try:
        import rawpy
    except ImportError:
        raise NlosError(f"{path}: reading raw files needs rawpy: pip install 'nlos-lab[raw]'") from None
    raw = rawpy.RawPy()
    try:
        raw.open_file(str(path))
        _check_size(path, raw.sizes.raw_width, raw.sizes.raw_height, 2)
        raw.unpack()
        mosaic, pattern = raw.raw_image_visible, raw.raw_pattern
        if mosaic is None or mosaic.ndim != 2:
            raise NlosError(f"{path}: holds no sensor values that could be read")
        if pattern is None or pattern.shape == (1, 1) or raw.num_colors == 1:
            values = mosaic[..., None].copy()
        elif pattern.shape != (2, 2) or raw.num_colors != 3 or raw.color_desc[:3] != b"RGB":
            raise NlosError(f"{path}: its sensor has no Bayer mosaic of red, green and blue")
        else:
            values = _binned(mosaic, raw.raw_colors_visible[:2, :2], raw.color_desc)
        black = np.array(raw.black_level_per_channel[: values.shape[2]], dtype=np.float32)
        level = float(black.mean())
        values = values - (black - level)  # one level for all colours
        white = float(raw.white_level or np.iinfo(mosaic.dtype).max)
    except rawpy.LibRawError as error:
        raise NlosError(f"{path}: is no raw file that LibRaw can read ({error})") from None
    finally:
        raw.close()
    with path.open("rb") as file:
        head = file.read(2**20)
    return Frame(path.name, values, white, black=level, exposure=_exposure(head))


def _binned(mosaic: Values, colours: Values, names: bytes) -> Values:
    """Return (height / 2, width / 2, 3) of a Bayer mosaic: red, the mean of both greens, blue."""
    height, width = (size // 2 * 2 for size in mosaic.shape)
    planes: dict[str, list[Values]] = {"R": [], "G": [], "B": []}
    for row in range(2):
        for column in range(2):
            name = chr(names[int(colours[row, column])])
            planes[name].append(mosaic[row:height:2, column:width:2].astype(np.float32))
    return np.stack([np.mean(planes[name], axis=0) for name in "RGB"], axis=-1)


def _video(path: Path) -> Iterator[Frame]:
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        if not video.isOpened():
            raise NlosError(f"{path}: is no video that OpenCV can read")
        width, height = (int(video.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if not 0 < width * height <= MOST_PIXELS:
            raise NlosError(f"{path}: claims {width} x {height} pixels; up to {MOST_PIXELS} are read")
        count = 0
        while count < _MOST_FRAMES:
            there, pixels = video.read()
            if not there:
                break
            count += 1
            yield Frame(f"{path.name}, frame {count}", pixels[..., ::-1], 255.0, lossy=True)
        if not count:
            raise NlosError(f"{path}: holds no frame that could be read")
    finally:
        video.release()
