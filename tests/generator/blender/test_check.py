"""What would spoil a sweep is found, named and mended; what is measured is what a sweep then shows."""

from __future__ import annotations

import ast
import math
from dataclasses import replace

import bpy
import numpy as np
import pytest
from conftest import ROOT
from mathutils import Matrix
from numpy.testing import assert_allclose

from generator.blender import check, check_signal, sweep_worker
from generator.blender.engines import renderers
from generator.blender.finding import ERROR, GOOD, NOTE, WARNING
from generator.blender.measure import experiment
from generator.blender.scene import adopt, blend_file, build, roles
from generator.blender.scene.description import read_scene
from generator.blender.scene.quiet import Overrides
from generator.files.pictures import read_picture
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.settings import Sweep


def built(name="room", target="sheet"):
    scene = blend_file.new_file()
    build.build(scene, preset(name, target))
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
    bpy.data.objects.remove(roles.find(scene, "target"))
    [found] = check.findings(scene)
    assert found.level == ERROR
    assert "No object is the target" in found.text
    wall = roles.find(scene, "relay_wall")
    scene.collection.objects.link(wall.copy())
    assert any("2 objects are the relay wall" in found.text for found in check.findings(scene))


@pytest.mark.parametrize("role", roles.SINGLE_ROLES)
@pytest.mark.parametrize("kept", [0, 1, 2])
def test_one_of_several_copies_keeps_the_role(role, kept):
    scene = built()
    first = roles.find(scene, role)
    for _ in range(2):
        scene.collection.objects.link(first.copy())
    [found] = check.findings(scene)
    names = sorted(o.name for o in roles.players(scene, role))
    assert (found.level, found.fix, sorted(found.choices)) == (ERROR, "keep", names)
    assert all(repr(name) in found.text for name in names)
    with pytest.raises(NlosError, match=r"3 objects are the .* keep one, by a button of Check"):
        roles.find(scene, role)
    for wrong in ("", "Nobody", roles.players(scene, "partition")[0].name):
        with pytest.raises(NlosError, match=rf"choose from .*'{names[2]}'"):
            check.mend(scene, "keep", wrong)
    assert len(roles.players(scene, role)) == 3
    check.mend(scene, found.fix, names[kept])
    assert roles.find(scene, role).name == names[kept]
    assert scene.camera == roles.find(scene, "camera")
    assert not [f for f in check.findings(scene) if f.fix == "keep"]
    with pytest.raises(NlosError, match="keeps no role, for none is played twice"):
        check.mend(scene, "keep", "Nobody")


@pytest.mark.parametrize("overridden", [False, True])
def test_a_linked_object_keeps_its_role(tmp_path, overridden):
    """Blender would let its property be deleted, and bring it back when the file is opened again."""
    built()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    scene = built()
    own = roles.find(scene, "target")
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.objects = [own.name]
    linked = wanted.objects[0].override_create() if overridden else wanted.objects[0]
    scene.collection.objects.link(linked)
    [found] = check.findings(scene)
    assert set(found.choices) == {own.name, linked.name_full}
    assert len(set(found.choices)) == 2  # though both may have one name
    with pytest.raises(NlosError, match=r"what is linked from another file \(.*library\.blend\) keeps its role;"):
        check.mend(scene, "keep", own.name)
    with pytest.raises(NlosError, match="keeps its role"):
        adopt.assign(scene, "target", [own])
    assert len(roles.players(scene, "target")) == 2
    check.mend(scene, "keep", linked.name_full)
    assert roles.find(scene, "target") == linked


