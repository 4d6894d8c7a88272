"""Worker processes: how they are started, fed, watched, ended and started again."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import logging
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from generator.jobs.protocol import ANSWER, PlanSweep, Request
from generator.model.errors import NlosError
from generator.model.quantities import Progress

NO_BLENDER = "this needs Blender's module bpy, which is not installed; install it with: pip install 'nlos-lab[bpy]'"


_HOME = str(Path(__file__).resolve().parents[2])


TRIES = 3
"""How often a unit of work is given to a worker before it is listed as failed."""


_PATIENCE = (6 * 3600.0, 600.0)
"""Seconds that a worker may be silent: before any unit of work is done, and from then on at least."""


_SLOWER = 20.0
"""Multiple of the longest time of a unit so far that a worker may be silent."""


_HOPELESS = 50
"""Workers in a row that end before a unit is done: then the fault is not in the units."""


Launch = Callable[[Sequence[str]], list[str]]
"""Turns a worker's module and arguments into the command line of its process."""


def python(arguments: Sequence[str]) -> list[str]:
    """Return the command line that runs a worker by this Python.

    Raises
    ------
    NlosError
        This Python has no bpy.
    """
    if importlib.util.find_spec("bpy") is None:  # does not import it
        raise NlosError(NO_BLENDER)
    return [sys.executable, "-m", *arguments]


def available_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_batches(units: Sequence[int], size: int) -> list[Sequence[int]]:
    """Return units of work in batches of that size; the last may be smaller."""
    return [units[start : start + size] for start in range(0, len(units), size)]


def planned_notes(request: PlanSweep, launch: Launch = python) -> list[str]:
    """Let a worker plan a set, and return its notes on the scene."""
    with Worker(request, launch) as worker:
        if (answer := worker.answer()) is None:
            raise NlosError(f"{request.scene}: Blender could not plan the set: {worker.last_words()}")
        return [str(words) for words in answer.get("notes", [])]


