"""What a picture costs and how wrong it is, for a ladder of engines and settings, on one scene and machine."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from generator.files.writing import csv_text, write_text
from generator.jobs import local
from generator.jobs.request import SweepRequest
from generator.jobs.workers import available_cores
from generator.measure import figures
from generator.measure.intervals import bootstrap
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.quantities import clock
from generator.sets.dataset import Dataset
from generator.transport import caching

REFERENCE = "reference"

_FINEST = {"engine": "surfel", "accuracy": 1e-5}
_MOST = 4
"""Times the samples of the dearest rung, for a reference where `surfel` is not valid."""
_SAMPLES = (4, 16, 64, 256, 1024)
_ACCURACIES = (1e-1, 1e-2, 1e-3)


@dataclass(frozen=True)
class Rung:
    """A way to render.

    Attributes
    ----------
    name : str
        Of its folder.
    settings : dict
        Fields of `generator.model.settings.Sweep`.
    """

    name: str
    settings: dict[str, Any]


def ladder(surfel: bool) -> list[Rung]:
    """Return the ways to render a scene, and the reference, which comes first."""
    rungs = [Rung(f"patch-{n}", {"engine": "patch", "samples": n}) for n in _SAMPLES]
    rungs += [Rung(f"patch-{n}-denoised", {"engine": "patch", "samples": n, "denoise": True}) for n in _SAMPLES[:3]]
    rungs += [
        Rung(f"patch-{n}-unpaired", {"engine": "patch", "samples": n, "paired": False}) for n in _SAMPLES[1:4:2]
    ]
    rungs += [Rung(f"path-{n}", {"engine": "path", "samples": n}) for n in _SAMPLES[1:4:2]]
    if surfel:
        exact = [Rung(f"surfel-{a:g}", {"engine": "surfel", "accuracy": a}) for a in _ACCURACIES]
        return [Rung(REFERENCE, dict(_FINEST)), *exact, *rungs]
    return [Rung(REFERENCE, {"engine": "patch", "samples": _MOST * _SAMPLES[-1]}), *rungs]


@dataclass(frozen=True)
class Cost:
    """What a rung takes and gives.

    Attributes
    ----------
    name : str
    seconds : float
        Core seconds that a picture takes, with the one it is paired with.
    error : (float, float, float)
        Root mean square of a difference picture's error, relative to the reference's difference: in the median pose,
        with the 95 % interval of a bootstrap over poses (Efron 1979).
    level : (float, float, float)
        Mean, over the poses, of the share of the reference's difference that is there: 1 without bias; as above.
    """

    name: str
    seconds: float
    error: tuple[float, float, float]
    level: tuple[float, float, float]


def run(
    scene: Path,
    folder: Path,
    *,
    poses: int = 3,
    seed: int = 0,
    resolution: str | None = None,
    most: float = 600.0,
    workers: int = 0,
    tell: Callable[[str], None] = lambda words: None,
    force: bool = False,
) -> list[Cost]:
    """Render the same poses on every rung, each a data set of its own in a folder, and measure them.

    A rung that was rendered before is not rendered again, so a run that was stopped goes on.

    Parameters
    ----------
    scene : Path
    folder : Path
    poses : int
        Per voxel.
    seed : int
    resolution : str, optional
        The scene's, if left out.
    most : float
        Seconds that a rung may take; one that would take longer, judged by the one below it, is left out.
    workers : int
        As of `generator.jobs.local.run`.
    tell : callable
        Is told of each rung.
    force : bool
        As of `generator.jobs.local.run`.

    Raises
    ------
    NlosError
        The scene cannot be swept, or the folder holds something else.
    """
    common: dict[str, Any] = {"poses": poses, "seed": seed}
    if resolution:
        common["resolution"] = resolution
    if words := caching.compiling_words("auto"):
        tell(words)
    with tempfile.TemporaryDirectory(prefix="nlos-") as trial:
        settings = {**common, "poses": 1, "engine": "auto"}
        request = SweepRequest(
            scene=scene, path=Path(trial) / "plan", chosen=settings, workers=workers, force=force, probe=False
        )
        planned = local.prepare(request, tell=tell)
    cheapest = planned.sweep.engine
    if cheapest == "path":
        raise NlosError(f"{scene}: only the engine 'path' can render it, so there is nothing to trade")
    took: dict[str, float] = {}
    for rung in ladder(cheapest == "surfel"):
        kind, work = _kind(rung), float(rung.settings.get("samples", 1))
        guess = took.get(kind, 0.0) * work
        if guess > most:
            tell(f"{rung.name}: left out, would take about {clock(guess)}")
            continue
        outcome = local.run(replace(request, path=folder / rung.name, chosen={**common, **rung.settings}))
        if outcome.failed:
            raise NlosError(f"{folder / rung.name}: {outcome.failed[0]}")
        seconds = sum(record.seconds for record in outcome.dataset.records)
        took[kind] = seconds / work / max(1, workers or available_cores())
        tell(f"{rung.name}: {seconds / len(outcome.dataset.records):.3g} core seconds a picture")
    return costs(folder)


def _kind(rung: Rung) -> str:
    return f"{rung.settings['engine']} {rung.settings.get('paired', True)} {rung.settings.get('denoise', False)}"


def rungs(folder: Path) -> list[Dataset]:
    """Return the finished data sets of a folder, the reference first.

    Raises
    ------
    NlosError
        There is no reference, or it is not finished, or no other.
    """
    if not Dataset.exists(folder / REFERENCE):
        raise NlosError(f"{folder}: holds no {REFERENCE} (nlos-generate tradeoff makes it)")
    every = [Dataset.open(folder / REFERENCE)]
    every += [Dataset.open(p) for p in sorted(folder.iterdir()) if p.name != REFERENCE and Dataset.exists(p)]
    if len(every[0].records) < every[0].planned:
        raise NlosError(f"{folder / REFERENCE}: is not finished; run nlos-generate tradeoff again")
    finished = [found for found in every if len(found.records) == every[0].planned]
    if len(finished) < 2:
        raise NlosError(f"{folder}: holds nothing beside the reference; run nlos-generate tradeoff again")
    return finished


def costs(folder: Path) -> list[Cost]:
    """Return what the rungs of a folder took, and how far each is from the reference; the quickest first."""
    reference, *others = rungs(folder)
    wanted = differences(reference)
    scale = np.sqrt((wanted**2).mean(axis=(1, 2)))
    if not scale.all():
        raise NlosError(f"{folder}: the object changes nothing in some pictures, so there is no error relative to it")
    made = []
    for found in others:
        got = differences(found)
        error = np.sqrt(((got - wanted) ** 2).mean(axis=(1, 2))) / scale
        level = (got * wanted).sum(axis=(1, 2)) / (wanted**2).sum(axis=(1, 2))
        seconds = float(np.mean([record.seconds for record in found.records]))
        made.append(Cost(found.path.name, seconds, bootstrap(error, np.median), bootstrap(level)))
    return sorted(made, key=lambda cost: cost.seconds)


def differences(found: Dataset) -> Array:
    """Return a data set's pictures less its background, grey, (n, height, width), W/m^2/sr."""
    background = found.background().astype(np.float64).mean(axis=2)
    return np.array([found.picture(record).astype(np.float64).mean(axis=2) - background for record in found.records])


