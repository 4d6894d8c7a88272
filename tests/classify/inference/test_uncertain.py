"""Answers in a scene that is not known exactly: closed forms, and regions that hold over drawn scenes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import worlds
from classify_helpers import make_bulk, plain_atlas
from scipy import stats

from classify.inference import answerer, atlas_build, atlas_file, evaluation
from classify.inference.posterior import REACH, holds, locate
from classify.inference.tracker import Filter
from classify.inference.uncertain import Backgrounds, Uncertain, fitted
from classify.pictures.sensor import Sensor
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.uncertainty import Uncertainty
from generator.sets.simulated import SimulatedSet

FLOOR = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
STATED = Uncertainty(
    names=("spot.aim.x", "camera.view.x", "room.albedo", "target.albedo", "target.size"),
    deviation=(0.02, 0.01, 0.05, 0.2, 0.1),
)
COUNT = 200
GRID = VoxelGrid(lo=(0.0, 0.0, 0.0), hi=(1.0, 1.0, 1.0), shape=(2, 1, 1))


def uncertain_atlas(n=400, k=4, r=2, p=2, seed=0):
    """An atlas of random codes, each with its own scatter and its own slopes."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(size=(n, 3))
    codes = np.concatenate([6.0 * positions, rng.normal(size=(n, k - 3))], axis=1)
    slopes, scatter = (rng.normal(size=(n, count, k)).astype(np.float32) for count in (p, r))
    own = Uncertain(slopes, scatter, rng.normal(size=(p, k)).astype(np.float32), np.sort(rng.uniform(size=100)))
    return replace(plain_atlas(codes, positions, GRID.voxels(positions), GRID), uncertain=own)


def test_likelihoods_are_those_of_normal_codes():
    atlas, code = uncertain_atlas(n=20), np.array([1.0, 2.0, 3.0, -1.0], dtype=np.float32)
    logs = atlas.logs(np.stack([code, 2.0 * code]))
    for row, picture in enumerate((code, 2.0 * code)):
        empty = stats.multivariate_normal(np.zeros(4), np.eye(4)).logpdf(picture)
        for pose in range(20):
            spread = np.eye(4) + atlas.uncertain.scatter[pose].T @ atlas.uncertain.scatter[pose]
            density = stats.multivariate_normal(atlas.codes[pose], spread)
            assert logs[row, pose] == pytest.approx(density.logpdf(picture) - empty, rel=1e-3, abs=1e-3)


def test_a_fit_finds_what_the_background_tells_and_what_it_does_not():
    """Codes that are linear in two hidden values, of which the background shows one, and in the position."""
    rng, n = np.random.default_rng(1), 2000
    positions, hidden = rng.uniform(-1.0, 1.0, size=(n, 3)), rng.normal(size=(n, 2))
    shown = np.outer(hidden[:, 0], np.array([3.0, 0.0, 4.0, 0.0, 0.0]))
    strength = 2.0 + positions[:, :1]
    effects = np.array([[1.0, 0.0, 2.0], [0.0, 3.0, 0.0]])
    changes = 0.5 + strength * (hidden @ effects) + 0.1 * rng.normal(size=(n, 3))
    directions = Backgrounds.of(shown, 0.01)
    places = shown @ directions.basis.T
    shift, found = fitted(changes, positions, hidden, places, directions)
    assert found.slopes.shape[1] == 1
    assert np.sqrt(((shift - 0.5) ** 2).mean()) < 0.1
    sign = np.sign(directions.basis[0, 0])
    scale = hidden[:, 0].std()
    wanted = sign * scale * strength * effects[0]
    assert np.sqrt(((found.slopes[:, 0] - wanted) ** 2).mean()) < 0.1
    covariances = np.einsum("nri,nrj->nij", found.scatter, found.scatter)
    wanted = (strength**2)[:, :, None] * np.outer(effects[1], effects[1]) + 0.01 * np.eye(3)
    assert worlds.error(covariances, wanted) < 0.1


def test_a_measured_background_moves_the_codes():
    atlas = uncertain_atlas(k=6)
    picture = np.full((1, 6, 3), 40.0, dtype=np.float32)
    atlas = replace(atlas, background=np.full((1, 6), 50.0))
    places = atlas.uncertain.basis @ atlas.shift(picture)
    moved = atlas.codes + np.einsum("p,npk->nk", places, atlas.uncertain.slopes)
    np.testing.assert_allclose(atlas.given(picture).codes, moved, rtol=1e-4, atol=1e-3)
    assert atlas.given(None) is atlas
    with pytest.raises(NlosError, match="measured background is needed"):
        atlas.difference(picture)


