"""A trajectory along the timeline, from the command line."""

from __future__ import annotations

import numpy as np
import pytest

from generator.blender.scene import blend_file, roles
from generator.sets.dataset import Dataset

SOME = ("--engine", "surfel", "--resolution", "8", "--accuracy", "1e-2", "--workers", "1")


@pytest.fixture(scope="module")
def animated(tmp_path_factory, scene_file):
    """A room whose sheet moves along x from frame 1 to frame 9, evenly."""
    scene = blend_file.open_file(scene_file)
    target = roles.find(scene, "target")
    for frame, x in ((1, 1.2), (9, 1.6)):
        target.location = (x, 1.2, 1.3)
        target.keyframe_insert("location", frame=frame)
    action = target.animation_data.action
    bags = [b for layer in action.layers for strip in layer.strips for b in strip.channelbags]
    for curve in (c for bag in bags for c in bag.fcurves):
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    scene.frame_start, scene.frame_end, scene.frame_step, scene.render.fps = 1, 9, 2, 30
    path = tmp_path_factory.mktemp("animated") / "walk.blend"
    blend_file.save_file(path)
    return path


def test_a_trajectory_follows_the_timeline(animated, tmp_path, command):
    walk = tmp_path / "walk"
    done = command("generator", "trajectory", animated, "-o", walk, "--timeline", *SOME)
    assert done.returncode == 0, done.stderr
    dataset = Dataset.open(walk)
    assert dataset.settings["timeline"] == [1, 9, 2]
    assert dataset.settings["frames"] == 5
    assert dataset.meta["frames_per_second"] == 30.0
    assert not {"pace", "poses", "rotation"} & set(dataset.settings)
    expected = [(1.2 + 0.1 * k, 1.2, 1.3) for k in range(5)]
    np.testing.assert_allclose([record.position for record in dataset.records], expected, atol=1e-6)
    assert [record.rotation for record in dataset.records] == [(0.0, 0.0, 0.0)] * 5
    for again in (("--timeline",), ("--timeline", "1:9:2"), ()):
        done = command("generator", "trajectory", animated, "-o", walk, *again)
        assert "nothing to do" in done.stdout, done.stderr
    for other, words in (
        (("--timeline", "1:9"), "timeline is [1, 9, 2] there and [1, 9, 1] here"),
        (("--frames", "6"), "frames is 5 there and 6 here"),
    ):
        done = command("generator", "trajectory", animated, "-o", walk, *other)
        assert done.returncode == 2
        assert words in done.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--timeline", "9:1"), "must begin before it ends"),
        (("--timeline", "1"), "must read FIRST:LAST or FIRST:LAST:STEP"),
        (("--timeline", "--frames", "3"), "--frames: follows from the animation"),
        (("--timeline", "--pace", "0.1"), "--pace: follows from the animation"),
        (("--timeline", "20:30"), "'Target' stands still from frame 20 to frame 30"),
    ],
)
def test_what_does_not_go_with_a_timeline_is_refused(animated, tmp_path, command, options, words):
    done = command("generator", "trajectory", animated, "-o", tmp_path / "walk", *options, *SOME)
    assert done.returncode == 2
    assert words in done.stderr
    assert not (tmp_path / "walk").exists()


def test_a_walk_that_was_drawn_is_not_taken_for_a_timeline(scene_file, animated, tmp_path, command):
    walk = tmp_path / "walk"
    assert command("generator", "trajectory", scene_file, "-o", walk, "--frames", "2", *SOME).returncode == 0
    done = command("generator", "trajectory", scene_file, "-o", walk, "--timeline")
    assert done.returncode == 2
    assert "holds no trajectory of a timeline" in done.stderr
