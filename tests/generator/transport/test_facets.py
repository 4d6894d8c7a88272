"""The reflectance of microfacets: against its definition, backwards, and the share of light that it reflects."""

from __future__ import annotations

import math

import glossy
import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss

from generator.transport import facets


def directions(rng, n):
    """Unit vectors of the upper half space."""
    ways = rng.normal(size=(n, 3))
    ways[:, 2] = np.abs(ways[:, 2])
    return ways / np.linalg.norm(ways, axis=1, keepdims=True)


def hemisphere(n=160):
    """Directions (k, 3) and their solid angles times cosines (k,): Gauss by the angle, equal steps around."""
    x, w = leggauss(n)
    polar, turn = (x + 1.0) * math.pi / 4.0, 2.0 * math.pi * (np.arange(2 * n) + 0.5) / (2 * n)
    ways = np.stack(
        [
            np.outer(np.sin(polar), np.cos(turn)),
            np.outer(np.sin(polar), np.sin(turn)),
            np.outer(np.cos(polar), np.ones(2 * n)),
        ],
        axis=-1,
    )
    weight = w * math.pi / 4.0 * np.sin(polar) * np.cos(polar) * math.pi / n
    return ways.reshape(-1, 3), np.repeat(weight, 2 * n)


@pytest.mark.parametrize("roughness", [0.2, 0.5, 1.0])
def test_reflectance_is_that_of_the_papers_and_the_same_backwards(roughness):
    rng = np.random.default_rng(0)
    one, two = directions(rng, 500), directions(rng, 500)
    alpha = np.full(500, roughness**2)
    got = facets.pairs(alpha, one[:, 2], two[:, 2], (one * two).sum(axis=1)) / np.pi
    expected = glossy.reflectance(np.array([0.0, 0.0, 1.0]), one, two, roughness**2)
    np.testing.assert_allclose(got, expected, rtol=1e-9)
    np.testing.assert_allclose(facets.pairs(alpha, two[:, 2], one[:, 2], (one * two).sum(axis=1)) / np.pi, got)


@pytest.mark.parametrize("roughness", [0.4, 0.7, 1.0])
@pytest.mark.parametrize("cosine", [0.2, 0.6, 1.0])
def test_share_reflected_is_the_integral_over_the_hemisphere(roughness, cosine):
    ways, weight = hemisphere()
    view = np.array([math.sqrt(1.0 - cosine**2), 0.0, cosine])
    expected = glossy.reflectance(np.array([0.0, 0.0, 1.0]), ways, view, roughness**2) @ weight
    got = facets.albedo(roughness**2, np.array([cosine]))[0]
    assert abs(got - expected) < 1e-5
    assert got <= 1.0


def test_white_facets_that_send_light_on_keep_all_of_it():
    """In a furnace: what one facet reflects, and what further ones send on, is all, whatever the direction."""
    cosines = np.linspace(0.05, 1.0, 7)
    for roughness in (0.3, 0.6, 1.0):
        share = facets.albedo(roughness**2, cosines)
        again = np.array(facets.multiple((1.0, 0.5, 0.0), roughness))
        whole = share[:, None] * (1.0 + again * (1.0 / share[:, None] - 1.0))
        np.testing.assert_allclose(whole[:, 0], 1.0, rtol=1e-12)
        assert again[2] == 0.0
        assert (share[:, None] * np.array([1.0, 0.5]) <= whole[:, :2] + 1e-12).all()
        assert 0.0 < again[1] < 0.5


def test_table_of_what_is_missing():
    table = facets.missing(0.25, 32)
    share = facets.albedo(0.25, np.array([0.5]))[0]
    assert len(table) == 33
    np.testing.assert_allclose(table[16], (1.0 - share) / share)
