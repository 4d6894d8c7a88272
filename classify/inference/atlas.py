"""The pictures that the engine expects of a known object, compressed to what a sensor can tell apart of them.

Three diffuse reflections leave so little detail that a dozen numbers hold all that a camera lets through of it. A
picture is put on a scale where its noise is 1 in every pixel, the empty scene is subtracted, and the rest projected
on the few directions in which simulated pictures differ: its code, whose noise is 1 in every direction too. Codes a
distance d apart are told apart as well as normal variables d apart, so comparing a code with those of many simulated
poses answers every question: is something there, in which voxel, where.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from sklearn.utils.extmath import randomized_svd

from classify.inference import unknown_object
from classify.inference.unknown_object import AmplitudePrior
from classify.pictures.feature_table import numbers, open_table
from classify.pictures.sensor import Sensor
from generator.files.pictures import COLOUR_SPACE, Picture
from generator.files.toml import from_dict, to_dict
from generator.files.writing import atomic
from generator.jobs.bulk import Engine
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.sets.bulk_set import Bulk
from generator.sets.readable import check_colours

FORMAT = 2

_LEFT_OUT = 0.05
_FEWEST = 100.0
"""Electrons in all frames of the darkest pixel, from which on a picture's code grows with the root of the frames."""
_FOR_BASIS = 4096
_FIRST = 64
_ABSURD = 1e15
"""No number in an atlas comes near, and the squares of these still are numbers."""
_BLOCK = 2048


