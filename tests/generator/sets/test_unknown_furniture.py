"""Furniture that nobody knows: where it stands, and what it leaves free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import worlds

from generator.model.errors import NlosError
from generator.model.uncertainty import Furniture
from generator.sets.unknown_furniture import unknown_furniture
from generator.transport import Sphere, World
from generator.transport.parameters import with_parameters

ROOM = {"room": {"x": [-2.0, 2.0], "y": [0.0, 4.0], "z": [-1.4, 1.8]}}


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
