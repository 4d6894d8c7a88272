"""Bounds against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from classify_helpers import make_bulk, plain_atlas
from figure_texts import misplaced
from scipy.stats import norm

from classify.inference import atlas_build, bound
from classify.inference.posterior import Synthesis
from classify.pictures.sensor import Sensor
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.transport import Transport

PLACE, TURN = np.array([0.8, 0.9, 0.1]), np.zeros(3)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A bulk set of a sphere before a bare wall."""
    return make_bulk(tmp_path_factory.mktemp("bulk") / "set", pictures=1500)


def line(distance, copies=400):
    """An atlas of two voxels whose pictures lie a distance apart, and nothing else."""
    codes = np.zeros((2 * copies, 3), dtype=np.float32)
    codes[copies:, 1] = distance
    voxels = np.repeat([0, 1], copies)
    positions = np.stack([voxels, 0.0 * voxels, 0.0 * voxels], axis=1).astype(float)
    grid = VoxelGrid(lo=(-0.5, -0.5, -0.5), hi=(1.5, 0.5, 0.5), shape=(2, 1, 1))
    return plain_atlas(codes, positions, voxels, grid)


@pytest.mark.parametrize("distance", [0.3, 1.0, 3.0, 40.0])
def test_two_pictures_are_told_apart_as_two_normal_variables(distance):
    """Accuracy is that of the best test between two normal distributions (Neyman and Pearson 1933)."""
    found = bound.reachable(line(distance), count=800)
    truth = norm.cdf(distance / 2.0)
    assert abs(found.accuracy.value - truth) < 3.3 * math.sqrt(truth * (1.0 - truth) / 800) + 1e-9
    assert found.count == 800
    if distance > 10.0:
        assert found.error.value < 1e-3


@pytest.mark.parametrize(("poses", "grows"), [(800, True), (12000, False)])
def test_too_few_poses_are_told(poses, grows):
    """Two kinds of code on a board whose fields are some noises wide: where poses are rare, neighbours mislead."""
    rng = np.random.default_rng(poses)
    place = rng.random((poses, 2))
    voxels = (np.floor(6.0 * place).sum(axis=1) % 2).astype(np.int64)
    codes = np.zeros((poses, 3))
    codes[:, :2] = 60.0 * place
    grid = VoxelGrid(lo=(-0.5, -0.5, -0.5), hi=(1.5, 0.5, 0.5), shape=(2, 1, 1))
    positions = np.stack([voxels, 0.0 * voxels, 0.0 * voxels], axis=1).astype(float)
    found = bound.reachable(plain_atlas(codes, positions, voxels, grid), count=800)
    assert any("make a larger atlas" in line for line in found.words()) == grows, found.gain
    assert "no method puts more of all pictures" in found.words()[0]


def test_a_handful_of_poses_bounds_nothing():
    with pytest.raises(NlosError, match="an atlas of 2 poses bounds nothing"):
        bound.reachable(line(1.0, copies=1), count=2)
    assert bound.reachable(line(1.0, copies=2), count=4).count == 4


@pytest.mark.parametrize("frames", [1, 16])
def test_strength_is_known_to_the_root_of_the_photons(simulated, frames):
    """With photons alone, and nothing but the object's light, no estimate beats 1 / sqrt(N): all photons count."""
    sensor = Sensor(read_noise=0.0, bits=0, frames=frames)
    synthesis = Synthesis(atlas_build.build(simulated, sensor, measured_background=False), simulated.world())
    made = Transport(simulated.world(), accuracy=1e-3).difference(PLACE, TURN)
    photons = frames * synthesis.atlas.sensor.electrons(made).sum()
    assert bound.limits(synthesis, PLACE, TURN).strength * math.sqrt(photons) == pytest.approx(1.0, rel=0.02)


def test_the_code_keeps_the_pictures_information(simulated):
    """The bound on the position is that of all pixels, by the engine's derivatives and the sensor's variance."""
    synthesis = Synthesis(atlas_build.build(simulated, Sensor(), measured_background=False), simulated.world())
    sensor = synthesis.atlas.sensor
    for place in (PLACE, np.array([1.2, 1.4, -0.1])):
        made = Transport(simulated.world(), accuracy=1e-2).render(place, TURN, derivatives=True)
        slopes = made.derivatives[:3, ..., 0].reshape(3, -1)
        whole = np.sqrt(np.diag(np.linalg.inv((slopes / sensor.variance(made.pixels).ravel()) @ slopes.T)))
        assert bound.limits(synthesis, place, TURN).position == pytest.approx(whole, rel=0.03)


