"""One asymmetric shape in every format that a target may have, written by hand or by Blender's own exporters."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import bpy
import numpy as np

from generator.blender.scene import blend_file

VERTICES = np.array([(0, 0, 0), (0.3, 0, 0), (0.3, 0.2, 0), (0, 0.2, 0), (0, 0, 0.5), (0.1, 0, 0.5)])
"""A sheared block, metres, x right, y forward, z up; no rotation maps it onto itself."""
TRIANGLES = [(0, 2, 1), (0, 3, 2), (0, 1, 5), (0, 5, 4), (0, 4, 3), (1, 2, 5), (3, 4, 5), (3, 5, 2)]
OF_UP = {
    "X": lambda v: np.stack([v[:, 2], v[:, 1], -v[:, 0]], axis=1),
    "Y": lambda v: np.stack([v[:, 0], v[:, 2], -v[:, 1]], axis=1),
    "Z": lambda v: v,
}
"""Coordinates in a file whose axis of that name points up."""


def numbers(unit: float, up: str) -> np.ndarray:
    """Return the vertices as a file holds them, whose unit is so many metres."""
    return OF_UP[up](VERTICES) / unit


def obj(path: Path, unit: float, up: str) -> Path:
    """Write an OBJ."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in numbers(unit, up)]
    path.write_text("\n".join([*lines, *("f " + " ".join(str(i + 1) for i in t) for t in TRIANGLES)]) + "\n")
    return path


def ply(path: Path, unit: float, up: str) -> Path:
    """Write a PLY."""
    head = ["ply", "format ascii 1.0", f"element vertex {len(VERTICES)}", *(f"property float {a}" for a in "xyz")]
    head += [f"element face {len(TRIANGLES)}", "property list uchar int vertex_indices", "end_header"]
    lines = [f"{x:.9g} {y:.9g} {z:.9g}" for x, y, z in numbers(unit, up)]
    path.write_text("\n".join([*head, *lines, *("3 {} {} {}".format(*t) for t in TRIANGLES)]) + "\n")
    return path


def stl(path: Path, unit: float, up: str) -> Path:
    """Write a binary STL."""
    places = numbers(unit, up)
    facets = [struct.pack("<12fH", 0, 0, 0, *places[list(t)].ravel(), 0) for t in TRIANGLES]
    path.write_bytes(bytes(80) + struct.pack("<I", len(facets)) + b"".join(facets))
    return path


def gltf(path: Path, unit: float, up: str, **more: object) -> Path:
    """Write a glTF and its numbers beside it; it states nothing, for it is metres and Y up."""
    places = numbers(unit, up).astype("<f4")
    corners = np.array(TRIANGLES, dtype="<u2").ravel()
    path.with_suffix(".bin").write_bytes(places.tobytes() + corners.tobytes())
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": "../nowhere/else.png"}],
        "buffers": [{"uri": path.with_suffix(".bin").name, "byteLength": places.nbytes + corners.nbytes}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": places.nbytes},
            {"buffer": 0, "byteOffset": places.nbytes, "byteLength": corners.nbytes},
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": len(places),
                "type": "VEC3",
                "min": places.min(axis=0).tolist(),
                "max": places.max(axis=0).tolist(),
            },
            {"bufferView": 1, "componentType": 5123, "count": len(corners), "type": "SCALAR"},
        ],
        **more,
    }
    path.write_text(json.dumps(tree))
    return path


def usda(path: Path, unit: float, up: str, *, states: bool = True, more: str = "") -> Path:
    """Write a USD as text."""
    head = f'(\n    metersPerUnit = {unit:.9g}\n    upAxis = "{up}"\n)\n' if states else ""
    places = ", ".join(f"({x:.9g}, {y:.9g}, {z:.9g})" for x, y, z in numbers(unit, up))
    indices = ", ".join(str(i) for t in TRIANGLES for i in t)
    counts = ", ".join("3" * len(TRIANGLES))
    mesh = (
        f'def Xform "a" {{\n    def Mesh "m" {{\n        int[] faceVertexCounts = [{counts}]\n'
        f"        int[] faceVertexIndices = [{indices}]\n        point3f[] points = [{places}]\n"
        '        uniform token subdivisionScheme = "none"\n    }\n}\n'
    )
    path.write_text(f"#usda 1.0\n{head}{mesh}{more}")
    return path


def modelled(unit: float = 1.0) -> bpy.types.Scene:
    """Return a new scene with the shape, turned, scaled and parented, a lamp and a camera."""
    scene = blend_file.clear()
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    mesh = bpy.data.meshes.new("block")
    mesh.from_pydata((4.0 * VERTICES @ turn).tolist(), [], TRIANGLES)
    mesh.materials.append(bpy.data.materials.new("paint"))
    parent, block = bpy.data.objects.new("holder", None), bpy.data.objects.new("block", mesh)
    block.parent, block.rotation_euler, parent.scale = parent, (0.0, 0.0, np.pi / 2.0), (0.25 / unit,) * 3
    parent.location = (1.0, 2.0, 3.0)
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "POINT"))
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    for made in (parent, block, lamp, camera):
        scene.collection.objects.link(made)
    scene.unit_settings.scale_length = unit
    bpy.context.view_layer.update()
    return scene


def centred(points: np.ndarray) -> np.ndarray:
    """Return points about the middle of their bounding box, in an order that does not depend on the file's."""
    about = points - (points.min(axis=0) + points.max(axis=0)) / 2.0
    return np.unique(about.round(6) + 0.0, axis=0)
