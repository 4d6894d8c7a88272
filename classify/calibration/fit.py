"""What is off in a scene, fitted to measured pictures: a maximum of the posterior, with its covariance.

The picture's noise is that of `Sensor.variance`; what is known beforehand are normal deviations. Steps are those of
Gauss and Newton, damped (Levenberg 1944, Marquardt 1963) until they improve the fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from classify.calibration.predicted import Predicted
from generator.model.arrays import Array
from generator.model.errors import NlosError

_MOST_STEPS = 8
"""Times that slopes are computed."""
_WITH_ONE_SLOPE = 10
_SETTLED = 0.1
"""The fit has settled where a step is less than this share of what remains unknown, root mean square."""
_FREE = 1e-3
"""Damping below which a short step says that the fit has settled."""
_NEAR = 1.0
"""Slopes count as those of the fit where the fit is no farther from where they were computed, in the same unit."""
UNDETERMINED = 0.9
"""A value is called undetermined where its deviation is still this share of what it was beforehand."""
_TOGETHER = 0.7
"""Correlation from which on two values are said to be known together only."""
_BLOCKS = 4
"""Parts along each side of a picture, whose means tell of errors of large scale."""
_LEFT = 0.1
"""Least share of the noise that a fit leaves of a combination of these means that still tells."""
_NOISE = 0.01
"""Least p-value, of three tests together, at which a residual counts as noise."""

Variance = Callable[[Array], Array]


@dataclass(frozen=True)
class Verdict:
    """Whether what a fit leaves of the pictures is noise.

    Attributes
    ----------
    chi_squared, freedom : float
        Sum of the squared residuals in units of the noise, and its expectation.
    p_chi_squared : float
        Probability of a value as far from it, either way.
    neighbours, p_neighbours : float
        Correlation of neighbouring pixels; probability of one as high.
    blocks, p_blocks : float
        Sum of the squared means of the pictures' 16 parts in units of their noise, relative to its expectation;
        probability of one as high.
    """

    chi_squared: float
    freedom: float
    p_chi_squared: float
    neighbours: float
    p_neighbours: float
    blocks: float
    p_blocks: float

    @property
    def p(self) -> float:
        """p-value of the three tests together (Bonferroni)."""
        return min(1.0, 3.0 * min(self.p_chi_squared, self.p_neighbours, self.p_blocks))

    @property
    def is_noise(self) -> bool:
        """Whether nothing speaks against noise."""
        return self.p >= _NOISE

    @property
    def words(self) -> str:
        """The verdict as a sentence."""
        if self.is_noise:
            return f"what the fit leaves of the pictures is noise (p = {self.p:.2g})"
        share = self.chi_squared / self.freedom
        if self.p_neighbours > _NOISE / 3.0 and self.p_blocks > _NOISE / 3.0:
            return (
                f"what the fit leaves has no shape, but is {share:.3g} times the sensor's variance "
                f"(p = {self.p_chi_squared:.2g}); measure the sensor, or say how many frames were averaged"
            )
        return (
            f"what the fit leaves of the pictures is no noise (p = {self.p:.2g}; {share:.3g} times the noise's "
            "variance): something differs that was not fitted; look at the residual pictures"
        )


@dataclass(frozen=True)
class Calibration:
    """What was fitted to measured pictures.

    Attributes
    ----------
    names : tuple of str
    before : ndarray of shape (n,)
        Standard deviations of what was known beforehand.
    offsets : ndarray of shape (n,)
        What is off, in the units of `generator.transport.parameters.OFFSETS`.
    covariance : ndarray of shape (n, n)
    expected : ndarray of shape (pictures, height, width)
        Pictures that the fitted scene gives, W/m^2/sr.
    residuals : ndarray of shape (pictures, height, width)
        Measured minus expected, in standard deviations of the noise.
    verdict : Verdict
    steps : int
        How often slopes were computed.
    settled : bool
        Whether the fit has settled.
    """

    names: tuple[str, ...]
    before: Array
    offsets: Array
    covariance: Array
    expected: Array
    residuals: Array
    verdict: Verdict
    steps: int
    settled: bool = True

    @property
    def deviations(self) -> Array:
        """Standard deviations, (n,), of what is known afterwards."""
        deviations: Array = np.sqrt(np.diag(self.covariance))
        return deviations

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of what the pictures hardly say anything about."""
        left = self.deviations > UNDETERMINED * self.before
        return tuple(name for name, is_left in zip(self.names, left, strict=True) if is_left)

    def bound_together(self) -> list[str]:
        """Return sentences on pairs of values that the pictures know better together than each alone."""
        correlation = self.covariance / np.outer(self.deviations, self.deviations)
        told = []
        for j, k in zip(*np.triu_indices(len(self.names), 1), strict=True):
            if abs(correlation[j, k]) > _TOGETHER:
                how = "the less" if correlation[j, k] < 0 else "the more"
                told.append(f"the more {self.names[j]}, {how} {self.names[k]} (correlation {correlation[j, k]:.2f})")
        return told

    def value(self, name: str) -> float:
        """Return what is off by a name; 0 if it was not fitted."""
        return float(self.offsets[self.names.index(name)]) if name in self.names else 0.0


