"""Model of a real camera: it counts photons, the chip adds noise, and the converter rounds.

The terms are those of the linear model of the standard EMVA 1288: photon shot noise, temporal dark noise (here read
noise: exposures are short), full well (saturation capacity), spread of the pixels' gain (PRNU) and offset (DSNU), and
quantisation. The camera is monochrome: it sees the mean of a picture's three channels.
"""

from __future__ import annotations

import hashlib
import itertools
import json
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
"""Black level, in standard deviations of the dark noise, high enough that clipping at zero biases no mean."""
_BRIGHTER = 4.0
"""A well whose expected charge is this many times its capacity overflows for any shot noise."""
_SAME_SHAPE = 0.02
"""Relative RMS difference, after scaling to one level, below which two pictures differ in the level alone."""
_SAME_LEVEL = 0.01
"""Relative difference below which two levels count as equal: lamps drift by as much."""


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A camera's sensor and how it is used.

    Attributes
    ----------
    full_well : float
        Electrons that a pixel can hold.
    read_noise : float
        Standard deviation of every readout, electrons.
    bits : int
        Bits of the converter, whose range is the full well; 0 does not round.
    exposure : float
        Electrons in a frame per W/m^2/sr; 0 puts the brightest pixel of the scene at ``fill``.
    fill : float
        Share of the full well that the brightest pixel fills if the exposure follows from the scene.
    frames : int
        Number of frames averaged for a picture.
    background_frames : int
        Number of frames averaged for the background picture; it is static, so there is time for many.
    gain_spread : float
        Standard deviation of the pixels' gain, relative (PRNU): a fixed pattern, the same in every frame.
    offset_spread : float
        Standard deviation of the pixels' offset, electrons (DSNU): also a fixed pattern.
    drift : float
        Relative change of the ambient light since the background was taken.
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
        """Return the sensor with an exposure; if it has none, the brightest pixel of the pictures defines it.

        Raises
        ------
        NlosError
            If there is no light in the pictures.
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
        """Return the electrons expected in a frame, (height, width), for radiance (height, width, 3), W/m^2/sr."""
        if not self.exposure:
            raise NlosError("sensor.exposure: is not chosen yet")
        # Rendering noise can make a radiance negative, but photon counts cannot be.
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
            Generator of the temporal noise.
        frames : int
            Number of frames averaged; 0 takes the sensor's own.
        pattern : int
            Seed of the fixed pattern: which specimen of the sensor it is.

        Raises
        ------
        NlosError
            If no exposure is chosen yet.
        """
        expected = self.electrons(picture)
        gain, offset = self._pattern(expected.shape, pattern)
        expected = np.minimum(expected * gain, _BRIGHTER * self.full_well + 100.0)
        count, total = frames or self.frames, np.zeros(expected.shape)
        for _ in range(count):
            electrons = np.minimum(rng.poisson(expected), self.full_well)
            total += self._convert(electrons + offset + rng.normal(scale=self.read_noise, size=electrons.shape))
        radiance = total / count / self.exposure
        return np.repeat(radiance[..., None], 3, axis=2).astype(np.float32)

    def variance(self, picture: Picture | Array, *, frames: int = 0) -> Array:
        """Return the variance of what `measure` reports, (height, width), (W/m^2/sr)^2, where no well overflows.

        It is the sum for photons, readout and rounding (EMVA 1288, the linear model's temporal noise, divided by the
        squared gain). The fixed pattern is left out, since picture and background share it.
        """
        rounding = self._step**2 / 12.0
        electrons = self.electrons(picture) + self.read_noise**2 + rounding
        variance: Array = electrons / (frames or self.frames) / self.exposure**2
        return variance

    def stabilised(self, picture: Picture | Array) -> Array:
        """Return measured light on a scale where its noise has variance 1 at any brightness, (height, width).

        The generalised Anscombe transform 2 sqrt(n + 3/8 + s^2) of n electrons with read noise s, in all frames
        together (Anscombe 1948, equation 2.1; Murtagh, Starck and Bijaoui 1995, equation 4).
        """
        electrons = self._held(picture)  # measured darkness can be below zero
        transformed: Array = 2.0 * np.sqrt(np.maximum(electrons + 0.375 + self._dark, 0.0))
        return transformed

    def stabilised_mean(self, picture: Picture | Array) -> Array:
        """Return the mean of `stabilised` over measurements of a known radiance, (height, width).

        As the root is concave, this is less than the root of the mean, by half its curvature times the variance.
        """
        electrons = np.maximum(self._held(picture), 0.0)
        argument = electrons + 0.375 + self._dark
        mean: Array = 2.0 * np.sqrt(argument) - (electrons + self._dark) / (4.0 * argument**1.5)
        return mean

    def _held(self, picture: Picture | Array) -> Array:
        """Electrons in all frames together, limited to the full well."""
        electrons: Array = float(self.frames) * np.minimum(self.exposure * _grey(picture), self.full_well)
        return electrons

    @property
    def _dark(self) -> float:
        """Variance of readout and rounding in all frames together, squared electrons."""
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
        """Grey level without light."""
        noise = math.hypot(self.read_noise, self.offset_spread)
        return float(math.ceil(_BLACK * noise * self._white / (self.full_well + _BLACK * noise)))

    def _convert(self, electrons: Array) -> Array:
        """Electrons as the converter reports them, rounded and clipped to its range."""
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


