"""Renders a data set in background Blender processes, while this Blender stays usable."""

# mypy: disable-error-code="misc"

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, StringProperty

from generator.blender import check, misgivings
from generator.blender.engines import devices
from generator.blender.finding import Finding
from generator.jobs import sweep
from generator.jobs.local import Outcome
from generator.jobs.remaining import Remaining
from generator.jobs.request import SweepRequest
from generator.model.engines import AUTO
from generator.model.errors import NlosError
from generator.model.quantities import clock
from generator.sets.dataset import Dataset
from generator.sets.manifest import SCENE

from ..draft import folder, sweep_of, wished
from ..session import background, state


class Job:
    """The running sweep, or the last one that ran.

    Attributes
    ----------
    path : Path
        Folder of the data set.
    done, total : int
        Pictures of this run, finished and in all.
    words : str
        How the sweep ended; empty while it runs.
    left : float, optional
        Estimated seconds until its end; None until they can be estimated.
    told : list of str
        The settings that were chosen, and the findings of the check at the start.
    """

    def __init__(self, request: SweepRequest) -> None:
        self.path = request.path
        self.done, self.total, self.words = 0, 0, ""
        self.told: list[str] = []
        self.left: float | None = None
        self._remaining = Remaining()
        self._cancelled, self._measures = False, bool(request.budget or request.accuracy)
        launch = background.launcher()
        request = replace(request, gpus=devices.preferred(devices.preferences()))  # which workers cannot read

        def work(task: background.Task) -> Outcome:
            return sweep.run(request, progress=self._told, tell=self.told.append, launch=launch, stop=task.stop)

        self._task = background.Task(work, self._ended, self._shown)

    @property
    def running(self) -> bool:
        """Whether the sweep is still running."""
        return not self.words

    def cancel(self) -> None:
        """Stop the sweep; finished pictures are kept."""
        self._cancelled = True
        self._task.stop.set()
        self._shown(self._task)

    @property
    def share(self) -> float:
        """Share of the pictures that is finished, 0 to 1."""
        return self.done / self.total if self.total else 0.0

    def status(self) -> str:
        """Return the progress, or how the sweep ended, in one line."""
        if not self.running:
            return self.words
        if self._cancelled:
            return "Cancelling: the pictures that are being rendered are given up"
        if not self.total:
            measuring = self._measures and not self.told
            return "Rendering a few pictures, to learn what they take" if measuring else "Planning the poses"
        if not self.done:
            return f"Rendering the background, then {self.total} pictures"
        left = "" if self.left is None else f", {clock(self.left)} left"
        return f"{self.done} of {self.total} pictures{left}"

    def _told(self, done: int, total: int) -> None:  # called in the workers' threads
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
        progress = f"{outcome.dataset.planned - outcome.remaining} of {outcome.dataset.planned} pictures"
        if self._cancelled:
            self.words = f"Cancelled with {progress} done; Resume goes on from there"
        elif outcome.failed:
            self.words = f"{progress}; {len(outcome.failed)} failed, the first: {outcome.failed[0]}"
        else:
            self.words = f"Finished: {progress}"


job: Job | None = None


def forget() -> None:
    """Forget a data set that is done: another file was opened. One that is being rendered goes on."""
    global job
    if job is not None and not job.running:
        job = None


_written: set[str] = set()
"""Workspaces with our text in the status bar."""


def _status_bar(text: str | None) -> None:
    """Write a text into the status bar of every visible workspace; None clears it wherever it was written."""
    windows = {window.workspace.name: window for window in bpy.context.window_manager.windows}
    if text is None:
        first = next(iter(windows.values()), None)
        windows |= dict.fromkeys(_written - set(windows), first) if first else {}
        _written.clear()
    else:
        _written.update(windows)
    for name, window in windows.items():
        if (workspace := bpy.data.workspaces.get(name)) is not None:
            # For a moment after a file is opened a timer has no window, and Blender 5.2 crashes here without one.
            with bpy.context.temp_override(window=window):
                workspace.status_text_set(text)


