"""Builds the Blender scene from its description; `description` reads it back, and `posing` moves the target.

Everything is stored in the file: the role of an object is a custom property of the object (``nlos_role``), the voxel
grid is three custom properties of the scene, and the reflection order is the setting in Cycles' light-path panel. All
of them can be read and edited in Blender without any add-on.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import bpy

# isort: split
import bmesh  # exists only once bpy is imported
import mathutils
import numpy as np

from generator.blender.scene import mesh_file
from generator.blender.scene.blend_file import new_file
from generator.blender.scene.importers import PLAIN
from generator.blender.scene.mesh_file import MeshFile
from generator.blender.scene.roles import (
    BUILT,
    COLLECTION,
    KIND,
    PRESET,
    ROLE,
    SURFACE,
    TARGET_FILE,
    cycles_settings,
    limit_reflections,
    write_grid,
)
from generator.blender.scene.words import file_name
from generator.model.arrays import Range, Vector
from generator.model.errors import NlosError
from generator.model.scene import FACES, Partition, Scene, Spot, Target


def new_scene(wanted: Scene) -> bpy.types.Scene:
    """Build a scene in a new file, which replaces the open one.

    Parameters
    ----------
    wanted : Scene
        As `generator.preset` returns it, possibly with changed values.

    Returns
    -------
    bpy.types.Scene
        Ready to be rendered, swept or saved.

    Raises
    ------
    NlosError
        See `build`.

    Examples
    --------
    >>> import generator
    >>> scene = generator.new_scene(generator.preset("room", "sheet"))
    >>> sorted(obj["nlos_role"] for obj in scene.objects if obj["nlos_role"] != "room")
    ['camera', 'partition', 'relay_wall', 'spot', 'target']
    """
    found = mesh_file.read(wanted.target) if wanted.target.kind == "mesh" else None
    scene = new_file()
    build(scene, wanted, found)
    return scene


def build(scene: bpy.types.Scene, wanted: Scene, found: MeshFile | None = None) -> None:
    """Build a scene from its description, and remove what an earlier call built.

    Parameters
    ----------
    scene : bpy.types.Scene
        Objects without a role are left unchanged.
    wanted : Scene
    found : MeshFile, optional
        Mesh of the target, if it was read before; only OBJ, PLY and STL can be read beside an open scene.

    Raises
    ------
    NlosError
        The mesh file cannot be read, the watched rectangle does not fit the resolution, or a surface has no area.
    """
    width, height = wanted.resolution
    x, z = wanted.camera.x, wanted.camera.z
    aspect = (x[1] - x[0]) / (z[1] - z[0])
    if abs(aspect - width / height) > 0.5 / max(width, height) * aspect:
        raise NlosError(
            f"resolution: {width} x {height} pixels do not fit the watched rectangle of "
            f"{x[1] - x[0]:g} x {z[1] - z[0]:g} m; pixels must be square"
        )
    # All that can fail comes first, so that a failure leaves the scene as it was.
    wanted.check_buildable()
    cycles_settings(scene)
    for obj in scene.objects:
        if ROLE in obj and obj.library is not None:
            raise NlosError(f"{file_name()}: {obj.name!r} is linked from another file, so it cannot be replaced")
    target = build_target(wanted.target, found)
    _clear(scene)
    collection = next((c for c in scene.collection.children if c.name == COLLECTION and c.library is None), None)
    if collection is None:
        collection = bpy.data.collections.new(COLLECTION)
        scene.collection.children.link(collection)
    for layer in scene.view_layers:
        layer.layer_collection.children[collection.name].exclude = False
    wall = _quad("Relay wall", "y", 0.0, {"x": wanted.wall.x, "z": wanted.wall.z}, wanted.wall.albedo, inward=1)
    add_part(collection, wall, "relay_wall")
    if wanted.room:
        extent = {axis: getattr(wanted.room, axis) for axis in "xyz"}
        for surface in wanted.room.surfaces:
            axis, end = FACES[surface]
            across = {a: r for a, r in extent.items() if a != axis}
            quad = _quad(
                surface.capitalize(), axis, extent[axis][end], across, wanted.room.albedo, inward=1 - 2 * end
            )
            quad[SURFACE] = surface
            quad.display_type = "WIRE"  # in the viewport only, so that the inside can be seen
            add_part(collection, quad, "room")
    if wanted.partition:
        for screen in _partition(wanted.partition):
            add_part(collection, screen, "partition")
    add_part(collection, _spot(wanted.spot), "spot")
    camera = _camera(wanted)
    add_part(collection, camera, "camera")
    scene.camera = camera
    add_part(collection, target, "target")
    target.location = np.add(wanted.grid.lo, wanted.grid.hi) / 2.0
    _world(scene, wanted.ambient)
    scene[PRESET] = wanted.preset
    write_grid(scene, wanted.grid)
    scene.render.resolution_x, scene.render.resolution_y = wanted.resolution
    scene.render.resolution_percentage = 100
    limit_reflections(scene, wanted.reflection_order)
    for obj in collection.objects:
        obj[BUILT] = True
    bpy.context.view_layer.update()


def _clear(scene: bpy.types.Scene) -> None:
    """Remove what an earlier call built; the user's own objects only lose their roles."""
    collection = scene.collection.children.get(COLLECTION)
    # Objects that older versions built have no mark, but are in a separate collection.
    built = [
        o
        for o in scene.objects
        if BUILT in o or (ROLE in o and collection is not None and o.name in collection.objects)
    ]
    for obj in [o for o in scene.objects if ROLE in o and o not in built]:
        del obj[ROLE]
    for obj in built:
        data = obj.data
        bpy.data.objects.remove(obj, do_unlink=True)
        if data is not None and data.users == 0:
            bpy.data.batch_remove([data])
    unused = [m for m in bpy.data.materials if m.name.startswith("NLOS ") and m.users == 0]
    bpy.data.batch_remove(unused)


