"""What a picture costs, how wrong it is, and what it is worth."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

from classify.cli import main as classify_cli
from generator.cli import main as cli
from generator.files.toml import to_dict
from generator.jobs import local
from generator.jobs.budget import Measured
from generator.measure import tradeoff
from generator.measure.tradeoff import Cost, Rung
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.model.presets import preset
from generator.model.settings import Sweep
from generator.sets.dataset import Dataset
from generator.sets.manifest import BACKGROUND

SHAPE = (6, 8)


def cost(name, seconds, errors):
    return Cost(name, seconds, (float(np.median(errors)), 0.0, 1.0), (1.0, 1.0, 1.0), np.asarray(errors))


def test_the_front_is_what_no_other_beats():
    seconds, errors = [1.0, 2.0, 3.0, 4.0, 2.5], [9.0, 4.0, 5.0, 1.0, 4.0]
    steps = [cost("patch-4", s, e * np.linspace(0.9, 1.1, 9)) for s, e in zip(seconds, errors, strict=True)]
    assert tradeoff.front(steps) == [0, 1, 3]


def test_a_dearer_rung_that_noise_makes_better_is_not_worth_its_price():
    """Smaller errors in the median pose, but in no more poses than chance would have it."""
    rng = np.random.default_rng(0)
    quick, dear = np.exp(rng.normal(size=(2, 27)))
    dear *= 0.95 * np.median(quick) / np.median(dear)
    assert tradeoff.front([cost("patch-4", 1.0, quick), cost("patch-16", 2.0, dear)]) == [0]
    assert tradeoff.front([cost("patch-4", 1.0, quick), cost("patch-16", 2.0, 0.8 * quick)]) == [0, 1]


def make(folder, name, signal, seconds, *, background=1.0):
    """A finished data set of given difference pictures (n, height, width)."""
    labels = preset("room").grid.labels
    records = [
        PoseRecord(0, v, labels[v], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0, file=f"{labels[v]}/0.exr")
        for v in range(len(signal))
    ]
    meta = {
        "sweep": {**to_dict(Sweep(poses=1, resolution=SHAPE[::-1])), "scene_sha256": name},
        "reference_radiance": 1.0,
        "scene": to_dict(preset("room")),
        "software": {"blender": "none"},
    }
    found = Dataset.create(folder / name, meta, records)
    found.write_background(BACKGROUND, np.full((*SHAPE, 3), background, dtype=np.float32), seed=0, samples=1)
    for record, picture in zip(records, signal, strict=True):
        pixels = np.repeat((background + picture)[..., None], 3, axis=2).astype(np.float32)
        found.write_pose(record, pixels, seconds=seconds, samples=1)
    found.gather()


@pytest.fixture
def folder(tmp_path):
    rng = np.random.default_rng(0)
    signal = 0.1 * rng.uniform(0.5, 1.0, size=(9, *SHAPE))
    make(tmp_path, tradeoff.REFERENCE, signal, 9.0)
    noise = rng.normal(size=signal.shape)
    noise *= 0.2 * np.sqrt((signal**2).mean(axis=(1, 2)) / (noise**2).mean(axis=(1, 2)))[:, None, None]
    make(tmp_path, "patch-4", signal + noise, 1.0)
    make(tmp_path, "patch-4-denoised", 0.9 * signal, 2.0, background=2.0)
    return tmp_path


def test_errors_are_relative_to_what_the_object_changes(folder):
    patch, denoised = tradeoff.costs(folder)
    assert (patch.name, patch.seconds) == ("patch-4", 1.0)
    assert patch.error[0] == pytest.approx(0.2, rel=1e-3)
    assert denoised.error[0] == pytest.approx(0.1, rel=1e-3)
    assert denoised.level == pytest.approx((0.9, 0.9, 0.9), rel=1e-3), "a bias, of which no interval makes one unsure"
    assert patch.level[1] < 1.0 < patch.level[2]
    assert [row[-1] for row in tradeoff.rows([patch, denoised])] == ["yes", "yes"]


def test_advice_takes_the_best_that_ends_in_time(monkeypatch):
    monkeypatch.setattr(tradeoff, "available_cores", lambda: 2)
    steps = [cost(f"patch-{n}", 0.1 * n, np.full(9, 1.0 / n)) for n in (1, 10, 100)]
    told = tradeoff.advice(steps, budgets=(10.0, 60.0, 600.0))
    assert told[0] == "900 pictures in 0:10: none ends; the quickest takes 0:45"
    assert told[1] == "900 pictures in 1:00: take patch-1, error 100 %; the next useful step, patch-10, takes 7:30"
    assert told[2].startswith("900 pictures in 10:00: take patch-10, error 10 %; the next useful step, patch-100")


def test_folders_without_a_finished_reference_are_one_sentence(tmp_path):
    with pytest.raises(NlosError, match="holds no reference"):
        tradeoff.costs(tmp_path)
    make(tmp_path, tradeoff.REFERENCE, np.ones((2, *SHAPE)), 1.0)
    with pytest.raises(NlosError, match="holds nothing beside the reference"):
        tradeoff.costs(tmp_path)


@pytest.mark.slow
def test_from_scene_to_worth(tmp_path, scene_file, command, monkeypatch, capsys):
    """Few ways, few pixels: the ladder is rendered, resumed, measured, and answered by an atlas of the same scene."""
    few = [
        Rung(tradeoff.REFERENCE, {"engine": "surfel", "accuracy": 1e-3}),
        Rung("surfel-0.1", {"engine": "surfel", "accuracy": 0.1}),
        Rung("patch-4", {"engine": "patch", "samples": 4}),
        Rung("patch-4096", {"engine": "patch", "samples": 2**24}),
    ]
    monkeypatch.setattr(tradeoff, "ladder", lambda reference: few)
    out = tmp_path / "trade"
    arguments = ["tradeoff", str(scene_file), "-o", str(out), "--poses", "1", "--resolution", "8", "--most", "10min"]
    assert cli.main(arguments) == 0
    told = capsys.readouterr().out
    assert "patch-4096: left out, would take about" in told
    files = {"costs.csv", "costs.png", "costs.svg"}
    assert {p.name for p in out.iterdir()} == {"reference", "surfel-0.1", "patch-4", *files}
    exact, noisy = sorted(tradeoff.costs(out), key=lambda cost: cost.error[0])
    assert exact.name == "surfel-0.1"
    assert exact.error[0] < 0.15
    assert noisy.error[0] > 1.0, "four samples are no picture of a thousandth"

    simulated, atlas = tmp_path / "simulated", tmp_path / "room.atlas"
    bulk = ("bulk", scene_file, "-o", simulated, "--pictures", "90", "--resolution", "8", "--accuracy", "0.01")
    assert command("generator", *bulk).returncode == 0
    assert classify_cli.main(["atlas", str(simulated), "-o", str(atlas)]) == 0
    assert classify_cli.main(["tradeoff", str(out), str(atlas), "--noises", "2"]) == 0
    told = capsys.readouterr().out
    assert "Without noise of rendering" in told
    assert "18 answers each" in told
    assert {"worth.png", "worth.svg", "report.html"} <= {p.name for p in out.iterdir()}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(("--poses", "0"), "--poses 0: must be from 1"), (("--most", "x"), "--time-limit 'x': must read like")],
)
def test_bad_input_is_one_sentence(tmp_path, scene_file, command, arguments, words):
    result = command("generator", "tradeoff", scene_file, "-o", tmp_path / "t", *arguments)
    assert result.returncode == 2
    assert words in result.stderr
    assert not (tmp_path / "t").exists()


def test_the_reference_does_not_price_the_quick_rungs():
    """Its accuracy of 1e-5 may take minutes; a rung at 10 % that takes none is not left out for it."""
    reference, *others = tradeoff.ladder({"engine": "surfel", "accuracy": 1e-5})
    kinds = [tradeoff._kind(rung) for rung in others]
    assert tradeoff._kind(reference) not in kinds
    assert len({kind for kind in kinds if kind.startswith("surfel")}) == 3
    of_patch = {tradeoff._kind(Rung(str(n), {"engine": "patch", "samples": n})) for n in (4, 64, 1024)}
    assert len(of_patch) == 1, "whose time is known from that of fewer samples"


SURFEL = Measured("surfel", 9, 4.0, 0.002, 0.02, 0.2, 0.0, 2.0)
PATCH = Measured("patch", 9, 4.0, 0.01, 0.015, 1.0, 10.0, 2.0)


def test_a_reference_judges_only_what_is_coarser():
    coarse = tradeoff.ladder({"engine": "surfel", "accuracy": 1e-3})
    assert [rung.name for rung in coarse if rung.name.startswith("surfel")] == ["surfel-0.1", "surfel-0.01"]
    few = tradeoff.ladder({"engine": "patch", "samples": 64})
    assert {rung.settings["samples"] for rung in few[1:]} == {4, 16}
    finest, *_, coarsest = tradeoff.references(SURFEL, 27)
    assert (finest[0]["accuracy"], coarsest[0]["accuracy"]) == (1e-5, 1e-3)
    assert finest[1] > 10.0 * coarsest[1] / 2.0
    assert [settings["samples"] for settings, _ in tradeoff.references(PATCH, 27)] == [4096, 1024, 256, 64, 16]


class Machine:
    """Renders in no time, and tells how long it would have taken: a clock, and stand-ins for trial and sweep."""

    def __init__(self, measured, slower=1.0):
        self.now, self.measured, self.slower, self.made = 0.0, measured, slower, []

    def clock(self):
        return self.now

    def trial(self, *_, deadline=None, **__):
        self.now += 6.0
        if deadline:
            deadline.check()
        return self.measured

    def run_until(self, deadline, request, progress):
        chosen = request.chosen
        each = self.slower * 0.015 * (chosen.get("samples") or 1.0 + (1e-3 / chosen["accuracy"]) ** 0.87)
        count = self.measured.voxels * chosen["poses"]
        taken = self.measured.start + count * each / self.measured.workers
        self.now += min(taken, deadline.left)
        rng = np.random.default_rng(len(self.made))
        signal = 0.1 + 1e-3 * rng.random((count, *SHAPE))
        done = count if deadline.left else 0
        if done:
            make(request.path.parent, request.path.name, signal, each)
            self.made.append(request.path.name)
        dataset = Dataset.open(request.path) if done else None
        return local.Outcome(dataset, done, [], count - done)


@pytest.mark.parametrize(("measured", "slower"), [(SURFEL, 1.0), (SURFEL, 40.0), (PATCH, 1.0), (PATCH, 5.0)])
@pytest.mark.parametrize("most", [30.0, 120.0, 3600.0])
def test_the_limit_holds_for_all_of_it(tmp_path, monkeypatch, measured, slower, most):
    """Also where pictures take far longer than the trial said; what is left out or stopped is named."""
    machine, told = Machine(measured, slower), []
    monkeypatch.setattr(tradeoff.budget, "measured_by_trial", machine.trial)
    monkeypatch.setattr(tradeoff.budget, "compiled", lambda *_, **__: 0.0)
    monkeypatch.setattr(tradeoff, "_run_until", machine.run_until)
    options = {"poses": 1, "most": most, "tell": told.append, "now": machine.clock}
    costs = None
    with contextlib.suppress(NlosError):
        costs = tradeoff.run(tmp_path / "a.blend", tmp_path, **options)
    assert machine.now <= most
    assert (costs is None) == (len(machine.made) < 2 or tradeoff.REFERENCE not in machine.made)
    if costs is not None:
        assert {cost.name for cost in costs} == set(machine.made) - {tradeoff.REFERENCE}
        left_out = {name for words in told if "left out" in words for name in words.partition(":")[0].split(", ")}
        every = {rung.name for rung in tradeoff.ladder(tradeoff.references(measured, 9)[0][0])}
        assert left_out | set(machine.made) == every
        assert not left_out & set(machine.made)
    assert costs is not None or most < 60.0 or slower > 1.0
