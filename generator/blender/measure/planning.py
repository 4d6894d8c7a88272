"""Plans what to model of a scene: measures its effects, keeps those that matter, and predicts a sweep's cost."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from generator.blender.engines import simplify, survey
from generator.blender.engines.devices import require_gpu
from generator.blender.engines.reading import MAX_ORDER
from generator.blender.engines.settings import settled
from generator.blender.measure import paired
from generator.blender.scene import blend_file, geometry, roles
from generator.blender.scene.clearance import clearance
from generator.blender.scene.description import read_scene
from generator.jobs import budget
from generator.measure import effects
from generator.measure.intervals import relative
from generator.measure.scene_plan import MOST, POSES, UNKNOWN, Effect, Plan
from generator.model import poses
from generator.model.arrays import Array
from generator.model.deadline import Deadline, Late
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.model.quantities import ALL_ORDERS, clock
from generator.model.settings import Sweep
from generator.transport import Rendered, Transport, World, caching, left_out

_REFERENCE = 1 / 10
"""Accuracy of the engine that effects are measured with, in units of the tolerance."""
_PLANNED = 1 / 3
"""Accuracy of the planned sweep, in the same units; the rest is for what is left out."""
_COARSEST = 0.1
_ORDERS = (4, 5)
_NOTHING = Effect("nothing", (0.0, 0.0, 0.0))
_PIXEL_BYTES = 12
SHARE, _EXACT = 0.4, 0.7
"""Shares of the remaining time for effects that only Cycles models, each time, and for those of `surfel`."""
_ENDING = 1.0
"""Seconds to write and draw what was found."""
_LEAST_TRIAL = 4.0
"""Seconds below which no trial of a sweep ends, since Blender has to start."""
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
    most: float = MOST,
    workers: int = 0,
    by_cycles: bool = True,
    predict: bool = True,
    device: str = "cpu",
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
        Time limit, seconds, for all of it; compiling, which is done once, comes on top. What cannot be measured in
        time is kept, and named (`Plan.unmeasured`).
    workers : int
        Number of workers of the predicted sweep.
    by_cycles : bool
        Whether to measure Cycles' effects; else they are all kept.
    predict : bool
        Whether to predict the cost of the sweep, by rehearsing it; else a plan for Cycles has no samples.
    device : {"cpu", "gpu"}
        Device that Cycles renders on, here and in the predicted sweep.
    tell : callable
        Called with a sentence about what is done.

    Raises
    ------
    NlosError
        The scene cannot be swept, or there is no GPU.
    """
    if device == "gpu":
        require_gpu()
    deadline = Deadline(most - _ENDING)
    scene = blend_file.open_file(source)
    described = read_scene(scene)
    pieces = simplify.removable_pieces(scene)
    _, reasons = survey.world(scene)
    engine, order = _cycles_engine(scene), roles.reflection_order(scene)
    all_records = _planned(scene, described, engine, max(count, paired.ROUNDS[1]), seed)
    fine = [piece for piece in pieces if piece.startswith(simplify.FINE)]  # costs Cycles nothing
    others = [piece for piece in pieces if piece not in fine]
    records = sorted((p for p in all_records if p.index < count), key=lambda p: (p.index, p.voxel))
    _compile(source, records[0], deadline, tell)
    exactly = {effect.name: effect for effect in followed(source, records, deadline.part(SHARE))}
    others = [piece for piece in others if piece not in exactly]
    measured = [Effect(name, UNKNOWN) for name in others]
    dropped: list[str] = []
    words: list[str] = []
    spent = _NOTHING
    if engine == "path":
        words.append(f"only path can render this scene, too noisily to measure anything by: {'; '.join(reasons)}")
    elif by_cycles:
        rounds = [[p for p in all_records if p.index == k] for k in range(paired.ROUNDS[1])]
        aspect = described.resolution[0] / described.resolution[1]
        probe = paired.PairedMeasurement(source, engine, rounds, aspect, device)
        part = deadline.part(SHARE)
        if others:
            tell(f"rendering {len(others)} effects that only Cycles models, for up to {clock(part.left)}")
        shares = paired.measure(probe, others, tolerance=tolerance, deadline=part, progress=tell)
        measured = [Effect(name, shares[name]) for name in others]
        dropped, spent = _droppable(probe, measured, tolerance)
    for effect in sorted(exactly.values(), key=lambda effect: effect.share[2]):
        measured.append(effect)
        joined = _joined(spent, effect)
        if not effect.note and joined.share[2] <= tolerance:
            dropped, spent = [*dropped, effect.name], joined
    if dropped and not {effect.name for effect in measured if not effect.note} - set(dropped):
        _, reasons = _simplified(source, dropped)
    if reasons:
        if engine != "path" and by_cycles:
            part = deadline.part(SHARE)
            bias = paired.denoiser_bias(probe, described.resolution, deadline=part, progress=tell)
            measured.append(Effect(paired.DENOISER, bias, note="not used"))
        words += [f"surfel cannot render this: {reason}" for reason in reasons if engine != "path"]
        plan = Plan(sorted(measured, key=Effect.rank), dropped, spent, {"engine": engine}, tolerance, words)
    else:
        remaining = tolerance - spent.share[2]
        part = deadline.part(_EXACT if predict else 1.0)
        exact, more, together, accuracy = _exact(source, dropped, fine, records, remaining, part, tell)
        together = _joined(together, spent)
        settings = {"engine": "surfel", "accuracy": accuracy}
        plan = Plan(
            sorted([*measured, *exact], key=Effect.rank), [*dropped, *more], together, settings, tolerance, words
        )
    if predict:
        voxels, resolution = described.grid.n_voxels, described.resolution
        plan = _predicted(source, plan, voxels, resolution, device, workers, deadline, tell)
    if by_cycles and engine != "path":
        orders = [k for k in _ORDERS if k > order >= MAX_ORDER and paired.order_name(k) not in exactly]
        further = _further(probe, orders, tolerance, deadline, tell)
        plan = replace(plan, effects=sorted([*plan.effects, *further], key=Effect.rank))
        unknown = [effect.name for effect in plan.effects if math.isnan(effect.share[0])]
        plan = replace(plan, unmeasured=[*plan.unmeasured, *unknown])
    return plan


