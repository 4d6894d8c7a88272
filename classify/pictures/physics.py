"""Features from the light transport: level, shape without level, and the fit of an unknown target.

An object of unknown shape is modelled as one small surface element with a position, a normal and a strength. The
picture of such an element in front of a bare wall is one term of the paper's sum over surfels (section 3.1), so the
pictures of many elements are computed in advance and a picture is compared with all of them. The features are means
over the elements, weighted by how well each explains the picture: they change smoothly with the picture and need no
initial guess.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, TransformerMixin

from classify.pictures.settings import Setup
from generator.model.errors import NlosError

Array = NDArray[np.float64]

_DEGREES = 6
"""Number of polynomials along each edge of the picture; more hold only noise (docs/explanation/localisation.md)."""
_SHAPE = 4
"""Largest total degree of the products of these polynomials that describe the shape."""
_PLACES = 12, 10, 7
_OUTSIDE = 0.15
"""How far elements reach beyond the voxel grid, relative to its size: a body's bright side is not its centre."""
_TURNS = np.radians([-60.0, -30.0, 0.0, 30.0, 60.0])
_TILTS = np.radians([-40.0, 0.0, 40.0])
_MISFIT = 0.03
"""Relative error of modelling a real object as one element; the likelihood must not be sharper than that."""
_USUAL, _SPREAD = 0.1, 1.5
"""Prior of an element's strength: share of a voxel's face that it fills, and standard deviation of the logarithm."""
_SMALLEST = 1e-300


def names() -> list[str]:
    """Return the names of the features, in order."""
    shape = [f"shape_{i}_{j}" for i, j in _shapes()]
    return ["level", "strength", *shape, *(f"fit_{name}" for name in _FITTED)]


_FITTED = ("x", "y", "z", "normal_x", "normal_y", "normal_z", "round", "strength", "share", "spread", "evidence")


def _shapes() -> list[tuple[int, int]]:
    return [(i, j) for i in range(_SHAPE + 1) for j in range(_SHAPE + 1 - i)]


