"""Compare Cycles' pictures of a data set with the engine's pictures at the same poses.

``python benchmarks/set_against_engine.py DATASET SIMULATED`` takes the scene from a simulated set of the same object
(``nlos-generate bulk``). For each voxel it prints the projection of Cycles' difference pictures onto the engine's (1
if they agree), with its 95 % interval over the poses, and the noise of Cycles' pixels.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from generator.sets.bulk_set import Bulk
from generator.sets.dataset import Dataset
from generator.transport import Transport


def main() -> None:
    """Compare the pictures, and print a line for each voxel."""
    parser = argparse.ArgumentParser(description="Compare a data set by Cycles with the engine, voxel by voxel.")
    parser.add_argument("dataset", type=Path)
    parser.add_argument("simulated", type=Path, help="simulated set of the same scene and object")
    parser.add_argument("--poses", type=int, default=40, help="of each voxel (default: 40)")
    options = parser.parse_args()
    dataset = Dataset.open(options.dataset)
    world = Bulk.open(options.simulated).world()
    background = dataset.background().mean(axis=2, dtype=np.float64)
    height, width = background.shape
    engine = Transport(world.seen_by(width, height), accuracy=1e-3)
    ratio = background.mean() / engine.background().mean()
    print(f"background: Cycles / engine = {ratio:.5f}")
    for voxel, label in enumerate(dataset.grid.labels):
        records = [r for r in dataset.records if r.voxel == voxel][: options.poses]
        if len(records) < 2:
            continue
        by_cycles = np.array([dataset.picture(r).mean(axis=2, dtype=np.float64) - background for r in records])
        by_engine = np.array([engine.difference(r.position, r.rotation).mean(axis=2) for r in records])
        projections = (by_cycles * by_engine).sum(axis=(1, 2)) / (by_engine**2).sum(axis=(1, 2))
        half_width = 1.96 * projections.std(ddof=1) / np.sqrt(len(projections))
        noise = (by_cycles - projections[:, None, None] * by_engine).std() / background.mean()
        print(
            f"{label}: {projections.mean():.4f} +- {half_width:.4f} over {len(projections)} poses; "
            f"noise of a pixel {noise:.1e} of the background"
        )


if __name__ == "__main__":
    main()
