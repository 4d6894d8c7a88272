"""The verb ``bound``: limits that no method can beat."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from classify.cli.options import add_atlas_options, add_seed, check_output, loaded, progress_bar
from generator.cli.answer import Answer, Interval, Table, interval, json_object
from generator.cli.options import Commands
from generator.model.described import described
from generator.model.errors import NlosError

if TYPE_CHECKING:
    from classify.inference.atlas import Atlas
    from classify.inference.bound import Reachable
    from classify.inference.posterior import Synthesis


def add_parsers(commands: Commands) -> None:
    """Add the verb ``bound`` to a command line."""
    parser = commands.add_parser(
        "bound",
        help="say how well any method can answer, voxel by voxel",
        description="Say how well voxel, position and presence can be known from a picture at all: what the sensor's "
        "noise leaves of it, by Bayes' rule and by the bound of Cramer and Rao.",
        epilog="example:\n  nlos-classify bound room.atlas simulated/",
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
    parser.set_defaults(run=run_bound, answer=Bounds)


@json_object
class VoxelBound:
    """The bounds in a voxel; the last five for the object, not turned, in its middle."""

    voxel: str = described("its label")
    accuracy: Interval = described("share of pictures that the best method puts into the right voxel")
    presence: float | None = described(
        "distance of the object's picture from the empty scene's, in standard deviations of the noise; null, as all "
        "that follow, where the object is not known, or where none can be",
        None,
    )
    position: list[float] | None = described("least standard deviation of x, y and z, metres", None)
    turned: float | None = described("of all three together where the turn is unknown too, metres", None)
    movement: list[float] | None = described("least movement along x, y and z that is noticed, metres", None)


@json_object
class Bounds:
    """Limits that no method can beat."""

    pictures: int = described("pictures that were tried")
    accuracy: Interval = described("share of pictures that the best method puts into the right voxel")
    error: Interval = described("median error of the position, metres")
    voxels: list[VoxelBound] = described("the bounds, voxel by voxel")
    words: list[str] = described("what they do and do not bound, in sentences")
    files: list[Path] = described("files that were written")


def run_bound(options: argparse.Namespace) -> Answer:
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
    # The bound of Cramer and Rao needs a known object and scene and the derivatives of its pictures.
    single = not (simulated.plan.unknown or simulated.plan.uncertain)
    if options.map and not single:
        raise NlosError(
            f"--map: draws what can be known of one object in a known scene, and {options.simulated} is of many"
        )
    with progress_bar("asking", "pictures") as progress:
        best = bound.reachable(
            atlas,
            count=options.count,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    synthesis = Synthesis(atlas, simulated.world()) if single else None
    headings, further, files = ["voxel", "right voxel"], [], []
    words = [*best.words(), f"median error of the position, wherever the object is: {best.error.centimetres()}"]
    if synthesis is not None:
        headings += ["presence", "x cm", "y cm", "z cm", "turn unknown", "noticed: x cm", "y cm", "z cm"]
        further.append(
            "presence: in standard deviations of the noise; x, y, z: least standard deviation in the middle of the "
            "voxel by Cramer and Rao, and of all three together where the turn is unknown too; noticed: least "
            "movement that shows between two pictures, at 1 % false alarms and 99 % detections"
        )
    table = Table(f"{options.atlas}: the best that any method can do", headings, bound.rows(atlas, best, synthesis))
    if options.map and synthesis is not None:
        with progress_bar("mapping", "places") as progress:
            bounds_map = bound.over_volume(synthesis, progress=lambda done, total: progress(done, total, ""))
        files = bound.draw(options.map, atlas, bounds_map)
    values = Bounds(
        pictures=best.count,
        accuracy=interval(best.accuracy),
        error=interval(best.error),
        voxels=_voxels(atlas, best, synthesis),
        words=words,
        files=files,
    )
    return Answer(values, [table, *words, *further, *map(str, files)])


def _voxels(atlas: Atlas, best: Reachable, synthesis: Synthesis | None) -> list[VoxelBound]:
    from classify.inference.bound import in_centre

    found = []
    for voxel, label in enumerate(atlas.grid.labels):
        one = VoxelBound(voxel=label, accuracy=interval(best.by_voxel[voxel]))
        if synthesis is not None and (here := in_centre(synthesis, voxel)):
            one = replace(
                one,
                presence=here.presence,
                position=here.position.tolist(),
                turned=math.sqrt(float((here.turned**2).sum())),
                movement=here.movement.tolist(),
            )
        found.append(one)
    return found
