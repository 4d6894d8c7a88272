"""The relay plane is the face that the lamp's axis meets first, whatever the rest of the relay wall is."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
import walls
from mathutils import Matrix

from generator.blender import check
from generator.blender.finding import ERROR
from generator.blender.scene import adopt, blend_file, build, clearance, geometry, outlines, relay, roles, varying
from generator.blender.scene.description import read_scene
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.variation import Variation


def built(edit=lambda scene: None):
    scene = blend_file.new_file()
    build.build(scene, preset("room"))
    edit(scene)
    bpy.context.view_layer.update()
    return scene


def wall_of(scene):
    return roles.find(scene, "relay_wall")


def in_a_rig(scene):
    """Put the slab below two parents, moved, turned and scaled by an uneven and a negative scale."""
    wall = walls.slab(scene)
    outer, inner = (bpy.data.objects.new(name, None) for name in ("Outer", "Inner"))
    for parent in (outer, inner):
        scene.collection.objects.link(parent)
    outer.location, outer.scale = (1.0, 2.0, 3.0), (2.0, 2.0, 2.0)
    inner.parent, inner.rotation_euler = outer, (0.3, 0.2, 0.1)
    wall.parent = inner
    wall.scale = (-2.0, 0.5, 1.0)
    bpy.context.view_layer.update()
    wall.data.transform(wall.matrix_world.inverted())


def thickened(scene):
    """Give the sheet a thickness by a modifier, which only renders apply."""
    solid = wall_of(scene).modifiers.new("Thick", "SOLIDIFY")
    solid.thickness, solid.offset, solid.show_viewport = 0.1, -1.0, False


def instanced(scene):
    """Make an empty that instances a collection the relay wall."""
    wall, library = walls.slab(scene), bpy.data.collections.new("Library")
    for collection in wall.users_collection:
        collection.objects.unlink(wall)
    library.objects.link(wall)
    empty = bpy.data.objects.new("Building", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", library
    scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    adopt.assign(scene, "relay_wall", [empty])


def many_triangles(scene):
    """Cut the wall into many coplanar triangles that share no corners."""
    walls.slab(scene)
    wall = wall_of(scene)
    for name, kind in (("Cut", "SUBSURF"), ("Apart", "EDGE_SPLIT"), ("Triangles", "TRIANGULATE")):
        modifier = wall.modifiers.new(name, kind)
        if kind == "SUBSURF":
            modifier.subdivision_type, modifier.levels, modifier.render_levels = "SIMPLE", 3, 3
        if kind == "EDGE_SPLIT":
            modifier.split_angle = 0.0


def flipped(scene):
    walls.slab(scene).data.flip_normals()


def flipped_in_part(scene):
    wall = walls.slab(scene)
    wall.data.polygons[0].flip()


SHAPES = {
    "slab": walls.slab,
    "room of one mesh": walls.joined,
    "opening elsewhere": lambda scene: walls.with_opening(scene, x=(1.5, 2.0), z=(0.5, 1.0)),
    "parents, uneven and negative scale": in_a_rig,
    "modifier": thickened,
    "instance": instanced,
    "many triangles": many_triangles,
    "flipped normals": flipped,
    "one flipped normal": flipped_in_part,
}


@pytest.mark.parametrize("name", SHAPES)
def test_the_relay_plane_of_any_object_is_that_of_the_sheet(name):
    sheet = read_scene(built())
    scene = built(SHAPES[name])
    described = read_scene(scene)
    for part in ("x", "z"):
        np.testing.assert_allclose(getattr(described.wall, part), getattr(sheet.wall, part), atol=1e-5)
    assert described.wall.albedo == sheet.wall.albedo
    assert described.spot == sheet.spot
    plane = relay.find(scene, geometry.snapshot(scene))
    np.testing.assert_allclose(plane.normal, (0.0, 1.0, 0.0), atol=1e-6)
    assert not [f.text for f in check.findings(scene) if f.level == ERROR]
    # Overlay and poses follow.
    np.testing.assert_allclose(outlines.watched(scene)[:, 1], 0.0, atol=1e-6)
    is_free = clearance.clearance(scene, described, engine="surfel")
    assert is_free((1.55, 1.15, 1.3), (0.0, 0.0, 0.0))
    assert not is_free((1.55, 0.0, 1.3), (20.0, 0.0, 0.0)), "the wall is a surface"


@pytest.mark.parametrize("name", ["slab", "room of one mesh", "instance"])
def test_align_puts_the_lit_face_at_y_0(name):
    scene = built(SHAPES[name])
    before = read_scene(scene)
    away = Matrix.Translation((3.0, -5.0, 0.4)) @ Matrix.Rotation(2.2, 4, "Z")
    for obj in [o for o in scene.objects if o.parent is None]:
        obj.matrix_world = away @ obj.matrix_world
    bpy.context.view_layer.update()
    [found] = [f for f in check.findings(scene) if f.fix == "align"]
    assert found.object == wall_of(scene).name
    check.mend(scene, "align")
    after = read_scene(scene)
    # x begins in the middle of the lit face, and heights stay.
    middle = np.mean(before.wall.x)
    np.testing.assert_allclose(np.add(after.wall.x, middle), before.wall.x, atol=1e-4)
    np.testing.assert_allclose(after.spot.aim, np.add(before.spot.aim, (-middle, 0.0, 0.4)), atol=1e-4)
    np.testing.assert_allclose(after.camera.x, np.add(before.camera.x, -middle), atol=1e-4)


def test_a_wall_that_is_lit_from_behind_is_turned():
    scene = built()
    for obj in [o for o in scene.objects if o.parent is None]:
        obj.matrix_world = Matrix.Rotation(math.pi, 4, "Z") @ obj.matrix_world
    bpy.context.view_layer.update()
    assert [f.fix for f in check.findings(scene) if f.level == ERROR] == ["align"]
    check.mend(scene, "align")
    assert read_scene(scene).spot.location[1] == pytest.approx(3.0, abs=1e-4)


def panel(scene, y, x=(-1.2, 0.1), z=(0.6, 2.0)):
    """Add a panel before the wall to its mesh."""
    wall = wall_of(scene)
    corners = [(x[0], y, z[0]), (x[1], y, z[0]), (x[1], y, z[1]), (x[0], y, z[1])]
    vertices = [tuple(v.co) for v in wall.data.vertices]
    faces = [tuple(p.vertices) for p in wall.data.polygons]
    walls.shape(scene, [*vertices, *corners], [*faces, tuple(range(len(vertices), len(vertices) + 4))])


def bent(scene):
    """Let the wall recede at x = 0.15, between what the camera sees and what the lamp lights."""
    (low, high), (bottom, top) = preset("room").wall.x, preset("room").wall.z
    points = [(low, -0.3), (0.15, -0.3), (0.15, 0.0), (high, 0.0)]
    vertices = [(x, y, z) for z in (bottom, top) for x, y in points]
    walls.shape(scene, vertices, [(i, i + 1, i + 5, i + 4) for i in range(3)])


def aim_at_the_floor(scene):
    walls.joined(scene)
    roles.find(scene, "camera").rotation_euler = (0.6, 0.0, math.pi)


def aim_beside(scene):
    roles.find(scene, "spot").rotation_euler = (0.0, 0.0, 0.0)


def box(at):
    def add(scene):
        bpy.ops.mesh.primitive_cube_add(size=0.1, location=at)
        bpy.context.object.name = "Books"

    return add


def axis_point(scene, role, share):
    """Return a point between an object with a role and where it looks."""
    described = read_scene(scene)
    if role == "spot":
        start, end = np.array(described.spot.location), np.array(described.spot.aim)
    else:
        start = np.array(described.camera.location)
        end = np.array([np.mean(described.camera.x), 0.0, np.mean(described.camera.z)])
    return tuple(start + share * (end - start))


def before(role):
    return lambda scene: box(axis_point(scene, role, 0.5))(scene)


REFUSED = {
    "panel 1 mm before the wall": (
        lambda scene: panel(scene, 1e-3),
        "lights one face of the relay wall 'Relay wall' and the camera 'Camera' looks at another, 0.001 m apart",
    ),
    "two levels": (bent, "'Camera' looks at another, 0.3 m apart; both must look at faces in one plane"),
    "camera at the floor of the same mesh": (aim_at_the_floor, "looks at another, at 90 degrees to one another"),
    "lamp elsewhere": (aim_beside, "the spot 'Spot' does not point at the relay wall 'Relay wall'"),
    "lamp through an opening": (
        lambda scene: walls.with_opening(scene, x=(0.1, 0.5), z=(1.0, 1.6)),
        "the spot 'Spot' does not point at the relay wall 'Relay wall': its axis meets none of its faces",
    ),
    "camera through an opening": (
        lambda scene: walls.with_opening(scene, x=(-0.6, -0.3), z=(1.0, 1.6)),
        "the camera 'Camera' does not look at the relay wall 'Relay wall': in the middle of its picture there is n",
    ),
    "before the lamp": (before("spot"), "the spot 'Spot' shines on 'Books' before it meets the relay wall"),
    "before the camera": (before("camera"), "the camera 'Camera' looks at 'Books', not at the relay wall"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_ambiguous_is_refused_by_name(name):
    edit, words = REFUSED[name]
    scene = built(edit)
    with pytest.raises(NlosError, match=words):
        read_scene(scene)
    found = [f for f in check.findings(scene) if f.level == ERROR]
    assert any(words in f.text for f in found), found
    assert any(f.object for f in found)


def test_what_the_camera_clips_or_does_not_see_stands_in_no_way():
    scene = built()
    at = axis_point(scene, "camera", 0.1)
    box(at)(scene)
    bpy.context.object.visible_camera = False
    read_scene(scene)
    bpy.context.object.visible_camera = True
    with pytest.raises(NlosError, match="looks at 'Books'"):
        read_scene(scene)
    roles.find(scene, "camera").data.clip_start = 1.0
    read_scene(scene)


def test_a_face_is_plane_to_a_tenth_of_a_millimetre():
    def uneven(scene):
        corners = walls.world_corners(wall_of(scene))
        corners[0, 1] += 1e-4
        walls.shape(scene, corners, [(0, 1, 2, 3)])

    scene = built(uneven)
    plane = relay.find(scene, geometry.snapshot(scene))
    assert plane.faces.all()
    assert not plane.in_frame  # by 30 micrometres
    check.mend(scene, "align")
    assert read_scene(scene).wall.x == pytest.approx((-2.5, 2.5), abs=1e-3)


def test_the_albedo_is_that_of_the_lit_face():
    def painted(scene):
        wall = walls.joined(scene)
        for material in wall.data.materials[1:]:
            material.node_tree.nodes["Diffuse BSDF"].inputs["Color"].default_value = (0.3, 0.3, 0.3, 1.0)

    assert read_scene(built(painted)).wall.albedo == 0.8


def test_the_albedo_of_a_wall_varies_only_where_the_wall_is_all():
    vary = Variation("wall.albedo", 0.2, 0.9)
    varying.Varying(built(walls.slab), [vary])
    for edit, words in ((walls.joined, "is more than the wall"), (instanced, "shows instances of 'Relay wall'")):
        with pytest.raises(NlosError, match=words):
            varying.Varying(built(edit), [vary])
