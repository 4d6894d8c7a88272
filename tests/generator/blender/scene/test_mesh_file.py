"""One shape in every format, unit and axis becomes one target; what is no target is refused by name."""

from __future__ import annotations

import json
import struct
from dataclasses import replace

import bpy
import mesh_files
import numpy as np
import pytest

from generator.blender.scene import blend_file, build, geometry, importers, mesh_file, roles
from generator.blender.scene.description import read_scene
from generator.files import usd
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.presets import preset
from generator.model.scene import UNITS, Target
from generator.sets import links

has_usd = pytest.mark.skipif(not importers._options(bpy.ops.wm.usd_import), reason="this Blender cannot read USD")
states_unit = pytest.mark.skipif(
    "apply_unit_conversion_scale" not in importers._options(bpy.ops.wm.usd_import),
    reason="this Blender does not read the unit of a USD",
)


def read(path, **how):
    return mesh_file.read(Target(kind="mesh", size=0.0, mesh=str(path), **how))


def volume_of(triangles):
    return np.einsum("ij,ij->i", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6.0


def assert_the_shape(found):
    got, wanted = mesh_files.centred(found.vertices), mesh_files.centred(mesh_files.VERTICES)
    assert got.shape == wanted.shape
    np.testing.assert_allclose(got, wanted, atol=2e-7)
    # Volume by the divergence theorem: faces join the right corners, and face outwards.
    ends = np.cumsum(found.sizes)
    fans = [
        (found.corners[end - size], *pair)
        for end, size in zip(ends, found.sizes, strict=True)
        for pair in zip(found.corners[end - size + 1 : end - 1], found.corners[end - size + 2 : end], strict=True)
    ]
    volume = volume_of(found.vertices[np.array(fans)])
    assert volume == pytest.approx(volume_of(mesh_files.VERTICES[np.array(mesh_files.TRIANGLES)]), rel=1e-5)


FORMATS = [
    *("obj", "ply", "stl", "gltf"),
    pytest.param("usda", marks=has_usd),
]


@pytest.mark.parametrize("up", "XYZ")
@pytest.mark.parametrize("unit", ["m", "cm", "mm", "inch"])
@pytest.mark.parametrize("kind", FORMATS)
def test_unit_and_axis_as_told(tmp_path, kind, unit, up):
    path = getattr(mesh_files, kind)(tmp_path / f"shape.{kind}", UNITS[unit], up)
    found = read(path, unit=unit, up=up)
    assert_the_shape(found)
    assert found.read == mesh_file.Read(path.name, unit, up, UNITS[unit], up)


@pytest.mark.parametrize(("kind", "up"), [("obj", "Y"), ("ply", "Z"), ("stl", "Z"), ("gltf", "Y")])
def test_what_formats_mean_that_state_nothing(tmp_path, kind, up):
    """As it was before a unit could be told, of OBJ, PLY and STL; as the standard says, of glTF."""
    found = read(getattr(mesh_files, kind)(tmp_path / f"shape.{kind}", 1.0, up))
    assert_the_shape(found)
    assert (found.read.metres_per_unit, found.read.up_axis) == (1.0, up)


@states_unit
@pytest.mark.parametrize(
    ("unit", "up", "states"), [(1.0, "Z", True), (0.3048, "Y", True), (0.001, "Z", True), (0.01, "Y", False)]
)
def test_what_a_usd_states(tmp_path, unit, up, states):
    """Without a word, a USD is in centimetres, y up: its own standard."""
    found = read(mesh_files.usda(tmp_path / "shape.usda", unit, up, states=states))
    assert_the_shape(found)
    assert (found.read.metres_per_unit, found.read.up_axis) == (unit, up)


@states_unit
@pytest.mark.parametrize("suffix", ["usda", "usdc", "usdz"])
def test_a_usd_by_blender(tmp_path, suffix):
    """Its importer leaves out the root that its exporter made, and with it what the file states."""
    path = tmp_path / f"shape.{suffix}"
    mesh_files.modelled()
    bpy.ops.wm.usd_export(
        filepath=str(path),
        convert_orientation=True,
        export_global_forward_selection="NEGATIVE_Z",
        export_global_up_selection="Y",
        convert_scene_units="CENTIMETERS",
    )
    for found in (read(path), read(path, unit="cm", up="Y")):
        assert_the_shape(found)
        assert (found.read.metres_per_unit, found.read.up_axis) == (0.01, "Y")
    assert found.left_out == "1 light, 1 camera"


def fbx(path, unit=1.0, **how):
    """Export the shape as FBX, and let it state another unit of so many centimetres, and be of that size."""
    mesh_files.modelled()
    for obj in bpy.context.scene.objects:
        if obj.parent is None:
            obj.scale = [edge / unit for edge in obj.scale]
    bpy.context.view_layer.update()
    bpy.ops.export_scene.fbx(filepath=str(path), **how)
    data = path.read_bytes()
    if unit != 1.0:
        at = data.index(b"S\x0f\0\0\0UnitScaleFactor")
        at = data.index(b"D" + struct.pack("<d", 1.0), at)
        path.write_bytes(data[: at + 1] + struct.pack("<d", unit) + data[at + 9 :])
    return path


@pytest.mark.parametrize(
    ("unit", "up", "metres", "how"),
    [
        (1.0, "Y", 0.01, {}),
        (2.54, "Y", 0.0254, {}),
        (1.0, "Y", 1.0, {"apply_scale_options": "FBX_SCALE_UNITS"}),
        (1.0, "Z", 0.01, {"axis_up": "Z", "axis_forward": "Y"}),
        (1.0, "X", 0.01, {"axis_up": "X", "axis_forward": "Z"}),
        (1.0, "Y", 0.01, {"bake_space_transform": True}),
    ],
)
def test_what_an_fbx_states(tmp_path, unit, up, metres, how):
    found = read(fbx(tmp_path / "shape.fbx", unit, **how))
    assert_the_shape(found)
    assert (found.read.metres_per_unit, found.read.up_axis) == (pytest.approx(metres, rel=1e-12), up)
    assert found.left_out == "1 light, 1 camera"


def test_an_fbx_that_states_a_wrong_unit(tmp_path):
    path = fbx(tmp_path / "shape.fbx", 0.1)
    assert_the_shape(read(path, unit="mm"))
    np.testing.assert_allclose(read(path, unit="cm").size, (3.0, 2.0, 5.0), rtol=1e-5)


@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_another_blend(tmp_path, unit):
    mesh_files.modelled(unit)
    hidden = bpy.data.objects.new("hidden", bpy.data.objects["block"].data)
    hidden.hide_render = True
    bpy.context.scene.collection.objects.link(hidden)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shape.blend"))
    blend_file.clear()
    found = read(tmp_path / "shape.blend")
    assert_the_shape(found)
    assert found.read.metres_per_unit == unit
    assert found.left_out == "1 material, 1 light, 1 camera, 1 hidden object"


def test_a_glb_by_blender(tmp_path):
    scene = mesh_files.modelled()
    block = bpy.data.objects["block"]
    for frame, x in ((1, 0.0), (10, 5.0)):
        block.location.x = x
        block.keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    bpy.ops.export_scene.gltf(filepath=str(tmp_path / "e.glb"), export_lights=True, export_cameras=True)
    found = read(tmp_path / "e.glb")
    assert_the_shape(found)
    assert found.left_out == "1 camera, 1 material, 1 animation, 1 light"


def test_instances_and_mirrored_ones_are_made_real(tmp_path):
    """A collection of the shape, shown twice, once mirrored; a subdivision that only renders show."""
    scene = mesh_files.modelled()
    shapes = bpy.data.collections.new("shapes")
    block = bpy.data.objects["block"]
    scene.collection.objects.unlink(block)
    shapes.objects.link(block)
    modifier = block.modifiers.new("finer", "SUBSURF")
    modifier.subdivision_type, modifier.levels, modifier.render_levels = "SIMPLE", 0, 1
    for place, scale in ((0.0, 1.0), (10.0, -1.0)):
        shown = bpy.data.objects.new("shown", None)
        shown.instance_type, shown.instance_collection = "COLLECTION", shapes
        shown.location.x, shown.scale.x = place, scale
        scene.collection.objects.link(shown)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "two.blend"))
    blend_file.clear()
    found = read(tmp_path / "two.blend")
    assert len(found.sizes) == 2 * 3 * len(mesh_files.TRIANGLES)
    assert found.size[0] == pytest.approx(10.0 - 2.0 - 0.0, abs=1e-5)
    corners = found.vertices[found.corners.reshape(-1, 4)]
    crosses = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    outward = np.einsum("ij,ij->i", corners.mean(axis=1), crosses).sum()
    assert outward > 0.0


