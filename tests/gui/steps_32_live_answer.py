"""Answers follow the live look while the object is dragged, never hold the window for long, and leave nothing."""

from __future__ import annotations

import stat

import bpy
import numpy as np
from helpers import MODULE, WORK, call, check, invoke, module, redraw, say, screenshot, tab, until, view3d, xdotool

LONGEST = 0.05
"""Seconds that no step of the extension may hold the window for."""

# They stand for an environment with NLOS Lab: what is tested here is how the extension asks and shows, not the model.
PYTHON = """#!/bin/sh
case "$*" in
  *answer_worker*) exec /usr/bin/python3 "$(dirname "$0")/answers.py";;
  *) exec /usr/bin/python3 "$@";;
esac
"""
ANSWERS = """
import json, sys
print('nlos {"ready": true, "words": "sheet.skops stands in"}', flush=True)
for line in sys.stdin:
    asked = json.loads(line)
    n = asked["grid"]["shape"][0] * asked["grid"]["shape"][1] * asked["grid"]["shape"][2]
    labels = [chr(65 + i) for i in range(min(n, 26))]
    first = asked["number"] % len(labels)
    chance = {label: 0.9 if i == first else 0.1 / (len(labels) - 1) for i, label in enumerate(labels)}
    print("nlos " + json.dumps({"number": asked["number"], "probability": chance, "doubts": []}), flush=True)
"""


def environment():
    """Return the Python of an environment, and a model; here, what stands for them."""
    python, model = WORK / "live-python", WORK / "sheet.skops"
    python.write_text(PYTHON)
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    (WORK / "answers.py").write_text(ANSWERS)
    model.write_bytes(b"")
    return [(str(python), str(model))]


def answers():
    roles, live_answer = module("generator.blender.scene.roles"), module("view.live_answer")
    state, looking = module("session.state"), module("view.live")
    session = bpy.context.window_manager.nlos
    session.overlay, session.show_poses = True, False
    yield from tab("NLOS")
    for number, (python, model) in enumerate(environment()):
        bpy.context.preferences.addons[MODULE].preferences.python = python
        settings = bpy.context.scene.nlos  # another one after undo
        settings.look_resolution, settings.look_shadows, settings.model = "64", True, model
        session.live_answer = True
        check(session.look, "it switches the look on")
        name = model.rpartition("/")[2]
        yield from until(lambda name=name: state.answer and name in live_answer.words()[0], f"{name} answers", 120.0)
        target = roles.find(bpy.context.scene, "target")
        place = tuple(target.location)
        looking.stalls(clear=True)
        for voxel in range(9):
            before = live_answer.answers()
            target = roles.find(bpy.context.scene, "target")
            target.location = np.mean(roles.read_grid(bpy.context.scene).bounds(voxel), axis=0)
            yield from until(lambda before=before: live_answer.answers() > before, "the answer follows")
        for step in range(200):
            target = roles.find(bpy.context.scene, "target")
            target.location = np.add(place, (0.2 * np.sin(step / 10.0), 0.1 * np.cos(step / 7.0) - 0.1, 0.0))
            yield 0.02
        yield from until(lambda: not live_answer.waits(), "all is answered")
        label = max(state.answer, key=lambda v: state.answer[v])
        say(f"{state.answer_words}; {live_answer.words()}")
        check(f"Voxel {label}, with" in state.answer_words, state.answer_words)
        for name, found in (("its own steps", live_answer.stalls()), ("the look's", looking.stalls())):
            say(f"{name}: {len(found)}, longest {1e3 * max(found):.1f} ms")
            check(max(found) < LONGEST, f"{name} take less than {1e3 * LONGEST:.0f} ms")
        yield from _dragged(target, live_answer)
        redraw()
        yield from screenshot(f"32-live-answer-{number}")
        with view3d():
            bpy.ops.ed.undo_push(message="moved")
        call(bpy.ops.ed.undo)
        yield 0.5
        check(session.live_answer, "undo leaves it on")
        roles.find(bpy.context.scene, "target").location = place
        yield 0.5


def _dragged(target, live_answer):
    with view3d() as (area, _region):
        for obj in bpy.context.selected_objects:
            obj.select_set(False)
        target.select_set(True)
        bpy.context.view_layer.objects.active = target
    x, y = area.x + area.width // 3, bpy.context.window.height - (area.y + area.height // 2)
    yield from xdotool("mousemove", x, y)
    yield 0.3
    before = live_answer.answers()
    invoke(bpy.ops.transform.translate, constraint_axis=(True, False, False))
    yield 0.2
    for step in range(20):
        yield from xdotool("mousemove_relative", "--", 4 if step < 10 else -4, 0)
        yield 0.02
    check(live_answer.answers() > before + 3, f"answers while the mouse drags: {live_answer.answers() - before}")
    yield from xdotool("click", 1)
    yield 0.5


def ends():
    session, state = bpy.context.window_manager.nlos, module("session.state")
    live_answer = module("view.live_answer")
    worker = live_answer._live.resident._worker
    worker.kill()
    yield from until(lambda: "has ended" in live_answer.words()[0], "a process that dies is told")
    yield from until(lambda: not state.answer, "and its answer taken away")
    session.live_answer = False
    session.live_answer = True
    yield from until(lambda: live_answer._live.resident.about, "it starts again", 120.0)
    process = live_answer._live.resident._worker._process
    session.live_answer = False
    yield from until(lambda: process.poll() is not None, "switched off, its process ends")
    check(session.look and not module("view.live").followers and not state.answer, "and the look stays")
    session.live_answer = True
    yield from until(lambda: live_answer._live.resident.about, "and again", 120.0)
    process = live_answer._live.resident._worker._process
    session.look = False
    yield from until(lambda: process.poll() is not None, "it ends with the look")
    check(not session.live_answer and not bpy.app.timers.is_registered(live_answer._show), "nothing of it runs")
    session.overlay = False
    bpy.context.preferences.addons[MODULE].preferences.python = ""


STEPS = [answers, ends]
