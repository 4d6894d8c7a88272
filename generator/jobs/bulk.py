"""Rendering of bulk sets by several processes, and the engine that renders their pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from generator.jobs.local import start_words
from generator.jobs.protocol import PlanBulk, RenderBulk
from generator.jobs.request import BulkRequest
from generator.jobs.workers import WorkerPool, planned_notes
from generator.model.arrays import Array, rotation_matrix
from generator.model.errors import NlosError
from generator.model.quantities import Progress
from generator.model.uncertainty import ATTEMPTS, SALT, offsets
from generator.model.variation import VARIABLES, value_in
from generator.sets import links
from generator.sets.bulk_part import Pictures
from generator.sets.bulk_set import Bulk, check_free
from generator.sets.resume import check_same
from generator.sets.unknown_furniture import unknown_furniture
from generator.sets.unknown_objects import unknown_object
from generator.transport.caching import compiling_words
from generator.transport.parameters import with_parameters
from generator.transport.world import Body, Sphere, World

if TYPE_CHECKING:
    from generator.transport import Gains, Transport

GAINS = ("target", "wall", "room", "lamp")
"""Fields of `generator.transport.Gains`, in the order of `VARIABLES`."""


@dataclass
class Outcome:
    """What a run did.

    Attributes
    ----------
    bulk : Bulk
    rendered : int
        Pictures made by this run.
    failed : list of str
        Parts that could not be made, each with its reason.
    remaining : int
        Pictures of the whole set, other shards' included, that are not rendered yet.
    """

    bulk: Bulk
    rendered: int = 0
    failed: list[str] = field(default_factory=list)
    remaining: int = 0


def run(
    request: BulkRequest,
    *,
    progress: Progress = lambda done, total: None,
    tell: Callable[[str], None] = lambda words: None,
) -> Outcome:
    """Render a bulk set, or the parts that are missing.

    Parameters
    ----------
    request : BulkRequest
        Set to render.
    progress : callable
        Called with (done, total) pictures of this run.
    tell : callable
        Called with messages: that the engine is being compiled, what the check of a new set's scene found, and what
        the check of its engine at the start found.

    Returns
    -------
    Outcome
        The set, and what this run did.

    Raises
    ------
    NlosError
        The input is bad, the check finds an error, the engine cannot honour the scene, or the set at that path was
        made with other settings.
    """
    with links.trusting(request.trust_links):
        return _run(request, progress, tell)


def _run(request: BulkRequest, progress: Progress, tell: Callable[[str], None]) -> Outcome:
    path, (index, count) = request.path, request.shard
    if words := compiling_words("surfel"):
        tell(words)
    new = not Bulk.exists(path)
    if new:
        for words in _plan(request):
            tell(words)
    bulk = Bulk.open(path)
    if new and (words := start_words(bulk)):
        tell(words)
    check_same(bulk, request.scene, request.chosen)
    if not 0 <= index < count:
        raise NlosError(f"--shard {index}/{count}: must be i/n with i from 0 to n - 1")
    pending = [number for number in bulk.missing() if number % count == index]
    outcome = Outcome(bulk)
    if pending:
        trust = links.trusted()  # read here, since other threads start the workers
        crew = WorkerPool(
            lambda threads: RenderBulk(path=path, threads=threads, trust_links=trust),
            lambda number: bulk.part_path(number).name,
            progress,
            size=lambda number: len(bulk.part_range(number)),
        )
        crew.work(pending, request.workers)
        outcome.failed = crew.failed
    missing = set(bulk.missing())
    outcome.rendered = sum(len(bulk.part_range(number)) for number in pending if number not in missing)
    outcome.remaining = sum(len(bulk.part_range(number)) for number in missing)
    if not missing:
        bulk.finish()
    return outcome


def _plan(request: BulkRequest) -> list[str]:
    if not request.scene.is_file():
        raise NlosError(f"{request.scene}: no such scene file")
    if "pictures" not in request.chosen:
        raise NlosError(f"{request.path}: is a new set, so say how many pictures it shall hold with --pictures N")
    check_free(request.path)
    return planned_notes(
        PlanBulk(
            scene=request.scene,
            path=request.path,
            chosen=dict(request.chosen),
            force=request.force,
            probe=request.probe,
            trust_links=links.trusted(),
        )
    )


class Engine:
    """The engine that renders the pictures of a set.

    Parameters
    ----------
    bulk : Bulk
    threads : int
        Threads of the engine; 0 takes all cores.
    as_stated : bool
        Whether `pictures` are of the scene as it is stated, although it is uncertain.
    """

    def __init__(self, bulk: Bulk, *, threads: int = 0, as_stated: bool = False) -> None:
        from generator.transport import Transport  # imported here: readers of sets need no compiler

        plan = bulk.plan
        self._bulk = bulk
        self._varies = bool(bulk.plan.vary)
        self._make = partial(Transport, accuracy=plan.accuracy, threads=threads)
        self._world = bulk.world().seen_by(*plan.resolution)
        several = plan.unknown or plan.targets > 1 or (plan.uncertain and not as_stated)
        self._known = None if several else self._make(self._world)
        self._last: Transport | None = None

    def pictures(
        self, numbers: NDArray[np.int64], positions: Array, rotations: Array, *, shadows: bool = True
    ) -> Pictures:
        """Return pictures (n, height, width, 3), W/m^2/sr.

        Parameters
        ----------
        numbers : ndarray of shape (n,), int
            Numbers of the pictures, in order.
        positions, rotations : ndarray of shape (n, 3)
            Metres, degrees; of several objects, (n, objects, 3).
        shadows : bool
            As for `generator.transport.Transport.pictures`.
        """
        if self._varies:
            return self.varied(numbers, positions, rotations, shadows=shadows)[0]
        batches = [
            transport.pictures(*poses, shadows=shadows)
            for transport, rows, poses in self._transports(numbers, positions, rotations)
        ]
        return np.concatenate(batches)

    def varied(
        self, numbers: NDArray[np.int64], positions: Array, rotations: Array, *, shadows: bool = True
    ) -> tuple[Pictures, Pictures]:
        """Return pictures as `pictures` does, and the background of each, of a set in which something varies."""
        batches = [
            transport.varied(*poses, self._gains(numbers[rows]), shadows=shadows)
            for transport, rows, poses in self._transports(numbers, positions, rotations)
        ]
        pictures, backgrounds = (np.concatenate(parts) for parts in zip(*batches, strict=True))
        return pictures, backgrounds

    def uncertain(
        self, numbers: NDArray[np.int64], positions: Array, rotations: Array
    ) -> tuple[Pictures, Pictures, Array]:
        """Return pictures and backgrounds of a set whose scene is uncertain, and the values (n, names) of each scene.

        Raises
        ------
        NlosError
            Hardly any scene that is drawn has room for a target.
        """
        width, height = self._bulk.plan.resolution
        pictures, backgrounds = np.empty((2, len(numbers), height, width, 3), dtype=np.float32)
        values = np.empty((len(numbers), len(self._bulk.plan.varying)))
        for row, number in enumerate(numbers.tolist()):
            pose = positions[row], rotations[row]
            pictures[row], backgrounds[row], values[row] = self._drawn(number, *pose)
        return pictures, backgrounds, values

    def _drawn(self, number: int, position: Array, rotation: Array) -> tuple[Pictures, Pictures, list[float]]:
        """Return the picture and the background of the first scene drawn for a pose that has room, and its values."""
        bulk, (index, voxel) = self._bulk, divmod(number, self._bulk.grid.n_voxels)
        refused: NlosError | None = None
        for attempt in range(ATTEMPTS):
            try:
                transport = self._make(self.drawn_world(number, position, attempt))
                picture = transport.pictures(position[None], rotation[None])[0]
            except NlosError as error:
                refused = refused or error
                continue
            values = [value for _, value in bulk.layout.values(voxel, index, attempt)]
            return picture, transport.background().astype(np.float32), values
        raise NlosError(f"{bulk.path}: none of {ATTEMPTS} scenes drawn for a pose can be; the first: {refused}")

    def drawn_world(self, number: int, position: Array, attempt: int = 0) -> World:
        """Return the world that is drawn for a picture of a set whose scene is uncertain.

        Parameters
        ----------
        number : int
            Number of the picture.
        position : ndarray of shape (3,)
            Position of the target, metres.
        attempt : int
            As for `generator.model.uncertainty.Uncertainty.draw`.

        Raises
        ------
        NlosError
            The drawn values are of no possible scene.
        """
        bulk, (index, voxel) = self._bulk, divmod(number, self._bulk.grid.n_voxels)
        plan, scene, world = bulk.plan, bulk.meta["scene"], self._world
        assert plan.uncertain is not None
        if plan.unknown:
            body = unknown_object(bulk.grid, plan.sweep, index, stream=plan.numbered_stream)
            world = replace(world, target=(body,))
        world = with_parameters(world, offsets(scene, bulk.layout.values(voxel, index, attempt)))
        if plan.uncertain.furniture:
            rng = np.random.default_rng([plan.seed, voxel, index, SALT + 1, plan.numbered_stream, attempt])
            boxes = unknown_furniture(plan.uncertain.furniture, scene, world, position, rng)
            world = replace(world, room=(*world.room, *boxes))
        return world

    def _gains(self, numbers: NDArray[np.int64]) -> Gains:
        """Return how much stronger lamp and reflectors are than in the set's world, picture by picture."""
        from generator.transport import Gains

        bulk, factors = self._bulk, np.ones((len(VARIABLES), len(numbers)))
        for k, number in enumerate(numbers.tolist()):
            index, voxel = divmod(number, bulk.grid.n_voxels)
            for name, value in bulk.layout.values(voxel, index):
                factors[VARIABLES.index(name), k] = value / value_in(bulk.meta["scene"], name)
        return Gains(**dict(zip(GAINS, factors, strict=True)))

    def _transports(
        self, numbers: NDArray[np.int64], positions: Array, rotations: Array
    ) -> Iterator[tuple[Transport, NDArray[np.int64], tuple[Array, Array]]]:
        """Yield the transport of each target, the rows that it renders, and their positions and rotations (k, 3)."""
        everything, bulk = np.arange(len(numbers)), self._bulk
        if self._known is not None:
            yield self._known, everything, (positions, rotations)
            return
        if bulk.plan.targets > 1:
            for row in everything:
                crowd = tuple(_crowd(self._world.target, positions[row], rotations[row]))
                self._last = self._make(replace(self._world, target=crowd), like=self._last)
                yield self._last, everything[row : row + 1], (positions[row, :1], np.zeros((1, 3)))
            return
        index = numbers // bulk.grid.n_voxels
        for rows in np.split(everything, np.flatnonzero(np.diff(index)) + 1):
            number, stream = int(index[rows[0]]), bulk.plan.numbered_stream
            body = unknown_object(bulk.grid, bulk.plan.sweep, number, stream=stream)
            self._last = self._make(replace(self._world, target=(body,)), like=self._last)
            yield self._last, rows, (positions[rows], rotations[rows])


def _crowd(target: Sequence[Body], positions: Array, rotations: Array) -> Iterator[Body]:
    """Yield copies of a target's bodies at poses (objects, 3), as one target that stands unrotated at the first."""
    for position, rotation in zip(positions, rotations, strict=True):
        turn, offset = rotation_matrix(rotation), position - positions[0]
        for body in target:
            if isinstance(body, Sphere):
                yield replace(body, centre=turn @ body.centre + offset)
            else:
                yield replace(body, triangles=body.triangles @ turn.T + offset)
