"""Sets of two objects in which reflectivities and lamp vary, by every engine: equal, resumed, and changed."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from classify.pictures import feature_table
from classify.pictures.sensor import Sensor
from classify.pictures.settings import FeatureSettings
from generator.files.pictures import read_picture
from generator.sets.dataset import Dataset
from generator.sets.simulated import open_set

pytestmark = pytest.mark.slow
VARY = ("target.albedo=0.3:1", "wall.albedo=0.4:0.9", "room.albedo=0.2:0.8", "spot.power=500:1500")
OPTIONS = ["--targets", "2", *(word for text in VARY for word in ("--vary", text))]
SMALL = ("--resolution", "8", "--workers", "1", *OPTIONS)


@pytest.fixture(scope="module")
def by_engine(tmp_path_factory, scene_file, command):
    """The same nine pairs of poses with the same values: by patch, by surfel, and as a bulk set."""
    folder = tmp_path_factory.mktemp("varying")
    for name, words in {
        "patch": ("sweep", "--engine", "patch", "--samples", "1024", "--poses", "1"),
        "surfel": ("sweep", "--engine", "surfel", "--poses", "1"),
        "bulk": ("bulk", "--pictures", "9", "--stream", "sweep"),
    }.items():
        result = command("generator", words[0], scene_file, "-o", folder / name, *words[1:], *SMALL)
        assert result.returncode == 0, result.stderr
    return folder


def test_engines_agree_pose_by_pose(by_engine):
    """Patch renders each scene by Cycles, surfel sums each anew, and bulk scales one sum."""
    patch, surfel, bulk = (open_set(by_engine / name) for name in ("patch", "surfel", "bulk"))
    sums = np.zeros((2, 2))
    for records in zip(patch.records, surfel.records, bulk.records, strict=True):
        assert len({(r.position, r.rotation, r.others, r.values) for r in records}) == 1
        assert len(records[0].others) == 1
        empty = [s.background_of(r).astype(float) for s, r in zip((patch, surfel, bulk), records, strict=True)]
        added = [s.picture(r) - e for s, r, e in zip((patch, surfel, bulk), records, empty, strict=True)]
        np.testing.assert_allclose(empty[2], empty[1], rtol=1e-5)
        assert np.sqrt(((added[2] - added[1]) ** 2).mean() / (added[1] ** 2).mean()) < 1e-3
        sums += [[empty[0].sum(), empty[1].sum()], [added[0].sum(), added[1].sum()]]
    assert np.ptp([e.mean() for e in map(surfel.background_of, surfel.records)]) > 0.5 * empty[1].mean()
    np.testing.assert_allclose(sums[:, 0], sums[:, 1], rtol=0.1)


def test_sets_verify_and_a_changed_value_is_found(by_engine, command, tmp_path):
    for name in ("patch", "surfel", "bulk"):
        assert command("generator", "verify", by_engine / name).returncode == 0
    shutil.copytree(by_engine / "surfel", tmp_path / "set")
    table = tmp_path / "set" / "poses.csv"
    albedo = repr(Dataset.open(tmp_path / "set").poses[4].values[0][1])
    table.write_text(table.read_text().replace(albedo, "0.5"))
    result = command("generator", "verify", tmp_path / "set")
    assert result.returncode == 1
    assert "poses.csv, line 6: values is target.albedo=0.5 " in result.stdout + result.stderr


def test_resumed_and_in_shards_to_the_same_bits(by_engine, command, scene_file, tmp_path):
    copy = tmp_path / "set"
    shutil.copytree(by_engine / "patch", copy)
    for lost in ("B/0000.exr", "D/0000-background.exr"):
        (copy / lost).unlink()
    for shard in ("1/2", "0/2"):
        words = ("--engine", "patch", "--samples", "1024", "--poses", "1", "--shard", shard)
        assert command("generator", "sweep", scene_file, "-o", copy, *words, *SMALL).returncode == 0
    hashes = [[pose.pixel_hash for pose in Dataset.open(path).poses] for path in (by_engine / "patch", copy)]
    assert hashes[0] == hashes[1]
    backgrounds = [read_picture(path / "D/0000-background.exr")[0] for path in (by_engine / "patch", copy)]
    np.testing.assert_array_equal(*backgrounds)


def test_another_background_is_refused(by_engine, command, tmp_path):
    copy = tmp_path / "set"
    shutil.copytree(by_engine / "surfel", copy)
    shutil.copy(copy / "A/0000-background.exr", copy / "B/0000-background.exr")
    result = command("generator", "verify", copy)
    assert result.returncode == 1
    assert "B/0000-background.exr: is " in result.stdout + result.stderr


@pytest.mark.parametrize("sensor", [None, Sensor()])
def test_features_subtract_each_poses_own_background(by_engine, sensor, tmp_path):
    found = [
        feature_table.extract(open_set(by_engine / name), FeatureSettings(set="physics"), sensor=sensor)
        for name in ("surfel", "bulk")
    ]
    feature_table.write(tmp_path / "features.h5", found[1])
    read = feature_table.read(tmp_path / "features.h5")
    assert set(read.varied) == {text.partition("=")[0] for text in VARY}
    assert read.labels.tolist() == [record.answer for record in open_set(by_engine / "surfel").records]
    for name, values in read.varied.items():
        np.testing.assert_array_equal(values, found[0].varied[name])
    if sensor is None:
        np.testing.assert_allclose(found[0].values, found[1].values, rtol=5e-3, atol=5e-3)
