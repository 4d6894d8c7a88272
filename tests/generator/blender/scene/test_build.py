"""What is built is what is read back, what an artist changes is what counts, and bad scenes are named."""

from __future__ import annotations

from dataclasses import replace

import bpy
import mathutils
import numpy as np
import pytest
import radiometry
from conftest import ROOT

from generator.blender.engines import renderers, survey
from generator.blender.engines.devices import require_gpu
from generator.blender.scene import blend_file, build, geometry, posing, roles
from generator.blender.scene.clearance import clearance
from generator.blender.scene.description import read_scene
from generator.files import meshes
from generator.files.toml import from_dict, to_dict
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.presets import preset
from generator.model.scene import Scene, Target, _leaves
from generator.transport import Sphere

PRESETS = ["room", "tabletop", "corridor"]


def built(scene):
    blender = blend_file.new_file()
    build.build(blender, scene)
    return blender


def assert_close(got, wanted):
    """Equal but for float32, inside Blender, and for what a mesh makes of a sphere."""
    for (name, a), (_, b) in zip(_leaves(got), _leaves(wanted), strict=True):
        if isinstance(b, float):
            tolerance = 1e-3 if name == "target.size" else 1e-6
            assert a == pytest.approx(b, rel=tolerance, abs=1e-6), name
        elif name != "target.mesh":
            assert a == b, name


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("target", ["sheet", "sphere"])
def test_what_is_built_is_read_back(name, target):
    scene = preset(name, target)
    assert_close(read_scene(built(scene)), scene)


@pytest.mark.parametrize("name", PRESETS)
def test_shipped_scenes_are_the_presets(name):

    path = ROOT / "blend_scenes" / f"{name}.blend"
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=True)
    scene = bpy.context.scene
    assert_close(read_scene(scene), preset(name))
    # One sees into them at once: rooms are drawn as wires, and views look at the wall from the hidden side.
    assert {o.display_type for o in roles.players(scene, "room")} <= {"WIRE"}
    views = [a.spaces.active for s in bpy.data.screens for a in s.areas if a.type == "VIEW_3D"]
    assert views
    for view in views:
        eye = view.region_3d.view_rotation @ mathutils.Vector((0, 0, view.region_3d.view_distance))
        assert (eye + view.region_3d.view_location).y > 1.0


def test_building_twice_leaves_nothing_behind():
    blender = built(preset("room"))
    count = {kind: len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "materials", "lights", "cameras")}
    build.build(blender, preset("room"))
    assert {kind: len(getattr(bpy.data, kind)) for kind in count} == count


def test_an_edited_scene_is_rendered_as_edited(tmp_path):
    blender = built(preset("room"))
    roles.find(blender, "spot").data.energy = 500.0
    roles.find(blender, "target").data.materials[0].node_tree.nodes["Diffuse BSDF"].inputs[0].default_value = (
        1,
        0,
        0,
        1,
    )
    roles.write_grid(blender, VoxelGrid(lo=(1, 0.5, 0.5), hi=(2, 1.5, 1.5), shape=(2, 2, 2)))
    bpy.ops.mesh.primitive_cube_add(size=0.2, location=(2.4, 3.0, 0.2))
    bpy.context.object.name = "Cupboard"
    blend_file.save_file(tmp_path / "edited.blend")
    again = blend_file.open_file(tmp_path / "edited.blend")
    scene = read_scene(again)
    assert scene.spot.power == 500.0
    assert scene.grid.n_voxels == 8
    assert scene.target.albedo == pytest.approx(1 / 3, abs=1e-6)
    assert roles.others(again) == ["Cupboard"]


