"""Hand-made edits of a scene, each a way in which our picture of an artist's file once differed from Cycles'.

Every edit is a function of the open scene and of the folder that the file will be saved in; `EDITS` names them all.
They find objects by role alone, so that any preset will do; `BASE` is the small scene that `properties.py` uses.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from generator.model.grid import VoxelGrid
from generator.model.scene import Camera, Partition, Room, Scene, Spot, Target, Wall

BASE = Scene(
    preset="custom",
    wall=Wall(x=(-1.6, 2.6), z=(0.0, 2.6)),
    room=Room(x=(-1.6, 2.6), y=(0.0, 2.6), z=(0.0, 2.6), albedo=0.3, surfaces=("floor", "back")),
    partition=Partition(x=0.3, y=(1.2, 2.6), z=(0.0, 2.6)),
    spot=Spot(location=(1.2, 0.9, 1.7), aim=(1.2, 0.0, 1.4), half_angle=35.0, power=1000.0),
    camera=Camera(location=(-0.6, 2.4, 1.2), x=(-0.9, 0.1), z=(0.6, 1.6)),
    grid=VoxelGrid(lo=(0.6, 1.0, 0.5), hi=(1.8, 1.7, 1.5), shape=(1, 1, 1)),
    target=Target(kind="sheet", size=0.6),
    resolution=(8, 8),
)
"""A room in which plain Cycles has little noise, with a wide lit patch and the target near the wall."""

Edit = Callable[[bpy.types.Scene, Path], None]


@dataclass(frozen=True)
class Case:
    """An edit, and what a sweep must do with it.

    Attributes
    ----------
    edit : callable
        Called with the scene and the folder that the file is saved in.
    kind : int
        Number of the kind of fault that it belongs to.
    expect : {"cycles", "refuse", "base"}
        What a sweep must do. cycles: render what plain Cycles renders, or refuse. refuse: refuse. base: render the
        same as without the edit, or refuse.
    solid : callable, optional
        Called with the scene; returns two corners of a box in which no pose of the target may be planned.
    instead : (str, object), optional
        Setting of ``scene.render`` that a sweep replaces, and its new value, which plain Cycles is given too.
    """

    edit: Edit
    kind: int
    expect: str = "cycles"
    solid: Callable[[bpy.types.Scene], tuple[Any, Any]] | None = None
    instead: tuple[str, Any] | None = None


EDITS: dict[str, Case] = {}


def case(kind: int, expect: str = "cycles", **more: Any) -> Callable[[Edit], Edit]:
    """Register an edit under its function's name."""

    def register(edit: Edit) -> Edit:
        EDITS[edit.__name__] = Case(edit, kind, expect, **more)
        return edit

    return register


# --------------------------------------------------------------------------------------------------------------------
# Helpers: the parts of a scene, and small changes of them
# --------------------------------------------------------------------------------------------------------------------


def part(scene: bpy.types.Scene, role: str) -> Any:
    """Return the first object that plays a role."""
    return next(o for o in scene.objects if o.get("nlos_role") == role)


def material(scene: bpy.types.Scene, role: str) -> Any:
    """Return the material of the object that plays a role."""
    return part(scene, role).material_slots[0].material


def nodes_of(owner: Any) -> Any:
    """Return the node tree of a material, lamp or world, created and enabled if necessary."""
    if owner.node_tree is None or (bpy.app.version < (5, 0) and not owner.use_nodes):
        owner.use_nodes = True
    if isinstance(owner, bpy.types.Light) and bpy.app.version < (5, 2):
        owner.use_nodes = True
    return owner.node_tree


def fresh(owner: Any) -> Any:
    """Return the emptied node tree of a material, lamp or world."""
    tree = nodes_of(owner)
    tree.nodes.clear()
    return tree


def output_of(tree: Any) -> Any:
    """Return the first output node of a tree."""
    return next(n for n in tree.nodes if n.type.startswith("OUTPUT_"))


def shaded(tree: Any, shader: str, output: str = "ShaderNodeOutputMaterial", **inputs: Any) -> Any:
    """Add a shader with some inputs, linked to an output of its own; return the shader."""
    node, end = tree.nodes.new(shader), tree.nodes.new(output)
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ")].default_value = value
    tree.links.new(node.outputs[0], end.inputs["Surface"])
    return node


def new_material(name: str, shader: str = "ShaderNodeBsdfDiffuse", **inputs: Any) -> Any:
    """Return a new material of one shader."""
    shade = bpy.data.materials.new(name)
    shaded(fresh(shade), shader, **inputs)
    return shade


def add(scene: bpy.types.Scene, name: str, data: Any, location: Any = (0.0, 0.0, 0.0)) -> Any:
    """Put a new object into the scene."""
    obj = bpy.data.objects.new(name, data)
    obj.location = tuple(map(float, location))
    scene.collection.objects.link(obj)
    return obj


def middle(scene: bpy.types.Scene) -> Any:
    """Return the middle of the voxel grid."""
    return (np.array(scene["nlos_grid_lo"]) + np.array(scene["nlos_grid_hi"])) / 2.0


def box(name: str, size: Any, shade: Any = None) -> Any:
    """Return the mesh of a closed box around the origin, normals outwards."""
    x, y, z = np.broadcast_to(np.asarray(size, float) / 2.0, 3)
    corners = [(a * x, b * y, c * z) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([tuple(map(float, c)) for c in corners], [], faces)
    mesh.materials.append(shade or new_material(name, Color=(0.5, 0.5, 0.5, 1.0)))
    return mesh


def plane(name: str, size: float, shade: Any = None) -> Any:
    """Return the mesh of a square in the plane y = 0 of its frame."""
    h = size / 2.0
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-h, 0.0, -h), (h, 0.0, -h), (h, 0.0, h), (-h, 0.0, h)], [], [(0, 1, 2, 3)])
    mesh.materials.append(shade or new_material(name, Color=(0.5, 0.5, 0.5, 1.0)))
    return mesh


def lamp(name: str, kind: str, power: float, **settings: Any) -> Any:
    """Return a lamp's data."""
    light = bpy.data.lights.new(name, kind)
    light.energy = power
    for key, value in settings.items():
        setattr(light, key, value)
    return light


def beside(scene: bpy.types.Scene, *shift: float) -> Any:
    """Return a place for furniture behind the voxels, out of the way, or shifted from there."""
    lo, hi = np.array(scene["nlos_grid_lo"]), np.array(scene["nlos_grid_hi"])
    return np.array([(lo[0] + hi[0]) / 2.0, hi[1] + 0.3, lo[2] + 0.2]) + (shift or 0.0)


def keyed(owner: Any, name: str, *values: Any, index: int = -1) -> None:
    """Insert keyframes of a property at the frames 1, 11, 21 ...; leave it at the first value."""
    for number, value in enumerate(values):
        if index >= 0:
            getattr(owner, name)[index] = value
        else:
            setattr(owner, name, value)
        owner.keyframe_insert(name, index=index, frame=1 + 10 * number)


def geometry(obj: Any, name: str = "Geometry") -> tuple[Any, Any, Any]:
    """Add a geometry nodes modifier to an object; return its node tree, input node and output node."""
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    modifier = obj.modifiers.new(name, "NODES")
    modifier.node_group = group
    return group, start, end


