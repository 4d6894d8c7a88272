"""Features of physics: what they are made of, that they find an element, and that no picture breaks them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from classify_helpers import make_bulk, make_dataset, make_seen, picture_of
from scipy.stats import spearmanr
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.pipeline import make_pipeline

from classify.cli.main import main
from classify.pictures import feature_table, physics
from classify.pictures.features import describe
from classify.pictures.physics import PhysicsFeatures
from classify.pictures.sensor import Camera, Sensor
from classify.pictures.settings import FeatureSettings, Setup
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.sets.simulated import SimulatedSet, open_set

SCENE = preset("room")
SETUP = Setup.of(SCENE)


def features(pictures, **settings):
    return PhysicsFeatures(SETUP, SCENE.reference_radiance, **settings).transform(pictures)


def column(values, name):
    return values[:, physics.names().index(name)]


def test_an_element_is_found_where_it_is():
    """A sheet that faces the wall, anywhere in the grid.

    How far it is stays open, as no picture tells a large far one from a small near one; but the order is kept.
    """
    rng = np.random.default_rng(0)
    places = rng.uniform(SCENE.grid.lo, SCENE.grid.hi, size=(60, 3))
    found = features([picture_of(SCENE, place) for place in places])
    for axis, name in enumerate("xyz"):
        told = column(found, f"fit_{name}")
        assert spearmanr(told, places[:, axis]).statistic > 0.85
        if name != "y":
            assert np.sqrt(np.mean((told - places[:, axis]) ** 2)) < SCENE.grid.size[axis] / 1.8
    assert column(found, "fit_share").min() > 0.95


def test_level_falls_with_distance_and_shape_does_not_know_of_brightness():
    near, far = (picture_of(SCENE, (1.0, y, 1.3)) for y in (0.6, 1.8))
    found = features([near, far, 1000.0 * near])
    level = column(found, "level")
    assert level[0] > level[1]
    # Far above the floor the level is a logarithm.
    assert level[2] - level[0] == pytest.approx(np.log(1000.0), rel=1e-3)
    for name in physics.names():
        if name.startswith("shape"):
            assert column(found, name)[2] == pytest.approx(column(found, name)[0], abs=1e-9)


def test_shape_is_made_of_orthonormal_polynomials():
    """A picture of one polynomial has that coefficient and no other."""
    across = np.linspace(-1.0, 1.0, 64)[None, :] * np.ones((64, 1))
    found = features([across])[0]
    names = physics.names()
    shapes = {name: found[names.index(name)] for name in names if name.startswith("shape")}
    assert shapes.pop("shape_0_1") == pytest.approx(1.0, abs=1e-3)
    assert max(map(abs, shapes.values())) < 1e-3


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 3), (6, 6), (200, 64)])
@pytest.mark.parametrize("value", [0.0, 1.0, -1.0, 1e-300, 1e-20, 1e20, 1e300])
def test_features_of_any_picture_are_finite(shape, value):
    found = features(np.full((1, *shape), value))
    assert np.isfinite(found).all()
    assert found.shape == (1, len(physics.names()))


def test_features_of_noise_are_finite_and_unsure():
    noise = np.random.default_rng(1).normal(size=(4, 32, 32))
    found = features(noise)
    assert np.isfinite(found).all()
    assert column(found, "fit_spread").min() > 0.3  # metres: it may be anywhere


@pytest.mark.parametrize(
    ("pictures", "words"),
    [
        (np.full((1, 4, 4), np.nan), "NaN or infinite"),
        (np.full((1, 4, 4), np.inf), "NaN or infinite"),
        (np.zeros((4, 4)), r"must have shape \(n, height, width\)"),
        (np.zeros((0, 4, 4)), "must have shape"),
    ],
)
def test_what_is_no_picture_is_refused(pictures, words):
    with pytest.raises(NlosError, match=words):
        features(pictures)


def test_a_setup_that_cannot_be_is_refused():
    with pytest.raises(NlosError, match="low before high"):
        replace(SETUP, watched=(1.0, 0.0, 0.0, 1.0))
    with pytest.raises(NlosError, match="in front of the wall"):
        replace(SETUP, lo=(0.8, -0.1, 0.4))
    with pytest.raises(NlosError, match="need to know the scene's setup"):
        describe(np.zeros((4, 4, 3)), FeatureSettings(set="physics"), reference=1.0, background=np.zeros((4, 4, 3)))


def test_it_is_a_step_of_a_pipeline():
    rng = np.random.default_rng(2)
    places = rng.uniform(SCENE.grid.lo, SCENE.grid.hi, size=(180, 3))
    pictures = np.array([picture_of(SCENE, place) for place in places])
    near = places[:, 1] < 1.15
    model = make_pipeline(PhysicsFeatures(SETUP, SCENE.reference_radiance), LinearDiscriminantAnalysis())
    assert model.fit(pictures[::2], near[::2]).score(pictures[1::2], near[1::2]) > 0.9


def test_a_data_set_brings_its_own_setup(tmp_path):
    made = feature_table.extract(make_dataset(tmp_path / "set", n=2), FeatureSettings(set="physics"))
    assert made.settings.setup == SETUP
    assert made.names == physics.names()
    feature_table.write(tmp_path / "f.h5", made)
    again = feature_table.read(tmp_path / "f.h5")
    assert again.settings == made.settings
    assert np.array_equal(again.values, made.values)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A bulk set of a sphere before a bare wall."""
    return make_bulk(tmp_path_factory.mktemp("bulk") / "set", pictures=64)


def test_a_simulated_set_reads_like_a_data_set_of_the_same_pictures(simulated, tmp_path):
    seen = make_seen(tmp_path / "seen", simulated, poses=4)
    as_one = SimulatedSet(simulated, 16)
    assert [(r.voxel, r.index, r.position) for r in as_one.records] == [
        (r.voxel, r.index, r.position) for r in seen.records
    ]
    settings = FeatureSettings()
    ours, theirs = (feature_table.extract(one, settings) for one in (as_one, seen))
    assert np.array_equal(ours.values, theirs.values)
    assert np.array_equal(ours.labels, theirs.labels)
    assert Camera(as_one, Sensor()).sensor == Camera(seen, Sensor()).sensor


def test_more_pictures_than_there_are_is_one_sentence(simulated, tmp_path, capsys):
    with pytest.raises(NlosError, match="holds 64 pictures, so 65 cannot be taken"):
        SimulatedSet(simulated, 65)
    make_dataset(tmp_path / "set", n=1)
    with pytest.raises(NlosError, match="is no simulated set"):
        open_set(tmp_path / "set", 5)
    assert main(["features", str(tmp_path / "set"), "-o", str(tmp_path / "f.h5"), "--count", "5"]) == 2
    assert "is no simulated set" in capsys.readouterr().err
    assert not (tmp_path / "f.h5").exists()


def test_features_of_a_simulated_set_from_the_shell(simulated, tmp_path, capsys):
    out = tmp_path / "f.h5"
    assert main(["features", str(simulated.path), "-o", str(out), "--set", "physics", "--count", "12"]) == 0
    assert "12 pictures, 28 features each (physics, difference)" in capsys.readouterr().out
    assert feature_table.read(out).values.shape == (12, 28)
