"""Relay walls as they are in real scenes: slabs, walls with openings, rooms of one mesh."""

from __future__ import annotations

import bpy
import numpy as np

from generator.blender.scene import roles


def shape(scene, vertices, faces, slots=None):
    """Give the relay wall another mesh, in the world's frame, with the materials of the wall; faces have slots."""
    wall = roles.find(scene, "relay_wall")
    mesh = bpy.data.meshes.new(wall.name)
    mesh.from_pydata([tuple(map(float, v)) for v in vertices], [], faces)
    for material in wall.data.materials:
        mesh.materials.append(material)
    for face, slot in zip(mesh.polygons, slots or [0] * len(faces), strict=True):
        face.material_index = slot
    wall.data = mesh
    bpy.context.view_layer.update()
    return wall


def slab(scene, thickness=0.02):
    """Make the relay wall a slab whose face at y = 0 is the sheet that it was."""
    corners = world_corners(roles.find(scene, "relay_wall"))
    back = corners - [0.0, thickness, 0.0]
    sides = [(i, (i + 1) % 4, 4 + (i + 1) % 4, 4 + i) for i in range(4)]
    return shape(scene, [*corners, *back], [(0, 1, 2, 3), (7, 6, 5, 4), *sides])


def joined(scene):
    """Make relay wall, floor, ceiling and other walls one mesh, each part with its own material."""
    wall, parts = roles.find(scene, "relay_wall"), roles.players(scene, "room")
    vertices, faces, slots = [], [], []
    for part in (wall, *parts):
        faces.append(tuple(range(len(vertices), len(vertices) + 4)))
        vertices += world_corners(part).tolist()
        if part is not wall:
            wall.data.materials.append(part.data.materials[0])
        slots.append(len(wall.data.materials) - 1)
    result = shape(scene, vertices, faces, slots)
    for part in parts:
        bpy.data.objects.remove(part)
    return result


def with_opening(scene, x, z, thickness=0.02):
    """Make the relay wall a slab with a rectangular opening, ``x`` and ``z`` from and to, metres."""
    corners = world_corners(roles.find(scene, "relay_wall"))
    xs = [corners[:, 0].min(), *x, corners[:, 0].max()]
    zs = [corners[:, 2].min(), *z, corners[:, 2].max()]
    points = [(a, y, c) for y in (0.0, -thickness) for c in zs for a in xs]
    cells = [(i, k) for k in range(3) for i in range(3) if (i, k) != (1, 1)]
    quads = [(4 * k + i, 4 * k + i + 1, 4 * k + i + 5, 4 * k + i + 4) for i, k in cells]
    reveal = [5, 6, 10, 9]
    rim = [0, 1, 2, 3, 7, 11, 15, 14, 13, 12, 8, 4]
    around = [(r[i - 1], r[i], r[i] + 16, r[i - 1] + 16) for r in (reveal, rim) for i in range(len(r))]
    return shape(scene, points, [*quads, *(tuple(16 + v for v in q) for q in quads), *around])


def world_corners(obj):
    """Return the corners of an object that is one face, in the order of the face, (n, 3), metres."""
    [face] = obj.data.polygons
    return np.array([obj.matrix_world @ obj.data.vertices[v].co for v in face.vertices], dtype=np.float64)