def with_nodes(obj: Any, kind: str, **inputs: Any) -> Any:
    """Send an object's geometry through one node; return the node."""
    group, start, end = geometry(obj)
    node = group.nodes.new(kind)
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ")].default_value = value
    group.links.new(start.outputs[0], node.inputs[0])
    group.links.new(node.outputs[0], end.inputs[0])
    return node


def instanced(scene: bpy.types.Scene, name: str, *objects: Any) -> Any:
    """Move objects into a collection that is in no scene, and show it by an empty; return the empty."""
    collection = bpy.data.collections.new(name)
    for obj in objects:
        for user in obj.users_collection:
            user.objects.unlink(obj)
        collection.objects.link(obj)
    empty = add(scene, name, None)
    empty.instance_type = "COLLECTION"
    empty.instance_collection = collection
    return empty


# --------------------------------------------------------------------------------------------------------------------
# 1. Animation
# --------------------------------------------------------------------------------------------------------------------


@case(1, "refuse")
def target_keys_on_location(scene, folder):
    place = middle(scene)
    keyed(part(scene, "target"), "location", tuple(place), tuple(place + 0.05))


@case(1, "refuse")
def target_keys_on_rotation(scene, folder):
    keyed(part(scene, "target"), "rotation_euler", (0.0, 0.0, 0.3), (0.0, 0.0, 1.0))


@case(1, "refuse")
def target_keys_on_one_axis(scene, folder):
    keyed(part(scene, "target"), "location", 0.9, 1.0, index=0)


@case(1, "refuse")
def target_nla_strip(scene, folder):
    target = part(scene, "target")
    target_keys_on_location(scene, folder)
    data = target.animation_data
    action = data.action
    data.action = None
    data.nla_tracks.new().strips.new("strip", 1, action)


@case(1, "refuse")
def target_driver_on_location(scene, folder):
    driver = part(scene, "target").driver_add("location", 0).driver
    driver.type = "SUM"
    variable = driver.variables.new()
    variable.targets[0].id = part(scene, "spot")
    variable.targets[0].data_path = "location.x"


@case(1)
def target_keys_on_scale(scene, folder):
    keyed(part(scene, "target"), "scale", (0.8, 1.0, 0.8), (1.0, 1.0, 1.0))


@case(1, "refuse")
def target_keyed_out_of_renders(scene, folder):
    keyed(part(scene, "target"), "hide_render", True, False)
    part(scene, "target").hide_render = False


@case(1)
def target_keys_elsewhere_muted(scene, folder):
    target_keys_on_location(scene, folder)
    tracks = part(scene, "target").animation_data
    action = tracks.action
    tracks.action = None
    track = tracks.nla_tracks.new()
    track.strips.new("strip", 1, action)
    track.mute = True


@case(1, "base")
def marker_bound_to_another_camera(scene, folder):
    camera = add(scene, "Other camera", bpy.data.cameras.new("Other"), (-0.5, 2.0, 1.3))
    camera.rotation_euler = (math.pi / 2.0, 0.0, math.pi)
    scene.timeline_markers.new("other", frame=1).camera = camera


@case(1)
def spot_power_keyed(scene, folder):
    keyed(part(scene, "spot").data, "energy", 300.0, 1000.0)
    part(scene, "spot").data.energy = 700.0


@case(1)
def spot_power_driven(scene, folder):
    driver = part(scene, "spot").data.driver_add("energy").driver
    driver.expression = "400"


@case(1)
def spot_keyed_place(scene, folder):
    spot = part(scene, "spot")
    place = np.array(spot.location)
    keyed(spot, "location", tuple(np.add(place, (0.05, 0.0, 0.05))), tuple(place))
    spot.location = tuple(place)


@case(1)
def camera_keyed_place(scene, folder):
    camera = part(scene, "camera")
    place = np.array(camera.location)
    keyed(camera, "location", tuple(np.add(place, (-0.05, 0.0, 0.05))), tuple(place))
    camera.location = tuple(place)


@case(1)
def wall_colour_keyed(scene, folder):
    colour = material(scene, "relay_wall").node_tree.nodes["Diffuse BSDF"].inputs["Color"]
    keyed(colour, "default_value", (0.3, 0.3, 0.3, 1.0), (0.8, 0.8, 0.8, 1.0))
    colour.default_value = (0.8, 0.8, 0.8, 1.0)


@case(1)
def target_colour_keyed(scene, folder):
    colour = material(scene, "target").node_tree.nodes["Diffuse BSDF"].inputs["Color"]
    keyed(colour, "default_value", (0.2, 0.2, 0.2, 1.0), (0.9, 0.9, 0.9, 1.0))
    colour.default_value = (0.9, 0.9, 0.9, 1.0)


@case(1)
def room_keyed_out_of_renders(scene, folder):
    floor = part(scene, "room")
    keyed(floor, "hide_render", True, False)
    floor.hide_render = False


@case(1)
def target_shape_keyed(scene, folder):
    target = part(scene, "target")
    target.shape_key_add(name="Basis")
    shape = target.shape_key_add(name="Small")
    for point in shape.data:
        point.co = 0.6 * point.co
    keyed(shape, "value", 1.0, 0.0)
    shape.value = 0.0


@case(1)
def bounces_keyed(scene, folder):
    keyed(scene.cycles, "diffuse_bounces", 1, 2)
    scene.cycles.diffuse_bounces = 2


@case(1)
def time_stands_later(scene, folder):
    spot_power_keyed(scene, folder)
    scene.frame_set(11)
    part(scene, "spot").data.energy = 700.0


@case(1, "refuse")
def grandparent_keyed(scene, folder):
    empty = add(scene, "Mover", None)
    keyed(empty, "location", (0.1, 0.0, 0.0), (0.0, 0.0, 0.0))
    empty.location = (0.0, 0.0, 0.0)
    hold = part(scene, "target").constraints.new("CHILD_OF")
    hold.target = empty


# --------------------------------------------------------------------------------------------------------------------
# 2. What moves with the target
# --------------------------------------------------------------------------------------------------------------------


def _tracks(owner: Any, aim: Any, influence: float) -> None:
    track = owner.constraints.new("TRACK_TO")
    track.target, track.track_axis, track.up_axis, track.influence = aim, "TRACK_NEGATIVE_Z", "UP_Y", influence


@case(2, "refuse")
def spot_tracks_target(scene, folder):
    _tracks(part(scene, "spot"), part(scene, "target"), 0.02)


@case(2, "refuse")
def camera_tracks_target(scene, folder):
    _tracks(part(scene, "camera"), part(scene, "target"), 0.02)


@case(2)
def lamp_child_of_target(scene, folder):
    child = add(scene, "Child lamp", lamp("Child lamp", "POINT", 1.0), (0.0, 0.15, 0.0))
    child.parent = part(scene, "target")


@case(2, "refuse")
def cupboard_copies_target(scene, folder):
    cupboard = add(scene, "Cupboard", box("Cupboard", 0.2), beside(scene))
    copy = cupboard.constraints.new("COPY_LOCATION")
    copy.target, copy.influence, copy.use_offset = part(scene, "target"), 0.05, False


