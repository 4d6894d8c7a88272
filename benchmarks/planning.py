"""Compare what a plan predicts for a scene with measurements: presets, clutter, mirrors, adversarial scenes.

python benchmarks/planning.py effects -o DIR            each effect, at other poses and with other noise
python benchmarks/planning.py random -o DIR --count 50  the planned picture against the full model, random scenes
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import results

from classify.intervals import wilson
from generator.blender.engines import simplify
from generator.blender.engines.settings import settled
from generator.blender.measure import paired, planning
from generator.blender.scene import blend_file, build, geometry, roles
from generator.blender.scene.clearance import clearance
from generator.blender.scene.description import read_scene
from generator.jobs import budget
from generator.measure import effects, scene_plan
from generator.measure.intervals import relative
from generator.measure.scene_plan import Effect, Plan
from generator.model import poses
from generator.model.deadline import Deadline
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.transport import Transport

RESULTS = {
    "plan-effects": ("scene", "left out", "plan", "measured again", "decision", "prediction"),
    "plan-random": ("tolerance", "rooms", "plans that hold", "largest error / tolerance", "speed-up, median"),
}
OTHER = 1
"""Seed of the poses at which a plan is tested; plans are made with seed 0."""


def material(name: str, colour: float, *, mirror: bool = False, rough: float = 0.0) -> bpy.types.Material:
    """Return a grey Lambertian material, or a mirror."""
    shade = bpy.data.materials.new(name)
    if shade.node_tree is None:
        shade.use_nodes = True
    tree = shade.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeBsdfGlossy" if mirror else "ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (colour, colour, colour, 1.0)
    shader.inputs["Roughness"].default_value = rough
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return shade


def box(name: str, at: Any, size: Any, made: bpy.types.Material) -> None:
    """Put a box into the scene."""
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=at)
    obj = bpy.context.object
    obj.name, obj.scale = name, size
    obj.data.materials.append(made)


def room(kind: str = "sphere", **changes: Any) -> bpy.types.Scene:
    """Return the preset room with some figures changed."""
    scene = blend_file.new_file()
    build.build(scene, replace(preset("room", kind), **changes))
    return scene


def _cluttered() -> bpy.types.Scene:
    scene = room()
    for name, location, size, colour in (
        ("Cupboard", (-2.1, 1.2, 0.9), (0.5, 0.8, 1.8), 0.5),
        ("Table", (-1.2, 1.6, 0.4), (0.8, 0.6, 0.05), 0.6),
        ("Shelf", (2.5, 2.4, 1.5), (0.15, 0.8, 0.03), 0.7),
        ("Chest", (1.4, 3.1, 0.25), (0.7, 0.4, 0.5), 0.3),
        ("Lamp shade", (0.6, 2.4, 2.3), (0.3, 0.3, 0.2), 0.9),
    ):
        box(name, location, size, material(name, colour))
    return scene


def _mirror_sphere() -> bpy.types.Scene:
    scene = room()
    target = roles.find(scene, "target")
    target.data.materials.clear()
    target.data.materials.append(material("Mirror", 0.9, mirror=True))
    return scene


def _mirror_panel() -> bpy.types.Scene:
    scene = room()
    box("Panel", (1.5, 3.38, 1.3), (1.6, 0.01, 1.6), material("Mirror", 0.9, mirror=True))
    return scene


def _board() -> bpy.types.Scene:
    scene = room()
    box("Board", (2.35, 1.15, 1.3), (0.01, 1.6, 1.8), material("Board", 0.95))
    return scene


def _grazing() -> bpy.types.Scene:
    spot = preset("room").spot
    return room(spot=replace(spot, location=(-1.9, 0.28, 1.7)))


def _window() -> bpy.types.Scene:
    base = preset("room", "sphere")
    scene = room(ambient=0.05, room=replace(base.room, surfaces=("floor", "back", "left", "right")))
    # The ceiling with a hole of 60 cm.
    hole = material("Ceiling", 0.8)
    for k, (x, y) in enumerate(
        (((-2.4, 0.5), (0.0, 3.4)), ((1.1, 2.6), (0.0, 3.4)), ((0.5, 1.1), (0.0, 2.4)), ((0.5, 1.1), (3.0, 3.4)))
    ):
        middle, size = [(a + b) / 2.0 for a, b in (x, y)], [b - a for a, b in (x, y)]
        box(f"Ceiling {k}", (*middle, 2.6), (*size, 0.01), hole)
    return scene


def _preset(name: str) -> Callable[[], bpy.types.Scene]:
    def build_preset() -> bpy.types.Scene:
        scene = blend_file.new_file()
        build.build(scene, preset(name, "sphere"))
        return scene

    return build_preset


SCENES: dict[str, Callable[[], bpy.types.Scene]] = {
    "room": _preset("room"),
    "tabletop": _preset("tabletop"),
    "corridor": _preset("corridor"),
    "cluttered": _cluttered,
    "mirror sphere": _mirror_sphere,
    "mirror panel": _mirror_panel,
    "white board": _board,
    "grazing lamp": _grazing,
    "window": _window,
}


def saved(scene: bpy.types.Scene, path: Path) -> Path:
    """Save a scene; return its path."""
    bpy.context.view_layer.update()
    blend_file.save_file(path)
    return path


def other_poses(source: Path, count: int) -> tuple[Any, Any]:
    """Return positions and rotations that the plan has not used."""
    scene = blend_file.open_file(source)
    described = read_scene(scene)
    sweep, _ = settled(scene, described, {"engine": "patch", "poses": count, "seed": OTHER})
    planned = poses.plan(described.grid, sweep, geometry.hull(scene), clearance(scene, described, engine="patch"))
    planned.sort(key=lambda pose: (pose.index, pose.voxel))
    return tuple(np.array([getattr(p, name) for p in planned]) for name in ("position", "rotation"))


def again(source: Path, plan: Plan, most: float) -> dict[str, tuple[float, float, float]]:
    """Measure a plan's effects again, at other poses and with other noise, and the plan's error against Cycles."""
    scene = blend_file.open_file(source)
    described = read_scene(scene)
    sweep, _ = settled(scene, described, {"engine": "patch", "poses": paired.ROUNDS[1], "seed": OTHER})
    planned = poses.plan(described.grid, sweep, geometry.hull(scene), clearance(scene, described, engine="patch"))
    rounds = [[p for p in planned if p.index == k] for k in range(paired.ROUNDS[1])]
    probe = paired.PairedMeasurement(source, "patch", rounds, described.resolution[0] / described.resolution[1])
    pieces = [e.name for e in plan.effects if e.name in simplify.removable_pieces(blend_file.open_file(source))]
    sky = planning.ambient(source, [p for round_poses in rounds[: scene_plan.POSES] for p in round_poses])
    pieces = [name for name in pieces if name != simplify.AMBIENT or sky is None]
    orders = [o for o in (4, 5) if any(e.name == paired.order_name(o) for e in plan.effects)]
    measured = paired.measure(probe, pieces, orders=orders, tolerance=plan.tolerance, deadline=Deadline(most))
    if sky is not None:
        measured[sky.name] = sky.share
    if plan.settings["engine"] == "surfel":
        cycles = [name for name in plan.dropped if name in (*pieces, simplify.AMBIENT)]
        variant = planning.variant(source, cycles)
        names = [e.name for e in plan.effects if not e.note and e.name not in measured]
        places, turns = other_poses(source, scene_plan.POSES)
        exact, _, _ = effects.measure(
            variant,
            names,
            places,
            turns,
            rounds=scene_plan.POSES,
            accuracy=max(budget.FINE, plan.tolerance / 20.0),
            tolerance=0.0,
        )
        measured |= {e.name: e.share for e in exact}
        measured["all of it, against Cycles"] = _against_cycles(probe, variant, plan, most)
    return measured


def _against_cycles(probe: Any, variant: Any, plan: Plan, most: float) -> tuple[float, float, float]:
    """Return the error of the planned pictures against Cycles' of the whole scene, without Cycles' noise."""
    world, shadows = variant(plan.dropped)
    errors, wholes, start = [], [], time.monotonic()
    for number in range(paired.ROUNDS[1]):
        whole = probe.whole(number)
        size = (paired.PIXELS, whole.shape[2] // paired.PIXELS)
        small = replace(world, watched=replace(world.watched, resolution=size))
        engine = Transport(small, accuracy=plan.settings["accuracy"])
        planned = [
            engine.difference(p.position, p.rotation, shadows=shadows).mean(axis=2).ravel()
            for p in probe.rounds[number]
        ]
        errors.append(whole - np.array(planned))
        wholes.append(whole)
        if number >= 3 and time.monotonic() - start > most:
            break
    return paired.share(errors, wholes)


def verdict(effect: Effect, measured: tuple[float, float, float], tolerance: float) -> str:
    """Return whether a prediction held: within a factor of 1.5, or inside one of the two intervals."""
    value, (got, low, high) = effect.share[0], measured
    if math.isnan(value) or math.isnan(got):
        return "not measured"
    if value > 0.0 and 1 / 1.5 <= got / value <= 1.5:
        return "held"
    if effect.share[1] <= got <= effect.share[2] or low <= value <= high or max(got, value) < tolerance / 30.0:
        return "held"
    return "missed"


def run_effects(options: argparse.Namespace) -> None:
    """Plan every scene, and compare each plan with measurements."""
    table = []
    for name in options.scenes or SCENES:
        source = saved(SCENES[name](), options.output / f"{name}.blend")
        plan = planning.make(source, tolerance=options.tolerance, most=options.most / planning.SHARE)
        try:
            measured = again(source, plan, options.most)
        except NlosError as error:
            print(f"{name}: {error}")
            measured = {}
        for line in plan.words:
            print(f"{name}: {line}")
        for effect in plan.effects:
            if effect.name in measured:
                kept = "left out" if effect.name in plan.dropped else effect.note or "needed"
                row = (name, effect.name, effect.percent(), Effect("", measured[effect.name]).percent(), kept)
                table.append((*row, verdict(effect, measured[effect.name], options.tolerance)))
                print(" | ".join(table[-1]), flush=True)
        if (all_of_it := measured.get("all of it, against Cycles")) is not None:
            table.append(
                (name, "all of it, against Cycles", plan.together.percent(), Effect("", all_of_it).percent(), "", "")
            )
            print(" | ".join(table[-1]), flush=True)
        known = plan.predicted
        if "seconds_full" in known:
            gain = known["seconds_full"] / known["seconds"]
            print(f"{name}: {plan.settings}, {gain:.3g} times as fast", flush=True)
        results.write(options.output, "plan-effects", RESULTS["plan-effects"], table)


def random_scene(seed: int) -> bpy.types.Scene:
    """Return a room of random size, albedo and clutter, with a random target."""
    rng = np.random.default_rng([20, seed])
    base = preset("room", str(rng.choice(["sphere", "sheet"])))
    far, back, top = rng.uniform(2.5, 4.0), rng.uniform(3.2, 5.0), rng.uniform(2.4, 3.4)
    surfaces = [s for s in base.room.surfaces if s == "floor" or rng.random() < 0.75]
    walls = replace(
        base.room,
        x=(-2.4, far),
        y=(0.0, back),
        z=(0.0, top),
        albedo=rng.uniform(0.05, 0.9),
        surfaces=tuple(surfaces),
    )
    scene = room(
        base.target.kind,
        resolution=(32, 32),
        room=walls,
        wall=replace(base.wall, x=(-2.4, far), z=(0.0, top), albedo=rng.uniform(0.3, 0.9)),
        partition=replace(
            base.partition, y=(1.3, back), z=(0.0, top), albedo=rng.choice([0.0, rng.uniform(0.0, 0.8)])
        ),
        target=replace(base.target, size=rng.uniform(0.2, 0.45), albedo=rng.uniform(0.2, 1.0)),
        spot=replace(base.spot, half_angle=rng.uniform(0.8, 3.0)),
    )
    for k in range(rng.integers(0, 5)):
        size = rng.uniform(0.05, 0.6, size=3)
        side = rng.random() < 0.5  # left of the partition, or behind the voxels
        low = np.array([-2.3, 0.2, 0.1]) if side else np.array([0.3, 2.0, 0.1])
        high = np.array([-1.6, 2.5, top - 0.1]) if side else np.array([far - 0.1, back - 0.1, top - 0.1])
        location = rng.uniform(low + size / 2.0, np.maximum(high - size / 2.0, low + size / 2.0 + 1e-3))
        box(f"Box {k}", location, size, material(f"Box {k}", rng.uniform(0.0, 0.95)))
    return scene


def run_random(options: argparse.Namespace) -> None:
    """Plan random scenes, and compare planned pictures with the full model's at other poses."""
    found: list[tuple[float, float, float]] = []
    for seed in range(options.count):
        tolerance = (0.01, 0.02, 0.05, 0.1)[seed % 4]
        source = saved(random_scene(seed), options.output / f"random-{seed}.blend")
        try:
            plan = planning.make(source, tolerance=tolerance, by_cycles=False, predict=False)
            places, turns = other_poses(source, scene_plan.POSES)
        except NlosError as error:
            print(f"{seed}: left out: {error}", flush=True)
            continue
        variant = planning.variant(source, [])
        whole, _ = effects.differences(variant, (), places, turns, max(budget.FINE, tolerance / 30.0))
        accuracy = plan.settings["accuracy"]
        planned, _ = effects.differences(variant, plan.dropped, places, turns, accuracy)
        squares = (((light**2).mean(axis=(1, 2))).reshape(scene_plan.POSES, -1) for light in (planned - whole, whole))
        error = relative(*squares)[0]
        ratios = []
        for _ in range(3):  # both in turn
            times = [effects.differences(variant, names, places, turns, accuracy)[1] for names in ((), plan.dropped)]
            ratios.append(times[0] / times[1])
        found.append((tolerance, error, float(np.median(ratios))))
        print(
            f"{seed}: tolerance {tolerance:g}, {len(plan.dropped)} left out, error {error:.3g}, "
            f"{'holds' if error <= tolerance else 'DOES NOT HOLD'}, {found[-1][2]:.3g} times as fast",
            flush=True,
        )
        results.write(options.output, "plan-random", RESULTS["plan-random"], by_tolerance(found))
    for row in by_tolerance(found):
        print(" | ".join(row))


