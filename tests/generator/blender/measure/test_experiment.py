"""The paper's experiments: what is measured of them is free of the noise's bias, and the scene is left as it was."""

from __future__ import annotations

import contextlib
import csv

import bpy
import numpy as np
import pytest

from generator.blender.measure import experiment
from generator.blender.measure.experiment import Experiment
from generator.blender.scene import blend_file, build, posing, roles
from generator.files.pictures import read_picture
from generator.model import poses
from generator.model.presets import preset
from generator.model.scene import Target


def made(repeats, noise, seed=0, size=24):
    """Pictures that change by 1, 2 and 0 times the signal per metre, with noise."""
    rng = np.random.default_rng(seed)
    rest = rng.normal(size=(size, size, 1)) + 3.0
    slope = np.ones_like(rest) * np.sqrt((rest**2).mean())
    step = 0.1
    rows = poses.experiment(1, (0.0, 0.0, 0.0), step=step)
    clean = np.array([[rest + k * step * rate * slope for k in range(-2, 3)] for rate in (1.0, 2.0, 0.0)])
    signals = clean[None] + rng.normal(scale=noise, size=(repeats, *clean.shape)) if noise else clean[None]
    return Experiment(1, "sphere", "patch", rows, step, signals)


def test_without_noise_the_change_is_exact():
    found = made(1, 0.0).changes()
    assert [value for value, _ in found] == pytest.approx([1.0, 2.0, 0.0], abs=1e-9)
    assert [half for _, half in found] == [0.0, 0.0, 0.0]


def test_noise_adds_nothing_and_the_interval_holds_the_truth():
    """Noise of half the signal would add 3.5 to each change if its square were taken; 60 trials."""
    held, values = 0, []
    for seed in range(60):
        for (value, half), truth in zip(made(6, 1.5, seed).changes(), (1.0, 2.0, 0.0), strict=True):
            held += value - half <= truth <= value + half
            values.append(value - truth)
    assert held >= 180 * 0.88  # 95 % less 3.9 standard deviations of 180 draws
    assert abs(np.mean(values[::3])) < 0.1


def test_what_noise_drowns_is_not_a_number():
    values = [made(2, 100.0, seed).changes()[0][0] for seed in range(12)]
    assert np.isnan(values).any()


def test_a_stand_in_leaves_no_trace():
    scene = blend_file.new_file()
    build.build(scene, preset("room"))
    target = roles.find(scene, "target")
    before = (len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.materials), target.hide_render)
    with contextlib.suppress(RuntimeError), posing.stand_in(scene, Target.named("sphere")):
        other = roles.find(scene, "target")
        assert other != target
        assert target.hide_render
        assert tuple(other.location) == pytest.approx(tuple(target.location))
        raise RuntimeError
    assert roles.find(scene, "target") == target
    assert (len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.materials), target.hide_render) == before


def test_both_engines_see_the_same():
    """Cycles' pictures of experiment 2 on the tabletop change as the integral's do, within their interval."""
    scene = blend_file.new_file()
    build.build(scene, preset("tabletop"))
    exact = experiment.run(scene, 2, "sheet", pixels=12)
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1e-9, 1e-9, 1e-9, 1.0)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1.0
    sampled = experiment.run(scene, 2, "sheet", pixels=12, samples=256, repeats=5)
    assert (exact.engine, sampled.engine) == ("surfel", "patch")
    for (truth, _), (value, half) in zip(exact.changes(), sampled.changes(), strict=True):
        assert abs(value - truth) < 2.0 * half


def test_the_command_line(tmp_path, scene_file, command):
    done = command("generator", "experiment", 3, "-o", tmp_path / "out", "--scene", scene_file, "--resolution", 12)
    assert done.returncode == 0, done.stderr
    assert "the paper's x and z matter most" in done.stdout
    with open(tmp_path / "out" / "changes.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6
    assert {row["unit"] for row in rows} == {"degree"}
    assert read_picture(tmp_path / "out" / "sheet-room-x.exr")[0].shape == (12, 60, 3)
    assert (tmp_path / "out" / "experiment-3-sphere.png").is_file()


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        (("--ambient", "-1"), "--ambient -1: must be 0, which is dark, or more"),
        (("--repeats", "0"), "--repeats 0: must be 1 or more"),
        (("--scene", "no.blend"), "no.blend"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, command, extra, words):
    done = command("generator", "experiment", 1, "-o", tmp_path / "out", *extra)
    assert done.returncode == 2
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
