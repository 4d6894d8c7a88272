"""A picture from panels: polynomials on as few panels as its smoothness allows, averaged over each pixel's box.

Light that has been reflected by the target falls on the wall as a smooth function, so a picture of any resolution is
held by a few hundred of its values. A panel is a box of the picture with m x m Gauss points; their Legendre
coefficients say how well they hold the function, and a panel that holds it badly is cut in four. Pixels are exact
integrals of the polynomials over their boxes, as Cycles' box filter asks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander
from numpy.typing import NDArray

from generator.transport.compiled import jit, jit_parallel, prange

Floats = NDArray[Any]

Evaluate = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""Given owners (n,) and boxes (n, 4), return values (n, channels, m * m + 4), the last at the corners, and the ratio
radius / distance (n,)."""

MAX_DEPTH = 24
_TOO_NEAR = 8.0


@dataclass(frozen=True)
class Panels:
    """What a picture was made of.

    Attributes
    ----------
    count : ndarray of shape (pictures,), int
        Panels.
    depth : ndarray of shape (pictures,), int
        How often the smallest was cut.
    error : ndarray of shape (pictures,)
        Root mean square of what the polynomials leave out, estimated, relative to the picture's.
    """

    count: Floats
    depth: Floats
    error: Floats


class Rule:
    """Gauss points of a panel, and what turns values there into Legendre coefficients.

    Parameters
    ----------
    m : int
        Points along a side.
    """

    def __init__(self, m: int) -> None:
        x, w = leggauss(m)
        self.m = m
        self.points = (x + 1.0) / 2.0
        self.weights = np.outer(w, w).ravel() / 4.0
        n = np.arange(m)
        one = ((2 * n + 1) / 2.0)[:, None] * (legvander(x, m - 1) * w[:, None]).T
        self.transform = np.kron(one, one)
        norms = 1.0 / (2 * n + 1)
        self._energy = np.outer(norms, norms).ravel()
        high = np.maximum(n[:, None], n[None, :]).ravel() >= m - 2
        self._tail = np.where(high, self._energy, 0.0)
        # At a corner every Legendre polynomial is 1 or -1.
        ends = np.stack([(-1.0) ** n, np.ones(m)])
        self._corners = np.stack([np.outer(ends[k // 2], ends[k % 2]).ravel() for k in range(4)])

    def coefficients(self, values: Floats) -> Floats:
        """Return Legendre coefficients (..., m * m) of values (..., m * m + 4)."""
        made: Floats = values[..., : self.m**2] @ self.transform.T
        return made

    def mean_square(self, coefficients: Floats) -> Floats:
        """Return the mean square over the panel."""
        squared: Floats = coefficients**2 @ self._energy
        return squared

    def tail_square(self, coefficients: Floats, values: Floats) -> Floats:
        """Return the mean square of what the polynomial may leave out.

        That is the two highest degrees, far more than what is left out if they fall off; and what is wrong at the
        corners: light that enters there may stay between them and the first points, a share 1 / m^2 of the panel.
        """
        missed = coefficients @ self._corners.T - values[..., self.m**2 :]
        squared: Floats = coefficients**2 @ self._tail + (missed**2).max(axis=-1) / self.m**2
        return squared


def draw(
    evaluate: Evaluate,
    rule: Rule,
    pictures: int,
    channels: int,
    resolution: tuple[int, int],
    accuracy: float,
    *,
    level: Floats | None = None,
    kin: Callable[[Floats], Floats] | None = None,
) -> tuple[Floats, Panels]:
    """Draw pictures of a function that can be evaluated on panels.

    Parameters
    ----------
    evaluate : callable
    rule : Rule
    pictures, channels : int
    resolution : (int, int)
        Width and height, pixels.
    accuracy : float
        Root mean square of the error, relative to that of the picture, channel by channel.
    level : ndarray of shape (pictures, channels), optional
        A mean square that errors are relative to where it is larger than the picture's own.
    kin : callable, optional
        Makes of all channels' mean squares (pictures, channels) those that errors are relative to.

    Returns
    -------
    pixels : ndarray of shape (pictures, channels, height, width)
        Means over the pixels' boxes.
    panels : Panels
    """
    width, height = resolution
    out = np.zeros((pictures, channels, height, width))
    owner, boxes = np.arange(pictures), np.tile([0.0, 1.0, 0.0, 1.0], (pictures, 1))
    settled, lost = np.zeros((pictures, channels)), np.zeros((pictures, channels))
    count, depth = np.zeros(pictures, dtype=np.int64), np.zeros(pictures, dtype=np.int64)
    # Peaks of the size of the target's distance can hide between points down to this size of a panel.
    smallest = 2.0 * math.sqrt(accuracy) / max(width, height)
    for cut in range(MAX_DEPTH + 1):
        values, nearness = evaluate(owner, boxes)
        coefficients = rule.coefficients(values)
        size = 0.5**cut
        area = size * size
        square, tail = area * rule.mean_square(coefficients), area * rule.tail_square(coefficients, values)
        norm = settled.copy()
        np.add.at(norm, owner, square)
        if level is not None:
            norm = np.maximum(norm, level)
        if kin is not None:
            norm = kin(norm)
        # Small panels may err more: those along a line are few for their size.
        allowed = (0.7 * accuracy) ** 2 * norm[owner] * area * 2.0**cut
        good = (tail <= allowed).all(axis=1) & ((nearness <= _TOO_NEAR) | (size < smallest))
        if cut == MAX_DEPTH:
            good[:] = True
        deposit(out, owner[good], boxes[good], coefficients[good])
        np.add.at(settled, owner[good], square[good])
        np.add.at(lost, owner[good], tail[good])
        np.add.at(count, owner[good], 1)
        depth[owner] = cut
        rest = ~good
        if not rest.any():
            break
        owner, boxes = np.repeat(owner[rest], 4), _quarters(boxes[rest])
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.where(settled > 0.0, np.sqrt(lost / settled), 0.0).max(axis=1, initial=0.0)
    return out, Panels(count, depth, error)


def _quarters(boxes: Floats) -> Floats:
    u0, u1, v0, v1 = boxes.T
    u, v = (u0 + u1) / 2.0, (v0 + v1) / 2.0
    parts = [(u0, u, v0, v), (u, u1, v0, v), (u0, u, v, v1), (u, u1, v, v1)]
    return np.stack([np.stack(p, axis=-1) for p in parts], axis=1).reshape(-1, 4)


def deposit(out: Floats, owner: Floats, boxes: Floats, coefficients: Floats) -> None:
    """Add the integrals of panels' polynomials over pixels to the pictures.

    Parameters
    ----------
    out : ndarray of shape (pictures, channels, height, width), added to
    owner : ndarray of shape (n,), int
    boxes : ndarray of shape (n, 4)
    coefficients : ndarray of shape (n, channels, m * m)
        Along u fastest.
    """
    if len(owner):
        order = np.argsort(owner, kind="stable")
        starts = np.flatnonzero(np.diff(owner[order], prepend=-1))
        _deposit(out, owner, order, np.append(starts, len(owner)), boxes, coefficients)


@jit
def _shares(low: float, high: float, pixels: int, m: int) -> tuple[int, Floats]:
    """Integrals of Legendre polynomials on [low, high] over the pixels that it meets, in pixels.

    Uses (2 n + 1) P_n = d/dx (P_(n+1) - P_(n-1)).

    Returns
    -------
    first : int
        The first of these pixels.
    shares : ndarray of shape (pixels met, m)
    """
    slack = 1e-9
    first = min(pixels - 1, max(0, math.floor(low * pixels + slack)))
    last = min(pixels - 1, max(first, math.ceil(high * pixels - slack) - 1))
    shares = np.zeros((last - first + 1, m))
    scale = (high - low) * pixels / 2.0
    edge = np.empty((2, m + 1))
    for p in range(first, last + 1):
        for e in range(2):
            x = 2.0 * ((p + e) / pixels - low) / (high - low) - 1.0
            x = min(1.0, max(-1.0, x))
            edge[e, 0] = 1.0
            edge[e, 1] = x
            for n in range(1, m):
                edge[e, n + 1] = ((2 * n + 1) * x * edge[e, n] - n * edge[e, n - 1]) / (n + 1)
        shares[p - first, 0] = scale * (edge[1, 1] - edge[0, 1])
        for n in range(1, m):
            rise = edge[1, n + 1] - edge[1, n - 1] - edge[0, n + 1] + edge[0, n - 1]
            shares[p - first, n] = scale * rise / (2 * n + 1)
    return first, shares


@jit_parallel
def _deposit(out: Floats, owner: Floats, order: Floats, starts: Floats, boxes: Floats, coefficients: Floats) -> None:
    height, width = out.shape[2], out.shape[3]
    m = int(math.sqrt(coefficients.shape[2]) + 0.5)
    for run in prange(starts.shape[0] - 1):
        for k in range(starts[run], starts[run + 1]):
            item = order[k]
            first_column, across = _shares(boxes[item, 0], boxes[item, 1], width, m)
            first_row, down = _shares(boxes[item, 2], boxes[item, 3], height, m)
            across_t = np.ascontiguousarray(across.T)
            for c in range(out.shape[1]):
                block = np.dot(down, np.dot(np.ascontiguousarray(coefficients[item, c]).reshape(m, m), across_t))
                rows, columns = block.shape
                into = out[owner[item], c]
                into[first_row : first_row + rows, first_column : first_column + columns] += block