def fit(
    predicted: Predicted,
    measured: Array,
    variance: Callable[[Array], Array],
    before: Mapping[str, float],
    *,
    correlation: Array | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Calibration:
    """Fit what is off in a scene to measured pictures.

    Parameters
    ----------
    predicted : Predicted
    measured : ndarray of shape (pictures, height, width)
        Grey, W/m^2/sr: the empty scene, then the object at each of the places.
    variance : callable
        Returns the noise's variance of expected pictures, of the same shape, (W/m^2/sr)^2.
    before : mapping
        Standard deviation of what is known beforehand of each value that is fitted; names of `Predicted.names`.
    correlation : ndarray of shape (n, n), optional
        Of what is known beforehand; independent if left out.
    progress : callable
        Called with (done, total) steps; the total is what may be needed.

    Raises
    ------
    NlosError
        A name is not one of these pictures, a deviation is not positive, or the pictures have another size.
    """
    names = tuple(before)
    known = predicted.names
    for name, deviation in before.items():
        if name not in known:
            raise NlosError(f"{name!r} is nothing that these pictures could tell; choose from {', '.join(known)}")
        if not 0.0 < deviation < math.inf:
            raise NlosError(f"{name}: its standard deviation is {deviation:g}; it must be above 0")
    if not names:
        raise NlosError("nothing to fit: state the standard deviation of what is not known exactly")
    deviations = np.array(list(before.values()))
    together = np.eye(len(names)) if correlation is None else correlation
    prior = np.linalg.inv(np.outer(deviations, deviations) * together)
    expected = predicted.pictures({})
    if measured.shape != expected.shape:
        raise NlosError(
            f"the pictures have shape {measured.shape}, and those of the scene {expected.shape} (number, height, "
            "width)"
        )

    def misfit(offsets: Array, pictures: Array, noise: Array) -> float:
        return float(((measured - pictures) ** 2 / noise).sum() + offsets @ prior @ offsets)

    offsets, steps = np.zeros(len(names)), 0
    low, high = np.array([predicted.bounds(name) for name in names]).T
    while True:
        steps += 1
        slopes = predicted.slopes(dict(zip(names, offsets.tolist(), strict=True)), before).reshape(len(names), -1)
        noise = variance(expected)
        weighted = slopes / noise.reshape(1, -1)
        normal = weighted @ slopes.T + prior
        start, damping, settled = offsets, 0.0, False
        # Slopes take most of the time, and hardly change: they serve until the fit settles.
        for _ in range(_WITH_ONE_SLOPE):
            pull = weighted @ (measured - expected).ravel() - prior @ offsets
            step = _within(normal + damping * np.diag(np.diag(normal)), pull, low - offsets, high - offsets)
            try:
                pictures = predicted.pictures(dict(zip(names, (offsets + step).tolist(), strict=True)))
                better = misfit(offsets + step, pictures, noise) < misfit(offsets, expected, noise)
            except NlosError:  # a scene that cannot be
                better = False
            settled = damping < _FREE and float(step @ normal @ step) < _SETTLED**2 * len(names)
            if better:
                offsets, expected, damping = offsets + step, pictures, 0.1 * damping
            else:
                damping = max(10.0 * damping, 1e-2)
            if settled:
                break
        progress(steps, _MOST_STEPS)
        moved = offsets - start
        settled = settled and float(moved @ normal @ moved) < _NEAR**2 * len(names)
        if settled or steps == _MOST_STEPS:
            break
    noise = variance(expected)
    residuals = (measured - expected) / np.sqrt(noise)
    covariance = np.linalg.inv(normal)
    scaled = slopes / np.sqrt(noise).reshape(1, -1)
    verdict = judge(residuals, scaled, covariance)
    return Calibration(names, deviations, offsets, covariance, expected, residuals, verdict, steps, settled)


def _within(normal: Array, pull: Array, low: Array, high: Array) -> Array:
    """Return the step (n,) that solves ``normal @ step = pull``; what would leave its bounds is held at them."""
    step, free = np.zeros(len(pull)), np.ones(len(pull), dtype=bool)
    while free.any():
        rest = pull[free] - normal[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.solve(normal[np.ix_(free, free)], rest)
        out = free & ((step < low) | (step > high))
        if not out.any():
            break
        step[out], free = np.clip(step, low, high)[out], free & ~out
    return step


def judge(residuals: Array, slopes: Array, covariance: Array) -> Verdict:
    """Test whether residuals are noise, of which a fit has taken a part.

    Residuals of a right fit have the covariance 1 - S' C S, with the slopes S of the pictures in units of the noise
    and the covariance C of what was fitted: it is the inverse of 1 + S' P S, the pictures' covariance before the fit,
    where P is that of what was known beforehand.

    Parameters
    ----------
    residuals : ndarray of shape (pictures, height, width)
        In standard deviations of the noise.
    slopes : ndarray of shape (n, pixels of all pictures)
        Derivatives in the same unit.
    covariance : ndarray of shape (n, n)
    """
    shape, flat = residuals.shape, residuals.ravel()
    absorbed = float((covariance * (slopes @ slopes.T)).sum())
    freedom = flat.size - absorbed
    total = float(flat @ flat)
    p_total = 2.0 * min(chi2.sf(total, freedom), chi2.cdf(total, freedom))
    product = 0.0
    pairs, expected = 0, 0.0
    pictures = slopes.reshape(len(slopes), *shape)
    for axis in (1, 2):
        near, far = (_without(residuals, axis, end) for end in (0, -1))
        product += float((near * far).sum())
        pairs += near.size
        one, other = (_without(pictures, axis + 1, end).reshape(len(slopes), -1) for end in (0, -1))
        expected -= float((covariance * (one @ other.T)).sum())
    excess = (product - expected) / math.sqrt(max(pairs, 1)) * (flat.size / freedom)
    means = _block_sums(residuals).ravel()
    absorbing = _block_sums(pictures).reshape(len(slopes), -1)
    joint = np.eye(len(means)) - absorbing.T @ covariance @ absorbing
    values, vectors = np.linalg.eigh(joint)
    kept = values > _LEFT
    along = vectors[:, kept].T @ means
    large = float((along**2 / values[kept]).sum())
    return Verdict(
        chi_squared=total,
        freedom=freedom,
        p_chi_squared=float(min(1.0, p_total)),
        neighbours=product / max(pairs, 1) * (flat.size / total),
        p_neighbours=float(norm.sf(excess)),
        blocks=large / int(kept.sum()),
        p_blocks=float(chi2.sf(large, int(kept.sum()))),
    )


def _without(pictures: Array, axis: int, end: int) -> Array:
    """Return pictures without their first (0) or last (-1) row or column."""
    return np.delete(pictures, end, axis=axis)


def _block_sums(pictures: Array) -> Array:
    """Return the sums over parts of pictures (..., height, width), divided by the root of their numbers of pixels."""
    sums = pictures
    for axis in (-2, -1):
        size = pictures.shape[axis]
        starts = np.unique(np.arange(_BLOCKS) * size // _BLOCKS)
        counts = np.diff(np.append(starts, size)).reshape((-1, 1) if axis == -2 else (-1,))
        sums = np.add.reduceat(sums, starts, axis=axis) / np.sqrt(counts)
    return sums
