"""Plans a sweep, starts workers, shows progress, resumes: the coordinator, which never imports bpy.

A worker's word is not taken for its work: what is done is what lies on disk, whole and with the right hash.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from generator import spec
from generator.dataset import SCENE, Dataset, check_free, scene_hash
from generator.spec import NlosError

ANSWER = "nlos "

_HOME = str(Path(__file__).resolve().parents[1])

TRIES = 3
"""How often a pose is given to a worker before it is listed as failed."""


@dataclass
class Outcome:
    """What a sweep did.

    Attributes
    ----------
    dataset : Dataset
    rendered : int
        Pictures made by this run.
    failed : list of str
        Files of the poses that could not be rendered, each with its reason.
    remaining : int
        Poses of the whole set, other shards' included, that are not rendered yet.
    """

    dataset: Dataset
    rendered: int = 0
    failed: list[str] = field(default_factory=list)
    remaining: int = 0


Progress = Callable[[int, int], None]
"""Is told how many pictures of this run are done, and how many there are to do."""


def run(
    scene: Path,
    path: Path,
    chosen: Mapping[str, Any],
    *,
    workers: int = 0,
    shard: tuple[int, int] = (0, 1),
    progress: Progress = lambda done, total: None,
) -> Outcome:
    """Render a data set, or what is missing of it.

    Parameters
    ----------
    scene : Path
        The ``.blend``.
    path : Path
        Of the data set; a folder that is new, empty, or holds the same sweep.
    chosen : mapping
        Fields of `Sweep` that the user chose. What is left out follows from the data set if there is one, else from
        the scene and the defaults.
    workers : int
        Processes; 0 is one per core.
    shard : (int, int)
        ``(i, n)``: render the i-th of n parts only, i from 0.
    progress : callable

    Raises
    ------
    NlosError
        The input is bad, or the data set at that path was made with other settings.
    """
    dataset = prepare(scene, path, chosen)
    pending = pending_positions(dataset, shard)
    outcome = Outcome(dataset)
    if pending or not _has_backgrounds(dataset):
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        crew = max(1, min(workers or cores, len(pending)))
        _Crew(dataset, outcome, progress).render(pending, crew, max(1, cores // crew), cores)
        outcome.rendered = sum(dataset.poses[position].done for position in pending)  # as gathered from disk
    outcome.remaining = sum(not pose.done for pose in dataset.poses)
    return outcome


def prepare(scene: Path, path: Path, chosen: Mapping[str, Any]) -> Dataset:
    """Return the data set at a path, planned now if there is none, after comparing the settings if there is one."""
    if not Dataset.exists(path):
        if not scene.is_file():
            raise NlosError(f"{scene}: no such scene file")
        check_free(path)
        _run_plan(scene, path, chosen)
        return Dataset.open(path)
    dataset = Dataset.open(path)
    check_same(dataset, scene, chosen)
    return dataset


def check_same(dataset: Dataset, scene: Path, chosen: Mapping[str, Any]) -> None:
    """Raise NlosError, naming each difference, if a data set was made from another scene or with other settings."""
    own = dataset.settings
    width, height = own["resolution"]
    differences = []
    for name, value in chosen.items():
        if name == "resolution" and isinstance(value, str):
            value = list(spec.parse_resolution(value, width / height))
        if name in own and own[name] != value:
            differences.append(f"{name} is {own[name]} there and {value} here")
    if scene_hash(scene) not in (own.get("scene_sha256"), scene_hash(dataset.path / SCENE)):
        differences.append(f"{scene} is not the scene it was rendered from (or has been saved again since)")
    if differences:
        raise NlosError(
            f"{dataset.path}: holds a sweep with other settings: {'; '.join(differences)}; "
            "use the same settings or another folder"
        )


def pending_positions(dataset: Dataset, shard: tuple[int, int] = (0, 1)) -> list[int]:
    """Return which poses of a shard are still to be rendered, judged by the pictures on disk."""
    index, count = shard
    if not 0 <= index < count:
        raise NlosError(f"--shard {index}/{count}: must be i/n with i from 0 to n - 1")
    dataset.gather()
    return [i for i, pose in enumerate(dataset.poses) if i % count == index and not pose.done]


def _has_backgrounds(dataset: Dataset) -> bool:
    return all(dataset.has_background(name) for name in dataset.background_names)


def _run_plan(scene: Path, path: Path, chosen: Mapping[str, Any]) -> None:
    with _Worker(["plan", str(scene), str(path), json.dumps(dict(chosen))]) as worker:
        if worker.answer() is None:
            raise NlosError(f"{scene}: Blender could not plan the sweep: {worker.last_words()}")


class _Worker:
    """A worker process and the talk with it."""

    def __init__(self, arguments: Sequence[str]) -> None:
        self._log = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115 (closed in stop)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "generator.worker", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,  # Ctrl-C is the coordinator's to handle
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [_HOME, os.environ.get("PYTHONPATH")]))},
        )

    def __enter__(self) -> _Worker:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End the process, at once: a picture that is not in place by then was never begun."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._log):
            if stream:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()

    def answer(self) -> dict[str, Any] | None:
        """Return the next answer, or None if the worker is gone; NlosError if that is its answer."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith(ANSWER):
                fields: dict[str, Any] = json.loads(line[len(ANSWER) :])
                if "error" in fields:
                    raise NlosError(fields["error"])
                return fields
        return None

    def send(self, position: int) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{position}\n")
        self._process.stdin.flush()

    def last_words(self) -> str:
        """Return the last line the worker wrote to its log, and how it ended."""
        code = self._process.wait()
        self._log.seek(0)
        lines = [line.strip() for line in self._log if line.strip()]
        return f"{lines[-1] if lines else 'it said nothing'} (exit code {code})"


