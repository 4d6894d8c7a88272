"""Reading a target's mesh file in another process, so that neither the window waits nor the open file gains its data.

The panel asks while it is drawn, where no file may be read; a timer starts the process, and its answer is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import bpy

from generator.blender.scene.mesh_file import MeshFile
from generator.jobs.protocol import ReadMesh
from generator.model.errors import NlosError
from generator.model.scene import Target

from ..draft import grid_of, target_of
from ..session import background, state

_AFTER = 0.3
"""Seconds from a change of the settings until the file is read."""

_asked: tuple[Any, ...] = ()
_of: tuple[Any, ...] = ()
_found: MeshFile | None = None
_fault = ""


def words(settings: Any) -> list[tuple[str, str]]:
    """Return what is known of the draft's mesh file, each sentence with an icon; read it if nothing is yet."""
    if settings.target_kind != "mesh" or not settings.target_mesh:
        return []
    if _asked != _settings(settings):
        state.once(_read, _AFTER)
        return [("Reading the file ...", "SORTTIME")]
    if _fault:
        return [(_fault, "ERROR")]
    if _found is None:
        return [("Reading the file ...", "SORTTIME")]
    try:
        warning = _found.warning(grid_of(settings))
    except NlosError:  # the voxels' own fault, which Build tells
        warning = ""
    return [(_found.words, "INFO"), *([(warning, "ERROR")] if warning else [])]


def read(target: Target, then: Callable[[MeshFile], None]) -> str:
    """Call a function with the mesh of a target: at once if it is known, else when it has been read.

    Returns
    -------
    str
        Empty if it was called, else what is being waited for.

    Raises
    ------
    NlosError
        The file cannot be read; with a window, the panel says so later.
    """
    of = _state_of(target)
    if _found is not None and of == _of:
        then(_found)
        return ""
    _ask(target, of, then)
    if bpy.app.background and _fault:
        raise NlosError(_fault)
    return "" if bpy.app.background else f"Reading {Path(target.mesh).name} ..."


def _ask(target: Target, of: tuple[Any, ...], then: Callable[[MeshFile], None]) -> None:
    global _asked, _found, _fault
    _asked, _found, _fault = _settings(bpy.context.scene.nlos), None, ""
    file = background.folder() / "target.npz"

    def answered(task: background.Task) -> None:
        global _found, _fault, _of
        _fault = task.error
        if not task.error:
            _of, _found = of, MeshFile.load(file, **task.result)
            try:
                then(_found)
            except NlosError as error:
                _fault = str(error)

    # The user has not opened this file, so that its links are not followed just anywhere.
    request = ReadMesh(target=asdict(target), file=file, trust_links=False)
    background.ask(request, answered, "target").settle()


def _settings(settings: Any) -> tuple[Any, ...]:
    return settings.target_mesh, settings.target_unit, settings.target_up, settings.target_size


def _state_of(target: Target) -> tuple[Any, ...]:
    """Return what the result of reading a target depends on."""
    try:
        status = Path(target.mesh).stat()
    except OSError:
        raise NlosError(f"target.mesh: {target.mesh} is no such file") from None
    return target.mesh, target.unit, target.up, target.size, status.st_mtime_ns, status.st_size


def _read() -> None:
    global _asked, _fault
    settings = bpy.context.scene.nlos
    if _asked == _settings(settings):  # asked for by Build meanwhile
        return
    _asked = _settings(settings)
    try:
        target = target_of(settings)
        _ask(target, _state_of(target), lambda found: None)
    except NlosError as error:
        _fault = str(error)
    state.redraw("VIEW_3D")


def forget() -> None:
    """Forget what was read: another file was opened, and a path may mean another one."""
    global _asked, _found, _fault
    _asked, _found, _fault = (), None, ""
