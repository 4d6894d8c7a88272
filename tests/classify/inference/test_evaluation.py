"""Detection and whole data sets: rates that hold, tables that a person reads, bad input in one sentence."""

from __future__ import annotations

import csv
import re
from dataclasses import replace

import numpy as np
import pytest
import worlds
from classify_helpers import make_bulk, make_dataset, make_seen, plain_atlas
from figure_texts import misplaced
from scipy import stats

from classify.cli.main import main
from classify.inference import atlas_build, atlas_file, evaluation
from classify.inference.detect import Detector, detections, evidence
from classify.pictures.sensor import Sensor
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid

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


def test_a_wall_of_another_albedo_is_exposed_for(simulated, tmp_path):
    """All light goes over the relay wall twice: half the albedo is a quarter of the light, in every picture."""
    atlas = atlas_build.build(simulated, DIM)
    usual, dark = (
        make_seen(tmp_path / name, make_bulk(tmp_path / f"b{name}", pictures=80, room=(FLOOR,), seed=3, wall=wall))
        for name, wall in (("usual", 0.8), ("dark", 0.4))
    )
    one, other = (evaluation.run(atlas, seen, empty=0) for seen in (usual, dark))
    assert (one.level, other.level) == (1.0, pytest.approx(4.0, rel=1e-3))
    table = [[run.right.sum(), (~run.right).sum()] for run in (one, other)]
    assert stats.fisher_exact(table).pvalue > 1e-3
    assert stats.ks_2samp(one.errors, other.errors).pvalue > 1e-3


