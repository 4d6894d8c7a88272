"""The library of assets is written beside, listed in the preferences, and shown by the asset browser."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
from helpers import call, check, looked, module, point, redraw, roles, screenshot, until, xdotool


def write_the_library():
    assets = module("operators.assets")
    check(not assets.is_there(), "there is no such library before")
    began = time.perf_counter()
    result = call(bpy.ops.nlos.add_assets)
    held = time.perf_counter() - began
    check(result == {"FINISHED"}, f"the library is written: {result}")
    check(held < 0.05, f"the window is not held: {1e3 * held:.0f} ms")
    yield from until(lambda: "..." not in assets.words, "it is written", 60.0)
    check("assets are in the asset browser" in assets.words, assets.words)
    check(assets.is_there(), "the preferences list it")
    size = sum(path.stat().st_size for path in assets.folder().iterdir())
    check(size <= module("generator.blender.assets").LARGEST, f"it is as small as it says: {size} bytes")
    result = call(bpy.ops.nlos.add_assets)
    yield from until(lambda: "..." not in assets.words, "it is written again", 60.0)
    listed = [Path(one.path) for one in bpy.context.preferences.filepaths.asset_libraries]
    check(listed.count(assets.folder()) == 1, f"and listed once: {listed}")


def look_at_it():
    assets = module("operators.assets")
    call(bpy.ops.wm.read_homefile, use_empty=True)
    yield 1.0
    window = bpy.context.window_manager.windows[0]
    area = max(window.screen.areas, key=lambda area: area.width * area.height)
    with bpy.context.temp_override(window=window, area=area):
        bpy.ops.screen.area_split(direction="HORIZONTAL", factor=0.55)
    yield 0.5
    lower = min((a for a in window.screen.areas if a.type == "VIEW_3D"), key=lambda area: area.y)
    lower.ui_type = "ASSETS"
    yield 0.5
    lower.spaces.active.params.asset_library_reference = assets.LIBRARY
    yield from point(lower.x + lower.width / 2, lower.y + 1.5 * lower.height)  # its tooltip would cover some of it
    redraw()
    yield 2.0
    yield from screenshot("68-assets")


def drag_a_wall():
    window = bpy.context.window_manager.windows[0]
    area = next(a for a in window.screen.areas if a.ui_type == "ASSETS")
    area.spaces.active.params.filter_search = "painted"
    redraw()
    yield 1.0
    region = next(r for r in area.regions if r.type == "WINDOW")
    height = window.height
    yield from xdotool("mousemove", region.x + 55, height - (region.y + region.height - 50))
    yield 0.5
    yield from xdotool("mousedown", 1)
    for share in (0.2, 0.4, 0.6, 0.8, 1.0):
        y = (1.0 - share) * (height - region.y - region.height + 50) + share * 250
        yield from xdotool("mousemove", region.x + 55 + round(share * 300), round(y))
        yield 0.2
    yield from xdotool("mouseup", 1)
    yield 1.0
    check(list(roles()) == ["relay_wall"], f"what is dragged out of the library is the wall: {roles()}")
    wall = bpy.context.scene.objects[roles()["relay_wall"][0]]
    check(wall.library is None and wall.asset_data is None, f"it is the user's own: {wall.name_full}")
    yield from screenshot("68-dragged")
    area.spaces.active.params.filter_search = ""
    bpy.data.objects.remove(wall)
    yield 0.3


def a_scene_of_assets():
    assets = module("operators.assets")
    file = assets.folder() / module("generator.blender.assets").FILE
    wanted = ("Relay wall, painted, 5 m x 2.6 m", "Spot lamp, beam of 2.78°", "Camera, perspective, 1 m x 1 m")
    for name in (*wanted, "Partition, 2.1 m x 2.6 m", "Target, sheet"):
        result = call(bpy.ops.wm.append, directory=f"{file}/Object/", filename=name)
        check(result == {"FINISHED"}, f"{name} is appended: {result}")
    check(set(roles()) == {"relay_wall", "spot", "camera", "partition", "target"}, f"each has its part: {roles()}")
    state = module("session.state")
    call(bpy.ops.nlos.check)
    yield from looked()
    for fix in ("voxels", "reflections"):
        result = call(bpy.ops.nlos.fix, fix=fix)
        yield from looked()
        check(result == {"FINISHED"}, f"{fix} is mended: {result}")
    texts = [f.text for f in state.findings if f.level == "error"]
    check(not texts, f"the check accepts it: {texts}")
    yield 0.5
    yield from screenshot("68-scene")


STEPS = [write_the_library, look_at_it, drag_a_wall, a_scene_of_assets]
