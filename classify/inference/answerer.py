"""One answer after another about clean pictures, such as the live look's: by a trained model, or by an atlas.

What is asked is what the answer would be about a picture that was taken, so a clean picture is first measured as the
pictures were that the model was trained on, or that the atlas is made for. A model of clean pictures gets it clean.
The noise is that of one seed, the same for every picture: answers follow from the picture alone. Noise of rendering,
which a model's pictures may have had, is not added, since it is not known pixel by pixel: that is said.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

import cv2
import h5py
import numpy as np

from classify.classifiers import models
from classify.inference import atlas_file
from classify.inference.atlas import Atlas
from classify.inference.evaluation import doubts
from classify.inference.misfit import Misfits, doubt_of_backgrounds
from classify.inference.posterior import Place, locate
from classify.pictures.sensor import Sensor, factor_between, level_between
from generator.files.pictures import Picture
from generator.files.toml import from_dict
from generator.model.arrays import Array
from generator.model.engines import ENGINES
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.sets.readable import check_colours

_SEED = 0
_Measured = tuple[dict[str, float], Place | None, float | None]
_ROUNDED = 0.5
"""Pixels by which the height of a picture of the same shape may differ, since it is a whole number."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """The scene that pictures are of.

    Attributes
    ----------
    background : ndarray of shape (height, width, 3)
        Clean picture without the target, W/m^2/sr.
    grid : VoxelGrid
    target : str
        Kind of the target: sheet, sphere or mesh.
    colour_space : str
        Linear colour space of the channels.
    """

    background: Picture
    grid: VoxelGrid
    target: str
    colour_space: str


@dataclass(frozen=True)
class Answered:
    """An answer.

    Attributes
    ----------
    probability : dict of str to float
        Probability of each voxel, by label.
    place : Place or None
        Position, from an atlas.
    misfit : float or None
        Probability that a picture which is what the model is made for fits as badly; None if that is not known.
    picture, background : ndarray of shape (height, width, 3), float32
        What was answered: as measured, W/m^2/sr.
    """

    probability: dict[str, float]
    place: Place | None
    misfit: float | None
    picture: Picture
    background: Picture


class Answerer(ABC):
    """Answers about pictures of one scene.

    Parameters
    ----------
    path : Path
        Its file, for messages.
    grid : VoxelGrid
    background : ndarray of shape (height, width)
        Empty scene that it is made for, W/m^2/sr.
    colour_space : str
    sensor : Sensor or None
        With its exposure; None if it is made for clean pictures.

    Attributes
    ----------
    doubts : list of str
        What speaks against answers about the scene of `look_at`, in sentences.
    """

    what = ""
    """What it is, in words."""

    def __init__(
        self, path: Path, grid: VoxelGrid, background: Array, colour_space: str, sensor: Sensor | None
    ) -> None:
        self.doubts: list[str] = []
        self._path, self._grid, self._empty = path, grid, background
        self._colour_space, self._sensor = colour_space, sensor
        self._clean: Picture = np.zeros((0, 0, 3), dtype=np.float32)
        self._background = self._clean
        self._level = 1.0

    @property
    def words(self) -> str:
        """What answers, and by which pictures, in a sentence."""
        return f"{self._path.name} ({self.what}) answers by {_sensor_words(self._sensor)}"

    def look_at(self, seen: Seen) -> None:
        """Take a scene for the following pictures.

        Raises
        ------
        NlosError
            It has other voxels, another colour space, or pictures that cannot be brought to the right size.
        """
        if seen.grid.shape != self._grid.shape or not self._grid.covers_same(seen.grid):
            raise NlosError(
                f"{self._path.name}: has other voxels than this scene; choose another, made for this scene"
            )
        check_colours(Path("the look"), seen.colour_space, self._colour_space, str(self._path.name))
        self._clean = self._resized(seen.background)
        grey = self._clean.mean(axis=2, dtype=np.float64)
        level, mismatch = self._difference(grey)
        self._level = self._taken_level(level)
        self.doubts = self._doubts(seen.target, level, mismatch)
        self._background = self._measured(self._clean, 0, background=True)

    def answer(self, difference: Picture) -> Answered:
        """Answer a picture, given as the change due to the target, (height, width, 3), W/m^2/sr.

        Raises
        ------
        NlosError
            The picture cannot be brought to the right size, or the model does not answer.
        """
        picture = self._measured(self._clean + self._resized(difference), 1)
        return Answered(*self.measured_answer(picture, self._background), picture, self._background)

    def _resized(self, picture: Picture) -> Picture:
        """Average a picture down to the size that it is made for: what a larger pixel collects."""
        (height, width), (own_height, own_width) = self._empty.shape, picture.shape[:2]
        if own_width < width or abs(own_height - own_width * height / width) > _ROUNDED:
            raise NlosError(
                f"{self._path.name}: is of {width} x {height} pixels, and the look has {own_width} x {own_height}; "
                f"set the look to {width} pixels or more, of the same shape"
            )
        light = np.asarray(picture, dtype=np.float32)
        if own_width == width:
            return light
        smaller: Picture = np.asarray(cv2.resize(light, (width, height), interpolation=cv2.INTER_AREA), np.float32)
        return smaller.reshape(height, width, 3)

    def _measured(self, clean: Picture, stream: int, *, background: bool = False) -> Picture:
        if self._sensor is None:
            return clean
        rng = np.random.default_rng([_SEED, stream])
        frames = self._sensor.background_frames if background else self._sensor.frames
        return self._sensor.measure(clean * np.float32(self._level), rng, frames=frames, pattern=_SEED)

    def _difference(self, empty: Array) -> tuple[float, float]:
        """Return in level and shape how an empty scene differs from the one that it is made for (`level_between`)."""
        return level_between(empty, self._empty)

    def _taken_level(self, level: float) -> float:
        """Return the factor on the exposure."""
        return 1.0

    @abstractmethod
    def measured_answer(self, picture: Picture, background: Picture) -> _Measured:
        """Return the probability of each voxel, the place from an atlas, and the misfit, for a measured picture."""

    @abstractmethod
    def _doubts(self, target: str, level: float, mismatch: float) -> list[str]:
        """Return what speaks against answers about a scene."""


class ByModel(Answerer):
    """Answers of a trained model, as ``nlos-classify predict`` gives them."""

    def __init__(self, path: Path, model: models.Model) -> None:
        self._model = model
        if any("+" in str(label) for label in model.estimator.classes_):
            raise NlosError(f"{path.name}: tells the voxels of several objects, and the look shows one")
        self.what = str(model.about.get("classifier", "model"))
        provenance = model.about.get("provenance")
        taken = provenance.get("sensor") if isinstance(provenance, dict) else None
        sensor = from_dict(Sensor, taken, f"{path.name}: sensor.") if taken else None
        if sensor is not None and not sensor.exposure:
            raise NlosError(f"{path.name}: does not tell the exposure of the sensor that it was trained on")
        background = model.background.mean(axis=2, dtype=np.float64)
        super().__init__(path, model.grid, background, model.colour_space, sensor)

    def measured_answer(self, picture: Picture, background: Picture) -> _Measured:
        """Return the probability of each voxel, no place, and the misfit."""
        probability, misfit = self._model.judged(picture, background=background, name="the look")
        return probability, None, misfit

    def _doubts(self, target: str, level: float, mismatch: float) -> list[str]:
        trained = str(self._model.about.get("target", ""))
        sentences = models.doubts(self._model, self._clean)
        if level != 1.0:
            sentences.append(
                f"the empty scene is {1.0 / level:.3g} times as bright as that of the training, which is made up for"
            )
        if noise := self._rendering_noise():
            sentences.append(noise)
        if target != trained:
            sentences.append(f"it was trained on a {trained}, and the look is of a {target}")
        return sentences

    def _rendering_noise(self) -> str:
        """Return what is to be said of the noise that its pictures had from rendering; empty if they had none."""
        provenance = self._model.about.get("provenance")
        sweep = provenance.get("sweep") if isinstance(provenance, dict) else None
        engine = str(sweep.get("engine", "")) if isinstance(sweep, dict) else ""
        if not isinstance(sweep, dict) or engine not in ENGINES or not ENGINES[engine].noisy:
            return ""
        by = f"{sweep['samples']} samples of {engine!r}" if sweep.get("samples") else repr(engine)
        return (
            f"it learnt from pictures with the noise of rendering, {by}, which the look's do not have: its "
            "probabilities are those of a rendered picture only if that noise is far below the object's light; "
            "Render Wall and Where Is It? ask about such a picture"
        )


class ByAtlas(Answerer):
    """Answers of an atlas, as ``nlos-classify locate`` gives them: if there is an object."""

    what = "atlas"

    def __init__(self, path: Path, atlas: Atlas) -> None:
        self._atlas, self._misfits = atlas, Misfits(atlas)
        self._given: tuple[Picture, Atlas] | None = None
        super().__init__(path, atlas.grid, atlas.background, atlas.colour_space, atlas.sensor)

    def measured_answer(self, picture: Picture, background: Picture) -> _Measured:
        """Return the probability of each voxel, the place, and the misfit."""
        difference = self._atlas.difference(picture, background, name="the look")
        code = self._atlas.code_of(difference)
        if self._given is None or self._given[0] is not background:
            self._given = background, self._atlas.given(background)
        given = self._given[1]
        place = locate(given, code, seed=_SEED)
        probability = dict(zip(self._atlas.grid.labels, map(float, place.voxels), strict=True))
        return probability, place, self._misfits(difference, code, given).probability

    def _difference(self, empty: Array) -> tuple[float, float]:
        if self._atlas.uncertain is None:
            return super()._difference(empty)
        return factor_between(empty, self._empty), 0.0  # its backgrounds were made as bright

    def _taken_level(self, level: float) -> float:
        return level

    def _doubts(self, target: str, level: float, mismatch: float) -> list[str]:
        if self._atlas.uncertain is None:
            return doubts(self._atlas, target, level=level, mismatch=mismatch)
        strange = doubt_of_backgrounds(np.array([self._atlas.strangeness(self._clean * np.float32(level))]))
        return [*([strange] if strange else []), *doubts(self._atlas, target, level=1.0, mismatch=0.0)]


def opened(path: Path) -> Answerer:
    """Open a trained model, or an atlas.

    Raises
    ------
    NlosError
        The file is missing or broken, or is neither.
    """
    if path.is_file() and h5py.is_hdf5(path):
        return ByAtlas(path, atlas_file.load(path))
    return ByModel(path, models.load(path))


def _sensor_words(sensor: Sensor | None) -> str:
    if sensor is None:
        return "the look's picture without a sensor's noise, like those that it learnt from"
    frames = "one frame" if sensor.frames == 1 else f"{sensor.frames} frames"
    without = ", without drift" if sensor.drift else ""
    return (
        f"the look's picture with simulated noise of its sensor: {frames} of {sensor.exposure:.3g} electrons per "
        f"W/m^2/sr, full well {sensor.full_well:.6g}, read noise {sensor.read_noise:.3g}{without}"
    )
