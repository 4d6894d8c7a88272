"""What the engine `surfel` gets is what Cycles would render, and what it cannot honour is named."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import bpy

# isort: split
import bmesh  # exists only once bpy is imported
import numpy as np
import pytest
import radiometry
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

from generator.blender.engines import renderers, shapes, survey
from generator.blender.scene import blend_file, build, geometry, posing, roles
from generator.blender.scene.words import numbers
from generator.model.arrays import rotation_matrix
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.transport.world import Mesh, Sphere

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def built(name="room", target="sheet", **changes):
    blender = blend_file.new_file()
    build.build(blender, replace(preset(name, target), **changes))
    return blender


def world(blender, **options):
    bpy.context.view_layer.update()
    found, reasons = survey.world(blender, **options)
    assert reasons == []
    return found


def reasons_of(blender):
    bpy.context.view_layer.update()
    found, reasons = survey.world(blender)
    assert (found is None) == bool(reasons)
    return reasons


def material(name, colour=0.5, node="ShaderNodeBsdfDiffuse"):
    made = bpy.data.materials.new(name)
    if made.node_tree is None:
        made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new(node), tree.nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Color"].default_value = (colour, colour, colour, 1.0)
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return made


def cube(name="Cupboard", at=(2.4, 3.0, 0.2), size=0.2, colour=0.5):
    bpy.ops.mesh.primitive_cube_add(size=size, location=at)
    obj = bpy.context.object
    obj.name = name
    obj.data.materials.append(material(name, colour))
    return obj


def target_of(blender):
    return roles.find(blender, "target")


def wall_of(blender):
    return roles.find(blender, "relay_wall")


def camera_of(blender):
    return roles.find(blender, "camera")


def spot_of(blender):
    return roles.find(blender, "spot")


def area(mesh: Mesh) -> float:
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


@pytest.mark.parametrize("name", ["room", "tabletop", "corridor"])
@pytest.mark.parametrize("target", ["sheet", "sphere"])
def test_presets_are_honoured(name, target):
    wanted = preset(name, target)
    blender = built(name, target)
    found = world(blender)
    (x0, x1), (z0, z1) = wanted.camera.x, wanted.camera.z
    corners = [[x1, 0, z1], [x0, 0, z1], [x0, 0, z0], [x1, 0, z0]]
    np.testing.assert_allclose(found.watched.points(CORNERS), corners, atol=3e-6)
    np.testing.assert_allclose(found.watched.normal, (0, 1, 0), atol=1e-6)
    assert found.watched.resolution == wanted.resolution
    assert found.order == 3
    np.testing.assert_allclose(found.watched.albedo, wanted.wall.albedo, rtol=1e-6)
    np.testing.assert_array_equal(found.patch.normal, survey.lit_patch(blender).normal)
    [body] = found.target
    if target == "sphere":
        assert isinstance(body, Sphere)
        assert body.radius == pytest.approx(wanted.target.size / 2, rel=1e-6)
        np.testing.assert_allclose(body.centre, 0.0, atol=1e-6)
        np.testing.assert_allclose(body.albedo, 1.0)
    else:
        assert area(body) == pytest.approx(wanted.target.size**2, rel=1e-6)
        np.testing.assert_allclose(body.albedo, wanted.target.albedo, rtol=1e-6)
    planes = len(roles.players(blender, "room")) + len(roles.players(blender, "partition"))
    assert sum(len(mesh.triangles) for mesh in found.room) == 2 * planes
    albedos = {round(float(a), 6) for mesh in found.room for a in mesh.albedo.ravel()}
    assert albedos == ({wanted.room.albedo, wanted.partition.albedo} if planes else set())
    assert renderers.choose(blender) == ("surfel", [])


def test_numbers_of_blender_are_float64():
    """Where Blender 5 hands float32 to NumPy, columns first, older ones hand Python's floats."""
    blender = built()
    lamp = roles.find(blender, "spot")
    matrix = numbers(lamp.matrix_world)
    assert matrix.dtype == np.float64
    assert matrix.flags.c_contiguous
    assert survey.lit_patch(blender).intensity[0] == lamp.data.energy / (4.0 * math.pi)


