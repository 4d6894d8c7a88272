"""Where a known object stands: a picture's code against those of an atlas, and between them where it is sharp.

Analysis by synthesis, M against S(p) as the paper has it (section 5.1), with every S(p) made before: the posterior
over the atlas' poses is exact as long as several of them explain the picture. Where a picture is so sharp that only a
few do, the codes around them are interpolated by a local quadratic (a response surface: Box and Wilson 1951) and the
posterior is sampled from that by importance sampling. Where even that is too coarse, `polish` asks the engine itself.
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
"""Poses that must share in an answer (effective number: Kish 1965) before the atlas alone gives it."""

SURE = 0.95
"""Probability that a stated region holds the truth."""

_NEAR = 256
_DRAWS = 1500
_ROUNDS = 2
_LEANING = 1e-2
_MOST_STEPS, _SETTLED, _STUCK = 30, 1e-2, 1e4
_ALONE = 3.0
"""Poses (effective number) below which what lies between them decides on the voxel too: more may be apart."""
_WIDER = 1.5
"""Standard deviations of what is drawn, in those of what is sought."""


@dataclass(frozen=True)
class Place:
    """Where an object stands, as far as a picture tells.

    Attributes
    ----------
    voxels : ndarray of shape (n_voxels,)
        Probability of each, if there is an object.
    position : ndarray of shape (3,)
        The posterior's mean, metres.
    covariance : ndarray of shape (3, 3)
        The posterior's, m^2.
    evidence : float
        Logarithm of how much more probable the picture is with the object somewhere than without (a Bayes factor).
    poses : float
        Effective number of the atlas' poses that explain the picture.
    """

    voxels: Array
    position: Array
    covariance: Array
    evidence: float
    poses: float


def locate(atlas: Atlas, code: NDArray[np.float32], *, seed: int = 0, without: int | None = None) -> Place:
    """Return where the object is.

    Parameters
    ----------
    atlas : Atlas
        Its poses are what is thought possible, each as likely as any other.
    code : ndarray of shape (k,)
        Of the picture, from `Atlas.code`.
    seed : int
        Of the sampling.
    without : int, optional
        A pose that is left out: the one that the code was made of, where the atlas is asked about itself.
    """
    logs = atlas.logs(code)
    if without is not None:
        logs[without] = -np.inf
    top = float(logs.max())
    weights = np.exp(logs - top)
    by_voxel = np.bincount(atlas.voxels, weights, atlas.grid.n_voxels).astype(np.float64)
    total = float(by_voxel.sum())
    poses = total**2 / float(weights @ weights)
    voxels = by_voxel / total
    if poses >= ENOUGH:
        some = np.flatnonzero(weights > weights.max() * 1e-7)
        position, covariance = _moments(atlas.positions[some], weights[some])
    else:
        try:
            position, covariance, between = _sharpened(atlas, code, logs, seed)
        except np.linalg.LinAlgError:
            raise NlosError("atlas: its poses and codes cannot be of one scene; make it anew") from None
        voxels = between if between is not None and poses < _ALONE else voxels
    return Place(voxels, position, covariance, top + math.log(total / len(logs)), poses)


@dataclass(frozen=True)
class Fit:
    """A pose that was fitted by the engine.

    Attributes
    ----------
    position, rotation : ndarray of shape (3,)
        Metres; degrees about x, then y, then z.
    covariance : ndarray of shape (k, k)
        Of the position (3), metres, and the rotation about the world's axes (3, if it was fitted), radians.
    misfit : float
        Squared distance of the picture's code from the fitted one: about as many as the code has numbers, less what
        was fitted, if the object is the known one.
    steps : int
        That were tried.
    """

    position: Array
    rotation: Array
    covariance: Array
    misfit: float
    steps: int


class Synthesis:
    """The engine, asked for codes.

    Parameters
    ----------
    atlas : Atlas
    world : World
        That the atlas is of.
    accuracy : float
        Relative, of a picture.
    """

    def __init__(self, atlas: Atlas, world: World, *, accuracy: float = 1e-3) -> None:
        self.atlas = atlas
        height, width = atlas.empty.shape
        world = world.seen_by(width, height)
        self._engine = Transport(world, accuracy=accuracy)
        # A step needs no more than the direction, and derivatives cost a hundred times as much at a tenth of this.
        self._leaning = Transport(world, accuracy=max(accuracy, _LEANING))
        self._background = self._engine.background()

    def code(self, position: Array, rotation: Array) -> Array:
        """Return the code of a pose, (k,): metres; degrees about x, then y, then z."""
        seen = self.atlas.sensor.stabilised_mean(self._background + self._engine.difference(position, rotation))
        code: Array = self.atlas.basis @ (seen - self.atlas.empty).ravel()
        return code

    def slopes(self, position: Array, rotation: Array) -> Array:
        """Return the code's derivatives, (k, 7): position, turn about the world's axes (radians), strength.

        Raises
        ------
        NlosError
            Something stands between the wall and the target: there the engine knows none.
        """
        sensor, made = self.atlas.sensor, self._leaning.render(position, rotation, derivatives=True)
        assert made.derivatives is not None
        # Of 2 sqrt(n + ...), by n: electrons in all frames.
        rise = 2.0 * sensor.frames * sensor.exposure / sensor.stabilised_mean(made.pixels)
        slopes: Array = self.atlas.basis @ (made.derivatives.mean(axis=3) * rise).reshape(7, -1).T
        return slopes


def polish(synthesis: Synthesis, code: NDArray[np.float32], *, starts: int = 3, turning: bool | None = None) -> Fit:
    """Fit the pose to a picture by the engine and its derivatives, from the atlas' best poses.

    Gauss and Newton's steps, damped (Levenberg 1944, Marquardt 1963, equation 10) until they make the fit better.

    Parameters
    ----------
    synthesis : Synthesis
    code : ndarray of shape (k,)
        Of the picture.
    starts : int
        How many of the atlas' poses to start from, the likeliest first, none near another.
    turning : bool, optional
        Whether the rotation is unknown; as in the atlas, if left out.

    Raises
    ------
    NlosError
        The engine knows no derivatives there, since something stands between the wall and the target.
    """
    atlas = synthesis.atlas
    turning = bool(np.ptp(atlas.rotations, axis=0).any()) if turning is None else turning
    logs = atlas.logs(code)
    fits = [_descend(synthesis, code, start, 6 if turning else 3) for start in _apart(atlas, logs, starts)]
    return min(fits, key=lambda fit: fit.misfit)


def _apart(atlas: Atlas, logs: NDArray[np.float32], count: int) -> list[int]:
    """The likeliest poses of which none lies within half a voxel of another."""
    kept: list[int] = []
    left = np.ones(len(logs), dtype=bool)
    near = 0.5 * np.asarray(atlas.grid.size)
    while len(kept) < count and left.any():
        best = int(np.argmax(np.where(left, logs, -np.inf)))
        kept.append(best)
        left &= (np.abs(atlas.positions - atlas.positions[best]) > near).any(axis=1)
    return kept


def _descend(synthesis: Synthesis, code: NDArray[np.float32], start: int, free: int) -> Fit:
    atlas = synthesis.atlas
    position, rotation = atlas.positions[start], atlas.rotations[start]
    apart = code - synthesis.code(position, rotation)
    slopes = synthesis.slopes(position, rotation)[:, :free]
    low, high = atlas.positions.min(axis=0), atlas.positions.max(axis=0)
    damping, misfit, steps = 1e-3, float(apart @ apart), 0
    while steps < _MOST_STEPS:
        steps += 1
        normal = slopes.T @ slopes
        step = np.linalg.lstsq(normal + damping * np.diag(np.diag(normal)), slopes.T @ apart, rcond=None)[0]
        moved = np.clip(position + step[:3], low, high)
        turned = _turned(rotation, step[3:]) if free > 3 else rotation
        try:
            there = code - synthesis.code(moved, turned)
        except NlosError:  # a place where no object can be
            there = np.full_like(apart, np.inf)
        gained = misfit - float(there @ there)
        if gained > 0.0:
            position, rotation, apart, misfit = moved, turned, there, misfit - gained
            damping *= 0.1
            slopes = synthesis.slopes(position, rotation)[:, :free]
        else:
            damping *= 10.0
        if abs(gained) < _SETTLED or damping > _STUCK:
            break
    return Fit(position, rotation, np.linalg.pinv(slopes.T @ slopes, hermitian=True), misfit, steps)


def _turned(rotation: Array, by: Array) -> Array:
    """Angles, degrees about x, then y, then z, after a further turn about the world's axes, radians."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # at a quarter turn about y the other two angles are one, and either will do
        turn = Rotation.from_rotvec(by) * Rotation.from_euler("xyz", rotation, degrees=True)
        angles: Array = turn.as_euler("xyz", degrees=True)
    return angles