def test_no_message_asks_for_a_custom_property():
    """An artist presses buttons; docstrings may say what a button does."""
    for folder in ("generator", "blender_addon"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            said = [node for node in ast.walk(tree) if isinstance(node, ast.Raise | ast.Call)]
            texts = [n.value for node in said for n in ast.walk(node) if isinstance(n, ast.Constant)]
            assert not [text for text in texts if isinstance(text, str) and "custom propert" in text], path


def test_lamp_that_shines_into_a_voxel():
    scene = built()
    lamp = roles.find(scene, "spot")
    lamp.location = (1.5, 3.2, 1.3)
    lamp.rotation_euler = (math.pi / 2.0, 0.0, math.pi)  # along -y, through the middle voxels
    bpy.context.view_layer.update()
    found = [f for f in told(scene, ERROR) if "shines straight into" in f.text]
    assert [f.object for f in found] == [lamp.name]
    assert "B, E, H" in found[0].text


def test_lit_patch_in_the_picture():
    scene = built()
    lamp = roles.find(scene, "spot")
    lamp.rotation_euler = (math.pi / 2.0, 0.0, math.pi)  # at x = -1.0, z = 1.7: just outside; 0.3 m aside: inside
    lamp.location.x = -0.5
    bpy.context.view_layer.update()
    assert any("lights the watched patch" in f.text for f in told(scene, WARNING))


def test_without_a_partition_nothing_hides():
    scene = built()
    for screen in roles.players(scene, "partition"):
        bpy.data.objects.remove(screen)
    texts = [f.text for f in told(scene, NOTE) if "Nothing hides" in f.text]
    assert len(texts) == 2  # from the lamp, and from the camera
    [good] = told(scene, GOOD)
    assert good.text == "Voxels A to I: seen by the wall, while lamp and camera point elsewhere"


def test_only_the_voxels_behind_the_screen_are_called_hidden():
    scene = built()
    [screen] = roles.players(scene, "partition")
    screen.location.y += 1.0  # the wall's side of the screen ends farther from the wall
    bpy.context.view_layer.update()
    assert [f.text[:30] for f in told(scene, NOTE) if "voxels A to G from" in f.text] == [
        "Nothing hides voxels A to G fr"
    ] * 2
    assert [f.text for f in told(scene, GOOD)] == [
        "Voxels H, I: hidden from lamp and camera, seen by the wall",
        "Voxels A to G: seen by the wall, while lamp and camera point elsewhere",
    ]


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
        (lambda s: roles.limit_reflections(s, 2), "reflections", "2 reflections at most"),
        (lambda s: setattr(roles.find(s, "target"), "hide_render", True), "show", "hidden from renders"),
        (lambda s: setattr(roles.find(s, "relay_wall"), "location", (0.0, -0.2, 0.0)), "align", "plane y = 0"),
        (lambda s: s.pop(roles.GRID_SHAPE), "voxels", "voxel grid"),
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
    node = roles.find(scene, "target").data.materials[0].node_tree.nodes["Diffuse BSDF"]
    node.inputs["Roughness"].default_value = 0.5
    assert any("cannot honour" in f.text and f.object for f in told(scene, ERROR, engine="surfel"))
    assert not told(scene, ERROR, engine="auto")
    assert not told(scene, ERROR, engine="patch")
    assert any("in less time" in f.text for f in told(built(), NOTE, engine="patch"))


def test_the_probe_foretells_signal_and_noise():
    scene = built()
    size = (16, 16)
    sweep = Sweep(engine="patch", samples=64, resolution=size, poses=3, seed=0)
    found = check_signal.probe(scene, sweep)
    with renderers.opened(scene, "surfel", resolution=size, accuracy=1e-3) as renderer:
        wall, without = renderer.render(), renderer.render(target=False)
    truth = wall - without
    assert found.share == pytest.approx(truth.mean() / wall.mean(), rel=0.35)
    with renderers.opened(scene, "patch", resolution=size) as renderer:
        errors = [
            renderer.render(samples=64, seed=s) - renderer.render(samples=64, seed=s, target=False) - truth
            for s in range(10, 14)
        ]
    ratio = np.sqrt((truth**2).mean() / np.mean([(e**2).mean() for e in errors]))
    assert ratio / 1.6 < found.signal_to_noise < ratio * 1.6
    assert found.seconds > 0
    assert found.bytes == pytest.approx(3.7 * 3 * 256 * 27)
    exact = check_signal.probe(scene, Sweep(engine="surfel", resolution=size, accuracy=1e-2, rotation=(0, 0, 0)))
    assert exact.signal_to_noise == pytest.approx(100.0)
    signal = exact.findings()[0]
    assert signal.level == GOOD
    assert signal.text.endswith("to the picture; its difference is computed to 1.00%")


def test_command_line_checks(scene_file, tmp_path, command):
    result = command("generator", "check", scene_file, "--samples", "8", "--resolution", "16", "--poses", "2")
    assert result.returncode == 0, result.stdout + result.stderr
    assert "The object adds" in result.stdout
    assert "on disk" in result.stdout
    assert "hidden from lamp" in result.stdout
    scene = blend_file.open_file(scene_file)
    roles.limit_reflections(scene, 2)
    spoilt = tmp_path / "spoilt.blend"
    blend_file.save_file(spoilt)
    result = command("generator", "check", spoilt)
    assert result.returncode == 1
    assert result.stdout.startswith("error: Light makes 2 reflections")
    assert command("generator", "check", tmp_path / "none.blend").returncode == 2


def as_an_artist_might_have_it(scene):
    """The room, turned and moved, in centimetres, under a scaled parent, without roles, with a second camera."""
    played = {o.name: o.get(roles.ROLE) for o in scene.objects}
    turned = Matrix.Translation((310.0, -220.0, 15.0)) @ Matrix.Rotation(math.radians(37.0), 4, "Z")
    change = turned @ Matrix.Diagonal((100.0, 100.0, 100.0, 1.0))
    parent = bpy.data.objects.new("Set", None)
    scene.collection.objects.link(parent)
    parent.scale = (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    for obj in list(scene.objects):
        if obj == parent:
            continue
        obj.pop(roles.ROLE, None)
        placed = change @ obj.matrix_world
        if obj.type in ("LIGHT", "CAMERA"):
            placed = Matrix.LocRotScale(*placed.decompose()[:2], None)
        else:
            obj.parent = parent
        obj.matrix_world = placed
        obj.pop(roles.KIND, None)
    camera = bpy.data.objects.new("Beauty camera", bpy.data.cameras.new("Beauty camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.scale_length = 0.01
    scene.unit_settings.length_unit = "CENTIMETERS"
    # Its sheet is a plane that an array modifier completes.
    target = next(o for o in scene.objects if played.get(o.name) == "target")
    target.data.transform(Matrix.Diagonal((0.5, 1.0, 1.0, 1.0)) @ Matrix.Translation((0.25, 0.0, 0.0)))
    target.modifiers.new("Mirror", "MIRROR").use_clip = True
    for key in (roles.GRID_LO, roles.GRID_HI, roles.GRID_SHAPE, roles.PRESET):
        del scene[key]
    bpy.context.view_layer.update()
    return played


def test_voxels_where_nothing_can_be_are_told_as_such():
    """Not as faults of lamp and camera, which seem to look into them."""
    scene = built()
    grid = roles.read_grid(scene)
    lo, hi = ((x, y - 3.0, z) for x, y, z in (grid.lo, grid.hi))
    roles.write_grid(scene, replace(grid, lo=lo, hi=hi))
    [error] = told(scene, ERROR)
    assert (error.fix, error.text) == (
        "voxels",
        "The voxels lie behind the relay wall (y from -2.6 to -1.1 m; the wall is y = 0)",
    )
    check.mend(scene, error.fix)
    assert not [f for f in check.findings(scene) if "behind the relay wall" in f.text]


def test_a_target_outside_its_voxels_is_told():
    scene = built()
    roles.find(scene, "target").location.y += 1.5
    bpy.context.view_layer.update()
    [note] = [f for f in told(scene, NOTE) if f.fix]
    assert (note.object, note.fix) == ("Target", "voxels")
    assert note.text == "The target 'Target' stands outside the voxels, into which a sweep puts it"


def test_an_artists_scene_is_adopted_and_renders_as_the_one_written_by_hand():
    scene = built()
    target = roles.find(scene, "target")
    target.rotation_euler.z = 0.4
    bpy.context.view_layer.update()
    with renderers.opened(scene, "surfel", resolution=(16, 16), accuracy=1e-4) as renderer:
        by_hand = renderer.render(), renderer.render(target=False)
    played = as_an_artist_might_have_it(scene)
    assert told(scene, ERROR)
    for name, role in played.items():
        if role in roles.SINGLE_ROLES:
            adopt.assign(scene, role, [scene.objects[name]])
    assert {f.fix for f in told(scene, ERROR)} == {"metres", "align"}
    check.mend(scene, "metres")
    check.mend(scene, "align")  # which lays the voxels too: where the wall was, they would have been elsewhere
    grid, place = roles.read_grid(scene), roles.find(scene, "target").matrix_world.translation
    assert all(low < at < high for low, at, high in zip(grid.lo, place, grid.hi, strict=True))
    assert not [f for f in told(scene, ERROR) if f.fix != "voxels" and "straight into" not in f.text]
    with renderers.opened(scene, "surfel", resolution=(16, 16), accuracy=1e-4) as renderer:
        adopted = renderer.render(), renderer.render(target=False)
    level = np.abs(by_hand[0] - by_hand[1]).max()
    assert_allclose(adopted[0] - adopted[1], by_hand[0] - by_hand[1], atol=1e-3 * level)
    assert_allclose(adopted[1], by_hand[1], rtol=1e-3)


def test_an_adopted_scene_is_swept(tmp_path):
    scene = built()
    described = read_scene(scene)
    played = as_an_artist_might_have_it(scene)
    for name, role in played.items():
        if role in roles.SINGLE_ROLES:
            adopt.assign(scene, role, [scene.objects[name]])
    check.mend(scene, "metres")
    check.mend(scene, "align")
    # Where the hand-written voxels lie in the new frame: the target's place moved by as much as the target did.
    moved = (
        np.array(roles.find(scene, "target").matrix_world.translation)
        - np.add(described.grid.lo, described.grid.hi) / 2.0
    )
    roles.write_grid(
        scene,
        type(described.grid)(
            lo=tuple(np.add(described.grid.lo, moved).round(5)),
            hi=tuple(np.add(described.grid.hi, moved).round(5)),
            shape=(3, 3, 1),
        ),
    )
    found = check.check_scene(scene, {"engine": "surfel", "resolution": [16, 16], "accuracy": 1e-2})
    assert not check.hopeless(found), found
    source = tmp_path / "artist.blend"
    blend_file.save_file(source)
    chosen = {"engine": "surfel", "poses": 2, "resolution": [16, 16], "accuracy": 1e-3, "rotation": [15, 15, 90]}
    plan = sweep_worker.plan(blend_file.open_file(source), source, tmp_path / "artist", chosen, probe=False)
    sweep_worker.render(
        blend_file.open_file(tmp_path / "artist" / "scene.blend"), plan, [dict.fromkeys(range(len(plan.poses)), 0)]
    )
    by_hand = built()
    with renderers.opened(by_hand, "surfel", resolution=(16, 16), accuracy=1e-3) as renderer:
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
    pictures = {number: experiment.draw(scene, number, pixels=16) for number in (1, 2, 3)}
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
        experiment.draw(scene, 4)


# Over voxel E, whence one sees past the partition to the wall; beside the camera, whence no voxel is seen.
AMONG, BEFORE = (1.55, 1.15, 2.4), (-1.1, 3.0, 2.0)


def lamp(kind, place=AMONG, *, energy=10.0, rotation=(0.0, 0.0, 0.0), collection=None, **data):
    light = bpy.data.lights.new(kind.capitalize(), kind)
    light.energy = energy
    for name, value in data.items():
        setattr(light, name, value)
    obj = bpy.data.objects.new(kind.capitalize(), light)
    obj.location, obj.rotation_euler = place, rotation
    (collection or bpy.context.scene.collection).objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def glowing(place, *, strength=5.0, size=0.3):
    bpy.ops.mesh.primitive_plane_add(size=size, location=place)
    material = bpy.data.materials.new("Glow")
    if material.node_tree is None:
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    emission, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    emission.inputs["Strength"].default_value = strength
    material.node_tree.links.new(emission.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)
    bpy.context.object.name = "Panel"
    bpy.context.view_layer.update()
    return bpy.context.object


def of_lights(scene):
    return [(f.level, f.text) for f in check.findings(scene) if f.text.startswith("Light of")]


def sun_through_the_roof(scene):
    bpy.data.objects.remove(scene.objects["Ceiling"])
    lamp("SUN", energy=1.0)


def in_a_collection(scene):
    hidden = bpy.data.collections.new("Instanced")
    lamp("POINT", (0.0, 0.0, 0.0), collection=hidden)
    empty = bpy.data.objects.new("Empty", None)
    empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", hidden, AMONG
    scene.collection.objects.link(empty)


def in_a_background_set(scene):
    other = bpy.data.scenes.new("Set")
    lamp("POINT", collection=other.collection)
    scene.background_set = other


def linked_to(scene, names, state="INCLUDE", place=(-0.5, 1.0, 2.4)):
    """A lamp that sees both patch and voxels, and lights only some objects."""
    for screen in roles.players(scene, "partition"):
        bpy.data.objects.remove(screen)
    obj = lamp("POINT", place)
    receivers = bpy.data.collections.new("Receivers")
    for name in names:
        receivers.objects.link(scene.objects[name])
    obj.light_linking.receiver_collection = receivers
    for entry in receivers.collection_objects:
        entry.light_linking.link_state = state


def by_geometry_nodes(scene):
    """A cube without a material gets one that glows by its modifier."""
    panel = glowing(AMONG)
    material = panel.data.materials[0]
    panel.data.materials.clear()
    tree = bpy.data.node_groups.new("Glow", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    into, out, change = (tree.nodes.new(n) for n in ("NodeGroupInput", "NodeGroupOutput", "GeometryNodeSetMaterial"))
    change.inputs["Material"].default_value = material
    tree.links.new(into.outputs[0], change.inputs[0])
    tree.links.new(change.outputs[0], out.inputs[0])
    panel.modifiers.new("Glow", "NODES").node_group = tree


BOTH = "falls directly on the watched patch and"
BACK, UP = (math.pi / 2.0, 0.0, 0.0), (math.pi, 0.0, 0.0)
"""A lamp shines down where it is not turned; these turn it from the wall, and up."""


@pytest.mark.parametrize(
    ("edit", "level", "words"),
    [
        (lambda s: lamp("POINT", (1.55, 1.15, 1.3), energy=1000.0), ERROR, "'Point' comes from within voxel E"),
        (lambda s: glowing((1.55, 1.15, 1.3)), ERROR, "'Panel' comes from within voxel E"),
        (lambda s: lamp("POINT"), WARNING, f"'Point' {BOTH} voxels A to I, and outshines"),
        (lambda s: lamp("AREA", rotation=BACK, size=0.2), WARNING, "'Area' falls directly on voxels D to I: the"),
        (lambda s: lamp("AREA", rotation=UP, size=0.2), NOTE, "'Area' is in the scene too, hidden"),
        (lambda s: lamp("SPOT", spot_size=0.2), WARNING, "'Spot.001' falls directly on voxel E:"),
        (lambda s: lamp("SPOT", spot_size=0.02), WARNING, "'Spot.001' falls directly on voxel E:"),
        (lambda s: lamp("SPOT", rotation=UP), NOTE, "'Spot.001' is in the scene too, hidden"),
        (lambda s: glowing(AMONG), WARNING, f"'Panel' {BOTH} voxels A to I"),
        (lambda s: lamp("POINT", BEFORE), WARNING, "'Point' falls directly on the watched patch, and outshines"),
        (lambda s: glowing(BEFORE), WARNING, "'Panel' falls directly on the watched patch, and outshines"),
        (lambda s: lamp("POINT", (0.3, -1.0, 1.3)), NOTE, "'Point' is in the scene too, hidden"),
        (lambda s: lamp("SUN", energy=1.0), NOTE, "'Sun' is in the scene too, hidden"),
        (sun_through_the_roof, WARNING, "'Sun' falls directly on voxels A to I"),
        (in_a_collection, WARNING, f"'Point' {BOTH} voxels A to I"),
        (in_a_background_set, WARNING, f"'Point' {BOTH} voxels A to I"),
        (by_geometry_nodes, WARNING, f"'Panel' {BOTH} voxels A to I"),
        (lambda s: linked_to(s, ["Floor"]), NOTE, "'Point' is in the scene too"),
        (lambda s: linked_to(s, ["Relay wall"]), WARNING, "'Point' falls directly on the watched patch, and"),
        (lambda s: linked_to(s, ["Target"]), WARNING, "'Point' falls directly on voxels"),
        (lambda s: linked_to(s, ["Target"], "EXCLUDE"), WARNING, "'Point' falls directly on the watched patch, and"),
        (lambda s: linked_to(s, ["Floor"], "EXCLUDE"), WARNING, f"'Point' {BOTH} voxels"),
        (
            lambda s: setattr(lamp("POINT", BEFORE).data, "use_shadow", False),
            WARNING,
            f"'Point' {BOTH} voxels A to I",
        ),
        (
            lambda s: s.world.node_tree.nodes["Background"].inputs["Strength"].__setattr__("default_value", 0.1),
            NOTE,
            "'NLOS world' is in every picture",
        ),
        (
            lambda s: lamp("POINT", (1.0, 1.0, 1.0)).__setattr__("parent", roles.find(s, "target")),
            WARNING,
            "'Point' moves with the hidden object",
        ),
    ],
)
def test_every_source_of_light_is_named_that_sees_a_voxel_or_lights_the_picture(edit, level, words):
    scene = built()
    edit(scene)
    bpy.context.view_layer.update()
    [(got, text)] = of_lights(scene)
    assert words in text
    assert got == level
    good = [f for f in check.findings(scene) if f.level == GOOD]
    assert bool(good) == (level == NOTE)


@pytest.mark.parametrize(
    "edit",
    [
        lambda lamp: setattr(lamp, "hide_render", True),
        lambda lamp: setattr(lamp.data, "energy", 0.0),
        lambda lamp: setattr(lamp.data, "color", (0.0, 0.0, 0.0)),
        lambda lamp: [setattr(lamp, f"visible_{kind}", False) for kind in ("diffuse", "glossy", "transmission")],
        lambda lamp: lamp.users_collection[0].objects.unlink(lamp),
    ],
)
def test_what_gives_no_light_is_not_named(edit):
    scene = built()
    edit(lamp("POINT"))
    bpy.context.view_layer.update()
    assert not of_lights(scene)


def test_a_light_that_is_named_is_one_that_plain_cycles_has():
    """Where check says that it falls directly on the patch, the picture of order 1 has it; where not, it has not."""
    scene = built()
    roles.limit_reflections(scene, 1)
    lights = [(lamp("POINT", BEFORE), True), (lamp("AREA", rotation=BACK), False), (lamp("POINT"), True)]
    lights += [(glowing(BEFORE), True), (lamp("POINT", (0.3, -1.0, 1.3)), False)]
    for obj, _ in lights:
        obj.hide_render = True
    for obj, direct in lights:
        obj.hide_render = False
        bpy.context.view_layer.update()
        with renderers.opened(scene, "path", resolution=(8, 8)) as renderer:
            assert renderer.render(samples=16, seed=0, target=False).any() == direct
        assert any("directly on the watched patch" in text for _, text in of_lights(scene)) == direct
        obj.hide_render = True


def test_a_screen_that_rays_pass_hides_nothing():
    scene = built()
    for screen in roles.players(scene, "partition"):
        screen.visible_shadow = False
    assert [f.object for f in told(scene, NOTE) if "Nothing hides" in f.text] == ["Spot"]
    for screen in roles.players(scene, "partition"):
        screen.visible_shadow, screen.visible_camera = True, False
    assert [f.object for f in told(scene, NOTE) if "Nothing hides" in f.text] == ["Camera"]


def rough_target(scene):
    """Make the target of something that patch renders and surfel does not."""
    node = roles.find(scene, "target").data.materials[0].node_tree.nodes["Diffuse BSDF"]
    node.inputs["Roughness"].default_value = 0.5


def small(scale):
    scene = built()
    roles.find(scene, "target").scale = (scale,) * 3
    bpy.context.view_layer.update()
    return scene


PROBED = {"samples": 64, "resolution": (16, 16), "poses": 3, "seed": 0}


@pytest.mark.parametrize(
    ("scale", "engine", "missed"),
    [
        (0.2, "patch", False),
        (0.2, "path", True),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((0.02, "patch", False), (1.0, "path", False))),
    ],
)
def test_an_object_that_the_noise_hides_changes_what_surfel_says(scale, engine, missed):
    """By 0.4 % to 0.00004 %: never "nothing", though no sample of path meets its light."""
    scene = small(scale)
    found = check_signal.probe(scene, Sweep(engine=engine, **PROBED))
    with renderers.opened(scene, "surfel", resolution=(16, 16), accuracy=1e-4) as renderer:
        wall, without = renderer.render(), renderer.render(target=False)
    assert found.share == pytest.approx((wall - without).mean() / wall.mean(), rel=0.03)
    assert bool(found.missed) == missed
    [signal, _] = found.findings()
    assert signal.level == WARNING
    assert f"The object adds {check_signal._share(found.share)} to the picture" in signal.text
    assert "or the engine 'surfel'" in signal.text


@pytest.mark.parametrize(
    ("how", "level", "words"),
    [
        (
            {"share": 8e-4, "error": 1e-3, "hidden": True},
            WARNING,
            "adds 0.08 % ± 0.10 % to the picture (95 %), hidden by",
        ),
        ({"share": -2e-4, "error": 1.26e-3, "hidden": True}, WARNING, "adds -0.02 % ± 0.13 % to the picture"),
        (
            {"share": 0.12, "error": 2.4e-2, "signal_to_noise": 5.0},
            GOOD,
            "adds 12.0 % ± 2.4 % to the picture (95 %); ",
        ),
        ({"share": 0.12, "signal_to_noise": 5.0}, GOOD, "adds 12.00% to the picture; its difference is 5 times the"),
        (
            {"share": 1e-3, "signal_to_noise": 1.5},
            WARNING,
            "; its difference is 1.5 times the noise of 'patch'; more",
        ),
        ({"share": 1e-3, "signal_to_noise": 0.0612}, WARNING, "is 0.0612 times the noise of 'patch', below it; more"),
        ({"share": 1e-3, "signal_to_noise": math.nan}, WARNING, "could not be compared with the noise of 'patch'"),
    ],
)
def test_a_signal_is_told_with_its_error_and_on_its_side_of_the_noise(how, level, words):
    probe = check_signal.Probe(engine="patch", seconds=1.0, bytes=1.0, **{"signal_to_noise": 0.5, **how})
    [signal, _] = probe.findings()
    assert signal.level == level
    assert words in signal.text


@pytest.mark.slow
def test_where_surfel_cannot_be_asked_a_range_is_told():
    scene = small(0.1)
    with renderers.opened(scene, "surfel", resolution=(16, 16), accuracy=1e-3) as renderer:
        wall, without = renderer.render(), renderer.render(target=False)
    rough_target(scene)  # which changes what it adds by less than the noise hides
    found = check_signal.probe(scene, Sweep(engine="patch", **PROBED))
    [signal, _] = found.findings()
    assert signal.level == WARNING
    how = "in no single pixel above" if found.share > found.error else "hidden by"
    assert f"(95 %), {how} the noise of 'patch'; more samples would tell" in signal.text
    assert "surfel" not in signal.text
    assert abs(found.share - (wall - without).mean() / wall.mean()) < 5.0 * found.error  # 1 in 10^6 by chance


@pytest.mark.slow
def test_what_no_sample_met_is_bounded_and_no_error():
    scene = small(0.02)
    rough_target(scene)
    found = check_signal.probe(scene, Sweep(engine="path", **PROBED))
    [signal, _] = found.findings()
    assert found.missed >= 16 * 256
    assert signal.level == WARNING
    assert "is not known: none of" in signal.text
    most = float(signal.text.split("nor do more than ")[1].split(" of all (95 %)")[0])
    assert 3.0 / found.missed <= most <= 3.3 / found.missed  # rounded up


def test_an_object_that_nothing_lights_changes_nothing():
    scene = built()
    with Overrides() as overrides:
        overrides.set(roles.find(scene, "spot").data, "energy", 0.0)
        for engine in ("surfel", "patch"):
            [signal, _] = check_signal.probe(scene, Sweep(engine=engine, **PROBED)).findings()
            assert signal.level == ERROR
            assert "makes no change above the rounding of float32, 6e-06 % of a pixel" in signal.text


def test_what_no_engine_can_is_a_finding_and_names_none():
    scene = built()
    target = roles.find(scene, "target")
    target.keyframe_insert("location", frame=1)
    found = [f for f in told(scene, ERROR) if target.name in f.text]
    assert found
    assert not [f for f in found if any(f"{engine!r}" in f.text for engine in renderers.ENGINES)]


def test_advice_names_an_engine_that_was_asked():
    scene = built()
    rough_target(scene)
    assert any("'patch' can" in f.text for f in told(scene, ERROR, engine="surfel"))
    roles.find(scene, "spot").data.shadow_soft_size = 0.1
    for engine in ("surfel", "patch"):
        errors = [f.text for f in told(scene, ERROR, engine=engine)]
        assert errors
        assert all(text.endswith("'path' can") for text in errors)
    assert any("radius" in text for text in errors)
    world = built()
    world.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.1
    assert not told(world, ERROR, engine="surfel"), "who asks for surfel gets ambient light, as in a sweep"


def test_what_is_deleted_between_two_parts_ends_a_check():
    scene = built()
    parts = check.parts(scene)
    found = [next(parts) for _ in range(5)]
    bpy.data.objects.remove(roles.find(scene, "spot"))
    found += parts
    [told] = [f for f in check.ordered(found) if f.level == ERROR]
    assert "no object is the spot" in told.text.lower()


def test_an_orthographic_camera_is_told_what_is_right_for_it():
    scene = built()
    camera = roles.find(scene, "camera")
    camera.data.type, camera.data.ortho_scale = "ORTHO", 0.5
    bpy.context.view_layer.update()
    assert not told(scene, ERROR)
    assert any("hidden from lamp and camera" in f.text for f in told(scene, GOOD)), "from its place, as others"
    camera.data.ortho_scale = 6.0
    assert any("lower its Orthographic Scale" in f.text and f.object == camera.name for f in told(scene, ERROR))
    camera.data.ortho_scale = 0.5
    camera.location.y = 0.1
    camera.rotation_euler.x += 0.6
    bpy.context.view_layer.update()
    [error] = told(scene, ERROR)
    assert "part of its picture starts behind the relay wall" in error.text
    assert error.object == camera.name


def test_what_stands_before_the_lamp_is_named():
    scene = built()
    spot = read_scene(scene).spot
    mesh = bpy.data.meshes.new("Book")
    across = 0.05 * np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    mesh.from_pydata((np.add(spot.location, spot.aim) / 2.0 + across).tolist(), [], [(0, 1, 2, 3)])
    linked = bpy.data.collections.new("In the lamp's light")
    scene.collection.children.link(linked)
    linked.objects.link(bpy.data.objects.new("Book", mesh))
    roles.find(scene, "spot").light_linking.blocker_collection = linked
    bpy.context.view_layer.update()
    assert any(f.object == "Book" and f.text.startswith("'Book' stands between 'Spot'") for f in told(scene, ERROR))