class _Crew:
    """Workers side by side, each fed one pose at a time by a thread of its own."""

    def __init__(self, dataset: Dataset, outcome: Outcome, progress: Progress) -> None:
        self._dataset = dataset
        self._outcome = outcome
        self._progress = progress
        self._todo: queue.SimpleQueue[tuple[int, int]] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._workers: set[_Worker] = set()
        self._stopped = threading.Event()
        self._error: NlosError | None = None
        self._done = 0
        self._total = 0

    def render(self, positions: Sequence[int], crew: int, threads: int, cores: int) -> None:
        self._total = len(positions)
        self._progress(0, self._total)
        for position in positions:
            self._todo.put((position, 1))
        try:
            # The first worker, on all cores, renders the background before there is a crew that needs it.
            if not _has_backgrounds(self._dataset):
                with self._start(cores) as first:
                    if first.answer() is None:
                        raise NlosError(f"the background could not be rendered: {first.last_words()}")
            feeders = [threading.Thread(target=self._feed, args=(threads,), daemon=True) for _ in range(crew)]
            for feeder in feeders:
                feeder.start()
            while any(feeder.is_alive() for feeder in feeders):
                feeders[0].join(0.2) if feeders[0].is_alive() else time.sleep(0.2)
        finally:
            self._stopped.set()
            with self._lock:
                for worker in self._workers:
                    worker.stop()
            self._dataset.gather()
        if self._error:
            raise self._error

    def _start(self, threads: int) -> _Worker:
        with self._lock:
            worker = _Worker(["render", str(self._dataset.path), str(threads)])
            self._workers.add(worker)
        return worker

    def _feed(self, threads: int) -> None:
        worker: _Worker | None = None
        try:
            while not self._stopped.is_set():
                try:
                    position, attempt = self._todo.get_nowait()
                except queue.Empty:
                    break
                worker = worker or self._start(threads)
                if self._render_one(worker, position):
                    with self._lock:
                        self._done += 1
                        self._progress(self._done, self._total)
                elif not self._stopped.is_set():
                    words, worker = worker.last_words(), None
                    if attempt < TRIES:
                        self._todo.put((position, attempt + 1))
                    else:
                        self._outcome.failed.append(f"{self._dataset.poses[position].file}: {words}")
        except NlosError as error:
            self._error = error
            self._stopped.set()

    @staticmethod
    def _render_one(worker: _Worker, position: int) -> bool:
        """Whether the worker says that it rendered the pose; False if it is gone."""
        try:
            worker.send(position)
            while answer := worker.answer():
                if "file" in answer:
                    return True
        except NlosError:
            raise
        except (BrokenPipeError, ValueError):  # its end of the pipe is closed, or ours was by `stop`
            pass
        return False
