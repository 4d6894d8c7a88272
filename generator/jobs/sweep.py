"""Renders a data set as requested: decides on its settings, then renders by workers, cluster jobs or this process."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace

from generator.jobs import budget, cluster, gpus, local
from generator.jobs.local import Here, Outcome
from generator.jobs.request import SweepRequest
from generator.jobs.workers import Launch, python
from generator.model.errors import NlosError
from generator.model.quantities import Progress
from generator.sets import links, plan_file
from generator.sets.dataset import Dataset


def run(
    request: SweepRequest,
    *,
    progress: Progress = lambda done, total: None,
    tell: Callable[[str], None] = lambda words: None,
    launch: Launch = python,
    stop: threading.Event | None = None,
    here: Here | None = None,
) -> Outcome:
    """Render a data set, or what is missing of it.

    Parameters
    ----------
    request : SweepRequest
        Data set to render.
    progress : callable
        Called with (done, total) pictures of this run.
    tell : callable
        Called with messages: the settings that follow from a budget; which engine ``auto`` took, and why; that
        an engine is being compiled; what the check at the start of a new set found, and how long it took.
    launch : callable
        Returns the command line that starts a worker.
    stop : threading.Event, optional
        Ends the run early when another thread sets it; finished pictures stay.
    here : Here, optional
        Renders in this process, instead of workers.

    Returns
    -------
    Outcome
        The set, and what this run did.

    Raises
    ------
    NlosError
        The input is bad, the check finds an error, or the data set at that path was made with other settings.
    """
    if request.plan and request.budget:
        raise NlosError("--budget: a plan has its own accuracy; leave --plan or --budget out")
    if request.budget and request.shard != (0, 1):
        raise NlosError("--budget: is one machine's; leave --shard out, or name the samples")
    with links.trusting(request.trust_links), gpus.choosing(request.gpus):
        decided, pace = _decided(request, tell, launch)
        if decided.cluster:
            if pace or request.shard != (0, 1):
                raise NlosError("--jobs: shares the poses out itself, at one setting; leave out --shard and --budget")
            outcome = cluster.run(decided, progress=progress, tell=tell)
        else:
            options = {"progress": progress, "tell": tell, "launch": launch, "stop": stop}
            outcome = local.run(decided, **options, pace=pace, here=here)  # type: ignore[arg-type]
        if request.plan:
            plan_file.keep(request.plan, request.path)
    return outcome


def _decided(
    request: SweepRequest, tell: Callable[[str], None], launch: Launch
) -> tuple[SweepRequest, budget.Pace | None]:
    """Return the request with the settings that follow from its plan, budget or accuracy, and the samples' pace."""
    new, chosen = not Dataset.exists(request.path), request.chosen
    if request.plan:
        chosen = plan_file.followed(request.plan, request.scene, chosen)
    if not new and (request.budget or request.accuracy):
        option = "--budget" if request.budget else "--accuracy"
        tell(f"{request.path}: goes on as it was begun; {option} is for new sets")
    elif request.budget or request.accuracy:
        choice = budget.choose(
            *(request.scene, chosen),
            budget=request.budget or math.inf,
            accuracy=request.accuracy,
            workers=request.workers,
            tell=tell,
            launch=launch,
            force=request.force,
        )
        return replace(request, chosen=choice.settings), choice.pace
    return replace(request, chosen=chosen), None
