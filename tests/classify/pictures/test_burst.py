"""Bursts are read as they are, and what is no burst of single pixels' values is refused."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from classify.pictures import burst
from generator.model.errors import NlosError


def write(folder, frames):
    folder.mkdir(parents=True)
    for number, frame in enumerate(frames):
        assert cv2.imwrite(str(folder / f"{number}.png"), frame)
    return folder


@pytest.fixture
def frames():
    return np.random.default_rng(0).integers(0, 4096, size=(3, 4, 6)).astype(np.uint16)


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        ("10ms", 0.01),
        ("dark-0.5s", 0.5),
        ("light 250us", 250e-6),
        ("1_60s", 1.0 / 60.0),
        ("exposure_2s_dark", 2.0),
        ("level7", math.nan),
        ("1ms-of-2s", math.nan),
        ("3spheres", math.nan),
    ],
)
def test_the_name_tells_the_exposure_time(tmp_path, frames, name, seconds):
    assert burst.read(write(tmp_path / name, frames)).time == pytest.approx(seconds, nan_ok=True)


def test_folders_and_stacks_hold_the_same(tmp_path, frames):
    np.save(tmp_path / "5ms.npy", frames)
    cv2.imwritemulti(str(tmp_path / "5ms.tif"), list(frames))
    folder = write(tmp_path / "5ms", frames)
    for path in (folder, tmp_path / "5ms.npy", tmp_path / "5ms.tif"):
        found = burst.read(path)
        assert np.array_equal(found.frames, frames)
        assert found.frames.dtype == np.uint16
        assert found.time == 0.005


def test_one_pixel_of_four_and_one_channel(tmp_path, frames):
    folder = write(tmp_path / "grey", frames)
    assert np.array_equal(burst.read(folder, mosaic=(1, 0)).frames, frames[:, 1::2, ::2])
    part = burst.read(folder, mosaic=(1, 0), region=(1, 0, 2, 1)).frames
    assert np.array_equal(part, frames[:, 1:2, 2:6:2])
    with pytest.raises(NlosError, match="lies outside the 6 x 4 pixels"):
        burst.read(folder, region=(5, 0, 2, 1))
    colour = np.stack([frames, frames + np.uint16(1), frames + np.uint16(2)], axis=-1)  # blue, green, red
    folder = write(tmp_path / "colour", colour)
    assert np.array_equal(burst.read(folder, channel="red").frames, frames + 2)
    with pytest.raises(NlosError, match="is in colour; take one of --channel red"):
        burst.read(folder)


def test_too_much_for_the_memory_is_told(tmp_path, frames, monkeypatch):
    monkeypatch.setattr(burst, "MOST", 40)
    with pytest.raises(NlosError, match="holds more than 40 values; take a part of the frames"):
        burst.read(write(tmp_path / "large", frames))


def test_what_is_no_burst_is_refused(tmp_path, frames):
    mixed = write(tmp_path / "mixed", [frames[0], frames[1][:2]])
    with pytest.raises(NlosError, match="its frames differ in size or depth"):
        burst.read(mixed)
    np.save(tmp_path / "nan.npy", np.full((2, 4, 4), np.nan, dtype=np.float32))
    with pytest.raises(NlosError, match="holds NaN or infinite values"):
        burst.read(tmp_path / "nan.npy")
    cv2.imwrite(str(tmp_path / "one.jpg"), (frames[0] // 16).astype(np.uint8))
    with pytest.raises(NlosError, match="compressed with loss"):
        burst.read(tmp_path / "one.jpg")
    with pytest.raises(NlosError, match=r"must end in"):
        burst.read(tmp_path / "nothing")
