"""A plan of a scene: pieces that are found and left out, noise that is seen through, a sweep that follows."""

from __future__ import annotations

import tomllib

import bpy
import numpy as np
import pytest
import walls

from generator.blender.engines import simplify, survey
from generator.blender.measure import paired, planning
from generator.blender.scene import blend_file, build, materials, roles
from generator.blender.scene.description import read_scene
from generator.measure import plan_report, scene_plan
from generator.measure.scene_plan import Effect, Plan
from generator.model.deadline import Deadline
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.quantities import ALL_ORDERS
from generator.sets import plan_file
from generator.sets.dataset import Dataset
from generator.transport.left_out import PATCH, SHADOW


def built(target="sphere", order=3, ambient=0.0):
    """The room with all that `surfel` does not model."""
    scene = blend_file.new_file()
    wanted = preset("room", target)
    build.build(scene, wanted.with_ambient(ambient) if ambient else wanted)
    roles.limit_reflections(scene, order)
    return scene


def add(name, kind="plane", at=(-2.0, 1.0, 0.5), size=0.2, gloss=False):
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(
        location=at, **({"radius": size} if "sphere" in kind else {"size": size})
    )
    obj = bpy.context.object
    obj.name = name
    material = bpy.data.materials.new(f"of {name}")
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeBsdfGlossy" if gloss else "ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (0.6, 0.4, 0.2, 1.0)
    if not gloss:
        shader.inputs["Roughness"].default_value = 0.0
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    obj.data.materials.append(material)
    bpy.context.view_layer.update()
    return obj


def sun(name):
    bpy.ops.object.light_add(type="SUN", location=(-2.0, 2.0, 2.0))
    bpy.context.object.name = name
    bpy.context.object.data.energy = 1.0


def test_a_plain_scene_holds_nothing_that_surfel_does_not_model():
    assert simplify.removable_pieces(built()) == []


@pytest.mark.parametrize(
    ("edit", "piece"),
    [
        (lambda: add("Mirror", gloss=True), "the material 'of Mirror'"),
        (lambda: sun("Bulb"), "the lamp 'Bulb'"),
        (lambda: add("Ball", "uv_sphere").data.shade_smooth(), "the curved shading of 'Ball'"),
        (lambda: add("Bare").data.materials.clear(), "the default material of 'Bare'"),
    ],
)
def test_every_piece_is_found_and_can_be_left_out(edit, piece):
    scene = built()
    edit()
    bpy.context.view_layer.update()
    assert survey.world(scene)[0] is None
    assert piece in simplify.removable_pieces(scene)
    simplify.apply(scene, [piece])
    bpy.context.view_layer.update()
    assert survey.world(scene)[1] == []
    assert piece not in simplify.removable_pieces(scene)


def test_light_and_reflections_are_pieces():
    scene = built(order=5, ambient=2.0)
    assert simplify.removable_pieces(scene) == [simplify.BEYOND, simplify.AMBIENT]
    assert simplify.lights(scene) == [simplify.AMBIENT]
    simplify.apply(scene, [simplify.BEYOND, simplify.AMBIENT])
    assert roles.reflection_order(scene) == 3
    assert survey.world(scene)[1] == []


def test_a_mirror_left_out_keeps_its_colour():
    scene = built()
    mirror = add("Mirror", gloss=True)
    simplify.apply(scene, ["the material 'of Mirror'"])
    assert materials.diffuse_colour(mirror) == pytest.approx((0.6, 0.4, 0.2))


def test_what_is_fine_is_made_coarse():
    scene = built()
    ball = add("Ball", "ico_sphere")
    bpy.ops.object.modifier_add(type="SUBSURF")
    ball.modifiers[0].levels = ball.modifiers[0].render_levels = 2
    bpy.context.view_layer.update()
    assert f"{simplify.FINE}'Ball'" in simplify.removable_pieces(scene)
    simplify.apply(scene, [f"{simplify.FINE}'Ball'"])
    bpy.context.view_layer.update()
    evaluated = ball.evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert len(evaluated.to_mesh().polygons) < 200


@pytest.mark.parametrize("name", ["no such thing", "Spot", "the lamp 'Bulb'"])
def test_what_is_not_there_cannot_be_left_out(name):
    scene = built()
    name = roles.find(scene, "spot").name if name == "Spot" else name
    with pytest.raises(NlosError, match=r"is not in .* plan again"):
        simplify.apply(scene, [name])


