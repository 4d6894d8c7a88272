"""Takes a camera's frames into a data set: what they show, in W/m^2/sr, on the wall's rectangle, with their noise.

The steps, in this order: a gamma undone; black level or dark frames subtracted; flat field divided out; saturated and
hot pixels left out; colours weighted; lens and perspective undone and pixels averaged by areas
(`classify.pictures.rectify`); exposures brought to one; brightness brought to that of the scene by the pictures of
the empty scene; noise from the electrons a grey level, or measured between frames of the same scene.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix

from classify.pictures import frames, rectify
from classify.pictures.frames import Frame
from classify.pictures.recipe import FILE, Recipe, check_gamma, linear, size_words, without
from classify.pictures.sensor import Sensor, level_between, nearest
from generator.files.pictures import Picture
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.poses import PoseRecord
from generator.sets.description import Description
from generator.sets.measured import MEASURED, MeasuredSet, record_of

_HOT = 10.0
"""Robust standard deviations, of dark frames or from the median of its neighbours, from which on a pixel is hot."""
_MOST_HOT = 0.01
"""Share of hot pixels from which on they are structure, and nothing is left out."""
_PLATEAU, _PILED = 10.0, 20
"""A largest value is where values are clipped if so many times as many pixels have it as those below, and so many."""
_CURVED, _BENT = 3.0, 0.1
"""A gamma is seen if undoing it makes the empty scene so many times as like the scene's, and it is so far from 1."""
_SAME_SHAPE = 0.02
_AS_STATED = 0.7
"""Ratio of variances from which on noise is not what it was stated to be."""
_FALLING = 3.0
"""Standard deviations by which noise must fall with light to be that of values through a gamma."""
_FEWEST = 10
"""Pixels from whose noise that of a camera may follow."""
_SURE, _APART = 4.0, 1e6
"""Standard deviations from which on there is readout noise, and condition up to which it is told from photons."""


@dataclass(frozen=True, kw_only=True)
class Treatment:
    """How frames are treated.

    Attributes
    ----------
    black : float or None
        Black level, in units of the file; None takes the one that the file states, or else 0.
    white : float or None
        Value from which on a pixel is saturated; None takes the largest of the format.
    gamma : str or None
        Transfer curve to undo (`classify.pictures.recipe.linear`); None takes values as linear and refuses files that
        state one.
    weights : (float, float, float)
        Of red, green and blue in grey; they sum to 1.
    saturated : str
        ``refuse`` frames with saturated pixels on the patch, or ``mask``: leave these pixels out in all frames.
    burst : int
        Frames averaged for a picture, one after the other.
    electrons : float or None
        Electrons per unit of the file (1 / K of EMVA 1288), to know the noise; None measures it between frames.
    read_noise : float
        Standard deviation of a readout, electrons; only with ``electrons``.
    level : float or None
        W/m^2/sr per unit of light; None compares the empty scene with the scene's own picture of it.
    """

    black: float | None = None
    white: float | None = None
    gamma: str | None = None
    weights: tuple[float, float, float] = (1 / 3, 1 / 3, 1 / 3)
    saturated: Literal["refuse", "mask"] = "refuse"
    burst: int = 1
    electrons: float | None = None
    read_noise: float = 0.0
    level: float | None = None

    def __post_init__(self) -> None:
        for name, least in (("white", 0.0), ("electrons", 0.0), ("level", 0.0)):
            value = getattr(self, name)
            if value is not None and not least < value < math.inf:
                raise NlosError(f"--{name} {value:g}: must be positive")
        if self.black is not None and not math.isfinite(self.black):
            raise NlosError(f"--black {self.black:g}: must be a number")
        if not 0.0 <= self.read_noise < math.inf:
            raise NlosError(f"--read-noise {self.read_noise:g}: must not be negative")
        if self.burst < 1:
            raise NlosError(f"--burst {self.burst}: must be 1 or more")
        if not (all(w >= 0.0 for w in self.weights) and 0.0 < sum(self.weights) < math.inf):
            raise NlosError(f"--weights {self.weights}: must not be negative, and one of them positive")
        if self.gamma is not None:
            check_gamma(self.gamma)


