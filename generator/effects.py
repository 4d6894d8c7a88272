"""What each part of a scene contributes to the difference picture: measured by leaving it out.

The engine `surfel` has no noise, so what is left out of a plain diffuse scene shows to the last digit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

from generator import figures
from generator.intervals import bootstrap
from generator.spec import Array
from generator.transport import Transport, World

SHADOW = "its shadow on the room"
PATCH = "the lit patch's extent"

_POINT = 1e-3
"""Of the lit patch, in itself, where it counts as a point."""


@dataclass(frozen=True)
class Effect:
    """What is wrong with a picture that lacks something.

    Attributes
    ----------
    name : str
    share : (float, float, float)
        Root mean square of the error of a difference picture without it, relative to the difference with it: in the
        mean over poses, with the 95 % interval of a bootstrap over them (Efron 1979).
    gain : float
        Times as many pictures a second without it.
    """

    name: str
    share: tuple[float, float, float]
    gain: float


@dataclass(frozen=True)
class Plan:
    """What a tolerance allows to leave out.

    Attributes
    ----------
    effects : list of Effect
        The largest first.
    dropped : list of str
        What may be left out together.
    together : Effect
        All of these left out at once, as measured.
    """

    effects: list[Effect]
    dropped: list[str]
    together: Effect


def without(world: World, names: Sequence[str], dropped: Sequence[str]) -> tuple[World, bool]:
    """Return a world without some effects, and whether the object's shadow on its room is left.

    Parameters
    ----------
    world : World
    names : sequence of str
        Of the world's room, surface by surface.
    dropped : sequence of str
        `SHADOW`, `PATCH`, or names of the room.
    """
    room = tuple(mesh for mesh, name in zip(world.room, names, strict=True) if name not in dropped)
    patch = world.patch
    if PATCH in dropped:
        small = {name: _POINT * getattr(patch, name) for name in ("major", "minor")}
        patch = replace(patch, **small, intensity=patch.intensity / _POINT**2)
    return replace(world, room=room, patch=patch), SHADOW not in dropped


def measure(
    world: World,
    names: Sequence[str],
    positions: Array,
    rotations: Array,
    *,
    accuracy: float = 1e-3,
    tolerance: float = 0.01,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> Plan:
    """Leave out one effect after the other, and then all at once that a tolerance allows.

    Parameters
    ----------
    world : World
    names : sequence of str
        Of the world's room, surface by surface.
    positions, rotations : ndarray of shape (n, 3)
        Of the poses that are looked at, metres and degrees.
    accuracy : float
        Of the engine.
    tolerance : float
        Relative error of a difference picture that is allowed, root mean square in the mean pose.
    progress : callable
        Is told how many pictures were asked for, of how many, and what is left out next.

    Raises
    ------
    NlosError
        The object cannot be at a pose.
    """
    every = [SHADOW, PATCH, *names] if names else [PATCH]
    whole, seconds = _differences(world, names, (), positions, rotations, accuracy)
    scale = np.sqrt((whole**2).mean(axis=(1, 2)))

    def effect(title: str, dropped: Sequence[str]) -> Effect:
        got, took = _differences(world, names, dropped, positions, rotations, accuracy)
        error = np.sqrt(((got - whole) ** 2).mean(axis=(1, 2)))
        share = np.divide(error, scale, out=np.zeros_like(error), where=scale > 0.0)
        return Effect(title, bootstrap(share), seconds / max(took, 1e-9))

    found = []
    for done, name in enumerate(every):
        progress(done, len(every) + 1, name)
        found.append(effect(name, [name]))
    small = sorted(found, key=lambda e: e.share[0])
    dropped: list[str] = []
    together = Effect("nothing", (0.0, 0.0, 0.0), 1.0)
    for one in small:
        if one.share[2] > tolerance:
            break
        tried = effect(" and ".join([*dropped, one.name]), [*dropped, one.name]) if dropped else one
        if tried.share[2] > tolerance:  # errors add up, or cancel: only measuring tells
            continue
        dropped.append(one.name)
        together = tried
    progress(len(every) + 1, len(every) + 1, "done")
    return Plan(small[::-1], dropped, together)


def _differences(
    world: World, names: Sequence[str], dropped: Sequence[str], positions: Array, rotations: Array, accuracy: float
) -> tuple[Array, float]:
    """Difference pictures (n, height, width), and the seconds that one takes."""
    some, shadows = without(world, names, dropped)
    engine = Transport(some, accuracy=accuracy)
    background = engine.background().mean(axis=2)
    engine.pictures(positions[:1], rotations[:1], shadows=shadows)  # what is made once is no part of a picture's time
    start = time.perf_counter()
    made = engine.pictures(positions, rotations, shadows=shadows).astype(np.float64).mean(axis=3) - background
    return made, (time.perf_counter() - start) / len(positions)


HEADINGS = ("left out", "error of a difference picture", "pictures a second", "")


def rows(plan: Plan) -> list[tuple[str, ...]]:
    """Return a table: a row for each effect, the largest first."""
    return [
        (
            effect.name,
            "{:.3g} % ({:.3g} to {:.3g})".format(*(100.0 * s for s in effect.share)),
            f"x {effect.gain:.2g}",
            "may be left out" if effect.name in plan.dropped else "needed",
        )
        for effect in plan.effects
    ]


def draw(path: Path, plan: Plan, tolerance: float, title: str) -> None:
    """Write a picture: a bar for each effect, and the tolerance."""
    effects = [effect for effect in plan.effects[::-1] if effect.share[0] > 0.0]
    figure, axis = plt.subplots(figsize=(8.0, 0.8 + 0.4 * max(1, len(effects))), layout="constrained")
    value, low, high = (np.array([100.0 * e.share[k] for e in effects]) for k in range(3))
    colours = ["#8b949e" if e.name in plan.dropped else "#1f6feb" for e in effects]
    if effects:
        axis.barh([e.name for e in effects], value, xerr=np.maximum([value - low, high - value], 0.0), color=colours)
        axis.set_xscale("log")
    axis.axvline(100.0 * tolerance, color="#cf222e", lw=1.0, ls="--")
    axis.set_xlabel("error of a difference picture without it, % of it")
    axis.set_title(title, fontsize=10)
    figures.save(path, figure)
