"""Objects that represent an unknown one: boxes and sheets of random edges, rotation and albedo.

After three diffuse reflections no edge or curve of an object can be seen, but its size, flatness, orientation and
brightness can. Boxes have all of these, and they are convex with few faces, so the engine is fast.
"""

from __future__ import annotations

import itertools

import numpy as np

from generator.model.arrays import Array, rotation_matrix
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.settings import Sweep
from generator.transport.world import Mesh

SMALLEST, LARGEST, TALLEST = 0.2, 1.0, 1.6
"""Least and largest edge, and largest vertical edge, in units of a voxel's shorter horizontal edge; log-uniform."""

FLAT = 1.0 / 3.0
"""Share of sheets."""

DARKEST = 0.3
"""Least albedo; the largest is 1."""

_TRIES = 10_000
_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def unknown_object(grid: VoxelGrid, sweep: Sweep, index: int, *, stream: int = 0) -> Mesh:
    """Return an object in its own frame, already rotated at random by up to the sweep's largest angles.

    Parameters
    ----------
    grid : VoxelGrid
    sweep : Sweep
        If all of a target must lie in its voxel, the object fits into one.
    index : int
        Index of the pose: every index has another object, the same in all voxels.
    stream : int
        As `generator.model.poses.Sampler` takes it: other streams have other objects.

    Raises
    ------
    NlosError
        No object fits into a voxel.
    """
    rng = np.random.default_rng([sweep.seed, index, 6, *([stream] if stream else [])])
    size = np.asarray(grid.size)
    unit = size[:2].min()
    for _ in range(_TRIES):
        edges = unit * np.exp(rng.uniform(np.log(SMALLEST), np.log([LARGEST, LARGEST, TALLEST])))
        if rng.uniform() < FLAT:
            edges[rng.integers(2)] = 0.0
        turn = rotation_matrix(tuple(rng.uniform(-1.0, 1.0, 3) * sweep.rotation))
        albedo = rng.uniform(DARKEST, 1.0)
        mesh = box(edges, turn, albedo)
        if sweep.inside == "centre" or (np.ptp(mesh.triangles.reshape(-1, 3), axis=0) < size).all():
            return mesh
    raise NlosError(
        f"grid: its voxels of {size[0]:.3g} x {size[1]:.3g} x {size[2]:.3g} m hold none of the unknown objects; "
        "keep only their centres inside (--inside centre)"
    )


def box(edges: Array, turn: Array, albedo: float) -> Mesh:
    """Return a box about the origin, or a sheet if an edge is 0; edges (3,) in metres, turn (3, 3)."""
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * edges @ turn.T
    quads = [face for face in _FACES if np.linalg.matrix_rank(corners[list(face)] - corners[face[0]], tol=1e-9) == 2]
    quads = quads[: 1 if len(quads) == 2 else None]  # a sheet's two sides are one surface, which reflects from both
    triangles = np.array([corners[[a, b, c]] for p, q, r, s in quads for a, b, c in ((p, q, r), (p, r, s))])
    return Mesh(triangles, np.full((len(triangles), 3), albedo))
