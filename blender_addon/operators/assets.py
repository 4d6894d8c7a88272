"""Writes a library of assets beside Blender's own data of the user, and shows it in the asset browser."""

# mypy: disable-error-code="misc"

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import bpy

from generator.blender.assets import LARGEST
from generator.jobs.protocol import WriteAssets
from generator.model.errors import NlosError

from ..session import background, state
from . import base

LIBRARY = "NLOS Lab"
"""Name of the library in the preferences."""

words: str = ""
"""What became of it, for the panel."""


def folder() -> Path:
    """Return the folder of the library, which may not be there yet."""
    return Path(bpy.utils.user_resource("DATAFILES", path="nlos_lab"), "assets")


def is_there() -> bool:
    """Return whether the preferences list the library; reads no file."""
    return any(Path(library.path) == folder() for library in bpy.context.preferences.filepaths.asset_libraries)


class NLOS_OT_add_assets(bpy.types.Operator):
    """Write walls, lamps, cameras, partitions, targets, clutter and diffuse materials of known albedo as a library of the asset browser. Another Blender does it, without a window"""  # noqa: E501

    bl_idname = "nlos.add_assets"
    bl_label = "Add NLOS Asset Library"

    def invoke(self: Any, context: Any, event: Any) -> set[str]:
        """Say first where it goes, and how large it is."""
        return cast(
            "set[str]",
            context.window_manager.invoke_confirm(
                self,
                event,
                title="Add NLOS Asset Library",
                message=f"Writes up to {LARGEST // 1000} kB into {folder()}, in place of what it has written there "
                f"before, and lists that folder as the asset library '{LIBRARY}' in the preferences.",
                confirm_text="Write",
            ),
        )

    def execute(self: Any, context: Any) -> set[str]:
        """Start the process that writes it; on its end, list the library in the preferences."""
        global words

        def then(task: background.Task) -> None:
            global words
            words = task.error
            if not task.error:
                _list()
                words = f"{len(task.result['assets'])} assets are in the asset browser, library {LIBRARY}"

        words = "Writing the assets ..."
        try:
            # Without a topic, so that opening another file does not end it.
            task = background.ask(WriteAssets(folder=folder()), then, "").settle()
            if task.error:
                raise NlosError(task.error)
        except NlosError as error:
            return base.refused(self, error)
        self.report({"INFO"}, words)
        state.redraw("VIEW_3D")
        return {"FINISHED"}


def _list() -> None:
    """List the library in the preferences, once, so that what is dragged out of it becomes the user's own."""
    if is_there():
        return
    preferences = bpy.context.preferences
    library = preferences.filepaths.asset_libraries.new(name=LIBRARY, directory=str(folder()))
    library.import_method = "APPEND"
    preferences.is_dirty = True  # Blender saves them at its end, if the user has that


_register, _unregister = bpy.utils.register_classes_factory((NLOS_OT_add_assets,))


def register() -> None:
    """Add the operator."""
    _register()


def unregister() -> None:
    """Remove the operator. The library stays: files may use it, and it needs no extension."""
    global words
    words = ""
    _unregister()
