"""Imports files of other programs by Blender's own importers, in their own numbers and axes, with what they state."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from generator.blender.scene import blend_file, references, roles
from generator.blender.scene.geometry import as_rendered
from generator.blender.scene.quiet import quiet
from generator.blender.scene.words import numbers
from generator.files import fbx, gltf, meshes, usd
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.scene import UNITS, Target
from generator.sets.links import real, trusted

PLAIN = (".obj", ".ply", ".stl")
"""Files that hold a mesh and nothing else, which can be read into an open file without changing it."""
TURNS: dict[str, Array] = {
    "X": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "Y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "Z": np.eye(3),
}
"""Rotations by a right angle that make an axis point up; for Y, that of Blender's importers."""
_LAYERS = (
    'def Xform "r"\n{{\n    def Xform "s" (\n        references = @@@{}@@@\n    )\n    {{\n    }}\n}}\n',
    "    subLayers = [@@@{}@@@]\n",
)
"""Ways to lay another USD under a layer that states metres and z, so that its numbers are taken as they are: its main
prim, or all of it. Of a whole file Blender leaves out the transform of a root that it has written itself."""


@dataclass(frozen=True)
class Part:
    """A mesh in its place."""

    vertices: Array
    corners: NDArray[np.int32]
    sizes: NDArray[np.int32]
    smooth: NDArray[np.bool_]


@dataclass(frozen=True)
class Found:
    """What an importer made of a file: parts in the file's own numbers and axes, and what the file states."""

    parts: list[Part]
    metres: float
    turn: Array
    axis: str
    left_out: str = ""


def _options(operator: Any) -> set[str]:
    """Return the names of an operator's options; none if this Blender lacks the operator."""
    try:
        return {prop.identifier for prop in operator.get_rna_type().properties}
    except KeyError:
        return set()


def _call(operator: Any, name: str, kind: str, path: Path, **options: Any) -> None:
    """Import a file by one of Blender's operators, without those options that this version does not know."""
    known = _options(operator)
    if not known:
        raise NlosError(
            f"target.mesh: {path} cannot be read: Blender {bpy.app.version_string}, as it is here, has no importer "
            f"of {kind} ({name}); take another Blender, or save the object in another format"
        )
    options = {option: value for option, value in options.items() if option in known}
    try:
        with quiet():  # the importers print how long they took
            operator(filepath=blend_file.literal(path.absolute()), **options)
    except (OSError, RuntimeError) as error:
        why = str(error).strip().splitlines()[-1].removeprefix("Error: ")
        raise NlosError(f"target.mesh: {path} is no {kind} that Blender can read ({why})") from None


def _plain(path: Path, wanted: Target) -> Found:
    """Read a file of `PLAIN` beside what is open, and leave nothing of it there."""
    suffix = path.suffix.lower()
    importers = {".obj": bpy.ops.wm.obj_import, ".ply": bpy.ops.wm.ply_import, ".stl": bpy.ops.wm.stl_import}
    before = set(bpy.data.objects)
    try:
        with meshes.importable(path) as importable_path, quiet():  # the importers print how long they took
            importers[suffix](filepath=blend_file.literal(importable_path.absolute()), up_axis="Z", forward_axis="Y")
    except (OSError, RuntimeError):
        raise NlosError(f"target.mesh: {path} is not a mesh file Blender can read ({', '.join(PLAIN)})") from None
    parts = []
    for obj in [o for o in bpy.data.objects if o not in before]:
        data = obj.data
        if obj.type == "MESH":
            parts.append(_part(data, numbers(obj.matrix_basis)))
        bpy.data.objects.remove(obj, do_unlink=True)
        if data is not None and data.users == 0:
            bpy.data.batch_remove([data])
    axis = "Y" if suffix == ".obj" else "Z"
    return Found(parts, 1.0, TURNS[axis], axis)


def _gltf(path: Path, wanted: Target) -> Found:
    content, counts = gltf.bare(path, None if trusted() else real(path.parent))
    blend_file.clear()
    with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
        copy = Path(folder) / f"{path.stem}.glb"
        copy.write_bytes(content)
        try:
            _call(bpy.ops.import_scene.gltf, "bpy.ops.import_scene.gltf", "glTF", copy, disable_bone_shape=True)
        except NlosError as error:
            raise NlosError(str(error).replace(str(copy), str(path))) from None
        parts, others = _rendered(path)
    return Found(_turned(parts, 1.0, TURNS["Y"]), 1.0, TURNS["Y"], "Y", _told(counts, others))


