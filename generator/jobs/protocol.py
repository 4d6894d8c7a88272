"""What coordinator and worker say to one another."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from typing import Any

ANSWER = "nlos "


NO_PROBE = "no-probe"
"""Tells a worker that plans to leave out the check at the start."""


FORCE = "force"
"""Last argument of a worker that plans in spite of errors that the check finds."""


def answer(**fields: Any) -> None:
    """Tell the coordinator something."""
    print(ANSWER + json.dumps(fields), flush=True)


def commands() -> Iterable[dict[int, int]]:
    """Say that this process is ready, and return the batches that are sent to it: numbers, each with its samples."""
    answer(ready=True)
    for line in sys.stdin:
        pairs = (word.partition(":") for word in line.split())
        yield {int(number): int(samples or 0) for number, _, samples in pairs}
