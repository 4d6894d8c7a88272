"""Places from pictures, against the Cramer-Rao bound and against their own stated uncertainty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from classify_helpers import colour, make_bulk
from scipy import stats

from classify.inference import atlas_build, atlas_file, posterior, unknown_object
from classify.inference.misfit import Misfits
from classify.pictures.sensor import Sensor
from generator.model.errors import NlosError


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A bulk set of a sphere before a bare wall."""
    return make_bulk(tmp_path_factory.mktemp("bulk") / "set")


@pytest.fixture(scope="module")
def unseen(tmp_path_factory):
    """The same sphere at other poses."""
    return make_bulk(tmp_path_factory.mktemp("bulk") / "unseen", pictures=600, seed=9)


def places(atlas, unseen, seed=0):
    """Where the unseen poses are found, through the sensor's noise."""
    rng = np.random.default_rng(seed)
    pictures = [atlas.sensor.measure(colour(p), rng) for p in unseen.pictures[:]]
    return [posterior.locate(atlas, atlas.code(picture)) for picture in pictures]


@pytest.mark.parametrize("measured", [False, True])
def test_an_empty_scene_has_a_code_of_unit_noise(tmp_path, measured):
    """In a room, so that there is light; the background's own noise is part of it where it is measured."""
    import worlds

    floor = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
    found = make_bulk(tmp_path / "set", pictures=64, room=(floor,))
    sensor = Sensor(background_frames=2)
    atlas = atlas_build.build(found, sensor, measured_background=measured)
    rng = np.random.default_rng(1)
    codes = []
    for _ in range(400):
        before = atlas.sensor.measure(found.background, rng, frames=2) if measured else None
        codes.append(atlas.code(atlas.sensor.measure(found.background, rng), before))
    codes = np.array(codes)
    low, high = stats.chi2.interval(0.999, codes.size)
    assert low < (codes**2).sum() < high
    assert np.abs(codes.mean(axis=0)).max() < 4.5 / np.sqrt(len(codes))


def test_noise_that_pixels_share_is_part_of_the_codes_noise(tmp_path):
    """Rows, columns, flicker, and what lens and dark charge do: unit noise still, also with fewer frames."""
    import worlds

    floor = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
    found = make_bulk(tmp_path / "set", pictures=64, room=(floor,))
    rough = {"row_noise": 20.0, "column_noise": 10.0, "flicker": 0.01, "vignetting": 0.3, "blur": 0.7}
    sensor = Sensor(frames=8, background_frames=8, dark_current=100.0, exposure_time=1.0, **rough)
    made = atlas_build.build(found, sensor, lamp_drift=1e-9)
    for frames in (8, 2):
        atlas, rng, codes, chances = made.at(frames), np.random.default_rng(1), [], []
        test = Misfits(atlas)
        for _ in range(300):
            before = atlas.sensor.measure(found.background, rng, frames=8)
            difference = atlas.difference(atlas.sensor.measure(found.background, rng), before)
            codes.append(atlas.code_of(difference))
            chances.append(test(difference, codes[-1]).pixels)
        low, high = stats.chi2.interval(0.999, np.size(codes))
        assert low < (np.array(codes) ** 2).sum() < high
        assert np.linalg.norm(np.cov(np.array(codes).T), 2) < (1.0 + np.sqrt(len(codes[0]) / 300)) ** 2 * 1.15
        assert stats.kstest(chances, "uniform").pvalue > 1e-3


def test_a_camera_whose_pictures_share_no_noise_leaves_the_atlas_drifts(tmp_path):
    """Resized pictures have no rows of the camera's: an atlas of noisy rows serves them as one without."""
    found = make_bulk(tmp_path / "set", pictures=64)
    sensor = Sensor(exposure=2e6, frames=4, background_frames=4)
    rough = atlas_build.build(found, replace(sensor, row_noise=5.0, flicker=0.01), lamp_drift=0.01)
    plain = atlas_build.build(found, sensor, lamp_drift=0.01)
    seen = rough.seen_by(sensor)
    assert len(seen.nuisances) == 1
    products = [(one.codes @ one.codes.T) for one in (seen, plain)]
    assert np.allclose(products[0], products[1], rtol=0.02, atol=0.02 * products[1].max())
    with pytest.raises(NlosError, match="cannot take on noise of rows"):
        plain.seen_by(replace(sensor, row_noise=1.0))


