"""The verb ``features``."""

from __future__ import annotations

import argparse
from pathlib import Path

from classify.cli.options import RAW, Commands, add_seed, add_sensor_options, check_output, progress_bar, sensor_of
from classify.pictures.settings import FeatureSettings
from generator.cli.options import add_setting


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
    add_setting(parser, "set", FeatureSettings)
    add_setting(parser, "input", FeatureSettings)
    add_setting(parser, "tone", FeatureSettings)
    add_setting(parser, "floor", FeatureSettings, type=float, metavar="F")
    add_setting(parser, "ceiling", FeatureSettings, type=float, metavar="F")
    add_setting(parser, "size", FeatureSettings, type=int, metavar="N")
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
    from generator.sets.simulated import open_set

    names = ("set", "input", "tone", "floor", "ceiling", "size")
    settings = FeatureSettings(**{n: getattr(options, n) for n in names if getattr(options, n) is not None})
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
