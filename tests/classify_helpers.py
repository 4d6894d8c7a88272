"""Small data sets without Blender: pictures from the three-reflection formula with one surface element."""

from __future__ import annotations

import numpy as np

from generator import poses, spec
from generator.dataset import BACKGROUND, Dataset
from generator.spec import Sweep, preset

SIZE = 12


def picture_of(scene, position, albedo=0.9, area=0.25):
    """Radiance (SIZE, SIZE) of one element that faces the wall: lamp -> w1 -> element -> wall."""
    x0, x1 = scene.camera.x
    z0, z1 = scene.camera.z
    u = x1 - (np.arange(SIZE) + 0.5) / SIZE * (x1 - x0)
    w = z1 - (np.arange(SIZE) + 0.5) / SIZE * (z1 - z0)
    patch = np.pi * 0.08**2 * scene.reference_radiance
    to_lit = np.subtract(position, scene.spot.aim)
    onto = patch * position[1] ** 2 / (to_lit @ to_lit) ** 2
    r2 = (u[None, :] - position[0]) ** 2 + position[1] ** 2 + (w[:, None] - position[2]) ** 2
    return scene.wall.albedo / np.pi * onto * albedo / np.pi * area * position[1] ** 2 / r2**2


def make_dataset(path, *, target="sheet", n=12, seed=0, noise=2e-7, grid=None, skip=0):
    """Write a data set of ``n`` poses a voxel, the last ``skip`` poses unrendered."""
    scene = preset("room", target)
    if grid is not None:
        scene = spec.from_dict(spec.Scene, {**spec.to_dict(scene), "grid": spec.to_dict(grid)})
    sweep = Sweep(poses=n, seed=seed, resolution=(SIZE, SIZE), inside="centre")
    records = poses.plan(scene.grid, sweep, np.zeros((1, 3)))
    meta = {
        "sweep": {**spec.to_dict(sweep), "scene_sha256": "none"},
        "reference_radiance": scene.reference_radiance,
        "scene": spec.to_dict(scene),
        "software": {"blender": "none"},
    }
    dataset = Dataset.create(path, meta, records)
    rng = np.random.default_rng([seed, len(target)])
    background = np.full((SIZE, SIZE, 3), 2e-4 * scene.reference_radiance, dtype=np.float32)
    dataset.write_background(BACKGROUND, background, seed=0, samples=1)
    albedo, area = (0.9, 0.25) if target == "sheet" else (1.0, np.pi * 0.2**2)
    for record in records[: len(records) - skip]:
        signal = picture_of(scene, record.position, albedo, area)
        light = signal + rng.normal(size=signal.shape) * noise * scene.reference_radiance
        pixels = (background + light[..., None]).astype(np.float32)
        dataset.write_pose(record, pixels, seconds=0.1, samples=1)
    dataset.gather()
    return dataset
