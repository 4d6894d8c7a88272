"""Hold `surfel` against Cycles and Mitsuba 3: seven scenes, five lights, 4, 6, 10 and all reflections.

python benchmarks/peers.py -o DIR [--only SCENE ...] [--light LIGHT ...] [--order N ...] [--seconds S]

Writes ``peers.csv``. Compared are the light that a hidden target changes and the background, in absolute units:
nothing is fitted. Each peer renders with the target and without it, with equal noise, until its 95 % intervals are
below `GOAL` or its seconds of processor time are spent; with 12 of them, some two hours on one core.

- Lights: the lamp; the sky, where the room lacks a ceiling or another side; both; a window in a side of a room that
  is closed otherwise (in the corridor, in its ceiling), with the sky outside; a glowing panel.
- Cycles reads the Blender scene. It renders by `patch` where the lamp shines, else by `path`, with a portal in the
  window, from which it draws directions.
- Mitsuba renders the world that `survey` reads: from the true spot by light tracing, other light by path tracing; the
  two add up where both shine. Its window is a surface as bright as the sky; ``--sky`` leaves the sky itself there.
- Columns: root mean square of the difference relative to that of its parts, what the target adds and what it hides,
  joined as squares: to these the engine's accuracy is relative, and where they nearly cancel, errors of their
  difference are larger. Then the mean of the engine's picture less the peer's, relative to the root mean square of
  the engine's; and its root mean square over the peer's, less 1, where products of pictures of independent noise keep
  the noise out.

Mitsuba needs what `engines.py` says.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import planning
import results
from mitsuba_scene import Prepared, mitsuba
from numpy.typing import NDArray
from scipy.stats import t as student

from generator.blender.engines import renderers, simplify
from generator.blender.engines.survey import surfel_world
from generator.blender.scene import blend_file, build, posing, roles
from generator.blender.scene.description import read_scene
from generator.model.presets import preset
from generator.model.quantities import ALL_ORDERS
from generator.model.scene import ROOM_SURFACES, Room, Scene
from generator.model.settings import Sweep
from generator.transport import Emitters, Transport, World

Array = NDArray[Any]
Pair = tuple[Array, Array]
"""The change by the target and the background, (height, width) each, W/m^2/sr."""

RESULTS = {
    "peers": (
        "scene",
        "light",
        "reflections",
        "peer",
        "difference of its parts, %",
        "difference, mean, %",
        "difference, RMS, %",
        "background, mean, %",
        "background, RMS, %",
    ),
}
ORDERS = {"4": 4, "6": 6, "10": 10, "all": ALL_ORDERS}
SOURCES = {
    "lamp": ("lamp",),
    "sky": ("sky",),
    "both": ("lamp", "sky"),
    "window": ("sky",),
    "panel": ("emitters",),
}
"""Lights, and what the engine calls their sources."""
PIXELS = (16, 16)
GOAL = 0.01
"""Half width of an interval at which a peer stops."""
LEAST = 8
"""Fewest renders of a peer."""
SAMPLES = {"Cycles": 256, "Mitsuba": 1024}
"""Paths per pixel of one render: its noise is not that of the next."""
CERTAIN = 8
"""Reflections after which Cycles may end a path by chance, where all of them count."""
TURN, NEAR = (10.0, -5.0, -35.0), (0.8, 0.55, 1.3)
"""How the target stands: its face to the lit patch, and near the picture, which it changes little from afar."""


@dataclass(frozen=True)
class Case:
    """A scene, and where its target, a window and a panel are in it.

    Attributes
    ----------
    make : callable
        Returns the Blender scene, dark.
    place : (float, float, float)
        Of the target, metres.
    window : str and three of float
        Side that the window is in; its middle along that side's two axes, x before y before z, and its size, metres.
    panel : str and four of float
        Axis that the panel is normal to; its middle and its size, metres.
    """

    make: Callable[[], bpy.types.Scene]
    place: tuple[float, float, float]
    window: tuple[str, float, float, float] = ("right", 1.2, 1.5, 0.6)
    panel: tuple[str, float, float, float, float] = ("z", 1.4, 1.6, 2.3, 0.6)


def _made(name: str) -> Callable[[], bpy.types.Scene]:
    def make() -> bpy.types.Scene:
        scene = blend_file.new_file()
        build.build(scene, preset(name))
        return scene

    return make


CASES = {
    "room": Case(_made("room"), NEAR),
    "corridor": Case(
        _made("corridor"), (1.5, 0.9, 1.5), window=("ceiling", 3.5, 1.2, 1.2), panel=("z", 3.5, 1.2, 2.8, 1.0)
    ),
    "tabletop": Case(
        _made("tabletop"), (0.1, 0.4, 0.05), window=("right", 0.7, 0.1, 0.4), panel=("y", 0.45, 0.9, 0.3, 0.3)
    ),
    "cluttered": Case(planning.SCENES["cluttered"], NEAR),
    **{f"random {seed}": Case(lambda seed=seed: planning.random_scene(seed), NEAR) for seed in range(3)},
}


def lit(case: Case, light: str, radiance: float) -> tuple[bpy.types.Scene, Array | None]:
    """Return the Blender scene under a light, and the window's triangles (2, 3, 3), turned inwards, if it has one."""
    scene = case.make()
    spec = read_scene(scene, PIXELS)
    if light == "panel":
        build.build(scene, spec)
        _panel(case.panel)
        return scene, None
    if light != "window":
        build.build(scene, spec.with_ambient(radiance if light in ("sky", "both") else 0.0))
        return scene, None
    side, *where = case.window
    room = _closed(spec)
    open_room = replace(room, surfaces=tuple(s for s in ROOM_SURFACES if s != side))
    build.build(scene, replace(spec, room=open_room, ambient=radiance))
    return scene, _windowed(room, side, *where)


