"""How the surfel engine's cost grows with the work, and how near its inner loop comes to the processor's limit.

Run: ``python benchmarks/scaling.py -o DIR`` (some minutes). Writes ``scaling.png`` and ``scaling.csv``, and prints:

- pair rate: pairs of wall point and surface element per second, in the loop that sums all pictures, against the
  single-precision divisions per second that the same cores can do: a pair needs one division, so no loop could be
  faster than that unless pairs share divisions;
- cost of a picture from 16 x 16 to 1024 x 1024 pixels, of targets of 10 to 100,000 triangles, and of 1 to 100,000
  poses (a million with ``--long``), with the peak memory of each.

All on the bare wall of the `room` preset; every time is the best of three runs.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pictures
import results

from generator.blender.engines import survey
from generator.blender.scene import blend_file, build
from generator.model.presets import preset
from generator.transport import Mesh, Transport, World, kernel

POSE = ((1.4, 0.9, 1.3), (0.0, 0.0, 20.0))

RESULTS = {"scaling": ("of", "number", "seconds", "peak memory so far, MiB")}


@numba.njit(error_model="numpy", parallel=True)
def _divisions(x: np.ndarray, y: np.ndarray, rounds: int, out: np.ndarray) -> None:
    for thread in numba.prange(out.shape[0]):
        a, b = x.copy(), y.copy()
        for _ in range(rounds):
            for i in range(a.shape[0]):
                a[i] = b[i] / a[i]
        out[thread] = a


@numba.njit(parallel=True)
def _pairs(a: np.ndarray, b: np.ndarray, elements: np.ndarray, total: np.ndarray) -> None:
    for tile in numba.prange(a.shape[0]):
        kernel.radiance(a[tile], b[tile], elements, elements.shape[1], 0.0, total[tile])


def best(work: Callable[[], object], times: int = 3) -> float:
    """Return the seconds of the shortest of some runs, after a warm-up run."""
    work()
    taken = []
    for _ in range(times):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return min(taken)


def pair_rate() -> tuple[float, float]:
    """Return pairs per second of the inner loop, and divisions per second, on all cores, measured in turn."""
    rng = np.random.default_rng(0)
    cores = numba.get_num_threads()
    x, y = rng.uniform(0.5, 1.0, (2, 512)).astype(np.float32)
    out = np.empty((cores, 512), dtype=np.float32)
    rounds = 100_000
    a, b = rng.uniform(-1.0, 1.0, (2, 16 * cores, 1024)).astype(np.float32)
    elements = rng.uniform(0.5, 1.0, (6, 2048)).astype(np.float32)
    total = np.zeros_like(a)
    pairs, divisions = [], []
    for _ in range(15):
        divisions.append(cores * 512 * rounds / best(lambda: _divisions(x, y, rounds, out), 1))
        pairs.append(a.size * elements.shape[1] / best(lambda: _pairs(a, b, elements, total), 1))
    return max(pairs), max(divisions)


def bare_world(pixels: int) -> World:
    """Return the room preset's wall and lamp without the room."""
    scene = blend_file.new_file()
    build.build(scene, preset("room", "sheet"))
    return replace(survey.surfel_world(scene, resolution=(pixels, pixels)), room=())


def ball(triangles: int) -> Mesh:
    """Return a sphere of radius 0.2 m made of about the given number of triangles, in rings."""
    rings = max(2, round(np.sqrt(triangles / 4.0)))
    theta, phi = np.linspace(0.0, np.pi, rings + 1), np.linspace(0.0, 2.0 * np.pi, 2 * rings + 1)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    points = 0.2 * np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    facets = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)
    area = np.linalg.norm(np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0]), axis=1)
    facets = facets[area > 1e-9]
    return Mesh(facets, np.full((len(facets), 3), 0.9))


def _memory() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main() -> None:
    """Measure, print, plot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--accuracy", type=float, default=1e-2)
    parser.add_argument("--long", action="store_true", help="go on to a million poses")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)

    pairs, divisions = pair_rate()
    print(
        f"inner loop {pairs / 1e9:.1f} Gpairs/s, divisions {divisions / 1e9:.1f} G/s: {pairs / divisions:.0%} of that"
    )

    world = bare_world(64)
    series: dict[str, list[tuple[float, float, float]]] = {"poses": [], "pixels": [], "triangles": []}

    def record(name: str, work: float, seconds: float) -> None:
        series[name].append((work, seconds, _memory()))

    # The memory is the peak so far: poses, which should take none, come first, and what takes most comes last.
    transport = Transport(world, accuracy=options.accuracy)
    rng = np.random.default_rng(1)
    for poses in (1, 10, 100, 1_000, 10_000, 100_000, *([1_000_000] if options.long else [])):
        places = rng.uniform((1.0, 0.6, 0.8), (2.1, 1.7, 1.8), (poses, 3))
        turns = rng.uniform(-15.0, 15.0, (poses, 3))

        def sweep(places: np.ndarray = places, turns: np.ndarray = turns) -> None:
            for first in range(0, len(places), 2048):
                transport.pictures(places[first : first + 2048], turns[first : first + 2048])

        record("poses", poses, best(sweep, 3 if poses <= 10_000 else 1))
    for pixels in (16, 32, 64, 128, 256, 512, 1024):
        watched = replace(world.watched, resolution=(pixels, pixels))
        transport = Transport(replace(world, watched=watched), accuracy=options.accuracy)
        record("pixels", pixels**2, best(lambda t=transport: t.render(*POSE)))
    for triangles in (10, 100, 1_000, 10_000, 100_000):
        mesh = ball(triangles)
        transport = Transport(replace(world, target=(mesh,)), accuracy=options.accuracy)
        record("triangles", len(mesh.triangles), best(lambda t=transport: t.render(*POSE)))

    for name, rows in series.items():
        print(f"\n{name:>10s} {'seconds':>10s} {'us each':>10s} {'MiB so far':>11s}")
        for n, t, memory in rows:
            print(f"{n:10.0f} {t:10.5f} {1e6 * t / n:10.3f} {memory:11.0f}")
    table = [
        (name, f"{n:.0f}", f"{t:.2g}", f"{memory:.0f}") for name, rows in series.items() for n, t, memory in rows
    ]
    file = results.write(options.output, "scaling", RESULTS["scaling"], table)
    for path in pictures.save("scaling", file, options.output):
        print(path)


if __name__ == "__main__":
    main()
