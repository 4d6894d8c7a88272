"""The verb ``bound``: limits that no method can beat."""

from __future__ import annotations

import argparse
from pathlib import Path

from classify.cli.options import RAW, Commands, add_atlas_options, add_seed, check_output, loaded, progress_bar
from generator.cli.terminal import print_table
from generator.model.errors import NlosError


def add_parsers(commands: Commands) -> None:
    """Add the verb ``bound`` to a command line."""
    parser = commands.add_parser(
        "bound",
        help="say how well any method can answer, voxel by voxel",
        description="Say how well voxel, position and presence can be known from a picture at all: what the sensor's "
        "noise leaves of it, by Bayes' rule and by the bound of Cramer and Rao.",
        epilog="example:\n  nlos-classify bound room.atlas simulated/",
        formatter_class=RAW,
    )
    parser.add_argument("atlas", type=Path, metavar="FILE.atlas")
    parser.add_argument("simulated", type=Path, metavar="SET", help="folder of the simulated set that it is of")
    parser.add_argument(
        "--map",
        type=Path,
        metavar="FILE",
        help="draw the bounds over the hidden volume, seen from above: .png, with an .svg beside it, .svg or .pdf",
    )
    parser.add_argument("--count", type=int, default=3000, metavar="N", help="pictures to try (default: 3000)")
    add_seed(parser, "of pictures and noise")
    add_atlas_options(parser, voxels=True)
    parser.set_defaults(run=run_bound)


def run_bound(options: argparse.Namespace) -> int:
    """Print the limits that no method can beat, and draw their map."""
    from classify.classifiers import models
    from classify.inference import bound
    from classify.inference.posterior import Synthesis
    from generator.measure import figures
    from generator.sets.bulk_set import Bulk

    models.check_seed(options.seed)
    if options.count < 1:
        raise NlosError(f"--count {options.count}: must be 1 or more")
    if options.map:
        check_output(options.map)
        figures.check_format(options.map)
    atlas, simulated = loaded(options), Bulk.open(options.simulated)
    if atlas.about.get("fingerprints") != [simulated.meta["fingerprint"]]:
        raise NlosError(f"{options.atlas}: is not an atlas of {options.simulated}; make it anew")
    # The bound of Cramer and Rao needs a known object and the derivatives of its pictures.
    ambient = simulated.world().ambient is not None
    single = not simulated.plan.unknown and not ambient
    if options.map and not single:
        reason = "is under ambient light, where the engine knows no derivatives" if ambient else "is of many"
        raise NlosError(f"--map: draws what can be known of one object, and {options.simulated} {reason}")
    with progress_bar("asking", "pictures") as progress:
        best = bound.reachable(
            atlas,
            count=options.count,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    synthesis = Synthesis(atlas, simulated.world()) if single else None
    headings = ["voxel", "right voxel"]
    if single:
        headings += ["presence", "x cm", "y cm", "z cm", "turn unknown", "noticed: x cm", "y cm", "z cm"]
    title = f"{options.atlas}: the best that any method can do"
    print_table(title, headings, bound.rows(atlas, best, synthesis))
    for line in best.words():
        print(line)
    print(f"median error of the position, wherever the object is: {best.error.centimetres()}")
    if synthesis is None:
        return 0
    print(
        "presence: in standard deviations of the noise; x, y, z: least standard deviation in the middle of the voxel "
        "by Cramer and Rao, and of all three together where the turn is unknown too; noticed: least movement that "
        "shows between two pictures, at 1 % false alarms and 99 % detections"
    )
    if options.map:
        with progress_bar("mapping", "places") as progress:
            bounds_map = bound.over_volume(synthesis, progress=lambda done, total: progress(done, total, ""))
        for path in bound.draw(options.map, atlas, bounds_map):
            print(path)
    return 0
