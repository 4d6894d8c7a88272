"""Finds what else in a scene changes when the target moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from generator.blender.engines.reading import read_surfaces
from generator.blender.engines.surface import Light, Reading, Surface
from generator.blender.scene import geometry, nodes, posing, roles
from generator.blender.scene.words import numbers
from generator.model.arrays import Array, Vector, rotation_matrix
from generator.model.errors import NlosError

_SHADE = 1e-6
"""Colours that differ by no more than this count as equal."""


def refuse_moving(scene: bpy.types.Scene, target: bpy.types.Object) -> tuple[Reading, list[str]]:
    """Read the scene with the target unrotated at its place; find what else changes when the target moves.

    Each such change is a reason why no engine can sweep the scene: a data set's poses would not be those of its
    pictures, or its background not theirs.
    """
    if roles.unseen(scene, target):  # its motion cannot be observed
        reading = read_surfaces(scene)
        reading.places.setdefault("target", numbers(target.matrix_world))
        return reading, []
    try:
        place = geometry.snapshot(scene).matrices["target"][:3, 3]
        posing.move_target(scene, _vector(place), (0.0, 0.0, 0.0))
        reading = read_surfaces(scene)
        parts = [s for s in reading.surfaces if s.role == "target"]
        corners = np.concatenate([np.zeros((0, 3)), *(s.triangles.reshape(-1, 3) for s in parts)])
        size = float(np.ptp(corners, axis=0).max()) if len(corners) else 1.0
        moved_to = place + size * np.array([0.31, 0.17, 0.23])
        turn = (40.0, 25.0, 70.0)
        posing.move_target(scene, _vector(moved_to), turn)
        moved = read_surfaces(scene)
    except NlosError as error:
        reading = read_surfaces(scene)
        reading.places.setdefault("target", numbers(target.matrix_world))
        return reading, [str(error).removeprefix(f"{bpy.data.filepath or 'scene'}: ")]
    before = reading.places.setdefault("target", numbers(target.matrix_world))
    after = moved.places.get("target", numbers(target.matrix_world))
    slack = 1e-4 * size + 1e-6 * float(np.abs(moved_to).max())
    matrix = rotation_matrix(turn)
    # Animation is applied only when a render starts: the target may not be where it was put.
    is_held = np.abs([before[:3, 3] - place, after[:3, 3] - moved_to]).max() > slack
    turned = after[:3, :3] - matrix @ before[:3, :3]
    if is_held or np.abs(turned).max() > 1e-4 * np.abs(before[:3, :3]).max():
        return reading, [posing.held(target)]
    carried = [replace(s, triangles=(s.triangles - before[:3, 3]) @ matrix.T + after[:3, 3]) for s in parts]
    reading.reasons += [
        f"{label} changes its shape or colour with where it stands"
        for label in _changed(carried, [s for s in moved.surfaces if s.role == "target"], slack)
    ]
    others_before, others_after = ([s for s in r.surfaces if s.role != "target"] for r in (reading, moved))
    reasons = [
        f"{label} changes when the target moves, and is not one of its children"
        for label in _changed(others_before, others_after, 1e-6 * size)
    ]
    for role in ("camera", "spot"):
        if role in moved.places and not _alike(reading.places[role], moved.places[role], 1e-6):
            reasons.append(f"the {role} {roles.find(scene, role).name!r} moves when the target does")
    return reading, [*reasons, *_changed_lights(reading.lights, moved.lights), *_painted_by(scene, target)]


def _painted_by(scene: bpy.types.Scene, target: bpy.types.Object) -> list[str]:
    """Return phrases for what the target does not carry, but whose texture moves with the target."""
    carried = {target, *target.children_recursive}
    textured: list[tuple[str, Any]] = [(f"the world {scene.world.name!r}", scene.world)] if scene.world else []
    for obj in scene.objects:
        if obj not in carried:
            blocks = [obj.data] if obj.type == "LIGHT" else [slot.material for slot in obj.material_slots]
            textured += [(f"{obj.name!r}", block) for block in blocks if block is not None]
    return [
        f"{label} has a texture in the coordinates of {anchor.name!r}, which moves with the target"
        for label, block in textured
        for anchor in nodes.anchors(block) & carried
    ]


def _changed_lights(before: Sequence[Light], after: Sequence[Light]) -> list[str]:
    """Return phrases that say how lights, except those that the target carries, change when it moves."""
    lights_before, lights_after = (
        [light for light in lights if light.role != "target"] for lights in (before, after)
    )
    if len(lights_before) != len(lights_after):
        return ["there are other lights when the target moves"]
    labels = []
    for light, moved in zip(lights_before, lights_after, strict=True):
        if not np.array_equal(light.power, moved.power, equal_nan=True):
            labels.append(f"the light {light.name!r} changes its power when the target moves")
        elif light.role != "spot" and not _alike(light.matrix, moved.matrix, 1e-6):
            labels.append(f"the light {light.name!r} moves when the target does")
    return labels


def _changed(before: Sequence[Surface], after: Sequence[Surface], slack: float) -> list[str]:
    """Return the labels of surfaces whose shape or colour is not the same, corner by corner."""
    unmatched: dict[str, list[Surface]] = {}
    for surface in after:
        unmatched.setdefault(surface.name, []).append(surface)
    labels = []
    for surface in before:
        counterpart = unmatched[surface.name].pop(0) if unmatched.get(surface.name) else None
        if counterpart is None or not (
            _alike(counterpart.triangles, surface.triangles, slack)
            and _alike(counterpart.albedo, surface.albedo, _SHADE)
            and _alike(counterpart.gloss, surface.gloss, _SHADE)
        ):
            labels.append(surface.label)
    return [*labels, *(surface.label for remaining in unmatched.values() for surface in remaining)]


def _alike(one: Array, other: Array, slack: float) -> bool:
    return one.shape == other.shape and float(np.abs(one - other).max(initial=0.0)) <= slack


def _vector(values: Array) -> Vector:
    return (float(values[0]), float(values[1]), float(values[2]))
