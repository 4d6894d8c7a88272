"""Tracking of a whole sequence: the estimated path, the true path, and the distance between them."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from classify.inference.atlas import Atlas
from classify.inference.evaluation import doubts
from classify.inference.posterior import holds
from classify.inference.tracker import AT_REST, Filter, Step
from classify.intervals import Interval, median_of_walk, share_of_walk, wilson
from classify.pictures.leak import refuse_shared
from classify.pictures.sensor import Camera
from generator.files.writing import csv_text
from generator.measure import figures
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.sets.dataset import Dataset
from generator.sets.readable import check_colours

_REST = 0.5
"""Seconds between two checks of a folder that is still being filled."""
_FAR = 10.0
"""Of n poses all over the volume, the closest to a border is that many n-ths of a voxel away once in exp(20)."""
_STATED = 0.95
"""Probability that the stated regions hold the position."""
_ELLIPSE = 2.448
"""Semi-axes of a 95 % ellipse, in standard deviations."""


@dataclass
class TrackedSequence:
    """Frames of a trajectory and the tracker's answers.

    Attributes
    ----------
    records : list of PoseRecord
    steps : list of Step
    there : list of bool
        Whether the object was in the frame; in a gap it was not.
    seconds : list of float
        Time that each frame took, from picture to answer.
    atlas_covered : Interval
        Share of the atlas' own poses, left out of it, that lie in the 95 % region (`held_out`).
    doubts : list of str
        What speaks against the answers, in sentences.
    """

    atlas_covered: Interval
    doubts: list[str] = field(default_factory=list)
    records: list[PoseRecord] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    there: list[bool] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    @property
    def truth(self) -> Array:
        """True positions, (n, 3), metres."""
        return np.array([r.position for r in self.records])

    @property
    def path(self) -> Array:
        """Estimated positions, (n, 3), metres."""
        return np.array([s.position for s in self.steps])

    @property
    def errors(self) -> Array:
        """Distances between estimated and true positions in the frames with an object, metres."""
        distances: Array = np.linalg.norm(self.path - self.truth, axis=1)[np.array(self.there, dtype=bool)]
        return distances

    def error(self) -> Interval:
        """Return the median of these distances, metres."""
        return median_of_walk(self.errors)

    def trajectory_error(self) -> float:
        """Root mean square of the distances, metres: absolute trajectory error (Sturm et al. 2012, equation 4)."""
        return float(np.sqrt((self.errors**2).mean()))

    def told(self) -> Interval:
        """Return the share of frames in which presence was stated correctly."""
        correct = [(s.found) == there for s, there in zip(self.steps, self.there, strict=True)]
        return share_of_walk(np.array(correct))

    def voxels(self) -> Interval:
        """Return the share of frames with an object in which its voxel was stated correctly."""
        frames = zip(self.steps, self.records, self.there, strict=True)
        correct = [s.voxels.argmax() == r.voxel for s, r, there in frames if there]
        return share_of_walk(np.array(correct))

    def held(self) -> Interval:
        """Return the share of frames with an object in which its position lies in the 95 % region."""
        frames = zip(self.steps, self.records, self.there, strict=True)
        inside = [holds(step, record.position) for step, record, there in frames if there]
        return share_of_walk(np.array(inside))

    def reacquired(self) -> list[int | None]:
        """Return, for the end of each gap, how many frames it took to detect the object again.

        None stands for a gap after which it was not detected before the next gap, or the end.
        """
        waits: list[int | None] = []
        for frame in range(1, len(self.there)):
            if self.there[frame] and not self.there[frame - 1]:
                present = itertools.takewhile(lambda k: self.there[k], range(frame, len(self.there)))
                waits.append(next((k - frame + 1 for k in present if self.steps[k].found), None))
        return waits

    def words(self) -> list[str]:
        """Return a summary for readers, line by line."""
        lines = [
            f"median error of the position {self.error().centimetres()}, root mean square "
            f"{100.0 * self.trajectory_error():.1f} cm, over {len(self.errors)} frames",
            f"right voxel in {self.voxels().percent()}, within the 95 % region {self.held().percent()}",
            f"presence told rightly in {self.told().percent()}",
        ]
        waits = self.reacquired()
        if counts := [str(wait) for wait in waits if wait is not None]:
            lines.append(f"found again after {', '.join(counts)} frames")
        if lost := waits.count(None):
            lines.append(f"not found again after {lost} of {len(waits)} gaps")
        if self.atlas_covered.high < _STATED:
            lines.append(
                f"do not rely on these regions: of the atlas' own poses, left out of it and looked at {AT_REST} "
                f"times, they hold {self.atlas_covered.percent()} for 95 %; simulate more pictures or take fewer "
                "--frames"
            )
        return [*lines, *self.doubts]

    def csv(self) -> str:
        """Return every frame as a table, comma-separated."""
        rows = []
        for record, step, there in zip(self.records, self.steps, self.there, strict=True):
            numbers = [*record.position, *step.position, *np.sqrt(np.diag(step.covariance))]
            rows.append([record.index, int(there), f"{step.presence:.4f}", *(f"{x:.5f}" for x in numbers)])
        columns = [f"{quantity}_{a}" for quantity in ("found", "sd") for a in "xyz"]
        return csv_text(["frame", "there", "presence", *"xyz", *columns], rows)

    @figures.styled
    def draw(self, path: Path, title: str) -> None:
        """Write a figure: the path from above, with its uncertainty; error and presence over time."""
        figure = Figure(figsize=(figures.WIDTH, 4.3))
        axes = figure.subplot_mosaic([["path", "error"], ["path", "presence"]], height_ratios=[2, 1])
        top_view, error_plot, presence_plot = axes["path"], axes["error"], axes["presence"]
        presence_plot.sharex(error_plot)
        truth, estimated = self.truth, self.path
        there = np.array(self.there, dtype=bool)
        for step, present in zip(self.steps, there, strict=True):
            if present and step.found:
                _ellipse(top_view, step)
        top_view.plot(
            *np.where(there[:, None], truth, np.nan)[:, :2].T, color=figures.BLACK, lw=1.5, label="true path"
        )
        shown = np.array([s.found for s in self.steps])
        top_view.plot(
            *np.where(shown[:, None], estimated, np.nan)[:, :2].T,
            color=figures.VERMILION,
            lw=1.2,
            ls="--",
            label="found",
        )
        top_view.set_xlabel("x, along the wall (m)")
        top_view.set_ylabel("y, from the wall (m)")
        top_view.set_aspect("equal", adjustable="datalim")
        top_view.set_title("from above, with 95 % regions")
        frames = np.arange(len(truth))
        spread = np.array([np.sqrt(np.trace(s.covariance)) for s in self.steps])
        error = np.where(there, np.linalg.norm(estimated - truth, axis=1), np.nan)
        error_plot.plot(frames, 100.0 * error, color=figures.VERMILION, lw=1.0, label="error")
        error_plot.plot(
            frames, 100.0 * spread, color=figures.BLUE, lw=1.0, ls="--", label="stated standard deviation"
        )
        error_plot.set_ylabel("position, cm")
        error_plot.set_ylim(bottom=0.0)
        error_plot.tick_params(labelbottom=False)
        presence_plot.plot(frames, [100.0 * s.presence for s in self.steps], color=figures.GREEN, lw=1.0)
        presence_plot.set_ylabel("presence, %")
        presence_plot.set_ylim(-3.0, 103.0)
        presence_plot.set_xlabel("frame")
        for plot in (error_plot, presence_plot):
            ends = plot.get_xaxis_transform()
            plot.fill_between(frames, 0, 1, where=~there, transform=ends, color=figures.PALE, lw=0, label="gone")
        handles = [*top_view.get_legend_handles_labels()[0], *error_plot.get_legend_handles_labels()[0]]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
        figure.suptitle(title)
        figures.save(path, figure)


def _ellipse(axis: Axes, step: Step) -> None:
    eigenvalues, eigenvectors = np.linalg.eigh(step.covariance[:2, :2])
    width, height = 2.0 * _ELLIPSE * np.sqrt(np.maximum(eigenvalues, 0.0))
    angle = float(np.degrees(np.arctan2(eigenvectors[1, 0], eigenvectors[0, 0])))
    axis.add_patch(
        Ellipse(tuple(step.position[:2]), width, height, angle=angle, color=figures.VERMILION, alpha=0.03, lw=0)
    )


def held_out(atlas: Atlas, *, step: float, count: int = 200, seed: int = 0) -> Interval:
    """Return the share of poses, left out of the atlas, that lie in the 95 % region after some frames at rest.

    Two errors stay from frame to frame and add up: the noise of the measured background, for which the filter allows;
    and what a cell's moments get wrong of the codes in it, if poses are few against the sharpness of the codes. That
    makes regions too small. This share tells by how much, before any picture is taken.

    Parameters
    ----------
    atlas : Atlas
    step : float
        As for `Filter`.
    count : int
        Number of poses, at most a tenth of the atlas.
    seed : int
        Seed of the choice and of the noise.

    Returns
    -------
    Interval
        With its 95 % interval (Wilson).
    """
    rng = np.random.default_rng([seed, 7])
    tested, kept = np.split(rng.permutation(len(atlas.codes)), [max(1, min(count, len(atlas.codes) // 10))])
    inside, size = 0, atlas.codes.shape[1]
    tracker = Filter(atlas.take(np.sort(kept)), step=step)
    for pose in tested:
        tracker.restart()
        background = rng.normal(size=size) * math.sqrt(1.0 - 1.0 / atlas.spread)
        for _ in range(AT_REST):
            noise = background + rng.normal(size=size) / math.sqrt(atlas.spread)
            answer = tracker.update((atlas.codes[pose] + noise).astype(np.float32))
        inside += holds(answer, atlas.positions[pose])
    return wilson(inside, len(tested))


def run(
    atlas: Atlas,
    dataset: Dataset,
    *,
    step: float,
    gaps: Sequence[tuple[int, int]] = (),
    patience: float = 0.0,
    seed: int = 0,
    told: Callable[[TrackedSequence], None] = lambda pursuit: None,
) -> TrackedSequence:
    """Track the object through a data set's pictures in their order, as the atlas' sensor would have seen them.

    Parameters
    ----------
    atlas : Atlas
    dataset : Dataset
        Data set of a trajectory.
    step : float
        Standard deviation of the walk, metres along each axis from frame to frame.
    gaps : sequence of (int, int)
        Ranges of frames, the end exclusive, from which the object is removed: they show the empty scene.
    patience : float
        Seconds to wait for the next picture of a set that is still being rendered.
    seed : int
        Seed of the sensor's noise.
    told : callable
        Called with the sequence so far after every frame.

    Raises
    ------
    NlosError
        If the atlas' poses do not fill the volume, or are those of the trajectory; grid or resolution differ, or the
        data set is not a trajectory, is empty or broken.
    """
    refuse_gaps(atlas)
    if not dataset.settings.get("frames"):
        raise NlosError(f"{dataset.path}: is no trajectory; make one with nlos-generate trajectory")
    if dataset.grid != atlas.grid:
        raise NlosError(f"{dataset.path}: has another voxel grid than the atlas; make both of one scene")
    check_colours(dataset.path, dataset.colour_space, atlas.colour_space, "the atlas")
    positions = np.array([record.position for record in dataset.poses])
    refuse_shared(atlas.positions, positions, "the atlas", str(dataset.path))
    tracker = Filter(atlas, step=step)
    camera = Camera(dataset, atlas.sensor, seed, like=atlas.background)
    pursuit = TrackedSequence(
        held_out(atlas, step=step, seed=seed),
        doubts(atlas, dataset.target_kind, level=camera.level, mismatch=camera.mismatch),
    )
    background, clean = camera.background(), camera.empty()
    rng = np.random.default_rng([seed, 6])
    for record in _frames(dataset, patience):
        there = not any(first <= record.index < last for first, last in gaps)
        start = time.perf_counter()
        picture = camera.picture(record) if there else atlas.sensor.measure(clean, rng, pattern=seed)
        answer = tracker.update(atlas.code(picture, background, name=str(dataset.path / record.file)))
        pursuit.seconds.append(time.perf_counter() - start)
        pursuit.records.append(record)
        pursuit.steps.append(answer)
        pursuit.there.append(there)
        told(pursuit)
    if not any(pursuit.there):
        raise NlosError(f"{dataset.path}: holds no frame with the object yet")
    return pursuit


def refuse_gaps(atlas: Atlas) -> None:
    """Raise NlosError if the atlas' poses leave gaps between the voxels."""
    if inside := atlas.about.get("inside"):
        gaps = set(inside) != {"centre"}
    else:  # an atlas of an earlier version: the closest pose to a border between voxels tells
        within = np.divide(np.subtract(atlas.positions, atlas.grid.lo), atlas.grid.size) % 1.0
        closest = np.minimum(within, 1.0 - within).min(axis=0)
        gaps = bool((closest > _FAR / len(within))[np.array(atlas.grid.shape) > 1].any())
    if gaps:
        raise NlosError(
            "the atlas: its poses leave gaps between the voxels, and a walk crosses them; make one of a set that "
            "fills the volume: nlos-generate bulk SCENE.blend -o SET --inside centre, then nlos-classify atlas SET "
            "-o FILE.atlas"
        )


def _frames(dataset: Dataset, patience: float) -> Iterator[PoseRecord]:
    """Yield the frames in order; of a set that is still being rendered, as they arrive."""
    for index in range(len(dataset.poses)):
        deadline = time.monotonic() + patience
        while not dataset.poses[index].done:
            if time.monotonic() >= deadline:
                return
            time.sleep(min(_REST, patience))
            dataset.gather()
        yield dataset.poses[index]
