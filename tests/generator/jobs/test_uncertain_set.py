"""Sets whose scene is drawn at every pose: what they draw, render, keep and verify."""

from __future__ import annotations

import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest
import worlds
from classify_helpers import make_bulk

from generator.jobs.bulk import Engine
from generator.model.errors import NlosError
from generator.model.uncertainty import Furniture, Uncertainty, offsets
from generator.sets.bulk_set import Bulk
from generator.sets.bulk_settings import Settings
from generator.sets.simulated import SimulatedSet
from generator.sets.unknown_furniture import unknown_furniture
from generator.transport import Sphere, Transport, World
from generator.transport.parameters import with_parameters

FLOOR = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
NAMES = ("spot.aim.x", "camera.view.z", "wall.albedo", "room.albedo", "target.albedo", "target.size")
ROOM = {"room": {"x": [-2.0, 2.0], "y": [0.0, 4.0], "z": [-1.4, 1.8]}}
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


def test_furniture_stands_in_the_room_and_leaves_lamp_camera_and_target_free():
    scene, place, world = ROOM, np.array([1.0, 1.2, -0.5]), _room_world()
    room = scene["room"]
    for seed in range(40):
        boxes = unknown_furniture(Furniture(boxes=(2, 4)), scene, world, place, np.random.default_rng(seed))
        assert 2 <= len(boxes) <= 4
        corners = np.concatenate([box.triangles.reshape(-1, 3) for box in boxes])
        for axis, name in enumerate("xyz"):
            low, high = room[name]
            assert low - 1e-9 <= corners[:, axis].min()
            assert corners[:, axis].max() <= high
        for box in boxes:
            near = np.abs(box.triangles.reshape(-1, 3)[:, 2] - room["z"][0]).min()
            assert near < 1e-9
        furnished = replace(world, room=(*world.room, *boxes))
        # Raises if something stands in the cone or the view: another test of rays than the one that drew the boxes.
        with_parameters(furnished, {"spot.power": 0.1, "camera.view.x": 1e-6})
        assert _distance(corners, place) > 0.2
    again = unknown_furniture(Furniture(boxes=(2, 4)), scene, world, place, np.random.default_rng(39))
    np.testing.assert_array_equal(again[0].triangles, boxes[0].triangles)


def test_furniture_needs_a_room_and_space():
    world, place, rng = _room_world(), np.array([1.0, 1.2, -0.5]), np.random.default_rng(0)
    with pytest.raises(NlosError, match="finds no place in the room"):
        unknown_furniture(Furniture(boxes=(1, 1), width=(5.0, 6.0)), ROOM, world, place, rng)
    with pytest.raises(NlosError, match="needs a room to stand in"):
        unknown_furniture(Furniture(), {}, world, place, rng)


def _room_world() -> World:
    """A sphere of 0.2 m above the floor of `ROOM`."""
    floor = worlds.quad((-2.0, 0.0, -1.4), (4.0, 0.0, 0.0), (0.0, 4.0, 0.0), 0.5)
    return worlds.world(Sphere(np.zeros(3), 0.2, np.ones(3)), room=(floor,))


def _distance(points, place) -> float:
    return float(np.linalg.norm(points - place, axis=1).min())
