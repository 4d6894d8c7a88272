"""Benefit of better pictures: answers for the same poses, rendered in every way from the fastest to the best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from classify.inference import evaluation
from classify.inference.atlas import Atlas
from classify.inference.detect import Detector
from classify.intervals import Interval, median, share
from generator.measure import figures, intervals
from generator.measure.tradeoff import REFERENCE, family, rungs
from generator.model.arrays import Array


@dataclass(frozen=True)
class Worth:
    """Quality of the answers for one way to render.

    Attributes
    ----------
    name : str
    seconds : float
        Core seconds per picture.
    accuracy : Interval
        Share of pictures that are put into the right voxel.
    error : Interval
        Median error of the position, metres.
    detected : Interval
        Share of pictures in which an object is found.
    count : int
        Number of answers: pictures times noise realisations of the sensor.
    right : ndarray of shape (pictures,)
        Share of the answers to each picture that name its voxel; in the order of the poses, the same for all ways.
    """

    name: str
    seconds: float
    accuracy: Interval
    error: Interval
    detected: Interval
    count: int
    right: Array


def worths(
    folder: Path,
    atlas: Atlas,
    *,
    false_alarm: float = 0.01,
    noises: int = 5,
    seed: int = 0,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> list[Worth]:
    """Evaluate the pictures of ``nlos-generate tradeoff``, as seen by the atlas' sensor; the reference comes first.

    Answers to the same picture are not independent, so intervals are by picture (`classify.intervals.grouped`).

    Parameters
    ----------
    folder : Path
    atlas : Atlas
        Atlas of the same scene.
    false_alarm : float
        Share of empty scenes in which an object may be found.
    noises : int
        Number of noise realisations of the sensor for each picture.
    seed : int
        Seed of this noise.
    progress : callable
        Called with (done, total, name of the next way).

    Raises
    ------
    NlosError
        If the folder holds no finished data sets, or they are of another scene than the atlas.
    """
    sets = rungs(folder)
    detectors = [Detector.at(atlas, false_alarm, seed=seed + number) for number in range(noises)]
    results = []
    for done, dataset in enumerate(sets):
        progress(done, len(sets), dataset.path.name)
        answers = [
            evaluation.run(atlas, dataset, seed=seed + number, empty=0, detector=detector)
            for number, detector in enumerate(detectors)
        ]
        correct, detected, errors = (
            np.concatenate([getattr(a, name) for a in answers]) for name in ("right", "found", "errors")
        )
        pictures = np.tile(np.arange(len(dataset.records)), noises)
        results.append(
            Worth(
                name=dataset.path.name,
                seconds=float(np.mean([record.seconds for record in dataset.records])),
                accuracy=share(correct, pictures),
                error=median(errors, pictures),
                detected=share(detected, pictures),
                count=len(correct),
                right=correct.reshape(noises, -1).mean(axis=0),
            )
        )
    progress(len(sets), len(sets), "done")
    return [results[0], *sorted(results[1:], key=lambda worth: worth.seconds)]


HEADINGS = ("way", "core s a picture", "right voxel", "median error", "detected")


def rows(found: Sequence[Worth]) -> list[tuple[str, ...]]:
    """Return a table with a row for each way to render."""
    return [
        (w.name, f"{w.seconds:.3g}", w.accuracy.percent(), w.error.centimetres(), w.detected.percent()) for w in found
    ]


def enough(found: Sequence[Worth]) -> list[str]:
    """Return sentences that say, for each engine, from which way on rendering noise no longer matters.

    A way loses if its answers, picture by picture, are right less often than the reference's, by Student's t.
    """
    reference = next(w for w in found if w.name == REFERENCE)
    sentences = [f"Without noise of rendering, {reference.accuracy.percent()} are put into the right voxel."]
    for engine in ("surfel", "patch", "path"):
        candidates = [w for w in found if family(w.name) == engine]
        good = [w for w in candidates if intervals.mean(w.right - reference.right)[2] >= 0.0]
        if good:
            first = min(good, key=lambda w: w.seconds)
            sentences.append(f"{engine}: what {first.name} ({first.seconds:.3g} core seconds) loses cannot be told.")
        elif candidates:
            best = max(candidates, key=lambda w: (w.accuracy.value, w.seconds))
            sentences.append(f"{engine}: even {best.name} loses: {best.accuracy.percent()}.")
    return sentences


@figures.styled
def draw(found: Sequence[Worth], title: str) -> Figure:
    """Return a figure: right voxels and median error against the rendering time; the reference as a line."""
    figure, [axes] = figures.subplots(1, 2, size=(figures.WIDTH, 4.0))
    others = [w for w in found if w.name != REFERENCE]
    reference = next(w for w in found if w.name == REFERENCE)
    for axis, name, scale, label in zip(
        axes, ("accuracy", "error"), (100.0, 100.0), ("right voxel, %", "median error, cm"), strict=True
    ):
        exact = getattr(reference, name)
        axis.axhspan(scale * exact.low, scale * exact.high, color=figures.GREY, alpha=0.15, lw=0)
        axis.axhline(scale * exact.value, color=figures.GREY, lw=1.0, ls=":", label="without noise of rendering")
        for kind, marker in zip(sorted({family(w.name) for w in others}), cycle(figures.MARKERS)):
            ways = [w for w in others if family(w.name) == kind]
            value, low, high = (np.array([scale * getattr(getattr(w, name), k) for w in ways]) for k in _ENDS)
            spread = np.maximum([value - low, high - value], 0.0)
            axis.errorbar(
                [w.seconds for w in ways], value, yerr=spread, marker=marker, ms=5, lw=1.0, capsize=2, label=kind
            )
        axis.set_xscale("log")
        figures.plain_numbers(axis.xaxis)
        axis.set_xlabel("core seconds a picture")
        axis.set_ylabel(label)
        axis.set_ylim(bottom=0.0)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.suptitle(title)
    return figure


_ENDS = ("value", "low", "high")
