"""Pictures of every panel, one at a time."""

from __future__ import annotations

import bpy
from helpers import call, check, module, redraw, screenshot, scroll, tab, view3d


def panels():
    if not module("generator.blender.scene.roles").players(bpy.context.scene, "target"):
        call(bpy.ops.nlos.new_room)
        yield 1.0
    yield from tab("NLOS")
    names = [n for n in dir(bpy.types) if n.startswith("NLOS_PT_")]
    check(len(names) >= 12, f"the panels are registered: {names}")
    with view3d() as (area, _):
        area.spaces.active.show_region_ui = True
    yield from scroll(-100)
    for page in range(4):
        redraw()
        yield from screenshot(f"70-panels-{page + 1}")
        yield from scroll(12)


STEPS = [panels]
