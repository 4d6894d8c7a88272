"""Measures cost and error of a picture for a ladder of engines and settings, on one scene and machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from generator.files.writing import csv_text, write_text
from generator.jobs import budget, local
from generator.jobs.budget import Measured
from generator.jobs.request import SweepRequest
from generator.jobs.workers import available_cores
from generator.measure import figures
from generator.measure.intervals import mean, median
from generator.model.arrays import Array
from generator.model.deadline import Deadline, Late
from generator.model.engines import traits_of
from generator.model.errors import NlosError
from generator.model.quantities import NO_CHANGE, Progress, clock
from generator.sets.dataset import Dataset

REFERENCE = "reference"
_PATCH = "patch True False"

_REFERENCES = (1e-5, 1e-4, 1e-3)
"""Accuracies of the reference by `surfel`: the finest that the time allows."""
_GROWTH = 0.9
"""Power of the accuracy with which the time of `surfel` grows at most beyond the trial's 1e-3; 0.87 in the room."""
_MOST = 4
"""Samples of the reference where `surfel` is not valid, in units of those of the most expensive rung."""
_FOR_REFERENCE = 0.5
"""Share of the time that is left of which the reference may take all."""
_EVALUATING = 1.0
"""Seconds to compare the pictures and to draw."""
_SAMPLES = (4, 16, 64, 256, 1024)
_ACCURACIES = (1e-1, 1e-2, 1e-3)


@dataclass(frozen=True)
class Rung:
    """A combination of engine and settings.

    Attributes
    ----------
    name : str
        Name of its folder.
    settings : dict
        Fields of `generator.model.settings.Sweep`.
    """

    name: str
    settings: dict[str, Any]


def ladder(reference: Mapping[str, Any]) -> list[Rung]:
    """Return the rungs that a reference of given settings can judge: it is first, then the quick ones."""
    surfel = reference["engine"] == "surfel"
    most = _SAMPLES[-1] if surfel else reference["samples"] // _MOST
    counts = [n for n in _SAMPLES if n <= most]
    fine = [a for a in _ACCURACIES if surfel and a > reference["accuracy"]]
    rungs = [Rung(f"surfel-{a:g}", {"engine": "surfel", "accuracy": a}) for a in fine]
    rungs += [Rung(f"patch-{n}", {"engine": "patch", "samples": n}) for n in counts]
    rungs += [Rung(f"patch-{n}-denoised", {"engine": "patch", "samples": n, "denoise": True}) for n in counts[:3]]
    rungs += [Rung(f"patch-{n}-unpaired", {"engine": "patch", "samples": n, "paired": False}) for n in counts[1:4:2]]
    rungs += [Rung(f"path-{n}", {"engine": "path", "samples": n}) for n in counts[1:4:2]]
    quick_first = sorted(rungs, key=lambda rung: rung.settings.get("samples", 0))
    return [Rung(REFERENCE, dict(reference)), *quick_first]


def references(measured: Measured, pictures: int) -> list[tuple[dict[str, Any], float]]:
    """Return settings of the references that a scene allows, the best first, each with its likely time.

    Parameters
    ----------
    measured : Measured
        From a trial with the cheapest engine of the scene.
    pictures : int

    Returns
    -------
    list of (dict, float)
        Fields of `generator.model.settings.Sweep`; seconds.
    """
    if measured.engine != "surfel":
        counts = [_MOST * n for n in reversed(_SAMPLES)]
        return [({"engine": "patch", "samples": n}, measured.total(n, pictures)) for n in counts]
    finest = 1e-3
    ways = []
    for accuracy in _REFERENCES:
        seconds = measured.total(1.0 / finest, pictures) - measured.start
        seconds = measured.start + seconds * (finest / accuracy) ** max(measured.power, _GROWTH)
        ways.append(({"engine": "surfel", "accuracy": accuracy}, seconds))
    return ways


@dataclass(frozen=True)
class Cost:
    """Cost and error of a rung.

    Attributes
    ----------
    name : str
    seconds : float
        Core seconds per picture, including the one that it is paired with.
    error : (float, float, float)
        Root mean square of a difference picture's error, relative to the reference's difference: in the median pose,
        with its 95 % interval (`intervals.median`).
    level : (float, float, float)
        Mean over the poses of the share of the reference's difference that the rung shows: 1 without bias; with its
        95 % interval (`intervals.mean`).
    errors : ndarray of shape (n,)
        The error pose by pose, in the same order for all rungs.
    """

    name: str
    seconds: float
    error: tuple[float, float, float]
    level: tuple[float, float, float]
    errors: Array


