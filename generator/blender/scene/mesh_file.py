"""Reads the mesh of a target from a file of another program, in metres and with z up, by Blender's own importers."""

from __future__ import annotations

import functools
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
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
from generator.model.arrays import Array, Vector
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.scene import MESH_SUFFIXES, UNITS, Target
from generator.sets.links import real, trusted

PLAIN = (".obj", ".ply", ".stl")
"""Files that hold a mesh and nothing else, which can be read into an open file without changing it."""
_SMALLEST, _LARGEST = 1e-6, 1e5
"""Longest edge of a target, metres: beyond these, the unit must be wrong."""
_TURNS: dict[str, Array] = {
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
class Read:
    """What is known of a mesh that was read; a data set's manifest holds it as ``target_file``.

    Attributes
    ----------
    name : str
        Name of the file, without its folder.
    unit, up : str
        As they were asked for (`Target`).
    metres_per_unit : float
        What a length of 1 in the file was taken for, metres.
    up_axis : str
        Axis of the file that was taken to point up.
    """

    name: str
    unit: str
    up: str
    metres_per_unit: float
    up_axis: str


@dataclass(frozen=True)
class MeshFile:
    """The mesh of a target, joined from all that a file renders.

    Attributes
    ----------
    vertices : ndarray of shape (n, 3)
        Metres, z up, from the middle of the bounding box.
    corners : ndarray of shape (m,), int
        Vertex of each corner of each face, one face after the other.
    sizes : ndarray of shape (k,), int
        Number of corners of each face.
    smooth : ndarray of shape (k,), bool
        Whether each face is shaded smooth.
    read : Read
    left_out : str
        What else the file holds, which is not taken; empty if nothing.
    """

    vertices: Array
    corners: NDArray[np.int32]
    sizes: NDArray[np.int32]
    smooth: NDArray[np.bool_]
    read: Read
    left_out: str = ""

    @functools.cached_property
    def size(self) -> Vector:
        """Width, depth and height, metres."""
        x, y, z = np.ptp(self.vertices, axis=0).tolist()
        return (x, y, z)

    @property
    def words(self) -> str:
        """Its size, how the file was understood, and what was left out, as a sentence without a full stop."""
        taken = f"the file's unit is {self.read.metres_per_unit:g} m, its {self.read.up_axis} axis points up"
        width, depth, height = (f"{edge:.3g}" for edge in self.size)
        left_out = f"; left out: {self.left_out}" if self.left_out else ""
        return f"{self.read.name}: {width} x {depth} x {height} m (width x depth x height; {taken}){left_out}"

    def warning(self, grid: VoxelGrid) -> str:
        """Return a sentence without a full stop if it is larger than a voxel; else an empty text."""
        wider = [name for name, edge, room in zip("xyz", self.size, grid.size, strict=True) if edge > room * 1.000001]
        if not wider:
            return ""
        voxel = " x ".join(f"{edge:.3g}" for edge in grid.size)
        return (
            f"The target is larger than a voxel ({voxel} m) along {', '.join(wider)}, so that it fits into none as it "
            "stands: say its unit, scale it, or make the voxels larger"
        )

    def save(self, path: Path) -> None:
        """Write the arrays to a file, from which `load` reads them."""
        np.savez(path, vertices=self.vertices, corners=self.corners, sizes=self.sizes, smooth=self.smooth)

    @classmethod
    def load(cls, path: Path, read: Mapping[str, Any], left_out: str) -> MeshFile:
        """Return what `save` wrote, with the fields that it did not write."""
        with np.load(path) as arrays:
            return cls(**arrays, read=Read(**read), left_out=left_out)

    def mesh(self, name: str) -> bpy.types.Mesh:
        """Return it as a mesh of Blender's."""
        mesh = bpy.data.meshes.new(name)
        mesh.vertices.add(len(self.vertices))
        mesh.vertices.foreach_set("co", self.vertices.astype(np.float32).ravel())
        mesh.loops.add(len(self.corners))
        mesh.loops.foreach_set("vertex_index", self.corners)
        mesh.polygons.add(len(self.sizes))
        mesh.polygons.foreach_set("loop_start", (np.cumsum(self.sizes) - self.sizes).astype(np.int32))
        mesh.polygons.foreach_set("use_smooth", self.smooth)
        mesh.update(calc_edges=True)
        mesh.validate()
        return mesh


@dataclass(frozen=True)
class _Found:
    """What an importer made of a file: parts in the file's own numbers and axes, and what the file states."""

    parts: list[_Part]
    metres: float
    turn: Array
    axis: str
    left_out: str = ""


@dataclass(frozen=True)
class _Part:
    """A mesh in its place."""

    vertices: Array
    corners: NDArray[np.int32]
    sizes: NDArray[np.int32]
    smooth: NDArray[np.bool_]


def read(wanted: Target) -> MeshFile:
    """Read a target's mesh. Unless its file is one of `PLAIN`, this replaces the open file.

    Raises
    ------
    NlosError
        There is no such file; it is of no known kind, or Blender has no importer for it, or cannot read it; it refers
        to files elsewhere; it renders no faces, or faces without an extent or of an absurd one.
    """
    path = Path(wanted.mesh)
    if not path.is_file():
        raise NlosError(f"target.mesh: {path} is no such file")
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise NlosError(f"target.mesh: {path} is not a mesh file Blender can read ({', '.join(MESH_SUFFIXES)})")
    found = _READERS[suffix](path, wanted)
    if not any(len(part.sizes) for part in found.parts):
        rendered = "holds no faces" if suffix in PLAIN else "renders no faces"
        raise NlosError(f"target.mesh: {path} {rendered}{found.left_out and f'; it holds {found.left_out}'}")
    metres = found.metres if wanted.unit == "auto" else UNITS[wanted.unit]
    axis, turn = (found.axis, found.turn) if wanted.up == "auto" else (wanted.up, _TURNS[wanted.up])
    starts = np.cumsum([0, *(len(part.vertices) for part in found.parts)])
    vertices = metres * np.concatenate([part.vertices for part in found.parts]) @ turn.T
    mesh = MeshFile(
        vertices=_placed(vertices, wanted, path),
        corners=np.concatenate(
            [part.corners + start for part, start in zip(found.parts, starts[:-1], strict=True)], dtype=np.int32
        ),
        sizes=np.concatenate([part.sizes for part in found.parts]),
        smooth=np.concatenate([part.smooth for part in found.parts]),
        read=Read(path.name, wanted.unit, wanted.up, metres, axis),
        left_out=found.left_out,
    )
    if not _has_area(mesh):
        raise NlosError(_FLAT.format(path))
    return mesh


_FLAT = "target.mesh: {} has no extent, or corners that are no places; its faces must have an area"


def _placed(vertices: Array, wanted: Target, path: Path) -> Array:
    """Return vertices about the middle of their bounding box, scaled to the wanted size."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = float(max(high - low))
    if not 0.0 < extent < math.inf:
        raise NlosError(_FLAT.format(path))
    if not wanted.size and not _SMALLEST <= extent <= _LARGEST:
        raise NlosError(
            f"target.mesh: {path} is {extent:.3g} m long, which no target is; say its unit (target.unit, "
            f"--target-unit: {', '.join(UNITS)}), or give it a size (target.size)"
        )
    placed: Array = (vertices - (low + high) / 2.0) * (wanted.size / extent if wanted.size else 1.0)
    return placed


def _has_area(mesh: MeshFile) -> bool:
    """Whether faces have an area, by Newell's formula: half the sum of the cross products along a face's edge."""
    after = np.arange(1, len(mesh.corners) + 1)
    ends = np.cumsum(mesh.sizes)
    after[ends - 1] = ends - mesh.sizes
    points = mesh.vertices[mesh.corners] / np.ptp(mesh.vertices, axis=0).max()
    crosses = np.add.reduceat(np.cross(points, points[after]), ends - mesh.sizes)
    return bool(0.0 < np.linalg.norm(crosses, axis=1).sum() < math.inf)


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
            f"target.mesh: {path} cannot be read: Blender {bpy.app.version_string}, as it is here, has no importer of "
            f"{kind} ({name}); take another Blender, or save the object in another format"
        )
    options = {option: value for option, value in options.items() if option in known}
    try:
        with quiet():  # the importers print how long they took
            operator(filepath=blend_file.literal(path.absolute()), **options)
    except (OSError, RuntimeError) as error:
        why = str(error).strip().splitlines()[-1].removeprefix("Error: ")
        raise NlosError(f"target.mesh: {path} is no {kind} that Blender can read ({why})") from None


def _plain(path: Path, wanted: Target) -> _Found:
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
    return _Found(parts, 1.0, _TURNS[axis], axis)


def _gltf(path: Path, wanted: Target) -> _Found:
    content, counts = gltf.bare(path, None if trusted() else real(path.parent))
    blend_file.new_file()
    with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
        copy = Path(folder) / f"{path.stem}.glb"
        copy.write_bytes(content)
        try:
            _call(bpy.ops.import_scene.gltf, "bpy.ops.import_scene.gltf", "glTF", copy, disable_bone_shape=True)
        except NlosError as error:
            raise NlosError(str(error).replace(str(copy), str(path))) from None
        parts, others = _rendered(path)
    return _Found(_turned(parts, 1.0, _TURNS["Y"]), 1.0, _TURNS["Y"], "Y", _told(counts, others))


def _fbx(path: Path, wanted: Target) -> _Found:
    metres, turn = fbx.stated(path)
    if not (0.0 < metres < math.inf and np.isclose(np.linalg.det(turn), 1.0)):
        raise NlosError(f"target.mesh: {path} states a unit or axes that cannot be")
    blend_file.new_file()
    if _options(bpy.ops.wm.fbx_import):  # from Blender 4.5 on; the older one fails at lamps from 5.0 on
        _call(bpy.ops.wm.fbx_import, "bpy.ops.wm.fbx_import", "FBX", path, use_anim=False)
    else:
        options = {"use_anim": False, "use_image_search": False}
        _call(bpy.ops.import_scene.fbx, "bpy.ops.import_scene.fbx", "FBX", path, **options)
    parts, others = _rendered(path)
    axis = "XYZ"[int(np.abs(turn[2]).argmax())]
    return _Found(_turned(parts, metres, turn), metres, turn, axis, _told(others))


def _usd(path: Path, wanted: Target) -> _Found:
    if not trusted():
        folder = real(path.parent)
        outside = [file for file in usd.linked(path) if not real(file).is_relative_to(folder)]
        if outside:
            raise NlosError(
                f"target.mesh: {path} refers to {outside[0]}, outside its own folder; copy it there, or allow it "
                "with --trust-links"
            )
    blend_file.new_file()
    _call(bpy.ops.wm.usd_import, "bpy.ops.wm.usd_import", "USD", path, **_BARE)
    parts, others = _rendered(path)
    raw = _raw(path, main=True) if usd.has_main_prim(path) else []
    if _count(raw) != _count(parts):
        raw = _raw(path, main=False)
    metres, axis = _compared(raw, parts)
    if "apply_unit_conversion_scale" not in _options(bpy.ops.wm.usd_import) and wanted.unit == "auto" and not wanted.size:
        raise NlosError(
            f"target.mesh: Blender {bpy.app.version_string} does not read the unit that {path} states; say it by "
            f"target.unit (--target-unit: {', '.join(UNITS)})"
        )
    return _Found(raw, metres, _TURNS[axis], axis, _told(others))


_BARE = {"set_frame_range": False, "import_materials": False, "create_world_material": False}
"""Options that keep the importer of USD from reading pictures."""


def _raw(path: Path, main: bool) -> list[_Part]:
    """Read a USD as if it stated metres and z up: its main prim, or all of it."""
    reference, sublayer = (text.format(path.absolute()) for text in _LAYERS)
    head = f'#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Z"\n{"" if main else sublayer})\n\n'
    blend_file.new_file()
    with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
        layer = Path(folder) / "raw.usda"
        layer.write_text(head + (reference if main else ""), encoding="utf-8")
        _call(bpy.ops.wm.usd_import, "bpy.ops.wm.usd_import", "USD", layer, **_BARE)
        return _rendered(path)[0]


def _count(parts: Sequence[_Part]) -> int:
    return sum(len(part.vertices) for part in parts)


def _compared(raw: Sequence[_Part], parts: Sequence[_Part]) -> tuple[float, str]:
    """Return metres per unit and the axis that points up, from a file's own numbers and from what was made of them.

    Blender's importer honours what a USD states, but does not tell it.
    """
    if not _count(parts) or _count(raw) != _count(parts):
        return 1.0, "Z"
    own, made = (np.concatenate([part.vertices for part in some]) for some in (raw, parts))
    scale = float(np.linalg.norm(made) / (np.linalg.norm(own) or 1.0))
    misfits = {axis: float(np.abs(scale * own @ turn.T - made).max()) for axis, turn in _TURNS.items()}
    return float(f"{scale:.6g}"), min(sorted(misfits, reverse=True), key=lambda axis: misfits[axis])


def _blend(path: Path, wanted: Target) -> _Found:
    if references.is_open(path):
        raise NlosError(f"target.mesh: {path} is the file that is open; adopt its object instead")
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
    return _Found(parts, metres, _TURNS["Z"], "Z", _told({"material": materials}, others))


_READERS: dict[str, Callable[[Path, Target], _Found]] = {
    **dict.fromkeys(PLAIN, _plain),
    **dict.fromkeys((".gltf", ".glb"), _gltf),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), _usd),
    ".fbx": _fbx,
    ".blend": _blend,
}


def _rendered(path: Path) -> tuple[list[_Part], dict[str, int]]:
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

    def look(depsgraph: Any) -> list[_Part]:
        return list(_instances(depsgraph))

    try:
        return as_rendered(scene, look), others
    except NlosError as error:
        raise NlosError(f"target.mesh: {path}: {str(error).partition(': ')[2]}") from None


_SOLID = ("MESH", "CURVE", "SURFACE", "FONT", "META")
_OTHER = ("CURVES", "POINTCLOUD", "VOLUME", "GPENCIL", "GREASEPENCIL")


def _instances(depsgraph: Any) -> Iterator[_Part]:
    for instance in depsgraph.object_instances:
        obj = instance.object
        if instance.show_self and isinstance(obj.data, bpy.types.Mesh):  # curves are listed again, as meshes
            mesh = obj.to_mesh()
            yield _part(mesh, numbers(instance.matrix_world))
            obj.to_mesh_clear()


def _part(mesh: Any, matrix: Array) -> _Part:
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
    return _Part(places, corners, sizes, smooth)


def _turned(parts: Sequence[_Part], metres: float, turn: Array) -> list[_Part]:
    """Return parts that an importer has made metres and turned upright, in the file's own numbers and axes."""
    return [_Part(part.vertices @ turn / metres, part.corners, part.sizes, part.smooth) for part in parts]


def _told(*counts: Mapping[str, int]) -> str:
    """Return counts of things, added up, as words: 2 lights, 1 camera."""
    kinds = dict.fromkeys(kind for some in counts for kind in some)
    totals = {kind: sum(some.get(kind, 0) for some in counts) for kind in kinds}
    many = {kind: kind.replace("object", "objects") if "object" in kind else f"{kind}s" for kind in totals}
    return ", ".join(f"{n} {kind if n == 1 else many[kind]}" for kind, n in totals.items() if n)


def described(mesh: MeshFile) -> dict[str, Any]:
    """Return the fields of `MeshFile.read` as plain values."""
    return asdict(mesh.read)
