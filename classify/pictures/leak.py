"""Poses that a set to learn from and a set to test on have in common."""

from __future__ import annotations

import numpy as np

from generator.model.arrays import Array
from generator.model.errors import NlosError

_STEP = 1e-6
"""Metres, and degrees: poses that differ by less are one."""


def shared_poses(learnt: tuple[Array, Array], tested: tuple[Array, Array]) -> int:
    """Return how many tested poses are also among those learnt.

    Parameters
    ----------
    learnt, tested : (ndarray of shape (n, 3), ndarray of shape (n, 3))
        Positions, metres, and rotations, degrees.
    """

    def rows(poses: tuple[Array, Array]) -> list[bytes]:
        whole = np.round(np.hstack(poses) / _STEP).astype(np.int64)
        return [row.tobytes() for row in whole]

    known = set(rows(learnt))
    return sum(row in known for row in rows(tested))


def refuse_shared(
    learnt: tuple[Array, Array], tested: tuple[Array, Array], learnt_name: str, tested_name: str
) -> None:
    """Raise NlosError if a test set shows poses that were learnt: its figures would be too good.

    Parameters
    ----------
    learnt, tested
        As `shared_poses` takes them.
    learnt_name, tested_name : str
        Names of both, for the message.
    """
    if count := shared_poses(learnt, tested):
        raise NlosError(
            f"{tested_name}: {count} of its {len(tested[0])} poses are also in {learnt_name}, so the answers "
            "would be too good; test on a set made with another --seed"
        )