def test_a_target_is_built_and_read_back(tmp_path):
    path = mesh_files.stl(tmp_path / "shape.stl", 0.001, "Y")
    wanted = preset("room", str(path))
    wanted = replace(wanted, target=replace(wanted.target, unit="mm", up="Y"))
    scene = build.new_scene(wanted)
    hull = geometry.hull(scene)
    np.testing.assert_allclose(mesh_files.centred(hull), mesh_files.centred(mesh_files.VERTICES), atol=2e-6)
    blend_file.save_file(tmp_path / "room.blend")
    again = blend_file.open_file(tmp_path / "room.blend")
    target = read_scene(again).target
    assert (target.kind, target.unit, target.up) == ("mesh", "mm", "Y")
    assert roles.target_file(again) == {
        "name": "shape.stl",
        "unit": "mm",
        "up": "Y",
        "metres_per_unit": 0.001,
        "up_axis": "Y",
    }


def test_a_size_replaces_the_unit(tmp_path):
    path = mesh_files.stl(tmp_path / "shape.stl", 0.001, "Z")
    found = mesh_file.read(Target(kind="mesh", size=0.25, mesh=str(path)))
    assert found.size == pytest.approx((0.15, 0.1, 0.25), rel=1e-6)


def test_larger_than_a_voxel_is_told(tmp_path):
    found = read(mesh_files.stl(tmp_path / "shape.stl", 1.0, "Z"))
    wide, low = (VoxelGrid(lo=(0, 0, 0), hi=(3 * 0.3, 3 * 0.2, z), shape=(3, 3, 1)) for z in (0.5, 0.4))
    assert found.warning(wide) == ""
    assert "(0.3 x 0.2 x 0.4 m) along z" in found.warning(low)