def add_part(collection: bpy.types.Collection, obj: bpy.types.Object, role: str) -> None:
    """Put an object into a collection, in a role."""
    obj[ROLE] = role
    collection.objects.link(obj)


def _material(name: str, reflectance: float | None) -> bpy.types.Material:
    material = bpy.data.materials.new(f"NLOS {name}")
    if material.node_tree is None:  # Blender 5 creates the tree itself and warns of `use_nodes`
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    value = 0.0 if reflectance is None else reflectance
    shader, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Color"].default_value = (value, value, value, 1.0)
    shader.inputs["Roughness"].default_value = 0.0
    output.location.x = 250.0
    material.node_tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    material.diffuse_color = (value, value, value, 1.0)
    return material


def _polish(target: bpy.types.Object, wanted: Target) -> None:
    """Make a share of what a target reflects glossy."""
    if wanted.gloss == 0.0:
        return
    tree = target.data.materials[0].node_tree
    by_type = {node.type: node for node in tree.nodes}
    diffuse, output = by_type["BSDF_DIFFUSE"], by_type["OUTPUT_MATERIAL"]
    glossy, mix = tree.nodes.new("ShaderNodeBsdfGlossy"), tree.nodes.new("ShaderNodeMixShader")
    glossy.distribution = "MULTI_GGX"
    glossy.inputs["Color"].default_value = diffuse.inputs["Color"].default_value
    glossy.inputs["Roughness"].default_value = wanted.roughness
    glossy.location.y, mix.location.x, output.location.x = -150.0, 250.0, 500.0
    mix.inputs[0].default_value = wanted.gloss
    for shader, socket in ((diffuse, mix.inputs[1]), (glossy, mix.inputs[2])):
        tree.links.new(shader.outputs[0], socket)
    tree.links.new(mix.outputs[0], output.inputs["Surface"])


def _mesh(name: str, vertices: list[Vector], faces: list[tuple[int, ...]], reflectance: float | None) -> Any:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    mesh.materials.append(_material(name, reflectance))
    return bpy.data.objects.new(name, mesh)


def _quad(
    name: str, axis: str, at: float, across: dict[str, Range], reflectance: float | None, *, inward: int
) -> bpy.types.Object:
    """Rectangle in a plane of constant ``axis``; its normal points along it if ``inward`` is 1, else against it."""
    (a, (a0, a1)), (b, (b0, b1)) = across.items()
    corners = [{axis: at, a: u, b: v} for u, v in ((a0, b0), (a1, b0), (a1, b1), (a0, b1))]
    vertices = [(c["x"], c["y"], c["z"]) for c in corners]
    normal = np.cross(np.subtract(vertices[1], vertices[0]), np.subtract(vertices[2], vertices[1]))
    if normal["xyz".index(axis)] * inward < 0:
        vertices.reverse()
    return _mesh(name, vertices, [(0, 1, 2, 3)], reflectance)


