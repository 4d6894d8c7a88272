"""The file is read as a render will see it: what moves, what is shown, what is solid; and pictures depend on nothing
that the process rendered before.
"""

from __future__ import annotations

import math
from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from generator.blender import check, sweep_worker
from generator.blender.engines import renderers, survey
from generator.blender.finding import ERROR
from generator.blender.scene import blend_file, build, geometry, posing, roles
from generator.blender.scene.clearance import Solid, clearance
from generator.blender.scene.description import read_scene
from generator.files.toml import from_dict
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.scene import Scene

POSITION, ROTATION = (1.5, 1.0, 1.2), (0.0, 0.0, 20.0)


def built(target="sheet", **changes):
    blender = blend_file.new_file()
    build.build(blender, replace(preset("room", target), **changes))
    return blender


def picture(blender, engine="patch", samples=16, seed=3, **options):
    with renderers.opened(blender, engine, resolution=(8, 8)) as renderer:
        posing.move_target(blender, POSITION, ROTATION)
        return renderer.render(samples=samples, seed=seed, **options)


def cube(name="Cube", at=(1.55, 1.15, 1.3), size=0.4, **flags):
    bpy.ops.mesh.primitive_cube_add(size=size, location=at)
    obj = bpy.context.object
    obj.name = name
    for key, value in flags.items():
        setattr(obj, key, value)
    return obj


# --------------------------------------------------------------------------------------------------------------------
# Kind 1: animation overrules what is set, when the render starts
# --------------------------------------------------------------------------------------------------------------------


def keyed(blender):
    target = roles.find(blender, "target")
    for frame, x in ((1, 1.1), (50, 2.0)):
        target.location.x = x
        target.keyframe_insert("location", frame=frame)


def nla(blender):
    keyed(blender)
    moves = roles.find(blender, "target").animation_data
    moves.nla_tracks.new().strips.new("strip", 1, moves.action)
    moves.action = None


def turned_by_keys(blender):
    target = roles.find(blender, "target")
    target.keyframe_insert("rotation_euler", frame=1)


def driven(blender):
    driver = roles.find(blender, "target").driver_add("location", 2).driver
    driver.expression = "1.3"


def parent_held(blender):
    target = roles.find(blender, "target")
    hook = bpy.data.objects.new("Hook", None)
    blender.collection.objects.link(hook)
    constraint = target.constraints.new("COPY_LOCATION")
    constraint.target = hook


HELD = {
    "keys": (keyed, "the animation 'TargetAction'"),
    "NLA": (nla, "its NLA strips"),
    "keys of the turn": (turned_by_keys, "the animation 'TargetAction'"),
    "driver": (driven, "its drivers"),
    "constraint": (parent_held, "the constraint 'Copy Location'"),
}


@pytest.mark.parametrize("name", HELD)
@pytest.mark.parametrize("engine", renderers.ENGINES)
def test_a_target_that_something_holds_is_refused_by_every_engine(name, engine):
    blender = built()
    edit, words = HELD[name]
    edit(blender)
    with (
        pytest.raises(NlosError, match=f"cannot be swept: the target 'Target' does not go where it is put.*{words}"),
        renderers.opened(blender, engine, resolution=(8, 8)),
    ):
        pass


@pytest.mark.parametrize("name", ["keys", "NLA"])
def test_check_and_plan_refuse_it_too_before_any_work(name, tmp_path):
    blender = built()
    HELD[name][0](blender)
    blend_file.save_file(tmp_path / "held.blend")
    blender = blend_file.open_file(tmp_path / "held.blend")
    found = check.findings(blender, engine="auto")
    assert any(f.level == ERROR and "does not go where it is put" in f.text for f in found)
    with pytest.raises(NlosError, match="does not go where it is put"):
        sweep_worker.plan(blender, tmp_path / "held.blend", tmp_path / "set", {"poses": 1, "samples": 4})
    assert not (tmp_path / "set").exists()


def test_keys_that_hold_nothing_that_is_set_are_no_matter():
    blender = built()
    target = roles.find(blender, "target")
    target.keyframe_insert("scale", frame=1)
    assert survey.survey(blender).never == []


