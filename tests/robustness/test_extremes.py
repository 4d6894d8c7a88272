"""Scenes and sets at the far ends of what can be asked: the right answer, or one sentence."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from classify_helpers import colour, make_bulk, plain_atlas

from classify.classifiers import curves, evaluate, models
from classify.inference import atlas_build, bound, detect, posterior, tracker
from classify.pictures import feature_table
from classify.pictures.features import describe
from classify.pictures.physics import PhysicsFeatures
from classify.pictures.sensor import Sensor
from classify.pictures.settings import FeatureSettings, Setup
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.presets import preset


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    return make_bulk(tmp_path_factory.mktemp("bulk") / "set", pictures=400)


def answers(found, pictures, background=None, seed=0):
    rng = np.random.default_rng(seed)
    seen = [found.code(found.sensor.measure(colour(p), rng), background) for p in pictures]
    return [posterior.locate(found, code) for code in seen]


@pytest.mark.parametrize("factor", [1e-20, 1e20])
def test_any_level_of_light_gives_the_same_answers(simulated, factor, tmp_path):
    """A camera is exposed for its scene: only ratios of light count."""
    usual = atlas_build.build(simulated, Sensor(), measured_background=False)
    scaled = dataclasses.replace(
        usual,
        background=usual.background * factor,
        sensor=dataclasses.replace(usual.sensor, exposure=usual.sensor.exposure / factor),
    )
    some = simulated.pictures[:12].astype(np.float64)
    for one, other in zip(answers(usual, some), answers(scaled, some * factor), strict=True):
        np.testing.assert_allclose(other.voxels, one.voxels, atol=2e-2)
        np.testing.assert_allclose(other.position, one.position, atol=2e-2)


@pytest.mark.parametrize("scale", [1e-3, pytest.param(1e3, marks=pytest.mark.slow)])
def test_any_size_of_scene_gives_the_same_answers(simulated, scale, tmp_path):
    """A millimetre room and a kilometre room with lamps to match show the same pictures, and places scale along."""
    found = make_bulk(tmp_path / "scaled", pictures=400, scale=scale)
    np.testing.assert_allclose(found.positions, scale * simulated.positions, rtol=1e-9)
    np.testing.assert_allclose(found.pictures[:20], simulated.pictures[:20], rtol=1e-4)
    usual, scaled = (atlas_build.build(s, Sensor(), measured_background=False) for s in (simulated, found))
    some = simulated.pictures[:12]
    for one, other in zip(answers(usual, some), answers(scaled, some), strict=True):
        assert one.voxels.argmax() == other.voxels.argmax()
        np.testing.assert_allclose(other.position, scale * one.position, rtol=0.02, atol=0.02 * scale)


def test_zero_light_is_one_sentence(tmp_path):
    dark = make_bulk(tmp_path / "dark", pictures=16, power=0.0)
    with pytest.raises(NlosError, match="pictures without light; give it in electrons"):
        atlas_build.build(dark, Sensor())


def test_ambient_light_a_million_times_the_signal_leaves_nothing_to_tell(simulated, tmp_path):
    """Photons of ambient light drown the signal: every voxel is as likely as before, and nothing is found."""
    signal = float((simulated.pictures[:] - simulated.background[..., 0]).max())
    lit = make_bulk(tmp_path / "lit", pictures=100, ambient=1e6 * signal)
    found = atlas_build.build(lit, Sensor(), measured_background=False)
    for place in answers(found, lit.pictures[:20]):
        np.testing.assert_allclose(place.voxels, 0.25, atol=0.01)
        assert abs(place.evidence) < 0.1
    row = detect.detections(found, [1], false_alarm=0.05, count=200)[0]
    assert all(interval.low < 0.1 for interval in row.found)


def test_light_that_nobody_counted_on_is_refused_or_told(simulated):
    """Pictures far beyond the sensor's full well saturate alike, and stay finite."""
    found = atlas_build.build(simulated, Sensor(), measured_background=False)
    glaring = simulated.pictures[:4] * 1e20
    for place in answers(found, glaring):
        assert np.isfinite(place.voxels).all()
        assert np.isfinite(place.position).all()


@pytest.mark.parametrize("shape", [(1, 1, 1), (10, 10, 10)])
def test_one_voxel_and_a_thousand(shape):
    """Codes as far apart as their poses: places are found between them, voxels as often as a neighbour shares one."""
    grid = VoxelGrid(lo=(0.0, 0.0, 0.0), hi=(1.0, 1.0, 1.0), shape=shape)
    rng = np.random.default_rng(0)
    places = rng.uniform(size=(5000, 3))
    voxels = np.array([grid.voxel(p) for p in places])
    found = plain_atlas(300.0 * places, places, voxels, grid)
    best = bound.reachable(found, count=200)
    neighbour = 1 if grid.n_voxels == 1 else 0.5
    assert best.accuracy.high >= neighbour
    assert best.error.high < 0.01
    assert len(best.by_voxel) == grid.n_voxels
    step = tracker.Filter(found, step=0.05).update((300.0 * places[7]).astype(np.float32))
    assert step.voxels.argmax() == voxels[7]


