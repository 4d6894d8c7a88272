"""Trains a model on a data set, by the Python of the preferences, while Blender stays usable."""

# mypy: disable-error-code="misc"

from __future__ import annotations

import json
import re
import time
from pathlib import Path
from typing import Any, cast

import bpy

from generator.model.errors import NlosError
from generator.model.quantities import clock

from ..draft import folder_named
from ..session import background, environment, state
from . import base

_PROGRESS = re.compile(r"(\d+) of (\d+) \w+")


class Job(base.Job):
    """The training that goes on, or the last one; its share is of the present step. A former model is kept."""

    def __init__(self, interpreter: str, dataset: Path, model: Path, settings: Any) -> None:
        super().__init__("Describing the pictures")
        self._file, self._scene, self._model = bpy.data.filepath, settings.id_data.name, model
        features = background.folder() / "train.h5"
        described = ["--features", settings.train_features, "--partial"]
        trained = ["--classifier", settings.train_classifier, "--cross-validate"]
        steps = (
            ("Describing the pictures", ["features", str(dataset), "-o", str(features), *described]),
            ("Cross-validating", ["train", str(features), "-o", str(model), *trained]),
        )
        begun = time.monotonic()

        def work(task: background.Task) -> str:
            found: dict[str, Any] = {}
            for words, arguments in steps:
                self.words, self.share = words, 0.0
                command = [interpreter, "-m", "classify.cli", *arguments, "--json"]
                found |= json.loads(environment.run(command, task.stop, self._told(words), environment.A_DAY))
            return _result(found, time.monotonic() - begun)

        self._task = background.Task(work, self._ended, lambda task: state.redraw("VIEW_3D"))
        self._task.settle()

    def _told(self, words: str) -> Any:
        def told(line: str) -> None:  # called in a thread
            if found := _PROGRESS.match(line):
                done, total = map(int, found.groups())
                self.words, self.share = f"{words}: {line}", done / total
                if done == total and words.startswith("Cross"):
                    self.words = "Training on all of them"

        return told

    def _ended(self, task: background.Task) -> None:
        self.running = False
        self.words = task.error or task.result
        scene = bpy.data.scenes.get(self._scene)
        if task.error:
            return
        if scene is None or bpy.data.filepath != self._file:  # another file has been opened
            self.words += f". The model is {self._model}"
            return
        scene.nlos.model = str(self._model)
        state.remember("Train")


def _result(found: dict[str, Any], seconds: float) -> str:
    """Return how good a model is, from what the command line answered."""
    try:
        accuracy, pictures, planned = found["accuracy"], int(found["pictures"]), int(found["planned"])
        value, low, high = (100.0 * float(accuracy[name]) for name in ("value", "low", "high"))
        folds = int(found["folds"])
    except (LookupError, TypeError, ValueError):
        raise NlosError("the Python in the preferences trained, but did not tell how well") from None
    of = f"{pictures} pictures" if pictures == planned else f"{pictures} of {planned} pictures"
    return (
        f"Finds the right voxel in {value:.1f} % of pictures (95 % interval: {low:.1f} to {high:.1f}), "
        f"in {folds} folds of {of}; took {clock(seconds)}"
    )


job: Job | None = None


class _OfTraining:
    busy, idle = "A model is being trained", "No model is being trained"

    @classmethod
    def job(cls) -> Job | None:
        return job


class NLOS_OT_train(_OfTraining, base.Alone, base.Told, bpy.types.Operator):
    """Train a model on the data set, beside which it is written, and choose it. Blender stays free"""

    bl_idname = "nlos.train"
    bl_label = "Train"

    def invoke(self: Any, context: Any, event: Any) -> set[str]:
        """Ask before an older model is replaced."""
        try:
            _, model = _paths(context.scene)
            there = model.exists()
        except (NlosError, OSError):
            there = False  # `execute` tells
        if not there:
            return cast("set[str]", self.execute(context))
        return cast(
            "set[str]",
            context.window_manager.invoke_confirm(
                self, event, title="Replace the model?", message=str(model), confirm_text="Train"
            ),
        )

    def act(self, context: Any) -> None:
        """Begin, in the background."""
        global job
        interpreter = environment.python()
        dataset, model = _paths(context.scene)
        if not dataset.is_dir():
            raise NlosError(f"{dataset} is not there; render a data set first, or name the folder of one")
        job = Job(interpreter, dataset, model, context.scene.nlos)


class NLOS_OT_train_cancel(_OfTraining, base.Cancels, bpy.types.Operator):
    """Stop the training. An older model of the same name is kept"""

    bl_idname = "nlos.train_cancel"


def _paths(scene: Any) -> tuple[Path, Path]:
    """Return the folder of the set, and the file of the model, which stands beside it."""
    dataset = folder_named(scene.nlos.train_set or scene.nlos.dataset)
    return dataset, dataset.parent / f"{dataset.name}.skops"


_CLASSES = (NLOS_OT_train, NLOS_OT_train_cancel)
_register, _unregister = bpy.utils.register_classes_factory(_CLASSES)


def register() -> None:
    """Add the operators."""
    _register()


def unregister() -> None:
    """Remove the operators, and forget the job."""
    global job
    job = None
    _unregister()