@pytest.mark.parametrize("suffix", ["gltf", "glb", "fbx", "usda", "usdc", "usdz", "usd", "blend"])
@pytest.mark.parametrize(
    "content", [b"", b"nonsense", b"glTF\2", b"Kaydara FBX Binary  \0\x1a\0", b"PXR-USDC", b"PK\3\4"]
)
def test_what_is_no_such_file_is_named(tmp_path, suffix, content):
    if suffix.startswith("usd") and not importers._options(bpy.ops.wm.usd_import):
        pytest.skip("this Blender cannot read USD")
    path = tmp_path / f"bad.{suffix}"
    path.write_bytes(content)
    with pytest.raises(NlosError, match=r"bad\.\w+") as caught:
        read(path)
    assert "Traceback" not in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("unit", [1e-8, 1e8])
def test_an_absurd_size_is_refused(tmp_path, kind, unit):
    path = getattr(mesh_files, kind)(tmp_path / f"shape.{kind}", unit, "Z")
    with pytest.raises(NlosError, match="m long, which no target is; say its unit"):
        read(path, unit="m")


def test_nothing_rendered_is_refused_and_told(tmp_path):
    mesh_files.modelled()
    bpy.data.objects["block"].hide_render = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "none.blend"))
    blend_file.clear()
    with pytest.raises(NlosError, match=r"renders no faces; it holds .*1 hidden object"):
        read(tmp_path / "none.blend")


def test_a_blend_runs_no_scripts_and_leads_nowhere_else(tmp_path):
    """A text that registers itself, and a library in another folder."""
    mark, path = tmp_path / "ran", tmp_path / "evil.blend"
    mesh_files.modelled()
    text = bpy.data.texts.new("evil.py")
    text.write(f"import pathlib; pathlib.Path({str(mark)!r}).touch()")
    text.use_module = True
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    blend_file.clear()
    assert_the_shape(read(path))
    assert not mark.exists()
    bpy.ops.wm.open_mainfile(filepath=str(path), use_scripts=True)
    assert mark.exists(), "it would have"

    (tmp_path / "far").mkdir()
    mesh_files.modelled()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "far" / "library.blend"))
    scene = blend_file.clear()
    with bpy.data.libraries.load(str(tmp_path / "far" / "library.blend"), link=True) as (_, linked):
        linked.objects = ["block"]
    scene.collection.objects.link(linked.objects[0])
    (tmp_path / "near").mkdir()
    path = tmp_path / "near" / "shape.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    blend_file.clear()
    with pytest.raises(NlosError, match=r"library\.blend, outside its own folder"):
        read(path)
    with links.trusting():
        assert_the_shape(read(path))


