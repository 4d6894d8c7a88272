"""The pair sums at the heart of the integral: lit patch to surface elements, and elements to points of the wall.

Everything here is in a frame whose origin lies on the relay wall and whose third axis is the wall's normal, so a wall
point is (a, b, 0) and an element stands at height h. The frame is close to the points at hand: coordinate differences
then keep all their digits, in float32 too, however far the scene is from its own origin.

Each sum has two forms, loops for numba and arrays for NumPy; tests check that they agree to rounding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.transport.compiled import COMPILED, jit_in_place, jit_loops, jit_released

Floats = NDArray[Any]

BEYOND = -1e30
"""A floor that no value reaches, not even in single precision."""


def _radiance_loops(a: Floats, b: Floats, elements: Floats, count: int, floor: float, total: Floats) -> None:
    """Add to ``total`` the light that the wall points (a, b, 0) receive from surface elements.

        total_k += sum_j  max(floor, n_j . d h_j) / |d|^4,    d = w_k - x_j

    which is cos_x cos_w / |d|^2 (Lambert's cosine on both sides) with the element's strength in the length of n_j.

    Parameters
    ----------
    a, b : ndarray of shape (k,)
        Wall points.
    elements : ndarray of shape (6, capacity)
        Rows: position along the two wall axes, height, and the normal's three components times strength.
    count : int
        Number of columns that are filled.
    floor : float
        0; or `BEYOND`, for light continued below a face's horizon, as negative values, smoothly across it.
    total : ndarray of shape (k,), added to
    """
    least = a.dtype.type(floor)
    pairs = count // 2
    for pair in range(pairs):
        i, j = 2 * pair, 2 * pair + 1
        a0, b0, h0 = elements[0, i], elements[1, i], elements[2, i]
        p0, q0, c0 = elements[3, i] * h0, elements[4, i] * h0, -elements[5, i] * h0 * h0
        a1, b1, h1 = elements[0, j], elements[1, j], elements[2, j]
        p1, q1, c1 = elements[3, j] * h1, elements[4, j] * h1, -elements[5, j] * h1 * h1
        s0, s1 = h0 * h0, h1 * h1
        for k in range(a.shape[0]):
            u0, v0 = a[k] - a0, b[k] - b0
            u1, v1 = a[k] - a1, b[k] - b1
            d0 = u0 * u0 + (v0 * v0 + s0)
            d1 = u1 * u1 + (v1 * v1 + s1)
            n0 = max(least, p0 * u0 + (q0 * v0 + c0))
            n1 = max(least, p1 * u1 + (q1 * v1 + c1))
            d0 = d0 * d0
            d1 = d1 * d1
            # One division for two elements, because divisions limit the speed of this loop.
            total[k] += (n0 * d1 + n1 * d0) / (d0 * d1)
    for i in range(2 * pairs, count):
        a0, b0, h0 = elements[0, i], elements[1, i], elements[2, i]
        p0, q0, c0 = elements[3, i] * h0, elements[4, i] * h0, -elements[5, i] * h0 * h0
        for k in range(a.shape[0]):
            u0, v0 = a[k] - a0, b[k] - b0
            d0 = u0 * u0 + (v0 * v0 + h0 * h0)
            total[k] += max(least, p0 * u0 + (q0 * v0 + c0)) / (d0 * d0)


def _radiance_arrays(a: Floats, b: Floats, elements: Floats, count: int, floor: float, total: Floats) -> None:
    """NumPy form of `_radiance_loops`."""
    x, y, h, p, q, r = elements[:, :count]
    u, v = a[:, None] - x, b[:, None] - y
    squared = u * u + (v * v + h * h)
    facing = np.maximum(p * h * u + (q * h * v - r * h * h), floor)
    total += (facing / (squared * squared)).sum(axis=1)


radiance = jit_released(_radiance_loops) if COMPILED else _radiance_arrays


def _irradiance_loops(x: Floats, n: Floats, nodes: Floats, count: int) -> float:
    """Return the irradiance that a surface point receives from the lit patch.

        E = sum_q  w_q L_q max(0, n . v) h / |v|^4,    v = p_q - x,  h = height of x

    Parameters
    ----------
    x, n : ndarray of shape (3,)
        The point and its unit normal.
    nodes : ndarray of shape (3, capacity)
        Rows: the patch's points along the two wall axes, and radiance times area.
    count : int
        Number of columns that are filled.
    """
    total = 0.0
    for q in range(count):
        u, v = nodes[0, q] - x[0], nodes[1, q] - x[1]
        squared = u * u + v * v + x[2] * x[2]
        total += nodes[2, q] * max(0.0, n[0] * u + n[1] * v - n[2] * x[2]) * x[2] / (squared * squared)
    return total


def _irradiance_arrays(x: Floats, n: Floats, nodes: Floats, count: int) -> float:
    """NumPy form of `_irradiance_loops`."""
    p, q, weight = nodes[:, :count]
    u, v = p - x[0], q - x[1]
    squared = u * u + v * v + x[2] * x[2]
    facing = np.maximum(n[0] * u + n[1] * v - n[2] * x[2], 0)
    return float((weight * facing * x[2] / (squared * squared)).sum())


irradiance = jit_released(_irradiance_loops) if COMPILED else _irradiance_arrays


@jit_in_place
def irradiance_gradient(x: Floats, n: Floats, nodes: Floats, count: int, gradient: Floats) -> float:
    """Return the irradiance as `irradiance` does, and write its derivatives to ``gradient``.

    Parameters
    ----------
    gradient : ndarray of shape (6,), written
        dE/dx (3) and dE/dn (3). Where the horizon of the surface cuts the patch the integrand is zero, so a moving
        horizon adds nothing.
    """
    total = 0.0
    gradient[:] = 0.0
    h = x[2]
    for q in range(count):
        u, v, w = nodes[0, q] - x[0], nodes[1, q] - x[1], -h
        facing = n[0] * u + n[1] * v + n[2] * w
        if facing <= 0.0:
            continue
        squared = u * u + v * v + h * h
        base = nodes[2, q] / (squared * squared)
        total += base * facing * h
        along = 4.0 * base * facing * h / squared
        gradient[0] += along * u - base * h * n[0]
        gradient[1] += along * v - base * h * n[1]
        gradient[2] += along * w - base * h * n[2] + base * facing
        gradient[3] += base * h * u
        gradient[4] += base * h * v
        gradient[5] += base * h * w
    return total


@jit_loops
def radiance_gradient(
    a: Floats, b: Floats, elements: Floats, moves: Floats, count: int, floor: float, total: Floats
) -> None:
    """Add to ``total`` what `radiance` adds, and its derivatives with respect to a rigid motion of the elements.

    Parameters
    ----------
    a, b : ndarray of shape (k,)
        Wall points.
    elements : ndarray of shape (6, capacity)
        As for `radiance`, but the normals are of unit length.
    moves : ndarray of shape (10, capacity)
        Rows: strength, its derivatives with respect to three translations and three rotations, and the element's
        position relative to the point it turns about.
    count : int
    floor : float
        As for `radiance`.
    total : ndarray of shape (7, k), added to
        The sum, and its derivatives with respect to translation (3) and rotation about the three axes (3).
    """
    for j in range(count):
        x0, y0, h = elements[0, j], elements[1, j], elements[2, j]
        n0, n1, n2 = elements[3, j], elements[4, j], elements[5, j]
        strength = moves[0, j]
        l0, l1, l2 = moves[7, j], moves[8, j], moves[9, j]
        for k in range(a.shape[0]):
            d0, d1, d2 = a[k] - x0, b[k] - y0, -h
            facing = n0 * d0 + n1 * d1 + n2 * d2
            if facing <= floor:
                continue
            squared = d0 * d0 + d1 * d1 + d2 * d2
            base = h / (squared * squared)
            value = facing * base
            total[0, k] += strength * value
            # With respect to the element's position ...
            along = 4.0 * value / squared
            g0 = strength * (along * d0 - n0 * base)
            g1 = strength * (along * d1 - n1 * base)
            g2 = strength * (along * d2 - n2 * base + facing / (squared * squared))
            # ... and to its normal, which turns with it: w x n.
            m0, m1, m2 = strength * base * d0, strength * base * d1, strength * base * d2
            total[1, k] += moves[1, j] * value + g0
            total[2, k] += moves[2, j] * value + g1
            total[3, k] += moves[3, j] * value + g2
            total[4, k] += moves[4, j] * value + (l1 * g2 - l2 * g1) + (n1 * m2 - n2 * m1)
            total[5, k] += moves[5, j] * value + (l2 * g0 - l0 * g2) + (n2 * m0 - n0 * m2)
            total[6, k] += moves[6, j] * value + (l0 * g1 - l1 * g0) + (n0 * m1 - n1 * m0)
