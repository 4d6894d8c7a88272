"""A target from a file: it is read beside, its size is told, and nothing else of the file comes into the scene."""

from __future__ import annotations

import json
import struct
import time

import bpy
from helpers import WORK, call, check, module, redraw, screenshot, tab, until

CORNERS = [(0, 0, 0), (30, 0, 0), (30, 20, 0), (0, 20, 0), (0, 0, 50), (30, 0, 50), (30, 20, 50), (0, 20, 50)]
TRIANGLES = [
    *((0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4)),
    *((1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)),
]


def stl(path):
    facets = [struct.pack("<12fH", 0, 0, 0, *(x for i in t for x in CORNERS[i]), 0) for t in TRIANGLES]
    path.write_bytes(bytes(80) + struct.pack("<I", len(facets)) + b"".join(facets))


def gltf(path):
    """The same in metres, Y up, with a material and a lamp."""
    places = b"".join(struct.pack("<3f", x / 100, z / 100, -y / 100) for x, y, z in CORNERS)
    corners = b"".join(struct.pack("<3H", *t) for t in TRIANGLES)
    path.with_suffix(".bin").write_bytes(places + corners)
    tree = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point"}]}},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"extensions": {"KHR_lights_punctual": {"light": 0}}}],
        "materials": [{"name": "paint"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "buffers": [{"uri": path.with_suffix(".bin").name, "byteLength": len(places + corners)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(places)},
            {"buffer": 0, "byteOffset": len(places), "byteLength": len(corners)},
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 8,
                "type": "VEC3",
                "min": [0, 0, -0.2],
                "max": [0.3, 0.5, 0],
            },
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
    }
    path.write_text(json.dumps(tree))


def words():
    found = module("view.target_file").words(bpy.context.scene.nlos)
    return " ".join(text for text, _ in found)


def size():
    target = next(o for o in bpy.context.scene.objects if o.get("nlos_role") == "target")
    return tuple(round(edge, 4) for edge in target.dimensions)


def counts():
    kinds = ("objects", "meshes", "materials", "lights", "cameras", "images", "collections", "scenes")
    return {kind: len(getattr(bpy.data, kind)) for kind in kinds}


def told():
    """The panel reads the file by itself, and says what comes of it."""
    yield from tab("NLOS")
    stl(WORK / "block.stl")
    gltf(WORK / "block.gltf")
    settings = bpy.context.scene.nlos
    settings.target_kind, settings.target_mesh = "mesh", str(WORK / "block.stl")
    redraw()
    yield from until(lambda: "30 x 20 x 50 m" in words(), "its size in metres is told")
    check("larger than a voxel" in words(), f"and that it is too large: {words()}")
    yield from screenshot("25-target-large")
    settings.target_unit = "cm"
    yield from until(lambda: "0.3 x 0.2 x 0.5 m" in words(), "in centimetres it is a hundredth")
    check("larger" not in words(), f"which is not too large: {words()}")
    yield from screenshot("25-target")


def built():
    """Build has what was read; from another file it waits, while the window does not."""
    check(call(bpy.ops.nlos.build_scene) == {"FINISHED"}, "it builds")
    before = counts()
    check(size() == (0.3, 0.2, 0.5), f"a block of that size: {size()}")
    settings = bpy.context.scene.nlos
    settings.target_mesh, settings.target_unit = str(WORK / "block.gltf"), "auto"
    start = time.perf_counter()
    check(call(bpy.ops.nlos.build_scene) == {"FINISHED"}, "it builds later")
    held = 1e3 * (time.perf_counter() - start)
    check(held < 50.0, f"it holds the window for {held:.0f} ms")
    target = next(o for o in bpy.context.scene.objects if o.get("nlos_role") == "target")
    check(target["nlos_target_file"]["name"] == "block.stl", "the scene waits for the file")
    name = lambda: next(  # noqa: E731
        o["nlos_target_file"]["name"] for o in bpy.context.scene.objects if o.get("nlos_role") == "target"
    )
    yield from until(lambda: name() == "block.gltf", "then it is built")
    check(size() == (0.3, 0.2, 0.5), f"the same block: {size()}")
    check("left out: 1 material, 1 light" in words(), f"and what it lacks is told: {words()}")
    check(counts() == before, f"nothing else came: {before}, {counts()}")
    check(call(bpy.ops.ed.undo) == {"FINISHED"}, "undo runs")
    yield 0.5
    check(name() == "block.stl", "undo brings the former back")


def refused():
    """What cannot be read is a sentence in the panel."""
    settings = bpy.context.scene.nlos
    (WORK / "block.usda").write_text("nonsense")
    settings.target_mesh = str(WORK / "block.usda")
    redraw()
    yield from until(lambda: "is not a USD file" in words(), "what is no USD is named")
    check("choose" not in words(), words())
    settings.target_mesh = str(WORK / "gone.stl")
    yield from until(lambda: "no such file" in words(), "what is not there is named")
    yield from screenshot("25-target-gone")
    settings.target_kind = "sheet"
    check(words() == "", "a sheet needs no file")
    check(call(bpy.ops.nlos.build_scene) == {"FINISHED"}, "and is built")


STEPS = [told, built, refused]
