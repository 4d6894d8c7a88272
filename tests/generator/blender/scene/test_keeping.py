"""Nothing that a user made is lost or moved, and what is not rendered is told: cases that a review provoked."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from generator.blender import check, check_signal
from generator.blender.engines import survey
from generator.blender.engines.settings import TURNS, settled
from generator.blender.finding import ERROR, NOTE
from generator.blender.plain_cycles import Plain
from generator.blender.scene import adopt, blend_file, build, clearance, geometry, posing, roles
from generator.blender.scene.description import read_scene
from generator.files.toml import from_dict, to_dict
from generator.model.arrays import rotation_matrix
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.poses import PoseRecord
from generator.model.presets import preset
from generator.model.scene import Scene

_FACES = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]


def built(target="sheet"):
    scene = blend_file.new_file()
    build.build(scene, preset("room", target))
    return scene


def own_object(scene, name="Mine", place=(3.0, 4.0, 5.0), collection=None):
    """A cube of the user's own."""
    mesh = bpy.data.meshes.new(name)
    corners = [(x, y, z) for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)]
    mesh.from_pydata(corners, [], _FACES)
    obj = bpy.data.objects.new(name, mesh)
    obj.location = place
    (collection or scene.collection).objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def test_building_again_keeps_what_was_adopted():
    """The user's object loses its role, no more; what an earlier build made goes, with or without a role."""
    scene = built()
    mine = own_object(scene)
    before = roles.find(scene, "target").name
    adopt.assign(scene, "target", [mine])
    world = bpy.data.worlds.new("Studio")
    scene.world = world
    build.build(scene, preset("room", "sphere"))
    assert mine.name in scene.objects
    assert roles.ROLE not in mine
    assert roles.find(scene, "target") != mine
    assert [o.name for o in scene.objects].count(before) <= 1
    assert len(roles.players(scene, "room")) == len(preset("room").room.surfaces)
    assert bpy.data.worlds.get("Studio") == world
    assert world.use_fake_user


def test_a_scene_that_cannot_be_built_stays():
    """What is refused is refused before anything is taken away."""
    scene = built()
    names = sorted(o.name for o in scene.objects)
    wrong = from_dict(Scene, {**to_dict(preset("room")), "resolution": [64, 32]})
    with pytest.raises(NlosError, match="do not fit the watched rectangle"):
        build.build(scene, wrong)
    assert sorted(o.name for o in scene.objects) == names


def test_metres_move_what_no_view_layer_shows():
    """Of an excluded collection Blender does not know where its objects are; their own figures say it."""
    scene = built()
    hidden = bpy.data.collections.new("Hidden")
    scene.collection.children.link(hidden)
    mine = own_object(scene, place=(2.0, 4.0, 6.0), collection=hidden)
    scene.view_layers[0].layer_collection.children["Hidden"].exclude = True
    bpy.context.view_layer.update()
    scene.unit_settings.scale_length = 0.5
    adopt.to_metres(scene)
    assert tuple(mine.location) == pytest.approx((1.0, 2.0, 3.0))


def limited(mine, scene):
    limit = mine.constraints.new("LIMIT_LOCATION")
    limit.use_min_x, limit.min_x = True, 3.0


def driven(mine, scene):
    mine.driver_add("location", 0).driver.expression = "3"


def animated(mine, scene):
    mine.keyframe_insert("location", frame=1)


@pytest.mark.parametrize("hold", [limited, driven, animated])
def test_what_is_held_is_named_and_nothing_moves(hold):
    scene = built()
    mine = own_object(scene)
    hold(mine, scene)
    before = {o.name: o.matrix_basis.copy() for o in scene.objects}
    scene.unit_settings.scale_length = 0.5
    with pytest.raises(NlosError, match="'Mine' is held by constraints"):
        adopt.to_metres(scene)
    assert all(scene.objects[name].matrix_basis == matrix for name, matrix in before.items())
    assert scene.unit_settings.scale_length == 0.5  # else it would count as converted
    assert not adopt.in_metres(scene)


def test_constraints_to_what_moves_along_hold_nothing():
    scene = built()
    wanted = read_scene(scene)
    lamp, aim = roles.find(scene, "spot"), bpy.data.objects.new("Aim", None)
    aim.location = wanted.spot.aim
    scene.collection.objects.link(aim)
    track = lamp.constraints.new("TRACK_TO")
    track.target, track.track_axis, track.up_axis = aim, "TRACK_NEGATIVE_Z", "UP_Y"
    lamp.rotation_euler = (0.0, 0.0, 0.0)
    for obj in scene.objects:
        obj.matrix_basis = Matrix.Rotation(0.8, 4, "Z") @ Matrix.Translation((0.2, 0.3, 0.0)) @ obj.matrix_basis
    bpy.context.view_layer.update()
    adopt.align(scene)
    found = read_scene(scene).spot
    assert found.aim[2] == pytest.approx(wanted.spot.aim[2], abs=1e-4)
    assert found.location[1:] == pytest.approx(wanted.spot.location[1:], abs=1e-4)


