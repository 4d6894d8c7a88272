"""The verbs ``status`` and ``verify``: how far a sweep is, and whether a set is complete and intact."""

from __future__ import annotations

import argparse
from pathlib import Path

from generator.cli.options import (
    Commands,
)


def add_parsers(commands: Commands) -> None:
    """Add the verbs ``verify`` and ``status`` to a command line."""
    _add_verify(commands)
    _add_status(commands)


def _add_verify(commands: Commands) -> None:
    parser = commands.add_parser(
        "verify",
        help="re-read a whole data set and list what is wrong",
        description="Re-read every picture and compare it with the manifest; exit code 1 if anything is wrong.",
    )
    parser.add_argument("dataset", type=Path)
    parser.set_defaults(run=run_verify)


def _add_status(commands: Commands) -> None:
    parser = commands.add_parser(
        "status",
        help="say how far a data set is and what its runs are doing, from another shell",
        description="Say how many pictures are done, at what rate and until when, what failed, and what each worker "
        "of each run is doing, on this machine and on others that share the folder. What happened to them is in "
        "DATASET/log.txt.",
        epilog="example:\n  nlos-generate status sphere/ --json",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--json", action="store_true", help="for programs")
    parser.set_defaults(run=run_status)


def run_status(options: argparse.Namespace) -> int:
    """Print how far a data set is, and what its runs are doing."""
    import json

    from generator.jobs import journal

    state = journal.read(options.dataset)
    print(json.dumps(state, indent=1) if options.json else "\n".join(journal.words(state)))
    return 0


def run_verify(options: argparse.Namespace) -> int:
    """Print what is wrong with a set; return 1 if anything is."""
    from generator.sets import audit
    from generator.sets.bulk_set import Bulk
    from generator.sets.dataset import Dataset

    if Bulk.exists(options.dataset):
        bulk = Bulk.open(options.dataset, check=False)
        faults = bulk.verify()
        for fault in faults:
            print(fault)
        print(f"{options.dataset}: {bulk.planned} pictures in {bulk.parts} parts, {len(faults)} faults")
        return 1 if faults else 0
    dataset = Dataset.open(options.dataset, check=False)
    faults = dataset.verify()
    for fault in faults:
        print(fault)
    if note := audit.unchecked(dataset):
        print(f"note: {note}")
    print(f"{options.dataset}: {dataset.planned} poses, {len(faults)} faults")
    return 1 if faults else 0