def holds(place: Place | Step, position: Vector) -> bool:
    """Whether the region that is stated to hold the object with probability `SURE` holds a position, metres."""
    apart = np.asarray(position) - place.position
    return bool(apart @ np.linalg.pinv(place.covariance, hermitian=True) @ apart <= chi2.ppf(SURE, 3))


def _moments(points: Array, weights: Array) -> tuple[Array, Array]:
    """Weighted mean and covariance of points (n, d)."""
    share = weights / weights.sum()
    mean = share @ points
    apart = points - mean
    return mean, (apart * share[:, None]).T @ apart


def _sharpened(
    atlas: Atlas, code: NDArray[np.float32], logs: NDArray[np.float32], seed: int
) -> tuple[Array, Array, Array | None]:
    """Mean and covariance of the position between the atlas' poses, and the voxels' probabilities if it has any."""
    kind = atlas.kinds[np.argmax(logs)]  # between objects of two kinds there is nothing to interpolate
    logs = np.where(atlas.kinds == kind, logs, -np.inf)
    count = min(_NEAR, int(np.isfinite(logs).sum()))
    near = np.argpartition(logs, len(logs) - count)[-count:]
    near = near[np.argsort(-logs[near])]
    poses = _aligned(atlas, near)
    free = np.ptp(poses, axis=0) > 0.0
    poses = poses[:, free]
    # The likelihood raised to a power that lets about a quarter of the neighbours share.
    tempered = _tempered(logs[near].astype(np.float64), count / 4.0)
    centre, spread = _moments(poses, tempered)
    scale = np.sqrt(np.diag(spread)) + 1e-12 * np.ptp(poses, axis=0)
    terms = _quadratic((poses - centre) / scale)
    root = np.sqrt(tempered)[:, None]
    codes = _parts(atlas, near)
    surfaces = [np.linalg.lstsq(terms * root, part * root, rcond=None)[0] for part in codes]
    # What the surface misses is uncertainty too, beside the noise.
    drawn_codes = [terms @ surface for surface in surfaces]
    apart = _joined(codes, codes, code) - _joined(drawn_codes, codes, code)
    missed = tempered @ apart**2 / tempered.sum()
    sharing = tempered.sum() ** 2 / (tempered @ tempered)
    noise = np.sqrt(1.0 + missed * sharing / max(1.0, sharing - terms.shape[1]))
    low, high = poses.min(axis=0), poses.max(axis=0)
    rng = np.random.default_rng(seed)
    mean, covariance, voxels = centre, spread, None
    for _ in range(_ROUNDS):
        factor = _WIDER * np.linalg.cholesky(covariance + np.diag((1e-6 * scale) ** 2))
        normal = rng.normal(size=(_DRAWS, len(mean)))
        drawn = mean + normal @ factor.T
        inside = ((drawn >= low) & (drawn <= high)).all(axis=1)
        if inside.sum() <= 2 * len(mean):  # the surface does not hold here: the neighbours' own spread has to do
            break
        drawn, normal = drawn[inside], normal[inside]
        terms = _quadratic((drawn - centre) / scale)
        log = 0.5 * (normal**2).sum(axis=1) + _explained([terms @ s / noise for s in surfaces], code / noise)
        shares = _tempered(log, 4.0 * len(mean))
        mean, covariance = _moments(drawn, shares)
        places = np.tile(atlas.positions[near[0]], (len(drawn), 1))
        places[:, free[:3]] = drawn[:, : int(free[:3].sum())]
        voxels = np.bincount(atlas.grid.voxels(places), shares, atlas.grid.n_voxels) / shares.sum()
    placed = int(free[:3].sum())
    position, uncertain = atlas.positions[near[0]].copy(), np.zeros((3, 3))
    position[free[:3]] = mean[:placed]
    uncertain[np.ix_(free[:3], free[:3])] = covariance[:placed, :placed]
    return position, uncertain, voxels


