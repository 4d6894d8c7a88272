"""Cost of reading: shares begin and end one after the other, and each reads its own pictures or all of them.

Run: ``python benchmarks/shares.py [--pictures 5000] [--shares 10]``. Nothing is rendered: the pictures are 16 x 16
pixels of noise, written between a share's beginning and its end. Prints how many pictures were read, and seconds.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from generator.files.toml import to_dict
from generator.jobs import local
from generator.model import poses
from generator.model.presets import preset
from generator.model.settings import Sweep
from generator.sets.dataset import Dataset
from generator.sets.manifest import BACKGROUND


def all_of_them(dataset: Dataset, shard: tuple[int, int], own: Sequence[int]) -> None:
    """Read every picture, as every share did in the past."""
    dataset.gather()


def run(
    folder: Path, pictures: int, shares: int, look: Callable[[Dataset, tuple[int, int], Sequence[int]], object]
) -> str:
    """Let every share begin, write its pictures, and let it end; return the counts as text."""
    scene = preset("room")
    settings = Sweep(poses=-(-pictures // scene.grid.n_voxels), resolution=(16, 16), inside="centre")
    meta = {"sweep": to_dict(settings), "scene": to_dict(scene), "reference_radiance": 1.0, "software": {}}
    created = Dataset.create(folder, meta, poses.plan(scene.grid, settings, np.zeros((1, 3))))
    pixels = np.random.default_rng(0).random((16, 16, 3)).astype(np.float32)
    created.write_background(BACKGROUND, pixels, seed=0, samples=1)
    read, seconds = 0, 0.0
    inspect = Dataset.inspect

    def counted(self: Dataset, pose: object) -> object:
        nonlocal read
        read += (self.path / pose.file).exists()
        return inspect(self, pose)

    Dataset.inspect = counted
    try:
        for k in range(shares):
            dataset = Dataset.open(folder)
            indices = range(k, dataset.planned, shares)
            start = time.perf_counter()
            look(dataset, (k, shares), indices)
            seconds += time.perf_counter() - start
            for position in indices:
                dataset.write_pose(dataset.poses[position], pixels, seconds=1.0, samples=1)
            start = time.perf_counter()
            look(dataset, (k, shares), indices)
            seconds += time.perf_counter() - start
    finally:
        Dataset.inspect = inspect
    assert len(Dataset.open(folder).records) == created.planned
    return f"{created.planned} pictures, {shares} shares: {read} read, {seconds:.1f} s"


def main() -> None:
    """Measure both ways of reading."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=5000)
    parser.add_argument("--shares", type=int, default=10)
    options = parser.parse_args()
    for name, look in {"all": all_of_them, "its own": local.gather}.items():
        with tempfile.TemporaryDirectory() as folder:
            print(f"{name}: {run(Path(folder) / 'set', options.pictures, options.shares, look)}", flush=True)


if __name__ == "__main__":
    main()
