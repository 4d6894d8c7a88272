"""Log and state of the runs of a sweep, kept in their data set: the log for people, the state for other processes.

Every run writes a state file of its own, so runs on several machines need no lock.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from generator.files.writing import is_alive, write_text
from generator.jobs import remaining
from generator.model.errors import NlosError
from generator.sets.dataset import Dataset
from generator.sets.manifest import LOG

RUNS = ".runs"
RUNNING, ENDED = "running", "ended"
EVERY = 2.0
"""Seconds between two writes of a state."""
_KEPT = 100
"""Number of runs whose states are kept."""
_FORGOTTEN = 24 * 3600.0
"""Seconds without an update after which a run whose state says that it runs is treated as one that has ended."""
_LOST = 60.0
"""Seconds without an update after which a run on another machine is called lost."""


_BROKEN = (ValueError, TypeError, KeyError, RecursionError)
"""Exceptions that are raised when a file that holds no state is read."""


@dataclass
class State:
    """State of a run.

    Attributes
    ----------
    host, pid : str, int
        Machine and process that it runs in.
    shard : str
        ``i/n``.
    state : str
        `RUNNING` or `ENDED`.
    done, total : int
        Pictures of this run.
    seconds : float
        Time since it began.
    first, first_seconds : int, float
        Number of pictures when any were done for the first time, and the time of that.
    failed : list of str
        Poses that could not be rendered, each with its reason.
    workers : list of dict
        For each its ``pid``, what it is ``doing`` and for how many ``seconds``, how many units it has ``done``, and
        its ``memory`` in bytes.
    """

    host: str
    pid: int
    shard: str = "0/1"
    state: str = RUNNING
    done: int = 0
    total: int = 0
    seconds: float = 0.0
    first: int = 0
    first_seconds: float = 0.0
    failed: list[str] = field(default_factory=list)
    workers: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def read(cls, text: str) -> State:
        """Return the state that a run has written; ValueError, TypeError or KeyError if the text is no state."""
        state = cls(**json.loads(text))
        texts = [state.host, state.shard, state.state, *state.failed, *(worker["doing"] for worker in state.workers)]
        counts = [state.pid, state.done, state.total, state.seconds, state.first, state.first_seconds]
        counts += [worker[name] for worker in state.workers for name in ("pid", "seconds", "done", "memory")]
        if not all(isinstance(text, str) for text in texts) or not all(0 <= count < 1e15 for count in counts):
            raise ValueError("is no run's state")
        return state

    @property
    def rate(self) -> float:
        """Pictures per second; 0 while there is no estimate."""
        if self.state != RUNNING:
            return self.done / self.seconds if self.seconds > 0.0 else 0.0
        return remaining.rate(self.done, self.seconds, self.first, self.first_seconds)


class Journal:
    """Keeps the state of one run.

    Parameters
    ----------
    path : Path
        Folder of the data set.
    shard : (int, int)
    look : callable
        Returns the failures and the workers, as `State` has them.
    """

    def __init__(
        self, path: Path, shard: tuple[int, int], look: Callable[[], tuple[list[str], list[dict[str, Any]]]]
    ) -> None:
        self.state = State(socket.gethostname(), os.getpid(), f"{shard[0]}/{shard[1]}")
        self._file = path / RUNS / f"{self.state.host}-{self.state.pid}.json"
        self._look = look
        self._begun = time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._keep, daemon=True)

    def __enter__(self) -> Journal:
        self._write()
        _forget(self._file.parent)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self.state.state = ENDED
        with contextlib.suppress(NlosError):  # it must not hide the error that ended the run
            self._write()

    def told(self, done: int, total: int) -> None:
        """Record the progress of the run."""
        self.state.done, self.state.total = done, total
        if done and not self.state.first:
            self.state.first, self.state.first_seconds = done, round(time.monotonic() - self._begun, 3)

    def _keep(self) -> None:
        while not self._over.wait(EVERY):
            with contextlib.suppress(NlosError):  # those who write pictures report a full disk
                self._write()

    def _write(self) -> None:
        self.state.seconds = round(time.monotonic() - self._begun, 1)
        self.state.failed, workers = self._look()
        self.state.workers = [{**worker, "memory": memory(worker["pid"])} for worker in workers]
        write_text(self._file, json.dumps(asdict(self.state), indent=1) + "\n")


def _forget(folder: Path) -> None:
    """Remove the states of all but the latest runs; a run that goes on would write its file again within seconds.

    Machines' clocks differ, so ages are differences between modification times, which one file server sets.
    """
    dated_files = []
    for file in folder.glob("*.json"):
        with contextlib.suppress(OSError):  # another machine removes states too
            dated_files.append((file.stat().st_mtime, file))
    dated_files.sort()
    for modified, file in dated_files[:-_KEPT]:
        with contextlib.suppress(OSError, *_BROKEN):
            running = State.read(file.read_text(encoding="utf-8")).state == RUNNING
            if running and dated_files[-1][0] - modified < _FORGOTTEN:
                continue
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)


def memory(pid: int) -> int:
    """Return the bytes that a process has in memory; 0 if that is unknown."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


