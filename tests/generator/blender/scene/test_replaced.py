"""What a file says of the settings that a sweep replaces changes no bit; all else is as plain Cycles has it."""

from __future__ import annotations

import re

import bpy
import numpy as np
import pytest
from conftest import ROOT
from numpy.testing import assert_array_equal

from generator.blender import check, sweep_worker
from generator.blender.engines import renderers
from generator.blender.scene import blend_file, build, replaced, roles
from generator.blender.scene.quiet import Overrides, quiet
from generator.files.pictures import read_picture
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.sets.dataset import Dataset

SIZE = (12, 12)
SAMPLES, SEED = 32, 3
TABLE = {s.path: s for s in (*replaced.OUTPUT, *replaced.SAMPLING)}

# Of each setting that the table tells of, what a file may say instead.
FILES = {
    "render.image_settings.color_management": "OVERRIDE",
    "render.engine": "BLENDER_WORKBENCH",
    "render.pixel_aspect_x": 2.0,
    "render.pixel_aspect_y": 3.0,
    "render.use_border": True,
    "render.use_compositing": True,
    "render.use_sequencer": True,
    "render.use_freestyle": True,
    "render.use_stamp": True,
    "render.use_motion_blur": True,
    "render.use_simplify": True,
    "render.use_multiview": True,
    "render.film_transparent": True,
    "cycles.use_adaptive_sampling": True,
    "cycles.use_denoising": True,
    "cycles.time_limit": 1e-3,
    "cycles.sample_clamp_direct": 0.1,
    "cycles.sample_clamp_indirect": 0.1,
    "cycles.blur_glossy": 5.0,
    "cycles.caustics_reflective": False,
    "cycles.caustics_refractive": False,
    "cycles.light_sampling_threshold": 0.5,
    "cycles.pixel_filter_type": "BLACKMAN_HARRIS",
    "cycles.film_exposure": 3.0,
    "cycles.use_fast_gi": True,
    "cycles.use_animated_seed": True,
    "cycles.use_guiding": True,
    "cycles.sampling_pattern": "BLUE_NOISE",
    "cycles.scrambling_distance": 0.1,
    "cycles.auto_scrambling_distance": True,
    "cycles.sample_offset": 5,
    "cycles.use_sample_subset": True,
    "cycles.use_pixel_jitter": True,
}

# Of those, the ones that plain Cycles must show in the picture below, lest equality here mean nothing.
FELT = {
    *("render.use_border", "render.use_compositing", "render.use_stamp", "render.use_simplify"),
    *("cycles.sample_clamp_direct", "cycles.sample_clamp_indirect", "cycles.caustics_reflective"),
    *("cycles.caustics_refractive", "cycles.blur_glossy", "cycles.auto_scrambling_distance"),
    *("cycles.pixel_filter_type", "cycles.film_exposure", "cycles.use_fast_gi", "cycles.scrambling_distance"),
    *("cycles.sample_offset", "cycles.use_denoising", "render.pixel_aspect_x", "cycles.time_limit"),
}

UNTRIED = ("render.engine", "render.use_freestyle")
"""Of plain Cycles."""


def material(kind, **inputs):
    made = bpy.data.materials.new(kind)
    if made.node_tree is None:
        made.use_nodes = True
    made.node_tree.nodes.clear()
    shader, output = (made.node_tree.nodes.new(f"ShaderNode{n}") for n in (kind, "OutputMaterial"))
    for name, value in inputs.items():
        shader.inputs[name].default_value = value
    made.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return made


