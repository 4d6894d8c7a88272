"""Corrects an open scene by what a calibration found to be off in it, and checks that its light is then as said."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from generator.blender.engines import survey
from generator.blender.scene import blend_file, materials, nodes, roles
from generator.blender.scene.build import new_scene
from generator.blender.scene.description import read_scene
from generator.blender.scene.words import file_name, numbers
from generator.files.toml import dump_toml, from_dict, read_toml, to_dict
from generator.files.writing import write_text
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.scene import Scene
from generator.transport.parameters import mean_albedo, with_parameters
from generator.transport.world import World
from generator.transport.world_file import save_world

_ROUNDING = 1e-4
"""Largest difference that Blender's 24 bits make, relative to the largest number of an array."""


def opened(path: Path) -> bpy.types.Scene:
    """Open a ``.blend``, or build the scene that a ``.toml`` describes."""
    if path.suffix.lower() != ".toml":
        return blend_file.open_file(path)
    described: Scene = from_dict(Scene, read_toml(path))
    return new_scene(described)


def read(path: Path, file: Path, resolution: Sequence[int]) -> dict[str, Any]:
    """Write the world of a scene as a file of arrays; return the scene's description as plain tables.

    Parameters
    ----------
    path : Path
        The scene: ``.blend``, or ``.toml`` with its description.
    file : Path
        Where `world_file.save_world` writes.
    resolution : sequence of int
        Width and height of the pictures.

    Raises
    ------
    NlosError
        The scene cannot be read, or the engine ``surfel`` cannot render it.
    """
    scene = opened(path)
    width, height = resolution
    save_world(file, survey.surfel_world(scene, resolution=(width, height)))
    return to_dict(read_scene(scene, (width, height)))


def write(path: Path, file: Path, offsets: Mapping[str, float]) -> None:
    """Write a scene with corrected values, as ``.blend`` or ``.toml``; see `correct`."""
    scene = opened(path)
    correct(scene, offsets)
    if file.suffix.lower() == ".toml":
        described = _described(from_dict(Scene, read_toml(path)), read_scene(scene))
        write_text(file, dump_toml(to_dict(described)))
    else:
        blend_file.save_file(file)


def _described(told: Scene, found: Scene) -> Scene:
    """Return the description of a corrected scene: what was not corrected stays as it was told."""
    room, screen = told.room, told.partition
    if room is not None and found.room is not None:
        room = replace(room, albedo=found.room.albedo)
    if screen is not None and found.partition is not None:
        screen = replace(screen, albedo=found.partition.albedo)
    return replace(
        told,
        wall=replace(told.wall, albedo=found.wall.albedo),
        room=room,
        partition=screen,
        spot=found.spot,
        camera=replace(found.camera, projection=told.camera.projection),
        target=replace(told.target, size=found.target.size, albedo=found.target.albedo),
        ambient=found.ambient,
    )


def correct(scene: bpy.types.Scene, offsets: Mapping[str, float]) -> None:
    """Change values of an open scene.

    Parameters
    ----------
    scene : bpy.types.Scene
    offsets : mapping
        What is added to values, as `with_parameters` has it.

    Raises
    ------
    NlosError
        The scene cannot be changed so: its light would not be that of `with_parameters`, as where the lamp is
        animated, or a surface is not plainly Lambertian.
    """
    before = survey.surfel_world(scene)
    wanted = with_parameters(before, offsets)
    _move_spot(scene, wanted, offsets)
    _move_view(scene, before, offsets)
    _paint(scene, before, offsets)
    target: Any = roles.find(scene, "target")
    size = 1.0 + offsets.get("target.size", 0.0)
    target.scale = [size * value for value in target.scale]
    _brighten(scene, 1.0 + offsets.get("ambient", 0.0))
    bpy.context.view_layer.update()
    if name := _unlike(wanted, survey.surfel_world(scene)):
        raise NlosError(
            f"{file_name()}: cannot be corrected, since its {name} would not be as it was found (an animation, a "
            "constraint, a parent or a driver may hold it); apply the offsets by hand"
        )


def _move_spot(scene: bpy.types.Scene, wanted: World, offsets: Mapping[str, float]) -> None:
    spot: Any = roles.find(scene, "spot")
    if any(name.startswith(("spot.location", "spot.aim")) for name in offsets):
        from mathutils import Matrix, Vector

        lamp, axis = Vector(wanted.patch.lamp.tolist()), Vector(wanted.patch.axis.tolist())
        turn = axis.to_track_quat("-Z", "Y").to_matrix().to_4x4()
        spot.matrix_world = Matrix.Translation(lamp) @ turn @ Matrix.Diagonal(spot.matrix_world.to_scale()).to_4x4()
    spot.data.spot_size += 2.0 * math.radians(offsets.get("spot.half_angle", 0.0))
    spot.data.energy *= 1.0 + offsets.get("spot.power", 0.0)


