"""Copies keep their role: one of them is chosen, by a button of Check, of the live look and of Adopt My Objects."""

from __future__ import annotations

import bpy
from helpers import call, check, looked, module, press, redraw, roles, screenshot, scroll, tab, until


def _copy():
    for obj in bpy.context.selected_objects:
        obj.select_set(False)
    target = bpy.context.scene.objects[roles()["target"][0]]
    target.select_set(True)
    bpy.context.view_layer.objects.active = target
    call(bpy.ops.object.duplicate)
    return roles()["target"]


def a_room():
    call(bpy.ops.nlos.new_room)
    yield 1.0
    yield from tab("NLOS")


def check_offers_to_keep_one_of_two_targets():
    state = module("session.state")
    names = _copy()
    check(len(names) == 2, f"a copy of the target is a target too: {roles()}")
    result = call(bpy.ops.nlos.check)
    yield from looked()
    check(result == {"FINISHED"}, f"the check runs: {result}")
    check([f.choices for f in state.findings] == [tuple(names)], f"it names both: {state.findings}")
    redraw()
    yield 0.5
    yield from scroll(100)
    yield from screenshot("25-copies")
    yield from press(f'nlos.fix(fix="keep", choice="{names[1]}"', across=0.65)
    yield 0.5
    check(roles()["target"] == [names[1]], f"its button keeps the copy: {roles()}")
    check(not [f for f in state.findings if f.choices], "and the check finds no two targets any more")
    call(bpy.ops.ed.undo)
    yield 0.3
    check(sorted(roles()["target"]) == sorted(names), f"undo gives the part back: {roles()}")


def the_look_offers_it_too():
    live = module("view.live")
    bpy.context.window_manager.nlos.look = True
    yield from until(live.played_twice, "the look says that there are two")
    check("2 objects are the target" in live.words(), live.words())
    [found] = live.played_twice()
    result = call(bpy.ops.nlos.fix, fix=found.fix, choice=found.choices[0])
    yield from looked()
    check(result == {"FINISHED"}, f"one is kept: {result}")
    yield from until(lambda: live.pictures() and not live.waits(), "a picture comes", 60.0)
    check(not live.played_twice(), "and there is no such button any more")
    bpy.context.window_manager.nlos.look = False
    yield 0.3


STEPS = (a_room, check_offers_to_keep_one_of_two_targets, the_look_offers_it_too)
