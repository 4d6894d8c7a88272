"""How familiar a picture is to a trained classifier: whether anything like it was among what it learnt from.

A classifier divides all of the space of features among the voxels, and is often surest where it has seen nothing. So
a model keeps where its training pictures lie, and says how rare one as far away as a new picture would be among them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.covariance import LedoitWolf
from sklearn.model_selection import StratifiedKFold

from classify.tail import Tail
from generator.model.arrays import Array

FEWEST = 50
"""Training pictures from which on one can say what is rare."""
_FOLDS = 5
_MOST, _SHARE, _EACH = 24, 0.999, 10
"""Most directions, the share of the features' variance that they hold, and training pictures for each of them."""
_KEPT = 10_000
_SMALLEST = 1e-12


@dataclass(frozen=True)
class _Space:
    """Where the features of pictures lie: directions in which they vary, and the voxels' means along these.

    What the directions leave out counts by its size, as a further direction.
    """

    centre: Array
    scale: Array
    directions: Array
    rest: Array
    means: Array
    precision: Array

    @classmethod
    def of(cls, values: Array, labels: NDArray[Any]) -> _Space:
        centre, scale = values.mean(axis=0), values.std(axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        scaled = (values - centre) / scale
        _, strengths, directions = np.linalg.svd(scaled, full_matrices=False)
        held = np.cumsum(strengths**2) / max(float((strengths**2).sum()), _SMALLEST)
        count = min(1 + int((held < _SHARE).sum()), _MOST, max(1, len(values) // _EACH))
        directions = directions[:count]
        sizes = _log_rest(scaled, directions)
        rest = np.array([sizes.mean(), max(float(sizes.std()), _SMALLEST)])
        points = np.column_stack([scaled @ directions.T, (sizes - rest[0]) / rest[1]])
        classes, which = np.unique(labels, return_inverse=True)
        means = np.array([points[which == k].mean(axis=0) for k in range(len(classes))])
        return cls(
            centre,
            scale,
            directions,
            rest,
            means,
            LedoitWolf(assume_centered=True).fit(points - means[which]).precision_,
        )

    def distances(self, values: Array) -> Array:
        """Return the squared Mahalanobis distance from the nearest voxel's mean, (n,)."""
        scaled = (values - self.centre) / self.scale
        sizes = (_log_rest(scaled, self.directions) - self.rest[0]) / self.rest[1]
        points = np.column_stack([scaled @ self.directions.T, sizes])
        apart = points[:, None] - self.means
        distances: Array = np.einsum("nki,ij,nkj->nk", apart, self.precision, apart).min(axis=1)
        return distances


def _log_rest(scaled: Array, directions: Array) -> Array:
    rest = scaled - scaled @ directions.T @ directions
    logs: Array = np.log(np.linalg.norm(rest, axis=1) + _SMALLEST)
    return logs


@dataclass(frozen=True)
class Familiar:
    """What is familiar to a classifier.

    Attributes
    ----------
    space : _Space
    known : ndarray of shape (n,)
        Distances of training pictures from the space of the others (five-fold cross-validation).
    """

    space: _Space
    known: Array

    @classmethod
    def of(cls, values: Array, labels: NDArray[Any], *, seed: int = 0) -> Familiar | None:
        """Return what is familiar after training on features (n, k); None if there are too few to say."""
        if len(values) < FEWEST:
            return None
        folds = StratifiedKFold(_FOLDS, shuffle=True, random_state=seed)
        known = [_Space.of(values[a], labels[a]).distances(values[b]) for a, b in folds.split(values, labels)]
        some = np.random.default_rng(seed).permutation(np.concatenate(known))[:_KEPT]
        return cls(_Space.of(values, labels), some)

    @cached_property
    def _tail(self) -> Tail:
        return Tail(self.known)

    def probability(self, row: Array) -> float:
        """Return how probable features (k,) as far from those of the training are among these."""
        return self._tail.exceeded(float(self.space.distances(row[None])[0]))

    def arrays(self) -> dict[str, Array]:
        """Return all that a file must keep."""
        return {**vars(self.space), "known": self.known}

    @classmethod
    def from_arrays(cls, arrays: dict[str, Array], n_features: int) -> Familiar:
        """Return what `arrays` gave; ValueError if the arrays do not fit together."""
        fields = {name: np.asarray(arrays[name], dtype=np.float64) for name in (*_Space.__annotations__, "known")}
        count = len(fields["directions"]) + 1
        shapes = {
            "centre": (n_features,),
            "scale": (n_features,),
            "directions": (count - 1, n_features),
            "rest": (2,),
            "means": (len(fields["means"]), count),
            "precision": (count, count),
            "known": (len(fields["known"]),),
        }
        if any(fields[name].shape != shape for name, shape in shapes.items()):
            raise ValueError("what is familiar to it does not fit together")
        if not all(np.isfinite(value).all() for value in fields.values()) or not len(fields["means"]):
            raise ValueError("what is familiar to it is no place")
        if len(fields["known"]) < FEWEST or (fields["scale"] <= 0.0).any() or fields["rest"][1] <= 0.0:
            raise ValueError("what is familiar to it is too little")
        known = fields.pop("known")
        return cls(_Space(**fields), known)
