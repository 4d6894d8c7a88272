"""Reads the scene as Cycles will render it: surfaces, lights, and what an engine cannot honour."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from generator.blender.engines import coincident, lamps
from generator.blender.engines.shapes import COARSE, SMOOTH, shape_of, softening
from generator.blender.engines.surface import Light, Reading, Shape, Surface
from generator.blender.scene import geometry, materials, nodes, roles
from generator.blender.scene.description import lamp_power
from generator.blender.scene.relay import RelayPlane, plane_met
from generator.blender.scene.words import numbers
from generator.model.arrays import Array

MAX_ORDER = 3
"""Reflections of the paper's model: wall, hidden object, wall."""


_NOT_MESH = {
    "CURVES": "hair curves",
    "POINTCLOUD": "a point cloud",
    "VOLUME": "a volume",
    "GPENCIL": "grease pencil",
    "GREASEPENCIL": "grease pencil",
}


def lights(scene: bpy.types.Scene) -> list[Light]:
    """Return all light sources in a render of a scene: lamps including the spot, emitting surfaces, the world.

    Raises
    ------
    NlosError
        A role is missing or played twice.
    """
    return read_surfaces(scene).lights


def read_surfaces(scene: bpy.types.Scene) -> Reading:
    """Read the scene as a render will see it: surfaces, lights, world, and what engines cannot honour."""
    parts = roles.target_parts(scene)
    played = {roles.find(scene, role): role for role in ("relay_wall", "spot", "camera", "target")}
    played |= dict.fromkeys(parts, "target")

    def look(depsgraph: Any) -> Reading:
        layers = _layer_reasons(scene)
        reading = Reading(reasons=list(layers), layers=layers)
        layer = scene.view_layers[depsgraph.view_layer.name]
        world = getattr(layer, "world_override", None) or depsgraph.scene.world
        _read_world(world, roles.reflection_order(scene), reading)
        reader = _Reader(played, parts[0], layer, roles.reflection_order(scene), reading)
        for instance in depsgraph.object_instances:
            reader.read(instance)
        # An instancer may itself not be shown, and is not listed then.
        reading.places.setdefault("target", numbers(parts[0].evaluated_get(depsgraph).matrix_world))
        reader.split_walls(reading.places.get("spot", numbers(roles.find(scene, "spot").matrix_world)))
        return reading

    return geometry.as_rendered(scene, look)


