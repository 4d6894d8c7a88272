"""A data set is rendered beside: the window stays free, cancel and resume lose nothing."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
from helpers import WORK, call, check, looked, memory, module, press, redraw, screenshot, tab, until, view3d

POSES = 150


def job():
    return module("operators.dataset").job


def start_cancel():
    settings = bpy.context.scene.nlos
    settings.engine, settings.samples, settings.resolution, settings.poses = "patch", 32, (16, 16), POSES
    settings.dataset, settings.workers = str(WORK / "set"), 2
    with view3d():
        bpy.ops.ed.undo_push(message="settings")  # as their fields do
    call(bpy.ops.wm.save_as_mainfile, filepath=str(WORK / "room40.blend"))
    yield from press("nlos.sweep_start")
    yield from looked()
    check(job() is not None and job().running, "its button starts it")
    gaps, last = [], time.monotonic()
    end = last + 120.0
    while job().running and job().done < 3 and time.monotonic() < end:
        yield 0.02
        gaps.append(time.monotonic() - last)
        last = time.monotonic()
    check(0 < job().done < 9 * POSES, f"pictures are made: {job().status()}")
    check(max(gaps) < 2.0, f"the window stays free: longest wait {max(gaps):.2f} s")
    redraw()
    yield from screenshot("40-running")
    words = call(bpy.ops.nlos.sweep_start)
    check("poll" in str(words), f"a second one is refused: {words}")
    call(bpy.ops.ed.undo)  # undo does not touch what runs beside
    yield 0.3
    check(job().running, "undo leaves it alone")
    call(bpy.ops.ed.redo)
    # Not by its button: seeking that by mouse takes longer than the set.
    check(call(bpy.ops.nlos.sweep_cancel) == {"FINISHED"}, "it can be cancelled")
    yield from until(lambda: not job().running, "it ends", 30.0)
    check("Resume goes on" in job().status(), job().status())
    made = sorted((WORK / "set").rglob("*.exr"))
    check(3 <= len(made) < 9 * POSES, f"what was made stays: {len(made)}")
    memory["made"] = {str(p): p.read_bytes() for p in made}
    check(not children(), f"no Blender is left running: {children()}")


def resume():
    words = call(bpy.ops.nlos.sweep_start)
    check("resume it" in str(words), f"it is not begun anew: {words}")
    call(bpy.ops.nlos.sweep_resume)
    yield 0.5
    call(bpy.ops.wm.read_homefile, use_empty=True)  # closing the file does not end it
    yield 1.0
    check(job() is not None and job().running, "it goes on when the file is closed")
    yield from until(lambda: not job().running, "it ends", 400.0)
    check("Finished" in job().status(), job().status())
    check(all(Path(name).read_bytes() == data for name, data in memory["made"].items()), "nothing was made twice")
    dataset = module("generator.sets.dataset").Dataset.open(WORK / "set")
    check(not dataset.verify(), f"the set is whole: {dataset.verify()[:3]}")
    call(bpy.ops.wm.open_mainfile, filepath=str(WORK / "room40.blend"))
    yield 1.0
    yield from tab("NLOS")
    redraw()
    yield from screenshot("40-finished")


def render_wall():
    state = module("session.state")
    bpy.context.scene.nlos.samples = 256
    result = call(bpy.ops.nlos.render_wall)
    check(result == {"FINISHED"}, f"the wall is rendered: {result}")
    yield from until(
        lambda: state.shown is not None or "Rendering" not in state.rendering, "the picture comes", 120.0
    )
    check(state.shown is not None, state.rendering)
    check("adds" in state.rendering, state.rendering)
    yield from screenshot("40-wall")


def children():
    me = str(Path("/proc/self").resolve().name)
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rsplit(")", 1)
        except OSError:
            continue
        if fields[1].split()[1] == me and fields[1].split()[0] != "Z":
            found.append(fields[0])
    return found


STEPS = [start_cancel, resume, render_wall]
