"""Brings the sidebar's tab to the front, and the wall and the voxels into view, after a new scene was made."""

from __future__ import annotations

from typing import Any

import bpy

from generator.blender.scene import viewports

from ..session import state

TAB = "NLOS"
_TRIES = 20


def enter() -> None:
    """Look at the scene in every 3D view that is open, and bring our tab to the front there."""
    screens = [window.screen for window in bpy.context.window_manager.windows]
    viewports.frame(bpy.context.scene, screens)
    for area in _areas():
        area.spaces.active.show_region_ui = True
    state.after_drawing(lambda: _bring_forward(_TRIES))


def _bring_forward(tries: int) -> None:
    """Choose our tab: Blender knows the tabs of a sidebar only once it has been drawn."""
    waits = False
    for region in (region for area in _areas() for region in area.regions if region.type == "UI"):
        try:
            region.active_panel_category = TAB
        except (TypeError, AttributeError):  # not drawn yet
            waits = True
    if waits and tries:
        state.after_drawing(lambda: _bring_forward(tries - 1))


def _areas() -> list[Any]:
    return [a for window in bpy.context.window_manager.windows for a in window.screen.areas if a.type == "VIEW_3D"]
