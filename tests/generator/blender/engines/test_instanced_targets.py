"""A target that shows instances gives the pictures of the object that it shows, in every pose."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
import walls
from mathutils import Matrix

from generator.blender import check
from generator.blender.engines import renderers, survey
from generator.blender.finding import ERROR
from generator.blender.scene import adopt, blend_file, build, geometry, posing, roles, varying
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.variation import Variation

POSES = [((1.55, 1.15, 1.3), (0.0, 0.0, 0.0)), ((1.3, 0.9, 1.1), (20.0, -15.0, 60.0))]


def built(show=None):
    scene = blend_file.new_file()
    build.build(scene, preset("room"))
    if show is not None:
        shown = roles.find(scene, "target")
        place = shown.location.copy()
        del shown[roles.ROLE]
        shown.location = (0.0, 0.0, 0.0)
        target = show(scene, shown)
        target.location = place
        bpy.context.view_layer.update()
        adopt.assign(scene, "target", [target])
    return scene


def linked(scene, name, data=None, parent=None):
    obj = bpy.data.objects.new(name, data)
    obj.parent = parent
    scene.collection.objects.link(obj)
    return obj


def library_of(name, *objects):
    """Put objects into a collection that is in no scene."""
    library = bpy.data.collections.new(name)
    for obj in objects:
        for collection in obj.users_collection:
            collection.objects.unlink(obj)
        library.objects.link(obj)
    return library


def instancing(obj, library):
    obj.instance_type, obj.instance_collection = "COLLECTION", library
    return obj


def of_a_collection(scene, shown):
    return instancing(linked(scene, "Statue"), library_of("Library", shown))


def of_a_collection_of_instances(scene, shown):
    """Scaled by a half and by two again, and moved by an offset that the collection has too."""
    shown.scale, shown.location = (0.5, 0.5, 0.5), (0.1, 0.2, 0.3)
    inner = library_of("Inner", shown)
    inner.instance_offset = shown.location
    statue = instancing(linked(scene, "Statue"), library_of("Outer", instancing(linked(scene, "Part"), inner)))
    statue.scale = (2.0, 2.0, 2.0)
    return statue


def of_a_child(scene, shown):
    parent = linked(scene, "Statue")
    instancing(linked(scene, "Part", parent=parent), library_of("Library", shown))
    return parent


def dot(scene):
    mesh = bpy.data.meshes.new("Dot")
    mesh.from_pydata([(0.0, 0.0, 0.0)], [], [])
    return linked(scene, "Statue", mesh)


def on_vertices(scene, shown):
    carrier = dot(scene)
    carrier.instance_type, carrier.show_instancer_for_render = "VERTS", False
    shown.parent = carrier
    return carrier


def on_faces(scene, shown):
    bpy.ops.mesh.primitive_plane_add(size=0.1)
    carrier = bpy.context.object
    carrier.name = "Statue"
    carrier.instance_type, carrier.show_instancer_for_render = "FACES", False
    shown.parent = carrier
    return carrier


def by_geometry_nodes(scene, shown):
    shown.hide_render = True
    carrier = dot(scene)
    group = bpy.data.node_groups.new("Show", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    read, output = group.nodes.new("GeometryNodeObjectInfo"), group.nodes.new("NodeGroupOutput")
    read.inputs["Object"].default_value, read.inputs["As Instance"].default_value = shown, True
    group.links.new(read.outputs["Geometry"], output.inputs[0])
    carrier.modifiers.new("Show", "NODES").node_group = group
    return carrier


WAYS = [of_a_collection, of_a_collection_of_instances, of_a_child, on_vertices, on_faces, by_geometry_nodes]


def pictures(scene):
    """Pictures without the target and of two poses, by `surfel` and by `patch`."""
    with renderers.opened(scene, "surfel", resolution=(8, 8)) as renderer:
        found = [renderer.render(target=False), renderer.render(), *(renderer.at(*pose) for pose in POSES)]
    with renderers.opened(scene, "patch", resolution=(8, 8)) as renderer, posing.put_back(scene):
        found += [renderer.render(samples=16, seed=5, target=False), renderer.render(samples=16, seed=5)]
        for pose in POSES:
            posing.move_target(scene, *pose)
            found.append(renderer.render(samples=16, seed=5))
    return np.array(found)


@pytest.fixture(scope="module")
def wanted():
    return pictures(built())


@pytest.mark.parametrize("way", WAYS)
def test_instances_are_rendered_and_move_as_the_object_that_they_show(wanted, way):
    scene = built(way)
    assert roles.find(scene, "target").name == "Statue"
    assert not [f.text for f in check.findings(scene, engine="surfel") if f.level == ERROR]
    np.testing.assert_allclose(pictures(scene), wanted, rtol=1e-4)
    assert len({picture.tobytes() for picture in wanted}) == len(wanted) - 2  # the first pose is where it stands
    assert np.ptp(geometry.hull(scene), axis=0) == pytest.approx((0.5, 0.0, 0.5), abs=1e-5)


def test_the_albedo_of_instances_does_not_vary():
    for way in (of_a_collection, by_geometry_nodes):
        with pytest.raises(NlosError, match="'Statue' shows instances of 'Target'"):
            varying.Varying(built(way), [Variation("target.albedo", 0.2, 0.9)])


def test_a_lamp_among_the_instances_is_named():
    def with_lamp(scene, shown):
        bulb = linked(scene, "Bulb", bpy.data.lights.new("Bulb", "POINT"))
        return instancing(linked(scene, "Statue"), library_of("Library", shown, bulb))

    assert "the light 'Bulb' moves when the target does" in survey.survey(built(with_lamp)).never


def test_a_scene_in_centimetres_with_a_rig_and_a_room_of_one_mesh_is_adopted():
    def surfel(scene):
        with renderers.opened(scene, "surfel", resolution=(8, 8)) as renderer:
            return np.array([renderer.render(target=False), renderer.render()])

    scene = built(on_faces)
    walls.joined(scene)
    wanted = surfel(scene)
    rig, lens = linked(scene, "Rig"), roles.find(scene, "camera").data
    for role in ("spot", "camera"):
        roles.find(scene, role).parent = rig
    turn = Matrix.Translation((300.0, 100.0, 20.0)) @ Matrix.Rotation(1.1, 4, "Z") @ Matrix.Scale(100.0, 4)
    for obj in [o for o in scene.objects if o.parent is None]:
        obj.matrix_basis = turn @ obj.matrix_basis
    lens.clip_start, lens.clip_end, lens.dof.focus_distance = 100.0 * lens.clip_start, 100.0 * lens.clip_end, 300.0
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", 0.01
    bpy.context.view_layer.update()
    assert [f.fix for f in check.findings(scene) if f.level == ERROR] == ["metres", "align"]
    for fix in ("metres", "align"):
        check.mend(scene, fix)
    assert lens.dof.focus_distance == pytest.approx(3.0)
    np.testing.assert_allclose(surfel(scene), wanted, rtol=1e-4)