def _move_view(scene: bpy.types.Scene, before: World, offsets: Mapping[str, float]) -> None:
    """Move the camera and its view: by the lens' shift where it looks straight at the wall, else with the camera."""
    camera: Any = roles.find(scene, "camera")
    step, view = (
        np.array([offsets.get(f"camera.{what}.{axis}", 0.0) for axis in "xyz"]) for what in ("location", "view")
    )
    if not (step.any() or view.any()):
        return
    from mathutils import Vector

    frame = numbers(camera.matrix_world)[:3, :3]
    frame = frame / np.linalg.norm(frame, axis=0)
    normal, lens = before.watched.normal, camera.data
    straight = float(frame[:, 2] @ normal) > 1.0 - 1e-9
    if not straight or lens.type != "PERSP":
        camera.matrix_world.translation += Vector((view + step).tolist())
        return
    corners = before.watched.points(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    sides = [float(np.linalg.norm(corners[k] - corners[0])) for k in (1, 2)]
    away = float((before.watched.eye[:3] - corners[0]) @ normal)
    camera.matrix_world.translation += Vector(step.tolist())
    nearer = (away + float(step @ normal)) / away
    # A shift is in units of the longer side, and of the lens' own picture at that distance.
    lens.angle = 2.0 * math.atan(math.tan(lens.angle / 2.0) / nearer)
    flat = view - (step - (step @ normal) * normal)
    lens.shift_x += float(flat @ frame[:, 0]) / max(sides)
    lens.shift_y += float(flat @ frame[:, 1]) / max(sides)


def _paint(scene: bpy.types.Scene, before: World, offsets: Mapping[str, float]) -> None:
    """Give surfaces the albedos that are wanted, each object materials of its own."""
    wall = float(before.watched.albedo.mean())
    means = {"wall": wall, "room": mean_albedo(before.room), "target": mean_albedo(before.target)}
    walls, targets = roles.players(scene, "relay_wall"), roles.target_parts(scene)
    rooms = [scene.objects[name] for name in survey.room_names(scene)] if "room.albedo" in offsets else []
    for part, objects in (("wall", walls), ("room", rooms), ("target", targets)):
        name = f"{part}.albedo"
        if name not in offsets:
            continue
        factor = (means[part] + offsets[name]) / means[part]
        for obj in objects:
            for slot in obj.material_slots:
                colour = None if slot.material is None else nodes.diffuse(slot.material)
                if colour is None:
                    raise NlosError(
                        f"{file_name()}: {name} cannot be corrected, since {obj.name!r} is not plainly Lambertian; "
                        "change it by hand"
                    )
                material = bpy.data.materials.new(slot.material.name)
                materials.make_lambertian(material, [min(1.0, factor * channel) for channel in colour])
                slot.link = "OBJECT"  # other objects may share the mesh
                slot.material = material


def _brighten(scene: bpy.types.Scene, factor: float) -> None:
    """Multiply the sky's light."""
    for owner, attribute in materials.worlds_of(scene) if factor != 1.0 else ():
        world = getattr(owner, attribute)
        for node in world.node_tree.nodes if world.node_tree else ():
            if node.type == "BACKGROUND" and not node.inputs["Strength"].is_linked:
                node.inputs["Strength"].default_value *= factor


def _unlike(wanted: World, got: World) -> str:
    """Return the name of the first part of two worlds that differs by more than rounding; empty if none does."""
    for part in ("patch", "watched", "target", "room", "wall", "ambient", "emitters"):
        one, other = (_arrays(getattr(world, part), part) for world in (wanted, got))
        if len(one) != len(other):
            return part
        for a, b in zip(one, other, strict=True):
            size = max(float(np.abs(a).max(initial=0.0)), 1e-3 if part in ("patch", "watched") else 0.0)
            if a.shape != b.shape or np.abs(a - b).max(initial=0.0) > _ROUNDING * size:
                return {"patch": "lamp", "watched": "camera's view"}.get(part, part)
    return ""


def _arrays(value: Any, name: str) -> list[Array]:
    """Return all numbers inside nested dataclasses and tuples; of a camera, where it looks and from where."""
    if value is None:
        return []
    if name == "watched":
        return [value.points(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])), value.albedo]
    if is_dataclass(value):
        return [one for f in fields(value) for one in _arrays(getattr(value, f.name), f.name)]
    if isinstance(value, tuple):
        return [one for item in value for one in _arrays(item, name)]
    return [np.asarray(value, dtype=np.float64)]
