"""Draws the live picture on the relay wall itself, in the 3D views, whatever their shading."""

from __future__ import annotations

from typing import Any

import bpy
import gpu
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Vector

from . import caption, images, texture

_BEFORE = 0.002
"""Metres by which the picture stands before the wall, or the wall would cover it in places."""
_THROUGH = 0.35
"""Opacity with which it is seen through what stands before it: a rendered view shows rooms closed."""
_BELOW = 0.05
"""Share of the picture's height by which the bar that tells its size lies below it."""

_handles: list[Any] = []


def switch(on: bool) -> None:
    """Start or stop drawing."""
    if on and not _handles and not bpy.app.background:
        add = bpy.types.SpaceView3D.draw_handler_add
        _handles.extend([add(_draw_picture, (), "WINDOW", "POST_VIEW"), add(_draw_words, (), "WINDOW", "POST_PIXEL")])
    elif not on:
        while _handles:
            bpy.types.SpaceView3D.draw_handler_remove(_handles.pop(), "WINDOW")
        texture.forget()


def _draw_picture() -> None:
    look = images.shown
    if look is None:
        return
    across, down = look.corners[1] - look.corners[0], look.corners[2] - look.corners[0]
    inwards = np.cross(down, across)
    corners = look.corners + _BEFORE * inwards / np.linalg.norm(inwards)
    texture.draw(look.colours, corners, _THROUGH)
    gpu.state.depth_test_set("LESS_EQUAL")
    texture.draw(look.colours, corners)
    gpu.state.depth_test_set("NONE")


def _draw_words() -> None:
    """Draw the bar of known length below the picture, and what its colours mean in the corner of the view."""
    context: Any = bpy.context
    look, meaning = images.shown, images.captions.get(images.LOOK)
    if look is None or meaning is None:
        return
    scale = context.preferences.system.ui_scale
    length = caption.ruler(meaning.width)
    low = look.corners[2] + _BELOW * (look.corners[2] - look.corners[0])
    ends = low, low + (look.corners[3] - look.corners[2]) * (length / meaning.width)
    places = [location_3d_to_region_2d(context.region, context.region_data, Vector(end)) for end in ends]
    if None not in places:
        caption.line(np.array(places), scale)
        left = min(places, key=lambda place: place.x)
        caption.write(caption.named(length), left.x, left.y - 18.0 * scale, scale)
    # To the right of the toolbar, which overlaps the view.
    tools = next((r.width for r in context.area.regions if r.type == "TOOLS" and r.alignment != "NONE"), 0)
    caption.legend(meaning, tools + 18.0 * scale, 38.0 * scale, scale)
