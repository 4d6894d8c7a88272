"""Pictures that a camera has taken, at the brightness of a model's empty scene; nothing is added to them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from classify.pictures.sensor import Sensor, nearest
from generator.files.pictures import Picture
from generator.files.toml import from_dict
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.sets.readable import PictureSet


def level_of(own: Array, wanted: Array) -> tuple[float, float]:
    """Return the factor that brings a measured background nearest to a model's, and what is left.

    Parameters
    ----------
    own, wanted : ndarray of shape (height, width)
        W/m^2/sr.

    Returns
    -------
    level : float
    mismatch : float
        Relative root mean square of the difference in shape; the measured background's noise is part of it.

    Raises
    ------
    NlosError
        One of them holds no light.
    """
    level, mismatch = nearest(own, wanted) if wanted.any() else (0.0, 0.0)
    if not 0.0 < level < math.inf:
        raise NlosError("the empty scene, measured or of the model, holds no light, so brightness cannot be compared")
    return level, mismatch


class Taken:
    """A set of measured pictures, brought to the level of a model.

    Parameters
    ----------
    dataset : PictureSet
        With noise of its own (`generator.sets.measured.has_own_noise`).
    like : ndarray of shape (height, width)
        Empty scene of the model, W/m^2/sr.

    Attributes
    ----------
    level : float
        Factor on all pictures by which the measured empty scene is as bright as the model's.
    mismatch : float
        Relative root mean square by which the two differ in shape.
    sensor : Sensor
        The camera, with its exposure at that level.

    Raises
    ------
    NlosError
        There is no picture of the empty scene, it has another size, or the set does not tell its noise.
    """

    def __init__(self, dataset: PictureSet, like: Array) -> None:
        self._dataset = dataset
        background = dataset.background()
        if background.shape[:2] != like.shape:
            (height, width), (wanted_height, wanted_width) = background.shape[:2], like.shape
            raise NlosError(
                f"{dataset.path}: has {width} x {height} pixels, and what is to answer is of {wanted_width} x "
                f"{wanted_height}; import the pictures with --resolution {wanted_width}x{wanted_height}"
            )
        told = dataset.meta.get("sensor")
        if not told:
            raise NlosError(
                f"{dataset.path}: does not tell the noise of its pictures; import them with --electrons or --sensor, "
                "or with several frames of the empty scene"
            )
        sensor: Sensor = from_dict(Sensor, told, f"{dataset.path}: sensor.")
        if not sensor.exposure:
            raise NlosError(f"{dataset.path}: sensor.exposure: is missing, electrons per W/m^2/sr")
        self.level, self.mismatch = level_of(background.mean(axis=2, dtype=np.float64), like)
        self.sensor = replace(sensor, exposure=sensor.exposure / self.level)
        self._background: Picture = background * np.float32(self.level)

    def background(self) -> Picture:
        """Return the measured empty scene, (height, width, 3), at the model's level."""
        return self._background

    def picture(self, record: PoseRecord) -> Picture:
        """Return a measured picture, (height, width, 3), at the model's level."""
        return self._dataset.picture(record) * np.float32(self.level)
