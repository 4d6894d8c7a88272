"""The paper's experiments 1 to 3 (section 5.1) in any scene: what a movement or a turn of the object changes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from generator.blender.engines import renderers
from generator.blender.engines.renderer import Renderer, Shot
from generator.blender.scene import geometry, posing, roles
from generator.blender.scene.description import read_scene
from generator.blender.scene.quiet import Overrides
from generator.files.pictures import Picture
from generator.measure import student
from generator.model import poses
from generator.model.arrays import Array, Vector
from generator.model.engines import traits_of
from generator.model.poses import Pose
from generator.model.scene import Target

ACCURACY = 1e-3
"""Accuracy of each picture. A turn about the wall's normal changes a picture by little more."""

TURN = 15.0
"""Degrees from one rotation to the next."""


@dataclass(frozen=True)
class Experiment:
    """Pictures of one experiment.

    Attributes
    ----------
    number : {1, 2, 3}
    target : {"sphere", "sheet"}
    engine : str
    poses : list of list of (position, rotation)
        A row for each axis, with the object at rest in the middle.
    step : float
        Distance from one pose to the next: metres; degrees in experiment 3.
    signals : ndarray of shape (repeats, 3, 5, height, width, 3)
        Change of the empty scene by the object, W/m^2/sr; the repeats differ in noise only.
    voxel : (float, float, float)
        Edges of a voxel, metres.
    corners : ndarray of shape (4, 2)
        Where the picture's corners lie on the wall, x and z, metres: top right, bottom right, bottom left, top left.
    """

    number: int
    target: str
    engine: str
    poses: list[list[Pose]]
    step: float
    signals: Array
    voxel: Vector = (math.nan,) * 3
    corners: Array = field(default_factory=lambda: np.full((4, 2), math.nan))

    @property
    def differences(self) -> Array:
        """Each picture minus the one at rest, averaged over repeats, (3, 5, height, width, 3), W/m^2/sr."""
        mean = self.signals.mean(axis=0)
        differences: Array = mean - mean[:, [self._rest]]
        return differences

    @property
    def rest(self) -> Array:
        """Change of the empty scene by the object at rest, averaged over repeats, (height, width, 3), W/m^2/sr."""
        signal: Array = self.signals[:, 0, self._rest].mean(axis=0)
        return signal

    @property
    def rounding(self) -> float:
        """Largest change of a picture, relative to the signal at rest, that may be a rounding error of a float32.

        Poses and pictures are such; without noise, smaller changes mean nothing.
        """
        return float(np.finfo(np.float32).eps)

    def noise(self) -> tuple[Array, NDArray[np.bool_]]:
        """Return the noise of each difference, grey, root mean square, and whether it is above the signal, (3, 5).

        With noise it is the standard error of the mean over the repeats, and the mean square of the signal is that of
        the difference less that of its noise; NaN with a single repeat. Without noise it is `rounding`.
        """
        grey = self.signals.mean(axis=-1)
        changes = grey - grey[:, :, [self._rest]]
        measured = (changes.mean(axis=0) ** 2).mean(axis=(-2, -1))
        if not traits_of(self.engine).noisy:
            level = self.rounding * math.sqrt(float((self.rest.mean(axis=-1) ** 2).mean()))
            return np.full(measured.shape, level), measured <= level**2
        if len(changes) == 1:
            return np.full(measured.shape, math.nan), np.zeros(measured.shape, dtype=bool)
        error = (changes.var(axis=0, ddof=1) / len(changes)).mean(axis=(-2, -1))
        return np.sqrt(error), measured <= 2.0 * error

    def changes(self) -> list[tuple[float, float]]:
        """Return the change of the signal along each axis, per metre or degree, and its distance to the upper bound.

        The change is the root mean square of the central difference, relative to that of the signal at rest. Noise
        would bias a mean square, so products of pictures with independent noise are averaged. The 95 % interval is
        the jackknife's (Efron 1981), and 0 where there is no noise. NaN where noise hides the signal itself.
        """
        return [self._change(axis) for axis in range(3)]

    def _change(self, axis: int) -> tuple[float, float]:
        square, estimates = self._squares(axis)
        value, margin = math.sqrt(max(square, 0.0)), _margin(estimates)
        return (value if math.isfinite(square) else math.nan), math.sqrt(max(square + margin, margin)) - value

    def stronger(self, one: int, other: int) -> bool | None:
        """Return whether the signal changes more along one axis than along another; None within the noise.

        The difference of the mean squares has an interval of its own: both have the same noise in part.
        """
        (a, without_a), (b, without_b) = self._squares(one), self._squares(other)
        return None if abs(a - b) <= _margin(without_a - without_b) else a > b

    def _squares(self, axis: int) -> tuple[float, Array]:
        """Return the square of an axis' change, and what it is without each of the repeats, if there are several."""
        signals = self.signals
        shift = (signals[:, axis, self._rest + 1] - signals[:, axis, self._rest - 1]) / (2.0 * self.step)
        rest = signals[:, axis, self._rest]
        others = [np.arange(len(signals)) != i for i in range(len(signals))] if len(signals) > 1 else []
        return _ratio(shift, rest), np.array([_ratio(shift[some], rest[some]) for some in others])

    @property
    def _rest(self) -> int:
        return len(self.poses[0]) // 2