def noisy(signal, noise, seed):
    """A round of two independent pictures of signals (n, pixels)."""
    rng = np.random.default_rng(seed)
    return signal + noise * rng.normal(size=(2, *signal.shape))


def test_shares_are_seen_through_noise():
    """The interval of noisy pictures holds the true share in about 95 % of the cases, and means it."""
    rng = np.random.default_rng(0)
    signal = rng.uniform(0.5, 1.5, size=(9, 256))
    held, widths = 0, []
    for trial in range(200):
        wholes = [noisy(signal, 1.0, 1000 * trial + k) for k in range(6)]
        errors = [noisy(0.1 * signal, 0.3, 1000 * trial + 100 + k) for k in range(6)]
        value, low, high = paired.share(errors, wholes)
        held += low <= 0.1 <= high
        widths.append(high - low)
        assert low <= value <= high
    assert held >= 180
    assert np.median(widths) < 0.1


def test_noise_that_hides_the_whole_decides_nothing():
    wholes = [noisy(np.zeros((2, 16)), 1.0, k) for k in range(4)]
    errors = [noisy(np.zeros((2, 16)), 1e-6, k) for k in range(4)]
    value, low, high = paired.share(errors, wholes)
    assert np.isnan(value)
    assert (low, high) == (0.0, np.inf)


class Probe:
    """Difference pictures with little noise, whose rendering takes as long as a clock says."""

    def __init__(self, seconds):
        self.rounds, self.deadline, self.now, self.seconds = range(48), Deadline(), 0.0, seconds
        self.signal = np.random.default_rng(0).uniform(0.5, 1.5, size=(9, 64))

    def _rendered(self, share, number):
        for _ in self.signal:
            self.deadline.check()
            self.now += self.seconds / len(self.signal)
        return noisy(share * self.signal, 0.01, number)

    def errors(self, dropped, number):
        return self._rendered(0.5 if dropped == ["Wall"] else 1e-4, number)

    def raised(self, order, number):
        return self._rendered(0.2, 1000 * order + number)

    def whole(self, number):
        return noisy(self.signal, 0.01, 500 + number)


@pytest.mark.parametrize(
    ("limit", "measured"), [(4.0, set()), (8.0, {"Wall"}), (11.0, {"Wall", "Dust"}), (100.0, {"Wall", "Dust", "4th"})]
)
def test_rounds_end_in_time_and_what_they_leave_out_is_unknown(limit, measured):
    """A second a round of each effect, four rounds at least: 12 for three; further reflections are left out first."""
    probe = Probe(1.0)
    deadline = Deadline(limit, lambda: probe.now)
    shares = paired.measure(probe, ["Wall", "Dust"], orders=[4], tolerance=0.01, deadline=deadline)
    known = {name for name, found in shares.items() if not np.isnan(found[0])}
    assert known == {paired.order_name(4) if name == "4th" else name for name in measured}
    assert probe.now <= limit
    if "Dust" in known:
        assert shares["Dust"][2] < 0.01 < shares["Wall"][1]


def test_a_plan_says_what_it_keeps_for_want_of_time():
    effects = [
        Effect("Wall", (0.5, 0.4, 0.6)),
        Effect("Dust", (1e-4, 0.0, 2e-4)),
        Effect("Air", (1e-5, 0.0, 2e-5)),
        Effect("Fog", scene_plan.UNKNOWN),
    ]
    settings = {"engine": "patch"}
    plan = Plan(effects, ["Air"], effects[2], settings, unmeasured=["Fog", "what the plan costs"])
    assert [row[-1] for row in scene_plan.rows(plan)] == ["needed", "kept to be safe", "left out", "kept to be safe"]
    words = scene_plan.words(plan)
    assert "plan: patch, samples not known; error 0.001 % (0 to 0.002)" in words
    unmeasured = "Fog, what the plan costs"
    assert f"not measured, for the time was over: {unmeasured}; more time (--time-limit) would tell" in words


def test_a_plan_without_samples_takes_those_of_the_user(tmp_path):
    scene = tmp_path / "room.blend"
    scene.write_bytes(b"not read")
    plan_report.write(tmp_path, scene, Plan([], [], Effect("nothing", (0.0, 0.0, 0.0)), {"engine": "patch"}), "title")
    assert plan_file.followed(tmp_path, scene, {"samples": 7}) == {"engine": "patch", "samples": 7}
    with pytest.raises(NlosError, match="engine: follows from --plan"):
        plan_file.followed(tmp_path, scene, {"engine": "path"})


