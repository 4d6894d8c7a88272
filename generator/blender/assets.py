"""A library of assets for Blender's asset browser: walls, lamps, cameras, partitions, targets, clutter, materials."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import bpy
import numpy as np

from generator.blender import asset_previews
from generator.blender.scene import blend_file, build, materials, roles
from generator.files.writing import atomic, write_text
from generator.model.albedos import ALBEDOS, TYPICAL, Albedo
from generator.model.arrays import Range, Vector
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.scene import Target

FILE, CATALOGS = "nlos_lab.blend", "blender_assets.cats.txt"
"""Files of the library; Blender looks for catalogs under that name."""
LARGEST = 400_000
"""Bytes that the library takes at most."""
AUTHOR = "NLOS Lab"

_CATALOG_IDS = {
    "": "6b6d8a52-0a0f-4c0e-8d2a-3f1e5a7c0000",
    "Relay walls": "6b6d8a52-0a0f-4c0e-8d2a-3f1e5a7c0001",
    "Lamps": "6b6d8a52-0a0f-4c0e-8d2a-3f1e5a7c0002",
    "Cameras": "6b6d8a52-0a0f-4c0e-8d2a-3f1e5a7c0003",
    "Partitions": "6b6d8a52-0a0f-4c0e-8d2a-3f1e5a7c0004",
    "Targets": "6b6d8a52-0a0f-4c0e-8d2a-3f1e5a7c0005",
    "Clutter": "6b6d8a52-0a0f-4c0e-8d2a-3f1e5a7c0006",
    "Materials": "6b6d8a52-0a0f-4c0e-8d2a-3f1e5a7c0007",
}
"""Catalogs by the name under ``NLOS``, which is one itself. Blender knows them by their ids, so ids never change."""

_Box: TypeAlias = tuple[Vector, Vector]
"""Lowest and highest corner, metres."""
_Mesh: TypeAlias = tuple[list[Vector], list[tuple[int, ...]]]
"""Vertices, metres, and faces."""


@dataclass(frozen=True)
class _Shape:
    """A mesh asset.

    Attributes
    ----------
    name, catalog, words : str
    material : str
        Name of its albedo.
    mesh : (list, list)
        Vertices and faces.
    role : str
        Role that it plays; empty for none.
    location : (float, float, float)
        Where it stands in the preset ``room``.
    """

    name: str
    catalog: str
    words: str
    material: str
    mesh: _Mesh
    role: str = ""
    location: Vector = (0.0, 0.0, 0.0)


def write(folder: Path) -> list[str]:
    """Write the library into a folder, in place of an earlier one; return the names of its assets.

    The open file is replaced by an empty one, so this is for a worker.

    Parameters
    ----------
    folder : Path
        Made if it is not there. Other files in it are kept, and other catalogs.

    Raises
    ------
    NlosError
        The folder cannot be written.
    """
    catalogs = _catalogs(folder / CATALOGS)
    scene = blend_file.new_file()
    surfaces = {albedo.name: _material(albedo) for albedo in ALBEDOS}
    objects = [*_walls_and_clutter(surfaces), *_targets(surfaces), *_lamps_and_cameras(scene)]
    path = folder / FILE
    with atomic(path) as temporary:
        try:
            bpy.data.libraries.write(blend_file.literal(temporary), {*surfaces.values(), *objects}, compress=True)
        except RuntimeError as error:
            raise NlosError(f"{path}: cannot be written ({' '.join(str(error).split())})") from None
    write_text(folder / CATALOGS, catalogs)
    return [block.name for block in (*objects, *surfaces.values())]


def _catalogs(path: Path) -> str:
    """Return the text of the file of catalogs, with those that it has of others."""
    try:
        kept = path.read_text(encoding="utf-8").splitlines() if path.is_file() else ["VERSION 1", ""]
    except (OSError, UnicodeDecodeError):
        raise NlosError(f"{path}: is no file of catalogs that can be read; put it elsewhere") from None
    names = {uuid: ["NLOS", name] if name else ["NLOS"] for name, uuid in _CATALOG_IDS.items()}
    own = [f"{uuid}:{'/'.join(parts)}:{'-'.join(parts)}" for uuid, parts in names.items()]
    kept = [line for line in kept if line.partition(":")[0] not in _CATALOG_IDS.values()]
    return "\n".join([*kept, *own]) + "\n"


def _describe(block: Any, catalog: str, words: str, tags: Iterable[str], picture: Any) -> Any:
    block.asset_mark()
    data = block.asset_data
    data.author, data.description, data.catalog_id = AUTHOR, words, _CATALOG_IDS[catalog]
    for tag in ("NLOS", *tags):
        data.tags.new(tag)
    preview = block.preview_ensure()
    preview.image_size = picture.shape[:2]
    preview.image_pixels_float.foreach_set(picture.astype(np.float32).ravel())
    return block


def _material(albedo: Albedo) -> Any:
    material = bpy.data.materials.new(albedo.name)
    materials.make_lambertian(material, albedo.value)
    material.diffuse_color = (*albedo.value, 1.0)
    values = " ".join(f"{value:g}" for value in dict.fromkeys(albedo.value))
    span = f", between {albedo.range[0]:g} and {albedo.range[1]:g}" if albedo.range else ""
    words = f"Lambertian, albedo {values}{span}. {albedo.source[0].upper()}{albedo.source[1:]}"
    tags = ["diffuse", "typical" if albedo.source == TYPICAL else "published"]
    return _describe(material, "Materials", words, tags, asset_previews.of_material(material))


def _placed(obj: Any, catalog: str, words: str, role: str, location: Vector | None = None) -> Any:
    if location is not None:
        obj.location = location
    if role:
        obj[roles.ROLE] = role
    tags = [role.replace("_", " ")] if role else ["clutter"]
    return _describe(obj, catalog, words, tags, asset_previews.of_object(obj))


def _walls_and_clutter(surfaces: dict[str, Any]) -> list[Any]:
    objects = []
    for shape in _SHAPES:
        mesh = bpy.data.meshes.new(shape.name)
        mesh.from_pydata(shape.mesh[0], [], shape.mesh[1])
        mesh.materials.append(surfaces[shape.material])
        obj = bpy.data.objects.new(shape.name, mesh)
        words = f"{shape.words}. {shape.material}"
        objects.append(_placed(obj, shape.catalog, words, shape.role, shape.location))
    return objects


def _targets(surfaces: dict[str, Any]) -> list[Any]:
    """Return the targets that `build` makes too: a two-sided sheet and a sphere."""
    objects = []
    for kind, words in (("sheet", "A square sheet 0.4 m wide, two-sided"), ("sphere", "A sphere 0.4 m wide")):
        obj = build.build_target(Target(kind=kind, size=0.4))  # type: ignore[arg-type]
        obj.name = obj.data.name = f"Target, {kind}"
        obj.data.materials[0] = surfaces["White paper"]
        objects.append(_placed(obj, "Targets", f"{words}. White paper", "target", _HIDDEN))
    return objects


def _lamps_and_cameras(scene: bpy.types.Scene) -> list[Any]:
    """Return lamps and cameras of the presets, where they stand there."""
    objects = []
    for name in ("room", "corridor", "tabletop"):
        wanted = preset(name)
        build.build(scene, wanted)
        lamp, camera = roles.find(scene, "spot"), roles.find(scene, "camera")
        for obj in (lamp, camera):
            for collection in obj.users_collection:
                collection.objects.unlink(obj)
            del obj[roles.BUILT]  # it will be the user's own
        lamp.name = lamp.data.name = f"Spot lamp, beam of {2.0 * wanted.spot.half_angle:g}°"
        words = f"A point of {wanted.spot.power:g} W, as Blender counts it, with a hard edge; as in the preset {name}"
        objects.append(_placed(lamp, "Lamps", words, "spot"))
        view = wanted.camera
        size = f"{view.x[1] - view.x[0]:g} m x {view.z[1] - view.z[0]:g} m"
        camera.name = camera.data.name = f"Camera, {view.projection}, {size}"
        words = f"Sees {size} of the wall from {view.location[1]:g} m; as in the preset {name}"
        objects.append(_placed(camera, "Cameras", words, "camera"))
    return objects


def _upright(width: float, height: float) -> _Mesh:
    """Return a rectangle that stands on the floor and faces +y."""
    half = width / 2.0
    return [(half, 0.0, 0.0), (-half, 0.0, 0.0), (-half, 0.0, height), (half, 0.0, height)], [(0, 1, 2, 3)]


def _boxes(*boxes: _Box) -> _Mesh:
    """Return boxes as one mesh, with normals that point outwards."""
    vertices: list[Vector] = []
    faces: list[tuple[int, ...]] = []
    for low, high in boxes:
        first = len(vertices)
        vertices += [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
        sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
        faces += [tuple(first + corner for corner in side) for side in sides]
    return vertices, faces


def _between(x: Range, y: Range, z: Range) -> _Box:
    return (x[0], y[0], z[0]), (x[1], y[1], z[1])


def _centred(width: float, depth: float, height: float, *, bottom: float = 0.0) -> _Box:
    return _between((-width / 2.0, width / 2.0), (-depth / 2.0, depth / 2.0), (bottom, bottom + height))


def _cylinder(radius: float, height: float, bottom: float = 0.0, count: int = 48) -> _Mesh:
    """Return a closed cylinder, a prism of as much area around as the round one has."""
    radius *= math.pi / count / math.sin(math.pi / count)
    around = [math.tau * k / count for k in range(count)]
    vertices = [(radius * math.cos(a), radius * math.sin(a), z) for z in (bottom, bottom + height) for a in around]
    sides = [(k, (k + 1) % count, count + (k + 1) % count, count + k) for k in range(count)]
    return vertices, [*sides, tuple(reversed(range(count))), tuple(range(count, 2 * count))]


def _letter(*strokes: tuple[Range, Range]) -> _Mesh:
    """Return a letter of flat strokes in the plane y = 0, ranges of x and z from -1 to 1, which face +y."""
    vertices: list[Vector] = []
    faces: list[tuple[int, ...]] = []
    for (x0, x1), (z0, z1) in strokes:
        faces.append(tuple(range(len(vertices), len(vertices) + 4)))
        vertices += [(_LETTER * x, 0.0, _LETTER * z) for x, z in ((x1, z0), (x0, z0), (x0, z1), (x1, z1))]
    return vertices, faces


def _legs(width: float, depth: float, height: float, thick: float) -> list[_Box]:
    x, y = (width - thick) / 2.0, (depth - thick) / 2.0
    half = thick / 2.0
    return [
        _between((sx * x - half, sx * x + half), (sy * y - half, sy * y + half), (0.0, height))
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]


def _target(name: str, words: str, mesh: _Mesh) -> _Shape:
    return _Shape(f"Target, {name}", "Targets", words, "White paper", mesh, "target", _HIDDEN)


_HIDDEN = (1.55, 1.15, 1.3)
"""Middle of the hidden volume of the preset ``room``."""
_LETTER = 0.25
"""Half the height of a letter, metres."""

_AT_CORNER = (0.0, 2.35, 0.0)
"""Where the partition of the preset ``room`` stands."""
_GAP = 1e-3
"""Between parts that would touch: coincident faces are none that light can tell apart, metres."""

_WALL = ("Relay walls", "Flat, upright, its front to +y")
_SCREEN, _CLUTTER = "Partitions", "Clutter"

_SHAPES = (
    *(
        _Shape(f"Relay wall, {name}", *_WALL, material, _upright(*size), "relay_wall", (0.1, 0.0, 0.0))
        for name, material, size in (
            ("painted, 5 m x 2.6 m", "White wall paint", (5.0, 2.6)),
            ("plaster, 5 m x 2.6 m", "Gypsum plaster", (5.0, 2.6)),
            ("concrete, 5 m x 2.6 m", "Concrete", (5.0, 2.6)),
            ("paper, 2 m x 2 m", "White paper", (2.0, 2.0)),
        )
    ),
    _Shape(
        "Partition, 2.1 m x 2.6 m",
        _SCREEN,
        "Hides what is beside it from lamp and camera",
        "Black felt",
        _boxes(_between((-0.02, 0.0), (-1.05, 1.05), (0.0, 2.6))),
        "partition",
        _AT_CORNER,
    ),
    _Shape(
        "Partition, corner",
        _SCREEN,
        "The corner of a corridor: two sides of 2.1 m, 2.6 m high",
        "Black paint",
        _boxes(_between((-0.02, 0.0), (-1.05, 1.05), (0.0, 2.6)), _between((_GAP, 2.1), (-1.05, -1.03), (0.0, 2.6))),
        "partition",
        _AT_CORNER,
    ),
    _target("cube", "A cube of 0.4 m", _boxes(_centred(0.4, 0.4, 0.4, bottom=-0.2))),
    _target("cylinder", "A cylinder 0.3 m wide, 0.6 m high", _cylinder(0.15, 0.6, bottom=-0.3)),
    _target(
        "letter L", "0.5 m high, flat, two-sided", _letter(((0.35, 0.7), (-1.0, 1.0)), ((-0.7, 0.35), (-1.0, -0.6)))
    ),
    _target(
        "letter T", "0.5 m high, flat, two-sided", _letter(((-0.2, 0.2), (-1.0, 0.6)), ((-0.8, 0.8), (0.6, 1.0)))
    ),
    _target(
        "figure",
        "A standing person of blocks, 1.7 m high; its origin is in the middle",
        _boxes(
            *(_between((s * 0.12 - 0.08, s * 0.12 + 0.08), (-0.09, 0.09), (-0.85, -0.05)) for s in (-1, 1)),
            _between((-0.22, 0.22), (-0.11, 0.11), (-0.05 + _GAP, 0.55)),
            *(_between((s * 0.28 - 0.05, s * 0.28 + 0.05), (-0.06, 0.06), (-0.1, 0.53)) for s in (-1, 1)),
            _between((-0.09, 0.09), (-0.1, 0.1), (0.6, 0.85)),
        ),
    ),
    _Shape("Box", _CLUTTER, "0.6 m x 0.4 m x 0.4 m", "Brown cardboard", _boxes(_centred(0.6, 0.4, 0.4))),
    _Shape("Bin", _CLUTTER, "A cylinder 0.3 m wide, 0.4 m high", "Furniture of a work place", _cylinder(0.15, 0.4)),
    _Shape(
        "Shelf",
        _CLUTTER,
        "Five boards between two sides, 0.8 m wide, 0.3 m deep, 1.8 m high",
        "Light wood",
        _boxes(
            *(_between((s * 0.39 - 0.01, s * 0.39 + 0.01), (-0.15, 0.15), (0.0, 1.8)) for s in (-1, 1)),
            *(
                _between((-0.38 + _GAP, 0.38 - _GAP), (-0.14, 0.14), (z, z + 0.02))
                for z in (0.05, 0.48, 0.91, 1.34, 1.77)
            ),
        ),
    ),
    _Shape(
        "Chair",
        _CLUTTER,
        "Of blocks, the seat 0.45 m high",
        "Dark wood",
        _boxes(
            *_legs(0.44, 0.44, 0.42 - _GAP, 0.04),
            _centred(0.45, 0.45, 0.03, bottom=0.42),
            _between((-0.22, 0.22), (-0.22, -0.19), (0.45 + _GAP, 0.9)),
        ),
    ),
    _Shape(
        "Table",
        _CLUTTER,
        "1.4 m x 0.7 m, 0.75 m high",
        "Light wood",
        _boxes(*_legs(1.3, 0.6, 0.72 - _GAP, 0.05), _centred(1.4, 0.7, 0.03, bottom=0.72)),
    ),
    _Shape(
        "Monitor",
        _CLUTTER,
        "A screen of 0.6 m x 0.35 m on a stand, switched off and matt",
        "Black paint",
        _boxes(
            _centred(0.24, 0.18, 0.015),
            _between((-0.03, 0.03), (-0.03, 0.0), (0.015 + _GAP, 0.3)),
            _between((-0.3, 0.3), (_GAP, 0.04), (0.12, 0.47)),
        ),
    ),
)
