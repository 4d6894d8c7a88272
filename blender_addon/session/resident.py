"""The process that draws the live look, so that Blender's window never waits for a picture."""

from __future__ import annotations

import base64
import contextlib
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from generator.files.pictures import Picture
from generator.jobs.protocol import DrawLook, Question
from generator.jobs.workers import Launch, Worker

from . import background, environment


class Resident:
    """A process that answers the newest question, and keeps its engine from one to the next.

    Parameters
    ----------
    launches : sequence of callable
        Ways to start it, the best first; the next is tried where one ends before it is ready.

    Attributes
    ----------
    words : str
        What an artist should know: that it starts, that it compiles first, or why there is none.
    note : str
        Why the best way to start it was not taken; empty if it was.
    ended : bool
        Whether it is over: no way to start it is left, or it died at work.
    """

    def __init__(self, launches: Sequence[Launch]) -> None:
        self.words, self.note, self.ended = "The engine starts ...", "", False
        self._launches = launches
        self._lock = threading.Lock()
        self._worker: Worker | None = None
        self._question: Question | None = None
        self._answer: dict[str, Any] | None = None
        self._is_ready = self._is_stopped = False
        self._came = threading.Event()
        threading.Thread(target=self._run, daemon=True, name="nlos look").start()

    def ask(self, question: Question) -> None:
        """Ask for a picture, in place of any that was asked for before."""
        with self._lock:
            self._question = question
            self._send()

    def take(self, patience: float = 0.0) -> dict[str, Any] | None:
        """Return the newest answer, once; None if there is none, nor comes within so many seconds."""
        if patience:
            self._came.wait(patience)
        with self._lock:
            self._came.clear()
            found, self._answer = self._answer, None
        return found

    def stop(self) -> None:
        """End the process, without waiting for it."""
        with self._lock:
            self._is_stopped = True
            if self._worker is not None:
                self._worker.kill()

    def _send(self) -> None:
        if self._is_ready and self._worker is not None and self._question is not None:
            with contextlib.suppress(OSError, ValueError):  # it has ended, as `_run` finds too
                self._worker.send(self._question.line)

    def _run(self) -> None:
        notes = []
        for launch in self._launches:
            try:
                worker = Worker(DrawLook(), launch)
            except OSError as error:
                notes.append(f"it cannot be run ({error.strerror or error})")
                continue
            if notes:
                self.note = f"The Python in the preferences does not draw it: {notes[0]}"
            with worker:
                with self._lock:
                    self._worker = worker
                    if self._is_stopped:
                        return
                self._listen(worker)
                with self._lock:
                    was_ready, self._is_ready, self._worker = self._is_ready, False, None
                    if self._is_stopped:
                        return
                notes.append(worker.last_words())
            if was_ready:
                break
        self.words = f"The live look has ended ({notes[-1]}); switch it off and on to start it again"
        self.ended = True

    def _listen(self, worker: Worker) -> None:
        while (fields := worker.answer()) is not None:
            with self._lock:
                if "ready" in fields:
                    self.words, self._is_ready = str(fields["words"]), True
                    self._send()
                else:
                    self.words, self._answer = "", fields
                    self._came.set()


def pixels(fields: dict[str, Any]) -> Picture:
    """Return the picture in an answer, (height, width, 3), W/m^2/sr."""
    values: Picture = np.frombuffer(base64.b64decode(fields["pixels"]), dtype="<f4").reshape(fields["shape"])
    return values


def launches() -> list[Launch]:
    """Return the ways to start it: by the Python of the preferences, if there is one, and by this Blender."""
    ways = [background.launcher()]
    if path := environment.named():
        # -E, so that what Blender's own variables name is not imported there.
        ways.insert(0, lambda arguments: [path, "-E", str(background.CHILD), "--", *arguments])
    return ways
