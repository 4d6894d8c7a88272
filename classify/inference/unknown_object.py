"""An object of unknown size and albedo: the amounts of light that it adds and hides are integrated out.

An object at a pose adds light in proportion to its size and albedo, and hides light of the room in proportion to its
size alone. So its code is ``a added + b hiding`` with strengths a and b, and with a normal prior for these the
likelihood of a picture has a closed form (linear Gaussian model: Rasmussen and Williams 2006, section 2.1; the
determinant and the inverse by Woodbury's identity).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[Any]

SIZE, ALBEDO = (0.7, 0.5), (0.8, 0.25)
"""Mean and standard deviation of an object's cross-section and albedo, relative to those of the atlas' object."""

MEAN = np.array([SIZE[0] * ALBEDO[0], SIZE[0]])
_SQUARES = SIZE[0] ** 2 + SIZE[1] ** 2, ALBEDO[0] ** 2 + ALBEDO[1] ** 2
COVARIANCE = np.array(
    [
        [_SQUARES[0] * _SQUARES[1] - MEAN[0] ** 2, ALBEDO[0] * SIZE[1] ** 2],
        [ALBEDO[0] * SIZE[1] ** 2, SIZE[1] ** 2],
    ]
)
"""Covariance of the strengths: size times albedo for the added light, size for the hidden light."""


@dataclass(frozen=True)
class AmplitudePrior:
    """Terms of the likelihood that do not depend on the picture, pose by pose.

    Attributes
    ----------
    shift : ndarray of shape (n, 2)
        Products of the code at the mean strengths with the codes of added and of hidden light.
    spread : ndarray of shape (n, 3)
        Posterior covariance of the strengths: first variance, covariance, second variance.
    rest : ndarray of shape (n,)
        Remaining terms of the logarithm.
    """

    shift: Floats
    spread: Floats
    rest: Floats

    @classmethod
    def of(cls, added: Floats, hiding: Floats) -> AmplitudePrior:
        """Return the terms for codes (n, k) of the added light and of the hidden light (negative)."""
        gram = np.stack([np.einsum("nk,nk->n", a, b) for a, b in ((added, added), (added, hiding), (hiding, hiding))])
        gram = gram.astype(np.float64)
        matrix = np.moveaxis(np.array([[gram[0], gram[1]], [gram[1], gram[2]]]), 2, 0)
        shift = matrix @ MEAN
        spread = np.linalg.inv(np.linalg.inv(COVARIANCE) + matrix)
        determinant = np.linalg.slogdet(np.eye(2) + COVARIANCE @ matrix)[1]
        rest = -0.5 * (shift @ MEAN) - 0.5 * determinant
        dtype = added.dtype
        entries = np.stack([spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]], axis=1)
        return cls(shift.astype(dtype), entries.astype(dtype), rest.astype(dtype))

    def logs(self, added: Floats, hiding: Floats) -> Floats:
        """Return the logarithm of the likelihood ratio to an empty scene.

        Parameters
        ----------
        added, hiding : ndarray of shape (..., n)
            Products of the picture's code with the codes given to `of`.
        """
        first, second = added - self.shift[:, 0], hiding - self.shift[:, 1]
        gain = self.spread[:, 0] * first**2 + 2.0 * self.spread[:, 1] * first * second
        gain += self.spread[:, 2] * second**2
        dtype = added.dtype.type
        logs: Floats = dtype(MEAN[0]) * added + dtype(MEAN[1]) * hiding + dtype(0.5) * gain + self.rest
        return logs

    def means(self, added: Floats, hiding: Floats) -> Floats:
        """Return the posterior means of the two strengths, (..., n, 2), from the same products."""
        first, second = added - self.shift[:, 0], hiding - self.shift[:, 1]
        means: Floats = np.stack(
            [
                MEAN[0] + self.spread[:, 0] * first + self.spread[:, 1] * second,
                MEAN[1] + self.spread[:, 1] * first + self.spread[:, 2] * second,
            ],
            axis=-1,
        )
        return means
