"""Meshes of a scene: corners, faces, colours, and the flaws of their materials and shading."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from generator.blender.engines.surface import Shape
from generator.blender.scene import nodes
from generator.model.arrays import Array
from generator.transport import facets
from generator.transport.world import SMOOTHEST

SMOOTH = 1e-3
"""Angle between a corner's normal and its face's, radians, above which the shading differs visibly."""


COARSE = 0.1
"""The same angle, radians, above which shadows differ too: as for an icosphere of 320 faces or fewer."""


TINT, ROUGHNESS, MULTIPLE, GLOSS = 0, 3, 4, 7
"""Columns of gloss, as in `world.Gloss`: tint (3), black where a face is not glossy; roughness; `multiple` (3). And
their number."""


def shape_of(obj: Any) -> Shape:
    """Return an evaluated object's triangles, colours and flaws, in its own frame."""
    mesh = obj.to_mesh()
    try:
        mesh.calc_loop_triangles()
        vertices = _values(mesh.vertices, "co", 3, np.float32)
        triangles = _values(mesh.loop_triangles, "vertices", 3, np.int32)
        corners = vertices[triangles].astype(np.float64)
        polygon = _values(mesh.loop_triangles, "polygon_index", 1, np.int32)[:, 0]
        slot = _values(mesh.polygons, "material_index", 1, np.int32)[:, 0][polygon]
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        solid = sides.any(axis=1)  # a triangle without area neither reflects nor hides anything
        edges = np.bincount(_values(mesh.loops, "edge_index", 1, np.int32)[:, 0])
        materials = [s.material for s in obj.material_slots] or [None]
        slots = np.clip(slot[solid], 0, len(materials) - 1)  # as Cycles does
        colours, radiance, gloss, flaws = _colours(materials, slots)
        kinds = {int(i): nodes.kinds(materials[i]) for i in np.unique(slots)}
        glowing = frozenset(i for i in kinds if materials[i] is not None and nodes.shines(materials[i]))
        return Shape(
            corners=corners[solid],
            slots=slots,
            albedo=colours,
            radiance=radiance,
            gloss=gloss,
            closed=bool((edges[edges > 0] == 2).all()),
            lean=_leans(mesh)[polygon[solid]],
            faces=len(mesh.polygons),
            flaws=flaws,
            kinds=kinds,
            glowing=glowing,
            fire=frozenset(i for i in kinds if materials[i] is not None and nodes.glows(materials[i])) - glowing,
        )
    finally:
        obj.to_mesh_clear()


def _values(collection: Any, name: str, width: int, kind: type) -> Any:
    values: Any = np.empty(len(collection) * width, dtype=kind)
    collection.foreach_get(name, values)
    return values.reshape(-1, width)


_SLIVERS = 1e-6
"""Share of a mesh's area that its smallest faces may have together to be of no account."""


def is_smooth(mesh: Any) -> bool:
    """Whether any corner's normal differs from its face's: shading that is set smooth may still be flat."""
    return bool((_leans(mesh) > SMOOTH).any())


def _leans(mesh: Any) -> Array:
    """Largest angle between the normals of each face's corners and its own, radians, at most a right angle, (n,)."""
    leans = np.zeros(len(mesh.polygons))
    if not len(leans):
        return leans
    shading = _values(mesh.corner_normals, "vector", 3, np.float32)
    loops = _values(mesh.polygons, "loop_total", 1, np.int32)[:, 0]
    faces = np.repeat(_values(mesh.polygons, "normal", 3, np.float32), loops, axis=0)
    sine = np.linalg.norm(np.cross(shading, faces), axis=1)
    lean = np.where((shading * faces).sum(axis=1) < 0, math.pi / 2.0, np.arcsin(np.minimum(sine, 1.0)))
    np.maximum.at(leans, np.repeat(np.arange(len(loops)), loops), lean)
    # Bevels and the like leave slivers, whose normals are of rounding alone: what little they are does not count.
    areas = _values(mesh.polygons, "area", 1, np.float32)[:, 0].astype(np.float64)
    order = np.argsort(areas)
    leans[order[np.cumsum(areas[order]) <= _SLIVERS * areas.sum()]] = 0.0
    return leans


def _colours(materials: Sequence[Any], slots: Any) -> tuple[Array, Array, Array, dict[int, str]]:
    """Return albedo and radiance (n, 3) and gloss (n, GLOSS) of faces with given materials, and these' flaws."""
    albedo, radiance = np.zeros((2, len(materials), 3))
    gloss = np.zeros((len(materials), GLOSS))
    flaws = {}
    for index in map(int, np.unique(slots)):
        material = materials[index]
        found = None if material is None else nodes.reflector(material)
        if found is None:
            flaws[index] = _material_flaw(material)
        elif min(found.albedo) < 0.0 or max(found.albedo) > 1.0 or (found.glossy and not _is_colour(found.glossy)):
            flaws[index] = f"has a material ({material.name!r}) whose colour is not between 0 and 1"
        elif min(found.radiance) < 0.0:
            flaws[index] = f"has a material ({material.name!r}) that gives negative light"
        else:
            albedo[index], radiance[index] = found.albedo, found.radiance
            if found.glossy is not None and found.glossy.share > 0.0 and any(found.glossy.colour):
                gloss[index] = _gloss(found.glossy)
    return albedo[slots], radiance[slots], gloss[slots], flaws


def _is_colour(glossy: nodes.Glossy) -> bool:
    """Whether a glossy reflection's colour, with its share and without, lies between 0 and 1."""
    low, high = min(glossy.colour), max(glossy.colour)
    return low >= 0.0 and max(1.0, glossy.share) * high <= 1.0 and glossy.share >= 0.0


def _gloss(glossy: nodes.Glossy) -> Array:
    """Return a row of gloss (GLOSS,)."""
    followed = glossy.multiple and glossy.roughness >= SMOOTHEST
    again = facets.multiple(glossy.colour, glossy.roughness) if followed else (0.0, 0.0, 0.0)
    return np.array([*(glossy.share * c for c in glossy.colour), glossy.roughness, *again])


def _material_flaw(material: Any) -> str:
    if material is None:
        return "has no material, so that Cycles takes one of its own, which is glossy"
    shader, has = nodes.read(material), f"has a material ({material.name!r}) that"
    if shader.volume:
        return f"{has} fills it with a volume"
    if shader.displaced:
        return f"{has} displaces it"
    if nodes.glows(material):
        return f"{has} may give light of its own, which is not constant, or not all"
    return f"{has} is not one constant colour, diffuse and with at most one gloss (GGX)"


def softening(obj: bpy.types.Object) -> float:
    """Return by how much Cycles moves the start of shadow rays where shading is smooth (geometry offset)."""
    return float(getattr(*softener(obj)))


def softener(obj: bpy.types.Object) -> tuple[Any, str]:
    """Return the owner of the setting that `softening` reads, and the attribute's name."""
    name = "shadow_terminator_geometry_offset"
    return (obj, name) if hasattr(obj, name) else (obj.cycles, name)