DIM = Sensor(full_well=40.0, bits=8)
"""Photons are so few that several of the atlas' poses explain a picture."""


@pytest.mark.parametrize("sensor", [DIM, Sensor(full_well=1000.0, bits=10), Sensor()], ids=["dim", "some", "bright"])
def test_stated_uncertainty_is_true(simulated, unseen, sensor):
    """95 % regions hold the truth in 95 % of the cases, voxels are right as often as they say they are."""
    atlas = atlas_build.build(simulated, sensor, measured_background=False)
    found = places(atlas, unseen)
    apart = np.array([p.position for p in found]) - unseen.positions
    distance = [d @ np.linalg.solve(p.covariance, d) for d, p in zip(apart, found, strict=True)]
    inside = np.sum(np.array(distance) < stats.chi2.ppf(0.95, 3))
    assert stats.binom.cdf(inside, len(found), 0.93) > 1e-3
    right = np.array([p.voxels.argmax() for p in found]) == unseen.voxels
    sure = np.array([p.voxels.max() for p in found])
    spread = np.sqrt((sure * (1.0 - sure)).sum())
    assert abs(right.sum() - sure.sum()) < 3.3 * spread + 2.0


@pytest.mark.parametrize("turning", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_engines_fit_reaches_the_bound(simulated, unseen, tmp_path, turning):
    """Its error is what Cramer and Rao allow, where pictures are sharp: a ball, and a sheet that turns too."""
    if turning:
        angles = (20.0, 20.0, 20.0)
        simulated = make_bulk(tmp_path / "set", radius=0.0, rotation=angles)
        unseen = make_bulk(tmp_path / "unseen", radius=0.0, rotation=angles, pictures=32, seed=9)
    atlas = atlas_build.build(simulated, Sensor(frames=100), measured_background=False)
    synthesis = posterior.Synthesis(atlas, unseen.world())
    rng = np.random.default_rng(4)
    apart = []
    for position, picture in list(zip(unseen.positions, unseen.pictures[:], strict=True))[:32]:
        fit = posterior.polish(synthesis, atlas.code(atlas.sensor.measure(colour(picture), rng)))
        off = fit.position - position
        apart.append(off @ np.linalg.solve(fit.covariance[:3, :3], off) / 3.0)
    low, high = stats.chi2.interval(0.999, 3 * len(apart))
    assert low < 3 * np.sum(apart) < high


def test_evidence_speaks_for_what_is_there(simulated, unseen):
    """A picture with the object is evidence for it, one without against it."""
    atlas = atlas_build.build(simulated, Sensor(), measured_background=False)
    rng = np.random.default_rng(3)
    dark = np.zeros((16, 16, 3), dtype=np.float32)
    empty = posterior.locate(atlas, atlas.code(atlas.sensor.measure(dark, rng)))
    assert empty.evidence < 0.0
    assert min(p.evidence for p in places(atlas, unseen)[:20]) > 0.0


def test_an_atlas_is_kept_in_a_file(simulated, tmp_path):
    """What was written is read."""
    atlas = atlas_build.build(simulated, Sensor())
    atlas_file.save(tmp_path / "a.h5", atlas)
    again = atlas_file.load(tmp_path / "a.h5")
    assert np.array_equal(again.codes, atlas.codes)
    assert (again.sensor, again.grid, again.about) == (atlas.sensor, atlas.grid, atlas.about)


def test_bad_input_is_one_sentence(simulated, tmp_path):
    """Other files, other sizes, NaN."""
    (tmp_path / "a.h5").write_text("no")
    with pytest.raises(NlosError, match=r"a\.h5: is not an atlas file of this software"):
        atlas_file.load(tmp_path / "a.h5")
    with pytest.raises(NlosError, match="no such atlas file"):
        atlas_file.load(tmp_path / "b.h5")
    atlas = atlas_build.build(simulated, Sensor())
    with pytest.raises(NlosError, match="has 8 x 8 pixels, but the atlas is of 16 x 16"):
        atlas.code(np.ones((8, 8, 3), dtype=np.float32))
    with pytest.raises(NlosError, match="holds NaN or infinite values"):
        atlas.code(np.full((16, 16, 3), np.nan, dtype=np.float32))


@pytest.mark.parametrize("frames", [1, 10])
def test_an_atlas_serves_fewer_frames_than_it_was_made_for(tmp_path, frames):
    """What is derived from one of many frames explains pictures as one does that was made for few."""
    import worlds

    floor = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
    found = make_bulk(tmp_path / "set", pictures=256, room=(floor,))
    drifts = {"lamp_drift": 0.01, "ambient_drift": 0.02}
    derived = atlas_build.build(found, Sensor(frames=40), **drifts).at(frames)
    made = atlas_build.build(found, Sensor(frames=frames, exposure=derived.sensor.exposure), **drifts)
    assert derived.sensor == made.sensor
    assert derived.spread == pytest.approx(made.spread)
    picture = derived.sensor.measure(colour(found.pictures[7]), np.random.default_rng(5))
    ours, theirs = (a.logs(a.code(picture, found.background)) for a in (derived, made))
    # Each leaves out directions that move a logarithm by a few hundredths of the noise.
    assert np.abs(ours - theirs).max() < 0.1 + 0.005 * np.abs(theirs).max()
    with pytest.raises(NlosError, match="frames 41: must be from 1 to the 40"):
        atlas_build.build(found, Sensor(frames=40)).at(41)


def test_a_dim_scene_needs_an_atlas_of_its_own(simulated):
    """Where photons are few, noise changes its form, and nothing is derived."""
    atlas = atlas_build.build(simulated, Sensor(frames=10))  # before a bare wall, the empty scene is dark
    with pytest.raises(NlosError, match="electrons in the darkest pixel"):
        atlas.at(1)


def test_what_could_be_a_change_of_light_is_no_evidence(tmp_path):
    """More light from lamp and sky is taken for an object, unless such a change is expected."""
    import worlds

    floor = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
    found = make_bulk(tmp_path / "set", pictures=256, room=(floor,))
    lit = found.background * 1.03 + 0.03 * found.background.mean()
    told = {}
    for drift in (0.0, 0.05):
        atlas = atlas_build.build(found, Sensor(frames=10), lamp_drift=drift, ambient_drift=drift)
        told[drift] = posterior.locate(atlas, atlas.code(lit.astype(np.float32), found.background)).evidence
    assert told[0.0] > 5.0
    assert told[0.05] < 1.0


def test_unknown_strengths_are_integrated_out():
    """The closed form is the average of the likelihood over drawn strengths."""
    rng = np.random.default_rng(0)
    added, hiding = rng.normal(size=(2, 3, 5)) * 0.6
    code = rng.normal(size=5)
    drawn = rng.multivariate_normal(unknown_object.MEAN, unknown_object.COVARIANCE, size=400_000)
    found = unknown_object.AmplitudePrior.of(added, hiding).logs(added @ code, hiding @ code)
    for pose in range(3):
        codes = drawn @ np.stack([added[pose], hiding[pose]])
        likelihoods = np.exp(codes @ code - 0.5 * (codes**2).sum(axis=1))
        error = likelihoods.std() / np.sqrt(len(drawn))
        assert abs(np.exp(found[pose]) - likelihoods.mean()) < 4.0 * error


def test_strengths_are_found():
    """Where the picture is sharp, the posterior mean is what the picture was made with."""
    rng = np.random.default_rng(1)
    added, hiding = 100.0 * rng.normal(size=(2, 1, 8))
    code = 0.3 * added[0] + 0.9 * hiding[0]
    found = unknown_object.AmplitudePrior.of(added, hiding).means(added @ code, hiding @ code)
    np.testing.assert_allclose(found[0], [0.3, 0.9], atol=1e-3)


@pytest.mark.slow
def test_an_object_of_another_size_and_albedo_is_found(tmp_path):
    """A dark ball of two thirds the radius is found by an atlas of a white one that knows of neither."""
    import worlds

    floor = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
    found = make_bulk(tmp_path / "set", pictures=2000, room=(floor,))
    other = make_bulk(tmp_path / "other", pictures=200, seed=9, radius=0.1, albedo=0.4, room=(floor,))
    sensor = Sensor(frames=1000, background_frames=100_000)
    rights = {}
    for unknown in (False, True):
        atlas = atlas_build.build(found, sensor, unknown=unknown)
        answers = places(atlas, other)
        rights[unknown] = np.mean([p.voxels.argmax() for p in answers] == other.voxels)
    assert rights[True] > 0.9
    assert rights[True] > rights[False] + 0.1
