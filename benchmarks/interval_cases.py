"""Cases of the intervals that follow from truth values, errors and pixels, drawn from distributions.

`interval_coverage.py` counts how often they hold; `interval_commands.py` has those of whole commands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
from scipy import signal, stats

from classify import intervals
from classify.classifiers import evaluate
from classify.inference import detect
from classify.inference.atlas import Atlas
from classify.intervals import Interval
from classify.pictures.sensor import Sensor
from generator.measure import agreement, tradeoff
from generator.measure import intervals as measured
from generator.model.grid import VoxelGrid

SHARES = (0.5, 0.9, 0.98)
SHARES_OF_WALK = (0.5, 0.9, 0.95, 0.98)
BACKGROUNDS = 50
VOXELS = (1.0, 0.99, 0.97, 0.95, 0.9, 0.85, 0.8, 0.7, 0.6)
"""Accuracy in nine voxels, as the room's are."""
NOISES = 5
THRESHOLDS = 50
"""Number of thresholds that are drawn."""
MEDIAN = float(stats.norm.ppf(0.75))
"""Median of the absolute value of a normal variable."""

Held = bool | Interval
"""Whether an interval holds the truth; or the interval, if the truth is the mean of its value over all draws."""
Draw = Callable[[np.random.Generator], tuple[Held | list[Held], bool | None]]
"""Draws pictures; returns their intervals, and whether one for independent pictures holds the truth."""


@dataclass(frozen=True)
class Case:
    """Intervals, which commands print them, a number of pictures, and how these are drawn.

    `slow` ones, of whole commands, are drawn 500 times at most.
    """

    name: str
    printed: str | list[str]
    count: int
    setting: str
    draw: Draw
    slow: bool = False


def holds(found: Interval | tuple[float, float, float], truth: float) -> bool:
    """Return whether an interval holds the truth, up to rounding."""
    _, low, high = (found.value, found.low, found.high) if isinstance(found, Interval) else found
    return low - 1e-12 <= truth <= high + 1e-12


def below(normal, share):
    """Truth values that are true for a share of normal variables."""
    return normal < stats.norm.ppf(np.minimum(share, 1.0 - 1e-12))


def in_groups(rng, groups, correlation):
    """Normal variables (n,) with a correlation within groups (n,)."""
    shared = rng.normal(size=groups.max() + 1)[groups]
    return math.sqrt(correlation) * shared + math.sqrt(1.0 - correlation) * rng.normal(size=len(groups))


def walk(rng, count, correlation):
    """Normal variables (n,) in which each has a correlation with the one before."""
    steps = math.sqrt(1.0 - correlation**2) * rng.normal(size=count + 300)
    return signal.lfilter([1.0], [1.0, -correlation], steps)[300:]


def shares() -> Iterator[Case]:
    """Shares of independent pictures."""
    for count in (9, 27, 90, 900):
        for share in SHARES:

            def draw(rng, n=count, p=share):
                return holds(intervals.wilson(int(rng.binomial(n, p)), n), p), None

            printed = "compare, learning-curve: accuracy; detect"
            yield Case("share", printed, count, f"{100 * share:g} % are true", draw)


