"""Closed forms and quadrature that share no code with the renderer: what the pictures are judged by."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from generator.model.grid import VoxelGrid
from generator.model.scene import Camera, Room, Scene, Spot, Target, Wall


def bare_scene(**changes):
    """A wall 2 m wide, a wide spot 1 m from it, no room, a sheet or sphere in front."""
    scene = Scene(
        preset="custom",
        wall=Wall(x=(-1.0, 1.0), z=(-1.0, 1.0)),
        spot=Spot(location=(0.5, 0.8, 0.1), aim=(0.4, 0.0, 0.0), half_angle=20.0, power=100.0),
        camera=Camera(location=(-0.5, 0.2, 0.0), x=(-0.9, -0.1), z=(-0.4, 0.4), projection="orthographic"),
        grid=VoxelGrid(lo=(-0.3, 0.9, -0.3), hi=(0.3, 1.5, 0.3), shape=(1, 1, 1)),
        target=Target(kind="sheet", size=0.4),
        resolution=(16, 16),
    )
    return replace(scene, **changes)


def floor_room(z=-1.0):
    return Room(x=(-1.0, 1.0), y=(0.0, 2.0), z=(z, 1.0), surfaces=("floor",))


def pixel_centres(scene, resolution=None):
    """Points on the wall, (height, width, 3): column 0 is the largest x, row 0 the largest z."""
    width, height = resolution or scene.resolution
    (x0, x1), (z0, z1) = scene.camera.x, scene.camera.z
    x = x1 - (np.arange(width) + 0.5) / width * (x1 - x0)
    z = z1 - (np.arange(height) + 0.5) / height * (z1 - z0)
    grid = np.zeros((height, width, 3))
    grid[..., 0], grid[..., 2] = x[None, :], z[:, None]
    return grid


def spot_irradiance(spot: Spot, points):
    """I cos / d^2 on the plane y = 0 inside the cone, else 0; Lambert's cosine and inverse square law."""
    way = points - np.asarray(spot.location)
    distance = np.linalg.norm(way, axis=-1)
    axis = np.subtract(spot.aim, spot.location)
    axis = axis / np.linalg.norm(axis)
    inside = way @ axis / distance >= math.cos(math.radians(spot.half_angle))
    return np.where(inside, spot.intensity * -way[..., 1] / distance**3, 0.0)


def midpoints(axis, at, a, b, n):
    """Midpoints (n*n, 3) of a rectangle in a plane of constant axis, and the area of each cell."""
    (a0, a1), (b0, b1) = a, b
    u = a0 + (np.arange(n) + 0.5) / n * (a1 - a0)
    v = b0 + (np.arange(n) + 0.5) / n * (b1 - b0)
    points = np.empty((n * n, 3))
    rest = [i for i in range(3) if i != axis]
    points[:, axis] = at
    points[:, rest[0]], points[:, rest[1]] = np.repeat(u, n), np.tile(v, n)
    return points, (a1 - a0) * (b1 - b0) / n**2


def transfer(points, normal, sources, source_normal, radiance, area, two_sided=False):
    """Irradiance at points from Lambertian source elements: sum of L cos cos A / r^2."""
    way = sources[None, :, :] - points[:, None, :]
    r2 = (way**2).sum(-1)
    here, there = way @ np.asarray(normal, float), -(way @ np.asarray(source_normal, float))
    if two_sided:  # a sheet radiates what it gets on the side that gets it; both sides are the caller's sum
        here = np.abs(here)
    return (np.maximum(here, 0) * np.maximum(there, 0) / r2**2 * radiance[None, :]).sum(1) * area


def third_order(scene: Scene, elements, normal, area, albedo, n_patch=120):
    """Radiance (height, width) of lamp -> wall -> elements -> wall, nothing in the way, by midpoint sums.

    The elements reflect from the side that their normal points to.
    """
    spot = scene.spot
    reach = 2.0 * spot.location[1] * math.tan(math.radians(spot.half_angle)) + 0.2
    x, z = spot.aim[0], spot.aim[2]
    lit, lit_area = midpoints(1, 0.0, (x - reach, x + reach), (z - reach, z + reach), n_patch)
    irradiance = spot_irradiance(spot, lit)
    keep = irradiance > 0
    radiance = scene.wall.albedo / math.pi * irradiance[keep]
    onto = transfer(elements, normal, lit[keep], (0, 1, 0), radiance, lit_area)
    points = pixel_centres(scene).reshape(-1, 3)
    back = transfer(points, (0, 1, 0), elements, normal, albedo / math.pi * onto, area)
    return (scene.wall.albedo / math.pi * back).reshape(scene.resolution[1], scene.resolution[0])
