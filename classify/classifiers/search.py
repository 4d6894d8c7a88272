"""A search of settings whose candidates share what they have in common."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, ClassifierMixin, MetaEstimatorMixin, clone
from sklearn.metrics.pairwise import euclidean_distances
from sklearn.svm import SVC

_AXES = ("classify__C", "classify__gamma", "scale")
"""Parameters of the estimator, in the order of their names, as the candidates of `GridSearchCV` are."""


class KernelSearch(ClassifierMixin, MetaEstimatorMixin, BaseEstimator):  # type: ignore[misc]
    """Grid search for a scaler and a support vector machine with RBF kernel, which computes a kernel once for all C.

    It chooses what `sklearn.model_selection.GridSearchCV` chooses, and fits that to all samples the same way. Takes
    the memory of four kernels, each 8 bytes for each pair of samples.

    Parameters
    ----------
    estimator : Pipeline
        Its steps are ``scale`` and ``classify``.
    param_grid : dict
        Lists of scalers (``scale``), of C (``classify__C``) and of gamma (``classify__gamma``). The kernel is
        exp(-gamma |a - b|^2); "scale" is 1 / (number of features x their variance).
    cv : cross-validator

    Attributes
    ----------
    scores_ : ndarray of shape (C, gamma, scalers)
        Mean accuracy of each candidate in the cross-validation.
    best_params_ : dict
        Chosen settings of the estimator: the first of the best.
    best_estimator_ : Pipeline
        Fitted with them to all samples.
    classes_ : ndarray of shape (n_classes,)
    """

    def __init__(self, estimator: Any, param_grid: dict[str, list[Any]], *, cv: Any) -> None:
        self.estimator = estimator
        self.param_grid = param_grid
        self.cv = cv

    def fit(self, x: NDArray[np.float64], y: NDArray[Any]) -> KernelSearch:
        """Choose settings by cross-validation, and fit a clone of the estimator with them to all samples."""
        folds = self.cv.split(x, y)
        self.scores_ = np.mean([self._scores(x[train], y[train], x[test], y[test]) for train, test in folds], axis=0)
        best = np.unravel_index(self.scores_.argmax(), self.scores_.shape)
        self.best_params_ = {name: self.param_grid[name][i] for name, i in zip(_AXES, best, strict=True)}
        self.best_estimator_ = clone(clone(self.estimator).set_params(**self.best_params_)).fit(x, y)
        self.classes_ = self.best_estimator_.classes_
        return self

    def predict(self, x: NDArray[np.float64]) -> NDArray[Any]:
        """Return the class of each sample."""
        classes: NDArray[Any] = self.best_estimator_.predict(x)
        return classes

    def _scores(self, x: Any, y: Any, x_test: Any, y_test: Any) -> NDArray[np.float64]:
        """Accuracy on samples to test, of each setting; the axes are `_AXES`."""
        penalties, gammas, scalers = (self.param_grid[name] for name in _AXES)
        scores = np.empty((len(penalties), len(gammas), len(scalers)))
        for k, scaler in enumerate(scalers):
            fitted = clone(scaler).fit(x)
            known, asked = fitted.transform(x), fitted.transform(x_test)
            apart, apart_asked = (euclidean_distances(rows, known, squared=True) for rows in (known, asked))
            for j, gamma in enumerate(gammas):
                rate = _scale(known) if gamma == "scale" else gamma
                kernel, kernel_asked = np.exp(-rate * apart), np.exp(-rate * apart_asked)
                for i, penalty in enumerate(penalties):
                    machine = SVC(kernel="precomputed", C=penalty).fit(kernel, y)
                    scores[i, j, k] = machine.score(kernel_asked, y_test)
        return scores


def _scale(x: NDArray[np.float64]) -> float:
    """The gamma that `sklearn.svm.SVC` calls "scale"."""
    variance = float(x.var())
    return 1.0 / (x.shape[1] * variance) if variance else 1.0
