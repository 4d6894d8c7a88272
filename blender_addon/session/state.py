"""State that no file stores: the session's last findings, messages and answers. No references to Blender's data."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import bpy

from generator.blender.finding import Finding
from generator.files.pictures import Picture


@dataclass
class Shown:
    """The picture that was rendered last, which a trained model is asked about.

    Attributes
    ----------
    wall : ndarray of shape (height, width, 3)
        Radiance, W/m^2/sr.
    background : ndarray of shape (height, width, 3)
        Radiance without the hidden object, W/m^2/sr.
    """

    wall: Picture
    background: Picture


findings: list[Finding] = []
checking: bool = False
rendering: str = ""
experiment: str = ""
shown: Shown | None = None
answer: dict[str, float] = {}
answer_words: str = ""
of: dict[str, str] = {}
"""What each result was of, by its topic: check, picture, experiment, answer (`view.differs.note`)."""
environment_words: str = ""
is_reading: bool = False


def forget() -> None:
    """Reset the state, since another file was opened and nothing known of the last one applies to it."""
    global checking, experiment, rendering, shown, answer_words
    findings.clear()
    answer.clear()
    of.clear()
    checking, rendering, experiment, shown, answer_words = False, "", "", None, ""


@contextmanager
def reading() -> Iterator[None]:
    """Read the scene, which moves the target and puts it back: handlers that follow the scene let that pass."""
    global is_reading
    if is_reading:
        yield
        return
    bpy.context.view_layer.update()  # what was changed before is no part of it; after undo, things are moved here
    is_reading = True
    try:
        yield
    finally:
        bpy.context.view_layer.update()  # tells handlers now what they would be told later
        is_reading = False


def rendering_now() -> bool:
    """Return whether Blender renders or bakes: reading a scene would then crash it or show in the picture."""
    return any(bpy.app.is_job_running(job) for job in ("RENDER", "OBJECT_BAKE"))


def remember(message: str) -> None:
    """Add an undo step for what was just put into the file."""
    manager: Any = bpy.context.window_manager
    if bpy.app.background or not manager.windows:
        return
    with bpy.context.temp_override(window=manager.windows[0]):
        bpy.ops.ed.undo_push(message=message)


def redraw(*kinds: str) -> None:
    """Redraw the areas of the given kinds; all areas if none is given."""
    manager: Any = bpy.context.window_manager
    for window in manager.windows if manager else ():
        for area in window.screen.areas:
            if not kinds or area.type in kinds:
                area.tag_redraw()


def after_drawing(function: Callable[[], Any], seconds: float = 0.1) -> None:
    """Call a function once the windows have been drawn anew."""

    def run() -> None:
        function()

    redraw()
    bpy.app.timers.register(run, first_interval=seconds, persistent=True)


def once(function: Callable[[], Any], after: float = 0.0) -> None:
    """Call a function from the event loop, unless that is already scheduled; opening a file does not cancel it."""
    if not bpy.app.timers.is_registered(function):
        bpy.app.timers.register(function, first_interval=after, persistent=True)
