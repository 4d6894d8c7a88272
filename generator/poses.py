"""Where the hidden object stands: poses drawn inside voxels, each from its own seed.

A pose depends on (sweep seed, voxel, index) alone, so neither shards, nor their order, nor resuming, nor asking for
more poses later changes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from generator.dataset import PoseRecord
from generator.spec import Array, NlosError, Sweep, Vector, VoxelGrid

Pose = tuple[Vector, Vector]

_BATCH = 256
_BATCHES = 400
_SEED_BITS = 31


def rotation_matrix(rotation: Vector) -> Array:
    """Return the (3, 3) matrix that turns about x, then y, then z (Blender's XYZ order), angles in degrees."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(rotation)), np.sin(np.radians(rotation))
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def noise_seed(sweep_seed: int, position: int) -> int:
    """Return the renderer's seed at one position of a sweep.

    Distinct for every position, by construction: an offset that follows from the sweep's seed plus the position,
    modulo 2^31. (Hashes alone would make two of 900 poses share their noise once in 5,000 sweeps.)
    """
    offset = int(np.random.SeedSequence([sweep_seed]).generate_state(1, np.uint64)[0])
    return int((offset + position) % 2**_SEED_BITS)


def plan(
    grid: VoxelGrid, sweep: Sweep, hull: Array, is_free: Callable[[Vector, Vector], bool] = lambda *_: True
) -> list[PoseRecord]:
    """Draw every pose of a sweep.

    Parameters
    ----------
    grid : VoxelGrid
    sweep : Sweep
    hull : ndarray of shape (n, 3)
        Points of the target relative to its origin, unrotated, metres; their convex hull holds the target.
    is_free : callable
        Whether the target, at a position and rotation, is clear of every surface of the scene.

    Returns
    -------
    list of PoseRecord
        Pose by pose, each through all voxels, so that a sweep cut short has seen every voxel.

    Raises
    ------
    NlosError
        The target does not fit into a voxel.
    """
    labels = grid.labels
    records = []
    for index in range(sweep.poses):
        for voxel, label in enumerate(labels):
            position, rotation = draw(grid, voxel, index, sweep, hull, is_free)
            # Position 0 is the background's.
            seed = noise_seed(sweep.seed, 1 + index * grid.n_voxels + voxel)
            records.append(PoseRecord(index, voxel, label, position, rotation, seed, file=f"{label}/{index:04d}.exr"))
    return records


def draw(
    grid: VoxelGrid,
    voxel: int,
    index: int,
    sweep: Sweep,
    hull: Array,
    is_free: Callable[[Vector, Vector], bool] = lambda *_: True,
) -> Pose:
    """Draw one pose, uniform over all position-and-rotation pairs that the sweep allows.

    Returns
    -------
    position : (float, float, float)
        Of the target's origin, metres.
    rotation : (float, float, float)
        About x, y, z, degrees.

    Raises
    ------
    NlosError
        No such pose was found: the target does not fit.
    """
    rng = np.random.default_rng([sweep.seed, voxel, index])
    lo, hi = grid.bounds(voxel)
    limits = np.asarray(sweep.rotation)
    turns = bool(limits.any())
    for _ in range(_BATCHES if turns else 1):
        for _ in range(_BATCH):
            rotation = rng.uniform(-limits, limits)
            reach = hull @ rotation_matrix(tuple(rotation)).T if sweep.inside == "whole" else np.zeros((1, 3))
            low, high = lo - reach.min(axis=0), hi - reach.max(axis=0)
            # A sheet as wide as its voxel fits exactly; float32 vertices must not make it too wide.
            room = high - low + 1e-6 * (hi - lo)
            keep, where = rng.uniform(), rng.uniform(size=3)
            if (room < 0).any():
                continue
            # Rotations that leave more room to stand must come up more often, or the poses would not be uniform.
            if turns and keep > math.prod(room / (hi - lo)) / (1 + 1e-6) ** 3:
                continue
            x, y, z = (float(v) for v in low + where * np.maximum(high - low, 0.0))
            pose: Pose = ((x, y, z), (float(rotation[0]), float(rotation[1]), float(rotation[2])))
            if is_free(*pose):
                return pose
    extent = np.ptp(hull, axis=0)
    raise NlosError(
        f"voxel {grid.labels[voxel]}: found no place for the target ({extent[0]:.3g} x {extent[1]:.3g} x "
        f"{extent[2]:.3g} m) in {hi[0] - lo[0]:.3g} x {hi[1] - lo[1]:.3g} x {hi[2] - lo[2]:.3g} m clear of all "
        "surfaces; use a smaller target, larger voxels, or keep only its centre inside (--inside centre)"
    )