def _margin(estimates: Array) -> float:
    """Return half the jackknife's 95 % interval, given a value without each of the repeats; 0 if there are none."""
    count = len(estimates)
    if not count:
        return 0.0
    error = math.sqrt((count - 1) / count * ((estimates - estimates.mean()) ** 2).sum())
    return student.quantile(count - 1) * error


def _ratio(shift: Array, rest: Array) -> float:
    denominator = _mean_square(rest)
    return _mean_square(shift) / denominator if denominator > 0.0 else math.nan


def _mean_square(repeats: Array) -> float:
    """Return the mean square of what repeats (n, ...) have in common."""
    if len(repeats) == 1:
        return float((repeats[0] ** 2).mean())
    return float(np.mean([(repeats[i] * repeats[j]).mean() for i, j in combinations(range(len(repeats)), 2)]))


def run(
    scene: bpy.types.Scene,
    number: int,
    target: str,
    *,
    pixels: int = 64,
    samples: int = 128,
    repeats: int = 8,
    device: str = "cpu",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Experiment:
    """Render the pictures of an experiment, by the cheapest engine that the scene allows.

    Parameters
    ----------
    scene : bpy.types.Scene
        The object replaces the target, half as large as a voxel. Afterwards the scene is restored.
    number : {1, 2, 3}
        1 and 2 move the object along x, y and z; 3 turns it about them.
    target : {"sphere", "sheet"}
    pixels : int
        Side of a picture, pixels.
    samples, repeats : int
        For Cycles, which is used if the engine `surfel`, which has no noise, cannot render the scene.
    device : {"cpu", "gpu"}
        Device that Cycles renders on.
    progress : callable
        Called with the number of pictures rendered, and with their total.

    Raises
    ------
    NlosError
        The scene cannot be read, or there is no such experiment.
    """
    voxel = read_scene(scene).grid.size
    size = min(voxel) / 2.0
    position = tuple(float(v) for v in geometry.snapshot(scene).matrices["target"][:3, 3])
    rows = poses.experiment(number, (position[0], position[1], position[2]), step=size / 4.0, turn=TURN)
    model = Target(kind="sphere" if target == "sphere" else "sheet", size=size, albedo=Target.named(target).albedo)
    with Overrides() as overrides:
        geometry.shape_pictures(scene, (pixels, pixels), overrides)
        _, corners = geometry.view(scene, roles.find(scene, "camera"), geometry.snapshot(scene).matrices["camera"])
    with posing.stand_in(scene, model):
        engine, _ = renderers.choose(scene)
        opened = renderers.opened(scene, engine, resolution=(pixels, pixels), accuracy=ACCURACY, device=device)
        with opened as renderer:
            if traits_of(engine).noisy:
                signals = _sampled(scene, renderer, rows, samples, repeats, progress)
            else:
                signals = np.array([[[renderer.difference(Shot(*pose)) for pose in row] for row in rows]])
    step = TURN if number == 3 else size / 4.0
    return Experiment(number, target, engine, rows, step, signals, voxel, corners[:, [0, 2]])


def draw(scene: bpy.types.Scene, number: int, *, pixels: int = 64, device: str = "cpu") -> Picture:
    """Return the difference pictures of an experiment side by side: a row per axis, the object at rest in the middle.

    The object is a sphere in experiment 1, and a square sheet in 2 and 3.

    Returns
    -------
    ndarray of shape (3 * pixels, 5 * pixels, 3), float32
        Radiance minus that with the object at rest, W/m^2/sr.

    Raises
    ------
    NlosError
        As `run`.
    """
    target = "sphere" if number == 1 else "sheet"
    differences = run(scene, number, target, pixels=pixels, repeats=1, device=device).differences
    mosaic: Picture = np.concatenate([np.concatenate(row, axis=1) for row in differences]).astype(np.float32)
    return mosaic


def _sampled(
    scene: bpy.types.Scene,
    renderer: Renderer,
    rows: list[list[Pose]],
    samples: int,
    repeats: int,
    progress: Callable[[int, int], None],
) -> Array:
    """Return pictures minus the empty scene's with the same noise; each distinct pose is rendered once per repeat."""
    distinct = list(dict.fromkeys(pose for row in rows for pose in row))
    signals: dict[Any, list[Array]] = {pose: [] for pose in distinct}
    for seed in range(repeats):
        empty = renderer.render(samples=samples, seed=seed, target=False).astype(np.float64)
        for pose in distinct:
            posing.move_target(scene, *pose)
            signals[pose].append(renderer.render(samples=samples, seed=seed) - empty)
            progress(sum(map(len, signals.values())), repeats * len(distinct))
    return np.moveaxis(np.array([[signals[pose] for pose in row] for row in rows]), 2, 0)
