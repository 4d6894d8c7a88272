"""Files that are gone: an error that names the file, where what is rendered is made from it; else nothing."""

from __future__ import annotations

import shutil

import bpy
import pytest
from conftest import TINY

from generator.blender.scene import blend_file, references
from generator.model.errors import NlosError


def square(scene, name="Extra"):
    """An object that is rendered, in a corner of the room, with a material of its own."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0, 0, 0), (0.2, 0, 0), (0, 0, 0.2)], [], [(0, 1, 2)])
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # Blender 5 makes the tree itself and warns of the old switch
        material.use_nodes = True
    mesh.materials.append(material)
    obj = bpy.data.objects.new(name, mesh)
    obj.location = (2.0, 3.0, 0.1)
    scene.collection.objects.link(obj)
    return obj


def an_image(file):
    image = bpy.data.images.new(file.name, 4, 4)
    image.filepath_raw, image.file_format = str(file), "PNG"
    image.save()
    bpy.data.images.remove(image)
    return bpy.data.images.load(str(file))


def papered(scene, image, *, linked=True):
    """Cover an object with a picture."""
    tree = square(scene).active_material.node_tree
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    if linked:
        shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
        tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    return node


def a_library(folder, *names):
    """Write a library with objects in a collection, and take them out of the open file."""
    made = bpy.data.collections.new("Furniture")
    for name in names:
        made.objects.link(bpy.data.objects.new(name, bpy.data.meshes.new(name)))
    kept = {made, *made.objects}
    bpy.data.libraries.write(str(folder / "library.blend"), kept)
    bpy.data.batch_remove(kept)


def linked(scene, folder):
    a_library(folder, "Chair")
    with bpy.data.libraries.load(str(folder / "library.blend"), link=True) as (_, wanted):
        wanted.objects = ["Chair"]
    scene.collection.objects.link(wanted.objects[0])
    return "library.blend"


def linked_collection(scene, folder):
    """The furniture in a collection below the scene's own, of which nothing at all is left."""
    a_library(folder, "Chair", "Table")
    with bpy.data.libraries.load(str(folder / "library.blend"), link=True) as (_, wanted):
        wanted.collections = ["Furniture"]
    scene.collection.children.link(wanted.collections[0])
    return "library.blend"


def instanced(scene, folder):
    linked_collection(scene, folder)
    collection = scene.collection.children["Furniture"]
    scene.collection.children.unlink(collection)
    holder = bpy.data.objects.new("Holder", None)
    holder.instance_type, holder.instance_collection = "COLLECTION", collection
    scene.collection.objects.link(holder)
    return "library.blend"


def a_picture(scene, folder):
    papered(scene, an_image(folder / "wallpaper.png"))
    return "wallpaper.png"


def a_tile(scene, folder):
    for number in (1001, 1002):
        an_image(folder / f"tile.{number}.png")
    image = bpy.data.images.load(str(folder / "tile.1001.png"))
    image.source, image.filepath = "TILED", str(folder / "tile.<UDIM>.png")
    image.tiles.new(1002)
    papered(scene, image)
    return "tile.1002.png"


def a_frame(scene, folder):
    for number in (1, 2, 3):
        an_image(folder / f"film{number:03d}.png")
    image = bpy.data.images.load(str(folder / "film001.png"))
    image.source = "SEQUENCE"
    node = papered(scene, image)
    node.image_user.frame_duration, scene.frame_current = 3, 2
    return "film002.png"


def a_mesh_cache(scene, folder):
    modifier = square(scene).modifiers.new("cache", "MESH_CACHE")
    modifier.cache_format, modifier.filepath = "PC2", str(folder / "moves.pc2")
    return "moves.pc2"


def a_light_profile(scene, folder):
    node = papered(scene, None, linked=False).id_data.nodes.new("ShaderNodeTexIES")
    node.mode, node.filepath = "EXTERNAL", str(folder / "lamp.ies")
    return "lamp.ies"


def a_volume(scene, folder):
    data = bpy.data.volumes.new("smoke")
    data.filepath = str(folder / "smoke.vdb")
    scene.collection.objects.link(bpy.data.objects.new("smoke", data))
    return "smoke.vdb"


def in_a_group(scene, folder):
    """A picture two node groups deep."""
    inner = bpy.data.node_groups.new("inner", "ShaderNodeTree")
    inner.nodes.new("ShaderNodeTexImage").image = an_image(folder / "deep.png")
    outer = bpy.data.node_groups.new("outer", "ShaderNodeTree")
    outer.nodes.new("ShaderNodeGroup").node_tree = inner
    papered(scene, None, linked=False).id_data.nodes.new("ShaderNodeGroup").node_tree = outer
    return "deep.png"


CASES = (
    linked,
    linked_collection,
    instanced,
    a_picture,
    a_tile,
    a_frame,
    a_mesh_cache,
    a_light_profile,
    a_volume,
    in_a_group,
)


@pytest.fixture
def saved(tmp_path, scene_file):
    """Return what edits the room and saves it."""

    def save(edit):
        path = tmp_path / "scene.blend"
        scene = blend_file.open_file(scene_file)
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
        name = edit(scene, tmp_path)
        bpy.ops.wm.save_as_mainfile(filepath=str(path), relative_remap=True)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        return path, name

    return save


