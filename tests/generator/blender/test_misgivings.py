"""A new set of a scene in which the check finds errors is begun with --force only, and remembers them."""

from __future__ import annotations

import subprocess
import sys

import pytest
from conftest import ROOT, TINY

from generator.blender.scene import blend_file, roles
from generator.sets.dataset import Dataset

ORDER = "Light makes 2 reflections at most"


@pytest.fixture(scope="module")
def doubtful(tmp_path_factory, scene_file):
    """A scene with one error, and one with two."""
    folder = tmp_path_factory.mktemp("doubtful")
    scene = blend_file.open_file(scene_file)
    roles.limit_reflections(scene, 2)
    blend_file.save_file(folder / "one.blend")
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", 0.5
    blend_file.save_file(folder / "units.blend")
    scene = blend_file.open_file(folder / "one.blend")
    scene[roles.GRID_LO], scene[roles.GRID_HI] = (-1.5, 0.4, 0.4), (0.0, 1.9, 2.2)  # before lamp and camera
    blend_file.save_file(folder / "two.blend")
    return folder


def test_it_is_refused_then_forced_then_resumed(tmp_path, doubtful, command):
    sweep = ("sweep", doubtful / "one.blend", "-o", tmp_path / "set", *TINY)
    done = command("generator", *sweep)
    assert (done.returncode, done.stdout) == (2, "")
    assert ORDER in done.stderr
    assert "--force" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "set").exists()
    done = command("generator", *sweep, "--force", "--shard", "0/2")
    assert done.returncode == 0, done.stderr
    assert f"error: {ORDER}" in done.stdout
    [kept] = Dataset.open(tmp_path / "set").meta["forced"]
    assert kept.startswith(ORDER)
    done = command("generator", *sweep)  # it goes on unasked, and says nothing again
    assert done.returncode == 0, done.stderr
    assert ORDER not in done.stdout
    assert "finished" in done.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ("sweep", *TINY),
        ("sweep", "--poses", "1", "--resolution", "8", "--budget", "1min"),
        ("trajectory", "--frames", "2", "--resolution", "8", "--samples", "1"),
        ("bulk", "--pictures", "9", "--resolution", "8"),
        ("tradeoff", "--poses", "1", "--resolution", "8"),
    ],
    ids=lambda arguments: " ".join(arguments[::5]),
)
def test_every_way_to_begin_a_set_asks(tmp_path, doubtful, command, arguments):
    verb, *options = arguments
    done = command("generator", verb, doubtful / "one.blend", "-o", tmp_path / "set", *options)
    assert done.returncode == 2, done.stdout
    assert ORDER in done.stderr
    assert "--force" in done.stderr


def test_more_than_one_error_is_counted(tmp_path, doubtful, command):
    done = command("generator", "sweep", doubtful / "two.blend", "-o", tmp_path / "set", *TINY, "--engine", "path")
    assert done.returncode == 2
    assert "more, see nlos-generate check)" in done.stderr


def test_units_that_are_no_metres(tmp_path, doubtful, command):
    done = command("generator", "sweep", doubtful / "units.blend", "-o", tmp_path / "set", *TINY)
    assert done.returncode == 2
    assert "A Blender unit is 0.5 m here" in done.stderr


def test_what_the_engine_itself_refuses_comes_first(tmp_path, doubtful, command):
    """Nobody can overrule it, so --force must not be offered for it."""
    scene = blend_file.open_file(doubtful / "one.blend")
    roles.find(scene, "spot").data.shadow_soft_size = 1.0
    blend_file.save_file(tmp_path / "soft.blend")
    done = command("generator", "sweep", tmp_path / "soft.blend", "-o", tmp_path / "set", *TINY)
    assert done.returncode == 2
    assert "cannot honour" in done.stderr
    assert "--force" not in done.stderr


@pytest.mark.parametrize("force", [False, True])
def test_batch_inside_blender_asks_too(tmp_path, doubtful, force):
    options = [*TINY[:-2], *(["--force"] if force else [])]
    code = (
        f"import bpy, runpy, sys; sys.argv = ['blender', '--', '-o', {str(tmp_path / 'b')!r}, *{options!r}];"
        f"bpy.ops.wm.open_mainfile(filepath={str(doubtful / 'one.blend')!r});"
        f"runpy.run_path({str(ROOT / 'generator' / 'batch.py')!r}, run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == (0 if force else 2), done.stderr
    assert (f"error: {ORDER}" in done.stdout) if force else (ORDER in done.stderr)


def test_a_good_scene_is_not_asked_about(tiny_dataset):
    assert "forced" not in Dataset.open(tiny_dataset).meta
