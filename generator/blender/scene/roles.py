"""Roles of objects, stored as their custom properties, so that scenes may be edited and objects renamed."""

from __future__ import annotations

from typing import Any

import bpy

from generator.blender.scene import roles
from generator.blender.scene.words import file_name, short
from generator.files.toml import from_dict
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid


def refuse_hidden(scene: bpy.types.Scene) -> None:
    """Raise NlosError if the target is not rendered."""
    target = roles.find(scene, "target")
    if why := roles.unseen(scene, target):
        raise NlosError(f"{bpy.data.filepath or 'scene'}: the target {target.name!r} {why}; show it")


ROLE = "nlos_role"


BUILT = "nlos_built"
"""Mark of what `build` made and may remove again."""


KIND = "nlos_target_kind"


SURFACE = "nlos_surface"


TARGET_FILE = "nlos_target_file"
"""How the target's file was read: fields of `mesh_file.Read`."""


GRID_LO, GRID_HI, GRID_SHAPE = "nlos_grid_lo", "nlos_grid_hi", "nlos_grid_shape"


PRESET = "nlos_preset"


COLLECTION = "NLOS"


# Roles that exactly one object plays; "room" and "partition" are played by any number.
SINGLE_ROLES = ("relay_wall", "spot", "camera", "target")


_NO_SURFACE = ("LIGHT_PROBE", "CAMERA", "SPEAKER", "ARMATURE", "LATTICE")


def limit_reflections(scene: bpy.types.Scene, order: int) -> None:
    """Limit Cycles to a number of reflections: the only place that converts them to bounces.

    Cycles counts bounces after the camera ray's first hit, which is itself a reflection, so order n is n - 1 bounces.
    """
    cycles = cycles_settings(scene)
    scene.render.engine = "CYCLES"
    for kind in ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces"):
        setattr(cycles, kind, order - 1)
    cycles.volume_bounces = 0
    # Russian roulette saves nothing on paths this short and adds noise.
    cycles.min_light_bounces = min(order, 1024)


def reflection_order(scene: bpy.types.Scene) -> int:
    """Return the reflection order that the scene's Cycles settings allow."""
    cycles = cycles_settings(scene)
    return int(min(cycles.max_bounces, cycles.diffuse_bounces)) + 1


def cycles_settings(scene: bpy.types.Scene) -> Any:
    """Return Cycles' settings; raise NlosError if Cycles is switched off."""
    if not hasattr(scene, "cycles"):
        raise NlosError("Cycles is switched off: enable it in Preferences > Add-ons (Cycles Render Engine)")
    return scene.cycles


def write_grid(scene: bpy.types.Scene, grid: VoxelGrid) -> None:
    """Store the voxel grid in the scene."""
    scene[GRID_LO], scene[GRID_HI], scene[GRID_SHAPE] = grid.lo, grid.hi, grid.shape


def find(scene: bpy.types.Scene, role: str) -> bpy.types.Object:
    """Return the one object that plays a role.

    Raises
    ------
    NlosError
        No object plays it, or more than one does.
    """
    objs = players(scene, role)
    label = role.replace("_", " ")
    if not objs:
        raise NlosError(
            f"{file_name()}: no object is the {label}; give one the custom property {ROLE} = {role!r} in Blender"
        )
    if len(objs) > 1:
        names = ", ".join(repr(o.name) for o in objs)
        raise NlosError(
            f"{file_name()}: {len(objs)} objects are named as {label} ({names}); only one may have {ROLE} = {role!r}"
        )
    return objs[0]


def players(scene: bpy.types.Scene, role: str) -> list[bpy.types.Object]:
    """Return every object of the scene that plays a role."""
    return [o for o in scene.objects if o.get(ROLE) == role]


def unseen(scene: bpy.types.Scene, obj: bpy.types.Object) -> str:
    """Return why an object is not rendered, as a phrase that follows its name; empty if it is rendered."""
    if obj.hide_render:
        return "is hidden from renders"

    def shown(layer: Any) -> bool:
        if layer.exclude or layer.collection.hide_render:
            return False
        return obj.name in layer.collection.objects or any(map(shown, layer.children))

    if any(layer.use and shown(layer.layer_collection) for layer in scene.view_layers):
        return ""
    return "is in no collection that is rendered"


def show(scene: bpy.types.Scene, obj: bpy.types.Object) -> None:
    """Make an object, and the collections that hold it, visible in renders."""
    obj.hide_render = False

    def open_up(layer: Any) -> bool:
        below = [open_up(child) for child in layer.children]  # visits all children, not only the first that holds it
        if obj.name in layer.collection.objects or any(below):
            if layer.exclude and layer.collection != scene.collection:
                layer.exclude = False
            layer.collection.hide_render = False
            return True
        return False

    for layer in scene.view_layers:
        open_up(layer.layer_collection)


def others(scene: bpy.types.Scene) -> list[str]:
    """Return the names of rendered objects without a role that are not part of the target: what an artist added."""
    with_target = {child for target in players(scene, "target") for child in target.children_recursive}
    return sorted(
        o.name
        for o in scene.objects
        if ROLE not in o and o not in with_target and not o.hide_render and o.type not in ("EMPTY", "CAMERA")
    )


def target_parts(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the target, followed by all its rendered descendants, which move with it.

    Raises
    ------
    NlosError
        There is not exactly one target.
    """
    target = find(scene, "target")
    scene_objects = set(scene.objects)
    children = [o for o in target.children_recursive if o in scene_objects and ROLE not in o and not o.hide_render]
    return [target, *(o for o in children if o.type not in _NO_SURFACE)]


def read_grid(scene: bpy.types.Scene) -> VoxelGrid:
    """Return the voxel grid that is stored in the scene.

    Raises
    ------
    NlosError
        No grid is stored, or the stored values are not a valid grid.
    """
    missing = [key for key in (GRID_LO, GRID_HI, GRID_SHAPE) if key not in scene]
    if missing:
        raise NlosError(f"{file_name()}: lacks the voxel grid (custom property {missing[0]} of the scene)")
    if not all(hasattr(scene[key], "__len__") for key in (GRID_LO, GRID_HI, GRID_SHAPE)):
        raise NlosError(
            f"{file_name()}: the voxel grid (custom properties {GRID_LO} and so on) must be three lists of three"
        )
    data = {
        "lo": [short(v) for v in scene[GRID_LO]],
        "hi": [short(v) for v in scene[GRID_HI]],
        "shape": [int(v) for v in scene[GRID_SHAPE]],
    }
    grid: VoxelGrid = from_dict(VoxelGrid, data, "grid.")
    return grid


def target_file(scene: bpy.types.Scene) -> dict[str, Any]:
    """Return how the target's file was read (`mesh_file.Read`); empty if it is of no file, or of old times."""
    kept = find(scene, "target").get(TARGET_FILE)
    return dict(kept.to_dict()) if hasattr(kept, "to_dict") else {}
