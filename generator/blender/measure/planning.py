"""Plans what to model of a scene: measures its effects, keeps those that matter, and predicts a sweep's cost."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from generator.blender.engines import simplify, survey
from generator.blender.engines.reading import MAX_ORDER
from generator.blender.engines.settings import settled
from generator.blender.measure import paired
from generator.blender.scene import blend_file, geometry, roles
from generator.blender.scene.clearance import clearance
from generator.blender.scene.description import read_scene
from generator.jobs import budget
from generator.measure import effects
from generator.measure.intervals import relative
from generator.measure.scene_plan import POSES, Effect, Plan
from generator.model import poses
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.model.settings import Sweep
from generator.transport import Transport, World, left_out

_REFERENCE = 1 / 10
"""Accuracy of the engine that effects are measured with, in units of the tolerance."""
_PLANNED = 1 / 3
"""Accuracy of the planned sweep, in the same units; the rest is for what is left out."""
_COARSEST = 0.1
_ORDERS = (4, 5)
_NOTHING = Effect("nothing", (0.0, 0.0, 0.0))
_PIXEL_BYTES = 12
_SKY = 0.01
"""Accuracy of the lamp's light where ambient light is measured."""
_SMALL = (16, 16)
"""Width and height of pictures that measure ambient light, which has no detail."""


def make(
    source: Path,
    *,
    tolerance: float = 0.01,
    count: int = POSES,
    seed: int = 0,
    most: float = 180.0,
    workers: int = 0,
    predict: bool = True,
    tell: Callable[[str], None] = lambda words: None,
) -> Plan:
    """Measure a scene's effects, and plan a sweep of it.

    `surfel` measures the effects that it models, without noise. Effects that only Cycles models - other lights,
    materials that are not plain, further reflections - are measured by paired renders
    (`generator.blender.measure.paired`). If all of these may be left out, the plan is one for `surfel`.

    Parameters
    ----------
    source : Path
        The ``.blend`` file, which is opened; the file open before is closed without saving.
    tolerance : float
        Allowed error of a difference picture, relative, root mean square over pixels and poses.
    count : int
        Poses per voxel that `surfel` renders.
    seed : int
        Seed of the poses.
    most : float
        Time limit for Cycles' effects, seconds; 0 measures none of them, and keeps them all.
    workers : int
        Number of workers of the predicted sweep.
    predict : bool
        Whether to predict the cost of the sweep, by rehearsing it; else a plan for Cycles has no samples.
    tell : callable
        Called with a sentence about what is done.

    Raises
    ------
    NlosError
        The scene cannot be swept.
    """
    scene = blend_file.open_file(source)
    described = read_scene(scene)
    pieces = simplify.removable_pieces(scene)
    _, reasons = survey.world(scene)
    engine, order = _cycles_engine(scene), roles.reflection_order(scene)
    all_records = _planned(scene, described, engine, max(count, paired.ROUNDS[1]), seed)
    fine = [piece for piece in pieces if piece.startswith(simplify.FINE)]  # costs Cycles nothing
    others = [piece for piece in pieces if piece not in fine]
    records = sorted((p for p in all_records if p.index < count), key=lambda p: (p.index, p.voxel))
    sky = ambient(source, records) if simplify.AMBIENT in others else None
    if sky is not None:
        others.remove(simplify.AMBIENT)
    measured = [Effect(name, (math.nan, 0.0, math.inf)) for name in others]
    dropped: list[str] = []
    words: list[str] = []
    spent = _NOTHING
    if engine == "path":
        words.append(f"only path can render this scene, too noisily to measure anything by: {'; '.join(reasons)}")
    elif most > 0.0:
        orders = [more for more in _ORDERS if more > order >= MAX_ORDER]
        rounds = [[p for p in all_records if p.index == k] for k in range(paired.ROUNDS[1])]
        probe = paired.PairedMeasurement(source, engine, rounds, described.resolution[0] / described.resolution[1])
        tell(f"rendering {len(others) + len(orders)} effects that only Cycles models, for up to {most:.0f} s")
        shares = paired.measure(probe, others, orders=orders, tolerance=tolerance, most=most, progress=tell)
        measured = [Effect(name, shares[name]) for name in others]
        dropped, spent = _droppable(probe, measured, tolerance)
        names = map(paired.order_name, orders)
        measured += [Effect(name, shares[name], note="not in the scene") for name in names]
    if sky is not None:
        measured.append(sky)
        joined = _joined(spent, sky)
        if joined.share[2] <= tolerance:
            dropped, spent = [*dropped, sky.name], joined
    if dropped and not {effect.name for effect in measured if not effect.note} - set(dropped):
        _, reasons = _simplified(source, dropped)
    if reasons:
        if engine != "path" and most > 0.0:
            bias = paired.denoiser_bias(probe, described.resolution, most=most / 3.0, progress=tell)
            measured.append(Effect(paired.DENOISER, bias, note="not used"))
        words += [f"surfel cannot render this: {reason}" for reason in reasons if engine != "path"]
        plan = Plan(_sorted(measured), dropped, spent, {"engine": engine}, tolerance, words)
    else:
        remaining = tolerance - spent.share[2]
        exact, more, together, accuracy = _exact(source, dropped, fine, records, remaining, tell)
        together = _joined(together, spent)
        settings = {"engine": "surfel", "accuracy": accuracy}
        plan = Plan(_sorted([*measured, *exact]), [*dropped, *more], together, settings, tolerance, words)
    if not predict:
        return plan
    return _predicted(source, plan, described.grid.n_voxels, described.resolution, workers, tell)


