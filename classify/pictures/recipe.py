"""How a camera's frames become pictures of radiance: all of it is linear, and so one matrix and an offset.

Values are brought back to a line if a gamma was laid over them; then dark and flat field, the weights of the colours,
lens, perspective and size, exposure and level are one product with a sparse matrix. A frame takes milliseconds.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from classify.pictures.frames import Frame, Values
from classify.pictures.sensor import Sensor
from generator.files.limits import check_archive
from generator.files.pictures import Picture
from generator.files.toml import from_dict
from generator.files.writing import atomic
from generator.model.arrays import Array
from generator.model.errors import NlosError

FILE = "recipe.npz"
"""Its name in a data set."""
_LINEAR = ("", "none", "linear", "1")
_FULL_ENOUGH = 0.5
"""Share of a picture's pixel that may be lost to masked pixels of the camera."""


def linear(values: Values, gamma: str, white: float) -> Array:
    """Return values in proportion to light.

    Parameters
    ----------
    values : ndarray
    gamma : str
        Transfer curve that was laid over them: ``srgb`` (IEC 61966-2-1), a number such as 2.2, or none.
    white : float
        Value that stands for 1.
    """
    light = np.asarray(values, dtype=np.float64)
    if gamma in _LINEAR:
        return light
    share = np.clip(light / white, 0.0, None)
    if gamma == "srgb":
        straight = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    else:
        straight = share ** float(gamma)
    return np.asarray(white * straight)


def size_words(shape: tuple[int, ...]) -> str:
    """Return the size of a frame (height, width, channels) in words."""
    return f"{shape[1]} x {shape[0]} pixels in {shape[2]} channel{'s' if shape[2] > 1 else ''}"


