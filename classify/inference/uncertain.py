"""Codes of a scene that is not known exactly: what a measured background tells of them, and how they still scatter.

A set with ``--uncertain`` has at every pose a scene of its own, drawn from what is not known, and its background. How
much its code differs from that of the scene as stated is a smooth function of the pose and of the draw, so it is
fitted around each pose by what neighbouring poses drew: linear in the background, which a lab measures, and in the
drawn values that the background does not tell, each of these linear in the position (locally weighted regression:
Cleveland 1979). Given a measured background, the code at a pose is then a normal variable, and the unknown values are
integrated out in closed form (linear Gaussian model: Rasmussen and Williams 2006, section 2.1). What such a fit
leaves over, such as furniture that the background hardly shows, widens it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import chi2

from classify.tail import Tail
from generator.model.arrays import Array

Floats = NDArray[np.float32]

_TOLD = 0.5
"""Largest variance of the noise in a measured background, relative to the direction's own, that tells a direction."""
_MOST_TOLD, _MOST_UNTOLD, _MOST_WAYS = 8, 8, 16
"""Most directions of backgrounds, of what they do not tell, and of the scatter at a pose."""
_FELT = 0.1
"""Root mean square change of the codes, in units of the noise, below which a direction of values is left out."""
_WEAK = 0.02
"""Variance of a direction of the scatter, in that of the noise, below which it is dropped."""
_ANCHORS = 5000
"""Most poses around which codes are fitted; others take the fit of the nearest of these."""
_SURPLUS = 4.0
"""Poses that a fit takes, in numbers of its terms."""


@dataclass(frozen=True)
class Uncertain:
    """What is not known of a scene, in the codes of an atlas' poses.

    Attributes
    ----------
    slopes : ndarray of shape (n, p, k), float32
        Change of each code per standard deviation of each direction in which backgrounds differ.
    scatter : ndarray of shape (n, r, k), float32
        Directions in which each code scatters besides, each of one standard deviation.
    basis : ndarray of shape (p, height * width), float32
        Matrix that maps a background's difference from the atlas', on the scale of unit noise, to these directions.
    left : ndarray of shape (m,), float64
        What these directions leave over in backgrounds as the atlas was made from, measured: root mean squares,
        on the scale of unit noise.
    """

    slopes: Floats
    scatter: Floats
    basis: Floats
    left: Array

    def told(self, difference: Array) -> Array:
        """Return where a background lies, (p,), in standard deviations, given its difference (height * width,)."""
        places: Array = self.basis @ difference
        return places

    @cached_property
    def _back(self) -> Array:
        back: Array = np.linalg.pinv(self.basis.astype(np.float64))
        return back

    def misfit(self, difference: Array) -> float:
        """Return the probability that a background of the stated scene differs as much.

        Parameters
        ----------
        difference : ndarray of shape (height * width,)
            Of the measured background from the atlas', on the scale of unit noise.
        """
        places = self.told(difference)
        rest = difference - self._back @ places
        outside = Tail(self.left).exceeded(float(np.sqrt((rest**2).mean())))
        inside = float(chi2.sf(places @ places, len(places))) if len(places) else 1.0
        return min(1.0, 2.0 * min(inside, outside))

    def take(self, some: Any) -> Uncertain:
        """Return what belongs to some of the poses, given by their indices or a slice."""
        return replace(self, slopes=self.slopes[some], scatter=self.scatter[some])

    def scaled(self, scale: float, change: Array, kept: int) -> Uncertain:
        """Return what `Atlas.at` makes of it: codes scaled and changed by a matrix, of which the first are kept."""
        slopes, scatter = (
            np.ascontiguousarray((scale * part @ change.T)[..., :kept].astype(np.float32))
            for part in (self.slopes, self.scatter)
        )
        basis = self.basis / np.float32(scale)
        return replace(self, slopes=slopes, scatter=scatter, basis=basis, left=scale * self.left)

    @cached_property
    def _whitened(self) -> tuple[Floats, Floats]:
        """Directions (n, r, k) whose squared products are twice a gain, and half the log-determinants (n,)."""
        scatter = self.scatter.astype(np.float64)
        factor = np.linalg.cholesky(np.eye(scatter.shape[1]) + scatter @ scatter.transpose(0, 2, 1))
        ways = np.linalg.solve(factor, scatter)
        half = np.log(np.einsum("nii->ni", factor)).sum(axis=1)
        return ways.astype(np.float32), half.astype(np.float32)

    def products(self, of: Floats) -> Floats:
        """Return the part of `gains` that depends on the poses' codes (n, k) alone, (n, r)."""
        products: Floats = np.einsum("nrk,nk->nr", self._whitened[0], of)
        return products

    def gains(self, codes: Floats, products: Floats) -> Floats:
        """Return what the scatter adds to the logarithm of each pose's likelihood, (..., n).

        The likelihood of a code c at a pose of code f is normal about f with covariance 1 + S'S; its inverse and
        determinant by Woodbury's identity.

        Parameters
        ----------
        codes : ndarray of shape (..., k)
            Codes of pictures.
        products : ndarray of shape (n, r)
            From `products`.
        """
        ways, half = self._whitened
        n, r, k = ways.shape
        offset = (codes @ ways.reshape(n * r, k).T).reshape(*codes.shape[:-1], n, r) - products
        gains: Floats = np.float32(0.5) * np.einsum("...nr,...nr->...n", offset, offset) - half
        return gains

    def covariance(self, some: NDArray[np.int64], weights: Array) -> Array:
        """Return the weighted mean, over some poses, of the covariance (k, k) of a code, noise included."""
        scatter = self.scatter[some].astype(np.float64) * np.sqrt(weights / weights.sum())[:, None, None]
        flat = scatter.reshape(-1, scatter.shape[2])
        covariance: Array = np.eye(flat.shape[1]) + flat.T @ flat
        return covariance