def test_cameras_bound_to_the_timeline_change_no_pixel():
    blender = built()
    for engine in ("path", "patch"):
        plain = picture(blender, engine)
        other = bpy.data.objects.new("Other", bpy.data.cameras.new("Other"))
        blender.collection.objects.link(other)
        other.location = (0.0, 2.0, 1.0)
        marker = blender.timeline_markers.new("Cut", frame=blender.frame_current)
        marker.camera = other
        before = blender.camera
        np.testing.assert_array_equal(picture(blender, engine), plain)
        assert marker.camera == other
        assert blender.camera == before
        blender.timeline_markers.remove(marker)


# --------------------------------------------------------------------------------------------------------------------
# Kind 2: something else moves with the target
# --------------------------------------------------------------------------------------------------------------------


def tracks(role):
    def edit(blender):
        constraint = roles.find(blender, role).constraints.new("TRACK_TO")
        constraint.target = roles.find(blender, "target")
        constraint.track_axis, constraint.up_axis = "TRACK_NEGATIVE_Z", "UP_Y"
        constraint.influence = 0.02

    return edit


def wall_follows(blender):
    constraint = roles.players(blender, "room")[0].constraints.new("COPY_LOCATION")
    constraint.target = roles.find(blender, "target")
    constraint.influence = 0.01


def cut_by_the_target(blender):
    obj = cube(at=(2.2, 3.0, 0.5))
    modifier = obj.modifiers.new("Displaced", "SHRINKWRAP")
    modifier.target = roles.find(blender, "target")


def colour_is_driven(blender):
    obj = roles.players(blender, "room")[0]
    socket = obj.data.materials[0].node_tree.nodes["Diffuse BSDF"].inputs["Color"]
    driver = socket.driver_add("default_value", 0).driver
    variable = driver.variables.new()
    variable.type = "TRANSFORMS"
    variable.targets[0].id = roles.find(blender, "target")
    variable.targets[0].transform_type = "LOC_X"
    driver.expression = f"{variable.name} / 4"


def lamp_follows(blender):
    lamp = bpy.data.objects.new("Torch", bpy.data.lights.new("Torch", "POINT"))
    blender.collection.objects.link(lamp)
    constraint = lamp.constraints.new("COPY_LOCATION")
    constraint.target = roles.find(blender, "target")


def power_is_driven(blender):
    driver = roles.find(blender, "spot").data.driver_add("energy").driver
    variable = driver.variables.new()
    variable.type = "TRANSFORMS"
    variable.targets[0].id = roles.find(blender, "target")
    variable.targets[0].transform_type = "LOC_Y"
    driver.expression = f"100 * {variable.name}"


def textured_by_it(blender):
    tree = roles.players(blender, "room")[0].data.materials[0].node_tree
    where, noise = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexNoise")
    where.object = roles.find(blender, "target")
    tree.links.new(where.outputs["Object"], noise.inputs["Vector"])
    tree.links.new(noise.outputs[0], tree.nodes["Diffuse BSDF"].inputs["Color"])


FOLLOWERS = {
    "spot": (tracks("spot"), "the spot 'Spot' moves when the target does"),
    "camera": (tracks("camera"), "the camera 'Camera' moves when the target does"),
    "room": (wall_follows, "changes when the target moves, and is not one of its children"),
    "modifier": (cut_by_the_target, "'Cube' changes when the target moves"),
    "colour": (colour_is_driven, "changes when the target moves, and is not one of its children"),
    "texture": (textured_by_it, "'Floor' has a texture in the coordinates of 'Target', which moves with the target"),
    "power": (power_is_driven, "the light 'Spot' changes its power when the target moves"),
    "lamp": (lamp_follows, "the light 'Torch' moves when the target does"),
}


@pytest.mark.parametrize("name", FOLLOWERS)
@pytest.mark.parametrize("engine", renderers.ENGINES)
def test_what_follows_the_target_is_refused_by_every_engine(name, engine):
    blender = built()
    edit, words = FOLLOWERS[name]
    edit(blender)
    with (
        pytest.raises(NlosError, match=f"cannot be swept: .*{words}"),
        renderers.opened(blender, engine, resolution=(8, 8)),
    ):
        pass


