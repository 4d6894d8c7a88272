"""Renders pictures of poses as arrays, without a data set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from generator.blender.engines import renderers
from generator.blender.engines.renderer import Shot
from generator.blender.engines.settings import settled
from generator.blender.scene import posing
from generator.blender.scene.description import read_scene
from generator.files.pictures import Picture
from generator.model.arrays import Vector
from generator.model.poses import noise_seed
from generator.model.settings import BACKGROUND_FACTOR


def render(
    scene: bpy.types.Scene,
    positions: Sequence[Vector],
    rotations: Sequence[Vector] = (),
    **settings: Any,
) -> tuple[Picture, Picture]:
    """Render the hidden object at poses, and the scene without it.

    Parameters
    ----------
    scene : bpy.types.Scene
        From `generator.new_scene` or `generator.open_scene`.
    positions, rotations : sequences of (float, float, float)
        Positions of the target's origin, metres, and rotations about x, then y, then z, degrees; without rotations
        the target is not turned. Collisions with the scene are not checked.
    **settings
        Fields of `generator.model.settings.Sweep` that decide on a picture: ``engine``, ``resolution``, ``samples``,
        ``seed``, ``accuracy``, ``paired``, ``denoise``, ``device``. The others have the defaults of a sweep.

    Returns
    -------
    pictures : ndarray of shape (n, height, width, 3), float32
        Radiance, W/m^2/sr; row 0 is the top.
    background : ndarray of shape (height, width, 3), float32
        The same scene without the target.

    Raises
    ------
    NlosError
        A setting is invalid, or the engine cannot honour something in the scene.

    Examples
    --------
    >>> import generator
    >>> scene = generator.new_scene(generator.preset("tabletop", "sphere"))
    >>> low, high = generator.preset("tabletop").grid.bounds(4)
    >>> settings = {"engine": "surfel", "resolution": (4, 4), "accuracy": 0.01}
    >>> pictures, background = generator.render(scene, [(low + high) / 2], **settings)
    >>> pictures.shape, background.shape
    ((1, 4, 4, 3), (4, 4, 3))
    """
    sweep, _ = settled(scene, read_scene(scene), settings)
    turns = rotations or [(0.0, 0.0, 0.0)] * len(positions)
    with renderers.opened(scene, sweep.engine, **renderers.settings(sweep)) as renderer, posing.put_back(scene):
        seed, samples = noise_seed(sweep.seed, 0), BACKGROUND_FACTOR * sweep.samples
        background = renderer.render(samples=samples, seed=seed, target=False)
        shots = [
            Shot(position, rotation, sweep.samples, noise_seed(sweep.seed, 1 + number))
            for number, (position, rotation) in enumerate(zip(positions, turns, strict=True))
        ]
        pictures = renderer.pictures(shots, background if sweep.paired else None)
    return np.array(pictures), background