def _further(
    probe: paired.PairedMeasurement,
    orders: Sequence[int],
    tolerance: float,
    deadline: Deadline,
    tell: Callable[[str], None],
) -> list[Effect]:
    """Return what reflections beyond the scene's own would add; last, for no plan depends on it."""
    if not orders:
        return []
    part = deadline.part(SHARE)
    tell(f"rendering {len(orders)} further reflections, for up to {clock(part.left)}")
    shares = paired.measure(probe, [], orders=orders, tolerance=tolerance, deadline=part, progress=tell)
    names = map(paired.order_name, orders)
    return [Effect(name, shares[name], note="not in the scene") for name in names]


def _joined(one: Effect, other: Effect) -> Effect:
    """Return the sum of two independent errors, in quadrature."""
    low, value, high = (math.hypot(one.share[k], other.share[k]) for k in (1, 0, 2))
    return replace(one, share=(value, low, high))


def _compile(source: Path, pose: PoseRecord, deadline: Deadline, tell: Callable[[str], None]) -> None:
    """Compile `surfel`, if that is still to be done; the time does not count."""
    if not (words := caching.compiling_words("auto")):
        return
    world, _ = survey.world(blend_file.open_file(source))
    if world is None:  # compiled later, if the engine is used after all
        return
    tell(words)
    begun = deadline.clock()
    Transport(world.seen_by(*_SMALL), accuracy=_SKY).difference(pose.position, pose.rotation)
    deadline.extend(deadline.clock() - begun)
    tell(f"compiled in {clock(deadline.clock() - begun)}, which no time limit counts")