def furnished():
    """The room with a sky, more lamps, and metal, glass and a veil in view: there is something for every setting."""
    scene = blend_file.new_file()
    build.build(scene, preset("room", "sheet"))
    roles.limit_reflections(scene, 4)
    bpy.data.objects.remove(scene.objects["Ceiling"])
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.1
    shaders = [
        material("BsdfAnisotropic", Roughness=0.3),
        material("BsdfGlass", Roughness=0.1),
        material("BsdfTransparent", Color=(0.5, 0.7, 0.9, 1.0)),
        material("Emission", Strength=2.0),
    ]
    for i, shader in enumerate(shaders):
        bpy.ops.mesh.primitive_cube_add(size=0.4, location=(-0.8 + 0.2 * i, 0.6 + 0.1 * i, 1.1 + 0.15 * (i % 3)))
        bpy.context.object.data.materials.append(shader)
        bpy.context.object.modifiers.new("Subdivision", "SUBSURF").render_levels = 2
    for i in range(4):
        light = bpy.data.lights.new("Lamp", "POINT")
        light.energy, light.shadow_soft_size = 3.0, 0.1
        lamp = bpy.data.objects.new("Lamp", light)
        lamp.location = (-2.0 + 0.6 * i, 1.5, 0.5)
        scene.collection.objects.link(lamp)
    bpy.context.view_layer.update()
    return scene


def path(scene, **options):
    with renderers.opened(scene, "path", resolution=SIZE, **options) as renderer:
        return renderer.render(samples=SAMPLES, seed=SEED)


# What neutral is, written down once more, and apart from the table.
NEUTRAL = {
    "render": {
        "resolution_x": SIZE[0],
        "resolution_y": SIZE[1],
        "resolution_percentage": 100,
        "engine": "CYCLES",
        "use_compositing": False,
        "use_sequencer": False,
        "use_file_extension": False,
        "film_transparent": False,
        "pixel_aspect_x": 1.0,
        "pixel_aspect_y": 1.0,
        "use_border": False,
        "use_stamp": False,
        "use_simplify": False,
        "use_motion_blur": False,
        "use_multiview": False,
        "use_freestyle": False,
    },
    "cycles": {
        "samples": SAMPLES,
        "seed": SEED,
        "device": "CPU",
        "use_adaptive_sampling": False,
        "use_denoising": False,
        "sample_clamp_direct": 0.0,
        "sample_clamp_indirect": 0.0,
        "blur_glossy": 0.0,
        "film_exposure": 1.0,
        "caustics_reflective": True,
        "caustics_refractive": True,
        "light_sampling_threshold": 0.0,
        "pixel_filter_type": "BOX",
        "sampling_pattern": "TABULATED_SOBOL",
        "time_limit": 0.0,
        "use_fast_gi": False,
        "use_animated_seed": False,
        "use_guiding": False,
        "scrambling_distance": 1.0,
        "auto_scrambling_distance": False,
        "sample_offset": 0,
        "use_pixel_jitter": False,
    },
}


def plain(scene, tmp_path, **changed):
    """Render with Blender's own render call alone; what is changed for good in the scene is nobody's matter."""
    render, image = scene.render, scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGB", "32", "NONE"
    for owner, values in NEUTRAL.items():
        for name, value in values.items():
            if hasattr(getattr(scene, owner), name):
                setattr(getattr(scene, owner), name, value)
    for name, value in changed.items():
        owner, _, attribute = name.rpartition(".")
        setattr(scene.path_resolve(owner), attribute, value)
    render.filepath = str(tmp_path / "plain.exr")
    with quiet():
        bpy.ops.render.render(write_still=True)
    return read_picture(tmp_path / "plain.exr")[0]


def make_the_compositor_count(scene):
    """Let a compositor put one colour in place of the picture."""
    if bpy.app.version >= (5, 0):
        tree = bpy.data.node_groups.new("Compositing", "CompositorNodeTree")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        if hasattr(scene, "compositor_effects"):  # Blender 5.3
            scene.compositor_effects.new("Compositing").node_group = tree
        else:
            scene.compositing_node_group = tree
        output = tree.nodes.new("NodeGroupOutput")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        output = tree.nodes.new("CompositorNodeComposite")
    colour = tree.nodes.new("CompositorNodeRGB")
    colour.outputs[0].default_value = (9.0, 9.0, 9.0, 1.0)
    tree.links.new(colour.outputs[0], output.inputs[0])


