"""The verb ``bulk``: many small pictures by the noise-free engine."""

from __future__ import annotations

import argparse
from pathlib import Path

from generator.cli.options import (
    Commands,
    add_force_option,
    add_links_option,
    add_pose_options,
    add_probe_option,
    chosen_settings,
    farm_of,
)
from generator.cli.terminal import progress_bar, report
from generator.jobs.request import BulkRequest


def add_parsers(commands: Commands) -> None:
    """Add the verb ``bulk`` to a command line."""
    parser = commands.add_parser(
        "bulk",
        help="make a very large set: up to millions of pictures in a few hundred HDF5 files",
        description="As sweep does, with the engine surfel, but straight into HDF5: set.h5 shows all pictures as one "
        "array. Interrupt it at any time: the same command goes on where it stopped. What is left out "
        "follows from the set, if there is one, else from the scene.",
        epilog="example:\n  nlos-generate bulk room.blend -o million/ --pictures 1000000 --resolution 64",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scene", type=Path, help="the .blend file")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="SET", help="folder of the set")
    parser.add_argument("--pictures", type=int, metavar="N", help="in all voxels together; needed for a new set")
    add_pose_options(parser, "of all poses")
    parser.add_argument("--accuracy", type=float, metavar="A", help="relative error of a picture (default: 0.001)")
    parser.add_argument(
        "--compress",
        action=argparse.BooleanOptionalAction,
        help="smaller files, several times slower to write and to read (default: off)",
    )
    parser.add_argument(
        "--unknown",
        action=argparse.BooleanOptionalAction,
        help="at every pose another box or sheet in place of the target, for an unknown object",
    )
    parser.add_argument("--part", type=int, metavar="N", help="pictures per file (default: about 64 MiB)")
    parser.add_argument("--shard", default="0/1", metavar="i/n", help="make the i-th of n shares only (from 0)")
    parser.add_argument("--workers", type=int, default=0, metavar="W", help="processes (default: one per core)")
    add_force_option(parser)
    add_probe_option(parser)
    add_links_option(parser)
    parser.set_defaults(run=run_bulk)


def run_bulk(options: argparse.Namespace) -> int:
    """Make a bulk set, or what is missing of it."""
    from generator.jobs import bulk
    from generator.sets import bulk_set

    request = BulkRequest(
        scene=options.scene,
        path=options.output,
        chosen=chosen_settings(options, bulk_set.Settings, pictures=1),
        force=options.force,
        probe=options.probe,
        trust_links=options.trust_links,
        **farm_of(options),
    )
    with progress_bar() as progress:
        outcome = bulk.run(request, progress=progress, tell=print)
    return report(outcome.bulk, outcome.rendered, outcome.remaining, outcome.failed)
