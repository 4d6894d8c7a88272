"""What an add-on may leave in Blender."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import bpy
from helpers import MODULE


def traces() -> dict[str, set[str]]:
    """Return what is registered: handlers, classes, operators, properties, menu entries and keys."""
    types = {name: getattr(bpy.types, name) for name in dir(bpy.types)}
    owners = {name: kind for name, kind in types.items() if isinstance(kind, type) and issubclass(kind, bpy.types.ID)}
    handlers = {name: getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)}
    keymaps = bpy.context.window_manager.keyconfigs.addon.keymaps
    return {
        "handler": {f"{n}: {_name(f)}" for n, all_ in handlers.items() if isinstance(all_, list) for f in all_},
        "class": set(types),
        "operator": {f"{group}.{name}" for group in dir(bpy.ops) for name in dir(getattr(bpy.ops, group))},
        "property": {f"{name}.{p.identifier}" for name, kind in owners.items() for p in kind.bl_rna.properties},
        "entry": {f"{n}: {_name(f)}" for n, kind in types.items() for f in _drawers(kind)},
        "key": {f"{keymap.name}: {item.idname}" for keymap in keymaps for item in keymap.keymap_items},
    }


def left(before: dict[str, set[str]]) -> list[str]:
    """Return what has come since ``before``."""
    now = traces()
    return [f"{kind} {name}" for kind in now for name in sorted(now[kind] - before[kind])]


def functions() -> list[Callable[..., Any]]:
    """Return the functions of the extension's modules: whichever of them is a timer, Blender does not tell."""
    modules = [m for name, m in sys.modules.items() if name.startswith(MODULE)]
    return [f for m in modules for f in vars(m).values() if callable(f) and not isinstance(f, type)]


def _name(function: Any) -> str:
    return f"{function.__module__}.{getattr(function, '__qualname__', function)}"


def _drawers(kind: Any) -> list[Any]:
    drawn = getattr(vars(kind).get("draw"), "_draw_funcs", []) if isinstance(kind, type) else []
    return [f for f in drawn if f.__qualname__ != f"{kind.__name__}.draw"]  # its own goes in with the first guest