class Worker:
    """A worker process and the communication with it.

    Parameters
    ----------
    request : Request
        Request to the worker.
    launch : callable
        Returns the command line that starts it.
    """

    def __init__(self, request: Request, launch: Launch = python) -> None:
        command = launch(request.arguments)
        self._log = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115 (closed in stop)
        # Blender and renders leave temporary folders, which a killed process cannot remove.
        self._scratch = tempfile.TemporaryDirectory(prefix="nlos-worker-", ignore_cleanup_errors=True)
        home = os.pathsep.join(filter(None, [_HOME, os.environ.get("PYTHONPATH")]))
        scratch = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), self._scratch.name)
        # Poses are shared among threads and workers already; threads of their small products wait for each other.
        products = {"OPENBLAS_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,  # the coordinator handles Ctrl-C
            env={**products, **os.environ, **scratch, "PYTHONPATH": home},
        )
        self.pid = self._process.pid
        self.done = 0
        self._since, self._doing = time.monotonic(), "starting"

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self.stop()

    def kill(self) -> None:
        """End the process at once; a picture that is not in place by then counts as not begun."""
        if self._process.poll() is None:
            self._process.kill()

    def stop(self) -> None:
        """End the process, and close the streams to it."""
        self.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._log):
            if stream:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()
        self._scratch.cleanup()

    def begin(self, what: str) -> None:
        """Record what the worker does from now on; an empty text means that it is waiting."""
        self._since, self._doing = time.monotonic(), what

    def look(self) -> dict[str, Any]:
        """Return what the worker is doing, and for how long."""
        seconds = round(time.monotonic() - self._since, 1)
        return {"pid": self.pid, "doing": self._doing, "seconds": seconds, "done": self.done}

    def answer(self) -> dict[str, Any] | None:
        """Return the next answer, or None if the worker has ended; raise NlosError if the answer is an error."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith(ANSWER):
                fields: dict[str, Any] = json.loads(line[len(ANSWER) :])
                if "error" in fields:
                    raise NlosError(fields["error"])
                return fields
        return None

    def send(self, words: str) -> None:
        """Send the worker its next units of work."""
        assert self._process.stdin is not None
        self._process.stdin.write(words + "\n")
        self._process.stdin.flush()

    def last_words(self) -> str:
        """Return the last line the worker wrote to its log, and how it ended."""
        code = self._process.wait()
        self._log.seek(0)
        lines = [line.strip() for line in self._log if line.strip()]
        return f"{lines[-1] if lines else 'it said nothing'} (exit code {code})"


class WorkerPool:
    """Workers that run in parallel; a thread per worker hands it one batch of units of work at a time.

    Parameters
    ----------
    request : callable
        Returns the request to a worker, given how many threads it may use. The worker reports when it is ready, takes
        batches as lines of unit numbers separated by blanks, and answers each batch when it is done.
    name : callable
        Returns the name of a unit in a list of failures.
    progress : callable
        Called with (done, total).
    size : callable
        Returns how much a unit adds to done and total.
    say : callable
        Returns the word that is sent to a worker for a unit.
    launch : callable
        Returns the command line that starts a worker.
    stop : threading.Event, optional
        Ends the work early when another thread sets it.
    log : logging.Logger, optional
        Receives a record of what happens to workers.
    patience : (float, float)
        Seconds after which a silent worker is ended: before any unit is done, and the least from then on; the limit
        grows to `_SLOWER` times the longest time that a unit took.

    Attributes
    ----------
    failed : list of str
        Units that could not be done, each with its reason.
    """

    def __init__(
        self,
        request: Callable[[int], Request],
        name: Callable[[int], str],
        progress: Progress,
        size: Callable[[int], int] = lambda unit: 1,
        *,
        say: Callable[[int], str] = str,
        launch: Launch = python,
        stop: threading.Event | None = None,
        log: logging.Logger | None = None,
        patience: tuple[float, float] = _PATIENCE,
    ) -> None:
        self.failed: list[str] = []
        self._request = request
        self._name = name
        self._progress = progress
        self._size = size
        self._say = say
        self._log = log or logging.getLogger("nlos")
        self._patience = patience
        self._longest = 0.0
        self._fallen = 0
        self._launch = launch
        self._todo: queue.SimpleQueue[tuple[Sequence[int], int]] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._workers: set[Worker] = set()
        self._stop = stop or threading.Event()
        self._stopped = threading.Event()
        self._error: Exception | None = None
        self._done = 0
        self._total = 0

    def work(self, units: Sequence[int], workers: int = 0, *, first: str = "", batch: int = 1) -> None:
        """Do all units of work.

        Parameters
        ----------
        units : sequence of int
        workers : int
            Processes; 0 is one per core.
        first : str
            What the first worker makes, on all cores, before the other workers start, which need it; empty if there
            is nothing to make first.
        batch : int
            Largest number of units that a worker is given at once.

        Raises
        ------
        NlosError
            A worker answered with an error, which ends the work.
        """
        cores = available_cores()
        crew = max(1, min(workers or cores, len(units)))
        self._total = sum(map(self._size, units))
        self._progress(0, self._total)
        batch = max(1, min(batch, len(units) // (4 * crew)))  # several per worker, so that all end about together
        for units_of_batch in in_batches(units, batch):
            self._todo.put((units_of_batch, 1))
        threading.Thread(target=self._watch, daemon=True).start()
        self._log.info("%d units to do by %d workers", len(units), crew)
        try:
            if first and (worker := self._start(cores)):
                with worker:
                    worker.begin(first)
                    if worker.answer() is None and not self._stopped.is_set():
                        raise NlosError(f"{first} could not be rendered: {worker.last_words()}")
            threads = max(1, cores // crew)
            feeders = [threading.Thread(target=self._feed, args=(threads,), daemon=True) for _ in range(crew)]
            for feeder in feeders:
                feeder.start()
            while any(feeder.is_alive() for feeder in feeders):
                feeders[0].join(0.2) if feeders[0].is_alive() else time.sleep(0.2)
        finally:
            self._stopped.set()
            with self._lock:
                for running_worker in self._workers:
                    running_worker.stop()
            self._log.info("%d of %d done, %d failed", self._done, self._total, len(self.failed))
        if self._error:
            raise self._error

    def look(self) -> tuple[list[str], list[dict[str, Any]]]:
        """Return what has failed, and what each worker is doing."""
        with self._lock:
            return list(self.failed), [worker.look() for worker in self._workers]

    def _watch(self) -> None:
        """End all workers when the work is to stop, and end any worker that has been silent for too long."""
        while not self._stopped.wait(0.2):
            if self._stop.is_set():
                self._stopped.set()
                break
            first_limit, later_limit = self._patience
            limit = max(later_limit, _SLOWER * self._longest) if self._longest else first_limit
            with self._lock:
                for worker in self._workers:
                    state = worker.look()
                    if state["doing"] and state["seconds"] > limit:
                        words = "worker %d, %s, said nothing for %.0f s and is ended"
                        self._log.warning(words, worker.pid, state["doing"], state["seconds"])
                        worker.begin("")
                        worker.kill()
        with self._lock:
            for worker in self._workers:
                worker.kill()

    def _start(self, threads: int) -> Worker | None:
        """Start a worker, unless the work has been stopped: nothing would end a worker that starts after that."""
        with self._lock:
            if self._stopped.is_set():
                return None
            worker = Worker(self._request(threads), self._launch)
            self._workers.add(worker)
            self._log.info("worker %d begins", worker.pid)
        return worker

    def _feed(self, threads: int) -> None:
        worker: Worker | None = None
        try:
            while not self._stopped.is_set():
                try:
                    batch, attempt = self._todo.get_nowait()
                except queue.Empty:
                    break
                worker = worker or self._start(threads)
                if worker is None:
                    break
                begun = time.monotonic()
                worker.begin(", ".join(map(self._name, batch)))
                if self._do(worker, batch):
                    worker.begin("")
                    worker.done += len(batch)
                    self._longest = max(self._longest, time.monotonic() - begun)
                    with self._lock:
                        self._fallen = 0
                        self._done += sum(map(self._size, batch))
                        self._progress(self._done, self._total)
                elif not self._stopped.is_set():
                    words = worker.last_words()
                    self._log.warning("worker %d ended at %s: %s", worker.pid, self._name(batch[0]), words)
                    with self._lock:
                        self._workers.discard(worker)
                        self._fallen += 1
                    worker.stop()
                    worker = None
                    if self._fallen >= _HOPELESS:
                        raise NlosError(f"{_HOPELESS} workers in a row ended before one picture was done: {words}")
                    for unit in batch:  # one by one from now on, so that the others do not fail with the faulty unit
                        if attempt < TRIES:
                            self._todo.put(([unit], attempt + 1))
                        else:
                            self.failed.append(f"{self._name(unit)}: {words}")
                            self._log.error("given up after %d tries: %s", TRIES, self.failed[-1])
        except Exception as error:  # bad input, or a closed output; the thread that waits for this one raises it
            self._error = error
            self._stopped.set()

    def _do(self, worker: Worker, batch: Sequence[int]) -> bool:
        """Return whether the worker has answered that the batch is done; False if the worker has ended."""
        try:
            worker.send(" ".join(map(self._say, batch)))
            while answer := worker.answer():
                if "ready" not in answer:
                    return True
        except NlosError:
            raise
        except (BrokenPipeError, ValueError):  # the worker's end of the pipe is closed, or `stop` closed ours
            pass
        return False
