"""Draws pictures of the pages from the files in ``docs/data``, so that none needs to be measured to be drawn again.

Run: ``python benchmarks/pictures.py [NAME ...] -o DIR``. Each is written as PNG, which goes to ``docs/pictures``, and
as SVG. A picture keeps the name and the hash of its file, and ``tests/test_pictures.py`` holds them against
``docs/data``, so that no file changes without its picture. Benchmarks that draw what they measure do it by `save`.
"""

from __future__ import annotations

import argparse
import csv
import functools
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from classify.inference import evaluation, worth
from classify.intervals import Interval
from generator.files.writing import file_hash
from generator.measure import figures, plan_report, tradeoff
from generator.measure.scene_plan import KEPT, LEFT_OUT, NEEDED, UNKNOWN, Effect, Plan

DATA = Path(__file__).resolve().parents[1] / "docs" / "data"
Row = dict[str, str]
_NUMBER = re.compile(r"-?\d[\d.]*(?:e[+-]?\d+)?")


@dataclass(frozen=True)
class Picture:
    """A picture of a page.

    Attributes
    ----------
    data : str
        Its file in ``docs/data``, without ``.csv``.
    draw : callable
        Makes a figure of the file's rows.
    """

    data: str
    draw: Callable[[list[Row]], Figure]