def _fbx(path: Path, wanted: Target) -> Found:
    metres, turn = fbx.stated(path)
    blend_file.clear()
    if _options(bpy.ops.wm.fbx_import):  # from Blender 4.5 on; the older one fails at lamps from 5.0 on
        _call(bpy.ops.wm.fbx_import, "bpy.ops.wm.fbx_import", "FBX", path, use_anim=False)
    else:
        options = {"use_anim": False, "use_image_search": False}
        _call(bpy.ops.import_scene.fbx, "bpy.ops.import_scene.fbx", "FBX", path, **options)
    parts, others = _rendered(path)
    axis = "XYZ"[int(np.abs(turn[2]).argmax())]
    return Found(_turned(parts, metres, turn), metres, turn, axis, _told(others))


def _usd(path: Path, wanted: Target) -> Found:
    if not trusted():
        folder = real(path.parent)
        outside = [file for file in usd.linked(path) if not real(file).is_relative_to(folder)]
        if outside:
            raise NlosError(
                f"target.mesh: {path} refers to {outside[0]}, outside its own folder; copy it there, or allow it "
                "with --trust-links"
            )
    blend_file.clear()
    _call(bpy.ops.wm.usd_import, "bpy.ops.wm.usd_import", "USD", path, **_BARE)
    parts, others = _rendered(path)
    raw = _raw(path, main=True) if usd.has_main_prim(path) else []
    if _count(raw) != _count(parts):
        raw = _raw(path, main=False)
    metres, axis = _compared(raw, parts, path)
    if "apply_unit_conversion_scale" not in _options(bpy.ops.wm.usd_import) and wanted.unit == "auto":
        raise NlosError(
            f"target.mesh: Blender {bpy.app.version_string} does not read the unit that {path} states; say it by "
            f"target.unit (--target-unit: {', '.join(UNITS)})"
        )
    return Found(raw, metres, TURNS[axis], axis, _told(others))


_BARE = {"set_frame_range": False, "import_materials": False, "create_world_material": False}
"""Options that keep the importer of USD from reading pictures."""


def _raw(path: Path, main: bool) -> list[Part]:
    """Read a USD as if it stated metres and z up: its main prim, or all of it."""
    reference, sublayer = (text.format(path.absolute()) for text in _LAYERS)
    head = f'#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Z"\n{"" if main else sublayer})\n\n'
    blend_file.clear()
    with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
        layer = Path(folder) / "raw.usda"
        layer.write_text(head + (reference if main else ""), encoding="utf-8")
        _call(bpy.ops.wm.usd_import, "bpy.ops.wm.usd_import", "USD", layer, **_BARE)
        return _rendered(path)[0]


def _count(parts: Sequence[Part]) -> int:
    return sum(len(part.vertices) for part in parts)


def _compared(raw: Sequence[Part], parts: Sequence[Part], path: Path) -> tuple[float, str]:
    """Return metres per unit and the axis that points up, from a file's own numbers and from what was made of them.

    Blender's importer honours what a USD states, but does not tell it.
    """
    if not _count(parts):
        return 1.0, "Z"
    own, made = (np.concatenate([np.zeros((0, 3)), *(part.vertices for part in some)]) for some in (raw, parts))
    if own.shape == made.shape:
        scale = float(np.linalg.norm(made) / (np.linalg.norm(own) or 1.0))
        misfits = {axis: float(np.abs(scale * own @ TURNS[axis].T - made).max()) for axis in "ZYX"}
        axis = min(misfits, key=lambda axis: misfits[axis])
        if not misfits[axis] > _MISFIT * np.abs(made).max():
            return float(f"{scale:.6g}"), axis
    raise NlosError(f"target.mesh: it cannot be told which unit and axes {path} states; save it in another format")


_MISFIT = 1e-4