@case(2, "refuse")
def cupboard_shrinkwraps_target(scene, folder):
    cupboard = add(scene, "Cupboard", box("Cupboard", 0.2), beside(scene))
    wrap = cupboard.modifiers.new("Wrap", "SHRINKWRAP")
    wrap.target, wrap.offset = part(scene, "target"), 0.2


@case(2, "refuse")
def spot_power_driven_by_target(scene, folder):
    driver = part(scene, "spot").data.driver_add("energy").driver
    variable = driver.variables.new()
    variable.targets[0].id = part(scene, "target")
    variable.targets[0].data_path = "location.x"
    driver.expression = "500 + 500 * var"


@case(2, "refuse")
def floor_colour_driven_by_target(scene, folder):
    shade = material(scene, "room")
    driver = shade.node_tree.nodes["Diffuse BSDF"].inputs["Color"].driver_add("default_value", 0).driver
    variable = driver.variables.new()
    variable.targets[0].id = part(scene, "target")
    variable.targets[0].data_path = "location.x"
    driver.expression = "var / 3"


@case(2)
def empty_child_of_target(scene, folder):
    add(scene, "Handle", None).parent = part(scene, "target")


@case(2)
def mesh_child_of_target(scene, folder):
    add(scene, "Knob", box("Knob", 0.1), (0.0, 0.1, 0.0)).parent = part(scene, "target")


@case(2)
def area_lamp_grandchild_of_target(scene, folder):
    handle = add(scene, "Handle", None)
    handle.parent = part(scene, "target")
    child = add(scene, "Panel", lamp("Panel", "AREA", 1.0, size=0.05), (0.0, 0.15, 0.0))
    child.parent = handle


@case(2)
def texture_of_target_follows_target(scene, folder):
    tree = material(scene, "target").node_tree
    coordinates, ramp = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexGradient")
    coordinates.object = part(scene, "target")
    tree.links.new(coordinates.outputs["Object"], ramp.inputs["Vector"])
    tree.links.new(ramp.outputs["Color"], tree.nodes["Diffuse BSDF"].inputs["Color"])


@case(2, "refuse")
def world_texture_follows_child_of_target(scene, folder):
    handle = add(scene, "Handle", None)
    handle.parent = part(scene, "target")
    tree, node = _sky(scene)
    coordinates, ramp = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexGradient")
    coordinates.object = handle
    tree.links.new(coordinates.outputs["Object"], ramp.inputs["Vector"])
    tree.links.new(ramp.outputs["Color"], node.inputs["Color"])


@case(2, "refuse")
def texture_of_floor_follows_target(scene, folder):
    tree = material(scene, "room").node_tree
    coordinates, ramp = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexGradient")
    coordinates.object = part(scene, "target")
    tree.links.new(coordinates.outputs["Object"], ramp.inputs["Vector"])
    tree.links.new(ramp.outputs["Color"], tree.nodes["Diffuse BSDF"].inputs["Color"])


# --------------------------------------------------------------------------------------------------------------------
# 3. The viewport and the render
# --------------------------------------------------------------------------------------------------------------------


def _cube(scene: bpy.types.Scene, size: float) -> Any:
    return add(scene, "Cube", box("Cube", size), middle(scene))


def _around(size: float) -> Callable[[bpy.types.Scene], tuple[Any, Any]]:
    return lambda scene: (middle(scene) - size / 2.0, middle(scene) + size / 2.0)


@case(3, solid=_around(0.3))
def cube_hidden_in_viewport(scene, folder):
    _cube(scene, 0.3).hide_viewport = True


@case(3, solid=_around(0.3))
def cube_in_collection_hidden_in_viewport(scene, folder):
    collection = bpy.data.collections.new("Furniture")
    scene.collection.children.link(collection)
    cube = _cube(scene, 0.3)
    scene.collection.objects.unlink(cube)
    collection.objects.link(cube)
    collection.hide_viewport = True


@case(3, solid=_around(0.3))
def cube_shown_by_render_only_modifier(scene, folder):
    cube = add(scene, "Cube", box("Cube", 0.01), middle(scene))
    scale = cube.modifiers.new("Grow", "CAST")
    scale.cast_type, scale.factor, scale.size, scale.use_radius_as_size = "CUBOID", 1.0, 0.15, False
    scale.show_viewport = False


@case(3)
def cube_hidden_in_renders(scene, folder):
    _cube(scene, 0.6).hide_render = True


@case(3)
def target_array_in_renders_only(scene, folder):
    array = part(scene, "target").modifiers.new("Array", "ARRAY")
    array.count, array.show_viewport = 2, False


@case(3)
def target_array_in_viewport_only(scene, folder):
    array = part(scene, "target").modifiers.new("Array", "ARRAY")
    array.count, array.show_render = 2, False


@case(3)
def target_is_viewport_node(scene, folder):
    target = part(scene, "target")
    group, start, end = geometry(target)
    scale = group.nodes.new("GeometryNodeTransform")
    scale.inputs["Scale"].default_value = (0.5, 0.5, 0.5)
    choice, is_viewport = group.nodes.new("GeometryNodeSwitch"), group.nodes.new("GeometryNodeIsViewport")
    choice.input_type = "GEOMETRY"
    group.links.new(is_viewport.outputs[0], choice.inputs["Switch"])
    group.links.new(start.outputs[0], scale.inputs["Geometry"])
    group.links.new(start.outputs[0], choice.inputs["True"])
    group.links.new(scale.outputs[0], choice.inputs["False"])
    group.links.new(choice.outputs[0], end.inputs[0])


@case(3)
def target_subdivided_in_renders(scene, folder):
    level = part(scene, "target").modifiers.new("Subdivision", "SUBSURF")
    level.levels, level.render_levels = 0, 2


@case(3)
def target_subdivided_in_viewport(scene, folder):
    level = part(scene, "target").modifiers.new("Subdivision", "SUBSURF")
    level.levels, level.render_levels = 2, 0


@case(3)
def target_hidden_in_viewport(scene, folder):
    part(scene, "target").hide_viewport = True


@case(3)
def spot_hidden_in_viewport(scene, folder):
    part(scene, "spot").hide_viewport = True


@case(3)
def camera_hidden_in_viewport(scene, folder):
    part(scene, "camera").hide_viewport = True


@case(3)
def wall_hidden_in_viewport(scene, folder):
    part(scene, "relay_wall").hide_viewport = True


@case(3)
def wall_displaced_in_renders(scene, folder):
    wall = part(scene, "relay_wall")
    split = wall.modifiers.new("Split", "SUBSURF")
    split.subdivision_type, split.levels, split.render_levels = "SIMPLE", 4, 4
    texture = bpy.data.textures.new("Bumps", "CLOUDS")
    bumps = wall.modifiers.new("Bumps", "DISPLACE")
    bumps.texture, bumps.strength, bumps.show_viewport = texture, 0.15, False


@case(3, instead=("use_simplify", False))
def target_simplified_in_renders(scene, folder):
    level = part(scene, "target").modifiers.new("Subdivision", "SUBSURF")
    level.levels, level.render_levels = 2, 2
    scene.render.use_simplify = True
    scene.render.simplify_subdivision_render = 0


# --------------------------------------------------------------------------------------------------------------------
# 4. Inside a solid
# --------------------------------------------------------------------------------------------------------------------


@case(4, solid=_around(0.66))
def voxel_filled_by_a_cube(scene, folder):
    _cube(scene, 0.66)


