"""Plans a sweep, starts workers, shows progress, resumes: the coordinator, which never imports bpy.

A worker's word is not taken for its work: what is done is what lies on disk, whole and with the right hash.
"""

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from generator.jobs import journal as journals
from generator.model import spec
from generator.model.spec import NlosError, Sweep
from generator.sets import links
from generator.sets.dataset import SCENE, Dataset, check_free, scene_hash
from generator.transport import caching

ANSWER = "nlos "
NO_PROBE = "no-probe"
"""Tells a worker that plans to leave out the check at the start."""

FORCE = "force"
"""Last argument of a worker that plans in spite of errors that the check finds."""

NO_BLENDER = "this needs Blender's module bpy, which is not installed; install it with: pip install 'nlos-lab[bpy]'"

_HOME = str(Path(__file__).resolve().parents[2])

BACKGROUND_FACTOR = 16
"""The background is rendered with this many times a pose's samples: its noise stands in every difference."""

TRIES = 3
"""How often a unit of work is given to a worker before it is listed as failed."""

_PATIENCE = (6 * 3600.0, 600.0)
"""Seconds that a worker may say nothing: before anything is known of how long it takes, and from then on."""
_SLOWER = 20.0
"""Times the longest that a unit has taken, likewise."""

_HOPELESS = 50
"""Workers in a row that end before any has done anything: the fault is not in what they were to do."""

_ON_GPU = 4
"""Workers that share a GPU, if none are asked for: more gain little, and each takes memory there."""

_BATCH, _BATCH_PIXELS = 32, 2**17
"""Most poses that `surfel` renders at once, and most pixels: more gain nothing, but memory and an uneven end."""


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

Pace = Callable[[], int]
"""Is asked, whenever a worker is about to begin a picture, with how many samples."""

Launch = Callable[[Sequence[str]], list[str]]
"""Turns a worker's module and arguments into the command line of a process of its own."""


def python(arguments: Sequence[str]) -> list[str]:
    """Return the command line that runs a worker by this Python.

    Raises
    ------
    NlosError
        It has no bpy.
    """
    if importlib.util.find_spec("bpy") is None:  # does not import it
        raise NlosError(NO_BLENDER)
    return [sys.executable, "-m", *arguments]


