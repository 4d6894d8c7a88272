"""Error against time, and agreement in absolute units: `surfel`, `patch`, `path`, and the independent Mitsuba 3.

    python benchmarks/engines.py -o DIR [--quick] [--only agreement|time]

Measured is the light that the hidden target adds: the picture with it minus the picture without it, both with the
same noise. "time": error (root mean square over pixels, relative to the signal's) of a new pose, at rising numbers of
samples, against `surfel` at an accuracy of 1e-6 (in the room 1e-5); `surfel` also renders batches of poses, as a
sweep does, and its seconds are then those of one pose. "agreement": the picture's mean, engine against
engine, with 95 % intervals over independent renders, from 1 m down to 5 cm from the relay wall; that table, not the
first, shows that the engines are right, since Mitsuba shares nothing with them: it renders worlds made by hand
(`scenes.py`), and `surfel` those that `generator.blender.engines.survey` reads from the Blender scene.

Mitsuba is left out, with a message, where it is not installed (`pip install mitsuba`; its LLVM variants need LLVM 17
or later). Cycles and Mitsuba each run in a separate process, one at a time.
"""

from __future__ import annotations

import argparse
import functools
import json
import math
import multiprocessing
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pictures
import results
import scenes
from scipy.stats import t as student

from generator.model.arrays import Vector, rotation_matrix
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.scene import Scene, Target
from generator.transport.compiled import COMPILED
from generator.transport.world import Body, Sphere, World

ROTATION = (15.0, -10.0, -35.0)
"""Rotation that turns the sheet's face to the lit patch; edge-on, there would be almost no light to compare."""
RESULTS = {
    "agreement": ("scene", "surfel, W/m²/sr", "hidden", "patch / surfel - 1", "Mitsuba / surfel - 1"),
    "speed": ("method", "sphere, 1 m, bare wall", "sheet, 1 m, bare wall", "sphere, 1 m, room"),
    "error-by-time": ("scene", "method", "setting", "seconds", "least", "most", "error"),
}
GOAL = 0.01
REFERENCE = {False: 1e-6, True: 1e-5}
"""Accuracy of the reference pictures, before the bare wall and in the room, whose own light takes long to compute."""


