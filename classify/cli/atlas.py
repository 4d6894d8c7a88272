"""The verb ``atlas``."""

from __future__ import annotations

import argparse
from pathlib import Path

from classify.cli.options import add_sensor_options, check_output, progress_bar, sensor_of
from generator.cli.answer import Answer, json_object
from generator.cli.options import Commands
from generator.model.described import described


def add_parsers(commands: Commands) -> None:
    """Add the verb ``atlas`` to a command line."""
    parser = commands.add_parser(
        "atlas",
        help="compress a simulated set to what a sensor can tell apart of it",
        description="Compress a simulated set (nlos-generate bulk) of a known object to what a camera's sensor can "
        "tell apart of its pictures: what locate and bound need.",
        epilog="example:\n  nlos-generate bulk room.blend -o simulated/ --pictures 90000 --accuracy 3e-3\n"
        "  nlos-classify atlas simulated/ -o room.atlas --frames 10",
    )
    parser.add_argument(
        "simulated",
        type=Path,
        nargs="+",
        metavar="SET",
        help="folder of a simulated set; of several, each with another object, any of them may be there",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.atlas")
    add_sensor_options(parser)
    parser.add_argument(
        "--lamp-drift",
        type=float,
        default=0.0,
        metavar="D",
        help="how much the lamp's strength may have changed since the background was taken, relative; it is fitted "
        "with every answer (default: 0)",
    )
    parser.add_argument(
        "--ambient-drift",
        type=float,
        default=0.0,
        metavar="D",
        help="how much uniform light on the wall may have come or gone since then, in units of the background's mean "
        "(default: 0)",
    )
    parser.add_argument(
        "--unknown",
        action="store_true",
        help="size and albedo of the object are not known: its pictures stand for all objects about like it",
    )
    parser.set_defaults(run=run_atlas, answer=Made)


@json_object
class Made:
    """An atlas that was made."""

    path: Path = described("the atlas")
    pictures: int = described("pictures of it")
    targets: list[str] = described("objects that they show")
    numbers: int = described("numbers that are kept of each picture")
    left_out: float = described("what these leave out of a picture, in units of its noise")
    frames: int = described("frames averaged for a picture")


def run_atlas(options: argparse.Namespace) -> Answer:
    """Make an atlas from simulated sets."""
    from classify.inference import atlas_build, atlas_file
    from generator.sets.bulk_set import Bulk

    sensor = sensor_of(options)
    check_output(options.output)
    first, *others = map(Bulk.open, options.simulated)
    with progress_bar("compressing", "pictures") as progress:
        atlas = atlas_build.build(
            first,
            sensor,
            *others,
            lamp_drift=options.lamp_drift,
            ambient_drift=options.ambient_drift,
            unknown=options.unknown,
            progress=lambda done, total: progress(done, total, ""),
        )
    atlas_file.save(options.output, atlas)
    n, k = atlas.codes.shape
    values = Made(
        path=options.output,
        pictures=n,
        targets=atlas.about["targets"],
        numbers=k,
        left_out=float(atlas.left_out),
        frames=atlas.sensor.frames,
    )
    line = (
        f"{options.output}: {n} pictures of a {' or a '.join(values.targets)}, {k} numbers each; what they leave out "
        f"is {atlas.left_out:.2f} of the noise"
    )
    return Answer(values, [line])
