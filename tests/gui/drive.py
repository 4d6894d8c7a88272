"""Runs the steps inside Blender: ``blender ... --python drive.py``, started by `run.py`.

One timer runs everything, so that Blender's event loop goes on between the steps and within those that yield.
"""

from __future__ import annotations

import faulthandler
import importlib
import inspect
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))

import helpers

# What waits in an operator that blocks cannot tell; the harness asks by this signal before it ends Blender.
faulthandler.register(signal.SIGUSR1, all_threads=True)


def steps() -> list[tuple[str, Callable[[], object]]]:
    """Return all steps with their names, file by file."""
    found = []
    for path in sorted(helpers.GUI.glob("steps_*.py")):
        for step in importlib.import_module(path.stem).STEPS:
            found.append((f"{path.stem.removeprefix('steps_')} {step.__name__}".replace("_", " "), step))
    return found


def run() -> Iterator[float | None]:
    """Run them; an exception fails its step, and the next one goes on."""
    yield 1.0  # the first window is drawn
    failed = 0
    for name, step in steps():
        helpers.say(f"begin {name}")
        start = time.monotonic()
        try:
            result = step()
            if inspect.isgenerator(result):
                yield from result
            for forgotten in helpers.waiting:
                helpers.check(False, f"'yield from' stands before {forgotten}()")
        except Exception:
            helpers.failures.append("an exception")
            helpers.say(traceback.format_exc())
        if helpers.failures:
            failed += 1
            helpers.say(f"FAILED {name} ({time.monotonic() - start:.1f} s)")
        else:
            helpers.say(f"ok {name} ({time.monotonic() - start:.1f} s)")
        helpers.failures.clear()
        helpers.waiting.clear()
    helpers.say("end")
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender's own way out would ask whether to save.
    os._exit(int(failed > 0))


def tick(running: Iterator[float | None] = run()) -> float:  # noqa: B008 (the one run, on purpose)
    """Go on; return for how many seconds to rest."""
    try:
        return next(running) or 0.05
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(3)


bpy.context.preferences.view.show_splash = False
# A file that a step opens would end a timer that is not persistent.
bpy.app.timers.register(tick, first_interval=0.5, persistent=True)
