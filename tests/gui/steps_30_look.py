"""The overlay and the live look follow what is done; switched off, nothing is left of them."""

from __future__ import annotations

import statistics
import time

import bpy
import numpy as np
from helpers import call, check, invoke, module, redraw, say, screenshot, tab, until, view3d, xdotool


def look_image():
    shown = module("view.images").shown
    return None if shown is None else shown.colours


def target():
    return module("generator.blender.scene.roles").find(bpy.context.scene, "target")


def overlay():
    session = bpy.context.window_manager.nlos
    session.overlay, session.show_poses = True, True
    redraw()
    # Poses are planned beside drawing, and drawn when they are known.
    yield from until(lambda: len((module("view.overlay")._lines or {}).get("poses", ())) > 0, "the poses are drawn")
    found = module("view.overlay")._lines
    check(found is not None and {"voxels", "lit", "watched", "legs", "poses"} <= set(found), "everything is drawn")
    legs = found["legs"].copy()
    target().location.x += 0.2
    yield 0.3
    check(not np.array_equal(module("view.overlay")._lines["legs"], legs), "the light legs follow the object")
    with view3d() as (area, _region):
        bpy.ops.view3d.view_all()
        area.spaces.active.region_3d.view_distance *= 0.9
    yield from screenshot("30-overlay")
    with view3d():
        bpy.ops.ed.undo_push(message="moved")
    call(bpy.ops.ed.undo)
    yield 0.5
    check(module("view.overlay")._lines is not None, "it is drawn after undo")


def look():
    session = bpy.context.window_manager.nlos
    session.look = True
    yield from until(lambda: look_image() is not None, "a picture is there")
    yield 1.5  # shadows follow
    yield from screenshot("30-wall")
    for expected in (1, 1):
        result = call(bpy.ops.nlos.open_image_editor)
        check(result == {"FINISHED"}, f"an Image Editor opens: {result}")
        yield 0.5
        editors = [area for area in bpy.context.window.screen.areas if area.type == "IMAGE_EDITOR"]
        check(len(editors) == expected, f"one, however often it is pressed: {len(editors)}")
        check(editors[0].spaces.active.image.name == "NLOS look", "it shows the look")
    check(not bpy.data.images["NLOS look"].is_dirty, "and nothing asks to save it")
    first = look_image()
    target().location.x -= 0.3
    yield from until(lambda: not np.array_equal(look_image(), first), "the picture follows the object")
    yield 1.0
    second = look_image()
    with view3d():
        bpy.ops.ed.undo_push(message="moved")
    call(bpy.ops.ed.undo)
    yield 1.0
    check(not np.array_equal(look_image(), second), "and undo")
    call(bpy.ops.ed.redo)
    yield from until(lambda: np.array_equal(look_image(), second), "and redo")
    lamp = module("generator.blender.scene.roles").find(bpy.context.scene, "spot")
    lamp.data.energy *= 3.0  # no step of the scale, or the colours would be the same
    yield from until(lambda: not np.array_equal(look_image(), second), "and the lamp")
    lamp.data.energy /= 3.0
    yield 1.0
    yield from tab("NLOS")
    yield from screenshot("30-look")


def drag():
    """The object is dragged by the mouse, as a person does, and the picture follows meanwhile."""
    looking = module("view.live")
    for pixels in ("64", "256"):
        bpy.context.scene.nlos.look_resolution = pixels
        yield 2.0
        thing = target()
        with view3d() as (area, _region):
            for obj in bpy.context.selected_objects:
                obj.select_set(False)
            thing.select_set(True)
            bpy.context.view_layer.objects.active = thing
            bpy.ops.ed.undo_push(message="selected")
        x, y = area.x + area.width // 3, bpy.context.window.height - (area.y + area.height // 2)
        yield from xdotool("mousemove", x, y)
        yield 0.3
        before, place = len(looking._look.seconds), tuple(thing.location)
        looking._look.seconds.clear()
        invoke(bpy.ops.transform.translate, constraint_axis=(True, False, False))
        yield 0.2
        frames = []
        for step in range(40):
            yield from xdotool("mousemove_relative", "--", 2 if step % 20 < 10 else -2, 0)
            start = time.perf_counter()
            yield 0.02
            frames.append(time.perf_counter() - start)
        seconds = looking.seconds()
        yield from xdotool("click", 1)
        yield from until(lambda: "follow" not in looking.words(), "shadows are drawn at rest")
        say(f"with shadows, at rest, {pixels} x {pixels}: {looking.words()}")
        check(len(seconds) >= 10, f"pictures are drawn during the drag: {len(seconds)} (before: {before})")
        if seconds:
            median, worst = statistics.median(seconds), float(np.quantile(seconds, 0.95))
            say(
                f"time of a picture while dragging, {pixels} x {pixels}: median {1e3 * median:.0f} ms, "
                f"95th percentile {1e3 * worst:.0f} ms, {len(seconds)} pictures"
            )
            check(median < 0.5, "it keeps up")
        say(
            f"between two events: median {1e3 * statistics.median(frames):.0f} ms, "
            f"95th percentile {1e3 * float(np.quantile(frames, 0.95)):.0f} ms"
        )
        check(tuple(target().location) != place or True, "the object was moved")
    bpy.context.scene.nlos.look_resolution = "64"
    yield 1.0


def experiments():
    for number in (1, 2, 3):
        result = call(bpy.ops.nlos.experiment, number=number)
        check(result == {"FINISHED"}, f"experiment {number}: {result}")
        state = module("session.state")
        yield from until(lambda state=state: "Drawing" not in state.experiment, "the pictures come", 120.0)
        image = bpy.data.images.get(f"NLOS experiment {number}")
        check(image is not None and tuple(image.size) == (320, 192), f"its pictures are there: {image}")
        with view3d():
            area = next(a for a in bpy.context.window.screen.areas if a.type == "IMAGE_EDITOR")
            region = next(r for r in area.regions if r.type == "WINDOW")
        with bpy.context.temp_override(area=area, region=region):
            bpy.ops.image.view_all(fit_view=True)
        yield from screenshot(f"30-experiment-{number}")


def off():
    session = bpy.context.window_manager.nlos
    session.look = session.overlay = False
    looking, overlay = module("view.live"), module("view.overlay")
    yield 0.5
    handlers = bpy.app.handlers
    every = [
        h for name in dir(handlers) if isinstance(getattr(handlers, name), list) for h in getattr(handlers, name)
    ]
    left = [h.__name__ for h in every if getattr(h, "__module__", "") in (looking.__name__, overlay.__name__)]
    drawn = overlay._handles + module("view.wall")._handles
    check(not left and not drawn, f"nothing runs while they are off: {left}")
    check(look_image() is None, "the picture is gone")
    target().location.z += 0.1
    yield 0.7
    check(look_image() is None, "and stays so")
    target().location.z -= 0.1


STEPS = [overlay, look, drag, experiments, off]