@case(4, solid=_around(0.66))
def voxel_filled_by_an_instanced_cube(scene, folder):
    instanced(scene, "Boxes", _cube(scene, 0.66))


@case(4, solid=_around(0.66))
def voxel_filled_by_an_inverted_cube(scene, folder):
    _cube(scene, 0.66).data.flip_normals()


# --------------------------------------------------------------------------------------------------------------------
# 5. Settings of the file that reach the pixels
# --------------------------------------------------------------------------------------------------------------------


@case(5, "base")
def stamp_on_pictures(scene, folder):
    scene.render.use_stamp = True
    scene.render.stamp_font_size = 8


@case(5, "base")
def compositor_doubles(scene, folder):
    if bpy.app.version < (5, 0):
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        layers, end = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeComposite")
        out = end.inputs[0]
    else:
        tree = bpy.data.node_groups.new("Compositing", "CompositorNodeTree")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        if hasattr(scene, "compositor_effects"):  # Blender 5.3
            scene.compositor_effects.new("Compositing").node_group = tree
        else:
            scene.compositing_node_group = tree
        layers, end = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("NodeGroupOutput")
        out = end.inputs[0]
    exposed = tree.nodes.new("CompositorNodeExposure")
    exposed.inputs["Exposure"].default_value = 1.0
    tree.links.new(layers.outputs["Image"], exposed.inputs["Image"])
    tree.links.new(exposed.outputs[0], out)


@case(5)
def view_layer_material_override(scene, folder):
    scene.view_layers[0].material_override = new_material("Dark", Color=(0.2, 0.2, 0.2, 1.0))


@case(5)
def view_layer_world_override(scene, folder):
    world = bpy.data.worlds.new("Bright")
    background = shaded(fresh(world), "ShaderNodeBackground", "ShaderNodeOutputWorld")
    background.inputs["Strength"].default_value = 1.0
    if hasattr(scene.view_layers[0], "world_override"):
        scene.view_layers[0].world_override = world


@case(5)
def second_view_layer(scene, folder):
    scene.view_layers.new("Second")


@case(5)
def holdout_floor(scene, folder):
    part(scene, "room").is_holdout = True


@case(5)
def indirect_only_furniture(scene, folder):
    collection = bpy.data.collections.new("Furniture")
    scene.collection.children.link(collection)
    collection.objects.link(add(scene, "Cupboard", box("Cupboard", 0.3), beside(scene)))
    scene.view_layers[0].layer_collection.children["Furniture"].indirect_only = True


@case(5)
def target_in_an_excluded_collection(scene, folder):
    scene.view_layers[0].layer_collection.children[0].exclude = True


# --------------------------------------------------------------------------------------------------------------------
# 6. What the wall is made of
# --------------------------------------------------------------------------------------------------------------------


@case(6)
def wall_material_set_by_geometry_nodes(scene, folder):
    dark = new_material("Dark", Color=(0.3, 0.3, 0.3, 1.0))
    with_nodes(part(scene, "relay_wall"), "GeometryNodeSetMaterial", Material=dark)


@case(6)
def target_material_set_by_geometry_nodes(scene, folder):
    dark = new_material("Dark", Color=(0.3, 0.3, 0.3, 1.0))
    with_nodes(part(scene, "target"), "GeometryNodeSetMaterial", Material=dark)


def _second_output(shade: Any, engine: str, *, first: str = "ALL", active: bool = False) -> None:
    tree = shade.node_tree
    old = output_of(tree)
    old.target = first
    dark = shaded(tree, "ShaderNodeBsdfDiffuse", Color=(0.3, 0.3, 0.3, 1.0))
    added = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL" and n != old)
    added.target = engine
    added.is_active_output, old.is_active_output = active, not active
    assert dark.outputs[0].is_linked


@case(6)
def wall_second_output_for_cycles(scene, folder):
    _second_output(material(scene, "relay_wall"), "CYCLES")


@case(6)
def wall_second_output_for_eevee(scene, folder):
    _second_output(material(scene, "relay_wall"), "EEVEE", active=True)


@case(6)
def wall_outputs_for_eevee_and_cycles(scene, folder):
    _second_output(material(scene, "relay_wall"), "CYCLES", first="EEVEE")


@case(6)
def wall_second_output_active(scene, folder):
    _second_output(material(scene, "relay_wall"), "ALL", active=True)


@case(6)
def target_second_output_for_cycles(scene, folder):
    _second_output(material(scene, "target"), "CYCLES")


@case(6)
def floor_second_output_for_eevee(scene, folder):
    _second_output(material(scene, "room"), "EEVEE", active=True)


@case(6)
def wall_invisible_to_diffuse(scene, folder):
    part(scene, "relay_wall").visible_diffuse = False


@case(6)
def wall_custom_normals(scene, folder):
    mesh = part(scene, "relay_wall").data
    turn = np.array([0.5, 1.0, 0.3])
    mesh.normals_split_custom_set([tuple(turn / np.linalg.norm(turn))] * len(mesh.loops))


@case(6)
def target_custom_normals(scene, folder):
    mesh = part(scene, "target").data
    turn = np.array([0.5, -1.0, 0.3])
    mesh.normals_split_custom_set([tuple(turn / np.linalg.norm(turn))] * len(mesh.loops))


@case(6)
def wall_smooth(scene, folder):
    part(scene, "relay_wall").data.shade_smooth()


@case(6)
def absorbing_world(scene, folder):
    tree = nodes_of(scene.world)
    fog = tree.nodes.new("ShaderNodeVolumeAbsorption")
    fog.inputs["Density"].default_value = 0.5
    fog.inputs["Color"].default_value = (0.3, 0.3, 0.3, 1.0)
    tree.links.new(fog.outputs[0], output_of(tree).inputs["Volume"])


@case(6)
def absorbing_box(scene, folder):
    fog = bpy.data.materials.new("Fog")
    tree = fresh(fog)
    node, end = tree.nodes.new("ShaderNodeVolumeAbsorption"), tree.nodes.new("ShaderNodeOutputMaterial")
    node.inputs["Density"].default_value = 1.0
    node.inputs["Color"].default_value = (0.3, 0.3, 0.3, 1.0)
    tree.links.new(node.outputs[0], end.inputs["Volume"])
    wall = part(scene, "relay_wall")
    ends = np.array([wall.matrix_world @ v.co for v in wall.data.vertices])
    low, high = ends.min(axis=0) - 0.2, ends.max(axis=0) + 0.2
    low[1], high[1] = -0.2, 1.0
    add(scene, "Fog", box("Fog", high - low, fog), (low + high) / 2.0)


@case(6)
def wall_terminator_offset(scene, folder):
    part(scene, "relay_wall").shadow_terminator_shading_offset = 0.9


@case(6)
def wall_terminator_geometry_offset(scene, folder):
    part(scene, "relay_wall").shadow_terminator_geometry_offset = 1.0


@case(6)
def target_terminator_offset(scene, folder):
    part(scene, "target").shadow_terminator_shading_offset = 0.9


@case(6)
def wall_slot_of_the_object(scene, folder):
    slot = part(scene, "relay_wall").material_slots[0]
    slot.link = "OBJECT"
    slot.material = new_material("Dark", Color=(0.3, 0.3, 0.3, 1.0))