def test_a_ball_that_turns_is_not_seen_to(simulated):
    """Within the engine's accuracy: a turn shows far less than the shift of the rim by as much."""
    synthesis = Synthesis(atlas_build.build(simulated, Sensor(), measured_background=False), simulated.world())
    found = bound.limits(synthesis, PLACE, TURN)
    assert (found.rotation > 5.0 * found.position / 0.15).all()
    assert (found.turned >= found.position * 0.999).all()
    assert found.presence > 10.0
    wanted = norm.isf(0.01) + norm.ppf(0.99)
    assert (found.movement < wanted * math.sqrt(2.0) * found.position * 1.001).all()


def test_what_is_blind_is_infinite():
    """A direction that nothing is known of makes all that share in it unknown, and nothing else."""
    assert bound.deviations(np.diag([4.0, 0.0, 25.0])).tolist() == [0.5, math.inf, 0.2]
    mixed = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert bound.deviations(mixed).tolist() == [math.inf, math.inf, 1.0]
    assert np.isinf(bound.deviations(np.zeros((2, 2)))).all()
    full = np.array([[2.0, 0.3], [0.3, 1.0]])
    assert bound.deviations(full) == pytest.approx(np.sqrt(np.diag(np.linalg.inv(full))))


def test_rates_that_cannot_be_are_one_sentence(simulated):
    """Fewer detections than false alarms are no detection."""
    with pytest.raises(NlosError, match="must be 0 < false < detected < 1"):
        bound.limits(None, PLACE, TURN, false_alarm=0.5, detection=0.4)


def test_the_map_holds_the_bounds_of_its_places(simulated, tmp_path):
    """Each field of the map is the bound there; a picture of it is drawn."""
    synthesis = Synthesis(atlas_build.build(simulated, Sensor()), simulated.world())
    found = bound.over_volume(synthesis, across=3)
    grid = synthesis.atlas.grid
    assert found.presence.shape == (len(found.y), 3)
    place = np.array([found.x[2], found.y[0], 0.5 * (grid.lo[2] + grid.hi[2])])
    there = bound.limits(synthesis, place, np.zeros(3))
    assert found.presence[0, 2] == pytest.approx(there.presence)
    assert found.position[0, 2] == pytest.approx(np.linalg.norm(there.position))
    assert found.movement[0, 2] == pytest.approx(there.movement.max())
    bound.draw(tmp_path / "map.png", synthesis.atlas, found)
    assert (tmp_path / "map.png").stat().st_size > 5000
    assert (tmp_path / "map.svg").is_file()


def test_a_map_is_capped_at_the_volumes_size_and_its_labels_are_seen(tmp_path, drawn):
    """Where nothing is known the bound is infinite: no length beyond the volume's diagonal is on the scale."""
    grid = VoxelGrid(lo=(0.0, 0.4, 0.0), hi=(1.5, 1.9, 0.8), shape=(3, 3, 2))
    atlas = plain_atlas(np.zeros((9, 2), np.float32), np.zeros((9, 3)), np.arange(9), grid)
    x, y = np.linspace(0.25, 1.25, 3), np.linspace(0.65, 1.65, 3)
    lengths = np.array([[0.01, 0.1, 0.5], [1.0, 40.0, math.inf], [0.02, math.nan, 7.0]])
    bound.draw(tmp_path / "map.svg", atlas, bound.Map(x, y, 1.0 / lengths, lengths, 2.0 * lengths))
    [figure] = drawn
    assert misplaced(figure) == []
    diagonal = 100.0 * math.sqrt(1.5**2 + 1.5**2 + 0.8**2)
    for axis in figure.axes[1:3]:
        [image] = axis.images
        assert image.norm.vmax == pytest.approx(diagonal)
        words = image.colorbar.ax.get_xlabel().replace("\n", " ")
        assert words.endswith(f"; capped at the volume's diagonal, {diagonal:.3g}"), words
    for axis in figure.axes[:3]:
        assert [text.get_text() for text in axis.texts] == list(grid.labels[9:]), "of the layer that is drawn"
        for text in axis.texts:
            assert axis.bbox.contains(*text.get_window_extent().min)
            assert axis.bbox.contains(*text.get_window_extent().max)
            assert text.get_path_effects(), "an outline, without which white is not seen on yellow"


def test_the_map_of_a_volume_where_nothing_is_known(tmp_path):
    grid = VoxelGrid(lo=(0.0, 0.4, 0.0), hi=(1.5, 1.9, 0.8), shape=(3, 3, 1))
    atlas = plain_atlas(np.zeros((9, 2), np.float32), np.zeros((9, 3)), np.arange(9), grid)
    unknown = np.full((3, 3), math.nan)
    bound.draw(tmp_path / "map.pdf", atlas, bound.Map(np.arange(3.0), np.arange(3.0), unknown, unknown, unknown))
    assert (tmp_path / "map.pdf").is_file()
