"""Nothing is left when the extension goes. Steps after these have no extension."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import traces
from helpers import MODULE, WORK, call, check, memory, roles, screenshot


def disable():
    functions = traces.functions()
    check(call(bpy.ops.preferences.addon_disable, module=MODULE) == {"FINISHED"}, "the add-on is disabled")
    yield 1.0  # what still draws or waits would fail now
    left = traces.left(memory["before"])
    check(not left, f"nothing is left registered: {left}")
    timers = [f.__qualname__ for f in functions if bpy.app.timers.is_registered(f)]
    check(not timers, f"no timer goes on: {timers}")
    check(MODULE not in bpy.context.preferences.addons, "the preferences know it no more")
    check(roles() == memory["roles"], "the scene keeps its roles")
    yield from screenshot("90-disabled")


def enable_again():
    check(call(bpy.ops.preferences.addon_enable, module=MODULE) == {"FINISHED"}, "the add-on is enabled")
    yield 0.5
    result = call(bpy.ops.nlos.read_scene)
    check(result == {"FINISHED"}, f"it reads the scene: {result}")


def remove():
    installed = Path(sys.modules[MODULE].__file__).parent
    check((installed / "blender_manifest.toml").is_file(), f"it is installed in {installed}")
    repos = bpy.context.preferences.extensions.repos
    index = next(i for i, repo in enumerate(repos) if repo.module == "user_default")
    result = call(bpy.ops.extensions.package_uninstall, repo_index=index, pkg_id="nlos_lab")
    check(result == {"FINISHED"}, f"it is removed: {result}")
    yield 1.0
    check(not installed.exists(), f"its folder is gone: {installed}")
    left = traces.left(memory["before"])
    check(not left, f"nothing is left registered: {left}")
    result = call(bpy.ops.wm.open_mainfile, filepath=str(WORK / "room.blend"))
    check(result == {"FINISHED"}, f"its files open without it: {result}")
    yield 1.0
    check(roles() == memory["roles"], "and keep their roles")
    yield from screenshot("90-removed")


STEPS = [disable, enable_again, remove]
