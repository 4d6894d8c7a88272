"""Other files that a ``.blend`` refers to: libraries, pictures, sounds, volumes, caches, meshes that nodes import.

They are collected before Blender opens the file, by linking its data without evaluating them: a file that is opened
is evaluated at once, and then reads the meshes that its nodes name, and writes caches of simulations to any path.
Collecting reads linked libraries only. Files in the scene's own folder are accepted; files elsewhere are refused
unless the user allows them.

Once a file is open, the files that its pictures depend on must exist too: Blender leaves out a missing library and
paints over what a missing picture covers, without any message.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

import bpy

from generator.blender.scene import roles
from generator.blender.scene.quiet import quiet
from generator.files.toml import read_toml
from generator.model.errors import NlosError
from generator.sets.links import real, trusted

_WITH_FILES = ("libraries", "images", "movieclips", "sounds", "volumes", "cache_files", "fonts")
"""Collections of `bpy.data` whose items have one file each."""
_BUILT_IN = "<builtin>"
"""File name of data that are built into Blender."""
_PROJECT = Path(".blender_project", "project.toml")
"""Settings of a project, which Blender 5.3 looks for in a scene's folder and those above, and reads with it."""


def refuse(scene: Path, known: Collection[Path] = ()) -> list[Path]:
    """Return the files that a scene refers to, before it is opened; refuse those that are not allowed.

    Parameters
    ----------
    scene : Path
        The ``.blend``.
    known : collection of Path
        Files outside its folder that it may refer to.

    Raises
    ------
    NlosError
        Links are not trusted, and the scene refers to files outside its folder or to files whose names cannot be
        known, or writes files as soon as it is opened; or it cannot be read.
    """
    files, doubts = _look(scene)
    if hasattr(bpy.data, "project"):
        files += project_colours(scene)
    if not trusted():
        folder = real(scene.parent)
        allowed = {real(path) for path in known}
        outside = [path for path in files if not real(path).is_relative_to(folder) and real(path) not in allowed]
        if outside:
            suffix = f" and {len(outside) - 1} more" if len(outside) > 1 else ""
            raise NlosError(
                f"{scene}: refers to {outside[0]}{suffix}, outside its own folder; copy what it needs there and save "
                "it with relative paths, or allow it with --trust-links"
            )
        if doubts:
            raise NlosError(f"{scene}: {doubts[0]}; or allow it with --trust-links")
    return files


def project_colours(scene: Path) -> list[Path]:
    """Return the file of the OpenColorIO configuration that a scene's project sets, if it is no built-in one."""
    for folder in scene.absolute().parents:
        if (folder / _PROJECT).is_file():  # the nearest is the scene's
            name = str(read_toml(folder / _PROJECT).get("ocio_config", ""))
            return [folder / name.replace("{project_root}", str(folder))] if name and "://" not in name else []
    return []


def is_open(scene: Path) -> bool:
    """Return whether a ``.blend`` is the file that is open."""
    return bool(bpy.data.filepath) and real(Path(bpy.data.filepath)) == real(scene)


def _look(scene: Path) -> tuple[list[Path], list[str]]:
    """Return the files that a scene refers to, and further reasons against opening it."""
    path = real(scene)
    if is_open(scene):  # by its user, or checked before
        return _looked_at(bpy.data, path)
    found = _linked(scene, path)
    if found is None:
        raise NlosError(f"{scene}: is not a scene Blender {bpy.app.version_string} can open")
    return found


def _linked(scene: Path, path: Path) -> tuple[list[Path], list[str]] | None:
    """Do the same for a file that is not open; None if Blender cannot read it.

    No error leaves this function, for it would keep the temporary data in its traceback, and Blender 5.0 crashed when
    another file was opened meanwhile.
    """
    with bpy.data.temp_data() as inside, quiet():
        try:
            with inside.libraries.load(str(scene), link=True) as (available, linked):
                for kind in dir(available):
                    if isinstance(names := getattr(available, kind), list):
                        setattr(linked, kind, list(names))
        except OSError:
            return None
        return _looked_at(inside, path)


def _looked_at(inside: Any, own: Path) -> tuple[list[Path], list[str]]:
    # Blender 4.2 has no `file_path_map`.
    paths = inside.file_path_map(include_libraries=True) if hasattr(inside, "file_path_map") else _named(inside)
    files = {
        Path(bpy.path.abspath(name, library=block.library))
        for block, names in paths.items()
        for name in names
        if name != _BUILT_IN and not isinstance(block, bpy.types.Text)  # whose text is stored in the scene
    }
    return sorted(path for path in files if real(path) != own), _doubts(inside)


