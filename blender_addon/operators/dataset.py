"""Renders a data set in Blenders without windows, while this one stays free."""

# mypy: disable-error-code="misc"

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, cast

import bpy
from bpy.props import BoolProperty

from generator.blender import misgivings
from generator.jobs import sweep
from generator.jobs.local import Outcome
from generator.jobs.remaining import Remaining
from generator.jobs.request import SweepRequest
from generator.model.errors import NlosError
from generator.model.quantities import clock
from generator.sets.dataset import Dataset
from generator.sets.manifest import SCENE

from ..draft import sweep_of, wished
from ..session import background, state


class Job:
    """The sweep that is going on, or went on last.

    Attributes
    ----------
    path : Path
        Of the data set.
    done, total : int
        Pictures of this run.
    words : str
        How it ended; empty while it goes on.
    left : float, optional
        Seconds that it still takes, once that can be told.
    told : list of str
        What was settled on, and what the check at the start found.
    """

    def __init__(self, request: SweepRequest) -> None:
        self.path = request.path
        self.done, self.total, self.words = 0, 0, ""
        self.told: list[str] = []
        self.left: float | None = None
        self._remaining = Remaining()
        self._cancelled, self._measures = False, bool(request.budget or request.accuracy)
        launch = background.launcher()

        def work(task: background.Task) -> Outcome:
            return sweep.run(request, progress=self._told, tell=self.told.append, launch=launch, stop=task.stop)

        self._task = background.Task(work, self._ended, self._shown)

    @property
    def running(self) -> bool:
        """Whether it goes on."""
        return not self.words

    def cancel(self) -> None:
        """End it; what is rendered stays."""
        self._cancelled = True
        self._task.stop.set()

    def status(self) -> str:
        """Return how far it is, in a line."""
        if not self.running:
            return self.words
        if not self.total:
            rehearses = self._measures and not self.told
            return "Rendering a few pictures, to learn what they take" if rehearses else "Planning the poses"
        if not self.done:
            return f"Rendering the background, then {self.total} pictures"
        left = "" if self.left is None else f", {clock(self.left)} left"
        return f"{self.done} of {self.total} pictures{left}"

    def _told(self, done: int, total: int) -> None:  # in the crew's threads
        self.left = self._remaining.told(done, total)
        self.done, self.total = done, total

    def _shown(self, _: background.Task) -> None:
        _status_bar(f"NLOS data set: {self.status()}")
        state.redraw("VIEW_3D")

    def _ended(self, task: background.Task) -> None:
        _status_bar(None)
        if task.error:
            self.words = task.error
            return
        outcome = task.result
        state_words = f"{outcome.dataset.planned - outcome.remaining} of {outcome.dataset.planned} pictures"
        if self._cancelled:
            self.words = f"Cancelled with {state_words} done; Resume goes on from there"
        elif outcome.failed:
            self.words = f"{state_words}; {len(outcome.failed)} failed, the first: {outcome.failed[0]}"
        else:
            self.words = f"Finished: {state_words}"


job: Job | None = None
_written: set[str] = set()
"""Workspaces with our text in the status bar."""


def _status_bar(text: str | None) -> None:
    """Write into the status bar of every workspace that is shown; None clears all that were."""
    shown = {window.workspace.name: window for window in bpy.context.window_manager.windows}
    if text is None:
        first = next(iter(shown.values()), None)
        shown |= dict.fromkeys(_written - set(shown), first) if first else {}
        _written.clear()
    else:
        _written.update(shown)
    for name, window in shown.items():
        if (workspace := bpy.data.workspaces.get(name)) is not None:
            # A timer has no window for a moment after a file was opened, and without one Blender 5.2 crashes here.
            with bpy.context.temp_override(window=window):
                workspace.status_text_set(text)


def folder(scene: Any) -> Path:
    """Return the data set's folder.

    Raises
    ------
    NlosError
        None is named, or it is relative to a file that is not saved.
    """
    named = scene.nlos.dataset
    if not named:
        raise NlosError("Name a folder for the data set")
    if named.startswith("//") and not bpy.data.filepath:
        raise NlosError("Save the file first, or name the data set's folder in full: it lies beside the file")
    path = Path(bpy.path.abspath(named)).absolute()
    try:
        path.exists()
    except OSError as error:
        raise NlosError(f"{path}: is no folder that can be used ({error.strerror})") from None
    return path


