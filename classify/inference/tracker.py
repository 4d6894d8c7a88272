"""Tracking of a moving object, frame by frame: predict its motion, then update with the new picture.

The hidden volume is divided into small cells, and the filter keeps the probability of each and of an empty scene.
Between two frames the object makes a random walk; each picture weights the cells. This is the filter of the hidden
Markov model (Rabiner 1989, equation 20) for this walk. The shape of the distribution is free: it may have two peaks
until a picture decides between them, and an object that was lost is found again.

Within a cell, position and code are modelled as jointly normal, with the moments of the atlas' poses there. No pose
of the atlas is exactly that of the object, so a sharp picture would practically rule out each of them alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d
from scipy.spatial import cKDTree
from scipy.special import ive

from classify.inference.atlas import Atlas
from generator.model.arrays import Array
from generator.model.errors import NlosError

_CELLS = 15
"""Number of cells along the longer of the grid's horizontal edges: 10 cm each in the preset room."""
_ENOUGH = 12
"""Least number of poses for the moments of a cell; if it has fewer, those nearest to their mean are taken."""
AT_REST = 20
"""Frames over which what is wrong in all of them alike adds up, for an object that hardly moves."""
_WAYS = 8
"""Number of principal directions of the codes in a cell: three for the position, some for rotations."""


@dataclass(frozen=True)
class Step:
    """Posterior after a frame.

    Attributes
    ----------
    presence : float
        Probability that there is an object.
    voxels : ndarray of shape (n_voxels,)
        Probability of each voxel, if there is an object.
    position : ndarray of shape (3,)
        Mean position, metres, if there is an object.
    covariance : ndarray of shape (3, 3)
        Covariance of the position, m^2.
    """

    presence: float
    voxels: Array
    position: Array
    covariance: Array

    @property
    def found(self) -> bool:
        """Whether an object is more probable than an empty scene."""
        return self.presence > 0.5


@dataclass(frozen=True)
class _Cells:
    """Moments of positions and codes in each of n cells, with r principal directions of the codes.

    Attributes
    ----------
    means : ndarray of shape (n, k)
        Means of the codes.
    ways : ndarray of shape (n, r, k)
        Principal directions of the codes, orthonormal.
    strengths : ndarray of shape (n, r)
        Variance of the codes along each direction.
    places : ndarray of shape (n, 3)
        Mean positions, metres.
    spreads : ndarray of shape (n, 3, 3)
        Covariances of the positions, m^2.
    along : ndarray of shape (n, 3, r)
        Covariances of the positions with the codes along each direction.
    voxels : ndarray of shape (n, n_voxels)
        Share of each voxel in a cell.
    """

    means: Array
    ways: Array
    strengths: Array
    places: Array
    spreads: Array
    along: Array
    voxels: Array

    @classmethod
    def of(cls, atlas: Atlas, members: list[NDArray[np.int64]]) -> _Cells:
        """Return the moments of cells, given the indices of the poses in each."""
        tree = cKDTree(atlas.positions)
        n, k, r = len(members), atlas.codes.shape[1], min(_WAYS, atlas.codes.shape[1])
        means, ways, strengths = np.zeros((n, k)), np.zeros((n, r, k)), np.zeros((n, r))
        places, spreads, along = np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, r))
        voxels = np.zeros((n, atlas.grid.n_voxels))
        least = min(_ENOUGH, len(atlas.codes))
        for cell, poses in enumerate(members):
            voxels[cell] = np.bincount(atlas.voxels[poses], minlength=atlas.grid.n_voxels) / len(poses)
            sample = poses if len(poses) >= least else tree.query(atlas.positions[poses].mean(axis=0), least)[1]
            sample = np.atleast_1d(sample)
            root = math.sqrt(max(len(sample) - 1, 1))
            codes, points = atlas.codes[sample].astype(np.float64), atlas.positions[sample]
            means[cell], places[cell] = codes.mean(axis=0), points.mean(axis=0)
            deviations, offsets = (codes - means[cell]) / root, (points - places[cell]) / root
            left_vectors, singular_values, right_vectors = np.linalg.svd(deviations, full_matrices=False)
            kept = min(r, len(singular_values))
            ways[cell, :kept], strengths[cell, :kept] = right_vectors[:kept], singular_values[:kept] ** 2
            spreads[cell] = offsets.T @ offsets
            along[cell, :, :kept] = offsets.T @ (left_vectors[:, :kept] * singular_values[:kept])
        return cls(means, ways, strengths, places, spreads, along, voxels)

    def weigh(self, code: Array) -> tuple[Array, Array]:
        """Return the log-likelihood ratio of each cell to an empty scene, and the mean position given the cell.

        The ratio is of two normal densities, with the covariance's inverse and determinant by Woodbury's identity.
        The position is the mean of one normal variable given the other (Kay 1993, equation 10.24).

        Returns
        -------
        logs : ndarray of shape (n,)
        places : ndarray of shape (n, 3)
            Metres.
        """
        deviations = self.ways @ code - np.einsum("nrk,nk->nr", self.ways, self.means)
        shrinkage = self.strengths / (1.0 + self.strengths)
        logs = self.means @ code - 0.5 * (self.means**2).sum(axis=1)
        logs += 0.5 * (shrinkage * deviations**2).sum(axis=1) - 0.5 * np.log1p(self.strengths).sum(axis=1)
        shifts = np.einsum("nar,nr->na", self.along, deviations / (1.0 + self.strengths))
        return logs, self.places + shifts

    @cached_property
    def left(self) -> Array:
        """Covariances of the positions given the code, (n, 3, 3), m^2."""
        reduction = np.einsum("nar,nr,nbr->nab", self.along, 1.0 / (1.0 + self.strengths), self.along)
        left: Array = self.spreads - reduction
        return left


