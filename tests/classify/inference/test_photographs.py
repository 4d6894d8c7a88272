"""An atlas for another camera, and answers by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import worlds
from classify_helpers import make_bulk

from classify.inference import atlas_build
from classify.pictures.sensor import Sensor
from classify.pictures.taken import level_of
from generator.model.errors import NlosError

FLOOR = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
MADE_FOR = Sensor(full_well=30_000.0, bits=0, frames=10)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    return make_bulk(tmp_path_factory.mktemp("bulk") / "set", pictures=200, room=(FLOOR,))


@pytest.fixture(scope="module")
def atlas(simulated):
    return atlas_build.build(simulated, MADE_FOR)


def squared(atlas):
    """Squared distances between the codes of neighbours, and their lengths: all that answers depend on."""
    codes = atlas.codes.astype(float)
    return np.concatenate([(codes**2).sum(axis=1), ((codes[1:] - codes[:-1]) ** 2).sum(axis=1)])


@pytest.mark.parametrize("light", [0.2, 4.0])
def test_an_atlas_for_another_camera_is_the_one_that_is_made_for_it(simulated, atlas, light):
    """Less light in more frames, or more in fewer, and another number of backgrounds."""
    frames, exposure = (7, light * 10 / 7 * atlas.sensor.exposure)
    other = replace(atlas.sensor, exposure=exposure, frames=frames, background_frames=30, full_well=1e6)
    wanted = squared(atlas_build.build(simulated, other))
    seen = atlas.seen_by(other)
    assert seen.spread == pytest.approx(1.0 + 7 / 30)
    assert np.allclose(squared(seen), wanted, rtol=0.03, atol=1e-3 * wanted.max())
    picture = np.repeat(simulated.pictures[5][..., None], 3, axis=2)
    assert np.allclose(seen.code(picture, simulated.background), seen.codes[5], atol=0.1)


def test_a_camera_of_other_noise_is_refused(atlas):
    dark = replace(atlas.sensor, read_noise=30.0 * np.sqrt(atlas.sensor.full_well))
    with pytest.raises(NlosError, match="noise is distributed otherwise"):
        atlas.seen_by(dark)
    bright = replace(atlas.sensor, exposure=1e4 * atlas.sensor.exposure, full_well=1e12, read_noise=0.0)
    with pytest.raises(NlosError, match="leaves out too much for them; make it with --frames"):
        atlas.seen_by(bright)


def test_the_level_is_found_whatever_the_unit():
    wanted = 1.0 + np.random.default_rng(0).random((4, 5))
    level, mismatch = level_of(wanted / 3e5, wanted)
    assert (level, mismatch) == (pytest.approx(3e5), pytest.approx(0.0, abs=1e-9))
    with pytest.raises(NlosError, match="holds no light"):
        level_of(np.zeros((4, 5)), wanted)
