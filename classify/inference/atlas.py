"""Simulated pictures of a known object, compressed to the differences that a sensor can resolve.

Three diffuse reflections leave so little detail that a dozen numbers hold all that a camera can measure of it. A
picture is put on a scale where its noise is 1 in every pixel, the empty scene is subtracted, and the difference is
projected on the few directions in which simulated pictures differ. The result is the picture's code, whose noise is 1
in every direction too. Codes at a distance d are as distinguishable as unit normal variables at a distance d, so
comparing a code with those of many simulated poses tells whether there is an object, in which voxel, and where.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classify.inference import unknown_object
from classify.inference.uncertain import Uncertain
from classify.inference.unknown_object import AmplitudePrior
from classify.pictures.sensor import Sensor
from generator.files.pictures import COLOUR_SPACE, Picture
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid

LEFT_OUT = 0.05
"""Root mean square over all pictures, in units of the noise, below which the remaining directions are dropped."""
_SAME_NOISE = 0.05
"""Relative difference of noise between bright and dark up to which two cameras count as alike but for their light."""
_MOST_LEFT_OUT = 0.3
"""Root mean square that an atlas may leave out of pictures of another camera, in units of their noise."""
_FEWEST = 100.0
"""Electrons of the darkest pixel in all frames from which on a code grows with the square root of the frames."""


def noise_of(spread: float, nuisances: NDArray[np.float32]) -> Array:
    """Return the covariance of a code's noise before it is scaled to 1, (k, k)."""
    covariance: Array = spread * np.eye(nuisances.shape[1]) + nuisances.T.astype(np.float64) @ nuisances
    return covariance


