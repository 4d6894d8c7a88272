"""Learning curves: accuracy against the number of training pictures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import joblib
import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import train_test_split

from classify.classifiers import models
from classify.classifiers.evaluate import fit_and_test, told_apart
from classify.classifiers.models import Settings
from classify.classifiers.names import ALL, NAMES
from classify.intervals import Interval, wilson
from classify.pictures.feature_table import Features, check_comparable
from classify.pictures.leak import refuse_shared
from generator.measure import figures
from generator.model.errors import NlosError

HELD_OUT = 0.2
"""Share of a set that is held out for testing if there is no test set."""

_LADDER = [n * 10**k for k in range(1, 7) for n in (1, 3)]


@dataclass(frozen=True)
class Point:
    """Result of a classifier that was trained on a given number of pictures.

    Attributes
    ----------
    classifier : str
    count : int
        Number of training pictures.
    accuracy : Interval
    train_seconds, predict_seconds : float
        Time of the fit, and time per predicted picture.
    size : int
        Bytes of the trained model.
    unconverged : bool
        Whether the fit ended before it converged.
    right : ndarray of shape (n,)
        Whether each tested picture was put into its voxel; all points of a curve have the same order.
    """

    classifier: str
    count: int
    accuracy: Interval
    train_seconds: float
    predict_seconds: float
    size: int
    unconverged: bool
    right: NDArray[np.bool_]


def curves(
    train: Features,
    test: Features | None = None,
    *,
    classifiers: Sequence[str] = tuple(NAMES),
    settings: Settings = "paper",
    counts: Sequence[int] = (),
    seed: int = 0,
    names: tuple[str, str] = ("training set", "test set"),
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> list[Point]:
    """Train classifiers on nested subsets of growing size of a set, and test each.

    Parameters
    ----------
    train : Features
    test : Features, optional
        Features of other pictures; without them, a fifth of the training set is held out.
    classifiers : sequence of str
    settings : {"paper", "tuned"}
    counts : sequence of int
        Numbers of training pictures. Default: those of 10, 30, 100, ... that allow two pictures of every class (three
        for "tuned"), and the whole set.
    seed : int
        Seed of the order of the pictures and of the classifiers.
    names : (str, str)
        Names of both sets, for messages.
    progress : callable
        Called with (done, total, description) after each fit.

    Raises
    ------
    NlosError
        If the sets do not belong together, there is only one class, or a number is out of range.
    """
    models.check_seed(seed)
    models.check_varied(train)
    tested = train if test is None else test
    if test is not None:
        check_comparable(train, test, names)
        if train.provenance.get("fingerprint") == test.provenance.get("fingerprint"):
            raise NlosError(f"{names[1]}: shows the pictures of {names[0]}; leave it out to hold some of them out")
        refuse_shared(train.positions, test.positions, *names)
    order, held_out = _order(train, seed, hold=test is None)
    test_rows = np.arange(len(tested.labels)) if test is not None else held_out
    classes = len(np.unique(train.labels))
    need = models.INNER_FOLDS if settings == "tuned" else 2
    if not counts:
        counts = sorted({n for n in (*_LADDER, len(order)) if need * classes <= n <= len(order)})
    for count in counts:
        if not need * classes <= count <= len(order):
            raise NlosError(
                f"{count} pictures: {names[0]} has {len(order)} to train on, and {classes} classes need {need} each"
            )
    jobs = [(name, count) for count in counts for name in classifiers]
    points = []
    with joblib.Parallel(n_jobs=-1, return_as="generator") as parallel:
        fits = parallel(
            joblib.delayed(fit_and_test)(
                models.make(name, settings, train.settings.set, count, seed=seed),
                train.values[order[:count]],
                train.labels[order[:count]],
                tested.values[test_rows],
                tested.labels[test_rows],
            )
            for name, count in jobs
        )
        for done, ((name, count), fit) in enumerate(zip(jobs, fits, strict=True)):
            progress(done + 1, len(jobs), f"{name}, {count} pictures")
            right = fit["truth"] == fit["predicted"]
            points.append(
                Point(
                    classifier=name,
                    count=count,
                    accuracy=wilson(int(right.sum()), len(right)),
                    train_seconds=fit["train_seconds"],
                    predict_seconds=fit["predict_seconds"] / len(test_rows),
                    size=fit["bytes"],
                    unconverged=bool(fit["unconverged"]),
                    right=right,
                )
            )
    return points


def _order(features: Features, seed: int, *, hold: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of the training pictures, in an order in which classes take turns, and of those held out."""
    indices = np.arange(len(features.labels))
    models.check_classes(features.labels, 3)
    held_out = indices[:0]
    if hold:
        count = max(math.ceil(HELD_OUT * len(indices)), len(np.unique(features.labels)))  # at least one of each class
        indices, held_out = train_test_split(indices, test_size=count, stratify=features.labels, random_state=seed)
    rng = np.random.default_rng([seed, 8])
    shuffled = rng.permutation(indices)
    rank = np.zeros(len(shuffled), dtype=np.int64)
    for label in np.unique(features.labels):
        members = features.labels[shuffled] == label
        rank[members] = np.arange(members.sum())
    return shuffled[np.argsort(rank, kind="stable")], held_out


