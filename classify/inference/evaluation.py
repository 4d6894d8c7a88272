"""Evaluation of the answers to a whole data set: voxel, position and presence, each with its interval."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import chi2

from classify.inference.atlas import Atlas
from classify.inference.detect import Detector, evidence
from classify.inference.misfit import Misfits, doubt, doubt_of_backgrounds
from classify.inference.posterior import REACH, Place, holds, locate
from classify.intervals import Interval, exceedance, median, share
from classify.pictures.leak import refuse_shared
from classify.pictures.sensor import Camera
from generator.files.writing import csv_text
from generator.measure import figures
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.sets.readable import PictureSet, check_colours

_EMPTY = 1000
BACKGROUNDS = 50
"""Most backgrounds that a run measures, since each takes as long as many pictures."""


@dataclass(frozen=True)
class Evaluation:
    """The answers to a data set's pictures.

    Attributes
    ----------
    records : list of PoseRecord
    places : list of Place
    evidence : ndarray of shape (n,)
        Evidence for an object in each picture.
    empty : ndarray of shape (m,)
        Evidence in pictures of the empty scene.
    detector : Detector
    draws, empty_draws : ndarray of shape (n,) and (m,)
        Which measured background each picture was compared with: those of one background are not independent.
    labels : tuple of str
        Labels of the voxels.
    seconds : ndarray of shape (n,)
        Time from the measured picture to the answer.
    level : float
        Factor on the exposure that makes the empty scene as bright as that of the atlas.
    doubts : tuple of str
        What speaks against the answers, in sentences.
    misfits : ndarray of shape (n,)
        Probability that a picture of the atlas' scene and object fits as badly, of each (`misfit.Misfit`).
    """

    records: list[PoseRecord]
    places: list[Place]
    evidence: Array
    empty: Array
    detector: Detector
    draws: NDArray[np.int64]
    empty_draws: NDArray[np.int64]
    labels: tuple[str, ...]
    seconds: Array
    level: float = 1.0
    doubts: tuple[str, ...] = ()
    misfits: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def right(self) -> NDArray[np.bool_]:
        """Whether the most probable voxel is the true one, (n,)."""
        return np.array([p.voxels.argmax() == r.voxel for p, r in zip(self.places, self.records, strict=True)])

    @property
    def errors(self) -> Array:
        """Distance of the position from the true one, (n,), metres."""
        estimated, true = (np.array([x.position for x in items]) for items in (self.places, self.records))
        distances: Array = np.linalg.norm(estimated - true, axis=1)
        return distances

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Whether the true position lies in the stated region, (n,)."""
        return np.array([holds(p, r.position) for p, r in zip(self.places, self.records, strict=True)])

    @property
    def found(self) -> NDArray[np.bool_]:
        """Whether an object is found, (n,)."""
        return self.evidence > self.detector.threshold

    def accuracy(self) -> Interval:
        """Return the share of pictures in the right voxel."""
        return share(self.right, self.draws)

    def detected(self) -> Interval:
        """Return the share of pictures in which an object is found."""
        return share(self.found, self.draws)

    def false_alarms(self) -> Interval:
        """Return the share of empty pictures in which an object is found."""
        return exceedance(self.empty, self.detector.threshold, self.empty_draws)

    def by_voxel(self) -> list[tuple[str, int, Interval, Interval, Interval, Interval]]:
        """Return, per voxel and in total: label, pictures, accuracy, median error, region coverage, detection."""
        voxels = np.array([r.voxel for r in self.records])
        parts = [(label, voxels == v) for v, label in enumerate(self.labels) if (voxels == v).any()]
        right, errors, inside, found = self.right, self.errors, self.inside, self.found
        table = []
        for label, some in [*parts, ("all", np.ones(len(voxels), dtype=bool))]:
            draws = self.draws[some]
            accuracy, covered, detected = (share(answers[some], draws) for answers in (right, inside, found))
            table.append((label, int(some.sum()), accuracy, median(errors[some], draws), covered, detected))
        return table

    def rows(self) -> list[tuple[str, ...]]:
        """Return `by_voxel` as a table of text."""
        return [
            (label, str(count), right.percent(), error.centimetres(), held.percent(), detected.percent())
            for label, count, right, error, held, detected in self.by_voxel()
        ]

    @property
    def regions(self) -> Array:
        """Stated probability of the smallest region that holds the true position, (n,)."""
        offsets = np.array(
            [np.subtract(r.position, p.position) for p, r in zip(self.places, self.records, strict=True)]
        )
        inverse = np.array([np.linalg.pinv(p.covariance, hermitian=True) for p in self.places])
        wider = REACH / np.array([p.reach for p in self.places])
        probabilities: Array = chi2.cdf(wider * np.einsum("ni,nij,nj->n", offsets, inverse, offsets), 3)
        return probabilities

    def calibration(self, levels: Array) -> Array:
        """Return the share of true positions that lie in the regions of given stated probabilities."""
        shares: Array = (self.regions[:, None] <= levels).mean(axis=0)
        return shares

    def draw(self, path: Path, title: str) -> None:
        """Write a figure: confusion matrix, errors by voxel, and calibration of the stated regions."""
        truth = np.array([r.voxel for r in self.records])
        predicted = np.array([p.voxels.argmax() for p in self.places])
        figures.save(path, draw(self.labels, truth, predicted, self.errors, self.regions, title))

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
        answers = zip(self.records, self.places, self.regions, self.evidence, self.misfits, strict=True)
        for record, place, region, log_ratio, fit in answers:
            numbers = [*record.position, *place.position, *np.sqrt(np.diag(place.covariance))]
            label, prob = self.labels[place.voxels.argmax()], place.voxels.max()
            verdict = [f"{region:.4f}", f"{log_ratio:.2f}", int(log_ratio > self.detector.threshold), f"{fit:.3g}"]
            rows.append([record.file, record.label, label, f"{prob:.4f}", *(f"{x:.5f}" for x in numbers), *verdict])
        return csv_text([*header, "region", "evidence", "detected", "misfit"], rows)


