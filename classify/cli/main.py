"""Command line of the classifier: argument parsing and words for people; all work is done elsewhere."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from generator.cli import console
from generator.cli.main import LineProgress, guarded, left_words, print_table
from generator.jobs.remaining import Remaining
from generator.model.spec import NlosError

if TYPE_CHECKING:
    from classify.inference.atlas import Atlas
    from classify.pictures.sensor import Sensor
    from generator.sets.dataset import Picture

_EXAMPLES = """\
examples:
  nlos-classify features sheet/ -o sheet.h5 --set global
  nlos-classify compare sheet.h5 sphere.h5 -o report/
  nlos-classify train sheet.h5 -o sheet.skops --classifier SVM
  nlos-classify predict sheet.skops sheet/E/0007.exr
"""
_RAW = argparse.RawDescriptionHelpFormatter


def main(argv: list[str] | None = None) -> int:
    """Run ``nlos-classify``; return the exit code: 0 well, 2 bad input, 130 interrupted, 141 nobody reads on."""
    return guarded(lambda: _run(argv), "interrupted; nothing was written")


def _run(argv: list[str] | None) -> int:
    options = _parser().parse_args(argv)
    return int(options.run(options))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="nlos-classify",
        description="Tell from pictures of the relay wall in which voxel the hidden object stands.",
        epilog=_EXAMPLES,
        formatter_class=_RAW,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    features = commands.add_parser(
        "features",
        help="describe every picture of a data set by numbers, into HDF5",
        description="Describe every picture of a data set by numbers, into one HDF5 file.",
        epilog="example:\n  nlos-classify features sheet/ -o sheet.h5 --set spatial-hog",
        formatter_class=_RAW,
    )
    features.add_argument("dataset", type=Path, help="folder of a data set, or of a simulated set")
    features.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.h5")
    features.add_argument(
        "--set",
        choices=["global", "spatial-hog", "physics"],
        default="global",
        help="global: colour histogram, Hu moments, Haralick texture; spatial-hog: small copy, colour histogram, "
        "HOG; physics: level, shape without level, and the fit of an unknown target",
    )
    features.add_argument(
        "--input",
        choices=["difference", "raw"],
        default="difference",
        help="picture minus background, or the picture itself (default: difference)",
    )
    features.add_argument(
        "--tone",
        choices=["log", "linear"],
        default="log",
        help="log keeps shades in near and far voxels alike; linear is like 8 bits of the brightest (default: log)",
    )
    features.add_argument(
        "--floor",
        type=float,
        default=1e-7,
        metavar="F",
        help="where log turns linear, in units of the lit patch's radiance (default: 1e-7)",
    )
    features.add_argument(
        "--ceiling",
        type=float,
        default=1e-3,
        metavar="F",
        help="what counts as white, in the same units (default: 1e-3)",
    )
    features.add_argument(
        "--size", type=int, default=32, metavar="N", help="average down to N pixels a side (default: 32)"
    )
    features.add_argument(
        "--count",
        type=int,
        default=0,
        metavar="N",
        help="take the first N pictures of a simulated set (default: all)",
    )
    features.add_argument("--partial", action="store_true", help="take an unfinished data set as it is")
    _add_sensor_options(features, "as clean radiance")
    features.add_argument("--seed", type=int, default=0, metavar="N", help="of the sensor's noise (default: 0)")
    features.set_defaults(run=_features)

    compare = commands.add_parser(
        "compare",
        help="compare seven classifiers on one or two sets of features",
        description="Compare seven classifiers, by the paper's settings and tuned: each set cross-validated, and "
        "with two also trained on one and tested on the other.",
        epilog="example:\n  nlos-classify compare sheet.h5 sphere.h5 -o report/",
        formatter_class=_RAW,
    )
    compare.add_argument("features", type=Path, nargs="+", metavar="FILE.h5", help="one or two")
    compare.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="for tables, figures and page"
    )
    compare.add_argument("--folds", type=int, default=10, metavar="N", help="default: 10")
    compare.add_argument("--seed", type=int, default=0, metavar="N", help="of folds and classifiers (default: 0)")
    compare.add_argument("--settings", choices=["paper", "tuned", "both"], default="both", help="default: both")
    compare.set_defaults(run=_compare)

    train = commands.add_parser(
        "train",
        help="train one classifier on all of a set, and save it",
        description="Train one classifier on all of a set, and save it with what it needs to read a picture.",
        epilog="example:\n  nlos-classify train sheet.h5 -o sheet.skops --classifier SVM",
        formatter_class=_RAW,
    )
    train.add_argument("features", type=Path, metavar="FILE.h5")
    train.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.skops")
    train.add_argument(
        "--classifier", default="SVM", metavar="NAME", help="LR, LDA, KNN, CART, RF, SVM, NB or MLP (default: SVM)"
    )
    train.add_argument("--settings", choices=["paper", "tuned"], default="tuned", help="default: tuned")
    train.add_argument("--seed", type=int, default=0, metavar="N", help="default: 0")
    train.set_defaults(run=_train)

    learn = commands.add_parser(
        "learn",
        help="say what more pictures to train on are worth",
        description="Train classifiers on more and more pictures of a set, and say how often each is right and how "
        "long it took: on a fifth of the set that is held out, or on another set.",
        epilog="example:\n  nlos-classify features simulated/ -o simulated.h5 --set physics --sensor default\n"
        "  nlos-classify learn simulated.h5 --test sphere.h5 -o learned/ --classifiers RF SVM MLP",
        formatter_class=_RAW,
    )
    learn.add_argument("features", type=Path, metavar="FILE.h5", help="to train on")
    learn.add_argument("--test", type=Path, metavar="FILE.h5", help="other pictures to test on")
    learn.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="for report.html, learn.csv and learn.png"
    )
    learn.add_argument(
        "--classifiers", nargs="+", metavar="NAME", help="LR, LDA, KNN, CART, RF, SVM, NB, MLP (default: all but MLP)"
    )
    learn.add_argument("--counts", type=int, nargs="+", metavar="N", help="default: 30, 100, 300, ... and all")
    learn.add_argument("--settings", choices=["paper", "tuned"], default="paper", help="default: paper")
    learn.add_argument("--seed", type=int, default=0, metavar="N", help="default: 0")
    learn.set_defaults(run=_learn)

    predict = commands.add_parser(
        "predict",
        help="say in which voxel the object stands, picture by picture",
        description="Say for each picture in which voxel the object stands, and how probable each voxel is.",
        epilog="example:\n  nlos-classify predict sheet.skops sheet/E/0007.exr --json",
        formatter_class=_RAW,
    )
    predict.add_argument("model", type=Path, metavar="FILE.skops")
    predict.add_argument("pictures", type=Path, nargs="+", metavar="PICTURE.exr")
    predict.add_argument("--json", action="store_true", help="one JSON object per picture and line")
    predict.add_argument(
        "--background",
        type=Path,
        metavar="FILE.exr",
        help="picture without the object (default: the training scene's)",
    )
    predict.set_defaults(run=_predict)

    atlas = commands.add_parser(
        "atlas",
        help="compress a simulated set to what a sensor can tell apart of it",
        description="Compress a simulated set (nlos-generate bulk) of a known object to what a camera's sensor can "
        "tell apart of its pictures: what locate and bound need.",
        epilog="example:\n  nlos-generate bulk room.blend -o simulated/ --pictures 90000 --accuracy 3e-3\n"
        "  nlos-classify atlas simulated/ -o room.atlas --frames 10",
        formatter_class=_RAW,
    )
    atlas.add_argument(
        "simulated",
        type=Path,
        nargs="+",
        metavar="SET",
        help="folder of a simulated set; of several, each with another object, any of them may be there",
    )
    atlas.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.atlas")
    _add_sensor_options(atlas)
    atlas.add_argument(
        "--lamp-drift",
        type=float,
        default=0.0,
        metavar="D",
        help="how much the lamp's strength may have changed since the background was taken, relative; it is fitted "
        "with every answer (default: 0)",
    )
    atlas.add_argument(
        "--ambient-drift",
        type=float,
        default=0.0,
        metavar="D",
        help="how much uniform light on the wall may have come or gone since then, in units of the background's mean "
        "(default: 0)",
    )
    atlas.add_argument(
        "--unknown",
        action="store_true",
        help="size and albedo of the object are not known: its pictures stand for all objects about like it",
    )
    atlas.set_defaults(run=_atlas)

    locate = commands.add_parser(
        "locate",
        help="say whether there is something, in which voxel, and where",
        description="Find a known object in every picture of a data set, as the atlas' sensor would have seen it, "
        "and say how often voxel, position and presence are right.",
        epilog="example:\n  nlos-classify locate room.atlas sphere/ -o answers/",
        formatter_class=_RAW,
    )
    locate.add_argument("atlas", type=Path, metavar="FILE.atlas")
    locate.add_argument(
        "dataset", type=Path, help="folder of a data set, or a simulated one; its pictures are clean, noise is added"
    )
    locate.add_argument(
        "--count",
        type=int,
        default=0,
        metavar="N",
        help="take the first N pictures of a simulated set (default: all)",
    )
    locate.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="for report.html and answers.csv")
    locate.add_argument("--seed", type=int, default=0, metavar="N", help="of the sensor's noise (default: 0)")
    locate.add_argument(
        "--false-alarm", type=float, default=0.01, metavar="P", help="share of empty scenes (default: 0.01)"
    )
    locate.add_argument(
        "--frames", type=int, metavar="N", help="to average, no more than the atlas was made for (default: as many)"
    )
    locate.add_argument(
        "--voxels",
        type=int,
        nargs=3,
        metavar=("NX", "NY", "NZ"),
        help="cut the volume into others than the scene's; for sets with --inside centre, which leave no gaps",
    )
    locate.set_defaults(run=_locate)

    trade = commands.add_parser(
        "tradeoff",
        help="say what better pictures are worth",
        description="Answer the pictures that nlos-generate tradeoff rendered in every way, through the atlas' "
        "sensor: from which samples on the sensor's noise decides, and rendering no longer.",
        epilog="example:\n  nlos-generate tradeoff room.blend -o trade/\n  nlos-classify tradeoff trade/ room.atlas",
        formatter_class=_RAW,
    )
    trade.add_argument("folder", type=Path, help="of nlos-generate tradeoff")
    trade.add_argument("atlas", type=Path, metavar="FILE.atlas")
    trade.add_argument("--noises", type=int, default=5, metavar="N", help="looks at each picture (default: 5)")
    trade.add_argument("--seed", type=int, default=0, metavar="N", help="of the sensor's noise (default: 0)")
    trade.add_argument(
        "--false-alarm", type=float, default=0.01, metavar="P", help="share of empty scenes (default: 0.01)"
    )
    trade.add_argument(
        "--frames", type=int, metavar="N", help="to average, no more than the atlas was made for (default: as many)"
    )
    trade.set_defaults(run=_tradeoff)

    track = commands.add_parser(
        "track",
        help="follow an object that moves, frame by frame",
        description="Follow a known object through the frames of a trajectory, as the atlas' sensor would have seen "
        "them: where it is after each, how sure, and how far from the truth.",
        epilog="example:\n  nlos-generate trajectory room.blend -o walk/ --frames 200 --engine surfel\n"
        "  nlos-classify track room.atlas walk/ -o track/ --gap 80:110",
        formatter_class=_RAW,
    )
    track.add_argument(
        "atlas", type=Path, metavar="FILE.atlas", help="of poses that fill the volume: --inside centre"
    )
    track.add_argument("dataset", type=Path, help="folder of the trajectory")
    track.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="for report.html, track.csv and track.png")
    track.add_argument(
        "--step",
        type=float,
        default=0.06,
        metavar="M",
        help="standard deviation of its walk along each axis from frame to frame, metres: about twice its pace if it "
        "keeps its way for a while (default: 0.06)",
    )
    track.add_argument(
        "--gap",
        action="append",
        default=[],
        metavar="FROM:TO",
        help="take the object away for these frames; repeatable",
    )
    track.add_argument(
        "--follow",
        type=float,
        default=0.0,
        metavar="S",
        help="while the trajectory is being rendered: wait S seconds for the next frame (default: 0)",
    )
    track.add_argument("--seed", type=int, default=0, metavar="N", help="of the sensor's noise (default: 0)")
    track.add_argument(
        "--frames", type=int, metavar="N", help="to average, no more than the atlas was made for (default: as many)"
    )
    track.set_defaults(run=_track)

    detect = commands.add_parser(
        "detect",
        help="say how often an object is found, against exposure and distance",
        description="Say how often the atlas' object is found at a chosen rate of false alarms, voxel by voxel and "
        "for several exposures: where and how long one has to look.",
        epilog="example:\n  nlos-classify atlas simulated/ -o room.atlas --frames 1000 --sensor long.toml\n"
        "  nlos-classify detect room.atlas -o detect/ --exposures 1 10 100 1000",
        formatter_class=_RAW,
    )
    detect.add_argument("atlas", type=Path, metavar="FILE.atlas")
    detect.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="for report.html, detect.csv and detect.png"
    )
    detect.add_argument(
        "--exposures",
        type=int,
        nargs="+",
        metavar="N",
        help="frames averaged, no more than the atlas was made for (default: 1, 3, 10, ... up to these)",
    )
    detect.add_argument(
        "--false-alarm", type=float, default=0.01, metavar="P", help="share of empty scenes (default: 0.01)"
    )
    detect.add_argument("--count", type=int, default=300, metavar="N", help="pictures in each voxel (default: 300)")
    detect.add_argument("--seed", type=int, default=0, metavar="N", help="of poses and noise (default: 0)")
    detect.set_defaults(run=_detect)

    bound = commands.add_parser(
        "bound",
        help="say how well any method can answer, voxel by voxel",
        description="Say how well voxel, position and presence can be known from a picture at all: what the sensor's "
        "noise leaves of it, by Bayes' rule and by the bound of Cramer and Rao.",
        epilog="example:\n  nlos-classify bound room.atlas simulated/",
        formatter_class=_RAW,
    )
    bound.add_argument("atlas", type=Path, metavar="FILE.atlas")
    bound.add_argument("simulated", type=Path, metavar="SET", help="folder of the simulated set that it is of")
    bound.add_argument(
        "--map", type=Path, metavar="FILE.png", help="draw the bounds over the hidden volume, seen from above"
    )
    bound.add_argument("--count", type=int, default=3000, metavar="N", help="pictures to try (default: 3000)")
    bound.add_argument("--seed", type=int, default=0, metavar="N", help="of pictures and noise (default: 0)")
    bound.add_argument(
        "--frames", type=int, metavar="N", help="to average, no more than the atlas was made for (default: as many)"
    )
    bound.add_argument(
        "--voxels",
        type=int,
        nargs=3,
        metavar=("NX", "NY", "NZ"),
        help="cut the volume into others than the scene's; for sets with --inside centre, which leave no gaps",
    )
    bound.set_defaults(run=_bound)
    return parser


_SENSORS = ("full_well", "read_noise", "bits", "exposure", "fill", "frames", "background_frames", "gain_spread")


def _add_sensor_options(parser: argparse.ArgumentParser, otherwise: str = "by the default sensor") -> None:
    parser.add_argument(
        "--sensor",
        metavar="default|FILE.toml",
        help=f"see the pictures through a camera's sensor; a file may name {', '.join(_SENSORS)}, offset_spread and "
        "drift. The default has a full well of 10,500 electrons, the brightest pixel at 80 %% of it, a read noise of "
        f"2.5, 12 bits (without it: {otherwise})",
    )
    parser.add_argument("--frames", type=int, metavar="N", help="that the sensor averages for a picture (default: 1)")


def _sensor(options: argparse.Namespace) -> Sensor:
    from dataclasses import replace

    from classify.pictures.sensor import Sensor
    from generator.model.spec import from_dict, read_toml

    named = options.sensor not in (None, "default")
    sensor: Sensor = from_dict(Sensor, read_toml(Path(options.sensor)), "sensor.") if named else Sensor()
    return sensor if options.frames is None else replace(sensor, frames=options.frames)


def _check_output(path: Path, *, folder: bool = False) -> None:
    """Say before the work, not after it, that its result has no place to go."""
    if path.exists() and path.is_dir() != folder:
        raise NlosError(f"{path}: is a {'file' if folder else 'folder'}; name a {'folder' if folder else 'file'}")
    place = next(p for p in [path, *path.absolute().parents] if p.exists())
    if not (path.exists() or place.is_dir()) or not os.access(place, os.W_OK):
        raise NlosError(f"{path}: cannot be written")


@contextlib.contextmanager
def _progress(what: str, unit: str) -> Iterator[Callable[[int, int, str], None]]:
    if not sys.stderr.isatty():
        lines = LineProgress(unit)
        yield lambda done, total, now: lines(done, total)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    remaining = Remaining()
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)

        def show(done: int, total: int, now: str) -> None:
            left = left_words(remaining.told(done, total))
            bar.update(task, completed=done, total=total, description=f"{now or what}{left}")

        yield show


def _features(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from classify.pictures import feature_table
    from classify.pictures.features import FeatureSettings
    from generator.sets.simulated import opened

    settings = FeatureSettings(
        set=options.set,
        input=options.input,
        tone=options.tone,
        floor=options.floor,
        ceiling=options.ceiling,
        size=options.size,
    )
    models.check_seed(options.seed)
    sensor = None if options.sensor is None and options.frames is None else _sensor(options)
    dataset = opened(options.dataset, options.count)
    _check_output(options.output)
    with _progress("describing", "pictures") as progress:
        features = feature_table.extract(
            dataset,
            settings,
            partial=options.partial,
            sensor=sensor,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    feature_table.write(options.output, features)
    n, d = features.values.shape
    missing = "" if n == dataset.planned else f" (of {dataset.planned} planned)"
    print(f"{options.output}: {n} pictures{missing}, {d} features each ({settings.set}, {settings.input})")
    return 0


def _compare(options: argparse.Namespace) -> int:
    from classify.classifiers import evaluate, models
    from classify.pictures import feature_table
    from classify.report import comparison

    if len(options.features) > 2:
        raise NlosError(f"compare: takes one or two features files, not {len(options.features)}")
    if options.folds < 2:
        raise NlosError(f"--folds {options.folds}: must be 2 or more")
    _check_output(options.output, folder=True)
    sets = [feature_table.read(path) for path in options.features]
    names = [str(path) for path in options.features]
    for features, name in zip(sets, names, strict=True):
        if features.duplicates:
            console.complain(
                f"warning: {name}: {features.duplicates} of {len(features.values)} pictures have exactly the "
                "features of another; where both sides of a fold hold one, accuracy is flattered"
            )
    chosen: list[models.Settings] = ["paper", "tuned"] if options.settings == "both" else [options.settings]
    with _progress("comparing", "classifiers") as progress:
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


def _learn(options: argparse.Namespace) -> int:
    from classify.classifiers import curves, models
    from classify.pictures import feature_table
    from classify.report import page
    from generator.sets.dataset import csv_text, write_text

    _check_output(options.output, folder=True)
    train = feature_table.read(options.features)
    test = feature_table.read(options.test) if options.test else None
    with _progress("learning", "fits") as progress:
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


def _train(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from classify.pictures import feature_table

    _check_output(options.output)
    model = models.train(
        feature_table.read(options.features), options.classifier, options.settings, seed=options.seed
    )
    models.save(options.output, model)
    picked = ", ".join(f"{k} = {v}" for k, v in model.about["chosen"].items())
    print(f"{options.output}: {options.classifier}, {options.settings} settings{f' ({picked})' if picked else ''}")
    return 0


def _predict(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from generator.sets.dataset import COLOUR_SPACE, check_colours, read_picture

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


def _atlas(options: argparse.Namespace) -> int:
    from classify.inference import atlas
    from generator.sets.bulk import Bulk

    sensor = _sensor(options)
    _check_output(options.output)
    first, *others = map(Bulk.open, options.simulated)
    with _progress("compressing", "pictures") as progress:
        made = atlas.build(
            first,
            sensor,
            *others,
            lamp_drift=options.lamp_drift,
            ambient_drift=options.ambient_drift,
            unknown=options.unknown,
            progress=lambda done, total: progress(done, total, ""),
        )
    atlas.save(options.output, made)
    n, k = made.codes.shape
    print(
        f"{options.output}: {n} pictures of a {' or a '.join(made.about['targets'])}, {k} numbers each; what they "
        f"leave out is {made.left_out:.2f} of the noise"
    )
    return 0


def _locate(options: argparse.Namespace) -> int:
    import numpy as np

    from classify.classifiers import models
    from classify.inference import evaluation
    from classify.report import page
    from generator.sets.dataset import write_text
    from generator.sets.simulated import opened

    models.check_seed(options.seed)
    if options.output:
        _check_output(options.output, folder=True)
    found = _loaded(options)
    dataset = opened(options.dataset, options.count)
    with _progress("locating", "pictures") as progress:
        answers = evaluation.run(
            found,
            dataset,
            false_alarm=options.false_alarm,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    title = f"{options.dataset}, each with its 95 % interval"
    headings = ("voxel", "pictures", "right voxel", "median error", "within 95 % region", "detected")
    table = answers.rows()
    print_table(title, headings, table)
    alarms = f"in empty scenes, something is found in {answers.false_alarms().percent()}"
    print(alarms)
    print(f"an answer takes {1000.0 * float(np.median(answers.seconds)):.1f} ms (median)")
    if answers.level != 1.0:
        print(
            f"exposed {answers.level:.3g} times as long as the atlas, so that the empty scene is as bright as there: "
            "right if the relay wall, the lamp or the camera is another, wrong if the room is"
        )
    if options.output:
        write_text(options.output / "answers.csv", answers.csv())
        answers.draw(options.output / "answers.png", dataset.target_kind)
        _, count, right, error, held, detected = table[-1]
        lead = [
            f"Of {count} pictures, {right} are put into the right voxel; the position is off by {error} (median).",
            f"The stated 95 % regions hold the truth in {held}.",
            f"Something is found in {detected}; {alarms}.",
        ]
        figures = {"answers.png": "What is taken for what, how far off, and whether the stated uncertainty is true."}
        sources = {"data set": options.dataset, **page.of_atlas(found), "seed of the noise": options.seed}
        tables = [page.Table(title, headings, table)]
        print(page.write(options.output, "Where is the hidden object?", lead, figures, tables, sources))
    return 0


def _loaded(options: argparse.Namespace) -> Atlas:
    """The atlas that was named, for as many frames and cut into the voxels that were asked for."""
    from classify.inference import atlas

    found = atlas.load(options.atlas)
    found = found if options.frames is None else found.at(options.frames)
    voxels = getattr(options, "voxels", None)
    return found if voxels is None else found.cut(tuple(voxels))


def _tradeoff(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from classify.inference import worth
    from classify.report import page

    models.check_seed(options.seed)
    if options.noises < 1:
        raise NlosError(f"--noises {options.noises}: must be 1 or more")
    if not options.folder.is_dir():
        raise NlosError(f"{options.folder}: no such folder")
    atlas = _loaded(options)
    with _progress("answering", "ways to render") as progress:
        found = worth.worths(
            options.folder,
            atlas,
            false_alarm=options.false_alarm,
            noises=options.noises,
            seed=options.seed,
            progress=progress,
        )
    table, lead = worth.rows(found), worth.enough(found)
    frames = atlas.sensor.frames
    title = f"{options.folder}: {found[0].count} answers each, {frames} frame{'s' if frames > 1 else ''}"
    print_table(title, worth.HEADINGS, table)
    for line in lead:
        print(line)
    worth.draw(options.folder / "worth.png", found, title)
    drawn = {"worth.png": "Against the time that a picture takes to render, with 95 % intervals."}
    sources = {"pictures": options.folder, **page.of_atlas(atlas), "seed of the noise": options.seed}
    tables = [page.Table(title, worth.HEADINGS, table)]
    print(page.write(options.folder, "What are better pictures worth?", lead, drawn, tables, sources))
    return 0


def _track(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from classify.inference import sequence
    from classify.report import page
    from generator.sets.dataset import Dataset, write_text

    models.check_seed(options.seed)
    gaps = [_gap(text) for text in options.gap]
    if options.output:
        _check_output(options.output, folder=True)

    def told(so_far: sequence.Pursuit) -> None:
        record, step = so_far.records[-1], so_far.steps[-1]
        x, y, z = step.position
        label = found.grid.labels[step.voxels.argmax()]
        where = f"{label} at {x:.2f}, {y:.2f}, {z:.2f} m" if step.found else "nothing"
        print(f"frame {record.index}: {where} (presence {step.presence:.0%})", flush=True)

    found = _loaded(options)
    followed = sequence.run(
        found,
        Dataset.open(options.dataset),
        step=options.step,
        gaps=gaps,
        patience=options.follow,
        seed=options.seed,
        told=told,
    )
    for line in followed.words():
        print(line)
    if options.output:
        write_text(options.output / "track.csv", followed.csv())
        followed.draw(options.output / "track.png", str(options.dataset))
        figures = {"track.png": "The path with its uncertainty, and the error over time."}
        sources = {"trajectory": options.dataset, **page.of_atlas(found), "seed of the noise": options.seed}
        print(page.write(options.output, "How does it move?", followed.words(), figures, [], sources))
    return 0


def _gap(text: str) -> tuple[int, int]:
    first, _, last = text.partition(":")
    try:
        gap = (int(first), int(last))
    except ValueError:
        gap = (0, 0)
    if not 0 <= gap[0] < gap[1]:
        raise NlosError(f"--gap {text!r}: must read FROM:TO, two frames, for example 80:110")
    return gap


def _detect(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from classify.inference import atlas, detect
    from classify.report import page
    from generator.sets.dataset import csv_text, write_text

    models.check_seed(options.seed)
    if options.count < 1:
        raise NlosError(f"--count {options.count}: must be 1 or more")
    if options.output:
        _check_output(options.output, folder=True)
    found = atlas.load(options.atlas)
    most = found.sensor.frames
    exposures = options.exposures or sorted({n for n in (*_LADDER, most) if n <= most})
    with _progress("looking", "exposures") as progress:
        made = detect.detections(
            found,
            exposures,
            false_alarm=options.false_alarm,
            count=options.count,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    headings = ["voxel", "from the wall", *(f"{n} frame{'s' if n > 1 else ''}" for n in exposures)]
    table = detect.rows(found, made)
    print_table(f"{options.atlas}: found, at {100.0 * options.false_alarm:g} % false alarms", headings, table)
    if options.output:
        write_text(options.output / "detect.csv", csv_text(headings, table))
        detect.draw(options.output / "detect.png", found, made, options.false_alarm)
        last = made[-1]
        least = min(range(len(last.found)), key=lambda voxel: last.found[voxel].value)
        lead = [
            f"At {100.0 * options.false_alarm:g} % false alarms and {last.frames} frames, something in voxel "
            f"{found.grid.labels[least]} is found least often: {last.found[least].percent()}."
        ]
        figures = {"detect.png": "Left: against exposure, with 95 % intervals. Right: against false alarms."}
        sources = {**page.of_atlas(found), "pictures in each voxel": options.count, "seed": options.seed}
        tables = [page.Table("Found, with its 95 % interval", headings, table)]
        print(page.write(options.output, "Is there something?", lead, figures, tables, sources))
    return 0


_LADDER = [n * 10**k for k in range(7) for n in (1, 3)]


def _bound(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from classify.inference import bound
    from classify.inference.posterior import Synthesis
    from generator.sets.bulk import Bulk

    models.check_seed(options.seed)
    if options.count < 1:
        raise NlosError(f"--count {options.count}: must be 1 or more")
    if options.map:
        _check_output(options.map)
    found, simulated = _loaded(options), Bulk.open(options.simulated)
    if found.about.get("fingerprints") != [simulated.meta["fingerprint"]]:
        raise NlosError(f"{options.atlas}: is not an atlas of {options.simulated}; make it anew")
    # Cramer and Rao ask about a known object, by derivatives.
    lit = simulated.world().ambient is not None
    one = not simulated.plan.unknown and not lit
    if options.map and not one:
        what = "is under ambient light, where the engine knows no derivatives" if lit else "is of many"
        raise NlosError(f"--map: draws what can be known of one object, and {options.simulated} {what}")
    with _progress("asking", "pictures") as progress:
        best = bound.reachable(
            found,
            count=options.count,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    synthesis = Synthesis(found, simulated.world()) if one else None
    headings = ["voxel", "right voxel"]
    if one:
        headings += ["presence", "x cm", "y cm", "z cm", "turn unknown", "noticed: x cm", "y cm", "z cm"]
    title = f"{options.atlas}: the best that any method can do"
    print_table(title, headings, bound.rows(found, best, synthesis))
    print(f"median error of the position, wherever the object is: {best.error.centimetres()}")
    if synthesis is None:
        return 0
    print(
        "presence: in standard deviations of the noise; x, y, z: least standard deviation in the middle of the voxel "
        "by Cramer and Rao, and of all three together where the turn is unknown too; noticed: least movement that "
        "shows between two pictures, at 1 % false alarms and 99 % detections"
    )
    if options.map:
        with _progress("mapping", "places") as progress:
            drawn = bound.over_volume(synthesis, progress=lambda done, total: progress(done, total, ""))
        bound.draw(options.map, found, drawn)
        print(options.map)
    return 0


if __name__ == "__main__":
    sys.exit(main())
