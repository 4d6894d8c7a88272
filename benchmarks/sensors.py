"""Do the intervals of ``nlos-classify sensor`` hold the figures of cameras that are known?

    python benchmarks/sensors.py -o DIR [--cameras N] [--draws N]

Draws cameras at random, and of each some specimens with their own fixed pattern; takes bursts of them electron by
electron (``tests/support/cameras.py``), twelve frames at each of twelve levels of light and four dark exposure times,
of 96 x 96 pixels. Writes DIR/sensors.csv: how many of the cameras' first specimens, and what share of all, have each
figure within its 95 % interval, and how wide that is.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np
import results

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
import cameras

from classify.pictures import photon_transfer

FRAMES = 12
RESULTS = {"sensors": ("figure", "held, of first specimens", "held, %", "error, %", "half the interval, %", "draws")}
"""``error`` is the standard error of the share; half the interval is the median over the draws, of the true value."""


def one(number: int, draw: int) -> dict[str, tuple[bool, float]]:
    """Return, for each figure of a specimen, whether its interval holds the truth, and its half over that."""
    camera = cameras.Camera.drawn(np.random.default_rng([number, 1288]))
    bench = cameras.Bench(camera, np.random.default_rng([number, draw]))
    found = photon_transfer.measure(bench.light(FRAMES), bench.dark(FRAMES), bits=camera.bits)
    linear = [level for level, used in zip(cameras.LEVELS, found.linear, strict=True) if used]
    return {
        name: (
            found.intervals[name].low <= value <= found.intervals[name].high,
            (found.intervals[name].high - found.intervals[name].low) / 2.0 / value,
        )
        for name, value in cameras.truth(camera, linear).items()
    }


def main() -> None:
    """Draw cameras, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--cameras", type=int, default=10)
    parser.add_argument("--draws", type=int, default=30)
    options = parser.parse_args()
    drawn = [[one(number, draw) for draw in range(options.draws)] for number in range(options.cameras)]
    count = options.cameras * options.draws
    rows = []
    for name in drawn[0][0]:
        held = np.array([[specimen[name][0] for specimen in camera] for camera in drawn])
        wide = np.median([[specimen[name][1] for specimen in camera] for camera in drawn])
        share = float(held.mean())
        error = math.sqrt(max(share * (1.0 - share), 1.0 / count) / count)
        first = f"{held[:, 0].sum()} of {options.cameras}"
        rows.append([name, first, f"{100.0 * share:.1f}", f"{100.0 * error:.1f}", f"{100.0 * wide:.2g}", count])
    print(results.write(options.output, "sensors", RESULTS["sensors"], rows))


if __name__ == "__main__":
    main()
