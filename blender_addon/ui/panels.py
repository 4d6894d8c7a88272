"""The NLOS tab of the 3D Viewport's sidebar. Nothing is computed here."""

# mypy: disable-error-code="misc"

import math
from collections.abc import Iterable
from typing import Any

import bpy
import numpy as np
from bl_ui.utils import PresetPanel

from generator.blender.finding import ERROR, FIXES, GOOD, NOTE, WARNING, Finding
from generator.blender.scene import roles
from generator.model.engines import AUTO, traits_of

from ..operators import dataset
from ..operators import environment as environments
from ..session import background, environment, state
from ..view import differs, images, live, target_file, views
from ..view.sentences import sentence
from . import choices, menus

_ICONS = {GOOD: "CHECKMARK", NOTE: "INFO", WARNING: "ERROR", ERROR: "CANCEL"}


class _Tab:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = views.TAB


class _OfScene(_Tab):
    """A panel that is there once there is a scene to work on."""

    @classmethod
    def poll(cls, context: Any) -> bool:
        """Return whether the scene has voxels, which are written last."""
        return roles.GRID_SHAPE in context.scene


def _split(layout: Any) -> None:
    layout.use_property_split = True
    layout.use_property_decorate = False


def _setting(layout: Any, settings: Any, name: str, **options: Any) -> None:
    """Draw a setting, with a pencil behind it if the scene has another value."""
    row = layout.row(align=True)
    row.prop(settings, name, **options)
    if any(name in names for names in differs.found()):
        row.label(text="", icon="GREASEPENCIL")


def _result(context: Any, layout: Any, topic: str) -> Any:
    """Return a column for a result, grey where it is of another scene than now, which it says."""
    column = layout.column()
    if differs.is_stale(topic):
        column.active = False
        sentence(context, column, "Of the scene before its last edits", "TIME")
    return column


def _findings(context: Any, layout: Any, findings: Iterable[Finding]) -> None:
    """Draw findings, each with the buttons that select its object and mend it."""
    for finding in findings:
        box = layout.box()
        sentence(context, box, finding.text, _ICONS[finding.level])
        if finding.choices:
            choices.draw(box, finding.fix, finding.choices)
        elif finding.object or finding.fix:
            row = box.row(align=True)
            if finding.object:
                row.operator(
                    "nlos.select", text=finding.object, translate=False, icon="RESTRICT_SELECT_OFF"
                ).name = finding.object
            if finding.fix:
                row.operator("nlos.fix", text=FIXES[finding.fix], icon="TOOL_SETTINGS").fix = finding.fix


def _is_noisy(settings: Any) -> bool:
    return settings.engine == AUTO or traits_of(settings.engine).noisy


def _listed(settings: Any, names: list[str]) -> str:
    return ", ".join(settings.bl_rna.properties[name].name.lower() for name in names)


class NLOS_PT_presets(PresetPanel, bpy.types.Panel):
    """The user's own presets."""

    bl_label = "NLOS Presets"
    preset_subdir = menus.PRESETS
    preset_operator = "script.execute_preset"
    preset_add_operator = "nlos.preset_add"


class NLOS_PT_scene(_Tab, bpy.types.Panel):
    """Preset of the scene, and the operators that build, read and apply it."""

    bl_label = "Scene"

    def draw_header_preset(self, context: Any) -> None:
        """Draw the menu of presets."""
        NLOS_PT_presets.draw_panel_header(self.layout)

    def draw(self, context: Any) -> None:
        """Draw the preset, its operators and the switch of the overlay."""
        layout, settings = self.layout, context.scene.nlos
        _split(layout)
        layout.prop(settings, "preset")
        column = layout.column()
        column.scale_y = 1.4
        column.operator("nlos.build_scene", icon="SCENE_DATA")
        row = layout.row(align=True)
        row.operator("nlos.read_scene", text="Read", icon="IMPORT")
        row.operator("nlos.apply", text="Apply", icon="EXPORT")
        to_apply, to_build = differs.found()
        if not (to_apply or to_build):  # says so, lest all below move when there is something
            sentence(context, layout, "The scene has these figures", "CHECKMARK")
        for operator, names in (("Apply", to_apply), ("Build Scene", to_build)):
            if names:
                words = f"Other in the scene, until {operator} writes them: {_listed(settings, names)}"
                sentence(context, layout, words, "GREASEPENCIL")
        row = layout.row(align=True)
        row.use_property_split = False
        session = context.window_manager.nlos
        row.prop(session, "overlay", toggle=True, icon="OVERLAY")
        row.popover("NLOS_PT_overlay", text="", icon="DOWNARROW_HLT")


