"""Detection of an object: its evidence is compared with a threshold that empty scenes seldom reach."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from scipy.special import logsumexp

from classify.inference.atlas import Atlas
from classify.intervals import Interval, wilson
from generator.measure import figures
from generator.model.arrays import Array
from generator.model.errors import NlosError

_POSES = 8192
"""Number of the atlas' poses that the evidence uses: more would change it by less than the noise does."""
_EMPTY = 20_000
_BLOCK = 256
_TRIED = 4000
"""Number of empty scenes that an ROC curve is based on."""
_MOST_LINES = 27


def evidence(atlas: Atlas, codes: NDArray[np.float32]) -> Array:
    """Return the log-likelihood ratio of the object at any pose to an empty scene, for each picture, (n,).

    It is the ratio for the mixture of all poses: at a given rate of false alarms no other test finds the object more
    often, on average over the poses (Neyman and Pearson 1933).

    Parameters
    ----------
    atlas : Atlas
    codes : ndarray of shape (n, k)
        Codes of the pictures.
    """
    step = max(1, len(atlas.codes) // _POSES)
    subset = atlas.take(slice(None, None, step))
    blocks = [codes[i : i + _BLOCK] for i in range(0, len(codes), _BLOCK)]
    logs = [logsumexp(subset.logs(block), axis=1) for block in blocks]
    log_ratios: Array = np.concatenate(logs).astype(np.float64) - np.log(len(subset.codes))
    return log_ratios


@dataclass(frozen=True)
class Detector:
    """Decides whether there is an object.

    Attributes
    ----------
    atlas : Atlas
    false_alarm : float
        Share of empty scenes in which it finds one as well.
    threshold : float
        Threshold of the evidence, a logarithm.
    """

    atlas: Atlas
    false_alarm: float
    threshold: float

    @classmethod
    def at(cls, atlas: Atlas, false_alarm: float = 0.01, *, seed: int = 0) -> Detector:
        """Return the detector that has a given share of false alarms in empty scenes.

        The threshold is the quantile of the evidence in simulated empty scenes, whose codes are unit noise.

        Raises
        ------
        NlosError
            If the rate is not a share, or so low that too few of the simulated scenes would give an alarm.
        """
        least = 20.0 / _EMPTY
        if not least <= false_alarm < 1.0:
            raise NlosError(f"false alarms {false_alarm:g}: must be a share from {least:g} to 1")
        rng = np.random.default_rng([seed, 4])
        empty = rng.normal(size=(_EMPTY, atlas.codes.shape[1])).astype(np.float32)
        return cls(atlas, false_alarm, float(np.quantile(evidence(atlas, empty), 1.0 - false_alarm)))

    def __call__(self, codes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return whether there is an object in each of the pictures with the codes (n, k), (n,)."""
        return evidence(self.atlas, codes) > self.threshold


@dataclass(frozen=True)
class Detection:
    """How often an object is found, voxel by voxel.

    Attributes
    ----------
    frames : int
        Number of frames averaged for a picture.
    found : list of Interval
        Share of pictures in which an object is found, for each voxel.
    evidence : list of ndarray
        Evidence in the pictures of each voxel.
    empty : ndarray of shape (m,)
        Evidence in empty scenes.
    """

    frames: int
    found: list[Interval]
    evidence: list[Array]
    empty: Array

    def roc(self, voxel: int) -> tuple[Array, Array]:
        """Return the rates of false alarms and of detections at every threshold, each from 0 to 1."""
        thresholds = np.sort(self.empty)[::-1]
        alarms = np.arange(1, len(thresholds) + 1) / len(thresholds)
        detected = 1.0 - np.searchsorted(np.sort(self.evidence[voxel]), thresholds) / len(self.evidence[voxel])
        return alarms, detected


def detections(
    atlas: Atlas,
    frames: Sequence[int],
    *,
    false_alarm: float = 0.01,
    count: int = 300,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Detection]:
    """Return how often the atlas' own objects are found, for several exposures.

    Parameters
    ----------
    atlas : Atlas
        Atlas for at least the largest number of frames.
    frames : sequence of int
    false_alarm : float
        Share of empty scenes in which an object may be found.
    count : int
        Number of pictures in each voxel, at most as many as the atlas has.
    seed : int
        Seed of poses and noise.
    progress : callable
        Called with (done, total), in exposures.

    Returns
    -------
    list of Detection
        One for each number of frames.

    Raises
    ------
    NlosError
        If the atlas is not made for so many frames, or the rate is out of range.
    """
    results = []
    for done, n_frames in enumerate(frames):
        progress(done, len(frames))
        exposed = atlas.at(n_frames)
        detector = Detector.at(exposed, false_alarm, seed=seed)
        rng = np.random.default_rng([seed, 7])
        evidences, code_length = [], exposed.codes.shape[1]
        for voxel in range(atlas.grid.n_voxels):
            members = np.flatnonzero(exposed.voxels == voxel)
            chosen = rng.choice(members, size=min(count, len(members)), replace=False)
            codes = np.array([exposed.example(int(pose), rng) for pose in chosen]).reshape(len(chosen), code_length)
            evidences.append(evidence(exposed, (codes + rng.normal(size=codes.shape)).astype(np.float32)))
        empty = evidence(exposed, rng.normal(size=(_TRIED, code_length)).astype(np.float32))
        rates = [
            wilson(int((e > detector.threshold).sum()), len(e)) if len(e) else Interval(math.nan, 0.0, 1.0)
            for e in evidences
        ]
        results.append(Detection(n_frames, rates, evidences, empty))
    progress(len(frames), len(frames))
    return results


def rows(atlas: Atlas, made: Sequence[Detection]) -> list[tuple[str, ...]]:
    """Return a table with a row for each voxel, its distance from the wall, and a column for each exposure."""
    table = []
    for voxel, label in enumerate(atlas.grid.labels):
        centre = np.mean(atlas.grid.bounds(voxel), axis=0)
        table.append((label, f"{centre[1]:.2f} m", *(detection.found[voxel].percent() for detection in made)))
    return table


@figures.styled
def draw(path: Path, atlas: Atlas, made: Sequence[Detection], false_alarm: float) -> None:
    """Write a figure: detections against exposure, and the ROC curves of the first exposure."""
    figure, [[left, right]] = figures.subplots(1, 2, size=(figures.WIDTH, 4.2))
    labels = atlas.grid.labels
    colours = colormaps[figures.SEQUENTIAL](np.linspace(0.0, 0.9, len(labels)))  # the order of the voxels
    for voxel, label in enumerate(labels[:_MOST_LINES]):
        values = [detection.found[voxel] for detection in made]
        spread = 100.0 * np.array([[v.value - v.low for v in values], [v.high - v.value for v in values]])
        left.errorbar(
            [detection.frames for detection in made],
            [100.0 * v.value for v in values],
            np.maximum(spread, 0.0),
            marker=figures.MARKERS[voxel % len(figures.MARKERS)],
            ms=4,
            lw=1.2,
            color=colours[voxel],
            label=label,
        )
        right.plot(
            *(100.0 * rate for rate in made[0].roc(voxel)),
            marker=figures.MARKERS[voxel % len(figures.MARKERS)],
            markevery=0.15,
            ms=4,
            lw=1.2,
            color=colours[voxel],
        )
    left.set_xscale("log")
    left.set_xlabel("frames averaged")
    left.set_ylabel(f"found at {100.0 * false_alarm:g} % false alarms, %")
    left.axhline(99.0, color=figures.GREY, lw=0.8, ls=":")
    left.set_ylim(0.0, 102.0)
    left.set_title("against exposure; dotted: 99 %")
    right.axvline(100.0 * false_alarm, color=figures.GREY, lw=0.8, ls=":")
    right.set_xscale("log")
    right.set_xlim(0.1, 100.0)
    right.set_ylim(0.0, 102.0)
    right.set_xlabel("false alarms, %")
    right.set_ylabel("found, %")
    right.set_title(f"against false alarms, {made[0].frames} frame{'s' if made[0].frames > 1 else ''}")
    figures.plain_numbers(left.xaxis, right.xaxis)
    handles, names = left.get_legend_handles_labels()
    figure.legend(handles, names, title="voxel", loc="outside lower center", ncols=min(9, len(names)))
    figures.save(path, figure)
