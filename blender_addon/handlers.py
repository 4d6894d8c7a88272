"""Handlers that run when another file is opened."""

from typing import Any

import bpy
from bpy.app.handlers import persistent

from .operators import dataset, timeline
from .session import background, state
from .view import images, live, live_answer, overlay, target_file, thumbnails


@persistent  # type: ignore[untyped-decorator]
def _before(*_: Any) -> None:
    """Switch off the live picture and the overlay: nothing that follows a scene may outlive it."""
    manager = bpy.context.window_manager
    live_answer.switch(False)
    live.switch(False)
    overlay.switch(False)
    if manager is not None:
        manager.nlos.live_answer = manager.nlos.look = manager.nlos.overlay = False


@persistent  # type: ignore[untyped-decorator]
def _after(*_: Any) -> None:
    background.drop()  # results of the running tasks would not apply to this file
    images.captions.clear()
    thumbnails.forget()
    state.forget()
    target_file.forget()
    timeline.forget()
    dataset.forget()
    session = bpy.context.window_manager.nlos
    # Blender may have taken the switches over from the file that was open.
    session.live_answer = session.look = session.overlay = session.show_handles = False


@persistent  # type: ignore[untyped-decorator]
def _undoing(*_: Any) -> None:
    """End what is being done stepwise: undo takes the scene away that it looks at."""
    if "check" in background.drop_steps():
        state.checking = False


def register() -> None:
    """Add the handlers."""
    for handlers in (bpy.app.handlers.undo_pre, bpy.app.handlers.redo_pre):
        handlers.append(_undoing)
    bpy.app.handlers.load_pre.append(_before)
    bpy.app.handlers.load_post.append(_after)


def unregister() -> None:
    """Remove the handlers."""
    for handlers in (bpy.app.handlers.undo_pre, bpy.app.handlers.redo_pre):
        handlers.remove(_undoing)
    bpy.app.handlers.load_post.remove(_after)
    bpy.app.handlers.load_pre.remove(_before)