def _identity(dataset: PictureSet, background: Picture) -> int:
    """Return a number of what a data set is of: its settings, its scene, and the change in its first picture.

    Neither the hash of the scene's file nor the fingerprint enters: Blender saves a scene as other bytes each time.
    Of two targets that are described alike the first pictures differ; two digits of it are the same on any processor.
    """
    settings = {name: value for name, value in dataset.meta["sweep"].items() if name != "scene_sha256"}
    change = ""
    if dataset.records:
        first = dataset.records[0]
        empty = dataset.background_of(first) if dataset.own_backgrounds else background
        change = f"{float((dataset.picture(first) - empty).mean(dtype=np.float64)):.1e}"
    scene = dataset.meta.get("scene")
    if isinstance(scene, dict) and isinstance(target := scene.get("target"), dict):
        # Sets from before targets could be glossy, or have files of any unit, keep their noise.
        plain = [name for name in ("unit", "up") if target.get(name) == "auto"]
        plain += [] if target.get("gloss") else ["gloss", "roughness"]
        scene = {**scene, "target": {name: value for name, value in target.items() if name not in plain}}
    content = json.dumps([settings, scene, change], sort_keys=True, default=str)
    return int.from_bytes(hashlib.sha256(content.encode()).digest()[:8], "big")


class Camera:
    """Reads a data set as a sensor would have seen it; the clean radiance stays on disk.

    Parameters
    ----------
    dataset : Dataset or SimulatedSet
    sensor : Sensor
        If it has no exposure, the brightest pixel of the data set fills the well to ``fill``.
    seed : int
        Seed of all noise. The noise of a picture follows from it, what the data set is of, the voxel and the pose's
        index. So it does not depend on the order, it is the same for a data set that is made again, and no two that
        differ share noise that a classifier could learn by heart.
    like : ndarray of shape (height, width), optional
        Background, W/m^2/sr. If the data set's own background differs from it only by a factor (another albedo of the
        wall, a stronger lamp), the exposure makes up for it: all light that meets the wall twice has that factor.
    any_shape : bool
        Whether the exposure makes every background as bright as ``like``, also those that a set has for each pose and
        those of other shape: for an atlas of an uncertain scene, whose backgrounds were made so.

    Attributes
    ----------
    sensor : Sensor
        The sensor with its exposure.
    level : float
        Factor on the radiance of all pictures: above 1 if the exposure is longer.
    mismatch : float
        Relative root mean square by which the two backgrounds differ in shape, if by more than 2 %; then they are of
        different scenes, and no exposure makes up for it.

    Raises
    ------
    NlosError
        If the data set has no light, a picture is broken, or ambient light drifts where each pose has a background.
    """

    def __init__(
        self,
        dataset: PictureSet,
        sensor: Sensor,
        seed: int = 0,
        *,
        like: Array | None = None,
        any_shape: bool = False,
    ) -> None:
        if sensor.drift and dataset.own_backgrounds:
            raise NlosError(
                f"{dataset.path}: has a background a pose, for which drift is not modelled; leave --drift out"
            )
        self._dataset = dataset
        self._seed = seed
        background = dataset.background()
        self._like = like if any_shape else None
        self.level, self.mismatch = (1.0, 0.0) if like is None else level_between(_grey(background), like)
        if self._like is not None:
            self.level, self.mismatch = factor_between(_grey(background), self._like), 0.0
        self._set = _identity(dataset, background)
        pictures = itertools.chain([background], map(dataset.picture, dataset.records))
        self.sensor = sensor.exposed(pictures)

    def _level_of(self, record: PoseRecord) -> float:
        """Return the factor on the radiance of a pose's picture."""
        if self._like is None or not self._dataset.own_backgrounds:
            return self.level
        return factor_between(_grey(self._dataset.background_of(record)), self._like)

    def background(self, draw: int = 0) -> Picture:
        """Return a measured background, (height, width, 3), W/m^2/sr; each ``draw`` has noise of its own."""
        sensor, clean = self.sensor, self.empty()
        if sensor.drift and (ambient := self._dataset.ambient_background()) is not None:
            clean = clean - ambient * np.float32(self.level * sensor.drift / (1.0 + sensor.drift))
        rng = np.random.default_rng([self._seed, 0, self._set, *([draw] if draw else [])])
        return sensor.measure(clean, rng, frames=sensor.background_frames, pattern=self._seed)

    def empty(self) -> Picture:
        """Return the clean background, (height, width, 3), W/m^2/sr, at the level of all pictures."""
        return self._dataset.background() * np.float32(self.level)

    def background_of(self, record: PoseRecord) -> Picture:
        """Return the measured background of a pose of a set in which each has its own."""
        rng = np.random.default_rng([self._seed, 2, self._set, record.voxel, record.index])
        clean = self._dataset.background_of(record) * np.float32(self._level_of(record))
        return self.sensor.measure(clean, rng, frames=self.sensor.background_frames, pattern=self._seed)

    def picture(self, record: PoseRecord) -> Picture:
        """Return a measured picture, (height, width, 3), W/m^2/sr."""
        rng = np.random.default_rng([self._seed, 1, self._set, record.voxel, record.index])
        clean = self._dataset.picture(record) * np.float32(self._level_of(record))
        return self.sensor.measure(clean, rng, pattern=self._seed)


def factor_between(own: Array, wanted: Array) -> float:
    """Return the factor by which a picture (height, width) is as bright as another, by least squares."""
    square = float((own * own).sum())
    return float((own * wanted).sum()) / square if square > 0.0 else 1.0


def level_between(own: Array, wanted: Array) -> tuple[float, float]:
    """Return the factor from one picture to another, and how they differ.

    Parameters
    ----------
    own, wanted : ndarray of shape (height, width)
        W/m^2/sr.

    Returns
    -------
    level : float
        Factor; 1 where it is within 1 % of that, or the pictures do not differ in level alone.
    mismatch : float
        Relative root mean square by which they differ in shape, if by more than 2 %.
    """
    if own.shape != wanted.shape or not (own.any() and wanted.any()):
        return 1.0, 0.0
    factor = factor_between(own, wanted)
    error = float(np.sqrt(((factor * own - wanted) ** 2).mean() / (wanted**2).mean()))
    if error >= _SAME_SHAPE:
        return 1.0, error
    return factor if abs(factor - 1.0) > _SAME_LEVEL else 1.0, 0.0


def _grey(picture: Picture | Array) -> Array:
    grey: Array = np.asarray(picture, dtype=np.float64).mean(axis=2)
    return grey
