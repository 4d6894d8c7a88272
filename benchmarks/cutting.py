"""Compare shadows cut out as polygons with shadows traced by rays: time and difference, with more furniture.

Run: ``python benchmarks/cutting.py -o DIR [--boxes 2 5 8 16 32] [--accuracy 1e-2]``. The two are independent methods
for the same picture, so their difference shows the error of both.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import results
import scenes

from generator.model.presets import preset
from generator.transport import Transport, fields
from generator.transport.world import Mesh

RESULTS = {"cutting": ("surfaces", "polygons, ms", "rays, ms", "difference")}


def furnished(boxes: int) -> Any:
    """Return the preset room with boxes next to its partition."""
    world = scenes.world_from_spec(replace(preset("room", "sphere"), resolution=(32, 32)))
    rng = np.random.default_rng(boxes)
    added = []
    for _ in range(boxes):
        size = rng.uniform(0.05, 0.4, size=3)
        low, high = np.array([-2.3, 0.2, 0.1]) + size / 2.0, np.array([-1.6, 2.5, 2.4]) - size / 2.0
        corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
        faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
        halves = [half for a, b, c, d in faces for half in ((a, b, c), (a, c, d))]
        triangles = (corners + rng.uniform(low, high))[np.array(halves)]
        added.append(Mesh(triangles, np.full((len(triangles), 3), 0.5)))
    return replace(world, room=(*world.room, *added))


def main() -> None:
    """Print a line for each number of boxes, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the table")
    parser.add_argument("--boxes", type=int, nargs="+", default=[2, 5, 8, 16, 32])
    parser.add_argument("--accuracy", type=float, default=1e-2)
    options = parser.parse_args()
    table = []
    print(" | ".join(RESULTS["cutting"]))
    for boxes in options.boxes:
        pictures, seconds = {}, {}
        for method, limit in (("cut", 10**6), ("rays", 0)):
            fields.CUT = limit
            engine = Transport(furnished(boxes), accuracy=options.accuracy)
            engine.difference((1.2, 1.0, 1.3), (0.0, 0.0, 0.0))  # warms up: setup is not part of the time
            places = np.random.default_rng(0).uniform((1.0, 0.6, 0.6), (2.1, 1.7, 2.0), size=(12, 3))
            start = time.perf_counter()
            pictures[method] = np.array([engine.difference(place, (0.0, 0.0, 0.0)) for place in places])
            seconds[method] = 1000.0 * (time.perf_counter() - start) / len(places)
        level = np.sqrt((pictures["rays"] ** 2).mean(axis=(1, 2, 3)))
        error = np.sqrt(((pictures["cut"] - pictures["rays"]) ** 2).mean(axis=(1, 2, 3))) / level
        times = [f"{seconds[method]:.1f}" for method in ("cut", "rays")]
        table.append((str(6 + 6 * boxes), *times, f"{100.0 * np.median(error):.2f} %"))
        print(" | ".join(table[-1]), flush=True)
    results.write(options.output, "cutting", RESULTS["cutting"], table)


if __name__ == "__main__":
    main()