@dataclass(frozen=True)
class Atlas:
    """Codes of simulated pictures.

    Attributes
    ----------
    codes : ndarray of shape (n, k), float32
        Of unit noise.
    basis : ndarray of shape (k, height * width), float32
        What turns a stabilised difference picture into a code.
    background : ndarray of shape (height, width), float64
        The empty scene, W/m^2/sr.
    nuisances : ndarray of shape (m, k), float32
        Codes of what may have changed since the background was taken (lamp, ambient light), each by a standard
        deviation: it is fitted with every answer, and what it could explain is no evidence.
    spread : float
        Variance of a code in every direction before it was made 1: above 1 where the background has noise too.
    positions, rotations : ndarray of shape (n, 3)
        Metres and degrees.
    voxels, kinds : ndarray of shape (n,), int
        Which voxel, and which of the ``about["targets"]`` stands there.
    grid : VoxelGrid
    sensor : Sensor
        With its exposure.
    left_out : float
        Root mean square, over the pictures, of what the basis cannot hold, in units of the noise in one direction.
    about : dict
        Targets, and the sets that the pictures are of.
    hiding : ndarray of shape (n, k), float32, optional
        Codes of what a black object would hide at the same poses: where it is given, the object's size and albedo
        count as unknown (`classify.inference.unknown_object`).
    """

    codes: NDArray[np.float32]
    basis: NDArray[np.float32]
    background: Array
    nuisances: NDArray[np.float32]
    spread: float
    positions: Array
    rotations: Array
    voxels: NDArray[np.int64]
    kinds: NDArray[np.int64]
    grid: VoxelGrid
    sensor: Sensor
    left_out: float
    about: dict[str, Any]
    hiding: NDArray[np.float32] | None = None

    @cached_property
    def empty(self) -> Array:
        """The empty scene on the scale of unit noise (`Sensor.stabilised_mean`), (height, width)."""
        return self.sensor.stabilised_mean(self.background[..., None])

    @property
    def colour_space(self) -> str:
        """The linear space that the channels of the simulated pictures are of."""
        return str(self.about.get("colour_space", COLOUR_SPACE))

    @property
    def unknown(self) -> bool:
        """Whether the object's size and albedo are unknown."""
        return self.hiding is not None

    @cached_property
    def _half_squares(self) -> NDArray[np.float32]:
        half: NDArray[np.float32] = 0.5 * np.einsum("ij,ij->i", self.codes, self.codes)
        return half

    @cached_property
    def added(self) -> NDArray[np.float32]:
        """Codes of the light that the object adds, (n, k)."""
        return self.codes if self.hiding is None else self.codes - self.hiding

    @cached_property
    def _strengths(self) -> AmplitudePrior:
        assert self.hiding is not None
        return AmplitudePrior.of(self.added, self.hiding)

    def logs(self, codes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return how much better each pose explains pictures than an empty scene: logarithms, (..., n).

        Parameters
        ----------
        codes : ndarray of shape (k,) or (m, k)
            Of pictures.
        """
        if self.hiding is None:
            return codes @ self.codes.T - self._half_squares
        return self._strengths.logs(codes @ self.added.T, codes @ self.hiding.T)

    def example(self, pose: int, rng: np.random.Generator) -> Array:
        """Return the code of the object at a pose, or of a random one where it is unknown; without noise, (k,)."""
        code: Array = self.codes[pose].astype(np.float64)
        if self.hiding is not None:
            first, second = rng.multivariate_normal(unknown_object.MEAN, unknown_object.COVARIANCE)
            code = first * self.added[pose].astype(np.float64) + second * self.hiding[pose]
        return code

    def at(self, frames: int) -> Atlas:
        """Return the atlas of the same sensor averaging another number of frames, no more than it was made for.

        A code grows with the root of the frames; directions in which nothing is left to see are dropped.

        Raises
        ------
        NlosError
            That are more frames, or the scene is so dark that its noise changes its form.
        """
        have = self.sensor.frames
        if not 1 <= frames <= have:
            raise NlosError(
                f"frames {frames}: must be from 1 to the {have} that the atlas was made for; make another"
            )
        if frames == have:
            return self
        darkest = float(self.sensor.electrons(self.background[..., None]).min())
        if darkest * frames < _FEWEST:
            raise NlosError(
                f"frames {frames}: collect {darkest * frames:.3g} electrons in the darkest pixel, too few to be "
                f"derived from an atlas of {have}; make one with --frames {frames}"
            )
        scale = math.sqrt(frames / have)
        spread = 1.0 + (self.spread - 1.0) * frames / have
        old = np.linalg.cholesky(_noise(self.spread, self.nuisances))
        new = np.linalg.cholesky(_noise(spread, scale * self.nuisances))
        change = np.linalg.solve(new, old)
        codes = (scale * self.codes @ change.T).astype(np.float32)
        hiding = None if self.hiding is None else (scale * self.hiding @ change.T).astype(np.float32)
        basis = (change @ self.basis).astype(np.float32)
        every = codes if hiding is None else np.concatenate([codes - hiding, hiding])
        rest = np.sqrt(np.cumsum(np.mean(every**2, axis=0)[::-1])[::-1])
        kept = max(1, int((rest > _LEFT_OUT).sum()))
        # The basis is in order of strength, and Cholesky's factor is triangular: what is dropped moves nothing else.
        return replace(
            self,
            codes=np.ascontiguousarray(codes[:, :kept]),
            hiding=None if hiding is None else np.ascontiguousarray(hiding[:, :kept]),
            basis=basis[:kept],
            nuisances=scale * self.nuisances[:, :kept],
            spread=spread,
            sensor=replace(self.sensor, frames=frames),
            left_out=math.hypot(scale * self.left_out, float(rest[kept]) if kept < len(rest) else 0.0),
        )

    def cut(self, shape: tuple[int, int, int]) -> Atlas:
        """Return the atlas of the same volume, cut into other voxels, along x, y and z."""
        grid = replace(self.grid, shape=shape)
        return replace(self, grid=grid, voxels=grid.voxels(self.positions))

    def take(self, some: Any) -> Atlas:
        """Return the atlas of some of its poses, given by their numbers or a slice."""
        every = {name: getattr(self, name)[some] for name in ("codes", "positions", "rotations", "voxels", "kinds")}
        return replace(self, **every, hiding=None if self.hiding is None else self.hiding[some])

    def code(
        self, picture: Picture, background: Picture | None = None, *, name: str = "picture"
    ) -> NDArray[np.float32]:
        """Return the code of a measured picture, (k,).

        Parameters
        ----------
        picture : ndarray of shape (height, width, 3)
            Measured radiance, W/m^2/sr.
        background : ndarray of shape (height, width, 3), optional
            Measured by the sensor's ``background_frames``; without it, the simulated one.
        name : str
            For messages.

        Raises
        ------
        NlosError
            The picture has another size than the atlas, or holds NaN or infinite pixels.
        """
        empty = self.empty
        if background is not None:
            self._check(background, f"{name}: its background")
            empty = self.sensor.stabilised_mean(background)  # of so many frames that it is as good as known
        self._check(picture, name)
        seen = self.sensor.stabilised(picture) - empty
        code: NDArray[np.float32] = self.basis @ seen.ravel().astype(np.float32)
        return code

    def _check(self, picture: Picture, name: str) -> None:
        height, width = self.empty.shape
        if picture.shape != (height, width, 3):
            raise NlosError(
                f"{name}: has {picture.shape[1]} x {picture.shape[0]} pixels, but the atlas is of {width} x {height}"
            )
        if not np.isfinite(picture).all():
            raise NlosError(f"{name}: holds NaN or infinite values; render it again")


def build(
    bulk: Bulk,
    sensor: Sensor,
    *others: Bulk,
    lamp_drift: float = 0.0,
    ambient_drift: float = 0.0,
    measured_background: bool = True,
    unknown: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Atlas:
    """Compress simulated sets to the codes of their pictures.

    Parameters
    ----------
    bulk : Bulk
        Finished.
    *others : Bulk
        The same scene with other objects: what is looked for may be any of them.
    sensor : Sensor
        Without an exposure, the brightest pixel of the background and of some thousand pictures fills it.
    lamp_drift : float
        Standard deviation of the lamp's strength since the background was taken, relative.
    ambient_drift : float
        Standard deviation of uniform light on the watched wall since then, in units of the background's mean.
    measured_background : bool
        Whether the background that pictures come with is measured too, and hence has noise of its own.
    unknown : bool
        Whether the object's size and albedo count as unknown.
    progress : callable
        Is told how many pictures are done, and of how many.

    Raises
    ------
    NlosError
        A set is not finished, or has no light, or they are not of one scene.
    """
    bulks = [bulk, *others]
    if unknown and (many := [b for b in bulks if b.plan.unknown]):
        raise NlosError(f"--unknown: {many[0].path} is of objects of all sizes and albedos already; leave it out")
    background = bulk.background
    _check_alike(bulks)
    share = math.ceil(_FOR_BASIS / len(bulks))
    some = [np.unique(np.linspace(0, b.planned - 1, min(b.planned, share)).astype(np.int64)) for b in bulks]
    dark = [_Black(b) for b in bulks] if unknown else []
    samples = [_colour(b.pictures[numbers]) for b, numbers in zip(bulks, some, strict=True)]
    sample = np.concatenate(samples)
    sensor = sensor.exposed([background, sample.reshape(-1, sample.shape[-2], 3)])
    empty = sensor.stabilised_mean(background)

    def differences(pictures: NDArray[np.float32]) -> NDArray[np.float32]:
        every = [sensor.stabilised_mean(p) - empty for p in pictures]
        return np.asarray(every, dtype=np.float32).reshape(len(every), -1)

    seen = differences(sample)
    if dark:
        black = [d(numbers, pictures) for d, numbers, pictures in zip(dark, some, samples, strict=True)]
        hidden = differences(np.concatenate(black))
        seen = np.concatenate([seen - hidden, hidden])
    basis, left_out = _basis(seen)
    # What cannot be told from a change of the light, and the background's own noise, make the rest less certain.
    spread = 1.0 + (sensor.frames / sensor.background_frames if measured_background else 0.0)
    drifts = [background * (1.0 + lamp_drift)] if lamp_drift else []
    drifts += [background + ambient_drift * background.mean()] if ambient_drift else []
    nuisances = np.array([basis @ (sensor.stabilised_mean(lit) - empty).ravel() for lit in drifts])
    nuisances = nuisances.reshape(len(drifts), len(basis)).astype(np.float32)
    whitened = np.linalg.solve(np.linalg.cholesky(_noise(spread, nuisances)), basis).astype(np.float32)
    count = sum(b.planned for b in bulks)
    codes: list[NDArray[np.float32]] = []
    hiding: list[NDArray[np.float32]] = []
    done = 0
    for number, one in enumerate(bulks):
        for start in range(0, one.planned, _BLOCK):
            block = slice(start, min(start + _BLOCK, one.planned))
            pictures = _colour(one.pictures[block])
            codes.append(differences(pictures) @ whitened.T)
            if dark:
                rows = np.arange(block.start, block.stop)
                hiding.append(differences(dark[number](rows, pictures)) @ whitened.T)
            done += len(pictures)
            progress(done, count)
    return Atlas(
        codes=np.concatenate(codes),
        basis=whitened,
        background=background.mean(axis=2, dtype=np.float64),
        nuisances=nuisances,
        spread=spread,
        positions=np.concatenate([b.positions for b in bulks]),
        rotations=np.concatenate([b.rotations for b in bulks]),
        voxels=np.concatenate([b.voxels for b in bulks]),
        kinds=np.repeat(np.arange(len(bulks)), [b.planned for b in bulks]),
        grid=bulk.grid,
        sensor=sensor,
        left_out=left_out,
        about={
            "targets": [b.target_kind for b in bulks],
            "sets": [b.path.resolve().name for b in bulks],
            "fingerprints": [b.meta["fingerprint"] for b in bulks],
            "colour_space": bulk.colour_space,
            "lamp_drift": lamp_drift,
            "ambient_drift": ambient_drift,
        },
        hiding=np.concatenate(hiding) if hiding else None,
    )


def _check_alike(bulks: list[Bulk]) -> None:
    """Raise NlosError unless all sets are finished and of one scene."""
    first = bulks[0]
    for bulk in bulks:
        bulk.refuse_unfinished()
        bulk.refuse_changed_parts()
        check_colours(bulk.path, bulk.colour_space, first.colour_space, str(first.path))
        if bulk.grid != first.grid or bulk.picture_shape != first.picture_shape:
            raise NlosError(f"{bulk.path} and {first.path}: have different voxel grids or pictures of another size")
        if not np.allclose(bulk.background, first.background, rtol=0.02, atol=0.0):
            raise NlosError(f"{bulk.path} and {first.path}: show different scenes; only the object may differ")


def _noise(spread: float, nuisances: NDArray[np.float32]) -> Array:
    """Covariance of a code before it is made 1, (k, k)."""
    covariance: Array = spread * np.eye(nuisances.shape[1]) + nuisances.T.astype(np.float64) @ nuisances
    return covariance


class _Black:
    """The same poses of a black object, which only hides."""

    def __init__(self, bulk: Bulk) -> None:
        self._engine = Engine(bulk)
        self._bulk = bulk

    def __call__(self, some: NDArray[np.int64], pictures: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the black object's pictures for the white one's, (n, height, width, 3)."""
        bulk = self._bulk
        # What an object adds takes the engine far less time than what it hides, which is the rest of its picture.
        lit = self._engine.pictures(some, bulk.positions[some], bulk.rotations[some], shadows=False)
        return pictures - (lit - bulk.background)


def _basis(sample: NDArray[np.float32]) -> tuple[Array, float]:
    """The fewest orthonormal directions (k, pixels) that hold pictures (n, pixels), and what they leave out.

    By sampling the pictures' range at random (Halko, Martinsson and Tropp 2011, algorithm 4.4): all directions would
    take minutes, and but for the first few hundred there is nothing in them.
    """
    pictures = sample.astype(np.float64)
    total, most = float((pictures**2).sum()), min(pictures.shape)
    count = min(_FIRST, most)
    while True:
        _, strengths, directions = randomized_svd(pictures, count, n_iter=4, random_state=0)
        beyond = max(total - float((strengths**2).sum()), 0.0)
        rest = np.sqrt((np.cumsum(strengths[::-1] ** 2)[::-1] + beyond) / len(pictures))
        if count == most or beyond <= len(pictures) * _LEFT_OUT**2:
            break
        count = min(2 * count, most)
    kept = max(1, int((rest > _LEFT_OUT).sum()))
    return directions[:kept], float(rest[kept] if kept < len(rest) else math.sqrt(beyond / len(pictures)))


def _colour(pictures: NDArray[np.float32]) -> NDArray[np.float32]:
    """Pictures (..., height, width, 3) of a grey set's (..., height, width)."""
    return pictures if pictures.shape[-1:] == (3,) and pictures.ndim > 3 else pictures[..., None].repeat(3, axis=-1)


def save(path: Path, atlas: Atlas) -> None:
    """Write an atlas to HDF5, by temporary name and rename."""
    with atomic(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["format"] = FORMAT
        file.attrs["kind"] = "atlas"
        file.attrs["grid"] = json.dumps(to_dict(atlas.grid))
        file.attrs["sensor"] = json.dumps(asdict(atlas.sensor))
        file.attrs["left_out"] = atlas.left_out
        file.attrs["spread"] = atlas.spread
        file.attrs["about"] = json.dumps(atlas.about)
        for name in _ARRAYS:
            file[name] = getattr(atlas, name)
        if atlas.hiding is not None:
            file["hiding"] = atlas.hiding
        file["codes"].attrs["about"] = "difference pictures in units of the sensor's noise, projected on the basis"
        file["positions"].attrs["units"] = "m"
        file["rotations"].attrs["units"] = "degrees about x, y, z"


_ARRAYS: dict[str, type[Any]] = {
    **dict.fromkeys(("codes", "basis", "nuisances"), np.float32),
    **dict.fromkeys(("background", "positions", "rotations"), np.float64),
    **dict.fromkeys(("voxels", "kinds"), np.int64),
}


def load(path: Path) -> Atlas:
    """Read an atlas.

    Raises
    ------
    NlosError
        The file is missing, of a newer format, or no atlas.
    """
    with open_table(path, "atlas", FORMAT) as file:
        atlas = Atlas(
            **{name: numbers(file, name, kind) for name, kind in _ARRAYS.items()},
            grid=from_dict(VoxelGrid, json.loads(str(file.attrs["grid"])), "grid."),
            sensor=from_dict(Sensor, json.loads(str(file.attrs["sensor"])), "sensor."),
            left_out=float(file.attrs["left_out"]),
            spread=float(file.attrs["spread"]),
            about=json.loads(str(file.attrs["about"])),
            hiding=numbers(file, "hiding", np.float32) if "hiding" in file else None,
        )
        n, k = atlas.codes.shape
        shapes = [atlas.basis.shape, atlas.positions.shape, atlas.rotations.shape, atlas.voxels.shape]
        shapes += [atlas.nuisances.shape[1:], atlas.kinds.shape]
        wanted = [(k, atlas.background.size), (n, 3), (n, 3), (n,), (k,), (n,)]
        if atlas.background.ndim != 2 or shapes != wanted or not n:
            raise ValueError("its codes, basis and poses differ in length")
        if atlas.hiding is not None and atlas.hiding.shape != (n, k):
            raise ValueError("its codes of light and of shadow differ in number")
        arrays = [getattr(atlas, name) for name in (*_ARRAYS, *["hiding"] * atlas.unknown)]
        if not all((np.abs(array) < _ABSURD).all() for array in arrays):
            raise ValueError("it holds NaN, infinite or absurdly large values")
        targets = atlas.about["targets"]
        if not (isinstance(targets, list) and all(isinstance(target, str) for target in targets)):
            raise ValueError("it does not name its targets")
        if not (0.0 < atlas.spread < math.inf and 0.0 <= atlas.left_out < math.inf):
            raise ValueError("its spread or what it leaves out is no positive number")
        if atlas.kinds.min() < 0 or atlas.kinds.max() >= len(targets):
            raise ValueError("it names a target that it does not describe")
        room = 1e-6 * np.subtract(atlas.grid.hi, atlas.grid.lo)
        low, high = atlas.positions.min(axis=0), atlas.positions.max(axis=0)
        if (low < atlas.grid.lo - room).any() or (high > atlas.grid.hi + room).any():
            raise ValueError("it has poses outside its grid")
        if atlas.voxels.min() < 0 or atlas.voxels.max() >= atlas.grid.n_voxels:
            raise ValueError(f"it names a voxel that its grid of {atlas.grid.n_voxels} lacks")
    return atlas
