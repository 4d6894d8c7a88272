"""Time that each stage of a sweep takes: 900 poses at 64 x 64 by surfel, and the same by `patch`.

Run: ``python benchmarks/sweep_stages.py -o DIR`` (some minutes). Each sweep runs the command line in a separate
process, on the room preset with its sheet, with as many workers as there are cores. The package is copied to DIR
first, so that the first sweep finds no compiled code; later sweeps find what it left. `patch` renders 9 and then 27
poses with the default samples: its time for as many poses as surfel renders follows from the time of one more pose.

The stages are timed from outside: named functions of the product are wrapped, in the coordinator and in its workers,
and the time of a function excludes that of the wrapped functions that it calls. A stage's part of the whole is its
time in the coordinator, in the worker that plans and in the first worker (where the background needs a worker to
itself), plus its mean over the workers that run in parallel.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

RESULTS = {"sweep-stages": ("stage", "seconds", "share")}
LOGS, STARTED = "NLOS_STAGES_LOGS", "NLOS_STAGES_STARTED"
"""Environment variables: folder in which a worker writes its times, and time when it was started."""

START, WAIT, REST = "start the process and import", "talk and wait for work", "rest of Python"
OTHERS, IDLE = "(wait for other threads)", "(nothing)"
THREADED = ("render poses", "background")
"""Stages that wait for threads which they started."""
STAGES = {
    START: [],
    "Blender: open, read, save the scene": [
        *(
            "generator.blender.scene.blend_file:open_file",
            "generator.blender.scene.blend_file:save_file",
            "generator.blender.scene.description:read_scene",
            "generator.blender.scene.geometry:hull",
        ),
        *(
            "generator.blender.scene.clearance:clearance",
            "generator.blender.engines.cycles:linear_output",
            "generator.blender.engines.cycles:plain_cycles",
        ),
    ],
    "extract the world": [
        "generator.blender.engines.survey:surfel_world",
        "generator.blender.engines.survey:world",
    ],
    "compile, or load what is compiled": ["numba.core.dispatcher:Dispatcher.compile"],
    "set up the engine": ["generator.transport:Transport.__init__"],
    "background": ["generator.blender.sweep_worker:_background"],
    "draw poses": ["generator.model.poses:plan"],
    "render poses": [
        "generator.transport:Transport.pictures",
        "generator.blender.engines.cycles:CyclesRenderer.render",
    ],
    "check pixels, encode EXR": ["generator.files.pictures:write_picture", "generator.files.exr:write"],
    "hash": ["generator.files.pictures:pixel_hash", "generator.sets.manifest:scene_hash"],
    "write and rename": [
        *("pathlib:Path.write_bytes", "pathlib:Path.write_text", "pathlib:Path.mkdir", "pathlib:Path.unlink"),
        *("pathlib:Path.is_dir", "os:replace"),
    ],
    "fsync": ["os:fsync"],
    "gather: read pictures, poses.csv": [
        *("generator.sets.dataset:Dataset.gather", "generator.sets.dataset:Dataset.write_manifest"),
        *(
            "generator.sets.manifest:read_poses",
            "generator.files.pictures:read_picture",
            "generator.sets.dataset:read_toml",
        ),
    ],
    WAIT: ["generator.jobs.protocol:answer"],
    REST: ["generator.sets.dataset:Dataset.write_pose"],
    OTHERS: ["concurrent.futures:Future.result"],
}


class _Thread(threading.local):
    """Nested stages that a thread is in, innermost last, and the time up to which they are counted."""

    def __init__(self) -> None:
        self.main = threading.current_thread() is threading.main_thread()
        self.stack = [REST if self.main else IDLE]
        self.last = time.perf_counter()


class Clock:
    """Exclusive time of nested stages: time inside an inner stage counts for the inner stage alone.

    Time that the main thread waits for others is shared among stages in proportion to the others' time in them.
    """

    def __init__(self) -> None:
        self._seconds: dict[bool, dict[str, float]] = {True: defaultdict(float), False: defaultdict(float)}
        self._lock = threading.Lock()
        self._thread = _Thread()

    def turn(self) -> None:
        """Count the time since the last call for the current stage."""
        thread, now = self._thread, time.perf_counter()
        with self._lock:
            self._seconds[thread.main][thread.stack[-1]] += now - thread.last
        thread.last = now

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time inside the context for a stage."""
        self.turn()
        self._thread.stack.append(name)
        try:
            yield
        finally:
            self.turn()
            self._thread.stack.pop()

    def told(self) -> dict[str, float]:
        """Return the main thread's seconds by stage."""
        self.turn()
        with self._lock:
            spent, others = dict(self._seconds[True]), dict(self._seconds[False])
        others.pop(IDLE, None)
        waited = spent.pop(OTHERS, 0.0) / (sum(others.values()) or 1.0)
        return {name: spent.get(name, 0.0) + waited * others.get(name, 0.0) for name in spent.keys() | others.keys()}

    def wrap(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function, wrapped so that its time counts for a stage."""

        def timed(*arguments: Any, **options: Any) -> Any:
            if name == OTHERS and self._thread.stack[-1] in THREADED:
                return function(*arguments, **options)
            with self.stage(name):
                return function(*arguments, **options)

        return timed

    def watch(self) -> None:
        """Wrap the stages' functions that have been imported, under every name that the product has for them."""
        for name, targets in STAGES.items():
            for target in targets:
                module, path = target.split(":")
                if module not in sys.modules:
                    continue  # the coordinator imports neither Blender nor numba
                *owners, attribute = path.split(".")
                owner: Any = importlib.import_module(module)
                for step in owners:
                    owner = getattr(owner, step)
                function = getattr(owner, attribute)
                timed = self.wrap(name, function)
                setattr(owner, attribute, timed)
                for importer in [m for key, m in sys.modules.items() if key.startswith("generator.")]:
                    for key in [k for k, v in vars(importer).items() if v is function]:
                        setattr(importer, key, timed)


def as_worker(arguments: list[str]) -> int:
    """Run a worker that writes its times to a file before each answer, since it may be ended after any answer."""
    began, clock = time.time(), Clock()
    with clock.stage(START):
        from generator.blender import worker
        from generator.jobs.protocol import PlanSweep, answer, batches, read_request
    before = began - float(os.environ[STARTED])
    write_text, role = Path.write_text, "plan" if isinstance(read_request(arguments[0]), PlanSweep) else "first"
    clock.watch()

    def answered(**fields: Any) -> None:
        log = {"role": role, "generator": worker.__file__, "before": before, "seconds": clock.told()}
        write_text(Path(os.environ[LOGS], f"{os.getpid()}.json"), json.dumps(log))
        answer(**fields)

    def given() -> Iterator[Any]:
        nonlocal role
        numbers = iter(batches())
        while True:
            with clock.stage(WAIT):
                number = next(numbers, None)
            if number is None:
                return
            role = "crew"
            yield number

    worker.answer, worker.batches = answered, given  # type: ignore[attr-defined]
    return int(worker.main(arguments))


def as_coordinator(arguments: list[str]) -> int:
    """Run the command line, with its workers replaced by ones that write their times."""
    began, clock = time.time(), Clock()
    with clock.stage(START):
        from generator.cli import main as cli
        from generator.jobs import local
        from generator.jobs.workers import WorkerPool
    before = began - float(os.environ[STARTED])
    write_text, start = Path.write_text, subprocess.Popen
    clock.watch()

    def started(command: list[str], **options: Any) -> Any:
        worker_command = [command[0], __file__, "--as-worker", *command[3:]]  # python -m generator.blender.worker ...
        options["env"] = {**options["env"], STARTED: repr(time.time())}
        return start(worker_command, **options)

    subprocess.Popen = started  # type: ignore[misc,assignment]
    local.planned_notes = clock.wrap("(workers)", local.planned_notes)  # type: ignore[attr-defined]
    WorkerPool.work = clock.wrap("(workers)", WorkerPool.work)  # type: ignore[method-assign]
    code = int(cli.main(arguments))
    log = {"role": "coordinator", "generator": local.__file__, "before": before, "seconds": clock.told()}
    write_text(Path(os.environ[LOGS], "coordinator.json"), json.dumps(log))
    return code


def sweep(home: Path, name: str, *options: str) -> tuple[float, list[dict[str, Any]]]:
    """Run one sweep with the package at ``home``; return its wall-clock time and the log of each process."""
    logs, dataset = home / f"logs-{name}", home / name
    for folder in (logs, dataset):
        shutil.rmtree(folder, ignore_errors=True)
    logs.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(home), LOGS: str(logs), STARTED: repr(time.time())}
    command = ["sweep", str(home / "room.blend"), "-o", str(dataset), *options]
    began = time.perf_counter()
    subprocess.run(
        [sys.executable, str(Path(__file__).resolve()), "--as-coordinator", *command],
        env=environment,
        cwd=home,
        check=True,
        stdout=subprocess.DEVNULL,
    )
    wall = time.perf_counter() - began
    process_logs = [json.loads(log.read_text()) for log in logs.glob("*.json")]
    foreign = {log["generator"] for log in process_logs if not Path(log["generator"]).is_relative_to(home)}
    assert not foreign, f"another generator was measured: {foreign}"
    return wall, process_logs