def make_the_sequencer_count(scene):
    editor = scene.sequence_editor or scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    end = {"length": 10} if bpy.app.version >= (5, 0) else {"frame_end": 10}
    strips.new_effect(name="White", type="COLOR", channel=1, frame_start=1, **end).color = (1.0, 1.0, 1.0)


@pytest.mark.slow
def test_the_file_has_no_say_in_what_is_replaced(tmp_path):
    """Nor do text, compositor, sequencer, Freestyle, stereo, region: the picture is that of the neutral file."""
    scene = furnished()
    make_the_compositor_count(scene)
    make_the_sequencer_count(scene)
    render = scene.render
    render.border_min_x, render.simplify_subdivision_render, render.use_crop_to_border = 0.5, 0, False
    render.stamp_font_size, render.use_stamp_note, render.stamp_note_text = 60, True, "note"
    scene.cycles.sample_subset_length = 1
    told = {path for path, setting in TABLE.items() if setting.words}
    assert told == set(FILES), "every setting that reaches the pixels is tried"
    neutral = plain(scene, tmp_path)
    assert_array_equal(path(scene), neutral)
    felt = set()
    for name, value in FILES.items():
        owner, _, attribute = name.rpartition(".")
        holder = scene.path_resolve(owner)
        if not hasattr(holder, attribute):  # nor has this Blender
            continue
        if name == "cycles.sample_offset":
            scene.cycles.use_sample_subset = True
        if name not in UNTRIED and not np.array_equal(plain(scene, tmp_path, **{name: value}), neutral):
            felt.add(name)
        plain(scene, tmp_path)  # puts the neutral values back
        before = getattr(holder, attribute)
        try:
            setattr(holder, attribute, value)
        except TypeError:  # this Blender has no such value
            continue
        assert name in [setting.path for setting in replaced.replaced(scene)], name
        assert_array_equal(path(scene), neutral, err_msg=name)
        assert getattr(holder, attribute) == (pytest.approx(value) if isinstance(value, float) else value), name
        setattr(holder, attribute, before)
    assert not FELT - felt, "plain Cycles shows none of these here, so that this test says nothing of them"


def animate(scene, path, value, how):
    """Let an action, a strip or a driver give a setting a value."""
    owner, _, name = path.rpartition(".")
    holder = scene.path_resolve(owner)
    if how == "driver":
        curve = scene.driver_add(path)
        scene["wish"] = float(value)
        variable = curve.driver.variables.new()
        variable.targets[0].id_type, variable.targets[0].id = "SCENE", scene
        variable.targets[0].data_path = '["wish"]'
        curve.driver.type = "SUM"
    else:
        setattr(holder, name, value)
        assert scene.keyframe_insert(path, frame=1)
    animation = scene.animation_data
    if how == "strip":
        strip = animation.nla_tracks.new().strips.new("Strip", 1, animation.action)
        animation.action = None
        return strip
    return animation


@pytest.mark.parametrize("how", ["action", "strip", "driver"])
def test_animation_of_what_is_replaced_has_no_say(how):
    """Blender evaluates it anew when a render starts, after everything that a script has set."""
    scene = furnished()
    neutral = path(scene)
    wishes = {
        "cycles.samples": 64,
        "cycles.seed": 77,
        "cycles.film_exposure": 3.0,
        "render.use_stamp": True,
        'view_layers["ViewLayer"].samples': 128,
        "view_layers[0].samples": 128,
        "cycles.pixel_filter_type": 1,
    }
    for wish, value in wishes.items():
        if how != "driver" and wish == "cycles.pixel_filter_type":
            value = "GAUSSIAN"
        elif how != "driver" and wish == "view_layers[0].samples":
            continue  # keys are inserted by name
        owner, _, name = wish.rpartition(".")
        holder = scene.path_resolve(owner)
        before = getattr(holder, name)
        animate(scene, wish, value, how)
        scene.frame_set(1)
        wanted = getattr(holder, name)
        assert wanted != before
        if wish in TABLE:
            assert any("animated in the file" in replaced.told(scene, s) for s in replaced.replaced(scene))
        assert_array_equal(path(scene), neutral, err_msg=wish)
        scene.frame_set(2)
        assert getattr(holder, name) == wanted, "the animation is at work again"
        scene.animation_data_clear()
        setattr(holder, name, before)


