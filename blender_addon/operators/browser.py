"""Operators of the data set's browser: turn its pages, put the target where a picture has it."""

# mypy: disable-error-code="valid-type,misc"

from __future__ import annotations

from typing import Any

import bpy
from bpy.props import IntProperty

from generator.blender.scene import posing, roles
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord

from ..session import state
from ..view import thumbnails
from . import base

VOXELS = 9
"""Voxels on a page."""

chosen: dict[int, int] = {}
"""Position of the pose that is shown of each voxel, among the voxel's poses; 0 where it is not named."""
page = 0


def shown(found: thumbnails.Opened) -> list[tuple[PoseRecord, int, int]]:
    """Return what is on the page: the pose of each voxel, its position among the voxel's poses, and their number."""
    voxels = list(found.voxels.items())
    begin = VOXELS * min(page, (len(voxels) - 1) // VOXELS)
    result = []
    for voxel, records in voxels[begin : begin + VOXELS]:
        place = min(chosen.get(voxel, 0), len(records) - 1)
        result.append((records[place], place, len(records)))
    return result


class _Set:
    @classmethod
    def poll(cls: Any, context: Any) -> bool:
        """Return whether a data set is shown."""
        cls.poll_message_set("No data set is shown")
        return thumbnails.opened() is not None


class NLOS_OT_browse_step(_Set, bpy.types.Operator):
    """Show another picture of this voxel. Ctrl goes ten at once"""

    bl_idname = "nlos.browse_step"
    bl_label = "Next Picture"
    bl_options = {"INTERNAL"}  # noqa: RUF012

    voxel: IntProperty(name="Voxel", options={"SKIP_SAVE"})
    by: IntProperty(name="By", default=1, options={"SKIP_SAVE"})

    def invoke(self: Any, context: Any, event: Any) -> set[str]:
        """Go farther if Ctrl is held."""
        self.by *= 10 if event.ctrl else 1
        result: set[str] = self.execute(context)
        return result

    def execute(self: Any, context: Any) -> set[str]:
        """Go on, from the last picture to the first."""
        found = thumbnails.opened()
        records = found.voxels.get(self.voxel) if found else None
        if not records:
            return {"CANCELLED"}
        chosen[self.voxel] = (min(chosen.get(self.voxel, 0), len(records) - 1) + self.by) % len(records)
        state.redraw("VIEW_3D")
        return {"FINISHED"}


class NLOS_OT_browse_page(_Set, bpy.types.Operator):
    """Show other voxels"""

    bl_idname = "nlos.browse_page"
    bl_label = "More Voxels"
    bl_options = {"INTERNAL"}  # noqa: RUF012

    by: IntProperty(name="By", default=1, options={"SKIP_SAVE"})

    def execute(self: Any, context: Any) -> set[str]:
        """Turn the page, from the last to the first."""
        global page
        found = thumbnails.opened()
        assert found is not None
        page = (page + self.by) % max(1, -(-len(found.voxels) // VOXELS))
        state.redraw("VIEW_3D")
        return {"FINISHED"}


class NLOS_OT_browse_place(_Set, bpy.types.Operator):
    """Put the target where it was in this picture, place and rotation"""

    bl_idname = "nlos.browse_place"
    bl_label = "Put Target There"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    voxel: IntProperty(name="Voxel", min=0, options={"SKIP_SAVE"})
    position: IntProperty(name="Picture", min=0, options={"SKIP_SAVE"})

    def execute(self: Any, context: Any) -> set[str]:
        """Move the target."""
        found = thumbnails.opened()
        assert found is not None
        records = found.voxels.get(self.voxel, ())
        if self.position >= len(records):
            return base.refused(self, f"The set has no picture {self.position + 1} of that voxel")
        record = records[self.position]
        try:
            target = roles.find(context.scene, "target")
            before = (target.rotation_mode, target.location.copy(), target.rotation_euler.copy())
            try:
                posing.move_target(context.scene, record.position, record.rotation)
            except NlosError:
                target.rotation_mode, target.location, target.rotation_euler = before
                raise
        except NlosError as error:
            return base.refused(self, error)
        return {"FINISHED"}


class NLOS_OT_browse_again(bpy.types.Operator):
    """Read the data set again"""

    bl_idname = "nlos.browse_again"
    bl_label = "Read Again"
    bl_options = {"INTERNAL"}  # noqa: RUF012

    def execute(self, context: Any) -> set[str]:
        """Forget what was read."""
        thumbnails.forget()
        state.redraw("VIEW_3D")
        return {"FINISHED"}


_CLASSES = (NLOS_OT_browse_step, NLOS_OT_browse_page, NLOS_OT_browse_place, NLOS_OT_browse_again)
_register, _unregister = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    """Add the operators."""
    _register()


def unregister() -> None:
    """Remove the operators, and forget what was chosen."""
    global page
    page = 0
    chosen.clear()
    _unregister()
