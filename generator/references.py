"""Other files that a ``.blend`` refers to: libraries, pictures, sounds, volumes, caches, meshes that nodes import.

They are looked for before Blender opens the file, by linking what is in it without evaluating any of it: a file that
is opened is evaluated at once, and then reads meshes that its nodes name, and writes caches of simulations wherever
it likes. Only linked libraries are read by looking. What lies in the scene's own folder is part of the work; what
lies elsewhere is refused unless its user says otherwise.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import bpy

from generator.links import real, trusted
from generator.spec import NlosError

_WITH_FILES = ("libraries", "images", "movieclips", "sounds", "volumes", "cache_files", "fonts")
"""Of `bpy.data`: what has one file each."""


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
    from generator import stage  # which opens what was looked at

    own = real(scene)
    if bpy.data.filepath and real(Path(bpy.data.filepath)) == own:  # open already: by its user, or looked at before
        return _looked_at(bpy.data, own)
    with bpy.data.temp_data() as inside, stage.quiet():
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
        if name != "<builtin>" and not isinstance(block, bpy.types.Text)  # whose text is in the file
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
