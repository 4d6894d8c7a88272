"""Pictures of a calibration, as they are named and read."""

from __future__ import annotations

import numpy as np
import pytest

from classify.calibration.measured import Measured, place, read
from classify.pictures.sensor import Sensor
from generator.files.pictures import write_picture
from generator.model.errors import NlosError


@pytest.fixture
def folder(tmp_path):
    rng = np.random.default_rng(0)
    for name in ("a", "b", "with"):
        write_picture(tmp_path / f"{name}.exr", rng.uniform(1.0, 2.0, (4, 5, 3)).astype(np.float32), {})
    np.save(tmp_path / "grey.npy", rng.uniform(1.0, 2.0, (4, 5)))
    np.save(tmp_path / "small.npy", np.ones((4, 4)))
    np.save(tmp_path / "nan.npy", np.full((4, 5), np.nan))
    write_picture(tmp_path / "wide.exr", np.ones((4, 5, 3), dtype=np.float32), {"colour_space": "Rec.2020"})
    (tmp_path / "x=1,2,3").write_bytes(b"")
    return tmp_path


def test_places_stand_behind_the_last_equals_sign(folder):
    assert place("a=b.exr=1,2,3.5")[0].name == "a=b.exr"
    assert place("a.exr=1,2,3.5")[1].position == (1.0, 2.0, 3.5)
    assert place("a.exr=1,2,3,10,20,30")[1].rotation == (10.0, 20.0, 30.0)
    assert place(str(folder / "x=1,2,3")) == (folder / "x=1,2,3", None)


def test_empty_pictures_are_averaged_and_count_their_frames(folder):
    sensor = Sensor(exposure=1000.0, frames=10, background_frames=50)
    seen = read([str(folder / "a.exr"), f"{folder / 'with.exr'}=1,1,1", str(folder / "grey.npy")], sensor)
    assert seen.frames == (100, 10)
    assert seen.pictures.shape == (2, 4, 5)
    variance = seen.variance(seen.pictures)
    electrons = 1000.0 * seen.pictures[1]
    step = sensor.full_well / 4096
    np.testing.assert_allclose(variance[1], (electrons + 2.5**2 + step**2 / 12.0) / 10 / 1000.0**2, rtol=1e-2)
    assert variance[0].mean() / variance[1].mean() == pytest.approx(
        0.1 * seen.pictures[0].mean() / seen.pictures[1].mean(), rel=1e-2
    )


def test_the_fixed_pattern_is_not_averaged():
    picture = np.full((1, 3, 3), 2.0)
    sensor = Sensor(exposure=1000.0, gain_spread=0.01, offset_spread=3.0)
    seen = [Measured(picture, (), sensor, (frames,)).variance(picture)[0, 0, 0] for frames in (100, 10**9)]
    assert seen[1] == pytest.approx(0.02**2 + 0.003**2, rel=1e-4)
    assert seen[0] - seen[1] == pytest.approx(2.0 / 1000.0 / 100, rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{}/a.exr=1,2,3"], "picture of the empty scene"),
        (["{}/a.exr", "{}/b.exr=1,2"], "must read PICTURE"),
        (["{}/a.exr", "{}/b.exr=1,2,nan"], "must read PICTURE"),
        (["{}/a.exr", "{}/small.npy"], "all must have the same"),
        (["{}/nan.npy"], "NaN"),
        (["{}/wide.exr"], "Rec.2020"),
        (["{}/none.exr"], "no such picture"),
        (["{}/none.npy"], "cannot be read"),
        (["{}/a.exr", "{}=1,2,3"], "is a folder"),
        (["{}"], "data set"),
    ],
)
def test_what_is_no_picture_is_said(folder, arguments, words):
    with pytest.raises(NlosError, match=words):
        read([argument.format(folder) for argument in arguments], Sensor())