def followed(source: Path, some: Sequence[PoseRecord], deadline: Deadline | None = None) -> list[Effect]:
    """Return the contributions of the sky, and of light after the third reflection, by `surfel`.

    Cycles' noise from paths that any ray may end would hide them. Light of more reflections than the scene's own is
    among them, as what is not in the scene.

    Parameters
    ----------
    source : Path
        The ``.blend`` file, which is opened.
    some : sequence of PoseRecord
        Poses of the object: round by round, in each one pose of every voxel.
    deadline : Deadline, optional
        Only rounds that end in time are used; without one in time, contributions are `UNKNOWN`.

    Returns
    -------
    list of Effect
        Empty if `surfel` cannot model the rest of the scene.
    """
    world, _ = survey.world(blend_file.open_file(source))
    if world is None:
        return []
    more = [order for order in (*_ORDERS, ALL_ORDERS) if order > world.order >= MAX_ORDER]
    engines = [Transport(world.seen_by(*_SMALL), accuracy=_SKY)]
    engines += [Transport(replace(world, order=order).seen_by(*_SMALL), accuracy=_SKY) for order in more]
    renders, deadline = [], deadline or Deadline()
    for pose in some:
        if not deadline.left:
            break
        renders.append([engine.render(pose.position, pose.rotation) for engine in engines])
    every = 1 + max(pose.index for pose in some)
    rounds = len(renders) * every // len(some)
    renders = renders[: rounds * len(some) // every]

    changes = [_change(row[0]) for row in renders]

    def share(parts: list[Array]) -> tuple[float, float, float]:
        if not rounds:
            return UNKNOWN
        squares = (np.array([(p.mean(axis=2) ** 2).mean() for p in some]) for some in (parts, changes))
        return relative(*(square.reshape(rounds, -1) for square in squares))

    found = []
    if world.order > MAX_ORDER:
        found.append(Effect(simplify.BEYOND, share([row[0].further for row in renders])))
    if world.ambient is not None:
        found.append(Effect(simplify.AMBIENT, share([row[0].ambient for row in renders])))
    for k, order in enumerate(more, start=1):
        beyond = [_change(row[k]) - change for row, change in zip(renders, changes, strict=True)]
        found.append(Effect(paired.order_name(order), share(beyond), note="not in the scene"))
    return found


def _change(render: Rendered) -> Array:
    return render.added - render.hidden + render.further + render.ambient + render.emitted


def _exact(
    source: Path,
    dropped: Sequence[str],
    fine: Sequence[str],
    some: Sequence[PoseRecord],
    tolerance: float,
    deadline: Deadline,
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
        deadline=deadline,
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
            try:
                share = probe.together(tried)
            except Late:  # what was not measured together is not left out together
                break
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
    wall = roles.find(scene, "relay_wall").name  # a sweep needs it whole
    return [name for name in survey.room_names(scene) if name in scene.objects and name != wall]


def _predicted(
    source: Path,
    plan: Plan,
    voxels: int,
    resolution: tuple[int, int],
    device: str,
    workers: int,
    deadline: Deadline,
    tell: Callable[[str], None],
) -> Plan:
    """Return the plan with the cost of its sweep, and of one that leaves nothing out at the same accuracy."""
    pictures = voxels * Sweep.poses
    costs: dict[str, float] = {}
    unmeasured, took = list(plan.unmeasured), _LEAST_TRIAL
    for name, settings in (
        ("seconds", {**plan.settings, "leave_out": plan.dropped}),
        ("seconds_full", {"engine": "auto"}),
    ):
        if name == "seconds_full" and not plan.dropped and plan.settings["engine"] != "surfel":
            if "seconds" in costs:
                costs[name] = costs["seconds"]  # it is the same sweep
            continue
        what = "the plan" if name == "seconds" else "the whole"
        begun = deadline.clock()
        try:
            if deadline.left < took:
                raise Late
            tell(f"rehearsing {what}")
            trial = budget.measured_by_trial(
                source, {**settings, "device": device}, workers, force=True, deadline=deadline
            )
        except Late:
            unmeasured.append(f"what {what} costs")
            continue
        took = deadline.clock() - begun
        if trial.engine == "surfel":
            work = 1.0 / plan.settings["accuracy"]
        else:
            work = min(max(1.0, (trial.noise / plan.tolerance) ** 2), 2.0**24)
        if name == "seconds" and trial.engine != "surfel":
            plan.settings["samples"] = math.ceil(work)
        costs[name] = float(f"{trial.total(work, pictures):.3g}")
    size = resolution[0] * resolution[1] * _PIXEL_BYTES * pictures
    return replace(plan, predicted={"pictures": pictures, **costs, "bytes": size}, unmeasured=unmeasured)