def check_gamma(gamma: str) -> str:
    """Return the name of a transfer curve; NlosError if there is no such curve."""
    if gamma in _LINEAR:
        return ""
    if gamma == "srgb":
        return gamma
    try:
        value = float(gamma)
    except ValueError:
        value = 0.0
    if not 0.2 <= value <= 5.0:
        raise NlosError(f"--gamma {gamma!r}: must be srgb, a number from 0.2 to 5, or 1 if values are linear")
    return gamma


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """From frames to a picture.

    Attributes
    ----------
    shape : (int, int, int)
        Height, width and channels of a frame.
    resolution : (int, int)
        Width and height of a picture.
    matrix : csr_matrix of shape (width * height, height * width * channels of a frame)
        W/m^2/sr per unit of light.
    offset : ndarray of shape (width * height,)
        W/m^2/sr of a dark frame.
    gamma : str
        As for `linear`.
    white : float
        Value from which on a pixel of a frame is saturated.
    exposure : float
        Exposure of the frames that the matrix is for, as `Frame.exposure` has it; 0 if exposures do not matter.
    sensor : Sensor or None
        The camera, whose pixels are those of a picture; None if its noise is not known.
    target : str
        Kind of the target.
    """

    shape: tuple[int, int, int]
    resolution: tuple[int, int]
    matrix: csr_matrix
    offset: Array
    gamma: str
    white: float
    exposure: float
    sensor: Sensor | None = None

    @property
    def used(self) -> NDArray[np.int64]:
        """Values of a frame that enter the picture."""
        used: NDArray[np.int64] = np.unique(self.matrix.indices).astype(np.int64)
        return used

    def saturated(self, values: Values) -> NDArray[np.int64]:
        """Return the numbers of the values of a frame that are saturated and enter the picture."""
        full = np.flatnonzero(values.reshape(-1) >= self.white)
        return full[np.isin(full, self.matrix.indices)] if len(full) else full

    def check(self, frame: Frame) -> None:
        """Raise NlosError unless a frame has the right size, finite values and no saturated pixel that counts."""
        if frame.values.shape != self.shape:
            have, want = size_words(frame.values.shape), size_words(self.shape)
            raise NlosError(f"{frame.name}: has {have}, and the others {want}")
        if frame.values.dtype.kind == "f" and not np.isfinite(frame.values).all():
            raise NlosError(f"{frame.name}: holds NaN or infinite values")
        if bool(self.exposure) != bool(frame.exposure):
            raise NlosError(
                f"{frame.name}: states {'an' if frame.exposure else 'no'} exposure, and the first picture "
                f"{'none' if frame.exposure else 'one'}; state all in the column exposure of --labels"
            )
        if count := len(self.saturated(frame.values)):
            raise NlosError(
                f"{frame.name}: {count} of its values on the patch are saturated ({self.white:g} or more); expose "
                "shorter, or leave these pixels out everywhere with --saturated mask"
            )

    def light(self, frame: Frame) -> Array:
        """Return the radiance of a frame, (width * height,)."""
        straight = linear(frame.values.reshape(-1), self.gamma, self.white)
        radiance: Array = self.matrix @ straight - self.offset
        if self.exposure and frame.exposure:
            radiance = radiance * (self.exposure / frame.exposure)
        return radiance

    def picture(self, light: Array) -> Picture:
        """Return radiance (width * height,) as a picture, (height, width, 3)."""
        width, height = self.resolution
        return np.repeat(light.reshape(height, width, 1), 3, axis=2).astype(np.float32)

    def __call__(self, frames: Sequence[Frame]) -> Picture:
        """Return the picture of frames, which are averaged.

        Raises
        ------
        NlosError
            A frame does not fit (`check`).
        """
        for frame in frames:
            self.check(frame)
        return self.picture(np.mean([self.light(frame) for frame in frames], axis=0))

    def scaled(self, factor: float, sensor: Sensor | None) -> Recipe:
        """Return the recipe of pictures that are ``factor`` times as bright, with their sensor."""
        fields = {**vars(self), "matrix": self.matrix * factor, "offset": self.offset * factor, "sensor": sensor}
        return Recipe(**fields)

    def save(self, path: Path) -> None:
        """Write it."""
        about = {
            **{name: getattr(self, name) for name in ("shape", "resolution", "gamma", "white", "exposure")},
            "sensor": None if self.sensor is None else asdict(self.sensor),
        }
        about["white"] = self.white if np.isfinite(self.white) else None
        matrix = self.matrix
        arrays = {"data": matrix.data.astype(np.float32), "indices": matrix.indices, "indptr": matrix.indptr}
        with atomic(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **arrays, offset=self.offset, about=np.array(json.dumps(about)))

    @classmethod
    def load(cls, path: Path) -> Recipe:
        """Read it.

        Raises
        ------
        NlosError
            The file is missing or broken.
        """
        if not path.is_file():
            raise NlosError(f"{path}: no such file; the data set was not made by nlos-classify import")
        try:
            check_archive(path)
            with np.load(path, allow_pickle=False) as file:
                about: dict[str, Any] = json.loads(str(file["about"]))
                height, width, channels = map(int, about["shape"])
                across, down = map(int, about["resolution"])
                parts = (file["data"], file["indices"], file["indptr"])
                matrix = csr_matrix(parts, shape=(across * down, height * width * channels), dtype=np.float64)
                matrix.check_format(full_check=True)
                offset = np.asarray(file["offset"], dtype=np.float64)
            if offset.shape != (across * down,) or not (np.isfinite(offset).all() and np.isfinite(matrix.data).all()):
                raise ValueError("its offset does not fit")
            told = about["sensor"]
            return cls(
                shape=(height, width, channels),
                resolution=(across, down),
                matrix=matrix,
                offset=offset,
                gamma=check_gamma(str(about["gamma"])),
                white=np.inf if about["white"] is None else float(about["white"]),
                exposure=float(about["exposure"]),
                sensor=None if told is None else from_dict(Sensor, told, "sensor."),
            )
        except NlosError as error:
            raise NlosError(f"{path}: {error}") from None
        except (OSError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile, EOFError) as error:
            raise NlosError(f"{path}: is no recipe of this software ({error})") from None


def without(weights: csr_matrix, masked: NDArray[np.bool_], resolution: tuple[int, int]) -> csr_matrix:
    """Return weights of areas without masked pixels of the camera; rows still sum to 1.

    Raises
    ------
    NlosError
        A pixel of the picture loses more than half of what it sees.
    """
    if not masked.any():
        return weights
    kept = csr_matrix(weights.multiply(~masked.ravel()[None]))
    kept.eliminate_zeros()
    left = np.asarray(kept.sum(axis=1)).ravel()
    if (worst := float(left.min())) < _FULL_ENOUGH:
        row, column = divmod(int(left.argmin()), resolution[0])
        raise NlosError(
            f"masked pixels of the camera leave {worst:.0%} of the picture's pixel in column {column}, row {row}, "
            "and half of it must be left; take a smaller --resolution or mask less"
        )
    return csr_matrix(kept.multiply(1.0 / left[:, None]))
