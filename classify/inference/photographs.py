"""Answers from an atlas about pictures that a camera has taken, whether or not it is known where the object stood."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from classify.inference.atlas import Atlas
from classify.inference.detect import Detector, evidence
from classify.inference.evaluation import doubts as doubts_of
from classify.inference.misfit import Misfits, doubt, doubt_of_backgrounds
from classify.inference.posterior import Place, holds, locate
from classify.inference.sequence import refuse_gaps
from classify.inference.tracker import Filter, Step
from classify.intervals import Interval, median, wilson
from classify.pictures.frames import Frame
from classify.pictures.recipe import Recipe
from classify.pictures.sensor import Camera
from classify.pictures.taken import Taken
from classify.tail import RARE
from generator.files.pictures import Picture
from generator.files.writing import csv_text
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.sets.measured import has_own_noise
from generator.sets.readable import PictureSet, check_colours

_SAME_SHAPE = 0.02
"""Relative difference in shape of two empty scenes from which on they are different scenes."""


@dataclass(frozen=True)
class Found:
    """The answer to a picture.

    Attributes
    ----------
    place : Place
    evidence : float
        Logarithm of how much likelier an object is than an empty scene.
    detected : bool
        Whether an object is found.
    misfit : float
        As of `classify.inference.misfit.Misfit`.
    seconds : float
        Time from the picture to the answer.
    """

    place: Place
    evidence: float
    detected: bool
    misfit: float
    seconds: float

    def words(self, labels: Sequence[str]) -> str:
        """Return the answer as a phrase."""
        if not self.detected:
            words = "nothing is found"
        else:
            voxel = int(self.place.voxels.argmax())
            x, y, z = self.place.position
            spread = " x ".join(f"{100.0 * s:.0f}" for s in np.sqrt(np.diag(self.place.covariance)))
            words = (
                f"in {labels[voxel]} ({self.place.voxels[voxel]:.1%}), at {x:.2f}, {y:.2f}, {z:.2f} m, give or take "
                f"{spread} cm"
            )
        return f"{words}; does not fit the atlas ({self.misfit:.1g})" if self.misfit < RARE else words


class Answering:
    """Answers picture by picture, all with one measured picture of the empty scene.

    Parameters
    ----------
    atlas : Atlas
        For the pictures' sensor.
    background : ndarray of shape (height, width, 3)
        Measured empty scene, W/m^2/sr.
    false_alarm : float
        Share of empty scenes in which something may be found.
    seed : int
    """

    def __init__(self, atlas: Atlas, background: Picture, *, false_alarm: float = 0.01, seed: int = 0) -> None:
        self.atlas = atlas
        self._background, self._seed = background, seed
        self._given = atlas.given(background)
        self._misfits = Misfits(atlas, seed=seed)
        self.detector = Detector.at(atlas, false_alarm, seed=seed)

    def __call__(self, picture: Picture, name: str) -> Found:
        """Answer a measured picture (height, width, 3), W/m^2/sr."""
        start = time.perf_counter()
        difference = self.atlas.difference(picture, self._background, name=name)
        code = self.atlas.code_of(difference)
        place = locate(self._given, code, seed=self._seed)
        ratio = float(evidence(self.atlas, code[None])[0])
        misfit = self._misfits(difference, code, self._given).probability
        return Found(place, ratio, ratio > self.detector.threshold, misfit, time.perf_counter() - start)


@dataclass(frozen=True)
class Answers:
    """The answers to a set's pictures.

    Attributes
    ----------
    records : list of PoseRecord
        What is known of them.
    found : list of Found
    labels : tuple of str
        Of the voxels.
    level, mismatch : float
        As of `Taken`.
    doubts : tuple of str
        What speaks against the answers, in sentences.
    """

    records: list[PoseRecord]
    found: list[Found]
    labels: tuple[str, ...]
    level: float
    mismatch: float
    doubts: tuple[str, ...]

    def accuracy(self) -> Interval | None:
        """Return the share of pictures put into the right voxel, of those whose voxel is known; None if none is."""
        right = [f.place.voxels.argmax() == r.voxel for r, f in self._both() if r.voxel >= 0]
        return wilson(sum(right), len(right)) if right else None

    def error(self) -> Interval | None:
        """Return the median distance from the true position, metres, where that is known; None if nowhere."""
        errors = [np.linalg.norm(f.place.position - r.position) for r, f in self._both() if r.placed]
        return median(np.array(errors)) if errors else None

    def covered(self) -> Interval | None:
        """Return the share of known positions that lie in the 95 % regions; None if none is known."""
        inside = [holds(f.place, r.position) for r, f in self._both() if r.placed]
        return wilson(sum(inside), len(inside)) if inside else None

    @property
    def seconds(self) -> float:
        """Median time of an answer, seconds."""
        return float(np.median([found.seconds for found in self.found]))

    def detected(self) -> Interval:
        """Return the share of pictures in which an object is found."""
        return wilson(sum(f.detected for f in self.found), len(self.found))

    def _both(self) -> Iterator[tuple[PoseRecord, Found]]:
        return zip(self.records, self.found, strict=True)

    def lines(self) -> list[str]:
        """Return a line a picture."""
        return [f"{record.file}: {found.words(self.labels)}" for record, found in self._both()]

    def csv(self) -> str:
        """Return every answer as a table; what is not known of a picture is empty."""
        axes = "xyz"
        header = ["file", "voxel", "found", "probability", *axes]
        header += [f"{word}_{axis}" for word in ("found", "sd") for axis in axes]
        rows = []
        for record, found in self._both():
            place = found.place
            voxel = int(place.voxels.argmax())
            truth = [f"{x:.5f}" if record.placed else "" for x in record.position]
            numbers = [*place.position, *np.sqrt(np.diag(place.covariance))]
            verdict = [f"{found.evidence:.2f}", int(found.detected), f"{found.misfit:.3g}"]
            answer = [record.file, record.label, self.labels[voxel], f"{place.voxels[voxel]:.4f}"]
            rows.append([*answer, *truth, *(f"{x:.5f}" for x in numbers), *verdict])
        return csv_text([*header, "evidence", "detected", "misfit"], rows)


def prepared(atlas: Atlas, dataset: PictureSet, seed: int = 0) -> tuple[Taken | Camera, Atlas, list[str]]:
    """Return a set's pictures at the atlas' level, the atlas for their camera, and what speaks against answers.

    Pictures without noise of their own are seen by the atlas' sensor, whose noise ``seed`` draws.

    Raises
    ------
    NlosError
        Voxels or colours are others, or the pictures cannot be compared with the atlas (`Taken`, `Atlas.seen_by`).
    """
    if not atlas.grid.covers_same(dataset.grid):
        raise NlosError(f"{dataset.path}: has another voxel grid than the atlas; make both of one scene")
    check_colours(dataset.path, dataset.colour_space, atlas.colour_space, "the atlas")
    if not has_own_noise(dataset):
        camera = Camera(dataset, atlas.sensor, seed, like=atlas.background, any_shape=atlas.uncertain is not None)
        return camera, atlas, doubts_of(atlas, dataset.target_kind, level=camera.level, mismatch=camera.mismatch)
    taken = Taken(dataset, atlas.background)
    seen = atlas.seen_by(taken.sensor)
    if seen.uncertain is not None:
        strange = doubt_of_backgrounds(np.array([seen.strangeness(taken.background())]))
        return taken, seen, [strange] if strange else []
    doubts = []
    # Noise of the measured background is no difference of scenes.
    noise = math.sqrt(float(taken.sensor.variance(taken.background(), frames=taken.sensor.background_frames).mean()))
    expected = noise / math.sqrt(float((atlas.background**2).mean()))
    if math.sqrt(max(taken.mismatch**2 - expected**2, 0.0)) > _SAME_SHAPE:
        doubts.append(
            f"do not rely on these answers: the empty scene differs from that of the atlas by {taken.mismatch:.1%} "
            "in shape, so room, lamp or view are others; make the atlas of this scene"
        )
    return taken, seen, doubts


def answers(
    atlas: Atlas,
    dataset: PictureSet,
    *,
    false_alarm: float = 0.01,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Answers:
    """Locate the object of each picture of a set.

    Raises
    ------
    NlosError
        The pictures cannot be compared with the atlas (`prepared`).
    """
    taken, atlas, doubts = prepared(atlas, dataset, seed)
    answering = Answering(atlas, taken.background(), false_alarm=false_alarm, seed=seed)
    found, records = [], dataset.records
    for record in records:
        found.append(answering(taken.picture(record), str(dataset.path / record.file)))
        progress(len(found), len(records))
    if dataset.grid.shape != atlas.grid.shape:  # the same volume, cut into others: only positions tell which
        records = [_recut(record, atlas) for record in records]
    doubts += filter(None, [doubt(np.array([f.misfit for f in found]))])
    return Answers(records, found, tuple(atlas.grid.labels), taken.level, taken.mismatch, tuple(doubts))


def live(
    atlas: Atlas,
    dataset: PictureSet,
    recipe: Recipe,
    coming: Iterable[Frame],
    *,
    false_alarm: float = 0.01,
    seed: int = 0,
    told: Callable[[str, Found], None] = lambda *_: None,
    complain: Callable[[str], None] = lambda words: None,
) -> Answers:
    """Answer a camera's frames as they come.

    Parameters
    ----------
    atlas : Atlas
    dataset : PictureSet
        Imported pictures of the same camera, of which the empty scene is taken.
    recipe : Recipe
        How these were made.
    coming : iterable of Frame
        Its end, or a keyboard interrupt, ends the answers.
    false_alarm, seed
        As for `Answering`.
    told : callable
        Called with the name of every picture and its answer.
    complain : callable
        Called with a sentence for a picture that cannot be answered.
    """
    taken, atlas, doubts = prepared(atlas, dataset, seed)
    answering = Answering(atlas, taken.background(), false_alarm=false_alarm, seed=seed)
    burst = taken.sensor.frames
    found: list[Found] = []
    records: list[PoseRecord] = []
    group: list[Frame] = []
    unknown = (math.nan, math.nan, math.nan)
    with contextlib.suppress(KeyboardInterrupt):
        for frame in coming:
            group.append(frame)
            if len(group) < burst:
                continue
            start = time.perf_counter()
            frames, group = group, []
            try:
                answer = answering(recipe(frames) * np.float32(taken.level), frame.name)
            except NlosError as error:
                complain(f"warning: {error}")
                continue
            found.append(replace(answer, seconds=time.perf_counter() - start))
            records.append(PoseRecord(len(records), -1, "", unknown, unknown, 0, file=frame.name))
            told(frame.name, found[-1])
    doubts += filter(None, [doubt(np.array([f.misfit for f in found]))])
    return Answers(records, found, tuple(atlas.grid.labels), taken.level, taken.mismatch, tuple(doubts))


def _recut(record: PoseRecord, atlas: Atlas) -> PoseRecord:
    voxel = atlas.grid.voxel(np.array(record.position)) if record.placed else -1
    return replace(record, voxel=voxel, label=atlas.grid.labels[voxel] if voxel >= 0 else "")


@dataclass(frozen=True)
class Tracked:
    """The path of an object through pictures of a camera.

    Attributes
    ----------
    records : list of PoseRecord
    steps : list of Step
    doubts : list of str
    """

    records: list[PoseRecord]
    steps: list[Step]
    doubts: list[str]

    @property
    def errors(self) -> Array:
        """Distances from the true positions where they are known, metres."""
        both = zip(self.records, self.steps, strict=True)
        return np.array([np.linalg.norm(step.position - record.position) for record, step in both if record.placed])

    def csv(self) -> str:
        """Return every frame as a table; what is not known is empty."""
        columns = [f"{quantity}_{a}" for quantity in ("found", "sd") for a in "xyz"]
        rows = []
        for record, step in zip(self.records, self.steps, strict=True):
            truth = [f"{x:.5f}" if record.placed else "" for x in record.position]
            numbers = [f"{x:.5f}" for x in (*step.position, *np.sqrt(np.diag(step.covariance)))]
            rows.append([record.index, f"{step.presence:.4f}", *truth, *numbers])
        return csv_text(["frame", "presence", *"xyz", *columns], rows)


def track(
    atlas: Atlas,
    dataset: PictureSet,
    *,
    step: float,
    seed: int = 0,
    told: Callable[[PoseRecord, Step], None] = lambda *_: None,
) -> Tracked:
    """Track an object through a set's pictures, in their order.

    Parameters
    ----------
    atlas : Atlas
    dataset : PictureSet
    step : float
        Standard deviation of the walk, metres along each axis from picture to picture.
    seed : int
        Seed of noise that is added to pictures without any.
    told : callable
        Called with every picture and its answer.
    """
    refuse_gaps(atlas)
    taken, atlas, doubts = prepared(atlas, dataset, seed)
    background = taken.background()
    tracker, steps = Filter(atlas.given(background), step=step), []
    for record in dataset.records:
        code = atlas.code(taken.picture(record), background, name=str(dataset.path / record.file))
        steps.append(tracker.update(code))
        told(record, steps[-1])
    return Tracked(dataset.records, steps, doubts)
