"""Finds the pieces of a scene that the engine `surfel` does not model or that cost it time, and removes them."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from typing import Any

import bpy
import numpy as np

from generator.blender.engines.reading import MAX_ORDER
from generator.blender.engines.shapes import is_smooth
from generator.blender.scene import materials, nodes, roles
from generator.model.errors import NlosError
from generator.transport.left_out import PARTS

BEYOND = "reflections beyond the third"
AMBIENT = "ambient light"
_MANY = 400
"""Number of faces from which a mesh is offered for simplification."""
_COARSE = 100
"""Number of faces after simplification."""
_HAIR = "the hair of "
_LAMP = "the lamp "
FINE = "the fine mesh of "
"""Start of the names of pieces that `surfel` models, but that cost it time."""
_GREY = 0.8


def removable_pieces(scene: bpy.types.Scene) -> list[str]:
    """Return the names, for `apply`, of the pieces of a scene that `surfel` does not model or that cost it time."""
    return list(_pieces(scene))


def lights(scene: bpy.types.Scene) -> list[str]:
    """Return those of `removable_pieces` that emit light, which simply adds to that of the spot."""
    return [name for name in removable_pieces(scene) if name == AMBIENT or name.startswith(_LAMP)]


def apply(scene: bpy.types.Scene, names: Iterable[str]) -> None:
    """Remove pieces from the open scene.

    Parameters
    ----------
    scene : bpy.types.Scene
        Changed permanently.
    names : iterable of str
        From `removable_pieces`, or names of objects without a single role, which are hidden. What the engine leaves
        out by itself (`transport.left_out`) is no piece of the scene, and is ignored.

    Raises
    ------
    NlosError
        There is no such piece.
    """
    pieces = _pieces(scene)
    named = [roles.find(scene, role).name for role in roles.SINGLE_ROLES]
    for name in set(names).difference(PARTS):
        if name in pieces:
            pieces[name]()
        elif name in scene.objects and name not in named:
            scene.objects[name].hide_render = True
        else:
            raise NlosError(
                f"leave_out: {name!r} is not in {bpy.data.filepath or 'the scene'}; it may have been edited since; "
                "plan again"
            )


def without_light(scene: bpy.types.Scene) -> None:
    """Switch the spot lamp off, so that only the other lights of the open scene are left."""
    roles.find(scene, "spot").hide_render = True


def _pieces(scene: bpy.types.Scene) -> dict[str, Callable[[], None]]:
    """Functions that remove a piece, by the name of the piece."""
    pieces: dict[str, Callable[[], None]] = {}
    if roles.reflection_order(scene) > MAX_ORDER:
        pieces[BEYOND] = functools.partial(roles.limit_reflections, scene, MAX_ORDER)
    if materials.ambient(scene) > 0.0:
        pieces[AMBIENT] = functools.partial(_put_out_the_sky, scene)
    named = {roles.find(scene, role): role for role in roles.SINGLE_ROLES}
    shown = [o for o in scene.objects if not roles.unseen(scene, o) and not _keeps(o, named)]
    for obj in shown:
        if obj.type == "LIGHT":
            if obj.data.energy != 0.0:
                pieces[_LAMP + repr(obj.name)] = functools.partial(setattr, obj, "hide_render", True)
        elif obj.type in ("MESH", "CURVE", "SURFACE", "FONT", "META"):
            _add_mesh(pieces, obj, target=named.get(obj) == "target")
        elif obj.type not in ("EMPTY", "CAMERA", "SPEAKER", "ARMATURE", "LATTICE", "LIGHT_PROBE"):
            pieces[obj.name] = functools.partial(setattr, obj, "hide_render", True)
    used = {slot.material for obj in shown if obj.type != "LIGHT" for slot in obj.material_slots}
    for material in sorted(used - {None}, key=lambda m: m.name):
        if nodes.diffuse(material) is None:
            pieces[f"the material {material.name!r}"] = functools.partial(_make_plain, material)
    return pieces


def _keeps(obj: bpy.types.Object, named: dict[bpy.types.Object, str]) -> bool:
    """Whether a sweep needs an object as it is: camera, spot, relay wall."""
    return named.get(obj) in ("camera", "spot", "relay_wall")


def _add_mesh(pieces: dict[str, Callable[[], None]], obj: bpy.types.Object, *, target: bool) -> None:
    if any(s.settings.type == "HAIR" for s in obj.particle_systems):
        pieces[f"{_HAIR}{obj.name!r}"] = functools.partial(_shave, obj)
    if not [slot for slot in obj.material_slots if slot.material]:
        pieces[f"the default material of {obj.name!r}"] = functools.partial(_paint, obj)
    if obj.type != "MESH" or (target and obj.get(roles.KIND) == "sphere"):
        return
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    if mesh is None:  # its modifiers leave only curves, points or a volume
        return
    faces, curved = len(mesh.polygons), is_smooth(mesh)
    evaluated.to_mesh_clear()
    if curved:
        pieces[f"the curved shading of {obj.name!r}"] = functools.partial(_flatten, obj)
    if faces >= _MANY:
        pieces[f"{FINE}{obj.name!r}"] = functools.partial(_coarsen, obj, _COARSE / faces)


def _put_out_the_sky(scene: bpy.types.Scene) -> None:
    """Remove the world's light and keep its volume."""
    for owner, name in materials.worlds_of(scene):
        setattr(owner, name, nodes.darkened(getattr(owner, name)))


