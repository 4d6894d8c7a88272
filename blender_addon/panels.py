"""The NLOS tab of the 3D Viewport's sidebar. Nothing is computed here."""

# mypy: disable-error-code="misc"

from typing import Any

import bpy


class _Tab:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "NLOS"


class NLOS_PT_lab(_Tab, bpy.types.Panel):
    """The parent of the others."""

    bl_label = "NLOS Lab"

    def draw(self, context: Any) -> None:
        """Draw what concerns the scene as a whole."""
        layout = self.layout
        column = layout.column()
        column.scale_y = 1.4
        column.operator("nlos.build_scene", icon="SCENE_DATA")
        row = layout.row(align=True)
        row.operator("nlos.read_scene", text="Read", icon="IMPORT")
        row.operator("nlos.apply", text="Apply", icon="EXPORT")


class NLOS_PT_scene(_Tab, bpy.types.Panel):
    """What to build."""

    bl_label = "Scene"
    bl_parent_id = "NLOS_PT_lab"

    def draw(self, context: Any) -> None:
        """Draw the preset."""
        layout, settings = self.layout, context.scene.nlos
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "preset")


class NLOS_PT_target(_Tab, bpy.types.Panel):
    """What hides."""

    bl_label = "Target"
    bl_parent_id = "NLOS_PT_lab"

    def draw(self, context: Any) -> None:
        """Draw the target's figures."""
        layout, settings = self.layout, context.scene.nlos
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "target_kind")
        if settings.target_kind == "mesh":
            layout.prop(settings, "target_mesh")
        layout.prop(settings, "target_size")
        layout.prop(settings, "target_albedo")


class NLOS_PT_light(_Tab, bpy.types.Panel):
    """What shines."""

    bl_label = "Light"
    bl_parent_id = "NLOS_PT_lab"

    def draw(self, context: Any) -> None:
        """Draw the spot's figures."""
        layout, settings = self.layout, context.scene.nlos
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "light_power")
        layout.prop(settings, "light_half_angle")


class NLOS_PT_ambient(_Tab, bpy.types.Panel):
    """What shines from all around."""

    bl_label = "Ambient Light"
    bl_parent_id = "NLOS_PT_light"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw_header(self, context: Any) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.nlos, "use_ambient", text="")

    def draw(self, context: Any) -> None:
        """Draw the radiance."""
        layout, settings = self.layout, context.scene.nlos
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.active = settings.use_ambient
        layout.prop(settings, "ambient_radiance")


class NLOS_PT_voxels(_Tab, bpy.types.Panel):
    """Where it may hide."""

    bl_label = "Hidden Voxels"
    bl_parent_id = "NLOS_PT_lab"

    def draw(self, context: Any) -> None:
        """Draw the grid."""
        layout, settings = self.layout, context.scene.nlos
        layout.use_property_split = True
        layout.use_property_decorate = False
        for name in ("grid_counts", "grid_lo", "grid_hi"):
            layout.column().prop(settings, name)


class NLOS_PT_rendering(_Tab, bpy.types.Panel):
    """How to render it."""

    bl_label = "Rendering"
    bl_parent_id = "NLOS_PT_lab"

    def draw(self, context: Any) -> None:
        """Draw the renderer's figures and its button."""
        layout, settings = self.layout, context.scene.nlos
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "engine")
        layout.prop(settings, "reflection_order")
        if settings.engine != "surfel":
            layout.prop(settings, "samples")
            layout.prop(settings, "seed")
        if settings.engine in ("surfel", "auto"):
            layout.prop(settings, "accuracy")
        column = layout.column(align=True)
        column.prop(settings, "resolution", index=0, text="Resolution X")
        column.prop(settings, "resolution", index=1, text="Y")
        layout.prop(settings, "difference")
        column = layout.column()
        column.scale_y = 1.4
        column.operator("nlos.render_wall", icon="RENDER_STILL")


_CLASSES = (
    NLOS_PT_lab,
    NLOS_PT_scene,
    NLOS_PT_target,
    NLOS_PT_light,
    NLOS_PT_ambient,
    NLOS_PT_voxels,
    NLOS_PT_rendering,
)

register, unregister = bpy.utils.register_classes_factory(_CLASSES)
