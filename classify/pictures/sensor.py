"""What a real camera makes of a radiance picture: photons are counted, a chip adds noise, a converter rounds.

The terms are those of the linear model of the standard EMVA 1288: photon shot noise, temporal dark noise (here read
noise: exposures are short), full well (saturation capacity), spread of the pixels' gain (PRNU) and offset (DSNU), and
quantisation. The camera is monochrome: it sees the mean of a picture's three channels.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.files.pictures import Picture
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.sets.readable import PictureSet

Floats = NDArray[Any]

_BLACK = 8.0
"""Read noises by which the black level lies above zero, so that rounding at zero biases no mean."""
_BRIGHTER = 4.0
"""A well that is filled this many times over overflows whatever the photons do."""
_SAME_SHAPE = 0.02
"""Two pictures are one in other light if, brought to one level, they differ by less, relative, root mean square."""
_SAME_LEVEL = 0.01
"""Levels are one if they differ by less: lamps drift by as much."""


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A camera's sensor and how it is used.

    Attributes
    ----------
    full_well : float
        Electrons that a pixel holds.
    read_noise : float
        Standard deviation, electrons, of every readout.
    bits : int
        Of the converter; its range is the full well's. 0 does not round.
    exposure : float
        Electrons in a frame per W/m^2/sr; 0 puts the brightest pixel of the scene at ``fill``.
    fill : float
        Share of the full well that the brightest pixel fills where the exposure follows from the scene.
    frames : int
        Averaged for a picture.
    background_frames : int
        Averaged for the background picture; it stands still, so there is time.
    gain_spread : float
        Standard deviation of the pixels' gain, relative (PRNU): a fixed pattern, the same in every frame.
    offset_spread : float
        Standard deviation of the pixels' offset, electrons (DSNU); likewise.
    drift : float
        By how much the ambient light has changed since the background was taken, relative.
    """

    full_well: float = 10_500.0
    read_noise: float = 2.5
    bits: int = 12
    exposure: float = 0.0
    fill: float = 0.8
    frames: int = 1
    background_frames: int = 100
    gain_spread: float = 0.0
    offset_spread: float = 0.0
    drift: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value):
                raise NlosError(f"sensor.{name}: {value} is not a finite number")
        for name in ("read_noise", "exposure", "gain_spread", "offset_spread"):
            if getattr(self, name) < 0.0:
                raise NlosError(f"sensor.{name}: {getattr(self, name):g} must not be negative")
        for name in ("full_well", "fill"):
            if getattr(self, name) <= 0.0:
                raise NlosError(f"sensor.{name}: {getattr(self, name):g} must be positive")
        for name in ("frames", "background_frames"):
            if getattr(self, name) < 1:
                raise NlosError(f"sensor.{name}: {getattr(self, name)} must be 1 or more")
        if not 0 <= self.bits <= 32:
            raise NlosError(f"sensor.bits: {self.bits} must be from 1 to 32, or 0 not to round")
        if self.drift <= -1.0:
            raise NlosError(f"sensor.drift: {self.drift:g} must be above -1, which is no light at all")
        if self.bits and self._black >= self._white:
            raise NlosError(
                f"sensor.bits: {self.bits} are too few for a read noise of {self.read_noise:g} electrons and a full "
                f"well of {self.full_well:g}"
            )

    def exposed(self, pictures: Iterable[Picture]) -> Sensor:
        """Return the sensor with an exposure; if it has none, the brightest of the pictures' pixels fills it.

        Raises
        ------
        NlosError
            There is no light.
        """
        if self.exposure:
            return self
        brightest = max((float(_grey(p).max()) for p in pictures), default=0.0)
        if not (brightest > 0.0 and math.isfinite(self.fill * self.full_well / brightest)):
            raise NlosError(
                "sensor.exposure: cannot follow from pictures without light; give it in electrons per W/m^2/sr"
            )
        return replace(self, exposure=self.fill * self.full_well / brightest)

    def electrons(self, picture: Picture | Array) -> Array:
        """Return the electrons expected in a frame, (height, width), of radiance (height, width, 3), W/m^2/sr."""
        if not self.exposure:
            raise NlosError("sensor.exposure: is not chosen yet")
        # A renderer's noise can go below zero, photons cannot.
        expected: Array = np.maximum(_grey(picture), 0.0) * self.exposure
        return expected

    def saturated(self, picture: Picture) -> float:
        """Return the share of pixels that overflow."""
        return float((self.electrons(picture) > self.full_well).mean())

    def measure(self, picture: Picture, rng: np.random.Generator, *, frames: int = 0, pattern: int = 0) -> Picture:
        """Return the radiance that the camera reports, (height, width, 3), float32, W/m^2/sr.

        Parameters
        ----------
        picture : ndarray of shape (height, width, 3)
            Scene-linear radiance, W/m^2/sr.
        rng : Generator
            Of the temporal noise.
        frames : int
            Averaged; 0 takes the sensor's own.
        pattern : int
            Seed of the fixed pattern: which specimen of the sensor it is.

        Raises
        ------
        NlosError
            No exposure is chosen yet.
        """
        expected = self.electrons(picture)
        gain, offset = self._pattern(expected.shape, pattern)
        expected = np.minimum(expected * gain, _BRIGHTER * self.full_well + 100.0)
        count, total = frames or self.frames, np.zeros(expected.shape)
        for _ in range(count):
            held = np.minimum(rng.poisson(expected), self.full_well)
            total += self._convert(held + offset + rng.normal(scale=self.read_noise, size=held.shape))
        radiance = total / count / self.exposure
        return np.repeat(radiance[..., None], 3, axis=2).astype(np.float32)

    def variance(self, picture: Picture | Array, *, frames: int = 0) -> Array:
        """Return the variance of what `measure` reports, (height, width), (W/m^2/sr)^2, where no well overflows.

        The photons', the readout's and the rounding's (EMVA 1288, the linear model's temporal noise, divided by the
        squared gain). Without the fixed pattern, which picture and background share.
        """
        rounding = self._step**2 / 12.0
        electrons = self.electrons(picture) + self.read_noise**2 + rounding
        variance: Array = electrons / (frames or self.frames) / self.exposure**2
        return variance

    def stabilised(self, picture: Picture | Array) -> Array:
        """Return measured light on a scale where its noise has variance 1 however bright it is, (height, width).

        The generalised Anscombe transform 2 sqrt(n + 3/8 + s^2) of n electrons with read noise s, in all frames
        together (Anscombe 1948, equation 2.1; Murtagh, Starck and Bijaoui 1995, equation 4).
        """
        held = self._held(picture)  # what is measured of darkness can be below zero
        made: Array = 2.0 * np.sqrt(np.maximum(held + 0.375 + self._dark, 0.0))
        return made

    def stabilised_mean(self, picture: Picture | Array) -> Array:
        """Return the mean of `stabilised` over measurements of light that is known, (height, width).

        The root bends, so that is less than the root of the mean: by half its curvature times the variance.
        """
        held = np.maximum(self._held(picture), 0.0)
        inside = held + 0.375 + self._dark
        mean: Array = 2.0 * np.sqrt(inside) - (held + self._dark) / (4.0 * inside**1.5)
        return mean

    def _held(self, picture: Picture | Array) -> Array:
        """Electrons in all frames; of what overflows, nobody knows how much it was."""
        held: Array = float(self.frames) * np.minimum(self.exposure * _grey(picture), self.full_well)
        return held

    @property
    def _dark(self) -> float:
        """Variance of what all frames add to the photons' own, squared electrons."""
        return self.frames * (self.read_noise**2 + self._step**2 / 12.0)

    @property
    def _white(self) -> float:
        """Highest grey level."""
        return float(2**self.bits - 1)

    @property
    def _step(self) -> float:
        """Electrons per grey level; 0 where nothing is rounded."""
        return self.full_well / (self._white - self._black) if self.bits else 0.0

    @property
    def _black(self) -> float:
        """Grey level of no light."""
        noise = math.hypot(self.read_noise, self.offset_spread)
        return float(math.ceil(_BLACK * noise * self._white / (self.full_well + _BLACK * noise)))

    def _convert(self, electrons: Array) -> Array:
        """Electrons as the converter reports them, rounded and cut at its ends."""
        if not self.bits:
            return electrons
        levels = np.clip(np.rint(electrons / self._step + self._black), 0.0, self._white)
        converted: Array = (levels - self._black) * self._step
        return converted

    def _pattern(self, shape: tuple[int, ...], seed: int) -> tuple[Any, Any]:
        """Gain and offset of each pixel."""
        if not (self.gain_spread or self.offset_spread):
            return 1.0, 0.0
        rng = np.random.default_rng([seed, 1288])
        gain, offset = rng.normal(size=(2, *shape))
        return np.maximum(1.0 + self.gain_spread * gain, 0.0), self.offset_spread * offset


