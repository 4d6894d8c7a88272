"""A moving object, frame by frame: what was known before it moved on, and what each new picture adds.

The hidden volume is cut into small cells, and the filter keeps the probability of each, and that there is nothing.
Between two frames the object walks at random; a frame's picture weighs the cells by how well the atlas' poses in each
explain it. That is the exact filter of the hidden Markov model (Rabiner 1989, equation 20) for this walk. Nothing is
assumed of the shape of what is known: an object may be in two places at once until a picture tells, and one that is
lost is found again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d
from scipy.special import ive

from classify.atlas import Atlas
from generator.spec import Array, NlosError

_CELLS = 15
"""Along the longer of the grid's horizontal edges: of 10 cm in the room."""


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
        One of these cannot be.
    """

    def __init__(self, atlas: Atlas, *, step: float, appear: float = 0.02, vanish: float = 0.02) -> None:
        if not step > 0.0:
            raise NlosError(f"step {step:g}: must be positive, metres from frame to frame")
        for name, value in (("appear", appear), ("vanish", vanish)):
            if not 0.0 < value < 1.0:
                raise NlosError(f"{name} {value:g}: must be a probability between 0 and 1")
        self.atlas = atlas
        self._appear, self._vanish = appear, vanish
        low, high = np.asarray(atlas.grid.lo), np.asarray(atlas.grid.hi)
        edge = max(high[0] - low[0], high[1] - low[1]) / _CELLS
        self._shape = tuple(int(n) for n in np.maximum(np.ceil((high - low) / edge - 1e-9), 1))
        places = np.clip(((atlas.positions - low) / edge).astype(int), 0, np.array(self._shape) - 1)
        cells = np.ravel_multi_index(tuple(places.T), self._shape)
        self._order = np.argsort(cells, kind="stable")
        self._cells, self._starts, counts = np.unique(cells[self._order], return_index=True, return_counts=True)
        self._ordered = atlas.take(self._order)
        self._share = 1.0 / counts
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
        logs = self._ordered.logs(code)
        top = max(float(logs.max()), 0.0)
        weights = np.exp(logs - top)
        likelihood = np.add.reduceat(weights, self._starts) * self._share
        joint = there * moved * likelihood
        seen = float(joint.sum())
        self._presence = seen / (seen + (1.0 - there) * float(np.exp(-top)))
        self._known = joint / seen if seen > 0.0 else moved
        return self._told(weights, likelihood)

    def _walk(self, known: Array) -> Array:
        """What a random step makes of the probability of each cell."""
        volume = np.zeros(len(self._inside))
        volume[self._cells] = known
        moved = volume.reshape(self._shape)
        for axis in range(3):
            moved = convolve1d(moved, self._kernel, axis=axis, mode="constant")
        walked: Array = moved.ravel()[self._cells]
        return walked

    def _told(self, weights: NDArray[np.float32], likelihood: Array) -> Step:
        atlas = self.atlas
        # Each pose has its part of its cell's probability.
        per_cell = np.divide(
            self._known * self._share, likelihood, out=np.zeros_like(likelihood), where=likelihood > 0
        )
        sizes = np.diff(np.append(self._starts, len(self._order)))
        shares = weights * np.repeat(per_cell, sizes)
        total = shares.sum()
        some = np.flatnonzero(shares > 1e-7 * shares.max(initial=0.0))
        of, share = self._order[some], shares[some] / total
        points = atlas.positions[of]
        mean = share @ points
        apart = points - mean
        voxels = np.bincount(atlas.voxels[of], share, atlas.grid.n_voxels).astype(np.float64)
        return Step(self._presence, voxels / voxels.sum(), mean, (apart * share[:, None]).T @ apart)
