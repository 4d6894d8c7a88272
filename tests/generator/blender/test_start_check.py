"""The check at the start of a sweep: plain Cycles against the chosen engine, at the first pose."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from generator.blender import start_check, sweep_worker
from generator.blender.scene import blend_file, build, roles
from generator.blender.scene.description import read_scene
from generator.files.toml import read_toml
from generator.measure import agreement
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.sets.bulk_set import Bulk
from generator.sets.dataset import Dataset

FEW = {"poses": 1, "resolution": [8, 8]}


def light(rng, rays, mean, *, weight=1.0, pixels=256):
    """Pixels (16, 16, 3) of a path tracer that finds light of that weight by rare chance, (1, 16, 16, 3)."""
    hits = rng.poisson(rays / pixels * mean / weight, size=(1, 16, 16, 1))
    return np.repeat(hits * weight * pixels / rays, 3, axis=3).astype(np.float64)


def judged(rng, rays, mean, claimed, **options):
    plain = light(rng, rays, mean, **options)
    return agreement.compare(plain, np.full_like(plain, claimed), samples=rays / 256, peak=2.0)


@pytest.mark.parametrize("hits", [0.1, 1.0, 5.0, 20.0, 40.0, 70.0, 100.0, 300.0, 3000.0, 30000.0])
def test_rare_light_is_no_reason_to_stop(hits):
    """Poisson hits are as skewed as light found by chance; 2,000 pictures at each level, in the mean and quarters."""
    rng = np.random.default_rng(int(10 * hits))
    mean, rays = 1e-3, round(hits / 1e-3)
    stopped = sum(agreement.worst(judged(rng, rays, mean, mean)).differs for _ in range(2000))
    assert stopped == 0  # of 20,000 in all: under 1.5e-4 at 95 %


def test_weights_of_all_sizes_are_no_reason_to_stop():
    """Contributions spread over three decades, the largest carrying a good part of the light."""
    rng = np.random.default_rng(3)
    weights = np.array([2.0, 0.2, 0.02, 0.002])
    shares = np.array([0.4, 0.3, 0.2, 0.1])
    stopped = 0
    for _ in range(2000):
        rays = int(10 ** rng.uniform(4, 7))
        parts = [light(rng, rays, 1e-3 * s, weight=w) for w, s in zip(weights, shares, strict=True)]
        plain = np.sum(parts, axis=0)
        figures = agreement.compare(plain, np.full_like(plain, 1e-3), samples=rays / 256, peak=2.0)
        stopped += agreement.worst(figures).differs
    assert stopped == 0


@pytest.mark.parametrize(
    ("factor", "hits"), [(0.0, 200), (0.15, 200), (0.5, 400), (1.8, 400), (2.66, 200), (7.1, 100)]
)
def test_what_is_wrong_is_found(factor, hits):
    """The issue's factors: the engine claims that many times the light there is (hits are those of the truth)."""
    rng = np.random.default_rng(5)
    mean, rays = 1e-3, round(hits / 1e-3)
    found = [agreement.worst(judged(rng, rays, mean, factor * mean)) for _ in range(200)]
    assert all(figure.differs for figure in found)
    assert {figure.where for figure in found} == {""}, "the whole picture says it best"


def test_light_that_is_not_there_at_all_is_found():
    """Plain Cycles black: nothing scatters, so only how many paths should have found the light can tell."""
    black = np.zeros((1, 16, 16, 3))
    claimed = np.full_like(black, 1e-3)
    assert not agreement.worst(agreement.compare(black, claimed, samples=50, peak=2.0)).differs  # 6 hits expected
    assert agreement.worst(agreement.compare(black, claimed, samples=1000, peak=2.0)).differs  # 128


def test_a_part_of_the_picture_and_a_colour_are_judged_too():
    rng = np.random.default_rng(7)
    plain = 1.0 + 0.01 * rng.standard_normal((2, 16, 16, 3))
    engine = np.ones_like(plain)
    assert not agreement.worst(agreement.compare(plain, engine, samples=1e6, peak=2.0)).differs
    engine[1, :8, 8:, 1] *= 1.04
    engine[1, 8:, :8, 1] *= 0.96
    bad = agreement.worst(agreement.compare(plain, engine, samples=1e6, peak=2.0))
    assert bad.differs
    assert (bad.what, bad.colour) == (agreement.WHAT[1], "green")
    assert bad.where in ("upper right quarter", "lower left quarter")


