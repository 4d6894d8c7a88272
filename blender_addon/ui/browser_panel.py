"""The panel that shows a data set's pictures."""

# mypy: disable-error-code="misc"

from typing import Any

import bpy

from ..operators import browser
from ..view import differs, thumbnails
from ..view.sentences import sentence
from .panels import _Tab

_PARTS = {"grid": "voxels", "spot": "lamp", "reflection_order": "reflections", "ambient": "ambient light"}


class NLOS_PT_browser(_Tab, bpy.types.Panel):
    """Pictures of the data set, voxel by voxel."""

    bl_label = "Pictures"
    bl_parent_id = "NLOS_PT_dataset"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        """Draw the page: a thumbnail, the pose and the buttons of each voxel."""
        layout, settings, found = self.layout, context.scene.nlos, thumbnails.opened()
        if found is None:
            thumbnails.want(settings.dataset)
            sentence(context, layout, thumbnails.words() or "Reading the set ...")
            layout.operator("nlos.browse_again", icon="FILE_REFRESH")
            return
        shown = browser.shown(found)
        thumbnails.want(settings.dataset, [record for record, _, _ in shown])
        if others := thumbnails.others_than(differs.described()):
            names = ", ".join(_PARTS.get(name, name) for name in others)
            sentence(context, layout, f"The set is of another scene than this one: other {names}", "ERROR")
        if found.fault:
            sentence(context, layout, found.fault, "ERROR")
        if len(found.voxels) > browser.VOXELS:
            row = layout.row(align=True)
            row.operator("nlos.browse_page", text="", icon="TRIA_LEFT").by = -1
            row.label(text=f"{shown[0][0].label} to {shown[-1][0].label} of {len(found.voxels)} voxels")
            row.operator("nlos.browse_page", text="", icon="TRIA_RIGHT").by = 1
        for record, place, count in shown:
            _draw_pose(context, layout.box(), record, place, count)


def _draw_pose(context: Any, box: Any, record: Any, place: int, count: int) -> None:
    icon, fault = thumbnails.thumbnail(record)
    halves = box.split(factor=0.35)
    if icon:
        halves.template_icon(icon, scale=4.2)
    else:
        halves.label(text="" if fault else "Reading ...")
    column = halves.column(align=True)
    row = column.row(align=True)
    for by, sign in ((-1, "TRIA_LEFT"), (1, "TRIA_RIGHT")):
        if by > 0:
            row.label(text=f"{record.label}  {place + 1} of {count}", translate=False)
        step = row.operator("nlos.browse_step", text="", icon=sign)
        step.voxel, step.by = record.voxel, by
    small = column.column(align=True)
    small.scale_y = 0.75
    small.label(text=" ".join(f"{v:.2f}" for v in record.position) + " m", translate=False)
    small.label(text=" ".join(f"{round(v)}°" for v in record.rotation), translate=False)
    put = column.operator("nlos.browse_place", text="Put Target There", icon="PIVOT_CURSOR")
    put.voxel, put.position = record.voxel, place
    notes = [fault] if fault else []
    if record.others:
        notes.append(f"One of {1 + len(record.others)} objects")
    notes += [f"{name} {value:.4g}" for name, value in record.values]
    if notes:
        sentence(context, box, "; ".join(notes))


register, unregister = bpy.utils.register_classes_factory((NLOS_PT_browser,))
