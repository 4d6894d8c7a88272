"""`patch` and `surfel` make the first reflection of what is lit, as Cycles renders it, or say why they cannot."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from nodetrees import WHITE, bare, node, output, paint, tree_of
from radiometry import floor_room

from generator.blender.engines import coincident, renderers, survey
from generator.blender.engines.shapes import softener
from generator.blender.scene import materials, posing, roles
from generator.model.errors import NlosError

SAMPLES, SEEDS = 16384, 6
SIGMAS = 4.5
"""By chance beyond it once in 100,000."""


def slow(*case):
    """A case of a test whose other cases are enough for `make test`."""
    return pytest.param(*case, marks=pytest.mark.slow)


def means(scene, engine, *, samples=SAMPLES):
    """Mean radiance over picture and seeds, and its standard error."""
    bpy.context.view_layer.update()
    with renderers.opened(scene, engine, resolution=(4, 4)) as renderer:
        if engine == "surfel":
            return float(renderer.render().mean()), 0.0
        found = [float(renderer.render(samples=samples, seed=seed + 1).mean()) for seed in range(SEEDS)]
    return float(np.mean(found)), float(np.std(found, ddof=1) / math.sqrt(SEEDS))


def agree(scene, *others, within=0.1, samples=SAMPLES):
    """Whether engines agree with plain path tracing, and the test could have seen a difference of ``within``."""
    true, error = means(scene, "path", samples=samples)
    assert error < within / SIGMAS * true, f"{true} +- {error} shows nothing"
    for engine in others:
        mean, own = means(scene, engine, samples=samples)
        assert abs(mean - true) <= SIGMAS * math.hypot(error, own), (engine, mean, own, true, error)


def refused(scene, words, *names):
    bpy.context.view_layer.update()
    found = survey.survey(scene)
    for engine in names:
        with pytest.raises(NlosError, match=words):
            found.check(engine)
    found.check("path")


def wall(scene):
    return roles.find(scene, "relay_wall")


def target(scene):
    return roles.find(scene, "target")


def spot(scene):
    return roles.find(scene, "spot")


def grey(name, value):
    made = bpy.data.materials.new(name)
    tree = tree_of(made)
    node(tree, "BsdfDiffuse", output(tree).inputs["Surface"], Color=(value, value, value, 1.0), Roughness=0.0)
    return made


def material_by_geometry_nodes(scene):
    tree = bpy.data.node_groups.new("Paint", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    paints = tree.nodes.new("GeometryNodeSetMaterial")
    paints.inputs["Material"].default_value = grey("Painted", 0.3)
    tree.links.new(tree.nodes.new("NodeGroupInput").outputs[0], paints.inputs["Geometry"])
    tree.links.new(paints.outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0])
    wall(scene).modifiers.new("Paint", "NODES").node_group = tree


def second_output_for_cycles(scene):
    tree = wall(scene).data.materials[0].node_tree
    first = tree.get_output_node("ALL")
    node(
        tree, "BsdfDiffuse", output(tree, target="CYCLES").inputs["Surface"], Color=(0.3,) * 3 + (1.0,), Roughness=0.0
    )
    first.is_active_output = True


def material_of_the_object(scene):
    """Another object has the same mesh, and shows what the mesh itself is made of."""
    other = bpy.data.objects.new("Twin", wall(scene).data)
    other.location = (0.0, -5.0, 0.0)
    scene.collection.objects.link(other)
    slot = wall(scene).material_slots[0]
    slot.link, slot.material = "OBJECT", grey("Own", 0.3)


def colour_of_a_node(scene):
    tree = wall(scene).data.materials[0].node_tree
    shader = tree.nodes["Diffuse BSDF"]
    node(tree, "RGB", shader.inputs["Color"]).outputs[0].default_value = (0.3, 0.3, 0.3, 1.0)


def two_colours(scene):
    """Lit is what the spot lights, and watched another one; the spot's half is darker."""
    mesh = bpy.data.meshes.new("Halves")
    corners = [(-1, 0, -1), (0.0, 0, -1), (0.0, 0, 1), (-1, 0, 1), (1, 0, -1), (1, 0, 1)]
    mesh.from_pydata(corners, [], [(0, 3, 2, 1), (1, 2, 5, 4)])
    mesh.materials.append(wall(scene).data.materials[0])
    mesh.materials.append(grey("Lit", 0.3))
    mesh.polygons[1].material_index = 1
    wall(scene).data = mesh
    spot(scene).location.x = spot(scene).location.x + 0.1


