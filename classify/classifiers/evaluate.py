"""Folds, scenarios, and metrics with confidence intervals."""

from __future__ import annotations

import pickle
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student
from sklearn.exceptions import ConvergenceWarning
from sklearn.metrics import confusion_matrix
from sklearn.model_selection import StratifiedKFold

from classify.classifiers import models
from classify.classifiers.models import Settings
from classify.classifiers.names import NAMES
from classify.intervals import Interval, paired_difference, score_interval, wilson
from classify.pictures.feature_table import Features, check_comparable
from classify.pictures.leak import refuse_shared
from generator.model.errors import NlosError

Array = NDArray[np.float64]

_RESAMPLES = 2000


@dataclass(frozen=True)
class Result:
    """One classifier in one scenario.

    Attributes
    ----------
    train, test : str
        What it was trained and tested on, as `target_names` names it.
    classifier, settings : str
    labels : list of str
        The classes, in voxel order.
    confusion : ndarray of shape (n_classes, n_classes)
        Rows are the truth, columns the prediction.
    right : ndarray of shape (n,)
        Whether each tested picture was put into its voxel; all results of a scenario have the same order.
    folds : list of float
        Accuracy per fold; one entry where all of one set was tested.
    accuracy, precision, recall, f1 : Interval
        All but the accuracy are means over the classes.
    train_seconds : float
        Mean time per fit, including the search.
    predict_seconds : float
        Time per picture.
    chosen : list of dict
        Settings that the search chose, per fit.
    unconverged : int
        Number of fits that ended before they converged.
    """

    train: str
    test: str
    classifier: str
    settings: str
    labels: list[str]
    confusion: NDArray[np.int64]
    right: NDArray[np.bool_]
    folds: list[float]
    accuracy: Interval
    precision: Interval
    recall: Interval
    f1: Interval
    train_seconds: float
    predict_seconds: float
    chosen: list[dict[str, str]] = field(default_factory=list)
    unconverged: int = 0

    @property
    def scenario(self) -> str:
        """The scenario in words."""
        return self.train if self.train == self.test else f"{self.train} -> {self.test}"

    @property
    def effect(self) -> float:
        """See `design_effect`."""
        return design_effect(len(self.folds))


def rivals(results: Sequence[Result], best: Result) -> list[Result]:
    """Return the results of the same scenario that the tested pictures do not tell apart from the best.

    The difference is taken picture by picture (`classify.intervals.paired_difference`); its interval holds 0. Any of
    them could have been the best, so the intervals of all pairs hold together in 95 % (Hochberg and Tamhane 1987).
    """
    peers = [r for r in results if r.scenario == best.scenario]
    among, effect = len(peers), best.effect
    return [r for r in peers if r is not best and not told_apart(best.right, r.right, among=among, effect=effect)]