def run(
    scene: Path,
    folder: Path,
    *,
    poses: int = 3,
    seed: int = 0,
    resolution: str | None = None,
    device: str = "cpu",
    most: float = 1200.0,
    workers: int = 0,
    tell: Callable[[str], None] = lambda words: None,
    progress: Progress = lambda done, total: None,
    force: bool = False,
    now: Callable[[], float] = time.monotonic,
) -> list[Cost]:
    """Render the same poses on every rung, each as a separate data set in a folder, and measure them.

    A rung that was rendered before is not rendered again, so an interrupted run continues.

    Parameters
    ----------
    scene : Path
    folder : Path
    poses : int
        Poses per voxel.
    seed : int
    resolution : str, optional
        Size of the pictures; by default the scene's.
    device : {"cpu", "gpu"}
        Device that Cycles renders on.
    most : float
        Time limit for all of it, seconds; compiling, which is done once, comes on top. A rung that is predicted to
        take longer than what is left is left out, and one that does is stopped; the reference is as good as half of
        the time allows.
    workers : int
        As for `generator.jobs.local.run`.
    tell : callable
        Called with a sentence about each rung.
    progress : callable
        Called with (done, total) pictures of a rung.
    force : bool
        As for `generator.jobs.local.run`.
    now : callable
        Returns the time in seconds.

    Raises
    ------
    NlosError
        The scene cannot be swept, the folder holds something else, or the limit is too short for two rungs.
    """
    common: dict[str, Any] = {"poses": poses, "seed": seed}
    if resolution:
        common["resolution"] = resolution
    settings = {**common, "engine": "auto", "device": device}
    budget.compiled(scene, settings, tell=tell, force=force)
    deadline = Deadline(most - _EVALUATING, now)
    tell("rehearsing a few pictures")
    try:
        measured = budget.measured_by_trial(scene, settings, workers, force=force, deadline=deadline)
    except Late:
        raise NlosError(
            f"--time-limit: {clock(most)} are over before a few pictures are; ask for more time"
        ) from None
    if measured.engine == "path":
        raise NlosError(f"{scene}: only the engine 'path' can render it, so there is nothing to trade")
    reference, seconds = _reference(folder, measured, poses * measured.voxels, deadline)
    wanted, rendered = ladder(reference), 0
    finest, _ = references(measured, poses * measured.voxels)[0]
    if too_fine := {rung.name for rung in ladder(finest)} - {rung.name for rung in wanted}:
        tell(f"{', '.join(sorted(too_fine))}: left out, too fine for the reference that there is time for")
    expected = {wanted[0].name: seconds}
    per_work: dict[str, float] = {}
    starting = measured.start
    for rung in wanted:
        kind, work = _kind(rung), float(rung.settings.get("samples", 1))
        known = per_work.get(kind, 0.0 if rung.settings["engine"] == "surfel" else per_work.get(_PATCH, 0.0))
        estimate = expected.get(rung.name, starting + known * work)
        path, traits = folder / rung.name, traits_of(rung.settings["engine"])
        if estimate > deadline.left and not _finished(path):
            if rung.name == REFERENCE:
                break
            tell(f"{rung.name}: left out, would take about {clock(estimate)}; {clock(deadline.left)} are left")
            continue
        tell(f"{rung.name}: {', '.join(f'{name} {value}' for name, value in rung.settings.items())}")
        request = SweepRequest(
            scene=scene,
            path=path,
            chosen={**common, **rung.settings, **({"device": device} if traits.noisy else {})},
            workers=workers,
            force=force,
            probe=False,
        )
        begun = now()
        outcome = _run_until(deadline, request, progress)
        if outcome.failed:
            raise NlosError(f"{path}: {outcome.failed[0]}")
        if outcome.remaining:
            tell(f"{rung.name}: stopped and left out, the time is over")
            continue
        rendered += 1
        spent = sum(record.seconds for record in outcome.dataset.records)
        per_work[kind] = spent / work / measured.workers
        if outcome.rendered:
            starting = max(0.0, now() - begun - spent / measured.workers)
        tell(f"{rung.name}: {spent / len(outcome.dataset.records):.3g} core seconds a picture")
    if rendered < 2 or not _finished(folder / REFERENCE):
        raise NlosError(
            f"--time-limit: {clock(most)} are too short for a reference, which takes about {clock(seconds)}, and one "
            "more; "
            "ask for more time, or for fewer --poses; the same command goes on with what is there"
        )
    return costs(folder)


