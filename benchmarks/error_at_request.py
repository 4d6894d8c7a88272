"""Error at request: errors that the surfel engine achieves at requested accuracies, against our own quadrature.

Run: ``python benchmarks/error_at_request.py -o DIR [--poses 1000] [--room 100]`` (some 25 minutes
on one core). Prints a table, writes ``error-at-request.csv``, ``.png`` and ``.json`` and ``errors-by-pose.csv``, and
exits with 1 if a single pose errs by more than requested, or if the reference could not be shown to be five times
better than that.

Poses before the bare wall are hard ones: near the wall, touching it, edge-on to the lit or the watched patch, and
edge-on *and* near. In the room, where the light that a target hides counts too, they are inside the preset's grid.
`quadrature.py` explains how the references are made. They are compared with references twice as fine (in the room by
a third), on some poses of each kind and on every pose whose error is above half of the request.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pictures
import quadrature
import results
import scenes
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.model.arrays import rotation_matrix
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.scene import Target
from generator.transport import Transport
from generator.transport.world import Mesh, Sphere, World

Array = NDArray[Any]

ACCURACIES = (1e-2, 1e-3, 1e-4)
KINDS = {
    "free": 0.2,
    "near": 0.2,
    "contact": 0.15,
    "edge-on to the light": 0.15,
    "edge-on to the picture": 0.15,
    "edge-on and near": 0.15,
}
"""Share of each kind of pose before the bare wall."""
RESULTS = {
    "error-at-request": ("kind", "requested", "poses", "median", "99 %", "worst"),
    "errors-by-pose": ("kind", "requested", "error"),
}
FAINT = 1e-12
"""Pictures below this, relative to the target's brightest, are rounding, as for a sheet whose lit side is unseen."""
TRUST = 5.0
PATIENCE = 90
"""Seconds after which a picture (usually of milliseconds; the first one compiles) counts as failed."""


@dataclass
class Case:
    """One pose and the errors at it.

    Attributes
    ----------
    kind, target : str
    position, rotation : list of float
        Metres, degrees.
    errors : dict of float to float
        Achieved error, by requested accuracy.
    checked : float or None
        Error of the reference relative to one twice as fine.
    """

    kind: str
    target: str
    position: list[float]
    rotation: list[float]
    errors: dict[float, float] = field(default_factory=dict)
    checked: float | None = None

    @property
    def worst(self) -> float:
        """Largest ratio of the error to the requested accuracy."""
        return max((e / a for a, e in self.errors.items()), default=0.0)

    def __str__(self) -> str:
        errors = ", ".join(f"{a:g}: {e:.3g}" for a, e in self.errors.items())
        known = "not checked" if self.checked is None else f"reference good to {self.checked:.1e}"
        return f"{self.kind}, {self.target}, {self.position}, {self.rotation}: {errors} ({known})"


def cube(size: float, albedo: float = 0.9) -> Mesh:
    """Return a closed cube of 12 triangles."""
    h = size / 2.0
    box = scenes.box(size, albedo)
    lid = np.array([[-h, -h, -h], [h, -h, -h], [h, -h, h], [-h, -h, h]])[[[0, 1, 2], [0, 2, 3]]]
    return Mesh(np.concatenate([box.triangles, lid]), np.concatenate([box.albedo, box.albedo[:2]]))


def targets() -> dict[str, Sphere | Mesh]:
    """Return the targets that stand before the bare wall, by name."""
    flat = scenes.bodies(Target(kind="sheet", size=0.5, albedo=0.9))[0]
    balls = {f"sphere {d:g}": Sphere(np.zeros(3), d / 2.0, np.ones(3)) for d in (0.2, 0.35, 0.5)}
    return {"sheet": flat, **balls, "cube": cube(0.35)}


def bare(target: Sphere | Mesh, pixels: int = 32) -> World:
    """Return the room preset's wall without the room."""
    scene = replace(preset("room"), room=None, partition=None, resolution=(pixels, pixels))
    return scenes.world_from_spec(scene, (target,))


