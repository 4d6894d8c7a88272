"""The lit patch: the light that it sends, and how many of its points are needed to compute that."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from generator.transport.compiled import jit_in_place
from generator.transport.elements import distance_to_disc

Floats = NDArray[Any]

ORDERS = 40
"""Most quadrature points along a diameter of the lit patch: enough at a distance of a hundredth of its radius."""

# A data set of many objects makes a setting for each, and the rules are most of the work for a setting.
leggauss = cache(legendre.leggauss)


class Patch(NamedTuple):
    """The lit patch: an ellipse on the wall, of radiance 1 under the lamp.

    Attributes
    ----------
    x, y : float
        Centre.
    major_x, major_y, minor_x, minor_y : float
        Semi-axes.
    lamp_x, lamp_y, height : float
        Position of the lamp.
    axis_x, axis_y, axis_z : float
        Unit vector along which the lamp shines.
    cos_outer, cos_width : float
        Cosine of the cone's half angle, and by how much the cosine differs at the inner end of its soft edge.
    """

    x: float
    y: float
    major_x: float
    major_y: float
    minor_x: float
    minor_y: float
    lamp_x: float
    lamp_y: float
    height: float
    axis_x: float
    axis_y: float
    axis_z: float
    cos_outer: float
    cos_width: float

    @property
    def centre(self) -> Floats:
        """Its centre, (2,)."""
        return np.array([self.x, self.y])

    @property
    def major(self) -> Floats:
        """Its major semi-axis, (2,)."""
        return np.array([self.major_x, self.major_y])

    @property
    def minor(self) -> Floats:
        """Its minor semi-axis, (2,)."""
        return np.array([self.minor_x, self.minor_y])


class Rules(NamedTuple):
    """The patch, and the quadrature rules for its light.

    Attributes
    ----------
    patch : Patch
    whole : ndarray
        Quadrature rules of the whole patch (`whole_rules`).
    chords : ndarray
        Rules for parts of it (`chord_rules`).
    gauss : ndarray
        Rules of cells (`elements.GAUSS`).
    digits : float
        Natural logarithm of one over the quadrature's relative accuracy.
    """

    patch: Patch
    whole: Floats
    chords: Floats
    gauss: Floats
    digits: float


@jit_in_place
def radius_of(patch: Patch) -> float:
    """Return the length of the patch's major semi-axis."""
    return math.sqrt(patch.major_x**2 + patch.major_y**2)


@jit_in_place
def distance_to(x: Floats, patch: Patch) -> float:
    """Return the distance from a point to the disc around the lit patch."""
    return distance_to_disc(x, patch.x, patch.y, radius_of(patch))


@jit_in_place
def radiance(p: float, q: float, patch: Patch) -> float:
    """Return the radiance of the lit patch at a wall point, in units of albedo / pi * intensity / height^2."""
    u, v, w = p - patch.lamp_x, q - patch.lamp_y, -patch.height
    far = math.sqrt(u * u + v * v + w * w)
    ratio = patch.height / far
    value = ratio * ratio * ratio
    if patch.cos_width > 0.0:
        cosine = (u * patch.axis_x + v * patch.axis_y + w * patch.axis_z) / far
        step = min(1.0, max(0.0, (cosine - patch.cos_outer) / patch.cos_width))
        value *= step * step * (3.0 - 2.0 * step)
    return value


def whole_rules(patch: Patch) -> Floats:
    """Return quadrature rules of the whole lit patch, (ORDERS + 1, 3, ORDERS^2), rule k with k^2 points.

    Chebyshev points of the second kind across the disc (their weight, the square of the sine, is the disc's own) and
    Gauss points along each chord.
    """
    rules = np.zeros((ORDERS + 1, 3, ORDERS**2))
    centre, major, minor = patch.centre, patch.major, patch.minor
    area = abs(major[0] * minor[1] - major[1] * minor[0])
    for k in range(1, ORDERS + 1):
        alpha = np.pi * np.arange(1, k + 1) / (k + 1)
        t, weight = leggauss(k)
        s, reach = np.cos(alpha)[:, None] + 0.0 * t, np.sin(alpha)[:, None] * t
        points = centre + s.reshape(-1, 1) * major + reach.reshape(-1, 1) * minor
        weights = area * (np.pi / (k + 1) * np.sin(alpha) ** 2)[:, None] * weight
        rules[k, 0, : k * k], rules[k, 1, : k * k] = points.T
        rules[k, 2, : k * k] = weights.ravel() * _sent(points, patch)
    return rules


def _sent(points: Floats, patch: Patch) -> Floats:
    """Return what `radiance` does, of all points (n, 2) at once: a set of many lamps makes the rules of each."""
    u, v, w = points[:, 0] - patch.lamp_x, points[:, 1] - patch.lamp_y, -patch.height
    far = np.sqrt(u * u + v * v + w * w)
    ratio = patch.height / far
    values: Floats = ratio * ratio * ratio
    if patch.cos_width > 0.0:
        cosine = (u * patch.axis_x + v * patch.axis_y + w * patch.axis_z) / far
        step = np.clip((cosine - patch.cos_outer) / patch.cos_width, 0.0, 1.0)
        values = values * (step * step * (3.0 - 2.0 * step))
    return values