def test_a_mesh_file_becomes_the_target(tmp_path):
    (tmp_path / "wedge.obj").write_text("v 0 0 0\nv 2 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 2 4\nf 2 3 4\n")
    scene = preset("room", str(tmp_path / "wedge.obj"))
    scene = replace(scene, target=replace(scene.target, size=0.3))
    hull = geometry.hull(built(scene))
    np.testing.assert_allclose(np.ptp(hull, axis=0).max(), 0.3, rtol=1e-6)
    np.testing.assert_allclose(hull.min(axis=0) + hull.max(axis=0), 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("none.obj", None, "no such file"),
        ("bad.ply", "nonsense", "not a mesh file|no faces"),
        ("e.obj", "v 0 0 0\nv 1 0 0\n", "no faces"),
    ],
)
def test_bad_mesh_files_are_named(tmp_path, name, text, words):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(NlosError, match=words):
        built(preset("room", str(tmp_path / name)))


def test_reflection_order_is_what_cycles_shows():
    for order in (1, 2, 3, 5):
        blender = built(replace(preset("room"), reflection_order=order))
        assert blender.cycles.diffuse_bounces == order - 1
        assert read_scene(blender).reflection_order == order


def test_camera_sees_the_watched_rectangle():
    """A glowing cube in the corner of largest x and z shows in the picture's first pixel."""
    scene = preset("room")
    blender = built(scene)
    got = read_scene(blender).camera
    assert got.x == pytest.approx(scene.camera.x, abs=1e-6)
    assert got.z == pytest.approx(scene.camera.z, abs=1e-6)
    glow = bpy.data.materials.new("glow")
    if glow.node_tree is None:
        glow.use_nodes = True
    glow.node_tree.nodes.clear()
    emission = glow.node_tree.nodes.new("ShaderNodeEmission")
    output = glow.node_tree.nodes.new("ShaderNodeOutputMaterial")
    glow.node_tree.links.new(emission.outputs[0], output.inputs[0])
    bpy.ops.mesh.primitive_cube_add(size=0.1, location=(scene.camera.x[1] - 0.05, 0.0, scene.camera.z[1] - 0.05))
    bpy.context.object.data.materials.append(glow)
    with renderers.opened(blender, "path", resolution=(10, 10)) as renderer:
        picture = renderer.render(samples=4, seed=0)[..., 0]
    assert np.unravel_index(picture.argmax(), picture.shape) == (0, 0), "largest x is column 0, largest z row 0"
    assert picture[0, 0] > 0.5


def test_engines_leave_the_scene_as_it_was():
    blender = built(preset("room"))
    watched = [(blender.render, n) for n in ("engine", "filepath", "resolution_x", "use_persistent_data")]
    watched += [(blender.cycles, n) for n in ("samples", "seed", "max_bounces", "use_light_tree", "use_denoising")]
    before = [getattr(owner, name) for owner, name in watched]
    with renderers.opened(blender, "patch", resolution=(8, 8)) as renderer:
        renderer.render(samples=2, seed=1, target=False)
    assert [getattr(owner, name) for owner, name in watched] == before
    assert [o.type for o in blender.objects].count("LIGHT") == 1
    assert not roles.find(blender, "target").hide_render
    assert not roles.find(blender, "spot").hide_render


def test_samples_and_seed_are_not_ignored():
    """With persistent data on, Cycles keeps the old ones unless it is told."""
    blender = built(preset("room"))
    with renderers.opened(blender, "patch", resolution=(16, 16)) as renderer:
        first = renderer.render(samples=4, seed=1)
        other_seed = renderer.render(samples=4, seed=2)
        more = renderer.render(samples=256, seed=1)
        again = renderer.render(samples=4, seed=1)
    assert (first != other_seed).mean() > 0.99
    assert more.std() < 0.5 * first.std()
    np.testing.assert_array_equal(first, again)


def test_pixels_do_not_depend_on_threads():
    blender = built(preset("room"))
    pictures = []
    for threads in (1, 2):
        with renderers.opened(blender, "patch", resolution=(16, 16), threads=threads) as renderer:
            pictures.append(renderer.render(samples=8, seed=5))
    np.testing.assert_array_equal(*pictures)