def test_another_scene_and_another_object_are_told(simulated, tmp_path):
    """A floor on one side only lights the wall in another shape: no exposure makes up for it."""
    half = worlds.quad((-2.0, 0.0, -1.0), (1.5, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
    atlas = atlas_build.build(simulated, DIM)
    usual, other = (
        make_seen(tmp_path / name, make_bulk(tmp_path / f"b{name}", pictures=40, room=(floor,), seed=3), poses=4)
        for name, floor in (("usual", FLOOR), ("other", half))
    )
    assert evaluation.run(atlas, usual, empty=0).doubts == ()
    shape, misfit = evaluation.run(atlas, other, empty=0).doubts
    assert re.match(r"do not rely on these answers: the empty scene differs from that of the atlas by \d", shape)
    assert re.match(r"\d+ of 16 pictures do not fit the atlas", misfit)
    atlas = replace(atlas, about={**atlas.about, "targets": ["sheet"]})
    assert evaluation.run(atlas, usual, empty=0).doubts == (
        "the atlas is of a sheet, and these pictures are of a sphere",
    )


@pytest.mark.parametrize("rate", [0.01, 0.1])
def test_false_alarms_are_as_many_as_asked_for(simulated, rate):
    """On empty scenes that the threshold was not chosen on."""
    atlas = atlas_build.build(simulated, DIM)
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
    answers = evaluation.run(atlas_build.build(simulated, DIM), seen, seed=1)
    assert answers.accuracy().value > 0.6
    assert np.unique(answers.draws).size == np.unique(answers.empty_draws).size == evaluation.BACKGROUNDS
    held = int(answers.inside.sum())
    assert answers.calibration(np.array([0.95]))[0] == pytest.approx(held / len(answers.records))
    assert stats.binom.cdf(held, len(answers.records), 0.93) > 1e-3
    low, high = stats.binom.interval(0.9999, len(answers.empty), 0.01)
    assert low <= (answers.empty > answers.detector.threshold).sum() <= high + 8
    rows = answers.rows()
    assert [row[0] for row in rows] == [*seen.grid.labels, "all"]
    written = list(csv.DictReader(answers.csv().splitlines()))
    assert len(written) == len(seen.records)
    assert {row["voxel"] for row in written} <= set(seen.grid.labels)
    assert [float(row["region"]) for row in written] == pytest.approx(answers.regions, abs=1e-4)
    again = evaluation.run(atlas_build.build(simulated, DIM), seen, seed=1)
    assert again.csv() == answers.csv()


def test_the_command_line(simulated, seen, tmp_path, command):
    """Atlas, locate and bound, as a user types them."""
    (tmp_path / "dim.toml").write_text("full_well = 300.0\nbits = 10\n")
    file = tmp_path / "room.atlas"
    made = command("classify", "atlas", simulated.path, "-o", file, "--sensor", tmp_path / "dim.toml", "--frames", 2)
    assert made.returncode == 0, made.stderr
    assert "1200 pictures of a sphere" in made.stdout
    assert atlas_file.load(file).sensor.frames == 2
    located = command("classify", "locate", file, seen.path, "-o", tmp_path / "answers")
    assert located.returncode == 0, located.stderr
    assert "in empty scenes, something is found in" in located.stdout
    assert {"answers.csv", "answers.png", "answers.svg"} <= {p.name for p in (tmp_path / "answers").iterdir()}
    page = (tmp_path / "answers" / "report.html").read_text(encoding="utf-8")
    assert "Where is the hidden object?" in page
    assert "data:image/png;base64," in page
    assert "nlos-classify locate" in page  # the command that made it
    rows = [re.findall(r"<td>(.*?)</td>", line) for line in page.splitlines() if line.startswith("<tr><td>")]
    assert rows[-1][0] == "all"
    assert rows[-1][2] in page.split("<table>")[0]  # what the lead says is what the table says
    bound = command("classify", "bound", file, simulated.path, "--count", 100)
    assert bound.returncode == 0, bound.stderr
    assert "the best that any method can do" in bound.stdout


@pytest.fixture(scope="module")
def atlas(simulated, tmp_path_factory):
    """An atlas of that set, as a file."""
    path = tmp_path_factory.mktemp("atlas") / "a.atlas"
    atlas_file.save(path, atlas_build.build(simulated, DIM))
    return path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("atlas", "{missing}", "-o", "{out}"), "is not a bulk set"),
        (("atlas", "{set}", "-o", "{out}", "--frames", "0"), "sensor.frames: 0 must be 1 or more"),
        (("atlas", "{set}", "-o", "{out}", "--sensor", "{bad}"), "bad.toml: colour: no such field"),
        (("locate", "{missing}", "{seen}"), "no such atlas file"),
        (("locate", "{atlas}", "{missing}"), "is not a data set"),
        (("locate", "{atlas}", "{other}"), "has another voxel grid than the atlas"),
        (("locate", "{atlas}", "{seen}", "--false-alarm", "0"), "false alarms 0: must be a share"),
        (("bound", "{atlas}", "{set}", "--count", "0"), "--count 0: must be 1 or more"),
    ],
)
def test_bad_input_is_one_sentence(simulated, seen, atlas, tmp_path, command, arguments, words):
    """Exit code 2, one line, nothing left behind."""
    (tmp_path / "bad.toml").write_text('colour = "red"\n')
    places = {
        "missing": tmp_path / "missing",
        "out": tmp_path / "out.atlas",
        "set": simulated.path,
        "seen": seen.path,
        "bad": tmp_path / "bad.toml",
        "atlas": atlas,
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
        atlas_build.build(type(simulated).open(copy), DIM)


def test_longer_exposures_find_what_short_ones_miss_as_two_normal_variables_would():
    """One pose and a known code: detections follow the normal distribution (Kay 1998, section 4.3)."""
    codes = np.zeros((64, 2), dtype=np.float32)
    codes[:, 0] = 3.0
    grid = VoxelGrid(lo=(0.0, 0.0, 0.0), hi=(1.0, 1.0, 1.0), shape=(1, 1, 1))
    atlas = plain_atlas(codes, np.zeros((64, 3)), np.zeros(64, dtype=np.int64), grid)
    atlas = replace(atlas, background=np.full((1, 2), 1e4), sensor=replace(atlas.sensor, frames=4))
    many = np.repeat(np.arange(64), 40)
    for found, strength in zip(
        detections(atlas.take(many), [1, 4], false_alarm=0.05, count=2560), (1.5, 3.0), strict=True
    ):
        truth = stats.norm.sf(stats.norm.isf(0.05) - strength)
        assert abs(found.found[0].value - truth) < 4.0 * np.sqrt(truth * (1 - truth) / 2560) + 0.01
        alarms, told = found.roc(0)
        at = np.searchsorted(alarms, 0.05)
        assert told[at] == pytest.approx(truth, abs=0.05)


def test_detection_from_the_shell(tmp_path, capsys, drawn):
    """A table, a picture and a file; exposures that the atlas cannot have are one sentence."""
    floor = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
    found = make_bulk(tmp_path / "set", pictures=200, room=(floor,))
    smaller = make_bulk(tmp_path / "smaller", pictures=200, radius=0.1, room=(floor,))
    made = [str(tmp_path / "a.atlas")]
    assert main(["atlas", str(found.path), str(smaller.path), "-o", *made, "--frames", "10", "--unknown"]) == 0
    assert "400 pictures of a sphere or a sphere" in capsys.readouterr().out
    assert main(["detect", *made, "-o", str(tmp_path / "out"), "--count", "40"]) == 0
    out = capsys.readouterr().out
    assert "10 frames" in out
    assert (tmp_path / "out" / "detect.png").stat().st_size > 5000
    assert (tmp_path / "out" / "detect.svg").is_file()
    assert misplaced(drawn[0]) == []
    assert "Is there something?" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    lines = list(csv.reader((tmp_path / "out" / "detect.csv").read_text().splitlines()))
    assert lines[0] == ["voxel", "from the wall", "1 frame", "3 frames", "10 frames"]
    assert [line[0] for line in lines[1:]] == list(found.grid.labels)
    assert main(["detect", *made, "--exposures", "11"]) == 2
    assert "frames 11: must be from 1 to the 10" in capsys.readouterr().err
    assert main(["locate", *made, str(smaller.path), "--count", "20", "--frames", "5"]) == 2
    assert "20 of its 20 poses are also in the atlas" in capsys.readouterr().err
    others = make_bulk(tmp_path / "others", pictures=40, radius=0.1, room=(floor,), seed=1)
    assert main(["locate", *made, str(others.path), "--count", "20", "--frames", "5"]) == 0
    assert "right voxel" in capsys.readouterr().out


def test_sets_of_other_scenes_do_not_make_one_atlas(tmp_path):
    floor = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
    darker = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.3)
    one, other = (make_bulk(tmp_path / name, pictures=8, room=(f,)) for name, f in (("a", floor), ("b", darker)))
    with pytest.raises(NlosError, match="show different scenes; only the object may differ"):
        atlas_build.build(one, Sensor(), other)