class NLOS_PT_overlay(bpy.types.Panel):
    """What the overlay shows."""

    bl_label = "NLOS Overlay"
    bl_space_type = "VIEW_3D"
    bl_region_type = "HEADER"

    def draw(self, context: Any) -> None:
        """Draw the switches."""
        layout, session = self.layout, context.window_manager.nlos
        layout.active = session.overlay
        for name in ("show_voxels", "show_patches", "show_legs", "show_poses"):
            layout.prop(session, name)


class NLOS_PT_roles(_Tab, bpy.types.Panel):
    """Objects that play the roles of the experiment."""

    bl_label = "Adopt My Objects"
    bl_parent_id = "NLOS_PT_scene"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        """Draw each role with its object."""
        layout = self.layout
        for role in roles.SINGLE_ROLES:
            players = roles.players(context.scene, role)
            row = layout.row(align=True)
            label = role.replace("_", " ").title()
            row.operator("nlos.adopt", text=label).role = role
            if len(players) == 1:
                row.operator(
                    "nlos.select", text=players[0].name, translate=False, icon="RESTRICT_SELECT_OFF"
                ).name = players[0].name
            else:
                row.label(text="nobody yet" if not players else f"{len(players)} objects", icon="ERROR")
                if players:  # an empty row would move those below
                    choices.draw(layout, "keep", [player.name_full for player in players])
        row = layout.row(align=True)
        for role in ("room", "partition", "none"):
            row.operator("nlos.adopt", text="No Role" if role == "none" else role.title()).role = role


class NLOS_PT_target(_Tab, bpy.types.Panel):
    """The hidden object."""

    bl_label = "Target"
    bl_parent_id = "NLOS_PT_scene"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        """Draw the target's settings."""
        layout, settings = self.layout, context.scene.nlos
        _split(layout)
        _setting(layout, settings, "target_kind")
        if settings.target_kind == "mesh":
            layout.prop(settings, "target_mesh")
            _setting(layout, settings, "target_unit")
            _setting(layout, settings, "target_up")
        _setting(layout, settings, "target_size")
        _setting(layout, settings, "target_albedo")
        for text, icon in target_file.words(settings):
            sentence(context, layout, text, icon)


class NLOS_PT_light(_Tab, bpy.types.Panel):
    """The spot lamp."""

    bl_label = "Light"
    bl_parent_id = "NLOS_PT_scene"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        """Draw the spot's settings."""
        layout, settings = self.layout, context.scene.nlos
        _split(layout)
        _setting(layout, settings, "light_power")
        _setting(layout, settings, "light_half_angle")


class NLOS_PT_ambient(_Tab, bpy.types.Panel):
    """Uniform light from all directions."""

    bl_label = "Ambient Light"
    bl_parent_id = "NLOS_PT_light"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw_header(self, context: Any) -> None:
        """Draw the switch."""
        self.layout.prop(context.scene.nlos, "use_ambient", text="")

    def draw(self, context: Any) -> None:
        """Draw the radiance."""
        layout, settings = self.layout, context.scene.nlos
        _split(layout)
        layout.active = settings.use_ambient
        _setting(layout, settings, "ambient_radiance")