def _closed(spec: Scene) -> Room:
    """Return the room with all its sides; around a wall that stands alone, a box."""
    if spec.partition is None:
        return Room(x=spec.wall.x, y=(0.0, 1.2), z=spec.wall.z)
    albedo = spec.room.albedo if spec.room else 0.8
    return Room(x=spec.wall.x, y=(0.0, spec.partition.y[1]), z=spec.wall.z, albedo=albedo)


def _windowed(room: Room, side: str, along: float, across: float, size: float) -> Array:
    """Put a side with a square hole in it into the open scene, and return the hole."""
    axis, (first, second) = (0, (1, 2)) if side == "right" else (2, (0, 1))
    ends = [room.x, room.y, room.z]
    made = planning.material("Window side", room.albedo or 0.0)
    low, high = np.array([along, across]) - size / 2.0, np.array([along, across]) + size / 2.0

    def corners(u: tuple[float, float], v: tuple[float, float]) -> Array:
        found = np.full((4, 3), ends[axis][1])
        found[:, first], found[:, second] = [u[0], u[1], u[1], u[0]], [v[0], v[0], v[1], v[1]]
        return found

    (u0, u1), (v0, v1) = ends[first], ends[second]
    for number, (u, v) in enumerate(
        (
            ((u0, low[0]), (v0, v1)),
            ((high[0], u1), (v0, v1)),
            ((low[0], high[0]), (v0, low[1])),
            ((low[0], high[0]), (high[1], v1)),
        )
    ):
        _mesh(f"Window side {number}", corners(u, v), made)
    hole = corners((low[0], high[0]), (low[1], high[1]))[::-1]  # its normal leads inwards
    triangles: Array = hole[[[0, 1, 2], [0, 2, 3]]]
    return triangles


def _mesh(name: str, corners: Array, material: bpy.types.Material) -> None:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners.tolist(), [], [tuple(range(len(corners)))])
    mesh.materials.append(material)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))


def _panel(panel: tuple[str, float, float, float, float]) -> None:
    """Put a square that glows, on both sides, into the open scene."""
    normal, *middle, size = panel
    corners = np.tile(np.array(middle), (4, 1))
    first, second = (k for k in range(3) if "xyz"[k] != normal)
    corners[:, first] += size * np.array([-0.5, 0.5, 0.5, -0.5])
    corners[:, second] += size * np.array([-0.5, -0.5, 0.5, 0.5])
    glow = planning.material("Glow", 0.0)
    tree = glow.node_tree
    shader = tree.nodes.new("ShaderNodeEmission")
    shader.inputs["Strength"].default_value = 1.0
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    _mesh("Panel", corners, glow)