def constant_lamp_nodes(scene):
    tree = tree_of(spot(scene).data)
    node(tree, "Emission", output(tree, "Light").inputs["Surface"], Color=(0.5, 1.0, 0.25, 1.0), Strength=3.0)


def target_that_glowed_in_old_blenders(scene):
    tree = paint(target(scene), "BsdfPrincipled", Alpha=1.0)
    shader = tree.nodes["Principled BSDF"]
    shader.inputs["Specular IOR Level"].default_value = 0.0
    shader.inputs["Emission Color"].default_value, shader.inputs["Emission Strength"].default_value = (
        (0, 0, 0, 1),
        1.0,
    )


@pytest.mark.parametrize(
    "edit",
    [
        *(material_by_geometry_nodes, constant_lamp_nodes),
        *(slow(edit) for edit in (second_output_for_cycles, material_of_the_object, colour_of_a_node)),
        *(slow(edit) for edit in (two_colours, target_that_glowed_in_old_blenders)),
    ],
    ids=lambda f: f.__name__,
)
def test_the_lit_wall_is_as_a_render_sees_it(edit):
    scene = bare()
    edit(scene)
    agree(scene, "patch", "surfel", within=0.2)


def muted_lamp(tree):
    node(tree, "Emission", output(tree, "Light").inputs["Surface"]).mute = True


def unlinked_lamp(tree):
    node(tree, "Emission")
    output(tree, "Light")


def lamp_of_eevee(tree):
    node(tree, "Emission", output(tree, "Light", "EEVEE").inputs["Surface"])


def black_lamp(tree):
    node(tree, "Emission", output(tree, "Light").inputs["Surface"], Color=(0.0, 0.0, 0.0, 1.0), Strength=1.0)


@pytest.mark.parametrize("build", [muted_lamp, unlinked_lamp, lamp_of_eevee, black_lamp], ids=lambda f: f.__name__)
def test_a_spot_that_gives_no_light_gives_none(build):
    scene = bare()
    build(tree_of(spot(scene).data))
    assert [means(scene, engine, samples=64)[0] for engine in renderers.ENGINES] == [0.0, 0.0, 0.0]


def sky_of_eevee(scene):
    tree = tree_of(scene.world)
    node(tree, "Background", output(tree, "World", "EEVEE").inputs["Surface"], Color=WHITE, Strength=5.0)


def sky_muted(scene):
    tree = tree_of(scene.world)
    node(tree, "Background", output(tree, "World").inputs["Surface"], Color=WHITE, Strength=5.0).mute = True


@pytest.mark.parametrize("edit", [sky_of_eevee, sky_muted], ids=lambda f: f.__name__)
def test_a_sky_that_does_not_count_counts_nothing(edit):
    scene = bare()
    true = [means(scene, engine, samples=64)[0] for engine in renderers.ENGINES]
    edit(scene)
    assert [means(scene, engine, samples=64)[0] for engine in renderers.ENGINES] == true
    assert materials.ambient(scene) == 0.0


def test_a_sky_of_emission_is_a_sky():
    scene = bare()
    tree = tree_of(scene.world)
    node(tree, "Emission", output(tree, "World").inputs["Surface"], Color=(0.5, 0.25, 1.0, 1.0), Strength=0.01)
    assert materials.ambient(scene) == pytest.approx(0.01 * 1.75 / 3.0)
    np.testing.assert_allclose(survey.surfel_world(scene).ambient.radiance, (0.005, 0.0025, 0.01), rtol=1e-6)


def invisible(flag):
    def edit(scene):
        setattr(wall(scene), flag, False)

    return edit


def custom_normals(scene):
    wall(scene).data.normals_split_custom_set([(0.5, 0.7, 0.5)] * len(wall(scene).data.loops))


def fog(scene):
    end = scene.world.node_tree.get_output_node("CYCLES")
    node(scene.world.node_tree, "VolumeAbsorption", end.inputs["Volume"])


def foggy_box(scene):
    bpy.ops.mesh.primitive_cube_add(size=0.2, location=(0.9, 1.5, 0.9))
    made = bpy.data.materials.new("Smoke")
    tree = tree_of(made)
    node(tree, "VolumeScatter", output(tree).inputs["Volume"])
    bpy.context.object.data.materials.append(made)


def terminator(scene):
    obj = wall(scene)
    new = "shadow_terminator_shading_offset"
    owner, name = (obj, new) if hasattr(obj, new) else (obj.cycles, "shadow_terminator_offset")
    setattr(owner, name, 0.8)


def painted_over(scene):
    scene.view_layers[0].material_override = grey("All", 0.3)


