"""A camera's figures from bursts of frames, by the photon transfer method of the standard EMVA 1288, release 4.0.

Each is what a field of `Sensor` is, with a 95 % interval for the kind of sensor of which the pixels are a sample. It
differs from the standard where that asks for a laboratory:

- Light need not be even: variance and mean are compared over the same pixels, and the spread of the gain (PRNU) is
  taken from second differences between neighbours, which smooth light leaves out. It must have no edges.
- Light may change from frame to frame: each frame is scaled to the burst's mean, and deviations that the pixels of a
  row or a column share are set apart from those of single pixels, by an analysis of variance, before the variance is
  taken. The standard subtracts the square of the difference of two frames' means.
- The full well is where the signal stops, not where its variance is highest, which depends on how close levels are.
- The gain is that of a dark sensor: where the response bends, its slope enters the variance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from classify.intervals import Interval
from classify.pictures.burst import Burst
from classify.pictures.burst_levels import Level, level
from classify.pictures.sensor import Sensor
from generator.model.arrays import Array
from generator.model.errors import NlosError

QUANTISED = 0.24
"""Variance of the dark noise below which rounding hides it, squared grey levels (EMVA 1288)."""
LIMIT = 0.40
"""Upper limit of the dark noise then, grey levels (EMVA 1288)."""
_ROUNDING = 1.0 / 12.0
_PHOTON_METRE = 1.98644586e-25
_FEWEST_PIXELS, _FEWEST_LEVELS, _TILES = 32, 3, 8
_UNDERFLOW = 0.005
"""Share of values at zero that the standard allows."""
_CLIPPED = 0.001
_TRANSFER, _LINEAR = 0.7, (0.05, 0.95)
"""Shares of saturation up to which the gain, and within which the linearity, is taken (EMVA 1288)."""
_FLICKER = 5e-4
"""Relative change of the light from frame to frame that is told: less costs no answer anything."""
_DROP, _FLAT = 0.85, 0.1
_CORRELATED, _MOSAIC, _CURVED, _ROUGH = 0.05, 0.02, 0.35, 1.5
_SECOND_1D, _SECOND_2D = 35.0 / 18.0, (35.0 / 18.0) ** 2
"""Sum of the squared autocorrelations of second differences of white noise, along one axis and along both."""
_Z = 1.959964


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A camera's figures.

    Attributes
    ----------
    sensor : Sensor
    intervals : dict of str to Interval
        Of fields of the sensor, and of further figures: ``temporal_dark_noise`` (electrons, with rows and columns),
        ``linearity_error`` (EMVA 1288, relative), ``dsnu_pixel``, ``dsnu_row``, ``dsnu_column`` (electrons),
        ``prnu_pixel``, ``prnu_row``, ``prnu_column`` (relative).
    doubts : list of str
        What speaks against them, in sentences.
    dark, light : list of Level
    used, linear : list of bool
        Whether the gain, and the linearity, are taken from each of ``light``.
    offset : float
        Mean grey level without light and dark charge.
    line : (float, float)
        Variance without signal, squared grey levels, and gain.
    signal : ndarray of shape (n,)
        Mean signal of each of ``light``, grey levels.
    exposure : ndarray of shape (n,)
        Of each of ``light``: its time, s, or irradiance times time, J/m^2; NaN if not known.
    """

    sensor: Sensor
    intervals: dict[str, Interval]
    doubts: list[str]
    dark: list[Level]
    light: list[Level]
    used: list[bool]
    linear: list[bool]
    offset: float
    line: tuple[float, float]
    signal: Array
    exposure: Array


def squares(terms: Sequence[tuple[float, float, float]]) -> Interval:
    """Return a sum of mean squares with its 95 % interval (modified large sample: Graybill and Wang 1980).

    Parameters
    ----------
    terms : sequence of (float, float, float)
        Factor, mean square, and its degrees of freedom.
    """
    value, below, above = 0.0, 0.0, 0.0
    for factor, square, freedom in terms:
        one = factor * square
        ends = (one * freedom / float(stats.chi2.ppf(quantile, freedom)) - one for quantile in (0.975, 0.025))
        low, high = sorted(ends)
        value, below, above = value + one, below + low**2, above + high**2
    return Interval(value, value - math.sqrt(below), value + math.sqrt(above))


def _root(square: Interval, scale: float, error: float) -> Interval:
    """Root of a square, 0 or more, times a scale with a relative standard error."""
    value, low, high = (math.sqrt(max(0.0, one)) * scale for one in (square.value, square.low, square.high))
    wide = _Z * error * value
    return Interval(value, max(0.0, value - math.hypot(value - low, wide)), value + math.hypot(high - value, wide))


