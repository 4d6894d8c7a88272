"""Drags a face of the voxel grid."""

# mypy: disable-error-code="valid-type,misc"

from __future__ import annotations

from dataclasses import replace
from typing import Any

import bpy
from bpy.props import EnumProperty, FloatProperty
from bpy_extras import view3d_utils
from mathutils import Vector

from generator.blender.scene import roles
from generator.blender.scene.words import vector
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid

from ..view import overlay
from . import base

_THINNEST = 1e-3
"""Least distance of two opposite faces, metres."""
_DIGITS = 4
_STEP = 0.05
_PRECISE = 0.1
_ENDWISE = 0.998
"""Cosine of the angle between the view and the axis above which the mouse cannot tell how far to go."""


def moved(grid: VoxelGrid, axis: int, side: int, value: float) -> VoxelGrid:
    """Return a grid of which one face is elsewhere along its axis, but not beyond the opposite one.

    Parameters
    ----------
    grid : VoxelGrid
    axis : int
    side : int
        0 for the face with the smaller coordinate, 1 for the other.
    value : float
        Metres.
    """
    low, high = list(grid.lo), list(grid.hi)
    if side:
        high[axis] = round(max(value, low[axis] + _THINNEST), _DIGITS)
    else:
        low[axis] = round(min(value, high[axis] - _THINNEST), _DIGITS)
    return replace(grid, lo=vector(low), hi=vector(high))


class NLOS_OT_drag_face(bpy.types.Operator):
    """Drag a face of the hidden volume. Ctrl snaps to 5 cm, Shift moves finely"""

    bl_idname = "nlos.drag_face"
    bl_label = "Drag Voxel Grid"
    bl_options = {"REGISTER", "UNDO", "BLOCKING"}  # noqa: RUF012

    axis: EnumProperty(name="Axis", items=[(name, name, "") for name in "XYZ"], options={"SKIP_SAVE"})
    side: EnumProperty(name="Face", items=(("LOW", "Low", "The smaller coordinate"), ("HIGH", "High", "The larger")))
    by: FloatProperty(name="By", description="How far the face goes", subtype="DISTANCE", unit="LENGTH", precision=3)

    @classmethod
    def poll(cls: Any, context: Any) -> bool:
        """Return whether the scene has a voxel grid."""
        cls.poll_message_set("The scene has no voxels: build it, or press Fit Voxels")
        return roles.GRID_SHAPE in context.scene

    def execute(self: Any, context: Any) -> set[str]:
        """Move the face by a distance."""
        try:
            self._put(context.scene, roles.read_grid(context.scene))
        except NlosError as error:
            return base.refused(self, error)
        return {"FINISHED"}

    def invoke(self: Any, context: Any, event: Any) -> set[str]:
        """Begin a drag at the mouse."""
        try:
            self._before = roles.read_grid(context.scene)
        except NlosError as error:
            return base.refused(self, error)
        settings = context.scene.nlos
        self._drafted = tuple(settings.grid_lo), tuple(settings.grid_hi)
        self.by, self._exact, self._last = 0.0, 0.0, self._along(context, event)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self: Any, context: Any, event: Any) -> set[str]:
        """Follow the mouse until its button is released; Esc and the right button take it back."""
        if event.type in ("ESC", "RIGHTMOUSE"):
            roles.write_grid(context.scene, self._before)
            context.scene.nlos.grid_lo, context.scene.nlos.grid_hi = self._drafted
            self._tell(context, None)
            return {"CANCELLED"}
        if event.type == "MOUSEMOVE":
            now = self._along(context, event)
            if now is not None and self._last is not None:
                self._exact += (now - self._last) * (_PRECISE if event.shift else 1.0)
            self._last = now
            self.by = self._exact
            if event.ctrl:
                start = self._face(self._before)
                self.by = round((start + self._exact) / _STEP) * _STEP - start
            self._put(context.scene, self._before)
            grid = roles.read_grid(context.scene)
            self._tell(context, f"{self.axis} of the face: {self._face(grid):.3f} m")
        if event.type == "LEFTMOUSE" and event.value == "RELEASE":
            self._tell(context, None)
            return {"FINISHED"} if self.by else {"CANCELLED"}
        return {"RUNNING_MODAL"}

    def _number(self: Any) -> tuple[int, int]:
        return "XYZ".index(self.axis), ("LOW", "HIGH").index(self.side)

    def _face(self: Any, grid: VoxelGrid) -> float:
        axis, side = self._number()
        return float((grid.lo, grid.hi)[side][axis])

    def _put(self: Any, scene: Any, before: VoxelGrid) -> None:
        """Write the grid that the drag has come to into the scene, and its corners into the panel."""
        axis, side = self._number()
        grid = moved(before, axis, side, self._face(before) + self.by)
        roles.write_grid(scene, grid)
        scene.nlos.grid_lo, scene.nlos.grid_hi = grid.lo, grid.hi
        overlay.changed()

    def _along(self: Any, context: Any, event: Any) -> float | None:
        """Return where the mouse is along the face's axis, metres; None where the view looks along it."""
        region, view = context.region, context.region_data
        mouse = (event.mouse_region_x, event.mouse_region_y)
        axis, _ = self._number()
        through = Vector([(a + b) / 2.0 for a, b in zip(self._before.lo, self._before.hi, strict=True)])
        origin = view3d_utils.region_2d_to_origin_3d(region, view, mouse)
        ray = view3d_utils.region_2d_to_vector_3d(region, view, mouse)
        across = ray[axis]
        if abs(across) > _ENDWISE:
            return None
        # The point of the axis that is nearest to the ray: both are unit vectors.
        gap = origin - through
        return float((gap[axis] - across * gap.dot(ray)) / (1.0 - across * across))

    def _tell(self: Any, context: Any, words: str | None) -> None:
        context.area.header_text_set(words)
        overlay.changed()


register, unregister = bpy.utils.register_classes_factory((NLOS_OT_drag_face,))
