"""Pictures that fit are told from those that do not: probabilities are true, and wrong scenes show."""

from __future__ import annotations

import numpy as np
import pytest
import worlds
from classify_helpers import colour, make_bulk
from scipy import stats

from classify.inference import atlas_build
from classify.inference.misfit import Misfits, doubt
from classify.pictures.sensor import Sensor

FLOOR = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
SENSORS = {"dim": Sensor(full_well=300.0, bits=10), "one": Sensor(), "hundred": Sensor(frames=100)}
COUNT = 300


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A bulk set of a sphere above a floor."""
    return make_bulk(tmp_path_factory.mktemp("bulk") / "set", room=(FLOOR,))


@pytest.fixture(scope="module", params=[pytest.param(name, marks=pytest.mark.slow) for name in SENSORS])
def atlas(request, simulated):
    """Atlases for pictures from dim to bright."""
    return atlas_build.build(simulated, SENSORS[request.param], measured_background=True)


def misfits(atlas, bulk, change=lambda picture: picture, *, before=True, seed=0):
    """Test the pictures of a set, changed, each with one of thirty backgrounds, which are changed if ``before``."""
    rng, test, sensor = np.random.default_rng(seed), Misfits(atlas), atlas.sensor
    empty = [sensor.measure(bulk.background, rng, frames=sensor.background_frames) for _ in range(30)]
    if before:
        empty = [change(picture) for picture in empty]
    differences = [
        atlas.difference(change(sensor.measure(colour(picture), rng)), empty[i % len(empty)])
        for i, picture in enumerate(bulk.pictures[:COUNT])
    ]
    return [test(difference, atlas.code_of(difference)) for difference in differences]


def test_probabilities_are_true(atlas, tmp_path):
    """At poses that the atlas does not have, each is as rare as it says."""
    found = misfits(atlas, make_bulk(tmp_path / "unseen", pictures=COUNT, seed=9, room=(FLOOR,)))
    code, pixels, joint = (
        np.array([getattr(one, name) for one in found]) for name in ("code", "pixels", "probability")
    )
    for probabilities in (code, pixels):
        assert stats.kstest(probabilities, "uniform", alternative="greater").pvalue > 1e-4
    most = stats.binom.ppf(1.0 - 1e-4, COUNT, 0.01)
    assert (joint < 0.01).sum() <= most
    assert joint.min() > 1e-6
    assert doubt(joint) == ""


WRONG = {
    "an object of another size": ({"radius": 0.2}, None),
    "an object of another albedo": ({"albedo": 0.6}, None),
    "a sheet": ({"radius": 0.0}, None),
    "a gamma": ({}, lambda picture: np.maximum(picture, 0.0) ** 0.8 * picture.max() ** 0.2),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", WRONG)
def test_what_does_not_fit_is_told(simulated, tmp_path, what):
    """From a hundred frames on, of a set of such pictures; most differ little from one of the atlas, elsewhere."""
    changes, change = WRONG[what]
    atlas = atlas_build.build(simulated, SENSORS["hundred"], measured_background=True)
    other = make_bulk(tmp_path / "other", pictures=COUNT, seed=9, room=(FLOOR,), **changes)
    joint = np.array([one.probability for one in misfits(atlas, other, change or (lambda picture: picture))])
    assert (joint < 0.01).mean() > 0.2
    assert "do not fit the atlas" in doubt(joint)


def test_a_picture_of_something_else_has_no_explanation(tmp_path):
    """A shadow across the wall, of a person who walks by, is no light of the object at any pose."""
    few = make_bulk(tmp_path / "set", pictures=300, room=(FLOOR,))
    atlas = atlas_build.build(few, SENSORS["one"], measured_background=True)

    def shaded(picture):
        dark = picture.copy()
        dark[:, :4] *= 0.9
        return dark

    assert min(one.probability for one in misfits(atlas, few)) > 1e-6
    assert max(one.probability for one in misfits(atlas, few, shaded, before=False)) < 1e-6