def test_only_the_animation_of_what_is_set_is_muted():
    """The lamp that keeps its own keys is lit as keyed, while the samples' keys in the same scene are muted."""
    scene = furnished()
    lamp = next(o for o in scene.objects if o.name.startswith("Lamp"))
    lamp.data.energy = 300.0
    brighter = path(scene)
    lamp.data.keyframe_insert("energy", frame=1)
    lamp.data.energy = 3.0  # not keyed: gone when a render starts
    scene.cycles.samples = 64
    scene.keyframe_insert("cycles.samples", frame=1)
    scene.keyframe_insert("cycles.transparent_max_bounces", frame=1)
    assert_array_equal(path(scene), brighter)


def test_an_action_that_others_share_is_refused_rather_than_muted():
    scene = furnished()
    spot, other = roles.find(scene, "spot"), next(o for o in scene.objects if o.name.startswith("Lamp"))
    spot.keyframe_insert("hide_render", frame=1)
    with Overrides() as overrides:
        overrides.set(spot, "hide_render", True)  # its own: muted
    other.animation_data_create().action = spot.animation_data.action
    if hasattr(spot.animation_data, "action_slot"):
        other.animation_data.action_slot = spot.animation_data.action_slot
    with (
        Overrides() as overrides,
        pytest.raises(NlosError, match=r"'Spot' shares the action .* give it an action of its own"),
    ):
        overrides.set(spot, "hide_render", True)


def test_the_output_that_an_artist_set_is_put_back():
    scene = blend_file.new_file()
    build.build(scene, preset("tabletop", "sheet"))
    image = scene.render.image_settings
    neutral = path(scene)
    chosen = {"file_format": "OPEN_EXR", "color_mode": "RGBA", "color_depth": "16", "exr_codec": "DWAA"}
    for name, value in chosen.items():
        setattr(image, name, value)
    image.color_management = "OVERRIDE"
    spaces = [i.identifier for i in image.linear_colorspace_settings.bl_rna.properties["name"].enum_items]
    space = next(name for name in ("ACEScg", "ACES2065-1", "Linear Rec.2020") if name in spaces)
    image.linear_colorspace_settings.name = space
    assert_array_equal(path(scene), neutral)
    assert {name: getattr(image, name) for name in chosen} == chosen
    assert image.linear_colorspace_settings.name == space
    assert image.color_management == "OVERRIDE"
    if hasattr(image, "media_type"):  # Blender 5
        image.media_type = "MULTI_LAYER_IMAGE"
        image.exr_codec = "PIZ"
        assert_array_equal(path(scene), neutral)
        assert (image.media_type, image.file_format, image.exr_codec) == (
            "MULTI_LAYER_IMAGE",
            "OPEN_EXR_MULTILAYER",
            "PIZ",
        )


FOLLOWED = {
    "cycles.use_light_tree": False,
    "cycles.min_light_bounces": 0,
    "cycles.min_transparent_bounces": 3,
    "cycles.transparent_max_bounces": 0,
    "cycles.glossy_bounces": 0,
    "cycles.transmission_bounces": 0,
    "cycles.max_bounces": 1,
    "layer.use_sky": False,
    "layer.use_solid": False,
    "layer.material_override": "NLOS Target",
    "world.cycles_visibility.diffuse": False,
    "camera.data.dof.use_dof": True,
    "camera.data.shift_x": -0.6,
    "camera.data.clip_end": 2.5,
}


