"""Lamps besides the spot, as surfaces and points that give light."""

from __future__ import annotations

import math
from typing import Any

import bmesh
import bpy
import numpy as np

from generator.blender.engines.surface import Glow
from generator.blender.scene import nodes
from generator.blender.scene.words import numbers
from generator.model.arrays import Array

_EVEN = 1e-5
_SIDES = 32
"""Sides of the polygon that stands for an elliptic lamp, as large as the ellipse."""
_CUTS = 2
"""Subdivisions of the icosphere that stands for a round lamp: 80 triangles."""


def flaws(lamp: bpy.types.Object, matrix: Array, order: int) -> list[str]:
    """Return why light of a lamp, of any kind, is not what its type, power and colour say.

    Each is a predicate of the lamp. ``matrix`` (4, 4) places it in the world, in pictures of ``order`` reflections.
    """
    light = lamp.data
    found = []
    factor = nodes.radiance(light)
    if factor is None or min(factor) < 0.0 or nodes.read(light).volume:
        found.append("has shader nodes of its own that are not one constant emission")
    if getattr(light, "use_temperature", False):
        found.append("takes its colour from a temperature")
    if not getattr(light, "normalize", True):
        found.append("has a power that is not normalised")
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    if np.ptp(scale) > _EVEN * scale.max():
        found.append("is scaled unevenly")
    if not light.use_shadow or not getattr(light.cycles, "cast_shadow", True):
        found.append("casts no shadows")
    if light.cycles.max_bounces < order - 1:
        found.append(f"has a limit of bounces of its own ({light.cycles.max_bounces})")
    if not lamp.visible_diffuse:
        found.append("is not visible to diffuse rays")
    linking = getattr(lamp, "light_linking", None)
    if linking is not None and (linking.receiver_collection or linking.blocker_collection):
        found.append("is linked to some objects only (light linking)")
    return found


def strength(light: Any) -> Array:
    """Return the power of a lamp (3,), W (of a sun, W/m^2), as its nodes, colour and exposure make it."""
    factor = np.array(nodes.radiance(light) or (0.0, 0.0, 0.0))
    power: Array = numbers(light.color) * factor * (light.energy * 2.0 ** getattr(light, "exposure", 0.0))
    return power


def glow(instance: Any, role: str, matrix: Array, order: int) -> tuple[Glow | None, list[str]]:
    """Return the light of a lamp other than the spot, or None, and why `surfel` cannot follow it.

    Parameters
    ----------
    instance : bpy.types.DepsgraphObjectInstance
    role : str
        "target" if it moves with the target.
    matrix : ndarray of shape (4, 4)
        Transform to the world.
    order : int
        Largest number of reflections.
    """
    lamp, light = instance.object, instance.object.data
    name = f"the lamp {lamp.name!r}"
    found = flaws(lamp, matrix, order)
    if role == "target":
        found.append("moves with the target")
    if light.type not in ("POINT", "AREA"):
        found.append(f"is a {light.type.lower()} lamp, neither a point nor an area")
    if light.type == "AREA" and light.spread < math.pi - _EVEN:
        found.append("is an area lamp whose spread is not 180 degrees")
    if found:
        return None, [f"{name} shines too, and {flaw}" for flaw in found]
    power, none, dark, softness = strength(light), np.zeros((0, 3)), np.zeros(3), 0.0
    size = float(np.linalg.norm(matrix[:3, 0]))
    if light.type == "POINT" and light.shadow_soft_size == 0.0:
        intensity = power / (4.0 * math.pi)
        return Glow(
            lamp.name, np.zeros((0, 3, 3)), dark, matrix[None, :3, 3], intensity, 0.0, lamp.visible_camera
        ), []
    if light.type == "POINT":
        triangles = light.shadow_soft_size * _ball() + matrix[:3, 3]
        area = 4.0 * math.pi * light.shadow_soft_size**2
        softness = light.shadow_soft_size if light.use_soft_falloff else 0.0
    else:
        flat = _outline(light) * size
        area = _area(flat)
        triangles = flat @ (matrix[:3, :3] / size).T + matrix[:3, 3]
    return Glow(lamp.name, triangles, power / (math.pi * area), none, dark, softness, lamp.visible_camera), []


def _outline(light: Any) -> Array:
    """Return the triangles (n, 3, 3) of an area lamp in its own frame, turned so that it shines along -z."""
    wide = light.size
    high = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else wide
    if light.shape in ("SQUARE", "RECTANGLE"):
        corners = np.array([[-1, -1, 0], [-1, 1, 0], [1, 1, 0], [1, -1, 0]]) * (wide / 2.0, high / 2.0, 1.0)
        halves: Array = corners[[[0, 1, 2], [0, 2, 3]]]
        return halves
    angles = -2.0 * math.pi * np.arange(_SIDES + 1) / _SIDES
    # As large as the ellipse, a polygon reaches a little beyond it.
    reach = math.sqrt(2.0 * math.pi / (_SIDES * math.sin(2.0 * math.pi / _SIDES)))
    rim: Array = np.stack([np.cos(angles) * wide, np.sin(angles) * high, np.zeros(_SIDES + 1)], axis=1) * reach / 2.0
    triangles: Array = np.stack([np.zeros((_SIDES, 3)), rim[:-1], rim[1:]], axis=1)
    return triangles


def _ball() -> Array:
    """Return triangles (n, 3, 3) around the unit ball, of its area: on average they look as large from all sides."""
    ball = bmesh.new()
    try:
        bmesh.ops.create_icosphere(ball, subdivisions=_CUTS, radius=1.0)
        triangles = np.array([[corner.co for corner in face.verts] for face in ball.faces], dtype=np.float64)
    finally:
        ball.free()
    return triangles * math.sqrt(4.0 * math.pi / _area(triangles))


def _area(triangles: Array) -> float:
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return float(np.linalg.norm(sides, axis=1).sum()) / 2.0
