"""What answers are worth: voxel, position and presence on a whole data set, each with its interval."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray
from scipy.stats import chi2

from classify.inference.atlas import Atlas
from classify.inference.bound import median
from classify.inference.detect import Detector, evidence
from classify.inference.posterior import Place, holds, locate
from classify.intervals import Interval, wilson
from classify.pictures.sensor import Camera
from generator.files.writing import csv_text
from generator.measure import figures
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.sets.readable import PictureSet, check_colours

_EMPTY = 1000
_MOST_LABELS = 30


@dataclass(frozen=True)
class Evaluation:
    """The answers to a data set's pictures.

    Attributes
    ----------
    records : list of PoseRecord
    places : list of Place
    evidence : ndarray of shape (n,)
        For something, picture by picture.
    empty : ndarray of shape (m,)
        The same of pictures of the empty scene.
    detector : Detector
    labels : tuple of str
        Of the voxels.
    seconds : ndarray of shape (n,)
        From measured picture to place.
    level : float
        What the exposure was multiplied with so that the empty scene is as bright as the atlas'.
    """

    records: list[PoseRecord]
    places: list[Place]
    evidence: Array
    empty: Array
    detector: Detector
    labels: tuple[str, ...]
    seconds: Array
    level: float = 1.0

    @property
    def right(self) -> NDArray[np.bool_]:
        """Whether the likeliest voxel is the true one, (n,)."""
        return np.array([p.voxels.argmax() == r.voxel for p, r in zip(self.places, self.records, strict=True)])

    @property
    def errors(self) -> Array:
        """Distance of the position from the true one, (n,), metres."""
        found, true = (np.array([x.position for x in some]) for some in (self.places, self.records))
        apart: Array = np.linalg.norm(found - true, axis=1)
        return apart

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Whether the true position lies in the region that is stated to hold it, (n,)."""
        return np.array([holds(p, r.position) for p, r in zip(self.places, self.records, strict=True)])

    def accuracy(self, some: Array | None = None) -> Interval:
        """Return the share of right voxels, of some pictures or all."""
        right = self.right if some is None else self.right[some]
        return wilson(int(right.sum()), len(right))

    def detected(self, some: Array | None = None) -> Interval:
        """Return the share of pictures in which something is found, of some or all."""
        found = self.evidence > self.detector.threshold
        found = found if some is None else found[some]
        return wilson(int(found.sum()), len(found))

    def false_alarms(self) -> Interval:
        """Return the share of empty pictures in which something is found."""
        return wilson(int((self.empty > self.detector.threshold).sum()), len(self.empty))

    def rows(self) -> list[tuple[str, ...]]:
        """Return a table, voxel by voxel and in all: pictures, accuracy, median error, stated regions, detection."""
        voxels = np.array([r.voxel for r in self.records])
        parts = [(label, voxels == v) for v, label in enumerate(self.labels) if (voxels == v).any()]
        made = []
        for label, some in [*parts, ("all", np.ones(len(voxels), dtype=bool))]:
            error = median(self.errors[some])
            held = wilson(int(self.inside[some].sum()), int(some.sum()))
            cells = [
                self.accuracy(some).percent(),
                error.centimetres(),
                held.percent(),
                self.detected(some).percent(),
            ]
            made.append((label, str(int(some.sum())), *cells))
        return made

    def calibration(self, levels: Array) -> Array:
        """Return the share of true positions that lie in the regions stated to hold them with given probabilities."""
        apart = np.array(
            [np.subtract(r.position, p.position) for p, r in zip(self.places, self.records, strict=True)]
        )
        inverse = np.array([np.linalg.pinv(p.covariance, hermitian=True) for p in self.places])
        distance = np.einsum("ni,nij,nj->n", apart, inverse, apart)
        held: Array = (distance[:, None] <= chi2.ppf(levels, 3)).mean(axis=0)
        return held

    def draw(self, path: Path, title: str) -> None:
        """Write a picture: what is taken for what, how far off, and whether stated regions hold what they should."""
        figure, (left, middle, right) = plt.subplots(1, 3, figsize=(14.0, 4.4), layout="constrained")
        count = len(self.labels)
        truth = np.array([r.voxel for r in self.records])
        told = np.array([p.voxels.argmax() for p in self.places])
        table = np.zeros((count, count))
        np.add.at(table, (truth, told), 1.0)
        share = 100.0 * table / np.maximum(table.sum(axis=1, keepdims=True), 1.0)
        left.imshow(share, cmap="Blues", vmin=0.0, vmax=100.0)
        if count <= _MOST_LABELS:
            left.set_xticks(range(count), self.labels)
            left.set_yticks(range(count), self.labels)
            for i, j in np.argwhere(share >= 0.5):
                colour = "white" if share[i, j] > 55.0 else "black"
                left.text(j, i, f"{share[i, j]:.0f}", ha="center", va="center", fontsize=8, color=colour)
        left.set_xlabel("found in")
        left.set_ylabel("stands in")
        left.set_title(f"{title}: voxels, % of the pictures of each", fontsize=9)
        present = [v for v in range(count) if (truth == v).any()]
        middle.boxplot([100.0 * self.errors[truth == v] for v in present], showfliers=False)
        middle.set_xticks(range(1, len(present) + 1), [self.labels[v] for v in present])
        middle.set_ylim(bottom=0.0)
        middle.set_ylabel("distance from the true position, cm")
        middle.set_title("errors by voxel: quartiles, and whiskers of 1.5 times their distance", fontsize=9)
        levels = np.linspace(0.02, 0.98, 49)
        right.plot(levels, levels, color="#57606a", lw=0.8, ls=":")
        right.plot(levels, self.calibration(levels), color="#1f6feb", lw=1.6)
        right.set_xlabel("stated probability of a region")
        right.set_ylabel("share of true positions that it holds")
        right.set_title("stated uncertainty against what it was", fontsize=9)
        figures.save(path, figure)

    def csv(self) -> str:
        """Return every answer as a table, comma-separated."""
        header = [
            "file",
            "voxel",
            "found",
            "probability",
            *_AXES,
            *(f"{w}_{a}" for w in ("found", "sd") for a in _AXES),
        ]
        rows = []
        for record, place, found in zip(self.records, self.places, self.evidence, strict=True):
            numbers = [*record.position, *place.position, *np.sqrt(np.diag(place.covariance))]
            label, sure = self.labels[place.voxels.argmax()], place.voxels.max()
            told = [f"{found:.2f}", int(found > self.detector.threshold)]
            rows.append([record.file, record.label, label, f"{sure:.4f}", *(f"{x:.5f}" for x in numbers), *told])
        return csv_text([*header, "evidence", "detected"], rows)


