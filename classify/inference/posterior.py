"""Position of a known object: a picture's code is compared with an atlas, and interpolated if it is sharp.

This is analysis by synthesis: the measurement M is compared with simulations S(p) (paper, section 5.1), all of which
are computed in advance. The posterior over the atlas' poses is exact as long as several of them explain the picture.
If a picture is so sharp that only a few do, the codes around them are interpolated by a local quadratic (a response
surface: Box and Wilson 1951) and importance sampling gives the posterior. If that is too coarse, `polish` calls the
engine itself.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from classify.inference.atlas import Atlas
from classify.inference.tracker import Step
from classify.inference.unknown_object import AmplitudePrior
from generator.model.arrays import Array, Vector
from generator.model.errors import NlosError
from generator.transport import Transport, World

ENOUGH = 200.0
"""Poses that must contribute to an answer (effective number: Kish 1965) for the atlas alone to suffice."""

SURE = 0.95
"""Probability that a stated region holds the truth."""

REACH = float(chi2.ppf(SURE, 3))
"""Squared distance from the mean, in units of the covariance, that a normal variable keeps with that probability."""

_NEAR = 256
_DRAWS = 1500
_ROUNDS = 2
_LEANING = 1e-2
_MOST_STEPS, _SETTLED, _STUCK = 30, 1e-2, 1e4
_ALONE = 3.0
"""Poses (effective number) below which interpolation gives the voxel too: with more, they may lie far apart."""
_WIDER = 1.5
"""Standard deviations of the proposal distribution, in those of the current estimate."""


@dataclass(frozen=True)
class Place:
    """Posterior of the position of an object, given a picture.

    Attributes
    ----------
    voxels : ndarray of shape (n_voxels,)
        Probability of each voxel, if there is an object.
    position : ndarray of shape (3,)
        Mean of the posterior, metres.
    covariance : ndarray of shape (3, 3)
        Covariance of the posterior, m^2.
    evidence : float
        Logarithm of how much more probable the picture is with the object somewhere than without (a Bayes factor).
    poses : float
        Effective number of the atlas' poses that explain the picture.
    reach : float
        Squared distance from the mean, in units of the covariance, within which the object is with the probability
        `SURE`: of a normal posterior, and of an uncertain scene's that of its own shape.
    """

    voxels: Array
    position: Array
    covariance: Array
    evidence: float
    poses: float
    reach: float = REACH


def locate(atlas: Atlas, code: NDArray[np.float32], *, seed: int = 0, without: int | None = None) -> Place:
    """Return the posterior of the position of the object.

    Parameters
    ----------
    atlas : Atlas
        Its poses are the prior, each as likely as any other.
    code : ndarray of shape (k,)
        Code of the picture, from `Atlas.code`.
    seed : int
        Seed of the sampling.
    without : int, optional
        Index of a pose to leave out: the one that the code comes from, if the atlas is tested on its own poses.
    """
    logs = atlas.logs(code)
    if without is not None:
        logs[without] = -np.inf
    top = float(logs.max())
    weights = np.exp(logs - top)
    by_voxel = np.bincount(atlas.voxels, weights, atlas.grid.n_voxels).astype(np.float64)
    total = float(by_voxel.sum())
    poses = total**2 / float(weights @ weights)
    voxels, reach = by_voxel / total, REACH
    if poses >= ENOUGH:
        likely = np.flatnonzero(weights > weights.max() * 1e-7)
        position, covariance = _moments(atlas.positions[likely], weights[likely])
        if atlas.uncertain is not None:
            reach = _reach(atlas.positions[likely] - position, covariance, weights[likely])
    else:
        try:
            position, covariance, interpolated = _sharpened(atlas, code, logs, seed)
        except np.linalg.LinAlgError:
            raise NlosError("atlas: its poses and codes cannot be of one scene; make it anew") from None
        voxels = interpolated if interpolated is not None and poses < _ALONE else voxels
    return Place(voxels, position, covariance, top + math.log(total / len(logs)), poses, reach)


@dataclass(frozen=True)
class Fit:
    """A pose that was fitted with the engine.

    Attributes
    ----------
    position, rotation : ndarray of shape (3,)
        Metres; degrees about x, then y, then z.
    covariance : ndarray of shape (k, k)
        Covariance of the position (3), metres, and the rotation about the world's axes (3, if fitted), radians.
    misfit : float
        Squared distance between the picture's code and the fitted one. If the object is the known one, it is about
        the length of the code minus the number of fitted parameters.
    steps : int
        Number of steps that were tried.
    """

    position: Array
    rotation: Array
    covariance: Array
    misfit: float
    steps: int


class Synthesis:
    """Codes of any pose, computed by the engine.

    Parameters
    ----------
    atlas : Atlas
    world : World
        World that the atlas was made of.
    accuracy : float
        Relative accuracy of a picture.
    """

    def __init__(self, atlas: Atlas, world: World, *, accuracy: float = 1e-3) -> None:
        self.atlas = atlas
        height, width = atlas.empty.shape
        world = world.seen_by(width, height)
        self._engine = Transport(world, accuracy=accuracy)
        # A step needs only a rough direction; derivatives of a tenth of this error cost a hundred times as much.
        self._leaning = Transport(world, accuracy=max(accuracy, _LEANING))
        self._background = self._engine.background()

    def code(self, position: Array, rotation: Array) -> Array:
        """Return the code of a pose, (k,); position in metres, rotation in degrees about x, then y, then z."""
        expected = self.atlas.sensor.stabilised_mean(self._background + self._engine.difference(position, rotation))
        code: Array = self.atlas.basis @ (expected - self.atlas.empty).ravel()
        return code

    def slopes(self, position: Array, rotation: Array) -> Array:
        """Return the code's derivatives, (k, 7): position, turn about the world's axes (radians), strength.

        Raises
        ------
        NlosError
            If something stands between the wall and the target, where the engine has no derivatives.
        """
        sensor, rendering = self.atlas.sensor, self._leaning.render(position, rotation, derivatives=True)
        assert rendering.derivatives is not None
        gain = sensor.stabilised_slope(rendering.pixels)
        slopes: Array = (
            self.atlas.basis @ (sensor.blurred(rendering.derivatives.mean(axis=3)) * gain).reshape(7, -1).T
        )
        return slopes


def polish(synthesis: Synthesis, code: NDArray[np.float32], *, starts: int = 3, turning: bool | None = None) -> Fit:
    """Fit the pose to a picture with the engine and its derivatives, starting from the atlas' best poses.

    Gauss-Newton steps are damped (Levenberg 1944, Marquardt 1963, equation 10) until they improve the fit.

    Parameters
    ----------
    synthesis : Synthesis
    code : ndarray of shape (k,)
        Code of the picture.
    starts : int
        Number of the atlas' poses to start from: the likeliest, none near another.
    turning : bool, optional
        Whether the rotation is unknown; default: whether it varies in the atlas.

    Raises
    ------
    NlosError
        If the engine has no derivatives there, since something stands between the wall and the target.
    """
    atlas = synthesis.atlas
    turning = bool(np.ptp(atlas.rotations, axis=0).any()) if turning is None else turning
    logs = atlas.logs(code)
    fits = [_descend(synthesis, code, start, 6 if turning else 3) for start in _apart(atlas, logs, starts)]
    return min(fits, key=lambda fit: fit.misfit)


def _apart(atlas: Atlas, logs: NDArray[np.float32], count: int) -> list[int]:
    """Indices of the likeliest poses of which none lies within half a voxel of another."""
    kept: list[int] = []
    remaining = np.ones(len(logs), dtype=bool)
    near = 0.5 * np.asarray(atlas.grid.size)
    while len(kept) < count and remaining.any():
        best = int(np.argmax(np.where(remaining, logs, -np.inf)))
        kept.append(best)
        remaining &= (np.abs(atlas.positions - atlas.positions[best]) > near).any(axis=1)
    return kept


def _descend(synthesis: Synthesis, code: NDArray[np.float32], start: int, free: int) -> Fit:
    atlas = synthesis.atlas
    position, rotation = atlas.positions[start], atlas.rotations[start]
    residual = code - synthesis.code(position, rotation)
    slopes = synthesis.slopes(position, rotation)[:, :free]
    low, high = atlas.positions.min(axis=0), atlas.positions.max(axis=0)
    damping, misfit, steps = 1e-3, float(residual @ residual), 0
    while steps < _MOST_STEPS:
        steps += 1
        normal = slopes.T @ slopes
        step = np.linalg.lstsq(normal + damping * np.diag(np.diag(normal)), slopes.T @ residual, rcond=None)[0]
        moved = np.clip(position + step[:3], low, high)
        turned = _turned(rotation, step[3:]) if free > 3 else rotation
        try:
            moved_residual = code - synthesis.code(moved, turned)
        except NlosError:  # a place where no object can be
            moved_residual = np.full_like(residual, np.inf)
        improvement = misfit - float(moved_residual @ moved_residual)
        if improvement > 0.0:
            position, rotation, residual, misfit = moved, turned, moved_residual, misfit - improvement
            damping *= 0.1
            slopes = synthesis.slopes(position, rotation)[:, :free]
        else:
            damping *= 10.0
        if abs(improvement) < _SETTLED or damping > _STUCK:
            break
    return Fit(position, rotation, np.linalg.pinv(slopes.T @ slopes, hermitian=True), misfit, steps)


def _turned(rotation: Array, by: Array) -> Array:
    """Angles, degrees about x, then y, then z, after a further turn about the world's axes, radians."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # gimbal lock, at a quarter turn about y: any solution will do
        turn = Rotation.from_rotvec(by) * Rotation.from_euler("xyz", rotation, degrees=True)
        angles: Array = turn.as_euler("xyz", degrees=True)
    return angles


