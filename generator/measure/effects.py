"""What each part of a scene contributes to the difference picture: measured by leaving it out.

The engine `surfel` has no noise, so what is left out of a plain diffuse scene shows to the last digit.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import cv2
import numpy as np

from generator.measure.intervals import relative
from generator.measure.scene_plan import Effect
from generator.model.arrays import Array
from generator.transport import Transport, World
from generator.transport.left_out import PARTS, PATCH

_FEWEST_PIXELS = 4
SAFE = 0.5
"""Of the tolerance that what is left out may take by the upper end of its interval: what only shows at rare poses, a
few of which a plan has not seen, has the rest."""

Variant = Callable[[Sequence[str]], tuple[World, bool]]
"""Returns a world without some effects, and whether the object's shadow on its room is left."""


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
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> tuple[list[Effect], list[str], Effect]:
    """Leave out one effect after the other, and then all at once that a tolerance allows.

    Parameters
    ----------
    variant : callable
    every : sequence of str
        What is tried.
    positions, rotations : ndarray of shape (n, 3)
        Of the poses that are looked at, metres and degrees: round by round, in each one pose of every voxel.
    rounds : int
        That they are.
    tolerance : float
        Relative error of a difference picture that is allowed, root mean square over pixels and poses
        (`intervals.relative`).
    accuracy : float
        Of the engine, where effects are measured.
    planned : float
        Of the engine, as the sweep will have it; 0 is the same.
    progress : callable
        Is told how many pictures were asked for, of how many, and what is left out next.

    Returns
    -------
    effects : list of Effect
        The largest first.
    dropped : list of str
        What may be left out together.
    together : Effect
        All of these left out at once at the planned accuracy.

    Raises
    ------
    NlosError
        The object cannot be at a pose.
    """
    planned = planned or accuracy
    whole, seconds = differences(variant, (), positions, rotations, accuracy)
    scale = (whole**2).mean(axis=(1, 2)).reshape(rounds, -1)

    def compared(name: str, made: Array, gain: float = math.nan, note: str = "") -> Effect:
        error = ((made - whole) ** 2).mean(axis=(1, 2)).reshape(rounds, -1)
        return Effect(name, relative(error, scale), gain, note)

    def effect(name: str, dropped: Sequence[str], precision: float = accuracy) -> Effect:
        made, took = differences(variant, dropped, positions, rotations, precision)
        return compared(name, made, seconds / max(took, 1e-9))

    found = []
    for done, name in enumerate(every):
        progress(done, len(every) + 1, name)
        found.append(effect(name, [name]))
    dropped: list[str] = []
    together = effect("nothing", [], planned)
    for one in sorted(found, key=lambda e: e.share[0]):
        if one.share[2] > SAFE * tolerance:
            break
        tried = effect(" and ".join([*dropped, one.name]), [*dropped, one.name], planned)
        if tried.share[2] <= SAFE * tolerance:  # errors add up, or cancel: only measuring tells
            dropped.append(one.name)
            together = tried
    empty = Transport(variant(())[0], accuracy=accuracy).background().mean(axis=2)
    for digits in (np.float32, np.float16):
        stored = (whole + empty).astype(digits).astype(np.float64) - empty.astype(digits).astype(np.float64)
        note = "float32, always" if digits is np.float32 else "kept: float32, always"
        found.append(compared(f"digits beyond {np.dtype(digits).name}", stored, note=note))
    height, width = whole.shape[1:]
    for factor in (2, 4):
        if width % factor == height % factor == 0 and min(width, height) // factor >= _FEWEST_PIXELS:
            few = whole.reshape(len(whole), height // factor, factor, width // factor, factor).mean(axis=(2, 4))
            made = np.array([cv2.resize(one, (width, height), interpolation=cv2.INTER_CUBIC) for one in few])
            name = f"pixels beyond {width // factor} x {height // factor}"
            found.append(compared(name, made, note="kept: each counts its own photons"))
    progress(len(every) + 1, len(every) + 1, "done")
    return sorted(found, key=lambda e: -e.share[0]), dropped, together


def differences(
    variant: Variant, dropped: Sequence[str], positions: Array, rotations: Array, accuracy: float
) -> tuple[Array, float]:
    """Difference pictures (n, height, width), and the seconds that one takes."""
    some, shadows = variant(dropped)
    engine = Transport(some, accuracy=accuracy)
    engine.difference(positions[0], rotations[0], shadows=shadows)  # what is made once is no part of a picture's time
    start = time.perf_counter()
    made = [engine.difference(*pose, shadows=shadows) for pose in zip(positions, rotations, strict=True)]
    took = (time.perf_counter() - start) / len(positions)
    return np.array(made).mean(axis=3), took
