"""Processes that stay, so that Blender's window never waits: one draws the live look, one answers its pictures."""

from __future__ import annotations

import base64
import contextlib
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from generator.files.pictures import Picture
from generator.jobs.protocol import DrawLook, PictureQuestion, Question, Request
from generator.jobs.workers import Launch, Worker
from generator.model.errors import NlosError

from . import background, environment


class Resident:
    """A process that answers the newest question, and keeps its engine from one to the next.

    Parameters
    ----------
    launches : sequence of callable
        Ways to start it, the best first; the next is tried where one ends before it is ready.
    request : Request
        What it is started with; `DrawLook` if not given.
    name : str
        What the panel calls it.
    starting : str
        What the panel says until it is ready.

    Attributes
    ----------
    words : str
        What an artist should know: that it starts, that it compiles first, or why there is none.
    note : str
        Why the best way to start it was not taken; empty if it was.
    ended : bool
        Whether it is over: no way to start it is left, it died at work, or what it was started with is wrong.
    about : str
        What it said of itself when it was ready.
    """

    def __init__(
        self,
        launches: Sequence[Launch],
        request: Request | None = None,
        *,
        name: str = "The live look",
        starting: str = "The engine starts ...",
    ) -> None:
        self.words, self.note, self.about, self.ended = starting, "", "", False
        self._launches, self._request, self._name = launches, request or DrawLook(), name
        self._lock = threading.Lock()
        self._worker: Worker | None = None
        self._question: Question | PictureQuestion | None = None
        self._asked = threading.Event()
        self._answer: dict[str, Any] | None = None
        self._is_ready = self._is_stopped = False
        self._came = threading.Event()
        for work in (self._run, self._send):
            threading.Thread(target=work, daemon=True, name=f"nlos {name}").start()

    def ask(self, question: Question | PictureQuestion) -> None:
        """Ask a question, in place of any that was asked before."""
        self._question = question
        self._asked.set()

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
            self._asked.set()
            if self._worker is not None:
                self._worker.kill()

    def _send(self) -> None:
        """Send questions, in a thread of its own: a picture fills the pipe, which the process empties in its time."""
        while True:
            self._asked.wait()
            self._asked.clear()
            with self._lock:
                if self._is_stopped or self.ended:
                    return
                worker, question = self._worker if self._is_ready else None, self._question
            if worker is not None and question is not None:
                with contextlib.suppress(OSError, ValueError):  # it has ended, as `_run` finds too
                    worker.send(question.line)

    def _run(self) -> None:
        notes = []
        for launch in self._launches:
            try:
                worker = Worker(self._request, launch)
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
                try:
                    self._listen(worker)
                except NlosError as error:  # it says itself what is wrong
                    self.words = f"{self._name}: {error}"
                    self._end()
                    return
                with self._lock:
                    was_ready, self._is_ready, self._worker = self._is_ready, False, None
                    if self._is_stopped:
                        return
                notes.append(worker.last_words())
            if was_ready:
                break
        self.words = f"{self._name} has ended ({notes[-1]}); switch it off and on to start it again"
        self._end()

    def _end(self) -> None:
        self.ended = True
        self._asked.set()

    def _listen(self, worker: Worker) -> None:
        while (fields := worker.answer()) is not None:
            with self._lock:
                if "ready" in fields:
                    self.words, self.about, self._is_ready = str(fields["words"]), str(fields["words"]), True
                    self._asked.set()
                else:
                    self.words, self._answer = "", fields
                    self._came.set()


def pixels(fields: dict[str, Any]) -> Picture:
    """Return the picture in an answer, (height, width, 3), W/m^2/sr."""
    values: Picture = np.frombuffer(base64.b64decode(fields["pixels"]), dtype="<f4").reshape(fields["shape"])
    return values


_ANSWERING = """
import os, sys
del sys.path[0]  # the current folder
if hasattr(os, "nice"):
    os.nice(10)  # where cores are few, Blender's window goes first
try:
    from {module} import main
except ImportError as error:
    sys.exit(f"it lacks {{error.name}}")
sys.exit(main(sys.argv[1:]))
"""


def answering(python: str) -> Launch:
    """Return the way to start what only an environment with NLOS Lab's command line can run."""
    # -E, so that what Blender's own variables name is not imported there.
    return lambda arguments: [python, "-E", "-c", _ANSWERING.format(module=arguments[0]), *arguments[1:]]


def launches() -> list[Launch]:
    """Return the ways to start what draws: by the Python of the preferences, if there is one, and by this Blender."""
    ways = [background.launcher()]
    if path := environment.named():
        # -E, so that what Blender's own variables name is not imported there.
        ways.insert(0, lambda arguments: [path, "-E", str(background.CHILD), "--", *arguments])
    return ways
