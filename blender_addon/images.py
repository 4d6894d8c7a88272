"""Pictures as Blender images: float, non-colour data, bottom row first as Blender has it."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from generator.dataset import Picture

WALL = "NLOS wall"
DIFFERENCE = "NLOS difference"
PREVIEW = "NLOS preview"


def store(name: str, picture: Picture) -> Any:
    """Put a picture into the image of that name, made if need be, and return the image.

    Parameters
    ----------
    name : str
    picture : ndarray of shape (height, width, 3), float32
        Row 0 is the top.
    """
    height, width = picture.shape[:2]
    old = bpy.data.images.get(name)
    image = old
    if old is None or tuple(old.size) != (width, height) or not old.is_float:
        image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=True, is_data=True)
        if old is not None:
            old.user_remap(image)
            bpy.data.images.remove(old)
            image.name = name
    rgba = np.ones((height, width, 4), dtype=np.float32)
    rgba[..., :3] = picture[::-1]
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    # Or it is gone when the file is saved and opened again.
    image.use_fake_user = True
    image.pack()
    return image


def preview(picture: Picture) -> Any:
    """Store a picture scaled so that light of any strength can be seen, and return the image.

    White is what 1 % of the values exceed: a single bright pixel, which is noise as a rule, does not darken the rest.
    """
    white = float(np.quantile(picture, 0.99)) or float(picture.max())
    return store(PREVIEW, np.clip(picture / white, 0.0, 1.0) if white > 0 else np.zeros_like(picture))


def show(image: Any) -> None:
    """Show an image in the first Image Editor that is open, if one is."""
    windows = bpy.context.window_manager.windows
    spaces = [a.spaces.active for w in windows for a in w.screen.areas if a.type == "IMAGE_EDITOR"]
    if spaces:
        spaces[0].image = image
