"""The reader of node trees says what Cycles renders: each case is rendered, by Cycles alone, and compared."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from nodetrees import WHITE, node, output, tree_of

from generator.blender.scene import blend_file, nodes
from generator.blender.scene.quiet import quiet
from generator.files.pictures import read_picture


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    """A camera above a plane, nothing else: what a render call gives for a material, lamp or world, (3,)."""
    scene = blend_file.new_file()
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = 1
    scene.cycles.samples, scene.cycles.use_denoising = 1, False
    scene.cycles.use_adaptive_sampling = False
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_depth, image.color_mode = "OPEN_EXR", "32", "RGB"
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 0.1, (0.0, 0.0, 1.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    mesh = bpy.data.meshes.new("Plane")
    mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    plane = bpy.data.objects.new("Plane", mesh)
    scene.collection.objects.link(plane)
    path = tmp_path_factory.mktemp("studio") / "picture.exr"
    scene.render.filepath, scene.render.use_file_extension = str(path), False

    def render(*, material=None, world=None):
        plane.hide_render = material is None
        mesh.materials.clear()
        mesh.materials.append(material)
        scene.world = world
        with quiet():
            bpy.ops.render.render(write_still=True, scene=scene.name)
        return read_picture(path)[0][0, 0]

    return render


def emission(tree, into, strength=1.0):
    return node(tree, "Emission", into, Color=WHITE, Strength=strength)


def plain(tree, kind):
    emission(tree, output(tree, kind).inputs["Surface"], 0.75)


def muted_shader(tree, kind):
    emission(tree, output(tree, kind).inputs["Surface"]).mute = True


def muted_link(tree, kind):
    emission(tree, output(tree, kind).inputs["Surface"])
    tree.links[0].is_muted = True


def unlinked(tree, kind):
    emission(tree, None)
    output(tree, kind)


def eevee_only(tree, kind):
    emission(tree, output(tree, kind, "EEVEE").inputs["Surface"])


def cycles_before_all(tree, kind):
    """Though the other one is active."""
    other = output(tree, kind)
    emission(tree, other.inputs["Surface"], 4.0)
    emission(tree, output(tree, kind, "CYCLES").inputs["Surface"], 0.25)
    other.is_active_output = True


def active_of_two(tree, kind):
    emission(tree, output(tree, kind).inputs["Surface"], 4.0)
    second = output(tree, kind)
    emission(tree, second.inputs["Surface"], 0.25)
    second.is_active_output = True


def by_reroutes(tree, kind):
    route = tree.nodes.new("NodeReroute")
    emission(tree, route.inputs[0], 0.5)
    second = tree.nodes.new("NodeReroute")
    tree.links.new(route.outputs[0], second.inputs[0])
    tree.links.new(second.outputs[0], output(tree, kind).inputs["Surface"])


def value_node(tree, kind):
    shader = emission(tree, output(tree, kind).inputs["Surface"])
    node(tree, "Value", shader.inputs["Strength"]).outputs[0].default_value = 0.125


def colour_as_number(tree, kind):
    shader = emission(tree, output(tree, kind).inputs["Surface"])
    node(tree, "RGB", shader.inputs["Strength"]).outputs[0].default_value = (1.0, 0.5, 0.0, 1.0)


def colour_as_shader(tree, kind):
    """Cycles lets it shine."""
    node(tree, "RGB", output(tree, kind).inputs["Surface"]).outputs[0].default_value = (0.2, 0.4, 0.6, 1.0)


def muted_mix(tree, kind):
    """The first shader goes through, whatever the factor."""
    mix = node(tree, "MixShader", output(tree, kind).inputs["Surface"])
    mix.inputs[0].default_value, mix.mute = 1.0, True
    emission(tree, mix.inputs[1], 0.5)
    emission(tree, mix.inputs[2], 3.0)


def mix_of_one(tree, kind):
    mix = node(tree, "MixShader", output(tree, kind).inputs["Surface"])
    node(tree, "Value", mix.inputs[0]).outputs[0].default_value = 2.0
    emission(tree, mix.inputs[1], 0.5)
    emission(tree, mix.inputs[2], 3.0)


def sum_of_two(tree, kind):
    add = node(tree, "AddShader", output(tree, kind).inputs["Surface"])
    emission(tree, add.inputs[0], 0.5)
    emission(tree, add.inputs[1], 3.0)


def a_quarter_of_one(tree, kind):
    mix = node(tree, "MixShader", output(tree, kind).inputs["Surface"])
    mix.inputs[0].default_value = 0.25
    emission(tree, mix.inputs[2], 3.0)


def sum_with_itself(tree, kind):
    add = node(tree, "AddShader", output(tree, kind).inputs["Surface"])
    shader = emission(tree, add.inputs[0], 0.5)
    tree.links.new(shader.outputs[0], add.inputs[1])


def mixed_twice(tree, kind):
    """One shader by two ways, a quarter and a half of it."""
    add = node(tree, "AddShader", output(tree, kind).inputs["Surface"])
    mix = node(tree, "MixShader", add.inputs[0])
    mix.inputs[0].default_value = 0.25
    shader = emission(tree, mix.inputs[2], 2.0)
    emission(tree, mix.inputs[1], 1.0)
    other = node(tree, "MixShader", add.inputs[1])
    other.inputs[0].default_value = 0.5
    tree.links.new(shader.outputs[0], other.inputs[1])


def group(tree, kind):
    inner = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
    inner.interface.new_socket("Strength", in_out="INPUT", socket_type="NodeSocketFloat")
    inner.interface.new_socket("Light", in_out="OUTPUT", socket_type="NodeSocketShader")
    shader = emission(inner, inner.nodes.new("NodeGroupOutput").inputs[0])
    inner.links.new(inner.nodes.new("NodeGroupInput").outputs[0], shader.inputs["Strength"])
    outer = node(tree, "Group")
    outer.node_tree = inner
    outer.inputs[0].default_value = 0.375
    tree.links.new(outer.outputs[0], output(tree, kind).inputs["Surface"])


def empty_group(tree, kind):
    node(tree, "Group")
    output(tree, kind)


def dangling_reroute(tree, kind):
    shader = emission(tree, output(tree, kind).inputs["Surface"], 0.25)
    tree.links.new(tree.nodes.new("NodeReroute").outputs[0], shader.inputs["Strength"])


def muted_number(tree, kind):
    shader = emission(tree, output(tree, kind).inputs["Surface"], 0.25)
    node(tree, "Math", shader.inputs["Strength"]).mute = True


def muted_output(tree, kind):
    """Blender 5 takes it all the same."""
    made = output(tree, kind)
    emission(tree, made.inputs["Surface"], 0.25)
    made.mute = True


def black_emission(tree, kind):
    node(tree, "Emission", output(tree, kind).inputs["Surface"], Color=(0.0, 0.0, 0.0, 1.0), Strength=5.0)


TREES = [
    *(plain, muted_shader, muted_link, unlinked, eevee_only, cycles_before_all, active_of_two, by_reroutes),
    *(value_node, colour_as_number, colour_as_shader, muted_mix, mix_of_one, sum_of_two, group, empty_group),
    *(a_quarter_of_one, sum_with_itself, mixed_twice),
    *(dangling_reroute, muted_number, muted_output, black_emission),
]


@pytest.mark.parametrize("build", TREES, ids=lambda f: f.__name__)
@pytest.mark.parametrize("kind", ["Material", "World"])
def test_what_shines_is_what_cycles_renders(studio, build, kind):
    """Equal, not nearly: emission that the camera sees has no noise."""
    block = (bpy.data.materials if kind == "Material" else bpy.data.worlds).new("Block")
    build(tree_of(block), kind)
    rendered = studio(**{kind.lower(): block})
    assert nodes.glows(block) == nodes.shines(block) == bool(rendered.any())
    if build is colour_as_shader and bpy.app.version < (5, 0):
        assert nodes.radiance(block) is None
        return
    np.testing.assert_allclose(nodes.radiance(block), rendered, rtol=1e-3)  # luminance differs in the fourth digit
    assert nodes.level(block) == pytest.approx(rendered.mean(), rel=1e-3)
    if kind == "Material":
        np.testing.assert_allclose(nodes.reflector(block).radiance, rendered, rtol=1e-3)


def test_a_mixture_reflects_what_its_parts_do_by_their_shares():
    made = bpy.data.materials.new("Mixed")
    tree = tree_of(made)
    mix = node(tree, "MixShader", output(tree).inputs["Surface"])
    mix.inputs[0].default_value = 0.25
    node(tree, "BsdfDiffuse", mix.inputs[1], Color=(0.8, 0.4, 0.2, 1.0))
    assert nodes.diffuse(made) == pytest.approx((0.6, 0.3, 0.15))
    emission(tree, mix.inputs[2], 2.0)
    assert nodes.diffuse(made) is None
    assert nodes.reflector(made).albedo == pytest.approx((0.6, 0.3, 0.15))
    assert nodes.reflector(made).radiance == pytest.approx((0.5, 0.5, 0.5))
    node(tree, "TexNoise", mix.inputs[0])
    assert nodes.reflector(made) is None


def test_a_mixture_of_a_diffuse_and_a_glossy_shader():
    made = bpy.data.materials.new("Glossy")
    tree = tree_of(made)
    mix = node(tree, "MixShader", output(tree).inputs["Surface"])
    mix.inputs[0].default_value = 0.25
    node(tree, "BsdfDiffuse", mix.inputs[1], Color=(0.8, 0.4, 0.2, 1.0))
    shader = node(tree, "BsdfGlossy", mix.inputs[2], Color=(0.5, 0.6, 0.7, 1.0), Roughness=0.4)
    found = nodes.reflector(made)
    assert nodes.diffuse(made) is None
    assert found.albedo == pytest.approx((0.6, 0.3, 0.15))
    assert found.glossy.colour == pytest.approx((0.5, 0.6, 0.7))
    assert (found.glossy.share, found.glossy.roughness) == pytest.approx((0.25, 0.4))
    assert found.glossy.multiple, "Blender's own distribution"
    shader.distribution = "GGX"
    assert not nodes.reflector(made).glossy.multiple
    shader.distribution = "BECKMANN"
    assert nodes.reflector(made) is None
    shader.distribution = "GGX"
    shader.inputs["Anisotropy"].default_value = 0.2
    assert nodes.reflector(made) is None


@pytest.mark.parametrize("socket", ["Color", "Roughness", "Normal", "Anisotropy"])
def test_a_glossy_shader_that_varies_is_not_constant(socket):
    made = bpy.data.materials.new("Varying")
    tree = tree_of(made)
    shader = node(tree, "BsdfGlossy", output(tree).inputs["Surface"])
    assert nodes.reflector(made) is not None
    node(tree, "TexNoise", shader.inputs[socket])
    assert nodes.reflector(made) is None


def test_two_glossy_shaders_have_two_roughnesses():
    made = bpy.data.materials.new("Two")
    tree = tree_of(made)
    both = node(tree, "AddShader", output(tree).inputs["Surface"])
    node(tree, "BsdfGlossy", both.inputs[0])
    node(tree, "BsdfGlossy", both.inputs[1])
    assert nodes.reflector(made) is None


def test_the_default_of_old_files_is_dark():
    """Files saved by 2.91 to 3.6 hold black emission of strength 1."""
    made = bpy.data.materials.new("Old")
    tree = tree_of(made)
    shader = node(tree, "BsdfPrincipled", output(tree).inputs["Surface"])
    shader.inputs["Specular IOR Level"].default_value = 0.0
    shader.inputs["Base Color"].default_value = (0.5, 0.25, 0.125, 1.0)
    shader.inputs["Emission Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    shader.inputs["Emission Strength"].default_value = 1.0
    assert not nodes.glows(made)
    assert nodes.diffuse(made) == (0.5, 0.25, 0.125)
    shader.inputs["Emission Color"].default_value = (0.1, 0.0, 0.0, 1.0)
    assert nodes.glows(made)
    assert nodes.diffuse(made) is None


def test_colours_that_are_linked_are_constants_too():
    made = bpy.data.materials.new("Linked")
    tree = tree_of(made)
    shader = node(tree, "BsdfDiffuse", output(tree).inputs["Surface"], Roughness=0.0)
    node(tree, "RGB", shader.inputs["Color"]).outputs[0].default_value = (0.5, 0.25, 0.125, 1.0)
    assert nodes.diffuse(made) == (0.5, 0.25, 0.125)
    node(tree, "TexNoise", shader.inputs["Color"])
    assert nodes.diffuse(made) is None


def test_bumps_are_no_plain_surface():
    made = bpy.data.materials.new("Bumpy")
    tree = tree_of(made)
    shader = node(tree, "BsdfDiffuse", output(tree).inputs["Surface"], Roughness=0.0)
    node(tree, "NormalMap", shader.inputs["Normal"])
    assert nodes.diffuse(made) is None


@pytest.mark.parametrize(
    ("kind", "inputs", "ways"),
    [
        ("BsdfDiffuse", {}, {nodes.DIFFUSE}),
        ("BsdfGlossy", {"Roughness": 0.0}, {nodes.GLOSSY, nodes.MIRROR}),
        ("BsdfGlossy", {"Roughness": 0.3}, {nodes.GLOSSY}),
        ("BsdfGlass", {"Roughness": 0.0}, {nodes.GLOSSY, nodes.TRANSMISSION, nodes.MIRROR}),
        ("BsdfTransparent", {}, {nodes.TRANSPARENT}),
        ("BsdfTranslucent", {}, {nodes.TRANSMISSION}),
        ("Emission", {}, set()),
        ("BsdfPrincipled", {"Metallic": 1.0, "Roughness": 0.0}, {nodes.DIFFUSE, nodes.GLOSSY, nodes.MIRROR}),
        ("BsdfPrincipled", {"Specular IOR Level": 0.0, "Alpha": 0.5}, {nodes.DIFFUSE, nodes.TRANSPARENT}),
        ("BsdfRayPortal", {}, {nodes.UNKNOWN}),
    ],
)
def test_ways_of_reflecting(kind, inputs, ways):
    made = bpy.data.materials.new("Way")
    tree = tree_of(made)
    node(tree, kind, output(tree).inputs["Surface"], **inputs)
    assert nodes.kinds(made) == ways


def test_a_roughness_that_nobody_knows_may_be_a_mirror():
    made = bpy.data.materials.new("Texture")
    tree = tree_of(made)
    shader = node(tree, "BsdfGlossy", output(tree).inputs["Surface"])
    node(tree, "TexNoise", shader.inputs["Roughness"])
    assert nodes.MIRROR in nodes.kinds(made)


def test_a_dark_world_keeps_its_fog():
    made = bpy.data.worlds.new("Fog")
    tree = tree_of(made)
    end = output(tree, "World")
    node(tree, "Background", end.inputs["Surface"], Color=WHITE, Strength=2.0)
    node(tree, "VolumeScatter", end.inputs["Volume"])
    dark = nodes.darkened(made)
    assert nodes.level(made) == 2.0
    assert nodes.level(dark) == 0.0
    assert [part.kind for part in nodes.read(dark).volume] == ["VOLUME_SCATTER"]
