"""A moving object, frame by frame: what was known before it moved on, and what each new picture adds.

The hidden volume is cut into small cells, and the filter keeps the probability of each, and that there is nothing.
Between two frames the object walks at random; a frame's picture weighs the cells. That is the filter of the hidden
Markov model (Rabiner 1989, equation 20) for this walk. Nothing is assumed of the shape of what is known: an object
may be in two places at once until a picture tells, and one that is lost is found again.

Within a cell, place and code are taken for jointly normal, by the moments of the atlas' poses there. For no pose of
the atlas is where the object is, and where a picture is sharp each of them alone would be as good as ruled out.
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
"""Along the longer of the grid's horizontal edges: of 10 cm in the room."""
_ENOUGH = 12
"""Poses that a cell's moments take at least, the nearest to its own if it has fewer."""
_WAYS = 8
"""In which codes differ within a cell, the strongest: three for the place, some for rotations."""


@dataclass(frozen=True)
class Step:
    """What is known after a frame.

    Attributes
    ----------
    presence : float
        Probability that there is something.
    voxels : ndarray of shape (n_voxels,)
        Probability of each, if there is.
    position : ndarray of shape (3,)
        Mean, metres, if there is.
    covariance : ndarray of shape (3, 3)
        m^2.
    """

    presence: float
    voxels: Array
    position: Array
    covariance: Array

    @property
    def found(self) -> bool:
        """Whether something is more probable than nothing."""
        return self.presence > 0.5


