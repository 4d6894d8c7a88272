"""One reflection: the lit patch itself, where the camera sees it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from generator.transport import elements
from generator.transport.compiled import in_parts, jit, jit_released
from generator.transport.polygons import clip

Floats = NDArray[Any]


def draw(to_wall: Floats, patch: Floats, resolution: tuple[int, int], accuracy: float) -> Floats:
    """Return a picture (height, width) of the lit patch, of radiance 1 under the lamp.

    A pixel is the integral over what it shows of the patch: a polygon, since the patch is one of so many corners, of
    its own area, that it may pass for an ellipse (its moments err with the square of the angle between corners).

    Parameters
    ----------
    to_wall : ndarray of shape (3, 3)
        The projective map from (u, v, 1) to the wall's two axes.
    patch : ndarray of shape (15,)
        As `elements.clip_patch` takes it.
    resolution : (int, int)
        Width and height, pixels.
    accuracy : float
        Relative.
    """
    width, height = resolution
    corners = max(32, math.ceil(8.0 / math.sqrt(accuracy)))
    step = 2.0 * math.pi / corners
    angle = step * np.arange(corners)[:, None]
    out = math.sqrt(step / math.sin(step))
    rim = patch[0:2] + out * (np.cos(angle) * patch[2:4] + np.sin(angle) * patch[4:6])
    from_wall = np.linalg.inv(to_wall)
    along, across = leggauss(4), leggauss(4)
    if patch[13] > 0.0:
        # A soft edge is smooth only piecewise: the more so, the more of it is in a pixel.
        seen = abs(float(from_wall[2] @ [patch[0], patch[1], 1.0]))
        pixel = abs(float(np.linalg.det(to_wall))) * seen**3 / (width * height)
        share = min(1.0, math.sqrt(pixel / abs(patch[2] * patch[5] - patch[3] * patch[4])))
        most = 24 if accuracy > 3e-3 else 96
        along, across = leggauss(max(4, math.ceil(most * share))), leggauss(max(4, math.ceil(most / 4.0 * share)))
    rules = tuple(((nodes + 1.0) / 2.0, weights / 2.0) for nodes, weights in (along, across))
    made = np.zeros((height, width))
    in_parts(_draw, height, made, to_wall, from_wall, patch, rim, *rules)
    return made


@jit_released
def _draw(
    start: int,
    stop: int,
    made: Floats,
    to_wall: Floats,
    from_wall: Floats,
    patch: Floats,
    rim: Floats,
    along: tuple[Floats, Floats],
    across: tuple[Floats, Floats],
) -> None:
    """Write rows of the picture."""
    height, width = made.shape
    # Of the map from (u, v) to the wall; its derivative is this over the cube of the homogeneous coordinate.
    determinant = abs(
        to_wall[0, 0] * (to_wall[1, 1] * to_wall[2, 2] - to_wall[1, 2] * to_wall[2, 1])
        - to_wall[0, 1] * (to_wall[1, 0] * to_wall[2, 2] - to_wall[1, 2] * to_wall[2, 0])
        + to_wall[0, 2] * (to_wall[1, 0] * to_wall[2, 1] - to_wall[1, 1] * to_wall[2, 0])
    )
    reach0, reach1 = 0.0, 0.0
    for k in range(rim.shape[0]):
        reach0, reach1 = max(reach0, abs(rim[k, 0] - patch[0])), max(reach1, abs(rim[k, 1] - patch[1]))
    corners = np.empty((4, 2))
    polygon, spare = np.empty((rim.shape[0] + 8, 2)), np.empty((rim.shape[0] + 8, 2))
    for row in range(start, stop):
        for column in range(width):
            for k in range(4):
                u, v = (column + (1 if k == 1 or k == 2 else 0)) / width, (row + k // 2) / height
                far = to_wall[2, 0] * u + to_wall[2, 1] * v + to_wall[2, 2]
                corners[k, 0] = (to_wall[0, 0] * u + to_wall[0, 1] * v + to_wall[0, 2]) / far
                corners[k, 1] = (to_wall[1, 0] * u + to_wall[1, 1] * v + to_wall[1, 2]) / far
            if (
                corners[:, 0].min() > patch[0] + reach0
                or corners[:, 0].max() < patch[0] - reach0
                or corners[:, 1].min() > patch[1] + reach1
                or corners[:, 1].max() < patch[1] - reach1
            ):
                continue
            n = rim.shape[0]
            polygon[:n] = rim
            middle0, middle1 = corners[:, 0].mean(), corners[:, 1].mean()
            for k in range(4):
                p0, p1 = corners[k, 0], corners[k, 1]
                a, b = p1 - corners[(k + 1) % 4, 1], corners[(k + 1) % 4, 0] - p0
                c = -a * p0 - b * p1
                side = 1.0 if a * middle0 + b * middle1 + c > 0.0 else -1.0
                n = clip(polygon, n, side * a, side * b, side * c, spare)
                polygon[:n] = spare[:n]
            if n < 3:
                continue
            middle0, middle1 = polygon[:n, 0].mean(), polygon[:n, 1].mean()
            total = 0.0
            for k in range(n):
                e0, e1 = polygon[k, 0] - middle0, polygon[k, 1] - middle1
                f0, f1 = polygon[(k + 1) % n, 0] - middle0, polygon[(k + 1) % n, 1] - middle1
                total += abs(e0 * f1 - e1 * f0) * _triangle(
                    middle0, middle1, e0, e1, f0, f1, from_wall, patch, along, across
                )
            made[row, column] = total * width * height / determinant


@jit
def _triangle(
    p: float,
    q: float,
    e0: float,
    e1: float,
    f0: float,
    f1: float,
    from_wall: Floats,
    patch: Floats,
    along: tuple[Floats, Floats],
    across: tuple[Floats, Floats],
) -> float:
    """Integrate radiance over a triangle, a corner (p, q) and two edges, relative to twice its area (Duffy 1982)."""
    total = 0.0
    for i in range(along[0].shape[0]):
        out = along[0][i]
        for j in range(across[0].shape[0]):
            turn = across[0][j]
            x = p + out * ((1.0 - turn) * e0 + turn * f0)
            y = q + out * ((1.0 - turn) * e1 + turn * f1)
            far = 1.0 / (from_wall[2, 0] * x + from_wall[2, 1] * y + from_wall[2, 2])
            total += along[1][i] * out * across[1][j] * elements.patch_radiance(x, y, patch) * abs(far) ** 3
    return total
