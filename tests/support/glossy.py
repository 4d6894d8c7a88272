"""Glossy reflection by formulas as papers print them, and sums of it that share no code with the engine."""

from __future__ import annotations

import numpy as np
import worlds
from numpy.polynomial.legendre import leggauss

from generator.model.arrays import rotation_matrix


def reflectance(normal, to_light, to_eye, alpha):
    """GGX of width alpha (Walter et al. 2007, equation 33; Heitz 2014, equations 72 and 99), 1/sr.

    All directions are unit vectors (..., 3).
    """
    half = to_light + to_eye
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    c, ci, co = ((normal * way).sum(axis=-1) for way in (half, to_light, to_eye))
    up = (ci > 0.0) & (co > 0.0)
    ci, co = np.where(up, ci, 1.0), np.where(up, co, 1.0)
    tan2 = (1.0 - c**2) / c**2
    slopes = 1.0 / (np.pi * alpha**2 * c**4 * (1.0 + tan2 / alpha**2) ** 2)
    li, lo = ((-1.0 + np.sqrt(1.0 + alpha**2 * (1.0 - x**2) / x**2)) / 2.0 for x in (ci, co))
    return np.where(up, slopes / (1.0 + li + lo) / (4.0 * ci * co), 0.0)


def sheet_points(position, rotation, *, size=0.4, n=24):
    """Gauss points of a sheet (k, 3), its two normals' one (k, 3), and areas (k,)."""
    x, w = leggauss(n)
    at, weight = x * size / 2.0, w * size / 2.0
    turn = rotation_matrix(rotation)
    own = np.stack([np.repeat(at, n), np.zeros(n * n), np.tile(at, n)], axis=1)
    normal = np.broadcast_to(turn @ np.array([0.0, -1.0, 0.0]), own.shape)
    return own @ turn.T + np.asarray(position), normal, np.outer(weight, weight).ravel()


def sphere_points(centre, radius, *, n=120):
    """Points of a sphere (k, 3), their normals (k, 3), and areas (k,): Gauss by height, equal steps around."""
    x, w = leggauss(n)
    turn = 2.0 * np.pi * (np.arange(2 * n) + 0.5) / (2 * n)
    ring = np.sqrt(1.0 - x**2)
    normal = np.stack(
        [np.outer(ring, np.cos(turn)), np.outer(ring, np.sin(turn)), np.outer(x, np.ones(2 * n))], axis=-1
    ).reshape(-1, 3)
    return np.asarray(centre) + radius * normal, normal, np.repeat(w, 2 * n) * np.pi / n * radius**2


def picture(scene, elements, roughness, *, two_sided, tint=1.0, factor=None, lamps=(8, 16), fine=1, seen=None):
    """Radiance (height, width) that glossy elements (points, normals, areas) add: lamp, w1, x, w2, one by one.

    ``factor`` may give, for the cosines of the ways to w2, what the reflectance is multiplied by; ``seen`` as for
    `worlds.sheet_picture`.
    """
    light, power = worlds.patch_points(scene.patch, *lamps)
    points, weights = worlds.picture_points(scene.watched, fine)
    wall = points.reshape(-1, 3)
    total = np.zeros(len(wall))
    sides = (1.0, -1.0) if two_sided else (1.0,)
    for place, normal, area in zip(*elements, strict=True):
        one, two = light - place, wall - place
        near, far = np.linalg.norm(one, axis=1), np.linalg.norm(two, axis=1)
        to_light, to_eye = one / near[:, None], two / far[:, None]
        arriving = power * place[1] / near**3
        leaving = place[1] / far**3 * area
        if seen is not None:
            arriving = arriving * seen(np.broadcast_to(place, light.shape), light)
            leaving = leaving * seen(np.broadcast_to(place, wall.shape), wall)
        for sign in sides:
            n = sign * normal
            caught = arriving * np.maximum(to_light @ n, 0.0)
            if not caught.any():
                continue
            f = reflectance(n, to_light[None], to_eye[:, None], roughness**2)
            cosine = np.maximum(to_eye @ n, 0.0)
            sent = (f @ caught) * cosine * leaving
            total += sent if factor is None else sent * factor(cosine)
    radiance = scene.watched.albedo[0] / np.pi * tint * total
    return radiance.reshape(*points.shape[:3]) @ weights
