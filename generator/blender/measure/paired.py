"""What an effect that only Cycles models contributes to the difference picture, in spite of Cycles' noise."""

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
"""A side of the pictures that are rendered: radiance is a mean over a pixel, so only detail is lost, and of as many
rays fewer pixels make products of two noises smaller."""
SAMPLES = 1024
ROUNDS = (4, 48)
"""Fewest and most."""
DENOISED = 64
"""Samples that the denoiser is measured with; its pictures are of full size, for detail is what it takes."""
DENOISER = f"the denoiser, at {DENOISED} samples"
_SPREAD = 3
"""Every so many voxels it is measured in."""
SURE = 0.4
"""Of an effect that is to be known and not decided on: its interval is no wider than this, relative to it."""


@dataclass
class PairedMeasurement:
    """Difference pictures of a scene with and without some of its pieces.

    A round is one pose in each voxel, rendered twice with independent noise, so that the product of both has the
    square of the light for its mean and no square of the noise. Pictures of a pair with and without a piece share
    their random numbers: paths that never meet the piece cancel. What lamps and ambient light give besides the spot
    is rendered alone, since light adds up.

    Parameters
    ----------
    source : Path
        The scene's file.
    engine : {"patch", "path"}
    rounds : sequence of sequences of PoseRecord
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
        """Return what a round shows of the pieces left out, in two noises, (2, n, pixels)."""
        lights = frozenset(self.lights)
        gone, rest = lights & set(dropped), frozenset(dropped) - lights
        return np.array([self._share(rest, gone, number, twin) for twin in range(2)])

    def together(self, dropped: Sequence[str]) -> tuple[float, float, float]:
        """Return the error of pieces left out together, by the rounds that are made of each of them already."""
        numbers = sorted(
            set.intersection(
                *({key[2] for key in self._made if name in key[0] | (key[1] or set())} for name in dropped)
            )
        )
        return share([self.errors(dropped, k) for k in numbers], [self.whole(k) for k in numbers])

    def raised(self, order: int, number: int) -> Array:
        """Return what a round shows of reflections up to an order, beyond the scene's own, (2, n, pixels)."""
        own = [self._difference(frozenset(), None, number, twin) for twin in range(2)]
        more = [self._difference(frozenset(), None, number, twin, order) for twin in range(2)]
        return np.array(more) - np.array(own)

    def whole(self, number: int) -> Array:
        """Return a round's difference pictures, (2, n, pixels)."""
        return np.array([self._whole(number, twin) for twin in range(2)])

    def _whole(self, number: int, twin: int) -> Array:
        made = self._difference(frozenset(), None, number, twin)
        if self.lights:
            made = made + self._difference(frozenset(), frozenset(self.lights), number, twin)
        return made

    def _share(self, rest: frozenset[str], gone: frozenset[str], number: int, twin: int) -> Array:
        left = frozenset(self.lights) - gone
        made = np.zeros_like(self._difference(frozenset(), None, number, twin))
        if gone:
            made = made + self._difference(frozenset(), gone, number, twin)
        if rest:
            for lit in [None, left] if left else [None]:
                one, other = (self._difference(names, lit, number, twin) for names in (frozenset(), rest))
                made = made + one - other
        return made

    def _difference(
        self, dropped: frozenset[str], lit: frozenset[str] | None, number: int, twin: int, order: int = 0
    ) -> Array:
        """Difference pictures (n, pixels) of a round, by the spot alone, or by some other lights alone."""
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
        """Difference pictures (n, pixels) of an open scene at poses."""
        made = []
        with renderers.opened(scene, engine, resolution=resolution, denoise=denoise) as renderer:
            for pose in poses:
                posing.move_target(scene, pose.position, pose.rotation)
                seed = (pose.seed + 7919 * twin) % 2**31
                seen, empty = (
                    renderer.render(samples=samples, seed=seed, target=target).astype(np.float64)
                    for target in (True, False)
                )
                made.append((seen - empty).mean(axis=2).ravel())
        return np.array(made)

    def denoised(self, resolution: tuple[int, int], number: int) -> tuple[Array, Array]:
        """Return what the denoiser changes of some of a round's pictures, and these, in two noises (2, n, pixels)."""
        scene = blend_file.open_file(self.source)
        some = self.rounds[number][::_SPREAD]
        plain, smooth = (
            np.array([self._rendered(scene, self.engine, resolution, DENOISED, some, k, on) for k in range(2)])
            for on in (False, True)
        )
        return smooth - plain, plain


