"""The command from a scene and pictures to a calibrated scene, and what it says about bad input."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import generator
from classify.pictures.sensor import Sensor
from generator.blender import corrected
from generator.blender.engines import survey
from generator.blender.scene import blend_file
from generator.blender.scene.description import read_scene
from generator.files.pictures import read_picture, write_picture
from generator.files.toml import from_dict, read_toml
from generator.model.uncertainty import Uncertainty
from generator.transport import Transport
from generator.transport.parameters import with_parameters

OFF = {"spot.aim.x": 0.03, "spot.aim.z": -0.02, "camera.view.x": -0.01, "wall.albedo": -0.05}
PRIOR = """\
version = 1
names = ["spot.aim.x", "spot.aim.z", "camera.view.x", "wall.albedo", "spot.location.y", "target.size"]
deviation = [0.02, 0.02, 0.01, 0.05, 0.03, 0.1]
[furniture]
boxes = [0, 2]
"""


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A scene, and pictures of the room that it is not quite."""
    folder = tmp_path_factory.mktemp("room")
    preset = replace(generator.preset("room", "sphere"), resolution=(12, 12))
    scene = generator.new_scene(preset)
    blend_file.save_file(folder / "room.blend")
    engine = Transport(with_parameters(survey.surfel_world(scene), OFF), accuracy=3e-4)
    empty, placed = engine.background(), engine.render((1.2, 1.0, 1.2), (0.0, 0.0, 0.0)).pixels
    sensor, rng = Sensor().exposed([empty]), np.random.default_rng(0)
    write_picture(folder / "empty.exr", sensor.measure(empty, rng, frames=100), {})
    write_picture(folder / "placed.exr", sensor.measure(placed, rng, frames=100), {})
    (folder / "prior.toml").write_text(PRIOR, encoding="utf-8")
    return folder


@pytest.mark.slow
def test_a_room_is_calibrated(room, tmp_path, command):
    pictures = [room / "empty.exr", f"{room / 'placed.exr'}=1.2,1.0,1.2"]
    options = ["--prior", room / "prior.toml", "--frames", "100", "-o", tmp_path / "out", "--json"]
    result = command("classify", "calibrate", room / "room.blend", *pictures, *options)
    assert result.returncode == 0, result.stderr
    answer = json.loads(result.stdout)
    found = {one["name"]: one for one in answer["fitted"]}
    for name, off in OFF.items():
        assert abs(found[name]["offset"] - off) < 4.0 * found[name]["deviation"], name
    assert "spot.location.y" in answer["undetermined"]
    assert found["spot.aim.x"]["deviation"] < 0.005
    assert answer == json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8")) | {
        "files": answer["files"]
    }
    uncertainty = from_dict(Uncertainty, read_toml(tmp_path / "out" / "uncertainty.toml"))
    assert uncertainty.names == tuple(name for name in found if "." in name and not name.startswith("place"))
    assert uncertainty.deviation[0] == pytest.approx(found["spot.aim.x"]["deviation"])
    assert uncertainty.furniture.boxes == (0, 2)
    calibrated = read_scene(corrected.opened(tmp_path / "out" / "scene.blend"))
    assert calibrated.spot.aim[0] == pytest.approx(0.3 + found["spot.aim.x"]["offset"], abs=1e-5)
    residual, _ = read_picture(tmp_path / "out" / "residual-empty.exr")
    assert residual.std() < 0.01 * read_picture(room / "empty.exr")[0].mean()


@pytest.mark.slow
def test_a_picture_of_another_room_is_told(room, tmp_path, command):
    pixels, _ = read_picture(room / "empty.exr")
    write_picture(tmp_path / "other.exr", np.ascontiguousarray(pixels[:, ::-1]), {})
    options = ["--prior", room / "prior.toml", "-o", tmp_path / "out"]
    result = command("classify", "calibrate", room / "room.blend", tmp_path / "other.exr", *options)
    assert result.returncode == 1
    assert "something differs that was not fitted" in result.stdout.replace("\n", " ")


@pytest.mark.parametrize(
    ("scene", "pictures", "options", "words"),
    [
        ("room.blend", ["empty.exr=1,2,3"], [], "empty scene"),
        ("room.exr", ["empty.exr"], [], "must end in .blend"),
        ("none.blend", ["empty.exr"], [], "no such scene file"),
        ("room.blend", ["empty.exr"], ["--black", "2"], "--black 2"),
        ("room.blend", ["none.exr"], [], "no such picture"),
    ],
)
def test_bad_input_is_said_in_a_sentence(room, tmp_path, command, scene, pictures, options, words):
    named = [str(room / picture) for picture in pictures]
    result = command("classify", "calibrate", room / scene, *named, "-o", tmp_path / "out", *options)
    assert result.returncode == 2
    assert words in result.stderr.replace("\n", " ")
    assert not (tmp_path / "out").exists()
