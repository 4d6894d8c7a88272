"""Points and directions that are spread evenly, without chance: sums converge faster than over random ones."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[Any]
Numbers = NDArray[np.int64]

_BITS = 30
_POLYNOMIALS = ((0, ()), (0, (1,)), (1, (1, 3)), (1, (1, 3, 1)))
"""Inner coefficients of the primitive polynomial of each dimension, and its first direction numbers (Joe and Kuo
2008, table "new-joe-kuo-6"); the first dimension is van der Corput's."""


def sobol(count: int, dimensions: int, number: int = 0) -> Floats:
    """Return the first points (count, dimensions) of Sobol's sequence, shifted digit by digit so that none is zero.

    Parameters
    ----------
    count : int
        At most 2^30; powers of two are spread best.
    dimensions : int
        At most 4.
    number : int, default=0
        Of the shift: points that are shifted differently know nothing of each other.
    """
    shift = np.random.default_rng([dimensions, number]).integers(0, 1 << _BITS, dimensions)
    indices = np.arange(count)
    gray = indices ^ (indices >> 1)
    points = np.empty((count, dimensions))
    for dimension in range(dimensions):
        digits = np.full(count, shift[dimension])
        for bit, direction in enumerate(_directions(dimension)):
            if count >> bit == 0:
                break
            digits ^= np.where(gray >> bit & 1, direction, 0)
        points[:, dimension] = (digits + 0.5) / (1 << _BITS)
    return points


def _directions(dimension: int) -> list[int]:
    """Return the direction numbers of a dimension, as fixed-point fractions (Bratley and Fox 1988, section 2)."""
    coefficients, first = _POLYNOMIALS[dimension]
    degree = len(first)
    if not degree:
        return [1 << (_BITS - 1 - bit) for bit in range(_BITS)]
    numbers = [m << (_BITS - 1 - bit) for bit, m in enumerate(first)]
    for bit in range(degree, _BITS):
        new = numbers[bit - degree] ^ numbers[bit - degree] >> degree
        for k in range(1, degree):
            if coefficients >> (degree - 1 - k) & 1:
                new ^= numbers[bit - k]
        numbers.append(new)
    return numbers


def lattice(count: int, dimensions: int) -> Floats:
    """Return points (count, dimensions) spread evenly over the unit cube: multiples of powers of the root of
    x^(d+1) = x + 1 (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
    """
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1)
    spread: Floats = (0.5 + np.arange(count)[:, None] * steps) % 1.0
    return spread


def shifted(count: int, dimensions: int, owners: Numbers) -> Floats:
    """Return the lattice (owners, count, dimensions), shifted for each owner so that their errors differ."""
    points: Floats = (lattice(count, dimensions)[None] + shifts(dimensions, owners)[:, None]) % 1.0
    return points


def shifts(dimensions: int, owners: Numbers) -> Floats:
    """Return the shift (owners, dimensions) of each owner."""
    found: Floats = np.random.default_rng(dimensions).random((int(owners.max(initial=-1)) + 1, dimensions))[owners]
    return found


def squares(count: int) -> Floats:
    """Return the centres (count^2, 2) of equal squares of the unit square."""
    steps = (np.arange(count) + 0.5) / count
    return np.stack([np.repeat(steps, count), np.tile(steps, count)], axis=1)


def _beside(axis: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors (n, 3) at right angles to unit vectors (n, 3) (Duff et al. 2017, listing 2)."""
    x, y, z = axis.T
    sign = np.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], 1), np.stack([b, sign + y * y * a, -y], 1)


def around(axis: Floats, cosine: Floats, angle: Floats) -> Floats:
    """Return unit vectors (n, 3) at given cosines (n,) to axes (n, 3) and angles (n,) around them."""
    sine = np.sqrt(np.maximum(0.0, 1.0 - cosine**2))
    first, second = _beside(axis)
    across = (sine * np.cos(angle))[:, None] * first + (sine * np.sin(angle))[:, None] * second
    vectors: Floats = cosine[:, None] * axis + across
    return vectors


def hemisphere(normals: Floats, spread: Floats) -> Floats:
    """Return directions (n, 3) about normals (n, 3), of cosine density, for points (n, 2) of the unit square."""
    return around(normals, np.sqrt(1.0 - spread[:, 0]), 2.0 * math.pi * spread[:, 1])
