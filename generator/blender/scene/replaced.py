"""Settings of a scene file that a sweep replaces by its own values, and why.

This one table is applied by the engines, reported by `check`, recorded in `dataset.toml` and printed in
docs/reference/render-settings.md. Settings that are not in it keep the file's values, and are rendered as plain
Cycles renders them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from generator.blender.scene.quiet import Overrides, animating


@dataclass(frozen=True)
class Setting:
    """A setting that every picture is rendered with, whatever the file says.

    Attributes
    ----------
    path : str
        Attribute path from the scene in Blender's Python; ``layer`` stands for every view layer.
    value : object
        Value in a sweep.
    words : str
        Name in Blender's interface; empty where another value in the file changes no pixel, because it concerns the
        file that is written, or because the sweep's own settings replace it (``--samples``).
    why : str
        Why a sweep does not use the file's value.
    """

    path: str
    value: Any
    words: str = ""
    why: str = ""


_NO_LIGHT = "what it draws is no light of the scene"
_ALL_SAMPLES = "every pixel gets as many samples as the sweep says, from the first"
_OWN_NOISE = "the noise of a picture follows from its own seed alone, each pixel's from that pixel"

OUTPUT = (
    Setting("render.image_settings.media_type", "IMAGE"),  # Blender 5
    Setting("render.image_settings.file_format", "OPEN_EXR"),
    Setting("render.image_settings.color_mode", "RGB"),
    Setting("render.image_settings.color_depth", "32"),
    Setting("render.image_settings.exr_codec", "NONE"),
    Setting("render.image_settings.use_preview", False),
    Setting(
        "render.image_settings.color_management",
        "FOLLOW_SCENE",
        "colour space of the output",
        "values are the renderer's, scene-linear",
    ),
    Setting("render.engine", "CYCLES", "render engine", "no other engine of Blender knows radiance"),
    Setting("render.resolution_percentage", 100),  # the file's value is already in the sweep's resolution
    Setting("render.pixel_aspect_x", 1.0, "pixel aspect x", "pixels are square"),
    Setting("render.pixel_aspect_y", 1.0, "pixel aspect y", "pixels are square"),
    Setting("render.use_border", False, "render region", "a picture is all that the camera sees"),
    Setting("render.use_compositing", False, "compositing", "values are the renderer's, scene-linear"),
    Setting("render.use_sequencer", False, "sequencer", "a picture is of the scene, not of its edit"),
    # Its style modules are Python, and run even if a file's scripts are disabled.
    Setting("render.use_freestyle", False, "Freestyle", _NO_LIGHT),
    Setting("render.use_stamp", False, "text burnt in", _NO_LIGHT),
    Setting("render.use_motion_blur", False, "motion blur", "a picture is of one instant"),
    Setting("render.use_simplify", False, "Simplify", "the scene is rendered as modelled, to its last detail"),
    Setting("render.use_multiview", False, "stereoscopy", "the camera has one eye"),
    Setting("render.film_transparent", False, "transparent film", "the world is in the picture where it is seen"),
    Setting("render.use_file_extension", False),
    Setting("render.use_overwrite", True),
    Setting("render.use_placeholder", False),
    Setting("render.use_render_cache", False),
    Setting("render.use_persistent_data", True),
)
"""Float32 radiance directly from the renderer: of the whole view, at one instant, with nothing drawn over it."""
IMAGES = tuple(setting for setting in OUTPUT if setting.path.startswith("render.image_settings."))
"""The image format among them: Blender renders no small picture of a file whose output is set to video."""

SAMPLING = (
    Setting("cycles.device", "CPU"),  # unless --device is given
    Setting("cycles.use_adaptive_sampling", False, "adaptive sampling", f"{_ALL_SAMPLES}; to stop early is biased"),
    Setting("cycles.use_denoising", False, "denoising", "it is biased; --denoise asks for it"),
    Setting("cycles.time_limit", 0.0, "time limit", "pixels do not depend on how fast the machine is"),
    Setting("cycles.sample_clamp_direct", 0.0, "clamping of direct light", "it takes light away"),
    Setting("cycles.sample_clamp_indirect", 0.0, "clamping of indirect light", "it takes light away"),
    Setting("cycles.blur_glossy", 0.0, "Filter Glossy", "materials reflect as they are"),
    Setting("cycles.caustics_reflective", True, "reflective caustics", "their light is there"),
    Setting("cycles.caustics_refractive", True, "refractive caustics", "their light is there"),
    Setting("cycles.light_sampling_threshold", 0.0, "light threshold", "faint light is what a sweep is about"),
    Setting("cycles.pixel_filter_type", "BOX", "pixel filter", "a pixel is the mean over its own square"),
    Setting("cycles.film_exposure", 1.0, "film exposure", "values are radiance, W/m²/sr"),
    Setting("cycles.use_fast_gi", False, "Fast GI", "it guesses light"),
    Setting("cycles.use_animated_seed", False, "animated seed", _OWN_NOISE),
    Setting(
        "cycles.use_guiding", False, "path guiding", "a picture and its own background must follow the same rays"
    ),
    Setting("cycles.sampling_pattern", "TABULATED_SOBOL", "sampling pattern", _OWN_NOISE),
    Setting("cycles.scrambling_distance", 1.0, "scrambling distance", _OWN_NOISE),
    Setting("cycles.auto_scrambling_distance", False, "automatic scrambling distance", _OWN_NOISE),
    Setting("cycles.use_sample_subset", False, "sample subset", _ALL_SAMPLES),
    Setting("cycles.sample_offset", 0, "sample offset", _ALL_SAMPLES),
    Setting("cycles.use_pixel_jitter", False, "pixel jitter", _OWN_NOISE),  # Blender 5.2
    Setting("layer.samples", 0),
    Setting("layer.cycles.use_denoising", True),  # lets --denoise apply to every layer
)
"""Unbiased Cycles: a fixed number of samples, nothing clamped, filtered, denoised, guessed or cut short."""


def places(scene: Any, setting: Setting) -> Iterator[tuple[Any, str]]:
    """Yield the owners of a setting with the attribute's name; nothing if this Blender has no such setting."""
    first, *middle, name = setting.path.split(".")
    for owner in scene.view_layers if first == "layer" else (getattr(scene, first),):
        for part in middle:
            owner = getattr(owner, part)
        if hasattr(owner, name):
            yield owner, name


