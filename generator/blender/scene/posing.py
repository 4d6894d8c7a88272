"""Moves the target to a pose, checks that nothing else in the file holds it, and restores it afterwards."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator

import bpy
import mathutils
import numpy as np
from mathutils import Euler, Matrix, Quaternion

from generator.blender.scene.build import add_part, build_target
from generator.blender.scene.geometry import snapshot
from generator.blender.scene.quiet import Overrides
from generator.blender.scene.roles import ROLE, find, target_parts
from generator.blender.scene.words import file_name, numbers
from generator.model.arrays import Vector
from generator.model.errors import NlosError
from generator.model.scene import Target

_SHEAR = 1e-5
"""A frame counts as sheared if it differs by more than this from an unsheared one, in units of its scale."""


def move_target(scene: bpy.types.Scene, position: Vector, rotation: Vector) -> None:
    """Place the target's origin at a position, rotated about x, then y, then z.

    Parameters
    ----------
    position : (float, float, float)
        Metres.
    rotation : (float, float, float)
        Degrees.

    Raises
    ------
    NlosError
        Something else holds the target in place: a constraint, a driver, an animation.
    """
    target = find(scene, "target")
    if target.parent is not None:
        cut_loose(scene, target)
    # Not by the matrix: its scale, read back and set again, would drift by a rounding error with every pose, and
    # the pixels would depend on earlier poses.
    turn = Euler([math.radians(a) for a in rotation], "XYZ")
    target.rotation_mode = "XYZ"
    target.delta_location, target.delta_rotation_euler = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    target.location, target.rotation_euler = position, turn
    bpy.context.view_layer.update()
    if not target.visible_get():
        return  # not evaluated in the viewport; a sweep checks the rendered pose beforehand (`engines.survey`)
    expected = Matrix.LocRotScale(
        mathutils.Vector(position), turn, mathutils.Vector(target.scale) * mathutils.Vector(target.delta_scale)
    )
    actual = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world
    tolerance = 1e-5 * (1.0 + max(map(abs, position)))
    if any(abs(a - b) > tolerance for r, s in zip(expected, actual, strict=True) for a, b in zip(r, s, strict=True)):
        raise NlosError(f"{file_name()}: {held(target)}")


def held(target: bpy.types.Object) -> str:
    """Return a sentence that says that the target cannot be moved, and what holds it."""
    animation, name = target.animation_data, f"the target {target.name!r}"
    holders = [f"the constraint {c.name!r}" for c in target.constraints if c.enabled and not c.mute]
    if animation and animation.action:
        holders.append(f"the animation {animation.action.name!r}")
    if animation and any(track.strips and not track.mute for track in animation.nla_tracks):
        holders.append("its NLA strips")
    if animation and animation.drivers:
        holders.append("its drivers")
    if target.rigid_body:
        holders.append("its rigid body simulation")
    if not holders:
        return f"{name} does not go where it is put: something holds it"
    several = len(holders) > 1 or holders[0].endswith("s")
    return f"{name} does not go where it is put, because {' and '.join(holders)} {'hold' if several else 'holds'} it"


def cut_loose(scene: bpy.types.Scene, target: bpy.types.Object) -> None:
    """Remove the target's parent, and keep the size that the parents give it.

    Raises
    ------
    NlosError
        The parents shear it.
    """
    matrix = Matrix(snapshot(scene).matrices["target"].tolist())
    scale = matrix.to_scale()
    unsheared = Matrix.LocRotScale(*matrix.decompose())
    if np.abs(numbers(unsheared) - numbers(matrix))[:3, :3].max() > _SHEAR * max(map(abs, scale)):
        raise NlosError(
            f"{file_name()}: the target {target.name!r} is sheared by its parents' scale, which no pose can hold; "
            "apply that scale (Object > Apply > Scale), or make it visual geometry"
        )
    target.parent = None
    target.scale = [s / d for s, d in zip(scale, target.delta_scale, strict=True)]


@contextlib.contextmanager
def put_back(scene: bpy.types.Scene) -> Iterator[None]:
    """Restore the target's parent and pose when the context is left."""
    target = find(scene, "target")
    # The order matters: setting the parent changes values that were set before it.
    names = [
        *("parent", "parent_type", "parent_bone", "matrix_parent_inverse", "rotation_mode", "location"),
        *("rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale"),
        *("delta_location", "delta_rotation_euler"),
    ]
    before = {name: getattr(target, name) for name in names}
    for name, value in before.items():
        if isinstance(value, mathutils.Vector | Euler | Quaternion | Matrix):
            before[name] = value.copy()  # otherwise a view of a value that will change
    before["rotation_axis_angle"] = tuple(target.rotation_axis_angle)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(target, name, value)
        bpy.context.view_layer.update()


@contextlib.contextmanager
def stand_in(scene: bpy.types.Scene, wanted: Target) -> Iterator[None]:
    """Replace the target by another object, unrotated, until the context is left."""
    parts = target_parts(scene)
    substitute = build_target(wanted)
    substitute.location = parts[0].matrix_world.translation
    with Overrides() as overrides:
        for part in parts:
            overrides.set(part, "hide_render", True)
        del parts[0][ROLE]
        add_part(scene.collection, substitute, "target")
        try:
            bpy.context.view_layer.update()
            yield
        finally:
            data, materials = substitute.data, list(substitute.data.materials)
            bpy.data.batch_remove([substitute, data, *materials])
            parts[0][ROLE] = "target"
    bpy.context.view_layer.update()
