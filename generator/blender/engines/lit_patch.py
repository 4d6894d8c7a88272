"""The patch of the wall that the spot lights, which holds w1 of every path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import bpy
import numpy as np

from generator.blender.engines import lamps
from generator.blender.engines.planes import (
    NOTHING,
    Plane,
    blocked,
    colour_within,
    covered,
    cut_areas,
    first_hit,
    near_plane,
    pyramid,
)
from generator.blender.engines.reading import RAYS
from generator.blender.engines.surface import Light, Reading
from generator.blender.scene import nodes, roles
from generator.blender.scene.words import numbers
from generator.model.arrays import Array
from generator.transport.cone import patch_lit
from generator.transport.world import LitPatch

LIFT = 1e-3
"""Distance of the lamp that replaces the patch from the wall, in units of the patch's minor radius: shadow rays must
miss the wall."""
_RIM = 1.0 - 1e-3
"""Factor that puts the tested rim just inside the cone, whose very edge may graze what borders the lit patch."""


def read_lit_patch(scene: bpy.types.Scene, reading: Reading) -> tuple[LitPatch | None, list[str]]:
    """Return the patch that the spot lights, or None, and the reasons against engines that start at the patch."""
    lamp, wall = roles.find(scene, "spot"), roles.find(scene, "relay_wall")
    light = lamp.data
    if lamp.type != "LIGHT" or light.type != "SPOT":
        return None, [f"the spot {lamp.name!r} is not a spot lamp"]
    # The transform in a render: Blender does not update the transform of objects that the viewport hides.
    matrix = reading.places.get("spot", numbers(lamp.matrix_world))
    reasons = _lamp_reasons(lamp, matrix, roles.reflection_order(scene))
    if "spot" not in reading.places:
        reasons.append(f"the spot {lamp.name!r} is hidden from renders")
    reasons += _reflection_reasons(scene, reading)
    surfaces = [s for s in reading.surfaces if s.role != "target"]
    walls = [s for s in surfaces if s.role == "relay_wall"]
    origin, axis = matrix[:3, 3], -matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    hit, point, normal = first_hit(surfaces, origin, axis)
    if hit is None or hit.role != "relay_wall":
        return None, [*reasons, blocked(lamp, wall, hit)]
    if normal @ axis > 0:
        normal = -normal
    patch = patch_lit(
        *(origin, axis, point, normal),
        half_angle=light.spot_size / 2.0,
        blend=float(light.spot_blend),
        intensity=lamps.strength(light) / (4.0 * math.pi),
        albedo=np.zeros(3),
    )
    if patch is None:
        return None, [*reasons, f"the spot {lamp.name!r} grazes the wall, so that its patch has no edge"]
    turns = np.arange(64)[:, None] * (2.0 * math.pi / 64)
    rim = patch.centre + _RIM * (np.cos(turns) * patch.major + np.sin(turns) * patch.minor)
    apex = np.append(origin, 1.0)
    sides = pyramid(rim, apex)
    major, minor = (float(np.linalg.norm(axis)) for axis in (patch.major, patch.minor))
    slack = min(1e-4 * patch.height, LIFT / 2.0 * minor)  # what is farther from the wall would hide that lamp
    cone = [*sides, Plane(normal, float(normal @ point) + slack)]
    colour = colour_within(walls, [*sides, *near_plane(normal, point, slack)])
    if colour is None:
        reasons.append(f"the relay wall {wall.name!r} has more than one colour where {lamp.name!r} lights it")
    else:
        patch = replace(patch, albedo=colour)
    blocking = [s for s in surfaces if cut_areas(s.triangles, cone).sum() > NOTHING * major * minor]
    reasons += [blocked(lamp, wall, s) for s in blocking]
    if not blocking and not covered(surfaces, sides, point, normal, rim, slack):
        reasons.append(blocked(lamp, wall, None))
    return (None if reasons else patch), list(dict.fromkeys(reasons))


def _lamp_reasons(lamp: bpy.types.Object, matrix: Array, order: int) -> list[str]:
    """Properties of the spot lamp that speak against engines that start at the patch."""
    name, radius = f"the spot {lamp.name!r}", lamp.data.shadow_soft_size
    reasons = [f"{name} has a radius of {radius:g} m, not 0"] if radius > 0 else []
    return [*reasons, *(f"{name} {flaw}" for flaw in lamps.flaws(lamp, matrix, order))]


def _reflection_reasons(scene: bpy.types.Scene, reading: Reading) -> list[str]:
    """Reasons why the first reflection in closed form, emitted by a lamp, would differ from what Cycles renders."""
    reasons = [*reading.layers, *reading.volumes]
    copies = [light for light in reading.lights if light.role == "spot" and light.instance]
    reasons += [f"the lamp {light.name!r} shines once more, as an instance" for light in copies]
    for wall in (s for s in reading.surfaces if s.role == "relay_wall"):
        reasons += wall.flaws
        if wall.smooth:
            reasons.append(f"{wall.label} is shaded smooth, so that it reflects as if it were curved")
    reasons += _passed_by(reading)
    reasons += _bounce_reasons(scene, reading)
    reasons += _transparent_reasons(scene, reading)
    if others := other_lights(reading.lights):
        reasons += [
            f"{s.label} is shaded smooth over coarse faces, around which lamps shine (shadow terminator geometry "
            f"offset), while {others[0].name!r} shines too"
            for s in reading.surfaces
            if s.softened
        ]
    return list(dict.fromkeys(reasons))


def _passed_by(reading: Reading) -> list[str]:
    """Surfaces that are visible to some kinds of rays and not to others.

    The leg from the object to the lit patch is a reflected ray in Cycles, and a shadow ray where a lamp replaces the
    patch.
    """
    kinds = frozenset().union(*reading.kinds.values())
    reflected = {"diffuse", *({nodes.GLOSSY, nodes.TRANSMISSION} & kinds)}
    reasons = []
    for surface in reading.surfaces:
        unseen = surface.unseen_by & {"shadow", *reflected}
        if unseen and unseen != {"shadow", *reflected}:
            words = " and ".join(word for word in RAYS if word in unseen)
            reasons.append(f"{surface.label} is not visible to {words} rays, and is to others")
    return reasons


def _bounce_reasons(scene: bpy.types.Scene, reading: Reading) -> list[str]:
    """Materials that need separate limits of bounces, or a lamp that rays can hit by chance."""
    cycles = scene.cycles
    others = other_lights(reading.lights)
    reasons = []
    for name, kinds in reading.kinds.items():
        ways = [kind for kind in (nodes.GLOSSY, nodes.TRANSMISSION) if kind in kinds]
        if nodes.UNKNOWN in kinds:
            reasons.append(f"{name!r} has a material that sends light where only Cycles knows")
        if not ways:
            continue
        limits = {kind: getattr(cycles, f"{kind}_bounces") for kind in ("diffuse", *ways)}
        low = min(limits, key=lambda kind: limits[kind])
        if limits[low] < cycles.max_bounces:
            reasons.append(
                f"{name!r} has a {ways[0]} material, and the limit of {low} bounces ({limits[low]}) is below that of "
                f"all ({cycles.max_bounces})"
            )
        if nodes.MIRROR in kinds and others:
            reasons.append(f"{name!r} may reflect like a mirror while {others[0].name!r} shines too")
    return reasons


def _transparent_reasons(scene: bpy.types.Scene, reading: Reading) -> list[str]:
    """Why the limit of transparent bounces may matter: for a shadow ray it is one more than for a path."""
    limit, legs = scene.cycles.transparent_max_bounces, roles.reflection_order(scene)
    transparent = [s for s in reading.surfaces if nodes.TRANSPARENT in s.kinds]
    known = {s.name for s in transparent}
    unknown = [name for name, kinds in reading.kinds.items() if nodes.TRANSPARENT in kinds and name not in known]
    crossed = legs * sum(_planes(s.triangles) for s in transparent)
    if not unknown and crossed < limit:
        return []
    names = [*unknown, *(s.name for s in transparent)]
    return [
        f"{names[0]!r} is transparent, and light may cross more such faces than the limit of transparent bounces "
        f"({limit}) surely allows"
        for _ in names[:1]
    ]


def _planes(triangles: Array) -> int:
    """Return the number of planes in which triangles (n, 3, 3) lie: a straight line crosses at most so many."""
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    dominant = normals[np.arange(len(normals)), np.abs(normals).argmax(axis=1)]
    normals = normals * np.sign(dominant)[:, None]  # both orientations of a plane count as one
    size = np.ptp(triangles.reshape(-1, 3), axis=0).max()
    offsets = (normals * (triangles[:, 0] - triangles[0, 0])).sum(axis=1) / size
    return len(np.unique(np.round(np.column_stack([normals, offsets]), 4), axis=0))


def other_lights(found: Sequence[Light]) -> list[Light]:
    """Return those of the lights that are not the spot itself."""
    return [light for light in found if not light.is_spot]
