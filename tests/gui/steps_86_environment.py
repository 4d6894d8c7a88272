"""The Python for answers is made by a click, with a shell script in place of pip: told, cancelled, removed."""

from __future__ import annotations

import sys
import time

import bpy
from helpers import MODULE, WORK, call, check, invoke, memory, module, panel_picture, screenshot, tab, until, xdotool

FAKE = """#!/bin/sh
case "$*" in
  *find_spec*) echo 3.13 whole;;
  *"-m venv"*) mkdir -p "$4/bin" "$4/site"; cp "$0" "$4/bin/python";;
  *sysconfig*) echo "$(dirname "$0")/../site";;
  *"-m pip"*) for name in numpy scipy numba llvmlite h5py; do echo "Collecting $name==1.0"; sleep 3; done;;
  *version_info*) echo 3.13.5;;
esac
"""


def making():
    return module("operators.environment")


def offline():
    words = call(bpy.ops.nlos.make_environment)
    check("--offline-mode" in str(words), f"what Blender may not do is told: {words}")
    making()._check_online = lambda: None


def cancelled():
    python = WORK / "fake-python"
    python.write_text(FAKE)
    python.chmod(0o755)
    memory["executable"], sys.executable = sys.executable, str(python)
    bpy.context.preferences.addons[MODULE].preferences.python = ""
    yield from tab("NLOS")
    invoke(bpy.ops.nlos.make_environment)
    yield 0.5
    yield from screenshot("86-asks")
    yield from xdotool("key", "Return")
    yield from until(lambda: making().job and making().job.running, "it begins once that is confirmed")
    gaps, last = [], time.monotonic()
    while making().job.running and "numba" not in making().job.words:
        yield 0.02
        gaps.append(time.monotonic() - last)
        last = time.monotonic()
    check(max(gaps) < 2.0, f"the window stays free: longest wait {max(gaps):.2f} s")
    yield from panel_picture("NLOS_PT_answer", "86-makes")
    check("package" in making().job.words, making().job.words)
    check(call(bpy.ops.nlos.cancel_environment) == {"FINISHED"}, "it can be cancelled")
    yield from until(lambda: not making().job.running, "it ends")
    check(not module("session.environment").own().exists(), "it is gone")
    check("Cancelled" in module("session.state").environment_words, module("session.state").environment_words)


def made_and_removed():
    state, environment = module("session.state"), module("session.environment")
    call(bpy.ops.nlos.make_environment)
    yield from until(lambda: "It works" in state.environment_words, "it is made and tested", 60.0)
    named = bpy.context.preferences.addons[MODULE].preferences
    check(named.python == str(environment.own() / "bin/python"), f"it is named: {named.python}")
    bpy.ops.screen.userpref_show()
    window = bpy.context.window_manager.windows[-1]
    bpy.context.preferences.active_section = "ADDONS"
    bpy.context.window_manager.addon_search = "NLOS"
    with bpy.context.temp_override(window=window, area=window.screen.areas[0]):
        bpy.ops.preferences.addon_expand(module=MODULE)
    yield 1.0
    yield from screenshot("86-preferences")
    with bpy.context.temp_override(window=window):
        bpy.ops.wm.window_close()
    yield 0.5
    call(bpy.ops.nlos.remove_environment)
    yield from until(lambda: "removed" in state.environment_words, "it is removed")
    check(not named.python and not environment.own().exists(), "and named no more")
    sys.executable = memory["executable"]


STEPS = [offline, cancelled, made_and_removed]
