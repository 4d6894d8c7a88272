"""Hold the engine's light of many reflections, and of a sky, against paths followed at random, Cycles and itself.

python benchmarks/reflections.py -o DIR [--only NAME ...] [--paths N] [--cycles N]   some 15 minutes on one core
python benchmarks/reflections.py -o DIR --hard N                                     some seconds a pose
python benchmarks/reflections.py -o DIR --touching N --paths 200000                  some minutes a pose

Prints tables and writes ``reflections.csv`` and ``reflections-cycles.csv``, or ``reflections-hard.csv``, or
``reflections-touching.csv``.

- Paths at random (``tests/support/brute_force.py``) have no cells and no quadrature. A sheet stands at three random
  poses in each preset and in three random rooms; compared is the mean of the picture. Orders cancel each other in
  part, so differences are relative to the *whole* change: the sum of the absolute changes by each order, up to the
  largest that counts. A sky is let in where the room lacks a side: of room and corridor, the ceiling. With both
  lights, the sky is as bright as makes its whole change as large as the lamp's. Order 120 stands for all.
- Cycles' ``patch`` at order 6: the slope of its change of the picture on the engine's, over all poses and pixels;
  its standard error from six renders of each, which differ in their noise.
- Hard poses, for all reflections: against the engine with half a million lines through the target from the beginning,
  more from the lamp, a target met by lines from the picture and not summed over its surface, cells of half the size,
  and of less near the target. Printed is also what the engine itself says (`Transport.light_error`).
- Those of them that touch floor or wall, lit by the lamp, are held to paths too.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import planning
import results
from numpy.typing import NDArray
from scipy.stats import t as student

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "support"))
import brute_force

from generator.blender.engines import renderers
from generator.blender.engines.survey import surfel_world
from generator.blender.scene import blend_file, build, posing
from generator.model.arrays import rotation_matrix
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.quantities import ALL_ORDERS
from generator.model.scene import ROOM_SURFACES, Scene
from generator.model.settings import Sweep
from generator.transport import AmbientLight, Mesh, Transport, World
from generator.transport.light import change, field, near

Array = NDArray[Any]

RESULTS = {
    "reflections": (
        "scene",
        "light",
        "of",
        "after the third, %",
        "order 4",
        "order 6",
        "order 10",
        "all",
        "worst pose, all",
    ),
    "reflections-cycles": ("light", "poses", "slope", "standard error", "background, engine / Cycles"),
    "reflections-hard": (
        "scene",
        "light",
        "pose",
        "poses",
        "median, %",
        "worst, %",
        "above 1 %",
        "worst with half a million lines through the target, %",
        "told by the engine, median, %",
        "above 1 % and twice what is told",
    ),
    "reflections-touching": (
        "scene",
        "pose",
        "paths, %",
        "their 95 %",
        "all reflections at once, %",
        "one by one, %",
    ),
}
ORDERS = {"order 4": 4, "order 6": 6, "order 10": 10, "all": ALL_ORDERS}
LONG = 120
"""Reflections that stand for all."""
POSES, REPEATS = 3, 16
RANDOM = 3
ROUNDS = 6
"""Renders of each pose by Cycles, with noise of their own, from which its standard error follows."""
_MANY = {"_LINES": 1 << 19, "_MOST_LINES": 1 << 19}
FINER: tuple[dict[str, Any], ...] = (
    _MANY,
    {**_MANY, "_VIEWS": ((48, 1 << 11),), "_FIRST_LINES": 0, "_LIT": 1 << 14},
)
"""Numbers of lines in `change`: through the target; and also from the picture's points to it, and from the lamp."""
FINE_CELLS: tuple[dict[str, Any], ...] = ({"_CELL": 0.0175, "_BLOCK": 12}, {"_SHARP": 0.25, "_FINEST": 1.0 / 128.0})
"""Sizes of the cells that the best is found with: in `field`, and in `near`."""


