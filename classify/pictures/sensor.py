"""Model of a real camera: it counts photons, the chip adds noise, and the converter rounds.

The terms are those of the linear model of the standard EMVA 1288 (release 4.0): photon shot noise, temporal dark
noise (read noise, shot noise of the dark current, noise of whole rows and columns), full well (saturation capacity),
system gain, quantisation, and the spread of the pixels' gain (PRNU) and offset (DSNU). Not in it are non-linearity,
and what the lens and the lamp add (blur, vignetting, flicker). The camera is monochrome: it sees the mean of a
picture's three channels. What is known of a camera is undone in what it reports: mean dark charge, non-linearity,
vignetting.
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
from scipy.ndimage import gaussian_filter

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
_PHOTON_METRE = 1.98644586e-25
"""Planck's constant times the speed of light, J m."""
_SAME_SHAPE = 0.02
"""Relative RMS difference, after scaling to one level, below which two pictures differ in the level alone."""
_SAME_LEVEL = 0.01
"""Relative difference below which two levels count as equal: lamps drift by as much."""
_STEEPEST = 0.45
"""Largest non-linearity; at a half the response ends flat."""
_NOT_NEGATIVE = (
    *("read_noise", "exposure", "gain_spread", "offset_spread", "gain", "black_level", "dark_current"),
    *("exposure_time", "row_noise", "column_noise", "blur", "flicker"),
    *("quantum_efficiency", "pixel_size", "f_number"),
)


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
        Bits of the converter; 0 does not round.
    exposure : float
        Electrons in a frame per W/m^2/sr; 0 lets it follow from ``quantum_efficiency`` and what is named there, or
        puts the brightest pixel of the scene at ``fill``.
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
    gain : float
        Overall system gain K, grey levels per electron; 0 lets the converter's range be the full well.
    black_level : float
        Mean grey level without light and without dark charge; 0 is eight standard deviations of the dark noise.
    dark_current : float
        Electrons that a pixel collects in a second without light. Their mean is subtracted from what is reported, as
        with a dark frame of the same exposure time; their shot noise stays.
    exposure_time : float
        Seconds in which a frame collects light and dark charge.
    nonlinearity : float
        Share of the charge that is missing in the response at full well; in between it grows with the charge.
    row_noise, column_noise : float
        Standard deviation of an offset that all pixels of a row, or of a column, share in a frame, electrons.
    vignetting : float
        Share of the light that is missing in the corners; in between it grows with the square of the distance from
        the middle.
    blur : float
        Standard deviation of the point spread function, a Gaussian, pixels.
    flicker : float
        Relative standard deviation of the light from frame to frame.
    quantum_efficiency : float
        Electrons per photon; with ``exposure_time``, ``pixel_size`` and ``f_number`` the exposure follows from it.
    pixel_size : float
        Side of a square pixel, metres.
    f_number : float
        Focal length over the diameter of the entrance pupil, of a lens that is focused far away.
    wavelength : float
        Of the light, metres.
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
    gain: float = 0.0
    black_level: float = 0.0
    dark_current: float = 0.0
    exposure_time: float = 0.0
    nonlinearity: float = 0.0
    row_noise: float = 0.0
    column_noise: float = 0.0
    vignetting: float = 0.0
    blur: float = 0.0
    flicker: float = 0.0
    quantum_efficiency: float = 0.0
    pixel_size: float = 0.0
    f_number: float = 0.0
    wavelength: float = 550e-9

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value):
                raise NlosError(f"sensor.{name}: {value} is not a finite number")
        for name in _NOT_NEGATIVE:
            if getattr(self, name) < 0.0:
                raise NlosError(f"sensor.{name}: {getattr(self, name):g} must not be negative")
        for name in ("full_well", "fill", "wavelength"):
            if getattr(self, name) <= 0.0:
                raise NlosError(f"sensor.{name}: {getattr(self, name):g} must be positive")
        for name in ("frames", "background_frames"):
            if getattr(self, name) < 1:
                raise NlosError(f"sensor.{name}: {getattr(self, name)} must be 1 or more")
        if not 0 <= self.bits <= 32:
            raise NlosError(f"sensor.bits: {self.bits} must be from 1 to 32, or 0 not to round")
        if self.drift <= -1.0:
            raise NlosError(f"sensor.drift: {self.drift:g} must be above -1, which is no light at all")
        if self.quantum_efficiency > 1.0:
            raise NlosError(f"sensor.quantum_efficiency: {self.quantum_efficiency:g} must be at most 1")
        if not 0.0 <= self.vignetting < 1.0:
            raise NlosError(
                f"sensor.vignetting: {self.vignetting:g} must be from 0 to below 1, which is no light at all"
            )
        if not -_STEEPEST < self.nonlinearity < _STEEPEST:
            raise NlosError(
                f"sensor.nonlinearity: {self.nonlinearity:g} must lie between -{_STEEPEST} and {_STEEPEST}; beyond "
                "that more light would give no more signal"
            )
        if self._dark_charge >= self.full_well:
            raise NlosError(
                f"sensor.dark_current: {self.dark_current:g} electrons a second fill the well of {self.full_well:g} "
                f"in an exposure time of {self.exposure_time:g} s"
            )
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
        if collected := self._collected():
            return replace(self, exposure=collected)
        brightest = max((float(self._seen(p).max()) for p in pictures), default=0.0)
        if not (brightest > 0.0 and math.isfinite(self.fill * self._capacity / brightest)):
            raise NlosError(
                "sensor.exposure: cannot follow from pictures without light; give it in electrons per W/m^2/sr"
            )
        return replace(self, exposure=self.fill * self._capacity / brightest)

    def electrons(self, picture: Picture | Array) -> Array:
        """Return the electrons expected in a frame, (height, width), for radiance (height, width, 3), W/m^2/sr."""
        if not self.exposure:
            raise NlosError("sensor.exposure: is not chosen yet")
        expected: Array = np.maximum(self._seen(picture), 0.0) * self.exposure
        return expected

    def saturated(self, picture: Picture) -> float:
        """Return the share of pixels that overflow."""
        return float((self.electrons(picture) + self._dark_charge > self._capacity).mean())

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
        fixed = self._pattern(expected.shape, pattern)
        count, total = frames or self.frames, np.zeros(expected.shape)
        for _ in range(count):
            total += self._read_out(expected, fixed, rng)
        radiance = self._corrected(total / count) / self.exposure
        return np.repeat(radiance[..., None], 3, axis=2).astype(np.float32)

    def frame(self, picture: Picture | Array, rng: np.random.Generator, *, pattern: int = 0) -> Array:
        """Return the grey levels of one frame, (height, width): whole numbers where there is a converter.

        Where neither ``bits`` nor ``gain`` is given, a grey level is an electron.

        Parameters
        ----------
        picture : ndarray of shape (height, width, 3)
            Scene-linear radiance, W/m^2/sr.
        rng : Generator
            Generator of the temporal noise.
        pattern : int
            Seed of the fixed pattern.
        """
        expected = self.electrons(picture)
        levels: Array = (
            self._read_out(expected, self._pattern(expected.shape, pattern), rng) / self._unit + self._black
        )
        return np.rint(levels) if self.bits else levels

    def radiance(self, levels: Array) -> Array:
        """Return the radiance, (height, width), W/m^2/sr, that grey levels of a frame, or their mean, stand for.

        The black level, the mean dark charge, the non-linearity and the vignetting are undone.

        Raises
        ------
        NlosError
            If no exposure is chosen yet.
        """
        if not self.exposure:
            raise NlosError("sensor.exposure: is not chosen yet")
        electrons = (np.asarray(levels, dtype=np.float64) - self._black) * self._unit
        light: Array = self._corrected(electrons) / self.exposure
        return light

    def variance(self, picture: Picture | Array, *, frames: int = 0) -> Array:
        """Return the variance of what `measure` reports, (height, width), (W/m^2/sr)^2, where no well overflows.

        It is the sum for photons, dark charge, readout and rounding (EMVA 1288, the linear model's temporal noise,
        divided by the squared gain), and for flicker; where the response is not linear, noise that is added to it
        counts by its slope. The fixed pattern is left out, since picture and background share it.
        """
        rounding = self._step**2 / 12.0
        light = self.electrons(picture)
        slope = (1.0 - 2.0 * self.nonlinearity * (light + self._dark_charge) / self.full_well) ** 2
        electrons = light + self._dark_charge + self.read_noise**2 / slope + rounding / slope
        electrons = electrons + (self.row_noise**2 + self.column_noise**2) / slope + (self.flicker * light) ** 2
        variance: Array = electrons / (frames or self.frames) / (self.exposure * self._falloff(light.shape)) ** 2
        return variance

    def stabilised(self, picture: Picture | Array) -> Array:
        """Return measured light on a scale where its noise has variance 1 at any brightness, (height, width).

        The generalised Anscombe transform 2 sqrt(n + 3/8 + s^2) of n electrons with read noise s, in all frames
        together (Anscombe 1948, equation 2.1; Murtagh, Starck and Bijaoui 1995, equation 4). Noise that pixels share
        (rows, columns, flicker) is left out: no scale of single pixels makes it white, see `shared`. So is the slope
        of a response that is not linear: it matters to the readout alone, where that is small against photons.
        """
        electrons = self._held(_grey(picture))  # measured darkness can be below zero
        transformed: Array = 2.0 * np.sqrt(np.maximum(electrons + 0.375 + self._dark, 0.0))
        return transformed

    def stabilised_mean(self, picture: Picture | Array, *, measured: bool = False) -> Array:
        """Return the mean of `stabilised` over measurements of a known radiance, (height, width).

        As the root is concave, this is less than the root of the mean, by half its curvature times the variance.

        Parameters
        ----------
        picture : ndarray of shape (height, width, 3)
            Radiance, W/m^2/sr.
        measured : bool
            Whether it is the mean of so many frames that it counts as known: then it is blurred already.
        """
        electrons = np.maximum(self._held(_grey(picture) if measured else self.blurred(_grey(picture))), 0.0)
        argument = electrons + 0.375 + self._dark
        mean: Array = 2.0 * np.sqrt(argument) - (electrons + self._dark) / (4.0 * argument**1.5)
        return mean

    def shared(self, picture: Picture | Array) -> Array:
        """Return noise that pixels share: patterns (n, height, width) of one standard deviation in a frame, W/m^2/sr.

        First flicker, then each row, then each column; those without noise are left out.

        Parameters
        ----------
        picture : ndarray of shape (height, width, 3)
            Scene-linear radiance, W/m^2/sr.
        """
        light = self.blurred(_grey(picture))
        height, width = light.shape
        own = self.exposure * self._falloff(light.shape)
        patterns = [self.flicker * light[None]] if self.flicker else []
        if self.row_noise:
            rows = np.eye(height)[:, :, None] * self.row_noise
            patterns.append(np.broadcast_to(rows, (height, height, width)) / own)
        if self.column_noise:
            columns = np.eye(width)[:, None, :] * self.column_noise
            patterns.append(np.broadcast_to(columns, (width, height, width)) / own)
        return np.concatenate(patterns) if patterns else np.zeros((0, height, width))

    def shared_count(self, shape: tuple[int, ...]) -> int:
        """Return the number of patterns of `shared`, for pictures of a shape (height, width)."""
        height, width = shape
        return bool(self.flicker) + height * bool(self.row_noise) + width * bool(self.column_noise)

    def stabilised_slope(self, picture: Picture | Array) -> Array:
        """Return the derivative of `stabilised_mean`, (height, width), by the radiance behind the lens."""
        mean = self.stabilised_mean(picture)
        slope: Array = 2.0 * self.frames * self.exposure * self._falloff(mean.shape) / mean
        return slope

    def blurred(self, radiance: Array) -> Array:
        """Return radiance (..., height, width) behind the lens."""
        if not self.blur:
            return radiance
        spread = (0.0,) * (radiance.ndim - 2) + (self.blur, self.blur)
        blurred: Array = gaussian_filter(radiance, spread, mode="nearest")
        return blurred

    def _collected(self) -> float:
        """Electrons in a frame per W/m^2/sr that follow from the optics; 0 where these are not given.

        A disc as wide as the entrance pupil, at the focal length, gives an irradiance of pi L / (4 N^2 + 1), as in
        EMVA 1288; photons have an energy of h c / lambda each.
        """
        light = math.pi / (4.0 * self.f_number**2 + 1.0) if self.f_number else 0.0
        joules = light * self.pixel_size**2 * self.exposure_time
        return self.quantum_efficiency * joules * self.wavelength / _PHOTON_METRE

    def _falloff(self, shape: tuple[int, ...]) -> Any:
        """Share of the light that reaches each pixel: 1 in the middle."""
        if not self.vignetting:
            return 1.0
        height, width = shape
        y, x = np.ogrid[:height, :width]
        squared = (x - (width - 1) / 2.0) ** 2 + (y - (height - 1) / 2.0) ** 2
        return 1.0 - self.vignetting * squared / (((width - 1) ** 2 + (height - 1) ** 2) / 4.0 or 1.0)

    def _seen(self, picture: Picture | Array) -> Array:
        """Radiance, (height, width), after the lens; by rendering noise it can be negative."""
        light = self.blurred(_grey(picture))
        seen: Array = light * self._falloff(light.shape)
        return seen

    def _held(self, grey: Array) -> Array:
        """Electrons in all frames together, limited to the full well, of radiance behind the lens."""
        collected = self.exposure * self._falloff(grey.shape) * grey
        electrons: Array = float(self.frames) * np.minimum(collected, self._capacity - self._dark_charge)
        return electrons

    @property
    def _capacity(self) -> float:
        """Electrons above which more light gives no more signal: of the well, or of the converter's range."""
        range_ = (self._white - self._black) / self.gain if self.bits and self.gain else math.inf
        return min(self.full_well, range_)

    @property
    def _dark_charge(self) -> float:
        """Mean charge without light in a frame, electrons."""
        return self.dark_current * self.exposure_time

    @property
    def _dark(self) -> float:
        """Variance of dark charge, readout and rounding in all frames together, squared electrons."""
        return self.frames * (self.read_noise**2 + self._step**2 / 12.0 + self._dark_charge)

    @property
    def _white(self) -> float:
        """Highest grey level."""
        return float(2**self.bits - 1)

    @property
    def electrons_per_level(self) -> float:
        """Electrons per grey level (1 / K of EMVA 1288); 0 where nothing is rounded."""
        return self._step

    @property
    def _step(self) -> float:
        """Electrons per grey level; 0 where nothing is rounded."""
        if not self.bits:
            return 0.0
        return 1.0 / self.gain if self.gain else self.full_well / (self._white - self._black)

    @property
    def _unit(self) -> float:
        """Electrons per grey level, also where nothing is rounded."""
        return self._step or (1.0 / self.gain if self.gain else 1.0)

    @property
    def _black(self) -> float:
        """Grey level without light."""
        if self.black_level:
            return self.black_level
        noise = math.hypot(self.read_noise, self.offset_spread, self.row_noise, self.column_noise)
        if self.gain:
            return float(math.ceil(_BLACK * noise * self.gain))
        return float(math.ceil(_BLACK * noise * self._white / (self.full_well + _BLACK * noise)))

    def _read_out(self, expected: Array, fixed: tuple[Any, Any], rng: np.random.Generator) -> Array:
        """Electrons that the converter reports of a frame, (height, width), for expected ones and a fixed pattern."""
        gain, offset = fixed
        if self.flicker:
            expected = expected * max(0.0, 1.0 + self.flicker * rng.normal())
        mean = np.minimum(expected * gain + self._dark_charge, _BRIGHTER * self.full_well + 100.0)
        electrons = np.minimum(rng.poisson(mean), self.full_well)
        if self.nonlinearity:
            electrons = electrons * (1.0 - self.nonlinearity * electrons / self.full_well)
        read = electrons + offset + rng.normal(scale=self.read_noise, size=electrons.shape)
        if self.row_noise:
            read = read + rng.normal(scale=self.row_noise, size=(len(read), 1))
        if self.column_noise:
            read = read + rng.normal(scale=self.column_noise, size=(1, read.shape[1]))
        return self._convert(read)

    def _corrected(self, electrons: Array) -> Array:
        """Light in electrons of a pixel in the middle, from converted electrons: what is known is undone."""
        if self.nonlinearity:
            # n - a n^2 / w is reported of n electrons; below zero, where noise leads, the line is as good.
            share = 4.0 * self.nonlinearity / self.full_well * np.maximum(electrons, 0.0)
            root = np.sqrt(np.maximum(1.0 - share, (1.0 - 2.0 * abs(self.nonlinearity)) ** 2 / 4.0))
            electrons = electrons * 2.0 / (1.0 + root)
        corrected: Array = (electrons - self._dark_charge) / self._falloff(electrons.shape)
        return corrected

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


def factor_between(own: Array, wanted: Array, dark: float = 1.0) -> float:
    """Return the factor by which a picture is as bright as another, by least squares; ``dark`` if it has no light."""
    square = float((own * own).sum())
    return float((own * wanted).sum()) / square if square > 0.0 else dark


def nearest(own: Array, wanted: Array) -> tuple[float, float]:
    """Return the factor that brings a picture nearest to another, 0 of one without light, and what is left.

    Parameters
    ----------
    own, wanted : ndarray of the same shape
        W/m^2/sr.

    Returns
    -------
    factor : float
    mismatch : float
        Relative root mean square by which they differ in shape.
    """
    factor = factor_between(own, wanted, dark=0.0)
    return factor, float(np.sqrt(((factor * own - wanted) ** 2).mean() / (wanted**2).mean()))


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
    factor, error = nearest(own, wanted)
    if error >= _SAME_SHAPE:
        return 1.0, error
    return factor if abs(factor - 1.0) > _SAME_LEVEL else 1.0, 0.0


def _grey(picture: Picture | Array) -> Array:
    grey: Array = np.asarray(picture, dtype=np.float64).mean(axis=2)
    return grey