class Filter:
    """Tracks one object.

    All frames are compared with one measured background, whose noise they share: a part ``1 - 1 / spread`` of the
    variance of a code. `AT_REST` frames then tell no more than ``1 / (1 + (AT_REST - 1) (1 - 1 / spread))`` of them
    would, the effective number of correlated samples (Kish 1965, section 5.4), so each counts with that power of its
    likelihood.

    Parameters
    ----------
    atlas : Atlas
        Atlas whose poses fill the hidden volume (``--inside centre``): the object could not cross gaps between them.
    step : float
        Standard deviation of the walk along each axis from frame to frame, metres.
    appear, vanish : float
        Probability, from frame to frame, that the object appears or vanishes.

    Raises
    ------
    NlosError
        If one of these is out of range, or the atlas is of an object of unknown size and albedo, or of an uncertain
        scene.
    """

    def __init__(self, atlas: Atlas, *, step: float, appear: float = 0.02, vanish: float = 0.02) -> None:
        if not step > 0.0:
            raise NlosError(f"step {step:g}: must be positive, metres from frame to frame")
        for name, value in (("appear", appear), ("vanish", vanish)):
            if not 0.0 < value < 1.0:
                raise NlosError(f"{name} {value:g}: must be a probability between 0 and 1")
        if atlas.unknown:
            raise NlosError(
                "atlas: is of an object of unknown size and albedo; track follows one made without --unknown"
            )
        if atlas.uncertain is not None:
            raise NlosError(
                "atlas: is of an uncertain scene, whose error all frames share; track follows one of a known scene "
                "(nlos-generate bulk without --uncertain)"
            )
        self.atlas = atlas
        self._power = 1.0 / (1.0 + (AT_REST - 1) * (1.0 - 1.0 / atlas.spread))
        self._appear, self._vanish = appear, vanish
        low, high = np.asarray(atlas.grid.lo), np.asarray(atlas.grid.hi)
        edge = max(high[0] - low[0], high[1] - low[1]) / _CELLS
        self._shape = tuple(int(n) for n in np.maximum(np.ceil((high - low) / edge - 1e-9), 1))
        places = np.clip(((atlas.positions - low) / edge).astype(int), 0, np.array(self._shape) - 1)
        cells = np.ravel_multi_index(tuple(places.T), self._shape)
        order = np.argsort(cells, kind="stable")
        self._cells, starts, counts = np.unique(cells[order], return_index=True, return_counts=True)
        self._moments = _Cells.of(atlas, np.split(order, starts[1:]))
        # The discrete Gaussian (Lindeberg 1990, equation 16) has the walk's variance even if its steps are short.
        spread = (step / edge) ** 2
        reach = np.arange(math.ceil(6.0 * math.sqrt(spread)) + 2)
        half = ive(reach, spread)
        self._kernel = np.concatenate([half[:0:-1], half]) / (2.0 * half.sum() - half[0])
        self._inside = np.zeros(int(np.prod(self._shape)))
        self._inside[self._cells] = 1.0
        self._at_first = counts / counts.sum()
        self.restart()
        # Steps out of the volume are not taken: their probability is distributed over the other steps.
        self._spread = np.maximum(self._walk(self._inside[self._cells]), 1e-12)

    def restart(self) -> None:
        """Forget all frames."""
        self._known, self._presence = self._at_first, 0.5

    def update(self, code: NDArray[np.float32]) -> Step:
        """Update with the code (k,) of a frame's picture, and return the posterior."""
        predicted = self._walk(self._known / self._spread)
        predicted /= predicted.sum()
        uniform = np.full(len(predicted), 1.0 / len(predicted))
        # An object that was absent, or has just vanished, may appear anywhere.
        appeared = (1.0 - self._presence * (1.0 - self._vanish)) * self._appear
        stayed = self._presence * (1.0 - self._vanish)
        present = appeared + stayed
        predicted = (stayed * predicted + appeared * uniform) / present
        logs, places = self._moments.weigh(code.astype(np.float64))
        logs *= self._power
        top = max(float(logs.max()), 0.0)
        joint = present * predicted * np.exp(logs - top)
        total = float(joint.sum())
        self._presence = total / (total + (1.0 - present) * math.exp(-top))
        self._known = joint / total if total > 0.0 else predicted
        mean = self._known @ places
        offsets = places - mean
        covariance = (
            np.einsum("n,nab->ab", self._known, self._moments.left) + (offsets * self._known[:, None]).T @ offsets
        )
        return Step(self._presence, self._known @ self._moments.voxels, mean, covariance)

    def _walk(self, known: Array) -> Array:
        """Probability of each cell after a random step."""
        volume = np.zeros(len(self._inside))
        volume[self._cells] = known
        moved = volume.reshape(self._shape)
        for axis in range(3):
            moved = convolve1d(moved, self._kernel, axis=axis, mode="constant")
        walked: Array = moved.ravel()[self._cells]
        return walked