@dataclass(frozen=True)
class Case:
    """A target in one pose, in the room or before the bare wall.

    Attributes
    ----------
    target : {"sphere", "sheet", "box", "sphere+sheet"}
        The box is open, so that it shadows itself; the last is one target of two parts, one in front of the other.
    gap : float
        Distance of the target's nearest point from the relay wall, metres.
    room : bool
        Whether the target is in the preset room; if not, there is neither room nor partition.
    resolution : int
        Pixels along each side.
    """

    target: str
    gap: float
    room: bool
    resolution: int = 64

    @property
    def name(self) -> str:
        """Name for tables and plots."""
        return f"{self.target}, {self.gap:g} m, {'room' if self.room else 'bare wall'}"

    @property
    def spec(self) -> Scene:
        """The scene; its target is a sheet where a spec cannot describe the target."""
        kind = self.target if self.target in ("sphere", "sheet") else "sheet"
        scene = replace(preset("room", kind), resolution=(self.resolution, self.resolution))
        return scene if self.room else replace(scene, room=None, partition=None)

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The target in its own frame."""
        if self.target == "box":
            return (scenes.box(0.35, 0.9),)
        if self.target == "sphere+sheet":
            ball = Sphere(np.array([-0.13, -0.12, 0.04]), 0.12, np.full(3, 0.9))
            sheet = scenes.bodies(Target(kind="sheet", size=0.3, albedo=0.9))[0]
            return (ball, scenes.moved(sheet, (0.08, 0.12, 0.0)))
        return scenes.bodies(self.spec.target)

    @property
    def position(self) -> Vector:
        """Position right of the lamp's cone, out of the camera's view, and such that the gap is right."""
        turn = rotation_matrix(ROTATION)
        spheres = [float((turn @ b.centre)[1]) - b.radius for b in self.bodies if isinstance(b, Sphere)]
        meshes = [float((b.triangles @ turn.T)[..., 1].min()) for b in self.bodies if not isinstance(b, Sphere)]
        nearest = min(spheres + meshes)
        return (0.75, self.gap - nearest, 1.3)

    @property
    def world(self) -> World:
        """The world, made by hand."""
        return scenes.world_from_spec(self.spec, self.bodies)


Shots = tuple[list[float], list[np.ndarray], list[np.ndarray]]
"""Seconds, difference pictures (height, width) and backgrounds of one engine, render by render."""


def cycles(case: Case, engine: str, samples: int, seeds: list[int], denoise: bool = False) -> Shots:
    """Render differences with Cycles; runs in a separate process. Seconds are those of a new pose."""
    from generator.blender.engines import renderers
    from generator.blender.scene import posing

    blender = _blender_scene(case)
    seconds, differences, backgrounds = [], [], []
    with renderers.opened(blender, engine, resolution=case.spec.resolution) as renderer:
        blender.cycles.use_denoising = denoise
        if denoise:
            blender.cycles.denoiser = "OPENIMAGEDENOISE"
        renderer.render(samples=1, seed=0)
        for seed in seeds:
            x, y, z = case.position
            posing.move_target(blender, (x, y + 0.1, z), ROTATION)
            renderer.render(samples=1, seed=0)
            start = time.perf_counter()
            posing.move_target(blender, case.position, ROTATION)
            picture = renderer.render(samples=samples, seed=seed)[..., 0].astype(float)
            empty = np.zeros_like(picture)
            if case.room:
                empty = renderer.render(samples=samples, seed=seed, target=False)[..., 0].astype(float)
            seconds.append(time.perf_counter() - start)
            differences.append(picture - empty)
            backgrounds.append(empty)
        blender.cycles.use_denoising = False
    return seconds, differences, backgrounds


def extracted(case: Case) -> tuple[World | None, list[str]]:
    """Return the world that `survey` reads from the case's Blender scene, or reasons; for Cycles' process."""
    from generator.blender.engines import survey

    return survey.world(_blender_scene(case), resolution=case.spec.resolution)


@functools.lru_cache(maxsize=1)
def _blender_scene(case: Case) -> Any:
    from generator.blender.scene import blend_file, build, posing, roles

    blender = blend_file.new_file()
    build.build(blender, case.spec)
    target = roles.find(blender, "target")
    if case.target not in ("sphere", "sheet"):
        target[roles.KIND] = "mesh"
        _give_shape(target, case.bodies[0])
        for body in case.bodies[1:]:
            part = target.copy()
            part.data = target.data.copy()
            del part[roles.ROLE]
            _give_shape(part, body)
            target.users_collection[0].objects.link(part)
            part.parent = target
            part.location = (0.0, 0.0, 0.0)
    posing.move_target(blender, case.position, ROTATION)
    return blender


def _give_shape(obj: Any, body: Body) -> None:
    triangles = body.centre + scenes.icosphere(body.radius, 5) if isinstance(body, Sphere) else body.triangles
    corners, index = np.unique(triangles.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    obj.data.clear_geometry()
    obj.data.from_pydata(corners.tolist(), [], index.reshape(-1, 3).tolist())
    obj.data.update()


def mitsuba(case: Case, method: str, samples: int, seeds: list[int]) -> Shots:
    """Render differences with Mitsuba; runs in a separate process. Seconds are those of a new pose."""
    from mitsuba_scene import Prepared

    world, pose = case.world, (case.position, ROTATION)
    empty = Prepared(world, *pose, method=method, target=False) if case.room else None
    seconds, differences, backgrounds = [], [], []
    # The first render warms up: kernels are compiled for every kind of scene, and again while another scene exists.
    for n, seed in ((min(samples, 1024), 0), *((samples, seed) for seed in seeds)):
        start = time.perf_counter()
        picture = Prepared(world, *pose, method=method).draw(n, seed)[..., 0]
        background = empty.draw(n, seed)[..., 0] if empty else np.zeros_like(picture)
        seconds.append(time.perf_counter() - start)
        differences.append(picture - background)
        backgrounds.append(background)
    return seconds[1:], differences[1:], backgrounds[1:]


def mitsuba_missing() -> str:
    """Return why Mitsuba cannot be used; empty if it can. Runs in its process, which a wrong LLVM would abort."""
    try:
        from mitsuba_scene import mitsuba as load

        load("llvm_ad_mono").Float([1.0, 2.0]) + 1.0
    except Exception as error:
        return f"Mitsuba left out: {error}"
    return ""


class Surfel:
    """The transport engine in one world.

    Parameters
    ----------
    world : World
    accuracy : float
    """

    def __init__(self, world: World, accuracy: float) -> None:
        from generator.transport import Transport

        start = time.perf_counter()
        self._transport = Transport(world, accuracy=accuracy)
        self.background = np.asarray(self._transport.background(), dtype=float)[..., 0]
        self.setup = time.perf_counter() - start

    def difference(self, case: Case) -> np.ndarray:
        """Return the light that the target adds minus the light that it hides, (height, width)."""
        rendered = self._transport.render(case.position, ROTATION)
        return np.asarray(rendered.added - rendered.hidden, dtype=float)[..., 0]

    def hidden_share(self, case: Case) -> float:
        """Return the light that the target hides, as a fraction of the light that it adds."""
        rendered = self._transport.render(case.position, ROTATION)
        return float(np.mean(rendered.hidden) / np.mean(rendered.added))

    def timed(self, case: Case, repeats: int = 5) -> tuple[float, np.ndarray]:
        """Return the median seconds of a new pose, and its picture."""
        seconds = []
        for _ in range(repeats):
            self.difference(replace(case, gap=case.gap + 0.1))
            start = time.perf_counter()
            picture = self.difference(case)
            seconds.append(time.perf_counter() - start)
        return float(np.median(seconds)), picture

    def timed_batch(self, case: Case, poses: int) -> tuple[float, np.ndarray]:
        """Return the seconds per picture of a batch of new poses, and the picture of the case."""
        places = np.array(case.position) + np.random.default_rng(0).uniform(-0.1, 0.1, (poses, 3))
        places[:, 1] = np.maximum(places[:, 1], case.position[1])
        turns = np.tile(ROTATION, (poses, 1))
        self._transport.pictures(places + np.array([0.0, 0.1, 0.0]), turns)
        places[0] = case.position
        start = time.perf_counter()
        pictures = self._transport.pictures(places, turns)
        return (time.perf_counter() - start) / poses, pictures[0, ..., 0].astype(float) - self.background


class Processes:
    """Cycles and Mitsuba, each in a fresh interpreter that lives as long as this object."""

    def __enter__(self) -> Processes:
        spawn = multiprocessing.get_context("spawn")
        self._pools = {name: ProcessPoolExecutor(1, mp_context=spawn) for name in ("cycles", "mitsuba")}
        try:
            self.missing = self.mitsuba(mitsuba_missing)
        except Exception as error:  # the process was aborted, so it cannot say why
            self.missing = f"Mitsuba left out: its process died ({error}); is there an LLVM of version 17 or later?"
        if self.missing:
            print(self.missing, flush=True)
        return self

    def __exit__(self, *_: object) -> None:
        for pool in self._pools.values():
            pool.shutdown()

    def cycles(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function in Cycles' process."""
        return self._pools["cycles"].submit(function, *arguments).result()

    def mitsuba(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function in Mitsuba's process."""
        return self._pools["mitsuba"].submit(function, *arguments).result()

    def surfel_world(self, case: Case) -> World:
        """Return the world that `generator.blender.engines.survey` reads from the case's Blender scene."""
        world, reasons = self.cycles(extracted, case)
        if world is None:
            raise NlosError(f"{case.name}: surfel cannot render it: {'; '.join(reasons)}")
        return world


Sampler = Callable[[Case, int, list[int]], Shots]

PATH, PATCH, DENOISED = "path", "patch", "patch, OIDN"
MITSUBA_PATCH, MITSUBA_SPOT = "Mitsuba, patch", "Mitsuba, spot"
SURFEL, BATCH = "surfel", "surfel, batches"
POSES = {False: 1024, True: 64}
"""Poses in a batch, before the bare wall and in the room."""


def samplers(processes: Processes) -> dict[str, Sampler]:
    """Return every Monte Carlo method that is available, by name."""
    methods: dict[str, Sampler] = {
        PATH: lambda case, n, seeds: processes.cycles(cycles, case, "path", n, seeds),
        PATCH: lambda case, n, seeds: processes.cycles(cycles, case, "patch", n, seeds),
        DENOISED: lambda case, n, seeds: processes.cycles(cycles, case, "patch", n, seeds, True),
    }
    if not processes.missing:
        methods[MITSUBA_PATCH] = lambda case, n, seeds: processes.mitsuba(mitsuba, case, "patch", n, seeds)
        methods[MITSUBA_SPOT] = lambda case, n, seeds: processes.mitsuba(mitsuba, case, "spot", n, seeds)
    return methods


# --- error against time ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rung:
    """One method at one number of samples (or accuracy): medians over rounds.

    Attributes
    ----------
    setting : float
        Samples per pixel, or accuracy.
    seconds : list of float
        Seconds of a new pose, round by round.
    error : float
        Root mean square over pixels and rounds, relative to the reference's.
    bias : float
        Part of the error that all rounds share.
    least_bias : float
        Smallest bias that differs from noise (four sigma for its heavy tails; a denoiser's pixels share their noise).
    """

    setting: float
    seconds: list[float]
    error: float
    bias: float
    least_bias: float


def measure(processes: Processes, case: Case, *, budget: float, rounds: int) -> dict[str, list[Rung]]:
    """Render by every method at growing numbers of samples, methods in turn, once per round.

    Parameters
    ----------
    processes : Processes
    case : Case
    budget : float
        Seconds that one render may take; the numbers of samples end below that.
    rounds : int
        Renders of every rung, each with its own noise.
    """
    world = processes.surfel_world(case)
    finest = REFERENCE[case.room]
    reference = Surfel(world, finest).difference(case)
    ladders = {a: Surfel(world, a) for a in (1e-1, 1e-2, 1e-3, 1e-4) if a > finest}
    taken: dict[str, dict[float, list[tuple[float, np.ndarray]]]] = defaultdict(lambda: defaultdict(list))
    for round_index in range(rounds):
        for accuracy, transport in ladders.items():
            taken[SURFEL][accuracy].append(transport.timed(case))
            taken[BATCH][accuracy].append(transport.timed_batch(case, POSES[case.room]))
        active = samplers(processes)
        samples = 16
        while active:
            for name, sampler in list(active.items()):
                seconds, differences, _ = sampler(case, samples, [1 + round_index + 1000 * samples])
                taken[name][samples].append((seconds[0], differences[0]))
                # The first round decides where the ladder ends; otherwise rungs would lack rounds.
                if samples >= max(taken[name]) if round_index else 4.0 * seconds[0] > budget:
                    del active[name]
            samples *= 4
        print(f"  {case.name}: round {round_index + 1} of {rounds}", flush=True)
    return {
        name: [_rung(setting, shots, reference) for setting, shots in sorted(rungs.items(), key=_by_time)]
        for name, rungs in taken.items()
    }


def _by_time(rung: tuple[float, Any]) -> float:
    setting = rung[0]
    return setting if setting >= 1.0 else 1.0 / setting


def _rung(setting: float, shots: list[tuple[float, np.ndarray]], reference: np.ndarray) -> Rung:
    level = math.sqrt(float((reference**2).mean()))
    deviations = np.array([picture for _, picture in shots]) - reference
    rounds = len(shots)
    scatter = deviations.var(axis=0, ddof=1).mean() if rounds > 1 else 0.0
    shared = max(0.0, float((deviations.mean(axis=0) ** 2).mean()) - scatter / rounds)
    least = 4.0 * scatter / rounds * math.sqrt(2.0 * rounds / max(1, rounds - 1) / deviations[0].size)
    return Rung(
        setting=setting,
        seconds=[seconds for seconds, _ in shots],
        error=math.sqrt(float((deviations**2).mean())) / level,
        bias=math.sqrt(shared) / level,
        least_bias=math.sqrt(least) / level,
    )


def time_to(rungs: list[Rung], goal: float, rounds: slice = slice(None)) -> tuple[float, str]:
    """Return the seconds to reach an error, and how they are known.

    Between two rungs they are interpolated; beyond the last they follow from the law of 1/sqrt(N), unless the
    error has stopped following it.

    Returns
    -------
    seconds : float
        Infinite if the error is never reached.
    how : {"measured", "at most", "extrapolated", "not reached"}
    """
    seconds = [float(np.median(r.seconds[rounds])) for r in rungs]
    errors = [r.error for r in rungs]
    if errors[0] <= goal:
        return seconds[0], "at most"
    for i in range(1, len(rungs)):
        if errors[i] <= goal:
            share = math.log(errors[i - 1] / goal) / math.log(errors[i - 1] / errors[i])
            return seconds[i - 1] * (seconds[i] / seconds[i - 1]) ** share, "measured"
    # Four times the samples halve the noise; an error that falls by less than a quarter has a floor.
    if len(rungs) > 1 and (rungs[-1].bias > max(goal, rungs[-1].least_bias) and errors[-1] > 0.75 * errors[-2]):
        return math.inf, "not reached"
    return seconds[-1] * (errors[-1] / goal) ** 2, "extrapolated"


def print_times(case: Case, found: dict[str, list[Rung]]) -> None:
    """Print one scene's table."""
    rounds = len(_rounds(found))
    bases = {name: time_to(found[name], GOAL)[0] for name in (SURFEL, BATCH)}
    print(
        f"\n{case.name}: {case.resolution} x {case.resolution} pixels, {rounds} rounds; surfel's batches are of "
        f"{POSES[case.room]} new poses, all others render one"
    )
    columns = f"{'time to 1 %':>12}  {'known':<13} {'x surfel':>9} {'x batches':>9} {'[rounds]':>20}"
    print(f"{'method':<16} {columns}   last rung")
    for name, rungs in sorted(found.items(), key=lambda item: time_to(item[1], GOAL)[0]):
        seconds, how = time_to(rungs, GOAL)
        ratios = _ratios(found, name)
        spread = f"[{_short(min(ratios))} .. {_short(max(ratios))}]"
        last = rungs[-1]
        bias = f"{last.bias:.2%}" if last.bias > last.least_bias else f"< {last.least_bias:.2%}"
        setting = f"accuracy {last.setting:g}" if last.setting < 1.0 else f"{last.setting:g} samples"
        print(
            f"{name:<16} {_short(seconds) + ' s':>12}  {how:<13} {_short(seconds / bases[SURFEL]):>9} "
            f"{_short(seconds / bases[BATCH]):>9} {spread:>20}"
            f"   {setting}, {_short(float(np.median(last.seconds)))} s: error {last.error:.2%}, bias {bias}"
        )


def _short(value: float) -> str:
    """Return a positive number with two digits."""
    return f"{float(f'{value:.1e}'):,.0f}" if 10.0 <= value < 1e5 else f"{value:.2g}"


def speed_rows(found: dict[Case, dict[str, list[Rung]]]) -> list[list[str]]:
    """Return a row per method: its time to `GOAL` in each scene, and how many times that of surfel's batches it is.

    Extrapolated times have an asterisk; in brackets the least and the largest ratio of the rounds.
    """
    rows = []
    for name in dict.fromkeys(name for methods in found.values() for name in methods):
        cells = dict.fromkeys(RESULTS["speed"][1:], "")
        for case, methods in found.items():
            if name in methods:
                seconds, how = time_to(methods[name], GOAL)
                star = "*" if how == "extrapolated" else ""
                unit = f"{_short(1e3 * seconds)} ms" if seconds < 1.0 else f"{_short(seconds)} s"
                cells[case.name] = f"{unit}{star}"
                if name != BATCH:
                    ratios = _ratios(methods, name)
                    factor = seconds / time_to(methods[BATCH], GOAL)[0]
                    spread = f"{_short(min(ratios))} to {_short(max(ratios))}"
                    cells[case.name] += f", {_short(factor)} x ({spread})"
        rows.append([name, *cells.values()])
    return rows


def _ratios(found: dict[str, list[Rung]], name: str) -> list[float]:
    """Return how many times as long as surfel's batches a method took, round by round."""
    times = ([time_to(found[n], GOAL, slice(i, i + 1))[0] for n in (name, BATCH)] for i in _rounds(found))
    return [seconds / base for seconds, base in times]


def _rounds(found: dict[str, list[Rung]]) -> range:
    return range(len(found[SURFEL][0].seconds))


def rung_rows(found: dict[Case, dict[str, list[Rung]]]) -> list[tuple[str, ...]]:
    """Return a row for each rung, and one for the time to `GOAL` where that is extrapolated."""
    table = []
    for case, methods in found.items():
        for name, rungs in methods.items():
            for r in rungs:
                seconds = (float(np.median(r.seconds)), min(r.seconds), max(r.seconds))
                table.append((case.name, name, f"{r.setting:g}", *(f"{s:.3g}" for s in seconds), f"{r.error:.3g}"))
            seconds_to, how = time_to(rungs, GOAL)
            if how == "extrapolated":
                table.append((case.name, name, how, *[f"{seconds_to:.3g}"] * 3, f"{GOAL:g}"))
    return table


def times(processes: Processes, folder: Path, *, quick: bool) -> dict[str, Any]:
    """Measure, print, write and plot error against time."""
    pairs = [("sphere", False)] if quick else [("sphere", False), ("sheet", False), ("sphere", True)]
    measured = {}
    for target, room in pairs:
        case = Case(target, 1.0, room)
        measured[case] = measure(processes, case, budget=1.5 if quick else 12.0, rounds=2 if quick else 5)
        print_times(case, measured[case])
    file = results.write(folder, "error-by-time", RESULTS["error-by-time"], rung_rows(measured))
    pictures.save("error-by-time", file, folder)
    results.write(folder, "speed", RESULTS["speed"], speed_rows(measured))
    print(f"\nplot: {folder / 'error-by-time.png'}")
    return {case.name: methods for case, methods in measured.items()}


# --- agreement ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Mean:
    """A picture's mean and half the width of its 95 % interval, which is 0 for a picture without noise."""

    value: float
    half: float = 0.0

    def over(self, other: Mean) -> Mean:
        """Return the ratio to another mean, minus one."""
        half = math.hypot(self.half / other.value, self.value * other.half / other.value**2)
        return Mean(self.value / other.value - 1.0, half)

    def __str__(self) -> str:
        return f"{100.0 * self.value:+.3f} % ± {100.0 * self.half:.3f} %"


def mean_of(pictures: list[np.ndarray]) -> Mean:
    """Return the mean over pictures with independent noise, with its interval."""
    means = [float(p.mean()) for p in pictures]
    half = student.ppf(0.975, len(means) - 1) * np.std(means, ddof=1) / math.sqrt(len(means))
    return Mean(float(np.mean(means)), float(half))


def converge(sampler: Sampler, case: Case, samples: int, budget: float) -> tuple[Mean, Mean]:
    """Render until the budget is spent; return the means of difference and background."""
    differences: list[np.ndarray] = []
    backgrounds: list[np.ndarray] = []
    spent = 0.0
    while len(differences) < 8 or spent < budget:
        seeds = [1 + len(differences) + i for i in range(4)]
        seconds, more, empty = sampler(case, samples, seeds)
        spent += sum(seconds)
        differences += more
        backgrounds += empty
    return mean_of(differences), mean_of(backgrounds)


def agreement(
    processes: Processes,
    folder: Path,
    *,
    targets: tuple[str, ...] = ("sphere", "sheet", "box", "sphere+sheet"),
    gaps: tuple[float, ...] = (1.0, 0.3, 0.05),
    rooms: tuple[bool, ...] = (False, True),
    budget: float = 25.0,
) -> list[dict[str, Any]]:
    """Print and write how well the engines' absolute means agree, and return the figures.

    Parameters
    ----------
    processes : Processes
    folder : Path
        Of the table.
    targets, gaps, rooms : tuple
        Every combination is rendered.
    budget : float
        Seconds per combination and Monte Carlo method.
    """
    print("\nmean of the target's light (with it minus without it): ratio - 1, with 95 % interval")
    _print_row((*RESULTS["agreement"], "patch / Mitsuba - 1"))
    rows, table = [], []
    for case in _cases(targets, gaps, rooms):
        if case.gap == gaps[0]:
            transport = _surfel(processes, case)
        row = _agree(processes, case, transport, budget)
        rows.append(row)
        table.append(_cells(case.name, row["difference"], row["hidden"]))
        _print_row(table[-1])
        if case.room and case == next(c for c in _cases(targets, gaps, (True,))):
            table.append(_cells("the room's own light", row["background"], None))
            _print_row(table[-1])
    results.write(folder, "agreement", RESULTS["agreement"], [cells[:-1] for cells in table])
    return rows


def _cases(targets: tuple[str, ...], gaps: tuple[float, ...], rooms: tuple[bool, ...]) -> Iterator[Case]:
    return (Case(t, g, room, resolution=32) for room in rooms for t in targets for g in gaps)


def _surfel(processes: Processes, case: Case) -> Surfel | None:
    try:
        return Surfel(processes.surfel_world(case), 3e-4)
    except (ImportError, NlosError) as error:
        print(f"surfel left out: {error}", flush=True)
        return None


def _agree(processes: Processes, case: Case, transport: Surfel | None, budget: float) -> dict[str, Any]:
    methods = samplers(processes)
    difference: dict[str, Mean] = {}
    background: dict[str, Mean] = {}
    for name, samples in ((PATCH, 1024), (MITSUBA_SPOT, 8192)):
        if name in methods:
            difference[name], background[name] = converge(methods[name], case, samples, budget)
    if transport:
        difference[SURFEL] = Mean(float(transport.difference(case).mean()))
        background[SURFEL] = Mean(float(transport.background.mean()))
    hidden = transport.hidden_share(case) if transport else None
    return {"case": case.name, "difference": difference, "background": background, "hidden": hidden}


def _cells(name: str, means: dict[str, Mean], hidden: float | None) -> list[str]:
    """Return a row of the table, and at its end the ratio of the two Monte Carlo methods."""

    def ratio(a: str, b: str) -> str:
        return str(means[a].over(means[b])) if a in means and b in means else ""

    value = f"{means[SURFEL].value:.4e}" if SURFEL in means else ""
    share = "" if hidden is None else f"{100.0 * hidden:.2f} %"
    ratios = [ratio(PATCH, SURFEL), ratio(MITSUBA_SPOT, SURFEL), ratio(PATCH, MITSUBA_SPOT)]
    return [name, value, share, *ratios]


def _print_row(cells: Sequence[str]) -> None:
    name, value, share, *ratios = cells
    print(f"{name:<26} {value:>13} {share:>8}  " + "  ".join(f"{c:>21}" for c in ratios), flush=True)


def main() -> None:
    """Run the selected benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the plot and the figures")
    parser.add_argument("--quick", action="store_true", help="minutes instead of an hour: fewer scenes and renders")
    parser.add_argument("--room", action="store_true", help="agreement: in the room only")
    parser.add_argument("--only", choices=["agreement", "time"], help="one of the parts")
    parser.add_argument(
        "--target",
        action="append",
        help="agreement: sphere, sheet, box or sphere+sheet; may be given again (default all)",
    )
    parser.add_argument(
        "--gap", action="append", type=float, help="agreement: metres from the wall; may be given again (default all)"
    )
    parser.add_argument(
        "--seconds", type=float, default=25.0, help="agreement: for every scene and Monte Carlo method (default 25)"
    )
    options = parser.parse_args()
    if not COMPILED:
        parser.error("numba is missing, without which surfel runs as plain Python: pip install numba")
    options.output.mkdir(parents=True, exist_ok=True)
    found: dict[str, Any] = {}
    with Processes() as processes:
        if options.only != "agreement":
            found["time"] = times(processes, options.output, quick=options.quick)
        if options.only != "time":
            selection: dict[str, Any] = {"targets": ("sphere", "box"), "gaps": (1.0, 0.05)} if options.quick else {}
            if options.target:
                selection["targets"] = tuple(options.target)
            if options.gap:
                selection["gaps"] = tuple(options.gap)
            if options.room:
                selection["rooms"] = (True,)
            found["agreement"] = agreement(processes, options.output, budget=options.seconds, **selection)
    text = json.dumps(found, indent=1, default=vars)
    (options.output / "figures.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
