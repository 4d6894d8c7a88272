"""Time what users wait for in this tree and in that of another revision, in turn.

Run: ``python benchmarks/speed_table.py -o DIR [--against TREE] [--rounds N] [--only WORD ...]``, some minutes on one
core. TREE is a checkout of this repository, e.g. by ``git worktree add TREE REVISION``. Each row is a process of its
own in either tree, one after the other, as often as rounds are asked for; printed is the median. Times are the
processor's, of one core, but the whole command's: seconds of the clock, on all cores. A row that a tree has not, or
refuses, is empty.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import pickle
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import results
from reflections import poses, world_of

from generator.model.presets import preset
from generator.model.quantities import ALL_ORDERS
from generator.transport import Mesh, World

RESULTS = {"speed-table": ("what", "there", "here", "there / here")}
_HERE = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Row:
    """What is timed: poses (n, 2, 3) in a world, of an accuracy, and how (`timed.seconds`)."""

    name: str
    world: World
    poses: list[Any]
    way: str = "alone"
    accuracy: float = 1e-2
    numba: bool = True

    @property
    def job(self) -> bytes:
        """What `timed` reads."""
        parts = {"ambient": self.world.ambient, "wall": self.world.wall if self.world.is_followed_on else None}
        more = {name: _told(part) for name, part in parts.items() if part is not None}
        world = {
            "patch": _told(self.world.patch)[1],
            "watched": _told(self.world.watched)[1],
            "target": [_told(body) for body in self.world.target],
            "room": [_told(body) for body in self.world.room],
            "order": self.world.order,
            "more": more,
        }
        job = {"world": world, "poses": self.poses, "way": self.way, "accuracy": self.accuracy, "numba": self.numba}
        return pickle.dumps(job)


def _told(part: Any) -> tuple[str, dict[str, Any]]:
    """Return the name of a dataclass and those of its fields that are set."""
    return type(part).__name__, {
        f.name: getattr(part, f.name) for f in fields(part) if getattr(part, f.name) is not None
    }


def _ring(radius: float, thick: float, turns: int, around: int) -> Mesh:
    """Return a torus of 2 turns around triangles: closed, and hiding parts of itself."""
    big, small = np.meshgrid(*(2.0 * math.pi * np.arange(n) / n for n in (turns, around)), indexing="ij")
    out = radius + thick * np.cos(small)
    p = np.stack([out * np.cos(big), thick * np.sin(small), out * np.sin(big)], axis=2)
    along, across = np.roll(p, -1, axis=0), np.roll(p, -1, axis=1)
    both = np.roll(along, -1, axis=1)
    triangles = np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((p, along, both), (p, both, across))])
    return Mesh(triangles, np.full((len(triangles), 3), 0.9))


def rows() -> Iterator[Row]:
    """Yield what the engine alone is timed at."""
    sphere, sheet = (replace(preset("room", kind), resolution=(64, 64)) for kind in ("sphere", "sheet"))
    room, bare = world_of(sphere), world_of(replace(sphere, room=None, partition=None))
    some = [(tuple(map(float, place)), (0.0, 0.0, 30.0)) for place in poses(sphere, 5, 64)[0]]
    turned = [tuple(map(tuple, pose)) for pose in zip(*(one.tolist() for one in poses(sheet, 5, 21)), strict=True)]
    # A tenth is asked for: errors are below 1 % then (cost-and-accuracy).
    yield Row("a pose in the room, in batches, ms", room, some, "batch", accuracy=0.1)
    yield Row("a pose alone, in the room, ms", room, some[:21], accuracy=0.1)
    yield Row("a pose alone, before the bare wall, ms", bare, some[:21], accuracy=0.1)
    yield Row("a sheet under a sky, three reflections, ms", world_of(sheet.with_ambient(0.0008)), turned)
    lit = replace(world_of(sheet), order=ALL_ORDERS)
    yield Row("a sheet, all reflections, in the room, ms", lit, turned)
    ring = replace(room, target=(_ring(0.15, 0.05, 25, 20),))
    yield Row("a mesh of 1,000 triangles in the room, ms", ring, some[:4])
    yield Row("a mesh of 1,000 triangles, a tenth asked for, ms", ring, some[:6], accuracy=0.1)
    yield Row("first picture in the room, nothing compiled, s", room, some[:1], "first")
    yield Row("first picture of all reflections, nothing compiled, s", lit, turned[:1], "first")
    places = ((1.55, 1.15, 1.3), (1.2, 1.6, 1.0), (1.9, 1.5, 1.3), (0.93, 1.99, 0.79))
    still, plain = [(place, (0.0, 0.0, 0.0)) for place in places], world_of(sheet)
    yield Row("a sheet in the room without numba, median, s", plain, still, numba=False)
    yield Row("the same without numba, the longest of four, s", plain, still, "longest", numba=False)
    yield Row("a draft of it without numba, the longest of four, s", plain, still, "draft", numba=False)


def timed(row: Row, tree: Path, cache: Path) -> float | None:
    """Return the seconds of a row in a tree."""
    with tempfile.TemporaryDirectory() as folder:
        job = Path(folder, "job")
        job.write_bytes(row.job)
        if row.way == "first":  # older revisions keep what is compiled beside their sources
            copy = Path(folder, "tree")
            shutil.copytree(tree / "generator", copy / "generator", ignore=shutil.ignore_patterns("__pycache__"))
            tree = cache = copy
        environment = {
            **os.environ,
            "PYTHONPATH": str(tree),
            "NUMBA_CACHE_DIR": str(cache),
            "OPENBLAS_NUM_THREADS": "1",
        }
        command = [sys.executable, str(_HERE / "benchmarks" / "timed.py"), str(job)]
        done = subprocess.run(command, env=environment, cwd=folder, check=True, capture_output=True, text=True)
    print(done.stderr, end="", file=sys.stderr)
    found = json.loads(done.stdout.splitlines()[-1])
    return None if found is None else float(found)


def command_time(tree: Path, cache: Path) -> float | None:
    """Return the seconds of the clock in which 900 poses become files, by one command."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(cache)}

    def run(*words: str) -> float:
        start = time.perf_counter()
        command = [sys.executable, "-m", "generator.cli", *words]
        subprocess.run(command, env=environment, cwd=folder, check=True, capture_output=True)
        return time.perf_counter() - start

    with tempfile.TemporaryDirectory() as folder:
        run("scene", "room", "--target", "sphere", "-o", "scene.blend")
        options = ["--engine", "surfel", "--poses", "100", "--resolution", "64"]
        help_text = subprocess.run(
            [sys.executable, "-m", "generator.cli", "sweep", "--help"],
            env=environment,
            cwd=folder,
            capture_output=True,
        ).stdout
        if b"--no-probe" in help_text:
            options.append("--no-probe")
        return run("sweep", "scene.blend", "-o", "set", *options)