def spot_instanced(scene):
    """The second one is hidden with the first."""
    held = bpy.data.collections.new("Held")
    held.objects.link(spot(scene))
    empty = bpy.data.objects.new("Again", None)
    empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", held, (-0.2, 0.0, 0.0)
    scene.collection.objects.link(empty)


def glossy(roughness):
    return lambda scene: paint(target(scene), "BsdfGlossy", Color=WHITE, Roughness=roughness)


def glossy_without_bounces(scene):
    glossy(0.5)(scene)
    scene.cycles.glossy_bounces = 0


def glossy_beyond_diffuse(scene):
    glossy(0.5)(scene)
    scene.cycles.max_bounces, scene.cycles.diffuse_bounces, scene.cycles.glossy_bounces = 4, 2, 4


def leaves_without_bounces(scene):
    paint(target(scene), "BsdfTranslucent", Color=WHITE)
    scene.cycles.transmission_bounces = 0


def veils(scene):
    """More than the limit of transparent bounces lets through."""
    for y in (0.3, 0.5):
        bpy.ops.mesh.primitive_plane_add(size=0.2, location=(0.9, y, 0.9), rotation=(math.pi / 2.0, 0.0, 0.0))
        paint(bpy.context.object, "BsdfTransparent", Color=WHITE)
    scene.cycles.transparent_max_bounces = 5


def half_seen(scene):
    target(scene).visible_shadow = False


def mirror_and_bulb(scene):
    glossy(0.0)(scene)
    bulb(scene)


def bulb(scene, data=None, x=0.0):
    lamp = bpy.data.objects.new("Bulb", data or bpy.data.lights.new("Bulb", "POINT"))
    lamp.location = (x, 0.6, 0.6)
    lamp.data.energy = lamp.data.energy if data else 0.05
    scene.collection.objects.link(lamp)
    return lamp


