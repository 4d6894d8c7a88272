"""Measures what each part of a scene contributes to the difference picture, by leaving it out.

The engine `surfel` has no noise, so in a plain diffuse scene each effect shows to the last digit.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import cv2
import numpy as np

from generator.measure.intervals import relative
from generator.measure.scene_plan import UNKNOWN, Effect
from generator.model.arrays import Array
from generator.model.deadline import Deadline, Late
from generator.transport import Transport, World
from generator.transport.left_out import PARTS, PATCH

_FEWEST_PIXELS = 4
_TOGETHER = 3
"""Sets of effects left out together that time is planned for."""
SAFE = 0.5
"""Share of the tolerance that the effects left out may take, by the upper end of their interval. The rest is for
what only shows at rare poses, a few of which a plan has not seen."""

Variant = Callable[[Sequence[str]], tuple[World, bool]]
"""Returns a world without some effects, and whether the object's shadow on its room is kept."""


def parts(world: World, names: Sequence[str] = ()) -> list[str]:
    """Return what may be left out of a world: the engine's own effects, and surfaces of the room."""
    return [*PARTS, *names] if world.room else [PATCH]


def measure(
    variant: Variant,
    every: Sequence[str],
    positions: Array,
    rotations: Array,
    *,
    rounds: int,
    tolerance: float = 0.01,
    accuracy: float = 1e-3,
    planned: float = 0.0,
    deadline: Deadline | None = None,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> tuple[list[Effect], list[str], Effect]:
    """Leave out one effect after the other, and then together all that a tolerance allows.

    Parameters
    ----------
    variant : callable
        See `Variant`.
    every : sequence of str
        Names of the effects that are measured.
    positions, rotations : ndarray of shape (n, 3)
        Poses that are rendered, metres and degrees: round by round, in each one pose of every voxel.
    rounds : int
        Number of rounds.
    tolerance : float
        Allowed relative error of a difference picture, root mean square over pixels and poses
        (`intervals.relative`).
    accuracy : float
        Accuracy of the engine with which effects are measured.
    planned : float
        Accuracy of the engine in the planned sweep; 0 takes `accuracy`.
    deadline : Deadline, optional
        Fewer rounds are taken, two at least, so that all effects can be measured in time; those that cannot have NaN
        for an error, and are not left out.
    progress : callable
        Called with the number of effects measured, their total, and the name of the next.

    Returns
    -------
    effects : list of Effect
        The largest first.
    dropped : list of str
        Names of the effects that may be left out together.
    together : Effect
        Error with all of these left out together, at the planned accuracy.

    Raises
    ------
    NlosError
        The object cannot stand at a pose.
    """
    planned, deadline = planned or accuracy, deadline or Deadline()
    if math.isfinite(deadline.left):
        rounds, each = _rounds_in_time(variant, every, positions, rotations, rounds, accuracy, deadline)
        positions, rotations = positions[: rounds * each], rotations[: rounds * each]
    try:
        whole, seconds = differences(variant, (), positions, rotations, accuracy, deadline)
    except Late:
        return [Effect(name, UNKNOWN) for name in every], [], Effect("nothing", UNKNOWN)
    scale = (whole**2).mean(axis=(1, 2)).reshape(rounds, -1)

    def compared(name: str, made: Array, gain: float = math.nan, note: str = "") -> Effect:
        error = ((made - whole) ** 2).mean(axis=(1, 2)).reshape(rounds, -1)
        return Effect(name, relative(error, scale), gain, note)

    def effect(name: str, dropped: Sequence[str], precision: float = accuracy) -> Effect:
        try:
            made, took = differences(variant, dropped, positions, rotations, precision, deadline)
        except Late:
            return Effect(name, UNKNOWN)
        return compared(name, made, seconds / max(took, 1e-9))

    effects = []
    for done, name in enumerate(every):
        progress(done, len(every) + 1, name)
        effects.append(effect(name, [name]))
    dropped: list[str] = []
    together = effect("nothing", [], planned)
    # By the upper end, so that an effect whose interval is too wide stands in the way of no other.
    for one in sorted((e for e in effects if e.share[2] <= SAFE * tolerance), key=lambda e: e.share[2]):
        tried = effect(" and ".join([*dropped, one.name]), [*dropped, one.name], planned)
        if tried.share[2] <= SAFE * tolerance:  # errors may add up or cancel, so they are measured together
            dropped.append(one.name)
            together = tried
    empty = Transport(variant(())[0], accuracy=accuracy).background().mean(axis=2)
    for digits in (np.float32, np.float16):
        stored = (whole + empty).astype(digits).astype(np.float64) - empty.astype(digits).astype(np.float64)
        note = "float32, always" if digits is np.float32 else "kept: float32, always"
        effects.append(compared(f"digits beyond {np.dtype(digits).name}", stored, note=note))
    height, width = whole.shape[1:]
    for factor in (2, 4):
        if width % factor == height % factor == 0 and min(width, height) // factor >= _FEWEST_PIXELS:
            coarse = whole.reshape(len(whole), height // factor, factor, width // factor, factor).mean(axis=(2, 4))
            made = np.array([cv2.resize(one, (width, height), interpolation=cv2.INTER_CUBIC) for one in coarse])
            name = f"pixels beyond {width // factor} x {height // factor}"
            effects.append(compared(name, made, note="kept: each counts its own photons"))
    progress(len(every) + 1, len(every) + 1, "done")
    return sorted(effects, key=Effect.rank), dropped, together


def _rounds_in_time(
    variant: Variant,
    every: Sequence[str],
    positions: Array,
    rotations: Array,
    rounds: int,
    accuracy: float,
    deadline: Deadline,
) -> tuple[int, int]:
    """Return how many rounds are likely to end in time, at least two, and the number of poses of each."""
    each = len(positions) // rounds
    begun = deadline.clock()
    _, seconds = differences(variant, (), positions[:1], rotations[:1], accuracy, Deadline())
    setting_up = deadline.clock() - begun
    renders = len(every) + 2 + _TOGETHER
    return max(2, min(rounds, int((deadline.left / renders - setting_up) / (each * seconds)))), each


def differences(
    variant: Variant,
    dropped: Sequence[str],
    positions: Array,
    rotations: Array,
    accuracy: float,
    deadline: Deadline,
) -> tuple[Array, float]:
    """Return difference pictures (n, height, width), and the seconds that one takes; raise `Late` if that is late."""
    world, shadows = variant(dropped)
    deadline.check()
    engine = Transport(world, accuracy=accuracy)
    engine.difference(positions[0], rotations[0], shadows=shadows)  # warm-up, not timed: one-off work
    start, pictures = time.perf_counter(), []
    for position, rotation in zip(positions, rotations, strict=True):
        deadline.check()
        pictures.append(engine.difference(position, rotation, shadows=shadows))
    seconds = (time.perf_counter() - start) / len(positions)
    return np.array(pictures).mean(axis=3), seconds
