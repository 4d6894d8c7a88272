"""Install, build a scene, undo, save: everything else needs these."""

from __future__ import annotations

import bpy
import traces
from helpers import MODULE, PACKAGE, WORK, call, check, memory, module, press, roles, screenshot, tab, view3d


def install():
    memory["before"] = traces.traces()
    result = call(
        bpy.ops.extensions.package_install_files,
        filepath=str(PACKAGE),
        repo="user_default",
        enable_on_install=True,
        overwrite=True,
    )
    check(result == {"FINISHED"}, f"the extension installs: {result}")
    check(MODULE in bpy.context.preferences.addons, "it is enabled")
    check([name for name in dir(bpy.types) if name.startswith("NLOS_PT_")], "its panels are there")
    check(hasattr(bpy.types.Scene, "nlos"), "its settings are there")


def sidebar_tab():
    check((yield from tab("NLOS")), "the tab is there")
    yield from screenshot("10-tab")


def build_scene():
    """Build by the button, with Blender's own cube, lamp and camera gone."""
    with view3d():
        for obj in list(bpy.context.scene.objects):
            bpy.data.objects.remove(obj)
        bpy.ops.ed.undo_push(message="cleared")
        bpy.context.scene.nlos.light_power = 250.0
        bpy.ops.ed.undo_push(message="power")
    yield from press("nlos.build_scene")
    found = roles()
    single = module("generator.blender.scene.roles").SINGLE_ROLES
    check(set(found) == {*single, "room", "partition"}, f"every role is played: {found}")
    check(all(len(found.get(role, ())) == 1 for role in single), f"the single roles by one object each: {found}")
    memory["roles"], memory["scene"] = found, _scene()
    yield from screenshot("10-built")


def undo_and_redo():
    check(call(bpy.ops.ed.undo) == {"FINISHED"}, "undo runs")
    yield 0.5
    check(not roles() and not bpy.context.scene.objects, f"undo takes the room away: {roles()}")
    check(bpy.context.scene.nlos.light_power == 250.0, "and leaves the settings made before")
    call(bpy.ops.ed.undo)
    yield 0.5
    check(bpy.context.scene.nlos.light_power != 250.0, "a second undo takes those back")
    for _ in range(2):
        check(call(bpy.ops.ed.redo) == {"FINISHED"}, "redo runs")
        yield 0.5
    check(roles() == memory["roles"], f"redo brings the room back: {roles()}")
    check(_scene() == memory["scene"], "just as it was")
    check(bpy.context.scene.nlos.light_power == 250.0, "with the settings")


def save_and_reopen():
    path = WORK / "room.blend"
    settings = bpy.context.scene.nlos
    settings.samples, settings.engine, settings.grid_counts = 77, "auto", (4, 5, 6)
    result = call(bpy.ops.wm.save_as_mainfile, filepath=str(path))
    check(result == {"FINISHED"}, f"it saves: {result}")
    settings.samples = 78
    result = call(bpy.ops.wm.open_mainfile, filepath=str(path))
    check(result == {"FINISHED"}, f"it opens: {result}")
    yield 1.0
    settings = bpy.context.scene.nlos
    kept = (settings.samples, settings.engine, tuple(settings.grid_counts), settings.light_power)
    check(kept == (77, "auto", (4, 5, 6), 250.0), f"the settings are in the file: {kept}")
    check(roles() == memory["roles"] and _scene() == memory["scene"], "and the scene is as it was")
    yield from tab("NLOS")
    yield from screenshot("10-sidebar")


def _scene():
    return module("generator.blender.scene.description").read_scene(bpy.context.scene)


STEPS = [install, sidebar_tab, build_scene, undo_and_redo, save_and_reopen]
