"""An animated target is rendered and followed beside a free window, and its path drawn frame by frame."""

from __future__ import annotations

import stat
import time

import bpy
import numpy as np
from helpers import MODULE, WORK, call, check, module, redraw, say, screenshot, tab, until, view3d

# They stand for an environment with NLOS Lab: tested is how the extension asks and shows, not the tracker.
PYTHON = """#!/bin/sh
exec /usr/bin/python3 "$(dirname "$0")/track.py" "$@"
"""
TRACK = """
import csv, json, sys, time
folder = sys.argv[sys.argv.index("track") + 2]
rows = list(csv.DictReader(open(folder + "/poses.csv")))
frames = []
for row in rows:
    print("frame " + row["index"] + ": E", file=sys.stderr, flush=True)
    time.sleep(0.1)
    true = [float(row[axis]) for axis in "xyz"]
    spread = [[0.002, 0.001, 0.0], [0.001, 0.004, 0.0], [0.0, 0.0, 0.003]]
    found = [true[0] + 0.05, true[1] - 0.03, true[2]]
    frames.append({"frame": int(row["index"]), "position": found, "true_position": true, "covariance": spread})
print(json.dumps({"frames": frames, "error": {"value": 0.058}, "covered": {"value": 1.0}, "words": []}))
"""


def environment():
    """Return the Python of an environment, and an atlas; here, what stands for them."""
    python, atlas = WORK / "track-python", WORK / "room.atlas"
    python.write_text(PYTHON)
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    (WORK / "track.py").write_text(TRACK)
    atlas.write_bytes(b"")
    return str(python), str(atlas)


def rendered():
    settings, scene = bpy.context.scene.nlos, bpy.context.scene
    settings.preset = "tabletop"
    settings.preset = "room"
    call(bpy.ops.nlos.build_scene)
    yield 0.5
    settings, scene = bpy.context.scene.nlos, bpy.context.scene
    settings.engine, settings.resolution, settings.samples = "patch", (16, 16), 256
    settings.timeline_folder, settings.workers = str(WORK / "timeline"), 1
    scene.frame_start, scene.frame_end, scene.frame_step = 1, 25, 2
    dataset = module("operators.dataset")
    call(bpy.ops.nlos.timeline_render)
    yield from until(lambda: not dataset.job.running, "a target at rest is refused", 120.0)
    check("stands still from frame 1 to frame 25" in dataset.job.status(), dataset.job.status())
    target = module("generator.blender.scene.roles").find(scene, "target")
    for frame, place in ((1, (1.1, 1.0, 1.3)), (12, (1.7, 1.2, 1.2)), (25, (1.5, 1.6, 1.4))):
        target.location = place
        target.keyframe_insert("location", frame=frame)
    result = call(bpy.ops.nlos.timeline_render)
    check(result == {"FINISHED"}, f"rendering begins: {result}")
    worst = yield from _free(lambda: dataset.job.running, 400.0)
    check(dataset.job.status() == "Finished: 13 of 13 pictures", dataset.job.status())
    say(f"longest wait between two steps while it renders: {1e3 * worst:.0f} ms")


def followed():
    timeline, path = module("operators.timeline"), module("view.path")
    settings = bpy.context.scene.nlos
    bpy.context.preferences.addons[MODULE].preferences.python, settings.timeline_atlas = environment()
    result = call(bpy.ops.nlos.timeline_follow)
    check(result == {"FINISHED"} and timeline.following(), f"following begins: {result}")
    seen = set()
    while timeline.following():
        seen.update(timeline.words)
        yield 0.05
    check(any(words.startswith("Frame ") for words in seen), f"it is told how far it is: {seen}")
    check(path.shown() is not None and timeline.words[0].startswith("Median error"), f"{timeline.words}")
    check(bpy.context.window_manager.nlos.overlay, "the overlay shows it")
    say(" ".join(timeline.words))
    bpy.context.scene.frame_set(15)
    check(path.current(15) == 7, "the current frame is one of its own")
    target = module("generator.blender.scene.roles").find(bpy.context.scene, "target")
    check(np.allclose(path.shown().truth[7], target.matrix_world.translation, atol=1e-5), "the target is on the path")
    with view3d() as (area, _region):
        bpy.ops.view3d.view_axis(type="TOP")
        area.spaces.active.region_3d.view_location = (1.4, 1.2, 1.3)
        area.spaces.active.region_3d.view_distance = 4.0
    yield from tab("NLOS")
    redraw()
    yield from screenshot("45-timeline")


def cancelled():
    timeline, path = module("operators.timeline"), module("view.path")
    call(bpy.ops.nlos.timeline_follow)
    yield 0.3
    call(bpy.ops.nlos.timeline_cancel)
    check(not timeline.following() and path.shown() is None and not path._handles, "nothing is left of it")
    yield 0.5
    bpy.context.window_manager.nlos.overlay = False
    bpy.context.preferences.addons[MODULE].preferences.python = ""
    bpy.context.scene.frame_set(1)


def _free(running, limit):
    """Wait while something runs, up to some seconds; return the longest time between two turns of the event loop."""
    end, worst, last = time.monotonic() + limit, 0.0, time.monotonic()
    while running() and time.monotonic() < end:
        yield 0.02
        now = time.monotonic()
        worst, last = max(worst, now - last), now
    return worst


STEPS = [rendered, followed, cancelled]
