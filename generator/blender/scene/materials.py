"""Colours of surfaces and of the world."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import bpy

from generator.blender.scene import nodes
from generator.blender.scene.words import short

_ROUNDING = 1e-5
"""Difference of colours that Blender's float32 makes."""


def albedo(obj: bpy.types.Object) -> float | None:
    """Return the mean albedo of an object's material if it is purely Lambertian, else None."""
    return mean_albedo(diffuse_colour(obj))


def mean_albedo(colour: Sequence[float] | None) -> float | None:
    """Return the mean of an RGB albedo; None for None."""
    return None if colour is None else short(sum(colour) / 3.0)


def diffuse_colour(obj: bpy.types.Object) -> tuple[float, float, float] | None:
    """Return the RGB albedo of an object whose only material is a constant Lambertian reflector, else None."""
    return only_diffuse(slot.material for slot in obj.material_slots)


def only_diffuse(materials: Iterable[Any]) -> tuple[float, float, float] | None:
    """Return the RGB albedo of materials if they are one and the same, a constant Lambertian reflector, else None."""
    different = set(materials)
    if len(different) != 1 or None in different:
        return None
    return nodes.diffuse(next(iter(different)))


def reflection(obj: bpy.types.Object) -> dict[str, Any]:
    """Return albedo, gloss and roughness of an object as `model.scene.Target` has them; albedo None otherwise."""
    plain = {"albedo": albedo(obj)}
    materials = {slot.material for slot in obj.material_slots}
    found = nodes.reflector(next(iter(materials))) if len(materials) == 1 and None not in materials else None
    if found is None or found.glossy is None or not found.glossy.multiple or any(found.radiance):
        return plain
    share, colour = found.glossy.share, found.glossy.colour
    if any(abs(a - (1.0 - share) * c) > _ROUNDING for a, c in zip(found.albedo, colour, strict=True)):
        return plain
    values = {"albedo": sum(colour) / 3.0, "gloss": share, "roughness": found.glossy.roughness}
    return {name: short(value) for name, value in values.items()}


def make_lambertian(material: Any, colour: Sequence[float]) -> Any:
    """Make a material a Lambertian reflector of an RGB albedo; return the socket that holds it."""
    if not nodes.uses_nodes(material):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Roughness"].default_value = 0.0
    shader.inputs["Color"].default_value = (*colour, 1.0)
    tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])
    return shader.inputs["Color"]


def ambient(scene: bpy.types.Scene) -> float:
    """Return the mean radiance of the rendered world, W/m^2/sr, or its strength if it has a texture.

    It is 0 only if the world gives no light.
    """
    return max((short(nodes.level(getattr(*holder))) for holder in worlds_of(scene)), default=0.0)


def worlds_of(scene: bpy.types.Scene) -> list[tuple[Any, str]]:
    """Return the owners of worlds that may be rendered, the scene or view layers, each with its attribute's name."""
    layers = [layer for layer in scene.view_layers if layer.use]
    overriding = [layer for layer in layers if getattr(layer, "world_override", None) is not None]
    owners: list[tuple[Any, str]] = [(layer, "world_override") for layer in overriding]
    return owners if len(overriding) == len(layers) or scene.world is None else [*owners, (scene, "world")]