@case(6)
def wall_second_slot_used(scene, folder):
    mesh = part(scene, "relay_wall").data
    mesh.materials.append(new_material("Dark", Color=(0.3, 0.3, 0.3, 1.0)))
    mesh.polygons[0].material_index = 1


@case(6)
def wall_second_slot_unused(scene, folder):
    part(scene, "relay_wall").data.materials.append(new_material("Dark", Color=(0.3, 0.3, 0.3, 1.0)))


@case(6)
def wall_coloured_by_attribute(scene, folder):
    wall = part(scene, "relay_wall")
    colours = wall.data.color_attributes.new("Col", "FLOAT_COLOR", "POINT")
    for item in colours.data:
        item.color = (0.3, 0.3, 0.3, 1.0)
    tree = material(scene, "relay_wall").node_tree
    source = tree.nodes.new("ShaderNodeVertexColor")
    source.layer_name = "Col"
    tree.links.new(source.outputs["Color"], tree.nodes["Diffuse BSDF"].inputs["Color"])


@case(6)
def wall_bumped(scene, folder):
    tree = material(scene, "relay_wall").node_tree
    bump, noise = tree.nodes.new("ShaderNodeBump"), tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs[0], bump.inputs["Height"])
    tree.links.new(bump.outputs[0], tree.nodes["Diffuse BSDF"].inputs["Normal"])


@case(6)
def wall_rough_diffuse(scene, folder):
    material(scene, "relay_wall").node_tree.nodes["Diffuse BSDF"].inputs["Roughness"].default_value = 0.8


@case(6)
def wall_without_material(scene, folder):
    part(scene, "relay_wall").data.materials.clear()


@case(6)
def wall_empty_slot(scene, folder):
    part(scene, "relay_wall").material_slots[0].material = None


# --------------------------------------------------------------------------------------------------------------------
# 7. Nodes that are there but do not count
# --------------------------------------------------------------------------------------------------------------------


def _spot_nodes(scene: bpy.types.Scene) -> tuple[Any, Any, Any]:
    tree = fresh(part(scene, "spot").data)
    emission = shaded(tree, "ShaderNodeEmission", "ShaderNodeOutputLight", Strength=1.0, Color=(1.0, 1.0, 1.0, 1.0))
    return tree, emission, output_of(tree)


@case(7)
def spot_emission_muted(scene, folder):
    _spot_nodes(scene)[1].mute = True


@case(7)
def spot_link_muted(scene, folder):
    _spot_nodes(scene)[0].links[0].is_muted = True


@case(7)
def spot_unlinked(scene, folder):
    tree = _spot_nodes(scene)[0]
    tree.links.remove(tree.links[0])


@case(7)
def spot_output_for_eevee(scene, folder):
    _spot_nodes(scene)[2].target = "EEVEE"


@case(7)
def spot_output_for_cycles(scene, folder):
    _spot_nodes(scene)[2].target = "CYCLES"


@case(7)
def spot_second_output_dark(scene, folder):
    tree, _, first = _spot_nodes(scene)
    shaded(tree, "ShaderNodeEmission", "ShaderNodeOutputLight", Strength=0.2)
    second = next(n for n in tree.nodes if n.type == "OUTPUT_LIGHT" and n != first)
    second.is_active_output = True


@case(7)
def spot_without_output(scene, folder):
    tree, _, end = _spot_nodes(scene)
    tree.nodes.remove(end)


@case(7)
def spot_through_reroute(scene, folder):
    tree, emission, end = _spot_nodes(scene)
    reroute = tree.nodes.new("NodeReroute")
    tree.links.new(emission.outputs[0], reroute.inputs[0])
    tree.links.new(reroute.outputs[0], end.inputs["Surface"])


@case(7)
def spot_strength_of_two(scene, folder):
    _spot_nodes(scene)[1].inputs["Strength"].default_value = 2.0


@case(7)
def spot_strength_by_unlinked_texture(scene, folder):
    tree, emission, _ = _spot_nodes(scene)
    value = tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = 0.5
    tree.links.new(value.outputs[0], emission.inputs["Strength"]).is_muted = True


@case(7)
def spot_nodes_unused(scene, folder):
    _spot_nodes(scene)[1].inputs["Strength"].default_value = 0.3
    if bpy.app.version < (5, 2):
        part(scene, "spot").data.use_nodes = False


@case(7)
def wall_shader_muted(scene, folder):
    material(scene, "relay_wall").node_tree.nodes["Diffuse BSDF"].mute = True


@case(7)
def wall_link_muted(scene, folder):
    material(scene, "relay_wall").node_tree.links[0].is_muted = True


@case(7)
def target_link_muted(scene, folder):
    material(scene, "target").node_tree.links[0].is_muted = True


@case(7)
def floor_link_muted(scene, folder):
    material(scene, "room").node_tree.links[0].is_muted = True


@case(7)
def wall_colour_link_muted(scene, folder):
    tree = material(scene, "relay_wall").node_tree
    dark = tree.nodes.new("ShaderNodeRGB")
    dark.outputs[0].default_value = (0.2, 0.2, 0.2, 1.0)
    tree.links.new(dark.outputs[0], tree.nodes["Diffuse BSDF"].inputs["Color"]).is_muted = True


@case(7)
def wall_through_reroute(scene, folder):
    tree = material(scene, "relay_wall").node_tree
    reroute = tree.nodes.new("NodeReroute")
    tree.links.new(tree.nodes["Diffuse BSDF"].outputs[0], reroute.inputs[0])
    tree.links.new(reroute.outputs[0], output_of(tree).inputs["Surface"])


@case(7)
def wall_with_a_stray_emission(scene, folder):
    material(scene, "relay_wall").node_tree.nodes.new("ShaderNodeEmission")


@case(7)
def target_with_a_black_emission(scene, folder):
    shaded(
        fresh(material(scene, "target")),
        "ShaderNodeBsdfPrincipled",
        Base_Color=(0.9, 0.9, 0.9, 1.0),
        Specular_IOR_Level=0.0,
        Emission_Color=(0.0, 0.0, 0.0, 1.0),
        Emission_Strength=1.0,
    )


@case(7)
def wall_with_a_black_emission(scene, folder):
    shaded(
        fresh(material(scene, "relay_wall")),
        "ShaderNodeBsdfPrincipled",
        Base_Color=(0.8, 0.8, 0.8, 1.0),
        Specular_IOR_Level=0.0,
        Emission_Color=(0.0, 0.0, 0.0, 1.0),
        Emission_Strength=1.0,
    )


