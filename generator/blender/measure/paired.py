"""Measures what effects that only Cycles models contribute to the difference picture, despite Cycles' noise."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from generator.blender.engines import renderers, simplify
from generator.blender.scene import blend_file, posing, roles
from generator.measure.intervals import relative
from generator.model.arrays import Array
from generator.model.poses import PoseRecord

PIXELS = 8
"""Longer side of the rendered pictures, pixels. Radiance is a mean over a pixel, so only detail is lost, and for a
given number of rays, fewer pixels make the product of two noises smaller."""
SAMPLES = 1024
ROUNDS = (4, 48)
"""Fewest and most rounds."""
DENOISED = 64
"""Samples with which the denoiser is measured; its pictures have full size, because it removes detail."""
DENOISER = f"the denoiser, at {DENOISED} samples"
_SPREAD = 3
"""The denoiser is measured in one of this many voxels."""
SURE = 0.4
"""Widest interval, relative to the effect, at which an effect that is not decided on counts as measured."""


@dataclass
class PairedMeasurement:
    """Difference pictures of a scene with and without some of its pieces.

    A round is one pose in each voxel, rendered twice with independent noise, so that the mean of the product of both
    is the square of the light, without the square of the noise. Pictures of a pair with and without a piece share
    their random numbers: paths that never meet the piece cancel. What other lamps than the spot and ambient
    light contribute is rendered alone, since light adds up.

    Parameters
    ----------
    source : Path
        Scene file.
    engine : {"patch", "path"}
    rounds : sequence of sequences of PoseRecord
        Poses of each round.
    aspect : float
        Width over height of the picture.
    """

    source: Path
    engine: str
    rounds: Sequence[Sequence[PoseRecord]]
    aspect: float = 1.0
    lights: list[str] = field(default_factory=list)
    _made: dict[tuple[frozenset[str], frozenset[str] | None, int, int], Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.lights = simplify.lights(blend_file.open_file(self.source))

    def errors(self, dropped: Sequence[str], number: int) -> Array:
        """Return what pieces that are left out contribute to a round, in two noises, (2, n, pixels)."""
        lights = frozenset(self.lights)
        dropped_lights, rest = lights & set(dropped), frozenset(dropped) - lights
        return np.array([self._share(rest, dropped_lights, number, twin) for twin in range(2)])

    def together(self, dropped: Sequence[str]) -> tuple[float, float, float]:
        """Return the error of pieces left out together, from the rounds already rendered for each of them."""
        numbers = sorted(
            set.intersection(
                *({key[2] for key in self._made if name in key[0] | (key[1] or set())} for name in dropped)
            )
        )
        return share([self.errors(dropped, k) for k in numbers], [self.whole(k) for k in numbers])

    def raised(self, order: int, number: int) -> Array:
        """Return what reflections up to an order, beyond the scene's own, contribute to a round, (2, n, pixels)."""
        normal = [self._difference(frozenset(), None, number, twin) for twin in range(2)]
        raised = [self._difference(frozenset(), None, number, twin, order) for twin in range(2)]
        return np.array(raised) - np.array(normal)

    def whole(self, number: int) -> Array:
        """Return a round's difference pictures, (2, n, pixels)."""
        return np.array([self._whole(number, twin) for twin in range(2)])

    def _whole(self, number: int, twin: int) -> Array:
        pictures = self._difference(frozenset(), None, number, twin)
        if self.lights:
            pictures = pictures + self._difference(frozenset(), frozenset(self.lights), number, twin)
        return pictures

    def _share(self, rest: frozenset[str], gone: frozenset[str], number: int, twin: int) -> Array:
        remaining = frozenset(self.lights) - gone
        pictures = np.zeros_like(self._difference(frozenset(), None, number, twin))
        if gone:
            pictures = pictures + self._difference(frozenset(), gone, number, twin)
        if rest:
            for lit in [None, remaining] if remaining else [None]:
                complete, reduced = (self._difference(names, lit, number, twin) for names in (frozenset(), rest))
                pictures = pictures + complete - reduced
        return pictures

    def _difference(
        self, dropped: frozenset[str], lit: frozenset[str] | None, number: int, twin: int, order: int = 0
    ) -> Array:
        """Return difference pictures (n, pixels) of a round, by the spot alone, or by some other lights alone."""
        key = (dropped | ({f"order {order}"} if order else set()), lit, number, twin)
        if key in self._made:
            return self._made[key]
        scene = blend_file.open_file(self.source)
        simplify.apply(scene, [*dropped, *(name for name in self.lights if name not in (lit or ()))])
        if order:
            roles.limit_reflections(scene, order)
        if lit is not None:
            simplify.without_light(scene)
        width = max(1, round(PIXELS * min(1.0, self.aspect)))
        height = max(1, round(PIXELS * min(1.0, 1.0 / self.aspect)))
        engine = self.engine if lit is None else "path"
        self._made[key] = self._rendered(scene, engine, (width, height), SAMPLES, self.rounds[number], twin)
        return self._made[key]

    def _rendered(
        self,
        scene: Any,
        engine: str,
        resolution: tuple[int, int],
        samples: int,
        poses: Sequence[PoseRecord],
        twin: int,
        denoise: bool = False,
    ) -> Array:
        """Return difference pictures (n, pixels) of an open scene at poses."""
        differences = []
        with renderers.opened(scene, engine, resolution=resolution, denoise=denoise) as renderer:
            for pose in poses:
                posing.move_target(scene, pose.position, pose.rotation)
                seed = (pose.seed + 7919 * twin) % 2**31
                picture, background = (
                    renderer.render(samples=samples, seed=seed, target=target).astype(np.float64)
                    for target in (True, False)
                )
                differences.append((picture - background).mean(axis=2).ravel())
        return np.array(differences)

    def denoised(self, resolution: tuple[int, int], number: int) -> tuple[Array, Array]:
        """Return what the denoiser changes in some pictures of a round, and these, in two noises, (2, n, pixels)."""
        scene = blend_file.open_file(self.source)
        records = self.rounds[number][::_SPREAD]
        plain, smooth = (
            np.array([self._rendered(scene, self.engine, resolution, DENOISED, records, k, on) for k in range(2)])
            for on in (False, True)
        )
        return smooth - plain, plain


