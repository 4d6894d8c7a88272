"""Limits that the noise of a picture sets to any method of inference.

The paper asks "under which conditions is the effect significant enough to be detected" (section 1). For small changes
the answer is the Fisher information of the picture about the pose; for voxels, and wherever noise is so large that a
pose may be anywhere, it is Bayes' rule with the engine's own pictures, which no method can surpass.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from scipy.stats import norm

from classify.inference.atlas import Atlas
from classify.inference.posterior import Synthesis, locate
from classify.intervals import Effective, Interval, median_of, paired_difference, score_interval
from generator.measure import figures
from generator.model.arrays import Array
from generator.model.errors import NlosError

_FEWEST = 4
"""Poses of an atlas whose half, without the pose that is asked about, still has one."""


@dataclass(frozen=True)
class Reachable:
    """Performance of the best possible method on poses distributed like those of the atlas.

    Attributes
    ----------
    accuracy : Interval
        Share of pictures that it puts into the right voxel.
    by_voxel : list of Interval
    error : Interval
        Median distance of its position from the true one, metres.
    count : int
        Number of pictures.
    gain : Interval
        Share of pictures that are right with the whole atlas less that with half of its poses.
    """

    accuracy: Interval
    by_voxel: list[Interval]
    error: Interval
    count: int
    gain: Interval

    def words(self) -> list[str]:
        """Return what the shares of right voxels do and do not bound, in sentences."""
        lines = [
            "right voxel: no method puts more of all pictures into their voxels; in a single voxel, a method that "
            "prefers that voxel may"
        ]
        if self.gain.low > 0.0:
            lines.append(
                f"these bounds are too low: with half of the atlas' poses they are {self.gain.percent()} "
                f"lower, so with more poses they would rise; make a larger atlas"
            )
        return lines


def reachable(
    atlas: Atlas, *, count: int = 3000, seed: int = 0, progress: Callable[[int, int], None] = lambda done, total: None
) -> Reachable:
    """Apply Bayes' rule to pictures of the atlas' own poses, each left out of the atlas for its own picture.

    No decision between voxels errs less often (Duda, Hart and Stork 2001, section 2.2), and the posterior's mean has
    the least mean squared error (Kay 1993, section 10.4), for poses distributed as in the atlas.

    The same pictures are also judged by half of the poses: where that makes a difference, the poses are too few for a
    bound.

    A pose that is asked about also answers for the others. With every pose asked about, the variance of a share is by
    simulation 1.1 to 1.4 times that of independent answers where pictures are sharp, and 2.1 times where noise hides
    them; the intervals assume twice, and less in proportion if fewer are asked about.

    Parameters
    ----------
    atlas : Atlas
    count : int
        Number of pictures, at most as many as the atlas has.
    seed : int
        Seed of their choice and their noise.
    progress : callable
        Called with (done, total), in pictures.
    """
    poses = len(atlas.codes)
    if poses < _FEWEST:
        raise NlosError(f"an atlas of {poses} poses bounds nothing; it needs {_FEWEST} at least")
    rng = np.random.default_rng([seed, 2])
    chosen = rng.choice(len(atlas.codes), size=min(count, len(atlas.codes)), replace=False)
    kept = np.sort(np.random.default_rng([seed, 10]).choice(poses, size=poses // 2, replace=False))
    half, place_in_half = atlas.take(kept), dict(zip(kept.tolist(), range(len(kept)), strict=True))
    correct, correct_by_half = np.zeros((2, len(chosen)), dtype=bool)
    errors = np.zeros(len(chosen))
    for done, pose in enumerate(chosen):
        code = atlas.example(int(pose), rng) + rng.normal(size=atlas.codes.shape[1])
        place = locate(atlas, code.astype(np.float32), without=int(pose))
        correct[done] = place.voxels.argmax() == atlas.voxels[pose]
        by_half = locate(half, code.astype(np.float32), without=place_in_half.get(int(pose)))
        correct_by_half[done] = by_half.voxels.argmax() == atlas.voxels[pose]
        errors[done] = np.linalg.norm(place.position - atlas.positions[pose])
        progress(done + 1, len(chosen))
    voxels = atlas.voxels[chosen]
    effect = 1.0 + len(chosen) / poses

    def share(right: NDArray[np.bool_]) -> Interval:
        return (
            score_interval(float(right.mean()), len(right) / effect) if len(right) else Interval(math.nan, 0.0, 1.0)
        )

    return Reachable(
        accuracy=share(correct),
        by_voxel=[share(correct[voxels == v]) for v in range(atlas.grid.n_voxels)],
        error=median_of(errors, Effective(len(chosen) / effect)),
        count=len(chosen),
        gain=paired_difference(correct, correct_by_half),
    )


@dataclass(frozen=True)
class Limits:
    """Bounds on what can be known of an object at a pose.

    Attributes
    ----------
    presence : float
        Distance of its picture from the empty scene's, in standard deviations of the noise.
    position : ndarray of shape (3,)
        Least standard deviation along x, y and z, metres, with the rotation known.
    turned : ndarray of shape (3,)
        The same with the rotation unknown; infinite if a movement cannot be distinguished from a turn.
    rotation : ndarray of shape (3,)
        Least standard deviation of the turn about x, y and z, radians, with the position known.
    strength : float
        Least relative standard deviation of the albedo, with the pose known.
    movement : ndarray of shape (3,)
        Shortest movement along x, y and z, metres, that is noticed between two pictures.
    """

    presence: float
    position: Array
    turned: Array
    rotation: Array
    strength: float
    movement: Array


def limits(
    synthesis: Synthesis, position: Array, rotation: Array, *, false_alarm: float = 0.01, detection: float = 0.99
) -> Limits:
    """Return the bounds at a pose.

    Cramer and Rao: no unbiased estimate has a smaller covariance than the inverse of the Fisher information (Kay
    1993, theorem 3.2), which for a code of unit noise is the product of its derivatives. A movement is noticed if it
    shifts the difference of two pictures by the sum of two normal quantiles (Kay 1998, section 4.3).

    Parameters
    ----------
    synthesis : Synthesis
    position, rotation : array-like of shape (3,)
        Metres; degrees about x, then y, then z.
    false_alarm, detection : float
        Rates at which a movement counts as noticed.

    Raises
    ------
    NlosError
        If no object can be there, or the engine has no derivatives there.
    """
    if not (0.0 < false_alarm < 1.0 and false_alarm < detection < 1.0):
        raise NlosError(
            f"false alarms {false_alarm:g} and detections {detection:g}: must be 0 < false < detected < 1"
        )
    place, turn = np.asarray(position, float), np.asarray(rotation, float)
    slopes = synthesis.slopes(place, turn)
    information = slopes.T @ slopes
    quantiles = norm.isf(false_alarm) + norm.ppf(detection)
    slope_norms = np.sqrt(np.diag(information))
    with np.errstate(divide="ignore"):
        return Limits(
            presence=float(np.linalg.norm(synthesis.code(place, turn))),
            position=deviations(information[:3, :3]),
            turned=deviations(information[:6, :6])[:3],
            rotation=deviations(information[3:6, 3:6]),
            strength=float(1.0 / slope_norms[6]),
            movement=quantiles * math.sqrt(2.0) / slope_norms[:3],
        )


def deviations(information: Array) -> Array:
    """Return the least standard deviations that Fisher information (k, k) allows; infinite where it is zero."""
    scale = np.sqrt(np.diag(information))
    known = scale > 1e-9 * scale.max(initial=0.0)
    least = np.full(len(information), np.inf)
    if known.any():
        normalised = information[np.ix_(known, known)] / np.outer(scale[known], scale[known])
        eigenvalues, eigenvectors = np.linalg.eigh(normalised)
        shares = eigenvectors**2
        blind = eigenvalues < 1e-10  # nothing is known along these, nor about any parameter with a share in them
        variance = (shares[:, ~blind] / eigenvalues[~blind]).sum(axis=1)
        variance[(shares[:, blind] > 1e-9).any(axis=1)] = np.inf
        least[known] = np.sqrt(variance) / scale[known]
    return least


def in_centre(synthesis: Synthesis, voxel: int) -> Limits | None:
    """Return the bounds for the object, not rotated, in the centre of a voxel; None if none can be there."""
    try:
        return limits(synthesis, np.mean(synthesis.atlas.grid.bounds(voxel), axis=0), np.zeros(3))
    except NlosError:  # something stands in the way
        return None


def rows(atlas: Atlas, best: Reachable, synthesis: Synthesis | None = None) -> list[tuple[str, ...]]:
    """Return a table of the bounds: a row for each voxel, and one for all.

    Parameters
    ----------
    atlas : Atlas
    best : Reachable
    synthesis : Synthesis, optional
        Gives the bounds for the object, not rotated, in the centre of each voxel.
    """
    grid = atlas.grid
    table: list[tuple[str, ...]] = []
    for voxel, label in enumerate(grid.labels):
        if synthesis is None:
            table.append((label, best.by_voxel[voxel].percent()))
            continue
        if bounds := in_centre(synthesis, voxel):
            lengths = [*bounds.position, float(np.linalg.norm(bounds.turned))]
            cells = [f"{bounds.presence:.1f}", *map(_short, lengths), *map(_short, bounds.movement)]
        else:
            cells = ["-"] * 8
        table.append((label, best.by_voxel[voxel].percent(), *cells))
    return [*table, ("all", best.accuracy.percent(), *[""] * (8 if synthesis else 0))]


@dataclass(frozen=True)
class Map:
    """The bounds over a horizontal section of the hidden volume.

    Attributes
    ----------
    x, y : ndarray of shape (nx,) and (ny,)
        Coordinates, metres.
    presence, position, movement : ndarray of shape (ny, nx)
        As in `Limits`. Of the three directions, position has the root of the summed squares and movement the longest,
        metres. NaN where no object can be or the engine has no derivatives.
    """

    x: Array
    y: Array
    presence: Array
    position: Array
    movement: Array


def over_volume(
    synthesis: Synthesis, *, across: int = 16, progress: Callable[[int, int], None] = lambda done, total: None
) -> Map:
    """Return the bounds at half the volume's height, for an object that is not rotated.

    Parameters
    ----------
    synthesis : Synthesis
    across : int
        Number of points along x; along y they are as dense.
    progress : callable
        Called with (done, total), in points.

    Returns
    -------
    Map
        Coordinates of the points, and the bounds at each.
    """
    lo, hi = np.asarray(synthesis.atlas.grid.lo), np.asarray(synthesis.atlas.grid.hi)
    deep = max(2, round(across * (hi[1] - lo[1]) / (hi[0] - lo[0])))
    x, y = (a + (np.arange(n) + 0.5) / n * (b - a) for a, b, n in zip(lo[:2], hi[:2], (across, deep), strict=True))
    presence, position, movement = np.full((3, deep, across), np.nan)
    for row in range(deep):
        for column in range(across):
            place = np.array([x[column], y[row], 0.5 * (lo[2] + hi[2])])
            try:
                bounds = limits(synthesis, place, np.zeros(3))
            except NlosError:  # no bounds there: something stands in the way
                continue
            presence[row, column] = bounds.presence
            position[row, column] = float(np.linalg.norm(bounds.position))
            movement[row, column] = float(bounds.movement.max())
        progress((row + 1) * across, deep * across)
    return Map(x, y, presence, position, movement)


@figures.styled
def draw(path: Path, atlas: Atlas, found: Map) -> list[Path]:
    """Write a figure of the bounds over the hidden volume, seen from above; return the files.

    Lengths are capped at the volume's diagonal: an error as long as that says that the position is not known.
    """
    figure, [axes] = figures.subplots(1, 3, size=(figures.WIDTH, 4.0))
    lo, hi = np.asarray(atlas.grid.lo), np.asarray(atlas.grid.hi)
    most = 100.0 * float(np.linalg.norm(hi - lo))
    panels = (
        ("distance from the empty scene", "standard deviations", found.presence, math.inf, figures.SEQUENTIAL),
        ("least error of the position", "cm", 100.0 * found.position, most, f"{figures.SEQUENTIAL}_r"),
        ("least movement noticed", "cm, worst direction", 100.0 * found.movement, most, f"{figures.SEQUENTIAL}_r"),
    )
    height = 0.5 * (lo[2] + hi[2])
    for axis, (title, unit, values, cap, colours) in zip(axes, panels, strict=True):
        shown = np.where(np.isnan(values) | (values <= 0.0), np.nan, np.minimum(values, cap))
        image = axis.imshow(
            shown, origin="lower", extent=(lo[0], hi[0], lo[1], hi[1]), cmap=colours, norm=_log_norm(shown)
        )
        capped = bool((values > cap).any())
        bar = figure.colorbar(image, ax=axis, orientation="horizontal", extend="max" if capped else "neither")
        bar.set_label(f"{unit}; capped at the volume's diagonal, {cap:.3g}" if capped else unit)
        figures.plain_numbers(bar.ax.xaxis)
        axis.grid(visible=False)
        for voxel, label in enumerate(atlas.grid.labels):
            low, high = atlas.grid.bounds(voxel)
            if low[2] <= height < high[2]:  # of several layers, the one that is drawn
                axis.add_patch(
                    Rectangle((low[0], low[1]), *(high - low)[:2], fill=False, ec="white", lw=0.6, alpha=0.7)
                )
                figures.outlined(axis.text(*(0.5 * (low + high))[:2], label, ha="center", va="center", fontsize=10))
        axis.set_title(title)
        axis.set_xlabel("x, along the wall (m)")
    axes[0].set_ylabel("y, from the wall (m)")
    frames = atlas.sensor.frames
    words = f"{frames} frame{'s' if frames > 1 else ''}; object not turned, {height:.3g} m high"
    figure.suptitle(f"What a picture can tell at most: {words}")
    return figures.save(path, figure)


def _log_norm(values: Array) -> LogNorm:
    """Return a logarithmic scale of the values, and one of a decade if there are none or all are equal."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (1.0, 10.0)
    return LogNorm(low, high if high > low else 10.0 * low)


def _short(length: float) -> str:
    """Length in centimetres, with three significant digits."""
    return f"{100.0 * length:.3g}" if math.isfinite(length) else "unknown"