class NLOS_PT_voxels(_Tab, bpy.types.Panel):
    """The voxels in which the object may hide."""

    bl_label = "Hidden Voxels"
    bl_parent_id = "NLOS_PT_scene"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        """Draw the grid."""
        layout, settings = self.layout, context.scene.nlos
        _split(layout)
        for name in ("grid_counts", "grid_lo", "grid_hi"):
            _setting(layout.column(), settings, name)
        if roles.GRID_SHAPE in context.scene:
            row = layout.row(align=True)
            row.use_property_split = False
            row.operator("nlos.fix", text=FIXES["voxels"], icon="TOOL_SETTINGS").fix = "voxels"
            row.prop(context.window_manager.nlos, "show_handles", toggle=True, icon="EMPTY_ARROWS")


class NLOS_PT_look(_OfScene, bpy.types.Panel):
    """Live picture of the light that the object changes on the wall."""

    bl_label = "Look"

    def draw(self, context: Any) -> None:
        """Draw the switch, its settings and the experiments."""
        layout, settings, session = self.layout, context.scene.nlos, context.window_manager.nlos
        row = layout.row(align=True)
        row.scale_y = 1.4
        row.prop(session, "look", toggle=True, icon="HIDE_OFF" if session.look else "HIDE_ON")
        row.operator("nlos.open_image_editor", text="", icon="IMAGE_DATA")
        column = layout.column()
        _split(column)
        column.prop(settings, "look_resolution")
        column.prop(settings, "look_shadows")
        if session.look and live.words():
            sentence(context, layout, live.words(), "SORTTIME" if live.waits() else "NONE")
        if session.look:
            _findings(context, layout, live.reasons())
            if live.needs_environment():
                environments.draw(context, layout)
        sentence(context, layout, "The paper's experiments")
        row = layout.row(align=True)
        for number, name in ((1, "Sphere"), (2, "Sheet"), (3, "Turned")):
            row.operator("nlos.experiment", text=f"{number} {name}").number = number
        if state.experiment:
            sentence(context, layout, state.experiment)


class NLOS_PT_check(_Tab, bpy.types.Panel):
    """Faults that would spoil a sweep."""

    bl_label = "Check"

    def draw(self, context: Any) -> None:
        """Draw the findings."""
        layout = self.layout
        layout.operator("nlos.check", icon="VIEWZOOM")
        layout = _result(context, layout, "check") if state.findings else layout
        _findings(context, layout, state.findings)
        if state.checking:
            sentence(context, layout, "Looking, then measuring signal and noise ...", "SORTTIME")


class NLOS_PT_rendering(_Tab, bpy.types.Panel):
    """A picture of the wall, and the settings of the renderer."""

    bl_label = "Rendering"

    def draw(self, context: Any) -> None:
        """Draw the button, what the picture is to be, and what it was."""
        layout, settings = self.layout, context.scene.nlos
        column = layout.column()
        column.scale_y = 1.4
        column.operator("nlos.render_wall", icon="RENDER_STILL")
        row = layout.row()
        row.prop(settings, "difference")
        if _is_noisy(settings):
            row.prop(settings, "denoise")
        if state.rendering:
            sentence(context, _result(context, layout, "picture"), state.rendering)
            if state.shown is not None:
                show = layout.operator("nlos.open_image_editor", text="Show the Picture", icon="IMAGE_DATA")
                show.image = images.PREVIEW
        else:
            sentence(
                context,
                layout,
                "F12 and rendered views find the lit patch only by chance, so they show black with bright dots: "
                "use Render Wall",
                "INFO",
            )


class NLOS_PT_renderer(_Tab, bpy.types.Panel):
    """Settings of the renderer."""

    bl_label = "Settings"
    bl_parent_id = "NLOS_PT_rendering"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        """Draw the renderer's settings."""
        layout, settings = self.layout, context.scene.nlos
        _split(layout)
        layout.prop(settings, "engine")
        _setting(layout, settings, "reflection_order")
        if _is_noisy(settings):
            layout.prop(settings, "device")
            layout.prop(settings, "samples")
            layout.prop(settings, "seed")
        if settings.engine == AUTO or not _is_noisy(settings):
            layout.prop(settings, "accuracy")
        layout.prop(settings, "quality")
        if settings.quality != "figures":
            layout.prop(settings, "minutes" if settings.quality == "time" else "error")
        column = layout.column(align=True)
        _setting(column, settings, "resolution", index=0, text="Resolution X")
        column.prop(settings, "resolution", index=1, text="Y")


