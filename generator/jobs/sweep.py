"""Plans a sweep, starts workers, shows progress, resumes: the coordinator, which never imports bpy.

A worker's word is not taken for its work: what is done is what lies on disk, whole and with the right hash.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from generator.jobs import journal as journals
from generator.jobs.protocol import PlanSweep, RenderSweep
from generator.jobs.workers import Launch, WorkerPool, planned_notes, python
from generator.model.errors import NlosError
from generator.model.quantities import Progress
from generator.model.settings import AUTO, Sweep
from generator.sets import links
from generator.sets.dataset import Dataset
from generator.sets.manifest import check_no_set
from generator.sets.resume import HasSettings, check_same
from generator.transport.caching import compiling_words

_ON_GPU = 4
"""Workers that share a GPU, if none are asked for: more gain little, and each takes memory there."""

_BATCH, _BATCH_PIXELS = 32, 2**17
"""Most poses that `surfel` renders at once, and most pixels: more gain nothing, but memory and an uneven end."""


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
"""Is asked, whenever a worker is about to begin a picture, with how many samples."""


def run(
    scene: Path,
    path: Path,
    chosen: Mapping[str, Any],
    *,
    workers: int = 0,
    shard: tuple[int, int] = (0, 1),
    progress: Progress = lambda done, total: None,
    tell: Callable[[str], None] = lambda words: None,
    launch: Launch = python,
    stop: threading.Event | None = None,
    pace: Pace | None = None,
    force: bool = False,
    probe: bool = True,
) -> Outcome:
    """Render a data set, or what is missing of it.

    Parameters
    ----------
    scene : Path
        The ``.blend``.
    path : Path
        Of the data set; a folder that is new, empty, or holds the same sweep.
    chosen : mapping
        Fields of `Sweep` that the user chose. What is left out follows from the data set if there is one, else from
        the scene and the defaults. The engine may be ``auto``: the data set's, or the cheapest that the scene allows.
    workers : int
        Processes; 0 is one per core, or four that share a GPU.
    shard : (int, int)
        ``(i, n)``: render the i-th of n parts only, i from 0.
    progress : callable
    tell : callable
        Is told which engine ``auto`` took, and why; that an engine is being compiled; what the check at the start of
        a new set found, and how long it took.
    launch : callable
        How workers are started.
    stop : threading.Event, optional
        Set by another thread, it ends the run early; what is done stays.
    pace : callable, optional
        Says with how many samples each picture is rendered; without it all take the data set's. Voxels then take
        turns, lest the noise tell them apart.
    force : bool
        Begin a new set in spite of errors that the check finds in the scene.
    probe : bool
        Whether a new set begins with the check of its engine against plain Cycles (`generator.blender.start_check`).

    Raises
    ------
    NlosError
        The input is bad, the check finds an error, or the data set at that path was made with other settings.
    """
    options: dict[str, Any] = {"launch": launch, "stop": stop, "force": force, "probe": probe}
    dataset = begin(scene, path, chosen, shard=shard, tell=tell, **options).dataset
    outcome = Outcome(dataset)
    pending = pending_positions(dataset, shard)
    if pace:
        pending.sort(key=lambda position: dataset.poses[position].index)
    if pending:
        say = (lambda position: f"{position}:{pace()}") if pace else str
        shared = _ON_GPU if dataset.sweep.device == "gpu" else 0
        with _crew(dataset, shard, progress, say=say, launch=launch, stop=stop) as crew:
            crew.work(pending, workers or shared, batch=batch_size(dataset))
        outcome.failed = crew.failed
        outcome.rendered = sum(dataset.poses[position].done for position in pending)  # as gathered from disk
    outcome.remaining = sum(not pose.done for pose in dataset.poses)
    if outcome.rendered and not outcome.remaining:
        dataset.tidy()
    return outcome


def begin(
    scene: Path,
    path: Path,
    chosen: Mapping[str, Any],
    *,
    shard: tuple[int, int] = (0, 1),
    tell: Callable[[str], None] = lambda words: None,
    launch: Launch = python,
    stop: threading.Event | None = None,
    force: bool = False,
    probe: bool = True,
) -> Outcome:
    """Plan a data set and render its background, as far as that is not done; parameters as of `run`."""
    new = not Dataset.exists(path)
    known = chosen.get("engine", AUTO) if new else Dataset.open(path).settings["engine"]
    if words := compiling_words(known):
        tell(words)
    dataset = prepare(scene, path, chosen, launch, force=force, probe=probe, tell=tell)
    if chosen.get("engine", AUTO) == AUTO:
        tell(engine_words(dataset, chosen))
    if new and (words := start_words(dataset)):
        tell(words)
    if not all(dataset.has_background(name) for name in dataset.background_names):
        with _crew(dataset, shard, lambda done, total: None, launch=launch, stop=stop) as crew:
            crew.work([], first="the background")
    return Outcome(dataset, remaining=len(dataset.poses))


@contextlib.contextmanager
def _crew(dataset: Dataset, shard: tuple[int, int], progress: Progress, **options: Any) -> Iterator[WorkerPool]:
    """Give a crew that renders a data set and tells of it; on leaving, gather what it has made."""

    def told(done: int, total: int) -> None:
        journal.told(done, total)
        progress(done, total)

    trust = links.trusted()  # asked here: the workers are started by other threads

    def request(threads: int) -> RenderSweep:
        return RenderSweep(path=dataset.path, threads=threads, trust_links=trust)

    with journals.logged(dataset.path) as log:
        crew = WorkerPool(request, lambda position: dataset.poses[position].file, told, log=log, **options)
        try:
            with journals.Journal(dataset.path, shard, crew.look) as journal:
                yield crew
        finally:
            mine = range(shard[0], dataset.planned, shard[1])
            gather(dataset, shard, [position for position in mine if not dataset.poses[position].done])


def engine_words(dataset: Dataset, chosen: Mapping[str, Any]) -> str:
    """Return which engine renders a data set, what in its scene asked for one so dear, and what is nothing to it."""
    engine, reasons = dataset.settings["engine"], dataset.meta.get("engine_reasons", [])
    words = f"engine: {engine}" + (f", because {'; '.join(reasons)}" if reasons else "")
    idle = [f"--{name}" for name in Sweep.idle(engine) if name in chosen]
    return words + (f"; {' and '.join(idle)} {'mean' if len(idle) > 1 else 'means'} nothing to it" if idle else "")


def start_words(dataset: HasSettings) -> str:
    """Return what the check at the start found, and how long it took; empty if there was none."""
    return str(dataset.meta.get("start_check", {}).get("words", ""))


def prepare(
    scene: Path,
    path: Path,
    chosen: Mapping[str, Any],
    launch: Launch = python,
    *,
    force: bool = False,
    probe: bool = True,
    tell: Callable[[str], None] = lambda words: None,
) -> Dataset:
    """Return the data set at a path, planned now if there is none, after comparing the settings if there is one."""
    if not Dataset.exists(path):
        if not scene.is_file():
            raise NlosError(f"{scene}: no such scene file")
        check_no_set(path)
        request = PlanSweep(
            scene=scene, path=path, chosen=dict(chosen), force=force, probe=probe, trust_links=links.trusted()
        )
        for words in planned_notes(request, launch):
            tell(words)
        return Dataset.open(path)
    dataset = Dataset.open(path)
    check_same(dataset, scene, chosen)
    return dataset


def pending_positions(dataset: Dataset, shard: tuple[int, int] = (0, 1)) -> list[int]:
    """Return which poses of a shard are still to be rendered, judged by the pictures on disk."""
    index, count = shard
    if not 0 <= index < count:
        raise NlosError(f"--shard {index}/{count}: must be i/n with i from 0 to n - 1")
    return gather(dataset, shard, range(index, dataset.planned, count))


def gather(dataset: Dataset, shard: tuple[int, int], own: Sequence[int]) -> list[int]:
    """Bring a manifest up to date, and return which of the share's own poses are still to be rendered.

    A share looks at its own pictures: were each to look at all, a thousand shares would read each a thousand times.
    """
    dataset.gather(own if shard[1] > 1 else None)
    return [position for position in own if not dataset.poses[position].done]


def batch_size(dataset: Dataset) -> int:
    """Return how many poses a worker is given at once at most: `surfel` renders many in less time than one by one."""
    if dataset.settings["engine"] != "surfel":
        return 1
    width, height = dataset.sweep.resolution
    return max(1, min(_BATCH, _BATCH_PIXELS // (width * height)))