def told_apart(best: NDArray[np.bool_], other: NDArray[np.bool_], *, among: int, effect: float = 1.0) -> bool:
    """Return whether the best of a number of classifiers is certainly better than another, on the same pictures."""
    return paired_difference(best, other, of=among * (among - 1) // 2, effect=effect).low > 0.0


def as_best(right: NDArray[np.bool_], *, among: int, effect: float = 1.0) -> Interval:
    """Return the accuracy of the best of a number of classifiers, with an interval that allows for this choice.

    Since it is the best, its interval lies too high, if anything: only the lower ends of all have to hold together.
    """
    return wilson(int(right.sum()), len(right), of=max(1.0, among / 2.0), effect=effect)


def design_effect(folds: int) -> float:
    """Return the variance of an accuracy over that of independent answers; 1 where another set is tested.

    In k folds a picture is tested by classifiers that learnt from the others. So the variance of a mean over folds is
    not 1/k of a fold's but 1/k + 1/(k - 1), where the share that is tested over that which is learnt from is added
    (Nadeau and Bengio 2003). It holds for a method that learns from further pictures too. Some methods vary less, but
    nothing in one set tells which (Bengio and Grandvalet 2004).
    """
    return 1.0 + folds / (folds - 1.0) if folds > 1 else 1.0


def macro_scores(confusion: Array) -> Array:
    """Return precision, recall and F1, each averaged over the classes (paper, eq. 1 to 3).

    Parameters
    ----------
    confusion : ndarray of shape (..., n_classes, n_classes)
        Rows are the truth. A class that is never predicted has precision 0.

    Returns
    -------
    ndarray of shape (3, ...)
    """
    hits = np.diagonal(confusion, axis1=-2, axis2=-1)
    predicted, true = confusion.sum(axis=-2), confusion.sum(axis=-1)
    precision = hits / np.maximum(predicted, 1)
    recall = hits / np.maximum(true, 1)
    f1 = 2 * hits / np.maximum(predicted + true, 1)
    present = np.maximum((true > 0).sum(axis=-1), 1)
    scores: Array = np.stack([(s * (true > 0)).sum(axis=-1) / present for s in (precision, recall, f1)])
    return scores


def intervals(confusion: NDArray[np.int64], seed: int = 0, effect: float = 1.0) -> list[Interval]:
    """Return macro precision, recall and F1 with 95 % intervals, given the design effect of the answers.

    Score intervals (Wilson 1927) for an effective number of pictures: the number for which a proportion would have
    the variance that the score has (Korn and Graubard 1998). Percentiles of a bootstrap cover the truth too rarely
    where few pictures are wrong, and never where none is; so the variance is that of resampling rows which are mixed
    with one picture's worth of the average row (right as often as all pictures are, wrong ones spread evenly).
    Student's t takes the place of the normal distribution, since this variance is an estimate.
    """
    rng = np.random.default_rng(seed)
    counts = confusion.sum(axis=1)
    total, classes, present = int(counts.sum()), len(confusion), int((counts > 0).sum())
    right = (float(np.trace(confusion)) + 0.5) / (total + 1.0)
    average = np.full(confusion.shape, (1.0 - right) / max(classes - 1, 1))
    np.fill_diagonal(average, right if classes > 1 else 1.0)
    drawn = np.zeros((_RESAMPLES, *confusion.shape), dtype=np.int64)
    for i in np.flatnonzero(counts):
        row = (confusion[i] + average[i]) / (counts[i] + 1.0)
        drawn[:, i] = rng.multinomial(counts[i], row / row.sum(), size=_RESAMPLES)
    resampled = macro_scores(drawn.astype(np.float64))
    # Resampling rows that are estimated themselves makes the variance too small by this factor.
    freedom = max(total - present, 1)
    variance = resampled.var(axis=1) * total / freedom
    mean = resampled.mean(axis=1)
    effective = np.where(variance > 0.0, mean * (1.0 - mean) / np.maximum(variance, 1e-12), total)
    effective = np.maximum(effective / effect, 1.0)
    values = macro_scores(confusion.astype(np.float64))
    z = float(student.ppf(0.975, freedom))
    return [score_interval(float(v), float(n), z) for v, n in zip(values, effective, strict=True)]


def compare(
    sets: Sequence[Features],
    names: Sequence[str],
    *,
    classifiers: Sequence[str] = tuple(NAMES),
    settings: Sequence[Settings] = ("paper", "tuned"),
    folds: int = 10,
    seed: int = 0,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> list[Result]:
    """Compare the classifiers in every scenario that one or two data sets allow.

    Parameters
    ----------
    sets : sequence of one or two Features
    names : sequence of str
        File names of the sets, for messages.
    classifiers, settings : sequence of str
    folds : int
        Number of stratified folds; the scaler and the search see only the training part of each.
    seed : int
        Seed of the folds, the classifiers and the bootstrap.
    progress : callable
        Called with (done, total, description of the next classifier).

    Returns
    -------
    list of Result
        Each set cross-validated; then training on all of one set and testing on all of the other, both ways.

    Raises
    ------
    NlosError
        If the sets do not belong together or are the same file, a class has too few samples for the folds, all
        features are constant, or the seed is out of range.
    """
    models.check_seed(seed)
    if len(sets) == 2:
        if names[0] == names[1]:
            raise NlosError(f"{names[0]}: is the same file twice; name one, or two different ones")
        check_comparable(sets[0], sets[1], (names[0], names[1]))
        refuse_shared(sets[0].positions, sets[1].positions, names[0], names[1])
    for features, name in zip(sets, names, strict=True):
        try:
            models.check_folds(features.labels, folds, settings)
            models.check_varied(features)
        except NlosError as error:
            raise NlosError(f"{name}: {error}") from None
    pairs = [(i, i) for i in range(len(sets))] + [
        (i, j) for i in range(len(sets)) for j in range(len(sets)) if i != j
    ]
    kinds = target_names(sets, names)
    jobs = [(i, j, c, s) for i, j in pairs for c in classifiers for s in settings]
    splits = {(i, j): _splits(sets[i], sets[j], folds if i == j else 1, seed) for i, j in pairs}
    tasks = (
        joblib.delayed(fit_and_test)(
            models.make(classifier, setting, sets[i].settings.set, len(train_rows), seed=seed),
            sets[i].values[train_rows],
            sets[i].labels[train_rows],
            sets[j].values[test_rows],
            sets[j].labels[test_rows],
        )
        for i, j, classifier, setting in jobs
        for train_rows, test_rows in splits[i, j]
    )
    results = []
    with joblib.Parallel(n_jobs=-1, return_as="generator") as parallel:  # no core waits for a classifier's last fold
        fits = parallel(tasks)
        for done, (i, j, classifier, setting) in enumerate(jobs):
            progress(done, len(jobs), f"{kinds[i]} -> {kinds[j]}: {classifier}, {setting}")
            of_this = list(islice(fits, len(splits[i, j])))
            results.append(
                _summarise(of_this, kinds[i], kinds[j], classifier, setting, _classes(sets[i], sets[j]), seed)
            )
    progress(len(jobs), len(jobs), "done")
    return results


def cross_validated(
    features: Features,
    classifier: str,
    settings: Settings,
    *,
    most_folds: int = 10,
    seed: int = 0,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> Result:
    """Cross-validate one classifier on a set, as `compare` does.

    Parameters
    ----------
    features : Features
    classifier, settings : str
    most_folds : int
        Number of stratified folds; fewer are taken where a class has fewer samples.
    seed : int
        Seed of the folds, the classifier and the bootstrap.
    progress : callable
        Called with (folds done, folds in all, "").

    Raises
    ------
    NlosError
        As for `compare`.
    """
    models.check_seed(seed)
    rarest = int(np.unique(features.labels, return_counts=True)[1].min())
    folds = max(2, min(most_folds, rarest))
    models.check_folds(features.labels, folds, [settings])
    models.check_varied(features)
    tasks = (
        joblib.delayed(fit_and_test)(
            models.make(classifier, settings, features.settings.set, len(train_rows), seed=seed),
            features.values[train_rows],
            features.labels[train_rows],
            features.values[test_rows],
            features.labels[test_rows],
        )
        for train_rows, test_rows in _splits(features, features, folds, seed)
    )
    fits = []
    progress(0, folds, "")
    with joblib.Parallel(n_jobs=-1, return_as="generator") as parallel:
        for fit in parallel(tasks):
            fits.append(fit)
            progress(len(fits), folds, "")
    name = features.contents
    return _summarise(fits, name, name, classifier, settings, _classes(features), seed)


def _splits(
    train: Features, test: Features, folds: int, seed: int
) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Rows to train and to test on, fold by fold; with one fold, all of both sets."""
    if folds == 1:
        return [(np.arange(len(train.labels)), np.arange(len(test.labels)))]
    splitter = StratifiedKFold(folds, shuffle=True, random_state=seed)
    return list(splitter.split(train.values, train.labels))


def target_names(sets: Sequence[Features], names: Sequence[str]) -> list[str]:
    """Return names for the sets: what they show, or their file names if two show the same."""
    kinds = [features.contents for features in sets]
    return kinds if len(set(kinds)) == len(kinds) else list(names)


def _classes(*sets: Features) -> list[str]:
    present = set().union(*(set(map(str, f.labels)) for f in sets))
    order = {label: k for k, label in enumerate(sets[0].grid.labels)}
    return sorted(present, key=lambda label: [order[name] for name in label.split("+")])


def fit_and_test(model: Any, x: Array, y: Any, x_test: Array, y_test: Any) -> dict[str, Any]:
    """Fit a classifier, predict other pictures, and return truth, predictions, times, size and chosen settings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        start = time.perf_counter()
        model.fit(x, y)
        fit_end = time.perf_counter()
        predicted = model.predict(x_test)
        end = time.perf_counter()
    return {
        "truth": y_test,
        "predicted": predicted,
        "train_seconds": fit_end - start,
        "predict_seconds": end - fit_end,
        "bytes": len(pickle.dumps(model)),
        "chosen": models.chosen(model),
        "unconverged": sum(issubclass(w.category, ConvergenceWarning) for w in caught),
    }


def _summarise(
    fits: list[dict[str, Any]], train: str, test: str, classifier: str, settings: str, labels: list[str], seed: int
) -> Result:
    truth = np.concatenate([f["truth"] for f in fits])
    predicted = np.concatenate([f["predicted"] for f in fits])
    confusion = confusion_matrix(truth, predicted, labels=labels)
    effect = design_effect(len(fits))
    precision, recall, f1 = intervals(confusion, seed, effect)
    return Result(
        train=train,
        test=test,
        classifier=classifier,
        settings=settings,
        labels=labels,
        confusion=confusion,
        right=truth == predicted,
        folds=[float(np.mean(f["truth"] == f["predicted"])) for f in fits],
        accuracy=wilson(int(np.trace(confusion)), int(confusion.sum()), effect=effect),
        precision=precision,
        recall=recall,
        f1=f1,
        train_seconds=float(np.mean([f["train_seconds"] for f in fits])),
        predict_seconds=float(sum(f["predict_seconds"] for f in fits) / len(truth)),
        chosen=[f["chosen"] for f in fits if f["chosen"]],
        unconverged=sum(f["unconverged"] for f in fits),
    )
