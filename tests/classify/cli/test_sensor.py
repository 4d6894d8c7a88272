"""The verb ``sensor``, from files to a file that other verbs take."""

from __future__ import annotations

import argparse
import json

import numpy as np
import pytest
from cameras import Bench, Camera
from classify_helpers import make_dataset

from classify.cli.options import sensor_of
from classify.pictures import feature_table, sensor_file
from generator.files.toml import read_toml
from generator.model.errors import NlosError

LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.65, 0.9, 1.6)


@pytest.fixture(scope="module")
def bursts(tmp_path_factory):
    """Files of bursts of a small camera: of light, and of darkness."""
    folder = tmp_path_factory.mktemp("bursts")
    bench = Bench(Camera(), np.random.default_rng(2), shape=(48, 64))
    paths = []
    for found in (bench.light(6, LEVELS), bench.dark(6, (0.01, 1.0))):
        paths.append([folder / f"{len(paths)}-{1000.0 * one.time:g}ms.npy" for one in found])
        for path, one in zip(paths[-1], found, strict=True):
            np.save(path, one.frames)
    return paths


def test_a_measured_camera_is_a_file_that_other_verbs_take(bursts, tmp_path, command):
    light, dark = bursts
    out = tmp_path / "sensor.toml"
    done = command("classify", "sensor", *light, "--dark", *dark, "-o", out, "--plot", tmp_path / "a.png", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    figures = {one["name"]: one for one in answer["figures"]}
    assert figures["gain"]["value"]["low"] < 0.2 < figures["gain"]["value"]["high"]
    assert figures["gain"]["unit"] == "grey levels/electron"
    assert answer["doubts"] == []
    assert [tmp_path / name for name in ("a.png", "a.svg")] == sorted(tmp_path.glob("a.*"))
    content = read_toml(out)
    assert set(content) == {"sensor", "interval", "measured"}
    assert (
        content["interval"]["read_noise"][0] < content["sensor"]["read_noise"] < content["interval"]["read_noise"][1]
    )
    sensor = sensor_file.read(out)
    assert sensor.bits == 12
    assert sensor.dark_current == pytest.approx(30.0, rel=0.1)
    taken = sensor_of(argparse.Namespace(sensor=str(out), frames=7, exposure_time=0.5))
    assert (taken.frames, taken.exposure_time, taken.gain) == (7, 0.5, sensor.gain)
    make_dataset(tmp_path / "set", n=1)
    words = ["-o", tmp_path / "f.h5", "--sensor", out, "--exposure-time", 0.5]
    done = command("classify", "features", tmp_path / "set", *words)
    assert done.returncode == 0, done.stderr
    seen = feature_table.read(tmp_path / "f.h5").provenance["sensor"]
    assert (seen["gain"], seen["exposure_time"]) == (sensor.gain, 0.5)


def test_a_part_of_the_frames_and_times_beside_the_names(bursts, tmp_path, command):
    light, dark = bursts
    out = tmp_path / "sensor.toml"
    times = [0.1 * level for level in LEVELS]
    words = ["--times", *times, "--dark-times", 0.01, 1.0, "--region", 8, 4, 40, 40]
    done = command("classify", "sensor", *light, "--dark", *dark, "-o", out, *words)
    assert done.returncode == 0, done.stderr
    assert read_toml(out)["measured"]["pixels"] == [40, 40]
    assert "overall system gain K" in done.stdout


def test_doubts_are_an_exit_code(bursts, tmp_path, command):
    light, dark = bursts
    done = command("classify", "sensor", *light[:-2], "--dark", *dark, "-o", tmp_path / "sensor.toml")
    assert done.returncode == 1
    assert "no burst is saturated" in done.stdout
    assert read_toml(tmp_path / "sensor.toml")["interval"]["full_well"][1] == np.inf


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--times", "0.1"], "--times: takes a number for each of the 8 bursts, not 1"),
        (["--dark-times", "-1", "1"], "--dark-times -1: must not be negative"),
        (["--region", "0", "0", "65", "10"], "--region: lies outside the 64 x 48 pixels"),
        (["--bits", "8"], "--bits 8: the frames hold grey levels up to"),
        (["--wavelength", "0"], "--wavelength 0: must be a positive number"),
        (["--plot", "a.jpeg"], "a.jpeg: must end in .png"),
    ],
)
def test_bad_input_is_one_sentence(bursts, tmp_path, command, words, sentence):
    light, dark = bursts
    done = command("classify", "sensor", *light, "--dark", *dark, "-o", tmp_path / "sensor.toml", *words)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_file_of_either_form_is_read_and_others_are_refused(tmp_path):
    file = tmp_path / "sensor.toml"
    for text in ("read_noise = 3.0\n", "[sensor]\nread_noise = 3.0\n[interval]\nread_noise = [2.0, 4.0]\n"):
        file.write_text(text, encoding="utf-8")
        assert sensor_file.read(file).read_noise == 3.0
    for text, words in (
        ("[sensor]\nread_nose = 3.0\n", "read_nose: no such field"),
        ("bits = 8\n[sensor]\nread_noise = 3.0\n", "bits: stands outside the table"),
        ("[interval]\nread_noise = [2.0, 4.0]\n", "interval: no such field"),
    ):
        file.write_text(text, encoding="utf-8")
        with pytest.raises(NlosError, match=words):
            sensor_file.read(file)