@dataclass(frozen=True)
class _Cells:
    """Moments of places and codes in each of n cells, r ways in which codes differ there.

    Attributes
    ----------
    means : ndarray of shape (n, k)
        Of the codes.
    ways : ndarray of shape (n, r, k)
        Orthonormal.
    strengths : ndarray of shape (n, r)
        Variance of the codes along each.
    places : ndarray of shape (n, 3)
        Means, metres.
    spreads : ndarray of shape (n, 3, 3)
        Covariances of the places, m^2.
    along : ndarray of shape (n, 3, r)
        Covariances of the places with the codes' ways.
    voxels : ndarray of shape (n, n_voxels)
        Share of each in a cell.
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
        """Return the moments of cells, given the numbers of the poses in each."""
        tree = cKDTree(atlas.positions)
        n, k, r = len(members), atlas.codes.shape[1], min(_WAYS, atlas.codes.shape[1])
        means, ways, strengths = np.zeros((n, k)), np.zeros((n, r, k)), np.zeros((n, r))
        places, spreads, along = np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, r))
        voxels = np.zeros((n, atlas.grid.n_voxels))
        least = min(_ENOUGH, len(atlas.codes))
        for cell, own in enumerate(members):
            voxels[cell] = np.bincount(atlas.voxels[own], minlength=atlas.grid.n_voxels) / len(own)
            some = own if len(own) >= least else tree.query(atlas.positions[own].mean(axis=0), least)[1]
            some = np.atleast_1d(some)
            root = math.sqrt(max(len(some) - 1, 1))
            codes, points = atlas.codes[some].astype(np.float64), atlas.positions[some]
            means[cell], places[cell] = codes.mean(axis=0), points.mean(axis=0)
            apart, offsets = (codes - means[cell]) / root, (points - places[cell]) / root
            left, sizes, right = np.linalg.svd(apart, full_matrices=False)
            kept = min(r, len(sizes))
            ways[cell, :kept], strengths[cell, :kept] = right[:kept], sizes[:kept] ** 2
            spreads[cell] = offsets.T @ offsets
            along[cell, :, :kept] = offsets.T @ (left[:, :kept] * sizes[:kept])
        return cls(means, ways, strengths, places, spreads, along, voxels)

    def weigh(self, code: Array) -> tuple[Array, Array]:
        """Return how much better each cell explains a picture than an empty scene, and the place if it is there.

        The logarithm of one normal density over another, the covariance's inverse and determinant by Woodbury's
        identity; and the mean of one normal variable given the other (Kay 1993, equation 10.24).

        Returns
        -------
        logs : ndarray of shape (n,)
        places : ndarray of shape (n, 3)
            Metres.
        """
        apart = self.ways @ code - np.einsum("nrk,nk->nr", self.ways, self.means)
        known = self.strengths / (1.0 + self.strengths)
        logs = self.means @ code - 0.5 * (self.means**2).sum(axis=1)
        logs += 0.5 * (known * apart**2).sum(axis=1) - 0.5 * np.log1p(self.strengths).sum(axis=1)
        moved = np.einsum("nar,nr->na", self.along, apart / (1.0 + self.strengths))
        return logs, self.places + moved

    @cached_property
    def left(self) -> Array:
        """Covariances of the places once the code is known, (n, 3, 3), m^2."""
        gained = np.einsum("nar,nr,nbr->nab", self.along, 1.0 / (1.0 + self.strengths), self.along)
        left: Array = self.spreads - gained
        return left


class Filter:
    """Follows one object.

    Parameters
    ----------
    atlas : Atlas
        Whose poses fill the hidden volume (``--inside centre``): between them the object could not pass.
    step : float
        Standard deviation of the walk along each axis from frame to frame, metres.
    appear, vanish : float
        Probability from frame to frame.

    Raises
    ------
    NlosError
        One of these cannot be, or the atlas is of an object of unknown size and albedo.
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
        self.atlas = atlas
        self._appear, self._vanish = appear, vanish
        low, high = np.asarray(atlas.grid.lo), np.asarray(atlas.grid.hi)
        edge = max(high[0] - low[0], high[1] - low[1]) / _CELLS
        self._shape = tuple(int(n) for n in np.maximum(np.ceil((high - low) / edge - 1e-9), 1))
        places = np.clip(((atlas.positions - low) / edge).astype(int), 0, np.array(self._shape) - 1)
        cells = np.ravel_multi_index(tuple(places.T), self._shape)
        order = np.argsort(cells, kind="stable")
        self._cells, starts, counts = np.unique(cells[order], return_index=True, return_counts=True)
        self._moments = _Cells.of(atlas, np.split(order, starts[1:]))
        # The discrete Gaussian (Lindeberg 1990, equation 16) has the walk's variance however short its steps are.
        spread = (step / edge) ** 2
        reach = np.arange(math.ceil(6.0 * math.sqrt(spread)) + 2)
        half = ive(reach, spread)
        self._kernel = np.concatenate([half[:0:-1], half]) / (2.0 * half.sum() - half[0])
        self._inside = np.zeros(int(np.prod(self._shape)))
        self._inside[self._cells] = 1.0
        self._known = counts / counts.sum()
        self._presence = 0.5
        # Where the walk would leave the volume it does not: the other steps take what that one would have.
        self._spread = np.maximum(self._walk(self._inside[self._cells]), 1e-12)

    def update(self, code: NDArray[np.float32]) -> Step:
        """Take a frame's picture, by its code (k,), and return what is known after it."""
        moved = self._walk(self._known / self._spread)
        moved /= moved.sum()
        fresh = np.full(len(moved), 1.0 / len(moved))
        # One that was gone, or has just gone, may be back anywhere.
        coming = (1.0 - self._presence * (1.0 - self._vanish)) * self._appear
        staying = self._presence * (1.0 - self._vanish)
        there = coming + staying
        moved = (staying * moved + coming * fresh) / there
        logs, places = self._moments.weigh(code.astype(np.float64))
        top = max(float(logs.max()), 0.0)
        joint = there * moved * np.exp(logs - top)
        seen = float(joint.sum())
        self._presence = seen / (seen + (1.0 - there) * math.exp(-top))
        self._known = joint / seen if seen > 0.0 else moved
        mean = self._known @ places
        apart = places - mean
        covariance = (
            np.einsum("n,nab->ab", self._known, self._moments.left) + (apart * self._known[:, None]).T @ apart
        )
        return Step(self._presence, self._known @ self._moments.voxels, mean, covariance)

    def _walk(self, known: Array) -> Array:
        """What a random step makes of the probability of each cell."""
        volume = np.zeros(len(self._inside))
        volume[self._cells] = known
        moved = volume.reshape(self._shape)
        for axis in range(3):
            moved = convolve1d(moved, self._kernel, axis=axis, mode="constant")
        walked: Array = moved.ravel()[self._cells]
        return walked
