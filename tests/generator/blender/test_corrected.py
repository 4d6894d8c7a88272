"""Scenes corrected by what a calibration found: their light is that of the world with the same offsets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import generator
from generator.blender import corrected
from generator.blender.engines import survey
from generator.blender.scene import blend_file, roles
from generator.blender.scene.description import read_scene
from generator.files.toml import dump_toml, from_dict, read_toml, to_dict
from generator.model.errors import NlosError
from generator.model.scene import Scene
from generator.transport import Transport
from generator.transport.parameters import with_parameters
from generator.transport.world_file import load_world

OFFSETS = {
    "spot.location.x": 0.05,
    "spot.location.y": -0.07,
    "spot.aim.x": 0.02,
    "spot.aim.z": -0.03,
    "spot.half_angle": 0.2,
    "spot.power": 0.1,
    "camera.location.x": 0.03,
    "camera.location.y": -0.05,
    "camera.view.x": 0.02,
    "camera.view.z": -0.01,
    "wall.albedo": -0.1,
    "room.albedo": 0.05,
    "target.albedo": -0.2,
    "target.size": 0.1,
}


def scene(**changes):
    return replace(generator.preset("room", "sphere"), resolution=(16, 16), **changes)


@pytest.mark.parametrize("suffix", [".blend", ".toml"])
def test_a_corrected_scene_has_the_corrected_light(tmp_path, suffix):
    source, result = tmp_path / f"given{suffix}", tmp_path / f"corrected{suffix}"
    if suffix == ".blend":
        generator.new_scene(scene())
        blend_file.save_file(source)
    else:
        source.write_text(dump_toml(to_dict(scene())), encoding="utf-8")
    described = corrected.read(source, tmp_path / "world.npz", (16, 16))
    corrected.write(source, result, OFFSETS)
    after = read_scene(corrected.opened(result))
    expected = with_parameters(load_world(tmp_path / "world.npz"), OFFSETS)
    got = survey.surfel_world(corrected.opened(result))
    pose = (1.5, 1.0, 1.3), (0.0, 0.0, 0.0)
    one, other = (Transport(world, accuracy=1e-3).render(*pose).pixels for world in (got, expected))
    np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4 * other.max())
    assert after.camera.location == pytest.approx((-1.07, 2.95, 1.4))
    assert after.spot.power == pytest.approx(1100.0)
    assert from_dict(Scene, described).spot.power == pytest.approx(1000.0)
    if suffix == ".toml":
        assert from_dict(Scene, read_toml(result)).grid == scene().grid


def test_the_skys_light_is_corrected():
    built = generator.new_scene(scene().with_ambient(2e-3))
    corrected.correct(built, {"ambient": 0.5})
    assert read_scene(built).ambient == pytest.approx(3e-3)


def test_a_lamp_that_is_held_is_no_silent_failure():
    built = generator.new_scene(scene())
    limit = roles.find(built, "spot").constraints.new("LIMIT_LOCATION")
    limit.use_min_x, limit.min_x, limit.use_max_x, limit.max_x = True, -1.0, True, -1.0
    with pytest.raises(NlosError, match="lamp would not be as it was found"):
        corrected.correct(built, {"spot.location.x": 0.05})


def test_a_surface_that_is_not_lambertian_keeps_its_material():
    built = generator.new_scene(scene(target=replace(scene().target, gloss=0.3)))
    with pytest.raises(NlosError, match="glossy"):
        corrected.correct(built, {"target.albedo": -0.1})
