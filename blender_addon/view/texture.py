"""A picture in colours, drawn as a texture: it belongs to no file, and nothing asks to save it."""

from __future__ import annotations

from typing import Any

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from generator.files.pictures import Picture

_AT_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], dtype=np.float32)
_kept: tuple[Picture, Any] | None = None


def draw(colours: Picture, corners: Any, opacity: float = 1.0) -> None:
    """Draw a picture; to be called where Blender draws.

    Parameters
    ----------
    colours : ndarray of shape (height, width, 3)
        Row 0 is the top. The texture of the last one is kept.
    corners : ndarray of shape (4, 2) or (4, 3)
        Where its upper left, upper right, lower left and lower right corner are, in the space that is drawn in.
    opacity : float
        0 to 1.
    """
    global _kept
    if _kept is None or _kept[0] is not colours:
        height, width = colours.shape[:2]
        rgba = np.ones((height, width, 4), dtype=np.float32)
        rgba[..., :3] = colours
        buffer = gpu.types.Buffer("FLOAT", rgba.size, rgba.ravel())
        _kept = colours, gpu.types.GPUTexture((width, height), format="RGBA16F", data=buffer)
    shader = gpu.shader.from_builtin("IMAGE_COLOR")
    gpu.state.blend_set("ALPHA")
    shader.bind()
    shader.uniform_float("color", (1.0, 1.0, 1.0, opacity))
    shader.uniform_sampler("image", _kept[1])
    batch = batch_for_shader(shader, "TRI_STRIP", {"pos": corners.astype(np.float32), "texCoord": _AT_CORNERS})
    batch.draw(shader)
    gpu.state.blend_set("NONE")


def forget() -> None:
    """Free the texture that was kept."""
    global _kept
    _kept = None