def test_a_lamp_that_the_target_carries_is_hidden_with_it():
    blender = built()
    empty = picture(blender, target=False)
    lamp = bpy.data.objects.new("Torch", bpy.data.lights.new("Torch", "POINT"))
    lamp.data.energy = 1.0
    blender.collection.objects.link(lamp)
    lamp.parent = roles.find(blender, "target")
    with_torch, without = picture(blender), picture(blender, target=False)
    assert with_torch.mean() > 3.0 * without.mean()
    assert without.mean() == pytest.approx(empty.mean(), rel=0.2)  # noise of 16 samples


# --------------------------------------------------------------------------------------------------------------------
# Kind 3: what is rendered counts, not what the viewport shows
# --------------------------------------------------------------------------------------------------------------------


def array_of_four(blender, viewport, render):
    modifier = roles.find(blender, "target").modifiers.new("Four", "ARRAY")
    modifier.count = 4
    modifier.show_viewport, modifier.show_render = viewport, render


@pytest.mark.parametrize(("viewport", "render", "size"), [(False, True, 2.0), (True, False, 0.5), (True, True, 2.0)])
def test_the_target_is_planned_as_it_is_rendered(viewport, render, size):
    blender = built()
    array_of_four(blender, viewport, render)
    assert read_scene(blender).target.size == pytest.approx(size, rel=1e-6)


def test_subdivision_is_that_of_renders():
    blender = built("sphere")
    modifier = roles.find(blender, "target").modifiers.new("Finer", "SUBSURF")
    modifier.levels, modifier.render_levels = 0, 1
    few = len(geometry.evaluated_vertices(roles.find(blender, "target")))
    assert len(geometry.hull(blender)) > 3 * few


