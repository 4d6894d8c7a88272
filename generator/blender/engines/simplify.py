"""What a scene holds that the engine `surfel` does not model, piece by piece, and the scene without some of it."""

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
"""Faces of a mesh from which its detail is worth a question."""
_COARSE = 100
"""Faces that are left of it."""
_HAIR = "the hair of "
_LAMP = "the lamp "
FINE = "the fine mesh of "
"""What costs `surfel` time, and is no more than that."""
_GREY = 0.8


def removable_pieces(scene: bpy.types.Scene) -> list[str]:
    """Return what of a scene `surfel` does not model, or at a price, each piece by the name that `apply` knows."""
    return list(_pieces(scene))


def lights(scene: bpy.types.Scene) -> list[str]:
    """Return those of `found` that give light of their own, to which the rest adds nothing."""
    return [name for name in removable_pieces(scene) if name == AMBIENT or name.startswith(_LAMP)]


def apply(scene: bpy.types.Scene, names: Iterable[str]) -> None:
    """Leave pieces out of the open scene.

    Parameters
    ----------
    scene : bpy.types.Scene
        It is changed, for good.
    names : iterable of str
        Of `found`, or of objects that play no single role, which are hidden. What the engine leaves out by itself
        (`transport.left_out`) is no piece of the scene, and counts nothing.

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
    """Put out the spot lamp, so that only the other lights of the open scene are left."""
    roles.find(scene, "spot").hide_render = True


def _pieces(scene: bpy.types.Scene) -> dict[str, Callable[[], None]]:
    """What leaves a piece out, by its name."""
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
    """Whether an object is what a sweep is about: camera, spot, wall."""
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
    """Take the world's light and leave its fog."""
    for owner, name in materials.worlds_of(scene):
        setattr(owner, name, nodes.darkened(getattr(owner, name)))


def _shave(obj: bpy.types.Object) -> None:
    for modifier in [m for m in obj.modifiers if m.type == "PARTICLE_SYSTEM"]:
        modifier.show_render = False


def _flatten(obj: bpy.types.Object) -> None:
    """Shade an object's faces as the planes that they are."""
    obj.data = obj.data.copy()  # others may share it
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
    """Give an object without a material the grey of Cycles' own, but none of its gloss."""
    material = bpy.data.materials.new("NLOS plain")
    _make_plain(material)
    if obj.material_slots:
        obj.material_slots[0].material = material
    else:
        obj.data.materials.append(material)


def _make_plain(material: bpy.types.Material) -> None:
    """Make a material a Lambertian reflector of about its own colour."""
    colour = _colour(material)
    if not nodes.uses_nodes(material):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Roughness"].default_value = 0.0
    shader.inputs["Color"].default_value = (*colour, 1.0)
    tree.links.new(shader.outputs["BSDF"], output.inputs["Surface"])


def _colour(material: bpy.types.Material) -> tuple[float, ...]:
    """What part of the light a material reflects, as far as its nodes tell; that of a lamp is black."""
    found = []
    for part in nodes.read(material).surface:
        name = next((n for n in ("Base Color", "Color") if n in part.inputs), "")
        if part.kind in ("EMISSION", "HOLDOUT"):
            found.append(np.zeros(3))
        elif name:
            found.append(_value(part, name))
    mean = np.clip(np.mean(found, axis=0) if found else np.full(3, _GREY), 0.0, 1.0)
    return tuple(float(c) for c in mean)


def _value(part: nodes.Part, name: str) -> Any:
    """The mean colour that an input of a shader is given."""
    colour, image = part.colour(name), part.images.get(name)
    if colour is not None:
        return np.array(colour)
    if image is None or (not image.has_data and not image.size[0]):
        return np.full(3, _GREY)
    pixels = np.empty(len(image.pixels), dtype=np.float32)
    image.pixels.foreach_get(pixels)
    colours = pixels.reshape(-1, image.channels)[:, : min(3, image.channels)]
    if image.colorspace_settings.name == "sRGB" and not image.is_float:
        colours = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    return np.resize(colours.mean(axis=0), 3)
