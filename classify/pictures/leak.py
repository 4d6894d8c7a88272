"""Poses that a set to learn from and a set to test on have in common."""

from __future__ import annotations

import numpy as np

from generator.model.arrays import Array
from generator.model.errors import NlosError

_STEP = 1e-6
"""Metres: positions that differ by less are one; two drawn independently never are."""


def shared_poses(learnt: Array, tested: Array) -> int:
    """Return how many tested poses stand where one stands that was learnt, however the object is turned there.

    Parameters
    ----------
    learnt, tested : ndarray of shape (n, 3)
        Positions, metres.
    """

    def rows(positions: Array) -> list[bytes]:
        return [row.tobytes() for row in np.round(positions / _STEP).astype(np.int64)]

    known = set(rows(learnt))
    return sum(row in known for row in rows(tested))


def refuse_shared(learnt: Array, tested: Array, learnt_name: str, tested_name: str) -> None:
    """Raise NlosError if a test set shows poses that were learnt: its figures would be too good.

    That holds for another object at the same places too: the label follows from the place.

    Parameters
    ----------
    learnt, tested : ndarray of shape (n, 3)
        Positions, metres.
    learnt_name, tested_name : str
        Names of both, for the message.
    """
    if count := shared_poses(learnt, tested):
        raise NlosError(
            f"{tested_name}: {count} of its {len(tested)} poses are also in {learnt_name}, so the answers would be "
            "too good; test on a set made with another --seed"
        )
