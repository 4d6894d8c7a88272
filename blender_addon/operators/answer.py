"""Asks a trained model for the object's voxel, in a separate Python process: Blender's own lacks scikit-learn."""

# mypy: disable-error-code="misc"

from __future__ import annotations

import json
from typing import Any

import bpy

from generator.blender import sweep_worker
from generator.files.pictures import write_picture
from generator.model.errors import NlosError

from ..session import background, environment, state
from ..view import overlay
from . import base


def _answered(said: str) -> tuple[dict[str, float], list[str]]:
    """Return the probability of each voxel, by label, and what speaks against it, from the command line's output."""
    try:
        answer = json.loads(said)
        probabilities = {str(label): float(p) for label, p in answer["answers"][0]["probability"].items()}
        if probabilities and all(0.0 <= p <= 1.0 for p in probabilities.values()):
            return probabilities, [str(text) for text in answer.get("doubts", ())]
        raise ValueError
    except (ValueError, LookupError, TypeError, AttributeError):
        raise NlosError(f"the Python in the preferences printed no answer but {said.strip()[:80]!r}") from None


class NLOS_OT_answer(base.Told, bpy.types.Operator):
    """Ask the model in which voxel the object stands, by the picture that was rendered last"""

    bl_idname = "nlos.answer"
    bl_label = "Where Is It?"

    def act(self, context: Any) -> None:
        """Write the picture, ask the model in a background thread, and show its answer when it arrives."""
        settings = context.scene.nlos
        interpreter = environment.python()
        model = environment.chosen(settings.model, environment.MODEL)
        if state.shown is None:
            raise NlosError("There is no picture yet: render the wall first")
        files = [background.folder() / f"{name}.exr" for name in ("asked", "asked-background")]
        for path, picture in zip(files, (state.shown.wall, state.shown.background), strict=True):
            write_picture(path, picture, {"colour_space": sweep_worker.colour_space()})
        arguments = ["-m", "classify.cli", "predict", str(model), str(files[0]), "--background", str(files[1])]
        state.answer_words = "Asking the model ..."
        state.of["answer"] = state.of.get("picture", "")

        def then(task: background.Task) -> None:
            state.answer.clear()
            if task.error:
                state.answer_words = task.error
            else:
                probabilities, doubts = task.result
                state.answer.update(probabilities)
                label = max(state.answer, key=lambda v: state.answer[v])
                words = f"Voxel {label}, with a probability of {state.answer[label]:.0%}"
                state.answer_words = "; ".join([words, *(text.replace(str(model), model.name) for text in doubts)])
            overlay.changed()

        command = [interpreter, *arguments, "--json"]
        background.Task(
            lambda task: _answered(environment.run(command, task.stop, doubtful=True)), then, topic="answer"
        ).settle()


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


_CLASSES = (NLOS_OT_answer, NLOS_OT_forget_answer)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
