"""Where the seconds of a sweep go, stage by stage: 900 poses at 64 x 64 by surfel, and the same by `patch`.

Run: ``python benchmarks/sweep_stages.py -o DIR`` (some minutes). Each sweep is the command line's own, in a process
of its own, of the room preset with its sheet, with as many workers as there are cores. The package is copied to DIR
first, so the first sweep finds no compiled code; the sweeps after it find what it left. `patch` renders with the
default samples, 9 and then 27 poses: the time of as many as surfel makes follows from what one more pose takes.

The stages are timed from outside: named functions of the product are wrapped, in the coordinator and in its workers,
and the time of a function is its own, without that of the wrapped functions that it calls. What a stage adds to the
whole is its time in the coordinator, in the worker that plans and in the one that comes first (where the background
needs a worker to itself), and its mean over the workers that run side by side.
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

LOGS, STARTED = "NLOS_STAGES_LOGS", "NLOS_STAGES_STARTED"
"""Environment: where a worker tells its times, and when it was started."""

START, WAIT, REST = "start the process and import", "talk and wait for work", "rest of Python"
OTHERS, IDLE = "(wait for other threads)", "(nothing)"
THREADED = ("render poses", "background")
"""Stages that wait for threads of their own."""
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
    "render poses": ["generator.transport:Transport.pictures", "generator.blender.engines.cycles:Renderer.render"],
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
    """What a thread is at, from the inside out, and since when."""

    def __init__(self) -> None:
        self.main = threading.current_thread() is threading.main_thread()
        self.stack = [REST if self.main else IDLE]
        self.last = time.perf_counter()


class Clock:
    """Own time of nested stages: what runs inside another stage counts for that one alone.

    Time that the main thread waits for others is shared among the stages in proportion to what those spent on them.
    """

    def __init__(self) -> None:
        self._seconds: dict[bool, dict[str, float]] = {True: defaultdict(float), False: defaultdict(float)}
        self._lock = threading.Lock()
        self._thread = _Thread()

    def turn(self) -> None:
        """Count what has passed for the stage at hand."""
        thread, now = self._thread, time.perf_counter()
        with self._lock:
            self._seconds[thread.main][thread.stack[-1]] += now - thread.last
        thread.last = now

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what is done inside for a stage."""
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
            spent, aside = dict(self._seconds[True]), dict(self._seconds[False])
        aside.pop(IDLE, None)
        waited = spent.pop(OTHERS, 0.0) / (sum(aside.values()) or 1.0)
        return {name: spent.get(name, 0.0) + waited * aside.get(name, 0.0) for name in spent.keys() | aside.keys()}

    def wrap(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function, its time counted for a stage."""

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
                    continue  # the coordinator knows neither Blender nor numba
                *owners, last = path.split(".")
                owner: Any = importlib.import_module(module)
                for step in owners:
                    owner = getattr(owner, step)
                function = getattr(owner, last)
                timed = self.wrap(name, function)
                setattr(owner, last, timed)
                for other in [m for key, m in sys.modules.items() if key.startswith("generator.")]:
                    for key in [k for k, v in vars(other).items() if v is function]:
                        setattr(other, key, timed)


def as_worker(arguments: list[str]) -> int:
    """Be a worker that tells in a file where its time went: before each answer, for it may be ended after any."""
    began, clock = time.time(), Clock()
    with clock.stage(START):
        from generator.blender import worker
        from generator.jobs.protocol import PlanSweep, answer, batches, read_request
    before = began - float(os.environ[STARTED])
    write_text, role = Path.write_text, "plan" if isinstance(read_request(arguments[0]), PlanSweep) else "first"
    clock.watch()

    def answered(**fields: Any) -> None:
        told = {"role": role, "generator": worker.__file__, "before": before, "seconds": clock.told()}
        write_text(Path(os.environ[LOGS], f"{os.getpid()}.json"), json.dumps(told))
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
    """Run the command line, its workers replaced by those that tell their times."""
    began, clock = time.time(), Clock()
    with clock.stage(START):
        from generator.cli import main as cli
        from generator.jobs import local
        from generator.jobs.workers import WorkerPool
    before = began - float(os.environ[STARTED])
    write_text, start = Path.write_text, subprocess.Popen
    clock.watch()

    def started(command: list[str], **options: Any) -> Any:
        own = [command[0], __file__, "--as-worker", *command[3:]]  # python -m generator.blender.worker ...
        options["env"] = {**options["env"], STARTED: repr(time.time())}
        return start(own, **options)

    subprocess.Popen = started  # type: ignore[misc,assignment]
    local.planned_notes = clock.wrap("(workers)", local.planned_notes)  # type: ignore[attr-defined]
    WorkerPool.work = clock.wrap("(workers)", WorkerPool.work)  # type: ignore[method-assign]
    code = int(cli.main(arguments))
    told = {"role": "coordinator", "generator": local.__file__, "before": before, "seconds": clock.told()}
    write_text(Path(os.environ[LOGS], "coordinator.json"), json.dumps(told))
    return code


def sweep(home: Path, name: str, *options: str) -> tuple[float, list[dict[str, Any]]]:
    """Run one sweep with the package at ``home``; return its wall clock and what each process tells."""
    logs, made = home / f"logs-{name}", home / name
    for folder in (logs, made):
        shutil.rmtree(folder, ignore_errors=True)
    logs.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(home), LOGS: str(logs), STARTED: repr(time.time())}
    command = ["sweep", str(home / "room.blend"), "-o", str(made), *options]
    began = time.perf_counter()
    subprocess.run(
        [sys.executable, str(Path(__file__).resolve()), "--as-coordinator", *command],
        env=environment,
        cwd=home,
        check=True,
        stdout=subprocess.DEVNULL,
    )
    wall = time.perf_counter() - began
    told = [json.loads(log.read_text()) for log in logs.glob("*.json")]
    strangers = {log["generator"] for log in told if not Path(log["generator"]).is_relative_to(home)}
    assert not strangers, f"another generator was measured: {strangers}"
    return wall, told


def table(wall: float, told: list[dict[str, Any]], poses: int) -> str:
    """Return the stages of a sweep as text."""
    roles = ("coordinator", "plan", "first", "crew")
    crew = max(1, sum(log["role"] == "crew" for log in told))
    seconds: dict[str, dict[str, float]] = {s: dict.fromkeys(roles, 0.0) for s in STAGES if s != OTHERS}
    for log in told:
        for stage, spent in [(START, log["before"]), *log["seconds"].items()]:
            if stage in seconds:  # what the coordinator waits for is in its workers' own times
                seconds[stage][log["role"]] += spent / (crew if log["role"] == "crew" else 1)
    lines = [
        "".join([f"{'seconds':36s}", *(f"{role:>12s}" for role in roles), f"{'all':>9s}{'ms/pose':>9s}{'share':>7s}"])
    ]
    known = 0.0
    for stage, by_role in seconds.items():
        whole = sum(by_role.values())
        known += whole
        columns = "".join(f"{by_role[role]:12.2f}" for role in roles)
        lines.append(f"{stage:36s}{columns}{whole:9.2f}{1e3 * whole / poses:9.3f}{whole / wall:7.0%}")
    for stage, whole in (("ends of processes, uneven workers", wall - known), ("wall clock", wall)):
        lines.append(f"{stage:36s}{'':48s}{whole:9.2f}{1e3 * whole / poses:9.3f}{whole / wall:7.0%}")
    return "\n".join(lines) + f"\n(crew: mean of {crew} workers)"


def main() -> int:
    """Measure and print."""
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
    print(f"nothing compiled yet:\n{table(*cold, poses)}\n", flush=True)
    wall, told = min((sweep(home, f"warm-{k}", *surfel) for k in range(options.runs)), key=lambda run: run[0])
    print(f"compiled before, quickest of {options.runs}:\n{table(wall, told, poses)}\n", flush=True)
    if options.no_patch:
        return 0
    few, more = (
        sweep(home, f"patch-{n}", "--engine", "patch", "--resolution", "64", "--poses", str(n))[0] for n in (1, 3)
    )
    each = (more - few) / 18
    scaled = few + (poses - 9) * each
    print(f"patch, default samples: 9 poses {few:.1f} s, 27 poses {more:.1f} s: {each:.2f} s for each more")
    print(f"patch, {poses} poses at that rate: {scaled:.0f} s; surfel is {scaled / wall:.0f} times as fast, all told")
    print(f"({scaled / cold[0]:.1f} times where nothing is compiled yet)")
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--as-worker"]:
        sys.exit(as_worker(sys.argv[2:]))
    if sys.argv[1:2] == ["--as-coordinator"]:
        sys.exit(as_coordinator(sys.argv[2:]))
    sys.exit(main())
