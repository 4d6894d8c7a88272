"""What a few pictures tell of a sweep's time."""

import contextlib
import time

import pytest

from generator.blender import trial_render
from generator.blender.engines import renderers
from generator.blender.scene import blend_file
from generator.blender.trial_render import SAMPLES, samples_of
from generator.model.settings import Sweep


@pytest.mark.parametrize("size", [(1, 1), (8, 8), (16, 12), (64, 64), (100, 20), (256, 256)])
def test_small_pictures_are_measured_by_as_many_rays(size):
    """Of 8 x 8 pixels, 48 samples take less time than starting a render: a sweep's would be told ten times too short,
    or too long.
    """
    few, many = samples_of(size)
    rays = size[0] * size[1]
    for samples, usual in ((few, SAMPLES[0]), (many, SAMPLES[1])):
        assert samples >= usual
        assert samples * rays > 0.7 * usual * 64 * 64
        assert samples == usual or samples * rays < 1.5 * usual * 64 * 64
    assert many / few == SAMPLES[1] / SAMPLES[0]


@pytest.mark.parametrize(
    ("engine", "more"),
    [("patch", {}), ("patch", {"vary": ("wall.albedo=0.4:0.9",)}), ("surfel", {"targets": 2})],
    ids=["one for all", "values vary", "two targets"],
)
def test_the_opening_of_an_engine_counts_where_each_pose_needs_its_own(monkeypatch, scene_file, engine, more):
    delay, opened = 0.4, renderers.opened

    @contextlib.contextmanager
    def slowly(*arguments, **settings):
        time.sleep(delay)
        with opened(*arguments, **settings) as renderer:
            yield renderer

    monkeypatch.setattr(renderers, "opened", slowly)
    monkeypatch.setattr(trial_render, "_PIXELS", 64)  # few samples
    scene = blend_file.open_file(scene_file)
    sweep = Sweep(engine=engine, resolution=(8, 8), **more)
    found = trial_render.trial_render(scene, sweep, share=(0, 9))
    assert all((seconds > delay) == bool(more) for seconds in found.seconds), found.seconds
