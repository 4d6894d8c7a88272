"""A sweep as jobs: by submitit's executors that need no cluster; what is of Slurm only is in `make slurm`."""

from __future__ import annotations

import pytest
from conftest import TINY

from generator.sets.dataset import Dataset


def hashes(path):
    return [pose.pixel_hash for pose in Dataset.open(path).poses]


@pytest.mark.parametrize("cluster", [pytest.param("local", marks=pytest.mark.slow), "debug"])
def test_jobs_make_the_same_set(tmp_path, scene_file, tiny_dataset, command, cluster):
    path = tmp_path / "set"
    jobs = ("--jobs", "3", "--cluster", cluster, "--job", "timeout_min=5")
    result = command("generator", "sweep", scene_file, "-o", path, *TINY, *jobs)
    assert result.returncode == 0, result.stderr
    assert "9 of 9 pictures, 9 of them rendered now; finished" in result.stdout
    assert hashes(path) == hashes(tiny_dataset)
    assert not Dataset.open(path).verify()
    again = command("generator", "sweep", scene_file, "-o", path, *TINY, *jobs)
    assert "nothing to do" in again.stdout, again.stderr


@pytest.mark.slow
def test_a_job_that_fails_is_named_and_the_rest_is_done(tmp_path, scene_file, command):
    """Where a picture should be lies a folder: that share cannot be finished, the others are."""
    path = tmp_path / "set"
    made = command("generator", "sweep", scene_file, "-o", path, *TINY, "--shard", "0/9")
    assert made.returncode == 0, made.stderr
    (path / "B" / "0000.exr").mkdir(parents=True)
    result = command("generator", "sweep", scene_file, "-o", path, *TINY, "--jobs", "3", "--cluster", "local")
    assert result.returncode == 1
    assert "failed: job" in result.stderr
    assert "B/0000.exr" in result.stderr
    assert sum(map(bool, hashes(path))) >= 6


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--jobs", "0"), "--jobs 0: must be 1 or more"),
        (("--jobs", "2", "--shard", "0/2"), "--jobs: shares the poses out itself"),
        (("--jobs", "2", "--cluster", "local", "--job", "timeout"), "--job-option 'timeout': must read NAME=VALUE"),
        (("--jobs", "2", "--cluster", "local", "--job", "no_such_thing=1"), "no_such_thing"),
        (("--jobs", "2"), "--jobs slurm: "),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, scene_file, command, options, words, monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")  # no Slurm
    result = command("generator", "sweep", scene_file, "-o", tmp_path / "set", *TINY, *options)
    assert result.returncode == 2, result.stdout
    assert words in result.stderr
    assert "Traceback" not in result.stderr