def test_geometry_nodes_that_ask_for_the_viewport_are_told_no():
    blender = built()
    tree = bpy.data.node_groups.new("Big in renders", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes, link = tree.nodes, tree.links.new
    first, last = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    scale, choice = nodes.new("GeometryNodeTransform"), nodes.new("GeometryNodeSwitch")
    choice.input_type = "VECTOR"
    sockets = {s.name: s for s in choice.inputs if s.enabled}
    sockets["False"].default_value, sockets["True"].default_value = (3.0, 3.0, 3.0), (1.0, 1.0, 1.0)
    link(nodes.new("GeometryNodeIsViewport").outputs[0], sockets["Switch"])
    link(next(s for s in choice.outputs if s.enabled), scale.inputs["Scale"])
    link(first.outputs[0], scale.inputs[0])
    link(scale.outputs[0], last.inputs[0])
    roles.find(blender, "target").modifiers.new("Nodes", "NODES").node_group = tree
    assert read_scene(blender).target.size == pytest.approx(1.5, rel=1e-6)


@pytest.mark.parametrize("role", ["spot", "target", "camera", "relay_wall"])
def test_what_only_the_viewport_hides_is_rendered(role):
    blender = built()
    described, plain = read_scene(blender), picture(blender)
    roles.find(blender, role).hide_viewport = True
    assert read_scene(blender) == described
    np.testing.assert_array_equal(picture(blender), plain)
    with renderers.opened(blender, "surfel", resolution=(8, 8)) as renderer:
        assert renderer.render().mean() == pytest.approx(plain.mean(), rel=0.1)


@pytest.mark.parametrize("role", ["spot", "target", "camera", "relay_wall"])
def test_so_it_is_in_a_file_that_was_saved_like_that(role, tmp_path):
    """Blender does not know where things are that were hidden when it opened the file."""
    blender = built()
    described, plain = read_scene(blender), picture(blender)
    obj = roles.find(blender, role)
    obj.hide_viewport = True
    blend_file.save_file(tmp_path / "hidden.blend")
    blender = blend_file.open_file(tmp_path / "hidden.blend")
    assert read_scene(blender) == described
    np.testing.assert_array_equal(picture(blender), plain)
    with renderers.opened(blender, "surfel", resolution=(8, 8)) as renderer:
        posing.move_target(blender, POSITION, ROTATION)
        assert renderer.render().mean() == pytest.approx(plain.mean(), rel=0.1)
    assert not any(f.level == ERROR for f in check.findings(blender, engine="auto"))


def test_a_cupboard_that_the_viewport_hides_is_kept_clear_of():
    places = []
    for hidden in (False, True):
        blender = built()
        cube(hide_viewport=hidden)
        is_free = clearance(blender, read_scene(blender), engine="patch")
        places.append([is_free((x, 1.15, 1.3), (0.0, 0.0, 0.0)) for x in np.linspace(0.9, 2.2, 14)])
    assert places[0] == places[1]
    assert any(places[0])
    assert not all(places[0])


def test_what_only_the_viewport_shows_is_not_in_the_way():
    blender = built()
    cube(hide_render=True)
    assert clearance(blender, read_scene(blender), engine="patch")((1.55, 1.15, 1.3), (0.0, 0.0, 0.0))


# --------------------------------------------------------------------------------------------------------------------
# Kind 4: free means clear of solids
# --------------------------------------------------------------------------------------------------------------------


def test_inside_a_closed_solid_is_not_free():
    blender = built()
    cube(size=0.9)
    is_free = clearance(blender, read_scene(blender), engine="path")
    assert not is_free((1.55, 1.15, 1.3), (0.0, 0.0, 0.0))
    assert is_free((1.0, 1.15, 0.7), (0.0, 0.0, 0.0)) == (abs(1.0 + 0.25 - 1.1) > 0.25)


def test_inside_an_open_box_is_free():
    blender = built()
    obj = cube(size=0.9)
    import bmesh

    shape = bmesh.new()
    shape.from_mesh(obj.data)
    bmesh.ops.delete(shape, geom=[max(shape.faces, key=lambda f: f.calc_center_median().y)], context="FACES")
    shape.to_mesh(obj.data)
    shape.free()
    assert clearance(blender, read_scene(blender), engine="path")((1.55, 1.15, 1.3), (0.0, 0.0, 0.0))


def made_of(obj, kind, socket):
    material = bpy.data.materials.new(kind)
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new(kind), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs[socket])
    obj.data.materials.append(material)


@pytest.mark.parametrize(
    ("kind", "socket", "inside", "across"),
    [
        ("ShaderNodeBsdfDiffuse", "Surface", False, False),
        ("ShaderNodeBsdfGlass", "Surface", True, False),  # a showcase
        ("ShaderNodeVolumeScatter", "Volume", True, True),  # fog, which has no surface
    ],
)
def test_what_light_comes_through_may_hold_the_target(kind, socket, inside, across):
    blender = built()
    made_of(cube(size=0.9), kind, socket)
    is_free = clearance(blender, read_scene(blender), engine="path")
    assert is_free((1.55, 1.15, 1.3), (0.0, 0.0, 0.0)) == inside
    assert is_free((1.1, 1.15, 1.3), (0.0, 0.0, 0.0)) == across


def test_a_room_that_is_one_closed_box_is_free_inside_and_not_outside():
    blender = built()
    for obj in roles.players(blender, "room") + roles.players(blender, "partition"):
        bpy.data.objects.remove(obj)
    box = cube("Box", at=(0.1, 1.69, 1.3), size=1.0)
    box.scale = (5.2, 3.42, 2.8)  # a little beyond the wall
    bpy.context.view_layer.update()
    is_free = clearance(blender, read_scene(blender), engine="path")
    assert is_free((1.5, 1.0, 1.2), (0.0, 0.0, 0.0))
    assert not is_free((1.5, 5.0, 1.2), (0.0, 0.0, 0.0))


def test_what_a_closed_target_swallows_is_in_its_way():
    blender = built("sphere")
    cube(at=(1.5, 1.0, 1.2), size=0.05)
    is_free = clearance(blender, read_scene(blender), engine="path")
    assert not is_free((1.5, 1.0, 1.2), (0.0, 0.0, 0.0))
    assert is_free((1.5, 1.4, 1.2), (0.0, 0.0, 0.0))


