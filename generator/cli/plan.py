"""The verbs ``plan`` and ``tradeoff``: what a scene needs, and what accuracy costs."""

from __future__ import annotations

import argparse
import functools

from generator.cli.terminal import print_table
from generator.measure import plan_file
from generator.model.errors import NlosError
from generator.model.settings import Sweep


def run_tradeoff(options: argparse.Namespace) -> int:
    from generator.measure import tradeoff

    if not 1 <= options.poses <= Sweep.poses:
        raise NlosError(f"--poses {options.poses}: must be from 1 to {Sweep.poses}")
    if options.output.exists() and not options.output.is_dir():
        raise NlosError(f"{options.output}: is a file; name a folder")
    names = ("poses", "seed", "resolution", "most", "workers", "force")
    found = tradeoff.run(
        options.scene,
        options.output,
        **{name: getattr(options, name) for name in names},
        tell=functools.partial(print, flush=True),
    )
    title = f"{options.scene.name}, {options.poses} poses a voxel, seed {options.seed}"
    print_table(f"{title}; intervals of 95 %", tradeoff.HEADINGS, tradeoff.rows(found))
    for line in tradeoff.advice(found):
        print(line)
    for path in tradeoff.write(options.output, found, title):
        print(path)
    return 0


def run_plan(options: argparse.Namespace) -> int:
    from generator.blender.measure import planning

    if options.output and options.output.exists() and not options.output.is_dir():
        raise NlosError(f"{options.output}: is a file; name a folder")
    if not 2 <= options.poses <= Sweep.poses:
        raise NlosError(f"--poses {options.poses}: must be from 2 to {Sweep.poses}")
    found = planning.make(
        options.scene,
        tolerance=options.tolerance,
        count=options.poses,
        seed=options.seed,
        most=options.most,
        workers=options.workers,
        tell=functools.partial(print, flush=True),
    )
    title = f"{options.scene.name}, seed {options.seed}, tolerance {100.0 * options.tolerance:g} %"
    print_table(f"{title}; intervals of 95 %", plan_file.HEADINGS, plan_file.rows(found))
    for line in plan_file.words(found):
        print(line)
    if options.output:
        for path in plan_file.write(options.output, options.scene, found, title):
            print(path)
        print(f"nlos-generate sweep {options.scene} -o DATASET --plan {options.output}")
    return 0
