"""The ellipse in which a lamp's cone cuts the relay wall."""

from __future__ import annotations

import math

import numpy as np

from generator.model.arrays import Array
from generator.transport.world import LitPatch

STEEPEST = math.radians(89.0)
"""Angle between the wall's normal and the cone's edge from which on the lit patch has no edge."""


def perpendicular(normal: Array) -> Array:
    """Return a unit vector at right angles to a normal."""
    axis = np.eye(3)[int(np.argmin(np.abs(normal)))]
    across = np.cross(normal, axis)
    unit: Array = across / np.linalg.norm(across)
    return unit


def patch_lit(
    lamp: Array,
    axis: Array,
    point: Array,
    normal: Array,
    *,
    half_angle: float,
    blend: float,
    intensity: Array,
    albedo: Array,
) -> LitPatch | None:
    """Return the patch of a wall that a spot lamp lights; None if its cone grazes the wall, so that it has no edge.

    Parameters
    ----------
    lamp, axis : ndarray of shape (3,)
        Position, metres, and unit direction towards the wall.
    point, normal : ndarray of shape (3,)
        A point of the wall, metres, and its unit normal towards the lamp.
    half_angle : float
        Between the axis and the cone's edge, radians.
    blend : float
        Blender's softness of the edge, 0 to 1.
    intensity, albedo : ndarray of shape (3,)
        As in `LitPatch`.
    """
    height = float((lamp - point) @ normal)
    tilt = math.acos(min(1.0, float(-axis @ normal)))
    if tilt + half_angle >= STEEPEST:
        return None
    along = axis + normal * math.cos(tilt)
    along = along / np.linalg.norm(along) if tilt > 1e-6 else perpendicular(normal)
    near, far = height * math.tan(tilt - half_angle), height * math.tan(tilt + half_angle)
    middle, major = (near + far) / 2.0, (far - near) / 2.0
    reach = (middle * math.sin(tilt) + height * math.cos(tilt)) / math.cos(half_angle)
    minor = math.sqrt(reach**2 - middle**2 - height**2)
    return LitPatch(
        centre=lamp - height * normal + middle * along,
        major=major * along,
        minor=minor * np.cross(normal, along),
        normal=normal,
        lamp=lamp,
        axis=axis,
        height=height,
        intensity=intensity,
        albedo=albedo,
        cos_outer=math.cos(half_angle),
        cos_width=(1.0 - math.cos(half_angle)) * blend,
    )
