"""Building of an atlas: simulated pictures are compressed to their codes."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from sklearn.utils.extmath import randomized_svd

from classify.inference.atlas import LEFT_OUT, Atlas, noise_of
from classify.inference.uncertain import Backgrounds, fitted
from classify.pictures.sensor import Sensor, factor_between
from generator.files.pictures import Picture
from generator.files.toml import to_dict
from generator.jobs.bulk import Engine
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.sets.bulk_set import Bulk
from generator.sets.readable import check_colours

_FOR_BASIS = 4096
_FIRST = 64
_BLOCK = 2048


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
        A finished set.
    *others : Bulk
        Sets of the same scene with other objects; the object that is looked for may be any of them.
    sensor : Sensor
        If it has no exposure, the brightest pixel of the background and of some thousand pictures defines it.
    lamp_drift : float
        Relative standard deviation of the lamp's strength since the background was taken.
    ambient_drift : float
        Standard deviation of uniform light added to the watched wall since then, in units of the background's mean.
    measured_background : bool
        Whether the background of the pictures is measured too, and hence has noise of its own.
    unknown : bool
        Whether the object's size and albedo count as unknown.
    progress : callable
        Called with (done, total), in pictures.

    Raises
    ------
    NlosError
        If a set is not finished, has no light, a background a picture or several objects, or the sets are not of one
        scene.
    """
    bulks = [bulk, *others]
    if unknown and (mixed := [b for b in bulks if b.plan.unknown]):
        raise NlosError(f"--unknown: {mixed[0].path} is of objects of all sizes and albedos already; leave it out")
    _check_alike(bulks)
    if crowds := [b for b in bulks if b.plan.targets > 1]:
        raise NlosError(f"{crowds[0].path}: shows {crowds[0].plan.targets} objects at once, and an atlas is of one")
    if any(b.plan.uncertain for b in bulks):
        return _of_uncertain(bulks, sensor, lamp_drift, ambient_drift, measured_background, unknown, progress)
    if own := [b for b in bulks if b.backgrounds is not None]:
        raise NlosError(f"{own[0].path}: has a background a picture, and an atlas has one; vary the target alone")
    background = bulk.background
    blacks = [_Black(b) for b in bulks] if unknown else []
    share = math.ceil(_FOR_BASIS / len(bulks))
    sample_rows = [np.unique(np.linspace(0, b.planned - 1, min(b.planned, share)).astype(np.int64)) for b in bulks]
    samples = [_colour(b.pictures[rows]) for b, rows in zip(bulks, sample_rows, strict=True)]
    sample = np.concatenate(samples)
    difference = _Difference(sensor.exposed([background, *sample]), background)
    sensor, differences = difference.sensor, difference(sample)
    if blacks:
        black_pictures = [d(rows, pictures) for d, rows, pictures in zip(blacks, sample_rows, samples, strict=True)]
        hidden = difference(np.concatenate(black_pictures))
        differences = np.concatenate([differences - hidden, hidden])
    basis, left_out = _basis(differences)
    # Possible changes of the light, and the background's own noise, add to the variance of a code.
    spread = 1.0 + (sensor.frames / sensor.background_frames if measured_background else 0.0)
    drifts = [background * (1.0 + lamp_drift)] if lamp_drift else []
    drifts += [background + ambient_drift * background.mean()] if ambient_drift else []
    # So does noise that pixels share: in the mean of the frames, and in the background's.
    noise = difference.shared(background) * math.sqrt(spread)
    nuisances = np.array([*(basis @ difference.of(drifted) for drifted in drifts), *(noise @ basis.T)])
    nuisances = nuisances.reshape(len(drifts) + len(noise), len(basis)).astype(np.float32)
    whitened = np.linalg.solve(np.linalg.cholesky(noise_of(spread, nuisances)), basis).astype(np.float32)
    codes, hiding = _codes(bulks, blacks, difference, whitened, progress)
    return Atlas(
        codes=codes,
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
        about=_about(bulks) | {"lamp_drift": lamp_drift, "ambient_drift": ambient_drift},
        hiding=hiding,
    )