def _portal(case: Case, hole: Array) -> None:
    """Put a portal into a window of the open scene, which tells Cycles where the sky's light comes from."""
    light = bpy.data.lights.new("Portal", "AREA")
    light.cycles.is_portal = True
    light.size = case.window[3]
    portal = bpy.data.objects.new("Portal", light)
    portal.location = hole.reshape(-1, 3)[[0, 1, 2, 5]].mean(axis=0)
    if case.window[0] == "right":  # a ceiling's shines down as it is made
        portal.rotation_euler = (0.0, math.pi / 2.0, 0.0)
    bpy.context.scene.collection.objects.link(portal)


def by_surfel(world: World, light: str, pose: Any) -> tuple[Pair, float]:
    """Return what the engine says at an accuracy of 1 %, and the change's size relative to its parts'."""
    engine = Transport(world, accuracy=1e-2)
    made = engine.render(*pose)
    of_source = {"lamp": made.added - made.hidden + made.further, "sky": made.ambient, "emitters": made.emitted}
    nothing = np.zeros((engine._setting.tint.shape[1], *PIXELS[::-1]))
    added = engine._changed(*pose, nothing, shadows=False)
    added["lamp"] = added["lamp"] + made.added
    seen = SOURCES[light]
    change, light_added = (np.sum([part[name] for name in seen], axis=0) for part in (of_source, added))
    background = engine.background() if "lamp" in seen else engine._followed(*seen)
    sizes = [float((part**2).mean()) for part in (change, light_added, light_added - change)]
    return (change.mean(axis=2), background.mean(axis=2)), math.sqrt(sizes[0] / (sizes[1] + sizes[2]))


class Mitsuba:
    """Renders a world by several methods, whose light adds up.

    Parameters
    ----------
    world : World
    methods : tuple of str
        Of `mitsuba_scene.METHODS`.
    pose : two of (float, float, float)
    """

    def __init__(self, world: World, methods: tuple[str, ...], pose: Any) -> None:
        self._scenes = [
            [Prepared(world, *pose, method=method, target=there) for there in (True, False)] for method in methods
        ]

    def draw(self, seed: int) -> Pair:
        """Render both pictures."""
        drawn = [[part.draw(SAMPLES["Mitsuba"], seed).mean(axis=2) for part in parts] for parts in self._scenes]
        seen, empty = np.sum(drawn, axis=0)
        return seen - empty, empty


def sampled(draw: Callable[[int], Pair], ours: Pair, seconds: float) -> list[str]:
    """Render until intervals are short enough or time is up; return the cells of `RESULTS`."""
    start, pairs = time.process_time(), []
    while True:
        pairs.append(draw(len(pairs)))
        if len(pairs) < LEAST:
            continue
        found = [figure for k in (0, 1) for figure in figures(np.array([pair[k] for pair in pairs]), ours[k])]
        if max(wide for _, wide in found) < GOAL or time.process_time() - start > seconds:
            return [f"{100.0 * value:+.2f} ± {100.0 * wide:.2f}" for value, wide in found]


def figures(theirs: Array, ours: Array) -> Iterator[tuple[float, float]]:
    """Yield the engine's error in the mean and in the root mean square, with the half width of its 95 % interval.

    Parameters
    ----------
    theirs : ndarray of shape (n, height, width)
        Pictures by a peer, with independent noise.
    ours : ndarray of shape (height, width)
    """
    n, size = len(theirs), math.sqrt(float((ours**2).mean()))
    quantile = float(student.ppf(0.975, n - 1))
    means = theirs.mean(axis=(1, 2))
    yield float(ours.mean() - means.mean()) / size, quantile * float(means.std(ddof=1)) / math.sqrt(n) / size
    total, squares = theirs.sum(axis=0), (theirs**2).mean(axis=(1, 2))
    # Sums of products of all pairs, and of all but one picture's (jackknife).
    whole = float((total**2).mean()) - float(squares.sum())
    without = ((total - theirs) ** 2).mean(axis=(1, 2)) - (squares.sum() - squares)
    root = math.sqrt(max(0.0, whole / (n * (n - 1))))
    roots = np.sqrt(np.maximum(0.0, without / ((n - 1) * (n - 2))))
    wide = quantile * math.sqrt((n - 1) / n * float(((roots - roots.mean()) ** 2).sum()))
    yield (size / root - 1.0, wide * size / root**2) if root else (math.inf, math.inf)