def test_solids_hold_what_is_inside():
    rng = np.random.default_rng(1)
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    split = corners[triangles].reshape(-1, 3)  # as a file without shared corners has it
    for solid in (Solid.of(corners, triangles), Solid.of(split, np.arange(len(split)).reshape(-1, 3))):
        points = rng.uniform(-1.5, 1.5, (300, 3))
        assert [solid.holds(p) for p in points] == list((np.abs(points) < 1.0).all(axis=1))
    assert Solid.of(corners, triangles[1:]) is None


# --------------------------------------------------------------------------------------------------------------------
# Kind 12: a picture's bits depend on scene, engine, samples and seed alone
# --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["path", "patch"])
@pytest.mark.parametrize("before", [(1,), (2048,), (300, 1, 5)])
def test_what_was_rendered_before_changes_no_bit(engine, before):
    blender = built()
    alone = picture(blender, engine, samples=64)
    with renderers.opened(blender, engine, resolution=(8, 8)) as renderer:
        posing.move_target(blender, POSITION, ROTATION)
        for samples in before:
            renderer.render(samples=samples, seed=9)
            renderer.render(samples=samples, seed=9, target=False)
        np.testing.assert_array_equal(renderer.render(samples=64, seed=3), alone)
        np.testing.assert_array_equal(renderer.render(samples=64, seed=3), alone)


def test_persistent_data_of_the_file_changes_no_bit():
    blender = built()
    alone = picture(blender, samples=64)
    blender.render.use_persistent_data = True
    picture(blender, samples=2048)
    np.testing.assert_array_equal(picture(blender, samples=64), alone)
    assert blender.render.use_persistent_data


# --------------------------------------------------------------------------------------------------------------------
# Kinds 13 and 17: frames that a pose cannot hold, and those that it can
# --------------------------------------------------------------------------------------------------------------------


def parented(blender, scale, turn=0.5, place=(0.2, 0.1, 0.0)):
    target = roles.find(blender, "target")
    parent = bpy.data.objects.new("Parent", None)
    blender.collection.objects.link(parent)
    parent.scale, parent.location = scale, place
    target.parent = parent
    target.rotation_euler.y = turn
    bpy.context.view_layer.update()
    return target


@pytest.mark.parametrize("engine", renderers.ENGINES)
def test_a_sheared_target_is_refused(engine):
    blender = built()
    parented(blender, (1.0, 1.0, 0.6))
    with (
        pytest.raises(NlosError, match="the target 'Target' is sheared by its parents' scale"),
        renderers.opened(blender, engine, resolution=(8, 8)),
    ):
        pass


@pytest.mark.parametrize("scale", [(0.8, 0.8, 0.8), (1.0, 1.0, 1.0)])
def test_a_parent_that_does_not_shear_is_followed(scale):
    blender = built()
    target = parented(blender, scale)
    assert read_scene(blender).target.size == pytest.approx(0.5 * scale[0], rel=1e-5)
    posing.move_target(blender, POSITION, ROTATION)
    assert target.dimensions.x == pytest.approx(0.5 * scale[0], rel=1e-5)


@pytest.mark.parametrize(
    "deltas",
    [
        {"delta_location": (0.1, 0.2, 0.0)},
        {"delta_rotation_euler": (0.0, 0.3, 0.1)},
        {"delta_scale": (0.5, 1.0, 0.5)},
        {"delta_location": (0.3, 0.0, 0.0), "delta_rotation_euler": (0.1, 0.0, 0.0), "delta_scale": (0.9, 0.9, 0.9)},
    ],
)
def test_delta_transforms_are_taken_into_the_pose(deltas):
    blender = built()
    target = roles.find(blender, "target")
    for name, value in deltas.items():
        setattr(target, name, value)
    bpy.context.view_layer.update()
    before = target.matrix_world.copy()
    with posing.put_back(blender):
        posing.move_target(blender, POSITION, ROTATION)
        wanted = Matrix.LocRotScale(POSITION, None, None) @ Matrix.Rotation(math.radians(20.0), 4, "Z")
        scale = deltas.get("delta_scale", (1.0, 1.0, 1.0))
        np.testing.assert_allclose(
            np.array(target.matrix_world), np.array(wanted @ Matrix.Diagonal((*scale, 1.0))), atol=1e-6
        )
    np.testing.assert_array_equal(np.array(target.matrix_world), np.array(before))
    assert survey.survey(blender).never == []


