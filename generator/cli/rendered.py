"""The answer of the verbs that render a set: sweep, trajectory and bulk."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from generator.cli import console
from generator.cli.answer import Answer, json_object
from generator.model.described import described

if TYPE_CHECKING:
    from generator.sets.bulk_set import Bulk
    from generator.sets.dataset import Dataset


@json_object
class Rendered:
    """How a run ended, and how far its set is."""

    path: Path = described("folder of the set")
    planned: int = described("pictures of the finished set")
    done: int = described("pictures that the set holds")
    rendered: int = described("pictures that this run made")
    remaining: int = described("pictures that are missing, those of other shards too")
    failed: list[str] = described("pictures that could not be rendered, each with its reason")
    warning: str | None = described("what is wrong with the set; null if nothing is")


def summary(dataset: Dataset | Bulk, *, rendered: int, remaining: int) -> str:
    """Return the last line of a sweep or of a bulk set."""
    done = dataset.planned - remaining
    state = f"{dataset.path}: {done} of {dataset.planned} pictures"
    if rendered == 0 and remaining == 0:
        return f"{state}; the data set is finished, nothing to do"
    return f"{state}, {rendered} of them rendered now" + (f"; {remaining} remain" if remaining else "; finished")


def report(dataset: Dataset | Bulk, rendered: int, remaining: int, failed: list[str]) -> Answer:
    """Return how a run ended, and print what failed."""
    from generator.sets import audit
    from generator.sets.dataset import Dataset

    for failure in failed:
        console.complain(f"failed: {failure}")
    warning = audit.words(dataset) if isinstance(dataset, Dataset) else ""
    if warning:
        console.complain(warning)
    values = Rendered(
        path=dataset.path,
        planned=dataset.planned,
        done=dataset.planned - remaining,
        rendered=rendered,
        remaining=remaining,
        failed=failed,
        warning=warning or None,
    )
    return Answer(values, [summary(dataset, rendered=rendered, remaining=remaining)], code=1 if failed else 0)