def test_what_an_engine_owns_up_to_is_allowed():
    rng = np.random.default_rng(9)
    plain = 1.0 + 0.001 * rng.standard_normal((2, 16, 16, 3))
    engine = 1.015 * np.ones_like(plain)
    assert agreement.worst(agreement.compare(plain, engine, samples=1e6, peak=2.0)).differs
    assert not agreement.worst(
        agreement.compare(plain, engine, samples=1e6, peak=2.0, tolerances=(0.02, 0.05))
    ).differs


# What an engine gets wrong today is mended tomorrow. So here the engine is given another scene than plain Cycles is:
# as if it had read the file wrongly.


def _wall_dark(scene):
    roles.find(scene, "relay_wall").active_material.node_tree.nodes["Diffuse BSDF"].inputs["Color"].default_value = (
        *(0.3, 0.3, 0.3),
        1.0,
    )


def _wall_red(scene):
    roles.find(scene, "relay_wall").active_material.node_tree.nodes["Diffuse BSDF"].inputs["Color"].default_value = (
        *(0.8, 0.5, 0.5),
        1.0,
    )


def _camera_moved(scene):
    roles.find(scene, "camera").location.x -= 0.8


def _lamp_child(scene):
    """A lamp that moves with the target, of which the other renderer knows nothing."""
    made = bpy.data.objects.new("Glow", bpy.data.lights.new("Glow", "POINT"))
    made.data.energy = 1.0
    scene.collection.objects.link(made)
    made.parent = roles.find(scene, "target")
    made.location = (0.0, 0.3, 0.0)


def _target_black(scene):
    """As a mirror is to a lamp that cannot be met by chance."""
    target = roles.find(scene, "target")
    target.active_material.node_tree.nodes["Diffuse BSDF"].inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)


def _stamp(scene):
    scene.render.use_stamp = True
    scene.render.stamp_background = (1.0, 1.0, 1.0, 1.0)


def _sky(scene):
    build.build(scene, replace(read_scene(scene), ambient=0.001))


def _nothing(scene):
    pass


def made(path, edit, kind="sphere"):
    scene = blend_file.new_file()
    build.build(scene, replace(preset("room", kind), room=None))
    edit(scene)
    bpy.context.view_layer.update()
    blend_file.save_file(path)
    return path


@pytest.fixture
def plan(tmp_path):
    """Plan a sweep of the room, where the engine and plain Cycles are given different scenes."""

    def run(by_engine, by_cycles, engine, *, kind="sphere", **chosen):
        source = made(tmp_path / "scene.blend", by_engine, kind)
        other = made(tmp_path / "other.blend", by_cycles, kind)
        settings = {**FEW, "engine": engine, **chosen}
        return sweep_worker.plan(
            blend_file.open_file(source), source, tmp_path / "a" / "set", settings, reference=other
        )

    return run


WRONG = {
    "background": [(_wall_dark, _nothing), (_nothing, _wall_dark), (_camera_moved, _nothing), (_nothing, _sky)],
    "change by the target": [(_target_black, _nothing), (_nothing, _target_black), (_nothing, _lamp_child)],
}


CASES = [
    *((what, engine, *edits) for what, some in WRONG.items() for edits in some for engine in ("path",)),
    ("background", "patch", _nothing, _sky),
    ("change by the target", "patch", _nothing, _lamp_child),
    ("background", "surfel", _nothing, _sky),
    *(  # each takes Cycles 5 s to tell
        pytest.param("change by the target", *case, marks=pytest.mark.slow)
        for case in (
            ("patch", _nothing, _target_black),
            ("surfel", _target_black, _nothing),
            ("surfel", _nothing, _wall_dark),
        )
    ),
]


@pytest.mark.parametrize(("what", "engine", "by_engine", "by_cycles"), CASES)
def test_another_picture_than_plain_cycles_makes_stops_the_sweep(
    plan, tmp_path, monkeypatch, what, engine, by_engine, by_cycles
):
    monkeypatch.setattr(start_check, "LIMITS", (60.0, 60.0, 60.0))  # it stops when it knows, on a busy machine too
    with pytest.raises(NlosError) as error:
        plan(by_engine, by_cycles, engine)
    words = str(error.value)
    assert f"the engine {engine!r} does not render what Cycles makes of this file" in words
    if engine != "path":  # whose pixels may already differ in what is named first
        assert f"the {what}" in words
    assert "W/m²/sr by plain Cycles and" in words
    assert "--no-probe" in words
    assert "--engine path" not in words, "which is wrong too"
    assert not (tmp_path / "a").exists(), "nothing is left, nor the folders that were made for it"