_AXES = ("x", "y", "z")
_MOST_TICKS = 14


@figures.styled
def draw(
    labels: Sequence[str],
    truth: NDArray[np.int64],
    predicted: NDArray[np.int64],
    errors: Array,
    regions: Array,
    title: str,
) -> Figure:
    """Return a figure: confusion matrix, errors by voxel, and calibration of the stated regions.

    Boxes show median and quartiles, whiskers the farthest errors within 1.5 quartile distances.

    Parameters
    ----------
    labels : sequence of str
        Of all voxels.
    truth, predicted : ndarray of shape (n,)
        True voxels and most probable ones, as indices of `labels`.
    errors : ndarray of shape (n,)
        Distances from the true positions, metres.
    regions : ndarray of shape (n,)
        `Evaluation.regions`.
    title : str
    """
    figure, [[left, middle, right]] = figures.subplots(1, 3, size=(figures.WIDTH, 3.2))
    count = len(labels)
    table = np.zeros((count, count))
    np.add.at(table, (truth, predicted), 1.0)
    share = 100.0 * table / np.maximum(table.sum(axis=1, keepdims=True), 1.0)
    figures.heat_map(left, share, labels)
    left.set_xlabel("found in")
    left.set_ylabel("stands in")
    left.set_title("voxels, % of each row")
    present = [v for v in range(count) if (truth == v).any()]
    middle.boxplot(
        [100.0 * errors[truth == v] for v in present],
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": figures.SKY, "alpha": 0.7},
        medianprops={"color": figures.BLACK},
    )
    step = -(-len(present) // _MOST_TICKS)
    middle.set_xticks(range(1, len(present) + 1, step), [labels[v] for v in present[::step]])
    middle.set_xlabel("voxel")
    middle.set_ylim(bottom=0.0)
    middle.set_ylabel("distance from the truth, cm")
    middle.set_title("errors")
    levels = np.linspace(0.02, 0.98, 49)
    held = (regions[:, None] <= levels).mean(axis=0)
    right.plot(100.0 * levels, 100.0 * levels, color=figures.GREY, lw=0.8, ls=":", label="as it should be")
    right.plot(100.0 * levels, 100.0 * held, color=figures.BLUE, lw=1.6, label="as it was")
    right.set_xlabel("stated probability of a region, %")
    right.set_ylabel("true positions in it, %")
    right.set_title("stated uncertainty")
    right.legend()
    figure.suptitle(title)
    return figure


def doubts(atlas: Atlas, kind: str, *, level: float, mismatch: float) -> list[str]:
    """Return what speaks against answers about pictures: another scene or another object than the atlas is of.

    Parameters
    ----------
    atlas : Atlas
    kind : str
        Kind of the target in the pictures.
    level, mismatch : float
        As of `Camera`.
    """
    sentences = []
    if mismatch:
        sentences.append(
            f"do not rely on these answers: the empty scene differs from that of the atlas by {mismatch:.1%} "
            "in shape, so room, lamp or view are others; make the atlas of this scene"
        )
    if level != 1.0:
        sentences.append(
            f"exposed {level:.3g} times as long as the atlas, so that the empty scene is as bright as there: "
            "right if the relay wall, the lamp or the camera is another, wrong if the room is"
        )
    kinds = atlas.about["targets"]
    if "box" not in kinds and kind not in kinds:  # an atlas of unknown boxes is asked about any object
        sentences.append(f"the atlas is of a {' and a '.join(kinds)}, and these pictures are of a {kind}")
    return sentences


def run(
    atlas: Atlas,
    dataset: PictureSet,
    *,
    false_alarm: float = 0.01,
    seed: int = 0,
    empty: int = _EMPTY,
    backgrounds: int = BACKGROUNDS,
    detector: Detector | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Evaluation:
    """Infer voxel, position and presence from each picture of a data set, as seen by the atlas' sensor.

    The pictures take turns with several measured backgrounds: with a single one, its noise would be in every answer,
    and no number of pictures would average it out.

    Parameters
    ----------
    atlas : Atlas
    dataset : Dataset or SimulatedSet
        Data set of the same volume and resolution; its pictures are without noise.
    false_alarm : float
        Share of empty scenes in which an object may be found.
    seed : int
        Seed of the sensor's noise.
    empty : int
        Number of pictures of the empty scene that are tested for false alarms.
    backgrounds : int
        Number of backgrounds that are measured, at most one for each picture.
    detector : Detector, optional
        By default, that of ``false_alarm`` and ``seed``.
    progress : callable
        Called with (done, total), in pictures.

    Raises
    ------
    NlosError
        If volume or resolution differ, the data set is empty or broken, or no background is to be measured.
    """
    if backgrounds < 1:
        raise NlosError(f"backgrounds {backgrounds}: must be 1 or more")
    grid = atlas.grid
    if (dataset.grid.lo, dataset.grid.hi) != (grid.lo, grid.hi):
        raise NlosError(f"{dataset.path}: has another voxel grid than the atlas; make both of one scene")
    check_colours(dataset.path, dataset.colour_space, atlas.colour_space, "the atlas")
    records = dataset.records
    if not records:
        raise NlosError(f"{dataset.path}: holds no finished picture yet")
    if records[0].others:
        raise NlosError(f"{dataset.path}: shows {1 + len(records[0].others)} objects at once; locate answers for one")
    positions = np.array([r.position for r in records])
    refuse_shared(atlas.positions, positions, "the atlas", str(dataset.path))
    uncertain = atlas.uncertain is not None
    camera = Camera(dataset, atlas.sensor, seed, like=atlas.background, any_shape=uncertain)
    measured, clean = [camera.background(k) for k in range(min(backgrounds, len(records)))], camera.empty()
    draws, empty_draws = (np.arange(n) % len(measured) for n in (len(records), empty))
    if dataset.own_backgrounds:
        draws = np.arange(len(records))
    misfit, misfits = Misfits(atlas, seed=seed), []
    codes, places, seconds = [], [], []
    shared = [] if dataset.own_backgrounds else measured
    given, strange = [atlas.given(one) for one in shared], [atlas.strangeness(one) for one in shared]
    for done, record in enumerate(records):
        background = camera.background_of(record) if dataset.own_backgrounds else measured[draws[done]]
        conditioned = given[draws[done]] if given else atlas.given(background)
        if dataset.own_backgrounds:
            strange.append(atlas.strangeness(background))
        picture = camera.picture(record)
        start = time.perf_counter()
        difference = atlas.difference(picture, background, name=str(dataset.path / record.file))
        codes.append(atlas.code_of(difference))
        places.append(locate(conditioned, codes[-1], seed=seed))
        misfits.append(misfit(difference, codes[-1], conditioned).probability)
        seconds.append(time.perf_counter() - start)
        progress(done + 1, len(records))
    rng = np.random.default_rng([seed, 5])
    codes_of_empty = [
        atlas.code(atlas.sensor.measure(clean, rng, pattern=seed), measured[draw]) for draw in empty_draws
    ]
    if dataset.grid != grid:  # the same volume, divided into other voxels
        voxels = grid.voxels(np.array([record.position for record in records]))
        records = [replace(r, voxel=int(v), label=grid.labels[v]) for r, v in zip(records, voxels, strict=True)]
    return Evaluation(
        records=records,
        places=places,
        evidence=evidence(atlas, np.array(codes)),
        empty=evidence(atlas, np.array(codes_of_empty)) if empty else np.zeros(0),
        detector=detector or Detector.at(atlas, false_alarm, seed=seed),
        draws=draws,
        empty_draws=empty_draws,
        labels=tuple(atlas.grid.labels),
        seconds=np.array(seconds),
        level=camera.level,
        doubts=tuple(
            filter(
                None,
                [
                    *doubts(
                        atlas,
                        dataset.target_kind,
                        level=1.0 if uncertain else camera.level,
                        mismatch=camera.mismatch,
                    ),
                    doubt_of_backgrounds(np.array(strange)),
                    doubt(np.array(misfits)),
                ],
            )
        ),
        misfits=np.array(misfits),
    )
