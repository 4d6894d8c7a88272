"""After a render the file is as it was: an artist who saves it loses no setting."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from generator.blender.engines import renderers
from generator.blender.scene import blend_file, build
from generator.blender.scene.description import read_scene
from generator.model.presets import preset

FORMATS = {
    "png": {"file_format": "PNG", "color_mode": "RGBA", "color_depth": "16", "compression": 33},
    "layers": {"file_format": "OPEN_EXR_MULTILAYER", "color_mode": "RGBA", "color_depth": "16", "exr_codec": "DWAA"},
    "exr": {"file_format": "OPEN_EXR", "color_mode": "BW", "color_depth": "16", "exr_codec": "PIZ"},
    "jpeg": {"file_format": "JPEG", "color_mode": "BW", "quality": 41},
    "tiff": {"file_format": "TIFF", "color_mode": "RGBA", "color_depth": "16", "tiff_codec": "LZW"},
    "film": {"file_format": "FFMPEG", "color_mode": "BW"},
    "dpx": {"file_format": "DPX", "color_mode": "RGB", "color_depth": "10"},
}
MEDIA = {"layers": "MULTI_LAYER_IMAGE", "film": "VIDEO"}
OWN_COLOURS = ("png", "exr", "tiff")
"""Formats that are given colour management of their own."""


def every_setting(scene):
    """All values of Blender's own list of properties, of all that an engine might touch, by their paths."""
    found = {}

    def walk(owner, path):
        for about in owner.bl_rna.properties:
            name = about.identifier
            if about.type == "COLLECTION" or name in ("rna_type", "use_nodes", "depsgraph"):
                continue
            if getattr(about, "is_deprecated", False):
                continue
            value = getattr(owner, name)
            if about.type != "POINTER":
                found[f"{path}.{name}"] = str(tuple(value) if getattr(about, "is_array", False) else value)
            elif value is None or isinstance(value, bpy.types.ID):
                found[f"{path}.{name}"] = str(value)
            elif path.count(".") < 4 and name not in ("rigidbody_world", "display"):
                walk(value, f"{path}.{name}")

    walk(scene, "scene")
    walk(scene.cycles, "cycles")
    walk(bpy.context.preferences.addons["cycles"].preferences, "preferences")
    for obj in scene.objects:
        walk(obj, obj.name)
        walk(obj.data, f"{obj.name} data")
        if hasattr(obj.data, "cycles"):
            walk(obj.data.cycles, f"{obj.name} cycles")
    for layer in scene.view_layers:
        for name in ("samples", "use", "use_pass_combined", "material_override", "world_override"):
            if hasattr(layer, name):
                found[f"{layer.name}.{name}"] = str(getattr(layer, name))
    for kind in ("lights", "objects", "cameras", "worlds", "materials"):
        found[f"data.{kind}"] = str(sorted(block.name for block in getattr(bpy.data, kind)))
    return found


def opened_with(name):
    scene = blend_file.new_file()
    build.build(scene, preset("room"))
    image = scene.render.image_settings
    if name in MEDIA and hasattr(image, "media_type"):
        image.media_type = MEDIA[name]
    for setting, value in FORMATS[name].items():
        setattr(image, setting, value)
    if name in OWN_COLOURS:
        image.color_management = "OVERRIDE"
        image.view_settings.view_transform, image.view_settings.exposure = "Raw", 1.5
        image.linear_colorspace_settings.name = "ACEScg"
    scene.view_settings.exposure, scene.render.engine = -2.0, "BLENDER_WORKBENCH"
    return scene


@pytest.fixture(scope="module")
def plain():
    """The picture of each engine in a file that nobody has edited."""
    scene = blend_file.new_file()
    build.build(scene, preset("room"))
    return {engine: pictures(scene, engine) for engine in renderers.ENGINES}


def pictures(scene, engine):
    with renderers.opened(scene, engine, resolution=(8, 8), accuracy=0.1) as renderer:
        return [renderer.render(samples=1, seed=1, target=target) for target in (True, False)]


@pytest.mark.parametrize("name", FORMATS)
def test_all_settings_are_as_they_were_and_none_reaches_the_pixels(name, plain):
    scene = opened_with(name)
    before = every_setting(scene)
    assert len(before) > 1500
    for engine in renderers.ENGINES:
        made = pictures(scene, engine)
        after = every_setting(scene)
        assert {k: (before.get(k), after[k]) for k in after if after[k] != before.get(k)} == {}, engine
        assert np.array_equal(made, plain[engine]), engine


def test_what_an_error_interrupts_is_set_back_too():
    scene = opened_with("tiff")
    before = every_setting(scene)
    with pytest.raises(ZeroDivisionError), renderers.opened(scene, "patch", resolution=(8, 8)):
        raise ZeroDivisionError
    assert every_setting(scene) == before


def test_a_small_file_that_is_set_to_video_is_read():
    """Blender itself renders no picture of one: "Image too small"."""
    scene = opened_with("film")
    scene.render.resolution_x = scene.render.resolution_y = 8
    before = every_setting(scene)
    assert read_scene(scene).resolution == (8, 8)
    assert every_setting(scene) == before
