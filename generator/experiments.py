"""The paper's experiments 1 to 3 (section 5.1) in any scene: what a movement or a turn of the object changes."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from generator import extract, poses, stage
from generator.dataset import Picture
from generator.spec import NlosError
from generator.transport import Mesh, Sphere, Transport

ACCURACY = 3e-3
"""Of each picture. A turn about the wall's normal changes it by little more."""


def draw(scene: bpy.types.Scene, number: int, *, pixels: int = 64, accuracy: float = ACCURACY) -> Picture:
    """Return the difference pictures of an experiment side by side: an axis a row, the object at rest in the middle.

    Parameters
    ----------
    scene : bpy.types.Scene
        The object stands where the target does; it is half as large as a voxel.
    number : {1, 2, 3}
        1 moves a sphere, 2 a square sheet, along x, y and z; 3 turns the sheet about them.
    pixels : int
        Of a picture's side.
    accuracy : float
        Relative, of each picture.

    Returns
    -------
    ndarray of shape (3 * pixels, 5 * pixels, 3), float32
        Radiance less that with the object at rest, W/m^2/sr.

    Raises
    ------
    NlosError
        The scene cannot be read, or the engine `surfel` cannot honour something in it.
    """
    grid = stage.read(scene).grid
    world, reasons = extract.world(scene, resolution=(pixels, pixels))
    if world is None:
        raise NlosError(f"experiments are drawn by the engine 'surfel', which cannot honour that {reasons[0]}")
    size = min(grid.size) / 2.0
    body = Sphere(np.zeros(3), size / 2.0, np.ones(3)) if number == 1 else _sheet(size)
    transport = Transport(replace(world, target=(body,)), accuracy=accuracy)
    x, y, z = stage.find(scene, "target").matrix_world.translation
    rows = poses.experiment(number, (x, y, z), step=size / 4.0)
    at_rest = transport.difference(*rows[0][len(rows[0]) // 2])
    drawn = [np.concatenate([transport.difference(*pose) - at_rest for pose in row], axis=1) for row in rows]
    sheet: Picture = np.concatenate(drawn).astype(np.float32)
    return sheet


def _sheet(size: float) -> Mesh:
    h = size / 2.0
    a, b, c, d = (-h, 0.0, -h), (h, 0.0, -h), (h, 0.0, h), (-h, 0.0, h)
    return Mesh(np.array([[a, b, c], [a, c, d]]), np.full((2, 3), 0.9))