def test_a_missing_picture_of_a_blend_is_no_matter(tmp_path):
    mesh_files.modelled()
    material = bpy.data.materials["paint"]
    if material.node_tree is None:
        material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    picture = bpy.data.images.new("gone", 4, 4)
    picture.filepath, picture.source = str(tmp_path / "gone.png"), "FILE"
    node.image = picture
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shape.blend"))
    blend_file.clear()
    assert_the_shape(read(tmp_path / "shape.blend"))


def test_a_gltf_leads_nowhere_else(tmp_path):
    (tmp_path / "near").mkdir()
    path = mesh_files.gltf(tmp_path / "near" / "shape.gltf", 1.0, "Y")
    numbers = tmp_path / "near" / "shape.bin"
    numbers.rename(tmp_path / "shape.bin")
    tree = json.loads(path.read_text())
    tree["buffers"][0]["uri"] = "../shape.bin"
    path.write_text(json.dumps(tree))
    with pytest.raises(NlosError, match=r"shape\.bin, outside its own folder"):
        read(path)
    with links.trusting():
        assert_the_shape(read(path))
    (tmp_path / "shape.bin").unlink()
    with links.trusting(), pytest.raises(NlosError, match=r"shape\.bin, which .*shape\.gltf refers to, cannot be"):
        read(path)


@has_usd
def test_a_usd_leads_nowhere_else(tmp_path):
    (tmp_path / "near").mkdir()
    part = mesh_files.usda(tmp_path / "part.usda", 1.0, "Z")
    part.write_text(part.read_text().replace('upAxis = "Z"', 'upAxis = "Z"\n    defaultPrim = "a"'))
    path = tmp_path / "near" / "shape.usda"
    head = '#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Z"\n    subLayers = [@inner.usda@]\n)\n'
    path.write_text(head)
    inner = '#usda 1.0\ndef Xform "b" (\n    references = @../part.usda@\n)\n{\n}\n'
    (tmp_path / "near" / "inner.usda").write_text(inner)
    with pytest.raises(NlosError, match=r"part\.usda, outside its own folder"):
        read(path, unit="m")
    with links.trusting():
        assert_the_shape(read(path, unit="m"))


@has_usd
def test_the_names_in_a_crate_are_found(tmp_path):
    """Those of a crate that Blender wrote, with many names and long runs, are all that its text form holds."""
    scene = blend_file.clear()
    for k in range(300):
        obj = bpy.data.objects.new(f"{'ab' * (k % 40)}_{k}", bpy.data.meshes.new(f"m{k}"))
        scene.collection.objects.link(obj)
    for suffix in ("usda", "usdc"):
        bpy.ops.wm.usd_export(filepath=str(tmp_path / f"many.{suffix}"))
    [text], [crate] = (usd._texts(tmp_path / f"many.{suffix}") for suffix in ("usda", "usdc"))
    names = set(crate.split("\0"))
    defined = [line.split('"')[1] for line in text.splitlines() if line.strip().startswith("def ")]
    assert len(defined) > 300
    assert set(defined) <= names


def test_a_missing_importer_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(importers, "_options", lambda operator: set())
    path = mesh_files.gltf(tmp_path / "shape.gltf", 1.0, "Y")
    with pytest.raises(NlosError, match=r"has no importer of glTF \(bpy\.ops\.import_scene\.gltf\)"):
        read(path)


def test_reading_prints_nothing(tmp_path, capfd):
    read(mesh_files.gltf(tmp_path / "shape.gltf", 1.0, "Y"))
    if importers._options(bpy.ops.wm.usd_import):
        read(mesh_files.usda(tmp_path / "shape.usda", 1.0, "Z"), unit="m")
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")


def test_only_plain_files_are_read_beside_an_open_scene(tmp_path):
    """A file with lamps and pictures of its own would leave them in the user's."""
    wanted = preset("room", str(mesh_files.gltf(tmp_path / "shape.gltf", 1.0, "Y")))
    scene = blend_file.clear()
    with pytest.raises(NlosError, match="into a new scene only"):
        build.build(scene, wanted)
    assert not scene.objects
    assert roles.find(build.new_scene(wanted), "target")
