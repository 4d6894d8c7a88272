"""Draws in the 3D views, with the overlay, the true and the estimated path of a target that was followed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from generator.model.arrays import Array

from ..session import state

RADIUS = 2.7955
"""Half axes of the ellipsoid that holds 95 % of a normal distribution in space, in standard deviations."""
_CORNERS = 32
_TRUE, _FOUND, _REGION = (0.4, 1.0, 0.5, 1.0), (1.0, 0.45, 0.1, 1.0), (1.0, 0.45, 0.1, 0.25)
_MOST_REGIONS = 60
"""Regions of so many frames, evenly chosen, are drawn faintly besides that of the current frame."""


@dataclass(frozen=True)
class Path:
    """A target's path, and what was found of it.

    Attributes
    ----------
    numbers : tuple of int
        Numbers of the frames on the timeline.
    truth, found : ndarray of shape (n, 3)
        Positions, metres.
    regions : ndarray of shape (n, 3, k, 3)
        Three ellipses of each frame's 95 % region, in planes of two of its axes, as closed lines.
    """

    numbers: tuple[int, ...]
    truth: Array
    found: Array
    regions: Array


_shown: Path | None = None
_handles: list[Any] = []


def shown() -> Path | None:
    """Return the path that is drawn."""
    return _shown


def path(numbers: Sequence[int], truth: Any, found: Any, covariances: Any) -> Path:
    """Return a path with its 95 % regions.

    Parameters
    ----------
    numbers : sequence of int
        Numbers of the frames.
    truth, found : array-like of shape (n, 3)
        Metres.
    covariances : array-like of shape (n, 3, 3)
        m^2.
    """
    truth, found, covariances = (np.asarray(values, dtype=np.float64) for values in (truth, found, covariances))
    values, axes = np.linalg.eigh(covariances)
    half_axes = RADIUS * np.sqrt(np.maximum(values, 0.0))[:, None, :] * axes  # its columns
    angles = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
    rings = [
        found[:, None]
        + np.cos(angles)[:, None] * half_axes[:, None, :, i]
        + np.sin(angles)[:, None] * half_axes[:, None, :, j]
        for i, j in ((2, 1), (2, 0), (1, 0))
    ]
    return Path(tuple(numbers), truth, found, np.stack(rings, axis=1))


def show(wanted: Path) -> None:
    """Draw a path from now on, wherever the overlay is on."""
    global _shown
    _shown = wanted
    if not _handles:
        _handles.append(bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW"))
    state.redraw("VIEW_3D")


def forget() -> None:
    """Draw no path any more."""
    global _shown
    _shown = None
    for handle in _handles:
        bpy.types.SpaceView3D.draw_handler_remove(handle, "WINDOW")
    _handles.clear()
    state.redraw("VIEW_3D")


def current(frame: int) -> int | None:
    """Return the index of a frame of the timeline in the path; None if it is not one of its frames."""
    return _shown.numbers.index(frame) if _shown is not None and frame in _shown.numbers else None


def _draw() -> None:
    context = bpy.context
    if _shown is None or not context.window_manager.nlos.overlay:
        return
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    region = context.region

    def line(points: Array, colour: tuple[float, ...], width: float) -> None:
        shader.bind()
        shader.uniform_float("viewportSize", (region.width, region.height))
        shader.uniform_float("lineWidth", width)
        shader.uniform_float("color", colour)
        batch_for_shader(shader, "LINES", {"pos": _segments(points)}).draw(shader)

    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("NONE")
    step = max(1, len(_shown.regions) // _MOST_REGIONS)
    line(_shown.regions[::step, 0], _REGION, 1.0)
    line(_shown.truth[None], _TRUE, 2.0)
    line(_shown.found[None], _FOUND, 2.0)
    index = current(context.scene.frame_current)
    if index is not None:
        line(_shown.regions[index], _FOUND, 2.5)
        line(np.stack([_shown.truth[index], _shown.found[index]])[None], (1.0, 1.0, 1.0, 1.0), 2.5)
    gpu.state.blend_set("NONE")


def _segments(lines: Array) -> Any:
    """Return lines (n, k, 3) as pairs of points, (2 n (k - 1), 3), float32."""
    return np.repeat(lines, 2, axis=1)[:, 1:-1].reshape(-1, 3).astype(np.float32)


def register() -> None:
    """Do nothing: a path is drawn only once something was followed."""


def unregister() -> None:
    """Draw no path any more."""
    forget()