def brightness(case: Case) -> float:
    """Return the sky's radiance, W/m^2/sr, by which it changes the picture twice as much as the lamp does."""
    scene, _ = lit(case, "both", 1.0)
    world = replace(surfel_world(scene, resolution=PIXELS), order=4)
    made = Transport(world, accuracy=3e-2).render(case.place, TURN)
    lamp, sky = (float(np.sqrt((p**2).mean())) for p in (made.added - made.hidden + made.further, made.ambient))
    return 2.0 * lamp / sky


def compared(name: str, light: str, options: argparse.Namespace) -> Iterator[tuple[str, ...]]:
    """Yield rows of `RESULTS`."""
    case = CASES[name]
    scene, hole = lit(case, light, brightness(case) if light == "both" else 1.0)
    pose = case.place, TURN
    world = surfel_world(scene, resolution=PIXELS)
    theirs = world
    if hole is not None and not options.sky:
        glow = Emitters(hole, np.ones((2, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(2))
        theirs = replace(world, ambient=None, emitters=glow)
    methods = {"lamp": ("spot",), "both": ("spot", "path")}.get(light, ("path",))
    posing.move_target(scene, *pose)
    engine = "patch" if light in ("lamp", "both") else "path"
    if engine == "path":
        simplify.without_light(scene)
    if hole is not None:
        _portal(case, hole)
    for label in options.order:
        order = ORDERS[label]
        ours, kept = by_surfel(replace(world, order=order), light, pose)
        start = name, light, label
        roles.limit_reflections(scene, order)
        setting = {**renderers.settings(Sweep()), "resolution": PIXELS, "threads": 1}
        with renderers.opened(scene, engine, **setting) as renderer:
            if order == ALL_ORDERS:
                scene.cycles.min_light_bounces = CERTAIN

            def by_cycles(seed: int, renderer: Any = renderer) -> Pair:
                seen, empty = (
                    renderer.render(samples=SAMPLES["Cycles"], seed=seed, target=there).mean(axis=2, dtype=float)
                    for there in (True, False)
                )
                return seen - empty, empty

            yield *start, "Cycles", f"{100.0 * kept:.0f}", *sampled(by_cycles, ours, options.seconds)
        if options.mitsuba:
            by_mitsuba = Mitsuba(replace(theirs, order=order), methods, pose)
            yield *start, "Mitsuba", f"{100.0 * kept:.0f}", *sampled(by_mitsuba.draw, ours, options.seconds)


def main() -> None:
    """Compare, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the table")
    parser.add_argument("--only", nargs="+", metavar="SCENE", choices=list(CASES), default=list(CASES))
    parser.add_argument("--light", nargs="+", metavar="LIGHT", choices=list(SOURCES), default=list(SOURCES))
    parser.add_argument("--order", nargs="+", choices=list(ORDERS), default=list(ORDERS))
    parser.add_argument("--seconds", type=float, default=12.0, help="for each peer, scene, light and order")
    parser.add_argument("--sky", action="store_true", help="Mitsuba's window is a hole under the sky")
    options = parser.parse_args()
    try:
        mitsuba("llvm_ad_mono")
        options.mitsuba = True
    except ImportError as error:
        print(f"Mitsuba left out: {error}", flush=True)
        options.mitsuba = False
    rows: list[tuple[str, ...]] = []
    for name in options.only:
        for light in options.light:
            for row in compared(name, light, options):
                rows.append(row)
                print(" | ".join(row), flush=True)
                results.write(options.out, "peers", RESULTS["peers"], rows)


if __name__ == "__main__":
    main()
