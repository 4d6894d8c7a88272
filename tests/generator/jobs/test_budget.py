"""Settings that follow from a time or an accuracy."""

from __future__ import annotations

import functools
import heapq
import queue
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from generator.jobs import budget
from generator.jobs.budget import Measured
from generator.measure.tradeoff import differences
from generator.model.deadline import Deadline, Late
from generator.model.errors import NlosError
from generator.model.quantities import fraction, seconds
from generator.sets.dataset import Dataset

PATCH = Measured("patch", 9, start=5.0, fixed=0.01, slope=0.002, power=1.0, noise=20.0, workers=2.0)
SURFEL = Measured("surfel", 9, start=4.0, fixed=0.002, slope=0.001, power=0.5, noise=0.0, workers=2.0)


@pytest.mark.parametrize(("text", "wanted"), [("90", 90.0), ("90s", 90.0), ("10min", 600.0), ("1.5h", 5400.0)])
def test_times_are_read(text, wanted):
    assert seconds(text) == wanted


@pytest.mark.parametrize("text", ["", "soon", "-3s", "0", "10 parsecs", "1e3", "nan"])
def test_what_is_no_time_is_one_sentence(text):
    with pytest.raises(NlosError, match="must read like 90s"):
        seconds(text)


@pytest.mark.parametrize(("text", "wanted"), [("1%", 0.01), ("0.01", 0.01), ("12.5 %", 0.125), ("1e-3", 1e-3)])
def test_accuracies_are_read(text, wanted):
    assert fraction(text) == pytest.approx(wanted)


@pytest.mark.parametrize("text", ["", "0", "100%", "2", "1%%", "good", "nan", "-1%"])
def test_what_is_no_accuracy_is_one_sentence(text):
    with pytest.raises(NlosError, match="must be between 0 and 1"):
        fraction(text)


def chosen(monkeypatch, measured, settings=None, **wanted):
    monkeypatch.setattr(budget, "measured_by_trial", lambda *_, **__: measured)
    told = []
    return budget.choose("room.blend", settings or {}, **wanted, tell=told.append).settings, told[-1]


@pytest.mark.parametrize("limit", [60.0, 600.0, 6000.0])
def test_the_time_is_used_and_not_more(monkeypatch, limit):
    made, words = chosen(monkeypatch, PATCH, budget=limit)
    assert 0.6 * limit < PATCH.total(made["samples"], 900) < limit
    assert "what the budget allows" in words


@pytest.mark.parametrize("slowness", [0.4, 1.0, 2.5])
@pytest.mark.parametrize("workers", [1, 3])
def test_a_pace_keeps_the_time_on_a_machine_of_another_speed(slowness, workers):
    """Workers of a simulated machine, which turns quick or slow when a third is done, end when they should."""
    measured, now, starts = replace(PATCH, workers=float(workers)), [0.0], 3.0
    pictures, late = 400, 600.0
    samples = int(measured.most(late, pictures, 1.0, 1e6))
    pace = budget.Pace(measured, samples, pictures, late, clock=lambda: now[0])
    told = queue.Queue()
    asks = [queue.Queue() for _ in range(workers)]
    free = [(starts, i) for i in range(workers)]
    for own in asks:  # a pace knows workers by their threads
        work = functools.partial(lambda own: [told.put(pace()) for _ in iter(own.get, None)], own)
        threading.Thread(target=work, daemon=True).start()
    taken = []
    for done in range(pictures):
        begun, i = heapq.heappop(free)
        now[0] = 0.0 if begun == starts and done < workers else begun
        asks[i].put(1)
        taken.append(told.get(timeout=10))
        now_slow = slowness if done > pictures / 3 else 1.0
        heapq.heappush(free, (begun + now_slow * measured.picture(taken[-1]), i))
    for own in asks:
        own.put(None)
    end = max(free)[0]
    assert 0.9 * late < end < 1.1 * late
    if slowness != 1.0:
        assert (np.mean(taken[-50:]) < np.mean(taken[:50])) == (slowness > 1.0)


def test_no_more_than_asked_for_is_done(monkeypatch):
    made, words = chosen(monkeypatch, PATCH, budget=1e6, accuracy=0.5)
    assert (made["engine"], made["samples"]) == ("patch", 1600)
    assert "as exact as asked for" in words
    assert "error of a difference picture 50 %" in words


def test_the_scarcer_of_both_decides(monkeypatch):
    made, words = chosen(monkeypatch, PATCH, budget=60.0, accuracy=0.5)
    assert made["samples"] < 1600
    assert "what the budget allows" in words


