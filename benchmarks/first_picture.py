"""Measure the first picture where nothing is compiled: processor time, and what each compiled function takes.

Run: ``python benchmarks/first_picture.py -o DIR``. Each case is a process of its own with an empty cache, and one
more that finds the cache filled. Times are the processor's, so that other work on the machine hardly changes them. A
function's time leaves out the functions that are compiled on the way; LLVM's is that of its passes and its machine
code, with what is on the way to them (`numba.core.codegen`). "One product" is numba alone, for a function that
multiplies.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import results

from generator.model.quantities import ALL_ORDERS

RESULTS = {
    "first-picture": ("picture", "functions", "processor, s", "of it compiling, s", "of it LLVM, s", "again, s")
}

CASES = {
    "one product": None,
    "no room": (False, 3),
    "room": (True, 3),
    "room, all reflections": (True, ALL_ORDERS),
}


class _Exclusive:
    """Processor time by name, without that of what is nested."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self._nested: list[float] = []
        self._starts: list[float] = []

    def begin(self) -> None:
        self._starts.append(time.process_time())
        self._nested.append(0.0)

    def end(self, name: str) -> None:
        taken = time.process_time() - self._starts.pop()
        self.seconds[name] += taken - self._nested.pop()
        if self._nested:
            self._nested[-1] += taken

    def around(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        """Return a function whose time is counted."""

        def timed(*arguments: Any, **options: Any) -> Any:
            self.begin()
            try:
                return function(*arguments, **options)
            finally:
                self.end(name)

        return timed


def child(case: str) -> dict[str, Any]:
    """Render the picture of a case, and return what that took."""
    import numba
    from numba.core import codegen, event

    functions, llvm = _Exclusive(), _Exclusive()

    class Listener(event.Listener):  # type: ignore[misc]
        """Counts what compiling each function takes."""

        def on_start(self, event: Any) -> None:
            functions.begin()

        def on_end(self, event: Any) -> None:
            function = event.data["dispatcher"].py_func
            functions.end(f"{function.__module__}.{function.__qualname__}")

    event.register("numba:compile", Listener())
    library = codegen.CPUCodeLibrary
    for name in ("add_ir_module", "finalize"):
        setattr(library, name, llvm.around(getattr(library, name), name))
    if CASES[case] is None:
        numba.njit(cache=True)(_product)(2.0)
    else:
        _render(*CASES[case])
    return {
        "processor": time.process_time(),
        "functions": functions.seconds,
        "llvm": llvm.seconds.total(),
    }


def _render(has_room: bool, order: int) -> None:
    import numpy as np
    import scenes

    from generator.model.presets import preset
    from generator.transport import Mesh, Transport

    scene = replace(preset("room"), resolution=(64, 64))
    world, place = scenes.world_from_spec(scene), (np.array(scene.grid.lo) + scene.grid.hi) / 2.0
    # The relay wall, as wide and high as the room.
    low, high = np.array([-2.4, 0.0, 0.0]), np.array([2.6, 0.0, 2.6])
    corners = [low, np.where([1, 0, 0], high, low), high, np.where([0, 0, 1], high, low)]
    wall = Mesh(np.array([[corners[k] for k in half] for half in ((0, 1, 2), (0, 2, 3))]), np.full((2, 3), 0.8))
    world = replace(world, order=order, wall=wall, room=world.room if has_room else ())
    Transport(world, accuracy=1e-2).render(place, (0.0, 0.0, 30.0))


def _product(x: float) -> float:
    return 2.0 * x


def measured(case: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what `child` returns in a process with an empty cache, and in one after it."""
    with tempfile.TemporaryDirectory() as cache:
        command = [sys.executable, str(Path(__file__).resolve()), "--child", case, "-o", cache]
        once, again = (
            json.loads(
                subprocess.run(
                    command,
                    env={**os.environ, "NUMBA_CACHE_DIR": cache},
                    check=True,
                    stdout=subprocess.PIPE,
                ).stdout
            )
            for _ in range(2)
        )
    return once, again


def main() -> None:
    """Print the functions of each case, the longest first, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the table")
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--child", choices=list(CASES), help="render a case in this process, print figures")
    options = parser.parse_args()
    if options.child:
        print(json.dumps(child(options.child)))
        return
    table = []
    for case in options.cases:
        once, again = measured(case)
        functions = Counter(once["functions"])
        compiling = functions.total()
        for name, seconds in functions.most_common():
            print(f"{seconds:8.2f} s  {name}")
        row = (once["processor"], compiling, once["llvm"], again["processor"])
        table.append((case, len(functions), *(f"{seconds:.1f}" for seconds in row)))
        print(" | ".join(map(str, table[-1])), flush=True)
    results.write(options.output, "first-picture", RESULTS["first-picture"], table)


if __name__ == "__main__":
    main()