class _Reader:
    """Reads what a render will see, object by object.

    Parameters
    ----------
    played : dict
        The role of each object that has one.
    target : bpy.types.Object
        The target itself, whose children move with it.
    layer : bpy.types.ViewLayer
    order : int
        Largest number of reflections.
    reading : Reading, added to
    """

    def __init__(
        self,
        played: dict[bpy.types.Object, str],
        target: bpy.types.Object,
        layer: Any,
        order: int,
        reading: Reading,
    ) -> None:
        self._played, self._target, self._layer, self._reading = played, target, layer, reading
        self._order = order
        self._shapes: dict[tuple[int, ...], Shape] = {}
        self._walls: list[_Drawn] = []

    def read(self, instance: Any) -> None:
        """Add an instance of the evaluated scene."""
        obj, reading = instance.object, self._reading
        owner = (instance.parent if instance.is_instance else obj).original
        role = self._played.get(owner, "room")
        matrix = numbers(instance.matrix_world)
        if not instance.is_instance and obj.original in self._played:
            reading.places[role if role != "target" or obj.original == self._target else obj.name] = matrix
        if instance.show_self and _has_empty_slot(obj.original):
            reason = f"{obj.name!r} has an empty material slot of its own, which Blender's versions fill differently"
            reading.layers += [reason] * (reason not in reading.layers)
            reading.reasons += [reason] * (reason not in reading.reasons)
        if obj.type == "LIGHT":
            _read_lamp(instance, self._played.get(obj.original, "room"), matrix, self._order, reading)
            return
        hair = [s for s in obj.particle_systems if s.settings.type == "HAIR" and s.settings.render_type == "PATH"]
        if hair and instance.show_particles:
            reading.reasons.append(f"{obj.name!r} carries hair")
            _read_substance(instance, role, matrix, reading)
        if not instance.show_self:
            return
        if obj.type in _NOT_MESH:
            reading.reasons.append(f"{obj.name!r} is {_NOT_MESH[obj.type]}, and surfel knows only faces")
            _read_substance(instance, role, matrix, reading)
        elif isinstance(obj.data, bpy.types.Mesh):  # a curve or text is listed again, as the mesh made of it
            shape = self._shape(obj)
            if len(shape.corners):
                self._add_surface(instance, role, matrix, shape)

    def _shape(self, obj: bpy.types.Object) -> Shape:
        # Objects that share a mesh may differ in their materials.
        material_keys = [slot.material.as_pointer() if slot.material else 0 for slot in obj.material_slots]
        key = (obj.data.as_pointer(), *material_keys)
        if key not in self._shapes:
            self._shapes[key] = shape_of(obj)
        return self._shapes[key]

    def split_walls(self, lamp: Array) -> None:
        """Add the surfaces of the relay wall, when all has been read: the relay plane, and the rest as the room's.

        ``lamp`` (4, 4) is the spot's transform. All of a wall that its axis does not meet counts as the relay wall.
        """
        if not self._walls:
            return
        triangles = np.concatenate([drawn.triangles for drawn in self._walls])
        axis = -lamp[:3, 2] / np.linalg.norm(lamp[:3, 2])
        plane = plane_met(triangles, lamp[:3, 3], axis)
        lit = np.ones(len(triangles), dtype=bool) if plane is None else one_layer(triangles, plane)
        ends = np.cumsum([len(drawn.triangles) for drawn in self._walls])
        for drawn, faces in zip(self._walls, np.split(lit, ends[:-1]), strict=True):
            rest = replace(drawn, label=f"another face of {drawn.label}")
            for part, role, chosen in ((drawn, "relay_wall", faces), (rest, "room", ~faces)):
                if chosen.any():
                    self._add_part(part, role, chosen)

    def _label(self, obj: bpy.types.Object, role: str) -> str:
        if role == "relay_wall":
            return f"the relay wall {obj.name!r}"
        if role == "target" and obj.original == self._target:
            return f"the target {obj.name!r}"
        return f"{obj.name!r}, which moves with the target," if role == "target" else f"{obj.name!r}"

    def _add_surface(self, instance: Any, role: str, matrix: Array, shape: Shape) -> None:
        obj = instance.object
        triangles = shape.corners @ matrix[:3, :3].T + matrix[:3, 3]
        is_finite = bool(np.isfinite(triangles).all())
        drawn = _Drawn(
            name=obj.name,
            label=self._label(obj, role),
            triangles=triangles if is_finite else np.nan_to_num(triangles, nan=0.0, posinf=0.0, neginf=0.0),
            is_finite=is_finite,
            shape=shape,
            matrix=matrix,
            is_instance=instance.is_instance,
            seen=obj.visible_camera,
            unseen_by=frozenset(_unseen_by(instance)),
            flaws=tuple(_visibility_flaws(instance, self._layer)),
            softening=softening(obj.original),
        )
        if role == "relay_wall":
            self._walls.append(drawn)
        else:
            self._add_part(drawn, role, np.ones(len(triangles), dtype=bool))

    def _add_part(self, drawn: _Drawn, role: str, faces: Any) -> None:
        """Add those of the triangles of a surface that ``faces`` (n,) says, in a role."""
        shape, reading = drawn.shape, self._reading
        used = set(shape.slots[faces].tolist())
        relevant = RAYS if role == "relay_wall" else ("diffuse", "shadow")
        flaws = [flaw for slot, flaw in shape.flaws.items() if slot in used]
        flaws += [f"is not visible to {word} rays" for word in RAYS if word in drawn.unseen_by and word in relevant]
        flaws += drawn.flaws
        if role != "target" and shape.gloss[faces].any():
            flaws.append("has a glossy material, which only the target may have")
        if role in ("relay_wall", "target") and shape.radiance[faces].any():
            flaws.append("has a material that gives light of its own")
        if not drawn.is_finite:
            flaws.append("has a corner that is not a finite number")
        kinds = frozenset().union(*(shape.kinds[slot] for slot in used))
        lean = float(shape.lean[faces].max(initial=0.0))
        triangles = drawn.triangles[faces]
        reading.surfaces.append(
            Surface(
                name=drawn.name,
                label=drawn.label,
                role=role if role in ("relay_wall", "target") else "room",
                triangles=triangles,
                albedo=shape.albedo[faces],
                radiance=shape.radiance[faces],
                gloss=shape.gloss[faces],
                closed=shape.closed and role != "relay_wall",
                smooth=lean > SMOOTH,
                faces=shape.faces,
                seen=drawn.seen,
                flaws=tuple(f"{drawn.label} {flaw}" for flaw in dict.fromkeys(flaws)),
                kinds=kinds,
                unseen_by=drawn.unseen_by,
                softened=lean > COARSE and drawn.softening > 0.0,
            )
        )
        reading.kinds[drawn.name] = reading.kinds.get(drawn.name, frozenset()) | kinds
        if nodes.VOLUME in kinds:
            reading.volumes.append(f"{drawn.name!r} is filled with a volume")
        glowing = used & shape.glowing
        if glowing or used & shape.fire:
            shining = triangles[np.isin(shape.slots[faces], list(glowing))] if glowing else triangles
            kind = "SURFACE" if glowing else "VOLUME"
            reading.lights.append(Light(drawn.name, kind, role, drawn.is_instance, drawn.matrix, corners=shining))