class Camera:
    """Reads a data set as a sensor would have seen it; the clean radiance stays on disk.

    Parameters
    ----------
    dataset : Dataset or SimulatedSet
    sensor : Sensor
        Where it has no exposure, the brightest pixel of the data set fills it to ``fill``.
    seed : int
        Of all noise; a picture's own follows from it, the data set, the voxel and the pose's index. So no order
        changes it, and no two data sets share it: what is trained on one could know the other's by heart.
    like : ndarray of shape (height, width), optional
        Background, W/m^2/sr, to whose level the exposure is set where the data set's own is the same but for a
        factor: another albedo of the wall, a stronger lamp. All light that goes over the wall twice has that factor.

    Attributes
    ----------
    sensor : Sensor
        With its exposure.
    level : float
        What the radiance of all pictures is multiplied with: above 1 where the exposure is longer.

    Raises
    ------
    NlosError
        The data set has no light, or a picture is broken.
    """

    def __init__(self, dataset: PictureSet, sensor: Sensor, seed: int = 0, *, like: Array | None = None) -> None:
        self._dataset = dataset
        self._seed = seed
        self.level = 1.0 if like is None else _level(_grey(dataset.background()), like)
        digest = hashlib.sha256(str(dataset.meta["fingerprint"]).encode()).digest()
        self._set = int.from_bytes(digest[:8], "big")
        every = itertools.chain([dataset.background()], map(dataset.picture, dataset.records))
        self.sensor = sensor.exposed(every)

    def background(self) -> Picture:
        """Return the measured background, (height, width, 3), W/m^2/sr."""
        sensor, clean = self.sensor, self.empty()
        if sensor.drift and (ambient := self._dataset.ambient_background()) is not None:
            clean = clean - ambient * np.float32(self.level * sensor.drift / (1.0 + sensor.drift))
        rng = np.random.default_rng([self._seed, 0, self._set])
        return sensor.measure(clean, rng, frames=sensor.background_frames, pattern=self._seed)

    def empty(self) -> Picture:
        """Return the clean background, (height, width, 3), W/m^2/sr, at the level of all pictures."""
        return self._dataset.background() * np.float32(self.level)

    def picture(self, record: PoseRecord) -> Picture:
        """Return a measured picture, (height, width, 3), W/m^2/sr."""
        rng = np.random.default_rng([self._seed, 1, self._set, record.voxel, record.index])
        clean = self._dataset.picture(record) * np.float32(self.level)
        return self.sensor.measure(clean, rng, pattern=self._seed)


def _level(own: Array, wanted: Array) -> float:
    """Return the factor that makes one picture of another in other light; 1 if they are not the same picture."""
    if own.shape != wanted.shape or not (own.any() and wanted.any()):
        return 1.0
    factor = float((own * wanted).sum() / (own * own).sum())
    error = np.sqrt(((factor * own - wanted) ** 2).mean() / (wanted**2).mean())
    return factor if error < _SAME_SHAPE and abs(factor - 1.0) > _SAME_LEVEL else 1.0


def _grey(picture: Picture | Array) -> Array:
    grey: Array = np.asarray(picture, dtype=np.float64).mean(axis=2)
    return grey