def _named(inside: Any) -> dict[Any, set[str]]:
    """Return the file paths that each data-block names."""
    paths: dict[Any, set[str]] = {}
    for kind in _WITH_FILES:
        for block in getattr(inside, kind):
            if not getattr(block, "packed_file", None) and block.filepath:
                paths[block] = {block.filepath}
    for obj in inside.objects:
        settings = [getattr(modifier, "domain_settings", None) for modifier in obj.modifiers]
        if folders := {domain.cache_directory for domain in settings if domain}:
            paths[obj] = folders
    for block in (*inside.materials, *inside.lights, *inside.worlds, *inside.node_groups):
        tree = getattr(block, "node_tree", block)
        if node_paths := {node.filepath for node in getattr(tree, "nodes", ()) if getattr(node, "filepath", "")}:
            paths[block] = node_paths
    return paths


def _doubts(inside: Any) -> list[str]:
    """Return a phrase for whatever reads files of unknown names, or writes files when the scene is opened."""
    doubts = []
    for tree in inside.node_groups:
        for node in tree.nodes:
            if node.bl_idname.startswith("GeometryNodeImport") and node.inputs[0].is_linked:
                doubts.append(
                    f"its node group {tree.name!r} imports files whose names it makes up; name them in full"
                )
    for obj in inside.objects:
        for modifier in obj.modifiers:
            domain = getattr(modifier, "domain_settings", None)
            if domain is not None and domain.cache_type == "REPLAY":
                doubts.append(
                    f"its fluid domain {obj.name!r} is simulated, and writes its cache, as soon as the file is "
                    "opened; bake it, or apply its modifier"
                )
        if any(cache.use_disk_cache for cache in _caches(obj)):
            doubts.append(
                f"its object {obj.name!r} writes a cache as soon as the file is opened; untick Disk Cache, or apply "
                "the modifier"
            )
    return doubts


def _caches(obj: Any) -> Iterator[Any]:
    for owner in (*obj.modifiers, *obj.particle_systems):
        if cache := getattr(owner, "point_cache", None):
            yield cache
        canvas = getattr(owner, "canvas_settings", None)
        for surface in canvas.canvas_surfaces if canvas else ():
            yield surface.point_cache


def require(scene: bpy.types.Scene, path: Path) -> None:
    """Raise NlosError, naming the first, if files that an open scene's pictures depend on are missing."""
    if gone := missing(scene):
        suffix = f" (and {len(gone) - 1} more)" if len(gone) > 1 else ""
        raise NlosError(f"{path}: {gone[0]}{suffix}; put it back, or take what needs it out of the scene")


def missing(scene: bpy.types.Scene) -> list[str]:
    """Return a phrase for each missing file that an open scene's pictures depend on.

    Only rendered data and the data that they use count: a missing sound, or the picture of an object that is hidden
    from renders, changes nothing.
    """
    rendered = _shown(scene)
    phrases = [_placeholder(block) for block in rendered if getattr(block, "is_missing", False)]
    paths = bpy.data.file_path_map(subset=rendered) if hasattr(bpy.data, "file_path_map") else _named(bpy.data)
    present = {block for block in rendered if not getattr(block, "is_missing", False)}
    for block in sorted(present & set(paths), key=lambda block: (block.id_type, block.name)):
        phrases += [
            f"{file} {fault}, which its {_words(block)} is made from"
            for file, fault in _lacking(scene, block, paths[block])
        ]
    return phrases


def _shown(scene: bpy.types.Scene) -> set[Any]:
    """Return all data-blocks that the rendered picture depends on."""
    users = bpy.data.user_map()
    needs: dict[Any, list[Any]] = {}
    for block, dependents in users.items():
        for user in dependents:
            needs.setdefault(user, []).append(block)
    todo = [scene.world, scene.camera, *(obj for obj in scene.objects if not roles.unseen(scene, obj))]
    blocks: set[Any] = set()
    while todo:
        block = todo.pop()
        if block is not None and block not in blocks and block.id_type not in ("SCENE", "TEXT", "LIBRARY"):
            blocks.add(block)
            todo += needs.get(block, [])
    for layer in scene.view_layers:
        blocks |= set(_collections(layer.layer_collection)) if layer.use else set()
    return blocks


