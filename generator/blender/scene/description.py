"""Reads a Blender scene back into its description, a `generator.model.scene.Scene`."""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from generator.blender.scene import relay
from generator.blender.scene.geometry import Snapshot, box_of, hull, shape_pictures, snapshot, view
from generator.blender.scene.materials import albedo, ambient, mean_albedo, only_diffuse, reflection
from generator.blender.scene.quiet import Overrides
from generator.blender.scene.roles import (
    KIND,
    PRESET,
    SINGLE_ROLES,
    SURFACE,
    find,
    players,
    read_grid,
    reflection_order,
    target_file,
)
from generator.blender.scene.words import file_name, range_of, short, vector
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.scene import ROOM_SURFACES, Camera, Partition, Room, Scene, Spot, Target, Wall


def read_scene(scene: bpy.types.Scene, resolution: tuple[int, int] | None = None) -> Scene:
    """Read the description back out of a scene, as it was edited and as a render sees it.

    Parameters
    ----------
    scene : bpy.types.Scene
    resolution : (int, int), optional
        Width and height of the pictures, on which the camera's view depends; the scene's own if not given.

    Raises
    ------
    NlosError
        A role is missing or played twice, the voxel grid is missing, the relay plane is not the plane y = 0, or the
        spot lamp or the camera does not point at it.
    """
    with Overrides() as overrides:
        return _read(scene, shape_pictures(scene, resolution, overrides))


def _read(scene: bpy.types.Scene, size: tuple[int, int]) -> Scene:
    wall, lamp, camera, target = (find(scene, role) for role in SINGLE_ROLES)
    seen = snapshot(scene)
    plane = relay.find(scene, seen)
    if not plane.in_frame:
        raise NlosError(
            f"{file_name()}: the relay wall {wall.name!r}, where the spot lights it, must lie in the plane y = 0"
        )
    relay.refuse_hidden_from_lamp(scene, seen)
    relay.refuse_unwatched(scene, seen, plane)
    low, high = (limit(plane.corners.reshape(-1, 3), axis=0) for limit in (np.min, np.max))
    paint = np.concatenate([np.array(shape.materials, dtype=object)[shape.slots] for shape in seen.of([wall])])
    colour = only_diffuse(paint[plane.faces])
    room, screens = players(scene, "room"), players(scene, "partition")
    kind, stated = target.get(KIND, "mesh"), target_file(scene)
    return Scene(
        preset=str(scene.get(PRESET, "custom")),
        wall=Wall(x=range_of(low, high, 0), z=range_of(low, high, 2), albedo=mean_albedo(colour)),
        room=_read_room(scene, room, seen) if room else None,
        partition=_read_partition(scene, screens, seen) if screens else None,
        spot=read_spot(lamp, seen.matrices["spot"]),
        camera=_read_camera(scene, camera, seen.matrices["camera"]),
        grid=read_grid(scene),
        target=Target(
            kind=kind if kind in ("sheet", "sphere") else "mesh",
            size=short(max(np.ptp(hull(scene, seen), axis=0))),
            **{name: stated[name] for name in ("unit", "up") if kind == "mesh" and name in stated},
            **reflection(target),
        ),
        ambient=ambient(scene),
        reflection_order=reflection_order(scene),
        resolution=size,
    )


def _read_room(scene: bpy.types.Scene, surfaces: list[bpy.types.Object], seen: Snapshot) -> Room:
    low, high = box_of(scene, surfaces, seen)
    names = {str(o.get(SURFACE)) for o in surfaces}
    return Room(
        x=range_of(low, high, 0),
        y=range_of(low, high, 1),
        z=range_of(low, high, 2),
        albedo=albedo(surfaces[0]) if len({albedo(o) for o in surfaces}) == 1 else None,
        surfaces=tuple(s for s in ROOM_SURFACES if s in names),
    )


def _read_partition(scene: bpy.types.Scene, screens: list[bpy.types.Object], seen: Snapshot) -> Partition:
    low, high = box_of(scene, screens, seen)
    x = range_of(low, high, 0)
    return Partition(
        x=x[0],
        depth=short(x[1] - x[0]),
        y=range_of(low, high, 1),
        z=range_of(low, high, 2),
        albedo=albedo(screens[0]),
    )


def lamp_power(light: Any) -> float:
    """Return a lamp's power in watts, multiplied by its exposure and by the mean of its colour channels."""
    mean = sum(light.color) / 3.0
    return float(light.energy * 2.0 ** getattr(light, "exposure", 0.0) * mean)


def read_spot(lamp: bpy.types.Object, place: Array) -> Spot:
    """Return a spot lamp, placed by a transform (4, 4); raise NlosError if it does not point at the plane y = 0."""
    if lamp.type != "LIGHT" or lamp.data.type != "SPOT":
        raise NlosError(f"{file_name()}: the spot {lamp.name!r} must be a spot lamp")
    matrix = Matrix(place.tolist())
    origin, axis = matrix.translation, -matrix.to_3x3().col[2].normalized()
    if axis.y >= -1e-9 or origin.y <= 0.0:
        raise NlosError(f"{file_name()}: the spot {lamp.name!r} does not point at the relay wall (the plane y = 0)")
    aim = origin - axis * (origin.y / axis.y)
    return Spot(
        location=vector(origin),
        aim=vector(aim),
        half_angle=short(math.degrees(lamp.data.spot_size) / 2.0),
        power=lamp_power(lamp.data),
    )


def _read_camera(scene: bpy.types.Scene, camera: bpy.types.Object, place: Array) -> Camera:
    _, points = view(scene, camera, place)
    low, high = points.min(axis=0), points.max(axis=0)
    return Camera(
        location=vector(place[:3, 3]),
        x=range_of(low, high, 0),
        z=range_of(low, high, 2),
        projection="orthographic" if camera.data.type == "ORTHO" else "perspective",
    )
