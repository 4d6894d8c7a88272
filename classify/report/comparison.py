"""Figures, tables and HTML page of a comparison of classifiers."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from classify.classifiers.evaluate import Result, as_best, rivals
from classify.classifiers.names import NAMES
from classify.intervals import Interval
from classify.pictures.feature_table import Features
from generator.files.writing import csv_text, write_text
from generator.measure import figures
from generator.model.grid import VoxelGrid

# Table 1 of the paper: accuracy, precision, recall, F1. Its data set 1 is the sheet and 2 the sphere (5.2, and the
# accuracies named in section 6); section 5.3.2 says the reverse by mistake.
PAPER: dict[str, dict[str, tuple[float, float, float, float]]] = {
    "sheet": {
        "LR": (0.61, 0.45, 0.53, 0.47),
        "LDA": (0.70, 0.70, 0.67, 0.68),
        "KNN": (0.63, 0.56, 0.55, 0.54),
        "CART": (0.59, 0.51, 0.49, 0.50),
        "RF": (0.60, 0.54, 0.53, 0.53),
        "SVM": (0.78, 0.73, 0.73, 0.74),
        "NB": (0.49, 0.49, 0.45, 0.42),
    },
    "sphere": {
        "LR": (0.64, 0.60, 0.58, 0.58),
        "LDA": (0.72, 0.72, 0.72, 0.71),
        "KNN": (0.66, 0.65, 0.65, 0.65),
        "CART": (0.63, 0.66, 0.65, 0.65),
        "RF": (0.65, 0.64, 0.64, 0.64),
        "SVM": (0.76, 0.75, 0.75, 0.73),
        "NB": (0.40, 0.43, 0.39, 0.37),
    },
}

_COLOURS = {"paper": figures.SKY, "tuned": figures.BLUE}


def paper_row(result: Result) -> tuple[float, float, float, float] | None:
    """Return the paper's accuracy, precision, recall and F1 for the same scenario, if it reports them.

    The paper's sets show one sheet or one sphere of fixed reflectivity, which alone are named so.
    """
    return PAPER.get(result.train, {}).get(result.classifier) if result.train == result.test else None


def write(
    folder: Path, results: Sequence[Result], sets: Sequence[Features], names: Sequence[str], folds: int
) -> Path:
    """Write tables, figures and the page into a folder, each to a temporary file that is then renamed.

    Parameters
    ----------
    folder : Path
        Output folder; files of other names in it are kept.
    results : sequence of Result
    sets : sequence of Features
        Sets that the results come from.
    names : sequence of str
        File names of the sets.
    folds : int

    Returns
    -------
    Path
        Path of the HTML page, which needs no other file.
    """
    write_text(folder / "results.csv", csv_text(_RESULT_COLUMNS, [_result_row(r) for r in results]))
    write_text(
        folder / "confusion.csv",
        csv_text(
            ["train", "test", "classifier", "settings", "truth", "predicted", "count"],
            [row for r in results for row in _confusion_rows(r)],
        ),
    )
    drawn = {"comparison.png": comparison_figure(results)}
    best = {}
    for scenario in dict.fromkeys(r.scenario for r in results):
        subset = [r for r in results if r.scenario == scenario]
        best[scenario] = max(subset, key=lambda r: r.accuracy.value)
        shown = {
            (r.classifier, r.settings): r for r in [*(r for r in subset if r.classifier == "SVM"), best[scenario]]
        }
        drawn[f"confusion-{_slug(scenario)}.png"] = confusion_figure(list(shown.values()))
    images = {}
    for name, figure in drawn.items():
        figures.save(folder / name, figure)
        images[name] = (folder / name).read_bytes()
    page = _page(results, sets, names, folds, best, images)
    write_text(folder / "report.html", page)
    return folder / "report.html"


@figures.styled
def comparison_figure(results: Sequence[Result]) -> Figure:
    """The paper's figure 6: accuracy of each classifier, fold by fold, one panel per scenario."""
    scenarios = list(dict.fromkeys(r.scenario for r in results))
    columns = min(2, len(scenarios))
    rows = -(-len(scenarios) // columns)
    figure, axes = figures.subplots(rows, columns, size=(max(5.0, 4.0 * columns), 2.7 * rows + 0.6), sharey=True)
    for axis in axes.flat[len(scenarios) :]:
        axis.set_visible(False)
    for axis, scenario in zip(axes.flat, scenarios, strict=False):
        subset = [r for r in results if r.scenario == scenario]
        order = [c for c in NAMES if any(r.classifier == c for r in subset)]
        kinds = [s for s in _COLOURS if any(r.settings == s for r in subset)]
        width = 0.8 / len(kinds)
        for k, kind in enumerate(kinds):
            for r in (r for r in subset if r.settings == kind):
                x = order.index(r.classifier) + (k - (len(kinds) - 1) / 2) * width
                _draw_accuracy(axis, x, width, r)
        published = [(i, PAPER.get(scenario, {}).get(c)) for i, c in enumerate(order)]
        if any(p for _, p in published):
            axis.plot(
                [i for i, p in published if p],
                [100.0 * p[0] for _, p in published if p],
                "D",
                color=figures.VERMILION,
                ms=5,
                zorder=4,
            )
        chance = 1.0 / len(subset[0].labels)
        axis.axhline(100.0 * chance, color=figures.GREY, lw=0.8, ls=":")
        axis.set_xticks(range(len(order)), order)
        axis.set_title(f"trained and tested on the {scenario}" if "->" not in scenario else _words(scenario))
        axis.set_ylim(0.0, 102.0)
        axis.grid(axis="x", visible=False)
    for row in axes:
        row[0].set_ylabel("accuracy, %")
    handles = [Line2D([], [], color=c, lw=6, label=f"{s} settings") for s, c in _COLOURS.items()]
    handles += [
        Line2D([], [], color=figures.VERMILION, marker="D", ls="", label="the paper's figure"),
        Line2D([], [], color=figures.GREY, ls=":", label="chance"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2 * columns, frameon=False)
    return figure


def _draw_accuracy(axis: Any, x: float, width: float, r: Result) -> None:
    colour = _COLOURS[r.settings]
    if len(r.folds) > 1:
        box = axis.boxplot(
            [[100.0 * f for f in r.folds]], positions=[x], widths=width * 0.85, patch_artist=True, manage_ticks=False
        )
        box["boxes"][0].set(facecolor=colour)
        box["medians"][0].set(color="black")
        for flier in box["fliers"]:
            flier.set(marker=".", markersize=4)
    else:  # a single test set has no folds: draw its interval instead
        value, low, high = (100.0 * v for v in (r.accuracy.value, r.accuracy.low, r.accuracy.high))
        axis.errorbar([x], [value], [[value - low], [high - value]], fmt="o", color=colour, ms=4, capsize=3)


@figures.styled
def confusion_figure(results: Sequence[Result]) -> Figure:
    """Confusion matrices side by side, each row in per cent of the pictures of that true voxel."""
    figure, axes = figures.subplots(1, len(results), size=(max(4.4, 2.8 * len(results)), 3.6))
    for axis, r in zip(axes[0], results, strict=True):
        share = 100.0 * r.confusion / np.maximum(r.confusion.sum(axis=1, keepdims=True), 1)
        figures.heat_map(axis, share, r.labels)
        accuracy = f"{100.0 * r.accuracy.value:.1f} % right"
        axis.set_title(f"{r.classifier}, {r.settings}: {accuracy}")
        axis.set_xlabel("predicted voxel")
    axes[0][0].set_ylabel("true voxel (rows in %)")
    figure.suptitle(_words(results[0].scenario))
    return figure


def confusions(result: Result, grid: VoxelGrid, most: int = 5) -> list[tuple[str, str, int, str]]:
    """Return the pairs of voxels that are confused most often: two labels, count, and relative position in words."""
    symmetric = np.triu(result.confusion + result.confusion.T, 1)
    pairs = sorted(((int(symmetric[i, j]), i, j) for i, j in np.argwhere(symmetric > 0)), reverse=True)[:most]
    index = {label: i for i, label in enumerate(grid.labels)}
    return [
        (a, b, count, "" if "+" in a + b else _relation(grid, index[a], index[b]))
        for count, a, b in ((count, result.labels[i], result.labels[j]) for count, i, j in pairs)
    ]


def _relation(grid: VoxelGrid, a: int, b: int) -> str:
    offsets = np.abs(np.subtract(grid.cell(a), grid.cell(b)))
    words = [
        f"{n} {'voxel' if n == 1 else 'voxels'} apart {direction}"
        for n, direction in zip(offsets, ("along the wall", "in distance from the wall", "in height"), strict=True)
        if n
    ]
    return " and ".join(words)


def text_table(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """Return the accuracy table as text: scenario, classifier, paper, here with its settings, and here tuned."""
    rows = []
    for scenario in dict.fromkeys(r.scenario for r in results):
        for classifier in NAMES:
            by_settings = {r.settings: r for r in results if r.scenario == scenario and r.classifier == classifier}
            if by_settings:
                published = paper_row(next(iter(by_settings.values())))
                cells = [by_settings[s].accuracy.percent() if s in by_settings else "" for s in _COLOURS]
                rows.append((_words(scenario), classifier, f"{published[0]:.0%}" if published else "-", *cells))
    return rows


_RESULT_COLUMNS = [
    *("train", "test", "classifier", "settings", "accuracy", "accuracy_low", "accuracy_high"),
    *(
        "precision",
        "precision_low",
        "precision_high",
        "recall",
        "recall_low",
        "recall_high",
        "f1",
        "f1_low",
        "f1_high",
    ),
    *("paper_accuracy", "paper_precision", "paper_recall", "paper_f1"),
    *("train_seconds", "predict_seconds_per_picture", "tested", "unconverged_fits"),
]


def _result_row(r: Result) -> list[object]:
    scores = [v for i in (r.accuracy, r.precision, r.recall, r.f1) for v in (i.value, i.low, i.high)]
    published = paper_row(r) or ("",) * 4
    numbers = [f"{v:.4f}" for v in scores]
    return [
        *(r.train, r.test, r.classifier, r.settings, *numbers, *published),
        *(f"{r.train_seconds:.4g}", f"{r.predict_seconds:.4g}", int(r.confusion.sum()), r.unconverged),
    ]


def _confusion_rows(r: Result) -> list[list[object]]:
    return [
        [r.train, r.test, r.classifier, r.settings, r.labels[i], r.labels[j], int(r.confusion[i, j])]
        for i, j in np.argwhere(r.confusion > 0)
    ]


def _slug(scenario: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in scenario.replace(" -> ", "-to-"))


def _words(scenario: str) -> str:
    train, arrow, test = scenario.partition(" -> ")
    return f"trained on {train}, tested on {test}" if arrow else scenario


def _map(result: Result, grid: VoxelGrid) -> list[list[tuple[str, float | None]]]:
    """Recall per voxel as seen from above, farthest row first, averaged over the layers of height."""
    recall = np.diagonal(result.confusion) / np.maximum(result.confusion.sum(axis=1), 1)
    by_cell: dict[tuple[int, int], list[tuple[str, float]]] = {}
    index = {label: i for i, label in enumerate(grid.labels)}
    for label, value in zip(result.labels, recall, strict=True):
        for name in label.split("+"):  # of several objects, each voxel's recall is the mean over what it holds with
            x, y, _ = grid.cell(index[name])
            by_cell.setdefault((x, y), []).append((name, float(value)))
    rows = []
    for y in reversed(range(grid.shape[1])):
        row: list[tuple[str, float | None]] = []
        for x in range(grid.shape[0]):
            cell = by_cell.get((x, y), [])
            row.append(
                (" ".join(dict.fromkeys(c[0] for c in cell)), float(np.mean([c[1] for c in cell])) if cell else None)
            )
        rows.append(row)
    return rows


def _page(
    results: Sequence[Result],
    sets: Sequence[Features],
    names: Sequence[str],
    folds: int,
    best: dict[str, Result],
    images: dict[str, bytes],
) -> str:
    loader = jinja2.FileSystemLoader(Path(__file__).parent / "templates")
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters["percent"] = Interval.percent
    grid = sets[0].grid
    sections = [
        {
            "title": _words(scenario),
            "best": winner,
            "accuracy": as_best(
                winner.right, among=sum(r.scenario == scenario for r in results), effect=winner.effect
            ),
            "rivals": ", ".join(f"{r.classifier} {r.settings}" for r in rivals(results, winner)),
            "rows": [(r, paper_row(r)) for r in results if r.scenario == scenario],
            "crossed": winner.train != winner.test,
            "image": f"confusion-{_slug(scenario)}.png",
            "map": _map(winner, grid) if grid.n_voxels <= 200 else None,
            "confused": confusions(winner, grid),
        }
        for scenario, winner in best.items()
    ]
    return environment.get_template("report.html").render(
        sections=sections,
        images={name: base64.b64encode(data).decode() for name, data in images.items()},
        classifiers=NAMES,
        chance=1.0 / len(results[0].labels),
        folds=folds,
        sets=list(zip(names, sets, strict=True)),
        settings=sets[0].settings,
        grid=grid,
        unconverged=sum(r.unconverged for r in results),
    )