def test_ambient_light_adds_the_world():
    scene = radiometry.bare_scene().with_ambient(0.5)
    with renderers.opened(built(scene), "patch", resolution=(8, 8)) as renderer:
        lit = renderer.render(samples=64, seed=1, target=False)
        dark = renderer.render(samples=64, seed=1, target=False, ambient=False)
    # A lone wall under a uniform sky L shows albedo times L, whatever the order.
    np.testing.assert_allclose((lit - dark).mean(), scene.wall.albedo * 0.5, rtol=1e-3)


def test_clutter_inside_a_voxel_is_kept_clear_of():
    described = preset("room", "sphere")
    blender = built(described)
    bpy.ops.mesh.primitive_cube_add(size=0.6, location=(1.05, 0.65, 1.9))
    bpy.context.view_layer.update()
    is_free = clearance(blender, described, engine="surfel")
    assert is_free((1.05, 0.65, 1.0), (0.0, 0.0, 0.0))
    assert not is_free((1.05, 0.65, 1.5), (0.0, 0.0, 0.0))
    assert not is_free((1.05, 0.05, 1.0), (0.0, 0.0, 0.0)), "the relay wall is a surface too"


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("target", ["sheet", "sphere"])
def test_every_voxel_of_a_preset_has_room(name, target):
    described = preset(name, target)
    blender = built(described)
    for engine in ("path", "patch", "surfel"):
        is_free = clearance(blender, described, engine=engine)
        for voxel in range(described.grid.n_voxels):
            middle = tuple(np.mean(described.grid.bounds(voxel), axis=0))
            assert is_free(middle, (0.0, 0.0, 0.0)), (engine, voxel)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_poses_are_hidden_from_lamp_and_camera_as_the_engine_has_it(projection):
    scene = replace(preset("room"), room=None, partition=None, target=Target(kind="sheet", size=0.3))
    scene = replace(scene, camera=replace(scene.camera, projection=projection))
    blender = built(scene)
    free = clearance(blender, scene, engine="surfel")
    any_place = clearance(blender, scene, engine="path")
    rng = np.random.default_rng(1)
    lamp, aim = np.array(scene.spot.location), np.array(scene.spot.aim)
    eye = np.array(scene.camera.location)
    seen = np.array([np.mean(scene.camera.x), 0.0, np.mean(scene.camera.z)])
    refused = 0
    with renderers.opened(blender, "surfel", resolution=(4, 4), accuracy=0.1) as renderer:
        for number in range(200):
            start, end = ((lamp, aim), (eye, seen))[number % 2]
            place = start + rng.uniform(0.2, 0.6) * (end - start) + rng.uniform(-0.5, 0.5, 3)
            turn = rng.uniform(-180.0, 180.0, 3)
            assert any_place(tuple(place), tuple(turn))
            if free(tuple(place), tuple(turn)):
                renderer.at(place, turn)
            else:
                refused += 1
    assert 20 < refused < 180


def second_target(blender):
    copy = roles.find(blender, "target").copy()
    blender.collection.objects.link(copy)


def no_target(blender):
    bpy.data.objects.remove(roles.find(blender, "target"))


def no_grid(blender):
    del blender[roles.GRID_LO]


def wall_away(blender):
    roles.find(blender, "relay_wall").location.y = 0.1
    bpy.context.view_layer.update()


def spot_away(blender):
    roles.find(blender, "spot").rotation_euler = (0, 0, 0)
    bpy.context.view_layer.update()


def camera_away(blender):
    roles.find(blender, "camera").rotation_euler = (0, 0, 0)
    bpy.context.view_layer.update()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (no_target, "no object is the target"),
        (second_target, "2 objects are the target, as copies keep their role"),
        (no_grid, "lacks the voxel grid"),
        (wall_away, "must lie in the plane y = 0"),
        (spot_away, "does not point at the relay wall"),
        (camera_away, "looks at .Floor., not at the relay wall"),
    ],
)
def test_a_scene_that_cannot_be_rendered_says_why(spoil, words):
    blender = built(preset("room"))
    spoil(blender)
    with pytest.raises(NlosError, match=words):
        read_scene(blender)


