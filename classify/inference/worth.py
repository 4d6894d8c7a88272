"""What better pictures are worth: answers to the same poses, rendered in every way from the quickest to the best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

from classify.inference import evaluation
from classify.inference.atlas import Atlas
from classify.inference.bound import median
from classify.intervals import Interval, wilson
from generator.measure import figures
from generator.measure.tradeoff import REFERENCE, family, rungs


@dataclass(frozen=True)
class Worth:
    """What a way to render is worth.

    Attributes
    ----------
    name : str
    seconds : float
        Core seconds that a picture takes.
    accuracy : Interval
        Share of pictures that are put into the right voxel.
    error : Interval
        Median distance of the position, metres.
    detected : Interval
        Share of pictures in which something is found.
    count : int
        Answers: pictures, each with several noises of the sensor.
    """

    name: str
    seconds: float
    accuracy: Interval
    error: Interval
    detected: Interval
    count: int


def worths(
    folder: Path,
    atlas: Atlas,
    *,
    false_alarm: float = 0.01,
    noises: int = 5,
    seed: int = 0,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> list[Worth]:
    """Answer all pictures of ``nlos-generate tradeoff``, seen through the atlas' sensor; the reference comes first.

    Intervals are too narrow by what the noises of one picture have in common.

    Parameters
    ----------
    folder : Path
    atlas : Atlas
        Of the same scene.
    false_alarm : float
        Share of empty scenes that may be taken for something.
    noises : int
        How often the sensor looks at each picture.
    seed : int
        Of these noises.
    progress : callable
        Is told how many ways are done, of how many, and which is next.

    Raises
    ------
    NlosError
        The folder holds no finished data sets, or they are of another scene than the atlas.
    """
    sets = rungs(folder)
    made = []
    for done, found in enumerate(sets):
        progress(done, len(sets), found.path.name)
        answers = [
            evaluation.run(atlas, found, false_alarm=false_alarm, seed=seed + number, empty=0)
            for number in range(noises)
        ]
        right = np.concatenate([a.right for a in answers])
        seen = np.concatenate([a.evidence > a.detector.threshold for a in answers])
        made.append(
            Worth(
                name=found.path.name,
                seconds=float(np.mean([record.seconds for record in found.records])),
                accuracy=wilson(int(right.sum()), len(right)),
                error=median(np.concatenate([a.errors for a in answers])),
                detected=wilson(int(seen.sum()), len(seen)),
                count=len(right),
            )
        )
    progress(len(sets), len(sets), "done")
    return [made[0], *sorted(made[1:], key=lambda worth: worth.seconds)]


HEADINGS = ("way", "core s a picture", "right voxel", "median error", "detected")


def rows(found: Sequence[Worth]) -> list[tuple[str, ...]]:
    """Return a table: a row for each way."""
    return [
        (w.name, f"{w.seconds:.3g}", w.accuracy.percent(), w.error.centimetres(), w.detected.percent()) for w in found
    ]


def enough(found: Sequence[Worth]) -> list[str]:
    """Return from which way on, for each engine, rendering no longer decides, in sentences."""
    reference = next(w for w in found if w.name == REFERENCE)
    told = [f"Without noise of rendering, {reference.accuracy.percent()} are put into the right voxel."]
    for engine in ("surfel", "patch", "path"):
        plain = [w for w in found if family(w.name) == engine]
        good = [w for w in plain if w.accuracy.high >= reference.accuracy.value]
        if good:
            first = min(good, key=lambda w: w.seconds)
            told.append(f"{engine}: what {first.name} ({first.seconds:.3g} core seconds) loses cannot be told.")
        elif plain:
            best = max(plain, key=lambda w: (w.accuracy.value, w.seconds))
            told.append(f"{engine}: even {best.name} loses: {best.accuracy.percent()}.")
    return told


def draw(path: Path, found: Sequence[Worth], title: str) -> None:
    """Write a picture: right voxels and median error against the time of rendering; the reference as a line."""
    figure, axes = plt.subplots(1, 2, figsize=(12.0, 4.6), layout="constrained")
    others = [w for w in found if w.name != REFERENCE]
    reference = next(w for w in found if w.name == REFERENCE)
    for axis, name, scale, label in zip(
        axes, ("accuracy", "error"), (100.0, 100.0), ("right voxel, %", "median error, cm"), strict=True
    ):
        exact = getattr(reference, name)
        axis.axhspan(scale * exact.low, scale * exact.high, color="#57606a", alpha=0.15, lw=0)
        axis.axhline(scale * exact.value, color="#57606a", lw=1.0, ls=":", label="without noise of rendering")
        for kind in dict.fromkeys(family(w.name) for w in others):
            own = [w for w in others if family(w.name) == kind]
            value, low, high = (np.array([scale * getattr(getattr(w, name), k) for w in own]) for k in _ENDS)
            spread = np.maximum([value - low, high - value], 0.0)
            axis.errorbar(
                [w.seconds for w in own], value, yerr=spread, marker="o", ms=4, lw=1.0, capsize=2, label=kind
            )
        axis.set_xscale("log")
        axis.set_xlabel("core seconds a picture")
        axis.set_ylabel(label)
    axes[0].legend(fontsize=8)
    figure.suptitle(title, fontsize=10)
    figures.save(path, figure)


_ENDS = ("value", "low", "high")
