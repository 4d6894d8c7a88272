"""A sweep on this machine: planning, rendering by workers, resuming. The coordinator never imports bpy.

Workers' answers are not trusted: a pose is done if its picture is on disk, whole and with the right hash.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from generator.jobs import gpus
from generator.jobs import journal as journals
from generator.jobs.protocol import PlanSweep, RenderSweep
from generator.jobs.request import SweepRequest
from generator.jobs.workers import Launch, WorkerPool, in_batches, planned_notes, python
from generator.model.engines import AUTO, traits_of
from generator.model.errors import NlosError
from generator.model.quantities import Progress
from generator.model.settings import Sweep
from generator.sets import links
from generator.sets.dataset import Dataset
from generator.sets.manifest import check_no_set
from generator.sets.resume import HasSettings, check_same
from generator.transport.caching import compiling_words

_ON_GPU = 4
"""Default number of workers that share a GPU: more workers gain little, and each takes memory of the GPU."""

_BATCH_PIXELS = 2**17
"""Most pixels that are rendered at once: more save no time, but take memory and let workers end far apart."""


@dataclass
class Outcome:
    """What a sweep did.

    Attributes
    ----------
    dataset : Dataset
    rendered : int
        Pictures made by this run.
    failed : list of str
        Files of the poses that could not be rendered, each with its reason.
    remaining : int
        Poses of the whole set, other shards' included, that are not rendered yet.
    """

    dataset: Dataset
    rendered: int = 0
    failed: list[str] = field(default_factory=list)
    remaining: int = 0


Pace = Callable[[], int]
"""Called whenever a worker is about to begin a picture; returns the samples to render it with."""


class Here(Protocol):
    """Plans and renders in this process, instead of workers."""

    def plan(self, request: SweepRequest, tell: Callable[[str], None]) -> None:
        """Make the data set that a request asks for, and check it at its start."""

    def render(self, dataset: Dataset, batches: Sequence[Sequence[int]], done: Callable[[int], None]) -> None:
        """Render batches of poses, and the background if it is missing; call ``done`` with how many were rendered."""


def run(
    request: SweepRequest,
    *,
    progress: Progress = lambda done, total: None,
    tell: Callable[[str], None] = lambda words: None,
    launch: Launch = python,
    stop: threading.Event | None = None,
    pace: Pace | None = None,
    here: Here | None = None,
) -> Outcome:
    """Render a data set, or what is missing of it, by worker processes on this machine or in this process.

    Parameters
    ----------
    request : SweepRequest
        Its budget, accuracy, plan and cluster are ignored here: `generator.jobs.sweep.run` handles them.
    progress, tell, launch, stop, here
        As for `generator.jobs.sweep.run`.
    pace : callable, optional
        Returns with how many samples each picture is rendered; without it all take the data set's. With it, voxels
        take turns, so that their noise does not tell them apart.

    Returns
    -------
    Outcome
        The set, and what this run did.

    Raises
    ------
    NlosError
        The input is bad, the check finds an error, or the data set at that path was made with other settings.
    """
    shard = request.shard
    dataset = begin(request, tell=tell, launch=launch, stop=stop, here=here).dataset
    outcome = Outcome(dataset)
    pending = pending_positions(dataset, shard)
    if pace:
        pending.sort(key=lambda position: dataset.poses[position].index)
    if here:
        _render_here(dataset, shard, pending, here, progress)
    elif pending:
        say = (lambda position: f"{position}:{pace()}") if pace else str
        default_workers = _ON_GPU if dataset.sweep.device == "gpu" else 0
        with _crew(dataset, shard, progress, say=say, launch=launch, stop=stop) as crew:
            crew.work(pending, request.workers or default_workers, batch=batch_size(dataset))
        outcome.failed = crew.failed
    outcome.rendered = sum(dataset.poses[position].done for position in pending)  # as gathered from disk
    outcome.remaining = sum(not pose.done for pose in dataset.poses)
    if outcome.rendered and not outcome.remaining:
        dataset.tidy()
    return outcome


def begin(
    request: SweepRequest,
    *,
    tell: Callable[[str], None] = lambda words: None,
    launch: Launch = python,
    stop: threading.Event | None = None,
    here: Here | None = None,
) -> Outcome:
    """Plan a data set and render its background, as far as that is not done; parameters as for `run`."""
    path, chosen, new = request.path, request.chosen, not Dataset.exists(request.path)
    engine = chosen.get("engine", AUTO) if new else Dataset.open(path).settings["engine"]
    if words := compiling_words(engine):
        tell(words)
    dataset = prepare(request, tell=tell, launch=launch, here=here)
    if chosen.get("engine", AUTO) == AUTO:
        tell(engine_words(dataset, chosen))
    if new and (words := start_words(dataset)):
        tell(words)
    if not here and not all(dataset.has_background(name) for name in dataset.background_names):
        with _crew(dataset, request.shard, lambda done, total: None, launch=launch, stop=stop) as crew:
            crew.work([], first="the background")
    return Outcome(dataset, remaining=len(dataset.poses))


def _render_here(
    dataset: Dataset, shard: tuple[int, int], pending: Sequence[int], here: Here, progress: Progress
) -> None:
    done = 0

    def report(count: int) -> None:
        nonlocal done
        done += count
        progress(done, len(pending))

    report(0)
    try:
        here.render(dataset, in_batches(pending, batch_size(dataset)), report)
    finally:
        gather(dataset, shard, pending)


@contextlib.contextmanager
def _crew(dataset: Dataset, shard: tuple[int, int], progress: Progress, **options: Any) -> Iterator[WorkerPool]:
    """Yield a pool of workers that render a data set and keep its journal; on leaving, gather their pictures."""

    def report(done: int, total: int) -> None:
        journal.told(done, total)
        progress(done, total)

    trust, chosen = links.trusted(), gpus.chosen()  # read here, since other threads start the workers

    def request(threads: int) -> RenderSweep:
        return RenderSweep(path=dataset.path, threads=threads, trust_links=trust, gpus=chosen)

    with journals.logged(dataset.path) as log:
        crew = WorkerPool(request, lambda position: dataset.poses[position].file, report, log=log, **options)
        try:
            with journals.Journal(dataset.path, shard, crew.look) as journal:
                yield crew
        finally:
            positions = range(shard[0], dataset.planned, shard[1])
            gather(dataset, shard, [position for position in positions if not dataset.poses[position].done])


def engine_words(dataset: Dataset, chosen: Mapping[str, Any]) -> str:
    """Return which engine renders a data set, why no cheaper one does, and which chosen settings it does not use."""
    engine, reasons = dataset.settings["engine"], dataset.meta.get("engine_reasons", [])
    words = f"engine: {engine}" + (f", because {'; '.join(reasons)}" if reasons else "")
    idle = [f"--{name}" for name in Sweep.idle(engine) if name in chosen]
    return words + (f"; {' and '.join(idle)} {'mean' if len(idle) > 1 else 'means'} nothing to it" if idle else "")


def start_words(dataset: HasSettings) -> str:
    """Return what the checks at the start found; empty if there was none."""
    found = (dataset.meta.get(name, {}).get("words", "") for name in ("start_check", "light_check"))
    return "\n".join(str(words) for words in found if words)


def prepare(
    request: SweepRequest,
    *,
    tell: Callable[[str], None] = lambda words: None,
    launch: Launch = python,
    here: Here | None = None,
) -> Dataset:
    """Return the data set at a path: a new one is planned; the settings of an existing one are compared first."""
    scene, path = request.scene, request.path
    if Dataset.exists(path):
        dataset = Dataset.open(path)
        check_same(dataset, scene, request.chosen)
        return dataset
    if not scene.is_file():
        raise NlosError(f"{scene}: no such scene file")
    check_no_set(path)
    if here:
        here.plan(request, tell)
        return Dataset.open(path)
    plan_request = PlanSweep(
        scene=scene,
        path=path,
        chosen=dict(request.chosen),
        force=request.force,
        probe=request.probe,
        trust_links=links.trusted(),
        gpus=gpus.chosen(),
    )
    for words in planned_notes(plan_request, launch):
        tell(words)
    return Dataset.open(path)


def pending_positions(dataset: Dataset, shard: tuple[int, int] = (0, 1)) -> list[int]:
    """Return which poses of a shard are still to be rendered, judged by the pictures on disk."""
    index, count = shard
    if not 0 <= index < count:
        raise NlosError(f"--shard {index}/{count}: must be i/n with i from 0 to n - 1")
    return gather(dataset, shard, range(index, dataset.planned, count))


def gather(dataset: Dataset, shard: tuple[int, int], own: Sequence[int]) -> list[int]:
    """Update a manifest, and return which of a shard's own poses are still to be rendered.

    A shard reads only its own pictures: if each read all, a thousand shards would read each picture a thousand times.
    """
    dataset.gather(own if shard[1] > 1 else None)
    return [position for position in own if not dataset.poses[position].done]


def batch_size(dataset: Dataset) -> int:
    """Return the most poses that a worker is given at once: `surfel` renders many in less time than one by one."""
    width, height = dataset.sweep.resolution
    return max(1, min(traits_of(dataset.sweep.engine).largest_batch, _BATCH_PIXELS // (width * height)))
