"""Prepares a scene that was not built for a sweep so that it can be swept: roles, metres, frame, voxels."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import bpy
import mathutils
import numpy as np
from mathutils import Matrix

from generator.blender.scene import free_box, geometry, relay, roles
from generator.blender.scene.words import numbers, vector
from generator.model.arrays import Array, Vector
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid

ROLES = (*roles.SINGLE_ROLES, "room", "partition")

_ROOMY = 1.25
"""A voxel's edge in units of the target's largest diameter, so that it can turn inside and move a little."""

_LEAST = 0.25
"""Edge of the smallest box in which voxels are laid, in units of the target's largest diameter."""

_SLACK = 1e-6

_STRAY = 1e-4
"""Distance from where it should be, in units of the scene's size, and angle, radians, at which an object is held."""

_FIGURES = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")

_LEFT_OVER = 0.02
"""Distance of fitted voxels from the relay wall, in units of the height of the hidden volume."""


def assign(scene: bpy.types.Scene, role: str, objects: Sequence[bpy.types.Object]) -> None:
    """Give objects a role. Any role but room and partition has one object, and is taken from the former one.

    Parameters
    ----------
    scene : bpy.types.Scene
    role : str
        One of `ROLES`; an empty string removes the objects' roles.
    objects : sequence of bpy.types.Object

    Raises
    ------
    NlosError
        The role is unknown, no object or too many are given, or one is not of the type that the role needs.
    """
    if role not in ("", *ROLES):
        raise NlosError(f"role {role!r}: there is none; choose from {', '.join(ROLES)}")
    if not objects:
        raise NlosError("no object is selected; select the one that is meant")
    label = role.replace("_", " ")
    if role in roles.SINGLE_ROLES and len(objects) > 1:
        raise NlosError(f"{len(objects)} objects are selected; exactly one can be the {label}")
    for obj in objects:
        if _is_linked(obj):
            raise NlosError(f"{obj.name!r} is linked from another file; make it local first (Object > Relations)")
        if role == "spot" and (obj.type != "LIGHT" or obj.data.type != "SPOT"):
            raise NlosError(
                f"{obj.name!r} cannot be the spot: it is no spot lamp; make it one (lamp's data > Type > Spot)"
            )
        if role == "camera" and obj.type != "CAMERA":
            raise NlosError(f"{obj.name!r} cannot be the camera: it is none")
        parts = [obj, *obj.children_recursive] if role == "target" else [obj]
        if role not in ("", "spot", "camera") and not geometry.has_surface(parts):
            raise NlosError(f"{obj.name!r} cannot be the {label}: it has no surface")
    if role in roles.SINGLE_ROLES:
        _release(former for former in roles.players(scene, role) if former not in objects)
    for obj in objects:
        if role:
            obj[roles.ROLE] = role
        elif roles.ROLE in obj:
            del obj[roles.ROLE]
    if role == "camera":
        scene.camera = objects[0]
    bpy.context.view_layer.update()


def keep(scene: bpy.types.Scene, name: str) -> None:
    """Let one of several objects that play a role of one object keep it, and take it from the others.

    Parameters
    ----------
    scene : bpy.types.Scene
    name : str
        Full name of the object, as `roles.named` takes it.

    Raises
    ------
    NlosError
        The object plays no such role, or another one that does is linked from a file.
    """
    obj = roles.named(scene, name)
    role = obj.get(roles.ROLE) if obj is not None else None
    if obj is None or role not in roles.SINGLE_ROLES:
        choices = [o.name_full for objects in roles.twice(scene).values() for o in objects]
        if not choices:
            raise NlosError(f"object {name!r}: keeps no role, for none is played twice")
        listed = ", ".join(map(repr, choices))
        raise NlosError(f"object {name!r}: keeps no role; choose from {listed}" if name else f"choose from {listed}")
    _release(other for other in roles.players(scene, role) if other != obj)
    if role == "camera":
        scene.camera = obj


def _is_linked(obj: bpy.types.Object) -> bool:
    return bool(obj.library or obj.override_library)


