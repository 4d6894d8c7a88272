"""How long the live look keeps Blender's window, and how soon it shows what was asked for."""

from __future__ import annotations

import os
import time

import bpy
import numpy as np
from helpers import MODULE, WORK, call, check, invoke, looked, module, say, until, view3d
from watch import Watch

PLACES = ((1.55, 1.15, 1.3), (1.2, 1.6, 1.0), (1.9, 1.5, 1.3), (0.93, 1.99, 0.79))
"""Where the target stands in the room: shadows of its screen, its corner and its far end."""
MINUTES = float(os.environ.get("NLOS_GUI_MINUTES", "5"))
LONGEST = 0.05
"""Seconds that no step of the extension may hold the window for."""


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
    """Five minutes of work: moves, undo, the lamp, a new build, a check, a data set, an answer."""
    session, settings = bpy.context.window_manager.nlos, bpy.context.scene.nlos
    session.overlay = True
    settings.engine, settings.poses, settings.workers, settings.resolution = "surfel", 8, 1, (32, 32)
    settings.accuracy = 0.05
    others = {40.0: build, 80.0: checked, 110.0: data_set, 170.0: trained, 210.0: answered, 250.0: build}
    rng, begun = np.random.default_rng(0), time.monotonic()
    with Watch(MODULE.rpartition(".")[2]) as watch:
        while (since := time.monotonic() - begun) < MINUTES * 60.0:
            due = [at for at in others if at <= since]
            for at in due:
                yield from others.pop(at)()
            yield from moved(rng)
    for line in watch.told():
        say(line)
    longest, name = max(watch.steps)
    check(longest < LONGEST, f"no step takes {1e3 * LONGEST:.0f} ms: {name} took {1e3 * longest:.0f}")
    check(not others, f"all of it was done: {others}")
    yield from until(lambda: not module("view.live").waits(), "the last picture is whole", 60.0)
    session.look = session.overlay = False


def moved(rng):
    roles = module("generator.blender.scene.roles")
    for _ in range(30):
        target = roles.find(bpy.context.scene, "target")
        target.location.x += float(rng.uniform(-0.02, 0.02))
        target.location.y += float(rng.uniform(-0.02, 0.02))
        yield 0.02
    with view3d():
        bpy.ops.ed.undo_push(message="moved")
    call(bpy.ops.ed.undo)
    yield 0.2
    call(bpy.ops.ed.redo)
    roles.find(bpy.context.scene, "spot").data.energy *= 1.01
    yield 0.6


def build():
    check(call(bpy.ops.nlos.build_scene) == {"FINISHED"}, "it is built anew")
    yield 0.5


def checked():
    check(call(bpy.ops.nlos.check) == {"FINISHED"}, "it is checked")
    yield from looked()


def data_set():
    bpy.context.scene.nlos.grid_counts = (3, 3, 1)  # few enough for a set of two minutes
    yield from build()
    bpy.context.scene.nlos.dataset = str(WORK / "stalls")
    check(invoke(bpy.ops.nlos.sweep_start) == {"FINISHED"}, "a data set is asked for")
    yield from looked()
    check(module("operators.dataset").job.running, "and rendered")


def is_named():
    return module("session.environment").named()


def trained():
    """A model is trained on the set, if a Python is named that can."""
    if is_named():
        yield from until(lambda: not module("operators.dataset").job.running, "the set is finished", 120.0)
        bpy.context.scene.nlos.dataset = str(WORK / "stalls")
        check((done := call(bpy.ops.nlos.train)) == {"FINISHED"}, f"a model is trained: {done}")
    yield 0.5


def answered():
    """A picture is rendered, and the model asked; without one, the extension says what it needs."""
    state = module("session.state")
    check(call(bpy.ops.nlos.render_wall) == {"FINISHED"}, "the wall is rendered")
    yield from until(lambda: state.shown is not None, "the picture comes", 60.0)
    if is_named():
        yield from until(lambda: not module("operators.train").job.running, "the model is trained", 120.0)
        say(module("operators.train").job.words)
    answer = call(bpy.ops.nlos.answer)
    if is_named():
        check(answer == {"FINISHED"}, f"the model is asked: {answer}")
        yield from until(lambda: state.answer, "it answers", 60.0)
        say(state.answer_words)
    else:
        check("Answers need a Python" in str(answer), f"what is needed is said: {answer}")
    yield 0.5


STEPS = [places, minutes]
