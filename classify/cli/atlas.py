"""The verbs ``atlas`` and ``bound``."""

from __future__ import annotations

import argparse

from classify.cli.options import check_output, loaded, progress_bar, sensor_of
from generator.cli.terminal import print_table
from generator.model.errors import NlosError


def run_atlas(options: argparse.Namespace) -> int:
    from classify.inference import atlas
    from generator.sets.bulk_set import Bulk

    sensor = sensor_of(options)
    check_output(options.output)
    first, *others = map(Bulk.open, options.simulated)
    with progress_bar("compressing", "pictures") as progress:
        made = atlas.build(
            first,
            sensor,
            *others,
            lamp_drift=options.lamp_drift,
            ambient_drift=options.ambient_drift,
            unknown=options.unknown,
            progress=lambda done, total: progress(done, total, ""),
        )
    atlas.save(options.output, made)
    n, k = made.codes.shape
    print(
        f"{options.output}: {n} pictures of a {' or a '.join(made.about['targets'])}, {k} numbers each; what they "
        f"leave out is {made.left_out:.2f} of the noise"
    )
    return 0


def run_bound(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from classify.inference import bound
    from classify.inference.posterior import Synthesis
    from generator.sets.bulk_set import Bulk

    models.check_seed(options.seed)
    if options.count < 1:
        raise NlosError(f"--count {options.count}: must be 1 or more")
    if options.map:
        check_output(options.map)
    found, simulated = loaded(options), Bulk.open(options.simulated)
    if found.about.get("fingerprints") != [simulated.meta["fingerprint"]]:
        raise NlosError(f"{options.atlas}: is not an atlas of {options.simulated}; make it anew")
    # Cramer and Rao ask about a known object, by derivatives.
    lit = simulated.world().ambient is not None
    one = not simulated.plan.unknown and not lit
    if options.map and not one:
        what = "is under ambient light, where the engine knows no derivatives" if lit else "is of many"
        raise NlosError(f"--map: draws what can be known of one object, and {options.simulated} {what}")
    with progress_bar("asking", "pictures") as progress:
        best = bound.reachable(
            found,
            count=options.count,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    synthesis = Synthesis(found, simulated.world()) if one else None
    headings = ["voxel", "right voxel"]
    if one:
        headings += ["presence", "x cm", "y cm", "z cm", "turn unknown", "noticed: x cm", "y cm", "z cm"]
    title = f"{options.atlas}: the best that any method can do"
    print_table(title, headings, bound.rows(found, best, synthesis))
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
            drawn = bound.over_volume(synthesis, progress=lambda done, total: progress(done, total, ""))
        bound.draw(options.map, found, drawn)
        print(options.map)
    return 0