@dataclass(frozen=True)
class _Drawn:
    """An instance of a surface as it was read: its triangles (n, 3, 3) in the world, and what all of them share."""

    name: str
    label: str
    triangles: Array
    is_finite: bool
    shape: Shape
    matrix: Array
    is_instance: bool
    seen: bool
    unseen_by: frozenset[str]
    flaws: tuple[str, ...]
    softening: float


def one_layer(triangles: Array, plane: RelayPlane) -> Any:
    """Return which of a wall's triangles (n, 3, 3) are the relay wall: of those in its plane that lie on one another,
    as the two sides of a thin board do, the ones nearest to the height of the lit point."""
    faces = plane.faces.copy()
    heights = (plane.corners - plane.point) @ plane.normal
    pairs = coincident.overlapping(plane.corners - heights[..., None] * plane.normal)
    means = heights.mean(axis=1)
    # Parts in one place are told apart by nothing, and are reported (`survey`).
    pairs = pairs[np.ptp(means[pairs], axis=1) > coincident.NEAR * float(np.abs(triangles).max())]
    away = np.abs(means - (plane.hit - plane.point) @ plane.normal)
    farther = np.where(away[pairs[:, 0]] > away[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
    faces[np.flatnonzero(faces)[farther]] = False
    return faces


def _has_empty_slot(obj: bpy.types.Object) -> bool:
    """Whether a slot is linked to the object and empty, while the object's data have a material for it.

    Cycles uses the data's material in Blender 5.0, its default in 5.2; the evaluated object has the data's in both.
    """
    data_materials = getattr(obj.data, "materials", ())
    return any(
        slot.link == "OBJECT" and slot.material is None and material is not None
        for slot, material in zip(obj.material_slots, data_materials, strict=False)
    )


def _read_lamp(instance: Any, role: str, matrix: Array, order: int, reading: Reading) -> None:
    """Record a lamp if it emits light."""
    obj, lamp = instance.object, instance.object.data
    portal = lamp.type == "AREA" and lamp.cycles.is_portal
    power = lamp_power(lamp)
    if portal or power == 0.0 or not nodes.shines(lamp):
        return
    factor = nodes.radiance(lamp)
    power *= 1.0 if factor is None else sum(factor) / 3.0
    reading.lights.append(Light(obj.name, lamp.type, role, instance.is_instance, matrix, power))
    if role == "spot" and instance.is_instance:
        reading.reasons.append(f"the lamp {obj.name!r} shines once more, as an instance")
    elif role != "spot":
        glow, reasons = lamps.glow(instance, role, matrix, order)
        reading.reasons += reasons
        reading.glowing += [glow] if glow is not None else []


def _read_world(world: Any, order: int, reading: Reading) -> None:
    """Record the world's light and volume, and the reasons against an engine."""
    reading.sky, reasons = _sky(world, order)
    reading.reasons += reasons
    if world is None:
        return
    if nodes.glows(world):
        reading.lights.append(Light(world.name, "WORLD", "room", False, np.eye(4)))
    if nodes.read(world).volume:
        reading.volumes.append(f"the world {world.name!r} is filled with a volume")


def _read_substance(instance: Any, role: str, matrix: Array, reading: Reading) -> None:
    """Record hair, points and volumes, whose shape only Cycles knows."""
    obj = instance.object
    materials = [slot.material for slot in obj.material_slots] or [None]
    kinds = frozenset().union(*map(nodes.kinds, materials))
    if obj.type == "VOLUME" or nodes.VOLUME in kinds:
        kinds = frozenset({nodes.VOLUME})
        reading.volumes.append(f"{obj.name!r} is filled with a volume")
    reading.kinds[obj.name] = reading.kinds.get(obj.name, frozenset()) | kinds
    if any(map(nodes.glows, materials)):
        kind = "VOLUME" if obj.type == "VOLUME" else "SURFACE"
        reading.lights.append(Light(obj.name, kind, role, instance.is_instance, matrix))


RAYS = ("camera", "diffuse", "glossy", "transmission", "shadow")


def _unseen_by(instance: Any) -> list[str]:
    """Kinds of rays to which a surface is invisible."""
    objects = [instance.object] + ([instance.parent] if instance.is_instance else [])
    return [word for word in RAYS if not all(getattr(o, f"visible_{word}") for o in objects)]


def _visibility_flaws(instance: Any, layer: bpy.types.ViewLayer) -> list[str]:
    objects = [instance.object] + ([instance.parent] if instance.is_instance else [])
    flaws = []
    originals = [o.original for o in objects]
    if any(o.is_holdout or o.holdout_get(view_layer=layer) for o in originals):
        flaws.append("is a holdout")
    if any(o.indirect_only_get(view_layer=layer) for o in originals):
        flaws.append("is in a collection that is seen indirectly only")
    if any(o.is_shadow_catcher for o in originals):
        flaws.append("is a shadow catcher")
    if any(_terminator(o) for o in originals):
        flaws.append("has a shadow terminator offset, which darkens it where light grazes")
    return flaws


def _terminator(obj: bpy.types.Object) -> bool:
    """Whether an object's shading is smoothed where light grazes it, which affects flat faces too."""
    if hasattr(obj, "shadow_terminator_shading_offset"):  # Blender 5, where Cycles' own property is unused
        return bool(obj.shadow_terminator_shading_offset)
    return bool(obj.cycles.shadow_terminator_offset)


def _layer_reasons(scene: bpy.types.Scene) -> list[str]:
    """Reasons, from the view layers, why only plain Cycles can render a picture."""
    reasons = []
    rendered = [layer for layer in scene.view_layers if layer.use]
    if len(rendered) > 1:
        reasons.append(f"{len(rendered)} view layers are rendered, not one")
    for layer in rendered:
        if layer.material_override is not None:
            reasons.append(f"the view layer {layer.name!r} puts one material in place of all")
        if not layer.use_solid:
            reasons.append(f"the view layer {layer.name!r} leaves out solid faces")
        if getattr(layer, "world_override", None) is not None:
            reasons.append(f"the view layer {layer.name!r} has a world of its own")
        if not layer.use_sky and materials.ambient(scene) > 0.0:
            reasons.append(f"the view layer {layer.name!r} leaves out the world's light")
    return reasons


def _sky(world: Any, order: int) -> tuple[Array | None, list[str]]:
    """Radiance (3,), W/m^2/sr, of a world with uniform light, else None, and the reasons against an engine."""
    if world is None:
        return None, []
    reasons = []
    if nodes.read(world).volume:
        reasons.append(f"the world {world.name!r} is filled with a volume")
    if not nodes.shines(world):
        return None, reasons
    if not world.cycles_visibility.diffuse:
        reasons.append(f"the world {world.name!r} is not visible to diffuse rays")
    if world.cycles.max_bounces < order - 1:
        reasons.append(f"the world {world.name!r} has a limit of bounces of its own ({world.cycles.max_bounces})")
    radiance = nodes.radiance(world)
    if radiance is None:
        return None, [*reasons, f"the world {world.name!r} gives ambient light that is not one constant radiance"]
    return _lit(radiance), reasons


def _lit(radiance: Any) -> Array | None:
    values = np.array(radiance, dtype=np.float64)[:3]
    return values if values.any() else None