def _of_uncertain(
    bulks: list[Bulk],
    sensor: Sensor,
    lamp_drift: float,
    ambient_drift: float,
    measured_background: bool,
    unknown: bool,
    progress: Callable[[int, int], None],
) -> Atlas:
    """Build an atlas of a set whose scene is drawn at every pose (`classify.inference.uncertain`)."""
    bulk, plan = bulks[0], bulks[0].plan
    if len(bulks) > 1:
        raise NlosError(f"{bulk.path}: is of an uncertain scene, and an atlas takes one such set; leave others out")
    if unknown:
        raise NlosError("--unknown: a set of an uncertain scene says itself how size and albedo vary; leave it out")
    if lamp_drift or ambient_drift:
        raise NlosError("--lamp-drift, --ambient-drift: are of scenes that are known; leave them out")
    if not measured_background:
        raise NlosError(f"{bulk.path}: is of an uncertain scene, whose background has to be measured")
    if sensor.shared_count(bulk.background.shape[:2]):
        raise NlosError(
            f"{bulk.path}: is of an uncertain scene, for which noise of rows and columns and flicker are not "
            "modelled; leave row_noise, column_noise and flicker out of the sensor's file"
        )
    background = bulk.background
    wanted = background.mean(axis=2, dtype=np.float64)
    stated, backgrounds = Engine(bulk, as_stated=True), bulk.backgrounds
    assert backgrounds is not None

    def drawn(rows: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return pictures and backgrounds of drawn scenes, exposed so that all backgrounds are as bright."""
        pictures, empty = _colour(bulk.pictures[rows]), _colour(backgrounds[rows])
        levels = [factor_between(one.mean(axis=2, dtype=np.float64), wanted) for one in empty]
        factors = np.array(levels, dtype=np.float32)[:, None, None, None]
        return pictures * factors, empty * factors

    def as_stated(rows: NDArray[np.int64]) -> NDArray[np.float32]:
        return stated.pictures(rows, bulk.positions[rows], bulk.rotations[rows])

    rows = np.unique(np.linspace(0, bulk.planned - 1, min(bulk.planned, _FOR_BASIS // 2)).astype(np.int64))
    pictures, empty = drawn(rows)
    difference = _Difference(sensor.exposed([background, *pictures]), background)
    sensor = difference.sensor
    shifts = difference(empty).astype(np.float64)
    directions = Backgrounds.of(shifts, sensor.frames / sensor.background_frames)
    basis, left_out = _basis(np.concatenate([difference(pictures) - difference(empty), difference(as_stated(rows))]))
    spread = 1.0 + sensor.frames / sensor.background_frames
    nuisances = np.zeros((0, len(basis)), np.float32)
    whitened = np.linalg.solve(np.linalg.cholesky(noise_of(spread, nuisances)), basis).astype(np.float32)
    codes, changes, places = [], [], []
    for start in range(0, bulk.planned, _BLOCK):
        block = np.arange(start, min(start + _BLOCK, bulk.planned))
        pictures, empty = drawn(block)
        shift = difference(empty)
        codes.append(difference(as_stated(block)) @ whitened.T)
        changes.append((difference(pictures) - shift) @ whitened.T - codes[-1])
        places.append(shift @ directions.basis.T)
        progress(len(block) + start, 2 * bulk.planned)
    mean, uncertain = fitted(
        np.concatenate(changes).astype(np.float64),
        bulk.positions,
        bulk.values,
        np.concatenate(places).astype(np.float64),
        directions,
        lambda done, total: progress(bulk.planned + done * bulk.planned // total, 2 * bulk.planned),
    )
    assert plan.uncertain is not None
    return Atlas(
        codes=np.concatenate(codes) + mean,
        basis=whitened,
        background=wanted,
        nuisances=nuisances,
        spread=spread,
        positions=bulk.positions,
        rotations=bulk.rotations,
        voxels=bulk.voxels,
        kinds=np.zeros(bulk.planned, dtype=np.int64),
        grid=bulk.grid,
        sensor=sensor,
        left_out=left_out,
        about=_about(bulks) | {"lamp_drift": 0.0, "ambient_drift": 0.0, "uncertain": to_dict(plan.uncertain)},
        uncertain=uncertain,
    )


def _about(bulks: list[Bulk]) -> dict[str, object]:
    return {
        "targets": [b.target_kind for b in bulks],
        "sets": [b.path.resolve().name for b in bulks],
        "fingerprints": [b.meta["fingerprint"] for b in bulks],
        "inside": [b.plan.inside for b in bulks],
        "colour_space": bulks[0].colour_space,
    }


class _Difference:
    """Converts pictures to differences from the empty scene, on the scale of a sensor's unit noise."""

    def __init__(self, sensor: Sensor, background: Picture) -> None:
        self.sensor = sensor
        self._empty = sensor.stabilised_mean(background)

    def of(self, picture: Picture) -> Array:
        """Return the difference of one picture, (pixels,)."""
        difference: Array = (self.sensor.stabilised_mean(picture) - self._empty).ravel()
        return difference

    def shared(self, background: Picture) -> Array:
        """Return `Sensor.shared` of the mean of the sensor's frames as differences, (n, pixels)."""
        patterns = self.sensor.shared(background) / math.sqrt(self.sensor.frames)
        differences: Array = (patterns * self.sensor.stabilised_slope(background)).reshape(
            len(patterns), background[..., 0].size
        )
        return differences

    def __call__(self, pictures: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the differences, (n, pixels), of pictures (n, height, width, 3)."""
        return np.asarray([self.of(p) for p in pictures], dtype=np.float32)


def _codes(
    bulks: list[Bulk],
    blacks: list[_Black],
    difference: _Difference,
    basis: NDArray[np.float32],
    progress: Callable[[int, int], None],
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """Codes (n, k) of all pictures, and of the light that a black object hides, if ``blacks`` are given."""
    total, done = sum(b.planned for b in bulks), 0
    codes: list[NDArray[np.float32]] = []
    hiding: list[NDArray[np.float32]] = []
    for index, bulk in enumerate(bulks):
        for start in range(0, bulk.planned, _BLOCK):
            block = slice(start, min(start + _BLOCK, bulk.planned))
            pictures = _colour(bulk.pictures[block])
            codes.append(difference(pictures) @ basis.T)
            if blacks:
                rows = np.arange(block.start, block.stop)
                hiding.append(difference(blacks[index](rows, pictures)) @ basis.T)
            done += len(pictures)
            progress(done, total)
    return np.concatenate(codes), np.concatenate(hiding) if hiding else None


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


class _Black:
    """Computes pictures of a black object, which only hides light, at the poses of a set."""

    def __init__(self, bulk: Bulk) -> None:
        self._engine = Engine(bulk)
        self._bulk = bulk

    def __call__(self, some: NDArray[np.int64], pictures: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the pictures of the black object, given those of the real one, (n, height, width, 3)."""
        bulk = self._bulk
        # The engine computes added light far faster than hidden light, which is what remains of the picture.
        lit = self._engine.pictures(some, bulk.positions[some], bulk.rotations[some], shadows=False)
        return pictures - (lit - bulk.background)


def _basis(sample: NDArray[np.float32]) -> tuple[Array, float]:
    """The fewest orthonormal directions (k, pixels) that span pictures (n, pixels), and the RMS that they leave out.

    The range of the pictures is sampled at random (Halko, Martinsson and Tropp 2011, algorithm 4.4): computing all
    directions would take minutes, and beyond the first few hundred they hold nothing.
    """
    pictures = sample.astype(np.float64)
    total, full_rank = float((pictures**2).sum()), min(pictures.shape)
    count = min(_FIRST, full_rank)
    while True:
        _, singular_values, directions = randomized_svd(pictures, count, n_iter=4, random_state=0)
        remainder = max(total - float((singular_values**2).sum()), 0.0)
        residual = np.sqrt((np.cumsum(singular_values[::-1] ** 2)[::-1] + remainder) / len(pictures))
        if count == full_rank or remainder <= len(pictures) * LEFT_OUT**2:
            break
        count = min(2 * count, full_rank)
    kept = max(1, int((residual > LEFT_OUT).sum()))
    return directions[:kept], float(residual[kept] if kept < len(residual) else math.sqrt(remainder / len(pictures)))


def _colour(pictures: NDArray[np.float32]) -> NDArray[np.float32]:
    """Pictures (..., height, width, 3), with the channel of a grey set (..., height, width) repeated."""
    return pictures if pictures.shape[-1:] == (3,) and pictures.ndim > 3 else pictures[..., None].repeat(3, axis=-1)