@case(7)
def target_in_a_node_group(scene, folder):
    group = bpy.data.node_groups.new("Look", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    end, shader = group.nodes.new("NodeGroupOutput"), group.nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (0.3, 0.3, 0.3, 1.0)
    group.links.new(shader.outputs[0], end.inputs[0])
    tree = fresh(material(scene, "target"))
    node, out = tree.nodes.new("ShaderNodeGroup"), tree.nodes.new("ShaderNodeOutputMaterial")
    node.node_tree = group
    tree.links.new(node.outputs[0], out.inputs["Surface"])


def _sky(scene: bpy.types.Scene, shader: str = "ShaderNodeBackground") -> tuple[Any, Any]:
    tree = fresh(scene.world)
    node = shaded(tree, shader, "ShaderNodeOutputWorld", Color=(1.0, 1.0, 1.0, 1.0))
    node.inputs["Strength"].default_value = 0.5
    return tree, node


@case(7)
def world_link_muted(scene, folder):
    _sky(scene)[0].links[0].is_muted = True


@case(7)
def world_shader_muted(scene, folder):
    _sky(scene)[1].mute = True


@case(7)
def world_output_for_eevee(scene, folder):
    output_of(_sky(scene)[0]).target = "EEVEE"


@case(7)
def world_second_output_for_cycles(scene, folder):
    tree, _ = _sky(scene)
    first = output_of(tree)
    background = shaded(tree, "ShaderNodeBackground", "ShaderNodeOutputWorld")
    background.inputs["Strength"].default_value = 0.1
    second = next(n for n in tree.nodes if n.type == "OUTPUT_WORLD" and n != first)
    second.target = "CYCLES"
    first.is_active_output = True


@case(7)
def world_unlinked(scene, folder):
    tree, _ = _sky(scene)
    tree.links.remove(tree.links[0])


@case(7)
def world_stray_background_node(scene, folder):
    nodes_of(scene.world).nodes.new("ShaderNodeBackground")


# --------------------------------------------------------------------------------------------------------------------
# 8. Mirrors and glass
# --------------------------------------------------------------------------------------------------------------------


def _metal(shade: Any, roughness: float) -> None:
    shaded(fresh(shade), "ShaderNodeBsdfAnisotropic", Color=(0.9, 0.9, 0.9, 1.0), Roughness=roughness)


@case(8)
def target_mirror(scene, folder):
    _metal(material(scene, "target"), 0.0)


@case(8)
def target_nearly_mirror(scene, folder):
    _metal(material(scene, "target"), 0.02)


@case(8)
def target_rough_metal(scene, folder):
    _metal(material(scene, "target"), 0.5)


def _partly_glossy(scene: Any, distribution: str, **inputs: Any) -> None:
    """Make the target's material a mixture of a diffuse shader and of a glossy one of a distribution."""
    tree = fresh(material(scene, "target"))
    mix, glossy = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfAnisotropic")
    diffuse, end = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Roughness"].default_value = 0.0
    glossy.distribution = distribution
    for name, value in inputs.items():
        glossy.inputs[name].default_value = value
    mix.inputs[0].default_value = 0.6
    tree.links.new(diffuse.outputs[0], mix.inputs[1])
    tree.links.new(glossy.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], end.inputs["Surface"])


@case(8)
def target_partly_glossy(scene, folder):
    _partly_glossy(scene, "GGX", Roughness=0.6, Color=(0.9, 0.6, 0.3, 1.0))


@case(8)
def target_partly_glossy_multiscatter(scene, folder):
    _partly_glossy(scene, "MULTI_GGX", Roughness=1.0, Color=(0.9, 0.6, 0.3, 1.0))


@case(8)
def target_glossy_beckmann(scene, folder):
    _partly_glossy(scene, "BECKMANN", Roughness=0.6)


@case(8)
def target_glossy_anisotropic(scene, folder):
    _partly_glossy(scene, "GGX", Roughness=0.6, Anisotropy=0.7)


@case(8)
def target_glossy_room_unseen_by_glossy(scene, folder):
    _partly_glossy(scene, "GGX", Roughness=0.6)
    next(o for o in scene.objects if o.get("nlos_role") == "room").visible_glossy = False


@case(8)
def target_principled_mirror(scene, folder):
    shaded(
        fresh(material(scene, "target")),
        "ShaderNodeBsdfPrincipled",
        Base_Color=(0.9, 0.9, 0.9, 1.0),
        Metallic=1.0,
        Roughness=0.0,
    )


@case(8)
def target_glass(scene, folder):
    shaded(fresh(material(scene, "target")), "ShaderNodeBsdfGlass", Color=(1.0, 1.0, 1.0, 1.0), Roughness=0.0)


@case(8)
def target_transparent_half(scene, folder):
    tree = fresh(material(scene, "target"))
    mix, clear = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
    diffuse, end = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(clear.outputs[0], mix.inputs[1])
    tree.links.new(diffuse.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], end.inputs["Surface"])


@case(8)
def target_plastic(scene, folder):
    shaded(fresh(material(scene, "target")), "ShaderNodeBsdfPrincipled", Roughness=0.2)


@case(8)
def floor_mirror(scene, folder):
    _metal(material(scene, "room"), 0.0)


@case(8)
def floor_plastic(scene, folder):
    shaded(fresh(material(scene, "room")), "ShaderNodeBsdfPrincipled", Roughness=0.1)


@case(8)
def target_translucent(scene, folder):
    shaded(fresh(material(scene, "target")), "ShaderNodeBsdfTranslucent", Color=(0.9, 0.9, 0.9, 1.0))


@case(8)
def glass_pane_before_the_target(scene, folder):
    pane = new_material("Pane", "ShaderNodeBsdfGlass", Roughness=0.0)
    lo, hi = np.array(scene["nlos_grid_lo"]), np.array(scene["nlos_grid_hi"])
    add(scene, "Pane", plane("Pane", float(hi[0] - lo[0]), pane), ((lo + hi) / 2.0) * (1, 0, 1) + (0, lo[1] - 0.1, 0))


# --------------------------------------------------------------------------------------------------------------------
# 9. Bounces, and lamps besides the spot
# --------------------------------------------------------------------------------------------------------------------


@case(9)
def no_glossy_bounces(scene, folder):
    _metal(material(scene, "target"), 0.4)
    scene.cycles.glossy_bounces = 0


@case(9)
def more_bounces_than_diffuse(scene, folder):
    _metal(material(scene, "target"), 0.4)
    scene.cycles.max_bounces, scene.cycles.diffuse_bounces, scene.cycles.glossy_bounces = 4, 4, 0


@case(9)
def fewer_bounces_in_all(scene, folder):
    scene.cycles.max_bounces, scene.cycles.diffuse_bounces = 2, 4


@case(9)
def no_transmission_bounces(scene, folder):
    shaded(fresh(material(scene, "target")), "ShaderNodeBsdfTranslucent", Color=(0.9, 0.9, 0.9, 1.0))
    scene.cycles.transmission_bounces = 0


@case(9)
def no_transparent_bounces(scene, folder):
    target_transparent_half(scene, folder)
    scene.cycles.transparent_max_bounces = 0


@case(9)
def point_lamp(scene, folder):
    add(scene, "Bulb", lamp("Bulb", "POINT", 20.0, shadow_soft_size=0.05), beside(scene, 0.0, 0.0, 1.0))


@case(9)
def area_lamp(scene, folder):
    add(scene, "Panel", lamp("Panel", "AREA", 20.0, size=0.3), beside(scene, 0.0, 0.0, 1.2))


@case(9)
def sun_lamp(scene, folder):
    add(scene, "Sun", lamp("Sun", "SUN", 0.05), (0.0, 1.0, 5.0))


@case(9)
def second_spot(scene, folder):
    spot_copy = part(scene, "spot").copy()
    spot_copy.name = "Second spot"
    del spot_copy["nlos_role"]
    scene.collection.objects.link(spot_copy)