_AXES = ("x", "y", "z")


def run(
    atlas: Atlas,
    dataset: PictureSet,
    *,
    false_alarm: float = 0.01,
    seed: int = 0,
    empty: int = _EMPTY,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Evaluation:
    """Answer every picture of a data set, as the atlas' sensor would have seen it.

    Parameters
    ----------
    atlas : Atlas
    dataset : Dataset or SimulatedSet
        Of the same grid and resolution; the pictures on it are clean.
    false_alarm : float
        Share of empty scenes that may be taken for something.
    seed : int
        Of the sensor's noise.
    empty : int
        How many pictures of the empty scene are looked at for false alarms.
    progress : callable
        Is told how many pictures are done, and of how many.

    Raises
    ------
    NlosError
        Grid or resolution differ, or the data set is empty or broken.
    """
    grid = atlas.grid
    if (dataset.grid.lo, dataset.grid.hi) != (grid.lo, grid.hi):
        raise NlosError(f"{dataset.path}: has another voxel grid than the atlas; make both of one scene")
    check_colours(dataset.path, dataset.colour_space, atlas.colour_space, "the atlas")
    records = dataset.records
    if not records:
        raise NlosError(f"{dataset.path}: holds no finished picture yet")
    camera = Camera(dataset, atlas.sensor, seed, like=atlas.background)
    background, clean = camera.background(), camera.empty()
    codes, places, seconds = [], [], []
    for done, record in enumerate(records):
        picture = camera.picture(record)
        start = time.perf_counter()
        codes.append(atlas.code(picture, background, name=str(dataset.path / record.file)))
        places.append(locate(atlas, codes[-1], seed=seed))
        seconds.append(time.perf_counter() - start)
        progress(done + 1, len(records))
    rng = np.random.default_rng([seed, 5])
    codes_of_empty = [atlas.code(atlas.sensor.measure(clean, rng, pattern=seed), background) for _ in range(empty)]
    if dataset.grid != grid:  # the same volume, cut otherwise
        own = grid.voxels(np.array([record.position for record in records]))
        records = [replace(r, voxel=int(v), label=grid.labels[v]) for r, v in zip(records, own, strict=True)]
    return Evaluation(
        records=records,
        places=places,
        evidence=evidence(atlas, np.array(codes)),
        empty=evidence(atlas, np.array(codes_of_empty)) if empty else np.zeros(0),
        detector=Detector.at(atlas, false_alarm, seed=seed),
        labels=tuple(atlas.grid.labels),
        seconds=np.array(seconds),
        level=camera.level,
    )
