"""The mesh of a target from a file of another program: in metres, with z up, about its middle."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from generator.blender.scene import blend_file, references
from generator.blender.scene.importers import PLAIN, READERS, TURNS
from generator.model.arrays import Array, Vector
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.scene import MESH_SUFFIXES, UNITS, Target

_SMALLEST, _LARGEST = 1e-6, 1e5
"""Longest edge of a target, metres: beyond these, the unit must be wrong."""


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
            f"The target is larger than a voxel ({voxel} m) along {', '.join(wider)}, so that it fits into none as "
            "it stands: say its unit, scale it, or make the voxels larger"
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


def read(wanted: Target) -> MeshFile:
    """Read a target's mesh. Unless its file is one of `PLAIN`, a new file is open afterwards.

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
    if suffix not in READERS:
        raise NlosError(f"target.mesh: {path} is not a mesh file Blender can read ({', '.join(MESH_SUFFIXES)})")
    if suffix == ".blend" and references.is_open(path):
        raise NlosError(f"target.mesh: {path} is the file that is open; adopt its object instead")
    found, fault = None, ""
    try:
        found = READERS[suffix](path, wanted)
    except NlosError as error:
        fault = str(error)
    if suffix not in PLAIN:  # not while an error keeps Blender's data in its traceback, at which Blender 5.0 crashed
        blend_file.clear()
    if found is None:
        raise NlosError(fault)
    if not any(len(part.sizes) for part in found.parts):
        rendered = "holds no faces" if suffix in PLAIN else "renders no faces"
        raise NlosError(f"target.mesh: {path} {rendered}{found.left_out and f'; it holds {found.left_out}'}")
    metres = found.metres if wanted.unit == "auto" else UNITS[wanted.unit]
    axis, turn = (found.axis, found.turn) if wanted.up == "auto" else (wanted.up, TURNS[wanted.up])
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


def described(mesh: MeshFile) -> dict[str, Any]:
    """Return the fields of `MeshFile.read` as plain values."""
    return asdict(mesh.read)