def held(blender):
    constraint = roles.find(blender, "target").constraints.new("LIMIT_LOCATION")
    constraint.use_max_x, constraint.max_x = True, 0.0


def test_a_target_that_is_held_in_place_is_named():
    blender = built(preset("room"))
    held(blender)
    with pytest.raises(NlosError, match="does not go where it is put"):
        posing.move_target(blender, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))


def something_in_the_beam(blender):
    bpy.ops.mesh.primitive_cube_add(size=0.1, location=(0.0, 0.7, 1.4))


def textured_wall(blender):
    tree = roles.find(blender, "relay_wall").data.materials[0].node_tree
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs[0], tree.nodes["Diffuse BSDF"].inputs[0])


@pytest.mark.parametrize("gloss", [0.4, 1.0])
def test_a_glossy_target_reads_back(gloss):
    target = Target(kind="sphere", albedo=0.7, gloss=gloss, roughness=0.3)
    blender = built(replace(preset("room"), target=target))
    got = read_scene(blender).target
    assert (got.albedo, got.gloss, got.roughness) == (0.7, gloss, 0.3)
    [body] = survey.surfel_world(blender).target
    np.testing.assert_allclose(body.albedo, 0.7 * (1.0 - gloss), rtol=1e-6)
    np.testing.assert_allclose(body.gloss.tint, 0.7 * gloss, rtol=1e-6)
    assert isinstance(body, Sphere)
    glossy = next(
        n for n in roles.find(blender, "target").data.materials[0].node_tree.nodes if n.type == "BSDF_GLOSSY"
    )
    glossy.inputs["Color"].default_value = (0.1, 0.2, 0.3, 1.0)
    other = read_scene(blender).target
    assert (other.albedo, other.gloss) == (None, 0.0) or gloss == 1.0
    with pytest.raises(NlosError, match=r"target\.roughness: 1\.2 must lie between 0 and 1"):
        replace(preset("room"), target=replace(target, roughness=1.2))


def wide_lamp(blender):
    roles.find(blender, "spot").data.spot_size = 3.0


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (something_in_the_beam, "'Cube' stands in the cone"),
        (textured_wall, "not one constant colour, diffuse"),
        (wide_lamp, "grazes the wall|misses the plane|stands in the cone"),
    ],
)
def test_patch_refuses_what_it_cannot_honour(spoil, words):
    blender = built(preset("room"))
    spoil(blender)
    bpy.context.view_layer.update()
    with pytest.raises(NlosError, match=words), renderers.opened(blender, "patch", resolution=(8, 8)):
        pass


def test_scene_files_of_other_scales_read_back(tmp_path):
    """A thousandth and a thousand times the room: the same figures to scale."""
    for scale in (1e-3, 1e3):
        plain = to_dict(preset("room"))
        for table, keys in {
            "wall": ("x", "z"),
            "room": ("x", "y", "z"),
            "partition": ("y", "z"),
            "spot": ("location", "aim"),
            "camera": ("location", "x", "z"),
            "grid": ("lo", "hi"),
        }.items():
            for key in keys:
                plain[table][key] = [v * scale for v in plain[table][key]]
        plain["target"]["size"] *= scale
        plain["spot"]["power"] *= scale**2
        scene = from_dict(Scene, plain)
        blender = built(scene)
        got = read_scene(blender)
        assert got.camera.x == pytest.approx(scene.camera.x, abs=1e-4 * scale)
        assert got.reference_radiance == pytest.approx(preset("room").reference_radiance, rel=1e-5)
        with renderers.opened(blender, "patch", resolution=(8, 8)) as renderer:
            level = renderer.render(samples=64, seed=1, target=False).mean()
        reference = built(preset("room"))
        with renderers.opened(reference, "patch", resolution=(8, 8)) as renderer:
            assert level == pytest.approx(renderer.render(samples=64, seed=1, target=False).mean(), rel=0.02)


