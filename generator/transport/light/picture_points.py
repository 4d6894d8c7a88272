"""Points of the picture where smooth light is evaluated, and the polynomials that are fitted to it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander
from numpy.typing import NDArray

from generator.transport import picture

Floats = NDArray[Any]

DEGREES = 0.6
"""Polynomial coefficients per point, along a side."""


class PicturePoints:
    """A grid of Gauss points of the picture, and Legendre polynomials, fewer than points, that are fitted there.

    Parameters
    ----------
    to_wall : ndarray of shape (3, 3)
        Projective map from (u, v, 1) to the wall's two axes.
    points : int
        Number along a side.

    Attributes
    ----------
    places : ndarray of shape (points^2, 3)
        On the wall.
    fit : ndarray of shape (coefficients, points^2)
        Coefficients per value at the points, by least squares.
    """

    def __init__(self, to_wall: Floats, points: int) -> None:
        nodes, weights = leggauss(points)
        degrees = math.ceil(DEGREES * points)
        transform = (np.arange(degrees) + 0.5)[:, None] * (legvander(nodes, degrees - 1) * weights[:, None]).T
        basis = legvander(nodes, degrees - 1)
        self.fit, self._back = np.kron(transform, transform), np.kron(basis, basis)
        uv = (np.stack([np.tile(nodes, points), np.repeat(nodes, points)], axis=1) + 1.0) / 2.0
        homogeneous = np.concatenate([uv, np.ones((len(uv), 1))], axis=1) @ to_wall.T
        self.places = np.append(homogeneous[:, :2] / homogeneous[:, 2:], np.zeros((len(uv), 1)), axis=1)

    def misfit(self, light: Floats, coefficients: Floats) -> float:
        """Return the root mean square difference of polynomials (coefficients, n) from light (points, n)."""
        return math.sqrt(float(((light - self._back @ coefficients) ** 2).mean()))


def drawn(coefficients: Floats, resolution: tuple[int, int]) -> Floats:
    """Return pictures (n, height, width) with Legendre coefficients (coefficients, n) over the whole picture."""
    width, height = resolution
    out = np.zeros((1, coefficients.shape[1], height, width))
    whole = np.array([[0.0, 1.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]])
    picture.deposit(out, np.zeros(1, dtype=np.int64), whole[0], np.ascontiguousarray(coefficients.T)[None], whole[1])
    return out[0]
