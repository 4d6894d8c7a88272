"""The panel that trains a model."""

# mypy: disable-error-code="misc"

from typing import Any

import bpy

from ..operators import train
from ..view.sentences import sentence
from .panels import _split, _Tab


class NLOS_PT_train(_Tab, bpy.types.Panel):
    """Training of a model on a data set."""

    bl_label = "Train"
    bl_parent_id = "NLOS_PT_answer"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        """Draw the choice, the button, the progress and the result."""
        layout, settings, job = self.layout, context.scene.nlos, train.job
        column = layout.column()
        _split(column)
        for name in ("train_set", "train_features", "train_classifier"):
            column.prop(settings, name)
        if job is not None and job.running:
            layout.progress(factor=job.share)
            sentence(context, layout, job.words)
            layout.operator("nlos.train_cancel", icon="CANCEL")
            return
        layout.operator("nlos.train", icon="EXPERIMENTAL")
        if job is not None:
            sentence(context, layout, job.words)


register, unregister = bpy.utils.register_classes_factory((NLOS_PT_train,))