def table(wall: float, told: list[dict[str, Any]], poses: int) -> tuple[str, list[tuple[str, ...]]]:
    """Return the stages of a sweep as text, and the columns of `RESULTS`."""
    roles = ("coordinator", "plan", "first", "crew")
    crew = max(1, sum(log["role"] == "crew" for log in told))
    seconds: dict[str, dict[str, float]] = {s: dict.fromkeys(roles, 0.0) for s in STAGES if s != OTHERS}
    for log in told:
        for stage, spent in [(START, log["before"]), *log["seconds"].items()]:
            if stage in seconds:  # the coordinator's waiting is contained in the times of its workers
                seconds[stage][log["role"]] += spent / (crew if log["role"] == "crew" else 1)
    lines = [
        "".join([f"{'seconds':36s}", *(f"{role:>12s}" for role in roles), f"{'all':>9s}{'ms/pose':>9s}{'share':>7s}"])
    ]
    known, rows = 0.0, []
    for stage, by_role in seconds.items():
        total = sum(by_role.values())
        known += total
        columns = "".join(f"{by_role[role]:12.2f}" for role in roles)
        rows.append((stage, f"{total:.2f}", f"{100.0 * total / wall:.0f} %"))
        lines.append(f"{stage:36s}{columns}{total:9.2f}{1e3 * total / poses:9.3f}{total / wall:7.0%}")
    for stage, total in (("ends of processes, uneven workers", wall - known), ("wall clock", wall)):
        rows.append((stage, f"{total:.2f}", f"{100.0 * total / wall:.0f} %"))
        lines.append(f"{stage:36s}{'':48s}{total:9.2f}{1e3 * total / poses:9.3f}{total / wall:7.0%}")
    return "\n".join(lines) + f"\n(crew: mean of {crew} workers)", rows