def share(errors: Sequence[Array], wholes: Sequence[Array]) -> tuple[float, float, float]:
    """Return the relative error of difference pictures, root mean square, with its 95 % interval.

    Parameters
    ----------
    errors, wholes : sequence of ndarray of shape (2, n, pixels)
        Round by round, from the same n voxels: what is missing, and the difference pictures, in two noises.

    Returns
    -------
    (float, float, float)
        See `intervals.relative`.
    """
    power, signal = (np.array([(one[0] * one[1]).mean(axis=1) for one in some]) for some in (errors, wholes))
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
    """Measure pieces one by one until each is decided, or time is up.

    Parameters
    ----------
    probe : Probe
    names : sequence of str
        Of `simplify.removable_pieces`.
    orders : sequence of int
        Reflection orders beyond the scene's, whose light is measured too.
    tolerance : float
        A piece is decided when its interval lies on one side of it.
    most : float
        Seconds.
    progress : callable
        Is told what is being done.

    Returns
    -------
    dict of str to (float, float, float)
        As `share` does, by the piece's name, or an order's (`order_name`).
    """
    begun = time.monotonic()
    todo = [*(("", order) for order in orders), *((name, 0) for name in names)]
    errors: dict[tuple[str, int], list[Array]] = {one: [] for one in todo}
    found: dict[str, tuple[float, float, float]] = {}
    for number in range(min(ROUNDS[1], len(probe.rounds))):
        for name, order in todo:
            got = probe.raised(order, number) if order else probe.errors([name], number)
            errors[name, order].append(got)
        wholes = [probe.whole(k) for k in range(number + 1)]
        for one in todo:
            found[one[0] or order_name(one[1])] = share(errors[one], wholes)
        if number + 1 >= ROUNDS[0]:
            todo = [one for one in todo if not _decided(found[one[0] or order_name(one[1])], one[1], tolerance)]
        progress(f"round {number + 1}: {len(todo)} of {len(errors)} effects not decided yet")
        if not todo or _late(begun, number + 1, most):
            break
    return found


def denoiser_bias(
    probe: PairedMeasurement,
    resolution: tuple[int, int],
    *,
    most: float = 60.0,
    progress: Callable[[str], None] = lambda words: None,
) -> tuple[float, float, float]:
    """Measure by how much denoised pictures are wrong in the mean, whatever their noise.

    Parameters
    ----------
    probe : Probe
    resolution : (int, int)
        Of the pictures that will be swept.
    most : float
        Seconds.
    progress : callable
        Is told what is being done.

    Returns
    -------
    (float, float, float)
        As `share` does.
    """
    begun, errors, wholes = time.monotonic(), [], []
    for number in range(min(ROUNDS[1], len(probe.rounds))):
        error, whole = probe.denoised(resolution, number)
        errors.append(error)
        wholes.append(whole)
        found = share(errors, wholes)
        progress(f"round {number + 1} of the denoiser's bias")
        value, low, high = found
        if (number + 1 >= ROUNDS[0] and high - low < SURE * value) or _late(begun, number + 1, most):
            break
    return found


def _late(begun: float, done: int, most: float) -> bool:
    """Whether rounds are enough, and there is no time for one more."""
    took = time.monotonic() - begun
    return done >= ROUNDS[0] and most - took < took / done


def order_name(order: int) -> str:
    """Return what the light of a reflection order beyond the scene's is called."""
    return f"reflections up to the {order}th"


def _decided(found: tuple[float, float, float], order: int, tolerance: float) -> bool:
    value, low, high = found
    if order:
        return high - low < SURE * value or high < tolerance
    return high < tolerance or low > tolerance
