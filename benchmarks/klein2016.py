"""Figure 2 of Klein et al. 2016: how much the picture changes when the hidden object moves or turns a little.

Run: ``python benchmarks/klein2016.py -o DIR`` (a few seconds, after the set-up). The `tabletop` preset is their
synthetic experiment: a 10 cm square, 50 cm from the wall, the spot in the middle. They move it by +-2.5 cm and turn
it by +-7.5 degrees about each axis, and say: "roughly 1 % per centimetre or degree, except rotation about the axis
normal to the wall", which changes much less.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import results

from generator.blender.engines import survey
from generator.blender.scene import blend_file, build
from generator.model.presets import preset
from generator.transport import Transport

PLACE = (0.0, 0.5, 0.0)
MOVE, TURN = 0.025, 7.5
AXES = {"x": "along the wall", "y": "normal to the wall", "z": "along the wall, up"}

RESULTS = {"klein2016": ("motion", "largest (%)", "RMS (%)", "largest per cm or degree (%)")}


def changes(pixels: int, accuracy: float) -> list[tuple[str, float, float, float]]:
    """Return for each motion its name, and the change of the added light in percent of its peak.

    The change is from the resting pose to the end of the motion that changes more: its largest pixel, its root mean
    square, and the largest per centimetre or degree.
    """
    scene = blend_file.new_file()
    build.build(scene, preset("tabletop", "sheet"))
    world = survey.surfel_world(scene, resolution=(pixels, pixels))
    transport = Transport(world, accuracy=accuracy)
    rest = transport.render(PLACE, (0.0, 0.0, 0.0)).added
    rows = []
    for k, (axis, words) in enumerate(AXES.items()):
        ends = []
        for sign in (-1.0, 1.0):
            place = np.array(PLACE)
            place[k] += sign * MOVE
            ends.append(transport.render(place, (0.0, 0.0, 0.0)).added)
        rows.append((f"move {axis} ({words})", *_change(ends, rest, 100.0 * MOVE)))
    for k, (axis, words) in enumerate(AXES.items()):
        ends = []
        for sign in (-1.0, 1.0):
            turn = np.zeros(3)
            turn[k] = sign * TURN
            ends.append(transport.render(PLACE, turn).added)
        rows.append((f"turn about {axis} ({words})", *_change(ends, rest, TURN)))
    return rows


def _change(ends: list[np.ndarray], rest: np.ndarray, steps: float) -> tuple[float, float, float]:
    differences = [100.0 * np.abs(end - rest) / rest.max() for end in ends]
    largest = max(differences, key=lambda difference: float(difference.max()))
    return float(largest.max()), float(np.sqrt((largest**2).mean())), float(largest.max() / steps)


def main() -> None:
    """Print the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the table")
    parser.add_argument("--pixels", type=int, default=64)
    parser.add_argument("--accuracy", type=float, default=1e-4)
    options = parser.parse_args()
    table = changes(options.pixels, options.accuracy)
    print(f"{'+-2.5 cm or +-7.5 degrees':40s} {'peak':>8s} {'RMS':>8s}   peak per cm or degree")
    for name, largest, mean, per_unit in table:
        print(f"{name:40s} {largest:7.2f}% {mean:7.2f}%   {per_unit:.3f}%")
    rows = [(name, f"{largest:.2f}", f"{mean:.2f}", f"{per_unit:.3f}") for name, largest, mean, per_unit in table]
    results.write(options.output, "klein2016", RESULTS["klein2016"], rows)


if __name__ == "__main__":
    main()
