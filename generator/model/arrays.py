"""Types of arrays and vectors, and rotations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]


Range = tuple[float, float]


Array = NDArray[np.float64]


def rotation_rows(angles: Array) -> list[list[Any]]:
    """Return the rows of `rotation_matrix` for three angles in radians, each a number or an array."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    return [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]


def rotation_matrix(rotation: Vector) -> Array:
    """Return the (3, 3) matrix that turns about x, then y, then z (Blender's XYZ order), angles in degrees."""
    return np.array(rotation_rows(np.radians(rotation)))