@dataclass(frozen=True)
class Case:
    """A scene: its worlds by the light in them, and where its sheet stands.

    Attributes
    ----------
    worlds : dict of str to World
        Of "lamp" and "sky", where the lamp is on as well.
    positions, rotations : ndarray of shape (POSES, 3)
        Metres, degrees.
    """

    name: str
    worlds: dict[str, World]
    positions: Array
    rotations: Array


def world_of(scene: Scene) -> World:
    """Return the engine's input for a spec."""
    made = blend_file.new_file()
    build.build(made, scene)
    return surfel_world(made)


def poses(scene: Scene, seed: int, count: int = POSES) -> tuple[Array, Array]:
    """Return random positions and rotations, wholly inside the grid where it is large enough."""
    rng, reach = np.random.default_rng([24, seed]), scene.target.size / math.sqrt(2.0)
    low, high = np.array(scene.grid.lo) + reach, np.array(scene.grid.hi) - reach
    middle = (low + high) / 2.0
    low, high = np.minimum(low, middle), np.maximum(high, middle)
    return rng.uniform(low, high, (count, 3)), rng.uniform((-15.0, -15.0, -90.0), (15.0, 15.0, 90.0), (count, 3))


def cases() -> Iterator[Case]:
    """Yield the presets and random rooms with a sheet in them."""
    for seed, name in enumerate(("room", "corridor", "tabletop")):
        scene = replace(preset(name), resolution=(16, 16))
        worlds = {"lamp": world_of(scene), "sky": world_of(scene.with_ambient(1.0))}
        yield Case(name, worlds, *poses(scene, seed))
    found = 0
    for seed in range(1000):
        made = planning.random_scene(seed)
        world = surfel_world(made, resolution=(16, 16))
        sides = sum(o.name.lower() in ROOM_SURFACES for o in made.objects)
        if isinstance(world.target[0], Mesh) and sides < len(ROOM_SURFACES):
            found += 1
            scene = replace(preset("room"), target=replace(preset("room").target, size=_extent(world.target[0])))
            lit = replace(world, ambient=AmbientLight(np.ones(3)))
            yield Case(f"random {seed}", {"lamp": world, "sky": lit}, *poses(scene, 100 + seed))
        if found == RANDOM:
            return


def _extent(sheet: Mesh) -> float:
    return float(np.ptp(sheet.triangles.reshape(-1, 3), axis=0).max())


def units(engine: Transport) -> Array:
    """Return the radiance, W/m^2/sr, of the units of `brute_force`: of the lamp's light and of the sky's."""
    setting = engine._setting
    return np.array([math.pi * setting.factor[0], 0.0 if setting.sky is None else setting.sky[0]])


def up_to(runs: Array, order: int) -> tuple[Array, float]:
    """Return the light up to an order by run, and the whole of it, from light by run, source and order."""
    some = runs[:, :, : min(order, LONG) + 1]
    return some.sum(axis=(1, 2)), float(np.abs(some.mean(axis=0)).sum())


