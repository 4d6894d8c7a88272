"""Detection and whole data sets: rates that hold, tables that a person reads, bad input in one sentence."""

from __future__ import annotations

import csv

import numpy as np
import pytest
import worlds
from classify_helpers import make_bulk, make_dataset, make_seen, plain_atlas
from scipy import stats

from classify import atlas as atlases
from classify import trial
from classify.detect import Detector, evidence
from generator.sensor import Sensor
from generator.spec import NlosError

FLOOR = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
DIM = Sensor(full_well=300.0, bits=10)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A bulk set of a sphere above a floor, which lights the wall without it too."""
    return make_bulk(tmp_path_factory.mktemp("bulk") / "set", pictures=1200, room=(FLOOR,))


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """A data set of the same scene at other poses."""
    folder = tmp_path_factory.mktemp("seen")
    return make_seen(folder / "data", make_bulk(folder / "bulk", pictures=160, room=(FLOOR,), seed=3), poses=40)


@pytest.mark.parametrize("rate", [0.01, 0.1])
def test_false_alarms_are_as_many_as_asked_for(simulated, rate):
    """On empty scenes that the threshold was not chosen on."""
    atlas = atlases.build(simulated, DIM)
    detector = Detector.at(atlas, rate)
    empty = np.random.default_rng(7).normal(size=(20_000, atlas.codes.shape[1])).astype(np.float32)
    low, high = stats.binom.interval(0.999, len(empty), rate)
    slack = 3.3 * np.sqrt(len(empty) * rate)  # of the threshold, which is drawn too
    assert low - slack <= detector(empty).sum() <= high + slack


def test_the_evidence_is_the_best_test():
    """Two normal distributions: it finds what Neyman and Pearson's test finds, and no more."""
    distance = 2.0
    codes = np.zeros((64, 2), dtype=np.float32)
    codes[:, 0] = distance
    some = np.zeros(64, dtype=np.int64)
    atlas = plain_atlas(codes, np.zeros((64, 3)), some, None)
    detector = Detector.at(atlas, 0.05)
    rng = np.random.default_rng(2)
    there = rng.normal(size=(20_000, 2)).astype(np.float32) + codes[0]
    power = stats.norm.sf(stats.norm.isf(0.05) - distance)
    assert detector(there).mean() == pytest.approx(power, abs=0.015)
    assert evidence(atlas, codes[:1]) == pytest.approx(distance**2 / 2.0)


def test_a_data_set_is_answered(simulated, seen):
    """Voxel, position and presence of every picture, and rates that agree with what is stated."""
    answers = trial.run(atlases.build(simulated, DIM), seen, seed=1)
    assert answers.accuracy().value > 0.6
    held = int(answers.inside.sum())
    assert stats.binom.cdf(held, len(answers.records), 0.93) > 1e-3
    low, high = stats.binom.interval(0.9999, len(answers.empty), 0.01)
    assert low <= (answers.empty > answers.detector.threshold).sum() <= high + 8
    rows = answers.rows()
    assert [row[0] for row in rows] == [*seen.grid.labels, "all"]
    written = list(csv.DictReader(answers.csv().splitlines()))
    assert len(written) == len(seen.records)
    assert {row["voxel"] for row in written} <= set(seen.grid.labels)
    again = trial.run(atlases.build(simulated, DIM), seen, seed=1)
    assert again.csv() == answers.csv()


def test_the_command_line(simulated, seen, tmp_path, command):
    """Atlas, locate and bound, as a user types them."""
    (tmp_path / "dim.toml").write_text("full_well = 300.0\nbits = 10\n")
    file = tmp_path / "room.atlas"
    made = command("classify", "atlas", simulated.path, "-o", file, "--sensor", tmp_path / "dim.toml", "--frames", 2)
    assert made.returncode == 0, made.stderr
    assert "1200 pictures of a sphere" in made.stdout
    assert atlases.load(file).sensor.frames == 2
    located = command("classify", "locate", file, seen.path, "-o", tmp_path / "answers")
    assert located.returncode == 0, located.stderr
    assert "in empty scenes, something is found in" in located.stdout
    assert (tmp_path / "answers" / "answers.csv").is_file()
    bound = command("classify", "bound", file, simulated.path, "--count", 100)
    assert bound.returncode == 0, bound.stderr
    assert "the best that any method can do" in bound.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("atlas", "{missing}", "-o", "{out}"), "is not a bulk set"),
        (("atlas", "{set}", "-o", "{out}", "--frames", "0"), "sensor.frames: 0 must be 1 or more"),
        (("atlas", "{set}", "-o", "{out}", "--sensor", "{bad}"), "sensor.colour"),
        (("locate", "{missing}", "{seen}"), "no such atlas file"),
        (("locate", "{atlas}", "{missing}"), "is not a data set"),
        (("locate", "{atlas}", "{other}"), "has another voxel grid than the atlas"),
        (("locate", "{atlas}", "{seen}", "--false-alarm", "0"), "false alarms 0: must be a share"),
        (("bound", "{atlas}", "{set}", "--count", "0"), "--count 0: must be 1 or more"),
    ],
)
def test_bad_input_is_one_sentence(simulated, seen, tmp_path, command, arguments, words):
    """Exit code 2, one line, nothing left behind."""
    (tmp_path / "bad.toml").write_text('colour = "red"\n')
    atlases.save(tmp_path / "a.atlas", atlases.build(simulated, DIM))
    places = {
        "missing": tmp_path / "missing",
        "out": tmp_path / "out.atlas",
        "set": simulated.path,
        "seen": seen.path,
        "bad": tmp_path / "bad.toml",
        "atlas": tmp_path / "a.atlas",
        "other": tmp_path / "other",
    }
    if "{other}" in arguments:
        make_dataset(tmp_path / "other", n=1)
    done = command("classify", *(a.format(**places) for a in arguments))
    assert done.returncode == 2, done.stdout + done.stderr
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not places["out"].exists()


def test_an_unfinished_set_makes_no_atlas(simulated, tmp_path):
    """It is said how much is missing."""
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(simulated.path, copy)
    next(copy.glob("part-*.h5")).unlink()
    with pytest.raises(NlosError, match=r"1 of \d+ parts are missing; finish the set first"):
        atlases.build(type(simulated).open(copy), DIM)
