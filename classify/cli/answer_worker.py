"""Worker process that says of one picture after another in which voxel the target stands, always for the newest.

Run as ``python -m classify.cli.answer_worker REQUEST``: what `AnswerPictures` and `PictureQuestion` of
`generator.jobs.protocol` say. A picture that comes while another is answered takes the place of one that waits.
"""

from __future__ import annotations

import base64
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from generator.files.toml import from_dict
from generator.jobs.desk import Desk
from generator.jobs.protocol import PictureQuestion, answer
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.transport import Transport
from generator.transport.world_file import load_world

if TYPE_CHECKING:
    from classify.inference.answerer import Answerer

_ACCURACY = 1e-2
"""Accuracy of the background. Picture and background share its error, so that it is in no difference."""


class _Clerk:
    """Answers questions, with the background of the last scene."""

    def __init__(self, answerer: Answerer) -> None:
        self._answerer = answerer
        self._scene: tuple[Any, ...] = ()
        self._refusal: NlosError | None = None

    def answered(self, question: PictureQuestion) -> dict[str, Any]:
        """Return the fields of the answer."""
        self._look_at(question)
        from classify.tail import RARE

        shape = tuple(question.shape)
        difference = np.frombuffer(base64.b64decode(question.pixels), dtype="<f4").reshape(shape)
        found = self._answerer.answer(difference)
        place: dict[str, Any] = {}
        if found.place is not None:
            deviation = np.sqrt(np.diag(found.place.covariance))
            place = {"position": found.place.position.tolist(), "deviation": deviation.tolist()}
        doubts = list(self._answerer.doubts)
        if found.misfit is not None and found.misfit < RARE:
            doubts.append(f"this picture is unlike those that it knows (misfit {found.misfit:.1g})")
        return {"probability": found.probability, **place, "doubts": doubts}

    def _look_at(self, question: PictureQuestion) -> None:
        from classify.inference.answerer import Seen

        scene = question.world, question.grid, question.target, question.colour_space
        if scene != self._scene:
            self._scene, self._refusal = scene, None
            try:
                background = Transport(load_world(Path(question.world)), accuracy=_ACCURACY).background()
                self._answerer.look_at(
                    Seen(
                        background=background.astype(np.float32),
                        grid=from_dict(VoxelGrid, question.grid, "grid."),
                        target=question.target,
                        colour_space=question.colour_space,
                    )
                )
            except NlosError as error:
                self._refusal = error
        if self._refusal is not None:
            raise self._refusal


def main(arguments: Sequence[str]) -> int:
    """Answer questions until the coordinator ends."""
    desk = Desk(lambda line: PictureQuestion(**json.loads(line)))
    try:
        from classify.inference.answerer import opened  # loads scikit-learn, which may be missing

        answerer = opened(Path(json.loads(arguments[0])["model"]))
    except ImportError as error:
        answer(error=f"the Python in the preferences lacks {error.name or error}; make one with 'make setup'")
        return 2
    except NlosError as error:
        answer(error=str(error))
        return 2
    answer(ready=True, words=answerer.words)
    clerk = _Clerk(answerer)
    while True:
        question = desk.next()
        try:
            answer(number=question.number, **clerk.answered(question))
        except NlosError as error:
            answer(number=question.number, refused=str(error))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