def _release(objects: Iterable[bpy.types.Object]) -> None:
    """Take the role from objects; raise NlosError before any is changed if one is linked."""
    objects = list(objects)
    for obj in objects:
        if _is_linked(obj):  # Blender would let it be changed, and forget that when the file is saved
            label = obj[roles.ROLE].replace("_", " ")
            library = obj.library or obj.override_library.reference.library
            raise NlosError(
                f"{obj.name_full!r} is the {label} too, and what is linked from another file ({library.filepath}) "
                "keeps its role; keep that one, or make it local first (Object > Relations > Make Local)"
            )
    for obj in objects:
        del obj[roles.ROLE]


def in_metres(scene: bpy.types.Scene) -> bool:
    """Whether one Blender unit is a metre, the unit of light, poses and voxels."""
    return scene.unit_settings.system == "NONE" or math.isclose(scene.unit_settings.scale_length, 1.0, rel_tol=1e-6)


def to_metres(scene: bpy.types.Scene) -> None:
    """Make one Blender unit a metre; everything keeps the size that Blender displays, and watts keep their meaning.

    Blender computes a lamp's light with lengths in its units: unless these are metres, it is off by their square.
    """
    factor = scene.unit_settings.scale_length
    _transform(scene, Matrix.Diagonal((factor, factor, factor, 1.0)))
    scene.unit_settings.scale_length = 1.0
    for data in {o.data for o in scene.objects if o.type in ("LIGHT", "CAMERA") and o.data}:
        for name in ("shadow_soft_size", "size", "size_y", "ortho_scale", "clip_start", "clip_end"):
            if hasattr(data, name):
                setattr(data, name, getattr(data, name) * factor)
        if hasattr(data, "dof"):
            data.dof.focus_distance *= factor


def is_aligned(scene: bpy.types.Scene) -> bool:
    """Whether the relay plane is the plane y = 0; False too where there is none, or where units are no metres."""
    try:
        return in_metres(scene) and relay.find(scene, geometry.snapshot(scene)).in_frame
    except NlosError:
        return False


def align(scene: bpy.types.Scene) -> None:
    """Turn and move the whole scene so that the relay plane (`relay.find`) is the plane y = 0, and the lamp at y > 0.

    Heights do not change if the wall is upright.

    Raises
    ------
    NlosError
        There is not exactly one relay wall and one spot, the lamp's axis does not meet the wall, or something holds
        an object in its place.
    """
    plane = relay.find(scene, geometry.snapshot(scene))
    normal, centre = plane.normal, plane.point
    up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
    z = up - (up @ normal) * normal
    z /= np.linalg.norm(z)
    turn = np.stack([np.cross(normal, z), normal, z])
    transform = np.eye(4)
    transform[:3, :3] = turn
    transform[:3, 3] = np.array([0.0, 0.0, centre[2]]) - turn @ centre
    _transform(scene, Matrix(transform.tolist()))


def fit_grid(scene: bpy.types.Scene, shape: tuple[int, int, int] = (3, 3, 1)) -> VoxelGrid:
    """Lay voxels around the target, each large enough for it to turn inside, and store them in the scene.

    They keep within walls, off all objects, out of the lamp's cone and the camera's view, and in their shadow if the
    target is. Where there is no room for so many, there are fewer along that axis.

    Parameters
    ----------
    scene : bpy.types.Scene
    shape : (int, int, int)
        Most voxels along each axis.

    Raises
    ------
    NlosError
        There is not exactly one target, or it has no surface.
    """
    seen = geometry.snapshot(scene)
    hull = geometry.hull(scene, seen)
    diameter = max(1e-6, 2.0 * float(np.linalg.norm(hull, axis=1).max()))
    place = seen.matrices["target"][:3, 3]
    low, high = geometry.box_of(scene, roles.target_parts(scene), seen)
    size = _ROOMY * diameter * np.array(shape)
    least = np.full(3, _LEAST * diameter)
    found = (free_box.free_box(scene, seen, around, least, size) for around in (place, (low + high) / 2.0))
    lo, hi = next((box for box in found if box is not None), (place - size / 2.0, place + size / 2.0))
    lo[1] = max(lo[1], _LEFT_OVER * size[2])
    counts = np.clip(np.floor((hi - lo) / (_ROOMY * diameter) + _SLACK), 1, shape).astype(int)
    grid = VoxelGrid(lo=_rounded(lo), hi=_rounded(hi), shape=(int(counts[0]), int(counts[1]), int(counts[2])))
    roles.write_grid(scene, grid)
    return grid


def _rounded(values: Array) -> Vector:
    x, y, z = (round(float(v), 4) for v in values)
    return (x, y, z)


