"""Command line of the classifier: argument parsing and words for people; all work is done elsewhere."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from classify.cli.atlas import run_atlas, run_bound
from classify.cli.features import run_features
from classify.cli.learn import run_compare, run_learn, run_predict, run_train
from classify.cli.locate import run_detect, run_locate, run_track, run_tradeoff
from classify.cli.options import RAW, add_sensor_options
from generator.cli.terminal import guarded

_EXAMPLES = """\
examples:
  nlos-classify features sheet/ -o sheet.h5 --set global
  nlos-classify compare sheet.h5 sphere.h5 -o report/
  nlos-classify train sheet.h5 -o sheet.skops --classifier SVM
  nlos-classify predict sheet.skops sheet/E/0007.exr
"""


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
        formatter_class=RAW,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    features = commands.add_parser(
        "features",
        help="describe every picture of a data set by numbers, into HDF5",
        description="Describe every picture of a data set by numbers, into one HDF5 file.",
        epilog="example:\n  nlos-classify features sheet/ -o sheet.h5 --set spatial-hog",
        formatter_class=RAW,
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
    add_sensor_options(features, "as clean radiance")
    features.add_argument("--seed", type=int, default=0, metavar="N", help="of the sensor's noise (default: 0)")
    features.set_defaults(run=run_features)

    compare = commands.add_parser(
        "compare",
        help="compare seven classifiers on one or two sets of features",
        description="Compare seven classifiers, by the paper's settings and tuned: each set cross-validated, and "
        "with two also trained on one and tested on the other.",
        epilog="example:\n  nlos-classify compare sheet.h5 sphere.h5 -o report/",
        formatter_class=RAW,
    )
    compare.add_argument("features", type=Path, nargs="+", metavar="FILE.h5", help="one or two")
    compare.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="for tables, figures and page"
    )
    compare.add_argument("--folds", type=int, default=10, metavar="N", help="default: 10")
    compare.add_argument("--seed", type=int, default=0, metavar="N", help="of folds and classifiers (default: 0)")
    compare.add_argument("--settings", choices=["paper", "tuned", "both"], default="both", help="default: both")
    compare.set_defaults(run=run_compare)

    train = commands.add_parser(
        "train",
        help="train one classifier on all of a set, and save it",
        description="Train one classifier on all of a set, and save it with what it needs to read a picture.",
        epilog="example:\n  nlos-classify train sheet.h5 -o sheet.skops --classifier SVM",
        formatter_class=RAW,
    )
    train.add_argument("features", type=Path, metavar="FILE.h5")
    train.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.skops")
    train.add_argument(
        "--classifier", default="SVM", metavar="NAME", help="LR, LDA, KNN, CART, RF, SVM, NB or MLP (default: SVM)"
    )
    train.add_argument("--settings", choices=["paper", "tuned"], default="tuned", help="default: tuned")
    train.add_argument("--seed", type=int, default=0, metavar="N", help="default: 0")
    train.set_defaults(run=run_train)

    learn = commands.add_parser(
        "learn",
        help="say what more pictures to train on are worth",
        description="Train classifiers on more and more pictures of a set, and say how often each is right and how "
        "long it took: on a fifth of the set that is held out, or on another set.",
        epilog="example:\n  nlos-classify features simulated/ -o simulated.h5 --set physics --sensor default\n"
        "  nlos-classify learn simulated.h5 --test sphere.h5 -o learned/ --classifiers RF SVM MLP",
        formatter_class=RAW,
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
    learn.set_defaults(run=run_learn)

    predict = commands.add_parser(
        "predict",
        help="say in which voxel the object stands, picture by picture",
        description="Say for each picture in which voxel the object stands, and how probable each voxel is.",
        epilog="example:\n  nlos-classify predict sheet.skops sheet/E/0007.exr --json",
        formatter_class=RAW,
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
    predict.set_defaults(run=run_predict)

    atlas = commands.add_parser(
        "atlas",
        help="compress a simulated set to what a sensor can tell apart of it",
        description="Compress a simulated set (nlos-generate bulk) of a known object to what a camera's sensor can "
        "tell apart of its pictures: what locate and bound need.",
        epilog="example:\n  nlos-generate bulk room.blend -o simulated/ --pictures 90000 --accuracy 3e-3\n"
        "  nlos-classify atlas simulated/ -o room.atlas --frames 10",
        formatter_class=RAW,
    )
    atlas.add_argument(
        "simulated",
        type=Path,
        nargs="+",
        metavar="SET",
        help="folder of a simulated set; of several, each with another object, any of them may be there",
    )
    atlas.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.atlas")
    add_sensor_options(atlas)
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
    atlas.set_defaults(run=run_atlas)

    locate = commands.add_parser(
        "locate",
        help="say whether there is something, in which voxel, and where",
        description="Find a known object in every picture of a data set, as the atlas' sensor would have seen it, "
        "and say how often voxel, position and presence are right.",
        epilog="example:\n  nlos-classify locate room.atlas sphere/ -o answers/",
        formatter_class=RAW,
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
    locate.set_defaults(run=run_locate)

    trade = commands.add_parser(
        "tradeoff",
        help="say what better pictures are worth",
        description="Answer the pictures that nlos-generate tradeoff rendered in every way, through the atlas' "
        "sensor: from which samples on the sensor's noise decides, and rendering no longer.",
        epilog="example:\n  nlos-generate tradeoff room.blend -o trade/\n  nlos-classify tradeoff trade/ room.atlas",
        formatter_class=RAW,
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
    trade.set_defaults(run=run_tradeoff)

    track = commands.add_parser(
        "track",
        help="follow an object that moves, frame by frame",
        description="Follow a known object through the frames of a trajectory, as the atlas' sensor would have seen "
        "them: where it is after each, how sure, and how far from the truth.",
        epilog="example:\n  nlos-generate trajectory room.blend -o walk/ --frames 200 --engine surfel\n"
        "  nlos-classify track room.atlas walk/ -o track/ --gap 80:110",
        formatter_class=RAW,
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
    track.set_defaults(run=run_track)

    detect = commands.add_parser(
        "detect",
        help="say how often an object is found, against exposure and distance",
        description="Say how often the atlas' object is found at a chosen rate of false alarms, voxel by voxel and "
        "for several exposures: where and how long one has to look.",
        epilog="example:\n  nlos-classify atlas simulated/ -o room.atlas --frames 1000 --sensor long.toml\n"
        "  nlos-classify detect room.atlas -o detect/ --exposures 1 10 100 1000",
        formatter_class=RAW,
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
    detect.set_defaults(run=run_detect)

    bound = commands.add_parser(
        "bound",
        help="say how well any method can answer, voxel by voxel",
        description="Say how well voxel, position and presence can be known from a picture at all: what the sensor's "
        "noise leaves of it, by Bayes' rule and by the bound of Cramer and Rao.",
        epilog="example:\n  nlos-classify bound room.atlas simulated/",
        formatter_class=RAW,
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
    bound.set_defaults(run=run_bound)
    return parser


if __name__ == "__main__":
    sys.exit(main())
