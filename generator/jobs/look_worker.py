"""Worker process that draws what a target at a pose changes, always for the newest question.

Run as ``python -m generator.jobs.look_worker REQUEST``; needs NumPy, and no Blender. A question is a line of JSON
(`Question`). Where the whole picture takes longer than `_SOON`, it is answered by quicker ones first: one without the
target's shadow on the room, and without a compiler a draft with it. What is unfinished is dropped when another
question comes. When the coordinator dies, its end of the pipe closes, and the worker ends too.
"""

from __future__ import annotations

import base64
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from generator.jobs.desk import Desk, DroppedError
from generator.jobs.protocol import Question, answer
from generator.model.errors import NlosError
from generator.transport import Transport
from generator.transport.caching import compiling_words
from generator.transport.compiled import COMPILED
from generator.transport.render import COARSEST
from generator.transport.world_file import load_world

_SOON = 0.05
"""Seconds within which a whole picture needs no quicker one before it."""
_LOOSER = 3.0
"""How many times less accurate a draft is."""


class _Painter:
    """Answers questions, with the engine of the last world."""

    def __init__(self, desk: Desk[Question]) -> None:
        self._desk = desk
        self._engine: Transport | None = None
        self._draft: Transport | None = None
        self._of: tuple[str, float] = "", 0.0
        self._seconds = float("inf")
        self._is_warm = not COMPILED

    def paint(self, question: Question) -> None:
        """Send the pictures that a question asks for."""
        start = time.perf_counter()
        try:
            self._desk.droppable(self._is_warm)  # what compiles is not dropped, or it might never end
            engine = self._prepared(question)
            if question.shadows and self._seconds > _SOON:
                self._send(question, self._draft or engine, start, shadows=False, whole=False)
                if self._draft is not None:
                    self._send(question, self._draft, start, shadows=True, whole=False)
            begun = time.perf_counter()
            self._send(question, engine, start, shadows=question.shadows, whole=True)
            self._is_warm = True
            if question.shadows:
                self._seconds = time.perf_counter() - begun
        except NlosError as error:
            self._desk.droppable(False)
            answer(number=question.number, refused=str(error), seconds=time.perf_counter() - start)
        finally:
            self._desk.droppable(False)

    def _prepared(self, question: Question) -> Transport:
        if self._engine is None or self._of != (question.world, question.accuracy):
            self._engine, self._draft, self._seconds = None, None, float("inf")
            world, accuracy = load_world(Path(question.world)), question.accuracy
            engine = Transport(world, accuracy=accuracy)
            if not COMPILED:
                self._draft = Transport(world, accuracy=min(COARSEST, _LOOSER * accuracy), like=engine, draft=True)
            self._engine, self._of = engine, (question.world, accuracy)
        return self._engine

    def _send(self, question: Question, engine: Transport, start: float, *, shadows: bool, whole: bool) -> None:
        picture = engine.difference(question.position, question.rotation, shadows=shadows).astype("<f4")
        self._desk.droppable(False)  # half an answer would be none
        answer(
            number=question.number,
            whole=whole,
            shadows=shadows,
            shape=picture.shape,
            pixels=base64.b64encode(picture.tobytes()).decode("ascii"),
            seconds=time.perf_counter() - start,
        )
        self._desk.droppable(self._is_warm)


def main(arguments: Sequence[str] = ()) -> int:
    """Answer questions until the coordinator ends."""
    desk = Desk(lambda line: Question(**json.loads(line)))
    painter = _Painter(desk)
    answer(ready=True, compiled=bool(COMPILED), words=compiling_words("surfel"))
    while True:
        question = desk.next()
        try:
            painter.paint(question)
        except DroppedError:
            continue


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
