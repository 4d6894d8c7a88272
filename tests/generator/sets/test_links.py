"""What a scene that comes from elsewhere may not do: read or write files outside its folder, or run anything."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from conftest import ROOT, TINY

from generator.blender import check
from generator.blender.engines import renderers
from generator.blender.measure import planning
from generator.blender.scene import blend_file, references, roles
from generator.files.toml import dump_toml, read_toml
from generator.files.writing import file_hash
from generator.model.errors import NlosError
from generator.sets import links, seal
from generator.sets.dataset import Dataset


@pytest.fixture
def edited(tmp_path, scene_file):
    """Return what edits the room and saves it into a folder of its own, beside one that is none of its business."""
    (tmp_path / "scenes").mkdir()
    (tmp_path / "elsewhere").mkdir()

    def edit(spoil, name="scene.blend"):
        path = tmp_path / "scenes" / name
        blend_file.open_file(scene_file)
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
        spoil(bpy.context.scene, tmp_path / "elsewhere")
        bpy.ops.wm.save_as_mainfile(filepath=str(path), relative_remap=False)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        (path.parent / f"{name}1").unlink(missing_ok=True)
        return path

    return edit


def files(folder):
    return {p.relative_to(folder) for p in folder.rglob("*") if "set" not in p.relative_to(folder).parts}


def an_object(scene, name="Extra"):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0)], [], [(0, 1, 2)])
    obj = bpy.data.objects.new(name, mesh)
    obj.location = (0.0, 3.0, 0.1)
    scene.collection.objects.link(obj)
    return obj


def an_image(name, file):
    image = bpy.data.images.new(name, 4, 4)
    image.source, image.filepath, image.use_fake_user = "FILE", str(file), True
    return image


def picture(scene, elsewhere):
    an_image("photo", elsewhere / "photo.png")


def far_picture(scene, elsewhere):
    an_image("photo", "//../../../photo.png")


def library(scene, elsewhere):
    kept = {bpy.data.objects.new("linked", bpy.data.meshes.new("linked"))}
    bpy.data.libraries.write(str(elsewhere / "library.blend"), kept)
    bpy.data.batch_remove(kept)
    with bpy.data.libraries.load(str(elsewhere / "library.blend"), link=True) as (_, wanted):
        wanted.objects = ["linked"]
    scene.collection.objects.link(wanted.objects[0])


def volume(scene, elsewhere):
    data = bpy.data.volumes.new("smoke")
    data.filepath, data.use_fake_user = str(elsewhere / "smoke.vdb"), True


def importer(scene, elsewhere, *, computed=False):
    (elsewhere / "secret.txt").write_text("words", encoding="utf-8")
    tree = bpy.data.node_groups.new("import", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    node, output = tree.nodes.new("GeometryNodeImportText"), tree.nodes.new("NodeGroupOutput")
    if not computed:
        node.inputs["Path"].default_value = str(elsewhere / "secret.txt")
    else:
        words = tree.nodes.new("FunctionNodeInputString")
        words.string = str(elsewhere / "secret.txt")
        tree.links.new(words.outputs[0], node.inputs["Path"])
    curves = tree.nodes.new("GeometryNodeStringToCurves")
    tree.links.new(node.outputs[0], curves.inputs["String"])
    tree.links.new(curves.outputs[0], output.inputs[0])
    an_object(scene).modifiers.new("import", "NODES").node_group = tree


def computed(scene, elsewhere):
    importer(scene, elsewhere, computed=True)


def shader(scene, elsewhere):
    tree = bpy.data.materials.new("script")
    tree.use_fake_user = True
    if tree.node_tree is None:
        tree.use_nodes = True
    node = tree.node_tree.nodes.new("ShaderNodeTexIES")
    node.mode, node.filepath = "EXTERNAL", str(elsewhere / "lamp.ies")


def disk_cache(scene, elsewhere):
    an_object(scene).modifiers.new("cloth", "CLOTH").point_cache.use_disk_cache = True


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (picture, "refers to .*photo.png, outside its own folder.*--trust-links"),
        (far_picture, "refers to .*photo.png, outside"),
        (library, "refers to .*library.blend, outside"),
        (volume, "refers to .*smoke.vdb, outside"),
        (shader, "refers to .*lamp.ies, outside"),
        (importer, "refers to .*secret.txt, outside"),
        (computed, "node group 'import' imports files whose names it makes up"),
        (disk_cache, "'Extra' writes a cache as soon as the file is opened"),
    ],
)
def test_what_leads_out_of_the_scenes_folder_is_refused(edited, tmp_path, spoil, words):
    if spoil in (importer, computed) and not hasattr(bpy.types, "GeometryNodeImportText"):
        pytest.skip("this Blender's nodes import nothing")
    path = edited(spoil)
    before = files(tmp_path)
    with pytest.raises(NlosError, match=words):
        blend_file.open_file(path)
    assert files(tmp_path) == before
    with links.trusting():
        assert roles.find(blend_file.open_file(path), "target")


def test_a_fluid_with_a_cache_is_never_opened(edited, tmp_path):
    """Opened, it would make the folder that it names, here beside the scene."""
    script = (
        "import bpy, sys;"
        "bpy.ops.wm.open_mainfile(filepath=sys.argv[1]);"
        "bpy.ops.mesh.primitive_cube_add(size=0.1);"
        "o = bpy.context.object;"
        "o.modifiers.new('f', 'FLUID').fluid_type = 'DOMAIN';"
        "o.modifiers[0].domain_settings.cache_directory = sys.argv[2];"
        "o.modifiers[0].show_viewport = False;"
        "bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1], relative_remap=False)"
    )
    folder = tmp_path / "scenes"
    for place, words in {tmp_path / "elsewhere" / "fluid": "outside", folder / "f": "fluid domain 'Cube'"}.items():
        path = edited(lambda scene, elsewhere: None)
        subprocess.run([sys.executable, "-c", script, path, place], capture_output=True, check=False)
        (folder / "scene.blend1").unlink()
        before = files(tmp_path)
        with pytest.raises(NlosError, match=words):
            blend_file.open_file(path)
        assert files(tmp_path) == before


def test_a_link_in_the_folder_that_leads_out_of_it_is_refused(edited, tmp_path):
    (tmp_path / "scenes" / "photo.png").symlink_to(tmp_path / "elsewhere" / "photo.png")
    with pytest.raises(NlosError, match="outside its own folder"):
        blend_file.open_file(edited(lambda scene, elsewhere: an_image("photo", "//photo.png")))


def test_what_is_packed_is_no_link(edited):
    def pack(scene, elsewhere):
        image = bpy.data.images.new("photo", 4, 4)
        image.filepath_raw, image.file_format = str(elsewhere / "photo.png"), "PNG"
        image.save()
        image.pack()
        image.use_fake_user = True

    assert references.refuse(edited(pack)) == []


def test_what_lies_in_the_scenes_folder_is_remembered_and_must_not_change(edited, tmp_path, command):
    """A texture and a library beside the scene are normal work; the pictures are of them as they were."""

    def furnish(scene, elsewhere):
        library(scene, tmp_path / "scenes")
        image = bpy.data.images.new("photo", 4, 4)
        image.filepath_raw, image.file_format = str(tmp_path / "scenes" / "photo.png"), "PNG"
        image.save()
        image.source, image.filepath, image.use_fake_user = "FILE", "//photo.png", True

    scene, path = edited(furnish), tmp_path / "set"
    sweep = ("generator", "sweep", scene, "-o", path, *TINY)
    result = command(*sweep)
    assert result.returncode == 0, result.stderr
    remembered = Dataset.open(path).meta["links"]
    assert set(remembered) == {"../scenes/photo.png", "../scenes/library.blend"}
    assert len(set(remembered.values())) == 2
    next(path.glob("*/0000.exr")).unlink()
    result = command("generator", "sweep", path / "scene.blend", "-o", path)
    assert result.returncode == 2, "whoever got the set from elsewhere has not asked for what lies around it"
    assert "photo.png, outside the folder of" in result.stderr or "library.blend, outside" in result.stderr
    (tmp_path / "scenes" / "photo.png").write_bytes(b"another")
    result = command(*sweep)
    assert result.returncode == 2
    assert "photo.png: is not the file that" in result.stderr


def test_a_set_that_hides_what_its_scene_refers_to_is_refused(edited, tmp_path, tiny_dataset, command):
    """A data set from elsewhere, whose scene refers to what its manifest does not tell."""
    path = tmp_path / "set"
    shutil.copytree(tiny_dataset, path)
    os.replace(edited(picture), path / "scene.blend")
    # Whoever means ill seals it anew.
    meta = read_toml(path / "dataset.toml")
    files = {**meta[seal.SEAL], "scene": file_hash(path / "scene.blend")}
    sealed = seal.sealed(meta, **{name: files[name] for name in ("scene", "poses")})
    (path / "dataset.toml").write_text(dump_toml(sealed), encoding="utf-8")
    next(path.glob("*/0000.exr")).unlink()
    result = command("generator", "sweep", path / "scene.blend", "-o", path)
    assert result.returncode == 2
    assert "photo.png, outside its own folder" in result.stderr


def busy(scene, elsewhere):
    """What a scene may ask for besides its picture: a script that leaves a mark, the compositor, files of its own."""
    text = bpy.data.texts.new("register.py")
    text.write(f"open({str(elsewhere / 'text')!r}, 'w').write('x')")
    text.use_module = True
    if hasattr(scene, "compositor_effects"):  # Blender 5.3
        tree = bpy.data.node_groups.new("compositor", "CompositorNodeTree")
        scene.compositor_effects.new("compositor").node_group = tree
    elif hasattr(scene, "compositing_node_group"):
        tree = scene.compositing_node_group = bpy.data.node_groups.new("compositor", "CompositorNodeTree")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
    output, layers = tree.nodes.new("CompositorNodeOutputFile"), tree.nodes.new("CompositorNodeRLayers")
    setattr(output, "directory" if hasattr(output, "directory") else "base_path", f"{elsewhere}/compositor/")
    if hasattr(output, "file_output_items"):
        output.file_output_items.new("RGBA", "a")
    tree.links.new(layers.outputs[0], output.inputs[0])
    scene.render.use_compositing = True
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.render.filepath = str(elsewhere / "output")


def test_nothing_in_a_scene_runs_or_writes(edited, tmp_path, command):
    path = edited(busy)
    before = files(tmp_path)
    result = command("generator", "sweep", path, "-o", tmp_path / "set", *TINY, "--engine", "path")
    assert result.returncode == 0, result.stderr
    script = (
        "import sys, runpy, bpy;"
        f"bpy.ops.wm.open_mainfile(filepath={str(path)!r}, use_scripts=False);"
        f"sys.argv = ['blender', '--', '-o', {str(tmp_path / 'set' / 'b')!r}, *{TINY[:-2]!r}];"
        f"runpy.run_path({str(ROOT / 'generator' / 'batch.py')!r}, run_name='__main__')"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert files(tmp_path) == before
    asked = f"import bpy; bpy.ops.wm.open_mainfile(filepath={str(path)!r}, use_scripts=True)"
    subprocess.run([sys.executable, "-c", asked], capture_output=True, check=True)
    assert files(tmp_path) - before == {Path("elsewhere/text")}, "the mark is left where a file's scripts are on"


@pytest.mark.slow
def test_nothing_runs_or_writes_while_a_scene_is_checked_and_planned(edited, tmp_path, monkeypatch):
    monkeypatch.setattr(planning, "_ORDERS", ())  # more reflections, which take seconds each, write nothing either
    path = edited(busy)
    before = files(tmp_path)
    assert check.check_scene(blend_file.open_file(path), {"resolution": "8", "samples": 4})
    assert planning.make(path, tolerance=0.1, count=2, by_cycles=False, predict=False).effects
    assert files(tmp_path) == before


@pytest.mark.parametrize("engine", renderers.ENGINES)
def test_what_may_run_or_write_is_off_while_a_scene_is_rendered(scene_file, engine):
    """And as it was afterwards."""
    scene = blend_file.open_file(scene_file)
    names = ("use_freestyle", "use_compositing", "use_sequencer")
    for name in names:
        setattr(scene.render, name, True)
    with renderers.opened(scene, engine, resolution=(8, 8)):
        assert not any(getattr(scene.render, name) for name in names)
    assert all(getattr(scene.render, name) for name in names)