def run(
    scene: Path,
    path: Path,
    chosen: Mapping[str, Any],
    *,
    workers: int = 0,
    shard: tuple[int, int] = (0, 1),
    progress: Progress = lambda done, total: None,
    tell: Callable[[str], None] = lambda words: None,
    launch: Launch = python,
    stop: threading.Event | None = None,
    pace: Pace | None = None,
    force: bool = False,
    probe: bool = True,
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
        the scene and the defaults. The engine may be ``auto``: the data set's, or the cheapest that the scene allows.
    workers : int
        Processes; 0 is one per core, or four that share a GPU.
    shard : (int, int)
        ``(i, n)``: render the i-th of n parts only, i from 0.
    progress : callable
    tell : callable
        Is told which engine ``auto`` took, and why; that an engine is being compiled; what the check at the start of
        a new set found, and how long it took.
    launch : callable
        How workers are started.
    stop : threading.Event, optional
        Set by another thread, it ends the run early; what is done stays.
    pace : callable, optional
        Says with how many samples each picture is rendered; without it all take the data set's. Voxels then take
        turns, lest the noise tell them apart.
    force : bool
        Begin a new set in spite of errors that the check finds in the scene.
    probe : bool
        Whether a new set begins with the check of its engine against plain Cycles (`generator.blender.start_check`).

    Raises
    ------
    NlosError
        The input is bad, the check finds an error, or the data set at that path was made with other settings.
    """
    options: dict[str, Any] = {"launch": launch, "stop": stop, "force": force, "probe": probe}
    dataset = begin(scene, path, chosen, shard=shard, tell=tell, **options).dataset
    outcome = Outcome(dataset)
    pending = pending_positions(dataset, shard)
    if pace:
        pending.sort(key=lambda position: dataset.poses[position].index)
    if pending:
        say = (lambda position: f"{position}:{pace()}") if pace else str
        shared = _ON_GPU if dataset.sweep.device == "gpu" else 0
        with _crew(dataset, shard, progress, say=say, launch=launch, stop=stop) as crew:
            crew.work(pending, workers or shared, batch=batch_size(dataset))
        outcome.failed = crew.failed
        outcome.rendered = sum(dataset.poses[position].done for position in pending)  # as gathered from disk
    outcome.remaining = sum(not pose.done for pose in dataset.poses)
    if outcome.rendered and not outcome.remaining:
        dataset.tidy()
    return outcome


def begin(
    scene: Path,
    path: Path,
    chosen: Mapping[str, Any],
    *,
    shard: tuple[int, int] = (0, 1),
    tell: Callable[[str], None] = lambda words: None,
    launch: Launch = python,
    stop: threading.Event | None = None,
    force: bool = False,
    probe: bool = True,
) -> Outcome:
    """Plan a data set and render its background, as far as that is not done; parameters as of `run`."""
    new = not Dataset.exists(path)
    known = chosen.get("engine", spec.AUTO) if new else Dataset.open(path).settings["engine"]
    if words := compiling_words(known):
        tell(words)
    dataset = prepare(scene, path, chosen, launch, force=force, probe=probe, tell=tell)
    if chosen.get("engine", spec.AUTO) == spec.AUTO:
        tell(engine_words(dataset, chosen))
    if new and (words := start_words(dataset)):
        tell(words)
    if not all(dataset.has_background(name) for name in dataset.background_names):
        with _crew(dataset, shard, lambda done, total: None, launch=launch, stop=stop) as crew:
            crew.work([], first="the background")
    return Outcome(dataset, remaining=len(dataset.poses))


@contextlib.contextmanager
def _crew(dataset: Dataset, shard: tuple[int, int], progress: Progress, **options: Any) -> Iterator[Crew]:
    """Give a crew that renders a data set and tells of it; on leaving, gather what it has made."""

    def told(done: int, total: int) -> None:
        journal.told(done, total)
        progress(done, total)

    def command(threads: int) -> list[str]:
        return ["generator.blender.worker", "render", str(dataset.path), str(threads)]

    with journals.logged(dataset.path) as log:
        crew = Crew(command, lambda position: dataset.poses[position].file, told, log=log, **options)
        try:
            with journals.Journal(dataset.path, shard, crew.look) as journal:
                yield crew
        finally:
            mine = range(shard[0], dataset.planned, shard[1])
            gather(dataset, shard, [position for position in mine if not dataset.poses[position].done])


def available_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def clock(seconds: float) -> str:
    """Return a time that is left, as people read it: 1:05 or 2:00:07."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"


def compiling_words(engine: str | None) -> str:
    """Return what to say before an engine's first run, which compiles it; nothing if there is nothing to wait for."""
    newest = max(source.stat().st_mtime for source in caching.sources())
    kept = caching.folder()
    compiled = kept is not None and any(index.stat().st_mtime > newest for index in kept.glob("*/*.nbi"))
    if compiled or engine not in ("surfel", "auto"):
        return ""
    when = "engine surfel" if engine == "surfel" else "engine auto: surfel, if the scene allows it,"
    again = "once" if kept else "by every process, for nothing that it makes can be kept (set NUMBA_CACHE_DIR)"
    return f"{when} is compiled for this machine first, {again}; that takes a minute or so"


def engine_words(dataset: Dataset, chosen: Mapping[str, Any]) -> str:
    """Return which engine renders a data set, what in its scene asked for one so dear, and what is nothing to it."""
    engine, reasons = dataset.settings["engine"], dataset.meta.get("engine_reasons", [])
    words = f"engine: {engine}" + (f", because {'; '.join(reasons)}" if reasons else "")
    idle = [f"--{name}" for name in Sweep.idle(engine) if name in chosen]
    return words + (f"; {' and '.join(idle)} {'mean' if len(idle) > 1 else 'means'} nothing to it" if idle else "")


def start_words(dataset: _Made) -> str:
    """Return what the check at the start found, and how long it took; empty if there was none."""
    return str(dataset.meta.get("start_check", {}).get("words", ""))


def prepare(
    scene: Path,
    path: Path,
    chosen: Mapping[str, Any],
    launch: Launch = python,
    *,
    force: bool = False,
    probe: bool = True,
    tell: Callable[[str], None] = lambda words: None,
) -> Dataset:
    """Return the data set at a path, planned now if there is none, after comparing the settings if there is one."""
    if not Dataset.exists(path):
        if not scene.is_file():
            raise NlosError(f"{scene}: no such scene file")
        check_free(path)
        arguments = ["generator.blender.worker", "plan", str(scene), str(path), json.dumps(dict(chosen))]
        arguments += [] if probe else [NO_PROBE]
        for words in planned_notes(scene, arguments, launch, force=force):
            tell(words)
        return Dataset.open(path)
    dataset = Dataset.open(path)
    check_same(dataset, scene, chosen)
    return dataset


class _Made(Protocol):
    """A set on disk that knows what it was made with."""

    path: Path
    meta: dict[str, Any]

    @property
    def settings(self) -> dict[str, Any]: ...


def check_same(dataset: _Made, scene: Path, chosen: Mapping[str, Any]) -> None:
    """Raise NlosError, naming each difference, if a data set was made from another scene or with other settings.

    Or if files that its scene refers to have changed, or may not be read (`links.check`).
    """
    own = {"device": Sweep.device, "denoise": Sweep.denoise, **dataset.settings}  # older sets knew of no other
    width, height = own["resolution"]
    differences = []
    for name, value in chosen.items():
        if name == "resolution" and isinstance(value, str):
            value = list(spec.parse_resolution(value, width / height))
        if name == "engine" and value == spec.AUTO:
            continue
        if name in Sweep.idle(own["engine"]) and chosen.get("engine", spec.AUTO) != spec.AUTO:
            differences.append(f"{name} means nothing to its engine {own['engine']!r}")
        if name in own and own[name] != value:
            differences.append(f"{name} is {own[name]} there and {value} here")
        elif name == "frames" and name not in own:
            differences.append("its poses lie in voxels, not on a trajectory")
        elif name == "poses" and name not in own:
            differences.append("its poses lie on a trajectory, not in voxels")
    if scene_hash(scene) not in (own.get("scene_sha256"), scene_hash(dataset.path / SCENE)):
        differences.append(f"{scene} is not the scene it was rendered from (or has been saved again since)")
    if differences:
        raise NlosError(
            f"{dataset.path}: holds a sweep with other settings: {'; '.join(differences)}; "
            "use the same settings or another folder"
        )
    links.check(dataset.meta.get("links", {}), dataset.path, scene)


def pending_positions(dataset: Dataset, shard: tuple[int, int] = (0, 1)) -> list[int]:
    """Return which poses of a shard are still to be rendered, judged by the pictures on disk."""
    index, count = shard
    if not 0 <= index < count:
        raise NlosError(f"--shard {index}/{count}: must be i/n with i from 0 to n - 1")
    return gather(dataset, shard, range(index, dataset.planned, count))


def gather(dataset: Dataset, shard: tuple[int, int], own: Sequence[int]) -> list[int]:
    """Bring a manifest up to date, and return which of the share's own poses are still to be rendered.

    A share looks at its own pictures: were each to look at all, a thousand shares would read each a thousand times.
    """
    dataset.gather(own if shard[1] > 1 else None)
    return [position for position in own if not dataset.poses[position].done]


def batch_size(dataset: Dataset) -> int:
    """Return how many poses a worker is given at once at most: `surfel` renders many in less time than one by one."""
    if dataset.settings["engine"] != "surfel":
        return 1
    width, height = dataset.sweep.resolution
    return max(1, min(_BATCH, _BATCH_PIXELS // (width * height)))


def in_batches(units: Sequence[int], size: int) -> list[Sequence[int]]:
    """Return units of work as runs of that size; the last may be shorter."""
    return [units[at : at + size] for at in range(0, len(units), size)]


def planned_notes(
    scene: Path, arguments: Sequence[str], launch: Launch = python, *, force: bool = False
) -> list[str]:
    """Let a worker plan a set, and return what it has to say of the scene."""
    with Worker([*arguments, *([FORCE] if force else [])], launch) as worker:
        if (answer := worker.answer()) is None:
            raise NlosError(f"{scene}: Blender could not plan the set: {worker.last_words()}")
        return [str(words) for words in answer.get("notes", [])]


class Worker:
    """A worker process and the talk with it.

    Parameters
    ----------
    arguments : sequence of str
        Its module and what follows on the command line.
    launch : callable
        How it is started.
    """

    def __init__(self, arguments: Sequence[str], launch: Launch = python) -> None:
        command = launch(arguments)
        self._log = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115 (closed in stop)
        # Blender and renders leave folders there that a process which is killed cannot take away.
        self._scratch = tempfile.TemporaryDirectory(prefix="nlos-worker-", ignore_cleanup_errors=True)
        home = os.pathsep.join(filter(None, [_HOME, os.environ.get("PYTHONPATH")]))
        scratch = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), self._scratch.name)
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,  # Ctrl-C is the coordinator's to handle
            env={**os.environ, **scratch, "PYTHONPATH": home},
        )
        self.pid = self._process.pid
        self.done = 0
        self._since, self._doing = time.monotonic(), "starting"

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self.stop()

    def kill(self) -> None:
        """End the process at once: a picture that is not in place by then was never begun."""
        if self._process.poll() is None:
            self._process.kill()

    def stop(self) -> None:
        """End the process, and the talk with it."""
        self.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._log):
            if stream:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()
        self._scratch.cleanup()

    def begin(self, what: str) -> None:
        """Take note of what the worker does from now on; nothing is waiting."""
        self._since, self._doing = time.monotonic(), what

    def look(self) -> dict[str, Any]:
        """Return what it is doing, and for how long."""
        seconds = round(time.monotonic() - self._since, 1)
        return {"pid": self.pid, "doing": self._doing, "seconds": seconds, "done": self.done}

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

    def send(self, words: str) -> None:
        """Tell the worker which units of work are its next."""
        assert self._process.stdin is not None
        self._process.stdin.write(words + "\n")
        self._process.stdin.flush()

    def last_words(self) -> str:
        """Return the last line the worker wrote to its log, and how it ended."""
        code = self._process.wait()
        self._log.seek(0)
        lines = [line.strip() for line in self._log if line.strip()]
        return f"{lines[-1] if lines else 'it said nothing'} (exit code {code})"


