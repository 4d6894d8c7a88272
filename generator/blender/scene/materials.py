"""Colours of surfaces and of the world."""

from __future__ import annotations

from typing import Any

import bpy

from generator.blender.scene import nodes
from generator.blender.scene.words import short


def albedo(obj: bpy.types.Object) -> float | None:
    """Return the mean albedo of an object's material if it is plainly Lambertian, else None."""
    colour = diffuse_colour(obj)
    return None if colour is None else short(sum(colour) / 3.0)


def diffuse_colour(obj: bpy.types.Object) -> tuple[float, float, float] | None:
    """Return the RGB albedo of an object whose only material is a constant Lambertian reflector, else None."""
    materials = {slot.material for slot in obj.material_slots}
    if len(materials) != 1 or None in materials:
        return None
    return nodes.diffuse(next(iter(materials)))


def ambient(scene: bpy.types.Scene) -> float:
    """Return the mean radiance of the world that is rendered, W/m^2/sr; of one with a texture, its strength.

    It is 0 only if the world gives no light.
    """
    return max((short(nodes.level(getattr(*held))) for held in worlds_of(scene)), default=0.0)


def worlds_of(scene: bpy.types.Scene) -> list[tuple[Any, str]]:
    """Return who holds a world that may be rendered, and in which attribute: the scene, or a view layer instead."""
    layers = [layer for layer in scene.view_layers if layer.use]
    own = [layer for layer in layers if getattr(layer, "world_override", None) is not None]
    owners: list[tuple[Any, str]] = [(layer, "world_override") for layer in own]
    return owners if len(own) == len(layers) or scene.world is None else [*owners, (scene, "world")]
