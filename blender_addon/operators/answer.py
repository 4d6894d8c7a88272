"""Asks a trained model for the object's voxel, in a separate Python process: Blender's own lacks scikit-learn."""

# mypy: disable-error-code="valid-type,misc"

from __future__ import annotations

import contextlib
import json
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import bpy
from bpy.props import StringProperty

from generator.blender import sweep_worker
from generator.files.pictures import write_picture
from generator.model.errors import NlosError

from ..session import background, environment, state
from ..view import overlay

_PATIENCE = 120.0
"""Seconds within which a Python process must start, import its modules and answer."""

_TEST = "import classify.classifiers.models, sys; print('.'.join(map(str, sys.version_info[:3])))"


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
        """Draw the path of the Python and the button that tests it."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "python")
        row = layout.row()
        row.alignment = "RIGHT"
        row.operator("nlos.test_environment", icon="CHECKMARK")
        if state.environment_words:
            layout.label(text=state.environment_words, translate=False)


def run(arguments: list[str], stop: threading.Event) -> str:
    """Run a Python command, isolated from Blender's modules, and return its output; kill it once ``stop`` is set.

    Raises
    ------
    NlosError
        The command cannot be started, takes too long, or fails; then with the last line of its error output.
    """
    try:
        # -E ignores Blender's PYTHONPATH and PYTHONHOME. -P would exclude the current folder, but needs Python 3.11.
        process = subprocess.Popen(
            [arguments[0], "-E", *arguments[1:]],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            errors="replace",
            cwd=str(Path(arguments[0]).parent),
        )
    except OSError as error:
        raise NlosError(f"{arguments[0]} cannot be run ({error.strerror or error})") from None
    deadline = time.monotonic() + _PATIENCE
    while not stop.is_set() and time.monotonic() < deadline:
        with contextlib.suppress(subprocess.TimeoutExpired):
            output, errors = process.communicate(timeout=0.2)
            break
    else:
        process.kill()
        process.communicate()
        raise NlosError(f"{arguments[0]} did not answer within {_PATIENCE:.0f} seconds")
    if process.returncode:
        lines = [line for line in errors.splitlines() if line.strip()]
        raise NlosError(lines[-1].removeprefix("error: ") if lines else f"exit code {process.returncode}")
    return output


def _probabilities(said: str) -> dict[str, float]:
    """Return the probability of each voxel, by label, from the output of the command line."""
    try:
        probabilities = {str(label): float(p) for label, p in json.loads(said)["answers"][0]["probability"].items()}
        if probabilities and all(0.0 <= p <= 1.0 for p in probabilities.values()):
            return probabilities
        raise ValueError
    except (ValueError, LookupError, TypeError, AttributeError):
        raise NlosError(f"the Python in the preferences printed no answer but {said.strip()[:80]!r}") from None


class NLOS_OT_test_environment(bpy.types.Operator):
    """Start the Python named above and see whether it can read trained models"""

    bl_idname = "nlos.test_environment"
    bl_label = "Test"

    def execute(self, context: Any) -> set[str]:
        """Start the test in a background thread."""
        try:
            interpreter = environment.python()
        except NlosError as error:
            state.environment_words = str(error)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        state.environment_words = "Testing ..."

        def then(task: background.Task) -> None:
            success = f"It works: Python {str(task.result).strip()} can read trained models"
            failure = f"It cannot read trained models: {task.error}"
            state.environment_words = failure if task.error else success

        command = [interpreter, "-c", _TEST]
        background.Task(lambda task: run(command, task.stop), then, topic="environment").settle()
        return {"FINISHED"}


class NLOS_OT_answer(bpy.types.Operator):
    """Ask the model in which voxel the object stands, by the picture that was rendered last"""

    bl_idname = "nlos.answer"
    bl_label = "Where Is It?"

    def execute(self, context: Any) -> set[str]:
        """Write the picture, ask the model in a background thread, and show its answer when it arrives."""
        settings = context.scene.nlos
        try:
            interpreter = environment.python()
            model = environment.chosen(settings.model, environment.MODEL)
            if state.shown is None:
                raise NlosError("There is no picture yet: render the wall first")
            files = [background.folder() / f"{name}.exr" for name in ("asked", "asked-background")]
            for path, picture in zip(files, (state.shown.wall, state.shown.background), strict=True):
                write_picture(path, picture, {"colour_space": sweep_worker.colour_space()})
        except NlosError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        arguments = ["-m", "classify.cli", "predict", str(model), str(files[0]), "--background", str(files[1])]
        state.answer_words = "Asking the model ..."
        state.of["answer"] = state.of.get("picture", "")

        def then(task: background.Task) -> None:
            state.answer.clear()
            if task.error:
                state.answer_words = task.error
            else:
                state.answer.update(task.result)
                label = max(state.answer, key=lambda v: state.answer[v])
                state.answer_words = f"Voxel {label}, with a probability of {state.answer[label]:.0%}"
            overlay.changed()

        command = [interpreter, *arguments, "--json"]
        background.Task(lambda task: _probabilities(run(command, task.stop)), then, topic="answer").settle()
        return {"FINISHED"}


class NLOS_OT_forget_answer(bpy.types.Operator):
    """Take the probabilities out of the overlay"""

    bl_idname = "nlos.forget_answer"
    bl_label = "Clear"

    def execute(self, context: Any) -> set[str]:
        """Remove the probabilities and the answer's text."""
        state.answer.clear()
        state.answer_words = ""
        overlay.changed()
        return {"FINISHED"}


_CLASSES = (NlosPreferences, NLOS_OT_test_environment, NLOS_OT_answer, NLOS_OT_forget_answer)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