def test_a_plan_is_written_and_followed(tmp_path):
    scene = tmp_path / "room.blend"
    scene.write_bytes(b"not read")
    effects = [
        Effect("Wall", (0.5, 0.4, 0.6)),
        Effect("Dust", (1e-4, 0.0, 2e-4)),
        Effect("Fog", (np.nan, 0.0, np.inf)),
    ]
    settings = {"engine": "surfel", "accuracy": 0.003}
    plan = Plan(effects, ["Dust"], effects[1], settings, 0.01)
    plan_report.write(tmp_path / "plan", scene, plan, "title")
    made = tomllib.loads((tmp_path / "plan" / "plan.toml").read_text())
    assert made["effects"]["Wall"] == {"error": [0.5, 0.4, 0.6], "verdict": "needed"}
    assert plan_file.read(tmp_path / "plan", scene) == {**settings, "leave_out": ["Dust"]}
    assert plan_file.followed(tmp_path / "plan" / "plan.toml", scene, {"poses": 3})["poses"] == 3
    with pytest.raises(NlosError, match="accuracy: follows from --plan"):
        plan_file.followed(tmp_path / "plan", scene, {"accuracy": 0.1})
    scene.write_bytes(b"edited")
    with pytest.raises(NlosError, match="is a plan of another scene"):
        plan_file.read(tmp_path / "plan", scene)
    (tmp_path / "plan" / "plan.toml").write_text("format = 1")
    with pytest.raises(NlosError, match="is no plan of format 1"):
        plan_file.read(tmp_path / "plan", scene)


@pytest.mark.slow
def test_a_small_mirror_far_away_is_left_out_and_surfel_takes_over(tmp_path, monkeypatch):
    """Measured by Cycles, through its noise, in as few rounds as it takes; a mirror as wide as a wall is not."""
    monkeypatch.setattr(paired, "ROUNDS", (paired.ROUNDS[0],) * 2)
    scene = built()
    scene.render.resolution_x = scene.render.resolution_y = 16
    add("Speck", at=(-2.3, 3.3, 0.1), size=0.02, gloss=True)
    path = tmp_path / "speck.blend"
    blend_file.save_file(path)
    plan = planning.make(path, tolerance=0.1, count=4, most=3600.0)
    speck = next(effect for effect in plan.effects if "Speck" in effect.name)
    assert speck.share[2] < 0.1
    assert "the material 'of Speck'" in plan.dropped
    assert plan.settings["engine"] == "surfel"
    assert next(effect for effect in plan.effects if effect.name == SHADOW).name not in plan.dropped
    more = next(effect for effect in plan.effects if effect.name == paired.order_name(4))
    assert more.note == "not in the scene"


@pytest.mark.slow
def test_a_faint_sky_is_left_out_and_surfel_takes_over(tmp_path, monkeypatch):
    """Half the sky changes the pictures by half as much; no render by Cycles is needed to know."""
    monkeypatch.setattr(planning, "_ORDERS", ())  # what is not in the scene is followed once, at the end
    shares = []
    for number, radiance in enumerate((1e-6, 2e-6)):
        scene, path = built(ambient=radiance), tmp_path / f"{number}.blend"
        scene.render.resolution_x = scene.render.resolution_y = 16
        blend_file.save_file(path)
        planned = planning._planned(scene, read_scene(scene), "patch", 2, 0)
        effects = planning.followed(path, sorted(planned, key=lambda p: (p.index, p.voxel)))
        shares.append({effect.name: effect for effect in effects}[simplify.AMBIENT].share)
    assert shares[1][0] == pytest.approx(2.0 * shares[0][0], rel=0.1)
    plan = planning.make(tmp_path / "0.blend", tolerance=0.3, count=2, by_cycles=False, predict=False)
    assert simplify.AMBIENT in plan.dropped
    assert plan.settings["engine"] == "surfel"
    assert plan.together.share[0] > plan.effects[[e.name for e in plan.effects].index(simplify.AMBIENT)].share[0]
    monkeypatch.undo()
    built()
    blend_file.save_file(tmp_path / "dark.blend")
    effects = {effect.name: effect for effect in planning.followed(tmp_path / "dark.blend", planned)}
    assert simplify.AMBIENT not in effects
    fourth, every = (effects[paired.order_name(order)] for order in (4, ALL_ORDERS))
    assert fourth.note == every.note == "not in the scene"
    assert 0.1 < fourth.share[0] < every.share[0]  # in a closed room, three reflections are not all of it