def rows(points: Sequence[Point]) -> list[tuple[str, ...]]:
    """Return a table with a row for each classifier and number of pictures."""
    ordered = sorted(points, key=lambda point: (list(ALL).index(point.classifier), point.count))
    return [
        (
            p.classifier,
            str(p.count),
            p.accuracy.percent() + (" (not converged)" if p.unconverged else ""),
            f"{p.train_seconds:.3g} s",
            f"{1e6 * p.predict_seconds:.3g} us",
            f"{p.size / 1e3:.3g} kB",
        )
        for p in ordered
    ]


HEADINGS = ("classifier", "trained on", "right voxel", "training", "answer, each", "model")


def rivals(points: Sequence[Point], best: Point) -> list[str]:
    """Return the other classifiers that the tested pictures do not tell apart from the best, with their accuracy."""
    named: dict[str, Point] = {}
    for point in sorted(points, key=lambda p: -p.accuracy.value):
        if point.classifier != best.classifier and not told_apart(best.right, point.right, among=len(points)):
            named.setdefault(point.classifier, point)
    return [f"{p.classifier} on {p.count} ({100.0 * p.accuracy.value:.1f} %)" for p in named.values()]


@figures.styled
def draw(path: Path, points: Sequence[Point], title: str) -> None:
    """Write a figure: accuracy against the number of pictures, and against the training time."""
    figure, [axes] = figures.subplots(1, 2, size=(figures.WIDTH, 3.8), sharey=True)
    names = list(dict.fromkeys(p.classifier for p in points))
    aside = np.geomspace(0.96, 1.04, len(names)) if len(names) > 1 else np.ones(1)  # or the intervals hide each other
    for name, marker, shift in zip(names, cycle(figures.MARKERS), aside):
        pts = sorted((p for p in points if p.classifier == name), key=lambda p: p.count)
        value, low, high = (np.array([100.0 * getattr(p.accuracy, k) for p in pts]) for k in ("value", "low", "high"))
        counts, seconds = [p.count * shift for p in pts], [max(p.train_seconds, 1e-4) for p in pts]
        spread = [value - low, high - value]
        for axis, x in zip(axes, (counts, seconds), strict=True):
            axis.errorbar(x, value, yerr=spread, marker=marker, ms=4, lw=1.2, capsize=2, label=name)
    for axis, label in zip(axes, ("pictures to train on", "seconds that training took"), strict=True):
        axis.set_xscale("log")
        figures.plain_numbers(axis.xaxis)
        axis.set_xlabel(label)
    axes[0].set_ylabel("right voxel, %")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(names))
    figure.suptitle(title)
    figures.save(path, figure)