def test_reading_leaves_the_scene_as_it_was():
    blender = built()
    target = target_of(blender)
    holder = bpy.data.objects.new("Holder", None)
    blender.collection.objects.link(holder)
    holder.location, holder.rotation_euler = (1.0, 0.2, 0.1), (0.1, 0.2, 0.3)
    target.parent = holder
    target.rotation_mode, target.rotation_quaternion = "QUATERNION", (0.8, 0.6, 0.0, 0.0)
    bpy.context.view_layer.update()
    names = ("engine", "resolution_x", "resolution_y", "use_persistent_data", "use_compositing")
    before = [getattr(blender.render, name) for name in names]
    places = {o.name: o.matrix_world.copy() for o in blender.objects}
    assert world(blender, resolution=(20, 20)).watched.resolution == (20, 20)
    assert [getattr(blender.render, name) for name in names] == before
    assert {o.name: o.matrix_world for o in blender.objects} == places
    assert target.parent == holder
    assert target.rotation_mode == "QUATERNION"
    assert not hasattr(bpy.types, "Look")


@pytest.mark.parametrize("lens", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
def test_watched_is_what_the_camera_sees(lens, fit):
    blender = built()
    camera = camera_of(blender)
    camera.rotation_euler = (math.radians(86), math.radians(7), math.radians(187))
    camera.scale = (2.0, 2.0, 2.0)
    camera.data.type, camera.data.sensor_fit = lens, fit
    camera.data.shift_x, camera.data.shift_y, camera.data.lens = 0.05, -0.04, 90.0
    camera.data.ortho_scale = 0.8
    blender.render.pixel_aspect_x = 2.0  # the engines set it to 1
    found = world(blender, resolution=(48, 32)).watched
    blender.render.resolution_x, blender.render.resolution_y, blender.render.pixel_aspect_x = 48, 32, 1.0
    bpy.context.view_layer.update()
    uv = np.stack(np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 4)), axis=-1).reshape(-1, 2)
    points = found.points(uv)
    np.testing.assert_allclose(points[:, 1], 0.0, atol=1e-9)
    seen = np.array([world_to_camera_view(blender, camera, Vector(p)) for p in points])
    np.testing.assert_allclose(seen[:, 0], uv[:, 0], atol=1e-5)
    np.testing.assert_allclose(1.0 - seen[:, 1], uv[:, 1], atol=1e-5)
    assert (np.column_stack([uv, np.ones(len(uv))]) @ found.to_wall[3] > 0).all()
    eye = (0.0, *found.eye) if lens == "ORTHO" else found.eye
    assert eye[-1] == (0.0 if lens == "ORTHO" else 1.0)


def test_modifiers_are_evaluated_as_rendered():
    blender = built()
    box = cube()
    array = box.modifiers.new("Array", "ARRAY")
    array.count, array.use_relative_offset, array.use_constant_offset = 3, False, True
    array.constant_offset_displace = (0.0, -0.3, 0.0)
    subdivided = box.modifiers.new("Subdivision", "SUBSURF")
    subdivided.subdivision_type, subdivided.levels, subdivided.render_levels = "SIMPLE", 0, 2
    solid = target_of(blender).modifiers.new("Solidify", "SOLIDIFY")
    solid.thickness, solid.offset = 0.01, 0.0
    found = world(blender)
    assert len(found.room[-1].triangles) == 3 * 12 * 16
    assert area(found.room[-1]) == pytest.approx(3 * 6 * 0.04, rel=1e-5)
    [body] = found.target
    assert area(body) == pytest.approx(2 * 0.25 + 4 * 0.5 * 0.01, rel=1e-4)
    assert np.ptp(body.triangles.reshape(-1, 3), axis=0) == pytest.approx([0.5, 0.01, 0.5], rel=1e-5)


def test_albedo_is_per_face():
    blender = built()
    box = cube(colour=0.25)
    box.data.materials.append(material("Top", 0.75))
    box.data.polygons[3].material_index = 1
    box.data.materials.append(material("Unused", 0.75, "ShaderNodeEmission"))
    albedo = world(blender).room[-1].albedo
    assert sorted(albedo[:, 0]) == pytest.approx([0.25] * 10 + [0.75] * 2)


def test_what_is_not_rendered_is_not_read():
    blender = built()
    room = len(world(blender).room)
    cube("Hidden").hide_render = True
    cube("Hidden in the viewport").hide_viewport = True
    cube("Hidden with H", at=(2.0, 3.0, 0.2)).hide_set(True)  # not where the other is: surfel would count both
    excluded = bpy.data.collections.new("Excluded")
    blender.collection.children.link(excluded)
    inside = cube("Excluded")
    for collection in list(inside.users_collection):
        collection.objects.unlink(inside)
    excluded.objects.link(inside)
    excluded.hide_render = True
    assert len(world(blender).room) == room + 2


