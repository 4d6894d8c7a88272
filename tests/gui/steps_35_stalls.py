"""How long the live look keeps Blender's window, and how soon it shows what was asked for."""

from __future__ import annotations

import time

import bpy
import numpy as np
from helpers import call, check, module, say, until, view3d

PLACES = ((1.55, 1.15, 1.3), (1.2, 1.6, 1.0), (1.9, 1.5, 1.3), (0.93, 1.99, 0.79))
"""Where the target stands in the room: shadows of its screen, its corner and its far end."""
LONGEST = 0.05
"""Seconds that no step of the extension may hold the window for."""


def told(seconds):
    worst, tail = 1e3 * max(seconds), 1e3 * float(np.quantile(seconds, 0.99))
    return f"{len(seconds)} steps, 99th percentile {tail:.0f} ms, longest {worst:.0f} ms"


def places():
    """From the move to the picture with all shadows."""
    looking, roles = module("view.live"), module("generator.blender.scene.roles")
    session = bpy.context.window_manager.nlos
    session.look = True
    bpy.context.scene.nlos.look_shadows = True
    yield from until(lambda: looking.words() and not looking.waits(), "the first picture is whole", 120.0)
    target = roles.find(bpy.context.scene, "target")
    before = tuple(target.location)
    target.location = (1.0, 0.8, 1.3)  # or it might stand at the first of them already
    yield 2.0
    for place in PLACES:
        done = len(looking.whole()[1])
        target.location = place
        yield 0.02
        yield from until(lambda done=done: len(looking.whole()[1]) > done, "the picture is whole", 60.0)
        shadowed, whole = (1e3 * times[-1] for times in looking.whole())
        say(f"from the move to the picture with shadows at {place}: {shadowed:.0f} ms; to 1 %: {whole:.0f} ms")
    target.location = before
    yield 0.5


def minutes():
    """Moves, undo and rebuilds: no step of the look holds the window for long."""
    looking, roles = module("view.live"), module("generator.blender.scene.roles")
    looking.stalls(clear=True)
    end = time.monotonic() + 60.0
    rng, moves = np.random.default_rng(0), 0
    while time.monotonic() < end:
        for _ in range(30):
            target = roles.find(bpy.context.scene, "target")
            target.location.x += float(rng.uniform(-0.02, 0.02))
            target.location.y += float(rng.uniform(-0.02, 0.02))
            moves += 1
            yield 0.02
        with view3d():
            bpy.ops.ed.undo_push(message="moved")
        call(bpy.ops.ed.undo)
        yield 0.2
        call(bpy.ops.ed.redo)
        roles.find(bpy.context.scene, "spot").data.energy *= 1.01
        yield 0.6
    found = looking.stalls()
    say(f"the look, {moves} moves with undo and a changing lamp: {told(found)}")
    check(max(found) < LONGEST, f"no step takes {1e3 * LONGEST:.0f} ms")
    yield from until(lambda: not looking.waits(), "the last picture is whole", 60.0)
    bpy.context.window_manager.nlos.look = False


STEPS = [places, minutes]