def _reference(folder: Path, measured: Measured, pictures: int, deadline: Deadline) -> tuple[dict[str, Any], float]:
    """Return the settings of a folder's reference, or of a new one, and the seconds that it is likely to take."""
    if Dataset.exists(folder / REFERENCE):
        settings = Dataset.open(folder / REFERENCE).settings
        return {name: settings[name] for name in ("engine", "accuracy", "samples") if name in settings}, 0.0
    ways = references(measured, pictures)
    return next((way for way in ways if way[1] <= _FOR_REFERENCE * deadline.left), ways[-1])


def _finished(path: Path) -> bool:
    return Dataset.exists(path) and len((made := Dataset.open(path)).records) == made.planned


def _run_until(deadline: Deadline, request: SweepRequest, progress: Progress) -> local.Outcome:
    """Render a data set until it is finished or the time is over."""
    stop = threading.Event()
    timer = threading.Timer(deadline.left, stop.set)
    timer.start()
    try:
        return local.run(request, progress=progress, stop=stop)
    finally:
        timer.cancel()


def _kind(rung: Rung) -> str:
    """Return a name that is the same for rungs whose time grows in proportion to their samples.

    Each accuracy of `surfel` is a kind of its own: the time of the reference says nothing of the quick rungs.
    """
    if rung.settings["engine"] == "surfel":
        return f"surfel {rung.settings['accuracy']}"
    return f"{rung.settings['engine']} {rung.settings.get('paired', True)} {rung.settings.get('denoise', False)}"


def rungs(folder: Path) -> list[Dataset]:
    """Return the finished data sets of a folder, the reference first.

    Raises
    ------
    NlosError
        There is no reference, it is not finished, or there is no other finished data set.
    """
    if not Dataset.exists(folder / REFERENCE):
        raise NlosError(f"{folder}: holds no {REFERENCE} (nlos-generate tradeoff makes it)")
    datasets = [Dataset.open(folder / REFERENCE)]
    datasets += [Dataset.open(p) for p in sorted(folder.iterdir()) if p.name != REFERENCE and Dataset.exists(p)]
    if len(datasets[0].records) < datasets[0].planned:
        raise NlosError(f"{folder / REFERENCE}: is not finished; run nlos-generate tradeoff again")
    finished = [dataset for dataset in datasets if len(dataset.records) == datasets[0].planned]
    if len(finished) < 2:
        raise NlosError(f"{folder}: holds nothing beside the reference; run nlos-generate tradeoff again")
    return finished


def costs(folder: Path) -> list[Cost]:
    """Return the costs of the rungs of a folder, and their errors against the reference; the quickest first."""
    reference, *others = rungs(folder)
    expected = differences(reference)
    scale = np.sqrt((expected**2).mean(axis=(1, 2)))
    if not scale.all():
        raise NlosError(f"{folder}: in some pictures {NO_CHANGE}, so there is no error relative to it")
    results = []
    for dataset in others:
        measured = differences(dataset)
        error = np.sqrt(((measured - expected) ** 2).mean(axis=(1, 2))) / scale
        level = (measured * expected).sum(axis=(1, 2)) / (expected**2).sum(axis=(1, 2))
        seconds = float(np.mean([record.seconds for record in dataset.records]))
        results.append(Cost(dataset.path.name, seconds, _median(error), mean(level), error))
    return sorted(results, key=lambda cost: cost.seconds)


def reference_words(folder: Path) -> str:
    """Return what the errors of a folder are relative to."""
    settings = Dataset.open(folder / REFERENCE).settings
    name = "accuracy" if settings["engine"] == "surfel" else "samples"
    return f"reference {settings['engine']}, {name} {settings[name]:g}"


def differences(found: Dataset) -> Array:
    """Return a data set's pictures minus its background, grey, (n, height, width), W/m^2/sr."""
    background = found.background().astype(np.float64).mean(axis=2)
    return np.array([found.picture(record).astype(np.float64).mean(axis=2) - background for record in found.records])


def _median(errors: Array) -> tuple[float, float, float]:
    value, low, high = median(errors)
    return value, max(low, 0.0), high