@case(9)
def point_lamp_in_an_instance(scene, folder):
    bulb = add(scene, "Bulb", lamp("Bulb", "POINT", 20.0, shadow_soft_size=0.05), beside(scene, 0.0, 0.0, 1.0))
    instanced(scene, "Lamps", bulb)


@case(9)
def point_lamp_in_a_background_set(scene, folder):
    set_scene = bpy.data.scenes.new("Set")
    bulb = add(set_scene, "Bulb", lamp("Bulb", "POINT", 20.0, shadow_soft_size=0.05), beside(scene, 0.0, 0.0, 1.0))
    assert bulb.name in set_scene.objects
    scene.background_set = set_scene


@case(9)
def furniture_in_a_background_set(scene, folder):
    set_scene = bpy.data.scenes.new("Set")
    add(set_scene, "Cupboard", box("Cupboard", 0.3), beside(scene))
    scene.background_set = set_scene


@case(9)
def spot_copied_in_an_instance(scene, folder):
    collection = bpy.data.collections.new("Copy")
    collection.objects.link(part(scene, "spot"))
    empty = add(scene, "Copy", None, (0.1, 0.0, 0.0))
    empty.instance_type, empty.instance_collection = "COLLECTION", collection


@case(9)
def glowing_panel(scene, folder):
    glow = new_material("Glow", "ShaderNodeEmission", Strength=1.0)
    add(scene, "Glow", plane("Glow", 0.3, glow), beside(scene))


@case(9)
def glow_by_geometry_nodes(scene, folder):
    glow = new_material("Glow", "ShaderNodeEmission", Strength=1.0)
    board = add(scene, "Board", plane("Board", 0.3), beside(scene))
    with_nodes(board, "GeometryNodeSetMaterial", Material=glow)


@case(9)
def glow_on_an_unused_slot(scene, folder):
    part(scene, "room").data.materials.append(new_material("Glow", "ShaderNodeEmission", Strength=1.0))


@case(9)
def target_glows(scene, folder):
    shaded(fresh(material(scene, "target")), "ShaderNodeEmission", Strength=0.5)


@case(9)
def lamp_hidden_in_renders(scene, folder):
    add(scene, "Bulb", lamp("Bulb", "POINT", 20.0), beside(scene)).hide_render = True


@case(9)
def lamp_without_power(scene, folder):
    add(scene, "Bulb", lamp("Bulb", "POINT", 0.0), beside(scene))


@case(9)
def lamp_with_negative_power(scene, folder):
    add(scene, "Bulb", lamp("Bulb", "POINT", -5.0, shadow_soft_size=0.05), beside(scene, 0.0, 0.0, 1.0))


@case(9)
def spot_in_a_light_group(scene, folder):
    scene.view_layers[0].lightgroups.add(name="Group")
    part(scene, "spot").lightgroup = "Group"


# --------------------------------------------------------------------------------------------------------------------
# 10. The world
# --------------------------------------------------------------------------------------------------------------------


@case(10)
def world_grey(scene, folder):
    _sky(scene)


@case(10)
def world_coloured(scene, folder):
    _sky(scene)[1].inputs["Color"].default_value = (0.2, 0.5, 1.0, 1.0)


@case(10)
def world_of_emission(scene, folder):
    _sky(scene, "ShaderNodeEmission")


@case(10)
def world_of_two_shaders(scene, folder):
    tree, first = _sky(scene)
    second, both = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeAddShader")
    second.inputs["Strength"].default_value = 0.3
    end = output_of(tree)
    tree.links.new(first.outputs[0], both.inputs[0])
    tree.links.new(second.outputs[0], both.inputs[1])
    tree.links.new(both.outputs[0], end.inputs["Surface"])


@case(10)
def world_gradient(scene, folder):
    tree, node = _sky(scene)
    coordinates, ramp = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexGradient")
    tree.links.new(coordinates.outputs["Generated"], ramp.inputs["Vector"])
    tree.links.new(ramp.outputs["Color"], node.inputs["Color"])


@case(10)
def world_strength_linked(scene, folder):
    tree, node = _sky(scene)
    value = tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = 0.4
    tree.links.new(value.outputs[0], node.inputs["Strength"])
    node.inputs["Strength"].default_value = 0.0


@case(10)
def world_through_reroute(scene, folder):
    tree, node = _sky(scene)
    reroute = tree.nodes.new("NodeReroute")
    tree.links.new(node.outputs[0], reroute.inputs[0])
    tree.links.new(reroute.outputs[0], output_of(tree).inputs["Surface"])


@case(10)
def world_for_camera_rays_only(scene, folder):
    tree, node = _sky(scene)
    rays = tree.nodes.new("ShaderNodeLightPath")
    tree.links.new(rays.outputs["Is Camera Ray"], node.inputs["Strength"])


@case(10)
def world_scattering(scene, folder):
    tree = nodes_of(scene.world)
    fog = tree.nodes.new("ShaderNodeVolumeScatter")
    fog.inputs["Density"].default_value = 0.1
    tree.links.new(fog.outputs[0], output_of(tree).inputs["Volume"])


@case(10)
def world_fog_under_a_sky(scene, folder):
    tree, _ = _sky(scene)
    fog = tree.nodes.new("ShaderNodeVolumeAbsorption")
    fog.inputs["Density"].default_value = 0.3
    tree.links.new(fog.outputs[0], output_of(tree).inputs["Volume"])


@case(10)
def world_sky_texture(scene, folder):
    tree, node = _sky(scene)
    tree.links.new(tree.nodes.new("ShaderNodeTexSky").outputs[0], node.inputs["Color"])
    node.inputs["Strength"].default_value = 0.05


@case(10)
def world_invisible_to_diffuse(scene, folder):
    _sky(scene)
    scene.world.cycles_visibility.diffuse = False


@case(10)
def no_world(scene, folder):
    scene.world = None


@case(10)
def world_glowing_fog(scene, folder):
    tree = nodes_of(scene.world)
    fog = tree.nodes.new("ShaderNodeEmission")
    fog.inputs["Strength"].default_value = 0.05
    tree.links.new(fog.outputs[0], output_of(tree).inputs["Volume"])


# --------------------------------------------------------------------------------------------------------------------
# 11. Surfaces on one another
# --------------------------------------------------------------------------------------------------------------------


def _twin(scene: bpy.types.Scene, role: str) -> Any:
    twin = part(scene, role).copy()
    twin.name = "Twin"
    del twin["nlos_role"]
    scene.collection.objects.link(twin)
    return twin


@case(11)
def target_faces_doubled(scene, folder):
    mesh = part(scene, "target").data
    points = [tuple(v.co) for v in mesh.vertices]
    shade = mesh.materials[0]
    double = bpy.data.meshes.new("Double")
    faces = [tuple(p.vertices) for p in mesh.polygons]
    double.from_pydata(2 * points, [], faces + [tuple(len(points) + v for v in f) for f in faces])
    double.materials.append(shade)
    part(scene, "target").data = double


@case(11)
def target_child_on_the_target(scene, folder):
    twin = _twin(scene, "target")
    twin.location = (0.0, 0.0, 0.0)
    twin.parent = part(scene, "target")


@case(11)
def target_mirrored_onto_itself(scene, folder):
    mirror = part(scene, "target").modifiers.new("Mirror", "MIRROR")
    mirror.use_axis[0], mirror.use_mirror_merge = True, False


