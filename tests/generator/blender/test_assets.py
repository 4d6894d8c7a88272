"""The library of assets: what is dragged out of it is what its description says, and makes a scene."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from generator.blender import asset_previews, assets, check
from generator.blender.engines import survey
from generator.blender.finding import ERROR
from generator.blender.scene import blend_file, geometry, materials, roles
from generator.blender.scene.description import read_scene
from generator.jobs.protocol import WriteAssets, read_request
from generator.model.albedos import ALBEDOS
from generator.model.errors import NlosError

CORNER = ("Relay wall, painted, 5 m x 2.6 m", "Spot lamp, beam of 2.78°", "Camera, perspective, 1 m x 1 m")
CLUTTER = ("Bin", "Box", "Chair", "Monitor", "Shelf", "Table")


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("library") / "new" / "assets"
    names = assets.write(folder)
    assert len(set(names)) == len(names)
    return folder, names


def appended(library, *names, kind="objects"):
    """Append assets as the asset browser does; return them."""
    with bpy.data.libraries.load(str(library[0] / assets.FILE), assets_only=True) as (found, wanted):
        assert set(names) <= set(getattr(found, kind))
        setattr(wanted, kind, list(names))
    blocks = getattr(wanted, kind)
    if kind == "objects":
        for obj in blocks:
            bpy.context.scene.collection.objects.link(obj)
        bpy.context.view_layer.update()
    return blocks


def mended():
    """Apply what the check offers to a scene, and return what is left to say."""
    scene = bpy.context.scene
    for _ in range(4):
        fixes = [f.fix for f in check.findings(scene) if f.fix]
        if not fixes:
            break
        check.mend(scene, fixes[0])
    return check.findings(scene)


def test_every_material_reads_back_as_its_albedo(library):
    blend_file.new_file()
    for albedo in ALBEDOS:
        [material] = appended(library, albedo.name, kind="materials")
        bpy.ops.mesh.primitive_plane_add()
        bpy.context.object.data.materials.append(material)
        assert materials.diffuse_colour(bpy.context.object) == pytest.approx(albedo.value, rel=1e-7)
        if len(set(albedo.value)) == 1:
            assert materials.albedo(bpy.context.object) == albedo.value[0]


def test_every_asset_says_what_it_is(library):
    folder, names = library
    blend_file.new_file()
    path = str(folder / assets.FILE)
    with bpy.data.libraries.load(path, link=True, assets_only=True) as (found, wanted):
        wanted.objects, wanted.materials = list(found.objects), list(found.materials)
    blocks = [*wanted.objects, *wanted.materials]
    assert sorted(block.name for block in blocks) == sorted(names)
    catalogs = dict(line.split(":")[:2] for line in (folder / assets.CATALOGS).read_text().splitlines()[2:])
    for block in blocks:
        data = block.asset_data
        assert (data.author, "NLOS" in [tag.name for tag in data.tags]) == (assets.AUTHOR, True)
        assert len(data.description) > 20
        assert catalogs[data.catalog_id].startswith("NLOS/")
        picture = np.empty(asset_previews.SIDE**2 * 4, dtype=np.float32)
        block.preview.image_pixels_float.foreach_get(picture)
        assert 0.02 < picture.reshape(-1, 4)[:, 3].mean() < 0.95, block.name
    players = {role: [o.name for o in wanted.objects if o.get(roles.ROLE) == role] for role in (*roles.SINGLE_ROLES,)}
    assert all(len(found) >= 3 for found in players.values()), players
    assert sorted(o.name for o in wanted.objects if roles.ROLE not in o) == sorted(CLUTTER)
    assert not [o.name for o in wanted.objects if roles.BUILT in o], "Build Scene would delete it"
    used = {slot.material for o in wanted.objects for slot in o.material_slots}
    assert used <= set(wanted.materials)


def test_it_is_as_small_as_it_says(library):
    assert sum(path.stat().st_size for path in library[0].iterdir()) <= assets.LARGEST


def test_what_is_dragged_makes_a_scene_that_the_check_accepts(library):
    scene = blend_file.new_file()
    appended(library, *CORNER, "Partition, 2.1 m x 2.6 m", "Target, sheet")
    assert [f.fix for f in check.findings(scene) if f.level == ERROR] == ["voxels"]
    found = mended()
    assert not [f for f in found if f.level == ERROR], found
    assert any("hidden from lamp and camera" in f.text for f in found), found
    described = read_scene(scene)
    assert described.wall.albedo == 0.85
    assert (described.partition.albedo, described.target.albedo, described.target.kind) == (0.03, 0.8, "sheet")
    assert survey.survey(scene).world is not None  # `surfel` can render it


@pytest.mark.parametrize("target", ["sphere", "cube", "cylinder", "letter L", "letter T", "figure"])
def test_every_target_and_all_clutter_take_part(library, target):
    scene = blend_file.new_file()
    *_, obj = appended(library, *CORNER, "Partition, corner", f"Target, {target}")
    for number, clutter in enumerate(appended(library, *CLUTTER)):
        clutter.location = (-1.2 - 0.2 * number, 3.5 + number, 0.0)
    bpy.context.view_layer.update()
    mended()
    surveyed = survey.survey(scene)
    assert not surveyed.never
    assert surveyed.world is not None, surveyed.reasons("surfel")
    assert read_scene(scene).target.albedo == 0.8
    [shape] = geometry.snapshot(scene).of([obj])
    largest = np.ptp(shape.placed, axis=0).max()
    sizes = {"sphere": 0.4, "cube": 0.4, "cylinder": 0.6, "figure": 1.7}
    assert largest == pytest.approx(sizes.get(target, 0.5), rel=2e-3)


def test_solids_are_closed_and_face_outwards(library):
    blend_file.new_file()
    solid = (*CLUTTER, "Target, cube", "Target, cylinder", "Target, figure", "Partition, corner")
    for obj in appended(library, *solid):
        mesh = obj.data
        mesh.calc_loop_triangles()
        corners = np.array([v.co for v in mesh.vertices])[[tuple(t.vertices) for t in mesh.loop_triangles]]
        assert np.linalg.det(corners).sum() / 6.0 > 0.0, obj.name
        sides = [edge for polygon in mesh.polygons for edge in polygon.edge_keys]
        assert all(sides.count(edge) == 2 for edge in set(sides)), obj.name


def test_written_again_it_keeps_what_others_put_there(library, tmp_path):
    (tmp_path / "own.blend").write_bytes(b"own")
    own = "01234567-0000-0000-0000-000000000000:Own/Chairs:Chairs"
    (tmp_path / assets.CATALOGS).write_text(f"VERSION 1\n\n{own}\n")
    for _ in range(2):
        assert assets.write(tmp_path) == library[1]
    lines = (tmp_path / assets.CATALOGS).read_text().splitlines()
    assert lines[0] == "VERSION 1"
    assert lines.count(own) == 1
    assert len([line for line in lines if ":NLOS" in line]) == len({line for line in lines if ":NLOS" in line}) == 8
    assert {path.name for path in tmp_path.iterdir()} == {"own.blend", assets.FILE, assets.CATALOGS}


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(NlosError, match=r"nlos_lab\.blend: cannot be written"):
        assets.write(tmp_path / "file")


def test_catalogs_that_cannot_be_read_are_named_before_anything_is_written(tmp_path):
    (tmp_path / assets.CATALOGS).write_bytes(b"VERSION 1\n\xff\xfe")
    with pytest.raises(NlosError, match=r"cats\.txt: is no file of catalogs that can be read"):
        assets.write(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [assets.CATALOGS]


def test_the_request_names_the_folder(tmp_path):
    assert read_request(WriteAssets(folder=tmp_path).arguments[1]) == WriteAssets(folder=tmp_path)
