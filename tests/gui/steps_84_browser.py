"""The pictures of a set are looked at while it is rendered and after: lazily, told, and the target put there."""

from __future__ import annotations

import math
import time

import bpy
from helpers import WORK, call, check, module, panel_picture, until, view3d

POSES = 400  # so many that reading all would be felt


def thumbnails():
    return module("view.thumbnails")


def target():
    return next(o for o in bpy.context.scene.objects if o.get("nlos_role") == "target")


def page():
    found = thumbnails().opened()
    return [record for record, _, _ in module("operators.browser").shown(found)] if found else []


def ask():
    thumbnails().want(bpy.context.scene.nlos.dataset, page())


def all_there():
    ask()
    return page() and all(thumbnails().thumbnail(record)[0] for record in page())


def while_it_is_rendered():
    settings = bpy.context.scene.nlos
    settings.preset = "room"
    call(bpy.ops.nlos.build_scene)
    settings.engine, settings.samples, settings.resolution, settings.poses = "patch", 256, (16, 16), POSES
    settings.dataset, settings.workers = str(WORK / "nothing there"), 1
    ask()
    yield from until(lambda: "is not a data set" in thumbnails().words(), "without a set there is a sentence")
    settings.dataset = str(WORK / "browsed")
    call(bpy.ops.nlos.sweep_start)
    job = module("operators.dataset").job
    yield from until(lambda: job.done > 4, "pictures are made", 120.0)
    gaps, last = [], time.monotonic()
    while job.done < 14 and job.running:
        ask()
        yield 0.02
        gaps.append(time.monotonic() - last)
        last = time.monotonic()
    check(max(gaps) < 2.0, f"the window stays free: longest wait {max(gaps):.2f} s")
    yield from until(all_there, "what is rendered meanwhile is shown")
    check(thumbnails().opened().dataset.planned == 9 * POSES, "the whole set is known")
    record = page()[0]
    call(bpy.ops.nlos.browse_step, voxel=0, by=-1)
    check(page()[0].index == POSES - 1, f"the one before the first is the last: {page()[0].index}")
    ask()
    yield from until(lambda: "not rendered yet" in thumbnails().thumbnail(page()[0])[1], "what is missing is told")
    yield from panel_picture("NLOS_PT_browser", "84-rendering")
    call(bpy.ops.nlos.browse_step, voxel=0, by=1)
    check(page()[0] == record, "and there again")
    call(bpy.ops.nlos.sweep_cancel)
    yield from until(lambda: not job.running, "it ends", 30.0)
    steps = []
    for _ in range(20):
        call(bpy.ops.nlos.browse_step, voxel=1)
        ask()
        began = time.monotonic()
        thumbnails()._serve()
        steps.append(time.monotonic() - began)
        yield 0.1
    module("operators.browser").chosen.clear()
    check(sorted(steps)[-2] < 0.05, f"its steps do not hold the window: {max(steps):.3f} s")


def put_there():
    with view3d():
        bpy.ops.ed.undo_push(message="settings")  # as their fields do
    yield from until(all_there, "its pictures are shown")
    yield from panel_picture("NLOS_PT_browser", "84-pictures")
    before = tuple(target().location)
    record = page()[5]
    bpy.context.window_manager.nlos.overlay = True
    result = call(bpy.ops.nlos.browse_place, voxel=record.voxel, position=0)
    check(result == {"FINISHED"}, f"a click puts the target there: {result}")
    off = max(abs(a - b) for a, b in zip(target().location, record.position, strict=True))
    turned = max(abs(math.degrees(a) - b) for a, b in zip(target().rotation_euler, record.rotation, strict=True))
    check(off < 1e-6 and turned < 1e-4, f"exactly: {off} m, {turned} degrees off")
    yield from panel_picture("NLOS_PT_browser", "84-put")
    call(bpy.ops.ed.undo)
    yield 0.5
    check(max(abs(a - b) for a, b in zip(target().location, before, strict=True)) < 1e-6, "undo takes it back")
    bpy.context.window_manager.nlos.overlay = False


def of_another_scene():
    differs = module("view.differs")
    bpy.context.scene.nlos.grid_counts = (2, 2, 1)
    with view3d():
        bpy.ops.ed.undo_push(message="voxels")
    call(bpy.ops.nlos.apply)
    yield from until(
        lambda: thumbnails().others_than(differs.described()) == ["grid"], "that the voxels are others is noticed"
    )
    (WORK / "browsed/A/0000.exr").write_bytes(b"broken")
    call(bpy.ops.nlos.browse_again)
    yield from until(lambda: ask() or (page() and thumbnails().thumbnail(page()[0])[1]), "a broken one is told")
    yield from panel_picture("NLOS_PT_browser", "84-other")
    call(bpy.ops.ed.undo)
    bpy.context.scene.nlos.dataset = "//dataset"


STEPS = [while_it_is_rendered, put_there, of_another_scene]
