"""The verbs ``status`` and ``verify``: how far a sweep is, and whether a set is complete and intact."""

from __future__ import annotations

import argparse
from pathlib import Path

from generator.cli.answer import Answer, json_object
from generator.cli.options import Commands
from generator.model.described import described


@json_object
class Worker:
    """A worker of a run."""

    pid: int = described("its process")
    doing: str = described("what it renders; empty while it has nothing to do")
    seconds: float = described("for how long it has been doing that, seconds")
    done: int = described("pictures, or parts of a bulk set, that it has finished")
    memory: int = described("bytes that it has in memory")


@json_object
class Run:
    """A run that renders a data set, or has done so."""

    host: str = described("machine")
    pid: int = described("process")
    shard: str = described("its share, i/n")
    state: str = described("running, ended or lost")
    done: int = described("pictures that it made")
    total: int = described("pictures that it was to make")
    seconds: float = described("time since it began, seconds")
    first: int = described("pictures when any were done for the first time")
    first_seconds: float = described("time of that, seconds since it began")
    failed: list[str] = described("poses that could not be rendered, each with its reason")
    workers: list[Worker] = described("its workers")
    rate: float = described("pictures per second")
    heard: float = described("seconds since it wrote its state")


@json_object
class Status:
    """How far a data set is, and what its runs are doing."""

    path: str = described("folder of the set")
    planned: int = described("pictures of the finished set")
    done: int = described("pictures whose files exist")
    failed: list[str] = described("poses that could not be rendered, each with its reason")
    rate: float = described("pictures per second of all runs that go on")
    seconds_left: float | None = described("time until they are done, seconds; null if none goes on")
    runs: list[Run] = described("the runs")


@json_object
class Verified:
    """Whether a set is complete and intact."""

    path: Path = described("folder of the set")
    planned: int = described("pictures of the finished set")
    faults: list[str] = described("what is wrong, one sentence each")
    note: str | None = described("what cannot be checked in a set of an older version; null if everything can")


def add_parsers(commands: Commands) -> None:
    """Add the verbs ``verify`` and ``status`` to a command line."""
    _add_verify(commands)
    _add_status(commands)


def _add_verify(commands: Commands) -> None:
    parser = commands.add_parser(
        "verify",
        help="re-read a whole data set and list what is wrong",
        description="Re-read every picture and compare it with the manifest; exit code 1 if anything is wrong.",
        epilog="example:\n  nlos-generate verify sphere/",
    )
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="folder of a data set, or of a bulk set")
    parser.set_defaults(run=run_verify, answer=Verified)


def _add_status(commands: Commands) -> None:
    parser = commands.add_parser(
        "status",
        help="say how far a data set is and what its runs are doing, from another shell",
        description="Say how many pictures are done, at what rate and until when, what failed, and what each worker "
        "of each run is doing, on this machine and on others that share the folder. What happened to them is in "
        "DATASET/log.txt.",
        epilog="example:\n  nlos-generate status sphere/ --json",
    )
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="folder of the data set")
    parser.set_defaults(run=run_status, answer=Status)


def run_status(options: argparse.Namespace) -> Answer:
    """Say how far a data set is, and what its runs are doing."""
    from generator.jobs import journal

    state = journal.read(options.dataset)
    runs = [Run(**{**run, "workers": [Worker(**worker) for worker in run["workers"]]}) for run in state["runs"]]
    return Answer(Status(**{**state, "runs": runs}), journal.words(state))


def run_verify(options: argparse.Namespace) -> Answer:
    """Say what is wrong with a set; the exit code is 1 if anything is."""
    from generator.sets import audit
    from generator.sets.bulk_set import Bulk
    from generator.sets.dataset import Dataset
    from generator.sets.measured import MeasuredSet

    made: Bulk | Dataset | MeasuredSet
    if Bulk.exists(options.dataset):
        made = Bulk.open(options.dataset, check=False)
        note, extent = "", f"{made.planned} pictures in {made.parts} parts"
    elif MeasuredSet.exists(options.dataset):
        made = MeasuredSet.open(options.dataset, check=False)
        note, extent = made.unchecked(), f"{made.planned} measured pictures"
    else:
        made = Dataset.open(options.dataset, check=False)
        note, extent = audit.unchecked(made), f"{made.planned} poses"
    faults = made.verify()
    values = Verified(path=options.dataset, planned=made.planned, faults=faults, note=note or None)
    notes = [f"note: {note}"] if note else []
    lines = [*faults, *notes, f"{options.dataset}: {extent}, {len(faults)} faults"]
    return Answer(values, lines, code=1 if faults else 0)
