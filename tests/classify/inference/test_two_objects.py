"""Two objects at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from classify_helpers import make_bulk, plain_atlas
from scipy.stats import multivariate_normal

from classify.inference import atlas_build
from classify.inference.two_objects import locate_two
from classify.pictures.sensor import Sensor
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.transport import Sphere, Transport

LIGHT = 3e-4
"""Of the empty scene, W/m^2/sr: six times the most that a sphere adds."""
GRID = VoxelGrid(lo=(0.0, 0.0, 0.0), hi=(2.0, 1.0, 1.0), shape=(2, 1, 1))


def test_the_pairs_are_weighed_by_their_likelihood():
    """As the normal density of the code around every sum of two codes has it."""
    rng = np.random.default_rng(0)
    codes, voxels = 2.0 * rng.normal(size=(40, 3)), rng.integers(2, size=40)
    found = plain_atlas(codes, rng.uniform(size=(40, 3)), voxels, GRID)
    found = replace(found, background=np.full((1, 3), 1e6))
    code = (codes[3] + codes[17] + rng.normal(size=3)).astype(np.float32)
    answer = locate_two(found, code)
    density = multivariate_normal(cov=np.eye(3))
    likely = np.array([[density.pdf(code - a - b) for b in codes] for a in codes])
    wanted = [[likely[np.ix_(voxels == v, voxels == w)].sum() / likely.sum() for w in (0, 1)] for v in (0, 1)]
    np.testing.assert_allclose(answer.voxels, wanted, rtol=1e-3)
    single = np.mean([density.pdf(code - a) for a in codes])
    np.testing.assert_allclose(answer.evidence, np.log(likely.mean() / single), rtol=1e-3)


def test_two_spheres_of_the_engine_are_found(tmp_path):
    simulated = make_bulk(tmp_path / "set", pictures=1200, radius=0.1, ambient=LIGHT)
    found = atlas_build.build(simulated, Sensor(frames=100, background_frames=10000), measured_background=False)
    world, rng = simulated.world(), np.random.default_rng(1)
    right = 0
    for _ in range(30):
        first, second = rng.choice(4, size=2, replace=False) + 4 * rng.integers(300, size=2)
        places = simulated.positions[[first, second]]
        middle = places.mean(axis=0)
        balls = tuple(Sphere(p - middle, 0.1, np.ones(3)) for p in places)
        both = Transport(type(world)(world.patch, world.watched, balls), accuracy=1e-2)
        picture = both.render(middle, (0.0, 0.0, 0.0)).pixels + LIGHT
        code = found.code(found.sensor.measure(picture, rng))
        right += locate_two(found, code).likeliest == tuple(sorted(simulated.voxels[[first, second]]))
    assert right > 15, "of six pairs, chance is five in thirty"


def test_what_outshines_its_scene_is_one_sentence(tmp_path):
    found = atlas_build.build(make_bulk(tmp_path / "set", pictures=64), Sensor())
    with pytest.raises(NlosError, match="adds up only where it is faint"):
        locate_two(found, np.zeros(found.codes.shape[1], dtype=np.float32))


def test_size_must_be_known(tmp_path):
    simulated = make_bulk(tmp_path / "set", pictures=64)
    found = atlas_build.build(simulated, Sensor(), unknown=True)
    with pytest.raises(NlosError, match="by an atlas of a known object only"):
        locate_two(found, np.zeros(found.codes.shape[1], dtype=np.float32))
