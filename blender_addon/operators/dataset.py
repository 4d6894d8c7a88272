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
from ..session import background, state, wording
from . import base


class Job(base.Job):
    """The running sweep, or the last one that ran.

    Attributes
    ----------
    path : Path
        Folder of the data set.
    done, total : int
        Pictures of this run, finished and in all.
    left : float, optional
        Estimated seconds until its end; None until they can be estimated.
    told : list of str
        The settings that were chosen, and the findings of the check at the start.
    """

    def __init__(self, request: SweepRequest) -> None:
        super().__init__("")
        self.path = request.path
        self.done, self.total = 0, 0
        self.told: list[str] = []
        self.left: float | None = None
        self._remaining = Remaining()
        self._cancelled, self._measures = False, bool(request.budget or request.accuracy)
        launch = background.launcher()
        request = replace(request, gpus=devices.preferred(devices.preferences()))  # which workers cannot read

        def work(task: background.Task) -> Outcome:
            return sweep.run(request, progress=self._told, tell=self.told.append, launch=launch, stop=task.stop)

        self._task = background.Task(work, self._ended, self._shown)

    def cancel(self) -> None:
        """Stop the sweep; finished pictures are kept."""
        self._cancelled = True
        super().cancel()
        self._shown(self._task)

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
        self.done, self.total, self.share = done, total, done / total if total else 0.0

    def _shown(self, _: background.Task) -> None:
        _status_bar(f"NLOS data set: {self.status()}")
        state.redraw("VIEW_3D")

    def _ended(self, task: background.Task) -> None:
        self.running = False
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


class _OfRendering:
    busy, idle = "A data set is being rendered", "No data set is being rendered"

    @classmethod
    def job(cls) -> Job | None:
        return job


class Running(_OfRendering, base.Alone, base.Told):
    """An operator that renders a data set, of which there is one at a time."""

    def act(self: Any, context: Any) -> None:
        """Start the job."""
        global job
        job = self.begin(context.scene)


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
                self,
                event,
                title="Render in spite of this?",
                message=wording.shown(self.error),
                confirm_text="Render",
            )
            return answer
        try:
            _new_folder(context.scene)
        except NlosError as error:
            return base.refused(self, error)
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


class NLOS_OT_sweep_cancel(_OfRendering, base.Cancels, bpy.types.Operator):
    """End the rendering of the data set. What is rendered stays, and Resume goes on from there"""

    bl_idname = "nlos.sweep_cancel"
    said = "The data set's rendering ends; what is rendered stays"


class NLOS_OT_open_folder(base.Told, bpy.types.Operator):
    """Show the data set's folder in the file browser"""

    bl_idname = "nlos.open_folder"
    bl_label = "Open Folder"

    def act(self, context: Any) -> None:
        """Open the folder, if it exists."""
        path = folder(context.scene)
        if not os.path.isdir(path):
            raise NlosError(f"{path} is not there yet")
        bpy.ops.wm.path_open(filepath=str(path))


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