def _parts(atlas: Atlas, some: NDArray[np.int64]) -> list[Array]:
    """The codes of some poses; where strengths are unknown, of what is added and of what is hidden."""
    every = [atlas.codes] if atlas.hiding is None else [atlas.added, atlas.hiding]
    return [part[some].astype(np.float64) for part in every]


def _joined(parts: list[Array], like: list[Array], code: NDArray[np.float32]) -> Array:
    """Codes of parts (n, k) at the strengths that a picture asks of others like them."""
    if len(parts) == 1:
        return parts[0]
    found = AmplitudePrior.of(*like).means(like[0] @ code, like[1] @ code)
    return found[:, :1] * parts[0] + found[:, 1:] * parts[1]


def _explained(parts: list[Array], code: Array) -> Array:
    """How much better each of the codes of parts (n, k) explains a picture than an empty scene, logarithms (n,)."""
    if len(parts) == 1:
        logs: Array = parts[0] @ code - 0.5 * (parts[0] ** 2).sum(axis=1)
    else:
        logs = AmplitudePrior.of(*parts).logs(parts[0] @ code, parts[1] @ code)
    return logs


def _tempered(logs: Array, least: float) -> Array:
    """Weights of log-likelihoods, raised to the largest power up to 1 that leaves ``least`` of them effective."""
    least = min(least, len(logs) / 2.0)
    relative = logs - logs.max()
    power = 1.0
    for _ in range(40):
        weights = np.exp(power * relative)
        if weights.sum() ** 2 >= least * (weights @ weights):
            break
        power *= 0.75
    made: Array = weights
    return made


def _aligned(atlas: Atlas, near: NDArray[np.int64]) -> Array:
    """Poses (n, 6) of a few members; a sheet's, which looks the same from behind, all from the side of the first."""
    rotations = atlas.rotations[near].copy()
    if atlas.about["targets"][atlas.kinds[near[0]]] == "sheet":
        # Half a turn about z maps the sheet on itself, and turns x and y around.
        behind = np.rint((rotations[:, 2] - rotations[0, 2]) / 180.0)
        rotations[:, 2] -= 180.0 * behind
        rotations[:, :2] *= np.where(behind % 2 == 0.0, 1.0, -1.0)[:, None]
    return np.concatenate([atlas.positions[near], rotations], axis=1)


def _quadratic(x: Array) -> Array:
    """All terms up to the second degree, (n, terms), of points (n, d)."""
    i, j = np.triu_indices(x.shape[1])
    return np.concatenate([np.ones((len(x), 1)), x, x[:, i] * x[:, j]], axis=1)
