"""Whether a picture can be of an atlas' scene and object at all, wherever that stands.

A posterior compares the atlas' poses with one another and always names one. What it does not say is whether any of
them explains the picture: another room, a moved lamp, an object of another size leave something over, in the code or
in what the code leaves out. Two tests say how probable so much is for a picture that is what the atlas is of.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from classify.inference.atlas import Atlas
from classify.tail import RARE, Tail, more_than_chance
from generator.model.arrays import Array

_DRAWS = 1000
_POSES = 20_000
"""Most poses of the atlas that a code is compared with."""
_CHANCE = 1e-4
"""Probability of a false warning about a set."""


@dataclass(frozen=True)
class Misfit:
    """How well a picture fits an atlas.

    Attributes
    ----------
    code : float
        Probability that a picture which is what the atlas is of has a code as far from those of all poses, and from
        that of the empty scene.
    pixels : float
        Probability that the part of such a picture which its code leaves out is as large.
    """

    code: float
    pixels: float

    @property
    def probability(self) -> float:
        """Probability that one of both is so small by chance (Bonferroni's bound)."""
        return min(1.0, 2.0 * min(self.code, self.pixels))


class Misfits:
    """Tests pictures against an atlas.

    Parameters
    ----------
    atlas : Atlas
    seed : int
        Seed of the simulated pictures that tell how far codes are from one another.

    Notes
    -----
    What a code leaves out has unit variance in every direction, times the atlas' ``spread``, if the picture is of its
    scene: the sum of squares is chi-squared. The distance of a code from the nearest of the atlas', and from the
    plane through the nearest few, depends on how densely these lie, so its distribution is simulated: poses of the
    atlas, each left out of it, with noise.
    """

    def __init__(self, atlas: Atlas, *, seed: int = 0) -> None:
        self._atlas = atlas
        # Noise that pixels share says nothing about the scene either, and has another variance.
        shared = atlas.sensor.shared(atlas.background[..., None]) * atlas.sensor.stabilised_slope(
            atlas.background[..., None]
        )
        known = np.concatenate([atlas.basis.astype(np.float64), shared.reshape(len(shared), atlas.background.size)])
        self._directions = np.linalg.qr(known.T)[0]
        self._some = slice(None, None, -(-len(atlas.codes) // _POSES))
        self._subset = atlas.take(self._some)
        free = int((np.ptp(np.concatenate([atlas.positions, atlas.rotations], axis=1), axis=0) > 0.0).sum())
        count, size = self._subset.codes.shape
        # Twice as many as the surface has, for it is curved; but most of the noise must be left over.
        self._directions_between = min(2 * free, size // 3, count - 2)
        rng = np.random.default_rng([seed, 7])
        left_out = rng.integers(count, size=_DRAWS)
        noise = rng.normal(size=(_DRAWS, size))
        codes = np.array([self._subset.example(int(pose), rng) for pose in left_out]) + noise
        poses = zip(codes, left_out, strict=True)
        own = [self._distance(code.astype(np.float32), self._subset, int(pose)) for code, pose in poses]
        self._tail = Tail(np.array(own))

    def __call__(self, difference: Array, code: NDArray[np.float32], given: Atlas | None = None) -> Misfit:
        """Test a picture.

        Parameters
        ----------
        difference : ndarray of shape (height * width,)
            From `Atlas.difference`.
        code : ndarray of shape (k,)
            Its code.
        given : Atlas, optional
            The atlas, given the picture's background (`Atlas.given`).
        """
        subset = self._subset
        if given is not None and given is not self._atlas:  # what scatters does not depend on the background
            subset = replace(subset, codes=given.codes[self._some])
        rest = difference - self._directions @ (difference @ self._directions)
        freedom = len(difference) - self._directions.shape[1]
        pixels = float(chi2.sf(rest @ rest / self._atlas.spread, freedom)) if freedom else 1.0
        return Misfit(self._tail.exceeded(self._distance(code, subset)), pixels)

    def _distance(self, code: NDArray[np.float32], atlas: Atlas, without: int | None = None) -> float:
        """Squared distance of a code from the nearest, or from the plane through the nearest few if that is less.

        With unknown strengths: from the likeliest, on their average.
        """
        logs = atlas.logs(code)
        if without is not None:
            logs[without] = -np.inf
        distance = float(code @ code) - 2.0 * max(0.0, float(logs.max()))
        if not self._directions_between or atlas.hiding is not None or atlas.uncertain is not None:
            return distance
        # The codes of an object that moves lie on a curved surface, and the atlas knows points of it.
        near = np.argpartition(logs, -1 - self._directions_between)[-1 - self._directions_between :]
        base = atlas.codes[near[-1]].astype(np.float64)
        sides = (atlas.codes[near[:-1]] - base).T
        rest = code - base
        rest = rest - sides @ np.linalg.lstsq(sides, rest, rcond=1e-6)[0]
        return min(distance, float(rest @ rest))


def doubt(probabilities: Array) -> str:
    """Return a sentence if more pictures do not fit than chance would have it; else an empty one.

    Parameters
    ----------
    probabilities : ndarray of shape (n,)
        `Misfit.probability` of pictures.
    """
    count = len(probabilities)
    bad, surprising = more_than_chance(probabilities, _CHANCE)
    if bad <= 2.0 * RARE * count or not surprising:  # pictures that share a background are alike
        return ""
    return (
        f"{bad} of {count} pictures do not fit the atlas ({RARE:.0%} would by chance): scene, object or camera are "
        "other than it knows them, and stated probabilities and regions cannot be relied on"
    )


def doubt_of_backgrounds(probabilities: Array) -> str:
    """Return a sentence if measured backgrounds are of no scene that an uncertain atlas allows; else an empty one.

    Parameters
    ----------
    probabilities : ndarray of shape (n,)
        `classify.inference.uncertain.Uncertain.misfit` of the backgrounds.
    """
    if not len(probabilities) or np.median(probabilities) >= _CHANCE:
        return ""
    return (
        f"the measured background differs from the atlas' by more than what was stated as uncertain (p < "
        f"{_CHANCE:g}): lamp, view or room are others, and stated probabilities and "
        "regions cannot be relied on"
    )
