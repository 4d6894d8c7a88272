"""Two objects at once: their changes of the light add up, except for the light that one takes from the other."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classify.inference.atlas import Atlas
from generator.model.arrays import Array
from generator.model.errors import NlosError

_POSES = 1500
_STARTS, _ROUNDS = 64, 6
_FEW = 20.0
"""Pairs that must contribute to an answer (effective number); with fewer, the answer is improved."""
_FAINT = 0.2
"""Largest relative change of the square root of the empty scene's light at which two changes add up."""


@dataclass(frozen=True)
class Pair:
    """Posterior of the voxels of two objects, given a picture.

    Attributes
    ----------
    voxels : ndarray of shape (n_voxels, n_voxels)
        Probability of each pair of voxels, if there are two objects; symmetric, of sum 1.
    evidence : float
        Logarithm of how much more probable the picture is with two objects than with one.
    """

    voxels: Array
    evidence: float

    @property
    def likeliest(self) -> tuple[int, int]:
        """The most probable pair of voxels, the lower first."""
        upper = np.triu(self.voxels) + np.triu(self.voxels.T, 1)
        first, second = np.unravel_index(int(upper.argmax()), upper.shape)
        return int(first), int(second)


def locate_two(atlas: Atlas, code: NDArray[np.float32], *, poses: int = _POSES, seed: int = 0) -> Pair:
    """Return the posterior of two objects of the atlas' kind.

    With codes a and b of unit noise, the logarithm of the likelihood ratio to an empty scene is that of a, plus that
    of b, minus the product a b, since light adds up. All pairs of some of the atlas' poses are weighted; if too few
    of these explain the picture, the best pairs are improved over all poses.

    Parameters
    ----------
    atlas : Atlas
        Atlas of a known object.
    code : ndarray of shape (k,)
        Code of the picture, from `Atlas.code`.
    poses : int
        Number of the atlas' poses to take; time and memory grow with its square.
    seed : int
        Seed of their choice.

    Raises
    ------
    NlosError
        If the object's size and albedo are unknown, the scene is uncertain, or the object is so bright relative to
        the empty scene that the noise depends on it.
    """
    if atlas.unknown:
        raise NlosError("two objects: are told apart by an atlas of a known object only (without --unknown)")
    if atlas.uncertain is not None:
        raise NlosError("two objects: are told apart in a known scene only (bulk without --uncertain)")
    strongest = atlas.codes[np.argmax((atlas.codes**2).sum(axis=1))]
    change = np.abs(np.linalg.pinv(atlas.basis) @ strongest)
    if (change > _FAINT * np.abs(atlas.empty.ravel()).mean()).any():
        raise NlosError(
            "two objects: their light adds up only where it is faint beside the empty scene's, and here it is not"
        )
    rng = np.random.default_rng([seed, 9])
    chosen = rng.choice(len(atlas.codes), size=min(poses, len(atlas.codes)), replace=False)
    order = chosen[np.argsort(atlas.voxels[chosen], kind="stable")]
    codes = atlas.codes[order]
    alone = _alone(codes, code)
    joint = alone[:, None] + alone - codes @ codes.T
    top = float(joint.max())
    weights = np.exp(joint - top)
    membership = np.eye(atlas.grid.n_voxels, dtype=np.float32)[atlas.voxels[order]]
    voxels = (membership.T @ weights @ membership).astype(np.float64)
    total = float(voxels.sum())
    effective = float(weights.sum()) ** 2 / float((weights**2).sum())
    top_alone = float(alone.max())
    evidence = top + math.log(total / len(order) ** 2) - top_alone - math.log(float(np.exp(alone - top_alone).mean()))
    if effective < _FEW:
        rows, columns = np.unravel_index(np.argsort(joint, axis=None)[-_STARTS:], joint.shape)
        voxels, total = _climbed(atlas, code, order[rows], order[columns])
    return Pair(voxels / total, evidence)


def _alone(codes: NDArray[np.float32], code: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logarithm of the likelihood ratio of one object to an empty scene, (n,)."""
    logs: NDArray[np.float32] = codes @ code - 0.5 * np.einsum("ij,ij->i", codes, codes)
    return logs


def _climbed(
    atlas: Atlas, code: NDArray[np.float32], first: NDArray[np.int64], second: NDArray[np.int64]
) -> tuple[Array, float]:
    """Weights of voxel pairs (n_voxels, n_voxels), and their sum, from pairs improved over the whole atlas.

    The best of a few poses may be far from the truth, so each of the two is moved in turn to the pose that explains
    best what the other leaves: coordinate ascent.
    """
    alone = _alone(atlas.codes, code)
    for _ in range(_ROUNDS):
        first = np.argmax(alone - atlas.codes[second] @ atlas.codes.T, axis=1)
        second = np.argmax(alone - atlas.codes[first] @ atlas.codes.T, axis=1)
    overlaps = np.einsum("ij,ij->i", atlas.codes[first], atlas.codes[second])
    logs = (alone[first] + alone[second] - overlaps).astype(np.float64)
    voxels = np.zeros((atlas.grid.n_voxels,) * 2)
    unique = np.unique(np.stack([first, second]), axis=1, return_index=True)[1]  # many starts lead to the same pair
    weights = np.exp(logs[unique] - logs.max())
    np.add.at(voxels, (atlas.voxels[first[unique]], atlas.voxels[second[unique]]), weights)
    return 0.5 * (voxels + voxels.T), float(weights.sum())
