"""Worlds for the transport engine, made by hand, and quadrature of their integral that shares no code with it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.polynomial.legendre import leggauss

from generator.model.arrays import rotation_matrix
from generator.transport import AmbientLight, LitPatch, Mesh, Sphere, Watched, World

WALL = 0.8
HIGH, WIDE, DEEP = 1.4, 1.6, 2.0


def lit_patch(*, radius=0.08, centre=(0.4, 0.0, 0.1), lamp=(-1.0, 3.0, 3.1), power=1000.0):
    """A round patch on the wall y = 0, lit from up on the left, out of the targets' way."""
    lamp, centre = np.array(lamp, float), np.array(centre, float)
    height = float(lamp[1])
    return LitPatch(
        centre=centre,
        major=np.array([radius, 0.0, 0.0]),
        minor=np.array([0.0, 0.0, radius]),
        normal=np.array([0.0, 1.0, 0.0]),
        lamp=lamp,
        axis=(centre - lamp) / np.linalg.norm(centre - lamp),
        height=height,
        intensity=np.full(3, power / (4.0 * math.pi)),
        albedo=np.full(3, WALL),
        cos_outer=height / math.hypot(height, radius),
        cos_width=0.0,
    )


def watched(*, x=(-0.8, 0.0), z=(-0.3, 0.5), resolution=(16, 16), eye=(-0.5, 3.0, 0.0)):
    """A rectangle of the wall y = 0, seen from the front: u runs towards -x, v towards -z."""
    to_wall = np.array([[x[0] - x[1], 0.0, x[1]], [0.0, 0.0, 0.0], [0.0, z[0] - z[1], z[1]], [0.0, 0.0, 1.0]])
    return Watched(to_wall, np.array([*eye, 1.0]), np.array([0.0, 1.0, 0.0]), np.full(3, WALL), resolution)


def sheet(size=0.4, albedo=0.9):
    """A square in the plane y = 0 of its own frame."""
    h = size / 2.0
    a, b, c, d = np.array([[-h, 0.0, -h], [h, 0.0, -h], [h, 0.0, h], [-h, 0.0, h]])
    return Mesh(np.array([[a, b, c], [a, c, d]]), np.full((2, 3), albedo))


def quad(corner, first, second, albedo):
    """A parallelogram as two triangles."""
    a, e, f = (np.array(v, float) for v in (corner, first, second))
    return Mesh(np.array([[a, a + e, a + e + f], [a, a + e + f, a + f]]), np.full((2, 3), albedo))


def world(target, *, room=(), **changes):
    """A world with that target."""
    return World(changes.pop("patch", lit_patch()), changes.pop("view", watched()), (target,), tuple(room), **changes)


def room(*, albedo=0.8, order=6, ceiling=True, sky=0.0, screen=True, target=None):
    """A box behind the wall, with a screen between camera and target, or open above."""
    x, z = (-WIDE, 2.0 * WIDE), (-HIGH, 2.0 * HIGH)
    across, up, back = (x[1], 0.0, 0.0), (0.0, 0.0, z[1]), (0.0, DEEP, 0.0)
    sides = [
        quad((x[0], 0.0, z[0]), across, back, albedo),
        quad((x[0], DEEP, z[0]), across, up, albedo),
        quad((x[0], 0.0, z[0]), back, up, albedo),
        quad((x[0] + x[1], 0.0, z[0]), back, up, albedo),
    ]
    if ceiling:
        sides.append(quad((x[0], 0.0, z[0] + z[1]), across, back, albedo))
    if screen:
        sides.append(quad((0.1, 0.8, z[0]), (0.0, DEEP - 0.8, 0.0), up, 0.1))
    made = world(target or sheet(0.6, 0.9), room=tuple(sides))
    wall = quad((x[0], 0.0, z[0]), across, up, albedo)
    watched = replace(made.watched, albedo=np.full(3, albedo))
    patch = replace(made.patch, albedo=np.full(3, albedo))
    ambient = AmbientLight(np.full(3, sky)) if sky else None
    return replace(made, watched=watched, patch=patch, order=order, wall=wall, ambient=ambient)


def windowed(size, *, albedo=0.8, order=3, target=None):
    """`room` under a sky that enters by a square window in the side x = WIDE, and the window's corners (4, 3)."""
    made = room(albedo=albedo, order=order, sky=1.0, target=target)
    middle, half = np.array([1.1, 0.3]), size / 2.0
    low, high = middle - half, middle + half
    pieces = (
        ((0.0, -HIGH), (low[0], HIGH)),
        ((high[0], -HIGH), (DEEP, HIGH)),
        ((low[0], -HIGH), (high[0], low[1])),
        ((low[0], high[1]), (high[0], HIGH)),
    )
    sides = [
        quad((WIDE, *start), (0.0, end[0] - start[0], 0.0), (0.0, 0.0, end[1] - start[1]), albedo)
        for start, end in pieces
    ]
    corners = np.array([(WIDE, y, z) for y, z in ((low[0], low[1]), (high[0], low[1]), high, (low[0], high[1]))])
    return replace(made, room=(*made.room[:3], *made.room[4:], *sides)), corners


