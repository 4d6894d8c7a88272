"""Background work: threads that never use bpy, and Blender processes without a window, which do."""

from __future__ import annotations

import atexit
import contextlib
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from generator.blender.engines import devices
from generator.blender.scene import blend_file
from generator.jobs.protocol import Request
from generator.jobs.workers import Launch, Worker
from generator.model.errors import NlosError

from . import state

CHILD = Path(__file__).with_name("child.py")
"""The script that runs a worker of the extension in another process."""
_BETWEEN = 0.001
_EVERY = 0.2
"""Seconds between two polls of the threads."""


class Task:
    """Work that a thread does, and a function that handles its result in Blender's main thread.

    Parameters
    ----------
    work : callable
        Called in a thread, with this task; must not use bpy.
    then : callable
        Called in Blender's main thread when the work is done, with this task; may use bpy.
    tick : callable, optional
        Called in Blender's main thread at intervals while the work runs, with this task.
    topic : str
        Subject of the task: a newer task on the same topic ends this one, and so does opening another file. Empty if
        neither should.

    Attributes
    ----------
    result : object
        Value that ``work`` returned.
    error : str
        Message of the error that ended ``work``; empty if there was none.
    stop : threading.Event
        Set to ask ``work`` to end early.
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
        except Exception as error:  # a thread that ends without a message would leave the panel waiting for ever
            self.error = f"{type(error).__name__}: {error}"

    @property
    def done(self) -> bool:
        """Whether the thread has ended."""
        return not self._thread.is_alive()

    def settle(self) -> Task:
        """Wait for the end if Blender has no window and thus no event loop; return the task."""
        if bpy.app.background:
            self._thread.join()
            _tasks.remove(self)
            self.then(self)
        return self

    def end(self) -> None:
        """Ask the thread to end, and wait up to 10 s for it."""
        self.stop.set()
        self._thread.join(10.0)


_tasks: list[Task] = []


def drop(topic: str | None = None) -> None:
    """Stop and discard the task on a topic, or all that have a topic if None: the result is no longer needed."""
    drop_steps(topic)
    for task in [t for t in _tasks if t.topic and topic in (None, t.topic)]:
        task.stop.set()
        _tasks.remove(task)


_stepping: dict[str, object] = {}


def stepwise(steps: Iterator[Any], then: Callable[[list[Any]], None], topic: str) -> None:
    """Do work that uses bpy one step after another, and let Blender's window go on between them.

    Parameters
    ----------
    steps : iterator
        Each step is short. Undo, opening a file and newer work on the topic end it: they invalidate Blender's data.
    then : callable
        Called with what the steps gave, in a list.
    topic : str
    """
    if bpy.app.background:
        then(list(steps))
        return
    token = _stepping[topic] = object()
    found: list[Any] = []

    def step() -> float | None:
        if _stepping.get(topic) is not token:
            return None
        try:
            found.append(next(steps))
        except StopIteration:
            del _stepping[topic]
            then(found)
            state.redraw()
            return None
        return _BETWEEN

    bpy.app.timers.register(step, persistent=True)


def drop_steps(topic: str | None = None) -> list[str]:
    """Give up what is done stepwise on a topic, or all of it if None; return the topics."""
    dropped = [name for name in _stepping if topic in (None, name)]
    for name in dropped:
        del _stepping[name]
    return dropped


def is_stepping(topic: str = "") -> bool:
    """Return whether work is being done stepwise, on a topic or, if that is empty, any."""
    return topic in _stepping if topic else bool(_stepping)


def _poll() -> float | None:
    for task in list(_tasks):
        try:
            task.tick(task)
            if task.done:
                _tasks.remove(task)
                task.then(task)
        except Exception:  # a task that fails must not leave the others waiting for ever
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
    """Return a function that gives the command to start a worker in the same Blender as this, without a window."""
    binary = bpy.app.binary_path  # may be read only in Blender's main thread
    # The bpy module comes without a Blender executable, but Python can import it.
    prefix = [binary, "--background", "--factory-startup", "-noaudio", "--python"] if binary else [sys.executable]

    def launch(arguments: Sequence[str]) -> list[str]:
        return [*prefix, str(CHILD), "--", *arguments]

    return launch


def ask(request: Request, then: Callable[[Task], None], topic: str) -> Task:
    """Run a worker that answers once; ``then`` gets the fields of the answer as the task's result."""
    # The worker starts with factory settings, so it knows the GPUs of the preferences only from the request.
    request, launch = replace(request, gpus=devices.preferred(devices.preferences())), launcher()

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
    """Return the temporary folder of the session, which is removed when Blender ends."""
    global _folder
    if _folder is None:
        try:
            _folder = tempfile.TemporaryDirectory(prefix="nlos-lab-")
        except OSError as error:
            raise NlosError(f"no temporary folder can be made ({error.strerror or error})") from None
    return Path(_folder.name)


def snapshot(name: str) -> Path:
    """Save the current scene to a temporary file, for another Blender to open; return its path."""
    path = folder() / name
    blend_file.save_snapshot(path)
    return path


def end() -> None:
    """End all tasks, and remove the temporary folder."""
    global _folder
    for task in list(_tasks):
        task.end()
    _tasks.clear()
    if _folder is not None:
        with contextlib.suppress(OSError):
            _folder.cleanup()
        _folder = None


def register() -> None:
    """Make all tasks end when Blender ends."""
    atexit.register(end)


def unregister() -> None:
    """End all tasks, and stop polling."""
    end()
    atexit.unregister(end)
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)
