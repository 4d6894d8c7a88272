"""The verbs ``compare``, ``learn``, ``train`` and ``predict``: classifiers."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from classify.classifiers.names import ALL, NAMES
from classify.cli.options import add_seed, check_output, progress_bar
from generator.cli import console
from generator.cli.terminal import print_table
from generator.model.errors import NlosError

if TYPE_CHECKING:
    from generator.files.pictures import Picture
from classify.cli.options import RAW, Commands


def add_parsers(commands: Commands) -> None:
    """Add the verbs ``compare``, ``train``, ``learn`` and ``predict`` to a command line."""
    _add_compare(commands)
    _add_train(commands)
    _add_learn(commands)
    _add_predict(commands)


def _add_compare(commands: Commands) -> None:
    parser = commands.add_parser(
        "compare",
        help="compare classifiers on one or two sets of features",
        description=f"Compare {', '.join(NAMES)}, by the paper's settings and tuned: each set cross-validated, and "
        "with two also trained on one and tested on the other.",
        epilog="example:\n  nlos-classify compare sheet.h5 sphere.h5 -o report/",
        formatter_class=RAW,
    )
    parser.add_argument("features", type=Path, nargs="+", metavar="FILE.h5", help="one or two")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="for tables, figures and page"
    )
    parser.add_argument("--folds", type=int, default=10, metavar="N", help="default: 10")
    add_seed(parser, "of folds and classifiers")
    parser.add_argument("--settings", choices=["paper", "tuned", "both"], default="both", help="default: both")
    parser.set_defaults(run=run_compare)


def _add_train(commands: Commands) -> None:
    parser = commands.add_parser(
        "train",
        help="train one classifier on all of a set, and save it",
        description="Train one classifier on all of a set, and save it with what it needs to read a picture.",
        epilog="example:\n  nlos-classify train sheet.h5 -o sheet.skops --classifier SVM",
        formatter_class=RAW,
    )
    parser.add_argument("features", type=Path, metavar="FILE.h5")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.skops")
    parser.add_argument("--classifier", default="SVM", metavar="NAME", help=f"one of {', '.join(ALL)} (default: SVM)")
    parser.add_argument("--settings", choices=["paper", "tuned"], default="tuned", help="default: tuned")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="default: 0")
    parser.set_defaults(run=run_train)


def _add_learn(commands: Commands) -> None:
    parser = commands.add_parser(
        "learn",
        help="say what more pictures to train on are worth",
        description="Train classifiers on more and more pictures of a set, and say how often each is right and how "
        "long it took: on a fifth of the set that is held out, or on another set.",
        epilog="example:\n  nlos-classify features simulated/ -o simulated.h5 --set physics --sensor default\n"
        "  nlos-classify learn simulated.h5 --test sphere.h5 -o learned/ --classifiers RF SVM MLP",
        formatter_class=RAW,
    )
    parser.add_argument("features", type=Path, metavar="FILE.h5", help="to train on")
    parser.add_argument("--test", type=Path, metavar="FILE.h5", help="other pictures to test on")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="for report.html, learn.csv and learn.png"
    )
    parser.add_argument(
        "--classifiers", nargs="+", metavar="NAME", help=f"some of {', '.join(ALL)} (default: all but MLP)"
    )
    parser.add_argument("--counts", type=int, nargs="+", metavar="N", help="default: 30, 100, 300, ... and all")
    parser.add_argument("--settings", choices=["paper", "tuned"], default="paper", help="default: paper")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="default: 0")
    parser.set_defaults(run=run_learn)


def _add_predict(commands: Commands) -> None:
    parser = commands.add_parser(
        "predict",
        help="say in which voxel the object stands, picture by picture",
        description="Say for each picture in which voxel the object stands, and how probable each voxel is.",
        epilog="example:\n  nlos-classify predict sheet.skops sheet/E/0007.exr --json",
        formatter_class=RAW,
    )
    parser.add_argument("model", type=Path, metavar="FILE.skops")
    parser.add_argument("pictures", type=Path, nargs="+", metavar="PICTURE.exr")
    parser.add_argument("--json", action="store_true", help="one JSON object per picture and line")
    parser.add_argument(
        "--background",
        type=Path,
        metavar="FILE.exr",
        help="picture without the object (default: the training scene's)",
    )
    parser.set_defaults(run=run_predict)


def run_compare(options: argparse.Namespace) -> int:
    """Compare classifiers, and write the report."""
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
    """Draw learning curves."""
    from classify.classifiers import curves
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
            classifiers=options.classifiers or tuple(NAMES),
            settings=options.settings,
            counts=options.counts or (),
            seed=options.seed,
            names=(str(options.features), str(options.test)),
            progress=progress,
        )
    table = curves.rows(points)
    tested_on = options.test or f"{100 * curves.HELD_OUT:.0f} % of it, held out"
    title = f"{options.features}, tested on {tested_on}"
    print_table(title, curves.HEADINGS, table)
    best = max(points, key=lambda point: point.accuracy.value)
    lead = [f"{best.classifier} on {best.count} pictures is right most often: {best.accuracy.percent()}."]
    if rivals := curves.rivals(points, best):
        lead.append(f"Not told apart from it by these pictures: {', '.join(rivals)}.")
    print(" ".join(lead))
    write_text(options.output / "learn.csv", csv_text(curves.HEADINGS, table))
    curves.draw(options.output / "learn.png", points, title)
    plots = {"learn.png": "Accuracy with its 95 % interval, against the number of pictures and the time of training."}
    sources = {"trained on": options.features, "tested on": options.test or "a part held out", "seed": options.seed}
    tables = [page.Table(title, curves.HEADINGS, table)]
    print(page.write(options.output, "What are more pictures worth?", lead, plots, tables, sources))
    return 0


def run_train(options: argparse.Namespace) -> int:
    """Train a classifier, and save it."""
    from classify.classifiers import models
    from classify.pictures import feature_table

    check_output(options.output)
    model = models.train(
        feature_table.read(options.features), options.classifier, options.settings, seed=options.seed
    )
    models.save(options.output, model)
    chosen = ", ".join(f"{k} = {v}" for k, v in model.about["chosen"].items())
    print(f"{options.output}: {options.classifier}, {options.settings} settings{f' ({chosen})' if chosen else ''}")
    return 0


def run_predict(options: argparse.Namespace) -> int:
    """Print the voxel that a model predicts for each picture."""
    from classify.classifiers import models
    from generator.files.pictures import COLOUR_SPACE, read_picture
    from generator.sets.readable import check_colours

    model = models.load(options.model)

    def read(path: Path) -> Picture:
        pixels, header = read_picture(path)
        check_colours(path, header.get("colour_space", COLOUR_SPACE), model.colour_space, str(options.model))
        return pixels

    background = read(options.background) if options.background else None
    answers = []  # collected before printing, so that a broken picture leaves no partial output
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
