"""Copies of the target, for scenes with several hidden objects."""

from __future__ import annotations

import math

import bpy
import mathutils
from mathutils import Euler, Matrix

from generator.blender.scene import posing, roles
from generator.model.arrays import Vector
from generator.model.poses import PoseRecord


class Copies:
    """The hidden objects of an open scene: its target, and copies that are the target's children.

    As its children they are hidden with it, and every engine takes them for parts of it.

    Parameters
    ----------
    scene : bpy.types.Scene
    count : int
        Number of objects in all; with 1, the scene is left as it is.
    """

    def __init__(self, scene: bpy.types.Scene, count: int) -> None:
        self._scene, self._target = scene, roles.find(scene, "target")
        parts = roles.target_parts(scene)
        self._copies = [self._copied(parts) for _ in range(count - 1)]

    def _copied(self, parts: list[bpy.types.Object]) -> bpy.types.Object:
        """Return a copy of the target, whose parts are copied too and are its children."""
        new = [part.copy() for part in parts]
        placed = self._target.matrix_world.inverted()
        for part, copy in zip(parts, new, strict=True):
            copy.pop(roles.ROLE, None)
            copy.parent = self._target if copy is new[0] else new[0]
            copy.matrix_parent_inverse = Matrix.Identity(4) if copy is new[0] else placed @ part.matrix_world
            copy.matrix_basis = Matrix.Identity(4)
            self._scene.collection.objects.link(copy)
        return new[0]

    def place(self, pose: PoseRecord) -> None:
        """Put the target and its copies at the places of a pose."""
        if not self._copies:
            return
        posing.move_target(self._scene, pose.position, pose.rotation)
        to_target = _frame(pose.position, pose.rotation).inverted()
        scale = Matrix.Diagonal(
            (*(s * d for s, d in zip(self._target.scale, self._target.delta_scale, strict=True)), 1)
        )
        for copy, other in zip(self._copies, pose.others, strict=True):
            # An inverse may hold any matrix, while scale, rotation and place hold no shear.
            copy.matrix_parent_inverse = scale.inverted() @ to_target @ _frame(other.position, other.rotation) @ scale
        bpy.context.view_layer.update()


def _frame(position: Vector, rotation: Vector) -> Matrix:
    turn = Euler([math.radians(angle) for angle in rotation], "XYZ")
    return Matrix.LocRotScale(mathutils.Vector(position), turn, None)