def _scaled(value: float, error: float, relative: float) -> Interval:
    """A value with a standard error, and a further relative one."""
    half = _Z * math.hypot(error, relative * value)
    return Interval(value, value - half, value + half)


def measure(
    light: Sequence[Burst],
    dark: Sequence[Burst],
    *,
    bits: int = 0,
    pixel_size: float = 0.0,
    wavelength: float = 550e-9,
) -> Measured:
    """Return a camera's figures.

    Parameters
    ----------
    light : sequence of Burst
        Of one steady scene without edges, at three or more levels up to saturation.
    dark : sequence of Burst
        With the lens covered, at one or more exposure times.
    bits : int
        Of the converter; 0 takes those that the values need.
    pixel_size : float
        Side of a pixel, metres; with irradiances and times, the quantum efficiency follows.
    wavelength : float
        Of the light, metres.

    Raises
    ------
    NlosError
        If there are too few frames, levels or pixels, blacks are clipped, or the values are not a linear converter's:
        by a gamma, compression, or interpolated colours.
    """
    _check(light, dark)
    unit, whole = _unit([*light, *dark])
    top = max(float(burst.frames.max()) for burst in [*light, *dark]) / unit
    darkness = _Darkness([level(burst, math.nan, unit=unit, top=top) for burst in dark], whole)
    levels = [level(burst, darkness.at(burst.time), unit=unit, top=top) for burst in light]
    levels.sort(key=lambda one: float(one.mean.mean()) - darkness.at(one.time))
    return _Transfer(darkness, levels, top, whole).measured(bits, pixel_size, wavelength)


def _check(light: Sequence[Burst], dark: Sequence[Burst]) -> None:
    if not dark:
        raise NlosError("--dark: name one or more bursts with the lens covered; without them no offset is known")
    if len(light) < _FEWEST_LEVELS:
        raise NlosError(
            f"{len(light)} levels of light are too few; take {_FEWEST_LEVELS} or more, of different exposure times"
        )
    shape = light[0].frames.shape[1:]
    for burst in [*light, *dark]:
        if len(burst.frames) < 2:
            raise NlosError(f"{burst.name}: holds one frame; temporal noise shows in two or more of one scene")
        if burst.frames.shape[1:] != shape:
            raise NlosError(f"{burst.name}: has frames of another size than {light[0].name}")
        if (burst.frames == burst.frames[0]).all() and burst in dark:
            raise NlosError(
                f"{burst.name}: all its frames are the same, so rounding or the camera itself removes the dark noise"
            )
    if min(shape) < _FEWEST_PIXELS:
        raise NlosError(f"{light[0].name}: {shape[1]} x {shape[0]} pixels are too few; take {_FEWEST_PIXELS} or more")


def _unit(bursts: Sequence[Burst]) -> tuple[float, bool]:
    """Step between the values that occur, and whether these are whole numbers of it."""
    frames = [burst.frames[0] for burst in bursts]
    if any((frame != np.rint(frame)).any() for frame in frames):
        return 1.0, False
    return float(max(1, math.gcd(*(int(np.gcd.reduce(frame.astype(np.int64), axis=None)) for frame in frames)))), True