class _Appender(logging.Handler):
    """Opens the file for every line: several machines may append to it, and none keeps the file or its disk busy."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self._file = file

    def emit(self, record: logging.LogRecord) -> None:
        """Append a line."""
        # Those who write pictures report a full disk.
        with contextlib.suppress(OSError), open(self._file, "a", encoding="utf-8") as file:
            file.write(self.format(record) + "\n")


@contextlib.contextmanager
def logged(path: Path) -> Iterator[logging.Logger]:
    """Yield a logger that writes to the data set's log."""
    log = logging.getLogger(f"nlos.{path}")
    log.setLevel(logging.INFO)
    log.propagate = False
    handler = _Appender(path / LOG)
    line_format = f"%(asctime)s {socket.gethostname()} {os.getpid()} %(levelname)s %(message)s"
    handler.setFormatter(logging.Formatter(line_format))
    log.addHandler(handler)
    try:
        yield log
    finally:
        log.removeHandler(handler)


def read(path: Path) -> dict[str, Any]:
    """Return how far a data set is, and what runs of it are doing.

    Returns
    -------
    dict
        ``planned``, ``done`` and ``failed`` of the set (a picture is done if its file exists; `Dataset.verify` reads
        the files), ``rate`` in pictures per second of all active runs, ``seconds_left`` (None if none is active), and
        ``runs``, a list of `State` as dicts, with ``heard``, the seconds since each wrote its state.

    Raises
    ------
    NlosError
        There is no data set.
    """
    dataset = Dataset.open(path, check=False)  # called again and again while a set is being made
    done = sum((path / pose.file).is_file() for pose in dataset.poses)
    runs = []
    for file in sorted((path / RUNS).glob("*.json")):
        with contextlib.suppress(OSError, *_BROKEN):
            state = State.read(file.read_text(encoding="utf-8"))
            heard = max(0.0, time.time() - file.stat().st_mtime)
            if state.state == RUNNING and not _alive(state, heard):
                state.state = "lost"
            runs.append({**asdict(state), "rate": round(state.rate, 4), "heard": round(heard, 1)})
    alive = [run for run in runs if run["state"] == RUNNING]
    rate = sum(run["rate"] for run in alive)
    left = sum(run["total"] - run["done"] for run in alive)
    failed = sorted({name for run in runs for name in run["failed"] if not (path / name.split(": ")[0]).is_file()})
    return {
        "path": str(path),
        "planned": dataset.planned,
        "done": done,
        "failed": failed,
        "rate": round(rate, 4),
        "seconds_left": round(left / rate, 1) if rate else None,
        "runs": runs,
    }


def words(found: Mapping[str, Any]) -> list[str]:
    """Return the result of `read` as lines of text for a person."""
    from generator.model.quantities import clock

    lines = [f"{found['path']}: {found['done']} of {found['planned']} pictures"]
    if found["seconds_left"] is not None:
        lines[0] += f", {found['rate']:.3g} a second, about {clock(found['seconds_left'])} left"
    for run in found["runs"]:
        heard = f", last heard of {clock(run['heard'])} ago" if run["state"] == "lost" else ""
        shard = "" if run["shard"] == "0/1" else f", shard {run['shard']}"
        lines.append(
            f"run {run['pid']} on {run['host']}{shard}: {run['state']}{heard}, {run['done']} of {run['total']} in "
            f"{clock(run['seconds'])}"
        )
        if run["state"] == RUNNING:
            lines += [
                f"  worker {worker['pid']}: {worker['doing'] or 'idle'}, {worker['seconds']:.0f} s; {worker['done']} "
                f"done, {worker['memory'] / 2**20:.0f} MiB"
                for worker in run["workers"]
            ]
    return [*lines, *(f"failed: {name}" for name in found["failed"])]


def _alive(state: State, heard: float) -> bool:
    return is_alive(state.pid) if state.host == socket.gethostname() else heard < _LOST