def _joined(one: Effect, other: Effect) -> Effect:
    """Return the sum of two independent errors, in quadrature."""
    low, value, high = (math.hypot(one.share[k], other.share[k]) for k in (1, 0, 2))
    return replace(one, share=(value, low, high))


def ambient(source: Path, some: Sequence[PoseRecord]) -> Effect | None:
    """Return the contribution of uniform ambient light by `surfel`; None if it cannot model the rest of the scene.

    Cycles' noise from a sky that any ray may hit would hide it; an error of a few per cent of it changes no decision.

    Parameters
    ----------
    source : Path
        The ``.blend`` file, which is opened.
    some : sequence of PoseRecord
        Poses of the object: round by round, in each one pose of every voxel.
    """
    world, _ = survey.world(blend_file.open_file(source), ambient=True)
    if world is None or world.ambient is None:
        return None
    engine = Transport(world.seen_by(*_SMALL), accuracy=_SKY)
    renders = [engine.render(pose.position, pose.rotation) for pose in some]
    sky = np.array([render.ambient.mean(axis=2) for render in renders])
    lamp = np.array([(render.added - render.hidden).mean(axis=2) for render in renders])
    rounds = 1 + max(pose.index for pose in some)
    error, signal = ((x**2).mean(axis=(1, 2)).reshape(rounds, -1) for x in (sky, lamp + sky))
    return Effect(simplify.AMBIENT, relative(error, signal))


def _exact(
    source: Path,
    dropped: Sequence[str],
    fine: Sequence[str],
    some: Sequence[PoseRecord],
    tolerance: float,
    tell: Callable[[str], None],
) -> tuple[list[Effect], list[str], Effect, float]:
    """Return what `effects.measure` does for a scene without some pieces, and the accuracy of its sweep."""
    positions, rotations = (np.array([getattr(pose, name) for pose in some]) for name in ("position", "rotation"))
    without = variant(source, dropped)
    accuracy = float(f"{max(budget.FINE, min(_COARSEST, _PLANNED * tolerance)):.2g}")
    measured = effects.measure(
        without,
        [*effects.parts(without(())[0], _room(source, dropped)), *fine],
        positions,
        rotations,
        rounds=1 + max(pose.index for pose in some),
        tolerance=tolerance,
        accuracy=max(budget.FINE, min(accuracy, _REFERENCE * tolerance)),
        planned=accuracy,
        progress=lambda done, total, what: tell(f"{done} of {total} measured without noise; next: {what}"),
    )
    return *measured, accuracy


