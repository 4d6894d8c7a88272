"""Sets what varies from pose to pose in the open scene: the albedo of target, wall or room, and the spot's power."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import bpy
import numpy as np

from generator.blender.scene import geometry, materials, relay, roles
from generator.blender.scene.description import lamp_power
from generator.blender.scene.quiet import animating
from generator.blender.scene.words import file_name
from generator.model.errors import require
from generator.model.variation import Values, Variation

_ROLES = {"target.albedo": "target", "wall.albedo": "relay_wall", "room.albedo": "room"}


class Varying:
    """The values of an open scene that vary; the scene is left as the last `apply` made it.

    A value is set anew from the one that the scene was opened with, so that no picture depends on those before it.

    Parameters
    ----------
    scene : bpy.types.Scene
    variations : iterable of Variation

    Raises
    ------
    NlosError
        A value cannot be varied: a surface is not plainly Lambertian, or black; surfaces of one role differ; an
        albedo would exceed 1 in a colour channel; there is no such surface; or the lamp is dark or animated.
    """

    def __init__(self, scene: bpy.types.Scene, variations: Iterable[Variation]) -> None:
        self._setters = {variation.name: _setter(scene, variation) for variation in variations}

    def apply(self, values: Values) -> None:
        """Give the scene the values of a pose."""
        for name, value in values:
            self._setters[name](value)


def _setter(scene: bpy.types.Scene, variation: Variation) -> Callable[[float], None]:
    if variation.name == "spot.power":
        return _power_setter(roles.find(scene, "spot"))
    return _albedo_setter(scene, variation)


def _require_own_surfaces(scene: bpy.types.Scene, objs: list[bpy.types.Object], cannot: str) -> None:
    """Raise NlosError if what a render sees of objects has other materials than theirs, or is more than is named."""
    seen = geometry.snapshot(scene)
    for obj in objs:
        made = [shape.name for shape in seen.of([obj]) if shape.instance]
        require(not made, f"{cannot}, since {obj.name!r} shows instances of {made[0]!r}" if made else "")
    for wall in (obj for obj in objs if obj.get(roles.ROLE) == "relay_wall"):
        plane = relay.find(scene, seen)
        points = geometry.points_of(seen.of([wall]))
        juts = ((points - plane.point) @ plane.normal).max() > relay.SLACK * np.ptp(points, axis=0).max()
        require(not juts, f"{cannot}, since {wall.name!r} is more than the wall; make that face an object of its own")


def _power_setter(spot: bpy.types.Object) -> Callable[[float], None]:
    light: Any = spot.data
    power = lamp_power(light)
    require(power > 0.0, f"{file_name()}: spot.power cannot vary, since the spot {spot.name!r} gives no light")
    held = animating(light, "energy")
    require(not held, f"{file_name()}: spot.power cannot vary, since the spot {spot.name!r} is animated")
    watts = light.energy / power

    def apply(value: float) -> None:
        light.energy = watts * value

    return apply


def _albedo_setter(scene: bpy.types.Scene, variation: Variation) -> Callable[[float], None]:
    name, role = variation.name, _ROLES[variation.name]
    objs = roles.target_parts(scene) if role == "target" else roles.players(scene, role)
    cannot = f"{file_name()}: {name} cannot vary"
    _require_own_surfaces(scene, objs, cannot)
    objs = [obj for obj in objs if obj.type not in ("EMPTY", "LIGHT")]
    require(bool(objs), f"{cannot}, since the scene has no {role.replace('_', ' ')} surface")
    first = objs[0].name
    colours = [materials.diffuse_colour(obj) for obj in objs]
    for obj, colour in zip(objs, colours, strict=True):
        require(colour is not None, f"{cannot}, since {obj.name!r} is not plainly Lambertian")
        require(colour == colours[0], f"{cannot}, since {first!r} and {obj.name!r} have different colours")
    colour = colours[0] or (0.0, 0.0, 0.0)
    mean = sum(colour) / 3.0
    require(mean > 0.0, f"{cannot}, since {first!r} is black; give it an albedo first")
    grey = len(set(colour)) == 1
    tint = (1.0, 1.0, 1.0) if grey else tuple(channel / mean for channel in colour)
    highest = variation.high * max(tint)
    require(
        highest <= 1.0 + 1e-6,
        f"{cannot} up to {variation.high:g}, since {first!r} would then reflect {highest:.3g} of one colour channel; "
        f"take {1.0 / max(tint):.3g} at most",
    )
    sockets: list[Any] = []

    def apply(value: float) -> None:
        if not sockets:
            material = bpy.data.materials.new(f"NLOS {name}")
            sockets.append(materials.make_lambertian(material, colour))
            for obj in objs:
                for slot in obj.material_slots:
                    slot.link = "OBJECT"  # other objects may share the mesh
                    slot.material = material
        sockets[0].default_value = (*(min(1.0, value * channel) for channel in tint), 1.0)

    return apply
