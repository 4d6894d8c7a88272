"""Small pictures of assets, drawn without a renderer, since a Blender without a window has none for them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.blender.scene import nodes
from generator.blender.scene.words import numbers
from generator.model.arrays import Array, Vector

SIDE = 128
"""Pixels a side."""
_VIEWER = np.array([0.5, 0.75, 0.45]) / np.linalg.norm([0.5, 0.75, 0.45])
_RIGHT = np.cross([0.0, 0.0, 1.0], _VIEWER) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], _VIEWER))
_AXES = np.stack([_RIGHT, np.cross(_VIEWER, _RIGHT), _VIEWER])
"""Rows: to the right in the picture, up, and towards the viewer, who sees the front of a relay wall."""
_LIGHT = np.array([-0.35, 0.5, 0.79])
"""Direction to the light, to the right in the picture, up and towards the viewer."""
_SKY = 0.3
"""Share of the light that comes from all around."""
_FILLED = 0.9
_LAMP, _CAMERA = (0.9, 0.6, 0.15), (0.15, 0.35, 0.7)


def of_material(material: Any) -> Array:
    """Return the picture of a ball of a material, (SIDE, SIDE, 4), sRGB and opacity; row 0 is the bottom."""
    x, y = np.meshgrid(*2 * (np.linspace(-1.0, 1.0, SIDE) / _FILLED,))
    inside = x**2 + y**2 <= 1.0
    towards = np.sqrt(np.where(inside, 1.0 - x**2 - y**2, 0.0))
    return _picture(inside, np.stack([x, y, towards], axis=-1), numbers(nodes.diffuse(material)))


def of_object(obj: Any) -> Array:
    """Return the picture of an object, as `of_material` does: a mesh, or a sign for a lamp or camera."""
    triangles, colours = _mesh(obj.data) if obj.type == "MESH" else _sign(obj)
    turned = triangles @ (_AXES @ numbers(obj.matrix_basis.to_3x3())).T
    low, high = turned[..., :2].min(axis=(0, 1)), turned[..., :2].max(axis=(0, 1))
    placed = turned.copy()
    placed[..., :2] = (turned[..., :2] - (low + high) / 2.0) * _FILLED * SIDE / (high - low).max() + SIDE / 2.0
    depth, nearest = np.full((SIDE, SIDE), -np.inf), np.full((SIDE, SIDE), -1)
    for number, corners in enumerate(placed):
        _fill(corners, number, depth, nearest)
    normals = np.cross(turned[:, 1] - turned[:, 0], turned[:, 2] - turned[:, 0])
    normals *= np.where(normals[:, 2:] < 0.0, -1.0, 1.0) / np.linalg.norm(normals, axis=1, keepdims=True)
    return _picture(nearest >= 0, normals[nearest], colours[nearest])


def _picture(covered: NDArray[np.bool_], normals: Array, albedos: Array) -> Array:
    lit = _SKY + (1.0 - _SKY) * np.maximum(0.0, normals @ _LIGHT)
    linear = np.clip(albedos * lit[..., None], 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    return np.where(covered[..., None], np.concatenate([encoded, np.ones((*covered.shape, 1))], axis=-1), 0.0)


def _fill(corners: Array, number: int, depth: Array, nearest: Array) -> None:
    """Enter a triangle's number where it is the nearest; corners are pixels, and the distance towards the viewer."""
    (x0, y0), (x1, y1) = np.floor(corners[:, :2].min(axis=0)), np.ceil(corners[:, :2].max(axis=0))
    rows, columns = slice(int(y0), int(y1) + 1), slice(int(x0), int(x1) + 1)
    x, y = np.meshgrid(np.arange(x0, x1 + 1.0) + 0.5, np.arange(y0, y1 + 1.0) + 0.5)
    a, b, c = corners
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if area == 0.0:
        return
    u = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
    v = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
    towards = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
    front = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (towards > depth[rows, columns])
    depth[rows, columns] = np.where(front, towards, depth[rows, columns])
    nearest[rows, columns] = np.where(front, number, nearest[rows, columns])


def _mesh(mesh: Any) -> tuple[Array, Array]:
    """Return a mesh's triangles (n, 3, 3) and albedos (n, 3)."""
    mesh.calc_loop_triangles()
    corners = np.array([vertex.co for vertex in mesh.vertices], dtype=np.float64)
    triangles = corners[[tuple(triangle.vertices) for triangle in mesh.loop_triangles]]
    albedos = np.array([nodes.diffuse(material) for material in mesh.materials])
    return triangles, albedos[[triangle.material_index for triangle in mesh.loop_triangles]]


def _sign(obj: Any) -> tuple[Array, Array]:
    """Return a cone for a lamp and a pyramid for a camera, in their direction, as triangles with colours."""
    lamp = obj.type == "LIGHT"
    count, wide = (24, 0.35) if lamp else (4, 0.6)
    around = math.tau * (np.arange(count) + 0.5) / count
    rim = np.stack([wide * np.cos(around), wide * np.sin(around), -np.ones(count)], axis=-1)
    apex: Vector = (0.0, 0.0, 0.0)
    sides = [(apex, rim[k], rim[(k + 1) % count]) for k in range(count)]
    bottom = [(rim[0], rim[k], rim[k + 1]) for k in range(1, count - 1)]
    triangles = np.array([*sides, *bottom], dtype=np.float64)
    return triangles, np.tile(_LAMP if lamp else _CAMERA, (len(triangles), 1))
