"""Plane geometry: surfaces cut by pyramids of sight, areas, and what hides what."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from generator.blender.engines.surface import Surface
from generator.blender.scene.relay import crossings
from generator.model.arrays import Array


def blocked(lamp: bpy.types.Object, wall: bpy.types.Object, hit: Surface | None) -> str:
    """Return a phrase that says what blocks the spot's cone."""
    if hit is None or hit.role == "relay_wall":
        return f"part of the cone of the spot {lamp.name!r} misses the plane of the relay wall {wall.name!r}"
    return f"{hit.label} stands in the cone of the spot {lamp.name!r}, before the relay wall"


def near_plane(normal: Array, point: Array, slack: float) -> list[Plane]:
    """Return the slab around a plane, as two half spaces."""
    offset = float(normal @ point)
    return [Plane(normal, offset - slack), Plane(-normal, -offset - slack)]


def colour_within(walls: Sequence[Surface], planes: Sequence[Plane]) -> Array | None:
    """Return the albedo (3,) of walls inside all of the planes; None if it is not uniform."""
    if not walls:
        return np.zeros(3)
    areas = np.concatenate([cut_areas(s.triangles, planes) for s in walls])
    albedo = np.concatenate([s.albedo for s in walls])[areas > NOTHING * areas.sum()]
    if not len(albedo):
        return np.zeros(3)
    return None if np.ptp(albedo, axis=0).any() else albedo[0]


def plane_of(triangles: Array) -> tuple[Array, Array]:
    """Return a point and the unit normal of the plane through triangles."""
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    largest = sides[np.argmax((sides**2).sum(axis=1))]
    normal = (sides * np.sign(sides @ largest)[:, None]).sum(axis=0)
    normal = normal / np.linalg.norm(normal)
    return triangles.reshape(-1, 3).mean(axis=0), normal


NOTHING = 1e-9
"""An area below this counts as none, in units of the area of the outline that is looked through."""


@dataclass(frozen=True)
class Plane:
    """The half space of points p with normal @ p >= offset; the normal has unit length."""

    normal: Array
    offset: float


def pyramid(outline: Array, apex: Array) -> list[Plane]:
    """Return the sides of the pyramid from an apex (homogeneous, 4) to a convex outline (n, 3), facing inwards."""
    towards = apex[:3] - apex[3] * outline
    normals = np.cross(np.roll(outline, -1, axis=0) - outline, towards)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    inside = ((outline.mean(axis=0) - outline) * normals).sum(axis=1)
    normals = normals * np.sign(inside)[:, None]
    return [Plane(n, float(n @ corner)) for n, corner in zip(normals, outline, strict=True)]


def cut_areas(triangles: Array, planes: Sequence[Plane]) -> Array:
    """Return the area of each triangle (n, 3, 3) inside all of the planes."""
    remaining = np.arange(len(triangles))
    inside = np.ones(len(triangles), dtype=bool)
    for plane in planes:
        distance = triangles[remaining] @ plane.normal - plane.offset
        inside[remaining] &= (distance >= 0.0).all(axis=1)
        remaining = remaining[(distance > 0.0).any(axis=1)]
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas: Array = np.where(inside, np.linalg.norm(sides, axis=1) / 2.0, 0.0)
    for index in remaining[~inside[remaining]]:
        polygon = triangles[index]
        for plane in planes:
            polygon = _cut(polygon, plane)
        areas[index] = polygon_area(polygon)
    return areas


def _cut(polygon: Array, plane: Plane) -> Array:
    """Return the part (m, 3) of a convex polygon (n, 3) that lies inside a plane (Sutherland and Hodgman 1974)."""
    distance = polygon @ plane.normal - plane.offset
    kept = []
    for i in range(len(polygon)):
        a, b = distance[i - 1], distance[i]
        if (a >= 0.0) != (b >= 0.0):
            kept.append(polygon[i - 1] + (polygon[i] - polygon[i - 1]) * (a / (a - b)))
        if b >= 0.0:
            kept.append(polygon[i])
    return np.array(kept).reshape(-1, 3)


def polygon_area(polygon: Array) -> float:
    """Return the area of a plane polygon, corners (n, 2); 0 for fewer than three."""
    if len(polygon) < 3:
        return 0.0
    spokes = polygon[1:] - polygon[0]
    return float(np.linalg.norm(np.cross(spokes[:-1], spokes[1:]).sum(axis=0)) / 2.0)


def covered(
    surfaces: Sequence[Surface], sides: Sequence[Plane], point: Array, normal: Array, outline: Array, slack: float
) -> bool:
    """Whether the relay wall, as far as it lies in a plane, fills an outline in that plane."""
    wall = np.concatenate([s.triangles for s in surfaces if s.role == "relay_wall"])
    filled = cut_areas(wall, [*sides, *near_plane(normal, point, slack)]).sum()
    return bool(filled >= (1.0 - 1e-5) * polygon_area(outline))


def first_hit(surfaces: Sequence[Surface], origin: Array, way: Array) -> tuple[Surface | None, Array, Array]:
    """Return the first surface along a ray, the hit point and its unit normal."""
    best: tuple[Surface | None, Array, Array] = (None, np.zeros(3), np.zeros(3))
    nearest = math.inf
    for surface in surfaces:
        distances = crossings(surface.triangles, origin, way)
        if distances.min(initial=math.inf) < nearest:
            index = int(distances.argmin())
            nearest = float(distances[index])
            a, b, c = surface.triangles[index]
            normal = np.cross(b - a, c - a)
            best = surface, origin + nearest * way, normal / np.linalg.norm(normal)
    return best