@pytest.mark.slow
def test_reflections_beyond_the_third_are_paid_for_or_left_out(tmp_path):
    """A closed room's are much of what the object changes; a tolerance above that leaves them out."""
    scene, path = built(), tmp_path / "room.blend"
    roles.limit_reflections(scene, 6)
    scene.render.resolution_x = scene.render.resolution_y = 16
    blend_file.save_file(path)
    kept = planning.make(path, tolerance=0.01, count=2, by_cycles=False, predict=False)
    assert simplify.BEYOND not in kept.dropped
    assert kept.settings["engine"] == "surfel"
    share = kept.effects[[e.name for e in kept.effects].index(simplify.BEYOND)].share
    assert share[0] > 0.1
    left = planning.make(path, tolerance=4.0 * share[2], count=2, by_cycles=False, predict=False)
    assert simplify.BEYOND in left.dropped


@pytest.mark.slow
def test_the_denoiser_is_wrong_in_the_mean_and_its_noise_is_not_counted(tmp_path):
    """Twenty-four pictures' noise is far above their signal, yet what is told is the bias alone."""
    path = tmp_path / "room.blend"
    scene = built()
    blend_file.save_file(path)
    described = read_scene(scene)
    planned = planning._planned(scene, described, "patch", paired.ROUNDS[0], 0)
    rounds = [[p for p in planned if p.index == k] for k in range(paired.ROUNDS[0])]
    probe = paired.PairedMeasurement(path, "patch", rounds)
    value, low, high = paired.denoiser_bias(probe, (24, 24), deadline=Deadline())
    error, plain = probe.denoised((24, 24), 0)
    signal = (plain[0] * plain[1]).mean()
    assert 0.02 < value < np.sqrt((error**2).mean() / signal)
    assert low < value < high


@pytest.mark.slow
def test_from_the_shell(tmp_path, command):
    scene_file, folder, data = tmp_path / "room.blend", tmp_path / "plan", tmp_path / "data"
    few = ("--target", "sphere", "--set", "resolution=[16,16]")
    assert command("generator", "scene", "room", *few, "-o", scene_file).returncode == 0
    result = command(
        *("generator", "plan", scene_file, "-o", folder, "--poses", "4", "--tolerance", "2%", "--no-cycles")
    )
    assert result.returncode == 0, result.stderr
    assert SHADOW in result.stdout
    assert "within 2 % one may leave out" in result.stdout
    assert {p.name for p in folder.iterdir()} == {"plan.toml", "plan.csv", "plan.png", "plan.svg"}
    settings = tomllib.loads((folder / "plan.toml").read_text())["settings"]
    assert PATCH in settings["leave_out"]
    sweep = ("generator", "sweep", scene_file, "-o", data, "--poses", "1", "--resolution", "16")
    made = command(*sweep, "--plan", folder)
    assert made.returncode == 0, made.stderr
    assert (data / "plan.toml").read_text() == (folder / "plan.toml").read_text()
    own = Dataset.open(data).settings
    assert own["leave_out"] == settings["leave_out"]
    assert own["engine"] == "surfel"
    assert "nothing to do" in command(*sweep, "--plan", folder).stdout
    whole = tmp_path / "whole"
    assert command(*sweep[:4], whole, *sweep[5:], "--engine", "surfel").returncode == 0
    from generator.measure.tradeoff import differences

    got, wanted = differences(Dataset.open(data)), differences(Dataset.open(whole))
    error = ((got - wanted) ** 2).mean(axis=(1, 2)) / (wanted**2).mean(axis=(1, 2))
    assert 0.0 < np.sqrt(error.mean()) < 0.03
    refused = command("generator", "plan", scene_file, "--tolerance", "2")
    assert refused.returncode == 2
    assert "--tolerance '2': must be between 0 and 1" in refused.stderr
    twice = command("generator", "sweep", scene_file, "-o", tmp_path / "x", "--plan", folder, "--engine", "patch")
    assert twice.returncode == 2
    assert "engine: follows from --plan" in twice.stderr


def test_what_else_a_relay_wall_is_cannot_be_left_out(tmp_path):
    scene = built("sheet")
    walls.joined(scene)
    path = tmp_path / "joined.blend"
    blend_file.save_file(path)
    assert survey.room_names(scene) == ["Partition", "Relay wall"]
    assert planning._room(path, []) == ["Partition"]
