"""Mean and temporal noise of bursts of frames: of single pixels, and of what a row, a column or a frame share."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from classify.pictures.burst import Burst
from generator.model.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Level:
    """What is kept of a burst.

    Attributes
    ----------
    name : str
    frames : int
    time, irradiance : float
        As of `Burst`.
    mean : ndarray of shape (height, width)
        Mean grey level of each pixel.
    variance : ndarray of shape (height, width)
        Temporal variance of each pixel, without what pixels share.
    means : ndarray of shape (n,)
        Mean grey level of each frame.
    row, column : float
        Mean squares of rows and columns of the frames: a pixel's variance, and that of rows times their length.
    alike : float
        Correlation of the temporal noise of neighbours.
    zero, top : float
        Shares of values that are zero, and that are the highest of all bursts.
    """

    name: str
    frames: int
    time: float
    irradiance: float
    mean: Array
    variance: Array
    means: Array
    row: float
    column: float
    alike: float
    zero: float
    top: float

    @property
    def pixel(self) -> float:
        """Mean of the pixels' temporal variance."""
        return float(self.variance.mean())

    @property
    def shared(self) -> tuple[float, float]:
        """Temporal variance of rows, and of columns."""
        height, width = self.mean.shape
        return (self.row - self.pixel) / width, (self.column - self.pixel) / height

    @property
    def noise(self) -> float:
        """Variance of a frame's mean that follows from its pixels, rows and columns."""
        height, width = self.mean.shape
        row, column = self.shared
        return self.pixel / self.mean.size + max(0.0, row) / height + max(0.0, column) / width


def level(burst: Burst, offset: float, *, unit: float, top: float) -> Level:
    """Return what is kept of a burst.

    Parameters
    ----------
    burst : Burst
    offset : float
        Mean grey level without light: frames are scaled about it to one brightness; NaN in the dark, where they are
        moved.
    unit : float
        Step between grey levels in the files.
    top : float
        Highest grey level of all bursts.
    """
    count, height, width = burst.frames.shape
    means = burst.frames.mean(axis=(1, 2), dtype=np.float64) / unit
    middle = float(means.mean())
    factors = np.ones(count) if math.isnan(offset) else (middle - offset) / (means - offset)

    def one(k: int) -> Array:
        frame: Array = burst.frames[k].astype(np.float64) / unit
        if math.isnan(offset):
            moved: Array = frame + (middle - means[k])
            return moved
        scaled: Array = offset + (frame - offset) * factors[k]
        return scaled

    mean = np.zeros((height, width))
    for k in range(count):
        mean += one(k) / count
    total, rows, columns, products = np.zeros((height, width)), 0.0, 0.0, 0.0
    for k in range(count):
        apart = one(k) - mean
        row, column = apart.mean(axis=1), apart.mean(axis=0)
        both = apart.mean()
        rows += float(((row - both) ** 2).sum()) * width
        columns += float(((column - both) ** 2).sum()) * height
        rest = apart - row[:, None] - column + both
        total += rest**2
        products += float((rest[:, 1:] * rest[:, :-1]).sum() + (rest[1:] * rest[:-1]).sum()) / 2.0
    free = count - 1
    return Level(
        name=burst.name,
        frames=count,
        time=burst.time,
        irradiance=burst.irradiance,
        mean=mean,
        variance=total / (free * (1.0 - 1.0 / height) * (1.0 - 1.0 / width)),
        means=means,
        row=rows / (free * (height - 1)),
        column=columns / (free * (width - 1)),
        alike=products / float(total.sum()) if total.any() else 0.0,
        zero=float((burst.frames <= 0).mean()),
        top=float((burst.frames >= top * unit).mean()),
    )
