"""While Blender renders, after undo, with stale pictures and unsaved work: what a review provoked."""

from __future__ import annotations

import bpy
from helpers import WORK, call, check, invoke, looked, module, redraw, screenshot, until, view3d, xdotool


def _image(name):
    return bpy.data.images.get(name)


def _running():
    return bpy.app.is_job_running("RENDER")


def f12():
    """A render is left in peace, and its picture stays when the scene is read afterwards."""
    scene, session = bpy.context.scene, bpy.context.window_manager.nlos
    call(bpy.ops.nlos.build_scene)
    session.look = True
    yield from until(lambda: "ms" in module("view.live").words(), "the look has a picture")
    bpy.context.preferences.view.render_display_type = "NONE"
    scene.render.resolution_x = scene.render.resolution_y = 512
    before, scene.cycles.samples = scene.cycles.samples, 64
    scene.cycles.use_denoising = False  # Debian's Blender 4.3 has no denoiser, and then renders nothing
    invoke(bpy.ops.render.render)
    yield from until(_running, "F12 renders", 10.0)
    drawn = module("view.live").pictures()
    target = module("generator.blender.scene.roles").find(scene, "target")
    for _ in range(10):
        target.location.z += 0.01
        yield 0.1
        if not _running():
            break
    check(not _running() or module("view.live").pictures() == drawn, "the look waits for the render")
    if _running():
        told = call(bpy.ops.nlos.check)
        check(
            "Wait for the render to end" in str(told) or "poll() failed" in str(told), f"the check does too: {told}"
        )
    yield from until(lambda: not _running(), "the render ends", 240.0)
    yield from until(lambda: module("view.live").pictures() > drawn, "then the look goes on")
    scene.cycles.samples = before
    call(bpy.ops.nlos.check)
    yield from looked()
    result = next(i for i in bpy.data.images if i.type == "RENDER_RESULT")
    path = WORK / "kept.png"
    try:
        result.save_render(str(path))
    except RuntimeError as error:
        check(False, f"the picture of F12 is still there: {error}")
    check(path.exists(), "the picture of F12 is still there")
    session.look = False


def undo_keeps_pictures():
    """Undo after a render takes back the movement, not the picture."""
    settings = bpy.context.scene.nlos
    settings.samples, settings.resolution = 4, (16, 16)
    call(bpy.ops.nlos.render_wall)
    yield from until(lambda: "Mean radiance" in module("session.state").rendering, "the wall is rendered", 120.0)
    target = module("generator.blender.scene.roles").find(bpy.context.scene, "target")
    target.location.x += 0.1
    with view3d():
        bpy.ops.ed.undo_push(message="moved")
    call(bpy.ops.ed.undo)
    yield 0.5
    check(_image("NLOS wall") is not None, "undo leaves the picture")


def look_notices():
    """What is deleted or hidden is noticed, and an error goes when its cause does."""
    session, scene = bpy.context.window_manager.nlos, bpy.context.scene
    session.look = True
    yield from until(lambda: "ms" in module("view.live").words(), "the look has a picture")
    yield 1.5
    drawn = module("view.live").pictures()
    bpy.data.objects.remove(bpy.data.objects["Floor"])
    yield from until(lambda: module("view.live").pictures() > drawn, "a deleted floor is noticed")
    yield 1.5
    drawn = module("view.live").pictures()
    bpy.data.objects["Back"].hide_render = True
    redraw()
    yield from until(lambda: module("view.live").pictures() > drawn, "a hidden wall is noticed")
    target = module("generator.blender.scene.roles").find(scene, "target")
    target.scale = (0.0, 0.0, 0.0)
    yield from until(lambda: "ms" not in module("view.live").words(), "a target of no size is told")
    target.scale = (1.0, 1.0, 1.0)
    yield from until(lambda: "ms" in module("view.live").words(), "and forgotten when it has one")
    yield 1.5
    drawn = module("view.live").pictures()
    yield 3.0
    check(module("view.live").pictures() - drawn <= 1, "at rest nothing is drawn again and again")
    session.look = False


def lamp_of_another_kind():
    """The overlay draws what there is."""
    session = bpy.context.window_manager.nlos
    session.overlay = True
    lamp = module("generator.blender.scene.roles").find(bpy.context.scene, "spot")
    lamp.data.type = "POINT"
    redraw()
    yield 1.0
    check("voxels" in module("view.overlay")._lines, "the voxels are still drawn")
    lamp.data.type = "SPOT"
    session.overlay = False


def new_room_asks():
    """Unsaved work is not dropped without a word."""
    name = "Precious"
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, None))
    with view3d():
        bpy.ops.ed.undo_push(message="precious")
    invoke(bpy.ops.nlos.new_room)
    yield 1.0
    yield from screenshot("80-asked")
    check(name in bpy.data.objects, "nothing is lost before the answer")
    yield from xdotool("key", "Escape")
    yield 1.0
    check(name in bpy.data.objects, "and nothing after a no")
    result = call(bpy.ops.wm.open_mainfile, filepath=str(WORK / "room.blend"))  # as later steps expect it
    check(result == {"FINISHED"}, f"the room is opened again: {result}")
    yield 1.0


STEPS = [f12, undo_keeps_pictures, look_notices, lamp_of_another_kind, new_room_asks]
