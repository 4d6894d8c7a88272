"""The reflectance of microfacets, on arrays; `gloss` sums it.

It is that of Cycles' Glossy BSDF with the distribution GGX: Trowbridge and Reitz' slopes of width alpha = roughness^2
(Walter et al. 2007, equation 33), with Smith's height-correlated masking and shadowing (Heitz 2014, equation 99), and
no Fresnel term.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

Floats = NDArray[Any]


def pairs(alpha: Floats, cos_in: Floats, cos_out: Floats, between: Floats) -> Floats:
    """Return `gloss.pair` of arrays."""
    width = alpha * alpha
    rest, half = 1.0 - width, 2.0 + 2.0 * between
    spread = half - rest * (cos_in + cos_out) ** 2
    masked = cos_out * np.sqrt(width + rest * cos_in**2) + cos_in * np.sqrt(width + rest * cos_out**2)
    reflectance: Floats = 0.5 * width * half * half / (spread * spread * masked)
    return reflectance


def albedo(alpha: float, cosines: Floats) -> Floats:
    """Return the share of light that white facets reflect once, by the cosine of its direction (n,).

    The integral goes over directions by Gauss's rule, whose points are close around the mirrored one (by the
    hyperbolic sine, which moves poles at 2 alpha from there away).
    """
    x, w = leggauss(128 if alpha < 0.1 else 64)
    shares = np.empty(len(cosines))
    for k, cosine in enumerate(cosines):
        polar = math.acos(min(1.0, max(1e-9, float(cosine))))
        wide = 2.0 * alpha
        low, high = math.asinh(-polar / wide), math.asinh((math.pi / 2.0 - polar) / wide)
        steps = low + (x + 1.0) / 2.0 * (high - low)
        to, weight = polar + wide * np.sinh(steps), w * (high - low) / 2.0 * wide * np.cosh(steps)
        wide = wide / (math.sin(polar) + wide)
        end = math.asinh(math.pi / wide)
        steps = (x + 1.0) / 2.0 * end
        turn, around = wide * np.sinh(steps), w * end * wide * np.cosh(steps)  # twice one half
        sine, c = np.sin(to)[:, None], np.cos(to)[:, None]
        between = math.sin(polar) * sine * np.cos(turn) + math.cos(polar) * c
        sent = pairs(np.array(alpha), c, np.array(math.cos(polar)), between) * sine * c
        shares[k] = weight @ sent @ around / math.pi
    return shares


@lru_cache(maxsize=64)
def missing(alpha: float, steps: int) -> Floats:
    """Return (1 - E) / E, E = `albedo`, at equal steps of the cosine from 0 to 1, (steps + 1,)."""
    share = albedo(alpha, np.linspace(0.0, 1.0, steps + 1))
    table: Floats = (1.0 - share) / share
    return table


def multiple(colour: Sequence[float], roughness: float) -> tuple[float, float, float]:
    """Return the mean reflectivity of the facets that light meets after the first, per colour channel.

    Of light from everywhere a first facet lets the share E' leave, and the rest meets facets again and again (Kulla
    and Conty 2017): F E' / (1 - F (1 - E')). Reflectance that includes it is f (1 + this (1 - E) / E), with E the
    share in the direction in which the light leaves (Turquin 2019); Cycles has it so as "Multiscatter GGX". It is not
    the same backwards.
    """
    x, w = leggauss(64)
    cosines = (x + 1.0) / 2.0
    mean = float((w * cosines * albedo(roughness**2, cosines)).sum())
    first, second, third = (c * mean / (1.0 - c * (1.0 - mean)) for c in colour)
    return first, second, third
