"""The NLOS menu of the 3D view's header, through which F3 and the keyboard find the operators; user presets."""

# mypy: disable-error-code="misc"

from typing import Any

import bpy
from bl_operators.presets import AddPresetBase

PRESETS = "nlos_lab/scene"
"""Folder of the user's presets, inside Blender's folder of presets."""

_KEPT = (
    *("preset", "target_kind", "target_size", "target_albedo", "target_mesh", "target_unit", "target_up"),
    *("light_power", "light_half_angle"),
    *("use_ambient", "ambient_radiance", "grid_counts", "grid_lo", "grid_hi", "reflection_order", "engine"),
    *("samples", "accuracy", "resolution", "seed", "difference", "denoise", "poses", "inside"),
)
"""Settings that a user preset stores; the scene preset comes first, since setting it sets the others too."""


class NLOS_OT_preset_add(AddPresetBase, bpy.types.Operator):
    """Keep the figures of the NLOS tab under a name, or remove those that are chosen"""

    bl_idname = "nlos.preset_add"
    bl_label = "Add NLOS Preset"
    preset_menu = "NLOS_PT_presets"
    # Full paths: older Blenders whose Python is 3.13 do not find a name that is defined for them in `preset_defines`.
    preset_values = tuple(f"bpy.context.scene.nlos.{name}" for name in _KEPT)
    preset_subdir = PRESETS


class NLOS_MT_main(bpy.types.Menu):
    """Everything that the NLOS tab does."""

    bl_label = "NLOS"

    def draw(self, context: Any) -> None:
        """Draw the operators."""
        layout, session = self.layout, context.window_manager.nlos
        for name in ("build_scene", "read_scene", "apply"):
            layout.operator(f"nlos.{name}")
        layout.menu("NLOS_MT_adopt")
        layout.separator()
        layout.operator("nlos.check")
        layout.prop(session, "overlay")
        layout.prop(session, "look")
        layout.operator("nlos.open_image_editor")
        layout.operator("nlos.render_wall")
        for number in (1, 2, 3):
            layout.operator("nlos.experiment", text=f"Experiment {number}").number = number
        layout.separator()
        for name in ("sweep_start", "sweep_resume", "sweep_cancel", "open_folder"):
            layout.operator(f"nlos.{name}")
        layout.separator()
        for name in ("answer", "forget_answer", "test_environment"):
            layout.operator(f"nlos.{name}")


class NLOS_MT_adopt(bpy.types.Menu):
    """Who plays which part."""

    bl_label = "Use Selected As"

    def draw(self, context: Any) -> None:
        """Draw the roles."""
        self.layout.operator_enum("nlos.adopt", "role")


def _in_header(self: Any, context: Any) -> None:
    if context.mode == "OBJECT":
        self.layout.menu("NLOS_MT_main")


def _in_new(self: Any, context: Any) -> None:
    self.layout.operator_context = "INVOKE_DEFAULT"
    self.layout.operator("nlos.new_room", icon="SCENE_DATA")


_CLASSES = (NLOS_OT_preset_add, NLOS_MT_adopt, NLOS_MT_main)
_register, _unregister = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    """Add the menus."""
    _register()
    bpy.types.VIEW3D_MT_editor_menus.append(_in_header)
    bpy.types.TOPBAR_MT_file_new.append(_in_new)


def unregister() -> None:
    """Remove the menus."""
    bpy.types.TOPBAR_MT_file_new.remove(_in_new)
    bpy.types.VIEW3D_MT_editor_menus.remove(_in_header)
    _unregister()