def test_only_a_number_has_a_unit():
    check = SimpleNamespace(pose=SimpleNamespace(label="A"), sweep=SimpleNamespace(engine="surfel"))
    known = agreement.Figure("background", "", "", 1.0, 1.0, 0.01, 1e4)
    vague = agreement.Figure("change by the target", "", "", 1.0, 1.0, 10.0, 1.0)
    words = start_check._words(check, [known, vague], 0.0, 1.0)
    assert words.endswith(
        "agree within the noise: background 1 W/m²/sr and 1 W/m²/sr ± 20 mW/m²/sr; "
        "change by the target too noisy to compare in this time"
    )
    assert "W/m²/sr" not in start_check._words(check, [vague], 0.0, 1.0)


@pytest.mark.parametrize("engine", ["path", "patch", "surfel"])
def test_what_renders_right_goes_on_and_says_so(plan, tmp_path, engine):
    dataset = plan(_nothing, _nothing, engine)
    found = Dataset.open(tmp_path / "a" / "set").meta["start_check"]
    assert found["voxel"] == "A"
    assert found["seconds"] > 0.0
    plain, by_engine, error = found["difference"]
    if engine == "path":
        assert plain == by_engine
        assert found["words"].endswith("plain Cycles and path give the same pixels")
    else:
        assert abs(plain - by_engine) < 6.0 / 1.96 * error
        assert "agree within the noise" in found["words"]
    assert not dataset.records, "it renders no picture of the set"


def test_no_probe_renders_all_the_same(tmp_path):
    source, other = made(tmp_path / "a.blend", _stamp), made(tmp_path / "b.blend", _nothing)
    settings = {**FEW, "engine": "path"}
    dataset = sweep_worker.plan(
        blend_file.open_file(source), source, tmp_path / "set", settings, probe=False, reference=other
    )
    assert "start_check" not in dataset.meta


@pytest.mark.slow
def test_the_command_tells_its_time_once_and_a_set_goes_on_without(tmp_path, command):
    source = made(tmp_path / "a.blend", _nothing)
    some = (*("--engine", "path", "--poses", "1", "--resolution", "8", "--samples", "1"), "--workers", "1")
    first = command("generator", "sweep", source, "-o", tmp_path / "set", *some, "--shard", "0/9", probe=True)
    assert first.returncode == 0, first.stderr
    assert first.stdout.count("start check, ") == 1
    assert " s: in voxel A plain Cycles and path give the same pixels" in first.stdout
    then = command("generator", "sweep", source, "-o", tmp_path / "set", *some, "--shard", "1/9", probe=True)
    assert then.returncode == 0, then.stderr
    assert "start check" not in then.stdout
    known = Dataset.open(tmp_path / "set").meta
    without = command("generator", "sweep", source, "-o", tmp_path / "other", *some)
    assert "start check" not in without.stdout
    plain = Dataset.open(tmp_path / "other")
    assert plain.meta["fingerprint"] == known["fingerprint"], "the check is no setting"


@pytest.mark.slow
def test_bulk_is_checked_too(tmp_path, command):
    source = made(tmp_path / "a.blend", _nothing)
    some = ("--pictures", "9", "--resolution", "8", "--accuracy", "0.01", "--workers", "1")
    result = command("generator", "bulk", source, "-o", tmp_path / "set", *some, probe=True)
    assert result.returncode == 0, result.stderr
    assert "plain Cycles and surfel agree within the noise" in result.stdout
    assert read_toml(tmp_path / "set" / "bulk.toml")["start_check"]["difference"][2] > 0.0
    assert Bulk.open(tmp_path / "set").planned == 9


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bulk", "sweep"])
def test_a_set_with_more_reflections_tells_how_far_their_cells_err(tmp_path, command, kind):
    source = tmp_path / "a.blend"
    made = command("generator", "scene", "room", "-o", source, "--set", "reflection_order=4")
    assert made.returncode == 0, made.stderr
    few = ("--pictures", "9") if kind == "bulk" else ("--poses", "1", "--engine", "surfel")
    some = (*few, "--resolution", "8", "--accuracy", "0.03", "--workers", "1")
    result = command("generator", kind, source, "-o", tmp_path / "set", *some, probe=True)
    assert result.returncode == 0, result.stderr
    assert "light check: at 9 poses light of many reflections errs by" in result.stdout
    found = read_toml(tmp_path / "set" / ("bulk.toml" if kind == "bulk" else "dataset.toml"))["light_check"]
    assert found["poses"] == 9
    assert 0.0 < found["median"] <= found["worst"] < 0.5
    assert found["asked"] == 0.03
