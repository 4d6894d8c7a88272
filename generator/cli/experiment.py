"""The verb ``experiment``: the paper's experiments 1 to 3."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from generator.cli.options import (
    Commands,
    add_links_option,
)
from generator.cli.terminal import LineProgress
from generator.model.errors import NlosError


def add_parsers(commands: Commands) -> None:
    """Add the verb ``experiment`` to a command line."""
    parser = commands.add_parser(
        "experiment",
        help="the paper's experiments 1 to 3: what a movement or a turn of the object changes",
        description="Move a sphere (1) or a square sheet (2) along x, y and z, or turn both about them (3), and show "
        "what that changes: difference pictures with their amplification, the change per centimetre or degree, and "
        "the paper's claims, tested. Without a scene of your own: on the tabletop and in the room, dark and under "
        "ambient light.",
        epilog="example:\n  nlos-generate experiment 2 -o experiment-2/",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("number", type=int, choices=[1, 2, 3])
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="for tables and pictures")
    parser.add_argument("--scene", type=Path, metavar="FILE.blend", help="take this one, as it is lit")
    parser.add_argument(
        "--ambient",
        type=float,
        default=1.0,
        metavar="A",
        help="ambient light on the wall, in units of the object's own signal; 0 leaves it out (default: 1)",
    )
    parser.add_argument("--resolution", type=int, default=64, metavar="N", help="pixels a side (default: 64)")
    parser.add_argument(
        "--samples", type=int, default=128, metavar="N", help="of Cycles, under ambient light (default: 128)"
    )
    parser.add_argument(
        "--repeats", type=int, default=8, metavar="N", help="with other noise, for intervals (default: 8)"
    )
    add_links_option(parser)
    parser.set_defaults(run=run_experiment)


def run_experiment(options: argparse.Namespace) -> int:
    """Write an experiment's tables and pictures."""
    from generator.blender.measure import experiment_report
    from generator.blender.scene import blend_file

    for name, minimum in (("resolution", 1), ("samples", 1), ("repeats", 1)):
        if getattr(options, name) < minimum:
            raise NlosError(f"--{name} {getattr(options, name)}: must be {minimum} or more")
    if not 0.0 <= options.ambient < math.inf:
        raise NlosError(f"--ambient {options.ambient:g}: must be 0, which is dark, or more")
    if options.output.exists() and not options.output.is_dir():
        raise NlosError(f"{options.output}: is a file; name a folder")
    if options.scene:  # keeps the scene's own light
        places: dict[str, experiment_report.Open] = {
            options.scene.stem: lambda _: blend_file.open_file(options.scene)
        }
        options.ambient = 0.0
    else:
        places = experiment_report.presets()
    settings = {"pixels": options.resolution, "samples": options.samples, "repeats": options.repeats}
    lines = experiment_report.run(
        options.number, options.output, places, settings, ambient=options.ambient, progress=LineProgress("pictures")
    )
    for line in lines:
        print(line, flush=True)
    return 0
