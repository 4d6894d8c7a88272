"""How far the light of many reflections is trusted at the poses of a set, before any picture of it is made."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from generator.model.errors import NlosError
from generator.transport import Transport
from generator.transport.compiled import COMPILED
from generator.transport.light.field import FINEST

_POSES = 9
"""Most poses that are looked at."""

Pose = tuple[Sequence[float], Sequence[float]]


def look(engine: Transport, poses: Sequence[Pose]) -> dict[str, Any]:
    """Estimate the error of light of many reflections at some poses, evenly chosen.

    Parameters
    ----------
    engine : Transport
    poses : sequence of (position, rotation)

    Returns
    -------
    dict
        ``poses``, their number; ``median`` and ``worst`` error, of the size of what the target changes; ``asked``;
        ``words``. Empty if no light is followed from cell to cell, at no pose, or in a Python without numba.
    """
    if not engine.world.is_followed_on or not COMPILED:  # without numba it would take longer than many a set
        return {}
    errors = list(_errors(engine, poses[:: -(-len(poses) // _POSES)]))
    if not errors:
        return {}
    found = {"median": float(np.median(errors)), "worst": max(errors), "asked": max(engine.accuracy, FINEST)}
    median, worst, asked = (f"{100.0 * found[name]:.2g} %" for name in ("median", "worst", "asked"))
    words = f"light check: at {len(errors)} poses light of many reflections errs by {median} of what the target"
    words += f" changes in the median, by {worst} at most; asked: {asked}"
    return {"poses": len(errors), **found, "words": words}


def _errors(engine: Transport, poses: Iterable[Pose]) -> Iterator[float]:
    for pose in poses:
        try:
            yield engine.light_error(*pose)
        except NlosError:  # a pose that the engine refuses is refused when its picture is made
            continue
