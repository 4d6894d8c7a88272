"""The verb ``features``."""

from __future__ import annotations

import argparse
from pathlib import Path

from classify.cli.options import add_seed, add_sensor_options, check_output, progress_bar, sensor_of
from classify.pictures.settings import FeatureSettings
from generator.cli.answer import Answer, json_object
from generator.cli.options import Commands, add_setting, group_of
from generator.model.described import described
from generator.model.errors import NlosError


def add_parsers(commands: Commands) -> None:
    """Add the verb ``features`` to a command line."""
    parser = commands.add_parser(
        "features",
        help="describe every picture of a data set by numbers, into HDF5",
        description="Describe every picture of a data set by numbers, into one HDF5 file.",
        epilog="example:\n  nlos-classify features sheet/ -o sheet.h5 --features spatial-hog",
    )
    parser.add_argument("dataset", type=Path, metavar="SET", help="folder of a data set, or of a simulated set")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.h5")
    group = group_of(parser, "features")
    add_setting(group, "set", FeatureSettings, flag="--features")
    add_setting(group, "input", FeatureSettings)
    add_setting(group, "tone", FeatureSettings)
    add_setting(group, "floor", FeatureSettings, type=float, metavar="F")
    add_setting(group, "ceiling", FeatureSettings, type=float, metavar="F")
    add_setting(group, "size", FeatureSettings, type=int, metavar="N")
    parser.add_argument(
        "--count",
        type=int,
        default=0,
        metavar="N",
        help="take the first N pictures of a simulated set (default: all)",
    )
    parser.add_argument("--partial", action="store_true", help="take an unfinished data set as it is")
    add_sensor_options(parser, "as clean radiance")
    add_seed(parser, "of the sensor's noise", default=None)
    parser.alias("--set", "--features")
    parser.set_defaults(run=run_features, answer=Described)


@json_object
class Described:
    """Features that were written."""

    path: Path = described("the HDF5 file")
    pictures: int = described("pictures that it describes")
    planned: int = described("pictures of the finished set")
    features: int = described("numbers of each picture")
    set: str = described("the set of features")
    input: str = described("difference or raw")


def run_features(options: argparse.Namespace) -> Answer:
    """Extract the features of every picture of a set."""
    from classify.classifiers import models
    from classify.pictures import feature_table
    from generator.sets.simulated import open_set

    names = ("set", "input", "tone", "floor", "ceiling", "size")
    settings = FeatureSettings(**{n: getattr(options, n) for n in names if getattr(options, n) is not None})
    unnamed = options.sensor is None and options.frames is None and options.exposure_time is None
    sensor = None if unnamed else sensor_of(options)
    if sensor is None and options.seed is not None:
        raise NlosError("--seed: is of the sensor's noise; name a sensor with --sensor, or leave it out")
    idle = ("tone", "ceiling") if settings.set == "physics" else ("floor",) if settings.tone == "linear" else ()
    for name in idle:
        if getattr(options, name) is not None:
            taken = "the features physics" if settings.set == "physics" else "--tone linear"
            raise NlosError(f"--{name}: means nothing to {taken}; leave it out")
    seed = options.seed or 0
    models.check_seed(seed)
    dataset = open_set(options.dataset, options.count)
    check_output(options.output)
    with progress_bar("describing", "pictures") as progress:
        features = feature_table.extract(
            dataset,
            settings,
            partial=options.partial,
            sensor=sensor,
            seed=seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    feature_table.write(options.output, features)
    n, d = features.values.shape
    values = Described(
        path=options.output,
        pictures=n,
        planned=dataset.planned,
        features=d,
        set=settings.set,
        input=settings.input,
    )
    missing = "" if n == dataset.planned else f" (of {dataset.planned} planned)"
    line = f"{options.output}: {n} pictures{missing}, {d} features each ({settings.set}, {settings.input})"
    return Answer(values, [line])
