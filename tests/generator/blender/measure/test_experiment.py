"""The paper's experiments: what is measured of them is free of the noise's bias, and the scene is left as it was."""

from __future__ import annotations

import contextlib
import csv
from dataclasses import replace

import bpy
import numpy as np
import pytest
from figure_texts import misplaced
from matplotlib.collections import QuadMesh

from generator.blender.measure import experiment, experiment_report
from generator.blender.measure.experiment import Experiment
from generator.blender.scene import blend_file, build, posing, roles
from generator.files.pictures import read_picture
from generator.measure import difference_panels
from generator.model import poses
from generator.model.arrays import rotation_matrix
from generator.model.presets import preset
from generator.model.scene import Target

CORNERS = np.array([[-0.5, 1.2], [-0.5, 0.6], [0.5, 0.6], [0.5, 1.2]])
"""A picture half a metre to each side of the origin, from the top right clockwise: the camera's right is -x."""


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


def test_axes_are_told_apart_by_their_difference():
    """The changes are 1, 2 and 0 of the signal per metre; noise that is large enough leaves the order open."""
    clear, drowned = made(6, 0.3), made(6, 20.0)
    assert (clear.stronger(1, 0), clear.stronger(0, 1), clear.stronger(2, 0)) == (True, False, False)
    assert drowned.stronger(1, 0) is None
    assert made(1, 0.0).stronger(1, 0) is True


def test_what_noise_drowns_is_not_a_number():
    values = [made(2, 100.0, seed).changes()[0][0] for seed in range(12)]
    assert np.isnan(values).any()


def exact(relative):
    """Noise-free pictures of a mean of 3 whose changes have a root mean square of a share of the signal."""
    found = made(1, 0.0)
    rest = found.signals[0, 0, 2]
    steps = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])[:, None, None, None]
    row = rest + steps * relative * np.sqrt((rest**2).mean())
    return replace(found, engine="surfel", signals=np.broadcast_to(row, (1, 3, *row.shape)).copy())


@pytest.mark.parametrize(("relative", "lost"), [(1e-9, [True] * 5), (1e-5, [False, False, True, False, False])])
def test_rounding_errors_are_no_signal(relative, lost):
    """In the middle stands the picture at rest itself."""
    noise, drowned = exact(relative).noise()
    assert (drowned == lost).all()
    assert noise == pytest.approx(noise[0, 0])


def test_a_panel_is_drowned_where_its_noise_is_above_its_signal():
    """Of 6 repeats with noise of 0.03, a difference has a standard error of 0.03 * sqrt(2 / 6): less than 0.1 * 3."""
    noise, drowned = made(6, 0.03).noise()
    assert noise[:, [0, 1, 3, 4]] == pytest.approx(0.03 * np.sqrt(2.0 / 6.0), rel=0.1)
    assert not drowned[:2, [0, 1, 3, 4]].any()
    assert drowned[2].all(), "nothing changes along the third axis"
    assert np.isnan(made(1, 0.0).noise()[0]).all(), "of Cycles, from one repeat"


def test_steps_are_told_in_metres_and_each_voxel_axis_of_its_own():
    found = replace(made(1, 0.0), voxel=(0.2, 0.5, 1.4))
    cells = experiment_report._cells(found)
    assert [row[4:7] for row in cells] == [["0.1", "m", "0.5"], ["0.1", "m", "0.2"], ["0.1", "m", "0.07143"]]
    block = experiment_report._block("room", replace(found, corners=CORNERS))
    assert block.axes == ["along x, voxel 20 cm", "along y, voxel 50 cm", "along z, voxel 140 cm"]
    assert list(block.columns) == ["-20 cm", "-10 cm", "+10 cm", "+20 cm"]


def test_panels_below_noise_are_marked_and_not_amplified(tmp_path, drawn):
    places = {"dark": replace(exact(1e-9), corners=CORNERS), "lit": replace(exact(1e-5), corners=CORNERS)}
    files = experiment_report._draw(tmp_path / "e.png", places)
    assert [file.name for file in files] == ["e.png", "e.svg"]
    [figure] = drawn
    texts = [text.get_text() for axis in figure.axes for text in axis.texts]
    assert len([words for words in texts if words.startswith("below noise")]) == 12
    meshes = [axis for axis in figure.axes if any(isinstance(c, QuadMesh) for c in axis.collections)]
    bars = [axis for axis in figure.axes if "W/m²/sr" in axis.get_ylabel()]
    assert len(meshes) == 12 + len(bars)
    assert len(bars) == 3, "a row each"
    assert misplaced(figure) == []


def test_pictures_lie_on_the_wall_as_the_camera_sees_them():
    """A frontal camera by its rectangle; an oblique one by the projection of a point inside."""
    x, z = difference_panels.on_wall(CORNERS, 2, 4)
    assert x[0] == pytest.approx([0.5, 0.25, 0.0, -0.25, -0.5])
    assert z[:, 0] == pytest.approx([1.2, 0.9, 0.6])
    camera = np.array([0.3, 2.0, 0.1])
    ways = np.array([[x, -1.0, z] for x, z in ((-0.5, 0.4), (-0.5, -0.4), (0.5, -0.4), (0.5, 0.4))])
    turn = rotation_matrix((10.0, 0.0, 25.0))

    def hit(way):
        ray = turn @ way
        return (camera - ray * camera[1] / ray[1])[[0, 2]]

    x, z = difference_panels.on_wall(np.array([hit(way) for way in ways]), 4, 4)
    assert (x[1, 3], z[1, 3]) == pytest.approx(tuple(hit(np.array([-0.25, -1.0, 0.2]))))


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
    sky = scene.world.node_tree.nodes["Background"]
    sky.inputs["Strength"].default_value = 1e-9
    checks = scene.world.node_tree.nodes.new("ShaderNodeTexChecker")  # not uniform, so that only Cycles can follow it
    scene.world.node_tree.links.new(checks.outputs["Color"], sky.inputs["Color"])
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
    assert all((tmp_path / "out" / f"experiment-3-sphere.{kind}").is_file() for kind in ("png", "svg"))
    sphere, sheet = ([row for row in rows if row["target"] == kind] for kind in ("sphere", "sheet"))
    assert [row["below_noise"] for row in sphere] == ["4", "4", "4"], "what it shows is rounding"
    assert "0" in {row["below_noise"] for row in sheet}


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