def test_all_else_in_the_file_is_as_plain_cycles_has_it(tmp_path):
    scene = furnished()
    neutral = path(scene)
    roles.find(scene, "camera").data.dof.focus_distance = 1.0
    for name, value in FOLLOWED.items():
        owner, _, attribute = name.replace("layer.", 'view_layers["ViewLayer"].').rpartition(".")
        holder = scene.path_resolve(owner)
        value = bpy.data.materials[value] if isinstance(value, str) else value
        before = getattr(holder, attribute)
        setattr(holder, attribute, value)
        got = path(scene)
        assert_array_equal(got, plain(scene, tmp_path), err_msg=name)
        assert not np.array_equal(got, neutral), name
        assert name not in replaced.replaced(scene)
        setattr(holder, attribute, before)


def test_what_is_on_disk_beside_the_pictures_changes_none(tmp_path):
    """Passes, metadata, dither, previews, overscan of the crop: none of it is light."""
    scene = furnished()
    neutral = path(scene)
    layer, render = scene.view_layers[0], scene.render
    for name in ("z", "normal", "cryptomatte_object", "diffuse_direct", "environment", "shadow"):
        setattr(layer, f"use_pass_{name}", True)
    layer.use_pass_combined = False
    layer.cycles.denoising_store_passes = layer.cycles.pass_debug_sample_count = True
    render.dither_intensity, render.use_crop_to_border, render.image_settings.use_preview = 2.0, True, True
    render.use_stamp_note, render.stamp_note_text, render.use_stamp_memory = True, "{x} \u20ac", True
    render.use_placeholder, render.use_overwrite, render.threads_mode = True, False, "FIXED"
    scene.view_settings.exposure, scene.view_settings.gamma, scene.view_settings.use_curve_mapping = 3.0, 2.0, True
    scene.cycles.use_preview_denoising = scene.cycles.use_auto_tile = True
    scene.cycles.tile_size = 8
    assert_array_equal(path(scene), neutral)


def test_denoising_that_is_asked_for_is_done_whatever_the_layer_says():
    scene = furnished()
    noisy, clean = path(scene), path(scene, denoise=True)
    scene.view_layers[0].cycles.use_denoising = False
    assert_array_equal(path(scene, denoise=True), clean)
    assert np.abs(np.diff(clean, axis=0)).mean() < 0.8 * np.abs(np.diff(noisy, axis=0)).mean()


def test_a_set_says_what_was_replaced(tmp_path):
    scene = blend_file.new_file()
    build.build(scene, preset("room", "sheet"))
    scene.cycles.caustics_reflective = False
    source = tmp_path / "room.blend"
    blend_file.save_file(source)
    chosen = {"engine": "patch", "poses": 1, "samples": 4, "resolution": [8, 8]}
    said = sweep_worker.plan(scene, source, tmp_path / "set", chosen, probe=False).meta["replaced"]
    assert Dataset.open(tmp_path / "set").meta["replaced"] == said
    assert "reflective caustics (off in the file, on in a sweep)" in said
    [note] = [f.text for f in check.findings(scene) if f.text.startswith("A sweep replaces")]
    assert "settings of the file: reflective caustics (off in the file, on in a sweep)" in note
    assert "some of Blender's defaults: adaptive sampling, denoising" in note
    for setting in replaced.replaced(scene):
        [(owner, name)] = replaced.places(scene, setting)
        setattr(owner, name, setting.value)
    assert not replaced.replaced(scene)
    assert not [f for f in check.findings(scene) if f.text.startswith("A sweep replaces")]


def test_the_page_has_the_table_of_the_code():
    page = (ROOT / "docs" / "reference" / "render-settings.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.+?) \| `(.+?)` \| (.+?) \| (.+?) \|$", page, flags=re.MULTILINE)
    wanted = [(s.words, s.path, replaced.words(s.value), s.why) for s in TABLE.values() if s.words]
    assert rows == wanted
    for setting in TABLE.values():
        assert bool(setting.words) == bool(setting.why)
        assert setting.words or f"`{setting.path}`" in page, "named among those that change no pixel"
