"""Other files that a ``.blend`` refers to: libraries, pictures, sounds, volumes, caches, meshes that nodes import.

They are looked for before Blender opens the file, by linking what is in it without evaluating any of it: a file that
is opened is evaluated at once, and then reads meshes that its nodes name, and writes caches of simulations wherever
it likes. Only linked libraries are read by looking. What lies in the scene's own folder is part of the work; what
lies elsewhere is refused unless its user says otherwise.

Once a file is open, what its pictures need must be there too: Blender leaves a library that is gone out, paints what
a missing picture covers, and says nothing.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

import bpy

from generator.blender.scene import roles
from generator.blender.scene.quiet import quiet
from generator.model.errors import NlosError
from generator.sets.links import real, trusted

_WITH_FILES = ("libraries", "images", "movieclips", "sounds", "volumes", "cache_files", "fonts")
"""Of `bpy.data`: what has one file each."""
_BUILT_IN = "<builtin>"
"""In place of the file of what Blender brings along."""


def refuse(scene: Path, known: Collection[Path] = ()) -> list[Path]:
    """Return the files that a scene refers to, before it is opened.

    Parameters
    ----------
    scene : Path
        The ``.blend``.
    known : collection of Path
        Files outside its folder that it may refer to.

    Raises
    ------
    NlosError
        Links are not trusted, and it refers to files outside its folder, or to some whose names only it knows; or it
        writes files as soon as it is opened.
    """
    found, doubts = _look(scene)
    if not trusted():
        folder = real(scene.parent)
        allowed = {real(path) for path in known}
        outside = [path for path in found if not real(path).is_relative_to(folder) and real(path) not in allowed]
        if outside:
            more = f" and {len(outside) - 1} more" if len(outside) > 1 else ""
            raise NlosError(
                f"{scene}: refers to {outside[0]}{more}, outside its own folder; copy what it needs there and save "
                "it with relative paths, or allow it with --trust-links"
            )
        if doubts:
            raise NlosError(f"{scene}: {doubts[0]}; or allow it with --trust-links")
    return found


def _look(scene: Path) -> tuple[list[Path], list[str]]:
    """The files that a scene refers to, and what else is wrong with it."""
    own = real(scene)
    if bpy.data.filepath and real(Path(bpy.data.filepath)) == own:  # open already: by its user, or looked at before
        return _looked_at(bpy.data, own)
    with bpy.data.temp_data() as inside, quiet():
        try:
            with inside.libraries.load(str(scene), link=True) as (there, wanted):
                for kind in dir(there):
                    if isinstance(names := getattr(there, kind), list):
                        setattr(wanted, kind, list(names))
        except OSError:
            raise NlosError(f"{scene}: is not a scene Blender {bpy.app.version_string} can open") from None
        return _looked_at(inside, own)


def _looked_at(inside: Any, own: Path) -> tuple[list[Path], list[str]]:
    # Blender 4.2 has no list of its own.
    named = inside.file_path_map(include_libraries=True) if hasattr(inside, "file_path_map") else _named(inside)
    found = {
        Path(bpy.path.abspath(name, library=block.library))
        for block, names in named.items()
        for name in names
        if name != _BUILT_IN and not isinstance(block, bpy.types.Text)  # whose text is in the file
    }
    return sorted(path for path in found if real(path) != own), _doubts(inside)


def _named(inside: Any) -> dict[Any, set[str]]:
    """What file each piece of Blender's data names."""
    made: dict[Any, set[str]] = {}
    for kind in _WITH_FILES:
        for block in getattr(inside, kind):
            if not getattr(block, "packed_file", None) and block.filepath:
                made[block] = {block.filepath}
    for obj in inside.objects:
        settings = [getattr(modifier, "domain_settings", None) for modifier in obj.modifiers]
        if folders := {domain.cache_directory for domain in settings if domain}:
            made[obj] = folders
    for block in (*inside.materials, *inside.lights, *inside.worlds, *inside.node_groups):
        tree = getattr(block, "node_tree", block)
        if files := {node.filepath for node in getattr(tree, "nodes", ()) if getattr(node, "filepath", "")}:
            made[block] = files
    return made


def _doubts(inside: Any) -> list[str]:
    """What reads files that nobody can name beforehand, or writes some when the file is opened; a phrase each."""
    made = []
    for tree in inside.node_groups:
        for node in tree.nodes:
            if node.bl_idname.startswith("GeometryNodeImport") and node.inputs[0].is_linked:
                made.append(f"its node group {tree.name!r} imports files whose names it makes up; name them in full")
    for obj in inside.objects:
        for modifier in obj.modifiers:
            domain = getattr(modifier, "domain_settings", None)
            if domain is not None and domain.cache_type == "REPLAY":
                made.append(
                    f"its fluid domain {obj.name!r} is simulated, and writes its cache, as soon as the file is "
                    "opened; bake it, or apply its modifier"
                )
        if any(cache.use_disk_cache for cache in _caches(obj)):
            made.append(
                f"its object {obj.name!r} writes a cache as soon as the file is opened; untick Disk Cache, or apply "
                "the modifier"
            )
    return made


def _caches(obj: Any) -> Iterator[Any]:
    for owner in (*obj.modifiers, *obj.particle_systems):
        if cache := getattr(owner, "point_cache", None):
            yield cache
        canvas = getattr(owner, "canvas_settings", None)
        for surface in canvas.canvas_surfaces if canvas else ():
            yield surface.point_cache