@dataclass(frozen=True)
class Atlas:
    """Codes of simulated pictures.

    Attributes
    ----------
    codes : ndarray of shape (n, k), float32
        Codes of the pictures, of unit noise.
    basis : ndarray of shape (k, height * width), float32
        Matrix that maps a stabilised difference picture to its code.
    background : ndarray of shape (height, width), float64
        Picture of the empty scene, W/m^2/sr.
    nuisances : ndarray of shape (m, k), float32
        Codes of possible changes since the background was taken (lamp, ambient light), each of one standard
        deviation. They are fitted with every answer, and whatever they could explain is no evidence.
    spread : float
        Variance of a code in every direction before it was scaled to 1: above 1 if the background has noise too.
    positions, rotations : ndarray of shape (n, 3)
        Metres and degrees.
    voxels, kinds : ndarray of shape (n,), int
        Index of the voxel, and index in ``about["targets"]`` of the object that stands there.
    grid : VoxelGrid
    sensor : Sensor
        The sensor with its exposure.
    left_out : float
        Root mean square, over the pictures, of the part outside the basis, in units of the noise in one direction.
    about : dict
        Targets, and the sets that the pictures come from; ``inside`` holds what of an object had to lie inside its
        voxel in each of them, "whole" or "centre".
    hiding : ndarray of shape (n, k), float32, optional
        Codes of the light that a black object would hide at the same poses. If given, the object's size and albedo
        count as unknown (`classify.inference.unknown_object`).
    uncertain : Uncertain, optional
        How codes differ and scatter where the scene is not known exactly; `given` takes a measured background.
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
    uncertain: Uncertain | None = None

    @cached_property
    def empty(self) -> Array:
        """The empty scene on the scale of unit noise (`Sensor.stabilised_mean`), (height, width)."""
        return self.sensor.stabilised_mean(self.background[..., None])

    @property
    def colour_space(self) -> str:
        """The linear colour space of the simulated pictures."""
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

    @cached_property
    def _products(self) -> NDArray[np.float32]:
        assert self.uncertain is not None
        return self.uncertain.products(self.codes)

    def logs(self, codes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the log-likelihood ratio of each pose to an empty scene, given pictures, (..., n).

        Parameters
        ----------
        codes : ndarray of shape (k,) or (m, k)
            Codes of the pictures.
        """
        if self.hiding is None:
            logs: NDArray[np.float32] = codes @ self.codes.T - self._half_squares
            return logs if self.uncertain is None else logs + self.uncertain.gains(codes, self._products)
        return self._strengths.logs(codes @ self.added.T, codes @ self.hiding.T)

    @property
    def shared(self) -> int:
        """Number of the last nuisances, which are noise that pixels share and not drifts."""
        return self.sensor.shared_count(self.background.shape)

    def example(self, pose: int, rng: np.random.Generator) -> Array:
        """Return the noiseless code (k,) of the object at a pose; of a random scene if it is uncertain."""
        code: Array = self.codes[pose].astype(np.float64)
        if self.hiding is not None:
            added, hidden = rng.multivariate_normal(unknown_object.MEAN, unknown_object.COVARIANCE)
            code = added * self.added[pose].astype(np.float64) + hidden * self.hiding[pose]
        if self.uncertain is not None:
            scatter = self.uncertain.scatter[pose].astype(np.float64)
            code = code + rng.normal(size=len(scatter)) @ scatter
        return code

    def at(self, frames: int) -> Atlas:
        """Return the atlas for the same sensor with another number of frames, at most the number it was made for.

        A code grows with the square root of the frames; directions that become too weak to see are dropped.

        Raises
        ------
        NlosError
            If the atlas was made for fewer frames, or the scene is so dark that its noise has another distribution.
        """
        available = self.sensor.frames
        if not 1 <= frames <= available:
            raise NlosError(
                f"frames {frames}: must be from 1 to the {available} that the atlas was made for; make another"
            )
        if frames == available:
            return self
        darkest = float(self.sensor.electrons(self.background[..., None]).min())
        if darkest * frames < _FEWEST:
            raise NlosError(
                f"frames {frames}: collect {darkest * frames:.3g} electrons in the darkest pixel, too few to be "
                f"derived from an atlas of {available}; make one with --frames {frames}"
            )
        scale = math.sqrt(frames / available)
        spread = 1.0 + (self.spread - 1.0) * frames / available
        return self._scaled(scale, spread, replace(self.sensor, frames=frames))

    def seen_by(self, sensor: Sensor) -> Atlas:
        """Return the atlas for pictures of another camera, whose exposure is that of the atlas' radiance.

        Codes follow from all electrons of a picture together: a camera that collects another number in as many frames
        as it likes has codes of another length, as long as the same share of its noise is that of photons.

        Raises
        ------
        NlosError
            Its noise is distributed otherwise, or it collects so much light that the atlas leaves out too much.
        """
        if sensor.shared_count(self.background.shape):
            raise NlosError(
                "the atlas: cannot take on noise of rows or columns, or flicker; make it with this camera's: "
                "nlos-classify atlas SET -o FILE.atlas --sensor FILE.toml"
            )
        # Pictures of a camera are resized, so that the atlas' rows and columns are not the camera's.
        alone = replace(self.sensor, row_noise=0.0, column_noise=0.0, flicker=0.0)
        light = np.maximum(self.background, 0.0)[..., None]
        ratio = np.sqrt(alone.variance(light) / sensor.variance(light))
        scale = float(np.sqrt((ratio**2).mean()))
        if float(np.abs(ratio / scale - 1.0).max()) > _SAME_NOISE:
            raise NlosError(
                "the atlas: is of a camera whose noise is distributed otherwise over bright and dark; make it with "
                "this camera's noise: nlos-classify atlas SET -o FILE.atlas --sensor FILE.toml"
            )
        if self.left_out * scale > _MOST_LEFT_OUT:
            raise NlosError(
                f"the atlas: was made for {1.0 / scale**2:.2g} of the light that these pictures have collected, and "
                f"leaves out too much for them; make it with --frames {math.ceil(self.sensor.frames * scale**2)}"
            )
        spread = 1.0 + sensor.frames / sensor.background_frames
        return self._scaled(scale, spread, sensor)

    def _scaled(self, scale: float, spread: float, sensor: Sensor) -> Atlas:
        """Return the atlas for a sensor by which codes are ``scale`` times as long before their noise is 1."""
        old_factor = np.linalg.cholesky(noise_of(self.spread, self.nuisances))
        # Noise that pixels share grows in the code as other noise does; a drift grows with the code.
        drifts, shared = len(self.nuisances) - self.shared, sensor.shared_count(self.background.shape)
        factors = np.array([scale] * drifts + [math.sqrt(spread / self.spread)] * shared, dtype=np.float32)
        nuisances = factors[:, None] * self.nuisances[: drifts + shared]
        new_factor = np.linalg.cholesky(noise_of(spread, nuisances))
        change = np.linalg.solve(new_factor, old_factor)
        codes = (scale * self.codes @ change.T).astype(np.float32)
        hiding = None if self.hiding is None else (scale * self.hiding @ change.T).astype(np.float32)
        basis = (change @ self.basis).astype(np.float32)
        components = codes if hiding is None else np.concatenate([codes - hiding, hiding])
        if self.uncertain is not None:
            scattered = scale * self.uncertain.scatter @ change.T
            components = np.sqrt(codes**2 + (scattered**2).sum(axis=1))
        residual = np.sqrt(np.cumsum(np.mean(components**2, axis=0)[::-1])[::-1])
        kept = max(1, int((residual > LEFT_OUT).sum()))
        # Ordered by strength, and Cholesky's factor is triangular: dropping the last directions changes no others.
        return replace(
            self,
            codes=np.ascontiguousarray(codes[:, :kept]),
            hiding=None if hiding is None else np.ascontiguousarray(hiding[:, :kept]),
            basis=basis[:kept],
            uncertain=None if self.uncertain is None else self.uncertain.scaled(scale, change, kept),
            nuisances=nuisances[:, :kept],
            spread=spread,
            sensor=sensor,
            left_out=math.hypot(scale * self.left_out, float(residual[kept]) if kept < len(residual) else 0.0),
        )

    def cut(self, shape: tuple[int, int, int]) -> Atlas:
        """Return the atlas of the same volume, divided into other numbers of voxels along x, y and z."""
        grid = replace(self.grid, shape=shape)
        return replace(self, grid=grid, voxels=grid.voxels(self.positions))

    def take(self, some: Any) -> Atlas:
        """Return the atlas of some of its poses, given by their indices or a slice."""
        fields = {name: getattr(self, name)[some] for name in ("codes", "positions", "rotations", "voxels", "kinds")}
        hiding = None if self.hiding is None else self.hiding[some]
        uncertain = None if self.uncertain is None else self.uncertain.take(some)
        return replace(self, **fields, hiding=hiding, uncertain=uncertain)

    def given(self, background: Picture | None) -> Atlas:
        """Return the atlas of what is left uncertain, given a measured background.

        Parameters
        ----------
        background : ndarray of shape (height, width, 3), optional
            As of `difference`, exposed to be as bright as the atlas' own (`classify.pictures.sensor.factor_between`).
        """
        if self.uncertain is None or background is None:
            return self
        places = self.uncertain.told(self.shift(background)).astype(np.float32)
        return replace(self, codes=self.codes + np.tensordot(self.uncertain.slopes, places, axes=(1, 0)))

    def strangeness(self, background: Picture) -> float:
        """Return the probability that a background of the stated scene differs as much from the atlas'; 1 of a known
        scene."""
        return 1.0 if self.uncertain is None else self.uncertain.misfit(self.shift(background))

    def shift(self, background: Picture) -> Array:
        """Return how a measured background differs from the atlas', on the scale of unit noise, (height * width,)."""
        self._check(background, "background")
        shift: Array = (self.sensor.stabilised_mean(background, measured=True) - self.empty).ravel()
        return shift

    def code(
        self, picture: Picture, background: Picture | None = None, *, name: str = "picture"
    ) -> NDArray[np.float32]:
        """Return the code of a measured picture, (k,); see `difference`."""
        return self.code_of(self.difference(picture, background, name=name))

    def code_of(self, difference: Array) -> NDArray[np.float32]:
        """Return the code (k,) of a difference from the empty scene, (height * width,)."""
        code: NDArray[np.float32] = self.basis @ difference.astype(np.float32)
        return code

    def difference(self, picture: Picture, background: Picture | None = None, *, name: str = "picture") -> Array:
        """Return how a measured picture differs from the empty scene, on the scale of unit noise, (height * width,).

        Parameters
        ----------
        picture : ndarray of shape (height, width, 3)
            Measured radiance, W/m^2/sr.
        background : ndarray of shape (height, width, 3), optional
            Measured background, averaged over ``background_frames``; without it, the simulated one is used.
        name : str
            Name of the picture, for messages.

        Raises
        ------
        NlosError
            If the picture has another size than the atlas, or holds NaN or infinite pixels.
        """
        empty = self.empty
        if background is None and self.uncertain is not None:
            raise NlosError(f"{name}: the atlas is of an uncertain scene, so its measured background is needed too")
        if background is not None:
            self._check(background, f"{name}: its background")
            # It averages so many frames that it counts as known.
            empty = self.sensor.stabilised_mean(background, measured=True)
        self._check(picture, name)
        difference: Array = (self.sensor.stabilised(picture) - empty).ravel()
        return difference

    def _check(self, picture: Picture, name: str) -> None:
        height, width = self.empty.shape
        if picture.shape != (height, width, 3):
            raise NlosError(
                f"{name}: has {picture.shape[1]} x {picture.shape[0]} pixels, but the atlas is of {width} x {height}"
            )
        if not np.isfinite(picture).all():
            raise NlosError(f"{name}: holds NaN or infinite values; render it again")
