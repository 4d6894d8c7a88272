"""Memory and rate of a sweep over ten thousand renders: do they stay constant?

Run: ``python benchmarks/endurance.py -o DIR [--pictures 10000]``. Writes ``endurance.csv`` and draws it: memory of
each worker and of the coordinator, and pictures per second, against pictures done.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import results

from generator.jobs import local
from generator.jobs.journal import memory
from generator.jobs.request import SweepRequest

RESULTS = {"endurance": ("pictures", "seconds", "coordinator, MiB", "one worker, MiB", "the other, MiB")}


def main() -> None:
    """Render, record memory and rate, and plot them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--pictures", type=int, default=10_000)
    parser.add_argument("--samples", type=int, default=4)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    scene = options.output / "scene.blend"
    command = [sys.executable, "-m", "generator.cli", "scene", "room", "--target", "sphere", "-o", str(scene)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    rows: list[tuple[float, ...]] = []
    start = time.monotonic()

    def record(done: int, total: int) -> None:
        if not rows or done - rows[-1][0] >= max(1, total // 200):
            workers = sorted(
                int(n)
                for task in Path("/proc/self/task").glob("*/children")
                for n in task.read_text().split()
                if b"generator.blender.worker" in Path(f"/proc/{n}/cmdline").read_bytes()
            )
            memories = [memory(pid) / 2**20 for pid in [os.getpid(), *workers]]
            rows.append((done, time.monotonic() - start, *(memories + [0.0] * 3)[:3]))

    poses = -(-options.pictures // 9)
    chosen = {"engine": "patch", "samples": options.samples, "poses": poses, "resolution": [16, 16]}
    outcome = local.run(
        SweepRequest(scene=scene, path=options.output / "set", chosen=chosen, workers=2), progress=record
    )
    table = np.array(rows)
    import pictures  # not before: what draws would count as the coordinator's memory

    file = results.write(options.output, "endurance", RESULTS["endurance"], np.round(table, 2).tolist())
    pictures.save("endurance", file, options.output)
    later = table[table[:, 0] > 0.1 * table[-1, 0]]
    rate = np.diff(later[:, 0]) / np.diff(later[:, 1])
    slope = [np.polyfit(later[:, 0], later[:, k], 1)[0] * 1e4 for k in (2, 3, 4)]
    print(f"{outcome.rendered} pictures, {2 * outcome.rendered} renders, {len(outcome.failed)} failed")
    print("memory grows by {:.1f}, {:.1f} and {:.1f} MiB in 10,000 pictures (coordinator, workers)".format(*slope))
    halves = [float(np.median(part)) for part in np.array_split(rate, 2)]
    print("rate: {:.3g} pictures a second in the first half, {:.3g} in the second".format(*halves))


if __name__ == "__main__":
    main()