class _Darkness:
    """Mean grey level without light, by exposure time."""

    def __init__(self, levels: list[Level], whole: bool) -> None:
        self.levels = sorted(levels, key=lambda one: one.time)
        for one in levels:
            if whole and one.zero > _UNDERFLOW:
                raise NlosError(
                    f"{one.name}: {one.zero:.1%} of its values are zero, so darkness is clipped, and its noise and "
                    "offset cannot be told; raise the camera's black level (offset, brightness)"
                )
        self.free = sum(one.frames - 1 for one in levels)
        excess = sum((one.frames - 1) * (float(one.means.var(ddof=1)) - one.noise) for one in levels) / self.free
        self.excess = max(0.0, excess)
        """Variance of the whole frame's level, more than its pixels explain."""
        self.rate, self.rate_error, self.straight = 0.0, math.nan, True
        self.offset = float(self.levels[0].mean.mean())
        self._line()

    def _line(self) -> None:
        known = [one for one in self.levels if math.isfinite(one.time)]
        times = np.array([one.time for one in known])
        if len(np.unique(times)) < 2:
            return
        means = np.array([one.mean.mean() for one in known])
        weights = 1.0 / np.array([(one.noise + self.excess) / one.frames for one in known])
        value, covariance = _fit(np.stack([np.ones_like(times), times], axis=1), means, weights)
        self.offset, self.rate = float(value[0]), float(value[1])
        free = len(times) - 2
        misfit = float((weights * (means - self.offset - self.rate * times) ** 2).sum())
        self.straight = free == 0 or float(stats.chi2.sf(misfit, free)) > 1e-3
        wide = 1.0 if self.straight else math.sqrt(misfit / free)
        self.rate_error = math.sqrt(covariance[1, 1]) * wide * float(stats.t.ppf(0.975, self.free)) / _Z

    def at(self, time: float) -> float:
        """Return the mean grey level at an exposure time."""
        same = [one for one in self.levels if math.isclose(one.time, time, rel_tol=1e-6)]
        if same:
            return float(np.mean([one.mean.mean() for one in same]))
        return self.offset + (self.rate * time if math.isfinite(time) else 0.0)

    def near(self, time: float) -> Level:
        """Return the burst whose exposure time is nearest, or the first if it is not known."""
        return min(self.levels, key=lambda one: abs(one.time - time) if math.isfinite(one.time - time) else 0.0)

    def pattern(self, time: float) -> Array:
        """Return the mean grey level of each pixel at an exposure time."""
        near = self.near(time)
        pattern: Array = near.mean + (self.at(time) - float(near.mean.mean()))
        return pattern


def _fit(design: Array, values: Array, weights: Array) -> tuple[Array, Array]:
    """Weighted least squares: the solution, and its covariance if the weights are inverse variances."""
    scale = np.abs(design).max(axis=0)
    scaled = design / scale
    covariance = np.linalg.inv(scaled.T @ (weights[:, None] * scaled))
    solution = covariance @ (scaled.T @ (weights * values))
    return solution / scale, covariance / np.outer(scale, scale)


def _straightened(signal: Any, bend: float) -> Any:
    """Linear signal of a measured one, s - bend s^2."""
    return 2.0 * signal / (1.0 + np.sqrt(np.maximum(1.0 - 4.0 * bend * signal, 0.0)))


