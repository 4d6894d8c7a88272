"""Sets whose scene is drawn at every pose: what they draw, render, keep and verify."""

from __future__ import annotations

import shutil

import h5py
import numpy as np
import pytest
import worlds
from classify_helpers import make_bulk

from generator.jobs.bulk import Engine
from generator.model.errors import NlosError
from generator.model.uncertainty import Uncertainty, offsets
from generator.sets.bulk_set import Bulk
from generator.sets.bulk_settings import Settings
from generator.sets.simulated import SimulatedSet
from generator.transport import Transport
from generator.transport.parameters import with_parameters

FLOOR = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
NAMES = ("spot.aim.x", "camera.view.z", "wall.albedo", "room.albedo", "target.albedo", "target.size")
STATED = Uncertainty(names=NAMES, deviation=(0.02, 0.01, 0.05, 0.1, 0.2, 0.1))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A set of twelve scenes, in parts that were written one after the other."""
    return make_bulk(tmp_path_factory.mktemp("drawn") / "set", pictures=12, room=(FLOOR,), uncertain=STATED)


def test_each_picture_is_of_the_scene_that_its_values_say(drawn):
    world, scene = drawn.world().seen_by(16, 16), drawn.meta["scene"]
    found = SimulatedSet(drawn)
    for record in found.records[::5]:
        changed = with_parameters(world, offsets(scene, record.values))
        engine = Transport(changed, accuracy=1e-3)
        empty = engine.background().astype(np.float32)
        np.testing.assert_array_equal(found.background_of(record), empty)
        np.testing.assert_array_equal(found.picture(record), engine.pictures(record.position, record.rotation)[0])
        assert dict(record.values) == dict(STATED.draw(scene, 0, record.voxel, record.index))
    levels = [found.background_of(record).mean() for record in found.records]
    assert np.std(levels) > 0.05 * np.mean(levels)


def test_a_scene_follows_from_its_pose_alone(drawn):
    engine, numbers = Engine(drawn), np.array([7, 3])
    pictures, backgrounds, values = engine.uncertain(numbers, drawn.positions[numbers], drawn.rotations[numbers])
    np.testing.assert_array_equal(pictures[..., 0], np.array([drawn.pictures[n] for n in numbers]))
    np.testing.assert_array_equal(backgrounds[..., 0], np.array([drawn.backgrounds[n] for n in numbers]))
    np.testing.assert_array_equal(values, drawn.values[numbers])


def test_a_changed_value_is_found(drawn, tmp_path):
    assert drawn.verify() == []
    copy = tmp_path / "set"
    shutil.copytree(drawn.path, copy)
    with h5py.File(next(copy.glob("part-*.h5")), "r+") as file:
        file["values"][3, 0] += 1e-9
    assert any("differ from their hash" in fault for fault in Bulk.open(copy).verify())


def test_a_scene_without_room_for_the_target_is_drawn_again(tmp_path):
    """A sphere in the nearest voxels, half a metre from the wall, that is drawn up to five times as large."""
    large = Uncertainty(names=("target.size",), deviation=(2.0,))
    bulk = make_bulk(tmp_path / "set", pictures=40, radius=0.3, inside="centre", uncertain=large)
    scene = bulk.meta["scene"]
    first = np.array([large.draw(scene, 0, n % 4, n // 4)[0][1] for n in range(40)])
    assert (bulk.values[:, 0] != first).any()
    assert (0.3 * bulk.values[:, 0] <= bulk.positions[:, 1] + 1e-9).all()
    assert bulk.verify() == []


@pytest.mark.parametrize(
    ("more", "words"),
    [({"vary": ("target.albedo=0.3:1",)}, "leave --vary out"), ({"targets": 2}, "leave --targets out")],
)
def test_what_a_drawn_scene_does_not_go_with_is_refused(more, words):
    with pytest.raises(NlosError, match=words):
        Settings(pictures=9, uncertain=STATED, **more)


@pytest.mark.slow
def test_by_command(command, scene_file, tmp_path):
    """Made, continued, and refused: with what the scene lacks, and what is another uncertainty."""
    for name, names in (("good", '["spot.aim.x", "target.size"]'), ("other", '["spot.aim.z", "target.size"]')):
        (tmp_path / f"{name}.toml").write_text(f"version = 1\nnames = {names}\ndeviation = [0.02, 0.1]\n")
    (tmp_path / "none.toml").write_text('version = 1\nnames = ["ambient"]\ndeviation = [0.1]\n')
    words = ("--pictures", "9", "--resolution", "8", "--no-probe", "--workers", "1")

    def made(stated):
        path = tmp_path / "set"
        return command("generator", "bulk", scene_file, "-o", path, *words, "--uncertain", tmp_path / stated)

    refused = made("none.toml")
    assert refused.returncode == 2
    assert "has no ambient light" in refused.stderr
    assert not (tmp_path / "set" / "bulk.toml").exists()
    assert made("good.toml").returncode == 0
    assert "nothing to do" in made("good.toml").stdout
    other = made("other.toml")
    assert (other.returncode, "what is uncertain is not the same there" in other.stderr) == (2, True)
    assert command("generator", "verify", tmp_path / "set").returncode == 0
