"""The verbs ``compare``, ``learn``, ``train`` and ``predict``: classifiers."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from classify.cli.options import check_output, progress_bar
from generator.cli import console
from generator.cli.terminal import print_table
from generator.model.errors import NlosError

if TYPE_CHECKING:
    from generator.files.pictures import Picture


def run_compare(options: argparse.Namespace) -> int:
    from classify.classifiers import evaluate, models
    from classify.pictures import feature_table
    from classify.report import comparison

    if len(options.features) > 2:
        raise NlosError(f"compare: takes one or two features files, not {len(options.features)}")
    if options.folds < 2:
        raise NlosError(f"--folds {options.folds}: must be 2 or more")
    check_output(options.output, folder=True)
    sets = [feature_table.read(path) for path in options.features]
    names = [str(path) for path in options.features]
    for features, name in zip(sets, names, strict=True):
        if features.duplicates:
            console.complain(
                f"warning: {name}: {features.duplicates} of {len(features.values)} pictures have exactly the "
                "features of another; where both sides of a fold hold one, accuracy is flattered"
            )
    chosen: list[models.Settings] = ["paper", "tuned"] if options.settings == "both" else [options.settings]
    with progress_bar("comparing", "classifiers") as progress:
        results = evaluate.compare(
            sets, names, settings=chosen, folds=options.folds, seed=options.seed, progress=progress
        )
    page = comparison.write(options.output, results, sets, names, options.folds)
    print_table(
        "accuracy with its 95 % interval",
        ("scenario", "classifier", "paper's", "its settings, here", "tuned, here"),
        comparison.text_table(results),
    )
    unconverged = sum(r.unconverged for r in results)
    if unconverged:
        print(f"{unconverged} fits ended at their iteration limit, before they converged")
    print(page)
    return 0


def run_learn(options: argparse.Namespace) -> int:
    from classify.classifiers import curves, models
    from classify.pictures import feature_table
    from classify.report import page
    from generator.files.writing import csv_text, write_text

    check_output(options.output, folder=True)
    train = feature_table.read(options.features)
    test = feature_table.read(options.test) if options.test else None
    with progress_bar("learning", "fits") as progress:
        points = curves.curves(
            train,
            test,
            classifiers=options.classifiers or tuple(models.NAMES),
            settings=options.settings,
            counts=options.counts or (),
            seed=options.seed,
            names=(str(options.features), str(options.test)),
            progress=progress,
        )
    table = curves.rows(points)
    where = options.test or f"{100 * curves.HELD_OUT:.0f} % of it, held out"
    title = f"{options.features}, tested on {where}"
    print_table(title, curves.HEADINGS, table)
    best = max(points, key=lambda point: point.accuracy.value)
    lead = [f"{best.classifier} on {best.count} pictures is right most often: {best.accuracy.percent()}."]
    print(lead[0])
    write_text(options.output / "learn.csv", csv_text(curves.HEADINGS, table))
    curves.draw(options.output / "learn.png", points, title)
    drawn = {"learn.png": "Accuracy with its 95 % interval, against the number of pictures and the time of training."}
    sources = {"trained on": options.features, "tested on": options.test or "a part held out", "seed": options.seed}
    tables = [page.Table(title, curves.HEADINGS, table)]
    print(page.write(options.output, "What are more pictures worth?", lead, drawn, tables, sources))
    return 0


def run_train(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from classify.pictures import feature_table

    check_output(options.output)
    model = models.train(
        feature_table.read(options.features), options.classifier, options.settings, seed=options.seed
    )
    models.save(options.output, model)
    picked = ", ".join(f"{k} = {v}" for k, v in model.about["chosen"].items())
    print(f"{options.output}: {options.classifier}, {options.settings} settings{f' ({picked})' if picked else ''}")
    return 0


def run_predict(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from generator.files.pictures import COLOUR_SPACE, read_picture
    from generator.sets.readable import check_colours

    model = models.load(options.model)

    def read(path: Path) -> Picture:
        pixels, header = read_picture(path)
        check_colours(path, header.get("colour_space", COLOUR_SPACE), model.colour_space, str(options.model))
        return pixels

    background = read(options.background) if options.background else None
    answers = []  # all before any is printed: a broken picture leaves no half answer
    for path in options.pictures:
        pixels = read(path)
        answers.append((path, model.probabilities(pixels, background=background, name=str(path))))
    for path, voxels in answers:
        label = max(voxels, key=lambda v: voxels[v])
        if options.json:
            print(json.dumps({"picture": str(path), "label": label, "probability": voxels}))
        else:
            likely = sorted(voxels.items(), key=lambda item: -item[1])
            print(f"{path}: {label}   " + "  ".join(f"{voxel} {p:.1%}" for voxel, p in likely if p >= 5e-4))
    return 0
