"""Bursts of frames of a steady scene, as a camera's files hold them: a folder of pictures, or one stack."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classify.pictures import frames
from generator.model.errors import NlosError

MOST = 2**25
"""Values of a burst that are read into memory."""
_TIME = re.compile(r"(?<![\d.])(?:(\d+)/)?(\d+(?:\.\d+)?)\s?(us|ms|s)(?![a-z])", re.IGNORECASE)
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0}


@dataclass(frozen=True, kw_only=True)
class Burst:
    """Frames that were taken one after another, with nothing changed.

    Attributes
    ----------
    name : str
        Its folder or file, for messages.
    frames : ndarray of shape (n, height, width)
        Grey levels, of the type that the files have.
    time : float
        Exposure time of a frame, seconds; NaN if it is not known.
    irradiance : float
        Of the chip, W/m^2, by a photometer; NaN if it is not known, 0 in the dark.
    """

    name: str
    frames: NDArray[Any]
    time: float = math.nan
    irradiance: float = math.nan


def read(
    path: Path,
    *,
    channel: str = "",
    mosaic: tuple[int, int] | None = None,
    region: tuple[int, int, int, int] | None = None,
) -> Burst:
    """Read a burst; its exposure time is taken from its name, if that holds one, such as ``10ms`` or ``1_60s``.

    Parameters
    ----------
    path : Path
        Folder of pictures, one a frame, or one file of several frames: those that `frames.read` reads.
    channel : {"", "red", "blue"}
        Taken of coloured frames. In a raw file these are values of single pixels; green is the mean of two.
    mosaic : (int, int), optional
        Row and column, 0 or 1, of the pixel of each 2 x 2 that is taken, of a grey picture of a colour mosaic.

    region : (int, int, int, int), optional
        Left, top, width and height of the part that is taken, in pixels (of each 2 x 2, if one is).

    Raises
    ------
    NlosError
        If there are no frames, a file cannot be read, or frames are compressed, coloured, too many, or unlike.
    """
    stack: list[NDArray[Any]] = []
    for frame in (frame for file in frames.expand([path]) for frame in frames.read(file)):
        stack.append(_part(_grey(frame, path, channel), path, mosaic, region))
        if sum(one.size for one in stack) > MOST:
            raise NlosError(f"{path}: holds more than {MOST:,} values; take a part of the frames (--region)")
    if len({(one.shape, one.dtype) for one in stack}) > 1:
        raise NlosError(f"{path}: its frames differ in size or depth; a burst is of one camera with one setting")
    return Burst(name=str(path), frames=np.stack(stack), time=_time(path.stem if path.is_file() else path.name))


def _part(
    values: NDArray[Any], path: Path, mosaic: tuple[int, int] | None, region: tuple[int, int, int, int] | None
) -> NDArray[Any]:
    """Part of a frame that is asked for."""
    if mosaic is not None:
        values = values[mosaic[0] :: 2, mosaic[1] :: 2]
    if region is None:
        return values
    (x, y, width, height), (own_height, own_width) = region, values.shape
    if min(x, y) < 0 or min(width, height) < 1 or x + width > own_width or y + height > own_height:
        raise NlosError(f"--region: lies outside the {own_width} x {own_height} pixels of {path}")
    return values[y : y + height, x : x + width].copy()


def _grey(frame: frames.Frame, path: Path, channel: str) -> NDArray[Any]:
    """Values of a frame, (height, width), if they are those of single pixels."""
    if frame.lossy or frame.gamma:
        why = "is compressed with loss" if frame.lossy else f"has a gamma ({frame.gamma})"
        raise NlosError(
            f"{path}: {frame.name} {why}, which changes the noise; take raw frames, or linear PNG or TIFF"
        )
    values = frame.values
    if not np.isfinite(values).all():
        raise NlosError(f"{path}: {frame.name} holds NaN or infinite values")
    if values.shape[2] == 3 and channel:
        values = values[..., ("red", "green", "blue").index(channel)]
    elif (values == values[..., :1]).all():
        values = values[..., 0]
    else:
        raise NlosError(
            f"{path}: {frame.name} is in colour; take one of --channel red and --channel blue, of raw files"
        )
    return values


def _time(name: str) -> float:
    """Seconds that a name such as ``dark-1/60s`` or ``10ms`` tells; NaN if it tells none, or several."""
    found = _TIME.findall(name.replace("_", "/"))
    if len(found) != 1:
        return math.nan
    part, number, unit = found[0]
    value = float(part) / float(number) if part else float(number)
    return value * _SECONDS[unit.lower()]
