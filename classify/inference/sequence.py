"""A whole sequence tracked: the path that was found, beside the true one, and how far apart they are."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from classify.inference.atlas import Atlas
from classify.inference.bound import median
from classify.inference.posterior import holds
from classify.inference.tracker import Filter, Step
from classify.intervals import Interval, wilson
from classify.pictures.sensor import Camera
from generator.files.writing import csv_text
from generator.measure import figures
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.sets.dataset import Dataset
from generator.sets.readable import check_colours

_REST = 0.5
"""Seconds between two looks at a folder that fills."""
_ELLIPSE = 2.448
"""Standard deviations of a 95 % ellipse."""


@dataclass
class TrackedSequence:
    """Frames and what was made of them.

    Attributes
    ----------
    records : list of PoseRecord
    steps : list of Step
    there : list of bool
        Whether the object was in the frame: in a gap it was not.
    seconds : list of float
        That a frame took, from picture to answer.
    """

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
        """Positions that were found, (n, 3), metres."""
        return np.array([s.position for s in self.steps])

    @property
    def errors(self) -> Array:
        """Distances between the two where there was an object, metres."""
        apart: Array = np.linalg.norm(self.path - self.truth, axis=1)[np.array(self.there, dtype=bool)]
        return apart

    def trajectory_error(self) -> float:
        """Root mean square of the distances, metres: absolute trajectory error (Sturm et al. 2012, equation 4)."""
        return float(np.sqrt((self.errors**2).mean()))

    def told(self) -> Interval:
        """Return the share of frames in which presence was told rightly."""
        right = [(s.found) == there for s, there in zip(self.steps, self.there, strict=True)]
        return wilson(sum(right), len(right))

    def voxels(self) -> Interval:
        """Return the share of frames with an object in which its voxel was told rightly."""
        every = zip(self.steps, self.records, self.there, strict=True)
        right = [s.voxels.argmax() == r.voxel for s, r, there in every if there]
        return wilson(int(sum(right)), len(right))

    def held(self) -> Interval:
        """Return the share of frames with an object whose place lies in its 95 % region."""
        every = zip(self.steps, self.records, self.there, strict=True)
        inside = [holds(step, record.position) for step, record, there in every if there]
        return wilson(sum(inside), len(inside))

    def found_again(self) -> list[int]:
        """Return, for each end of a gap, how many frames it took to tell that the object was back."""
        waits = []
        for at in range(1, len(self.there)):
            if self.there[at] and not self.there[at - 1]:
                after = [s.found for s in self.steps[at:]]
                waits.append(after.index(True) + 1 if any(after) else len(after))
        return waits

    def words(self) -> list[str]:
        """Return what a person wants to know, line by line."""
        said = [
            f"median error of the position {median(self.errors).centimetres()}, root mean square "
            f"{100.0 * self.trajectory_error():.1f} cm, over {len(self.errors)} frames",
            f"right voxel in {self.voxels().percent()}, within the 95 % region {self.held().percent()}",
            f"presence told rightly in {self.told().percent()}",
        ]
        if waits := self.found_again():
            said.append(f"found again after {', '.join(map(str, waits))} frames")
        return said

    def csv(self) -> str:
        """Return every frame as a table, comma-separated."""
        rows = []
        for record, step, there in zip(self.records, self.steps, self.there, strict=True):
            numbers = [*record.position, *step.position, *np.sqrt(np.diag(step.covariance))]
            rows.append([record.index, int(there), f"{step.presence:.4f}", *(f"{x:.5f}" for x in numbers)])
        named = [f"{what}_{a}" for what in ("found", "sd") for a in "xyz"]
        return csv_text(["frame", "there", "presence", *"xyz", *named], rows)

    def draw(self, path: Path, title: str) -> None:
        """Write a picture of the path from above, with its uncertainty, and of the error over time."""
        figure, (above, over) = plt.subplots(1, 2, figsize=(12.5, 5.0), layout="constrained")
        truth, found = self.truth, self.path
        there = np.array(self.there, dtype=bool)
        for step, present in zip(self.steps, there, strict=True):
            if present and step.found:
                _ellipse(above, step)
        above.plot(*np.where(there[:, None], truth, np.nan)[:, :2].T, color="#1a1a1a", lw=1.5, label="true path")
        seen = np.array([s.found for s in self.steps])
        above.plot(*np.where(seen[:, None], found, np.nan)[:, :2].T, color="#d1242f", lw=1.2, label="found")
        above.set_xlabel("x, along the wall (m)")
        above.set_ylabel("y, from the wall (m)")
        above.set_aspect("equal")
        above.legend(loc="best", fontsize=8)
        above.set_title(f"{title}: from above, with 95 % regions", fontsize=9)
        frames = np.arange(len(truth))
        spread = np.array([np.sqrt(np.trace(s.covariance)) for s in self.steps])
        error = np.where(there, np.linalg.norm(found - truth, axis=1), np.nan)
        over.plot(frames, 100.0 * error, color="#d1242f", lw=1.0, label="error")
        over.plot(frames, 100.0 * spread, color="#1f6feb", lw=1.0, ls="--", label="stated standard deviation")
        over.fill_between(
            frames, 0, 1, where=~there, transform=over.get_xaxis_transform(), color="#d0d7de", label="gone"
        )
        over.plot(frames, [100.0 * s.presence for s in self.steps], color="#57606a", lw=0.8, label="presence, %")
        over.set_xlabel("frame")
        over.set_ylabel("cm")
        over.set_ylim(bottom=0.0)
        over.legend(loc="best", fontsize=8)
        figures.save(path, figure)


def _ellipse(axis: Axes, step: Step) -> None:
    strengths, ways = np.linalg.eigh(step.covariance[:2, :2])
    wide, high = 2.0 * _ELLIPSE * np.sqrt(np.maximum(strengths, 0.0))
    angle = float(np.degrees(np.arctan2(ways[1, 0], ways[0, 0])))
    axis.add_patch(Ellipse(tuple(step.position[:2]), wide, high, angle=angle, color="#d1242f", alpha=0.03, lw=0))


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
        A trajectory.
    step : float
        Standard deviation of the walk, metres along each axis from frame to frame.
    gaps : sequence of (int, int)
        Frames from and up to which the object is taken away: the empty scene is seen in their place.
    patience : float
        Seconds to wait for the next picture of a set that is still being rendered.
    seed : int
        Of the sensor's noise.
    told : callable
        Is told after every frame.

    Raises
    ------
    NlosError
        Grid or resolution differ, or the data set is no trajectory, is empty or broken.
    """
    if not dataset.settings.get("frames"):
        raise NlosError(f"{dataset.path}: is no trajectory; make one with nlos-generate trajectory")
    if dataset.grid != atlas.grid:
        raise NlosError(f"{dataset.path}: has another voxel grid than the atlas; make both of one scene")
    check_colours(dataset.path, dataset.colour_space, atlas.colour_space, "the atlas")
    tracker, pursuit = Filter(atlas, step=step), TrackedSequence()
    camera = Camera(dataset, atlas.sensor, seed, like=atlas.background)
    background, clean = camera.background(), camera.empty()
    rng = np.random.default_rng([seed, 6])
    for record in _frames(dataset, patience):
        there = not any(first <= record.index < last for first, last in gaps)
        start = time.perf_counter()
        picture = camera.picture(record) if there else atlas.sensor.measure(clean, rng, pattern=seed)
        found = tracker.update(atlas.code(picture, background, name=str(dataset.path / record.file)))
        pursuit.seconds.append(time.perf_counter() - start)
        pursuit.records.append(record)
        pursuit.steps.append(found)
        pursuit.there.append(there)
        told(pursuit)
    if not any(pursuit.there):
        raise NlosError(f"{dataset.path}: holds no frame with the object yet")
    return pursuit


def _frames(dataset: Dataset, patience: float) -> Iterator[PoseRecord]:
    """Frames in order; of a set that grows, as they come."""
    for index in range(len(dataset.poses)):
        late = time.monotonic() + patience
        while not dataset.poses[index].done:
            if time.monotonic() >= late:
                return
            time.sleep(min(_REST, patience))
            dataset.gather()
        yield dataset.poses[index]
