"""One reflection: the lit patch itself, where the camera sees it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from generator.transport.compiled import in_parts, jit_parts, jit_within
from generator.transport.lit import Patch, radiance
from generator.transport.polygons import clip, copy, middle, start_triangle

Floats = NDArray[Any]


def draw(to_wall: Floats, patch: Patch, resolution: tuple[int, int], accuracy: float) -> Floats:
    """Return a picture (height, width) of the lit patch, of radiance 1 under the lamp.

    A pixel is the integral over the part of the patch that it shows. That part is a polygon, since the ellipse is
    replaced by a polygon of its area and many corners (its moments err with the square of the angle between corners).

    Parameters
    ----------
    to_wall : ndarray of shape (3, 3)
        The projective map from (u, v, 1) to the wall's two axes.
    patch : lit.Patch
    resolution : (int, int)
        Width and height, pixels.
    accuracy : float
        Relative accuracy.
    """
    width, height = resolution
    corners = max(32, math.ceil(8.0 / math.sqrt(accuracy)))
    step = 2.0 * math.pi / corners
    angle = step * np.arange(corners)[:, None]
    scale = math.sqrt(step / math.sin(step))
    rim = patch.centre + scale * (np.cos(angle) * patch.major + np.sin(angle) * patch.minor)
    from_wall = np.linalg.inv(to_wall)
    along, across = leggauss(4), leggauss(4)
    if patch.cos_width > 0.0:
        # A soft edge is smooth only piecewise: the more of it a pixel holds, the more points the pixel needs.
        seen = abs(float(from_wall[2] @ [patch.x, patch.y, 1.0]))
        pixel = abs(float(np.linalg.det(to_wall))) * seen**3 / (width * height)
        share = min(1.0, math.sqrt(pixel / abs(patch.major_x * patch.minor_y - patch.major_y * patch.minor_x)))
        most = 24 if accuracy > 3e-3 else 96
        along, across = leggauss(max(4, math.ceil(most * share))), leggauss(max(4, math.ceil(most / 4.0 * share)))
    rules = tuple(((nodes + 1.0) / 2.0, weights / 2.0) for nodes, weights in (along, across))
    image = np.zeros((height, width))
    in_parts(_draw_rows, height, image, to_wall, from_wall, patch, rules, rim)
    return image


class _Space(NamedTuple):
    """The patch's rim (n, 2), and scratch space: two polygons, the corners of a pixel (4, 2), a triangle (6,)."""

    rim: Floats
    polygon: Floats
    spare: Floats
    corners: Floats
    triangle: Floats


def _draw_rows(
    start: int,
    stop: int,
    made: Floats,
    to_wall: Floats,
    from_wall: Floats,
    patch: Patch,
    rules: tuple[tuple[Floats, Floats], tuple[Floats, Floats]],
    rim: Floats,
) -> None:
    """Write rows of the picture."""
    size = (len(rim) + 8, 2)
    space = _Space(rim, np.empty(size), np.empty(size), np.empty((4, 2)), np.empty(6))
    _draw(start, stop, made, to_wall, from_wall, patch, rules, space)


@jit_parts
def _draw(
    start: int,
    stop: int,
    made: Floats,
    to_wall: Floats,
    from_wall: Floats,
    patch: Patch,
    rules: tuple[tuple[Floats, Floats], tuple[Floats, Floats]],
    space: _Space,
) -> None:
    """As `_draw_rows`."""
    height, width = made.shape
    # Determinant of the map from (u, v) to the wall, whose Jacobian is this over the homogeneous coordinate cubed.
    determinant = abs(
        to_wall[0, 0] * (to_wall[1, 1] * to_wall[2, 2] - to_wall[1, 2] * to_wall[2, 1])
        - to_wall[0, 1] * (to_wall[1, 0] * to_wall[2, 2] - to_wall[1, 2] * to_wall[2, 0])
        + to_wall[0, 2] * (to_wall[1, 0] * to_wall[2, 1] - to_wall[1, 1] * to_wall[2, 0])
    )
    rim, polygon, spare, corners, triangle = space
    reach0, reach1 = 0.0, 0.0
    for k in range(rim.shape[0]):
        reach0, reach1 = max(reach0, abs(rim[k, 0] - patch.x)), max(reach1, abs(rim[k, 1] - patch.y))
    for row in range(start, stop):
        for column in range(width):
            for k in range(4):
                u, v = (column + (1 if k == 1 or k == 2 else 0)) / width, (row + k // 2) / height
                far = to_wall[2, 0] * u + to_wall[2, 1] * v + to_wall[2, 2]
                corners[k, 0] = (to_wall[0, 0] * u + to_wall[0, 1] * v + to_wall[0, 2]) / far
                corners[k, 1] = (to_wall[1, 0] * u + to_wall[1, 1] * v + to_wall[1, 2]) / far
            left, right, below, above = 0, 0, 0, 0
            for k in range(4):
                left += corners[k, 0] < patch.x - reach0
                right += corners[k, 0] > patch.x + reach0
                below += corners[k, 1] < patch.y - reach1
                above += corners[k, 1] > patch.y + reach1
            if max(max(left, right), max(below, above)) == 4:
                continue
            n = rim.shape[0]
            copy(rim, n, polygon)
            middle0, middle1 = middle(corners, 4)
            for k in range(4):
                p0, p1 = corners[k, 0], corners[k, 1]
                a, b = p1 - corners[(k + 1) % 4, 1], corners[(k + 1) % 4, 0] - p0
                c = -a * p0 - b * p1
                side = 1.0 if a * middle0 + b * middle1 + c > 0.0 else -1.0
                n = clip(polygon, n, side * a, side * b, side * c, spare)
                copy(spare, n, polygon)
            if n < 3:
                continue
            middle0, middle1 = middle(polygon, n)
            total = 0.0
            for k in range(n):
                start_triangle(polygon, n, k, middle0, middle1, triangle)
                area = abs(triangle[2] * triangle[5] - triangle[3] * triangle[4])
                total += area * _triangle(triangle, from_wall, patch, rules)
            made[row, column] = total * width * height / determinant


@jit_within
def _triangle(
    triangle: Floats, from_wall: Floats, patch: Patch, rules: tuple[tuple[Floats, Floats], tuple[Floats, Floats]]
) -> float:
    """Integrate radiance over a triangle, a corner and two edges (6,), relative to twice its area (Duffy 1982)."""
    p, q, e0, e1, f0, f1 = triangle[0], triangle[1], triangle[2], triangle[3], triangle[4], triangle[5]
    along, across = rules
    total = 0.0
    for i in range(along[0].shape[0]):
        out = along[0][i]
        for j in range(across[0].shape[0]):
            turn = across[0][j]
            x = p + out * ((1.0 - turn) * e0 + turn * f0)
            y = q + out * ((1.0 - turn) * e1 + turn * f1)
            far = 1.0 / (from_wall[2, 0] * x + from_wall[2, 1] * y + from_wall[2, 2])
            total += along[1][i] * out * across[1][j] * radiance(x, y, patch) * abs(far) ** 3
    return total