def test_surfel_needs_no_more_than_float32_holds(monkeypatch):
    made, words = chosen(monkeypatch, SURFEL, budget=1e6)
    assert made == {"engine": "surfel", "accuracy": budget.FINE}
    assert "as float32 pictures can hold" in words
    made, words = chosen(monkeypatch, replace(SURFEL, slope=0.01), budget=60.0)
    assert budget.FINE < made["accuracy"] < 0.3


def test_too_little_time_is_one_sentence(monkeypatch):
    with pytest.raises(NlosError, match="900 pictures take 0:10 at the very least, and 0:05 are left"):
        chosen(monkeypatch, PATCH, budget=5.0)


def test_samples_are_not_chosen_twice(monkeypatch):
    with pytest.raises(NlosError, match="samples: follow from --budget"):
        chosen(monkeypatch, PATCH, {"samples": 4}, budget=60.0)


@pytest.mark.slow
def test_pictures_are_as_exact_as_asked_for(tmp_path, scene_file, command):
    """Against the engine without noise, at the same poses: the median error is the one that was promised."""
    common = ("--poses", "3", "--resolution", "12")
    noisy, exact = tmp_path / "noisy", tmp_path / "exact"
    result = command("generator", "sweep", scene_file, "-o", noisy, *common, "--engine", "patch", "--accuracy", "60%")
    assert result.returncode == 0, result.stderr
    assert "as exact as asked for" in result.stdout
    again = command("generator", "sweep", scene_file, "-o", noisy, "--engine", "patch", "--accuracy", "60%")
    assert "nothing to do" in again.stdout, again.stderr
    assert command("generator", "sweep", scene_file, "-o", exact, *common, "--engine", "surfel").returncode == 0
    got, wanted = differences(Dataset.open(noisy)), differences(Dataset.open(exact))
    error = np.sqrt(((got - wanted) ** 2).mean(axis=(1, 2)) / (wanted**2).mean(axis=(1, 2)))
    # Noise differs from voxel to voxel by more than what nine poses tell of the median of all.
    assert 0.6 / 2.5 < np.median(error) < 0.6 * 2.5


def asleep(arguments):
    return [sys.executable, "-c", "import time; time.sleep(600)"]


def test_a_trial_that_takes_too_long_is_ended(monkeypatch):
    begun = time.monotonic()
    with pytest.raises(Late):
        budget.measured_by_trial("room.blend", {}, 2, asleep, deadline=Deadline(1.0))
    monkeypatch.setattr(budget, "compiled", lambda *_, **__: 0.0)
    with pytest.raises(NlosError, match="--budget: 0:01 are over before a few pictures are"):
        budget.choose("room.blend", {}, budget=1.0, launch=asleep)
    assert time.monotonic() - begun < 60.0


def test_compiling_is_told_and_timed(monkeypatch):
    told = []
    monkeypatch.setattr(budget, "measured_by_trial", lambda *_, **__: PATCH)
    monkeypatch.setattr(
        budget.caching, "compiling_words", lambda engine: "compiled first" if engine == "auto" else ""
    )
    assert budget.compiled("room.blend", {"engine": "patch"}, tell=told.append) == 0.0
    assert told == []
    budget.compiled("room.blend", {"engine": "auto"}, tell=told.append)
    assert told == ["compiled first", "compiled in 0:00, which no time limit counts"]


@pytest.mark.slow
def test_a_budget_from_the_shell(tmp_path, scene_file, command):
    path = tmp_path / "set"
    small = ("--poses", "1", "--resolution", "8")
    result = command("generator", "sweep", scene_file, "-o", path, *small, "--budget", "10min")
    assert result.returncode == 0, result.stderr
    assert "surfel, accuracy 0.0001: as exact as float32 pictures can hold" in result.stdout
    assert Dataset.open(path).sweep.accuracy == budget.FINE


def test_a_trajectory_has_no_median_pose(tmp_path, scene_file, command):
    arguments = ("trajectory", scene_file, "-o", tmp_path / "walk", "--frames", "2", "--engine", "patch")
    result = command("generator", *arguments, "--accuracy", "10%")
    assert result.returncode == 2
    assert "accuracy: means nothing to the engine 'patch'" in result.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--budget", "never"), "--budget 'never': must read like 90s"),
        (("--budget", "1min", "--shard", "0/2"), "--budget: is one machine's"),
        (("--accuracy", "500%"), "--accuracy '500%': must be between 0 and 1"),
        (("--budget", "1min", "--samples", "4"), "samples: follow from --budget and --accuracy"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, scene_file, command, options, words):
    result = command("generator", "sweep", scene_file, "-o", tmp_path / "set", *options)
    assert result.returncode == 2
    assert words in result.stderr
    assert not (tmp_path / "set").exists()
