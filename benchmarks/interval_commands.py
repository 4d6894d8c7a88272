"""Cases of the intervals of whole commands: their functions are given simulated renders, atlases and features."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from types import SimpleNamespace

import joblib
import numpy as np
from interval_cases import Case, atlas_of, holds
from sklearn.model_selection import StratifiedKFold

from classify.classifiers import curves, evaluate, models
from classify.inference import bound, detect, sequence
from classify.inference.posterior import locate
from classify.intervals import paired_difference
from classify.pictures.feature_table import Features
from classify.pictures.settings import FeatureSettings
from generator.model.deadline import Deadline
from generator.model.grid import VoxelGrid

TOLERANCE = 0.01
FOLDS = 5
FRESH = 45_000
"""Pictures that tell how often a classifier is right."""
CLASSIFIERS = ("LDA", "CART")


def probed() -> Iterator[Case]:
    """What the object adds to a picture, printed where the noise hides it; and nothing, where no sample met it."""
    from generator.blender import check_signal  # needs bpy, as `settled`

    side, level = 16, 1.0
    pattern = np.random.default_rng(1).uniform(0.5, 1.5, size=(side, side))
    pattern /= pattern.mean()
    for pairs in (1, 4, 20):
        for share, size in ((0.0, "nothing"), (0.005, "less than the noise of a mean"), (0.02, "more than that")):

            def draw(rng, n=pairs, s=share):
                while True:  # until it is printed
                    differences, hidden = [], True
                    while hidden and len(differences) < n:
                        differences.append(s * pattern + 0.3 * rng.normal(size=pattern.shape))
                        hidden = not check_signal.common_signal(np.array(differences))[2]
                    if hidden:
                        value, half = check_signal.added(differences, level)
                        return abs(value - s) <= half, None

            yield Case("what the object adds", "check", pairs, f"adds {size}", draw)
    for taken in (16 * 32**2, 16 * 256**2):
        text = check_signal.Probe("path", 0.0, float("nan"), 1.0, 1.0, missed=taken).findings()[0].text
        share = 1.001 * float(text.split("nor do more than ")[1].split()[0])

        def draw_missed(rng, n=taken, p=share):
            return rng.binomial(n, p) > 0, None  # or else it is said that no more than p / 1.001 do

        yield Case("share that no sample met", "check", taken, "a little more than what is said", draw_missed)


def settled() -> Iterator[Case]:
    """Effects that only Cycles models, measured in rounds of nine poses, with noise, until they are decided."""
    from generator.blender.measure import paired

    pixels, voxels = 16, 9
    for times in (0.7, 1.4, 4.0):
        for spread in (0.3, 0.7):
            truth = times * TOLERANCE

            def draw(rng, e=truth, s=spread):
                def noisy(signal, noise):
                    return signal + noise * rng.normal(size=(2, voxels, pixels))

                poses = e * np.exp(s * rng.normal(size=(paired.ROUNDS[1], voxels, 1)) - s**2)
                wholes = [noisy(np.ones((voxels, pixels)), 0.05) for _ in poses]
                rounds = SimpleNamespace(
                    rounds=range(len(poses)),
                    deadline=Deadline(),
                    errors=lambda dropped, number: noisy(poses[number], 0.01),
                    whole=lambda number: wholes[number],
                )
                found = paired.measure(rounds, ["piece"], tolerance=TOLERANCE, deadline=Deadline())
                return holds(found["piece"], e), None

            setting = f"{times:g} times the tolerance, sigma {spread:g}, until decided"
            yield Case("effect left out, to a decision", "plan", paired.ROUNDS[1], setting, draw)


def detected() -> Iterator[Case]:
    """How often an atlas' own objects are found: another threshold, other pictures and noise in each draw."""
    atlas, rng, code_length = atlas_of(np.random.default_rng(20), 200, shape=(1, 2, 1)), np.random.default_rng(21), 8
    threshold = np.mean([detect.Detector.at(atlas, seed=seed).threshold for seed in range(1000, 1100)])
    truths = []
    for voxel in range(2):
        codes = np.repeat(atlas.codes[atlas.voxels == voxel], 100, axis=0)
        noisy = (codes + rng.normal(size=(len(codes), code_length))).astype(np.float32)
        truths.append(float((detect.evidence(atlas, noisy) > threshold).mean()))
    for count in (20, 70):

        def draw(rng, n=count):
            found = detect.detections(atlas, [1], count=n, seed=int(rng.integers(2**31)))[0].found
            return [holds(*pair) for pair in zip(found, truths, strict=True)], None

        printed = [f"detect: {100 * truth:.0f} % are found" for truth in truths]
        yield Case("found, by a drawn threshold", printed, count, "of about 100 poses in a voxel", draw, slow=True)


def told_rightly(atlas, further):
    """Whether Bayes' rule with an atlas puts pictures of another atlas' poses into their voxels, (n,)."""
    rng = np.random.default_rng(19)
    codes = (further.codes + rng.normal(size=further.codes.shape)).astype(np.float32)
    logs = atlas.logs(codes)
    weights = np.exp(logs - logs.max(axis=1, keepdims=True))
    told = (weights @ np.eye(atlas.grid.n_voxels, dtype=np.float32)[atlas.voxels]).argmax(axis=1)
    for k in np.flatnonzero(weights.sum(axis=1) ** 2 < 4.0 * (weights**2).sum(axis=1)):
        told[k] = locate(atlas, codes[k]).voxels.argmax()  # so sharp that the codes are interpolated
    return told == further.voxels


