"""The verb ``bulk``: many small pictures by the noise-free engine."""

from __future__ import annotations

import argparse
from pathlib import Path

from generator.cli.answer import Answer
from generator.cli.options import (
    Commands,
    add_force_option,
    add_links_option,
    add_pose_options,
    add_probe_option,
    add_setting,
    add_vary_option,
    chosen_settings,
    farm_of,
    farm_options,
    group_of,
    option,
)
from generator.cli.rendered import Rendered, report
from generator.cli.terminal import progress_bar
from generator.cli.volume import note
from generator.files.uncertainty_file import plain_values, read_uncertainty
from generator.jobs.request import BulkRequest
from generator.model.quantities import fraction
from generator.sets.bulk_settings import Settings


def add_parsers(commands: Commands) -> None:
    """Add the verb ``bulk`` to a command line."""
    parser = commands.add_parser(
        "bulk",
        help="make a very large set: up to millions of pictures in a few hundred HDF5 files",
        description="As sweep does, with the engine surfel, but straight into HDF5: set.h5 shows all pictures as one "
        "array. Interrupt it at any time: the same command goes on where it stopped. What is left out "
        "follows from the set, if there is one, else from the scene.",
        epilog="example:\n  nlos-generate bulk room.blend -o million/ --pictures 1000000 --resolution 64",
    )
    parser.add_argument("scene", type=Path, help="the .blend file")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="SET", help="folder of the set")
    poses = group_of(parser, "poses and pictures")
    add_setting(poses, "pictures", Settings, default="none; needed for a new set", type=int, metavar="N")
    add_pose_options(parser)
    add_vary_option(parser)
    add_setting(poses, "uncertain", Settings, default="none", type=Path, metavar="uncertainty.toml")
    add_setting(poses, "unknown", Settings)
    add_setting(poses, "stream", Settings, default="bulk")
    add_setting(group_of(parser, "rendering"), "accuracy", Settings, type=option(fraction), metavar="A")
    files = group_of(parser, "files")
    add_setting(files, "compress", Settings)
    add_setting(files, "part", Settings, type=int, metavar="N")
    farm = farm_options(parser)
    farm.add_argument("--shard", default="0/1", metavar="i/n", help="make the i-th of n shares only (from 0)")
    farm.add_argument("--workers", type=int, default=0, metavar="W", help="processes (default: one per core)")
    add_force_option(parser)
    add_probe_option(parser)
    add_links_option(parser)
    parser.set_defaults(run=run_bulk, answer=Rendered)


def run_bulk(options: argparse.Namespace) -> Answer:
    """Make a bulk set, or what is missing of it."""
    from generator.jobs import bulk

    if options.uncertain:
        options.uncertain = plain_values(read_uncertainty(options.uncertain))
    request = BulkRequest(
        scene=options.scene,
        path=options.output,
        chosen=chosen_settings(options, Settings, pictures=1),
        force=options.force,
        probe=options.probe,
        trust_links=options.trust_links,
        **farm_of(options),
    )
    with progress_bar() as progress:
        outcome = bulk.run(request, progress=progress, tell=note)
    return report(outcome.bulk, outcome.rendered, outcome.remaining, outcome.failed)
