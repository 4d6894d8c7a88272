"""Pictures for a calibration: read from files and data sets, as a sensor sees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from classify.calibration.predicted import Placed
from classify.pictures.sensor import Sensor
from generator.files.pictures import COLOUR_SPACE, Picture, read_picture
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.sets.measured import has_own_noise
from generator.sets.simulated import open_set


@dataclass(frozen=True)
class Measured:
    """What was measured of a room.

    Attributes
    ----------
    pictures : ndarray of shape (1 + places, height, width)
        Grey, W/m^2/sr: the empty scene, then the object at each place.
    places : tuple of Placed
    sensor : Sensor
        The camera, with its exposure.
    frames : tuple of int
        How many frames were averaged for each picture.
    """

    pictures: Array
    places: tuple[Placed, ...]
    sensor: Sensor
    frames: tuple[int, ...]

    def variance(self, expected: Array) -> Array:
        """Return the noise's variance of expected pictures, of their shape, (W/m^2/sr)^2.

        The fixed pattern of the pixels counts as noise of each picture, which frames do not average.
        """
        pairs = zip(expected, self.frames, strict=True)
        seen = [self.sensor.variance(np.repeat(one[..., None], 3, axis=2), frames=n) for one, n in pairs]
        gain, offset = self.sensor.gain_spread, self.sensor.offset_spread / self.sensor.exposure
        variance: Array = np.stack(seen) + (gain * expected) ** 2 + offset**2
        return variance


def place(text: str) -> tuple[Path, Placed | None]:
    """Return the file of an argument ``PICTURE``, ``PICTURE=x,y,z`` or ``PICTURE=x,y,z,rx,ry,rz``, and the place.

    Raises
    ------
    NlosError
        What stands behind the last ``=`` is neither three nor six numbers; a file's name may hold others.
    """
    name, equals, numbers = text.rpartition("=")
    if not equals or Path(text).exists():
        return Path(text), None
    try:
        values = [float(number) for number in numbers.split(",")]
    except ValueError:
        values = []
    if len(values) not in (3, 6) or not np.isfinite(values).all():
        raise NlosError(
            f"{text}: a place must read PICTURE=x,y,z in metres, or PICTURE=x,y,z,rx,ry,rz with degrees too"
        )
    x, y, z, rx, ry, rz = [*values, 0.0, 0.0, 0.0][:6]
    return Path(name), Placed((x, y, z), (rx, ry, rz))


def read(arguments: Sequence[str], sensor: Sensor, seed: int = 0) -> Measured:
    """Read pictures of the empty scene, which are averaged, and of the object at known places.

    Folders are data sets, whose empty scene's picture is taken; their pictures get the sensor's noise if they were
    rendered. Files are pictures that were measured: ``.exr`` or ``.npy``.

    Parameters
    ----------
    arguments : sequence of str
        As `place` takes them.
    sensor : Sensor
        Without an exposure, the brightest pixel of all pictures fills its well to its ``fill``.
    seed : int
        Of the noise.

    Raises
    ------
    NlosError
        A picture cannot be read, has another size or other colours, or there is none of the empty scene.
    """
    rng = np.random.default_rng([seed, 26])
    empty: list[tuple[Path, Picture, bool]] = []
    placed: list[tuple[Path, Picture, bool]] = []
    places = []
    for path, where in map(place, arguments):
        if where is None:
            empty.append((path, *_picture(path)))
        elif path.is_dir():
            raise NlosError(f"{path}: is a folder; name the picture in it that shows the object at {where.position}")
        else:
            placed.append((path, *_picture(path)))
            places.append(where)
    if not empty:
        raise NlosError("a calibration needs a picture of the empty scene: name one without a place")
    for path, one, _ in (*empty, *placed):
        if one.shape != empty[0][1].shape:
            sizes = [f"{p.shape[1]} x {p.shape[0]} pixels" for p in (one, empty[0][1])]
            raise NlosError(f"{path}: has {sizes[0]}, and {empty[0][0]} has {sizes[1]}; all must have the same")
    sensor = sensor.exposed([one for _, one, _ in (*empty, *placed)])

    def seen(one: Picture, is_clean: bool, frames: int) -> Array:
        grey: Array = (sensor.measure(one, rng, frames=frames) if is_clean else one).mean(axis=2, dtype=np.float64)
        return grey

    background = np.mean([seen(one, clean, sensor.background_frames) for _, one, clean in empty], axis=0)
    with_object = [seen(one, clean, sensor.frames) for _, one, clean in placed]
    frames = (len(empty) * sensor.background_frames, *(sensor.frames for _ in placed))
    return Measured(np.stack([background, *with_object]), tuple(places), sensor, frames)


def _picture(path: Path) -> tuple[Picture, bool]:
    """Return a picture (height, width, 3), and whether it is free of noise."""
    if path.is_dir():
        dataset = open_set(path)
        return _checked(path, dataset.background(), dataset.colour_space), not has_own_noise(dataset)
    if path.suffix.lower() == ".npy":
        try:
            values = np.load(path, allow_pickle=False)
        except (OSError, ValueError) as error:
            raise NlosError(f"{path}: cannot be read as an array ({error})") from None
        if values.ndim == 2:
            values = np.repeat(values[..., None], 3, axis=2)
        return _checked(path, values, COLOUR_SPACE), False
    pixels, header = read_picture(path)
    return _checked(path, pixels, header.get("colour_space", COLOUR_SPACE)), False


def _checked(path: Path, values: Any, space: str) -> Picture:
    if values.ndim != 3 or values.shape[2] != 3 or values.dtype.kind not in "fiu":
        raise NlosError(
            f"{path}: must hold numbers of shape (height, width) or (height, width, 3), not {values.shape}"
        )
    if not np.isfinite(values).all():
        raise NlosError(f"{path}: holds NaN or infinite pixels")
    if space != COLOUR_SPACE:
        raise NlosError(
            f"{path}: its channels are linear {space}, of which the mean is another grey; give {COLOUR_SPACE}"
        )
    return np.asarray(values, dtype=np.float32)