@dataclass(frozen=True)
class Backgrounds:
    """The directions in which the backgrounds of drawn scenes differ, as far as a measured one tells them.

    Attributes
    ----------
    basis : ndarray of shape (p, height * width)
        As of `Uncertain`.
    noise : ndarray of shape (p,)
        Variance of the noise of a measured background's place.
    left : ndarray of shape (n,)
        As of `Uncertain`.
    """

    basis: Array
    noise: Array
    left: Array

    @classmethod
    def of(cls, differences: Array, noise: float) -> Backgrounds:
        """Find the directions.

        Parameters
        ----------
        differences : ndarray of shape (n, height * width)
            Of backgrounds from the atlas', on the scale of unit noise.
        noise : float
            Variance of a measured background's noise on that scale.
        """
        n, pixels = differences.shape
        _, strengths, ways = np.linalg.svd(differences, full_matrices=False)
        variances = strengths**2 / n
        count = int(min(_MOST_TOLD, (noise < _TOLD * variances).sum()))
        basis = ways[:count] / np.sqrt(variances[:count])[:, None]
        rest = differences - (differences @ ways[:count].T) @ ways[:count]
        rng = np.random.default_rng([n, 11])
        free = rng.chisquare(max(1, pixels - count), size=n)
        left = np.sqrt(((rest**2).sum(axis=1) + noise * free) / pixels)
        return cls(basis, noise / variances[:count], left)


