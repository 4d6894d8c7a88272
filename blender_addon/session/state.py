"""What the session knows and no file keeps: what was found, asked, answered last. No reference to Blender's data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy

from generator.blender.finding import Finding
from generator.files.pictures import Picture


@dataclass
class Shown:
    """The picture that was made last: what a trained model is asked about.

    Attributes
    ----------
    wall : ndarray of shape (height, width, 3)
        Radiance, W/m^2/sr.
    background : ndarray of shape (height, width, 3)
        Without the hidden object.
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
environment_words: str = ""


def forget() -> None:
    """Another file is open: nothing known of the last one is true of it."""
    global checking, experiment, rendering, shown, answer_words
    findings.clear()
    answer.clear()
    checking, rendering, experiment, shown, answer_words = False, "", "", None, ""


def rendering_now() -> bool:
    """Whether Blender renders or bakes: reading a scene then would crash it, or be seen in the picture."""
    return any(bpy.app.is_job_running(job) for job in ("RENDER", "OBJECT_BAKE"))


def remember(message: str) -> None:
    """Make what was just put into the file a step of its own for undo."""
    manager: Any = bpy.context.window_manager
    if bpy.app.background or not manager.windows:
        return
    with bpy.context.temp_override(window=manager.windows[0]):
        bpy.ops.ed.undo_push(message=message)


def redraw(*kinds: str) -> None:
    """Let areas of some kinds (all, if none is named) draw themselves again."""
    manager: Any = bpy.context.window_manager
    for window in manager.windows if manager else ():
        for area in window.screen.areas:
            if not kinds or area.type in kinds:
                area.tag_redraw()


def once(function: Callable[[], Any], after: float = 0.0) -> None:
    """Call a function from the event loop, unless it is about to be called already; also when a file opens before."""
    if not bpy.app.timers.is_registered(function):
        bpy.app.timers.register(function, first_interval=after, persistent=True)
