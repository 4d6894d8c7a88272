"""What would spoil a sweep is found, named and mended; what is measured is what a sweep then shows."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from numpy.testing import assert_allclose

from generator import adopt, check, engines, experiments, stage, worker
from generator.check import ERROR, GOOD, NOTE, WARNING
from generator.dataset import read_picture
from generator.spec import NlosError, Sweep, preset


def built(name="room", target="sheet"):
    scene = stage.new_file()
    stage.build(scene, preset(name, target))
    return scene


def told(scene, level, **options):
    return [f for f in check.findings(scene, **options) if f.level == level]


@pytest.mark.parametrize("name", ["room", "tabletop", "corridor"])
def test_presets_are_sound(name):
    scene = built(name)
    assert not told(scene, ERROR)
    # Klein et al. have the lit patch in the picture.
    assert [f.text[:14] for f in told(scene, WARNING)] == (["'Spot' lights "] if name == "tabletop" else [])
    assert [f.text[:13] for f in told(scene, GOOD)] == ([] if name == "tabletop" else ["Voxels A to I"])
    hidden = [f for f in told(scene, NOTE) if "Nothing hides" in f.text]
    assert bool(hidden) == (name == "tabletop")  # which hides its object by looking elsewhere


def test_missing_and_double_roles():
    scene = built()
    bpy.data.objects.remove(stage.find(scene, "target"))
    [found] = check.findings(scene)
    assert found.level == ERROR
    assert "No object is the target" in found.text
    wall = stage.find(scene, "relay_wall")
    wall.copy()
    twin = wall.copy()
    scene.collection.objects.link(twin)
    texts = [f.text for f in check.findings(scene)]
    assert any("2 objects are the relay wall" in text for text in texts)


def test_lamp_that_shines_into_a_voxel():
    scene = built()
    lamp = stage.find(scene, "spot")
    lamp.location = (1.5, 3.2, 1.3)
    lamp.rotation_euler = (math.pi / 2.0, 0.0, math.pi)  # along -y, through the middle voxels
    bpy.context.view_layer.update()
    found = [f for f in told(scene, ERROR) if "shines straight into" in f.text]
    assert [f.object for f in found] == [lamp.name]
    assert "B, E, H" in found[0].text


def test_lit_patch_in_the_picture():
    scene = built()
    lamp = stage.find(scene, "spot")
    lamp.rotation_euler = (math.pi / 2.0, 0.0, math.pi)  # at x = -1.0, z = 1.7: just outside; 0.3 m aside: inside
    lamp.location.x = -0.5
    bpy.context.view_layer.update()
    assert any("lights the watched patch" in f.text for f in told(scene, WARNING))


def test_without_a_partition_nothing_hides():
    scene = built()
    for screen in stage.players(scene, "partition"):
        bpy.data.objects.remove(screen)
    texts = [f.text for f in told(scene, NOTE) if "Nothing hides" in f.text]
    assert len(texts) == 2  # from the lamp, and from the camera


def test_a_voxel_in_the_dark():
    scene = built()
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(2.05, 0.65, 1.3))
    bpy.context.object.scale = (0.49, 0.49, 1.9)  # around voxel C, not around its neighbours
    bpy.context.view_layer.update()
    [found] = [f for f in told(scene, ERROR) if "does not see" in f.text]
    assert "Voxel C" in found.text


@pytest.mark.parametrize(
    ("spoil", "fix", "words"),
    [
        (lambda s: stage.limit_reflections(s, 2), "reflections", "2 reflections at most"),
        (lambda s: setattr(stage.find(s, "target"), "hide_render", True), "show", "hidden from renders"),
        (lambda s: setattr(stage.find(s, "relay_wall"), "location", (0.0, -0.2, 0.0)), "align", "plane y = 0"),
        (lambda s: s.pop(stage.GRID_SHAPE), "voxels", "voxel grid"),
    ],
)
def test_what_can_be_mended_is(spoil, fix, words):
    scene = built()
    spoil(scene)
    bpy.context.view_layer.update()
    found = [f for f in told(scene, ERROR) if f.fix == fix]
    assert found, check.findings(scene)
    assert words in found[0].text
    check.mend(scene, fix)
    assert not [f for f in check.findings(scene) if f.fix == fix]
    with pytest.raises(NlosError, match="there is none"):
        check.mend(scene, "magic")


def test_engine_that_cannot():
    scene = built()
    node = stage.find(scene, "target").data.materials[0].node_tree.nodes["Diffuse BSDF"]
    node.inputs["Roughness"].default_value = 0.5
    assert any("cannot honour" in f.text and f.object for f in told(scene, ERROR, engine="surfel"))
    assert not told(scene, ERROR, engine="auto")
    assert not told(scene, ERROR, engine="patch")
    assert any("in less time" in f.text for f in told(built(), NOTE, engine="patch"))


def test_the_probe_foretells_signal_and_noise():
    scene = built()
    size = (16, 16)
    sweep = Sweep(engine="patch", samples=64, resolution=size, poses=3, seed=0)
    found = check.probe(scene, sweep)
    with engines.opened(scene, "surfel", resolution=size, accuracy=1e-3) as renderer:
        wall, without = renderer.render(), renderer.render(target=False)
    truth = wall - without
    assert found.share == pytest.approx(truth.mean() / wall.mean(), rel=0.35)
    with engines.opened(scene, "patch", resolution=size) as renderer:
        errors = [
            renderer.render(samples=64, seed=s) - renderer.render(samples=64, seed=s, target=False) - truth
            for s in range(10, 14)
        ]
    ratio = np.sqrt((truth**2).mean() / np.mean([(e**2).mean() for e in errors]))
    assert ratio / 1.6 < found.signal_to_noise < ratio * 1.6
    assert found.seconds > 0
    assert found.bytes == pytest.approx(3.7 * 3 * 256 * 27)
    exact = check.probe(scene, Sweep(engine="surfel", resolution=size, accuracy=1e-2, rotation=(0, 0, 0)))
    assert exact.signal_to_noise == pytest.approx(100.0)


def test_command_line_checks(scene_file, tmp_path, command):
    result = command("generator", "check", scene_file, "--samples", "8", "--resolution", "16", "--poses", "2")
    assert result.returncode == 0, result.stdout + result.stderr
    assert "The object adds" in result.stdout
    assert "on disk" in result.stdout
    assert "hidden from lamp" in result.stdout
    scene = stage.open_file(scene_file)
    stage.limit_reflections(scene, 2)
    spoilt = tmp_path / "spoilt.blend"
    stage.save_file(spoilt)
    result = command("generator", "check", spoilt)
    assert result.returncode == 1
    assert result.stdout.startswith("error: Light makes 2 reflections")
    assert command("generator", "check", tmp_path / "none.blend").returncode == 2


def as_an_artist_might_have_it(scene):
    """The room, turned and moved, in centimetres, under a scaled parent, without roles, with a second camera."""
    roles = {o.name: o.get(stage.ROLE) for o in scene.objects}
    turned = Matrix.Translation((310.0, -220.0, 15.0)) @ Matrix.Rotation(math.radians(37.0), 4, "Z")
    change = turned @ Matrix.Diagonal((100.0, 100.0, 100.0, 1.0))
    parent = bpy.data.objects.new("Set", None)
    scene.collection.objects.link(parent)
    parent.scale = (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    for obj in list(scene.objects):
        if obj == parent:
            continue
        obj.pop(stage.ROLE, None)
        placed = change @ obj.matrix_world
        if obj.type in ("LIGHT", "CAMERA"):
            placed = Matrix.LocRotScale(*placed.decompose()[:2], None)
        else:
            obj.parent = parent
        obj.matrix_world = placed
        obj.pop(stage.KIND, None)
    camera = bpy.data.objects.new("Beauty camera", bpy.data.cameras.new("Beauty camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.scale_length = 0.01
    scene.unit_settings.length_unit = "CENTIMETERS"
    # Its sheet is a plane that an array modifier completes.
    target = next(o for o in scene.objects if roles.get(o.name) == "target")
    target.data.transform(Matrix.Diagonal((0.5, 1.0, 1.0, 1.0)) @ Matrix.Translation((0.25, 0.0, 0.0)))
    target.modifiers.new("Mirror", "MIRROR").use_clip = True
    for key in (stage.GRID_LO, stage.GRID_HI, stage.GRID_SHAPE, stage.PRESET):
        del scene[key]
    bpy.context.view_layer.update()
    return roles


def test_an_artists_scene_is_adopted_and_renders_as_the_one_written_by_hand():
    scene = built()
    target = stage.find(scene, "target")
    target.rotation_euler.z = 0.4
    bpy.context.view_layer.update()
    with engines.opened(scene, "surfel", resolution=(16, 16), accuracy=1e-4) as renderer:
        by_hand = renderer.render(), renderer.render(target=False)
    roles = as_an_artist_might_have_it(scene)
    assert told(scene, ERROR)
    for name, role in roles.items():
        if role in stage.SINGLE_ROLES:
            adopt.assign(scene, role, [scene.objects[name]])
    assert {f.fix for f in told(scene, ERROR)} == {"metres", "align"}
    check.mend(scene, "metres")
    check.mend(scene, "align")
    assert [f.fix for f in told(scene, ERROR)] == ["voxels"]
    check.mend(scene, "voxels")
    assert not [f for f in told(scene, ERROR) if f.fix != "voxels" and "straight into" not in f.text]
    with engines.opened(scene, "surfel", resolution=(16, 16), accuracy=1e-4) as renderer:
        adopted = renderer.render(), renderer.render(target=False)
    level = np.abs(by_hand[0] - by_hand[1]).max()
    assert_allclose(adopted[0] - adopted[1], by_hand[0] - by_hand[1], atol=1e-3 * level)
    assert_allclose(adopted[1], by_hand[1], rtol=1e-3)


def test_an_adopted_scene_is_swept(tmp_path):
    scene = built()
    described = stage.read(scene)
    roles = as_an_artist_might_have_it(scene)
    for name, role in roles.items():
        if role in stage.SINGLE_ROLES:
            adopt.assign(scene, role, [scene.objects[name]])
    check.mend(scene, "metres")
    check.mend(scene, "align")
    # Where the hand-written voxels lie in the new frame: the target's place moved by as much as the target did.
    moved = (
        np.array(stage.find(scene, "target").matrix_world.translation)
        - np.add(described.grid.lo, described.grid.hi) / 2.0
    )
    stage.write_grid(
        scene,
        type(described.grid)(
            lo=tuple(np.add(described.grid.lo, moved).round(5)),
            hi=tuple(np.add(described.grid.hi, moved).round(5)),
            shape=(3, 3, 1),
        ),
    )
    found = worker.check_scene(scene, {"engine": "surfel", "resolution": [16, 16], "accuracy": 1e-2})
    assert not check.hopeless(found), found
    source = tmp_path / "artist.blend"
    stage.save_file(source)
    chosen = {"engine": "surfel", "poses": 2, "resolution": [16, 16], "accuracy": 1e-3, "rotation": [15, 15, 90]}
    plan = worker.plan(stage.open_file(source), source, tmp_path / "artist", chosen, probe=False)
    worker.render(
        stage.open_file(tmp_path / "artist" / "scene.blend"), plan, [dict.fromkeys(range(len(plan.poses)), 0)]
    )
    by_hand = built()
    with engines.opened(by_hand, "surfel", resolution=(16, 16), accuracy=1e-3) as renderer:
        for pose in plan.poses:
            wanted = renderer.at(np.subtract(pose.position, moved), pose.rotation)
            assert_allclose(read_picture(plan.path / pose.file)[0], wanted, rtol=5e-3)


@pytest.mark.parametrize(
    ("role", "name", "words"),
    [
        ("spot", "Camera", "no spot lamp"),
        ("camera", "Spot", "it is none"),
        ("target", "Spot", "has no surface"),
        ("king", "Spot", "there is none"),
    ],
)
def test_roles_that_cannot_be(role, name, words):
    scene = built()
    with pytest.raises(NlosError, match=words):
        adopt.assign(scene, role, [scene.objects[name]])
    assert not told(scene, ERROR)
    with pytest.raises(NlosError, match="no object is selected"):
        adopt.assign(scene, "target", [])


def test_experiments_show_what_moves_and_what_does_not():
    """The sheet turned about its own normal, y, changes nothing worth the name; along y it changes most."""
    scene = built("tabletop")
    pictures = {number: experiments.draw(scene, number, pixels=16) for number in (1, 2, 3)}
    for picture in pictures.values():
        assert picture.shape == (48, 80, 3)
        assert not picture[:, 32:48].any(), "at rest"

    def change(number):  # of each row's outermost pictures
        rows = pictures[number].reshape(3, 16, 80, 3)
        return np.abs(rows[:, :, [*range(16), *range(64, 80)]]).max(axis=(1, 2, 3))

    for number in (1, 2):
        assert change(number).argmax() == 1
    about_x, about_y, about_z = change(3)
    assert about_y < 0.1 * min(about_x, about_z)
    with pytest.raises(NlosError, match="there is none"):
        experiments.draw(scene, 4)
