"""A model is trained from the panel, with a shell script in place of the command line: told, cancelled, chosen."""

from __future__ import annotations

import time

import bpy
from helpers import MODULE, WORK, call, check, module, panel_picture, until

FAKE = """#!/bin/sh
case "$*" in
  *" features "*) for n in 1 2; do echo "$n of 4 pictures" >&2; done; test -e "$(dirname "$0")/slow" && sleep 300
    echo '{"pictures": 900, "planned": 900}';;
  *) for n in 1 2 3 4 5 6 7 8 9 10; do echo "$n of 10 folds" >&2; sleep 0.3; done
    echo '{"accuracy": {"value": 0.791, "low": 0.75, "high": 0.827}, "folds": 10}';;
esac
"""


def job():
    return module("operators.train").job


def cancelled():
    python = WORK / "training-python"
    python.write_text(FAKE)
    python.chmod(0o755)
    (WORK / "slow").touch()
    bpy.context.preferences.addons[MODULE].preferences.python = str(python)
    settings = bpy.context.scene.nlos
    settings.model, settings.dataset = "", str(WORK / "nowhere")
    words = call(bpy.ops.nlos.train)
    check("render a data set first" in str(words), f"without a set there is a sentence: {words}")
    (WORK / "taught").mkdir()
    settings.train_set = str(WORK / "taught")
    call(bpy.ops.nlos.train)
    gaps, last = [], time.monotonic()
    while job().running and "2 of 4" not in job().words:
        yield 0.02
        gaps.append(time.monotonic() - last)
        last = time.monotonic()
    check(max(gaps) < 2.0, f"the window stays free: longest wait {max(gaps):.2f} s")
    yield from panel_picture("NLOS_PT_train", "88-trains")
    check(call(bpy.ops.nlos.train_cancel) == {"FINISHED"}, "it can be cancelled")
    yield from until(lambda: not job().running, "it ends")
    (WORK / "slow").unlink()
    check(job().words == "Cancelled" and not settings.model, f"nothing is chosen: {job().words}")


def trained():
    call(bpy.ops.nlos.train)
    yield from until(lambda: not job().running, "it ends", 60.0)
    check("right voxel in 79.1 %" in job().words, job().words)
    settings = bpy.context.scene.nlos
    check(settings.model == str(WORK / "taught.skops"), f"the model is chosen: {settings.model}")
    yield from panel_picture("NLOS_PT_train", "88-trained")
    call(bpy.ops.ed.undo)
    yield 0.3
    check(not bpy.context.scene.nlos.model, f"undo takes the choice back: {bpy.context.scene.nlos.model}")
    bpy.context.preferences.addons[MODULE].preferences.python = ""
    result = call(bpy.ops.wm.open_mainfile, filepath=str(WORK / "room.blend"))  # as later steps expect it
    check(result == {"FINISHED"}, f"the room is opened again: {result}")
    yield 1.0


STEPS = [cancelled, trained]
