"""Measures what effects that only Cycles models contribute to the difference picture, despite Cycles' noise."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from generator.blender.engines import renderers, simplify
from generator.blender.scene import blend_file, posing, roles
from generator.measure.intervals import relative
from generator.measure.scene_plan import UNKNOWN
from generator.model.arrays import Array
from generator.model.deadline import Deadline, Late
from generator.model.poses import PoseRecord
from generator.model.quantities import ALL_ORDERS

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
    device : {"cpu", "gpu"}
        Device that Cycles renders on.
    deadline : Deadline
        When it is over, rendering raises `Late`.
    """

    source: Path
    engine: str
    rounds: Sequence[Sequence[PoseRecord]]
    aspect: float = 1.0
    device: str = "cpu"
    lights: list[str] = field(default_factory=list)
    deadline: Deadline = field(default_factory=Deadline)
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
        with renderers.opened(scene, engine, resolution=resolution, denoise=denoise, device=self.device) as renderer:
            for pose in poses:
                self.deadline.check()
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
    deadline: Deadline,
    progress: Callable[[str], None] = lambda words: None,
) -> dict[str, tuple[float, float, float]]:
    """Measure pieces one by one until each is decided, or the time is up.

    What the time does not allow `ROUNDS` of is left out, the further reflections first.

    Parameters
    ----------
    probe : PairedMeasurement
    names : sequence of str
        Pieces, from `simplify.removable_pieces`.
    orders : sequence of int
        Reflection orders beyond the scene's, whose light is measured too.
    tolerance : float
        A piece is decided when its interval lies on one side of it.
    deadline : Deadline
    progress : callable
        Called with a sentence about what is done.

    Returns
    -------
    dict of str to (float, float, float)
        Results of `share`, by the piece's name, or the name of an order (`order_name`); `UNKNOWN` if left out.
    """
    todo = [*((name, 0) for name in names), *(("", order) for order in orders)]
    errors: dict[tuple[str, int], list[Array]] = {key: [] for key in todo}
    spent, shares = dict.fromkeys(todo, 0.0), dict.fromkeys(todo, UNKNOWN)
    probe.deadline = deadline
    with contextlib.suppress(Late):
        for number in range(min(ROUNDS[1], len(probe.rounds))):
            while todo and not _time_for_more(sum(spent[key] for key in todo), number, deadline):
                todo = todo[:-1] if number < ROUNDS[0] else []
            if not todo:
                break
            for key in todo:
                begun = deadline.clock()
                errors[key].append(probe.raised(key[1], number) if key[1] else probe.errors([key[0]], number))
                spent[key] += deadline.clock() - begun
            if number + 1 >= ROUNDS[0]:
                wholes = [probe.whole(k) for k in range(number + 1)]
                shares |= {key: share(errors[key], wholes) for key in todo}
                todo = [key for key in todo if not _decided(shares[key], key[1], tolerance)]
            progress(f"round {number + 1}: {len(todo)} of {len(errors)} effects not decided yet")
    return {name or order_name(order): found for (name, order), found in shares.items()}


def denoiser_bias(
    probe: PairedMeasurement,
    resolution: tuple[int, int],
    *,
    deadline: Deadline,
    progress: Callable[[str], None] = lambda words: None,
) -> tuple[float, float, float]:
    """Measure the bias of denoised pictures: the error of their mean, apart from their noise.

    Parameters
    ----------
    probe : PairedMeasurement
    resolution : (int, int)
        Width and height of the sweep's pictures.
    deadline : Deadline
    progress : callable
        Called with a sentence about what is done.

    Returns
    -------
    (float, float, float)
        See `share`; `UNKNOWN` if the time does not allow `ROUNDS`.
    """
    start, errors, wholes, bias = deadline.clock(), [], [], UNKNOWN
    probe.deadline = deadline
    with contextlib.suppress(Late):
        for number in range(min(ROUNDS[1], len(probe.rounds))):
            if not _time_for_more(deadline.clock() - start, number, deadline):
                break
            error, whole = probe.denoised(resolution, number)
            errors.append(error)
            wholes.append(whole)
            progress(f"round {number + 1} of the denoiser's bias")
            if number + 1 >= ROUNDS[0]:
                bias = value, low, high = share(errors, wholes)
                if high - low < SURE * value:
                    break
    return bias


def _time_for_more(spent: float, done: int, deadline: Deadline) -> bool:
    """Whether the rounds that are needed, or one more, are likely to end in time, judged by those that are done."""
    more = max(1, ROUNDS[0] - done)
    return not done or spent / done * more <= deadline.left


def order_name(order: int) -> str:
    """Return the name of the light of a reflection order beyond the scene's own."""
    return "all reflections" if order >= ALL_ORDERS else f"reflections up to the {order}th"


def _decided(found: tuple[float, float, float], order: int, tolerance: float) -> bool:
    value, low, high = found
    if order:
        return high - low < SURE * value or high < tolerance
    return high < tolerance or low > tolerance