def scaled(world, factor):
    """The same world, larger or smaller, its lamp so much brighter or dimmer that the picture stays the same."""
    patch, view = world.patch, world.watched
    longer = {name: factor * getattr(patch, name) for name in ("centre", "major", "minor", "lamp", "height")}
    wide = np.array([[factor], [factor], [factor], [1.0]])

    def larger(body):
        if isinstance(body, Mesh):
            return Mesh(factor * body.triangles, body.albedo)
        return Sphere(factor * body.centre, factor * body.radius, body.albedo)

    def larger_emitters(glow):
        lengths = {name: factor * getattr(glow, name) for name in ("triangles", "places", "softness")}
        return replace(glow, **lengths, intensity=factor**2 * glow.intensity)

    return World(
        replace(patch, **longer, intensity=factor**2 * patch.intensity),
        replace(view, to_wall=wide * view.to_wall, eye=np.append(factor * view.eye[:3], view.eye[3])),
        tuple(map(larger, world.target)),
        tuple(map(larger, world.room)),
        world.order,
        world.ambient,
        None if world.wall is None else larger(world.wall),
        None if world.emitters is None else larger_emitters(world.emitters),
    )


def patch_points(patch, n=24, turns=48):
    """Polar quadrature of the lit patch: points (k, 3), and radiance times area (k,)."""
    r, weight = leggauss(n)
    r, weight = (r + 1.0) / 2.0, weight / 2.0
    angle = 2.0 * np.pi * (np.arange(turns) + 0.5) / turns
    across = (
        np.outer(r, np.cos(angle)).reshape(-1, 1) * patch.major
        + np.outer(r, np.sin(angle)).reshape(-1, 1) * patch.minor
    )
    area = np.linalg.norm(np.cross(patch.major, patch.minor)) * np.repeat(r * weight, turns) * 2.0 * np.pi / turns
    points = patch.centre + across
    away = np.linalg.norm(points - patch.lamp, axis=1)
    return points, patch.albedo[0] / np.pi * patch.intensity[0] * patch.height / away**3 * area


def picture_points(view, fine):
    """Gauss points inside every pixel: (height, width, fine^2, 3), and their weights (fine^2,)."""
    width, height = view.resolution
    x, w = leggauss(fine)
    x, w = (x + 1.0) / 2.0, w / 2.0
    u = (np.arange(width)[:, None] + x) / width
    v = (np.arange(height)[:, None] + x) / height
    uv = np.zeros((height, width, fine, fine, 2))
    uv[..., 0], uv[..., 1] = u[None, :, None, :], v[:, None, :, None]
    return view.points(uv.reshape(height, width, fine * fine, 2)), np.outer(w, w).ravel()


def sheet_picture(scene, position, rotation, *, size=0.4, albedo=0.9, cells=6, n=8, fine=3, seen=None, light=None):
    """Radiance (height, width) that a sheet adds: Gauss-Legendre on it, both sides, nothing in the way.

    ``seen`` may say, for arrays of starts and ends (k, 3), which pairs see each other.
    """
    x, w = leggauss(n)
    edges = np.linspace(-size / 2.0, size / 2.0, cells + 1)
    at = (edges[:-1, None] + (x + 1.0) / 2.0 * np.diff(edges)[:, None]).ravel()
    weight = (w / 2.0 * np.diff(edges)[:, None]).ravel()
    turn = rotation_matrix(rotation)
    own = np.stack([np.repeat(at, len(at)), np.zeros(len(at) ** 2), np.tile(at, len(at))], axis=1)
    elements, area = own @ turn.T + np.asarray(position), np.outer(weight, weight).ravel()
    normal = turn @ np.array([0.0, -1.0, 0.0])
    light, power = light or patch_points(scene.patch)
    points, weights = picture_points(scene.watched, fine)
    flat = points.reshape(-1, 3)
    total = np.zeros(len(flat))
    for element, piece in zip(elements, area, strict=True):
        way = light - element
        facing = way @ normal
        share = power * np.abs(facing) * element[1] / (way**2).sum(axis=1) ** 2
        if seen is not None:
            share = share * seen(np.broadcast_to(element, light.shape), light)
        front, back = share[facing > 0].sum(), share[facing < 0].sum()
        way = flat - element
        facing = way @ normal
        lit = np.where(facing > 0, front, back)
        term = lit * np.abs(facing) * element[1] / (way**2).sum(axis=1) ** 2 * piece
        if seen is not None:
            term = term * seen(np.broadcast_to(element, flat.shape), flat)
        total += term
    radiance = scene.watched.albedo[0] / np.pi * albedo / np.pi * total
    return radiance.reshape(*points.shape[:3]) @ weights


def error(got, expected):
    """Root mean square of the difference, relative to that of what was expected."""
    return float(np.sqrt(((got - expected) ** 2).mean() / (expected**2).mean()))
