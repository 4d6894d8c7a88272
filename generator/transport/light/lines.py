"""Lines through a target, and the light that they exchange between it and the room.

Each sum has two forms, loops for numba and arrays for NumPy; tests check that they agree to rounding.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport.compiled import COMPILED, jit_released
from generator.transport.light.cells import Hits, summed

Floats = NDArray[Any]
Numbers = NDArray[np.int64]

SETS = 4
"""Number of sets of lines. Each is a net of Sobol's sequence, as all of them are."""


class Lines(NamedTuple):
    """Lines through the target at a pose, set after set.

    Attributes
    ----------
    owner : ndarray of shape (n,), int
        Cell of the target that each leaves.
    flux : ndarray of shape (n,)
        Area that it stands for, in its set.
    own : ndarray of shape (n,), int
        Cell of the target that it meets before any of the room, or the number of the target's cells.
    front : Hits
        What it meets of the room.
    behind : Hits
        What it meets of the room in the opposite direction, as if the target were not there.
    """

    owner: Numbers
    flux: Floats
    own: Numbers
    front: Hits
    behind: Hits


def fair(number: Numbers | Floats) -> Floats:
    """Return factors (cells, sets) for the sets that have lines of a cell, which stand for those that have none."""
    there = number > 0
    factor: Floats = np.where(there, SETS / np.maximum(1, there.sum(axis=1, keepdims=True)), 0.0)
    return factor


def completed(values: Floats, missing: NDArray[np.bool_], groups: int) -> Floats:
    """Return values (cells, sets * groups) with the mean of the other sets where one has none."""
    if not missing.any():
        return values
    by_set, there = values.reshape(len(values), SETS, groups), ~missing.reshape(len(values), SETS, groups)
    mean = (by_set * there).sum(axis=1, keepdims=True) / np.maximum(1, there.sum(axis=1, keepdims=True))
    return np.where(there, by_set, mean).reshape(values.shape)


def _received_loops(lines: Lines, level: Floats, body: Floats, groups: int) -> Floats:
    """Return the light that the target's cells receive, times their area, (target's cells, sets * groups).

    Parameters
    ----------
    lines : Lines
    level : ndarray of shape (rows, sets * groups)
        Radiosity of the room's cells and of the sky, as `near.Near` lists them.
    body : ndarray of shape (target's cells, sets * groups)
        Radiosity of the target's cells.
    groups : int
    """
    n = len(lines.owner)
    found = np.zeros(body.shape)
    corners, shares = lines.front.corners, lines.front.shares
    for k in range(n):
        owner, flux, own = lines.owner[k], lines.flux[k], lines.own[k]
        first = groups * (SETS * k // n)
        for g in range(first, first + groups):
            light = 0.0
            if own < body.shape[0]:
                light = body[own, g]
            else:
                for c in range(corners.shape[1]):
                    light += shares[k, c] * level[corners[k, c], g]
            found[owner, g] += flux * light
    return found


def received_arrays(lines: Lines, level: Floats, body: Floats, groups: int) -> Floats:
    """NumPy form of `_received_loops`."""
    padded = np.append(body, np.zeros((1, body.shape[1])), axis=0)
    light = np.where((lines.own < len(body))[:, None], padded[lines.own], lines.front.of(level))
    return summed(lines.owner, _by_set(lines, groups) * light, len(body))


def _leaving_loops(lines: Lines, level: Floats, body: Floats, groups: int) -> Floats:
    """Return the light that the room's cells gain, times their area, (rows, sets * groups): the target's in place of
    that behind it. Parameters are those of `_received_loops`.

    What a cell receives along one set's lines it sends along another's, and so it stands in that one's columns:
    bright places would else light themselves, by the few lines that lead there, the more so the smaller cells are.
    """
    n = len(lines.owner)
    found = np.zeros(level.shape)
    front, behind = lines.front, lines.behind
    corners = front.corners.shape[1]
    for k in range(n):
        owner, flux = lines.owner[k], lines.flux[k]
        if lines.own[k] < body.shape[0]:
            continue
        part = SETS * k // n
        first, after = groups * part, groups * ((part + 1) % SETS)
        for g in range(groups):
            far = 0.0
            for c in range(corners):
                far += behind.shares[k, c] * level[behind.corners[k, c], first + g]
            for c in range(corners):
                gained = front.shares[k, c] * flux * (body[owner, first + g] - far)
                found[front.corners[k, c], after + g] += gained
    return found


def leaving_arrays(lines: Lines, level: Floats, body: Floats, groups: int) -> Floats:
    """NumPy form of `_leaving_loops`."""
    is_own = (lines.own < len(body))[:, None]
    sent = np.where(is_own, 0.0, body[lines.owner] - lines.behind.of(level))
    return onward(lines.front.spread(_by_set(lines, groups) * sent, len(level)), groups)


def onward(values: Floats, groups: int, sets: int = 1) -> Floats:
    """Return values (n, sets * groups) in the columns of another set, so many sets on."""
    return np.roll(values, sets * groups, axis=1)


def _by_set(lines: Lines, groups: int) -> Floats:
    """Return the area (n, sets * groups) that each line stands for, in its own set's columns."""
    n = len(lines.owner)
    mine = np.arange(SETS * groups) // groups == (np.arange(n)[:, None] * SETS // n)
    return np.where(mine, lines.flux[:, None], 0.0)


received = jit_released(_received_loops) if COMPILED else received_arrays
leaving = jit_released(_leaving_loops) if COMPILED else leaving_arrays