def _tiles(values: Array) -> Array:
    """Sums over tiles of a picture, (tiles,)."""
    height, width = values.shape
    starts = [np.arange(_TILES) * size // _TILES for size in (height, width)]
    return np.add.reduceat(np.add.reduceat(values, starts[0], axis=0), starts[1], axis=1).ravel()


def _rough(differences: Array) -> bool:
    """Whether few values are far larger than most, as differences across edges are."""
    return math.sqrt(float((differences**2).mean())) > _ROUGH * 1.4826 * float(np.median(np.abs(differences)))


def _flat(one: Level, signal: float) -> bool:
    """Whether all pixels have the same level, as if they are saturated."""
    low, high = np.quantile(one.mean, (0.01, 0.99))
    return bool(high - low < _FLAT * signal)


class _Transfer:
    """Photon transfer of bursts of light, from dim to bright."""

    def __init__(self, darkness: _Darkness, light: list[Level], top: float, whole: bool) -> None:
        self.darkness, self.light, self.top, self.whole = darkness, light, top, whole
        self.doubts: list[str] = []
        self.signal = np.array([float(one.mean.mean()) - darkness.at(one.time) for one in light])
        if self.signal[-1] <= 0.0:
            raise NlosError(
                "the bursts are no brighter than the dark ones; name those with the lens covered by --dark"
            )
        self._classify()
        self._refuse_processed()
        self.flicker = self._flicker()
        self.exposure = self._exposures()
        self.bend, self.bend_error, self.response = self._bend()
        self.zero, self.gain, self.replicates = self._line(self.bend)
        self._refuse_curved()
        # What the line is where the bend is one standard error less, and more.
        self.moved = [np.array(self._line(self.bend + sign * self.bend_error)[:2]) for sign in (-1.0, 1.0)]
        self.gain_error = self._error(lambda line: line[..., 1])

    def _error(self, figure: Callable[[Array], Array]) -> float:
        """Standard error of a figure of the line, (..., 2), by the jackknife over tiles, and by the bend's."""
        found = figure(self.replicates)
        count = len(found)
        spread = math.sqrt((count - 1) / count * float(((found - found.mean()) ** 2).sum()))
        bent = abs(float(figure(self.moved[1]) - figure(self.moved[0]))) / 2.0
        return math.hypot(spread * float(stats.t.ppf(0.975, count - 1)) / _Z, bent)

    def _classify(self) -> None:
        """Find the levels that saturate, and those that the gain and the linearity are taken from."""
        variance = np.array([one.pixel for one in self.light])
        dark = self.darkness.levels[0].pixel
        low = self.signal <= _TRANSFER * self.signal[-1]
        low[:2] = True
        slope = float(((variance - dark) * self.signal)[low].sum() / (self.signal**2)[low].sum())
        share = variance / np.maximum(dark + slope * self.signal, 1e-12)
        high = self.signal >= 0.9 * self.signal[-1]
        clipped = np.array([one.top for one in self.light]) > _CLIPPED
        partly = np.array([self._partly(one, dark, slope) for one in self.light])
        self.clipped = clipped | partly | ((share < _DROP) & (self.signal > 0.5 * self.signal[-1]))
        full = (share < 0.5) & high & np.array([_flat(one, float(self.signal[-1])) for one in self.light])
        means = np.array([float(one.mean.mean()) for one in self.light])
        highest = float(means[full].max()) if full.any() else self.top
        self.reached, self.saturation = bool(full.any() or clipped.any()), highest - self.darkness.offset
        most = self.saturation if self.reached else float(self.signal[~self.clipped].max(initial=0.0))
        bright = variance >= QUANTISED if self.whole else np.ones(len(variance), dtype=bool)
        self.used = ~self.clipped & bright & (self.signal > 0.0)
        self.linear = ~self.clipped & (self.signal >= _LINEAR[0] * most)
        if self.reached:
            self.used &= self.signal <= _TRANSFER * most
            self.linear &= self.signal <= _LINEAR[1] * most
        if self.used.sum() < _FEWEST_LEVELS:
            raise NlosError(
                f"{self.used.sum()} levels of light lie above the noise of rounding and below "
                f"{_TRANSFER:.0%} of saturation; the photon transfer takes {_FEWEST_LEVELS} or more"
            )

    def _partly(self, one: Level, dark: float, slope: float) -> bool:
        """Whether the brightest tiles of a burst vary less than their signal has it: some pixels are saturated."""
        counts = _tiles(np.ones(one.mean.shape))
        signal = _tiles(one.mean - self.darkness.pattern(one.time)) / counts
        share = _tiles(one.variance) / counts / np.maximum(dark + slope * signal, 1e-12)
        chance = 5.0 * math.sqrt(2.0 / ((one.frames - 1) * float(counts.min())))
        return bool((share[signal > 0.5 * self.signal[-1]] < min(_DROP, 1.0 - chance)).any())

    def _charge(self, one: Level) -> float:
        """Mean dark charge of a burst, grey levels."""
        return self.darkness.rate * one.time if math.isfinite(one.time) else 0.0

    def _refuse_processed(self) -> None:
        """Raise NlosError if the values are of a colour mosaic, or each was computed from several."""
        one = self.light[int(np.flatnonzero(self.used)[-1])]
        signal = one.mean - self.darkness.pattern(one.time)
        phases = [float(signal[y::2, x::2].mean()) for y in (0, 1) for x in (0, 1)]
        uneven = (max(phases) - min(phases)) / max(float(np.mean(phases)), 1e-12)
        if uneven > _MOSAIC:
            raise NlosError(
                f"{one.name}: every second pixel differs by {uneven:.0%}, as with a mosaic of colour filters; take "
                "one pixel of each four (--mosaic)"
            )
        chance = 4.0 / math.sqrt(2.0 * one.mean.size * (one.frames - 1))
        if abs(one.alike) > _CORRELATED + chance:
            raise NlosError(
                f"{one.name}: the noise of neighbouring pixels is correlated ({one.alike:+.2f}), so the values were "
                "compressed, resized, smoothed or interpolated; take raw frames"
            )

    def _refuse_curved(self) -> None:
        """Raise NlosError if variance does not grow in line with the mean."""
        design, variance, weights = self._points(self.bend)
        try:
            value, covariance = _fit(
                np.stack([design[:, 0], design[:, 1], design[:, 1] ** 2], axis=1), variance, weights
            )
        except np.linalg.LinAlgError:
            raise NlosError("the levels of light are too much alike; take them at 10 to 70 % of saturation") from None
        most = float(design[:, 1].max())
        curved = float(value[2]) * most / self.gain
        error = math.sqrt(covariance[2, 2]) * most / abs(self.gain)
        if self.gain <= 0.0 or abs(curved) > _CURVED + 4.0 * error:
            raise NlosError(
                "the variance of the noise does not grow in line with the signal, as photons' does: the pictures "
                "have a gamma or were compressed, or the scene changed; take raw or linear frames of a steady scene"
            )

    def _points(self, bend: float) -> tuple[Array, Array, Array]:
        """Design, variances and weights of the line of photon transfer."""
        sums, counts = self._sums(bend)
        charge, variance = sums.sum(axis=2) / counts.sum()
        design = np.stack([np.ones_like(charge), charge], axis=1)
        freedom = self._freedom
        first, _ = _fit(design, variance, freedom / variance**2)
        expected = np.maximum(design @ first, 0.5 * variance)
        return design, variance, freedom / expected**2 / 2.0

    def _sums(self, bend: float) -> tuple[Array, Array]:
        """Sums over tiles of charge as it enters the variance, and of variance, (2, levels, tiles); tiles' pixels."""
        shape = self.light[0].mean.shape
        dark = [one for one in self.darkness.levels if one.pixel >= QUANTISED or not self.whole]
        light = [one for one, used in zip(self.light, self.used, strict=True) if used]
        charges = [np.full(shape, self._charge(one)) for one in dark]
        for one in light:
            charges.append(one.mean - self.darkness.pattern(one.time) + self._charge(one))
        linear = [_straightened(charge, bend) for charge in charges]
        entering = [one * (1.0 - 2.0 * bend * one) ** 2 for one in linear]
        levels = [*dark, *light]
        self._freedom = np.array([(one.frames - 1.0) * one.mean.size for one in levels])
        sums = np.array([[_tiles(one) for one in entering], [_tiles(one.variance) for one in levels]])
        return sums, _tiles(np.ones(shape))

    def _line(self, bend: float) -> tuple[float, float, Array]:
        """Variance without signal, gain, and both with each tile left out, (tiles, 2)."""
        design, variance, weights = self._points(bend)
        value, _ = _fit(design, variance, weights)
        sums, counts = self._sums(bend)
        replicates = []
        for tile in range(len(counts)):
            charge, left = (sums.sum(axis=2) - sums[:, :, tile]) / (counts.sum() - counts[tile])
            replicates.append(_fit(np.stack([np.ones_like(charge), charge], axis=1), left, weights)[0])
        return float(value[0]), float(value[1]), np.array(replicates)

    def _flicker(self) -> Interval:
        """Squared relative deviation of the light from frame to frame."""
        free, found, noise = 0.0, 0.0, 0.0
        for one, signal, clipped in zip(self.light, self.signal, self.clipped, strict=True):
            if not clipped and signal > 0.2 * self.signal[~self.clipped].max():
                own = one.frames - 1.0
                free, found = free + own, found + own * float(one.means.var(ddof=1)) / signal**2
                noise += own * (one.noise + self.darkness.excess) / signal**2
        return squares([(1.0, found / free, free), (-1.0, noise / free, 1e9)])

    def _exposures(self) -> Array:
        times = np.array([one.time for one in self.light])
        irradiances = np.array([one.irradiance for one in self.light])
        self.radiometric = bool(np.isfinite(irradiances).all())
        return times * irradiances if self.radiometric else times

    def _errors(self) -> Array:
        """Standard errors of the mean signals, from what frames differ by."""
        errors = []
        for one, signal in zip(self.light, self.signal, strict=True):
            dark = self.darkness.near(one.time)
            own = (one.noise + self.darkness.excess + max(0.0, self.flicker.value) * signal**2) / one.frames
            errors.append(math.sqrt(own + (dark.noise + self.darkness.excess) / dark.frames))
        return np.array(errors)

    def _bend(self) -> tuple[float, float, Interval | None]:
        """What the signal lacks, over its square, with its standard error; and the response at no light."""
        rows = self.linear & np.isfinite(self.exposure)
        exposure, signal, error = self.exposure[rows], self.signal[rows], self._errors()[rows]
        if len(np.unique(exposure)) < _FEWEST_LEVELS or not np.isfinite(self.exposure).all():
            return 0.0, 0.0, None
        weights = 1.0 / error**2
        value, covariance = _fit(np.stack([exposure, exposure**2], axis=1), signal, weights)
        free = len(signal) - 2
        misfit = float((weights * (signal - value[0] * exposure - value[1] * exposure**2) ** 2).sum())
        wide = 1.0
        if free and float(stats.chi2.sf(misfit, free)) < 1e-3:
            wide = math.sqrt(misfit / free) * float(stats.t.ppf(0.975, free)) / _Z
        middle = self.light[int(np.flatnonzero(self.linear)[-1])]
        shape = middle.mean - self.darkness.pattern(middle.time)
        contrast = 1.0 + float(shape.var() / shape.mean() ** 2)
        slope = np.array([2.0 * value[1] / value[0] ** 3, -1.0 / value[0] ** 2]) / contrast
        bend = -float(value[1] / value[0] ** 2) / contrast
        return (
            bend,
            math.sqrt(float(slope @ covariance @ slope)) * wide,
            _scaled(float(value[0]), math.sqrt(covariance[0, 0]) * wide, 0.0),
        )

    def measured(self, bits: int, pixel_size: float, wavelength: float) -> Measured:
        """Return all figures."""
        found: dict[str, Interval] = {"gain": _scaled(self.gain, self.gain_error, 0.0)}
        relative = self.gain_error / self.gain
        found |= self._dark_noise(relative)
        if math.isfinite(self.darkness.rate_error):
            error = self.darkness.rate_error / self.gain
            found["dark_current"] = _scaled(self.darkness.rate / self.gain, error, relative)
        found["full_well"] = self._full_well(relative)
        found |= self._dark_pattern(relative)
        found |= self._light_pattern()
        flicker = self.flicker
        found["flicker"] = _root(flicker, 1.0, 0.0)
        if self.response is not None:
            full = found["full_well"].value * self.gain
            found["nonlinearity"] = _scaled(self.bend * full, self.bend_error * full, 0.0)
            found["linearity_error"] = self._linearity_error()
            if self.radiometric and pixel_size:
                photons = pixel_size**2 * wavelength / _PHOTON_METRE
                value, error = (
                    self.response.value / photons,
                    (self.response.high - self.response.value) / _Z / photons,
                )
                found["quantum_efficiency"] = _scaled(value / self.gain, error / self.gain, relative)
        self._doubt(found)
        return Measured(
            sensor=self._sensor(found, bits, pixel_size if "quantum_efficiency" in found else 0.0, wavelength),
            intervals=found,
            doubts=self.doubts,
            dark=self.darkness.levels,
            light=self.light,
            used=list(map(bool, self.used)),
            linear=list(map(bool, self.linear)),
            offset=self.darkness.offset,
            line=(self.zero, self.gain),
            signal=self.signal,
            exposure=self.exposure,
        )

    def _sensor(self, found: dict[str, Interval], bits: int, pixel_size: float, wavelength: float) -> Sensor:
        """Sensor of the figures; those that may be zero are."""
        own = {"nonlinearity", "row_noise", "column_noise", "dark_current", "flicker", "offset_spread", "gain_spread"}
        fields: dict[str, Any] = {
            name: one.value for name, one in found.items() if name in own and not one.low <= 0.0 <= one.high
        }
        if fields.get("flicker", 0.0) <= _FLICKER:
            fields.pop("flicker", None)
        if "quantum_efficiency" in found:
            fields |= {"quantum_efficiency": found["quantum_efficiency"].value}
            fields |= {"pixel_size": pixel_size, "wavelength": wavelength}
        needed = math.ceil(math.log2(self.top + 1.0))
        usual = next((one for one in (8, 10, 12, 14, 16) if one >= needed), needed)
        if bits and needed > bits:
            raise NlosError(f"--bits {bits}: the frames hold grey levels up to {self.top:.0f}, which need {needed}")
        return Sensor(
            full_well=found["full_well"].value,
            read_noise=found["read_noise"].value,
            bits=(bits or usual) if self.whole else 0,
            gain=self.gain,
            black_level=self.darkness.offset,
            **fields,
        )

    def _dark_noise(self, relative: float) -> dict[str, Interval]:
        """Temporal noise without light: of pixels, of rows and columns, and of all together, electrons."""
        shape = self.light[0].mean.shape
        terms: list[list[tuple[float, float, float]]] = []
        for axis, size in enumerate(shape):
            other = shape[1 - axis]
            free = self.darkness.free
            weights = [(one.frames - 1) / free for one in self.darkness.levels]
            own = sum(w * (one.row, one.column)[axis] for w, one in zip(weights, self.darkness.levels, strict=True))
            pixel = sum(w * one.pixel for w, one in zip(weights, self.darkness.levels, strict=True))
            parts = [
                (1.0 / other, own, free * (size - 1.0)),
                (-1.0 / other, pixel, free * (size - 1.0) * (other - 1.0)),
            ]
            terms.append(parts)
        row, column = squares(terms[0]), squares(terms[1])
        rounding = _ROUNDING if self.whole else 0.0
        least = min(one.pixel for one in self.darkness.levels) + max(0.0, row.value) + max(0.0, column.value)
        scale = 1.0 / self.gain
        noise = {"row_noise": _root(row, scale, relative), "column_noise": _root(column, scale, relative)}
        if self.whole and least < QUANTISED:
            self.doubts.append(
                f"the dark noise of {math.sqrt(least):.2f} grey levels is hidden by rounding (EMVA 1288: a variance "
                f"below {QUANTISED}), so read_noise is its upper limit; more gain or bits would show it"
            )
            limit = Interval(LIMIT * scale, 0.0, LIMIT * scale * (1.0 + _Z * relative))
            return noise | {"read_noise": limit, "temporal_dark_noise": limit}
        variance = self.zero - rounding
        error = self._error(lambda line: (line[..., 0] - rounding) / line[..., 1] ** 2)
        pixel_noise = _scaled(variance * scale**2, error, 0.0)
        each = [pixel_noise, *(Interval(*(v * scale**2 for v in (i.value, i.low, i.high))) for i in (row, column))]
        total = sum(one.value for one in each)
        below = math.sqrt(sum((one.value - one.low) ** 2 for one in each))
        above = math.sqrt(sum((one.high - one.value) ** 2 for one in each))
        return noise | {
            "read_noise": _root(pixel_noise, 1.0, 0.0),
            "temporal_dark_noise": _root(Interval(total, total - below, total + above), 1.0, 0.0),
        }

    def _full_well(self, relative: float) -> Interval:
        """Charge at which the signal stops, electrons; at least the largest that was seen if it was not reached."""
        measured = self.saturation if self.reached else float(self.signal.max())
        linear = _straightened(measured, self.bend)
        bent = abs(_straightened(measured, self.bend + self.bend_error) - linear) / linear
        found = _scaled(linear / self.gain, 0.0, math.hypot(relative, bent))
        if self.reached:
            return found
        self.doubts.append(
            "no burst is saturated, so the full well is at least what is stated; add a burst in which every pixel is"
        )
        return Interval(found.value, found.low, math.inf)

    def _dark_pattern(self, relative: float) -> dict[str, Interval]:
        """Spread of the pixels' offset, and of it what pixels, rows and columns have, electrons."""
        times = np.array([one.time for one in self.light])
        one = self.darkness.near(float(np.median(times)))
        height, width = one.mean.shape
        n, free = one.frames, one.frames - 1.0
        mean = one.mean - one.mean.mean()
        row, column = mean.mean(axis=1), mean.mean(axis=0)
        rest = mean - row[:, None] - column
        rows, columns = width * float((row**2).sum()) / (height - 1), height * float((column**2).sum()) / (width - 1)
        inner = (height - 1.0) * (width - 1.0)
        pixel = float((rest**2).sum()) / inner
        own = (pixel, inner), (one.pixel / n, free * inner)
        lines = {
            "row": ((rows, height - 1.0), (one.row / n, free * (height - 1.0)), width),
            "column": ((columns, width - 1.0), (one.column / n, free * (width - 1.0)), height),
        }
        parts = {"pixel": [(1.0, *own[0]), (-1.0, *own[1])]}
        for name, (spatial, temporal, length) in lines.items():
            share = 1.0 / length
            parts[name] = [(share, *spatial), (-share, *temporal), (-share, *own[0]), (share, *own[1])]
        shares = 1.0 - 1.0 / width - 1.0 / height
        total = [(shares, *own[0]), (-shares, *own[1]), *parts["row"][:2], *parts["column"][:2]]
        scale = 1.0 / self.gain
        found = {f"dsnu_{name}": _root(squares(terms), scale, relative) for name, terms in parts.items()}
        return {"offset_spread": _root(squares(total), scale, relative), **found}

    def _light_pattern(self) -> dict[str, Interval]:
        """Relative spread of the pixels' gain, and of it what pixels, rows and columns have."""
        most = self.saturation if self.reached else float(self.signal.max())
        usable = np.flatnonzero(~self.clipped)
        k = int(usable[np.argmin(np.abs(self.signal[usable] - 0.5 * most))])
        one, charge = self.light[k], self._charge(self.light[k])
        dark = self.darkness.near(one.time)
        signal = _straightened(one.mean - self.darkness.pattern(one.time) + charge, self.bend) - charge
        if float(signal.min()) <= 0.0:
            self.doubts.append(f"{one.name}: has pixels without light, so the spread of the gain is not told")
            return {}
        height, width = signal.shape
        logs, scale = np.log(signal), ((1.0 - 2.0 * self.bend * signal) * signal) ** -2.0
        noise = float(((one.variance / one.frames + dark.variance / dark.frames) * scale).mean())
        shared = np.add([v / one.frames for v in one.shared], [v / dark.frames for v in dark.shared]) * float(
            scale.mean()
        )
        both = np.diff(np.diff(logs, 2, axis=0), 2, axis=1)
        pixel = float((both**2).mean()) / 36.0, both.size / _SECOND_2D
        many = (one.frames - 1.0) * signal.size
        parts, rough = {"pixel": [(1.0, *pixel), (-1.0, noise, many)]}, _rough(both)
        for axis, (name, length) in enumerate({"row": width, "column": height}.items()):
            second = np.diff(logs.mean(axis=1 - axis), 2)
            own = float((second**2).mean()) / 6.0, len(second) / _SECOND_1D
            temporal = float(shared[axis]), (one.frames - 1.0) * (len(second) + 1)
            parts[name] = [(1.0, *own), (-1.0 / length, *pixel), (-1.0, *temporal)]
            rough |= _rough(second)
        if rough:
            self.doubts.append(
                f"{one.name}: some pixels differ from their neighbours far more than most do; if the scene has edges "
                "or dust, they count as spread of the gain: take an even surface, out of focus"
            )
        shares = 1.0 - 1.0 / width - 1.0 / height
        total = [(shares, *pixel), (-1.0, noise, many)]
        total += [part for name in ("row", "column") for part in (parts[name][0], parts[name][2])]
        found = {f"prnu_{name}": _root(squares(terms), 1.0, 0.0) for name, terms in parts.items()}
        return {"gain_spread": _root(squares(total), 1.0, 0.0), **found}

    def _linearity_error(self) -> Interval:
        """Mean relative deviation from the line that fits best (EMVA 1288); noise alone makes it more than it is."""
        exposure, signal = self.exposure[self.linear], self.signal[self.linear]
        line, _ = _fit(np.stack([np.ones_like(exposure), exposure], axis=1), signal, signal**-2.0)
        fitted = line[0] + line[1] * exposure
        error = self._errors()[self.linear] / signal
        value = float(np.abs(signal / fitted - 1.0).mean())
        chance = math.sqrt(float((error**2).sum())) / len(error)
        noise = math.sqrt(2.0 / math.pi) * float(error.mean())
        return Interval(value, max(0.0, value - noise - _Z * chance), value + _Z * chance)

    def _doubt(self, found: dict[str, Interval]) -> None:
        if self.response is None:
            self.doubts.append(
                "linearity is not measured: it needs three levels or more of known exposure (--times, or a time in "
                "the names), from 5 to 95 % of saturation"
            )
        elif found["linearity_error"].low > 0.05:
            self.doubts.append(
                f"the signal is {found['linearity_error'].value:.0%} off a line against the exposure: the light "
                "changed, exposure times are not as stated, or the pictures have a gamma"
            )
        if not self.darkness.straight:
            self.doubts.append(
                "darkness does not grow in line with the exposure time: the chip warmed up, or corrects it"
            )
        if not math.isfinite(self.darkness.rate_error):
            self.doubts.append(
                "dark current is not measured: it needs --dark at two or more known exposure times; until then its "
                "charge counts as light, and its noise as read noise"
            )
        if found["flicker"].low > 0.0 and found["flicker"].value > _FLICKER:
            self.doubts.append(
                f"the light changed by {found['flicker'].value:.2%} from frame to frame; each frame was scaled to "
                "one brightness, and the file says so as flicker: delete that line if another lamp lights the scene"
            )
        last = int(np.flatnonzero(self.used)[-1])
        one = self.light[last]
        usual = sum((level.frames - 1) * level.shared[0] for level in self.darkness.levels) / self.darkness.free
        free = (one.frames - 1.0) * (one.mean.shape[0] - 1.0)
        bands = squares([(1.0 / one.mean.shape[1], one.row, free), (-1.0 / one.mean.shape[1], one.pixel, 1e9)])
        if bands.low > max(usual, 0.0) * 1.5 and bands.low > 4e-8 * self.signal[last] ** 2:
            share = math.sqrt(bands.value - max(usual, 0.0)) / self.signal[last]
            self.doubts.append(
                f"{one.name}: rows differ from frame to frame by {share:.2%} more than in the dark: the "
                "light flickers while rows are read out; use exposure times that are "
                "multiples of half a period of the mains, or a lamp on direct current"
            )
