"""Poses of the hidden object, drawn inside voxels, each from its own seed.

A pose depends on (sweep seed, voxel, index) alone, so shards, their order, resuming, and asking for more poses later
do not change it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.model.arrays import Array, Vector, rotation_matrix, rotation_rows
from generator.model.errors import NlosError, require
from generator.model.grid import VoxelGrid
from generator.model.settings import Sweep
from generator.model.variation import VARIABLES, Values
from generator.model.variation import draw as draw_values

Pose = tuple[Vector, Vector]

_TRIES = 256
_TRIES_TURNING = 102_400
_FIRST_BLOCK = 128
_NUMBERS = 7
"""Random numbers that one try takes: three for the rotation, one for keeping it, three for the place."""

_CROWD = 3000
"""Start of the numbers of the streams that the objects besides the first are drawn from."""

_PROBES = 32

_MARGIN = 1e-5
"""Tolerance of the screening, in voxels: larger than any rounding error, and so small that few more tries pass."""

_HUGE = 10.0
"""A target this many times larger than its voxel is probably of a file in millimetres or inches."""

_SEED_BITS = 31


def noise_seed(sweep_seed: int, position: int) -> int:
    """Return the renderer's seed at one position of a sweep.

    It is distinct for every position by construction: the position plus an offset that follows from the sweep's seed,
    modulo 2^31. (With hashes alone, two of 900 poses would share their noise once in 5,000 sweeps.)
    """
    offset = int(np.random.SeedSequence([sweep_seed]).generate_state(1, np.uint64)[0])
    return int((offset + position) % 2**_SEED_BITS)


def plan(
    grid: VoxelGrid, sweep: Sweep, hull: Array, is_free: Callable[[Vector, Vector], bool] = lambda *_: True
) -> list[PoseRecord]:
    """Draw every pose of a sweep.

    Parameters
    ----------
    grid : VoxelGrid
    sweep : Sweep
    hull : ndarray of shape (n, 3)
        Points of the target relative to its origin, unrotated, metres; their convex hull holds the target.
    is_free : callable
        Returns whether the target, at a position and rotation, is clear of every surface of the scene.

    Returns
    -------
    list of PoseRecord
        Sorted by index, then by voxel, so that a sweep that is cut short has seen every voxel.

    Raises
    ------
    NlosError
        The target does not fit into a voxel.
    """
    labels = grid.labels
    sampler, crowd = Sampler(grid, sweep, hull, is_free), Crowd(grid, sweep, hull, is_free)
    records = []
    for index in range(sweep.poses):
        for voxel, label in enumerate(labels):
            position, rotation = sampler.draw(voxel, index)
            # Position 0 belongs to the background.
            seed = noise_seed(sweep.seed, 1 + index * grid.n_voxels + voxel)
            values = draw_values(sweep.variations, sweep.seed, voxel, index)
            others, file = crowd.draw(voxel, index, position), f"{label}/{index:04d}.exr"
            place = (position, rotation)
            records.append(PoseRecord(index, voxel, label, *place, seed, file=file, values=values, others=others))
    return records


def draw(
    grid: VoxelGrid,
    voxel: int,
    index: int,
    sweep: Sweep,
    hull: Array,
    is_free: Callable[[Vector, Vector], bool] = lambda *_: True,
) -> Pose:
    """Draw one pose, uniform over all position-and-rotation pairs that the sweep allows.

    Returns
    -------
    position : (float, float, float)
        Position of the target's origin, metres.
    rotation : (float, float, float)
        Angles about x, y, z, degrees.

    Raises
    ------
    NlosError
        No such pose was found: the target does not fit.
    """
    return Sampler(grid, sweep, hull, is_free).draw(voxel, index)


class Sampler:
    """Draws poses as `draw` does, but computes only once what all poses have in common.

    Where a large target turns in a small voxel, hundreds of tries fail for each that succeeds, so tries are screened
    in blocks with a few points of the hull: these reach no farther than the whole hull, so a try that they rule out
    would fail. The remaining tries are drawn again, one by one, with the exact arithmetic, so no pose depends on the
    screening.

    Parameters
    ----------
    grid, sweep, hull, is_free
        As for `plan`.
    stream : int
        Which poses the seed draws: 0 those of a sweep; other kinds of set have their own, so that the same seed does
        not give a set to learn from and a set to test on the same poses.
    """

    def __init__(
        self,
        grid: VoxelGrid,
        sweep: Sweep,
        hull: Array,
        is_free: Callable[[Vector, Vector], bool] = lambda *_: True,
        *,
        stream: int = 0,
    ) -> None:
        self._grid = grid
        self._stream = [stream] if stream else []
        self._sweep = sweep
        self._extent = np.ptp(hull, axis=0)
        self._is_free = is_free
        self._limits = np.asarray(sweep.rotation)
        self._turns = bool(self._limits.any())
        whole = sweep.inside == "whole"
        self._hull = hull if whole else np.zeros((1, 3))
        self._screened = self._turns and whole
        # Without rotation, or for a single point, the bounding box is the same for every try.
        self._box = None if self._screened else _box(self._hull)
        self._probes = _spread(self._hull) if self._screened else self._hull
        self._bounds: dict[int, tuple[Array, Array]] = {}

    def draw(self, voxel: int, index: int) -> Pose:
        """Draw one pose; see `poses.draw`."""
        if voxel not in self._bounds:
            self._bounds[voxel] = self._grid.bounds(voxel)
        lo, hi = self._bounds[voxel]
        rng = np.random.default_rng([self._sweep.seed, voxel, index, *self._stream])
        pose = self._draw_screened(rng, lo, hi) if self._screened else self._draw_plainly(rng, lo, hi)
        if pose is None:
            extent, size = self._extent, hi - lo
            ways = ["a smaller target", "larger voxels"]
            if self._turns:
                ways.append("smaller turns (--rotation 0 0 0)")
            if self._sweep.inside == "whole":
                ways.append("only its centre inside (--inside centre)")
            unit = " (a mesh's unit is the metre; target.size scales it)" if (extent > _HUGE * size).any() else ""
            raise NlosError(
                f"voxel {self._grid.labels[voxel]}: found no place for the target ({extent[0]:.3g} x {extent[1]:.3g} "
                f"x {extent[2]:.3g} m) in {size[0]:.3g} x {size[1]:.3g} x {size[2]:.3g} m clear of all "
                f"surfaces and hidden from lamp and camera; take {', or '.join(ways)}{unit}"
            )
        return pose

    def _draw_plainly(self, rng: np.random.Generator, lo: Array, hi: Array) -> Pose | None:
        for _ in range(_TRIES_TURNING if self._turns else _TRIES):
            if pose := self._try(rng, lo, hi):
                return pose
        return None

    def _draw_screened(self, rng: np.random.Generator, lo: Array, hi: Array) -> Pose | None:
        bits: Any = rng.bit_generator
        tried, block = 0, _FIRST_BLOCK
        while tried < _TRIES_TURNING:
            block = min(block, _TRIES_TURNING - tried)
            candidates = self._screen(rng.random((block, _NUMBERS)), lo, hi)
            current = block
            for candidate in candidates.tolist():
                bits.advance((candidate - current) * _NUMBERS)
                if pose := self._try(rng, lo, hi):
                    return pose
                current = candidate + 1
            bits.advance((block - current) * _NUMBERS)
            tried += block
            block *= 2
        return None

    def _screen(self, numbers: Array, lo: Array, hi: Array) -> NDArray[np.int64]:
        """Return the numbers of the tries that may succeed: all that do, and a few that do not."""
        size = hi - lo
        angles = np.radians(self._limits[:, None] * (2.0 * numbers[:, :3].T - 1.0))
        room = np.ones(len(numbers))
        for axis, row in enumerate(rotation_rows(angles)):
            reach = self._probes @ np.stack(row)
            room *= np.maximum(1.0 - (reach.max(axis=0) - reach.min(axis=0)) / size[axis] + _MARGIN, 0.0)
        candidates: NDArray[np.int64] = np.flatnonzero((room > 0.0) & (numbers[:, 3] <= room + _MARGIN))
        return candidates

    def _try(self, rng: np.random.Generator, lo: Array, hi: Array) -> Pose | None:
        """Draw rotation and place, and return them if the target fits there."""
        rotation = rng.uniform(-self._limits, self._limits)
        # The transposed copy has the same numbers, and its minima are found ten times as fast.
        reach = self._box or _box(self._hull @ rotation_matrix(tuple(rotation)).T)
        low, high = lo - reach[0], hi - reach[1]
        # A sheet as wide as its voxel fits exactly; float32 vertices must not make it too wide.
        room = high - low + 1e-6 * (hi - lo)
        u_accept, u_place = rng.uniform(), rng.uniform(size=3)
        if (room < 0).any():
            return None
        # Rotations that leave more room to stand must come up more often, or the poses would not be uniform.
        if self._turns and u_accept > math.prod(room / (hi - lo)) / (1 + 1e-6) ** 3:
            return None
        x, y, z = (float(v) for v in low + u_place * np.maximum(high - low, 0.0))
        pose: Pose = ((x, y, z), (float(rotation[0]), float(rotation[1]), float(rotation[2])))
        return pose if self._is_free(*pose) else None


class Crowd:
    """Draws the poses of the hidden objects besides the first, each in a voxel of its own.

    Objects whose spheres about their origins would meet are drawn again, so none cut one another; where all of each
    must lie in its voxel, none can.

    Parameters
    ----------
    grid, sweep, hull, is_free, stream
        As for `Sampler`.
    """

    def __init__(
        self,
        grid: VoxelGrid,
        sweep: Sweep,
        hull: Array,
        is_free: Callable[[Vector, Vector], bool] = lambda *_: True,
        *,
        stream: int = 0,
    ) -> None:
        require(
            sweep.targets <= grid.n_voxels,
            f"targets: {sweep.targets} do not fit into {grid.n_voxels} voxels, of which each has one of its own",
        )
        self._grid, self._sweep, self._stream = grid, sweep, stream
        self._samplers = [
            Sampler(grid, sweep, hull, is_free, stream=_CROWD + 2 * k + stream) for k in range(sweep.targets - 1)
        ]
        radius = float(np.linalg.norm(hull, axis=1).max(initial=0.0))
        self._apart = 0.0 if sweep.inside == "whole" else 2.0 * radius

    def draw(self, voxel: int, index: int, position: Vector) -> tuple[Other, ...]:
        """Return the other objects of the picture whose first is at a position in a voxel.

        Raises
        ------
        NlosError
            There is no place that is far enough from the others.
        """
        if not self._samplers:
            return ()
        grid = self._grid
        rng = np.random.default_rng([self._sweep.seed, voxel, index, _CROWD, self._stream])
        free = [other for other in range(grid.n_voxels) if other != voxel]
        chosen = [int(v) for v in rng.permutation(free)[: len(self._samplers)]]
        placed, found = [np.array(position)], []
        for sampler, home in zip(self._samplers, chosen, strict=True):
            for attempt in range(_TRIES):
                # A number that no other picture has, or two pictures would share the pose.
                number = (index * grid.n_voxels + voxel) * _TRIES + attempt
                place, turn = sampler.draw(home, number)
                if all(np.linalg.norm(np.array(place) - p) >= self._apart for p in placed):
                    break
            else:
                raise NlosError(
                    f"targets: found no place in voxel {grid.labels[home]} clear of the other objects; ask for "
                    "fewer, or keep all of each in its voxel (--inside whole)"
                )
            placed.append(np.array(place))
            found.append(Other(home, grid.labels[home], place, turn))
        return tuple(found)


def experiment(number: int, centre: Vector, *, step: float, turn: float = 15.0, steps: int = 2) -> list[list[Pose]]:
    """Return the poses of one of the paper's experiments (section 5.1): a row per axis, the rest pose in its middle.

    Parameters
    ----------
    number : {1, 2, 3}
        1 and 2 move the object (a sphere, a sheet) along x, y and z; 3 turns it about them.
    centre : (float, float, float)
        Rest position of the object, metres.
    step : float
        Distance from one place to the next, metres.
    turn : float
        Angle from one rotation to the next, degrees.
    steps : int
        Number of steps to each side of the rest pose.

    Raises
    ------
    NlosError
        There is no such experiment.
    """
    if number not in (1, 2, 3):
        raise NlosError(f"experiment {number}: there is none; choose 1, 2 or 3")
    rows: list[list[Pose]] = []
    for axis in range(3):
        row: list[Pose] = []
        for k in range(-steps, steps + 1):
            place, rotation = list(centre), [0.0, 0.0, 0.0]
            if number == 3:
                rotation[axis] = k * turn
            else:
                place[axis] += k * step
            row.append(((place[0], place[1], place[2]), (rotation[0], rotation[1], rotation[2])))
        rows.append(row)
    return rows


def trajectory(
    grid: VoxelGrid, sweep: Sweep, hull: Array, is_free: Callable[[Vector, Vector], bool] = lambda *_: True
) -> list[PoseRecord]:
    """Draw a path through the voxels: straight from one random pose to the next, at constant speed.

    Parameters
    ----------
    grid, sweep, hull, is_free
        As for `plan`; the target is clear of every surface all along each leg.

    Returns
    -------
    list of PoseRecord
        One per frame; voxel and label are those of the voxel that holds the target's origin.

    Raises
    ------
    NlosError
        The target fits nowhere, or no free leg leads on from where it is.
    """
    labels, centred = grid.labels, replace(sweep, inside="centre")
    sampler = Sampler(grid, centred, hull, is_free)
    rng = np.random.default_rng([sweep.seed, grid.n_voxels])
    drawn = 0

    def random_pose() -> tuple[Array, Array]:
        nonlocal drawn
        drawn += 1
        place, turn = sampler.draw(int(rng.integers(grid.n_voxels)), drawn)
        return np.array(place), np.array(turn)

    place, turn = random_pose()
    path = [(place, turn)]
    while len(path) < sweep.frames:
        for _ in range(_TRIES):
            goal, goal_turn = random_pose()
            steps = math.ceil(float(np.linalg.norm(goal - place)) / sweep.pace)
            fractions = np.minimum(np.arange(1, steps + 1) * sweep.pace / np.linalg.norm(goal - place), 1.0)[:, None]
            leg = list(zip(place + fractions * (goal - place), turn + fractions * (goal_turn - turn), strict=True))
            if all(is_free(_vector(p), _vector(r)) for p, r in leg):
                break
        else:
            raise NlosError("trajectory: found no way on for the target, clear of all surfaces and hidden all along")
        path += leg
        place, turn = leg[-1]
    records = []
    for index, (place, turn) in enumerate(path[: sweep.frames]):
        voxel = grid.voxel(place)
        file = f"frames/{index:05d}.exr"
        seed = noise_seed(sweep.seed, 1 + index)
        records.append(PoseRecord(index, voxel, labels[voxel], _vector(place), _vector(turn), seed, file=file))
    return records


def along(
    grid: VoxelGrid, sweep: Sweep, path: Sequence[Pose], is_free: Callable[[Vector, Vector], bool] = lambda *_: True
) -> list[PoseRecord]:
    """Return the frames of a path that is given, such as that of an animated target.

    Parameters
    ----------
    grid, sweep, is_free
        As for `plan`; the sweep's ``timeline`` numbers the frames.
    path : sequence of ((float, float, float), (float, float, float))
        Position, metres, and rotation, degrees, of each frame.

    Raises
    ------
    NlosError
        The target leaves the hidden volume, or is not clear of every surface and hidden; the frame is named.
    """
    first, last, step = sweep.timeline
    records = []
    numbers = range(first, last + 1, step)
    for index, (number, (place, turn)) in enumerate(zip(numbers, path, strict=True)):
        where = ", ".join(f"{x:.3g}" for x in place)
        if not all(low <= x <= high for low, x, high in zip(grid.lo, place, grid.hi, strict=True)):
            raise NlosError(f"frame {number}: the target, at {where} m, is outside the hidden voxels")
        if not is_free(place, turn):
            raise NlosError(
                f"frame {number}: the target, at {where} m, cuts a surface, or is in sight of the lamp or the camera"
            )
        voxel, file = grid.voxel(np.asarray(place)), f"frames/{index:05d}.exr"
        seed = noise_seed(sweep.seed, 1 + index)
        records.append(PoseRecord(index, voxel, grid.labels[voxel], place, turn, seed, file=file))
    return records


def _vector(values: Array) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _box(points: Array) -> tuple[Array, Array]:
    """Return the lowest and the highest corner of the box around points (n, 3)."""
    axes = np.ascontiguousarray(points.T)
    return axes.min(axis=1), axes.max(axis=1)


def _spread(points: Array) -> Array:
    """Return the points that lie farthest out in each of a few directions."""
    if len(points) <= _PROBES:
        return points
    # A Fibonacci lattice: directions that are spread evenly over the sphere.
    steps = np.arange(_PROBES)
    z = 1.0 - (2.0 * steps + 1.0) / _PROBES
    turn = steps * math.pi * (3.0 - math.sqrt(5.0))
    ring = np.sqrt(1.0 - z * z)
    directions = np.stack([ring * np.cos(turn), ring * np.sin(turn), z])
    farthest: Array = points[np.unique((points @ directions).argmax(axis=0))]
    return farthest


_PLANNED = ("index", "voxel", "label", "x", "y", "z", "rx", "ry", "rz", "seed", "file")
_RENDERED = ("pixel_hash", "seconds", "samples")


def pose_columns(poses: Sequence[PoseRecord]) -> list[str]:
    """Return the columns of ``poses.csv``: those of every set, and in the middle what varies in this one."""
    first = poses[:1]
    others = [name for pose in first for k in range(len(pose.others)) for name in _of_other(k)]
    return [*_PLANNED, *others, *(name for pose in first for name, _ in pose.values), *_RENDERED]


def _of_other(k: int) -> list[str]:
    """Return the columns of the k-th object besides the first: ``voxel2``, ``label2``, ``x2`` ... for k = 0."""
    return [f"{name}{k + 2}" for name in _PLANNED[1:9]]


@dataclass(frozen=True)
class Other:
    """A hidden object besides the first; attributes as of `PoseRecord`."""

    voxel: int
    label: str
    position: Vector
    rotation: Vector


@dataclass(frozen=True)
class PoseRecord:
    """One row of ``poses.csv``.

    Attributes
    ----------
    index : int
        Index of the pose within its voxel.
    voxel, label : int, str
        Number and name of the voxel that the target stands in.
    position : (float, float, float)
        Position of the target's origin, metres.
    rotation : (float, float, float)
        Euler angles about x, then y, then z, degrees.
    seed : int
        Seed of the renderer's noise, 31 bits.
    file : str
        Path of the picture, relative to the data set's folder.
    pixel_hash : str
        Hash of the pixels; empty until the picture is rendered.
    seconds : float
        Time spent on rendering the picture.
    samples : int
        Camera rays per pixel.
    values : tuple of (str, float)
        Names and values of what varies from pose to pose (`generator.model.variation`).
    others : tuple of Other
        The hidden objects besides the first, if there are several.
    """

    index: int
    voxel: int
    label: str
    position: Vector
    rotation: Vector
    seed: int
    file: str
    pixel_hash: str = ""
    seconds: float = 0.0
    samples: int = 0
    values: Values = ()
    others: tuple[Other, ...] = ()

    @property
    def answer(self) -> str:
        """Names of all voxels that hold an object, such as A+C, in the order of their numbers."""
        held = sorted([(self.voxel, self.label), *((other.voxel, other.label) for other in self.others)])
        return "+".join(label for _, label in held)

    @property
    def placed(self) -> bool:
        """Whether the object's position is known; of a measured picture it may not be."""
        return math.isfinite(self.position[0])

    @property
    def background_file(self) -> str:
        """Path of the picture without the target, relative to the data set's folder, of a set that has one a pose."""
        return f"{self.file.removesuffix('.exr')}-background.exr"

    @property
    def plan(self) -> tuple[Any, ...]:
        """The planned values, without those that rendering added."""
        place = (self.voxel, self.label, self.position, self.rotation)
        return self.index, *place, self.seed, self.file, self.values, self.others

    @property
    def planned_row(self) -> list[str]:
        """The planned values as strings, in the manifest's order; floats keep every digit."""
        plan: list[Any] = [self.index, self.voxel, self.label, *self.position, *self.rotation, self.seed, self.file]
        for other in self.others:
            plan += [other.voxel, other.label, *other.position, *other.rotation]
        plan += [value for _, value in self.values]
        return [repr(float(v)) if isinstance(v, float) else str(v) for v in plan]

    @property
    def done(self) -> bool:
        """Whether the picture has been rendered."""
        return bool(self.pixel_hash)

    def row(self) -> list[str]:
        """Return the record as strings, in the manifest's order (`pose_columns`)."""
        result = [self.pixel_hash, f"{self.seconds:.3f}", self.samples] if self.done else ["", "", ""]
        return [*self.planned_row, *map(str, result)]

    @classmethod
    def from_row(cls, row: Mapping[str, str]) -> PoseRecord:
        """Return the record of a manifest's row; ValueError or KeyError if the row is not valid."""
        others = _others(row)
        if set(row) - {*_PLANNED, *VARIABLES, *_RENDERED} - {n for k in range(len(others)) for n in _of_other(k)}:
            raise ValueError("it has more columns than this software writes")
        file = row["file"]
        if Path(file).is_absolute() or ".." in Path(file).parts:
            raise ValueError(f"file {file!r} lies outside the data set")
        x, y, z, rx, ry, rz = (float(row[name]) for name in ("x", "y", "z", "rx", "ry", "rz"))
        values = tuple((name, float(text)) for name, text in row.items() if name in VARIABLES)
        more = [*(v for _, v in values), *(v for other in others for v in (*other.position, *other.rotation))]
        if not all(map(math.isfinite, (x, y, z, rx, ry, rz, *more))):
            raise ValueError("its place, its rotation or a value is not finite")
        return cls(
            index=int(row["index"]),
            voxel=int(row["voxel"]),
            label=row["label"],
            position=(x, y, z),
            rotation=(rx, ry, rz),
            seed=int(row["seed"]),
            file=file,
            pixel_hash=row["pixel_hash"],
            seconds=float(row["seconds"] or 0.0),
            samples=int(row["samples"] or 0),
            values=values,
            others=others,
        )


def _others(row: Mapping[str, str]) -> tuple[Other, ...]:
    """Return the objects besides the first in a row of ``poses.csv``."""
    others: list[Other] = []
    while _of_other(len(others))[0] in row:
        voxel, label, x, y, z, rx, ry, rz = (row[name] for name in _of_other(len(others)))
        place, turn = (float(x), float(y), float(z)), (float(rx), float(ry), float(rz))
        others.append(Other(int(voxel), label, place, turn))
    return tuple(others)