def front(x: Sequence[float], y: Sequence[float]) -> list[int]:
    """Return which points no other beats in both, the least x first (Pareto's front; less is better)."""
    best, kept = float("inf"), []
    for number in sorted(range(len(x)), key=lambda k: (x[k], y[k])):
        if y[number] < best:
            best = y[number]
            kept.append(number)
    return kept


HEADINGS = ("way", "core s a picture", "error", "light that is there", "900 pictures here", "best at its price")


def rows(found: Sequence[Cost]) -> list[tuple[str, ...]]:
    """Return a table: a row for each rung."""
    best = front([c.seconds for c in found], [c.error[0] for c in found])
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
    """Return which way to take for each time that 900 pictures may last here, and when the next is worth it."""
    best = [found[k] for k in front([c.seconds for c in found], [c.error[0] for c in found])]
    whole = [900.0 * cost.seconds / available_cores() for cost in best]
    told = []
    for limit in budgets:
        within = [k for k, seconds in enumerate(whole) if seconds <= limit]
        if not within:
            told.append(f"900 pictures in {clock(limit)}: none ends; the quickest takes {clock(whole[0])}")
            continue
        k = within[-1]
        line = f"900 pictures in {clock(limit)}: take {best[k].name}, error {100.0 * best[k].error[0]:.3g} %"
        if k + 1 < len(best):
            line += f"; the next useful step, {best[k + 1].name}, takes {clock(whole[k + 1])}"
        told.append(line)
        if k + 1 == len(best):
            break
    return told


def write(folder: Path, found: Sequence[Cost], title: str) -> list[Path]:
    """Write the table and the picture into the folder; return their paths."""
    table, picture = folder / "costs.csv", folder / "costs.png"
    write_text(table, csv_text(HEADINGS, rows(found)))
    figure, axis = plt.subplots(figsize=(7.5, 5.0), layout="constrained")
    seconds, errors = [c.seconds for c in found], [100.0 * c.error[0] for c in found]
    for kind in dict.fromkeys(family(c.name) for c in found):
        own = [c for c in found if family(c.name) == kind]
        value, low, high = (np.array([100.0 * c.error[k] for c in own]) for k in range(3))
        spread = np.maximum([value - low, high - value], 0.0)
        axis.errorbar([c.seconds for c in own], value, yerr=spread, marker="o", ms=4, lw=1.0, capsize=2, label=kind)
    best = front(seconds, errors)
    axis.plot([seconds[k] for k in best], [errors[k] for k in best], color="#57606a", lw=3.0, alpha=0.3, label="best")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel("core seconds a picture")
    axis.set_ylabel("error of a difference picture, % of it (median pose)")
    axis.set_title(title, fontsize=10)
    axis.legend(fontsize=8)
    figures.save(picture, figure)
    return [table, picture]


def family(name: str) -> str:
    """Return what a rung has in common with those that differ in samples or accuracy alone."""
    engine, *rest = name.split("-")
    rest = [word for word in rest if word in ("denoised", "unpaired")]
    return " ".join([engine, *rest])
