"""Handlers that run when another file is opened."""

from typing import Any

import bpy
from bpy.app.handlers import persistent

from .session import background, state
from .view import images, live, overlay, target_file


@persistent  # type: ignore[untyped-decorator]
def _before(*_: Any) -> None:
    """Switch off the live picture and the overlay: nothing that follows a scene may outlive it."""
    manager = bpy.context.window_manager
    live.switch(False)
    overlay.switch(False)
    if manager is not None:
        manager.nlos.look = manager.nlos.overlay = False


@persistent  # type: ignore[untyped-decorator]
def _after(*_: Any) -> None:
    background.drop()  # results of the running tasks would not apply to this file
    images.captions.clear()
    state.forget()
    target_file.forget()
    session = bpy.context.window_manager.nlos
    # Blender may have taken the switches over from the file that was open.
    session.look = session.overlay = False


def register() -> None:
    """Add the handlers."""
    bpy.app.handlers.load_pre.append(_before)
    bpy.app.handlers.load_post.append(_after)


def unregister() -> None:
    """Remove the handlers."""
    bpy.app.handlers.load_post.remove(_after)
    bpy.app.handlers.load_pre.remove(_before)
