"""An object of unknown size and albedo: how much light it adds and how much it hides are integrated out.

An object at a pose adds light in proportion to its size and albedo, and hides the room's in proportion to its size
alone. So its code is ``a added + b hiding``, whatever a and b are, and with a normal prior for the two the likelihood
of a picture has a closed form (linear Gaussian model: Rasmussen and Williams 2006, section 2.1; the determinant and
the inverse by Woodbury's identity).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[Any]

SIZE, ALBEDO = (0.7, 0.5), (0.8, 0.25)
"""Mean and standard deviation of an object's cross-section and of its albedo, in those of the atlas' object."""

MEAN = np.array([SIZE[0] * ALBEDO[0], SIZE[0]])
_SQUARES = SIZE[0] ** 2 + SIZE[1] ** 2, ALBEDO[0] ** 2 + ALBEDO[1] ** 2
COVARIANCE = np.array(
    [
        [_SQUARES[0] * _SQUARES[1] - MEAN[0] ** 2, ALBEDO[0] * SIZE[1] ** 2],
        [ALBEDO[0] * SIZE[1] ** 2, SIZE[1] ** 2],
    ]
)
"""Of the strengths: what is added is size times albedo, what is hidden is size."""


@dataclass(frozen=True)
class AmplitudePrior:
    """What of the likelihood does not depend on the picture, pose by pose.

    Attributes
    ----------
    shift : ndarray of shape (n, 2)
        Of a code's products with what is added and hidden, at the mean strengths.
    spread : ndarray of shape (n, 3)
        Posterior covariance of the strengths: first, mixed, second.
    rest : ndarray of shape (n,)
        What is left of the logarithm.
    """

    shift: Floats
    spread: Floats
    rest: Floats

    @classmethod
    def of(cls, added: Floats, hiding: Floats) -> AmplitudePrior:
        """Return them for codes (n, k) of what is added and of what is hidden (negative light)."""
        gram = np.stack([np.einsum("nk,nk->n", a, b) for a, b in ((added, added), (added, hiding), (hiding, hiding))])
        gram = gram.astype(np.float64)
        matrix = np.moveaxis(np.array([[gram[0], gram[1]], [gram[1], gram[2]]]), 2, 0)
        shift = matrix @ MEAN
        spread = np.linalg.inv(np.linalg.inv(COVARIANCE) + matrix)
        determinant = np.linalg.slogdet(np.eye(2) + COVARIANCE @ matrix)[1]
        rest = -0.5 * (shift @ MEAN) - 0.5 * determinant
        kind = added.dtype
        three = np.stack([spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]], axis=1)
        return cls(shift.astype(kind), three.astype(kind), rest.astype(kind))

    def logs(self, added: Floats, hiding: Floats) -> Floats:
        """Return the logarithm of the likelihood ratio to an empty scene.

        Parameters
        ----------
        added, hiding : ndarray of shape (..., n)
            Products of the picture's code with those of `of`.
        """
        first, second = added - self.shift[:, 0], hiding - self.shift[:, 1]
        gained = self.spread[:, 0] * first**2 + 2.0 * self.spread[:, 1] * first * second
        gained += self.spread[:, 2] * second**2
        kind = added.dtype.type
        logs: Floats = kind(MEAN[0]) * added + kind(MEAN[1]) * hiding + kind(0.5) * gained + self.rest
        return logs

    def means(self, added: Floats, hiding: Floats) -> Floats:
        """Return the posterior means of the two strengths, (..., n, 2), of the same products."""
        first, second = added - self.shift[:, 0], hiding - self.shift[:, 1]
        found: Floats = np.stack(
            [
                MEAN[0] + self.spread[:, 0] * first + self.spread[:, 1] * second,
                MEAN[1] + self.spread[:, 1] * first + self.spread[:, 2] * second,
            ],
            axis=-1,
        )
        return found