class Poses:
    """Draws poses before the bare wall.

    Parameters
    ----------
    world : World
        World whose lit and watched patches the poses refer to.
    rng : Generator
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self._patch, self._view, self._rng = world.patch, world.watched, rng

    def draw(self, kind: str, body: Sphere | Mesh) -> tuple[Array, Array]:
        """Return a position and a rotation, which the engine may refuse."""
        rng = self._rng
        if kind.startswith("edge-on"):
            return self._edge_on(body, kind)
        rotation = rng.uniform(-180.0, 180.0, 3)
        if kind == "free":
            return rng.uniform((0.3, 0.0, 0.2), (2.5, 3.0, 2.4)), rotation
        if kind == "contact" and rng.random() < 0.5:
            # It stands on an edge or lies on a face, as furniture does and a random rotation never does.
            rotation = rng.choice([0.0, 45.0, 90.0, 180.0, -90.0], 3)
            rotation[rng.integers(3)] = rng.uniform(-180.0, 180.0)
        height = 10.0 ** rng.uniform(-4.0, math.log10(0.3)) if kind == "near" else rng.choice([0.0, 1e-9])
        points = self._points(body, rotation)
        lowest = points[np.argmin(points[:, 1])]
        # Half of the poses are close to a rim, half anywhere.
        if rng.random() < 0.5:
            turn, away = rng.uniform(0.0, 2.0 * math.pi), 10.0 ** rng.uniform(-3.0, -0.3)
            foot = self._rim() + away * np.array([math.cos(turn), 0.0, math.sin(turn)])
        else:
            foot = rng.uniform((-1.3, 0.0, 0.3), (1.3, 0.0, 2.3))
        return foot + np.array([0.0, height, 0.0]) - lowest, rotation

    def _edge_on(self, body: Sphere | Mesh, kind: str) -> tuple[Array, Array]:
        rng = self._rng
        is_light = "light" in kind or ("near" in kind and rng.random() < 0.5)
        through = self._lit() if is_light else self._view.points(rng.random(2))
        centre = rng.uniform((0.2, 0.05, 0.2), (2.5, 3.0, 2.4))
        along = (centre - through) / np.linalg.norm(centre - through)
        normal = np.cross(along, rng.normal(size=3))
        normal /= np.linalg.norm(normal)
        tilt = rng.choice([0.0, rng.uniform(0.0, 2.0), 10.0 ** rng.uniform(-4.0, 0.0)])
        normal = Rotation.from_rotvec(math.radians(tilt) * along * rng.choice([-1.0, 1.0])).apply(normal)
        first = np.cross(normal, rng.normal(size=3))
        first /= np.linalg.norm(first)
        turn = np.stack([first, normal, np.cross(first, normal)], axis=1)
        rotation = Rotation.from_matrix(turn).as_euler("xyz", degrees=True)
        depth = body.triangles[..., 1].max() if isinstance(body, Mesh) else 0.0
        position = centre - depth * normal
        if "near" in kind:
            # Moved down within its own plane, so that it stays edge-on, until it almost touches the wall.
            height = rng.choice([0.0, 10.0 ** rng.uniform(-4.0, -1.0), 10.0 ** rng.uniform(-4.0, -1.0)])
            up = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
            lowest = (self._points(body, rotation) + position)[:, 1].min()
            position = position + (height - lowest) / up[1] * up
        return position, rotation

    def _lit(self) -> Array:
        a, b = self._rng.uniform(-1.0, 1.0, 2)
        return self._patch.centre + 0.7 * (a * self._patch.major + b * self._patch.minor)

    def _rim(self) -> Array:
        if self._rng.random() < 0.5:
            turn = self._rng.uniform(0.0, 2.0 * math.pi)
            return self._patch.centre + math.cos(turn) * self._patch.major + math.sin(turn) * self._patch.minor
        uv = self._rng.random(2)
        uv[self._rng.integers(2)] = self._rng.integers(2)
        return self._view.points(uv)

    @staticmethod
    def _points(body: Sphere | Mesh, rotation: Array) -> Array:
        """Return corners about the target's origin, or a sphere's lowest point."""
        if isinstance(body, Sphere):
            return np.array([[0.0, -body.radius, 0.0]])
        return body.triangles.reshape(-1, 3) @ rotation_matrix(tuple(rotation)).T


def off(got: Array, expected: Array, scale: float = 0.0) -> float:
    """Return the root mean square of the difference, relative to that of the expected picture or to a scale."""
    if not np.isfinite(got).all():
        return math.inf
    size = max(math.sqrt(float((expected**2).mean())), scale)
    return math.sqrt(float(((got - expected) ** 2).mean())) / size if size else float(np.abs(got).max() > 0.0)


def _added(engine: Transport, position: Array, rotation: Array) -> Array:
    """Return the light that the target adds; not-a-number where the engine takes longer than `PATIENCE`."""

    def stop(*_: object) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(PATIENCE)
    try:
        picture: Array = engine.render(position, rotation).added[..., 0]
    except TimeoutError:
        return np.full((1, 1), np.nan)
    finally:
        signal.alarm(0)
    return picture


def bare_wall(poses: int, rng: np.random.Generator) -> Iterator[Case]:
    """Judge poses before the bare wall."""
    if not poses:
        return
    bodies = targets()
    worlds = {name: bare(body) for name, body in bodies.items()}
    engines = {name: {a: Transport(world, accuracy=a) for a in ACCURACIES} for name, world in worlds.items()}
    draw = Poses(worlds["sheet"], rng)
    brightest: dict[str, float] = defaultdict(float)
    refused: Counter[str] = Counter()
    fine = quadrature.Fineness()
    count: Counter[str] = Counter()
    for number in range(poses):
        kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
        while True:
            flat = "sheet" if rng.random() < 0.5 else f"sphere {rng.choice([0.2, 0.35, 0.5]):g}"
            name = "cube" if rng.random() < 1.0 / 3.0 else "sheet" if kind.startswith("edge-on") else flat
            position, rotation = draw.draw(kind, bodies[name])
            try:
                pictures = {a: _added(engine, position, rotation) for a, engine in engines[name].items()}
                break
            except NlosError:
                refused[kind] += 1
        case = Case(kind, name, position.tolist(), rotation.tolist())
        expected = quadrature.added(worlds[name], position, rotation, fine)
        size = math.sqrt(float((expected**2).mean()))
        brightest[name] = max(brightest[name], size)
        case.errors = {a: off(got, expected, FAINT * brightest[name]) for a, got in pictures.items()}
        count[kind] += 1
        if count[kind] % 10 == 1 or case.worst > 0.5:
            for finer in (fine.doubled, fine.doubled.doubled):
                coarser, expected = expected, quadrature.added(worlds[name], position, rotation, finer)
                case.checked = off(coarser, expected, FAINT * brightest[name])
                if not untrusted(case):
                    break
            case.errors = {a: off(got, expected, FAINT * brightest[name]) for a, got in pictures.items()}
        yield case
        if (number + 1) % 50 == 0:
            print(f"  {number + 1} of {poses} poses", flush=True)
    print("poses: " + ", ".join(f"{kind} {100 * count[kind] / max(poses, 1):.0f} %" for kind in KINDS))
    print("refused by the engine and drawn again: " + ", ".join(f"{k} {n}" for k, n in refused.items()), flush=True)


def in_room(poses: int, accuracies: tuple[float, ...], rng: np.random.Generator) -> Iterator[Case]:
    """Judge poses in the preset room: the light that the target adds minus the light that it hides."""
    scene = {kind: replace(preset("room", kind), resolution=(8, 8)) for kind in ("sheet", "sphere")}
    worlds = {kind: scenes.world_from_spec(s) for kind, s in scene.items()}
    engines = {kind: {a: Transport(world, accuracy=a) for a in accuracies} for kind, world in worlds.items()}
    fine = quadrature.Fineness()
    count: Counter[str] = Counter()
    for number in range(poses):
        name = ("sheet", "sphere")[number % 2]
        body, (low, high) = worlds[name].target[0], np.array([scene[name].grid.lo, scene[name].grid.hi])
        while True:
            rotation = rng.uniform(-15.0, 15.0, 3)
            edge_on = name == "sheet" and number % 8 == 0
            turn = rotation_matrix(tuple(rotation))
            points = body.triangles.reshape(-1, 3) @ turn.T if isinstance(body, Mesh) else body.radius * np.eye(3)
            reach = np.abs(points).max(axis=0)
            position = rng.uniform(low + reach, high - reach)
            if edge_on:
                # Turned about z until the middle of the watched patch lies in the sheet's plane.
                ray = worlds[name].watched.points(np.array([0.5, 0.5])) - position
                normal = rotation_matrix((rotation[0], rotation[1], 0.0))[:, 1]
                level, across = ray[0] * normal[0] + ray[1] * normal[1], ray[1] * normal[0] - ray[0] * normal[1]
                height = math.acos(np.clip(-normal[2] * ray[2] / math.hypot(level, across), -1.0, 1.0))
                rotation[2] = math.degrees(math.atan2(across, level) + height)
            try:
                pictures = {a: engine.render(position, rotation) for a, engine in engines[name].items()}
                break
            except NlosError:
                continue
        kind = f"room, {name}{', edge-on' if edge_on else ''}"
        case = Case(kind, name, position.tolist(), rotation.tolist())
        world = worlds[name]
        added = quadrature.added(world, position, rotation, fine)
        hidden = quadrature.hidden(world, position, rotation, fine)
        scale = math.sqrt(max(float((added**2).mean()), float((hidden**2).mean())))
        changes = {a: (picture.added - picture.hidden)[..., 0] for a, picture in pictures.items()}
        case.errors = {a: off(change, added - hidden, scale) for a, change in changes.items()}
        count[kind] += 1
        if count[kind] % 10 == 1 or case.worst > 0.5:
            finer = added - quadrature.hidden(world, position, rotation, fine.finer)
            case.checked = off(added - hidden, finer, scale)
            case.errors = {a: off(change, finer, scale) for a, change in changes.items()}
        yield case
        if (number + 1) % 10 == 0:
            print(f"  {number + 1} of {poses} poses in the room", flush=True)


def untrusted(case: Case) -> list[float]:
    """Return the accuracies at which a pose cannot be judged: its reference is less than five times better."""
    return [a for a in case.errors if case.checked is not None and case.checked * TRUST > a]


def table(cases: list[Case]) -> list[tuple[str, ...]]:
    """Return a table of error over request, a row per kind and accuracy."""
    rows = []
    kinds = list(dict.fromkeys(case.kind for case in cases))
    for kind in [*kinds, "all"]:
        for asked in ACCURACIES:
            shares = [
                c.errors[asked] / asked
                for c in cases
                if (kind in ("all", c.kind)) and asked in c.errors and asked not in untrusted(c)
            ]
            if shares:
                middle, high = np.quantile(shares, [0.5, 0.99])
                ratios = (f"{x:.3f}" for x in (middle, high, max(shares)))
                rows.append((kind, f"{asked:.0e}".replace("e-0", "e-"), str(len(shares)), *ratios))
    return rows


def checks(cases: list[Case]) -> str:
    """Return a table of the references' errors, a line per kind."""
    lines = ["reference against itself, twice as fine (in the room a third):"]
    for kind in dict.fromkeys(case.kind for case in cases):
        known = [c.checked for c in cases if c.kind == kind and c.checked is not None]
        if known:
            lines.append(f"{kind:<26}{len(known):>4} poses, median {np.median(known):.1e}, worst {max(known):.1e}")
    return "\n".join(lines)


