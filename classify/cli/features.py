"""The verb ``features``."""

from __future__ import annotations

import argparse
from pathlib import Path

from classify.cli.options import RAW, Commands, add_seed, add_sensor_options, check_output, progress_bar, sensor_of


def add_parsers(commands: Commands) -> None:
    """Add the verb ``features`` to a command line."""
    parser = commands.add_parser(
        "features",
        help="describe every picture of a data set by numbers, into HDF5",
        description="Describe every picture of a data set by numbers, into one HDF5 file.",
        epilog="example:\n  nlos-classify features sheet/ -o sheet.h5 --set spatial-hog",
        formatter_class=RAW,
    )
    parser.add_argument("dataset", type=Path, help="folder of a data set, or of a simulated set")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.h5")
    parser.add_argument(
        "--set",
        choices=["global", "spatial-hog", "physics"],
        default="global",
        help="global: colour histogram, Hu moments, Haralick texture; spatial-hog: small copy, colour histogram, "
        "HOG; physics: level, shape without level, and the fit of an unknown target",
    )
    parser.add_argument(
        "--input",
        choices=["difference", "raw"],
        default="difference",
        help="picture minus background, or the picture itself (default: difference)",
    )
    parser.add_argument(
        "--tone",
        choices=["log", "linear"],
        default="log",
        help="log keeps shades in near and far voxels alike; linear is like 8 bits of the brightest (default: log)",
    )
    parser.add_argument(
        "--floor",
        type=float,
        default=1e-7,
        metavar="F",
        help="where log turns linear, in units of the lit patch's radiance (default: 1e-7)",
    )
    parser.add_argument(
        "--ceiling",
        type=float,
        default=1e-3,
        metavar="F",
        help="what counts as white, in the same units (default: 1e-3)",
    )
    parser.add_argument(
        "--size", type=int, default=32, metavar="N", help="average down to N pixels a side (default: 32)"
    )
    parser.add_argument(
        "--count",
        type=int,
        default=0,
        metavar="N",
        help="take the first N pictures of a simulated set (default: all)",
    )
    parser.add_argument("--partial", action="store_true", help="take an unfinished data set as it is")
    add_sensor_options(parser, "as clean radiance")
    add_seed(parser, "of the sensor's noise")
    parser.set_defaults(run=run_features)


def run_features(options: argparse.Namespace) -> int:
    """Extract the features of every picture of a set."""
    from classify.classifiers import models
    from classify.pictures import feature_table
    from classify.pictures.features import FeatureSettings
    from generator.sets.simulated import open_set

    settings = FeatureSettings(
        set=options.set,
        input=options.input,
        tone=options.tone,
        floor=options.floor,
        ceiling=options.ceiling,
        size=options.size,
    )
    models.check_seed(options.seed)
    sensor = None if options.sensor is None and options.frames is None else sensor_of(options)
    dataset = open_set(options.dataset, options.count)
    check_output(options.output)
    with progress_bar("describing", "pictures") as progress:
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
