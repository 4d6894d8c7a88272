"""The engines surfel and auto as a user meets them: sweeps, reasons, refusals."""

from __future__ import annotations

import shutil
import signal

import numpy as np
import pytest
from processes import start, wait_for_pictures

from generator.blender.engines import renderers, survey
from generator.blender.scene import blend_file, build, posing, roles
from generator.files.pictures import read_picture
from generator.files.writing import HOST
from generator.model.presets import preset
from generator.sets.dataset import Dataset
from generator.transport import Transport

SMALL = ("--poses", "1", "--resolution", "8", "--workers", "1")


@pytest.fixture(scope="module")
def surfel_dataset(tmp_path_factory, scene_file, command):
    path = tmp_path_factory.mktemp("surfel") / "set"
    result = command("generator", "sweep", scene_file, "-o", path, *SMALL, "--engine", "auto", "--accuracy", "1e-2")
    assert result.returncode == 0, result.stderr
    assert "engine: surfel\n" in result.stdout
    return path


def test_data_set_is_like_any_other(surfel_dataset, command):
    result = command("generator", "verify", surfel_dataset)
    assert result.returncode == 0
    dataset = Dataset.open(surfel_dataset)
    assert dataset.sweep.engine == "surfel"
    assert dataset.sweep.accuracy == 1e-2
    assert "samples" not in dataset.settings
    assert all(pose.samples == 0 for pose in dataset.poses)


def test_pictures_are_those_of_the_integral(surfel_dataset):
    dataset = Dataset.open(surfel_dataset)
    scene = blend_file.open_file(surfel_dataset / "scene.blend")
    transport = Transport(survey.surfel_world(scene, resolution=(8, 8)), accuracy=1e-2)
    for pose in dataset.poses[:3]:
        pixels, _ = read_picture(surfel_dataset / pose.file)
        np.testing.assert_array_equal(pixels, transport.pictures([pose.position], [pose.rotation])[0])


def test_lost_pictures_come_back_the_same(surfel_dataset, scene_file, command, tmp_path):
    copy = tmp_path / "set"
    shutil.copytree(surfel_dataset, copy)
    lost = [copy / pose.file for pose in Dataset.open(copy).poses[::3]]
    for picture in lost:
        picture.unlink()
    result = command("generator", "sweep", scene_file, "-o", copy, "--workers", "2", "--engine", "auto")
    assert result.returncode == 0, result.stderr
    for pose in Dataset.open(copy).poses:
        np.testing.assert_array_equal(read_picture(copy / pose.file)[0], read_picture(surfel_dataset / pose.file)[0])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--engine", "surfel", "--samples", "4"), "samples: means nothing to the engine 'surfel'"),
        (("--engine", "surfel", "--denoise"), "denoise: means nothing to the engine 'surfel'"),
        (("--engine", "surfel", "--accuracy", "1e-12"), "accuracy: 1e-12 must be from 1e-08 to 0.3"),
    ],
)
def test_settings_of_another_engine_are_refused_in_one_sentence(options, words, scene_file, command, tmp_path):
    result = command("generator", "sweep", scene_file, "-o", tmp_path / "set", *SMALL, *options)
    assert result.returncode == 2
    assert words in result.stderr
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "set").exists()


def test_auto_says_what_asks_for_a_dearer_engine(command, tmp_path):
    scene = blend_file.new_file()
    build.build(scene, preset("room", "sheet"))
    target = roles.find(scene, "target")
    tree = target.material_slots[0].material.node_tree
    shader = tree.nodes.new("ShaderNodeBsdfGlossy")
    shader.inputs["Roughness"].default_value = 0.0
    output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    file = tmp_path / "mirror.blend"
    blend_file.save_file(file)
    options = ("--poses", "1", "--resolution", "4", "--workers", "1", "--samples", "1", "--engine", "auto")
    result = command("generator", "sweep", file, "-o", tmp_path / "set", *options)
    assert result.returncode == 0, result.stderr
    assert "engine: patch, because" in result.stdout
    assert "'Target'" in result.stdout
    result = command("generator", "sweep", file, "-o", tmp_path / "other", *SMALL, "--engine", "surfel")
    assert result.returncode == 2
    assert "'surfel' cannot honour" in result.stderr


def test_one_interface_renders_the_target_where_it_stands():
    scene = blend_file.new_file()
    build.build(scene, preset("room", "sphere"))
    posing.move_target(scene, (1.0, 0.75, 1.25), (0.0, 0.0, 0.0))
    with renderers.opened(scene, "surfel", resolution=(8, 8), accuracy=1e-2) as renderer:
        seen, background = renderer.render(), renderer.render(target=False)
        np.testing.assert_allclose(renderer.at((1.0, 0.75, 1.25), (0.0, 0.0, 0.0)), seen, rtol=1e-5)
    assert (seen > background).mean() > 0.5


@pytest.mark.slow
def test_killed_and_resumed_gives_the_same_pixels_and_no_litter(tmp_path, scene_file, command):
    options = ("--poses", "30", "--resolution", "16", "--engine", "surfel", "--accuracy", "1e-2", "--no-probe")
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert command("generator", "sweep", scene_file, "-o", whole, *options, "--workers", "1").returncode == 0
    process = start(scene_file, killed, *options, "--workers", "1")
    wait_for_pictures(killed, 40, process)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert 40 <= len(list(killed.glob("?/*.exr"))) < 270, "killed too late to show anything"
    (killed / "A" / f".0000.exr.{HOST}-{2**22 + 1}.tmp").write_bytes(b"of a worker that was killed")
    result = command("generator", "sweep", scene_file, "-o", killed, *options, "--workers", "2")
    assert result.returncode == 0, result.stderr
    a, b = Dataset.open(whole), Dataset.open(killed)
    assert [pose.pixel_hash for pose in a.poses] == [pose.pixel_hash for pose in b.poses]
    assert not b.verify()
    assert not list(killed.rglob("*.tmp"))