def replace(scene: Any, overrides: Overrides, settings: Iterable[Setting]) -> None:
    """Set the values that a sweep renders with, in place of the file's."""
    for setting in settings:
        for owner, name in places(scene, setting):
            overrides.set(owner, name, setting.value)


def replaced(scene: Any) -> list[Setting]:
    """Return the settings that affect the pixels and in which a file differs, or may differ, from a sweep."""
    return [
        setting
        for setting in (*OUTPUT, *SAMPLING)
        if setting.words
        and any(
            getattr(owner, name) != setting.value or animating(owner, name) for owner, name in places(scene, setting)
        )
        and (setting.path not in _AT_WORK or _AT_WORK[setting.path](scene))
    ]


def told(scene: Any, setting: Setting) -> str:
    """Return a phrase that gives a setting's value in the file and in a sweep."""
    owner, name = next(places(scene, setting))
    file_value = "animated" if animating(owner, name) else words(getattr(owner, name))
    return f"{setting.words} ({file_value} in the file, {words(setting.value)} in a sweep)"


def is_default(scene: Any, setting: Setting) -> bool:
    """Whether a setting has the default value of Blender, and is not animated."""
    owner, name = next(places(scene, setting))
    default = owner.bl_rna.properties[name].default
    return bool(getattr(owner, name) == default) and not animating(owner, name)


def words(value: Any) -> str:
    """Return a setting's value in words."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return value if isinstance(value, str) else f"{value:g}"


def _composites(scene: Any) -> bool:
    if hasattr(scene, "compositor_effects"):  # Blender 5.3, where the next is deprecated
        return any(effect.enable_for_render and effect.node_group is not None for effect in scene.compositor_effects)
    if hasattr(scene, "compositing_node_group"):  # Blender 5
        return scene.compositing_node_group is not None
    return bool(scene.use_nodes and scene.node_tree is not None)


def _edits(scene: Any) -> bool:
    editor = scene.sequence_editor
    return editor is not None and bool(len(editor.strips if hasattr(editor, "strips") else editor.sequences))


_AT_WORK: dict[str, Callable[[Any], bool]] = {
    "render.use_compositing": _composites,
    "render.use_sequencer": _edits,
    "cycles.sample_offset": lambda scene: getattr(scene.cycles, "use_sample_subset", True),
}
"""For settings that act only together with others: whether they act in this file."""
