"""A relay wall of any shape gives the pictures of the sheet that its lit face is: no other face meets the light."""

from __future__ import annotations

import math
from dataclasses import replace

import bpy
import numpy as np
import pytest
import walls

from generator.blender.engines import renderers, survey
from generator.blender.scene import blend_file, build, roles
from generator.model.presets import preset

POSES = [((1.55, 1.15, 1.3), (0.0, 0.0, 0.0)), ((1.2, 0.9, 1.1), (20.0, -15.0, 60.0))]


def built(edit=lambda scene: None, **changes):
    scene = blend_file.new_file()
    build.build(scene, replace(preset("room"), **changes))
    edit(scene)
    bpy.context.view_layer.update()
    return scene


def wide(edit):
    """As an edit, with a spot so wide that plain path tracing finds its light."""

    def widened(scene):
        edit(scene)
        roles.find(scene, "spot").data.spot_size = math.radians(50.0)

    return widened


def thin(scene):
    """Give the sheet a back within the tolerance of its plane, and sides: 0.1 mm."""
    walls.slab(scene, thickness=1e-4)


def opening(scene):
    walls.with_opening(scene, x=(1.5, 2.0), z=(0.5, 1.0))


SHAPES = {"slab": walls.slab, "thin board": thin, "room of one mesh": walls.joined, "opening elsewhere": opening}


def surfel(scene, accuracy=1e-3):
    with renderers.opened(scene, "surfel", resolution=(8, 8), accuracy=accuracy) as renderer:
        return np.array([renderer.render(target=False), *(renderer.at(*pose) for pose in POSES)])


@pytest.fixture(scope="module")
def sheet():
    return surfel(built())


@pytest.mark.parametrize("name", SHAPES)
def test_surfel_gives_the_very_pictures_of_the_sheet(sheet, name):
    np.testing.assert_array_equal(surfel(built(SHAPES[name])), sheet)


@pytest.mark.parametrize("engine", ["patch", "path"])
@pytest.mark.parametrize("name", ["slab", "room of one mesh"])
def test_cycles_gives_the_very_pictures_of_the_sheet(engine, name):
    def pictures(edit):
        with renderers.opened(built(edit), engine, resolution=(8, 8)) as renderer:
            return np.array([renderer.render(samples=64, seed=3, target=target) for target in (True, False)])

    edit = SHAPES[name] if engine == "patch" else wide(SHAPES[name])
    wanted = pictures((lambda scene: None) if engine == "patch" else wide(lambda scene: None))
    assert wanted.mean() > 0.0
    assert (wanted[0] != wanted[1]).any()
    np.testing.assert_allclose(pictures(edit), wanted, rtol=1e-5)


def test_engines_agree_on_a_room_of_one_mesh(sheet):
    with renderers.opened(built(walls.joined), "patch", resolution=(8, 8)) as renderer:
        pictures = np.array([renderer.render(samples=64, seed=seed, target=False) for seed in range(16)])
    means = pictures.mean(axis=(1, 2, 3))
    error = means.std(ddof=1) / math.sqrt(len(means))
    assert error < 0.02 * means.mean()
    assert abs(means.mean() - sheet[0].mean()) < 4.0 * error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes"), [("slab", {"ambient": 1e-3}), ("room of one mesh", {"reflection_order": 4})]
)
def test_light_that_is_followed_on_is_that_of_the_sheet(name, changes):
    wanted = surfel(built(**changes), accuracy=1e-2)
    np.testing.assert_allclose(surfel(built(SHAPES[name], **changes), accuracy=1e-2), wanted, rtol=1e-3)


def plate(at, *, joined):
    """Add a plate of 4 by 4 cm to the scene or to the wall's mesh."""

    def add(scene):
        x, y, z = at
        corners = [(x + a, y, z + c) for a, c in ((-0.02, -0.02), (0.02, -0.02), (0.02, 0.02), (-0.02, 0.02))]
        wall = roles.find(scene, "relay_wall")
        if joined:
            vertices, faces = walls.world_corners(wall).tolist(), [(0, 1, 2, 3), (4, 5, 6, 7)]
            walls.shape(scene, vertices + corners, faces)
            return
        mesh = bpy.data.meshes.new("Plate")
        mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
        mesh.materials.append(wall.data.materials[0])
        scene.collection.objects.link(bpy.data.objects.new("Plate", mesh))

    return add


def hole(scene):
    """Leave a window in the sheet that takes away a part of the lit patch, beside its middle."""
    walls.with_opening(scene, x=(0.33, 0.6), z=(1.0, 1.6))


REFUSED = {
    # The lamp that stands for the patch is less than that before the wall.
    "plate 0.2 mm before the patch": (plate((0.34, 2e-4, 1.3), joined=False), "'Plate' stands in the cone"),
    "the same of the wall's mesh": (
        plate((0.34, 2e-4, 1.3), joined=True),
        "another face of the relay wall 'Relay wall' stands in the cone of the spot 'Spot'",
    ),
    "hole in the patch": (hole, "part of the cone of the spot 'Spot' misses the plane of the relay wall"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_disturbs_the_lit_patch_is_left_to_path(name):
    edit, words = REFUSED[name]
    scene = built(edit)
    found = survey.survey(scene)
    assert not found.never
    assert any(words in reason for reason in found.reasons("patch")), found.reasons("patch")
    assert any(words in reason for reason in found.reasons("surfel"))
    assert renderers.choose(scene, found)[0] == "path"


def test_light_of_other_faces_is_light_of_the_room():
    def edit(scene):
        wall = walls.joined(scene)
        ceiling = wall.data.materials[2].copy()
        tree = ceiling.node_tree
        shader, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes["Material Output"]
        tree.links.new(shader.outputs[0], output.inputs["Surface"])
        wall.data.materials[2] = ceiling

    found = survey.survey(built(edit))
    assert not found.reasons("surfel")
    assert [(light.name, light.role) for light in found.lights if not light.is_spot] == [("Relay wall", "room")]
    assert len(found.world.emitters.triangles) == 4  # two, on both sides


def test_what_is_wrong_with_other_faces_is_said_of_them():
    def edit(scene):
        wall = walls.joined(scene)
        floor = wall.data.materials[1].copy()
        floor.node_tree.nodes.new("ShaderNodeBsdfGlossy").name = "Shine"
        tree = floor.node_tree
        output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
        tree.links.new(tree.nodes["Shine"].outputs[0], output.inputs["Surface"])
        wall.data.materials[1] = floor

    found = survey.survey(built(edit))
    assert not found.reasons("patch")  # which needs only the lit face to be diffuse
    assert any(r.startswith("another face of the relay wall 'Relay wall' has") for r in found.reasons("surfel"))
