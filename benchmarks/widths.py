"""Loss of accuracy of the engine `surfel` by float32 and fast mathematics, in extreme scenes.

Run: ``python benchmarks/widths.py -o DIR``; the engine is compiled three times. Every picture is rendered in
float32 and float64, by code that is compiled without fastmath, with contraction only (as the engine is), and
with all of fastmath; the error is relative to float64 without fastmath at the same accuracy, root mean square over
the pixels of the difference picture.
"""

from __future__ import annotations

import argparse
import functools
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import results

MODES: dict[str, Any] = {"none": set(), "contract": {"contract"}, "all": True}
WIDTHS = ("float64", "float32")
RESULTS = {
    "widths": (
        "difference picture",
        "float64, fastmath contract",
        "float64, fastmath all",
        "float32, fastmath none",
        "float32, fastmath contract",
        "float32, fastmath all",
    )
}
"""The columns are errors relative to float64 without fastmath."""
ACCURACY = 5e-3
"""Accuracy of the pictures. The engine uses float32 by default unless an accuracy finer than 5e-5 is requested."""
_FAR = np.array([1000.0, 0.0, 1000.0])


def cases() -> list[tuple[str, Any, Any, Any]]:
    """Return name, world, position and rotation of every extreme case."""
    import scenes

    from generator.model.presets import preset
    from generator.transport.world import Sphere

    def bare(kind: str = "sphere", pixels: int = 32, **changes: Any) -> Any:
        spec = replace(preset("room", kind), room=None, partition=None, resolution=(pixels, pixels), **changes)
        return scenes.world_from_spec(spec)

    def ball(radius: float) -> Any:
        return replace(bare(), target=(Sphere(np.zeros(3), radius, np.ones(3)),))

    def lit(factor: float) -> Any:
        world = bare()
        return replace(world, patch=replace(world.patch, intensity=world.patch.intensity * factor))

    def scaled(factor: float) -> Any:
        small = bare()
        patch, view = small.patch, small.watched
        places = {name: factor * getattr(patch, name) for name in ("centre", "major", "minor", "lamp", "height")}
        to_wall = view.to_wall.copy()
        to_wall[:3] *= factor
        eye = view.eye * np.array([factor, factor, factor, 1.0])
        target = tuple(replace(b, centre=factor * b.centre, radius=factor * b.radius) for b in small.target)
        return replace(
            small,
            patch=replace(patch, **places, intensity=patch.intensity * factor**2),
            watched=replace(view, to_wall=to_wall, eye=eye),
            target=target,
        )

    def away() -> Any:
        near = bare()
        patch, view = near.patch, near.watched
        to_wall = view.to_wall.copy()
        to_wall[:3] += np.outer(_FAR, to_wall[3])
        return replace(
            near,
            patch=replace(patch, centre=patch.centre + _FAR, lamp=patch.lamp + _FAR),
            watched=replace(view, to_wall=to_wall, eye=view.eye + np.append(_FAR, 0.0)),
        )

    place, still = (1.2, 1.0, 1.3), (0.0, 0.0, 0.0)
    in_room = scenes.world_from_spec(replace(preset("room", "sphere"), resolution=(32, 32)))
    lit_at, seen_at = np.array(preset("room").spot.aim), np.array([-0.45, 0.0, 1.3])

    def edge_on(point: Any) -> tuple[float, float, float]:
        # The sheet's normal is its own -y; turned about z until the point lies in its plane.
        way = np.array(place) - point
        return (0.0, 0.0, float(np.degrees(np.arctan2(way[1], way[0]))))

    return [
        ("sphere at 1 m", bare(), place, still),
        ("sheet at 1 m", bare("sheet"), place, (10.0, 5.0, 30.0)),
        ("sphere in a room", in_room, place, still),
        ("sphere touching the wall", bare(), (1.2, 0.2, 1.3), still),
        ("sphere 1 mm from it", bare(), (1.2, 0.201, 1.3), still),
        ("sheet edge-on to w1", bare("sheet"), place, edge_on(lit_at)),
        ("sheet edge-on to w2", bare("sheet"), place, edge_on(seen_at)),
        ("sphere in the partition's shadow", in_room, (2.2, 3.1, 1.3), still),
        ("sphere bigger than its voxel", ball(0.7), place, still),
        ("radiance times 1e-20", lit(1e-20), place, still),
        ("radiance times 1e20", lit(1e20), place, still),
        ("scene of 5 mm", scaled(1e-3), tuple(1e-3 * x for x in place), still),
        ("scene of 5 km", scaled(1e3), tuple(1e3 * x for x in place), still),
        ("1.4 km from the origin", away(), tuple(np.array(place) + _FAR), still),
        ("1 x 1 pixels", bare(pixels=1), place, still),
        ("2048 x 2048 pixels", bare(pixels=2048), place, still),
    ]


def child(mode: str, out: Path) -> None:
    """Render all cases in one mode, and write the pictures to a file."""
    import numba

    from generator.transport import compiled

    compiled._njit = functools.partial(numba.njit, error_model="numpy", fastmath=MODES[mode])  # type: ignore[assignment]
    from generator.transport import Transport, fields

    pictures = {}
    seconds = {width: [] for width in WIDTHS}
    for name, world, place, turn in cases():
        for width in WIDTHS:
            fields._SINGLE = 0.0 if width == "float32" else 1.0
            pictures[f"{name}|{width}"] = Transport(world, accuracy=ACCURACY).difference(place, turn).mean(axis=2)
    engines = {}
    name, world, place, turn = cases()[0]
    for width in WIDTHS:
        engines[width] = Transport(world, accuracy=ACCURACY)
    for _ in range(200):  # both widths in turn
        for width in WIDTHS:
            fields._SINGLE = 0.0 if width == "float32" else 1.0
            start = time.perf_counter()
            engines[width].difference(place, turn)
            seconds[width].append(time.perf_counter() - start)
    for width in WIDTHS:
        pictures[f"seconds|{width}"] = np.array(np.median(seconds[width]))
    np.savez(out, **pictures)


def main() -> None:
    """Render everything, print the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--child", choices=list(MODES), help=argparse.SUPPRESS)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    if options.child:
        child(options.child, options.output / f"{options.child}.npz")
        return
    output = {}
    for mode in MODES:
        command = [sys.executable, __file__, "-o", str(options.output), "--child", mode]
        subprocess.run(command, check=True)
        output[mode] = dict(np.load(options.output / f"{mode}.npz"))
    columns = [(width, mode) for width in WIDTHS for mode in MODES if (width, mode) != ("float64", "none")]
    table = []
    for name, *_ in cases():
        reference = output["none"][f"{name}|float64"]
        scale = float(np.sqrt((reference**2).mean()))
        row = [name]
        for width, mode in columns:
            error = float(np.sqrt(((output[mode][f"{name}|{width}"] - reference) ** 2).mean()))
            row.append(f"{error / scale:.1e}" if scale else "dark" if error == 0.0 else "LIGHT")
        table.append(row)
        print(" | ".join(row), flush=True)
    results.write(options.output, "widths", RESULTS["widths"], table)
    base = float(output["contract"]["seconds|float64"])
    for mode in MODES:
        for width in WIDTHS:
            print(f"{width}, fastmath {mode}: {float(output[mode][f'seconds|{width}']) / base:.3g} times the seconds")


if __name__ == "__main__":
    main()