def rows(file: Path) -> list[Row]:
    """Return the rows of a file of results, each by the names of its columns."""
    lines = file.read_text(encoding="utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("# ")))


def source(file: Path) -> str:
    """Return what a picture keeps of the file that it is drawn from."""
    return f"{file.name}, SHA-256 {file_hash(file)}"


def save(name: str, file: Path, folder: Path) -> list[Path]:
    """Draw a picture from a file of results into a folder; return what was written."""
    return figures.save(folder / f"{name}.png", PICTURES[name].draw(rows(file)), source=source(file))


def interval(cell: str) -> tuple[float, float, float]:
    """Return a value and its interval from text such as ``3.1 % (2.9 to any)``; a value alone is exact."""
    numbers = [float(number) for number in _NUMBER.findall(cell)]
    if len(numbers) == 2 and cell.endswith("to any)"):
        numbers.append(math.inf)
    return (numbers[0], numbers[1], numbers[2]) if len(numbers) > 1 else (numbers[0],) * 3


def _arms(values: Sequence[tuple[float, float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Return values, and the lengths of the two arms of each error bar."""
    value, low, high = np.array(values, dtype=float).T
    return value, np.array([value - low, high - value])


# --- reproduction ---------------------------------------------------------------------------------------------------


@figures.styled
def accuracy(table: list[Row]) -> Figure:
    """Accuracy of each classifier on the global features, a panel for each pair of training and test set."""
    table = [row for row in table if row["features"] == "global"]
    pairs = list(dict.fromkeys((row["trained on"], row["tested on"]) for row in table))
    figure, axes = figures.subplots(2, 2, size=(figures.WIDTH, 5.6), sharey=True)
    kinds = {"paper's settings": (figures.SKY, "o"), "tuned": (figures.BLUE, "s")}
    for axis, (train, test) in zip(axes.flat, sorted(pairs, key=lambda pair: pair[0] != pair[1]), strict=True):
        shown = [row for row in table if (row["trained on"], row["tested on"]) == (train, test)]
        places = np.arange(len(shown))
        for aside, (kind, (colour, marker)) in zip((-0.13, 0.13), kinds.items(), strict=True):
            value, arms = _arms([interval(row[f"{kind}, accuracy"]) for row in shown])
            axis.errorbar(places + aside, value, yerr=arms, fmt=marker, ms=4.5, color=colour, capsize=2.5, label=kind)
        published = [row["paper, accuracy / F1"].partition(" / ")[0] for row in shown]
        if any(published):
            paper = [float(text) if text else math.nan for text in published]
            axis.plot(places, paper, "D", color=figures.VERMILION, ms=5, label="the paper")
        axis.axhline(100.0 / 9.0, color=figures.GREY, lw=1.0, ls=":", label="chance")
        axis.set_xticks(places, [row["classifier"] for row in shown])
        axis.set_ylim(0.0, 102.0)
        axis.grid(axis="x", visible=False)
        axis.set_title(f"trained and tested on the {train}" if train == test else f"{train} learnt, {test} tested")
    for row in axes:
        row[0].set_ylabel("accuracy, %")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


@figures.styled
def confusion(target: str, table: list[Row]) -> Figure:
    """Confusion matrices of one object on the global features: the paper's SVM, the tuned one, and the best."""
    table = [row for row in table if row["features"] == "global" and row["trained on"] == row["tested on"] == target]
    labels = sorted({row["truth"] for row in table})
    counts: dict[tuple[str, str], np.ndarray] = {}
    for row in table:
        matrix = counts.setdefault((row["classifier"], row["settings"]), np.zeros((len(labels), len(labels))))
        matrix[labels.index(row["truth"]), labels.index(row["predicted"])] += float(row["count"])
    best = max(counts, key=lambda key: np.trace(counts[key]))
    shown = list(dict.fromkeys([("SVM", "paper"), ("SVM", "tuned"), best]))
    figure, axes = figures.subplots(1, len(shown), size=(2.7 * len(shown), 3.2))
    for axis, (name, settings) in zip(axes[0], shown, strict=True):
        matrix = counts[name, settings]
        figures.heat_map(axis, 100.0 * matrix / matrix.sum(axis=1, keepdims=True), labels)
        right = f"{100.0 * np.trace(matrix) / matrix.sum():.1f} % right"
        axis.set_title(f"{name}, {settings}: {right}")
        axis.set_xlabel("predicted voxel")
    axes[0, 0].set_ylabel("true voxel (rows in %)")
    return figure


# --- localisation ---------------------------------------------------------------------------------------------------


def located(table: list[Row]) -> Figure:
    """What `nlos-classify locate` draws of its answers, from their file."""
    labels = sorted({row["voxel"] for row in table})
    truth, predicted = (np.array([labels.index(row[name]) for row in table]) for name in ("voxel", "found"))
    true, found = (np.array([[float(row[f"{w}{a}"]) for a in "xyz"] for row in table]) for w in ("", "found_"))
    regions = np.array([float(row["region"]) for row in table])
    title = f"{len(table)} pictures of a sphere, one frame"
    return evaluation.draw(labels, truth, predicted, np.linalg.norm(found - true, axis=1), regions, title)


@figures.styled
def learnt(table: list[Row]) -> Figure:
    """Accuracy against the number of simulated training pictures, a panel for each object."""
    figure, [axes] = figures.subplots(1, 2, size=(figures.WIDTH, 3.6), sharey=True)
    cycles = next(row for row in table if row["trained on"].startswith("Cycles"))
    simulated = [row for row in table if row is not cycles]
    counts = np.array([float(_NUMBER.findall(row["trained on"].replace(",", ""))[0]) for row in simulated])
    names = ("RF", "SVM", "MLP")
    for axis, target in zip(axes, ("sphere", "sheet"), strict=True):
        for name, colour, marker, aside in zip(
            names, figures.COLOURS, figures.MARKERS, (0.95, 1.0, 1.05), strict=False
        ):
            value, arms = _arms([interval(row[f"{target}: {name}"]) for row in simulated])
            axis.errorbar(counts * aside, value, yerr=arms, marker=marker, ms=4, capsize=2, color=colour, label=name)
            if cell := cycles[f"{target}: {name}"]:
                axis.axhline(interval(cell)[0], color=colour, lw=1.0, ls=":")
        axis.set_xscale("log")
        figures.plain_numbers(axis.xaxis)
        axis.set_xlabel("simulated pictures to train on")
        axis.set_title(target)
    axes[0].set_ylabel("right voxel, %")
    handles = axes[0].get_legend_handles_labels()[0]
    handles.append(Line2D([], [], color=figures.GREY, lw=1.0, ls=":", label="ten folds of 900 by Cycles"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    return figure


# --- cost and accuracy ----------------------------------------------------------------------------------------------


def _way(cell: str) -> str:
    """Return the name that `tradeoff` gives to a way to render: ``patch, 16, denoised`` is ``patch-16-denoised``."""
    return cell.replace(", ", "-")


def costs(table: list[Row]) -> Figure:
    """What `nlos-generate tradeoff` draws."""
    found = []
    for row in table:
        value, low, high = (number / 100.0 for number in interval(row["error"]))
        level = interval(row["light, relative to the reference"])
        seconds = float(row["core seconds a picture"])
        found.append(tradeoff.Cost(_way(row["way"]), seconds, (value, low, high), level, np.array([])))
    found.sort(key=lambda cost: cost.seconds)
    named = {_way(row["way"]) for row in table if row["best at its price"]}
    best = [number for number, cost in enumerate(found) if cost.name in named]
    return tradeoff.draw(found, best, "27 poses of the sphere in the room, against surfel at accuracy 1e-5")


def worths(table: list[Row]) -> Figure:
    """What `nlos-classify tradeoff` draws."""
    found = []
    for row in table:
        name = tradeoff.REFERENCE if row["way"] == "no noise of rendering" else _way(row["way"])
        right, error, detected = (
            Interval(*(number / 100.0 for number in interval(row[column])))
            for column in ("right voxel (%)", "median error", "detected (%)")
        )
        seconds = float(row["core seconds a picture"])
        found.append(worth.Worth(name, seconds, right, error, detected, 0, np.array([])))
    found.sort(key=lambda way: way.seconds)
    return worth.draw(found, "270 answers, one frame, with 95 % intervals")


def plan(table: list[Row]) -> Figure:
    """What `nlos-generate plan` draws."""
    effects, dropped = [], []
    for row in table:
        cell, decision = row["error of a difference picture"], row["decision"]
        value, low, high = UNKNOWN if cell == "not measured" else (number / 100.0 for number in interval(cell))
        note = "" if decision in (NEEDED, LEFT_OUT, KEPT) else decision
        effects.append(Effect(row["left out"], (value, low, high), note=note))
        if decision == LEFT_OUT:
            dropped.append(row["left out"])
    together = Effect("together", UNKNOWN)
    return plan_report.draw(Plan(effects, dropped, together, tolerance=0.01), "sphere in the room, tolerance 1 %")


# --- validation -----------------------------------------------------------------------------------------------------


@figures.styled
def scaling(table: list[Row]) -> Figure:
    """Seconds against poses, pixels and triangles."""
    figure, [axes] = figures.subplots(1, 3, size=(figures.WIDTH, 3.0))
    for axis, (name, label) in zip(
        axes,
        {"poses": "poses", "pixels": "pixels of a picture", "triangles": "triangles of the object"}.items(),
        strict=True,
    ):
        work, seconds = np.array(
            [(float(row["number"]), float(row["seconds"])) for row in table if row["of"] == name]
        ).T
        axis.plot(work, seconds, "o-", ms=4, label="measured")
        axis.plot(work, seconds[-1] * work / work[-1], color=figures.GREY, ls=":", label="in proportion")
        axis.set(xscale="log", yscale="log", xlabel=label)
        axis.set_ylim(bottom=0.3 * seconds.min())
    axes[0].set_ylabel("seconds")
    axes[0].legend(loc="upper left")
    return figure


@figures.styled
def error_at_request(table: list[Row]) -> Figure:
    """Error achieved against the accuracy asked for, a point for each pose."""
    kinds = sorted({row["kind"] for row in table})
    asked_for = sorted({float(row["requested"]) for row in table})
    figure, [axes] = figures.subplots(1, len(asked_for), size=(figures.WIDTH, 4.2), sharey=True)
    for axis, asked in zip(axes, asked_for, strict=True):
        for place, kind in enumerate(kinds):
            errors = np.array(
                [float(row["error"]) for row in table if row["kind"] == kind and float(row["requested"]) == asked]
            )
            spread = np.random.default_rng(0).uniform(-0.3, 0.3, len(errors))
            shown = np.maximum(errors, _LEAST)
            axis.scatter(shown, place + spread, s=6, color=figures.BLUE, lw=0, alpha=0.5, rasterized=True)
        axis.axvline(asked, color=figures.BLACK, lw=1.2)
        axis.set(xscale="log", xlabel="error achieved", title=f"asked for: {asked:g}")
        axis.grid(axis="y", visible=False)
    axes[0].set_yticks(range(len(kinds)), kinds)
    axes[0].invert_yaxis()
    return figure


_LEAST = 1e-9
"""Errors below are drawn here: pictures without any light."""


@figures.styled
def error_by_time(table: list[Row]) -> Figure:
    """Error against seconds, a panel for each scene, a line for each method."""
    scenes = list(dict.fromkeys(row["scene"] for row in table))
    names = list(dict.fromkeys(row["method"] for row in table))
    figure, [axes] = figures.subplots(1, len(scenes), size=(figures.WIDTH, 4.2), sharey=True)
    for axis, scene in zip(axes, scenes, strict=True):
        for name, colour, marker in zip(names, cycle(figures.COLOURS), cycle(figures.MARKERS)):
            _error_line(
                axis, [row for row in table if (row["scene"], row["method"]) == (scene, name)], colour, marker
            )
        axis.set(xscale="log", yscale="log", xlabel="seconds of a new pose", title=scene)
    axes[0].set_ylabel("error of the difference picture, relative")
    handles = [
        Line2D([], [], color=colour, marker=marker, ms=4, label=name)
        for name, colour, marker in zip(names, cycle(figures.COLOURS), cycle(figures.MARKERS))
    ]
    handles.append(Line2D([], [], color=figures.GREY, ls=":", label="extrapolated"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _error_line(axis: Axes, table: list[Row], colour: str, marker: str) -> None:
    measured = [row for row in table if row["setting"] != "extrapolated"]
    if not measured:
        return
    seconds, arms = _arms([(float(row["seconds"]), float(row["least"]), float(row["most"])) for row in measured])
    errors = [float(row["error"]) for row in measured]
    axis.errorbar(seconds, errors, xerr=arms, color=colour, marker=marker, ms=4, lw=1.2)
    for row in table:
        if row["setting"] == "extrapolated":
            axis.plot([seconds[-1], float(row["seconds"])], [errors[-1], float(row["error"])], ":", color=colour)


# --- robustness -----------------------------------------------------------------------------------------------------


@figures.styled
def endurance(table: list[Row]) -> Figure:
    """Memory and rate against the pictures done."""
    done, seconds, coordinator, *workers = np.array([[float(cell) for cell in row.values()] for row in table]).T
    figure, [[left, right]] = figures.subplots(1, 2, size=(figures.WIDTH, 3.1))
    for number, memory in enumerate(workers):
        # Both have the same memory, so one is drawn broken, over the other.
        left.plot(
            done[1:],
            memory[1:],
            ls=("-", "--")[number],
            lw=(3.0, 1.2)[number],
            label=("one worker", "the other")[number],
        )
    left.plot(done[1:], coordinator[1:], label="coordinator")
    left.set_ylim(bottom=0.0)
    left.set_ylabel("memory, MiB")
    left.legend(loc="center right")
    later = done > 0.1 * done[-1]
    right.plot(done[later][1:], np.diff(done[later]) / np.diff(seconds[later]), color=figures.BLUE, lw=1.0)
    right.set_ylim(bottom=0.0)
    right.set_ylabel("pictures a second")
    for axis in (left, right):
        axis.set_xlabel("pictures done")
    return figure


PICTURES = {
    "accuracy-global": Picture("reproduction", accuracy),
    "confusion-sheet": Picture("points/confusion", functools.partial(confusion, "sheet")),
    "confusion-sphere": Picture("points/confusion", functools.partial(confusion, "sphere")),
    "costs": Picture("costs", costs),
    "endurance": Picture("points/endurance", endurance),
    "error-at-request": Picture("points/errors-by-pose", error_at_request),
    "error-by-time": Picture("points/error-by-time", error_by_time),
    "learn": Picture("learn", learnt),
    "locate-sphere": Picture("points/locate-sphere", located),
    "plan": Picture("plan", plan),
    "scaling": Picture("scaling", scaling),
    "worth": Picture("worth", worths),
}


def main() -> None:
    """Draw the pictures that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(PICTURES)} (default: all)")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the pictures")
    options = parser.parse_args()
    if unknown := [name for name in options.names if name not in PICTURES]:
        parser.error(f"no picture is called {unknown[0]}; there are {', '.join(PICTURES)}")
    options.output.mkdir(parents=True, exist_ok=True)
    for name in options.names or PICTURES:
        for path in save(name, DATA / f"{PICTURES[name].data}.csv", options.output):
            print(path)


if __name__ == "__main__":
    main()
