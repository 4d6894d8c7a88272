"""A sweep as an array of jobs on a cluster, by submitit: each renders a share of the poses, and all write one set."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from generator.jobs import journal, local
from generator.jobs.request import SweepRequest
from generator.model.errors import NlosError
from generator.model.quantities import Progress
from generator.sets import links
from generator.sets.manifest import SCENE

LOGS = ".jobs"
"""Folder of the jobs' output, in the data set."""
_EVERY = 5.0


@dataclass
class Share:
    """Renders one of n shares of a data set; called again after a preemption, it goes on where it stopped.

    Attributes
    ----------
    path : str
        Folder of the data set, which is planned already.
    index, count : int
        Number of the share, from 0, and number of shares.
    workers : int
        Processes; 0 is one per core of the job.
    trust_links : bool
        As in the request that the jobs were started for.
    """

    path: str
    index: int
    count: int
    workers: int = 0
    trust_links: bool = False

    def __call__(self) -> list[str]:
        """Render what is missing of the share; return what failed."""
        path = Path(self.path)
        request = SweepRequest(scene=path / SCENE, path=path, shard=(self.index, self.count), workers=self.workers)
        with links.trusting(self.trust_links):
            return local.run(request).failed

    def checkpoint(self) -> Any:
        """Return the job that goes on after this one; finished pictures are on disk already."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)


def run(
    request: SweepRequest,
    *,
    progress: Progress = lambda done, total: None,
    tell: Callable[[str], None] = lambda words: None,
) -> local.Outcome:
    """Plan a data set in this process, let jobs render it, and wait for them.

    Parameters
    ----------
    request : SweepRequest
        Its folder must be shared by the jobs' machines; its number of workers holds for each job.
    progress, tell : callable
        As for `generator.jobs.sweep.run`.

    Returns
    -------
    Outcome
        The set, and what the jobs did.

    Raises
    ------
    NlosError
        The input is bad, submitit or Slurm is missing, or refuses an option.
    """
    assert request.cluster
    path, executor, shares = request.path, request.cluster.executor, request.cluster.shares
    try:
        import submitit
    except ImportError:
        raise NlosError("--jobs: submitit is missing; install it with pip install 'nlos-lab[slurm]'") from None
    outcome = local.begin(request, tell=tell)
    todo = outcome.remaining = len(local.pending_positions(outcome.dataset))
    if not todo:
        return outcome
    try:
        submitter = submitit.AutoExecutor(folder=path / LOGS / "%j", cluster=executor)
        submitter.update_parameters(name="nlos", **request.cluster.options)
        with submitter.batch():
            share = Share(str(path.absolute()), 0, shares, request.workers, links.trusted())
            jobs = [submitter.submit(replace(share, index=i)) for i in range(shares)]
    except (RuntimeError, ValueError, TypeError, NameError, submitit.core.utils.FailedJobError) as error:
        raise NlosError(f"--jobs {executor}: {' '.join(str(error).split())}") from None
    tell(
        f"jobs {jobs[0].job_id} to {jobs[-1].job_id}; Ctrl-C leaves them running; what they print is in {path / LOGS}"
    )
    done_before = outcome.dataset.planned - todo
    missing: set[str] = set()
    while waiting := {job.job_id for job in jobs if not _ended(job, executor)}:
        progress(journal.read(path)["done"] - done_before, todo)
        missing_before, missing = missing, waiting - _queued() if executor == "slurm" else set()
        if waiting <= missing & missing_before:
            break  # twice not in the queue, and no result: there will be none
        time.sleep(0.2 if executor == "debug" else _EVERY)
    words = "left the queue without a result; it was killed, or ran out of time"
    for job in jobs:
        outcome.failed += [f"job {job.job_id}: {words}"] if job.job_id in waiting else _failures(job, executor)
    outcome.remaining = len(outcome.dataset.gather())
    outcome.rendered = todo - outcome.remaining
    progress(outcome.rendered, todo)
    if not outcome.remaining:
        outcome.dataset.tidy()
    return outcome


def _ended(job: Any, executor: str) -> bool:
    """Whether a job has ended; submitit itself would ask Slurm's accounting, which not every cluster has."""
    return bool(job.paths.result_pickle.exists() if executor == "slurm" else job.done())


def _queued() -> set[str]:
    """Return the jobs, and the tasks of job arrays, that are waiting or running in Slurm."""
    answer = subprocess.run(["squeue", "-h", "-r", "-o", "%F_%K %i"], capture_output=True, text=True, check=False)
    if answer.returncode:
        raise NlosError(f"--jobs slurm: squeue does not answer ({answer.stderr.strip()}); the jobs may go on")
    return set(answer.stdout.split())


def _failures(job: Any, executor: str) -> Sequence[str]:
    """Return what a job could not render, or the error that ended it."""
    if executor == "slurm":
        from submitit.core import utils

        outcome, result = utils.pickle_load(job.paths.result_pickle)
        error = result if outcome == "error" else None
    else:
        error = job.exception()
        result = None if error else job.result()
    if error is None:
        failed: list[str] = result
        return failed
    lines = [line.strip() for line in str(error).splitlines() if "Error: " in line]
    return [f"job {job.job_id}: {lines[-1].partition('Error: ')[2] if lines else type(error).__name__}"]