def fitted(
    changes: Array,
    positions: Array,
    values: Array,
    told: Array,
    backgrounds: Backgrounds,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Floats, Uncertain]:
    """Fit how codes change with the scene.

    Parameters
    ----------
    changes : ndarray of shape (n, k)
        Code of each drawn scene less that of the stated scene with the target at the same pose.
    positions : ndarray of shape (n, 3)
        Metres.
    values : ndarray of shape (n, m)
        The drawn values.
    told : ndarray of shape (n, p)
        Where the background of each lies (`Backgrounds.basis`).
    backgrounds : Backgrounds
    progress : callable
        Called with (done, total), in poses.

    Returns
    -------
    shift : ndarray of shape (n, k), float32
        Mean change of each code, with a background as the atlas' own.
    uncertain : Uncertain
    """
    n, k = changes.shape
    unit = np.ptp(positions, axis=0)
    points = positions / np.where(unit > 0.0, unit, 1.0)
    untold = _felt(changes, points, _untold(values, told))
    p, q = told.shape[1], untold.shape[1]
    terms = 10 + 4 * (p + q)
    count = min(n, max(int(_SURPLUS * terms), 60))
    anchors = np.arange(n) if n <= _ANCHORS else np.linspace(0, n - 1, _ANCHORS).astype(np.int64)
    tree, nearest = cKDTree(points), cKDTree(points[anchors]).query(points)[1]
    shift, slopes = np.zeros((n, k), np.float32), np.zeros((n, p, k), np.float32)
    scatter = np.zeros((n, min(_MOST_WAYS, k), k), np.float32)
    shrunk, unsure = 1.0 / (1.0 + backgrounds.noise), np.sqrt(backgrounds.noise / (1.0 + backgrounds.noise))
    order = np.argsort(nearest, kind="stable")
    members = np.split(order, np.cumsum(np.bincount(nearest, minlength=len(anchors)))[:-1])
    for done, (anchor, own) in enumerate(zip(anchors, members, strict=True)):
        if not len(own):
            continue
        far, near = tree.query(points[anchor], count)
        weights = (1.0 - (far / (far[-1] * (1.0 + 1e-9) + 1e-300)) ** 3) ** 3
        design = _terms(points[near] - points[anchor], told[near], untold[near])
        root = np.sqrt(weights)[:, None]
        fit = _ridge(design * root, changes[near] * root)
        rest = (changes[near] - design @ fit) * root
        # With weights, so many neighbours count (Kish 1965). Errors of the fit itself add to what it leaves over.
        used = terms * float(weights @ weights) / weights.sum() ** 2
        leftover = rest.T @ rest / weights.sum() * (1.0 + used) / max(1.0 - used, 0.1)
        offsets = points[own] - points[anchor]
        linear = np.concatenate([np.ones((len(own), 1)), offsets], axis=1)
        shift[own] = _terms(offsets, np.zeros((len(own), p)), np.zeros((len(own), q))) @ fit
        both = np.einsum("oa,ajk->ojk", linear, fit[10:].reshape(4, p + q, k))
        slopes[own] = both[:, :p] * shrunk[:, None]
        ways = np.concatenate([both[:, :p] * unsure[:, None], both[:, p:]], axis=1)
        covariance = ways.transpose(0, 2, 1) @ ways + leftover
        strengths, axes = np.linalg.eigh(covariance)
        kept = slice(k - scatter.shape[1], k)
        roots = np.sqrt(np.maximum(strengths[:, kept], 0.0))
        scatter[own] = roots[:, ::-1, None] * axes[:, :, kept].transpose(0, 2, 1)[:, ::-1]
        progress(done + 1, len(anchors))
    kept_ways = int(((scatter.astype(np.float64) ** 2).sum(axis=2).max(axis=0) > _WEAK).sum())
    left = np.sort(backgrounds.left)
    uncertain = Uncertain(
        slopes, np.ascontiguousarray(scatter[:, : max(1, kept_ways)]), backgrounds.basis.astype(np.float32), left
    )
    return shift, uncertain


def _untold(values: Array, told: Array) -> Array:
    """Return drawn values (n, m), without what the backgrounds tell of them, of unit covariance."""
    known = np.concatenate([np.ones((len(told), 1)), told], axis=1)
    rest = values - known @ np.linalg.lstsq(known, values, rcond=None)[0]
    spread = values.std(axis=0)
    rest = rest[:, spread > 0.0] / spread[spread > 0.0]
    strengths, axes = np.linalg.eigh(rest.T @ rest / len(rest)) if rest.shape[1] else (np.zeros(0), rest.T)
    kept = strengths > 1e-4
    whitened: Array = rest @ axes[:, kept] / np.sqrt(strengths[kept])
    return whitened


def _felt(changes: Array, points: Array, untold: Array) -> Array:
    """Return the directions of values (n, q), of unit variance, that codes depend on, the strongest first."""
    if not untold.shape[1]:
        return untold
    centred = points - points.mean(axis=0)
    linear = np.concatenate([np.ones((len(points), 1)), centred / np.maximum(points.std(axis=0), 1e-12)], axis=1)
    design = (linear[:, :, None] * untold[:, None, :]).reshape(len(points), -1)
    fit = _ridge(design, changes - changes.mean(axis=0)).reshape(4, untold.shape[1], -1)
    effects = fit.transpose(1, 0, 2).reshape(untold.shape[1], -1)
    axes, strengths, _ = np.linalg.svd(effects, full_matrices=False)
    kept = min(_MOST_UNTOLD, int((strengths > _FELT).sum()))
    felt: Array = untold @ axes[:, :kept]
    return felt


def _terms(points: Array, told: Array, untold: Array) -> Array:
    """Return quadratic terms of points (n, 3), and those of both kinds of values alone and times each coordinate."""
    i, j = np.triu_indices(3)
    ones, values = np.ones((len(points), 1)), np.concatenate([told, untold], axis=1)
    linear = np.concatenate([ones, points], axis=1)
    mixed = (linear[:, :, None] * values[:, None, :]).reshape(len(points), -1)
    terms: Array = np.concatenate([linear, points[:, i] * points[:, j], mixed], axis=1)
    return terms


def _ridge(design: Array, wanted: Array) -> Array:
    """Return a least-squares solution; terms that the data do not tell apart share what they explain."""
    scale = np.sqrt((design**2).sum(axis=0)) + 1e-300
    scaled = design / scale
    gram = scaled.T @ scaled + 1e-6 * np.eye(scaled.shape[1])
    solution: Array = np.linalg.solve(gram, scaled.T @ wanted) / scale[:, None]
    return solution
