"""Prepares a scene that was not built for a sweep so that it can be swept: roles, metres, frame, voxels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import bpy
import mathutils
import numpy as np
from mathutils import Matrix

from generator.blender.scene import geometry, roles
from generator.blender.scene.words import numbers, vector
from generator.model.arrays import Array, Vector
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid

ROLES = (*roles.SINGLE_ROLES, "room", "partition")

_ROOMY = 1.25
"""A voxel's edge in units of the target's largest diameter, so that it can turn inside and move a little."""

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
            raise NlosError(f"{obj.name!r} cannot be the spot: it is no spot lamp")
        if role == "camera" and obj.type != "CAMERA":
            raise NlosError(f"{obj.name!r} cannot be the camera: it is none")
        parts = [obj, *obj.children_recursive] if role == "target" else [obj]
        if role not in ("", "spot", "camera") and not any(len(geometry.evaluated_vertices(o)) for o in parts):
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
        raise NlosError(
            f"object {name!r}: keeps no role; "
            + (f"choose from {', '.join(map(repr, choices))}" if choices else "none is played twice")
        )
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


def align(scene: bpy.types.Scene) -> None:
    """Turn and move the whole scene so that the relay wall lies in the plane y = 0 and faces +y.

    Heights do not change if the wall is upright.

    Raises
    ------
    NlosError
        There is not exactly one relay wall and one spot, or the wall is not flat.
    """
    wall, lamp = roles.find(scene, "relay_wall"), roles.find(scene, "spot")
    normal, centre = _plane(wall)
    if normal @ (numbers(lamp.matrix_world.translation) - centre) < 0.0:
        normal = -normal
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

    Raises
    ------
    NlosError
        There is not exactly one target, or it has no surface.
    """
    seen = geometry.snapshot(scene)
    hull = geometry.hull(scene, seen)
    edge = _ROOMY * max(1e-6, 2.0 * float(np.linalg.norm(hull, axis=1).max()))
    size = edge * np.array(shape)
    lo = seen.matrices["target"][:3, 3] - size / 2.0
    lo[1] = max(lo[1], _LEFT_OVER * size[2])
    grid = VoxelGrid(lo=_rounded(lo), hi=_rounded(lo + size), shape=shape)
    roles.write_grid(scene, grid)
    return grid


def _rounded(values: Array) -> Vector:
    x, y, z = (round(float(v), 4) for v in values)
    return (x, y, z)


def _plane(wall: bpy.types.Object) -> tuple[Array, Array]:
    """Unit normal and centre of a wall in the world."""
    points = geometry.placed_vertices(wall)
    if len(points) < 3:
        raise NlosError(f"the relay wall {wall.name!r} has no surface")
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    offsets = points - points.mean(axis=0)
    _, spread, axes = np.linalg.svd(offsets, full_matrices=False)
    if spread[2] > 1e-4 * spread[0] or spread[1] <= 1e-6 * spread[0]:
        raise NlosError(f"the relay wall {wall.name!r} is not flat; use a flat object, or a part of it as its own")
    normal: Array = axes[2]
    # Projected onto the plane: the centre of a slanted wall's bounding box may lie off it.
    return normal, centre - ((centre - points.mean(axis=0)) @ normal) * normal


def _transform(scene: bpy.types.Scene, change: Matrix) -> None:
    """Apply a transform of the world to every object and to the voxels; lamps and cameras keep their scale."""
    bpy.context.view_layer.update()
    roots = [o for o in scene.objects if o.parent is None or o.parent.name not in scene.objects]
    for obj in roots:
        animated = obj.animation_data is not None and (obj.animation_data.action or obj.animation_data.drivers)
        if obj.constraints or animated or obj.library is not None:
            reason = "is linked from another file" if obj.library else "is held by constraints, drivers or animation"
            raise NlosError(f"{obj.name!r} {reason}, so it cannot be put elsewhere; nothing was changed")
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
    bpy.context.view_layer.update()
