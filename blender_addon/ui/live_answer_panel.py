"""The panel of the answers that follow the live look. Nothing is computed here."""

# mypy: disable-error-code="misc"

from typing import Any

import bpy

from ..view import live_answer
from ..view.sentences import sentence
from .panels import _Tab


class NLOS_PT_live_answer(_Tab, bpy.types.Panel):
    """Answers about the live look while the object is moved."""

    bl_label = "While Looking"
    bl_parent_id = "NLOS_PT_answer"

    def draw(self, context: Any) -> None:
        """Draw the switch, and what answers by which picture."""
        layout, session = self.layout, context.window_manager.nlos
        layout.prop(session, "live_answer", toggle=True, icon="PLAY" if not session.live_answer else "PAUSE")
        if session.live_answer:
            for text in live_answer.words():
                sentence(context, layout, text)


register, unregister = bpy.utils.register_classes_factory((NLOS_PT_live_answer,))
