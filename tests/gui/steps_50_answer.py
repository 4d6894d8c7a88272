"""Without a Python that has scikit-learn there is a sentence; with something that answers, its answer is shown."""

from __future__ import annotations

import stat

import bpy
from helpers import MODULE, WORK, call, check, module, redraw, screenshot, tab, until

FAKE = """#!/bin/sh
# Stands for an environment's Python: what is tested here is how the extension asks and shows, not the model.
case "$*" in
  *predict*) echo '{"answers": [{"label": "E", "probability": {"A": 0.1, "B": 0.05, "E": 0.8, "I": 0.05}}]}';;
  *) echo 3.11.2;;
esac
"""


def without():
    preferences = bpy.context.preferences.addons[MODULE].preferences
    preferences.python = ""
    words = call(bpy.ops.nlos.answer)
    check("make setup" in str(words), f"a way out is named: {words}")
    preferences.python = "/nowhere/python"
    words = call(bpy.ops.nlos.test_environment)
    check("is no file" in str(words), f"a wrong path is told: {words}")
    preferences.python = "/usr/bin/python3"
    state = module("session.state")
    call(bpy.ops.nlos.test_environment)
    yield from until(lambda: "Testing" not in state.environment_words, "the test ends", 60.0)
    check("cannot read trained models" in state.environment_words, state.environment_words)


def asked():
    state = module("session.state")
    python, model = WORK / "python", WORK / "sheet.skops"
    python.write_text(FAKE)
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    model.write_bytes(b"")
    bpy.context.preferences.addons[MODULE].preferences.python = str(python)
    call(bpy.ops.nlos.test_environment)
    yield from until(lambda: "works" in state.environment_words, "the test is passed")
    bpy.context.scene.nlos.model = str(model)
    result = call(bpy.ops.nlos.answer)
    check(result == {"FINISHED"}, f"the model is asked: {result}")
    yield from until(lambda: state.answer, "it answers")
    check(state.answer_words == "Voxel E, with a probability of 80%", state.answer_words)
    bpy.context.window_manager.nlos.overlay = True
    redraw()
    yield from tab("NLOS")
    yield from screenshot("50-answer")
    call(bpy.ops.nlos.forget_answer)
    check(not state.answer, "it can be forgotten")
    bpy.context.window_manager.nlos.overlay = False


STEPS = [without, asked]
