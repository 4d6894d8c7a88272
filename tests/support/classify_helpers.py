"""Small data sets without Blender: pictures from the three-reflection formula with one surface element."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import worlds

from classify.inference.atlas import Atlas
from classify.pictures.sensor import Sensor
from generator.files.toml import from_dict, to_dict
from generator.jobs.bulk import Engine
from generator.model import poses
from generator.model.grid import VoxelGrid
from generator.model.poses import PoseRecord
from generator.model.presets import preset
from generator.model.scene import Scene
from generator.model.settings import Sweep
from generator.sets import bulk_set
from generator.sets.bulk_settings import Settings
from generator.sets.dataset import Dataset
from generator.sets.manifest import BACKGROUND
from generator.transport import Sphere, Transport

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


def make_dataset(
    path, *, target="sheet", n=12, seed=0, noise=2e-7, grid=None, skip=0, engine="patch", saved="none", **more
):
    """Write a data set of ``n`` poses a voxel, the last ``skip`` poses unrendered, with ``more`` in its manifest."""
    scene = preset("room", target)
    if grid is not None:
        scene = from_dict(Scene, {**to_dict(scene), "grid": to_dict(grid)})
    sweep = Sweep(engine=engine, poses=n, seed=seed, resolution=(SIZE, SIZE), inside="centre")
    records = poses.plan(scene.grid, sweep, np.zeros((1, 3)))
    meta = {
        "sweep": {**to_dict(sweep), "scene_sha256": saved},
        "reference_radiance": scene.reference_radiance,
        "scene": to_dict(scene),
        "software": {"blender": "none"},
        **more,
    }
    dataset = Dataset.create(path, meta, records)
    rng = np.random.default_rng([seed, len(target)])
    background = np.full((SIZE, SIZE, 3), 2e-4 * scene.reference_radiance, dtype=np.float32)
    dataset.write_background(BACKGROUND, background, seed=poses.noise_seed(seed, 0), samples=1)
    albedo, area = (0.9, 0.25) if target == "sheet" else (1.0, np.pi * 0.2**2)
    for record in records[: len(records) - skip]:
        signal = picture_of(scene, record.position, albedo, area)
        light = signal + rng.normal(size=signal.shape) * noise * scene.reference_radiance
        pixels = (background + light[..., None]).astype(np.float32)
        dataset.write_pose(record, pixels, seconds=0.1, samples=1)
    dataset.gather()
    return dataset


def colour(picture):
    """A grey picture in three channels."""
    return np.repeat(np.asarray(picture)[..., None], 3, axis=2)


class UnderLight:
    """The engine, with uniform light on the wall besides."""

    def __init__(self, engine, ambient):
        self.engine, self.ambient = engine, np.float32(ambient)

    def pictures(self, *pose):
        return self.engine.pictures(*pose) + self.ambient


def make_bulk(
    path,
    *,
    pictures=3000,
    seed=0,
    radius=0.15,
    albedo=1.0,
    room=(),
    rotation=(0.0, 0.0, 0.0),
    resolution=(16, 16),
    inside="whole",
    shape=(2, 2, 1),
    power=1000.0,
    scale=1.0,
    ambient=0.0,
    wall=worlds.WALL,
    uncertain=None,
):
    """Write a bulk set of a sphere before a bare wall (or a sheet, with radius 0), made by the engine itself."""
    target = Sphere(np.zeros(3), radius, np.full(3, albedo)) if radius else worlds.sheet(0.3)
    view = worlds.watched(resolution=resolution)
    world = worlds.world(target, room=room, view=view, patch=worlds.lit_patch(power=power))
    world = worlds.scaled(world, scale)
    grey = np.full(3, wall)
    world = replace(world, patch=replace(world.patch, albedo=grey), watched=replace(world.watched, albedo=grey))
    lo, hi = (tuple(scale * x for x in corner) for corner in ((0.3, 0.5, -0.4), (1.5, 1.7, 0.6)))
    grid = VoxelGrid(lo=lo, hi=hi, shape=shape)
    chosen = {"pictures": pictures, "resolution": resolution, "seed": seed, "rotation": rotation, "inside": inside}
    plan = Settings(**chosen, accuracy=1e-3, uncertain=uncertain)
    scene = {**to_dict(preset("room", "sphere" if radius else "sheet")), "grid": to_dict(grid)}
    transport = Transport(world, accuracy=1e-3)
    meta = {"scene": scene, "reference_radiance": 1.0, "software": {"blender": "none"}}
    path.mkdir()
    background = transport.background().astype(np.float32) + np.float32(ambient)
    found = bulk_set.Bulk.create(path, plan, meta, world, background, "0" * 64)
    reach = scale * (radius or 0.3 / np.sqrt(2.0))
    hull = np.concatenate([reach * np.eye(3), -reach * np.eye(3)])
    draw = poses.Sampler(grid, plan.sweep, hull).draw
    engine = Engine(found) if uncertain else UnderLight(Engine(found), ambient)
    for number in found.missing():
        found.part(number).write(draw, engine)
    found.finish()
    return bulk_set.Bulk.open(path)


def plain_atlas(codes, positions, voxels, grid):
    """An atlas of given codes (n, k), as unit noise has them, whose basis nobody looks at."""
    k = codes.shape[1]
    return Atlas(
        codes=codes.astype(np.float32),
        basis=np.eye(k, dtype=np.float32),
        background=np.zeros((1, k)),
        nuisances=np.zeros((0, k), dtype=np.float32),
        spread=1.0,
        positions=np.asarray(positions, dtype=np.float64),
        rotations=np.zeros((len(codes), 3)),
        voxels=voxels,
        kinds=np.zeros(len(codes), dtype=np.int64),
        grid=grid,
        sensor=Sensor(exposure=1.0),
        left_out=0.0,
        about={"targets": ["sphere"]},
    )


def make_seen(path, simulated, *, poses=3, frames=0, pace=0.0):
    """Write a data set of some poses of a bulk set, as a sweep of its scene would have."""
    walk = {"frames": frames, "pace": pace} if frames else {}
    n = poses * simulated.grid.n_voxels
    labels, records = simulated.grid.labels, []
    for i, voxel in enumerate(simulated.voxels[:n]):
        place, turn = (tuple(map(float, p[i])) for p in (simulated.positions, simulated.rotations))
        file = f"frames/{i:05d}.exr" if frames else f"{labels[voxel]}/{i:04d}.exr"
        index = i if frames else i // len(labels)
        records.append(PoseRecord(index, int(voxel), labels[voxel], place, turn, 1, file=file))
    meta = {
        "sweep": {**to_dict(simulated.plan.sweep), "scene_sha256": "none", **walk},
        "reference_radiance": 1.0,
        "scene": simulated.meta["scene"],
        "software": {"blender": "none"},
    }
    dataset = Dataset.create(path, meta, records)
    dataset.write_background(BACKGROUND, simulated.background, seed=0, samples=1)
    for record, picture in zip(records, simulated.pictures[:n], strict=True):
        dataset.write_pose(record, np.repeat(picture[..., None], 3, axis=2), seconds=0.1, samples=1)
    dataset.gather()
    return Dataset.open(path)