@cache
def chord_rules() -> Floats:
    """Return Gauss points and weights on [0, 1], (ORDERS + 1, 2, ORDERS), for `clip`."""
    rules = np.zeros((ORDERS + 1, 2, ORDERS))
    for k in range(1, ORDERS + 1):
        x, w = leggauss(k)
        rules[k, 0, :k], rules[k, 1, :k] = (x + 1.0) / 2.0, w / 2.0
    return rules


@jit_in_place
def order_at(x: Floats, patch: Patch, digits: float) -> int:
    """Return the number of points along the patch's diameter that a surface point needs: fewer at larger distance."""
    return order_for(distance_to(x, patch), patch, digits)


@jit_in_place
def order_for(distance: float, patch: Patch, digits: float) -> int:
    """Return the number of points along the patch's diameter for light that varies over a distance."""
    ratio = distance / radius_of(patch)
    rate = 2.0 * math.log(ratio + math.sqrt(1.0 + ratio * ratio))
    order = 1 if patch.cos_width == 0.0 else 12  # a soft edge is smooth only piecewise
    # As for cells (`elements.points_wanted`), but with the pole above the disc's middle instead of outside its rim.
    while order < ORDERS - 4 and order * rate - 3.0 * math.log(2.0 * order) < digits:
        order += 1
    return order


@jit_in_place
def chord_order(order: int, arc: float, digits: float) -> int:
    """Return the number of points for half of the visible part of the patch's edge, an arc of the unit circle.

    Gauss's rule needs arc / 2 times the points of equal steps around the circle (Trefethen 2008, section 5), and as
    many as the light's own Fourier series, up to cos(3 alpha) / 4, requires: its error is a Bessel function of
    order 2 k at 3 arc / 2 (Abramowitz and Stegun 9.1.62).
    """
    k = order + 3 if arc < 2.0 else math.ceil(order * arc / 2.0) + 3
    while k < ORDERS and 2.0 * k * math.log(0.75 * arc) - math.lgamma(2.0 * k + 1.0) > math.log(4.0) - digits:
        k += 1
    return min(k, ORDERS)


@jit_in_place
def clip(x: Floats, n: Floats, patch: Patch, rule: Floats, order: int, nodes: Floats) -> int:
    """Write quadrature points of the part of the lit patch that a surface point can see; return their number.

    The surface's horizon cuts the ellipse along a chord. In the unit disc, with s across the chord and t along it,
    s = cos(alpha) turns the disc's edge into a smooth integrand over alpha, so Gauss's rule converges however small
    the part.

    Parameters
    ----------
    x, n : ndarray of shape (3,)
    patch : Patch
    rule : ndarray of shape (2, order)
        Gauss points and weights on [0, 1].
    order : int
    nodes : ndarray of shape (3, capacity), written
        As for `kernel.irradiance`.
    """
    c0, c1 = patch.x, patch.y
    j0, j1, m0, m1 = patch.major_x, patch.major_y, patch.minor_x, patch.minor_y
    level = n[0] * (c0 - x[0]) + n[1] * (c1 - x[1]) - n[2] * x[2]
    g0, g1 = n[0] * j0 + n[1] * j1, n[0] * m0 + n[1] * m1
    steep = math.sqrt(g0 * g0 + g1 * g1)
    if level <= -steep:
        return 0
    start = math.pi
    if level < steep:
        start = math.acos(max(-1.0, -level / steep))
    if steep > 0.0:
        g0, g1 = g0 / steep, g1 / steep
    else:
        g0, g1 = 1.0, 0.0
    area = abs(j0 * m1 - j1 * m0)
    count = 0
    for i in range(order):
        alpha = start * rule[0, i]
        s, reach = math.cos(alpha), math.sin(alpha)
        for j in range(order):
            t = reach * (2.0 * rule[0, j] - 1.0)
            e, f = s * g0 - t * g1, s * g1 + t * g0
            p, q = c0 + e * j0 + f * m0, c1 + e * j1 + f * m1
            nodes[0, count], nodes[1, count] = p, q
            weight = reach * reach * start * rule[1, i] * 2.0 * rule[1, j] * area
            nodes[2, count] = weight * radiance(p, q, patch)
            count += 1
    return count


@jit_in_place
def seen_from(x: Floats, n: Floats, rules: Rules, nodes: Floats) -> tuple[int, int]:
    """Find the quadrature points of the part of the patch that a surface point sees.

    Returns
    -------
    whole : int
        Index of the rule in ``rules.whole`` that holds them; -1 if the point does not see all of the patch and they
        are written to ``nodes``.
    number : int
    """
    return seen_with(x, n, rules, order_at(x, rules.patch, rules.digits), nodes)


@jit_in_place
def seen_with(x: Floats, n: Floats, rules: Rules, order: int, nodes: Floats) -> tuple[int, int]:
    """As `seen_from`, with ``order`` points along the patch's diameter."""
    patch = rules.patch
    level = n[0] * (patch.x - x[0]) + n[1] * (patch.y - x[1]) - n[2] * x[2]
    across, along = n[0] * patch.major_x + n[1] * patch.major_y, n[0] * patch.minor_x + n[1] * patch.minor_y
    steep = math.sqrt(across**2 + along**2)
    if level >= steep:
        return order, order * order
    if level <= -steep:
        return -1, 0
    order = chord_order(order, math.acos(max(-1.0, min(1.0, -level / steep))), rules.digits)
    return -1, clip(x, n, patch, rules.chords[order], order, nodes)
