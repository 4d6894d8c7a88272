"""The verbs ``status`` and ``verify``: how a sweep goes, and whether a set is whole."""

from __future__ import annotations

import argparse

from generator.sets import audit
from generator.sets.dataset import Dataset


def run_status(options: argparse.Namespace) -> int:
    import json

    from generator.jobs import journal

    found = journal.read(options.dataset)
    print(json.dumps(found, indent=1) if options.json else "\n".join(journal.words(found)))
    return 0


def run_verify(options: argparse.Namespace) -> int:
    from generator.sets.bulk_set import Bulk

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
    if words := audit.unchecked(dataset):
        print(f"note: {words}")
    print(f"{options.dataset}: {dataset.planned} poses, {len(faults)} faults")
    return 1 if faults else 0