# --------------------------------------------------------------------------------------------------------------------
# Kind 14: descriptions are those of the pictures
# --------------------------------------------------------------------------------------------------------------------


def planned(blender, tmp_path, **chosen):
    path = tmp_path / "scene.blend"
    blend_file.save_file(path)
    chosen = {"poses": 1, "samples": 4, "engine": "patch", **chosen}
    dataset = sweep_worker.plan(blend_file.open_file(path), path, tmp_path / "set", chosen, probe=False)
    return from_dict(Scene, dataset.meta["scene"], "").camera


def test_a_wide_picture_is_described_as_such(tmp_path):
    camera = planned(built(), tmp_path, resolution="32x8")
    assert camera.z == pytest.approx((1.175, 1.425), abs=1e-6)
    assert camera.x == pytest.approx((-0.95, 0.05), abs=1e-6)


@pytest.mark.parametrize(("aspect", "resolution"), [((2.0, 1.0), None), ((1.0, 2.0), None), ((1.0, 3.0), "8x8")])
def test_pixels_are_square_whatever_the_file_says(tmp_path, aspect, resolution):
    blender = built()
    blender.render.pixel_aspect_x, blender.render.pixel_aspect_y = aspect
    camera = planned(blender, tmp_path, **({"resolution": resolution} if resolution else {}))
    assert camera.z == pytest.approx((0.8, 1.8), abs=1e-6)
    assert camera.x == pytest.approx((-0.95, 0.05), abs=1e-6)


@pytest.mark.parametrize("scale", [(2.0, 1.0, 1.0), (0.5, 0.5, 0.5), (1.0, 3.0, 2.0)])
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_cameras_have_no_scale(scale, projection):
    blender = built(camera=replace(preset("room").camera, projection=projection))
    plain, described = picture(blender, samples=4), read_scene(blender).camera
    roles.find(blender, "camera").scale = scale
    np.testing.assert_allclose(picture(blender, samples=4), plain, rtol=1e-5)
    scaled = read_scene(blender).camera
    assert scaled.x == pytest.approx(described.x, abs=1e-6)
    assert scaled.z == pytest.approx(described.z, abs=1e-6)


# --------------------------------------------------------------------------------------------------------------------
# Kind 15: a target that is an empty with an instanced collection
# --------------------------------------------------------------------------------------------------------------------


def test_an_instanced_collection_can_be_the_target():
    blender = built()
    old = roles.find(blender, "target")
    plain = picture(blender, samples=64)
    hidden = bpy.data.collections.new("Kept")
    shape = old.copy()
    del shape[roles.ROLE]
    shape.location = (0.0, 0.0, 0.0)
    hidden.objects.link(shape)
    empty = bpy.data.objects.new("Instance", None)
    blender.collection.objects.link(empty)
    empty.instance_type, empty.instance_collection = "COLLECTION", hidden
    empty.location = old.location
    empty[roles.ROLE] = "target"
    bpy.data.objects.remove(old)
    bpy.context.view_layer.update()
    assert read_scene(blender).target.size == pytest.approx(0.5, rel=1e-6)
    is_free = clearance(blender, read_scene(blender), engine="patch")
    assert is_free(POSITION, ROTATION)
    assert not is_free((1.5, 0.1, 1.2), (0.0, 0.0, 80.0))
    assert not any(f.level == ERROR for f in check.findings(blender))
    np.testing.assert_allclose(picture(blender, samples=64), plain, rtol=0.3)
    assert picture(blender, samples=64).mean() == pytest.approx(plain.mean(), rel=0.02)