class Running:
    """An operator that renders a data set, of which there is one at a time."""

    @classmethod
    def poll(cls: Any, context: Any) -> bool:
        """Return whether no other data set is being rendered."""
        cls.poll_message_set("A data set is being rendered")
        return job is None or not job.running

    def execute(self: Any, context: Any) -> set[str]:
        """Start the job, or report why it cannot start."""
        global job
        try:
            job = self.begin(context.scene)
        except NlosError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        state.redraw("VIEW_3D")
        return {"FINISHED"}


class NLOS_OT_sweep_start(Running, bpy.types.Operator):
    """Render the object at many poses in every voxel, in Blenders without windows. This one stays free"""

    bl_idname = "nlos.sweep_start"
    bl_label = "Render Data Set"

    force: BoolProperty(  # type: ignore[valid-type]
        name="In Spite of Errors", description="Begin though Check finds errors", options={"SKIP_SAVE"}
    )

    is_checked: BoolProperty(options={"SKIP_SAVE", "HIDDEN"})  # type: ignore[valid-type]
    error: StringProperty(options={"SKIP_SAVE", "HIDDEN"})  # type: ignore[valid-type]

    def invoke(self: Any, context: Any, event: Any) -> set[str]:
        """Check what needs no rendering first, step by step; ask for confirmation if that finds an error."""
        if self.error:
            self.force = True  # takes effect only if the user confirms
            answer: set[str] = context.window_manager.invoke_confirm(
                self, event, title="Render in spite of this?", message=self.error, confirm_text="Render"
            )
            return answer
        try:
            _new_folder(context.scene)
        except NlosError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        background.stepwise(check.parts(context.scene, engine=AUTO), _begin, "start")
        return {"FINISHED"}

    def begin(self, scene: Any) -> Job:
        """Begin a new data set."""
        path = _new_folder(scene)
        if not (self.force or self.is_checked):
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
                trust_links=True,  # Blender has already followed the links of the open file
            )
        )


def _new_folder(scene: Any) -> Path:
    path = folder(scene)
    if Dataset.exists(path):
        raise NlosError(f"{path} holds a data set already: resume it, or name another folder")
    return path


def _begin(found: list[list[Finding]]) -> None:
    """Go on with a data set whose scene was checked."""
    doubts = misgivings.of(check.ordered(found))
    manager: Any = bpy.context.window_manager
    with bpy.context.temp_override(window=manager.windows[0]):
        try:
            if doubts.errors:
                bpy.ops.nlos.sweep_start("INVOKE_DEFAULT", error=doubts.first)
            else:
                bpy.ops.nlos.sweep_start("EXEC_DEFAULT", is_checked=True)
        except RuntimeError as error:  # a button would have shown what an operator reports
            words = str(error).strip()
            manager.popup_menu(lambda menu, _: menu.layout.label(text=words), title="Render Data Set", icon="ERROR")


class NLOS_OT_sweep_resume(Running, bpy.types.Operator):
    """Render what the data set in the folder still lacks, with the scene and settings that it was begun with"""

    bl_idname = "nlos.sweep_resume"
    bl_label = "Resume"

    def begin(self, scene: Any) -> Job:
        """Continue the data set in the folder."""
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
        """Return whether a data set is being rendered."""
        cls.poll_message_set("No data set is being rendered")
        return job is not None and job.running

    def execute(self: Any, context: Any) -> set[str]:
        """Ask the workers to stop."""
        assert job is not None
        job.cancel()
        self.report({"INFO"}, "The data set's rendering ends; what is rendered stays")
        return {"FINISHED"}


class NLOS_OT_open_folder(bpy.types.Operator):
    """Show the data set's folder in the file browser"""

    bl_idname = "nlos.open_folder"
    bl_label = "Open Folder"

    def execute(self: Any, context: Any) -> set[str]:
        """Open the folder, if it exists."""
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
    """Remove the operators, and forget the job."""
    global job
    job = None
    _status_bar(None)
    _unregister()
