"""Two objects at once: how often both voxels are right, and how much light one object takes from the other.

``python benchmarks/two_objects.py room.atlas simulated/ --frames 10``: the engine renders pairs of the set's spheres
in different voxels, with all light and shadow between them; the answers assume that the light of both adds up.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from classify.inference import atlas_file
from classify.inference.posterior import locate
from classify.inference.two_objects import locate_two
from classify.intervals import wilson
from generator.sets.bulk_set import Bulk
from generator.transport import Sphere, Transport

_MARGIN = 1.05


def main() -> None:
    """Render pairs, and locate both objects of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("atlas", type=Path)
    parser.add_argument("simulated", type=Path, help="the set of a sphere that the atlas is of")
    parser.add_argument("--frames", type=int, default=1)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    atlas, bulk = atlas_file.load(options.atlas).at(options.frames), Bulk.open(options.simulated)
    world = bulk.world().seen_by(*bulk.plan.resolution)
    ball = world.target[0]
    assert isinstance(ball, Sphere), "the set must be of a sphere"
    empty = Transport(world, accuracy=bulk.plan.accuracy).background()
    rng = np.random.default_rng(options.seed)
    right, half, single, missing, two_likelier = 0, 0, 0, [], 0
    for _ in range(options.count):
        first, second = _two(bulk, rng, _MARGIN * 2.0 * ball.radius)
        places = bulk.positions[[first, second]]
        middle = places.mean(axis=0)
        bodies = tuple(replace(ball, centre=ball.centre + place - middle) for place in places)
        picture = Transport(replace(world, target=bodies), accuracy=1e-2).render(middle, (0.0, 0.0, 0.0)).pixels
        summed = bulk.pictures[first] + bulk.pictures[second] - 2.0 * empty.mean(axis=2)
        difference = (picture - empty).mean(axis=2)
        missing.append(float(np.sqrt(((summed - difference) ** 2).mean() / (difference**2).mean())))
        code = atlas.code(atlas.sensor.measure(picture, rng))
        pair = locate_two(atlas, code)
        truth = sorted((int(bulk.voxels[first]), int(bulk.voxels[second])))
        right += list(pair.likeliest) == truth
        half += bool({*pair.likeliest} & {*truth})
        single += int(locate(atlas, code).voxels.argmax()) in truth
        two_likelier += pair.evidence > 0.0
    frames = f"{options.frames} frame{'s' if options.frames > 1 else ''}"
    print(f"{options.count} pairs of spheres in two voxels, {frames}, seed {options.seed}")
    print(f"both voxels right: {wilson(right, options.count).percent()}; of 36 pairs, chance is 2.8 %")
    print(f"one of them at least: {wilson(half, options.count).percent()}")
    print(f"asked for one object, one of the two is named: {wilson(single, options.count).percent()}")
    print(f"two are held more probable than one: {wilson(two_likelier, options.count).percent()}")
    print(f"light and shadow between the two: {100.0 * float(np.median(missing)):.1f} % of the signal (median)")


def _two(bulk: Bulk, rng: np.random.Generator, apart: float) -> tuple[int, int]:
    """Draw two poses in different voxels whose spheres do not touch."""
    while True:
        first, second = (int(n) for n in rng.integers(bulk.planned, size=2))
        separated = np.linalg.norm(bulk.positions[first] - bulk.positions[second]) > apart
        if separated and bulk.voxels[first] != bulk.voxels[second]:
            return first, second


if __name__ == "__main__":
    main()