def main() -> None:
    """Time, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the table")
    parser.add_argument("--against", type=Path, metavar="TREE", help="a checkout of another revision")
    parser.add_argument("--rounds", type=int, default=3, help="times that each row is timed in each tree")
    parser.add_argument("--only", nargs="+", metavar="WORD", help="rows whose names have one of these words")
    options = parser.parse_args()
    trees = [*([] if options.against is None else [options.against.resolve()]), _HERE]
    ways: dict[str, tuple[float, range, Callable[[Path, Path], float | None]]] = {}
    # The first round fills the cache and does not count, but where nothing is to be compiled.
    warmed, once = range(-1, options.rounds), range(1)
    for row in rows():
        unit, rounds = 1e3 if row.name.endswith("ms") else 1.0, once if row.way == "first" else warmed
        ways[row.name] = unit, rounds, lambda tree, cache, row=row: timed(row, tree, cache)
    ways["900 poses to EXR, the whole command, all cores, s"] = 1.0, warmed, command_time
    table = []
    with tempfile.TemporaryDirectory() as caches:
        for name, (unit, rounds, way) in ways.items():
            if options.only and not set(options.only) & set(name.replace(",", "").split()):
                continue
            found: dict[Path, list[float]] = {tree: [] for tree in trees}
            for number in rounds:
                for tree in trees:
                    taken = way(tree, Path(caches, str(trees.index(tree))))
                    if taken is not None and number >= 0:
                        found[tree].append(unit * taken)
            medians = {tree: statistics.median(every) if every else None for tree, every in found.items()}
            there, here = medians.get(trees[0]) if options.against else None, medians[_HERE]
            ratio = "" if not there or not here else f"{there / here:.2g}"
            table.append((name, *("" if one is None else f"{one:.3g}" for one in (there, here)), ratio))
            print(" | ".join(table[-1]), flush=True)
            results.write(options.output, "speed-table", RESULTS["speed-table"], table)


if __name__ == "__main__":
    main()