REFUSED = {
    "no diffuse": (invisible("visible_diffuse"), "'Relay wall' is not visible to diffuse rays"),
    "no glossy": (invisible("visible_glossy"), "'Relay wall' is not visible to glossy rays"),
    "custom normals": (custom_normals, "'Relay wall' is shaded smooth"),
    "fog": (fog, "the world .* is filled with a volume"),
    "foggy box": (foggy_box, "'Cube' is filled with a volume"),
    "terminator": (terminator, "'Relay wall' has a shadow terminator offset"),
    "override": (painted_over, "puts one material in place of all"),
    "spot twice": (spot_instanced, "the lamp 'Spot' shines once more, as an instance"),
    "glossy 0": (glossy_without_bounces, "'Target' has a glossy material, and the limit of glossy bounces"),
    "glossy 4": (glossy_beyond_diffuse, "'Target' has a glossy material, and the limit of diffuse bounces"),
    "leaves": (leaves_without_bounces, "'Target' has a transmission material, and the limit of transmission bounces"),
    "veils": (veils, "'Plane' is transparent, and light may cross more such faces"),
    "half seen": (half_seen, "'Target' is not visible to shadow rays, and is to others"),
    "mirror": (mirror_and_bulb, "'Target' may reflect like a mirror while 'Bulb' shines too"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_the_first_reflection_cannot_honour_is_refused_by_name(name):
    edit, words = REFUSED[name]
    scene = bare()
    edit(scene)
    refused(scene, words, "patch", "surfel")
    assert renderers.choose(scene)[0] == "path"


@pytest.mark.parametrize("order", [3, slow(5)])
def test_a_mirror_is_seen(order):
    """By way of the floor too: its paths are as long as the scene allows, and no longer."""
    scene = bare(room=floor_room())
    roles.limit_reflections(scene, order)
    paint(target(scene), "BsdfGlossy", Color=WHITE, Roughness=0.0)
    agree(scene, "patch")
    assert renderers.choose(scene)[0] == "patch"


@pytest.mark.parametrize(("kind", "order"), [("BsdfGlass", 6), slow("BsdfRefraction", 5), slow("BsdfMetallic", 4)])
def test_what_bends_or_throws_light_is_seen(kind, order):
    scene = bare(room=floor_room())
    roles.limit_reflections(scene, order)
    paint(target(scene), kind, Roughness=0.0 if kind != "BsdfMetallic" else 0.2)
    agree(scene, "patch")


@pytest.mark.parametrize(("distribution", "roughness"), [("GGX", 0.6), slow("MULTI_GGX", 1.0), slow("GGX", 0.4)])
def test_a_glossy_target_reflects_as_in_cycles(distribution, roughness):
    """Beside a diffuse part, in a picture by the integral, by path tracing, and by that from the lit patch."""
    scene = bare()
    tree = tree_of(bpy.data.materials.new("Glossy"))
    mix = node(tree, "MixShader", output(tree).inputs["Surface"])
    mix.inputs[0].default_value = 0.75
    node(tree, "BsdfDiffuse", mix.inputs[1], Color=WHITE, Roughness=0.0)
    node(tree, "BsdfGlossy", mix.inputs[2], Color=WHITE, Roughness=roughness).distribution = distribution
    target(scene).data.materials[0] = bpy.data.materials["Glossy"]
    agree(scene, "patch", "surfel", samples=32768)
    assert renderers.choose(scene)[0] == "surfel"


def test_a_mirror_alone_reflects_what_the_closed_form_says():
    """The lit patch seen in a plane mirror: w2 gets its light as from behind the mirror, at twice the distance."""
    scene = bare()
    posing.move_target(scene, (-0.05, 1.0, 0.0), (0.0, 0.0, 0.0))
    target(scene).scale = (30.0, 1.0, 30.0)
    paint(target(scene), "BsdfGlossy", Color=WHITE, Roughness=0.0)
    mean, error = means(scene, "patch", samples=65536)
    lit, view = survey.lit_patch(scene), survey.surfel_world(bare()).watched
    turns, rings = np.meshgrid((np.arange(96) + 0.5) / 96 * 2.0 * np.pi, (np.arange(48) + 0.5) / 48)
    points = (
        lit.centre + (rings * np.cos(turns))[..., None] * lit.major + (rings * np.sin(turns))[..., None] * lit.minor
    )
    area = np.linalg.norm(np.cross(lit.major, lit.minor)) * rings * (1 / 48) * (2.0 * np.pi / 96)
    far = np.linalg.norm(points - lit.lamp, axis=-1)
    power = lit.albedo[0] / np.pi * lit.intensity[0] * lit.height / far**3 * area
    u, v = np.meshgrid((np.arange(8) + 0.5) / 8, (np.arange(8) + 0.5) / 8)
    seen = view.points(np.stack([u, v], axis=-1)).reshape(-1, 3)
    images = points.reshape(-1, 3) * (1.0, -1.0, 1.0) + (0.0, 2.0, 0.0)
    squared = ((seen[:, None] - images[None]) ** 2).sum(axis=-1)
    wanted = 0.8 / np.pi * (power.ravel() * 4.0 / squared**2).sum(axis=1).mean()
    assert error < 0.02 * wanted
    assert abs(mean - wanted) <= SIGMAS * error + 2e-3 * wanted


def instanced_bulb(scene):
    lamp = bulb(scene)
    held = bpy.data.collections.new("Held")
    held.objects.link(lamp)
    scene.collection.objects.unlink(lamp)
    empty = bpy.data.objects.new("There", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", held
    scene.collection.objects.link(empty)


def background_set(scene):
    other = bpy.data.scenes.new("Set")
    lamp = bulb(scene)
    scene.collection.objects.unlink(lamp)
    other.collection.objects.link(lamp)
    scene.background_set = other


def glowing_by_geometry_nodes(scene):
    material_by_geometry_nodes(scene)
    [modifier] = wall(scene).modifiers
    paints = next(n for n in modifier.node_group.nodes if n.type == "SET_MATERIAL")
    made = bpy.data.materials.new("Glow")
    tree = tree_of(made)
    node(tree, "Emission", output(tree).inputs["Surface"], Color=WHITE, Strength=0.05)
    paints.inputs["Material"].default_value = made
    bpy.ops.mesh.primitive_plane_add(size=0.3, location=(0.0, 1.5, 0.6), rotation=(math.pi / 2.0, 0.0, 0.0))
    bpy.context.object.modifiers.new("Paint", "NODES").node_group = modifier.node_group
    wall(scene).modifiers.clear()


def second_spot_of_the_same_data(scene):
    """It is limited to no bounce with the first."""
    lamp = bulb(scene, spot(scene).data)
    lamp.location, lamp.rotation_euler = (-0.4, 1.8, 0.1), (-math.pi / 2.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "edit",
    [instanced_bulb, *map(slow, (background_set, glowing_by_geometry_nodes, second_spot_of_the_same_data))],
    ids=lambda f: f.__name__,
)
def test_other_lights_keep_all_their_reflections(edit):
    """The third of theirs is little of all they give: the floor and a strong target make it tell."""
    scene = bare(room=floor_room())
    spot(scene).data.energy = 1.0
    edit(scene)
    assert len(survey.survey(scene).lights) == 2
    agree(scene, "patch", within=0.03)


def test_smooth_shading_over_coarse_faces_lets_no_light_around():
    """Cycles lets lamps shine around such corners, and no reflected light: the patch is none of its lamps."""
    scene = bare()
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2, radius=0.25)
    ball = bpy.context.object
    ball.data.materials.append(target(scene).data.materials[0])
    ball.data.polygons.foreach_set("use_smooth", [True] * 80)
    target(scene).data = ball.data
    bpy.data.objects.remove(ball)
    owner, name = softener(target(scene))
    pictures = []
    for offset in (0.1, 0.0):
        setattr(owner, name, offset)
        pictures.append(means(scene, "patch", samples=256))
        assert getattr(owner, name) == pytest.approx(offset)
    assert pictures[0] == pictures[1]
    setattr(owner, name, 0.1)
    bulb(scene)
    refused(scene, "'Target' is shaded smooth over coarse faces", "patch")


def copied_in_place(scene):
    obj = target(scene)
    twin = bpy.data.objects.new("Twin", obj.data)
    twin.parent = obj
    scene.collection.objects.link(twin)


def mirrored_onto_itself(scene):
    """Cut into triangles the other way."""
    modifier = target(scene).modifiers.new("Mirror", "MIRROR")
    modifier.use_mirror_merge = False


def half_on(scene):
    mesh = bpy.data.meshes.new("Patch")
    mesh.from_pydata([(0.1, 0, 0.1), (0.4, 0, 0.15), (0.2, 0, 0.5)], [], [(0, 1, 2)])
    mesh.materials.append(target(scene).data.materials[0])
    child = bpy.data.objects.new("Rag", mesh)
    child.parent = target(scene)
    scene.collection.objects.link(child)


def carpet(scene):
    bpy.ops.mesh.primitive_plane_add(size=0.7, location=(0.1, 1.0, -1.0), rotation=(0.0, 0.0, 0.3))
    bpy.context.object.data.materials.append(grey("Carpet", 0.2))


def box(z):
    def edit(scene):
        bpy.ops.mesh.primitive_cube_add(size=0.2, location=(0.5, 1.5, z))
        bpy.context.object.data.materials.append(grey("Box", 0.2))

    return edit


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (copied_in_place, "the target 'Target' and 'Twin', which moves with the target, lie on one another"),
        (mirrored_onto_itself, "parts of the target 'Target' lie on one another"),
        (half_on, "the target 'Target' and 'Rag', which moves with the target, lie on one another"),
        (carpet, "'Floor' and 'Plane' lie on one another"),
        (box(-1.1), "'Floor' and 'Cube' lie on one another"),
    ],
)
def test_what_lies_on_one_another_is_named(edit, words):
    scene = bare(room=floor_room())
    edit(scene)
    bpy.context.view_layer.update()
    reasons = survey.survey(scene).surfel_reasons
    assert len(reasons) == 1
    assert words in reasons[0]