class PhysicsFeatures(TransformerMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn has no types
    """Transformer of difference pictures into features, for any scikit-learn pipeline.

    Parameters
    ----------
    setup : Setup
    reference : float, default=1.0
        The scene's reference radiance, W/m^2/sr.
    floor : float, default=1e-7
        Level, in units of ``reference``, up to which the scale is linear; above it is logarithmic.

    Attributes
    ----------
    n_features_out_ : int

    Examples
    --------
    >>> from sklearn.pipeline import make_pipeline
    >>> from sklearn.svm import SVC
    >>> setup = Setup(lit=(0.3, 0, 1.3), lit_area=0.02, watched=(-1, 0, 0.8, 1.8), lo=(0.8, 0.4, 0.4),
    ...               hi=(2.3, 1.9, 2.2), face=0.25)
    >>> model = make_pipeline(PhysicsFeatures(setup), SVC())
    """

    def __init__(self, setup: Setup, reference: float = 1.0, floor: float = 1e-7) -> None:
        self.setup = setup
        self.reference = reference
        self.floor = floor

    def fit(self, pictures: Any, y: Any = None) -> PhysicsFeatures:
        """Learn nothing: all constants follow from the scene."""
        self.n_features_out_ = len(names())
        return self

    def get_feature_names_out(self, input_features: Any = None) -> NDArray[np.object_]:
        """Return the names of the features."""
        return np.array(names(), dtype=object)

    def transform(self, pictures: Any) -> Array:
        """Return features, (n, n_features), which are finite for any pictures.

        Parameters
        ----------
        pictures : array-like of shape (n, height, width) or (n, height, width, 3)
            Picture minus background, W/m^2/sr; row 0 is the largest z, column 0 the largest x.

        Raises
        ------
        NlosError
            If the pictures have another shape, or hold NaN or infinite pixels.
        """
        light = np.asarray(pictures, dtype=np.float64)
        if light.ndim == 4:
            light = light.mean(axis=3)
        if light.ndim != 3 or not light.size:
            raise NlosError(
                f"pictures: must have shape (n, height, width) or (n, height, width, 3), not {np.shape(pictures)}"
            )
        if not np.isfinite(light).all():
            raise NlosError("pictures: hold NaN or infinite values")
        light = light / max(self.reference, _SMALLEST)
        # Squares of larger values would overflow; no scene is brighter than its own lit patch by such a factor.
        light = np.clip(light, -1e100, 1e100)
        return np.stack([self._describe(picture) for picture in light])

    def _describe(self, picture: Array) -> Array:
        height, width = picture.shape
        across, down = _polynomials(width), _polynomials(height)
        projection = down.T @ picture @ across / math.sqrt(picture.size)
        energy = float((projection**2).sum())
        norm = math.sqrt(energy)
        residual = max(float((picture**2).mean()) - energy, 0.0)
        free = picture.size - projection.size
        noise = residual / free if free > 0 else 0.0  # mean square, per coefficient
        coefficients = np.zeros((_DEGREES, _DEGREES))
        coefficients[: projection.shape[0], : projection.shape[1]] = projection
        level = _signed_log(coefficients[0, 0] / self.floor)
        shape = [coefficients[i, j] / max(norm, _SMALLEST) for i, j in _shapes()]
        return np.array([level, _signed_log(norm / self.floor), *shape, *self._fit(projection, energy, noise)])

    def _fit(self, found: Array, energy: float, noise: float) -> list[float]:
        """Means over the elements, weighted by how well each explains a picture."""
        elements = _elements(self.setup, found.shape)
        measured = found.ravel() / (math.sqrt(energy) or 1.0)
        variance = noise / max(energy, _SMALLEST) + _MISFIT**2
        cosines = elements.pictures @ measured  # both sides have length 1
        strength = np.maximum(cosines, 1e-6) * math.sqrt(energy) / elements.sizes
        typical = _USUAL * self.setup.face * self.setup.lit_area / math.pi
        log_ratios = np.log(np.maximum(strength, _SMALLEST) / typical)
        logs = 0.5 * np.maximum(cosines, 0.0) ** 2 / variance - 0.5 * (log_ratios / _SPREAD) ** 2
        top = float(logs.max())
        weights = np.exp(logs - top)
        weights /= weights.sum()
        share = float(weights @ cosines**2)  # explained share of the picture's energy
        mean = weights @ elements.poses
        spread = math.sqrt(
            max(float(weights @ (elements.poses[:, :3] ** 2).sum(axis=1) - (mean[:3] ** 2).sum()), 0.0)
        )
        mean_log_ratio = float(weights @ log_ratios)
        evidence = _signed_log(energy / max(noise, _SMALLEST)) if energy else 0.0
        return [*mean, max(mean_log_ratio, -50.0), share, min(spread, 1e3), min(evidence, 700.0)]


@dataclass(frozen=True)
class _Elements:
    """Pictures of surface elements, as coefficients of polynomials.

    Attributes
    ----------
    poses : ndarray of shape (n, 7)
        Position, metres; normal; and 1 for a ball, which faces all directions and has the normal 0, otherwise 0.
    pictures : ndarray of shape (n, k)
        Coefficients, each row of length 1.
    sizes : ndarray of shape (n,)
        Lengths that the rows were divided by: those of the coefficients of an element of strength 1.
    """

    poses: Array
    pictures: Array
    sizes: Array


@lru_cache(maxsize=8)
def _elements(setup: Setup, shape: tuple[int, int]) -> _Elements:
    """Compute the elements; ``shape`` is the number of polynomials along the height and width of the picture."""
    x0, x1, z0, z1 = setup.watched
    nodes, weights = legendre.leggauss(2 * _DEGREES)
    # Column 0 is the largest x and row 0 the largest z.
    x = 0.5 * (x0 + x1) - 0.5 * (x1 - x0) * nodes
    z = 0.5 * (z0 + z1) - 0.5 * (z1 - z0) * nodes
    wall = np.stack(np.meshgrid(x, [0.0], z, indexing="ij"), axis=-1).reshape(len(x), len(z), 3)
    lo, hi = np.array(setup.lo), np.array(setup.hi)
    margin = _OUTSIDE * (hi - lo)
    low, high = lo - margin, hi + margin
    low[1] = max(low[1], 0.5 * lo[1])
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, _PLACES, strict=True)]
    axes[1] = np.geomspace(low[1], high[1], _PLACES[1])  # the light varies with the logarithm of the distance
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    turn, tilt = (a.ravel() for a in np.meshgrid(_TURNS, _TILTS, indexing="ij"))
    normals = np.stack([np.sin(turn) * np.cos(tilt), -np.cos(turn) * np.cos(tilt), np.sin(tilt)], axis=1)
    to_lit = np.array(setup.lit) - places
    lit_distance = np.linalg.norm(to_lit, axis=1)
    to_lit /= lit_distance[:, None]
    arriving = places[:, 1] / lit_distance / lit_distance**2  # cosine at the lit patch, inverse square law
    to_wall = wall[None] - places[:, None, None]
    wall_distance = np.linalg.norm(to_wall, axis=3)
    to_wall /= wall_distance[..., None]
    leaving = places[:, 1, None, None] / wall_distance / wall_distance**2
    falloff = (arriving[:, None, None] * leaving)[:, None]
    # A sheet reflects only on the side that is lit: towards the other side, the two cosines differ in sign.
    cos_lit, cos_wall = to_lit @ normals.T, np.einsum("pxzc,nc->pnxz", to_wall, normals)
    flat = np.maximum(cos_lit[:, :, None, None] * cos_wall, 0.0)
    # A Lambertian ball's phase function (Schoenberg 1929) of the angle between the directions to w1 and to w2.
    angle = np.arccos(np.clip(np.einsum("pc,pxzc->pxz", to_lit, to_wall), -1.0, 1.0))
    ball = (2.0 / (3.0 * math.pi)) * (np.sin(angle) + (math.pi - angle) * np.cos(angle))
    light = falloff * np.concatenate([flat, ball[:, None]], axis=1)
    across = _at(nodes, shape[1]) * weights[:, None] / 2.0
    down = _at(nodes, shape[0]) * weights[:, None] / 2.0
    coefficients = np.einsum("pnxz,zi,xj->pnij", light, down, across, optimize=True).reshape(-1, shape[0] * shape[1])
    sizes = np.linalg.norm(coefficients, axis=1)
    kinds = np.concatenate([np.hstack([normals, np.zeros((len(normals), 1))]), [[0.0, 0.0, 0.0, 1.0]]])
    poses = np.hstack([np.repeat(places, len(kinds), axis=0), np.tile(kinds, (len(places), 1))])
    visible = sizes > 1e-9 * sizes.max()  # an element seen edge-on sends no light
    return _Elements(poses[visible], coefficients[visible] / sizes[visible, None], sizes[visible])


def _at(nodes: Array, count: int) -> Array:
    """Legendre polynomials of mean square 1 at points from -1 to 1, (n, count)."""
    return legendre.legvander(nodes, count - 1) * np.sqrt(2.0 * np.arange(count) + 1.0)


@lru_cache(maxsize=32)
def _polynomials(pixels: int) -> Array:
    """Legendre polynomials averaged over each pixel of an edge and made orthonormal again, (pixels, count)."""
    count = min(_DEGREES, pixels)
    edges = np.linspace(-1.0, 1.0, pixels + 1)
    integrals = np.stack(
        [legendre.legval(edges, legendre.legint([0.0] * k + [math.sqrt(2.0 * k + 1.0)])) for k in range(count)]
    )
    averages = np.diff(integrals, axis=1).T * pixels / 2.0
    q, r = np.linalg.qr(averages)
    signed: Array = q * np.sign(np.diag(r))
    return signed


def _signed_log(value: float) -> float:
    return float(np.arcsinh(value))