def _cycles_engine(scene: Any) -> str:
    try:
        survey.lit_patch(scene)
    except NlosError:
        return "path"
    return "patch"


def _planned(scene: Any, described: Any, engine: str, count: int, seed: int) -> list[PoseRecord]:
    sweep, _ = settled(scene, described, {"engine": engine, "poses": count, "seed": seed})
    # Every engine but path needs the target hidden from lamp and camera, so these poses suit all engines.
    is_free = clearance(scene, described, engine="patch" if engine == "path" else engine)
    return poses.plan(described.grid, sweep, geometry.hull(scene), is_free)


def _droppable(
    probe: paired.PairedMeasurement, found: Sequence[Effect], tolerance: float
) -> tuple[list[str], Effect]:
    """Return which of Cycles' effects may be left out together, and their joint error."""
    dropped: list[str] = []
    together = _NOTHING
    for candidate in sorted(found, key=lambda effect: effect.share[2]):
        if not candidate.share[2] <= tolerance:
            break
        tried, share = [*dropped, candidate.name], candidate.share
        if dropped:
            share = probe.together(tried)
        if share[2] <= tolerance:
            dropped, together = tried, Effect(" and ".join(tried), share)
    return dropped, together


def variant(source: Path, always: Sequence[str]) -> effects.Variant:
    """Return the function of a scene's world without some pieces, besides those that are always left out."""

    def without(dropped: Sequence[str]) -> tuple[World, bool]:
        world, reasons = _simplified(source, [*always, *dropped])
        assert world is not None, reasons
        return left_out.without(world, dropped)

    return without


def _simplified(source: Path, dropped: Sequence[str]) -> tuple[World | None, list[str]]:
    scene = blend_file.open_file(source)
    simplify.apply(scene, dropped)
    return survey.world(scene)


def _room(source: Path, dropped: Sequence[str]) -> list[str]:
    scene = blend_file.open_file(source)
    simplify.apply(scene, dropped)
    return [name for name in survey.room_names(scene) if name in scene.objects]


def _sorted(found: Sequence[Effect]) -> list[Effect]:
    return sorted(found, key=lambda effect: -math.inf if math.isnan(effect.share[0]) else -effect.share[0])


def _predicted(
    source: Path, plan: Plan, voxels: int, resolution: tuple[int, int], workers: int, tell: Callable[[str], None]
) -> Plan:
    """Return the plan with the cost of its sweep, and of one that leaves nothing out at the same accuracy."""
    pictures = voxels * Sweep.poses
    costs: dict[str, float] = {}
    for name, settings in (
        ("seconds", {**plan.settings, "leave_out": plan.dropped}),
        ("seconds_full", {"engine": "auto"}),
    ):
        if name == "seconds_full" and not plan.dropped and plan.settings["engine"] != "surfel":
            costs[name] = costs["seconds"]  # it is the same sweep
            continue
        tell(f"rehearsing {'the plan' if name == 'seconds' else 'the whole'}")
        trial = budget.measured_by_trial(source, settings, workers, force=True)
        if trial.engine == "surfel":
            work = 1.0 / plan.settings["accuracy"]
        else:
            work = min(max(1.0, (trial.noise / plan.tolerance) ** 2), 2.0**24)
        if name == "seconds" and trial.engine != "surfel":
            plan.settings["samples"] = math.ceil(work)
        costs[name] = float(f"{trial.total(work, pictures):.3g}")
    size = resolution[0] * resolution[1] * _PIXEL_BYTES * pictures
    return replace(plan, predicted={"pictures": pictures, **costs, "bytes": size})