def test_instances_and_curves_are_read():
    blender = built()
    collection = bpy.data.collections.new("Boxes")
    box = cube("Box", at=(0.0, 0.0, 0.0))
    for holder in list(box.users_collection):
        holder.objects.unlink(box)
    collection.objects.link(box)
    for x in (1.0, 2.0):
        empty = bpy.data.objects.new("Boxes", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        empty.location, empty.scale = (x, 3.0, 0.2), (2.0, 2.0, 2.0)
        blender.collection.objects.link(empty)
    bpy.ops.object.text_add(location=(2.0, 3.0, 1.0), rotation=(math.pi / 2, 0, 0))
    text = bpy.context.object
    text.data.body, text.data.size = "w2", 0.2
    text.data.materials.append(material("Letters"))
    found = world(blender)
    boxes, letters = found.room[-2:]
    assert area(boxes) == pytest.approx(2 * 6 * 0.16, rel=1e-5)
    assert {round(float(v), 5) for v in boxes.triangles[..., 0].ravel()} == {0.8, 1.2, 1.8, 2.2}
    assert len(letters.triangles) > 10
    assert np.ptp(letters.triangles[..., 1]) < 1e-6


def add_child(blender, at=(0.4, 0.0, 0.1)):
    target = target_of(blender)
    child = cube("Handle", at=(0, 0, 0), size=0.1)
    child.parent = target
    child.location = at
    bpy.context.view_layer.update()
    return child


def test_children_move_along():
    blender = built("room", "sphere")
    target = target_of(blender)
    target.rotation_euler, target.scale = (0.3, 0.2, 0.1), (1.5, 1.5, 1.5)
    child = add_child(blender)
    hidden = add_child(blender, at=(9.0, 0.0, 0.0))
    hidden.hide_render = True
    assert roles.target_parts(blender) == [target, child]
    assert roles.others(blender) == []
    found = world(blender)
    ball, handle = found.target
    assert isinstance(ball, Sphere)
    assert ball.radius == pytest.approx(0.3, rel=1e-5)
    np.testing.assert_allclose(handle.triangles.reshape(-1, 3).mean(axis=0), (0.6, 0.0, 0.15), atol=1e-6)
    hull = geometry.hull(blender)
    np.testing.assert_allclose(hull.max(axis=0)[0], 0.675, atol=1e-6)
    pose = ((1.0, 1.2, 1.1), (20.0, 40.0, 60.0))
    posing.move_target(blender, *pose)
    there = handle.triangles.reshape(-1, 3) @ rotation_matrix(pose[1]).T + pose[0]
    matrix = np.array(child.matrix_world)
    corners = geometry.evaluated_vertices(child) @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(np.unique(there.round(5), axis=0), np.unique(corners.round(5), axis=0), atol=2e-5)
    np.testing.assert_allclose(geometry.hull(blender), hull, atol=1e-5)


def test_the_background_is_without_all_parts():
    blender = built()
    child = add_child(blender)
    hidden = []
    bpy.app.handlers.render_pre.append(lambda *_: hidden.append((target_of(blender).hide_render, child.hide_render)))
    try:
        with renderers.opened(blender, "patch", resolution=(2, 2)) as renderer:
            hidden.clear()
            renderer.render(samples=1, seed=0, target=False)
            renderer.render(samples=1, seed=0)
    finally:
        bpy.app.handlers.render_pre.clear()
    assert hidden == [(True, True), (False, False)]
    assert not child.hide_render


def test_ball_scaled_unevenly_is_a_mesh():
    blender = built("room", "sphere")
    target_of(blender).scale = (1.0, 1.0, 0.8)
    [body] = world(blender).target
    assert isinstance(body, Mesh)


def test_smooth_ball_is_a_sphere_and_a_cut_one_is_not():
    blender = built("room", "sphere")
    data = target_of(blender).data
    data.polygons.foreach_set("use_smooth", [True] * len(data.polygons))
    [body] = world(blender).target
    assert isinstance(body, Sphere)
    shape = bmesh.new()
    shape.from_mesh(data)
    whole = [*shape.verts, *shape.edges, *shape.faces]
    bmesh.ops.bisect_plane(shape, geom=whole, plane_co=(0, 0, 0.15), plane_no=(0, 0, 1), clear_outer=True)
    rim = [edge for edge in shape.edges if edge.is_boundary]
    for vertex in {v for edge in rim for v in edge.verts}:
        vertex.co *= 0.2 / vertex.co.length
    bmesh.ops.contextual_create(shape, geom=rim)
    for face in shape.faces:
        face.smooth = False
    shape.to_mesh(data)
    shape.free()
    [body] = world(blender).target
    assert isinstance(body, Mesh)


def test_pose_places_a_turned_stretched_target():
    """Whatever the file's rotation and scale, the World's target at a pose is Blender's."""
    blender = built()
    target = target_of(blender)
    target.rotation_euler, target.scale = (0.5, -0.3, 0.9), (1.0, 1.0, -0.5)
    [body] = world(blender).target
    pose = ((1.2, 1.0, 1.3), (10.0, -50.0, 130.0))
    posing.move_target(blender, *pose)
    there = body.triangles.reshape(-1, 3) @ rotation_matrix(pose[1]).T + pose[0]
    corners = [target.matrix_world @ v.co for v in target.data.vertices]
    np.testing.assert_allclose(np.unique(there.round(5), axis=0), np.unique(np.round(corners, 5), axis=0), atol=2e-5)


def test_flat_smooth_shading_makes_no_difference():
    blender = built()
    for obj in blender.objects:
        if obj.type == "MESH":
            obj.data.polygons.foreach_set("use_smooth", [True] * len(obj.data.polygons))
    world(blender)


def other_lamp(blender):
    lamp = bpy.data.objects.new("Bulb", bpy.data.lights.new("Bulb", "SUN"))
    blender.collection.objects.link(lamp)


def ambient(blender):
    blender.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.1


def textured_world(blender):
    tree = blender.world.node_tree
    sky = tree.nodes.new("ShaderNodeTexEnvironment")
    node = tree.nodes["Background"]
    node.inputs["Strength"].default_value = 1.0
    tree.links.new(sky.outputs[0], node.inputs["Color"])


def foggy_world(blender):
    tree = blender.world.node_tree
    fog = tree.nodes.new("ShaderNodeVolumeScatter")
    output = next(n for n in tree.nodes if n.type == "OUTPUT_WORLD")
    tree.links.new(fog.outputs[0], output.inputs["Volume"])


def made_of(name, node, socket="Surface"):
    def edit(blender):
        made = material("Odd")
        shader = made.node_tree.nodes.new(node)
        output = next(n for n in made.node_tree.nodes if n.type == "OUTPUT_MATERIAL")
        made.node_tree.links.new(shader.outputs[0], output.inputs[socket])
        bpy.data.objects[name].data.materials[0] = made

    return edit


def glossy_target(*edits, **inputs):
    def edit(blender):
        made_of("Target", "ShaderNodeBsdfGlossy")(blender)
        tree = bpy.data.objects["Target"].data.materials[0].node_tree
        shader = next(n for n in tree.nodes if n.type == "BSDF_GLOSSY")
        for name, value in inputs.items():
            shader.inputs[name].default_value = value
        for more in edits:
            more(blender)

    return edit


def textured_wall(blender):
    tree = wall_of(blender).data.materials[0].node_tree
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs[0], tree.nodes["Diffuse BSDF"].inputs[0])


