"""The verbs ``sweep`` and ``trajectory``: render a data set."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from generator.cli.answer import Answer
from generator.cli.options import (
    FRAMES,
    Commands,
    add_sweep_options,
    chosen_settings,
    farm_of,
    farm_options,
    group_of,
    option,
)
from generator.cli.rendered import Rendered, report
from generator.cli.terminal import progress_bar
from generator.cli.volume import note
from generator.jobs.request import ClusterJobs, SweepRequest
from generator.model.engines import ENGINES
from generator.model.errors import NlosError
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
    )
    parser.add_argument("scene", type=Path, help="the .blend file")
    add_sweep_options(parser, goal=True)
    farm = farm_options(parser)
    farm.add_argument(
        "--workers", type=int, default=0, metavar="W", help="processes (default: one per core; on a GPU four)"
    )
    rendering = group_of(parser, "rendering")
    rendering.add_argument(
        "--budget",
        type=option(seconds),
        metavar="T",
        help="90s, 10min, 2h: take the engine, and the samples or accuracy, with which a new set ends in that time, "
        "measured on this scene and machine",
    )
    rendering.add_argument(
        "--plan", type=Path, metavar="PLAN", help="model what nlos-generate plan found needed, and no more"
    )
    farm.add_argument(
        "--jobs", type=int, metavar="N", help="render as an array of N jobs on a cluster that shares the folder"
    )
    farm.add_argument("--cluster", choices=["slurm", "local", "debug"], help="of --jobs (default: slurm)")
    farm.add_argument(
        "--job-option",
        dest="job",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="of --jobs, an option of submitit, e.g. slurm_partition=gpu or timeout_min=120; repeatable",
    )
    parser.alias("--job", "--job-option")
    parser.set_defaults(run=run_sweep, answer=Rendered)


def _add_trajectory(commands: Commands) -> None:
    parser = commands.add_parser(
        "trajectory",
        help="render a data set of a target that moves: frame after frame, for track",
        description="As sweep does, but the target walks through the voxels, straight from one random pose to the "
        "next, or as it is animated in Blender, and its pictures are frames, one after the other.",
        epilog="example:\n  nlos-generate trajectory room.blend -o walk/ --frames 200 --pace 0.03 --engine surfel",
    )
    parser.add_argument("scene", type=Path, help="the .blend file")
    add_sweep_options(parser, frames=True)
    group_of(parser, "poses and pictures").add_argument(
        "--timeline",
        nargs="?",
        const=(),
        type=_timeline,
        metavar="FIRST:LAST[:STEP]",
        help="move the target as the .blend animates it, in these frames (default of FIRST:LAST:STEP: the scene's)",
    )
    farm_options(parser).add_argument(
        "--workers", type=int, default=0, metavar="W", help="processes (default: one per core; on a GPU four)"
    )
    parser.set_defaults(run=run_trajectory, answer=Rendered)


def run_sweep(options: argparse.Namespace) -> Answer:
    """Render a data set, or what is missing of it."""
    from generator.jobs import sweep

    budget, accuracy = getattr(options, "budget", None), 0.0
    noisy = options.engine in ENGINES and ENGINES[options.engine].noisy
    walks = getattr(options, "frames", None) or getattr(options, "timeline", None) is not None
    if budget or (noisy and not walks):
        # Here the accuracy is a goal that decides on settings, and not a setting itself.
        accuracy, options.accuracy = options.accuracy or 0.0, None
    request = SweepRequest(
        scene=options.scene,
        path=options.output,
        chosen=chosen_settings(options),
        accuracy=accuracy,
        budget=budget or 0.0,
        plan=getattr(options, "plan", None),
        cluster=_cluster(options),
        force=options.force,
        probe=options.probe,
        trust_links=options.trust_links,
        **farm_of(options),
    )
    with progress_bar() as progress:
        outcome = sweep.run(request, progress=progress, tell=note)
    return report(outcome.dataset, outcome.rendered, outcome.remaining, outcome.failed)


def _cluster(options: argparse.Namespace) -> ClusterJobs | None:
    jobs, executor, job = (getattr(options, name, None) for name in ("jobs", "cluster", "job"))
    if jobs is None:
        for flag, given in (("--cluster", executor), ("--job-option", job)):
            if given:
                raise NlosError(f"{flag}: is an option of --jobs; say how many with --jobs N, or leave it out")
        return None
    if jobs < 1:
        raise NlosError(f"--jobs {jobs}: must be 1 or more")
    return ClusterJobs(shares=jobs, executor=executor or "slurm", options=dict(map(_job_option, job or [])))


def _job_option(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not (equals and name.isidentifier()):
        raise NlosError(f"--job-option {text!r}: must read NAME=VALUE, for example timeout_min=120")
    return name, int(value) if value.isdecimal() else value


def _timeline(text: str) -> tuple[int, ...]:
    parts = text.split(":")
    if not (2 <= len(parts) <= 3 and all(part.removeprefix("-").isdecimal() for part in parts)):
        raise argparse.ArgumentTypeError(f"{text!r} must read FIRST:LAST or FIRST:LAST:STEP, for example 1:250:2")
    first, last, step = (*map(int, parts), 1)[:3]
    if first > last or step < 1:
        raise argparse.ArgumentTypeError(f"{text!r} must begin before it ends, with a step of 1 or more")
    return first, last, step


def run_trajectory(options: argparse.Namespace) -> Answer:
    """Render a trajectory, or what is missing of it."""
    from generator.sets.dataset import Dataset

    settings: dict[str, Any] = {}
    if Dataset.exists(options.output):
        settings = Dataset.open(options.output).settings
    if options.timeline is not None:
        for name in ("frames", "pace", "rotation"):
            if getattr(options, name) is not None:
                raise NlosError(f"--{name}: follows from the animation; leave it out, or --timeline")
        if settings and not options.timeline:
            if not settings.get("timeline"):
                raise NlosError(f"{options.output}: holds no trajectory of a timeline; name another folder")
            options.timeline = tuple(settings["timeline"])
    elif options.frames is None and not settings.get("timeline"):
        options.frames = settings.get("frames", FRAMES)
    if options.frames is not None and options.frames < 1:
        raise NlosError(f"--frames {options.frames}: must be 1 or more")
    return run_sweep(options)
