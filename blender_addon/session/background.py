"""Work beside Blender's own: threads that never touch bpy, and Blenders without a window that do."""

from __future__ import annotations

import atexit
import contextlib
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import bpy

from generator.blender.scene import blend_file
from generator.jobs.protocol import Request
from generator.jobs.workers import Launch, Worker
from generator.model.errors import NlosError

from . import state

_CHILD = Path(__file__).with_name("child.py")
_EVERY = 0.2
"""Seconds between two looks at what the threads have done."""


class Task:
    """Something that a thread does, and what Blender's own thread makes of it.

    Parameters
    ----------
    work : callable
        Is called in a thread, with this task; must not touch bpy.
    then : callable
        Is called in Blender's thread when that is done, with this task; may.
    tick : callable, optional
        Is called in Blender's thread every now and then meanwhile.
    topic : str
        What it is about: a newer task about the same ends this one, and so does another file that is opened. Empty if
        nothing does.

    Attributes
    ----------
    result : object
        What ``work`` returned.
    error : str
        Why it did not; empty if it did.
    stop : threading.Event
        Asks ``work`` to end early.
    """

    def __init__(
        self,
        work: Callable[[Task], Any],
        then: Callable[[Task], None],
        tick: Callable[[Task], None] = lambda task: None,
        *,
        topic: str = "",
    ) -> None:
        if topic:
            drop(topic)
        self.topic = topic
        self.result: Any = None
        self.error = ""
        self.stop = threading.Event()
        self.tick = tick
        self.then = then
        self._work = work
        self._thread = threading.Thread(target=self._run, daemon=True, name="nlos")
        _tasks.append(self)
        self._thread.start()
        if not bpy.app.background:
            state.once(_poll)

    def _run(self) -> None:
        try:
            self.result = self._work(self)
        except NlosError as error:
            self.error = str(error)
        except Exception as error:  # a thread that dies in silence would leave the panel waiting for ever
            self.error = f"{type(error).__name__}: {error}"

    @property
    def done(self) -> bool:
        """Whether the thread has ended."""
        return not self._thread.is_alive()

    def settle(self) -> Task:
        """Finish here and now where Blender has no window, for there it has no event loop; return the task."""
        if bpy.app.background:
            self._thread.join()
            _tasks.remove(self)
            self.then(self)
        return self

    def end(self) -> None:
        """Ask the thread to end, and wait for it a while."""
        self.stop.set()
        self._thread.join(10.0)


_tasks: list[Task] = []


def drop(topic: str | None = None) -> None:
    """End the task about a topic, or about any, whatever it would have found: the question is no longer asked."""
    for task in [t for t in _tasks if t.topic and topic in (None, t.topic)]:
        task.stop.set()
        _tasks.remove(task)


def _poll() -> float | None:
    for task in list(_tasks):
        try:
            task.tick(task)
            if task.done:
                _tasks.remove(task)
                task.then(task)
        except Exception:  # one that fails must not leave the others waiting for ever
            traceback.print_exc()
            state.rendering = "What was asked for in the background could not be shown; the system console says why"
            if task in _tasks and task.done:
                _tasks.remove(task)
        if task not in _tasks:
            state.redraw()
    return _EVERY if _tasks else None


def _kill_when(stop: threading.Event, worker: Worker) -> None:
    stop.wait()
    worker.kill()


def launcher() -> Launch:
    """Return what starts a worker in a Blender without a window, the same as this one."""
    binary = bpy.app.binary_path  # to be asked in Blender's own thread
    # The bpy module has no Blender beside it, but Python can import it.
    before = [binary, "--background", "--factory-startup", "-noaudio", "--python"] if binary else [sys.executable]

    def launch(arguments: Sequence[str]) -> list[str]:
        return [*before, str(_CHILD), "--", *arguments]

    return launch


def ask(request: Request, then: Callable[[Task], None], topic: str) -> Task:
    """Run a worker that answers once; ``then`` finds the answer's fields as the task's result."""
    launch = launcher()

    def work(task: Task) -> dict[str, Any]:
        with Worker(request, launch) as worker:
            threading.Thread(target=_kill_when, args=(task.stop, worker), daemon=True).start()
            answer = worker.answer()
            task.stop.set()
            if answer is None:
                raise NlosError(f"Blender, without a window, ended early: {worker.last_words()}")
            return answer

    return Task(work, then, topic=topic)


_folder: tempfile.TemporaryDirectory[str] | None = None


def folder() -> Path:
    """Return the session's own folder, which goes when Blender does."""
    global _folder
    if _folder is None:
        try:
            _folder = tempfile.TemporaryDirectory(prefix="nlos-lab-")
        except OSError as error:
            raise NlosError(f"no temporary folder can be made ({error.strerror or error})") from None
    return Path(_folder.name)


def snapshot(name: str) -> Path:
    """Save the scene as it stands under a temporary name, for another Blender to open; return the file."""
    path = folder() / name
    blend_file.save_file(path)
    return path


def end() -> None:
    """End everything that is going on, and remove what it left."""
    global _folder
    for task in list(_tasks):
        task.end()
    _tasks.clear()
    if _folder is not None:
        with contextlib.suppress(OSError):
            _folder.cleanup()
        _folder = None


def register() -> None:
    """Have everything end with Blender."""
    atexit.register(end)


def unregister() -> None:
    """End everything."""
    end()
    atexit.unregister(end)
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)
