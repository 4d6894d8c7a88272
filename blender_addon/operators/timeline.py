"""Renders the target as it is animated, and follows it by a tracker in the Python of the preferences."""

# mypy: disable-error-code="misc"

from __future__ import annotations

import json
import re
import threading
from pathlib import Path
from typing import Any

import bpy

from generator.jobs.request import SweepRequest
from generator.model.errors import NlosError
from generator.sets.dataset import Dataset

from ..draft import folder_named, sweep_of
from ..session import background, environment, state
from ..view import path
from . import base, dataset

_FRAME = re.compile(r"frame (\d+): ")
_TOPIC = "follow"

words: list[str] = []
"""How the last tracking went, or how far it is, in sentences."""


class _Job(base.Job):
    """The tracking that goes on, or the last one."""

    def __init__(self, command: list[str], folder: Path) -> None:
        super().__init__("")
        words[:] = ["The atlas is tried ..."]
        self._task = background.Task(
            lambda task: _tracked(command, folder, task.stop), self._ended, _tell, topic=_TOPIC
        )
        self._task.settle()

    def cancel(self) -> None:
        """End it; what it finds no longer counts."""
        forget()
        words[:] = ["Cancelled"]

    def _ended(self, task: background.Task) -> None:
        self.running = False
        _show(task)


job: _Job | None = None


def following() -> bool:
    """Return whether the target is being followed."""
    return job is not None and job.running


class NLOS_OT_timeline_render(dataset.Running, bpy.types.Operator):
    """Render the object in each frame of the timeline, in Blenders without windows. This one stays free"""

    bl_idname = "nlos.timeline_render"
    bl_label = "Render Timeline"

    def begin(self, scene: Any) -> dataset.Job:
        """Begin a data set of the scene's frame range."""
        settings = scene.nlos
        folder = folder_named(settings.timeline_folder)
        if Dataset.exists(folder):
            raise NlosError(
                f"{folder} holds a data set already: name another folder, or resume it by the Data Set panel"
            )
        chosen = {name: value for name, value in sweep_of(settings).items() if name not in ("poses", "inside")}
        frames = (scene.frame_start, scene.frame_end, scene.frame_step)
        return dataset.Job(
            SweepRequest(
                scene=background.snapshot("timeline.blend"),
                path=folder,
                chosen={**chosen, "timeline": frames},
                workers=settings.workers,
                trust_links=True,  # Blender has already followed the links of the open file
            )
        )


class NLOS_OT_timeline_follow(base.Told, bpy.types.Operator):
    """Follow the object through the rendered frames by the atlas, and draw where it was and where it was found"""

    bl_idname = "nlos.timeline_follow"
    bl_label = "Follow"

    def act(self, context: Any) -> None:
        """Start the tracker in a background thread."""
        global job
        settings = context.scene.nlos
        python = environment.python()
        atlas = environment.chosen(settings.timeline_atlas, environment.ATLAS)
        folder = folder_named(settings.timeline_folder)
        if not Dataset.exists(folder):
            raise NlosError(f"{folder} holds no frames yet: render the timeline first")
        step = str(settings.timeline_step)
        track = [python, "-m", "classify.cli", "track", str(atlas), str(folder), "--process-noise", step, "--json"]
        job = _Job(track, folder)


class NLOS_OT_timeline_cancel(base.Cancels, bpy.types.Operator):
    """End the tracking"""

    bl_idname = "nlos.timeline_cancel"
    idle = "Nothing is being followed"

    @classmethod
    def job(cls) -> _Job | None:
        """Return the tracking."""
        return job


def forget() -> None:
    """End the tracking, and draw no path any more."""
    global job
    background.drop(_TOPIC)
    job = None
    words.clear()
    path.forget()


_now = ""


def _tracked(command: list[str], folder: Path, stop: threading.Event) -> tuple[path.Path, list[str]]:
    """Run the tracker, note which frame it has reached, and return the path and what is to be said of it."""
    global _now
    _now = ""
    settings = Dataset.open(folder).settings
    if not settings.get("timeline"):
        raise NlosError(f"{folder} holds no frames of a timeline: render the timeline into another folder")
    first, last, step = settings["timeline"]
    numbers = range(first, last + 1, step)

    def told(line: str) -> None:  # called in another thread
        global _now
        if match := _FRAME.match(line):
            _now = f"Frame {int(match[1]) + 1} of {len(numbers)}"

    output = environment.run(command, stop, told, environment.A_DAY)
    return _read(output, numbers)


def _read(output: str, numbers: range) -> tuple[path.Path, list[str]]:
    try:
        said = json.loads(output)
        frames = said["frames"]
        found = path.path(
            [numbers[frame["frame"]] for frame in frames],
            *([frame[name] for frame in frames] for name in ("true_position", "position", "covariance")),
        )
        summary = (
            f"Median error {100.0 * said['error']['value']:.1f} cm; {said['covered']['value']:.0%} of {len(frames)} "
            "frames inside the stated 95 % regions"
        )
        return found, [summary, *(str(line) for line in said["words"])]
    except (ValueError, LookupError, TypeError):
        raise NlosError(f"the Python in the preferences printed no track but {output.strip()[:80]!r}") from None


def _tell(task: background.Task) -> None:
    if _now and words[:1] != [_now]:
        words[:] = [_now]
        state.redraw("VIEW_3D")


def _show(task: background.Task) -> None:
    if task.error:
        words[:] = [task.error]
        return
    found, words[:] = task.result
    path.show(found)
    bpy.context.window_manager.nlos.overlay = True


_CLASSES = (NLOS_OT_timeline_render, NLOS_OT_timeline_follow, NLOS_OT_timeline_cancel)
_register, _unregister = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    """Add the operators."""
    _register()


def unregister() -> None:
    """End the tracking, and remove the operators."""
    forget()
    _unregister()