class _Running:
    @classmethod
    def poll(cls: Any, context: Any) -> bool:
        """Only one at a time."""
        cls.poll_message_set("A data set is being rendered")
        return job is None or not job.running

    def execute(self: Any, context: Any) -> set[str]:
        """Start the job, or say why not."""
        global job
        try:
            job = self.begin(context.scene)
        except NlosError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        state.redraw("VIEW_3D")
        return {"FINISHED"}


class NLOS_OT_sweep_start(_Running, bpy.types.Operator):
    """Render the object at many poses in every voxel, in Blenders without windows. This one stays free"""

    bl_idname = "nlos.sweep_start"
    bl_label = "Render Data Set"

    force: BoolProperty(  # type: ignore[valid-type]
        name="In Spite of Errors", description="Begin though Check finds errors", options={"SKIP_SAVE"}
    )

    def invoke(self: Any, context: Any, event: Any) -> set[str]:
        """Ask first where the check, short of rendering, finds an error."""
        found = misgivings.look(context.scene)
        if not found.errors:
            return cast("set[str]", self.execute(context))
        self.force = True  # if the answer is yes
        answer: set[str] = context.window_manager.invoke_confirm(
            self, event, title="Render in spite of this?", message=found.first, confirm_text="Render"
        )
        return answer

    def begin(self, scene: Any) -> Job:
        """Start anew."""
        path = folder(scene)
        if Dataset.exists(path):
            raise NlosError(f"{path} holds a data set already: resume it, or name another folder")
        if not self.force:
            misgivings.refuse(misgivings.look(scene))
        source = background.snapshot("dataset.blend")
        settings = scene.nlos
        limits = wished(settings)
        return Job(
            SweepRequest(
                scene=source,
                path=path,
                chosen=sweep_of(settings),
                budget=limits.get("budget", 0.0),
                accuracy=limits.get("accuracy", 0.0),
                workers=settings.workers,
                force=self.force,
                trust_links=True,  # Blender has followed the links of what is open in it
            )
        )


class NLOS_OT_sweep_resume(_Running, bpy.types.Operator):
    """Render what the data set in the folder still lacks, with the scene and settings that it was begun with"""

    bl_idname = "nlos.sweep_resume"
    bl_label = "Resume"

    def begin(self, scene: Any) -> Job:
        """Go on."""
        path = folder(scene)
        if not Dataset.exists(path):
            raise NlosError(f"{path} holds no data set to go on with")
        return Job(SweepRequest(scene=path / SCENE, path=path, workers=scene.nlos.workers, trust_links=True))


class NLOS_OT_sweep_cancel(bpy.types.Operator):
    """End the rendering of the data set. What is rendered stays, and Resume goes on from there"""

    bl_idname = "nlos.sweep_cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls: Any, context: Any) -> bool:
        """Only while it goes on."""
        cls.poll_message_set("No data set is being rendered")
        return job is not None and job.running

    def execute(self: Any, context: Any) -> set[str]:
        """Ask the workers to end."""
        assert job is not None
        job.cancel()
        self.report({"INFO"}, "The data set's rendering ends; what is rendered stays")
        return {"FINISHED"}


class NLOS_OT_open_folder(bpy.types.Operator):
    """Show the data set's folder in the file browser"""

    bl_idname = "nlos.open_folder"
    bl_label = "Open Folder"

    def execute(self: Any, context: Any) -> set[str]:
        """Open it, if it is there."""
        try:
            path = folder(context.scene)
            if not os.path.isdir(path):
                raise NlosError(f"{path} is not there yet")
        except NlosError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        bpy.ops.wm.path_open(filepath=str(path))
        return {"FINISHED"}


_CLASSES = (NLOS_OT_sweep_start, NLOS_OT_sweep_resume, NLOS_OT_sweep_cancel, NLOS_OT_open_folder)
_register, _unregister = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    """Add the operators."""
    _register()


def unregister() -> None:
    """Take them away, and forget the job."""
    global job
    job = None
    _status_bar(None)
    _unregister()
