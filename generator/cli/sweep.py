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
