"""The Python that answers and training need: named in the preferences, tested, made by one click, removed."""

# mypy: disable-error-code="valid-type,misc"

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import bpy
from bpy.props import StringProperty

from generator.model.errors import NlosError

from ..session import background, environment, making, state
from ..view import live
from ..view.sentences import sentence
from . import base

_SIZE = f"{making.DOWNLOAD_MB} MB to download, {making.DISK_MB} MB on disk"


class Job(base.Job):
    """The making of an environment. If it is cancelled, what was made so far is removed."""

    def __init__(self, folder: Path) -> None:
        super().__init__("Preparing")
        self._task = background.Task(
            lambda task: making.make(folder, self._told, task.stop),
            self._ended,
            lambda task: state.redraw("VIEW_3D", "PREFERENCES"),
        )
        self._task.settle()

    def _told(self, words: str, share: float) -> None:  # called in the thread
        self.words, self.share = words, share

    def _ended(self, task: background.Task) -> None:
        self.running = False
        environment.look()
        if task.error:
            state.environment_words = task.error
        else:
            environment.name(str(task.result))
            _test(str(task.result))


job: Job | None = None


class _OfMaking:
    busy, idle = "An environment is being made", "No environment is being made"

    @classmethod
    def job(cls) -> Job | None:
        return job


class NlosPreferences(bpy.types.AddonPreferences):
    """Settings that depend on the machine, not on the scene."""

    bl_idname = environment.EXTENSION

    python: StringProperty(
        name="Python",
        description="The Python of an environment that has NLOS Lab's command line installed, such as "
        ".venv/bin/python. Answers of trained models need it, and the live look is drawn by it, several times faster",
        subtype="FILE_PATH",
    )

    def draw(self, context: Any) -> None:
        """Draw the path of the Python and the buttons that make, test and remove one."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "python")
        row = layout.row()
        row.alignment = "RIGHT"
        row.operator("nlos.test_environment", icon="CHECKMARK")
        draw(context, layout)
        if not (job and job.running) and state.environment_words:
            sentence(context, layout, state.environment_words)


def draw(context: Any, layout: Any) -> None:
    """Draw the buttons that make and remove the environment, or how far its making is."""
    if job and job.running:
        layout.progress(factor=job.share)
        sentence(context, layout, job.words)
        layout.operator("nlos.cancel_environment", icon="CANCEL")
        return
    row = layout.row(align=True)
    made = environment.is_made()
    row.operator("nlos.make_environment", text="Renew Environment" if made else "Make Environment", icon="IMPORT")
    if made:
        row.operator("nlos.remove_environment", text="", icon="TRASH")


def _test(interpreter: str) -> None:
    """Test a Python in the background, and tell what it can do."""
    state.environment_words = "Testing ..."

    def then(task: background.Task) -> None:
        version = str(task.result).strip()
        success = f"It works: Python {version} can read trained models, train them, and draw the live look"
        state.environment_words = f"It cannot read trained models: {task.error}" if task.error else success
        if not task.error:
            live.restart()

    command = [interpreter, "-c", environment.TEST]
    background.Task(lambda task: environment.run(command, task.stop), then, topic="environment").settle()


class NLOS_OT_make_environment(_OfMaking, base.Alone, base.Told, bpy.types.Operator):
    """Make a Python with all that answers and training need, in Blender's folder for extensions; asks first"""

    bl_idname = "nlos.make_environment"
    bl_label = "Make Environment"

    def invoke(self: Any, context: Any, event: Any) -> set[str]:
        """Ask, with what it takes and where it goes."""
        try:
            folder = environment.own()
            _check_online()
        except NlosError as error:
            return base.refused(self, error)
        made, current = environment.look(), making.is_current(folder)
        title = "Make a Python for answers and training?"
        if made:
            title = "Make it again?" if current else "Make it again, with what this version needs?"
        return cast(
            "set[str]",
            context.window_manager.invoke_confirm(
                self,
                event,
                title=title,
                message=f"{_SIZE}. It goes to {folder}",
                confirm_text="Renew" if made else "Make",
            ),
        )

    def act(self, context: Any) -> None:
        """Begin, in the background."""
        global job
        with _told():
            _check_online()
            folder = environment.own()
        state.environment_words = ""
        job = Job(folder)


class NLOS_OT_cancel_environment(_OfMaking, base.Cancels, bpy.types.Operator):
    """Stop making the environment. What was made so far is removed"""

    bl_idname = "nlos.cancel_environment"


class NLOS_OT_remove_environment(_OfMaking, base.Alone, base.Told, bpy.types.Operator):
    """Delete the Python that Make Environment made"""

    bl_idname = "nlos.remove_environment"
    bl_label = "Remove Environment"

    def invoke(self: Any, context: Any, event: Any) -> set[str]:
        """Ask first."""
        return cast("set[str]", context.window_manager.invoke_confirm(self, event))

    def act(self, context: Any) -> None:
        """Delete it in a background thread, for it is thousands of files."""
        folder = environment.own()
        _unname(folder)

        def then(task: background.Task) -> None:
            environment.look()
            state.environment_words = task.error or "The environment is removed"

        state.environment_words = "Removing the environment ..."
        background.Task(lambda task: making.remove(folder), then, topic="environment").settle()


@contextmanager
def _told() -> Iterator[None]:
    """Say what is wrong in the panel too."""
    try:
        yield
    except NlosError as error:
        state.environment_words = str(error)
        raise


def _check_online() -> None:
    if bpy.app.online_access:
        return
    if bpy.app.online_access_override:
        raise NlosError("Blender was started with --offline-mode; the packages can be downloaded only without that")
    raise NlosError("Blender may not go online: tick Allow Online Access in Preferences > System > Network first")


def _unname(folder: Path) -> None:
    """Take a Python that goes away out of the preferences."""
    if environment.named() == str(making.interpreter(folder)):
        environment.name("")


class NLOS_OT_test_environment(base.Told, bpy.types.Operator):
    """Start the Python named above and see whether it can read trained models"""

    bl_idname = "nlos.test_environment"
    bl_label = "Test"

    def act(self, context: Any) -> None:
        """Start the test in a background thread."""
        with _told():
            _test(environment.python())


_CLASSES = (
    NlosPreferences,
    NLOS_OT_make_environment,
    NLOS_OT_cancel_environment,
    NLOS_OT_remove_environment,
    NLOS_OT_test_environment,
)
_register, _unregister = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    """Add the preferences and the operators."""
    _register()


def unregister() -> None:
    """Remove them, and forget the job."""
    global job
    job = None
    _unregister()