def _collections(layer: Any) -> Iterator[Any]:
    """Yield the rendered collections of a view layer; of a missing linked one nothing else is left."""
    if not layer.exclude and not layer.collection.hide_render:
        yield layer.collection
        for child in layer.children:
            yield from _collections(child)


def _words(block: Any) -> str:
    return f"{block.bl_rna.name.lower()} {block.name!r}"


def _placeholder(block: Any) -> str:
    file = Path(bpy.path.abspath(block.library.filepath))
    if file.is_file():
        return f"{file} does not hold its {_words(block)} any more"
    return f"{file} is not there, which its {_words(block)} is linked from"


def _lacking(scene: bpy.types.Scene, block: Any, names: Collection[str]) -> Iterator[tuple[Path, str]]:
    """Yield the files that a data-block names and that are missing or no readable picture, each with its fault."""
    if isinstance(block, bpy.types.Object):
        names = set(_of_modifiers(block)) & set(names)
    if isinstance(block, bpy.types.Image) and block.source == "GENERATED":
        names = ()
    for name in sorted(set(names) - {"", _BUILT_IN}):
        files = list(_numbered(scene, block, bpy.path.abspath(name, library=block.library)))
        gone = [file for file in files if not file.exists()]
        yield from ((file, "is not there") for file in gone[:1])
        if not gone and getattr(block, "source", "") == "FILE" and not _readable(block):
            yield files[0], "is no picture that Blender can read"


def _of_modifiers(obj: bpy.types.Object) -> Iterator[str]:
    """Yield the paths that an object's modifiers read in renders; an unbaked simulation reads none."""
    for modifier in obj.modifiers:
        domain = getattr(modifier, "domain_settings", None)
        if not modifier.show_render:
            continue
        if modifier.type == "MESH_CACHE":
            yield modifier.filepath
        elif domain is not None and domain.has_cache_baked_any:
            yield domain.cache_directory
    yield from (cache.filepath for cache in _caches(obj) if cache.use_external)


def _numbered(scene: bpy.types.Scene, block: Any, name: str) -> Iterable[Path]:
    """Return the files that a numbered name stands for: tiles of a picture, or frames of a sequence."""
    if getattr(block, "source", "") == "TILED":
        tiles = [tile.number for tile in block.tiles]
        marks = [(f"{n}", f"u{(n - 1001) % 10 + 1}_v{(n - 1001) // 10 + 1}") for n in tiles]
        return [Path(name.replace("<UDIM>", udim).replace("<UVTILE>", uv)) for udim, uv in marks]
    if getattr(block, "source", "") == "SEQUENCE":
        return [Path(_frame(name, frame)) for frame in _frames(scene, block)]
    if getattr(block, "is_sequence", False):  # a volume or a cache, which selects its frames itself
        folder, regex = Path(name).parent, re.compile(r"\d+".join(map(re.escape, re.split(r"\d+", Path(name).name))))
        matches = [file for file in (folder.iterdir() if folder.is_dir() else ()) if regex.fullmatch(file.name)]
        return matches[:1] or [Path(name)]
    return [Path(name)]


def _frame(name: str, frame: int) -> str:
    """Return the file name of a sequence's frame: the last number in the name is replaced."""
    return re.sub(r"\d+(?=\D*$)", lambda digits: str(frame).zfill(len(digits[0])), name)


def _frames(scene: bpy.types.Scene, image: bpy.types.Image) -> list[int]:
    """Return the frames of a sequence that a render of the scene shows."""
    trees = [getattr(b, "node_tree", None) for b in (*bpy.data.materials, *bpy.data.worlds, *bpy.data.lights)]
    nodes = [node for tree in (*filter(None, trees), *bpy.data.node_groups) for node in tree.nodes]
    users = [
        node.image_user for node in nodes if getattr(node, "image", None) == image and hasattr(node, "image_user")
    ]
    frames = set()
    for user in users:
        frame, length = scene.frame_current - user.frame_start + 1, max(1, user.frame_duration)
        frame = (frame - 1) % length + 1 if user.use_cyclic else min(max(frame, 1), length)
        frames.add(frame + user.frame_offset)
    return sorted(frames)


def _readable(image: bpy.types.Image) -> bool:
    """Whether a picture can be decoded; pixels that were not loaded before are freed again."""
    loaded = image.has_data
    readable = bool(min(image.size) > 0)
    if not loaded and image.has_data:
        image.buffers_free()
    return readable