def _partition(screen: Partition) -> list[bpy.types.Object]:
    reflectance = screen.albedo
    quads = [_quad("Partition", "x", screen.x, {"y": screen.y, "z": screen.z}, reflectance, inward=-1)]
    if screen.depth > 0:
        reach = (screen.x, screen.x + screen.depth)
        quads.append(_quad("Partition side", "y", screen.y[0], {"x": reach, "z": screen.z}, reflectance, inward=-1))
    return quads


def _spot(lamp: Spot) -> bpy.types.Object:
    light = bpy.data.lights.new("Spot", "SPOT")
    light.energy = lamp.power
    light.spot_size = 2.0 * math.radians(lamp.half_angle)
    light.spot_blend = 0.0
    light.shadow_soft_size = 0.0
    obj = bpy.data.objects.new("Spot", light)
    obj.location = lamp.location
    direction = np.subtract(lamp.aim, lamp.location)  # normalised, for Blender treats a short vector as zero
    obj.rotation_euler = mathutils.Vector(direction / np.linalg.norm(direction)).to_track_quat("-Z", "Y").to_euler()
    return obj


def _camera(wanted: Scene) -> bpy.types.Object:
    view = wanted.camera
    camera = bpy.data.cameras.new("Camera")
    width = view.x[1] - view.x[0]
    distance = view.location[1]
    camera.sensor_fit = "HORIZONTAL"
    if view.projection == "orthographic":
        camera.type = "ORTHO"
        camera.ortho_scale = width
    else:
        camera.angle_x = 2.0 * math.atan2(width / 2.0, distance)
    # Facing the wall, the camera's right is -x.
    camera.shift_x = (view.location[0] - (view.x[0] + view.x[1]) / 2.0) / width
    camera.shift_y = ((view.z[0] + view.z[1]) / 2.0 - view.location[2]) / width
    camera.clip_start, camera.clip_end = 1e-3 * distance, 1e3 * distance
    obj = bpy.data.objects.new("Camera", camera)
    obj.location = view.location
    obj.rotation_euler = (math.pi / 2.0, 0.0, math.pi)
    return obj


def build_target(wanted: Target, found: MeshFile | None = None) -> bpy.types.Object:
    """Build the hidden object from its description, and from its mesh, if that was read before."""
    if wanted.kind == "sheet":
        h = wanted.size / 2.0
        target = _quad("Target", "y", 0.0, {"x": (-h, h), "z": (-h, h)}, wanted.albedo, inward=-1)
    elif wanted.kind == "sphere":
        target = _sphere(wanted)
    else:
        target = _import_mesh(wanted, found)
    target[KIND] = wanted.kind
    _polish(target, wanted)
    return target


def _sphere(wanted: Target) -> bpy.types.Object:
    """A geodesic sphere of 5120 triangles with the true sphere's area.

    A convex body's mean projected area is a quarter of its surface (Cauchy 1841), so the light that it receives is
    right on average over directions although its vertices protrude by 0.04 %.
    """
    radius = wanted.size / 2.0
    shape = bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=5, radius=radius)
    area = sum(face.calc_area() for face in shape.faces)
    bmesh.ops.scale(shape, vec=[math.sqrt(4.0 * math.pi * radius**2 / area)] * 3, verts=shape.verts)
    mesh = bpy.data.meshes.new("Target")
    shape.to_mesh(mesh)
    shape.free()
    mesh.materials.append(_material("Target", wanted.albedo))
    return bpy.data.objects.new("Target", mesh)


def _import_mesh(wanted: Target, found: MeshFile | None = None) -> bpy.types.Object:
    if found is None and Path(wanted.mesh).suffix.lower() not in (*PLAIN, ""):
        raise NlosError(f"target.mesh: {wanted.mesh} can be read into a new scene only (`generator.new_scene`)")
    found = found or mesh_file.read(wanted)
    mesh = found.mesh("Target")
    mesh.materials.append(_material("Target", wanted.albedo))
    target = bpy.data.objects.new("Target", mesh)
    target[TARGET_FILE] = mesh_file.described(found)
    return target


def _world(scene: bpy.types.Scene, radiance: float) -> None:
    old = scene.world
    if old is None or BUILT not in old or old.library is not None:
        if old is not None:
            old.use_fake_user = True  # the user's own: kept, although this scene has another now
        scene.world = bpy.data.worlds.new("NLOS world")
        scene.world[BUILT] = True
    if bpy.app.version < (5, 0, 0) or scene.world.node_tree is None:  # Blender 5 always uses nodes, and warns
        scene.world.use_nodes = True
    tree = scene.world.node_tree
    tree.nodes.clear()
    background, output = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    background.inputs["Strength"].default_value = radiance
    output.location.x = 250.0
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
