"""``scene --target FILE``: its unit and its axis are told, asked for and kept."""

from __future__ import annotations

import json

import mesh_files
import pytest

from generator.blender import sweep_worker
from generator.blender.scene import blend_file, roles
from generator.blender.scene.description import read_scene
from generator.files.toml import read_toml


@pytest.fixture
def cube(tmp_path):
    return mesh_files.stl(tmp_path / "cube.stl", 0.001, "Y")


def test_the_size_that_results_is_told(command, cube, tmp_path):
    options = ("--target", cube, "--target-unit", "mm", "--target-up", "Y", "-o", tmp_path / "a.blend")
    result = command("generator", "scene", "room", *options)
    assert "warning: The target is larger" not in result.stdout
    words = "0.3 x 0.2 x 0.5 m (width x depth x height; the file's unit is 0.001 m, its Y axis points up)"
    assert f"target: cube.stl: {words}" in result.stdout.splitlines()


def test_what_is_larger_than_a_voxel_is_warned_of(command, cube, tmp_path):
    """As before a unit could be told: a number in a STL is a metre."""
    result = command("generator", "scene", "room", "--target", cube, "-o", tmp_path / "a.blend", "--json")
    answer = json.loads(result.stdout)
    assert answer["target_size"] == pytest.approx([300.0, 500.0, 200.0])
    assert answer["target_file"]["metres_per_unit"] == 1.0
    assert any("larger than a voxel (0.5 x 0.5 x 1.8 m) along x, y, z" in note for note in answer["notes"])


def test_a_description_keeps_them(command, cube, tmp_path):
    shown = command("generator", "scene", "room", "--target", cube, "--target-unit", "cm", "--show").stdout
    (tmp_path / "my.toml").write_text(shown)
    assert (target := read_toml(tmp_path / "my.toml")["target"])["unit"] == "cm"
    assert target["up"] == "auto"
    options = ("--config", tmp_path / "my.toml", "--target-up", "X", "-o", tmp_path / "a.blend", "--json")
    answer = json.loads(command("generator", "scene", "room", *options).stdout)
    assert answer["target_size"] == pytest.approx([2.0, 5.0, 3.0])


def test_a_manifest_keeps_them_of_a_mesh_only(command, cube, tmp_path):
    """A set of a sheet has no new field, which older versions would refuse."""
    options = ("--target", cube, "--target-unit", "mm", "-o", tmp_path / "a.blend")
    assert command("generator", "scene", "room", *options).returncode == 0
    scene = blend_file.open_file(tmp_path / "a.blend")
    entries = sweep_worker.described_scene(scene, read_scene(scene))
    assert (entries["scene"]["target"]["unit"], entries["scene"]["target"]["up"]) == ("mm", "auto")
    assert entries["target_file"] == roles.target_file(scene)
    assert (entries["target_file"]["metres_per_unit"], entries["target_file"]["up_axis"]) == (0.001, "Z")
    assert command("generator", "scene", "room", "-o", tmp_path / "b.blend").returncode == 0
    scene = blend_file.open_file(tmp_path / "b.blend")
    entries = sweep_worker.described_scene(scene, read_scene(scene))
    assert set(entries) == {"scene"}
    assert not {"unit", "up"} & set(entries["scene"]["target"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--target", "sheet", "--target-up", "X"), "target.up: means nothing to a sheet"),
        (("--target", "CUBE", "--target-unit", "mm", "--set", "target.unit=cm"), "say the same thing twice"),
        (("--target", "CUBE", "--target-unit", "ft"), "--target-unit 'ft': there is none"),
        (("--target", "CUBE", "--set", "target.unit=ft"), "target.unit: 'ft' must be one of auto, m, cm, mm, inch"),
        (("--target", "CUBE", "--set", "target.up=W"), "target.up: 'W' must be one of auto, X, Y, Z"),
    ],
)
def test_bad_ones_are_refused(command, cube, tmp_path, options, words):
    options = [str(cube) if option == "CUBE" else option for option in options]
    result = command("generator", "scene", "room", *options, "-o", tmp_path / "a.blend")
    assert result.returncode == 2
    assert words in result.stderr
    assert not (tmp_path / "a.blend").exists()