@pytest.mark.parametrize("how", ["exclude", "hide_render"])
def test_a_target_in_a_collection_that_is_not_rendered(how):
    """Found by the check, refused by the engines, mended by its fix."""
    scene = built()
    layer = scene.view_layers[0].layer_collection.children[roles.COLLECTION]
    setattr(layer if how == "exclude" else layer.collection, how, True)
    bpy.context.view_layer.update()
    found = [f for f in check.findings(scene) if "is in no collection that is rendered" in f.text]
    assert [f.level for f in found][:1] == [ERROR]
    with pytest.raises(NlosError, match="is in no collection that is rendered"):
        roles.refuse_hidden(scene)
    check.mend(scene, "show")
    assert not roles.unseen(scene, roles.find(scene, "target"))


def test_an_object_that_changes_nothing_is_an_error():
    """If it is known: never "infinitely far above the noise", and never since no sample met it."""
    probe = check_signal.Probe(engine="surfel", share=0.0, signal_to_noise=0.0, seconds=1.0, bytes=1.0, exact=True)
    assert [f.level for f in probe.findings()] == [ERROR, NOTE]


def test_the_picture_that_was_rendered_last_stays(tmp_path):
    """Reading the scene renders too, in a slot of its own."""
    scene = built()
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.render.image_settings.file_format = "OPEN_EXR"
    bpy.ops.render.render()
    result = next(i for i in bpy.data.images if i.type == "RENDER_RESULT")
    for _ in range(3):
        survey.surfel_world(scene)
    result.save_render(str(tmp_path / "kept.exr"))
    assert (tmp_path / "kept.exr").stat().st_size > 0
    assert len(result.render_slots) <= 9


@pytest.mark.parametrize("scale", [(-1.0, 1.0, 1.0), (-1.0, -1.0, 1.0), (2.0, -1.0, -0.5), (-1.0, -1.0, -1.0)])
@pytest.mark.parametrize("parent", [None, (-1.0, 1.0, -1.0), (1.0, -2.0, 1.0)])
def test_a_mirrored_target_keeps_its_shape_in_every_pose(scale, parent):
    """A matrix of negative scales comes back from Blender as another turn and scale."""
    scene = built()
    target = roles.find(scene, "target")
    corners = np.array([(0.1, 0.0, 0.2), (0.3, 0.0, 0.1), (0.2, 0.1, 0.3)])
    target.data = bpy.data.meshes.new("Uneven")
    target.data.from_pydata([tuple(c) for c in corners], [], [(0, 1, 2)])
    target.data.materials.append(roles.find(scene, "relay_wall").data.materials[0])
    target.rotation_euler, target.scale = (0.3, 0.5, 0.7), scale
    if parent is not None:
        target.parent = bpy.data.objects.new("Parent", None)
        scene.collection.objects.link(target.parent)
        target.parent.scale = parent
        target.location = [at / by for at, by in zip(target.location, parent, strict=True)]
        target.rotation_euler = (0.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    read_scene(scene)

    def placed():
        return np.array([target.matrix_world @ vertex.co for vertex in target.data.vertices])

    # The pose in which it stands, as read, leaves it where it is.
    matrix = Matrix(geometry.snapshot(scene).matrices["target"].tolist())
    place, turn, _ = geometry.pose_of(target, matrix)
    angles = tuple(map(math.degrees, turn.to_euler("XYZ")))
    before, vertices = placed(), geometry.hull(scene)
    np.testing.assert_allclose(vertices @ rotation_matrix(angles).T + place, before, atol=1e-5)
    posing.move_target(scene, tuple(place), angles)
    np.testing.assert_allclose(placed(), before, atol=1e-5)
    # And any other one puts it where the clearance test and plain Cycles have it.
    position, rotation = (1.5, 1.1, 1.2), (10.0, 20.0, 40.0)
    wanted = vertices @ rotation_matrix(rotation).T + position
    posing.move_target(scene, position, rotation)
    np.testing.assert_allclose(placed(), wanted, atol=1e-5)
    Plain(scene, PoseRecord(0, 0, "A", position, rotation, seed=0, file=""), (8, 8))
    np.testing.assert_allclose(placed(), wanted, atol=1e-5)


def test_instances_are_in_the_way_and_what_is_not_rendered_is_not():
    scene = built()
    before = len(clearance.obstacles(scene))
    furniture = bpy.data.collections.new("Furniture")
    own_object(scene, collection=furniture)
    empty = bpy.data.objects.new("Instance", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", furniture
    scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    assert len(clearance.obstacles(scene)) == before + 1
    empty.hide_render = True
    bpy.context.view_layer.update()
    assert len(clearance.obstacles(scene)) == before


def test_odd_properties_are_sentences():
    scene = built()
    roles.find(scene, "target")[roles.KIND] = "teapot"
    assert read_scene(scene).target.kind == "mesh"
    assert settled(scene, read_scene(scene), {})[0].rotation == TURNS["mesh"]
    scene[roles.GRID_LO] = 1.0
    with pytest.raises(NlosError, match="is no three lists of three"):
        roles.read_grid(scene)


def test_many_voxels_are_looked_at_in_part():
    """A window waits for the check."""
    scene = built()
    grid = roles.read_grid(scene)
    roles.write_grid(scene, VoxelGrid(lo=grid.lo, hi=grid.hi, shape=(20, 20, 20)))
    assert not any(f.level == ERROR for f in check.findings(scene))


def test_a_lamp_that_is_no_spot_has_no_patch():
    from generator.blender.scene import outlines

    scene = built()
    lamp = roles.find(scene, "spot")
    lamp.data.type = "POINT"
    assert outlines.lit_patch(lamp).shape == (0, 3)