def bounded() -> Iterator[Case]:
    """The best that any method can do, from an atlas' own poses: another atlas in each draw."""
    strength, shape = 6.0, (3, 3, 1)
    further = atlas_of(np.random.default_rng(18), 1500, strength=strength, shape=shape)
    for poses, pictures in ((60, 60), (300, 30)):

        def draw(rng, n=poses, count=pictures):
            atlas = atlas_of(rng, n, strength=strength, shape=shape)
            found = bound.reachable(atlas, count=count, seed=int(rng.integers(2**31)))
            right = told_rightly(atlas, further)
            first = float(right[further.voxels == 0].mean())
            these = [holds(found.accuracy, float(right.mean())), holds(found.by_voxel[0], first)]
            return [*these, found.accuracy, found.gain], None

        printed = [
            *("bound: right voxel, with this atlas", "bound: right voxel in voxel A, with this atlas"),
            *("bound: right voxel, with other atlases", "bound: what half the atlas loses"),
        ]
        yield Case("bound", printed, pictures, f"an atlas of {poses} poses", draw, slow=True)


def regions() -> Iterator[Case]:
    """How often a tracker's regions hold an atlas' own poses: another atlas in each draw."""
    for poses in (100, 200):

        def draw(rng, n=poses):
            atlas = atlas_of(rng, n, strength=60.0, shape=(3, 3, 1))
            return sequence.held_out(atlas, step=0.01, seed=int(rng.integers(2**31))), None

        yield Case("regions of an atlas", "track", poses // 10, f"an atlas of {poses} poses", draw, slow=True)


def features_of(rng, count, distance):
    """Features of nine classes in turn, normal in six directions; their means form a square in two of them."""
    voxels = np.arange(count) % 9
    values = rng.normal(size=(count, 6))
    values[:, 0] += distance * (voxels % 3)
    values[:, 1] += distance * (voxels // 3)
    grid = VoxelGrid(lo=(0.0, 0.0, 0.0), hi=(3.0, 3.0, 1.0), shape=(3, 3, 1))
    return Features(
        values=values,
        names=[f"feature {k}" for k in range(6)],
        labels=np.array(grid.labels)[voxels],
        voxels=voxels,
        positions=rng.random((count, 3)),
        rotations=np.zeros((count, 3)),
        files=[str(k) for k in range(count)],
        background=np.zeros((1, 1, 3), dtype=np.float32),
        reference_radiance=1.0,
        settings=FeatureSettings(),
        grid=grid,
        target="sphere",
        provenance={"fingerprint": str(rng.integers(2**62))},
    )


@cache
def fresh(distance):
    """Many more pictures of such classes."""
    return features_of(np.random.default_rng(17), FRESH, distance)


def accuracy(name, train, rows, distance, seed):
    """How often a classifier is right that was trained on some rows of a set."""
    model = models.make(name, "paper", train.settings.set, len(rows), seed=seed)
    model.fit(train.values[rows], train.labels[rows])
    further = fresh(distance)
    return float((model.predict(further.values) == further.labels).mean())


def folds() -> Iterator[Case]:
    """Cross-validation: the classifiers of the folds, on further pictures; and such, trained on further pictures."""
    for count, distance, right in ((90, 3.5, 85), (450, 1.5, 40)):

        def draw(rng, n=count, d=distance):
            train, seed = features_of(rng, n, d), int(rng.integers(2**31))
            with joblib.parallel_config(backend="sequential"):
                results = evaluate.compare(
                    [train], ["a set"], classifiers=CLASSIFIERS, settings=["paper"], folds=FOLDS, seed=seed
                )
            folds = StratifiedKFold(FOLDS, shuffle=True, random_state=seed)
            splits = list(folds.split(train.values, train.labels))
            one, other = (
                float(np.mean([accuracy(name, train, rows, d, seed) for rows, _ in splits])) for name in CLASSIFIERS
            )
            difference = paired_difference(results[0].right, results[1].right, effect=results[0].effect)
            these = [holds(results[0].accuracy, one), holds(results[1].accuracy, other)]
            scores = [score for r in results for score in (r.accuracy, r.precision, r.recall, r.f1)]
            return [*these, holds(difference, one - other), *scores], None

        printed = [f"compare: accuracy, {name}, these classifiers" for name in CLASSIFIERS]
        printed.append("compare: not told apart, these classifiers")
        printed += [
            f"compare: {score}, {name}, trained on further pictures"
            for name in CLASSIFIERS
            for score in ("accuracy", "precision", "recall", "F1")
        ]
        setting = f"{FOLDS} folds, about {right} % are right"
        yield Case("cross-validation", printed, count, setting, draw, slow=True)


def learned() -> Iterator[Case]:
    """A classifier that was trained on one set and is tested on another."""
    for count in (90, 900):
        for distance, right in ((1.5, 50), (3.5, 90)):

            def draw(rng, n=count, d=distance):
                train, test = features_of(rng, 270, d), features_of(rng, n, d)
                with joblib.parallel_config(backend="sequential"):
                    point, _ = curves.curves(train, test, classifiers=CLASSIFIERS, counts=[270])
                return holds(point.accuracy, accuracy("LDA", train, np.arange(270), d, 0)), None

            setting = f"trained on 270, about {right} % are right"
            yield Case("another set", "learning-curve, compare: accuracy", count, setting, draw, slow=True)