def many_classes(features, classes, each):
    """Features of many voxels, a cloud around each one's own place."""
    grid = VoxelGrid(lo=(0.0, 0.0, 0.0), hi=(1.0, 1.0, 1.0), shape=(classes, 1, 1))
    voxels = np.tile(np.arange(classes), each)
    rng = np.random.default_rng(0)
    middles = rng.uniform(size=(classes, 12))
    values = middles[voxels] + 0.003 * rng.normal(size=(len(voxels), 12))
    labels = np.array(grid.labels)[voxels]
    files = [str(i) for i in range(len(voxels))]
    return dataclasses.replace(features, values=values, labels=labels, voxels=voxels, grid=grid, files=files)


@pytest.fixture(scope="module")
def features(tmp_path_factory):
    from classify_helpers import make_dataset

    return feature_table.extract(make_dataset(tmp_path_factory.mktemp("f") / "d", n=3), FeatureSettings())


@pytest.mark.parametrize("name", ["LDA", "KNN", "CART", "RF", "SVM", "NB"])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_classifiers_take_a_thousand_voxels(features, name):
    # Of SVMs there is one for every pair of classes: of a thousand, half a million.
    many = many_classes(features, {"SVM": 100, "RF": 200}.get(name, 1000), 4)
    point = curves.curves(many, classifiers=[name], counts=[3 * len(np.unique(many.labels))])[0]
    assert point.accuracy.value > 0.3, "a thousand times chance"


def test_one_class_is_one_sentence(features):
    one = dataclasses.replace(features, labels=np.full_like(features.labels, "A"))
    with pytest.raises(NlosError, match="only one class"):
        evaluate.compare([one], ["one.h5"], folds=2)
    with pytest.raises(NlosError, match="only one class"):
        curves.curves(one)
    with pytest.raises(NlosError, match="only one class"):
        models.train(one, "SVM", "paper")


def test_voxels_of_copies_are_one_sentence(features):
    """Linear discriminant analysis divides by how a voxel's pictures vary; no one can learn it from copies."""
    copies = dataclasses.replace(features, values=np.repeat(features.voxels[:, None], 5, axis=1).astype(float))
    for fit in (lambda: models.train(copies, "LDA", "paper"), lambda: curves.curves(copies)):
        with pytest.raises(NlosError, match="pictures of each voxel all have the same features"):
            fit()


@pytest.mark.parametrize("size", [(1, 1), (2048, 2048)])
def test_physics_of_pictures_of_any_size(size):
    height, width = size
    x = np.linspace(-1.0, 1.0, width)
    y = np.linspace(-1.0, 1.0, height)
    picture = (1e-5 / (1.0 + x[None, :] ** 2 + y[:, None] ** 2) ** 2)[..., None].repeat(3, axis=2).astype(np.float32)
    values = PhysicsFeatures(Setup.of(preset("room"))).fit_transform(picture.mean(axis=2)[None])
    assert np.isfinite(values).all()
    for kind in ("global", "spatial-hog"):
        assert np.isfinite(describe(picture, FeatureSettings(set=kind, input="raw"), reference=1.0)).all()


def test_a_ball_wider_than_its_voxel(tmp_path):
    """Its centre alone is inside. Answers are as true as elsewhere."""
    found = make_bulk(tmp_path / "wide", pictures=640, shape=(5, 5, 1), radius=0.13, inside="centre")
    assert found.grid.size[0] < 0.26
    atlas = atlas_build.build(found, Sensor(full_well=100.0), measured_background=False)
    held = [
        posterior.holds(p, t) for p, t in zip(answers(atlas, found.pictures[:100]), found.positions, strict=False)
    ]
    assert np.mean(held) > 0.85


def test_edge_on_and_unlit_objects_are_what_they_look_like_nothing(simulated):
    """A pose that changes nothing has a code of zero: no evidence, no place, no error."""
    codes = np.zeros((50, 4))
    found = plain_atlas(codes, simulated.positions[:50], simulated.voxels[:50], simulated.grid)
    place = posterior.locate(found, np.array([0.3, -1.0, 0.2, 0.8], dtype=np.float32))
    assert abs(place.evidence) < 1e-6
    np.testing.assert_allclose(place.voxels.sum(), 1.0)
    assert np.isfinite(place.covariance).all()