def main() -> int:
    """Measure the stages, print the tables, and write that of compiled code."""
    import results  # here: the processes that are timed run this file too

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--poses-per-voxel", type=int, default=100)
    parser.add_argument("--accuracy", default="1e-2")
    parser.add_argument("--runs", type=int, default=3, help="sweeps with compiled code (default: 3)")
    parser.add_argument("--no-patch", action="store_true", help="surfel only")
    options = parser.parse_args()
    home: Path = options.output.resolve()
    home.mkdir(parents=True, exist_ok=True)
    source = Path(__file__).resolve().parents[1] / "generator"
    shutil.rmtree(home / "generator", ignore_errors=True)
    shutil.copytree(source, home / "generator", ignore=shutil.ignore_patterns("__pycache__"))
    build = [sys.executable, "-m", "generator.cli", "scene", "room", "-o", "room.blend"]
    subprocess.run(build, cwd=home, env={**os.environ, "PYTHONPATH": str(home)}, check=True)

    poses = 9 * options.poses_per_voxel
    many = ("--resolution", "64", "--poses", str(options.poses_per_voxel))
    surfel = ("--engine", "surfel", "--accuracy", options.accuracy, *many)
    print(f"surfel, {poses} poses, 64 x 64, accuracy {options.accuracy}; load {os.getloadavg()[0]:.1f}\n")
    cold = sweep(home, "cold", *surfel)
    print(f"nothing compiled yet:\n{table(*cold, poses)[0]}\n", flush=True)
    wall, process_logs = min((sweep(home, f"warm-{k}", *surfel) for k in range(options.runs)), key=lambda run: run[0])
    text, rows = table(wall, process_logs, poses)
    print(f"compiled before, quickest of {options.runs}:\n{text}\n", flush=True)
    results.write(home, "sweep-stages", RESULTS["sweep-stages"], rows)
    if options.no_patch:
        return 0
    few, more = (
        sweep(home, f"patch-{n}", "--engine", "patch", "--resolution", "64", "--poses", str(n))[0] for n in (1, 3)
    )
    per_pose = (more - few) / 18
    scaled = few + (poses - 9) * per_pose
    print(f"patch, default samples: 9 poses {few:.1f} s, 27 poses {more:.1f} s: {per_pose:.2f} s for each more")
    print(f"patch, {poses} poses at that rate: {scaled:.0f} s; surfel is {scaled / wall:.0f} times as fast, all told")
    print(f"({scaled / cold[0]:.1f} times where nothing is compiled yet)")
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--as-worker"]:
        sys.exit(as_worker(sys.argv[2:]))
    if sys.argv[1:2] == ["--as-coordinator"]:
        sys.exit(as_coordinator(sys.argv[2:]))
    sys.exit(main())