def share(errors: Sequence[Array], wholes: Sequence[Array]) -> tuple[float, float, float]:
    """Return the relative error of difference pictures, root mean square, with its 95 % interval.

    Parameters
    ----------
    errors, wholes : sequence of ndarray of shape (2, n, pixels)
        Round by round, from the same n voxels: the missing light, and the difference pictures, in two noises.

    Returns
    -------
    (float, float, float)
        See `intervals.relative`.
    """
    power, signal = (np.array([(pair[0] * pair[1]).mean(axis=1) for pair in rounds]) for rounds in (errors, wholes))
    return relative(power, signal)


def measure(
    probe: PairedMeasurement,
    names: Sequence[str],
    *,
    orders: Sequence[int] = (),
    tolerance: float = 0.01,
    most: float = 300.0,
    progress: Callable[[str], None] = lambda words: None,
) -> dict[str, tuple[float, float, float]]:
    """Measure pieces one by one until each is decided, or the time is up.

    Parameters
    ----------
    probe : PairedMeasurement
    names : sequence of str
        Pieces, from `simplify.removable_pieces`.
    orders : sequence of int
        Reflection orders beyond the scene's, whose light is measured too.
    tolerance : float
        A piece is decided when its interval lies on one side of it.
    most : float
        Time limit, seconds.
    progress : callable
        Called with a sentence about what is done.

    Returns
    -------
    dict of str to (float, float, float)
        Results of `share`, by the piece's name, or the name of an order (`order_name`).
    """
    start = time.monotonic()
    todo = [*(("", order) for order in orders), *((name, 0) for name in names)]
    errors: dict[tuple[str, int], list[Array]] = {key: [] for key in todo}
    shares: dict[str, tuple[float, float, float]] = {}
    for number in range(min(ROUNDS[1], len(probe.rounds))):
        for name, order in todo:
            change = probe.raised(order, number) if order else probe.errors([name], number)
            errors[name, order].append(change)
        wholes = [probe.whole(k) for k in range(number + 1)]
        for key in todo:
            shares[key[0] or order_name(key[1])] = share(errors[key], wholes)
        if number + 1 >= ROUNDS[0]:
            todo = [key for key in todo if not _decided(shares[key[0] or order_name(key[1])], key[1], tolerance)]
        progress(f"round {number + 1}: {len(todo)} of {len(errors)} effects not decided yet")
        if not todo or _late(start, number + 1, most):
            break
    return shares


def denoiser_bias(
    probe: PairedMeasurement,
    resolution: tuple[int, int],
    *,
    most: float = 60.0,
    progress: Callable[[str], None] = lambda words: None,
) -> tuple[float, float, float]:
    """Measure the bias of denoised pictures: the error of their mean, apart from their noise.

    Parameters
    ----------
    probe : PairedMeasurement
    resolution : (int, int)
        Width and height of the sweep's pictures.
    most : float
        Time limit, seconds.
    progress : callable
        Called with a sentence about what is done.

    Returns
    -------
    (float, float, float)
        See `share`.
    """
    start, errors, wholes = time.monotonic(), [], []
    for number in range(min(ROUNDS[1], len(probe.rounds))):
        error, whole = probe.denoised(resolution, number)
        errors.append(error)
        wholes.append(whole)
        bias = share(errors, wholes)
        progress(f"round {number + 1} of the denoiser's bias")
        value, low, high = bias
        if (number + 1 >= ROUNDS[0] and high - low < SURE * value) or _late(start, number + 1, most):
            break
    return bias


def _late(begun: float, done: int, most: float) -> bool:
    """Whether there are enough rounds, and no time for one more."""
    elapsed = time.monotonic() - begun
    return done >= ROUNDS[0] and most - elapsed < elapsed / done


def order_name(order: int) -> str:
    """Return the name of the light of a reflection order beyond the scene's own."""
    return f"reflections up to the {order}th"


def _decided(found: tuple[float, float, float], order: int, tolerance: float) -> bool:
    value, low, high = found
    if order:
        return high - low < SURE * value or high < tolerance
    return high < tolerance or low > tolerance
