"""The panel of the asset library. Nothing is read or computed here."""

# mypy: disable-error-code="misc"

from typing import Any

import bpy

from ..operators import assets
from ..view.sentences import sentence
from .panels import _Tab


class NLOS_PT_assets(_Tab, bpy.types.Panel):
    """The library of assets."""

    bl_label = "Assets"
    bl_parent_id = "NLOS_PT_scene"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        """Draw the button, and what became of it."""
        layout = self.layout
        layout.operator("nlos.add_assets", icon="ASSET_MANAGER")
        if assets.words:
            sentence(context, layout, assets.words)


register, unregister = bpy.utils.register_classes_factory((NLOS_PT_assets,))
