"""``check --mend``: what is spoilt is mended, told and saved, and the scene that was named stays as it is."""

from __future__ import annotations

import json

import pytest

from generator.blender import check
from generator.blender.scene import blend_file, build, roles
from generator.model.presets import preset

QUICK = ("--samples", "16", "--resolution", "8", "--poses", "1", "--engine", "patch")


@pytest.fixture
def spoilt(tmp_path):
    """A room moved off the frame, without voxels, its target hidden, whose light makes two reflections."""
    scene = build.new_scene(preset("room"))
    for obj in scene.objects:
        obj.location.y += 0.5
    roles.find(scene, "target").hide_render = True
    scene.cycles.max_bounces = 1
    del scene[roles.GRID_LO]
    blend_file.save_file(tmp_path / "spoilt.blend")
    return tmp_path / "spoilt.blend"


def test_all_is_mended_and_saved_elsewhere(command, spoilt, tmp_path):
    before = spoilt.read_bytes()
    result = command("generator", "check", spoilt, "--mend", "-o", tmp_path / "mended.blend", *QUICK)
    lines = result.stdout.splitlines()
    assert [line for line in lines if line.startswith("mended: ")] == [
        "mended: align (Align to Wall)",
        "mended: reflections (Allow Three)",
        "mended: show (Show)",
        "mended: voxels (Fit Voxels)",
    ]
    assert spoilt.read_bytes() == before
    scene = blend_file.open_file(tmp_path / "mended.blend")
    assert not {f.fix for f in check.findings(scene)} - {""}
    errors = [line for line in lines if line.startswith("error: ")]
    assert result.returncode == (1 if errors else 0)
    again = command("generator", "check", tmp_path / "mended.blend", *QUICK)
    assert again.returncode == result.returncode
    assert [line for line in again.stdout.splitlines() if line.startswith("error: ")] == errors


def test_only_what_is_named_is_mended(command, spoilt):
    """Into the scene itself, if -o names it."""
    result = command("generator", "check", spoilt, "--json", "--mend", "show", "metres", "-o", spoilt, *QUICK)
    answer = json.loads(result.stdout)
    assert (answer["mended"], answer["refused"], answer["saved"]) == (["show"], {}, str(spoilt))
    assert (result.returncode, answer["errors"] > 0) == (1, True)
    scene = blend_file.open_file(spoilt)
    assert not roles.unseen(scene, roles.find(scene, "target"))
    assert scene.cycles.max_bounces == 1


def test_what_cannot_be_mended_is_told(command, spoilt, tmp_path):
    scene = blend_file.open_file(spoilt)
    wall = roles.find(scene, "relay_wall")
    limit = wall.constraints.new("LIMIT_LOCATION")
    limit.use_min_y, limit.min_y = True, 0.5
    blend_file.save_file(spoilt)
    result = command("generator", "check", spoilt, "--mend", "-o", tmp_path / "mended.blend", *QUICK)
    assert result.returncode == 1
    assert "not mended: align: 'Relay wall'" in result.stdout, result.stdout
    assert "mended: show (Show)" in result.stdout


def test_what_was_meant_is_not_mended_unless_it_is_named():
    """All reflections, as in a real room, are a note."""
    scene = build.new_scene(preset("room"))
    roles.limit_reflections(scene, 6)
    assert check.mend_all(scene, {}) == ([], {})
    assert roles.reflection_order(scene) == 6
    assert check.mend_all(scene, {}, ["reflections"]) == (["reflections"], {})
    assert roles.reflection_order(scene) == 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--mend",), "--mend and -o FILE.blend: give both"),
        (("-o", "x.blend"), "--mend and -o FILE.blend: give both"),
        (("--mend", "-o", "x.txt"), "x.txt: a scene file must end in .blend"),
        (("--mend", "magic", "-o", "x.blend"), "fix 'magic': there is none; choose from metres"),
    ],
)
def test_bad_requests_are_refused_and_save_nothing(command, scene_file, tmp_path, options, words):
    result = command("generator", "check", scene_file, *options, cwd=tmp_path)
    assert result.returncode == 2
    assert words in result.stderr
    assert not list(tmp_path.iterdir())


def test_which_of_two_keeps_a_role_is_named(command, tmp_path):
    """Nothing is written while that is not said."""
    scene = build.new_scene(preset("room"))
    copy = roles.find(scene, "target").copy()
    scene.collection.objects.link(copy)
    blend_file.save_file(tmp_path / "two.blend")
    where = ("check", tmp_path / "two.blend", *QUICK, "-o", tmp_path / "one.blend", "--mend")
    result = command("generator", *where)
    assert result.returncode == 1
    assert f"not mended: keep: choose from {copy.name!r}, 'Target' as keep=OBJECT" in result.stdout
    assert result.stdout.endswith("one.blend: not written, for nothing was mended\n")
    assert not (tmp_path / "one.blend").exists()
    result = command("generator", *where, "keep=Target")
    assert "mended: keep (Keep This One)" in result.stdout, result.stdout
    assert roles.find(blend_file.open_file(tmp_path / "one.blend"), "target").name == "Target"
