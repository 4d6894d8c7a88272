"""Presets, menus and names work as everywhere in Blender."""

from __future__ import annotations

import bpy
from helpers import call, check, invoke, looked, module, roles, screenshot, tab, xdotool


def presets():
    settings = bpy.context.scene.nlos
    settings.light_power, settings.poses, settings.grid_counts = 321.0, 17, (2, 2, 2)
    result = call(bpy.ops.nlos.preset_add, name="Bright")
    check(result == {"FINISHED"}, f"a preset is kept: {result}")
    path = bpy.utils.preset_find("Bright", module("ui.menus").PRESETS)
    check(path, "it lies in the user's folder")
    settings.light_power, settings.poses, settings.grid_counts = 1.0, 1, (1, 1, 1)
    result = call(bpy.ops.script.execute_preset, filepath=path, menu_idname="NLOS_PT_presets")
    kept = (settings.light_power, settings.poses, tuple(settings.grid_counts))
    check(result == {"FINISHED"} and kept == (321.0, 17, (2, 2, 2)), f"and brought back: {result}, {kept}")
    call(bpy.ops.nlos.preset_add, name="Bright", remove_name=True, remove_active=False)
    settings.poses, settings.grid_counts = 100, (3, 3, 1)


def names():
    target = module("generator.blender.scene.roles").find(bpy.context.scene, "target")
    target.name = "Käse 🧀\nmit Löchern"
    state = module("session.state")
    call(bpy.ops.nlos.check)
    yield from looked()
    check(not module("generator.blender.check").hopeless(state.findings), f"{[f.text for f in state.findings]}")
    check(roles()["target"] == [target.name], "an object may have any name")
    module("generator.blender.scene.roles").find(bpy.context.scene, "target").name = "Target"


def search():
    """F3 finds what the menu has."""
    yield from tab("NLOS")
    with_mouse = bpy.context.window
    yield from xdotool("mousemove", with_mouse.width // 2 - 100, with_mouse.height // 2)
    yield 1.0
    yield from xdotool("key", "F3")
    yield 1.0
    if bpy.app.version >= (5, 0):  # there F3 as xdotool sends it opens nothing; why was not found
        invoke(bpy.ops.wm.search_menu)
        yield 1.5
    yield from xdotool("type", "--delay", "40", "Check Scene")
    yield 0.8
    yield from screenshot("65-search")
    state = module("session.state")
    state.findings.clear()
    yield from xdotool("key", "Return")
    yield 2.0
    check(state.findings, "F3, 'Check Scene', Return checks the scene")


def scenes():
    """A second scene has settings of its own, and the look follows the one that is shown."""
    session, window = bpy.context.window_manager.nlos, bpy.context.window
    first = window.scene
    session.look = session.overlay = True
    yield 1.0
    call(bpy.ops.scene.new, type="EMPTY")
    yield 1.0
    check(bpy.context.scene != first and not roles(), "a new scene is empty")
    module("view.live").changed()
    yield 1.0
    check("no object is the" in module("view.live").words(), f"the look says so: {module('view.live').words()}")
    call(bpy.ops.scene.delete)
    yield 0.5
    check(roles() != {}, "the first is back")
    module("view.live").changed()
    yield 1.0
    check("ms" in module("view.live").words(), f"and looked at: {module('view.live').words()}")
    session.look = session.overlay = False


STEPS = [presets, names, search, scenes]