class NLOS_PT_dataset(_OfScene, bpy.types.Panel):
    """Rendering of a data set."""

    bl_label = "Data Set"

    def draw(self, context: Any) -> None:
        """Draw the settings, the buttons and the progress."""
        layout, settings, job = self.layout, context.scene.nlos, dataset.job
        column = layout.column()
        _split(column)
        column.prop(settings, "dataset")
        column.prop(settings, "poses", text="Poses a Voxel")
        voxels = math.prod(context.scene[roles.GRID_SHAPE])
        sentence(context, column, f"{voxels * settings.poses} pictures in {voxels} voxels")
        column.prop(settings, "inside")
        column.prop(settings, "workers")
        if job is not None and job.running:
            layout.progress(factor=job.share)
            sentence(context, layout, job.status())
            layout.operator("nlos.sweep_cancel", icon="CANCEL")
        elif background.is_stepping("start"):
            sentence(context, layout, "Looking at the scene ...", "SORTTIME")
        else:
            row = layout.row(align=True)
            row.scale_y = 1.4
            row.operator("nlos.sweep_start", icon="RENDER_ANIMATION")
            row.operator("nlos.sweep_resume", icon="PLAY")
            if job is not None:
                sentence(context, layout, job.status())
        for message in job.told if job is not None else ():
            sentence(context, layout, message)
        layout.operator("nlos.open_folder", icon="FILE_FOLDER")


class NLOS_PT_answer(_OfScene, bpy.types.Panel):
    """The voxel that a trained model predicts."""

    bl_label = "Answer"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        """Draw the model, the question and the answer."""
        layout, settings = self.layout, context.scene.nlos
        column = layout.column()
        _split(column)
        column.prop(settings, "model")
        layout.operator("nlos.answer", icon="QUESTION")
        if state.answer_words:
            layout = _result(context, layout, "answer")
            sentence(context, layout, state.answer_words)
        if state.answer:
            column = layout.column(align=True)
            likely = sorted(state.answer.items(), key=lambda item: -item[1])[:_MOST_LIKELY]
            for label, probability in likely:
                column.progress(factor=probability, text=f"{label}  {probability:.0%}")
            if stands := _stands(context.scene):
                sentence(context, layout, stands)
            layout.operator("nlos.forget_answer", icon="X")
        if not environment.named():
            sentence(
                context,
                layout,
                "Answers need a Python with scikit-learn: make one here, or name one in the add-on's preferences",
                "INFO",
            )
            environments.draw(context, layout)
        if state.environment_words:
            sentence(context, layout, state.environment_words)


def _stands(scene: Any) -> str:
    """Return where the object's origin is, as of a moment ago: what an answer is to be compared with."""
    described, players = differs.described(), roles.players(scene, "target")
    if described is None or len(players) != 1:
        return ""
    place, grid = np.array(players[0].matrix_world.translation), described.grid
    if ((place < grid.lo) | (place > grid.hi)).any():
        return "The object stands outside the voxels now"
    return f"The object stands in {grid.labels[grid.voxel(place)]} now"


_MOST_LIKELY = 5

_CLASSES = (
    NLOS_PT_presets,
    NLOS_PT_overlay,
    NLOS_PT_scene,
    NLOS_PT_roles,
    NLOS_PT_target,
    NLOS_PT_light,
    NLOS_PT_ambient,
    NLOS_PT_voxels,
    NLOS_PT_look,
    NLOS_PT_check,
    NLOS_PT_rendering,
    NLOS_PT_renderer,
    NLOS_PT_dataset,
    NLOS_PT_answer,
)

register, unregister = bpy.utils.register_classes_factory(_CLASSES)
