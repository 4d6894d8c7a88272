"""Evaluated Blender scene -> what an engine needs of it, in plain figures; says what it could not honour."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NoReturn

import bpy
import numpy as np
from mathutils import Vector as BlenderVector

from generator import stage
from generator.spec import Array, NlosError

_RIM = 1.0 - 1e-3
"""Probe just inside the cone: its very edge may graze whatever the lit patch ends at."""


@dataclass(frozen=True)
class LitPatch:
    """The part of the relay wall that the spot lights, as a Lambertian emitter.

    A circular cone cuts a plane in an ellipse (as long as the cone does not reach the plane's horizon), so the
    outline is exact; its radiance at a point p is

        L(p) = albedo / pi * intensity * height / |p - lamp|^3 * falloff(angle off the axis)

    Attributes
    ----------
    centre : ndarray of shape (3,)
        Of the ellipse (not w1, which is where the axis meets the wall), metres.
    major, minor : ndarray of shape (3,)
        Semi-axes, metres.
    normal : ndarray of shape (3,)
        Of the wall, towards the lamp; unit length.
    lamp, axis : ndarray of shape (3,)
        The lamp's position, metres, and unit direction.
    height : float
        Distance of the lamp from the wall's plane, metres.
    intensity : ndarray of shape (3,)
        Radiant intensity per colour channel, W/sr.
    albedo : ndarray of shape (3,)
        Of the wall, per colour channel.
    cos_outer, cos_width : float
        The falloff is smoothstep((cos - cos_outer) / cos_width); cos_width = 0 is a hard edge.
    """

    centre: Array
    major: Array
    minor: Array
    normal: Array
    lamp: Array
    axis: Array
    height: float
    intensity: Array
    albedo: Array
    cos_outer: float
    cos_width: float


def lit_patch(scene: bpy.types.Scene) -> LitPatch:
    """Return the lit patch of a scene, or say why it has none in closed form.

    Raises
    ------
    NlosError
        The lamp or the wall is not one whose reflection is known in closed form, or something stands between them;
        the message names what, and says that `path` can render it.
    """
    lamp, wall, target = (stage.find(scene, role) for role in ("spot", "relay_wall", "target"))
    light = lamp.data
    if lamp.type != "LIGHT" or light.type != "SPOT":
        _refuse(f"the spot {lamp.name!r} is not a spot lamp")
    if light.shadow_soft_size > 0:
        _refuse(f"the spot {lamp.name!r} has a radius of {light.shadow_soft_size:g} m, not 0")
    if light.use_nodes and light.node_tree and _has_own_nodes(light.node_tree):
        _refuse(f"the spot {lamp.name!r} has shader nodes of its own")
    if getattr(light, "use_temperature", False):
        _refuse(f"the spot {lamp.name!r} takes its colour from a temperature")
    scale = np.asarray(lamp.matrix_world.to_scale())
    if np.ptp(np.abs(scale)) > 1e-5 * np.abs(scale).max():
        _refuse(f"the spot {lamp.name!r} is scaled unevenly, so that its cone is not round")
    colour = stage.diffuse_colour(wall)
    if colour is None:
        _refuse(f"the relay wall {wall.name!r} has a material that is not one constant diffuse colour")
    matrix = np.asarray(lamp.matrix_world, dtype=np.float64)
    origin, axis = matrix[:3, 3], -matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    half = light.spot_size / 2.0
    hit, point, normal = _probe(scene, origin, axis, hidden=target)
    if hit != wall:
        _refuse(_blocked(lamp, wall, hit))
    if normal @ axis > 0:
        normal = -normal
    height = float((origin - point) @ normal)
    tilt = math.acos(min(1.0, float(-axis @ normal)))
    if tilt + half >= math.radians(89.0):
        _refuse(f"the spot {lamp.name!r} grazes the wall, so that its patch has no edge")
    along = axis + normal * math.cos(tilt)
    along = along / np.linalg.norm(along) if tilt > 1e-6 else _perpendicular(normal)
    near, far = height * math.tan(tilt - half), height * math.tan(tilt + half)
    middle, major = (near + far) / 2.0, (far - near) / 2.0
    reach = (middle * math.sin(tilt) + height * math.cos(tilt)) / math.cos(half)
    minor = math.sqrt(reach**2 - middle**2 - height**2)
    blend = float(light.spot_blend)
    patch = LitPatch(
        centre=origin - height * normal + middle * along,
        major=major * along,
        minor=minor * np.cross(normal, along),
        normal=normal,
        lamp=origin,
        axis=axis,
        height=height,
        intensity=np.asarray(light.color) * (light.energy * 2.0 ** getattr(light, "exposure", 0.0) / (4.0 * math.pi)),
        albedo=np.asarray(colour),
        cos_outer=math.cos(half),
        cos_width=(1.0 - math.cos(half)) * blend,
    )
    for step in range(32):
        turn = 2.0 * math.pi * step / 32
        rim = patch.centre + _RIM * (math.cos(turn) * patch.major + math.sin(turn) * patch.minor)
        hit, point, _ = _probe(scene, origin, rim - origin, hidden=target)
        if hit != wall or abs((point - patch.centre) @ normal) > 1e-4 * height:
            _refuse(_blocked(lamp, wall, hit))
    return patch


def _refuse(why: str) -> NoReturn:
    raise NlosError(f"{bpy.data.filepath or 'scene'}: the engine 'patch' cannot honour that {why}; use --engine path")


def _blocked(lamp: bpy.types.Object, wall: bpy.types.Object, hit: bpy.types.Object | None) -> str:
    if hit is None or hit == wall:
        return f"part of the cone of the spot {lamp.name!r} misses the plane of the relay wall {wall.name!r}"
    return f"{hit.name!r} stands in the cone of the spot {lamp.name!r}, before the relay wall"


def _has_own_nodes(tree: bpy.types.NodeTree) -> bool:
    """Whether a lamp's node tree is other than the one every lamp starts with: white emission of strength 1."""
    if {n.type for n in tree.nodes} - {"EMISSION", "OUTPUT_LIGHT"}:
        return True
    for node in tree.nodes:
        if node.type == "EMISSION":
            colour, strength = node.inputs["Color"], node.inputs["Strength"]
            if colour.is_linked or strength.is_linked or strength.default_value != 1.0:
                return True
            if any(c != 1.0 for c in colour.default_value):
                return True
    return False


def _perpendicular(normal: Array) -> Array:
    other = np.eye(3)[int(np.argmin(np.abs(normal)))]
    across = np.cross(normal, other)
    unit: Array = across / np.linalg.norm(across)
    return unit


def _probe(
    scene: bpy.types.Scene, origin: Array, direction: Array, *, hidden: bpy.types.Object
) -> tuple[bpy.types.Object | None, Array, Array]:
    """First rendered surface along a ray, looking through the hidden object: what, where, and its unit normal."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    way = BlenderVector(direction).normalized()
    start = BlenderVector(origin)
    while True:
        found, point, normal, _, obj, _ = scene.ray_cast(depsgraph, start, way)
        if not found:
            return None, np.zeros(3), np.zeros(3)
        if obj != hidden and not obj.hide_render:
            return obj, np.asarray(point, dtype=np.float64), np.asarray(normal, dtype=np.float64)
        start = point + way * (1e-6 * (point - BlenderVector(origin)).length)