class Crew:
    """Workers side by side, each fed a batch of units of work at a time by a thread of its own.

    Parameters
    ----------
    command : callable
        Returns a worker's module and arguments, given how many threads it may use. The worker says when it is ready,
        takes batches as lines, numbers of units with blanks between, and answers each batch when it is done.
    name : callable
        What a unit is called in a list of failures.
    progress : callable
        Is told how much is done, and of how much.
    size : callable
        How much a unit adds to that.
    say : callable
        What a worker is told of a unit: a word.
    launch : callable
        How workers are started.
    stop : threading.Event, optional
        Set by another thread, it ends the work early.
    log : logging.Logger, optional
        Is told what happens to workers.
    patience : (float, float)
        Seconds after which a worker that says nothing is ended: before any unit is done, and from then on at least,
        where it is `_SLOWER` times the longest that one took.

    Attributes
    ----------
    failed : list of str
        Units that could not be done, each with its reason.
    """

    def __init__(
        self,
        command: Callable[[int], Sequence[str]],
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
        self._command = command
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
        """Do all units.

        Parameters
        ----------
        units : sequence of int
        workers : int
            Processes; 0 is one per core.
        first : str
            What the first worker makes, on all cores, before there is a crew that needs it; empty if there is
            no such thing.
        batch : int
            Most units that a worker is given at once.

        Raises
        ------
        NlosError
            A worker answered with one, which ends the work.
        """
        cores = available_cores()
        crew = max(1, min(workers or cores, len(units)))
        self._total = sum(map(self._size, units))
        self._progress(0, self._total)
        batch = max(1, min(batch, len(units) // (4 * crew)))  # a few for each worker, lest they end far apart
        for some in in_batches(units, batch):
            self._todo.put((some, 1))
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
                for each in self._workers:
                    each.stop()
            self._log.info("%d of %d done, %d failed", self._done, self._total, len(self.failed))
        if self._error:
            raise self._error

    def look(self) -> tuple[list[str], list[dict[str, Any]]]:
        """Return what has failed, and what each worker is doing."""
        with self._lock:
            return list(self.failed), [worker.look() for worker in self._workers]

    def _watch(self) -> None:
        """End the workers at once when all is to stop, and any that has been silent for too long."""
        while not self._stopped.wait(0.2):
            if self._stop.is_set():
                self._stopped.set()
                break
            first, later = self._patience
            limit = max(later, _SLOWER * self._longest) if self._longest else first
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
        """Start a worker, unless all are stopped: nobody would stop one that comes after."""
        with self._lock:
            if self._stopped.is_set():
                return None
            worker = Worker(self._command(threads), self._launch)
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
                    for unit in batch:  # one by one from now on: the others shall not fail with the one that did
                        if attempt < TRIES:
                            self._todo.put(([unit], attempt + 1))
                        else:
                            self.failed.append(f"{self._name(unit)}: {words}")
                            self._log.error("given up after %d tries: %s", TRIES, self.failed[-1])
        except Exception as error:  # bad input, or that nobody reads on; the thread that waits for this one raises it
            self._error = error
            self._stopped.set()

    def _do(self, worker: Worker, batch: Sequence[int]) -> bool:
        """Whether the worker says that it has done the batch; False if it is gone."""
        try:
            worker.send(" ".join(map(self._say, batch)))
            while answer := worker.answer():
                if "ready" not in answer:
                    return True
        except NlosError:
            raise
        except (BrokenPipeError, ValueError):  # its end of the pipe is closed, or ours was by `stop`
            pass
        return False
