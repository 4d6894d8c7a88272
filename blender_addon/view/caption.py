"""Draws captions that explain the colours and pixels of our images, and the live picture, in the Image Editors."""

from __future__ import annotations

from typing import Any

import blf
import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from generator.model.quantities import radiance

from . import images, texture

_handles: list[Any] = []
_STEPS = 48


def register() -> None:
    """Start drawing; this costs nothing where none of our images is shown."""
    if not bpy.app.background:
        _handles.append(bpy.types.SpaceImageEditor.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL"))


def unregister() -> None:
    """Stop drawing."""
    while _handles:
        bpy.types.SpaceImageEditor.draw_handler_remove(_handles.pop(), "WINDOW")


def lines(caption: images.Caption) -> tuple[str, str]:
    """Return the texts above and below the colour scale."""
    scale = f"dark to bright: ±{radiance(caption.top, 1)}" if caption.top else "no light from the object"
    return scale, f"amplified {caption.amplification:,.0f} times" if caption.amplification else ""


def ruler(width: float) -> float:
    """Return a round length, metres, of about a quarter of a width."""
    longest = images.round_up(width / 4.0)
    return longest if longest <= width / 2.0 else longest / 2.0


def _draw() -> None:
    context: Any = bpy.context
    image = context.space_data.image
    caption = images.captions.get(image.name) if image else None
    if caption is None:
        return
    scale = context.preferences.system.ui_scale
    left, bottom = context.region.view2d.view_to_region(0.0, 0.0, clip=False)
    if image.name == images.LOOK and images.shown is not None:
        right, top = context.region.view2d.view_to_region(1.0, 1.0, clip=False)
        texture.draw(images.shown.colours, np.array([[left, top], [right, top], [left, bottom], [right, bottom]]))
    legend(caption, 18.0 * scale, 38.0 * scale, scale)
    if caption.width:
        length = ruler(caption.width)
        right, _ = context.region.view2d.view_to_region(length / caption.width, 0.0, clip=False)
        line(np.array([[left, bottom - 8.0], [right, bottom - 8.0]]), scale)
        write(named(length), left, bottom - 26.0 * scale, scale)


def named(length: float) -> str:
    """Return a length, metres, in words."""
    return f"{100.0 * length:g} cm" if length < 1.0 else f"{length:g} m"


def line(ends: Any, scale: float) -> None:
    """Draw a white line between two points, pixels of the region."""
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    shader.bind()
    shader.uniform_float("color", (1.0, 1.0, 1.0, 1.0))
    gpu.state.line_width_set(2.0 * scale)
    batch_for_shader(shader, "LINES", {"pos": ends.astype(np.float32)}).draw(shader)
    gpu.state.line_width_set(1.0)


def legend(caption: images.Caption, x: float, y: float, scale: float) -> None:
    """Draw the scale of colours with its texts, its lower left corner at a point of the region, pixels."""
    wide, high = 180.0 * scale, 14.0 * scale
    gpu.state.blend_set("ALPHA")
    steps = np.linspace(-1.0, 1.0, _STEPS)
    columns = x + (steps + 1.0) / 2.0 * wide
    corners = np.stack([np.repeat(columns, 2), np.tile([y, y + high], _STEPS)], axis=1).astype(np.float32)
    colours = np.ones((2 * _STEPS, 4), dtype=np.float32)
    colours[:, :3] = np.repeat(images.signed(steps), 2, axis=0)
    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    batch_for_shader(shader, "TRI_STRIP", {"pos": corners, "color": colours}).draw(shader)
    above, below = lines(caption)
    write(above, x, y + high + 6.0 * scale, scale)
    write(below, x, y - 20.0 * scale, scale)
    gpu.state.blend_set("NONE")


def write(text: str, x: float, y: float, scale: float, size: float = 12.0) -> None:
    """Write a white text that can be read over anything, from a point of the region, pixels."""
    blf.size(0, size * scale)
    blf.color(0, 1.0, 1.0, 1.0, 1.0)
    blf.enable(0, blf.SHADOW)
    blf.shadow(0, 3, 0.0, 0.0, 0.0, 1.0)
    blf.position(0, x, y, 0.0)
    blf.draw(0, text)
    blf.disable(0, blf.SHADOW)
