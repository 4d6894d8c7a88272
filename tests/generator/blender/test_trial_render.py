"""What a few pictures tell of a sweep's time."""

import pytest

from generator.blender.trial_render import SAMPLES, samples_of


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