def found_gpus():
    try:
        return require_gpu()
    except NlosError:
        return []


def test_a_machine_without_a_gpu_says_so_and_one_with_it_renders_the_same_radiance():
    blender = built(preset("room", "sphere"))
    if not found_gpus():
        refused = pytest.raises(NlosError, match="finds no GPU")
        with refused, renderers.opened(blender, "patch", resolution=(8, 8), device="gpu"):
            pass
        assert blender.cycles.device == "CPU"
        return
    means = []
    for device in ("cpu", "gpu"):
        with renderers.opened(blender, "patch", resolution=(8, 8), device=device) as renderer:
            means.append(renderer.render(samples=256, seed=3).astype(np.float64).mean())
    # The same random numbers, but rounding may send a ray another way.
    assert means[1] == pytest.approx(means[0], rel=1e-2)


def test_a_mesh_whose_modifiers_leave_only_curves_has_no_surface(scene_file):
    """Blender gives no mesh at all of it."""
    from generator.blender import check
    from generator.blender.engines import simplify
    from generator.blender.scene import clearance

    scene = blend_file.open_file(scene_file)
    tree = bpy.data.node_groups.new("curves", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    line, output = tree.nodes.new("GeometryNodeCurvePrimitiveLine"), tree.nodes.new("NodeGroupOutput")
    tree.links.new(line.outputs[0], output.inputs[0])
    obj = bpy.data.objects.new("Wire", bpy.data.meshes.new("Wire"))
    scene.collection.objects.link(obj)
    obj.modifiers.new("curves", "NODES").node_group = tree
    bpy.context.view_layer.update()
    assert geometry.evaluated_vertices(obj).shape == (0, 3)
    assert clearance.clearance(scene, read_scene(scene), engine="path")
    assert simplify.removable_pieces(scene)
    assert check.findings(scene, engine="path")


def test_a_ply_that_claims_what_it_cannot_hold_is_refused(tmp_path, monkeypatch):
    """By a limit so low that a sound file exceeds it."""
    path = tmp_path / "claim.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    target = Target(kind="mesh", size=0.0, albedo=0.5, mesh=str(path))
    assert len(build._import_mesh(target).data.polygons) == 1
    monkeypatch.setattr(meshes, "_PER_BYTE", 0.01)
    with pytest.raises(NlosError, match=r"claim\.ply claims 3 elements in"):
        build._import_mesh(target)


def test_an_obj_leads_nowhere_else(tmp_path):
    """Its material library, and the textures that this names, may be any files of the machine."""
    (tmp_path / "any.mtl").write_text(f"newmtl x\nmap_Kd {tmp_path / 'any.png'}\n")
    text = f"mtllib {tmp_path / 'any.mtl'}\n  mtllib any.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl x\nf 1 2 3\n"
    (tmp_path / "m.obj").write_text(text)
    before = len(bpy.data.images)
    made = build._import_mesh(Target(kind="mesh", size=0.0, albedo=0.5, mesh=str(tmp_path / "m.obj")))
    assert len(made.data.polygons) == 1
    assert len(bpy.data.images) == before


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("m.obj", "v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"),
        (
            "m.ply",
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
            "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 0 1\n3 0 1 2\n",
        ),
        (
            "m.stl",
            "solid m\nfacet normal 0 -1 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 0 1\nendloop\nendfacet\n"
            "endsolid m\n",
        ),
    ],
)
def test_importing_a_mesh_prints_nothing(tmp_path, capfd, name, text):
    (tmp_path / name).write_text(text)
    build._import_mesh(Target(kind="mesh", size=0.0, albedo=0.5, mesh=str(tmp_path / name)))
    assert capfd.readouterr().out == ""