def compared(case: Case, paths: int) -> Iterator[tuple[str, ...]]:
    """Yield rows of `RESULTS` for the lamp alone, the sky alone and both."""
    walked, empty = {}, {}
    for name, world in case.worlds.items():
        long = replace(world, order=LONG)
        every = enumerate(zip(case.positions, case.rotations, strict=True))
        walked[name] = [brute_force.changes(long, *p, paths, repeats=REPEATS, seed=1 + k) for k, p in every]
        empty[name] = brute_force.backgrounds(long, paths // 16, repeats=REPEATS, seed=99)
    engine = Transport(case.worlds["sky"], accuracy=1e-2)
    lamp, sky = (units(engine)[k] * sum(up_to(r[:, k : k + 1], LONG)[1] for r in walked["sky"]) for k in (0, 1))
    for light, name, seen in (
        ("lamp", "lamp", (1.0, 0.0)),
        ("sky", "sky", (0.0, 1.0)),
        ("both", "sky", (1.0, lamp / sky)),
    ):
        engines = {
            o: Transport(replace(_lit(case.worlds[name], seen), order=o), accuracy=1e-2) for o in ORDERS.values()
        }
        theirs = [_scaled(runs, engines[4], seen) for runs in walked[name]]
        ours = [
            {o: _change(engine, pose, seen) for o, engine in engines.items()}
            for pose in zip(case.positions, case.rotations, strict=True)
        ]
        yield (case.name, light, "change", *_cells(theirs, ours))
        if light != "both" and (case.name, light) != ("tabletop", "lamp"):
            backgrounds = {o: _background(engine, seen) for o, engine in engines.items()}
            yield (case.name, light, "background", *_cells([_scaled(empty[name], engines[4], seen)], [backgrounds]))


def _lit(world: World, seen: tuple[float, float]) -> World:
    """Return a world whose sky is as bright as told."""
    return replace(world, ambient=AmbientLight(np.full(3, seen[1])) if seen[1] else None)


def _scaled(runs: Array, engine: Transport, seen: tuple[float, float]) -> Array:
    scaled: Array = runs[:, :2] * (units(engine) * [seen[0], 1.0])[:, None]
    return scaled


def _change(engine: Transport, pose: tuple[Array, Array], seen: tuple[float, float]) -> float:
    made = engine.render(*pose)
    lamp = (made.added - made.hidden + made.further)[..., 0].mean()
    return float(seen[0] * lamp + made.ambient[..., 0].mean())


def _background(engine: Transport, seen: tuple[float, float]) -> float:
    dark = engine.background(ambient=False)
    sky = (engine.background() - dark)[..., 0].mean()
    return float(seen[0] * (dark - engine.directly_lit())[..., 0].mean() + sky)


def _cells(theirs: list[Array], ours: list[dict[int, float]]) -> list[str]:
    """Return the share of light after the third reflection, and the engine's differences, per cent of the whole."""
    cells, worst = [], ""
    first, whole = (np.mean([up_to(runs, order)[1] for runs in theirs]) for order in (3, LONG))
    for order in ORDERS.values():
        off, errors = [], []
        for runs, found in zip(theirs, ours, strict=True):
            light, size = up_to(runs, order)
            off.append(100.0 * (found[order] - light.mean()) / size)
            errors.append(100.0 * light.std(ddof=1) / math.sqrt(REPEATS) / size)
        wide = student.ppf(0.975, (REPEATS - 1) * len(errors)) * np.linalg.norm(errors) / len(errors)
        cells.append(f"{np.mean(off):+.2f} ± {wide:.2f}")
        k = int(np.argmax(np.abs(off)))
        one = student.ppf(0.975, REPEATS - 1) * errors[k]
        worst = f"{off[k]:+.2f} ± {one:.2f}"
    return [f"{100.0 * (1.0 - first / whole):.0f}", *cells, worst]


def by_cycles(count: int) -> Iterator[tuple[str, ...]]:
    """Yield rows of `RESULTS` for the room at order 6."""
    base = replace(preset("room"), resolution=(12, 12), reflection_order=6)
    positions, rotations = poses(base, 7, count)
    for light, spec in (("lamp", base), ("lamp and sky", base.with_ambient(0.0008))):
        scene = blend_file.new_file()
        build.build(scene, spec)
        engine = Transport(surfel_world(scene), accuracy=1e-2)
        theirs, squares, empty = np.zeros((ROUNDS, count)), np.zeros(count), []
        setting = {**renderers.settings(Sweep()), "resolution": (12, 12)}
        with renderers.opened(scene, "patch", **setting) as renderer:
            for k, pose in enumerate(zip(positions, rotations, strict=True)):
                posing.move_target(scene, *(tuple(map(float, part)) for part in pose))
                expected = engine.difference(*pose).mean(axis=2)
                squares[k] = (expected**2).mean()
                for r in range(ROUNDS):
                    seed = ROUNDS * k + r
                    seen, bare = (renderer.render(samples=512, seed=seed, target=there) for there in (True, False))
                    theirs[r, k] = ((seen - bare).mean(axis=2) * expected).mean()
                    empty.append(bare.mean())
        slopes = theirs.sum(axis=1) / squares.sum()
        slope, error = slopes.mean(), slopes.std(ddof=1) / math.sqrt(ROUNDS)
        background = engine.background().mean() / np.mean(empty)
        yield light, str(count), f"{slope:.4f}", f"{error:.4f}", f"{background:.4f}"


def hard_poses(scene: Scene, count: int) -> Iterator[tuple[str, Array, Array]]:
    """Yield poses that touch floor or wall, are edge-on to the picture, or behind the partition, in turn."""
    rng, size = np.random.default_rng([24, 1000]), scene.target.size
    room, screen = scene.room, scene.partition
    if room is None or screen is None:
        raise ValueError("a room with a partition")
    back = screen.y[0] if screen.depth else room.y[1]
    low = np.array([screen.x, 0.0, room.z[0]])
    high = np.array([min(room.x[1], screen.x + 4.0 * room.z[1]), back, room.z[1]])
    watched = np.array([np.mean(scene.camera.x), 0.0, np.mean(scene.camera.z)])
    h = size / 2.0
    corners = np.array([[x, 0.0, z] for x in (-h, h) for z in (-h, h)])
    for number in range(count):
        kind = ("on the floor", "at the wall", "edge-on", "behind the partition")[number % 4]
        rotation = rng.uniform(-180.0, 180.0, 3)
        if kind in ("on the floor", "at the wall") and rng.random() < 0.5:
            rotation = rng.choice([0.0, 90.0, 180.0, -90.0], 3)
            rotation[rng.integers(3)] = rng.uniform(-180.0, 180.0)
        # Behind the partition: on the side of it that no part of the picture sees past its edge.
        start = np.array([low[0], screen.y[0], low[2]]) if kind.startswith("behind") and not screen.depth else low
        place = rng.uniform(start, high)
        if kind == "edge-on":
            toward = watched - place
            rotation[2] = math.degrees(math.atan2(toward[1], toward[0]))
            rotation[:2] = 0.0
        turned = corners @ rotation_matrix(tuple(rotation)).T
        margin = 1e-3
        place = np.clip(place, low - turned.min(axis=0) + margin, high - turned.max(axis=0) - margin)
        if kind == "on the floor":
            place[2] = low[2] - turned[:, 2].min()
        if kind == "at the wall":
            place[1] = -turned[:, 1].min()
        yield kind, place, rotation


def at_hard_poses(count: int) -> Iterator[tuple[str, ...]]:
    """Yield rows of `RESULTS`: errors of all reflections at hard poses.

    They are relative to the parts of the change, joined as squares: what `Transport` is asked for.
    """
    for name in ("room", "corridor"):
        for light, spec in (("lamp", preset(name)), ("lamp and sky", preset(name).with_ambient(0.0008))):
            world = replace(world_of(replace(spec, resolution=(16, 16))), order=ALL_ORDERS)
            first = Transport(world, accuracy=1e-2)
            # Each keeps its own lines from pose to pose.
            with patched(field, FINE_CELLS[0]):
                best_engine = Transport(world, accuracy=1e-2)
            engines = {first: {}, Transport(world, accuracy=1e-2, like=first): FINER[0], best_engine: FINER[1]}
            errors: dict[str, list[tuple[float, float, float]]] = {}
            for kind, *pose in hard_poses(spec, count):
                try:
                    *found, best = (
                        drawn_with(finer, engine, pose, FINE_CELLS[1] if engine is best_engine else {})
                        for engine, finer in engines.items()
                    )
                except NlosError as error:
                    print(f"  refused: {name}, {kind}: {error}", flush=True)
                    continue
                size = math.sqrt((best**2).mean(axis=(1, 2)).sum())
                off = [100.0 * math.sqrt(float(((one - best).sum(axis=0) ** 2).mean())) / size for one in found]
                told = 100.0 * first.light_error(*pose)
                errors.setdefault(kind, []).append((off[0], off[1], told))
                if off[0] > 1.0:
                    place, turn = (part.round(4).tolist() for part in pose)
                    both = ", ".join(f"{one:.2f} %" for one in (*off, told))
                    print(f"  {name}, {light}, {kind}, {place}, {turn}: {both}", flush=True)
            for kind, every in errors.items():
                usual, lines, told = np.array(every).T
                figures = (
                    f"{np.median(usual):.2f}",
                    f"{usual.max():.2f}",
                    str((usual > 1.0).sum()),
                    f"{lines.max():.2f}",
                    f"{np.median(told):.2f}",
                    str(((usual > 1.0) & (usual > 2.0 * told)).sum()),
                )
                yield name, light, kind, str(len(every)), *figures


def touching(count: int, paths: int) -> Iterator[tuple[str, ...]]:
    """Yield rows of `RESULTS`: the mean change after the third reflection, of all the rest, at poses that touch.

    It is relative to the mean change by the first three and that by the rest, of the paths, joined as squares.
    """
    for name in ("room", "corridor"):
        world = world_of(replace(preset(name), resolution=(16, 16)))
        orders = ALL_ORDERS, LONG
        engines = [Transport(replace(world, order=order), accuracy=1e-2) for order in orders]
        unit = units(engines[0])[0]
        for kind, *pose in hard_poses(preset(name), count):
            if kind not in ("on the floor", "at the wall"):
                continue
            try:
                found = [float(engine.render(*pose).further[..., 0].mean()) for engine in engines]
            except NlosError as error:
                print(f"  refused: {name}, {kind}: {error}", flush=True)
                continue
            runs = unit * brute_force.changes(replace(world, order=LONG), *pose, paths, repeats=REPEATS, seed=7)[:, 0]
            first, rest = runs[:, :4].sum(axis=1), runs[:, 4:].sum(axis=1)
            size = math.hypot(first.mean(), rest.mean()) / 100.0
            wide = student.ppf(0.975, REPEATS - 1) * rest.std(ddof=1) / math.sqrt(REPEATS)
            yield name, kind, *(f"{v / size:+.1f}" for v in (rest.mean(), wide, *found))


def drawn_with(numbers: dict[str, Any], engine: Transport, pose: list[Array], cells: dict[str, Any]) -> Array:
    """Return an engine's change (parts, height, width) with other numbers of lines: the lamp's up to the third
    reflection, its further ones, and the sky's."""
    with patched(change, numbers), patched(near, cells):
        made = engine.render(*pose)
        return np.stack([made.added - made.hidden, made.further, made.ambient])[..., 0]


@contextmanager
def patched(module: ModuleType, numbers: dict[str, Any]) -> Iterator[None]:
    """Set constants of a module for a while."""
    usual = {name: getattr(module, name) for name in numbers}
    try:
        for name, number in numbers.items():
            setattr(module, name, number)
        yield
    finally:
        for name, number in usual.items():
            setattr(module, name, number)


def main() -> None:
    """Compare, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the tables")
    parser.add_argument(
        "--only", nargs="+", metavar="NAME", help="scenes (room, corridor, tabletop, random, ...), cycles"
    )
    parser.add_argument("--paths", type=int, default=20000, help="from each of 16 parts of the picture, 16 times")
    parser.add_argument("--cycles", type=int, default=8, help="poses that Cycles renders")
    parser.add_argument("--hard", type=int, help="instead of all that: so many hard poses in each room and light")
    parser.add_argument("--touching", type=int, help="instead: of so many hard poses those that touch, by paths")
    options = parser.parse_args()
    if options.touching:
        show(options.out, "reflections-touching", list(touching(options.touching, options.paths)))
        return
    if options.hard:
        show(options.out, "reflections-hard", list(at_hard_poses(options.hard)))
        return
    rows: list[tuple[str, ...]] = []
    for case in cases():
        if options.only is None or {case.name, case.name.split()[0]} & set(options.only):
            rows += compared(case, options.paths)
            show(options.out, "reflections", rows)
    if options.only is None or "cycles" in options.only:
        show(options.out, "reflections-cycles", list(by_cycles(options.cycles)))


def show(folder: Path, name: str, rows: list[tuple[str, ...]]) -> None:
    """Write and print a table of `RESULTS`."""
    results.write(folder, name, RESULTS[name], rows)
    print("\n".join(" | ".join(row) for row in (RESULTS[name], *rows)), flush=True)


if __name__ == "__main__":
    main()