def front(found: Sequence[Cost]) -> list[int]:
    """Return the indices of the rungs that are worth their price, the quickest first (Pareto front).

    A rung is, if its errors are smaller than those of the quicker one before it, pose by pose: the interval of the
    median ratio lies below 1. With fewer than six poses nothing can be told, and the quickest stays alone.
    """
    ordered = sorted(range(len(found)), key=lambda k: (found[k].seconds, found[k].error[0]))
    kept = ordered[:1]
    for number in ordered[1:]:
        with np.errstate(divide="ignore", invalid="ignore"):  # without an error there is none to divide by
            ratios = found[number].errors / found[kept[-1]].errors
        if median(np.nan_to_num(ratios, nan=1.0, posinf=float(np.finfo(float).max)))[2] < 1.0:
            kept.append(number)
    return kept


HEADINGS = ("way", "core s a picture", "error", "light that is there", "900 pictures here", "best at its price")
"""The last says whether no quicker way is as good as far as these poses tell."""


def rows(found: Sequence[Cost]) -> list[tuple[str, ...]]:
    """Return a table: a row for each rung."""
    best = front(found)
    cores = available_cores()
    return [
        (
            cost.name,
            f"{cost.seconds:.3g}",
            "{:.3g} % ({:.3g} to {:.3g})".format(*(100.0 * e for e in cost.error)),
            "{:.4g} ({:.4g} to {:.4g})".format(*cost.level),
            clock(900.0 * cost.seconds / cores),
            "yes" if number in best else "",
        )
        for number, cost in enumerate(found)
    ]


def advice(found: Sequence[Cost], budgets: Sequence[float] = (60.0, 600.0, 3600.0, 86400.0)) -> list[str]:
    """Return which rung to take for each time budget of 900 pictures on this machine, and when the next one pays."""
    best = [found[k] for k in front(found)]
    totals = [900.0 * cost.seconds / available_cores() for cost in best]
    lines = []
    for limit in budgets:
        within = [k for k, seconds in enumerate(totals) if seconds <= limit]
        if not within:
            lines.append(f"900 pictures in {clock(limit)}: none ends; the quickest takes {clock(totals[0])}")
            continue
        k = within[-1]
        line = f"900 pictures in {clock(limit)}: take {best[k].name}, error {100.0 * best[k].error[0]:.3g} %"
        if k + 1 < len(best):
            line += f"; the next useful step, {best[k + 1].name}, takes {clock(totals[k + 1])}"
        lines.append(line)
        if k + 1 == len(best):
            break
    return lines


def write(folder: Path, found: Sequence[Cost], title: str) -> list[Path]:
    """Write the table and the figure into the folder; return their paths."""
    table, picture = folder / "costs.csv", folder / "costs.png"
    write_text(table, csv_text(HEADINGS, rows(found)))
    return [table, *figures.save(picture, draw(found, front(found), title))]


@figures.styled
def draw(found: Sequence[Cost], best: Sequence[int], title: str) -> Figure:
    """Return a figure of the errors against the time of a picture.

    Parameters
    ----------
    found : sequence of Cost
    best : sequence of int
        Indices of those that are worth their price, the quickest first.
    title : str
    """
    figure, [[axis]] = figures.subplots(size=(7.5, 5.0))
    seconds, errors = [c.seconds for c in found], [100.0 * c.error[0] for c in found]
    for kind, marker in zip(sorted({family(c.name) for c in found}), cycle(figures.MARKERS)):
        group = [c for c in found if family(c.name) == kind]
        value, low, high = (np.array([100.0 * c.error[k] for c in group]) for k in range(3))
        spread = np.maximum([value - low, np.where(np.isfinite(high), high - value, np.nan)], 0.0)
        axis.errorbar(
            [c.seconds for c in group], value, yerr=spread, marker=marker, ms=5, lw=1.0, capsize=2, label=kind
        )
    axis.plot(
        [seconds[k] for k in best],
        [errors[k] for k in best],
        color=figures.GREY,
        lw=5.0,
        alpha=0.3,
        zorder=1,
        label="best at its price",
    )
    axis.set_xscale("log")
    axis.set_yscale("log")
    figures.plain_numbers(axis.xaxis, axis.yaxis)
    axis.set_xlabel("core seconds a picture")
    axis.set_ylabel("error of a difference picture, % of it (median pose)")
    axis.set_title(title)
    axis.legend()
    return figure


def family(name: str) -> str:
    """Return the name that a rung shares with those that differ in samples or accuracy alone."""
    engine, *rest = name.split("-")
    rest = [word for word in rest if word in ("denoised", "unpaired")]
    return " ".join([engine, *rest])