def too_bright(blender):
    target_of(blender).data.materials[0].node_tree.nodes["Diffuse BSDF"].inputs[0].default_value = (2, 1, 1, 1)


def no_material(blender):
    bpy.data.objects["Floor"].data.materials.clear()


def smooth_cube(blender):
    box = cube("Pillow")
    box.data.polygons.foreach_set("use_smooth", [True] * 6)


def smooth_target(blender):
    solid = target_of(blender).modifiers.new("Solidify", "SOLIDIFY")
    solid.thickness = 0.1
    target_of(blender).data.polygons[0].use_smooth = True


def glowing(name, colour=None):
    def edit(blender):
        made_of(name, "ShaderNodeEmission")(blender)
        tree = bpy.data.objects[name].data.materials[0].node_tree
        if colour is not None:
            emission = next(n for n in tree.nodes if n.type == "EMISSION")
            tree.links.new(tree.nodes.new(colour).outputs["Color"], emission.inputs["Color"])

    return edit


def flag(name, attribute, value):
    def edit(blender):
        setattr(bpy.data.objects[name], attribute, value)

    return edit


def light(attribute, value):
    def edit(blender):
        setattr(spot_of(blender).data, attribute, value)

    return edit


def lens(attribute, value):
    def edit(blender):
        setattr(camera_of(blender).data, attribute, value)

    return edit