def test_regions_have_the_posteriors_own_shape():
    atlas, rng = uncertain_atlas(n=2000, seed=4), np.random.default_rng(5)
    held = []
    for pose in rng.integers(2000, size=400):
        code = atlas.example(int(pose), rng) + rng.normal(size=4)
        place = locate(atlas, code.astype(np.float32), without=int(pose))
        held.append(holds(place, atlas.positions[pose]))
    assert place.reach != REACH
    assert stats.binomtest(sum(held), len(held), 0.95).pvalue > 1e-3


def test_files_and_what_does_not_go_with_it(tmp_path):
    atlas = uncertain_atlas()
    atlas_file.save(tmp_path / "a.atlas", atlas)
    again = atlas_file.load(tmp_path / "a.atlas")
    for name in ("slopes", "scatter", "basis", "left"):
        np.testing.assert_array_equal(getattr(again.uncertain, name), getattr(atlas.uncertain, name))
    with pytest.raises(NlosError, match="is of an uncertain scene"):
        Filter(atlas, step=0.1)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A set of drawn scenes for an atlas, and one to ask about."""
    folder = tmp_path_factory.mktemp("uncertain")
    more = {"room": (FLOOR,), "uncertain": STATED}
    return (
        make_bulk(folder / "set", pictures=1000, **more),
        make_bulk(folder / "asked", pictures=COUNT, seed=9, **more),
        make_bulk(folder / "known", pictures=1000, room=(FLOOR,)),
    )


@pytest.mark.slow
@pytest.mark.parametrize("frames", [1, 100])
def test_regions_hold_over_drawn_scenes(drawn, frames):
    """The atlas of the stated scene alone is sure of wrong places, and says that pictures do not fit."""
    simulated, asked, known = drawn
    answers = {
        name: evaluation.run(atlas_build.build(bulk, Sensor(frames=frames)), SimulatedSet(asked), empty=300)
        for name, bulk in (("drawn", simulated), ("known", known))
    }
    held = {name: int(one.inside.sum()) for name, one in answers.items()}
    assert stats.binomtest(held["drawn"], COUNT, 0.95).pvalue > 1e-3
    if frames == 100:
        assert held["known"] < held["drawn"] - COUNT // 10
    assert answers["drawn"].doubts == ()
    assert answers["drawn"].false_alarms().low <= 0.02


@pytest.mark.slow
def test_fewer_frames_of_an_atlas_are_those_of_one_made_so(drawn):
    simulated, asked, _ = drawn
    many, few = (atlas_build.build(simulated, Sensor(frames=frames)) for frames in (100, 10))
    sensor = few.sensor
    for made in (many.at(10), few):
        assert made.sensor.frames == 10
    derived = evaluation.run(many.at(10), SimulatedSet(asked, 100), empty=0)
    built = evaluation.run(replace(few, sensor=sensor), SimulatedSet(asked, 100), empty=0)
    np.testing.assert_allclose(derived.places[7].voxels, built.places[7].voxels, atol=0.1)
    assert abs(int(derived.inside.sum()) - int(built.inside.sum())) <= 5


@pytest.mark.slow
def test_a_background_of_another_room_is_told(drawn, tmp_path):
    half = worlds.quad((-2.0, 0.0, -1.0), (1.5, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
    other = make_bulk(tmp_path / "other", pictures=12, seed=3, room=(half,))
    answers = evaluation.run(atlas_build.build(drawn[0], Sensor(frames=10)), SimulatedSet(other), empty=0)
    assert any("more than what was stated as uncertain" in words for words in answers.doubts)


@pytest.mark.slow
def test_a_live_look_answers_as_locate_does(drawn, tmp_path):
    """Also of a scene that is twice as bright, which is exposed half as long."""
    simulated, asked, _ = drawn
    atlas_file.save(tmp_path / "a.atlas", atlas_build.build(simulated, Sensor(frames=10)))
    atlas, found = atlas_file.load(tmp_path / "a.atlas"), SimulatedSet(asked)
    live = answerer.opened(tmp_path / "a.atlas")
    answers = []
    for factor in (1.0, 2.0):
        for record in found.records[:5]:
            background, picture = (np.float32(factor) * one(record) for one in (found.background_of, found.picture))
            live.look_at(
                answerer.Seen(background=background, grid=asked.grid, target="sphere", colour_space="Rec.709")
            )
            assert live.doubts == []
            said = live.answer(picture - background)
            expected = locate(atlas.given(said.background), atlas.code(said.picture, said.background))
            np.testing.assert_allclose(said.place.position, expected.position, rtol=1e-6)
            answers.append(said.place.position)
    np.testing.assert_allclose(answers[:5], answers[5:], atol=0.02)