@pytest.mark.parametrize("z", [-0.9, -0.89])
def test_what_stands_on_the_floor_is_fine(z):
    """Its foot and the floor under it see no light."""
    scene = bare(room=floor_room())
    box(z)(scene)
    bpy.context.view_layer.update()
    assert survey.survey(scene).surfel_reasons == []


def test_many_neighbours_are_no_overlap():
    """Nor do they take long: each is compared with those near it only."""
    x, z = np.meshgrid(np.arange(60) / 7.0, np.arange(60) / 7.0)
    a = np.stack([x.ravel(), np.zeros(3600), z.ravel()], axis=1)
    step = np.eye(3) / 7.0
    first = np.stack([a, a + step[0], a + step[0] + step[2]], axis=1)
    second = np.stack([a, a + step[0] + step[2], a + step[2]], axis=1)
    grid = np.concatenate([first, second]).astype(np.float32).astype(np.float64)
    assert len(coincident.overlapping(grid)) == 0
    stray = grid[4321] + 0.3 * step[0]
    found = coincident.overlapping(np.concatenate([grid, stray[None]]))
    assert 4321 in found[:, 0]
    assert set(found[:, 1]) == {len(grid)}


@pytest.mark.parametrize("part", [wall, target])
def test_an_empty_slot_of_the_objects_own_is_refused(part):
    """Cycles takes the mesh's material in Blender 5.0 and its own in 5.2, and Python shows the mesh's in both."""
    scene = bare(room=floor_room())
    part(scene).material_slots[0].link = "OBJECT"
    refused(scene, "empty material slot of its own", "patch", "surfel")
    part(scene).material_slots[0].material = part(scene).data.materials[0]
    bpy.context.view_layer.update()
    survey.survey(scene).check("surfel")