def blurred(blender):
    camera_of(blender).data.dof.use_dof = True


def thin_pole(blender):
    """Thinner than any grid of probing rays."""
    pole = cube("Pole", at=(-0.7, 1.0, 1.3), size=1.0)
    pole.scale = (1e-3, 1e-3, 2.0)


def speck(blender):
    """Well inside the beam, off its axis."""
    cube("Speck", at=(-0.35 + 0.025, 1.5, 1.5), size=2e-3)


def narrow_wall(blender):
    wall_of(blender).scale.x = 0.3


def bent_wall(blender):
    data = wall_of(blender).data
    data.vertices[0].co.y = 0.5


def turned_away(blender):
    camera_of(blender).rotation_euler = (math.pi / 2, 0, 0)


def behind_the_wall(blender):
    camera = camera_of(blender)
    camera.location.y, camera.rotation_euler = -3.0, (math.pi / 2, 0, 0)
    camera.data.shift_x *= -1
    for name in ("Floor", "Ceiling", "Left", "Right", "Back"):
        bpy.data.objects[name].hide_render = True


def hair(blender):
    curves = bpy.data.objects.new("Wig", bpy.data.hair_curves.new("Wig"))
    blender.collection.objects.link(curves)


def fog(blender):
    blender.collection.objects.link(bpy.data.objects.new("Fog", bpy.data.volumes.new("Fog")))


def fur(blender):
    box = cube("Fur")
    box.modifiers.new("Hair", "PARTICLE_SYSTEM")
    box.particle_systems[0].settings.type = "HAIR"


def held(blender):
    constraint = target_of(blender).constraints.new("LIMIT_LOCATION")
    constraint.use_max_x, constraint.max_x = True, 0.0


def animated(blender):
    target = target_of(blender)
    target.keyframe_insert("location", frame=1)


def soft_body(blender):
    """Its shape follows an object that stays behind."""
    empty = bpy.data.objects.new("Centre", None)
    blender.collection.objects.link(empty)
    target_of(blender).modifiers.new("Cast", "CAST").object = empty


def follower(blender):
    box = cube("Shadowy", at=(1.0, 2.0, 0.2))
    constraint = box.constraints.new("COPY_LOCATION")
    constraint.target = target_of(blender)


def linked_light(blender):
    spot_of(blender).light_linking.receiver_collection = bpy.data.collections.new("Some")


def override(blender):
    bpy.context.view_layer.material_override = material("All alike")


def hidden_target(blender):
    target_of(blender).hide_render = True


def order_4(blender):
    roles.limit_reflections(blender, 4)


def fine_under_a_sky(blender):
    ambient(blender)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=40, y_subdivisions=40, size=0.5, location=(1.0, 2.5, 0.5))
    bpy.context.object.data.materials.append(blender.objects["Target"].data.materials[0])


def indirect_only(blender):
    collection = bpy.data.collections.new("Ghosts")
    blender.collection.children.link(collection)
    box = cube("Ghost")
    for holder in list(box.users_collection):
        holder.objects.unlink(box)
    collection.objects.link(box)
    bpy.context.view_layer.layer_collection.children["Ghosts"].indirect_only = True


