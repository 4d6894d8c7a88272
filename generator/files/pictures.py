"""Pictures: float arrays of linear radiance, as EXR files with attributes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.files import exr
from generator.files.writing import atomic
from generator.model.errors import NlosError

COLOUR_SPACE = "Rec.709"
"""Default space of the three channels: linear, with these primaries."""


_INTEROP = {"Rec.709": "lin_rec709_scene", "Rec.2020": "lin_rec2020_scene", "ACEScg": "lin_ap1_scene"}
"""Names of the Color Interop Forum, which Blender 5 and others write into EXR files as ``colorInteropID``."""


Picture = NDArray[np.float32]


_OURS = "nlos:"


_GREY = ("Y", "V")
"""Channels of grey pictures: OpenEXR's own name, and Blender's."""


_COMBINED = ".Combined."
"""What the channels of a rendered picture have in their names in Blender's files of many layers."""


def pixel_hash(pixels: Picture) -> str:
    """Return the SHA-256 of a picture's shape and little-endian float32 pixels."""
    data = np.ascontiguousarray(pixels, dtype="<f4")
    return hashlib.sha256(repr(data.shape).encode() + data.tobytes()).hexdigest()


def write_picture(path: Path, pixels: Picture, header: Mapping[str, str]) -> str:
    """Write a float32 EXR, ZIP-compressed, by temporary name and rename.

    Parameters
    ----------
    path : Path
    pixels : ndarray of shape (height, width, 3), float32
        Scene-linear radiance, W/m^2/sr; row 0 is the top.
    header : mapping of str to str
        Attributes; each is stored as ``nlos:NAME``.

    Returns
    -------
    str
        Hash of the pixels, which is stored in the header too.

    Raises
    ------
    NlosError
        The pixels have another shape or are not finite, or the file cannot be written.
    """
    if pixels.ndim != 3 or pixels.shape[2] != 3:
        raise NlosError(f"{path}: a picture must have shape (height, width, 3), not {pixels.shape}")
    if not np.isfinite(pixels).all():
        raise NlosError(f"{path}: the picture holds NaN or infinite pixels")
    digest = pixel_hash(pixels)
    attributes = {f"{_OURS}{key}": value for key, value in {**header, "pixel_hash": digest}.items()}
    if header.get("colour_space", COLOUR_SPACE) != COLOUR_SPACE:
        attributes[exr.SPACE] = _INTEROP.get(header["colour_space"], header["colour_space"])
    with atomic(path) as temporary:
        exr.write(temporary, {name: pixels[..., i] for i, name in enumerate("RGB")}, attributes)
    return digest


def read_picture(path: Path) -> tuple[Picture, dict[str, str]]:
    """Read an EXR.

    Parameters
    ----------
    path : Path
        A picture with channels R, G, B; or grey, as Y or V, which stands for all three; or a file of many layers as
        Blender writes them, with the pass Combined of one view layer.

    Returns
    -------
    pixels : ndarray of shape (height, width, 3), float32
        Scene-linear radiance, W/m^2/sr.
    header : dict of str to str
        The attributes that `write_picture` stored; ``colour_space`` too where the file says by other means that its
        channels are not `COLOUR_SPACE`.

    Raises
    ------
    NlosError
        The file is missing, truncated, cropped or no such picture, or does not hold radiance.
    """
    path = Path(path)
    if not path.is_file():
        raise NlosError(f"{path}: no such picture")
    try:
        channels, attributes = exr.read(path)
    except exr.ExrError as error:
        raise NlosError(f"{path}: is not a whole EXR picture ({error})") from None
    except OSError as error:
        raise NlosError(f"{path}: cannot be read ({error.strerror})") from None
    header = {name.removeprefix(_OURS): value for name, value in attributes.items() if name.startswith(_OURS)}
    names = {interop: name for name, interop in _INTEROP.items()}
    if (space := names.get(attributes.get(exr.SPACE, ""), attributes.get(exr.SPACE, COLOUR_SPACE))) != COLOUR_SPACE:
        header.setdefault("colour_space", space)
    if not any(name in channels for name in "RGB"):
        channels = _combined(channels, path)
    missing = [name for name in "RGB" if name not in channels]
    grey = [name for name in _GREY if name in channels]
    if len(missing) == 3 and len(grey) == 1 and not {"RY", "BY"} & set(channels):  # with these, Y is in colour
        return np.repeat(channels[grey[0]][..., None], 3, axis=2), header
    if missing:
        raise NlosError(
            f"{path}: is no picture of radiance: it holds {', '.join(sorted(channels))}, and lacks "
            f"{', '.join(missing)} (or Y alone, for grey)"
        )
    return np.stack([channels[name] for name in "RGB"], axis=-1), header


def _combined(channels: exr.Planes, path: Path) -> exr.Planes:
    """Return the channels of the pass Combined by their colours, if there is one; else all channels as they are."""
    layers = sorted({name.rpartition(_COMBINED)[0] for name in channels if _COMBINED in name})
    if len(layers) > 1:
        raise NlosError(f"{path}: holds the view layers {', '.join(layers)}; save the one to be read alone")
    return {name.rpartition(".")[2]: plane for name, plane in channels.items() if _COMBINED in name} or channels
