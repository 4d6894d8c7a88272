"""Is something there? The evidence for a known object, against a threshold that empty scenes seldom reach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from classify.atlas import Atlas
from generator.spec import Array, NlosError

_POSES = 8192
"""Of the atlas, that share in the evidence: more change it by less than the noise does."""
_EMPTY = 20_000
_BLOCK = 256


def evidence(atlas: Atlas, codes: NDArray[np.float32]) -> Array:
    """Return how much more probable pictures are with the object somewhere than without, as logarithms, (n,).

    The likelihood ratio of the mixture of all poses: at a given rate of false alarms no other test finds the object
    more often, on average over the poses (Neyman and Pearson 1933).

    Parameters
    ----------
    atlas : Atlas
    codes : ndarray of shape (n, k)
        Of the pictures.
    """
    step = max(1, len(atlas.codes) // _POSES)
    some = atlas.take(slice(None, None, step))
    blocks = [codes[i : i + _BLOCK] for i in range(0, len(codes), _BLOCK)]
    logs = [logsumexp(some.logs(block), axis=1) for block in blocks]
    found: Array = np.concatenate(logs).astype(np.float64) - np.log(len(some.codes))
    return found


@dataclass(frozen=True)
class Detector:
    """Says whether there is something.

    Attributes
    ----------
    atlas : Atlas
    false_alarm : float
        Share of empty scenes in which it says so too.
    threshold : float
        Of the evidence, a logarithm.
    """

    atlas: Atlas
    false_alarm: float
    threshold: float

    @classmethod
    def at(cls, atlas: Atlas, false_alarm: float = 0.01, *, seed: int = 0) -> Detector:
        """Return the detector that a share of empty scenes alarms.

        The threshold is the quantile of the evidence in simulated empty scenes, whose codes are unit noise.

        Raises
        ------
        NlosError
            The rate is none, or so low that too few of the simulated scenes would reach it.
        """
        least = 20.0 / _EMPTY
        if not least <= false_alarm < 1.0:
            raise NlosError(f"false alarms {false_alarm:g}: must be a share from {least:g} to 1")
        rng = np.random.default_rng([seed, 4])
        empty = rng.normal(size=(_EMPTY, atlas.codes.shape[1])).astype(np.float32)
        return cls(atlas, false_alarm, float(np.quantile(evidence(atlas, empty), 1.0 - false_alarm)))

    def __call__(self, codes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return whether there is something in pictures with the codes (n, k), (n,)."""
        return evidence(self.atlas, codes) > self.threshold