OBSTACLES = {
    "other lamp": (other_lamp, "the lamp 'Bulb' shines too, and is a sun lamp"),
    "textured world": (textured_world, "the world '[^']+' gives ambient light"),
    "foggy world": (foggy_world, "the world '[^']+' is filled with a volume"),
    "toon target": (
        made_of("Target", "ShaderNodeBsdfToon"),
        "the target 'Target' .* not one constant colour, diffuse and with at most one gloss",
    ),
    "glossy floor": (
        made_of("Floor", "ShaderNodeBsdfGlossy"),
        "'Floor' has a glossy material, which only the target",
    ),
    "mirror": (glossy_target(Roughness=0.0), "the target 'Target' has a glossy roughness of 0, .* from 0.2 on"),
    "polished target": (
        glossy_target(Roughness=0.1),
        "the target 'Target' has a glossy roughness of 0.1, .* from 0.2",
    ),
    "glossy, order 4": (glossy_target(order_4), "the target 'Target' is glossy, .* order of 3, not 4"),
    "glossy, sky": (glossy_target(ambient), "the target 'Target' is glossy, .* and 'NLOS world' shines too"),
    "glossy, unseen": (
        glossy_target(flag("Back", "visible_glossy", False)),
        "'Back' is not visible to glossy rays, and the target 'Target' is glossy",
    ),
    "too glossy": (glossy_target(Color=(1.2, 0.5, 0.5, 1.0)), "the target 'Target' .* not between 0 and 1"),
    "patchy floor": (glowing("Floor", "ShaderNodeTexNoise"), "'Floor' .* may give light of its own, which is not"),
    "glowing target": (glowing("Target"), "the target 'Target' .* gives light of its own"),
    "glowing wall": (glowing("Relay wall"), "the relay wall 'Relay wall' .* gives light of its own"),
    "floor of fog": (made_of("Floor", "ShaderNodeVolumeScatter", "Volume"), "'Floor' .* volume"),
    "displaced floor": (made_of("Floor", "ShaderNodeDisplacement", "Displacement"), "'Floor' .* displaces it"),
    "textured wall": (textured_wall, "the relay wall 'Relay wall' .* not one constant colour"),
    "bright target": (too_bright, "the target 'Target' .* not between 0 and 1"),
    "no material": (no_material, "'Floor' has no material"),
    "smooth cube": (smooth_cube, "'Pillow' is shaded smooth"),
    "smooth target": (smooth_target, "the target 'Target' is shaded smooth"),
    "invisible wall": (flag("Relay wall", "visible_camera", False), "the relay wall 'Relay wall' .* camera rays"),
    "no diffuse": (flag("Back", "visible_diffuse", False), "'Back' is not visible to diffuse rays"),
    "no shadow": (flag("Target", "visible_shadow", False), "the target 'Target' .* shadow rays"),
    "holdout": (flag("Floor", "is_holdout", True), "'Floor' is a holdout"),
    "catcher": (flag("Floor", "is_shadow_catcher", True), "'Floor' is a shadow catcher"),
    "indirect only": (indirect_only, "'Ghost' is in a collection that is seen indirectly"),
    "lamp radius": (light("shadow_soft_size", 0.1), "the spot 'Spot' has a radius"),
    "lamp shadows": (light("use_shadow", False), "the spot 'Spot' casts no shadows"),
    "hidden lamp": (flag("Spot", "hide_render", True), "the spot 'Spot' is hidden"),
    "wide lamp": (light("spot_size", 3.0), "grazes the wall|misses the plane|stands in the cone"),
    "light linking": (linked_light, "the spot 'Spot' is linked to some objects"),
    "panorama": (lens("type", "PANO"), "the camera 'Camera' is neither"),
    "depth of field": (blurred, "the camera 'Camera' has depth of field"),
    "clipping": (lens("clip_end", 2.0), "the camera 'Camera' clips the relay wall"),
    "near clipping": (lens("clip_start", 3.5), "the camera 'Camera' clips the relay wall"),
    "pole": (thin_pole, "'Pole' stands between the camera 'Camera'"),
    "speck": (speck, "'Speck' stands in the cone of the spot 'Spot'"),
    "narrow wall": (narrow_wall, "the camera 'Camera' sees beyond the edge of the relay wall"),
    "bent wall": (bent_wall, "the camera 'Camera' sees beyond the edge of the relay wall"),
    "hidden wall": (flag("Relay wall", "hide_render", True), "the relay wall 'Relay wall' is hidden"),
    "turned away": (turned_away, "the camera 'Camera' sees beyond the plane"),
    "behind": (behind_the_wall, "the camera 'Camera' and the spot 'Spot' stand on opposite sides"),
    "hair": (hair, "'Wig' is hair curves"),
    "fog": (fog, "'Fog' is a volume"),
    "fur": (fur, "'Fur' carries hair"),
    "held": (held, "the target 'Target' does not go where it is put"),
    "animated": (animated, "the target 'Target' does not go where it is put"),
    "soft": (soft_body, "the target 'Target' changes its shape"),
    "follower": (follower, "'Shadowy' changes when the target moves"),
    "override": (override, "the view layer '[^']+' puts one material"),
    "hidden target": (hidden_target, "the target 'Target' is hidden from renders"),
    "fine under a sky": (fine_under_a_sky, "over which neither other light nor a fourth reflection"),
}


NEVER = ("held", "animated", "follower")