def by_tolerance(found: Sequence[tuple[float, float, float]]) -> list[tuple[str, ...]]:
    """Return the columns of `RESULTS` for each tolerance, and for all, of tolerances, errors and speed-ups."""
    rows = []
    for tolerance in [*sorted({t for t, _, _ in found}), None]:
        shares, gains = zip(*((e / t, gain) for t, e, gain in found if tolerance in (None, t)), strict=True)
        held, count, gain = sum(share <= 1.0 for share in shares), len(shares), f"{np.median(gains):.3g}"
        if tolerance is None:
            name, largest, rate = "all", "", wilson(held, count)
            holding = f"{held} ({100.0 * rate.value:.0f} %, {100.0 * rate.low:.1f} to {100.0 * rate.high:.1f})"
            gain = f"{gain} ({min(gains):.3g} to {max(gains):.3g})"
        else:
            name, largest, holding = f"{100.0 * tolerance:g} %", f"{100.0 * max(shares):.0f} %", str(held)
        rows.append((name, str(count), holding, largest, gain))
    return rows


def main() -> None:
    """Run one of the two commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["effects", "random"])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--scenes", nargs="*", choices=list(SCENES))
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument(
        "--most", type=float, default=60.0, help="seconds for Cycles' effects, of each scene and time"
    )
    parser.add_argument("--count", type=int, default=50)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    (run_effects if options.what == "effects" else run_random)(options)


if __name__ == "__main__":
    main()