@pytest.mark.parametrize("case", CASES)
def test_what_is_rendered_and_gone_is_named(case, saved):
    path, name = saved(case)
    if (path.parent / name).exists():
        blend_file.open_file(path)
        (path.parent / name).unlink()
        blend_file.new_file()
    with pytest.raises(NlosError, match=rf"/{name} is not there, which its ") as told:
        blend_file.open_file(path)
    assert "put it back" in str(told.value)


def test_a_library_that_lacks_one_thing(saved):
    path, _ = saved(linked)
    a_library(path.parent, "Table")
    with pytest.raises(NlosError, match=r"library\.blend does not hold its object 'Chair' any more"):
        blend_file.open_file(path)


def test_a_file_that_is_no_picture(saved):
    path, name = saved(a_picture)
    (path.parent / name).write_text("text")
    with pytest.raises(NlosError, match=r"wallpaper\.png is no picture that Blender can read"):
        blend_file.open_file(path)


def unused(scene, folder):
    image = an_image(folder / "photo.png")
    image.use_fake_user = True
    hidden = papered(scene, an_image(folder / "poster.png"))
    bpy.data.objects["Extra"].hide_render = True
    sound = bpy.data.sounds.load(str(folder / "photo.png"), check_existing=True)
    sound.use_fake_user = True
    return hidden.image.name


def packed(scene, folder):
    a_picture(scene, folder)
    bpy.data.images["wallpaper.png"].pack()
    return "wallpaper.png"


def not_in_renders(scene, folder):
    a_mesh_cache(scene, folder)
    bpy.data.objects["Extra"].modifiers[0].show_render = False
    return "moves.pc2"


def made_by_blender(scene, folder):
    """A picture that Blender makes, which has a name for a file that was never written."""
    image = bpy.data.images.new("checks", 8, 8)
    image.filepath_raw = str(folder / "checks.png")
    papered(scene, image)
    bpy.data.curves.new("words", "FONT")
    text = bpy.data.objects.new("words", bpy.data.curves["words"])
    text.location = (2.0, 3.0, 0.1)
    scene.collection.objects.link(text)
    return "checks.png"


@pytest.mark.parametrize("case", [unused, packed, not_in_renders, made_by_blender])
def test_what_no_picture_needs_may_be_gone(case, saved):
    path, name = saved(case)
    for file in path.parent.glob("*.png"):
        file.unlink()
    assert references.missing(blend_file.open_file(path)) == []
    assert not (path.parent / name).exists()


@pytest.mark.slow
def test_every_way_to_render_says_so(tmp_path, saved, command):
    """The library is gone before a set is planned, and when one goes on."""
    path, name = saved(linked)
    good = command("generator", "sweep", path, "-o", tmp_path / "set", *TINY)
    assert good.returncode == 0, good.stderr
    (path.parent / name).unlink()
    for arguments in (
        ("sweep", path, "-o", tmp_path / "new", *TINY),
        ("bulk", path, "-o", tmp_path / "bulk", "--pictures", "9"),
        ("check", path),
    ):
        done = command("generator", *arguments)
        assert (done.returncode, done.stdout) == (2, ""), arguments
        assert "library.blend is not there" in done.stderr
    (next((tmp_path / "set").glob("?/*.exr"))).unlink()
    done = command("generator", "sweep", path, "-o", tmp_path / "set", *TINY)
    assert done.returncode == 2
    assert "library.blend" in done.stderr


BUILT_IN = "ocio://studio-config-v4.0.0_aces-v2.0_ocio-v2.5"


def a_project(folder, configuration):
    settings = folder / ".blender_project" / "project.toml"
    settings.parent.mkdir(exist_ok=True)
    settings.write_text(f'schema_version = 1\nname = "lab"\nocio_config = "{configuration}"\n')


def test_the_colours_of_a_project_are_a_file_that_a_scene_refers_to(tmp_path):
    scene = tmp_path / "in" / "a.blend"
    scene.parent.mkdir()
    assert references.project_colours(scene) == []
    a_project(tmp_path, "{project_root}/ocio/config.ocio")
    assert references.project_colours(scene) == [tmp_path / "ocio" / "config.ocio"]
    a_project(tmp_path, BUILT_IN)
    assert references.project_colours(scene) == []
    a_project(scene.parent, "/elsewhere/config.ocio")
    assert [str(path) for path in references.project_colours(scene)] == ["/elsewhere/config.ocio"]


@pytest.mark.skipif(not hasattr(bpy.data, "project"), reason="Blender has projects since 5.3")
def test_a_project_with_colours_of_its_own_is_refused(tmp_path, scene_file, command):
    """A set's copy of the scene lies elsewhere, where its textures would have other colours."""
    scene = tmp_path / "room.blend"
    shutil.copy(scene_file, scene)
    for configuration, words in (
        ("/elsewhere/config.ocio", "refers to /elsewhere/config.ocio, outside its own folder"),
        (BUILT_IN, f"cannot be swept: its colours follow the OpenColorIO configuration of the project {tmp_path}"),
    ):
        a_project(tmp_path, configuration)
        done = command("generator", "sweep", scene, "-o", tmp_path / "set", *TINY)
        assert (done.returncode, (tmp_path / "set").exists()) == (2, False)
        assert words in done.stderr
    a_project(tmp_path, "")
    assert command("generator", "sweep", scene, "-o", tmp_path / "set", *TINY).returncode == 0
