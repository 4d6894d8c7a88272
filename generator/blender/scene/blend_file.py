"""Opens, saves and creates blend files."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import bpy

from generator.blender.scene import references
from generator.blender.scene.quiet import quiet
from generator.model.errors import NlosError


def open_file(path: Path, known: Collection[Path] = ()) -> bpy.types.Scene:
    """Open a ``.blend``, running none of the scripts stored in it, and return its active scene.

    Parameters
    ----------
    path : Path
    known : collection of Path
        Files outside its folder that it may refer to.

    Raises
    ------
    NlosError
        There is no such file, Blender cannot read it, it refers to files elsewhere (`references.refuse`), or its
        pictures depend on files that are missing (`references.require`).
    """
    scene = load_file(path, known)
    references.require(scene, path)
    return scene


def load_file(path: Path, known: Collection[Path] = ()) -> bpy.types.Scene:
    """Do the same, although files that its pictures depend on may be missing."""
    if not path.is_file():
        raise NlosError(f"{path}: no such scene file")
    references.refuse(path, known)
    try:
        with quiet():
            bpy.ops.wm.open_mainfile(filepath=literal(path), load_ui=False, use_scripts=False)
    except RuntimeError:
        raise NlosError(f"{path}: is not a scene Blender {bpy.app.version_string} can open") from None
    return bpy.context.scene


def literal(path: Path, *, rendered: bool = False) -> str:
    """Return a path, escaped so that Blender takes it literally.

    Blender reads two slashes at the start as the open file's folder and, from Blender 5 on, braces in the path that
    is rendered to as variables.
    """
    text = str(path)
    if text.startswith("//"):
        text = text[1:]
    if rendered and bpy.app.version >= (5, 0):
        text = text.replace("{", "{{").replace("}", "}}")
    return text


def save_file(path: Path) -> None:
    """Save a compressed copy of the open file under a temporary name and rename it; textures stay where they are."""
    from generator.files.writing import atomic

    with atomic(path) as temporary:
        _save(temporary, path, compress=True)


def save_snapshot(path: Path) -> None:
    """Save a copy of the open file for another process to read soon: quickly, neither compressed nor flushed."""
    files = bpy.context.preferences.filepaths
    before, is_dirty = files.file_preview_type, bpy.context.preferences.is_dirty
    files.file_preview_type = "NONE"  # drawing a preview would hold the window
    try:
        _save(path, path, compress=False)
    finally:
        files.file_preview_type = before
        bpy.context.preferences.is_dirty = is_dirty


def _save(path: Path, named: Path, *, compress: bool) -> None:
    with quiet():
        try:
            bpy.ops.wm.save_as_mainfile(
                filepath=literal(path), copy=True, compress=compress, check_existing=False, relative_remap=True
            )
        except RuntimeError as error:
            raise NlosError(f"{named}: cannot be written ({' '.join(str(error).split())})") from None


def new_file() -> bpy.types.Scene:
    """Start an empty file and return its scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def clear() -> bpy.types.Scene:
    """Start an empty file without loading preferences and add-ons anew, and return its scene."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return bpy.context.scene