@dataclass(frozen=True, kw_only=True)
class Sources:
    """Files of a camera.

    Attributes
    ----------
    pictures, background, dark, flat : sequence of Path
        Files, or folders of files: with and without the hidden object, without light, and of an evenly lit surface.
    labels : Path, optional
        Table of the pictures: ``file``, and ``label``, ``x``, ``y``, ``z``, ``rx``, ``ry``, ``rz`` where known, and
        ``exposure``.
    mask : Path, optional
        Picture whose pixels of value 0 are left out.
    """

    pictures: Sequence[Path]
    background: Sequence[Path] = ()
    dark: Sequence[Path] = ()
    flat: Sequence[Path] = ()
    labels: Path | None = None
    mask: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Where the watched rectangle of wall lies in the frames.

    Attributes
    ----------
    x, z : (float, float)
        Extent of the watched rectangle, metres.
    resolution : (int, int)
        Width and height of the pictures to be made.
    marks : Marks, optional
        Points of the frames and of the wall; without them, a frame shows exactly the rectangle.
    """

    x: tuple[float, float]
    z: tuple[float, float]
    resolution: tuple[int, int]
    marks: rectify.Marks | None = None


@dataclass
class Imported:
    """What was made.

    Attributes
    ----------
    dataset : MeasuredSet
    notes : list of str
        What was found and done, in sentences, as far as it may matter.
    level : float
        W/m^2/sr per unit of light.
    mismatch : float
        Relative root mean square by which the empty scene differs in shape from the scene's own; NaN if unknown.
    """

    dataset: MeasuredSet
    notes: list[str]
    level: float
    mismatch: float


def run(
    sources: Sources,
    treatment: Treatment,
    geometry: Geometry,
    description: Description | None,
    output: Path,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Imported:
    """Import frames into a new data set.

    Parameters
    ----------
    sources : Sources
    treatment : Treatment
    geometry : Geometry
    description : Description, optional
        The scene; without one, the set has no voxels, and no level.
    output : Path
        Folder of the set: new or empty.
    progress : callable
        Called with (done, total), in files.

    Raises
    ------
    NlosError
        A file is broken or does not fit the others, saturated, or through a gamma; the geometry is wrong; the set
        cannot be written.
    """
    work = _Work(sources, treatment, geometry, description)
    work.find_recipe()
    grid = None if description is None or "grid" not in description.scene else _grid(description)
    listed = _labels(sources, work.files, grid)
    found: list[list[str]] = []

    def pictures() -> Iterator[tuple[PoseRecord, Picture]]:
        for number, (files, group) in enumerate(work.groups(lambda done: progress(done, len(work.files)))):
            record = _record([listed[path] for path in files], number, grid)
            found.append([frame.name for frame in group])
            yield record, work.recipe(group)

    background = None if work.background is None else work.recipe.picture(work.background)
    table = work.table()
    meta: dict[str, Any] = {
        MEASURED: {**table, "sources": found},
        **({} if description is None else description.manifest),
        **({} if work.recipe.sensor is None else {"sensor": asdict(work.recipe.sensor)}),
        "software": _software(),
    }
    dataset = MeasuredSet.create(output, meta, pictures(), background, {FILE: work.recipe.save})
    return Imported(dataset, work.notes, work.level, work.mismatch)


def _software() -> dict[str, str]:
    versions = {"opencv": cv2.__version__, "numpy": np.__version__}
    try:
        return {"nlos-lab": metadata.version("nlos-lab"), **versions}
    except metadata.PackageNotFoundError:
        return versions


def _grid(description: Description) -> VoxelGrid:
    from generator.files.toml import from_dict

    grid: VoxelGrid = from_dict(VoxelGrid, description.scene["grid"], "scene.grid.")
    return grid


@dataclass
class _Work:
    """Finds out from the files how frames are to be treated; `find_recipe` fills the rest."""

    sources: Sources
    treatment: Treatment
    geometry: Geometry
    description: Description | None
    notes: list[str] = field(default_factory=list)
    level: float = 1.0
    mismatch: float = math.nan
    background: Array | None = None
    masked: int = 0
    hot: int = 0

    def __post_init__(self) -> None:
        self.files = frames.expand(self.sources.pictures)
        self._first = next(iter(frames.read(self.files[0])))
        self.shape = self._first.values.shape
        self._gamma = self._transfer()
        limit = self._first.white if self.treatment.white is None else self.treatment.white
        self.white = limit
        if self._gamma and not math.isfinite(limit):
            raise NlosError("--gamma: needs --white for floats, the value that stands for 1")
        self.exposures = _exposures(self.sources.labels)

    def _transfer(self) -> str:
        frame, chosen = self._first, self.treatment.gamma
        if chosen is not None:
            return check_gamma(chosen)
        if frame.gamma:
            undo = frame.gamma if frame.gamma == "srgb" or frame.gamma[0].isdigit() else "srgb, or 2.2,"
            raise NlosError(
                f"{frame.name}: states that its values went through a gamma ({frame.gamma}), so they are not in "
                f"proportion to light; undo it with --gamma {undo} or say --gamma 1 if it states what is wrong"
            )
        if frame.lossy:
            raise NlosError(
                f"{frame.name}: most videos are through a gamma; say --gamma srgb, a number, or 1 if it is linear"
            )
        return ""

    def find_recipe(self) -> None:
        """Find dark and flat field, masks, weights, level and noise."""
        self._refuse_clipped(self._first)
        height, width, channels = self.shape
        dark, self.dark_frames = self._mean(self.sources.dark)
        black = self._first.black if self.treatment.black is None else self.treatment.black
        if dark is None:
            dark = np.full(self.shape, float(linear(np.array(black), self._gamma, self.white)))
            if self.treatment.black is None and not black and math.isfinite(self._first.white):
                self.notes.append("no black level is known, so 0 counts as dark; state it with --black or --dark")
        elif self.treatment.black is not None:
            raise NlosError("--black and --dark: exclude each other; dark frames hold the black level")
        self.black = float(np.median(dark))
        empty, self.empty_frames = self._mean(self.sources.background)
        flat, self.flat_frames = self._mean(self.sources.flat)
        masked = self._masked(dark, empty)
        marks = self.geometry.marks or rectify.whole((height, width), self.geometry.x, self.geometry.z)
        resolution = self.geometry.resolution
        weights = rectify.areas((height, width), marks, self.geometry.x, self.geometry.z, resolution)
        self.masked = int(masked.ravel()[np.unique(weights.indices)].sum())
        weights = without(weights, masked, resolution)
        even = self._even(flat, dark, weights)
        matrix = self._coloured(weights, even)
        plain = Recipe(
            shape=(height, width, channels),
            resolution=resolution,
            matrix=matrix,
            offset=matrix @ dark.ravel(),
            gamma=self._gamma,
            white=self.white,
            exposure=self._of(self.files[0], self._first).exposure,
        )
        if self.treatment.saturated == "mask":
            plain = self._unsaturated(plain, weights, masked, even, dark)
        self.recipe = plain
        looks = [plain.light(frame) for frame in self._checked(plain, self.sources.background)]
        if looks:
            self.background = np.mean(looks, axis=0)
            self._refuse_gamma(self.background)
        self._find_level()
        self.recipe = plain.scaled(self.level, None)
        looks = [look * self.level for look in looks]
        self.background = None if self.background is None else self.background * self.level
        self.recipe = self.recipe.scaled(1.0, self._noise(even, looks))

    def groups(self, done: Callable[[int], None]) -> Iterator[tuple[list[Path], list[Frame]]]:
        """Yield the files and the frames of each picture."""
        paths: list[Path] = []
        group: list[Frame] = []
        for number, path in enumerate(self.files):
            for frame in frames.read(path):
                paths.append(path)
                group.append(self._of(path, frame))
                if len(group) == self.treatment.burst:
                    yield paths, group
                    paths, group = [], []
            done(number + 1)
        if group:
            raise NlosError(
                f"--burst {self.treatment.burst}: the frames do not make whole bursts; {len(group)} are left over"
            )

    def table(self) -> dict[str, Any]:
        """Return the table ``measured`` of the manifest."""
        weights = self.recipe.matrix
        table: dict[str, Any] = {
            "noise": True,
            "files": [FILE],
            "frames": self.treatment.burst,
            "background_frames": self.empty_frames,
            "dark_frames": self.dark_frames,
            "flat_frames": self.flat_frames,
            "black": self.black,
            "gamma": self._gamma or "none",
            "weights": [w / sum(self.treatment.weights) for w in self.treatment.weights],
            "saturated": self.treatment.saturated,
            "masked_pixels": self.masked,
            "hot_pixels": self.hot,
            "camera_pixels": round(weights.nnz / weights.shape[0] / self.shape[2], 2),
            "level": self.level,
            "notes": self.notes,
        }
        if math.isfinite(self.white):
            table["white"] = self.white
        if math.isfinite(self.mismatch):
            table["mismatch"] = self.mismatch
        if (marks := self.geometry.marks) is not None:
            table["marks"] = np.column_stack([marks.pixels, marks.wall]).tolist()
            table["marks_residual"] = float(marks.found.get("residual", 0.0))
            if marks.lens is not None:
                table["camera_matrix"] = marks.lens.matrix.tolist()
                table["distortion"] = marks.lens.distortion.tolist()
        return table

    def _of(self, path: Path, frame: Frame) -> Frame:
        """Return a frame with the exposure that the table of labels states for its file, if it does."""
        given = self.exposures.get(path.name, 0.0)
        return replace(frame, exposure=given) if given else frame

    def _all(self, paths: Sequence[Path]) -> Iterator[Frame]:
        for path in frames.expand(paths):
            for frame in frames.read(path):
                if frame.values.shape != self.shape:
                    have, want = size_words(frame.values.shape), size_words(self.shape)
                    raise NlosError(f"{path}: has {have}, and the pictures {want}")
                yield self._of(path, frame)

    def _checked(self, recipe: Recipe, paths: Sequence[Path]) -> Iterator[Frame]:
        for frame in self._all(paths):
            recipe.check(frame)
            yield frame

    def _mean(self, paths: Sequence[Path]) -> tuple[Array | None, int]:
        """Mean of frames, as light, and their number."""
        total, count = np.zeros(self.shape), 0
        for frame in self._all(paths):
            total += linear(frame.values, self._gamma, self.white)
            count += 1
        return (total / count, count) if count else (None, 0)

    def _refuse_clipped(self, frame: Frame) -> None:
        """Raise NlosError if values pile up below the largest of the format: then another is the limit."""
        if self.treatment.white is not None or frame.values.dtype.kind == "f":
            return
        top = int(frame.values.max())
        below = [int((frame.values == top - k).sum()) for k in range(1, 6)]
        piled = int((frame.values == top).sum())
        if 0 < top < frame.white and piled > max(_PILED, _PLATEAU * (1.0 + max(below))):
            raise NlosError(
                f"{frame.name}: {piled} values are exactly {top}, as if the camera clipped there; say --white {top}, "
                f"or --white {frame.white:g} if that is not so"
            )

    def _masked(self, dark: Array, empty: Array | None) -> NDArray[np.bool_]:
        """Pixels of the camera that are left out: hot, or in the mask."""
        masked = np.zeros(self.shape[:2], dtype=bool)
        if self.sources.mask is not None:
            mask = next(iter(frames.read(self.sources.mask))).values
            if mask.shape[:2] != self.shape[:2]:
                raise NlosError(f"{self.sources.mask}: has another size than the pictures")
            masked |= (mask == 0).all(axis=2)
        off = None
        if self.dark_frames:
            off = dark - np.median(dark)
        elif empty is not None:
            grey = empty.astype(np.float32)
            off = grey - np.stack(
                [cv2.medianBlur(np.ascontiguousarray(grey[..., c]), 3) for c in range(self.shape[2])], axis=-1
            )
        if off is not None:
            spread = 1.4826 * float(np.median(np.abs(off)))
            hot = (np.abs(off) > _HOT * max(spread, 1e-12)).any(axis=2) if spread else np.zeros_like(masked)
            if hot.mean() > _MOST_HOT:
                self.notes.append(f"{hot.mean():.1%} of the pixels look hot, which is structure; none is left out")
            else:
                self.hot = int(hot.sum())
                masked |= hot
        return masked

    def _even(self, flat: Array | None, dark: Array, weights: csr_matrix) -> Array:
        """Relative response of each pixel and channel, (height, width, channels), with a mean of 1 on the patch."""
        if flat is None:
            return np.ones(self.shape)
        used = np.unique(weights.indices)
        response = (flat - dark).reshape(-1, self.shape[2])
        if (response[used] <= 0.0).any():
            raise NlosError("--flat: has pixels on the patch that are no brighter than dark ones; expose it longer")
        even = np.ones_like(response)
        even[used] = response[used] / response[used].mean(axis=0)
        return even.reshape(self.shape)

    def _coloured(self, weights: csr_matrix, even: Array) -> csr_matrix:
        """Weights of areas, with those of colours and the flat field: a column for each value of a frame."""
        channels = self.shape[2]
        given = np.array(self.treatment.weights) / sum(self.treatment.weights)
        colours = given if channels == 3 else np.ones(1)
        rows = np.repeat(np.arange(weights.shape[0]), np.diff(weights.indptr))
        columns = (weights.indices[:, None].astype(np.int64) * channels + np.arange(channels)).ravel()
        data = (weights.data[:, None] * colours).ravel() / even.ravel()[columns]
        shape = (weights.shape[0], weights.shape[1] * channels)
        made = coo_matrix((data, (np.repeat(rows, channels), columns)), shape=shape).tocsr()
        made.eliminate_zeros()
        return made

    def _unsaturated(
        self, plain: Recipe, weights: csr_matrix, masked: NDArray[np.bool_], even: Array, dark: Array
    ) -> Recipe:
        """Leave out pixels that are saturated in any frame."""
        full: set[int] = set()
        for frame in self._all([*self.sources.pictures, *self.sources.background]):
            full.update((plain.saturated(frame.values) // self.shape[2]).tolist())
        if not full:
            return plain
        masked = masked.copy()
        masked.ravel()[list(full)] = True
        self.masked += len(full)
        self.notes.append(f"{len(full)} saturated pixels of the camera are left out in all frames")
        matrix = self._coloured(without(weights, masked, self.geometry.resolution), even)
        return replace(plain, matrix=matrix, offset=matrix @ dark.ravel())

    def _model_background(self) -> Array | None:
        if self.description is None or self.description.background is None:
            return None
        wanted = self.description.background.mean(axis=2, dtype=np.float64)
        width, height = self.geometry.resolution
        if wanted.shape[0] < height or wanted.shape[1] < width:
            return None
        smaller = cv2.resize(wanted, (width, height), interpolation=cv2.INTER_AREA)
        return np.asarray(smaller, dtype=np.float64)

    def _refuse_gamma(self, empty: Array) -> None:
        """Raise NlosError if the empty scene is like that of the model only after a gamma is undone."""
        wanted = self._model_background()
        if wanted is None or empty.min() <= 0.0:
            return
        powers = np.exp(np.linspace(math.log(0.3), math.log(3.5), 121))
        relative = empty / empty.max()
        misses = [nearest(relative**power, wanted.ravel())[1] for power in powers]
        best, plain = int(np.argmin(misses)), nearest(relative, wanted.ravel())[1]
        bent = abs(math.log(powers[best])) > _BENT
        if plain > _SAME_SHAPE and bent and plain > _CURVED * misses[best] and self.treatment.gamma is None:
            raise NlosError(
                f"the empty scene differs from that of the model by {plain:.1%} in shape, and by {misses[best]:.1%} "
                f"if a gamma of {powers[best]:.2f} is undone: values seem not to be in proportion to light; say "
                f"--gamma {powers[best]:.2f} (or srgb), or --gamma 1 if they are"
            )

    def _find_level(self) -> None:
        """Find the factor from light to W/m^2/sr."""
        wanted = self._model_background()
        if self.background is not None and wanted is not None:
            own = self.background.reshape(wanted.shape)
            self.level, self.mismatch = nearest(own, wanted)
            if level_between(own, wanted)[1]:
                self.notes.append(
                    f"the empty scene differs from that of the model by {self.mismatch:.1%} in shape: room, lamp, "
                    "view or the camera's correction are others"
                )
        if self.treatment.level is not None:
            self.level = self.treatment.level
        elif math.isnan(self.mismatch):
            self.notes.append(
                "brightness is in units of the file, since there is no picture of the empty scene, or none of the "
                "model, to compare; state --level if it is known"
            )
        if not 0.0 < self.level < math.inf:
            raise NlosError("the pictures of the empty scene hold no light; correct --black or --dark")

    def _noise(self, even: Array, looks: Sequence[Array]) -> Sensor | None:
        """The camera as pixels of a picture see it."""
        squared = self.recipe.matrix.multiply(self.recipe.matrix)
        # What light over electrons a unit, and the readout's variance in units squared, add to a pixel's variance.
        photons = squared @ even.ravel() / self.level
        readout = np.asarray(squared.sum(axis=1)).ravel()
        measured = _between(photons, readout, looks, *self._bursts())
        rounding = 1.0 / 12.0 if self._first.values.dtype.kind == "u" else 0.0
        if self.treatment.electrons is not None:
            electrons = self.treatment.electrons
            unit = (self.treatment.read_noise / electrons) ** 2 + rounding
            if measured is not None and self.background is not None:
                light = float((self.background * photons).mean())
                stated = light / electrons + unit * float(readout.mean())
                ratio = (light / measured[0] + measured[1] * float(readout.mean())) / stated
                if not _AS_STATED < ratio < 1.0 / _AS_STATED:
                    self.notes.append(
                        f"between frames, the noise has {ratio:.2f} times the variance that was stated: other "
                        "--electrons, a lamp that moves, or values that are not in proportion to light"
                    )
        elif measured is None:
            self.notes.append(
                "the noise is not known, so locate and track cannot weigh these pictures; state --electrons a grey "
                "level or --sensor, or give several frames of the empty scene"
            )
            return None
        else:
            electrons, unit, slope = measured
            if slope < -_FALLING:
                raise NlosError(
                    "noise falls where there is more light, as of values through a gamma; undo it with --gamma, or "
                    "say --electrons if the camera is linear"
                )
            self.notes.append(
                f"between frames, the noise is that of {electrons:.3g} electrons a unit, and a read noise of "
                f"{math.sqrt(max(unit - rounding, 0.0)) * electrons:.3g}"
            )
        exposure = electrons / float(photons.mean())
        well = (self.white - self.black) * self.level * exposure
        return Sensor(
            full_well=well if 0.0 < well < 1e15 else 1e15,
            read_noise=math.sqrt(float(readout.mean()) * max(unit, rounding)) * exposure,
            bits=0,
            exposure=exposure,
            frames=self.treatment.burst,
            background_frames=max(1, self.empty_frames),
        )

    def _bursts(self) -> list[list[Array]]:
        if self.treatment.burst < 2:
            return []
        groups = []
        for _, group in self.groups(lambda done: None):
            groups.append([self.recipe.light(frame) for frame in group])
            if len(groups) == 20:
                break
        return groups


def _between(photons: Array, readout: Array, *groups: Sequence[Array]) -> tuple[float, float, float] | None:
    """Electrons a unit and variance of the readout in units squared, from frames of still scenes (photon transfer).

    The last of the three is by how many standard deviations noise grows with light. A lamp that flickers changes all
    pixels alike, which does not count.

    Parameters
    ----------
    photons, readout : ndarray of shape (pixels,)
        What light over electrons a unit, and the variance of the readout, are multiplied with in a variance.
    *groups : sequence of ndarray of shape (pixels,)
        Frames of a scene, W/m^2/sr.
    """
    means, variances, freedom = [], [], 0
    for looks in groups:
        if len(looks) < 2:
            continue
        stack = np.array(looks)
        mean = stack.mean(axis=0)
        steady = stack / (stack @ mean / (mean @ mean))[:, None]
        means.append(mean)
        variances.append(steady.var(axis=0, ddof=1))
        freedom += len(looks) - 1
    if not means:
        return None
    light, variance = np.concatenate(means), np.concatenate(variances)
    some = (light > 0.0) & (variance > 0.0)
    if some.sum() < _FEWEST:
        return None
    shot, fixed = (np.tile(factor, len(means))[some] for factor in (photons, readout))
    light, variance = light[some], variance[some]
    relative = math.sqrt(2.0 * len(means) / freedom)
    apart = np.log(light) - np.log(light).mean()
    slope = float(apart @ np.log(variance / shot)) / relative / math.sqrt(max(float(apart @ apart), 1e-300))
    inverse, left = float((variance / (shot * light)).mean()), 0.0
    # Least squares, each variance with its own uncertainty; readout counts only if it is there beyond doubt.
    weights = 1.0 / (relative * inverse * shot * light)
    columns = np.column_stack([shot * light, fixed]) * weights[:, None]
    columns = columns / (lengths := np.linalg.norm(columns, axis=0))
    normal = columns.T @ columns
    if np.linalg.cond(normal) < _APART:
        fitted = np.linalg.solve(normal, columns.T @ (variance * weights))
        if fitted[0] > 0.0 and fitted[1] > _SURE * math.sqrt(float(np.linalg.inv(normal)[1, 1])):
            inverse, left = map(float, fitted / lengths)
    return 1.0 / inverse, left, slope


def read_table(path: Path) -> list[dict[str, str]]:
    """Read a table, comma-separated, with a line of headings.

    Raises
    ------
    NlosError
        It cannot be read, or is no such table.
    """
    try:
        if path.stat().st_size > 2**26:
            raise NlosError(f"{path}: is larger than a table of pictures")
        with path.open(newline="", encoding="utf-8-sig") as file:
            return [{str(k): v or "" for k, v in row.items()} for row in csv.DictReader(file)]
    except OSError as error:
        raise NlosError(f"{path}: cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise NlosError(f"{path}: is not a CSV file ({error})") from None


def _exposures(path: Path | None) -> dict[str, float]:
    """Exposures by file name that a table of labels states."""
    found: dict[str, float] = {}
    for line, row in enumerate(read_table(path) if path else [], start=2):
        if text := row.get("exposure", "").strip():
            try:
                value = float(text)
            except ValueError:
                value = 0.0
            if not 0.0 < value < math.inf:
                raise NlosError(f"{path}, line {line}: exposure {text!r} must be a positive number")
            found[Path(row.get("file", "")).name] = value
    return found


_KNOWN = ("file", "label", "x", "y", "z", "rx", "ry", "rz", "exposure")


def _labels(sources: Sources, files: Sequence[Path], grid: VoxelGrid | None) -> dict[Path, Mapping[str, str]]:
    """What is known of each file: the rows of a table, or else labels from the names of folders."""
    if sources.labels is None:
        names = {path.parent.name for path in files}
        in_folders = grid is not None and names <= set(grid.labels)
        return {path: {"label": path.parent.name} if in_folders else {} for path in files}
    rows: dict[str, Mapping[str, str]] = {}
    for line, row in enumerate(read_table(sources.labels), start=2):
        unknown = [name for name in row if name not in _KNOWN]
        if unknown or "file" not in row:
            raise NlosError(f"{sources.labels}: its columns must be file and some of {', '.join(_KNOWN[1:])}")
        name = row["file"].strip()
        if name in rows:
            raise NlosError(f"{sources.labels}, line {line}: names {name} a second time")
        rows[name] = row
    found: dict[Path, Mapping[str, str]] = {}
    for path in files:
        match = [name for name in rows if name and f"/{path.as_posix()}".endswith(f"/{name}")]
        if not match:
            raise NlosError(f"{sources.labels}: has no row for {path}")
        found[path] = rows[max(match, key=len)]
    used = {row.get("file", "").strip() for row in found.values()}
    if left := sorted(set(rows) - used):
        raise NlosError(f"{sources.labels}: names {left[0]}, which is none of the pictures")
    return found


def _record(rows: Iterable[Mapping[str, str]], number: int, grid: VoxelGrid | None) -> PoseRecord:
    """The record of a picture, from what is known of its files."""
    told = [{name: row.get(name, "") for name in _KNOWN[1:-1]} for row in rows]
    if any(row != told[0] for row in told):
        raise NlosError(f"picture {number + 1}: its burst is of files with different labels; correct --burst")
    record = record_of({**told[0], "file": f"pictures/{number:05d}.exr"}, number, grid)
    return replace(record, file=f"{record.label}/{number:05d}.exr") if record.label else record
