"""A few poses of a sweep rendered twice, to tell what all of it would take and how noisy it would be."""

from __future__ import annotations

import time
from dataclasses import replace

import bpy
import numpy as np

from generator.blender.engines import renderers, simplify
from generator.blender.engines.renderer import Shot
from generator.blender.scene import geometry, posing
from generator.blender.scene.clearance import clearance
from generator.blender.scene.description import read_scene
from generator.jobs.budget import REHEARSED, TrialResult
from generator.model import poses
from generator.model.arrays import Array
from generator.model.poses import PoseRecord
from generator.model.settings import Sweep

SAMPLES = (8, 48)
"""Of the two rounds, in pictures of `_PIXELS`; of smaller ones, as many more: the time of a few rays is all overhead,
of which no sweep can be told the length."""
_PIXELS = 64 * 64
ACCURACIES = (1e-1, 1e-3)


def trial_render(
    scene: bpy.types.Scene, sweep: Sweep, *, share: tuple[int, int] = (0, 1), threads: int = 0
) -> TrialResult:
    """Render one pose in each of some voxels, with little work and with more.

    The error of one round is its difference from the other, of which its samples are a part: with n samples out of
    m, its variance is 1 / n - 1 / m of that of one.

    Parameters
    ----------
    scene : bpy.types.Scene
    sweep : Sweep
    share : (int, int)
        ``(i, n)``: the i-th of n parts of the voxels.
    threads : int

    Raises
    ------
    NlosError
        The scene cannot be swept so.
    """
    described = read_scene(scene)
    voxels = np.unique(
        np.linspace(0, described.grid.n_voxels - 1, min(REHEARSED, described.grid.n_voxels)).astype(int)
    )
    is_free = clearance(scene, described, engine=sweep.engine)
    planned = {r.voxel: r for r in poses.plan(described.grid, replace(sweep, poses=1), geometry.hull(scene), is_free)}
    mine = [planned[int(voxel)] for voxel in voxels][share[0] :: share[1]]
    simplify.apply(scene, sweep.leave_out)
    if not sweep.noisy:
        work = (1.0 / ACCURACIES[0], 1.0 / ACCURACIES[1])
        return TrialResult(sweep.engine, described.grid.n_voxels, work, _exact(scene, sweep, mine, threads), [])
    seconds, noise = _noisy(scene, sweep, mine, threads)
    few, many = samples_of(sweep.resolution)
    work = (float(few), float(many))
    return TrialResult(sweep.engine, described.grid.n_voxels, work, seconds, noise)


def samples_of(resolution: tuple[int, int]) -> tuple[int, int]:
    """Return the samples of the two rounds for pictures of a width and height."""
    more = max(1, round(_PIXELS / (resolution[0] * resolution[1])))
    return more * SAMPLES[0], more * SAMPLES[1]


def _exact(scene: bpy.types.Scene, sweep: Sweep, mine: list[PoseRecord], threads: int) -> tuple[float, float]:
    took = []
    settings = renderers.settings(sweep)
    for accuracy in ACCURACIES:
        settings["accuracy"] = accuracy
        with renderers.opened(scene, sweep.engine, threads=threads, **settings) as renderer:
            shots = [Shot(pose.position, pose.rotation) for pose in mine]
            renderer.pictures(shots)  # what is compiled and made once is no part of a picture's time
            start = time.perf_counter()
            renderer.pictures(shots)
            took.append((time.perf_counter() - start) / max(1, len(mine)))
    return took[0], took[1]


def _noisy(
    scene: bpy.types.Scene, sweep: Sweep, mine: list[PoseRecord], threads: int
) -> tuple[tuple[float, float], list[float]]:
    rounds = few, many = samples_of(sweep.resolution)
    share = 1.0 / few - 1.0 / many
    took, noise = np.zeros(2), []
    with renderers.opened(scene, sweep.engine, threads=threads, **renderers.settings(sweep)) as renderer:
        renderer.render(samples=1, seed=0)
        for pose in mine:
            posing.move_target(scene, pose.position, pose.rotation)
            seen: list[Array] = []
            for round_, samples in enumerate(rounds):
                start = time.perf_counter()
                picture = renderer.render(samples=samples, seed=pose.seed).astype(np.float64)
                if sweep.paired:
                    picture -= renderer.render(samples=samples, seed=pose.seed, target=False)
                took[round_] += time.perf_counter() - start
                seen.append(picture.mean(axis=2))
            variance = float(((seen[1] - seen[0]) ** 2).mean()) / share
            if not sweep.paired:
                seen[1] = seen[1] - renderer.render(samples=many, seed=pose.seed, target=False).mean(axis=2)
            signal = float((seen[1] ** 2).mean()) - variance / many
            # Where noise hides the signal, all that is known is that it is smaller.
            noise.append(variance / max(signal, 0.1 * variance / many) if variance else 0.0)
    each = took / max(1, len(mine))
    return (float(each[0]), float(each[1])), noise
