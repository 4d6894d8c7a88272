"""Arrows on the faces of the voxel grid, while they are asked for: a drag moves the face.

They take clicks that are meant for what stands behind them, so they are not there otherwise.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

from typing import Any

import bpy
from mathutils import Matrix, Vector

from generator.blender.scene import roles

_COLOURS = ((1.0, 0.25, 0.3), (0.55, 0.85, 0.1), (0.25, 0.55, 1.0))
_OUTWARD = tuple((axis, side) for axis in range(3) for side in (0, 1))
"""The faces: axis, and 0 for the one with the smaller coordinate, 1 for the other."""


class NLOS_GGT_grid(bpy.types.GizmoGroup):
    """Arrows on the six faces of the voxel grid."""

    bl_label = "NLOS Voxel Grid"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"3D", "PERSISTENT"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Return whether the arrows are asked for, and the overlay shows voxels."""
        session = context.window_manager.nlos
        return bool(
            session.show_handles and session.overlay and session.show_voxels and roles.GRID_SHAPE in context.scene
        )

    def setup(self, context: Any) -> None:
        """Make the arrows."""
        for axis, side in _OUTWARD:
            arrow = self.gizmos.new("GIZMO_GT_arrow_3d")
            operator = arrow.target_set_operator("nlos.drag_face")
            operator.axis, operator.side = "XYZ"[axis], ("LOW", "HIGH")[side]
            arrow.use_draw_modal = False  # it would run ahead: Blender moves it too, and knows no limit and no snap
            arrow.color = _COLOURS[axis]
            arrow.color_highlight = (1.0, 1.0, 1.0)
            arrow.alpha, arrow.alpha_highlight = 0.8, 1.0
            arrow.scale_basis = 0.8
            arrow.line_width = 3.0

    def draw_prepare(self, context: Any) -> None:
        """Put the arrows where the faces are now."""
        scene = context.scene
        try:
            low, high = Vector(scene[roles.GRID_LO]), Vector(scene[roles.GRID_HI])
        except (KeyError, TypeError, ValueError):  # somebody has edited the custom properties; Check tells
            return
        for arrow, (axis, side) in zip(self.gizmos, _OUTWARD, strict=True):
            place, outward = (low + high) / 2.0, Vector()
            place[axis] = (low, high)[side][axis]
            outward[axis] = (-1.0, 1.0)[side]
            turn = Vector((0.0, 0.0, 1.0)).rotation_difference(outward)
            arrow.matrix_basis = Matrix.LocRotScale(place, turn, None)


register, unregister = bpy.utils.register_classes_factory((NLOS_GGT_grid,))