@case(11)
def target_array_in_place(scene, folder):
    array = part(scene, "target").modifiers.new("Array", "ARRAY")
    array.count, array.use_relative_offset = 3, False


@case(11)
def floor_doubled(scene, folder):
    _twin(scene, "room")


@case(11)
def wall_doubled(scene, folder):
    _twin(scene, "relay_wall")


@case(11)
def target_solidified_flat(scene, folder):
    part(scene, "target").modifiers.new("Thickness", "SOLIDIFY").thickness = 0.0


# --------------------------------------------------------------------------------------------------------------------
# 13. Shapes and places of the target
# --------------------------------------------------------------------------------------------------------------------


@case(13)
def target_sheared(scene, folder):
    target = part(scene, "target")
    outer, inner = add(scene, "Outer", None), add(scene, "Inner", None)
    outer.scale = (1.2, 1.0, 0.8)
    inner.parent = outer
    inner.rotation_euler = (0.0, math.radians(45.0), 0.0)
    target.parent = inner
    target.location = (0.0, 0.0, 0.0)
    outer.location = tuple(middle(scene))


@case(13)
def target_sheared_by_parent_inverse(scene, folder):
    target = part(scene, "target")
    target.parent = add(scene, "Holder", None)
    target.matrix_parent_inverse = Matrix(((1, 0, 0.4, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)))


@case(13)
def target_scaled(scene, folder):
    part(scene, "target").scale = (0.6, 1.0, 0.9)


@case(13)
def target_parented_plainly(scene, folder):
    holder = add(scene, "Holder", None, (0.3, 0.2, 0.1))
    part(scene, "target").parent = holder


@case(13)
def target_of_a_scaled_parent(scene, folder):
    holder = add(scene, "Holder", None)
    holder.scale = (0.7, 0.7, 0.7)
    part(scene, "target").parent = holder


@case(13)
def target_by_quaternion(scene, folder):
    target = part(scene, "target")
    target.rotation_mode = "QUATERNION"
    target.rotation_quaternion = (0.9, 0.1, 0.2, 0.3)


@case(17)
def target_delta_location(scene, folder):
    part(scene, "target").delta_location = (0.1, 0.0, 0.1)


@case(17)
def target_delta_rotation(scene, folder):
    part(scene, "target").delta_rotation_euler = (0.0, 0.0, 0.4)


@case(17)
def target_delta_scale(scene, folder):
    part(scene, "target").delta_scale = (0.7, 1.0, 0.7)


@case(17)
def target_limited(scene, folder):
    limit = part(scene, "target").constraints.new("LIMIT_LOCATION")
    limit.use_max_z, limit.max_z = True, 0.3


@case(17)
def target_constraint_muted(scene, folder):
    target_limited(scene, folder)
    part(scene, "target").constraints[0].mute = True


@case(17)
def target_locked(scene, folder):
    part(scene, "target").lock_location = (True, True, True)


@case(17)
def spot_delta_location(scene, folder):
    part(scene, "spot").delta_location = (0.05, 0.0, 0.05)


@case(17)
def camera_scaled(scene, folder):
    part(scene, "camera").scale = (2.0, 1.0, 1.0)


# --------------------------------------------------------------------------------------------------------------------
# 15. Missing files, instances and collections
# --------------------------------------------------------------------------------------------------------------------


@case(15)
def missing_image_on_the_floor(scene, folder):
    image = bpy.data.images.new("Gone", 4, 4)
    image.filepath_raw, image.file_format = str(folder / "gone.png"), "PNG"
    image.save()
    image.source, image.filepath = "FILE", "//gone.png"
    tree = material(scene, "room").node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    tree.links.new(texture.outputs["Color"], tree.nodes["Diffuse BSDF"].inputs["Color"])
    (folder / "gone.png").unlink()


@case(15)
def target_is_an_instanced_collection(scene, folder):
    target = part(scene, "target")
    mesh = bpy.data.objects.new("Sheet", target.data)
    collection = bpy.data.collections.new("Hidden")
    collection.objects.link(mesh)
    del target["nlos_role"]
    bpy.data.objects.remove(target)
    empty = add(scene, "Target", None, middle(scene))
    empty["nlos_role"] = "target"
    empty.instance_type, empty.instance_collection = "COLLECTION", collection


@case(15)
def target_without_extent(scene, folder):
    for vertex in part(scene, "target").data.vertices:
        vertex.co = (0.0, 0.0, 0.0)


@case(15)
def furniture_in_an_instance(scene, folder):
    instanced(scene, "Furniture", add(scene, "Cupboard", box("Cupboard", 0.3), beside(scene)))


@case(15)
def furniture_on_vertices(scene, folder):
    points = bpy.data.meshes.new("Points")
    points.from_pydata([(0.0, 0.0, 0.0), (0.0, 0.0, 0.5)], [], [])
    owner = add(scene, "Points", points, beside(scene))
    owner.instance_type = "VERTS"
    add(scene, "Cupboard", box("Cupboard", 0.2)).parent = owner


@case(15)
def furniture_with_hair(scene, folder):
    cupboard = add(scene, "Cupboard", box("Cupboard", 0.3), beside(scene))
    cupboard.modifiers.new("Hair", "PARTICLE_SYSTEM")
    hair = cupboard.particle_systems[0].settings
    hair.type, hair.count, hair.hair_length = "HAIR", 50, 0.2


@case(15)
def furniture_of_curves(scene, folder):
    curve = bpy.data.curves.new("Bar", "CURVE")
    curve.dimensions, curve.bevel_depth = "3D", 0.03
    line = curve.splines.new("POLY")
    line.points.add(1)
    line.points[0].co, line.points[1].co = (0.0, 0.0, 0.0, 1.0), (0.4, 0.0, 0.3, 1.0)
    curve.materials.append(new_material("Bar", Color=(0.5, 0.5, 0.5, 1.0)))
    add(scene, "Bar", curve, beside(scene))


@case(15)
def furniture_by_points_to_instances(scene, folder):
    # Planes, not boxes: with some forty faces the engine's background would take minutes.
    cupboard = add(scene, "Cupboard", plane("Cupboard", 0.2), beside(scene, 0.0, 0.2, 0.0))
    board = add(scene, "Board", plane("Board", 0.4), beside(scene))
    group, start, end = geometry(board)
    on_points, info = group.nodes.new("GeometryNodeInstanceOnPoints"), group.nodes.new("GeometryNodeObjectInfo")
    info.inputs["Object"].default_value = cupboard
    info.transform_space = "ORIGINAL"
    group.links.new(start.outputs[0], on_points.inputs["Points"])
    group.links.new(info.outputs["Geometry"], on_points.inputs["Instance"])
    group.links.new(on_points.outputs[0], end.inputs[0])


@case(15)
def library_there(scene, folder):
    library = folder / "library.blend"
    mesh = box("Linked", 0.3)
    obj = bpy.data.objects.new("Linked", mesh)
    obj.location = tuple(map(float, beside(scene)))
    bpy.data.libraries.write(str(library), {obj})
    bpy.data.objects.remove(obj)
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = ["Linked"]
    scene.collection.objects.link(wanted.objects[0])


@case(15, "refuse")
def library_gone(scene, folder):
    library_there(scene, folder)
    (folder / "library.blend").unlink()
