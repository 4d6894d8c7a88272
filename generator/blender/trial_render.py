"""Renders a few poses of a sweep twice, to predict how long the whole sweep takes and how noisy it is."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import bpy
import numpy as np

from generator.blender.engines import renderers, simplify
from generator.blender.engines.renderer import Renderer, Shot
from generator.blender.scene import geometry, posing
from generator.blender.scene.clearance import clearance
from generator.blender.scene.copies import Copies
from generator.blender.scene.description import read_scene
from generator.blender.scene.varying import Varying
from generator.jobs.budget import REHEARSED, TrialResult
from generator.model import poses
from generator.model.arrays import Array
from generator.model.poses import PoseRecord
from generator.model.settings import Sweep

SAMPLES = (8, 48)
"""Samples of the two rounds, in pictures of `_PIXELS`; smaller pictures take proportionally more, because the time of
a few rays is all overhead and does not predict the time of a sweep."""
_PIXELS = 64 * 64
ACCURACIES = (1e-1, 1e-3)


def trial_render(
    scene: bpy.types.Scene, sweep: Sweep, *, share: tuple[int, int] = (0, 1), threads: int = 0
) -> TrialResult:
    """Render one pose in each of some voxels, with little work and with more.

    The error of the first round is its difference from the second, which contains the same samples: with n samples
    out of m, its variance is 1 / n - 1 / m of that of one sample.

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
        The scene cannot be swept with these settings.
    """
    described = read_scene(scene)
    voxels = np.unique(
        np.linspace(0, described.grid.n_voxels - 1, min(REHEARSED, described.grid.n_voxels)).astype(int)
    )
    is_free = clearance(scene, described, engine=sweep.engine)
    planned = {r.voxel: r for r in poses.plan(described.grid, replace(sweep, poses=1), geometry.hull(scene), is_free)}
    records = [planned[int(voxel)] for voxel in voxels][share[0] :: share[1]]
    simplify.apply(scene, sweep.leave_out)
    opened = functools.partial(renderers.opened, scene, sweep.engine, threads=threads, **renderers.settings(sweep))
    if not sweep.noisy:
        work = (1.0 / ACCURACIES[0], 1.0 / ACCURACIES[1])
        return TrialResult(sweep.engine, described.grid.n_voxels, work, _exact(scene, sweep, records, opened), [])
    seconds, noise = _noisy(scene, sweep, records, opened)
    few, many = samples_of(sweep.resolution)
    work = (float(few), float(many))
    return TrialResult(sweep.engine, described.grid.n_voxels, work, seconds, noise)


def samples_of(resolution: tuple[int, int]) -> tuple[int, int]:
    """Return the samples of the two rounds for pictures of a width and height."""
    factor = max(1, round(_PIXELS / (resolution[0] * resolution[1])))
    return factor * SAMPLES[0], factor * SAMPLES[1]


Opened = Callable[..., contextlib.AbstractContextManager[Renderer]]
"""`renderers.opened`, of one scene and with one sweep's settings."""


def _exact(scene: bpy.types.Scene, sweep: Sweep, mine: list[PoseRecord], opened: Opened) -> tuple[float, float]:
    prepare, seconds = _preparing(scene, sweep), []
    for accuracy in ACCURACIES:
        opened_to = functools.partial(opened, accuracy=accuracy)
        if sweep.varied:
            _apart(sweep, mine[:1], prepare, opened_to)  # warm-up: compiling and other one-off work
            start = time.perf_counter()
            _apart(sweep, mine, prepare, opened_to)
            seconds.append(time.perf_counter() - start)
            continue
        with opened_to() as renderer:
            shots = [Shot(pose.position, pose.rotation) for pose in mine]
            renderer.pictures(shots)  # warm-up
            start = time.perf_counter()
            renderer.pictures(shots)
            seconds.append(time.perf_counter() - start)
    return seconds[0] / max(1, len(mine)), seconds[1] / max(1, len(mine))


def _apart(sweep: Sweep, mine: list[PoseRecord], prepare: Callable[[PoseRecord], None], opened: Opened) -> None:
    """Render poses without noise, each in a scene of its own, as the sweep will."""
    for pose in mine:
        prepare(pose)
        with opened() as renderer:
            renderer.pictures([Shot(pose.position, pose.rotation)])
            if sweep.own_backgrounds:
                renderer.render(samples=0, seed=0, target=False)


def _noisy(
    scene: bpy.types.Scene, sweep: Sweep, mine: list[PoseRecord], opened: Opened
) -> tuple[tuple[float, float], list[float]]:
    rounds = few, many = samples_of(sweep.resolution)
    share = 1.0 / few - 1.0 / many
    prepare, seconds, noise = _preparing(scene, sweep), np.zeros(2), []
    with _engine(opened, anew=sweep.varied) as engine:
        for pose in mine:
            pictures: list[Array] = []
            for round_, samples in enumerate(rounds):
                start = time.perf_counter()
                prepare(pose)
                with engine() as renderer:
                    posing.move_target(scene, pose.position, pose.rotation)
                    picture = renderer.render(samples=samples, seed=pose.seed).astype(np.float64)
                    if sweep.paired:
                        picture -= renderer.render(samples=samples, seed=pose.seed, target=False)
                seconds[round_] += time.perf_counter() - start
                pictures.append(picture.mean(axis=2))
            variance = float(((pictures[1] - pictures[0]) ** 2).mean()) / share
            if not sweep.paired:
                with engine() as renderer:
                    empty = renderer.render(samples=many, seed=pose.seed, target=False)
                pictures[1] = pictures[1] - empty.mean(axis=2)
            signal = float((pictures[1] ** 2).mean()) - variance / many
            # Where noise hides the signal, only an upper bound of the signal is known.
            noise.append(variance / max(signal, 0.1 * variance / many) if variance else 0.0)
    mean_seconds = seconds / max(1, len(mine))
    return (float(mean_seconds[0]), float(mean_seconds[1])), noise


@contextlib.contextmanager
def _engine(opened: Opened, *, anew: bool) -> Iterator[Opened]:
    """Yield what opens an engine for a picture: anew, or one that is open and kept for all."""
    with opened() as renderer:
        renderer.render(samples=1, seed=0)  # warm-up
        if not anew:
            yield lambda: contextlib.nullcontext(renderer)
            return
    yield opened


def _preparing(scene: bpy.types.Scene, sweep: Sweep) -> Callable[[PoseRecord], None]:
    """Return what gives the scene the values of a pose, and puts several targets at their places."""
    copies, varying = Copies(scene, sweep.targets), Varying(scene, sweep.variations)

    def prepare(pose: PoseRecord) -> None:
        varying.apply(pose.values)
        copies.place(pose)

    return prepare