def _blend(path: Path, wanted: Target) -> Found:
    scene = blend_file.load_file(path)
    for obj in scene.objects:  # looks are not taken, so files that they need may be missing
        for slot in obj.material_slots:
            if not (obj.library or obj.override_library or (obj.data and obj.data.library)):
                slot.material = None
    scene.world = None
    references.require(scene, path)
    units = scene.unit_settings
    metres = 1.0 if units.system == "NONE" else float(f"{units.scale_length:.6g}")
    materials = len([m for m in bpy.data.materials if m.library is None and not m.is_grease_pencil])
    parts, others = _rendered(path)
    return Found(parts, metres, TURNS["Z"], "Z", _told({"material": materials}, others))


def _rendered(path: Path) -> tuple[list[Part], dict[str, int]]:
    """Return all meshes that a render of the open scene shows, in the world, and how much else there is."""
    scene = bpy.context.scene
    others = {
        "light": sum(o.type == "LIGHT" for o in scene.objects),
        "camera": sum(o.type == "CAMERA" for o in scene.objects),
        "animation": len(bpy.data.actions),
        "hidden object": sum(o.type in _SOLID and bool(roles.unseen(scene, o)) for o in scene.objects),
        "object without faces": sum(o.type in _OTHER for o in scene.objects),
    }
    for obj in scene.objects:
        obj.pop(roles.ROLE, None)
    camera = bpy.data.objects.new("NLOS look", bpy.data.cameras.new("NLOS look"))
    camera[roles.ROLE] = "camera"
    scene.collection.objects.link(camera)
    scene.render.resolution_x = scene.render.resolution_y = 8

    def look(depsgraph: Any) -> list[Part]:
        return list(_instances(depsgraph))

    try:
        return as_rendered(scene, look), others
    except NlosError as error:
        raise NlosError(f"target.mesh: {path}: {str(error).partition(': ')[2]}") from None


_SOLID = ("MESH", "CURVE", "SURFACE", "FONT", "META")
_OTHER = ("CURVES", "POINTCLOUD", "VOLUME", "GPENCIL", "GREASEPENCIL")


def _instances(depsgraph: Any) -> Iterator[Part]:
    for instance in depsgraph.object_instances:
        obj = instance.object
        if instance.show_self and isinstance(obj.data, bpy.types.Mesh):  # curves are listed again, as meshes
            mesh = obj.to_mesh()
            yield _part(mesh, numbers(instance.matrix_world))
            obj.to_mesh_clear()


def _part(mesh: Any, matrix: Array) -> Part:
    """Return a mesh in its place; a mirrored one with its faces turned round, so that they still face outwards."""
    vertices = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", vertices)
    corners = np.empty(len(mesh.loops), dtype=np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    sizes = np.empty(len(mesh.polygons), dtype=np.int32)
    mesh.polygons.foreach_get("loop_total", sizes)
    smooth = np.empty(len(mesh.polygons), dtype=bool)
    mesh.polygons.foreach_get("use_smooth", smooth)
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        ends = np.cumsum(sizes)
        corners = corners[np.repeat(2 * ends - sizes - 1, sizes) - np.arange(len(corners))]
    places = vertices.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return Part(places, corners, sizes, smooth)


def _turned(parts: Sequence[Part], metres: float, turn: Array) -> list[Part]:
    """Return parts that an importer has made metres and turned upright, in the file's own numbers and axes."""
    return [Part(part.vertices @ turn / metres, part.corners, part.sizes, part.smooth) for part in parts]


def _told(*counts: Mapping[str, int]) -> str:
    """Return counts of things, added up, as words: 2 lights, 1 camera."""
    kinds = dict.fromkeys(kind for some in counts for kind in some)
    totals = {kind: sum(some.get(kind, 0) for some in counts) for kind in kinds}
    many = {kind: kind.replace("object", "objects") if "object" in kind else f"{kind}s" for kind in totals}
    return ", ".join(f"{n} {kind if n == 1 else many[kind]}" for kind, n in totals.items() if n)


READERS: dict[str, Callable[[Path, Target], Found]] = {
    **dict.fromkeys(PLAIN, _plain),
    **dict.fromkeys((".gltf", ".glb"), _gltf),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), _usd),
    ".fbx": _fbx,
    ".blend": _blend,
}
"""Functions that read files, by their endings; each but those of `PLAIN` opens another file in Blender."""
