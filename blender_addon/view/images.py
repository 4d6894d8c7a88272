"""Pictures as Blender images: float, non-colour data, bottom row first as Blender stores them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from generator.files.pictures import Picture

WALL = "NLOS wall"
DIFFERENCE = "NLOS difference"
PREVIEW = "NLOS preview"
LOOK = "NLOS look"
EXPERIMENT = "NLOS experiment {}"

_STOPS = np.array([[0.0, 0.0, 0.0], [0.9, 0.35, 0.05], [1.0, 0.95, 0.75]])
"""Colours at 0, 1/2 and 1 of the scale where the object brightens the wall; red and blue swap where it darkens it."""


@dataclass(frozen=True)
class Caption:
    """Meaning of the colours and pixels of an image.

    Attributes
    ----------
    top : float
        Radiance of the brightest colour, W/m^2/sr.
    amplification : float
        Factor by which the light is brightened: at 1 the lit patch has the brightest colour.
    width : float
        Width of the image on the wall, metres; 0 if it holds several pictures.
    """

    top: float
    amplification: float
    width: float


captions: dict[str, Caption] = {}
"""Captions by the names of their images."""


@dataclass(frozen=True)
class Look:
    """The live picture, which is drawn on the wall and in Image Editors but is no image's pixels.

    Attributes
    ----------
    colours : ndarray of shape (height, width, 3), float32
        Row 0 is the top.
    corners : ndarray of shape (4, 3)
        Upper left, upper right, lower left and lower right corner on the wall, metres.
    """

    colours: Picture
    corners: Any


shown: Look | None = None
"""The live picture as it is now; None if there is none."""

_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])


def store(name: str, picture: Picture) -> Any:
    """Store a picture in the image of that name, created if it is missing, and return the image.

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
    image.use_fake_user = True
    image.pack()  # saved with the file
    return image


def preview(picture: Picture) -> Any:
    """Store a picture scaled so that light of any strength can be seen, and return the image.

    White is what 1 % of the values exceed, so that a single bright pixel, usually noise, does not darken it.
    """
    captions.pop(PREVIEW, None)
    white = float(np.quantile(picture, 0.99)) or float(picture.max())
    return store(PREVIEW, np.clip(picture / white, 0.0, 1.0) if white > 0 else np.zeros_like(picture))


def look(picture: Picture, watched: Any, reference: float) -> None:
    """Show a difference picture in the colours of `signed`, with its caption, in place of the last.

    Its pixels are drawn (`view.wall`), not stored in an image: Blender would ask to save that when it quits.

    Parameters
    ----------
    picture : ndarray of shape (height, width, 3)
        Radiance, W/m^2/sr.
    watched : Watched
        The part of the wall that it shows.
    reference : float
        Radiance of the lit patch, W/m^2/sr.
    """
    global shown
    corners = watched.points(_CORNERS)
    sides = corners[1] - corners[0], corners[3] - corners[2]
    width = float(np.mean([np.linalg.norm(side) for side in sides]))
    shown = Look(_colours(LOOK, picture, reference, width), corners)
    image = bpy.data.images.get(LOOK)
    if image is not None and tuple(image.size) != shown.colours.shape[1::-1]:
        image.generated_height, image.generated_width = shown.colours.shape[:2]
    # Undoing a step from before the image was made removes the image.
    if any(area.spaces.active.image is None for _, area in _editors()):
        show(look_image())


def darken() -> None:
    """Take the live picture and its caption away: what it showed is not so any more."""
    global shown
    shown = None
    captions.pop(LOOK, None)


def look_image() -> Any:
    """Return the black image over which Image Editors draw the live picture, created if it is missing."""
    image = bpy.data.images.get(LOOK)
    if image is None:
        height, width = shown.colours.shape[:2] if shown else (64, 64)
        image = bpy.data.images.new(LOOK, width, height, alpha=False, float_buffer=True, is_data=True)
    return image


def coloured(name: str, picture: Picture, reference: float, width: float) -> Any:
    """Store a difference picture in colours, with its caption, and return the image; see `look`."""
    return store(name, _colours(name, picture, reference, width))


def _colours(name: str, picture: Picture, reference: float, width: float) -> Picture:
    level = picture.mean(axis=2)
    top = scale(level)
    captions[name] = Caption(top, reference / top if top else 0.0, width)
    return signed(level / top if top else level)


def scale(level: Picture) -> float:
    """Return the value of the brightest colour for a picture of signed values; 0 if all are 0."""
    return round_up(float(np.quantile(np.abs(level), 0.995)) or float(np.abs(level).max()))


def signed(values: Picture) -> Picture:
    """Return colours (..., 3) of values from -1 to 1: warm above zero, cold below, black at zero."""
    x = np.clip(np.abs(values), 0.0, 1.0)
    stops = np.linspace(0.0, 1.0, len(_STOPS))
    warm = np.stack([np.interp(x, stops, _STOPS[:, c]) for c in range(3)], axis=-1)
    colours: Picture = np.where((values < 0.0)[..., None], warm[..., ::-1], warm)
    return colours


def round_up(value: float) -> float:
    """Round up to 1, 2, 5, 10, 20 ..., a scale that does not change while the object is moved a little."""
    if not value > 0.0 or not math.isfinite(value):
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return next((step * power for step in (1.0, 2.0, 5.0) if value <= step * power), 10.0 * power)


def show(image: Any) -> bool:
    """Show an image in the first Image Editor that is open, as large as fits; return whether there is one."""
    for window, area in _editors()[:1] if image is not None else ():
        previous, area.spaces.active.image = area.spaces.active.image, image
        if previous is None or previous == image or tuple(previous.size) != tuple(image.size):
            region = next(r for r in area.regions if r.type == "WINDOW")
            with bpy.context.temp_override(window=window, area=area, region=region):
                bpy.ops.image.view_all(fit_view=True)
        area.tag_redraw()
        return True
    return False


def is_editor_open() -> bool:
    """Return whether an Image Editor is open."""
    return bool(_editors())


def _editors() -> list[tuple[Any, Any]]:
    """Return (window, area) of every open Image Editor."""
    windows = bpy.context.window_manager.windows
    return [(w, a) for w in windows for a in w.screen.areas if a.type == "IMAGE_EDITOR"]