@pytest.mark.parametrize("name", OBSTACLES)
def test_obstacles_are_named(name):
    edit, words = OBSTACLES[name]
    blender = built()
    edit(blender)
    reasons = reasons_of(blender)
    assert [r for r in reasons if re.search(words, r)], reasons
    refusal = f"'surfel' cannot honour that (.*{words}).*; use --engine pat[ch]+"
    if name in NEVER:  # of which no other engine's pictures would be right either
        refusal = f"cannot be swept: {words}"
    with pytest.raises(NlosError, match=refusal):
        survey.surfel_world(blender)


def test_uniform_ambient_light_is_followed():
    blender = built()
    ambient(blender)
    found = survey.surfel_world(blender)
    np.testing.assert_allclose(found.ambient.radiance, 0.1, rtol=1e-6)
    assert len(found.wall.triangles) == 2
    assert survey.surfel_world(built()).ambient is None


def test_all_reasons_are_told():
    blender = built()
    other_lamp(blender)
    no_material(blender)
    textured_world(blender)
    reasons = reasons_of(blender)
    assert len(reasons) == 3
    with pytest.raises(NlosError, match=re.escape(", nor that ".join(reasons)) + "; use --engine patch$"):
        survey.surfel_world(blender)


@pytest.mark.parametrize(
    ("edit", "engine", "words"),
    [
        (made_of("Target", "ShaderNodeBsdfToon"), "patch", "'Target'"),
        (made_of("Target", "ShaderNodeBsdfGlossy"), "surfel", ""),
        (order_4, "surfel", ""),
        (ambient, "surfel", ""),
        (light("shadow_soft_size", 0.1), "path", "'Spot' has a radius"),
        (textured_wall, "path", "'Relay wall'"),
    ],
)
def test_choose(edit, engine, words):
    blender = built()
    edit(blender)
    bpy.context.view_layer.update()
    chosen, reasons = renderers.choose(blender)
    assert chosen == engine
    assert words in " ".join(reasons)


def test_a_camera_may_look_through_what_cameras_do_not_see():
    blender = built()
    front = cube("Front", at=(-0.88, 2.0, 1.37), size=0.1)
    assert "Front" in " ".join(reasons_of(blender))
    front.visible_camera = False
    world(blender)


def test_the_target_may_stand_in_view_and_beam():
    blender = built()
    posing.move_target(blender, (-0.4, 1.5, 1.5), (0.0, 0.0, 0.0))
    world(blender)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scale_makes_no_difference(scale):
    blender = built("room", "sphere")
    for obj in blender.objects:
        obj.matrix_world = Matrix.Scale(scale, 4) @ obj.matrix_world
    camera_of(blender).data.clip_start *= scale
    camera_of(blender).data.clip_end *= scale
    found = world(blender)
    [ball] = found.target
    assert ball.radius == pytest.approx(0.2 * scale, rel=1e-5)
    np.testing.assert_allclose(
        found.watched.points(CORNERS)[0], np.multiply((0.05, 0.0, 1.8), scale), atol=1e-5 * scale
    )


def test_cycles_own_material_is_not_diffuse():
    """Why an object without a material is refused: there is no albedo for which a diffuse wall looks like it."""
    scene = radiometry.bare_scene(reflection_order=1, resolution=(2, 2))
    ratios = []
    for x in (0.4, 0.2):
        levels = []
        for bare in (False, True):
            blender = blend_file.new_file()
            camera = replace(scene.camera, location=(x, 0.5, 0.0), x=(x - 0.05, x + 0.05), z=(-0.05, 0.05))
            build.build(blender, replace(scene, camera=camera))
            if bare:
                wall_of(blender).data.materials.clear()
            with renderers.opened(blender, "path", resolution=(2, 2)) as renderer:
                levels.append(renderer.render(samples=16, seed=0, target=False).mean())
        ratios.append(levels[1] / levels[0])
    assert abs(ratios[0] - ratios[1]) > 0.02


@pytest.mark.parametrize(("height", "smooth"), [(1e-8, False), (1e-3, True)])
def test_slivers_do_not_make_a_surface_smooth(height, smooth):
    """Bevels leave some whose normals are of rounding alone."""
    mesh = bpy.data.meshes.new("Board")
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0, height)]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3), (1, 0, 4)])
    mesh.polygons.foreach_set("use_smooth", [False, True])
    mesh.normals_split_custom_set([(0, 0, 1)] * 7)
    mesh.update()
    assert shapes.is_smooth(mesh) == smooth
