"""The panel of the animated target. Nothing is computed here."""

# mypy: disable-error-code="misc"

from typing import Any

import bpy

from ..operators import dataset, timeline
from ..view.sentences import sentence
from .panels import _split, _Tab


class NLOS_PT_timeline(_Tab, bpy.types.Panel):
    """Rendering and following of the target as it is animated."""

    bl_label = "Timeline"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        """Draw the settings, the buttons and the progress."""
        layout, scene, job = self.layout, context.scene, dataset.job
        settings = scene.nlos
        column = layout.column()
        _split(column)
        column.prop(settings, "timeline_folder")
        row = column.row(align=True)
        row.prop(scene, "frame_start", text="Frames")
        row.prop(scene, "frame_end", text="")
        row.prop(scene, "frame_step", text="")
        if job is not None and job.running:
            layout.progress(factor=job.share)
            sentence(context, layout, job.status())
            layout.operator("nlos.sweep_cancel", icon="CANCEL")
        else:
            layout.operator("nlos.timeline_render", icon="RENDER_ANIMATION")
            if job is not None:
                sentence(context, layout, job.status())
        column = layout.column()
        _split(column)
        column.prop(settings, "timeline_atlas")
        column.prop(settings, "timeline_step")
        if timeline.following():
            layout.operator("nlos.timeline_cancel", icon="CANCEL")
        else:
            layout.operator("nlos.timeline_follow", icon="TRACKING")
        for text in timeline.words:
            sentence(context, layout, text)


register, unregister = bpy.utils.register_classes_factory((NLOS_PT_timeline,))