def _transform(scene: bpy.types.Scene, change: Matrix) -> None:
    """Apply a transform of the world to every object and to the voxels; lamps and cameras keep their scale.

    Constraints and animation may hold an object, or may not, as one that turns a lamp to an object: a render tells.
    """
    bpy.context.view_layer.update()
    roots = [o for o in scene.objects if o.parent is None or o.parent.name not in scene.objects]
    for obj in roots:
        if obj.library is not None:
            raise NlosError(
                f"{obj.name!r} is linked from another file, so it cannot be put elsewhere; nothing was changed"
            )
    places = _places(scene)
    figures = [(o, name, _copied(getattr(o, name))) for o in roots for name in _FIGURES]
    _put(roots, change)
    if held := _elsewhere(places, _places(scene), np.array(change, dtype=np.float64)):
        for obj, name, value in figures:
            setattr(obj, name, value)
        bpy.context.view_layer.update()
        raise NlosError(
            f"{held!r} is held by constraints, drivers or animation, so it cannot be put elsewhere; nothing was "
            "changed"
        )
    if all(key in scene for key in (roles.GRID_LO, roles.GRID_HI, roles.GRID_SHAPE)):
        lo, hi = scene[roles.GRID_LO], scene[roles.GRID_HI]
        corners = np.array(
            [
                change @ mathutils.Vector((x, y, z))
                for x in (lo[0], hi[0])
                for y in (lo[1], hi[1])
                for z in (lo[2], hi[2])
            ],
            dtype=np.float64,
        )
        scene[roles.GRID_LO], scene[roles.GRID_HI] = (
            vector(corners.min(axis=0)),
            vector(corners.max(axis=0)),
        )


def _put(roots: Sequence[bpy.types.Object], change: Matrix) -> None:
    """Apply a transform of the world to objects."""
    for obj in roots:
        # The object's own matrix: Blender does not update the world matrix of what no view layer shows.
        before = obj.matrix_basis.copy() if obj.parent is None else obj.matrix_world.copy()
        placed = change @ before
        if obj.type in ("LIGHT", "CAMERA") and not obj.children:
            place, turn, _ = placed.decompose()
            placed = Matrix.LocRotScale(place, turn, before.to_scale())
        if obj.parent is None:
            obj.matrix_basis = placed
        else:
            obj.matrix_world = placed
    bpy.context.view_layer.update()


def _copied(value: Any) -> Any:
    """Return a figure of an object, and not a view of it that would change with the object."""
    return value.copy() if hasattr(value, "copy") else tuple(value)


def _places(scene: bpy.types.Scene) -> list[tuple[str, Array, Array]]:
    """Return name, points (n, 3) and directions (m, 3) of all that a render sees, in its order."""

    def look(depsgraph: Any) -> list[tuple[str, Array, Array]]:
        places = []
        for instance in depsgraph.object_instances:
            obj, matrix = instance.object, numbers(instance.matrix_world)
            name = (instance.parent if instance.is_instance else obj).original.name
            points, ways = matrix[None, :3, 3], np.zeros((0, 3))
            if obj.type in ("LIGHT", "CAMERA"):
                ways = matrix[:3, 1:3].T  # up, and against the view
            elif isinstance(obj.data, bpy.types.Mesh):
                points = np.array(obj.bound_box, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
            places.append((name, points, ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-30)))
        return places

    return geometry.as_rendered(scene, look)


def _elsewhere(before: list[tuple[str, Array, Array]], after: list[tuple[str, Array, Array]], change: Array) -> str:
    """Return the name of what a transform (4, 4) of the world has not taken along; empty if there is nothing."""
    size = float(np.abs(np.concatenate([points for _, points, _ in after])).max())
    turn = change[:3, :3] / np.linalg.norm(change[:3, 0])
    for (name, points, ways), (new_name, new_points, new_ways) in itertools.zip_longest(
        before, after, fillvalue=("", np.zeros((0, 3)), np.zeros((0, 3)))
    ):
        moved = points @ change[:3, :3].T + change[:3, 3]
        if not (
            (name, points.shape) == (new_name, new_points.shape)
            and np.allclose(new_points, moved, rtol=0.0, atol=_STRAY * size)
            and np.allclose(new_ways, ways @ turn.T, rtol=0.0, atol=_STRAY)
        ):
            return name or new_name
    return ""