def holds(place: Place | Step, position: Vector) -> bool:
    """Whether a position, metres, lies in the region that holds the object with the stated probability `SURE`."""
    offset = np.asarray(position) - place.position
    reach = place.reach if isinstance(place, Place) else REACH
    return bool(offset @ np.linalg.pinv(place.covariance, hermitian=True) @ offset <= reach)


def _reach(offsets: Array, covariance: Array, weights: Array) -> float:
    """Return the squared distance, in units of the covariance, within which weighted offsets lie with `SURE`."""
    inverse = np.linalg.pinv(covariance, hermitian=True)
    distances = np.einsum("ni,ij,nj->n", offsets, inverse, offsets)
    order = np.argsort(distances)
    shares = np.cumsum(weights[order], dtype=np.float64)
    return float(distances[order[np.searchsorted(shares, SURE * shares[-1])]])


def _moments(points: Array, weights: Array) -> tuple[Array, Array]:
    """Weighted mean and covariance of points (n, d)."""
    share = weights / weights.sum()
    mean = share @ points
    offsets = points - mean
    return mean, (offsets * share[:, None]).T @ offsets


def _sharpened(
    atlas: Atlas, code: NDArray[np.float32], logs: NDArray[np.float32], seed: int
) -> tuple[Array, Array, Array | None]:
    """Mean and covariance of the position, and voxel probabilities if sampled, interpolated between the poses."""
    kind = atlas.kinds[np.argmax(logs)]  # between objects of two kinds there is nothing to interpolate
    logs = np.where(atlas.kinds == kind, logs, -np.inf)
    count = min(_NEAR, int(np.isfinite(logs).sum()))
    neighbours = np.argpartition(logs, len(logs) - count)[-count:]
    neighbours = neighbours[np.argsort(-logs[neighbours])]
    poses = _aligned(atlas, neighbours)
    free = np.ptp(poses, axis=0) > 0.0
    poses = poses[:, free]
    # The likelihood is raised to a power at which about a quarter of the neighbours contribute.
    tempered = _tempered(logs[neighbours].astype(np.float64), count / 4.0)
    centre, spread = _moments(poses, tempered)
    scale = np.sqrt(np.diag(spread)) + 1e-12 * np.ptp(poses, axis=0)
    terms = _quadratic((poses - centre) / scale)
    root_weights = np.sqrt(tempered)[:, None]
    codes = _parts(atlas, neighbours)
    if atlas.uncertain is not None:  # what scatters is put on the scale of unit noise as well
        factor = np.linalg.cholesky(atlas.uncertain.covariance(neighbours, tempered))
        codes = [np.linalg.solve(factor, codes[0].T).T]
        code = np.linalg.solve(factor, code.astype(np.float64)).astype(np.float32)
    surfaces = [np.linalg.lstsq(terms * root_weights, part * root_weights, rcond=None)[0] for part in codes]
    # The misfit of the surface adds to the noise.
    fitted_codes = [terms @ surface for surface in surfaces]
    residuals = _joined(codes, codes, code) - _joined(fitted_codes, codes, code)
    misfit = tempered @ residuals**2 / tempered.sum()
    effective = tempered.sum() ** 2 / (tempered @ tempered)
    noise = np.sqrt(1.0 + misfit * effective / max(1.0, effective - terms.shape[1]))
    low, high = poses.min(axis=0), poses.max(axis=0)
    rng = np.random.default_rng(seed)
    mean, covariance, voxels = centre, spread, None
    for _ in range(_ROUNDS):
        factor = _WIDER * np.linalg.cholesky(covariance + np.diag((1e-6 * scale) ** 2))
        normal = rng.normal(size=(_DRAWS, len(mean)))
        samples = mean + normal @ factor.T
        inside = ((samples >= low) & (samples <= high)).all(axis=1)
        if inside.sum() <= 2 * len(mean):  # the surface is not valid here: keep the last spread
            break
        samples, normal = samples[inside], normal[inside]
        terms = _quadratic((samples - centre) / scale)
        log_weights = 0.5 * (normal**2).sum(axis=1) + _explained([terms @ s / noise for s in surfaces], code / noise)
        weights = _tempered(log_weights, 4.0 * len(mean))
        mean, covariance = _moments(samples, weights)
        places = np.tile(atlas.positions[neighbours[0]], (len(samples), 1))
        places[:, free[:3]] = samples[:, : int(free[:3].sum())]
        voxels = np.bincount(atlas.grid.voxels(places), weights, atlas.grid.n_voxels) / weights.sum()
    n_free = int(free[:3].sum())
    position, full_covariance = atlas.positions[neighbours[0]].copy(), np.zeros((3, 3))
    position[free[:3]] = mean[:n_free]
    full_covariance[np.ix_(free[:3], free[:3])] = covariance[:n_free, :n_free]
    return position, full_covariance, voxels