def points(cases: list[Case]) -> list[tuple[str, str, str]]:
    """Return a row for each error that can be judged."""
    judged = ((c.kind, a, e) for c in cases for a, e in c.errors.items() if a not in untrusted(c) and e < 1e9)
    return [(kind, f"{asked:g}", f"{error:.3g}") for kind, asked, error in judged]


def main(argv: list[str] | None = None) -> int:
    """Judge the engine."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for plot and poses")
    parser.add_argument("--poses", type=int, default=1000, help="before the bare wall")
    parser.add_argument("--room", type=int, default=100, help="in the room, with shadows")
    parser.add_argument("--finest-room", action="store_true", help="ask for 1e-4 in the room as well")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    options.out.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    room_accuracies = ACCURACIES if options.finest_room else ACCURACIES[:2]
    cases = []
    for judged in (
        bare_wall(options.poses, np.random.default_rng([options.seed, 0])),
        in_room(options.room, room_accuracies, np.random.default_rng([options.seed, 1])),
    ):
        for case in judged:
            cases.append(case)
            if case.worst > 1.0:
                print(f"  above what was asked: {case}", flush=True)
    if not cases:
        parser.error("no poses were asked for")
    cases.sort(key=lambda case: case.kind)
    rows = table(cases)
    results.write(options.out, "error-at-request", RESULTS["error-at-request"], rows)
    print("\nachieved / requested")
    for kind, *cells in (RESULTS["error-at-request"], *rows):
        print(f"{kind:<26}" + "".join(f"{cell:>10}" for cell in cells))
    print(f"\n{checks(cases)}\n")
    file = results.write(options.out, "errors-by-pose", RESULTS["errors-by-pose"], points(cases))
    pictures.save("error-at-request", file, options.out)
    cases.sort(key=lambda case: -case.worst)
    (options.out / "error-at-request.json").write_text(json.dumps([asdict(c) for c in cases], indent=1))
    failed = [c for c in cases if any(e > a and a not in untrusted(c) for a, e in c.errors.items())]
    doubtful = [c for c in cases if untrusted(c)]
    for title, group in (("errs by more than was asked", failed), ("cannot be judged", doubtful)):
        print(f"{title}: {len(group)} of {len(cases)} poses")
        for case in group[:20]:
            print(f"  {case}")
    print(f"{time.perf_counter() - start:.0f} s")
    return 1 if failed or doubtful else 0


if __name__ == "__main__":
    sys.exit(main())
