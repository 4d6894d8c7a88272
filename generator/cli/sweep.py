"""The verbs ``sweep`` and ``trajectory``: render a data set."""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from generator.cli.options import FRAMES, chosen_settings, farm_of
from generator.cli.terminal import progress_bar, report
from generator.jobs import budget
from generator.measure import plan_file
from generator.model.errors import NlosError
from generator.sets.dataset import Dataset

if TYPE_CHECKING:
    from generator.jobs.sweep import Outcome
from pathlib import Path

from generator.cli.options import (
    Commands,
    add_sweep_options,
    option,
)
from generator.model.quantities import seconds


def add_parsers(commands: Commands) -> None:
    """Add the verbs ``sweep`` and ``trajectory`` to a command line."""
    _add_sweep(commands)
    _add_trajectory(commands)


def _add_sweep(commands: Commands) -> None:
    parser = commands.add_parser(
        "sweep",
        help="render a data set: the target at many poses in every voxel",
        description="Move the target through its voxels and render what the camera sees of the relay wall. "
        "Interrupt it at any time: the same command goes on where it stopped. What is left out "
        "follows from the data set, if there is one, else from the scene.",
        epilog="example:\n  nlos-generate sweep room.blend -o sheet/ --poses 100 --engine patch --samples 512",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scene", type=Path, help="the .blend file")
    add_sweep_options(parser)
    parser.add_argument(
        "--workers", type=int, default=0, metavar="W", help="processes (default: one per core; on a GPU four)"
    )
    parser.add_argument(
        "--budget",
        type=option(seconds),
        metavar="T",
        help="90s, 10min, 2h: take the engine, and the samples or accuracy, with which a new set ends in that time, "
        "measured on this scene and machine",
    )
    parser.add_argument(
        "--plan", type=Path, metavar="PLAN", help="model what nlos-generate plan found needed, and no more"
    )
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="render as an array of N jobs on a cluster that shares the folder"
    )
    parser.add_argument(
        "--cluster", choices=["slurm", "local", "debug"], default="slurm", help="of --jobs (default: slurm)"
    )
    parser.add_argument(
        "--job",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="of --jobs, an option of submitit, e.g. slurm_partition=gpu or timeout_min=120; repeatable",
    )
    parser.set_defaults(run=run_sweep)


def _add_trajectory(commands: Commands) -> None:
    parser = commands.add_parser(
        "trajectory",
        help="render a data set of a target that moves: frame after frame, for track",
        description="As sweep does, but the target walks through the voxels, straight from one random pose to the "
        "next, and its pictures are frames, one after the other.",
        epilog="example:\n  nlos-generate trajectory room.blend -o walk/ --frames 200 --pace 0.03 --engine surfel",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scene", type=Path, help="the .blend file")
    add_sweep_options(parser, frames=True)
    parser.add_argument(
        "--workers", type=int, default=0, metavar="W", help="processes (default: one per core; on a GPU four)"
    )
    parser.set_defaults(run=run_trajectory)


def run_sweep(options: argparse.Namespace) -> int:
    from generator.jobs import sweep

    limit, accuracy, planned = getattr(options, "budget", None), None, getattr(options, "plan", None)
    if planned and limit:
        raise NlosError("--budget: a plan has its own accuracy; leave --plan or --budget out")
    if limit and options.shard != "0/1":
        raise NlosError("--budget: is one machine's; leave --shard out, or name the samples")
    if limit or (options.engine in ("path", "patch") and not getattr(options, "frames", None)):
        accuracy, options.accuracy = options.accuracy, None  # decides on settings, and is none itself
    chosen, pace = chosen_settings(options), None
    if planned:
        chosen = plan_file.followed(planned, options.scene, chosen)
    if limit and Dataset.exists(options.output):
        print(f"{options.output}: goes on as it was begun; --budget is for new sets")
    elif limit or (accuracy and not Dataset.exists(options.output)):
        choice = budget.choose(
            options.scene,
            chosen,
            budget=limit or math.inf,
            accuracy=accuracy or 0.0,
            workers=options.workers,
            tell=functools.partial(print, flush=True),
            force=options.force,
        )
        chosen, pace = choice.settings, choice.pace
    farm = farm_of(options)
    with progress_bar() as progress:
        if getattr(options, "jobs", None) is not None:
            outcome = _jobs(options, chosen, progress, paced=pace is not None)
        else:
            outcome = sweep.run(
                options.scene,
                options.output,
                chosen,
                progress=progress,
                tell=print,
                pace=pace,
                force=options.force,
                probe=options.probe,
                **farm,
            )
    if planned:
        plan_file.keep(planned, options.output)
    return report(outcome.dataset, outcome.rendered, outcome.remaining, outcome.failed)


def _jobs(
    options: argparse.Namespace, chosen: dict[str, Any], progress: Callable[[int, int], None], *, paced: bool
) -> Outcome:
    from generator.jobs import cluster

    if options.jobs < 1:
        raise NlosError(f"--jobs {options.jobs}: must be 1 or more")
    if paced or options.shard != "0/1":
        raise NlosError("--jobs: shares the poses out itself, at one setting; leave out --shard and --budget")
    return cluster.run(
        options.scene,
        options.output,
        chosen,
        executor=options.cluster,
        shares=options.jobs,
        workers=options.workers,
        options=dict(map(_job_option, options.job)),
        progress=progress,
        tell=functools.partial(print, flush=True),
        force=options.force,
        probe=options.probe,
    )


def _job_option(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not (equals and name.isidentifier()):
        raise NlosError(f"--job {text!r}: must read NAME=VALUE, for example timeout_min=120")
    return name, int(value) if value.isdecimal() else value


def run_trajectory(options: argparse.Namespace) -> int:
    if options.frames is None:
        known = Dataset.open(options.output).settings if Dataset.exists(options.output) else {}
        options.frames = known.get("frames", FRAMES)
    if options.frames < 1:
        raise NlosError(f"--frames {options.frames}: must be 1 or more")
    return run_sweep(options)