def _parts(atlas: Atlas, some: NDArray[np.int64]) -> list[Array]:
    """The codes of some poses; if strengths are unknown, those of the added light and of the hidden light."""
    components = [atlas.codes] if atlas.hiding is None else [atlas.added, atlas.hiding]
    return [part[some].astype(np.float64) for part in components]


def _joined(parts: list[Array], like: list[Array], code: NDArray[np.float32]) -> Array:
    """Codes (n, k) summed from parts, at the mean strengths that the parts ``like`` have for a picture."""
    if len(parts) == 1:
        return parts[0]
    strengths = AmplitudePrior.of(*like).means(like[0] @ code, like[1] @ code)
    return strengths[:, :1] * parts[0] + strengths[:, 1:] * parts[1]


def _explained(parts: list[Array], code: Array) -> Array:
    """Log-likelihood ratio (n,) of each of the codes of parts (n, k) to an empty scene, given a picture."""
    if len(parts) == 1:
        logs: Array = parts[0] @ code - 0.5 * (parts[0] ** 2).sum(axis=1)
    else:
        logs = AmplitudePrior.of(*parts).logs(parts[0] @ code, parts[1] @ code)
    return logs


def _tempered(logs: Array, least: float) -> Array:
    """Likelihoods raised to the largest power up to 1 at which the effective number of weights is ``least``."""
    least = min(least, len(logs) / 2.0)
    relative = logs - logs.max()
    power = 1.0
    for _ in range(40):
        weights = np.exp(power * relative)
        if weights.sum() ** 2 >= least * (weights @ weights):
            break
        power *= 0.75
    tempered: Array = weights
    return tempered


def _aligned(atlas: Atlas, near: NDArray[np.int64]) -> Array:
    """Poses (n, 6) of a few members; those of a sheet, which has equal sides, all on the side of the first."""
    rotations = atlas.rotations[near].copy()
    if atlas.about["targets"][atlas.kinds[near[0]]] == "sheet":
        # Half a turn about z maps the sheet on itself, and reverses the turns about x and y.
        half_turns = np.rint((rotations[:, 2] - rotations[0, 2]) / 180.0)
        rotations[:, 2] -= 180.0 * half_turns
        rotations[:, :2] *= np.where(half_turns % 2 == 0.0, 1.0, -1.0)[:, None]
    return np.concatenate([atlas.positions[near], rotations], axis=1)


def _quadratic(x: Array) -> Array:
    """All terms up to the second degree, (n, terms), of points (n, d)."""
    i, j = np.triu_indices(x.shape[1])
    return np.concatenate([np.ones((len(x), 1)), x, x[:, i] * x[:, j]], axis=1)