def _shave(obj: bpy.types.Object) -> None:
    for modifier in [m for m in obj.modifiers if m.type == "PARTICLE_SYSTEM"]:
        modifier.show_render = False


def _flatten(obj: bpy.types.Object) -> None:
    """Set an object's faces to flat shading."""
    obj.data = obj.data.copy()  # other objects may share it
    obj.data.polygons.foreach_set("use_smooth", np.zeros(len(obj.data.polygons), dtype=bool))
    if "custom_normal" in obj.data.attributes:
        obj.data.attributes.remove(obj.data.attributes["custom_normal"])
    for modifier in [m for m in obj.modifiers if m.type in ("WEIGHTED_NORMAL", "NORMAL_EDIT")]:
        obj.modifiers.remove(modifier)
    obj.data.update()


def _coarsen(obj: bpy.types.Object, ratio: float) -> None:
    modifier = obj.modifiers.new("NLOS coarser", "DECIMATE")
    modifier.ratio = ratio


def _paint(obj: bpy.types.Object) -> None:
    """Give an object without a material the grey of Cycles' default material, without its gloss."""
    material = bpy.data.materials.new("NLOS plain")
    _make_plain(material)
    if obj.material_slots:
        obj.material_slots[0].material = material
    else:
        obj.data.materials.append(material)


def _make_plain(material: bpy.types.Material) -> None:
    """Make a material a Lambertian reflector of about its own colour."""
    materials.make_lambertian(material, _colour(material))


def _colour(material: bpy.types.Material) -> tuple[float, ...]:
    """Approximate albedo of a material according to its nodes; black for an emitter."""
    colours = []
    for part in nodes.read(material).surface:
        name = next((n for n in ("Base Color", "Color") if n in part.inputs), "")
        if part.kind in ("EMISSION", "HOLDOUT"):
            colours.append(np.zeros(3))
        elif name:
            colours.append(_value(part, name))
    mean = np.clip(np.mean(colours, axis=0) if colours else np.full(3, _GREY), 0.0, 1.0)
    return tuple(float(c) for c in mean)


def _value(part: nodes.Part, name: str) -> Any:
    """Mean colour of a shader's input."""
    colour, image = part.colour(name), part.images.get(name)
    if colour is not None:
        return np.array(colour)
    if image is None or (not image.has_data and not image.size[0]):
        return np.full(3, _GREY)
    pixels = np.empty(len(image.pixels), dtype=np.float32)
    image.pixels.foreach_get(pixels)
    colours = pixels.reshape(-1, image.channels)[:, : 3 if image.channels >= 3 else 1]  # of two, the second is alpha
    if image.colorspace_settings.name == "sRGB" and not image.is_float:
        colours = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    return np.resize(colours.mean(axis=0), 3)