def scores() -> Iterator[Case]:
    """Macro precision, recall and F1 of nine classes, whose errors fall unevenly."""
    wrong = np.random.default_rng(5).random((9, 9)) ** 3
    np.fill_diagonal(wrong, 0.0)
    for count in (90, 900):
        for share in SHARES:
            rows = (1.0 - share) * wrong / wrong.sum(axis=1, keepdims=True) + share * np.eye(9)
            truth = evaluate.macro_scores(1e9 * rows)

            def draw(rng, n=count // 9, rows=rows, truth=truth):
                confusion = np.stack([rng.multinomial(n, row) for row in rows])
                return [holds(*pair) for pair in zip(evaluate.intervals(confusion), truth, strict=True)], None

            printed = [f"compare: {score}" for score in ("precision", "recall", "F1")]
            yield Case("macro score", printed, count, f"{100 * share:g} % are right", draw)


def located() -> Iterator[Case]:
    """Shares and median error of pictures that take turns with measured backgrounds."""
    for count in (9, 90, 900):
        groups = np.arange(count) % min(BACKGROUNDS, count)
        for correlation in (0.0, 0.3):
            setting = f"correlation {correlation:g} within a background"
            for share in SHARES:

                def draw(rng, g=groups, r=correlation, p=share):
                    true = below(in_groups(rng, g, r), p)
                    return holds(intervals.share(true, g), p), holds(intervals.share(true), p)

                yield Case("share by background", "locate", count, f"{100 * share:g} % are true, {setting}", draw)

            def draw_median(rng, g=groups, r=correlation):
                errors = np.abs(in_groups(rng, g, r))
                return holds(intervals.median(errors, g), MEDIAN), holds(intervals.median(errors), MEDIAN)

            yield Case("median by background", "locate, bound", count, setting, draw_median)
    for count in (90, 900):
        groups, accuracy = np.arange(count) % BACKGROUNDS, np.resize(VOXELS, count)

        def draw_voxels(rng, g=groups, p=accuracy):
            true, truth = below(in_groups(rng, g, 0.0), p), float(np.mean(p))
            return holds(intervals.share(true, g), truth), holds(intervals.share(true), truth)

        yield Case("share by background", "locate", count, "60 to 100 % are true, voxel by voxel", draw_voxels)


def atlas_of(rng, poses, *, strength=6.0, shape=(1, 1, 1)):
    """Atlas of poses on a curved surface in eight directions; the further from the wall, the weaker."""
    k = 8
    directions = np.random.default_rng(0).normal(size=(3, k)) * 2.0
    positions = rng.uniform(size=(poses, 3))
    strengths = strength * np.exp(-0.5 * np.arange(k)) * np.exp(-3.0 * positions[:, 1:2])
    grid = VoxelGrid(lo=(0.0, 0.0, 0.0), hi=(1.0, 1.0, 1.0), shape=shape)
    return Atlas(
        codes=(np.cos(positions @ directions) * strengths).astype(np.float32),
        basis=np.eye(k, dtype=np.float32),
        background=np.zeros((1, k)),
        nuisances=np.zeros((0, k), dtype=np.float32),
        spread=1.01,
        positions=positions,
        rotations=np.zeros((poses, 3)),
        voxels=grid.voxels(positions),
        kinds=np.zeros(poses, dtype=np.int64),
        grid=grid,
        sensor=Sensor(exposure=1.0),
        left_out=0.0,
        about={"targets": ["sphere"]},
    )


def alarms() -> Iterator[Case]:
    """False alarms of an atlas of 300 poses, by a threshold that is drawn anew, as each run of a command does."""
    rng, k = np.random.default_rng(0), 8
    atlas = atlas_of(rng, 300)
    many = detect.evidence(atlas, rng.normal(size=(200_000, k)).astype(np.float32))
    for rate in (0.01, 0.1):
        thresholds = np.array([detect.Detector.at(atlas, rate, seed=seed).threshold for seed in range(THRESHOLDS)])
        truths = (many > thresholds[:, None]).mean(axis=1)
        for share, frames in (
            (1 / 101, "100 background frames for one"),
            (0.5, "as many background frames as frames"),
        ):
            for count in (100, 1000):

                def draw(rng, n=count, share=share, rate=rate, drawn=(thresholds, truths)):
                    number = rng.integers(THRESHOLDS)
                    t, truth = (float(values[number]) for values in drawn)
                    groups = np.arange(n) % BACKGROUNDS
                    background = math.sqrt(share) * rng.normal(size=(BACKGROUNDS, k))
                    noise = math.sqrt(1.0 - share) * rng.normal(size=(n, k))
                    found = detect.evidence(atlas, (noise + background[groups]).astype(np.float32))
                    single = detect.evidence(atlas, (noise + background[0]).astype(np.float32))
                    plain = intervals.wilson(int((single > t).sum()), n)  # one background, as it was before
                    both = intervals.exceedance(found, t, groups)
                    return [holds(both, truth), holds(both, rate)], holds(plain, truth)

                printed = ["locate", "locate: against the rate that was asked for"]
                yield Case("false alarms", printed, count, f"{100 * rate:g} % alarm, {frames}", draw)


def tracked() -> Iterator[Case]:
    """Shares and median error of the frames of a walk."""
    for count in (40, 100, 200, 400, 1000):
        for correlation in (0.0, 0.5, 0.82):
            setting = f"correlation {correlation:g} from frame to frame"
            for share in SHARES_OF_WALK:

                def draw(rng, n=count, r=correlation, p=share):
                    true = below(walk(rng, n, r), p)
                    return holds(intervals.share_of_walk(true), p), holds(intervals.share(true), p)

                yield Case("share of a walk", "track", count, f"{100 * share:g} % are true, {setting}", draw)

            def draw_median(rng, n=count, r=correlation):
                errors = np.abs(walk(rng, n, r))
                return holds(intervals.median_of_walk(errors), MEDIAN), holds(intervals.median(errors), MEDIAN)

            yield Case("median of a walk", "track", count, setting, draw_median)


def worth() -> Iterator[Case]:
    """Answers to the same pictures in several noises, and their difference from another way's."""
    for pictures in (27, 90):
        groups = np.tile(np.arange(pictures), NOISES)
        for share in SHARES:
            for correlation in (0.5, 0.9):
                setting = f"{100 * share:g} % are true, correlation {correlation:g} within a picture"

                def draw(rng, g=groups, r=correlation, p=share):
                    true = below(in_groups(rng, g, r), p)
                    return holds(intervals.share(true, g), p), holds(intervals.share(true), p)

                yield Case("share by picture", "classify tradeoff", pictures, setting, draw)

            def draw_loss(rng, n=pictures, g=groups, p=share):
                shared = math.sqrt(0.7) * rng.normal(size=n)[g]
                one, other = (below(shared + math.sqrt(0.3) * rng.normal(size=len(g)), p) for _ in range(2))
                difference = (one.astype(float) - other).reshape(NOISES, n).mean(axis=0)
                return holds(measured.mean(difference), 0.0), None

            yield Case(
                "difference of two ways",
                "classify tradeoff: loses",
                pictures,
                f"{100 * share:g} % are true",
                draw_loss,
            )

        def draw_median(rng, g=groups):
            errors = np.abs(in_groups(rng, g, 0.5))
            return holds(intervals.median(errors, g), MEDIAN), holds(intervals.median(errors), MEDIAN)

        yield Case(
            "median by picture", "classify tradeoff", pictures, "correlation 0.5 within a picture", draw_median
        )


def compared() -> Iterator[Case]:
    """Differences of two classifiers over the same pictures."""
    for count in (90, 900):
        for share in SHARES:

            def draw(rng, n=count, p=share):
                shared = math.sqrt(0.7) * rng.normal(size=n)
                one, other = (below(shared + math.sqrt(0.3) * rng.normal(size=n), p) for _ in range(2))
                return holds(intervals.paired_difference(one, other), 0.0), None

            yield Case(
                "difference of two classifiers",
                "bound: half the atlas",
                count,
                f"{100 * share:g} % are right",
                draw,
            )


def chosen() -> Iterator[Case]:
    """The best of several classifiers that are equally good, and which of them are said to be worse."""
    for count in (90, 900):
        for several in (2, 14):
            for share in SHARES:

                def draw(rng, n=count, m=several, p=share):
                    shared = math.sqrt(0.7) * rng.normal(size=n)
                    right = [below(shared + math.sqrt(0.3) * rng.normal(size=n), p) for _ in range(m)]
                    results = [
                        SimpleNamespace(effect=1.0, scenario="", classifier=str(i), right=r)
                        for i, r in enumerate(right)
                    ]
                    best = max(results, key=lambda result: result.right.mean())
                    every = m - 1 == len(evaluate.rivals(results, best))
                    plain = intervals.wilson(int(best.right.sum()), n)
                    return [every, holds(evaluate.as_best(best.right, among=m), p)], holds(plain, p)

                printed = ["compare, learning-curve: not told apart", "compare, learning-curve: accuracy of the best"]
                yield Case("best of several", printed, count, f"{several} of which {100 * share:g} % are right", draw)


def traded() -> Iterator[Case]:
    """Error and level over the poses of a rung."""
    for count in (9, 27, 90):

        def draw_error(rng, n=count):
            return holds(measured.median(np.exp(rng.normal(size=n))), 1.0), None

        def draw_level(rng, n=count):
            return holds(measured.mean(1.0 + 0.1 * rng.gamma(4.0, size=n)), 1.4), None

        yield Case("median error of a rung", "generate tradeoff", count, "lognormal", draw_error)
        yield Case("mean level of a rung", "generate tradeoff", count, "gamma, skewness 1", draw_level)
    for count in (6, 9, 27, 90):

        def draw_ratio(rng, n=count):
            pose = rng.normal(size=n)
            costs = [
                tradeoff.Cost(str(k), float(k), (0.0,) * 3, (0.0,) * 3, np.exp(pose + 0.3 * rng.normal(size=n)))
                for k in range(2)
            ]
            swapped = [replace(costs[0], seconds=2.0), costs[1]]
            return tradeoff.front(costs) == [0] and tradeoff.front(swapped) == [1], None

        printed = "generate tradeoff: best at its price"
        yield Case("ratio of two ways", printed, count, "lognormal, ratio 1", draw_ratio)


def planned() -> Iterator[Case]:
    """Relative errors over rounds of poses, one pose of each of nine voxels a round."""
    for rounds in (4, 10, 48):
        for spread in (0.3, 1.0):
            truth = math.sqrt(math.exp(0.5 * spread**2))

            def draw(rng, n=rounds, s=spread, truth=truth):
                error, level = np.exp(s * rng.normal(size=(n, 9))), np.exp(0.3 * rng.normal(size=(n, 9)) - 0.045)
                return holds(measured.relative(error, level), truth), None

            yield Case("effect left out", "generate plan", rounds, f"lognormal, sigma {spread:g}", draw)


def changed() -> Iterator[Case]:
    """Changes by a movement, from renders with noise; the difference of two that are the same."""
    from generator.blender.measure.experiment import Experiment  # needs bpy, as no other does
    from generator.model import poses

    pixels, step = 12, 0.1
    rows = poses.experiment(1, (0.0, 0.0, 0.0), step=step)
    at_rest = np.random.default_rng(3).normal(size=(pixels, pixels, 1)) + 3.0
    slope = np.full_like(at_rest, math.sqrt(float((at_rest**2).mean())))
    clean = np.array([[at_rest + k * step * slope for k in range(-2, 3)] for _ in range(3)])
    for repeats in (3, 8):
        for noise in (0.3, 1.5):

            def made(rng, n=repeats, s=noise):
                return Experiment(
                    1, "sphere", "patch", rows, step, clean + rng.normal(scale=s, size=(n, *clean.shape))
                )

            def draw(rng, made=made):
                value, half = made(rng).changes()[0]
                return abs(value - 1.0) <= half, None

            def draw_difference(rng, made=made):
                return made(rng).stronger(0, 1) is None, None

            setting = f"noise {noise:g} of a signal of 3"
            yield Case("change by a movement", "generate experiment", repeats, setting, draw)
            yield Case("difference of two axes", "generate experiment: claim", repeats, setting, draw_difference)


def checked() -> Iterator[Case]:
    """Differences of two renderers, from the scatter of their pixels."""
    for side in (6, 64):

        def draw(rng, side=side):
            plain, engine = 1.0 + 0.1 * rng.normal(size=(2, 1, side, side, 1)).repeat(3, axis=4)
            figure = agreement.compare(plain, engine, samples=1e6, peak=1.0)[0]
            return abs(figure.plain - figure.engine) <= 1.96 * figure.error, None

        yield Case("difference of two renderers", "sweep: start check", side * side, "normal noise", draw)