def require(scene: bpy.types.Scene, path: Path) -> None:
    """Raise NlosError, naming the first, if files are not there that the pictures of an open scene are made from."""
    if gone := missing(scene):
        more = f" (and {len(gone) - 1} more)" if len(gone) > 1 else ""
        raise NlosError(f"{path}: {gone[0]}{more}; put it back, or take what needs it out of the scene")


def missing(scene: bpy.types.Scene) -> list[str]:
    """Return what is not there of the files that an open scene's pictures are made from, a phrase each.

    Only what is rendered counts, and whatever it is made from: a missing sound, or the picture of an object that is
    hidden from renders, changes nothing.
    """
    shown = _shown(scene)
    made = [_placeholder(block) for block in shown if getattr(block, "is_missing", False)]
    paths = bpy.data.file_path_map(subset=shown) if hasattr(bpy.data, "file_path_map") else _named(bpy.data)
    kept = {block for block in shown if not getattr(block, "is_missing", False)}
    for block in sorted(kept & set(paths), key=lambda block: (block.id_type, block.name)):
        made += [
            f"{file} {why}, which its {_words(block)} is made from"
            for file, why in _lacking(scene, block, paths[block])
        ]
    return made


def _shown(scene: bpy.types.Scene) -> set[Any]:
    """Every piece of data that what is rendered is made from."""
    users = bpy.data.user_map()
    needs: dict[Any, list[Any]] = {}
    for block, by in users.items():
        for user in by:
            needs.setdefault(user, []).append(block)
    todo = [scene.world, scene.camera, *(obj for obj in scene.objects if not roles.unseen(scene, obj))]
    found: set[Any] = set()
    while todo:
        block = todo.pop()
        if block is not None and block not in found and block.id_type not in ("SCENE", "TEXT", "LIBRARY"):
            found.add(block)
            todo += needs.get(block, [])
    for layer in scene.view_layers:
        found |= set(_collections(layer.layer_collection)) if layer.use else set()
    return found


def _collections(layer: Any) -> Iterator[Any]:
    """The collections of a view layer that are rendered; of one that is gone nothing else is left."""
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
    """Of the files that a piece of data names, those that are not there, or no picture, and which of the two."""
    if isinstance(block, bpy.types.Object):
        names = set(_of_modifiers(block)) & set(names)
    if isinstance(block, bpy.types.Image) and block.source == "GENERATED":
        names = ()
    for name in sorted(set(names) - {"", _BUILT_IN}):
        every = list(_numbered(scene, block, bpy.path.abspath(name, library=block.library)))
        gone = [file for file in every if not file.exists()]
        yield from ((file, "is not there") for file in gone[:1])
        if not gone and getattr(block, "source", "") == "FILE" and not _readable(block):
            yield every[0], "is no picture that Blender can read"


def _of_modifiers(obj: bpy.types.Object) -> Iterator[str]:
    """What an object's modifiers read in renders; of a simulation that is not baked there is nothing to read."""
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
    """The files that a name with a number in it stands for: tiles of a picture, or a frame of a sequence."""
    if getattr(block, "source", "") == "TILED":
        tiles = [tile.number for tile in block.tiles]
        marks = [(f"{n}", f"u{(n - 1001) % 10 + 1}_v{(n - 1001) // 10 + 1}") for n in tiles]
        return [Path(name.replace("<UDIM>", udim).replace("<UVTILE>", uv)) for udim, uv in marks]
    if getattr(block, "source", "") == "SEQUENCE":
        return [Path(_frame(name, frame)) for frame in _frames(scene, block)]
    if getattr(block, "is_sequence", False):  # a volume, or a cache, which know their frames themselves
        folder, wanted = Path(name).parent, re.compile(r"\d+".join(map(re.escape, re.split(r"\d+", Path(name).name))))
        there = [file for file in (folder.iterdir() if folder.is_dir() else ()) if wanted.fullmatch(file.name)]
        return there[:1] or [Path(name)]
    return [Path(name)]


def _frame(name: str, frame: int) -> str:
    """The name of a sequence's file for a frame: its last number is replaced."""
    return re.sub(r"\d+(?=\D*$)", lambda digits: str(frame).zfill(len(digits[0])), name)


def _frames(scene: bpy.types.Scene, image: bpy.types.Image) -> list[int]:
    """The frames of a sequence that a render of the scene shows."""
    trees = [getattr(b, "node_tree", None) for b in (*bpy.data.materials, *bpy.data.worlds, *bpy.data.lights)]
    nodes = [node for tree in (*filter(None, trees), *bpy.data.node_groups) for node in tree.nodes]
    users = [
        node.image_user for node in nodes if getattr(node, "image", None) == image and hasattr(node, "image_user")
    ]
    found = set()
    for user in users:
        frame, last = scene.frame_current - user.frame_start + 1, max(1, user.frame_duration)
        frame = (frame - 1) % last + 1 if user.use_cyclic else min(max(frame, 1), last)
        found.add(frame + user.frame_offset)
    return sorted(found)


def _readable(image: bpy.types.Image) -> bool:
    """Whether a picture can be decoded; one that nobody has looked at yet is forgotten again."""
    before = image.has_data
    sound = bool(min(image.size) > 0)
    if not before and image.has_data:
        image.buffers_free()
    return sound
