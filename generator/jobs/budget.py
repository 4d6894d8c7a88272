"""Settings of a sweep that follow from a time budget or an accuracy, measured on this scene and this machine."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from generator.jobs import gpus
from generator.jobs.protocol import TrialRender
from generator.jobs.workers import Launch, Worker, available_cores, python
from generator.model.deadline import Deadline, Late
from generator.model.engines import traits_of
from generator.model.errors import NlosError
from generator.model.quantities import clock, percent
from generator.model.settings import BACKGROUND_FACTOR, Sweep
from generator.sets import links
from generator.transport import caching

FINE = 1e-4
"""Finest accuracy of `surfel`: float32 pictures hold no finer one of an object that changes them by a thousandth."""

_COARSE = 0.3
_FILL = 0.95
"""Share of the remaining budget that a sweep is planned to take; the rest is for pictures that end late."""
_SWING = 4.0
"""Factor by which the samples of a picture may differ from the plan when a machine becomes slower or faster."""
_LATEST = 0.1
"""Weight of the latest picture in the estimate of the machine's speed."""
_MOST_SAMPLES = 2**20
REHEARSED = 9
"""Number of voxels, evenly spread, of which one pose each is rendered to estimate all."""

_WRITING = 2e-3
"""Seconds to write a picture and its line of the table."""


@dataclass(frozen=True)
class TrialResult:
    """Times and noise of two rounds of a few pictures: a worker's answer (`generator.blender.trial_render`).

    Attributes
    ----------
    engine : str
    voxels : int
        Number of voxels of the scene's grid.
    work : two of float
        Samples, or the inverse of the accuracy, of each round.
    seconds : two of float
        Time per picture of each round, its paired background included.
    noise : list of float
        Of Cycles, pose by pose: variance of a difference picture of one sample over the difference's mean square.
    """

    engine: str
    voxels: int
    work: Sequence[float]
    seconds: Sequence[float]
    noise: list[float]


@dataclass(frozen=True)
class Measured:
    """Cost and noise of all sweeps of a scene with one engine, estimated from a trial.

    Attributes
    ----------
    engine : str
    voxels : int
    start : float
        Seconds before the first and after the last picture.
    fixed, slope, power : float
        A picture takes ``fixed + slope * work**power`` seconds, where work is the samples, or the inverse of the
        accuracy.
    noise : float
        Of Cycles: relative error of a difference picture of one sample, in the median pose.
    workers : float
        Number of pictures rendered at a time.
    """

    engine: str
    voxels: int
    start: float
    fixed: float
    slope: float
    power: float
    noise: float
    workers: float

    def picture(self, work: float) -> float:
        """Return the seconds that a picture takes one worker."""
        return float(self.fixed + self.slope * work**self.power)

    def total(self, work: float, pictures: int) -> float:
        """Return the seconds that a sweep takes."""
        noisy = traits_of(self.engine).noisy
        background = self.picture(BACKGROUND_FACTOR * work) / 2.0 / self.workers if noisy else 0.0
        return self.start + background + pictures * self.picture(work) / self.workers

    def most(self, limit: float, pictures: int, low: float, high: float) -> float:
        """Return the most work, between two bounds, with which a sweep keeps a limit; the lower if none does."""
        for _ in range(60):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if self.total(middle, pictures) <= limit else (low, middle)
        return low


class Pace:
    """Decides how many samples the next picture of a sweep may take, so that all pictures are done in time.

    On shared cores the same work may take twice as long a minute later, so earlier measurements are not enough.

    Parameters
    ----------
    measured : Measured
        Cost of a sweep by Cycles.
    samples : int
        Planned samples of a picture.
    pictures : int
        Number of pictures that are to be begun.
    late : float
        Time on the clock when all is to be done.
    clock : callable
        Returns the time in seconds.
    """

    def __init__(
        self,
        measured: Measured,
        samples: int,
        pictures: int,
        late: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._measured = measured
        self._samples = samples
        self._left = pictures
        self._late = late
        self._clock = clock
        self._lock = threading.Lock()
        self._slowness = 1.0
        self._known = 0
        self._begun: dict[int, tuple[float, int]] = {}

    def __call__(self) -> int:
        """Return the samples of the picture that this thread's worker is about to begin, having ended its last."""
        with self._lock:
            now, thread = self._clock(), threading.get_ident()
            if thread in self._begun:  # the first may have waited for Blender to start, so its time is not used
                start, samples = self._begun[thread]
                if start >= 0.0:
                    self._learn((now - start) / self._measured.picture(samples))
                start = now
            else:
                start = -1.0
            workers = self._measured.workers
            # Pictures under way take half a picture's time more each, on average.
            busy = max(0, len(self._begun) - 1) * self._measured.picture(self._samples) * self._slowness / 2.0
            seconds_each = max(0.0, (self._late - now) * workers - busy) / max(1, self._left) / self._slowness
            wanted = (seconds_each - self._measured.fixed) / self._measured.slope
            low, high = max(1.0, self._samples / _SWING), self._samples * _SWING
            samples = int(min(max(wanted, low), high))
            self._begun[thread] = (start, samples)
            self._left -= 1
            return samples

    def _learn(self, ratio: float) -> None:
        self._known += 1
        weight = max(1.0 / self._known, _LATEST)
        self._slowness += weight * (min(max(ratio, 1.0 / _SWING), _SWING) - self._slowness)


@dataclass(frozen=True)
class Choice:
    """Settings that were chosen from a trial.

    Attributes
    ----------
    settings : dict
        Fields of `Sweep`.
    pace : Pace or None
        Keeps the budget, if the budget determines the samples.
    """

    settings: dict[str, Any]
    pace: Pace | None


def choose(
    scene: Path,
    chosen: Mapping[str, Any],
    *,
    budget: float = math.inf,
    accuracy: float = 0.0,
    workers: int = 0,
    tell: Callable[[str], None] = lambda words: None,
    launch: Launch = python,
    force: bool = False,
) -> Choice:
    """Return the settings of a sweep that keeps a budget, or is as exact as asked for, whichever takes less time.

    One pose in each of a few voxels is rendered twice and discarded (`generator.blender.trial_render`); noise falls
    with the square root of the samples.

    Parameters
    ----------
    scene : Path
    chosen : mapping
        Fields of `Sweep` that the user chose; the engine is ``auto`` if it is not among them.
    budget : float
        Seconds, from now on, the rehearsal included; compiling, which is done once, comes on top.
    accuracy : float
        Relative root mean square error of a difference picture, in the median pose; 0 is as exact as possible.
    workers : int
        As for `generator.jobs.local.run`.
    tell : callable
        Called with what was measured and chosen.
    launch : callable
        Returns the command line that starts a worker.
    force : bool
        As for `generator.jobs.local.run`.

    Raises
    ------
    NlosError
        Even the least work does not end in time, samples were chosen too, or the scene cannot be swept.
    """
    if "samples" in chosen:
        raise NlosError("samples: follow from --budget and --accuracy; leave them out, or leave these out")
    settings = {"engine": "auto", **{k: v for k, v in chosen.items() if k != "accuracy"}}
    compiled(scene, settings, tell=tell, launch=launch, force=force)
    begun = time.monotonic()
    try:
        measured = measured_by_trial(scene, settings, workers, launch, force=force, deadline=Deadline(budget))
    except Late:
        raise NlosError(f"--budget: {clock(budget)} are over before a few pictures are; ask for more time") from None
    pictures = int(settings.get("poses", Sweep.poses)) * measured.voxels
    exact = not traits_of(measured.engine).noisy
    left = budget - (time.monotonic() - begun)
    low, high = (1.0 / _COARSE, 1.0 / FINE) if exact else (1.0, float(_MOST_SAMPLES))
    if accuracy:
        wanted = 1.0 / max(accuracy, FINE) if exact else (measured.noise / accuracy) ** 2
        high = min(max(low, wanted), high)
    work = high if measured.total(high, pictures) <= left else measured.most(_FILL * left, pictures, low, high)
    least = measured.total(low, pictures)
    if least > left:
        raise NlosError(
            f"--budget: {pictures} pictures take {clock(least)} at the very least, and "
            f"{clock(max(left, 0.0))} are left of it; ask for fewer poses, a lower resolution, or more time"
        )
    settings["engine"] = measured.engine
    pace = None
    reason = "as exact as asked for" if accuracy and work >= high else "what the budget allows"
    duration = clock(measured.total(work, pictures))
    if exact:
        settings["accuracy"] = float(f"{1.0 / work:.2g}")
        error, words = settings["accuracy"], f"accuracy {settings['accuracy']:g}"
    else:
        settings["samples"] = max(1, math.floor(work))
        error, words = measured.noise / math.sqrt(settings["samples"]), f"{settings['samples']} samples"
        if work < high:
            words = f"about {words}"
            pace = Pace(measured, settings["samples"], pictures, begun + _FILL * budget)
    if exact and work >= 1.0 / FINE:
        reason = "as exact as float32 pictures can hold"
    tell(f"{measured.engine}, {words}: {reason}; about {duration}, error of a difference picture {percent(error)}")
    return Choice(settings, pace)


def compiled(
    scene: Path,
    settings: Mapping[str, Any],
    *,
    tell: Callable[[str], None] = lambda words: None,
    launch: Launch = python,
    force: bool = False,
) -> float:
    """Compile `surfel` if a sweep may use it and it is not compiled yet; return the seconds that took.

    Parameters are those of `choose`. A time limit begins afterwards: what is done once says nothing of a sweep.
    """
    begun = time.monotonic()
    if not (words := caching.compiling_words(str(settings["engine"]))):
        return 0.0
    tell(words)
    measured_by_trial(scene, {**settings, "resolution": "8"}, 1, launch, force=force)
    taken = time.monotonic() - begun
    tell(f"compiled in {clock(taken)}, which no time limit counts")
    return taken


def _kill(workers: Sequence[Worker]) -> None:
    for worker in workers:
        worker.kill()


def measured_by_trial(
    scene: Path,
    settings: Mapping[str, Any],
    workers: int = 0,
    launch: Launch = python,
    *,
    force: bool = False,
    deadline: Deadline | None = None,
) -> Measured:
    """Measure a sweep by a trial, on as many parallel workers as it will have; 0 is one per core.

    Raises
    ------
    NlosError
        The scene cannot be swept with these settings.
    Late
        The deadline was over before the trial was.
    """
    cores = available_cores()
    crew = max(1, min(workers or cores, REHEARSED))
    begun = time.monotonic()
    trial = TrialRender(
        scene=scene,
        chosen=dict(settings),
        threads=max(1, cores // crew),
        share=0,
        shares=crew,
        force=force,
        trust_links=links.trusted(),
        gpus=gpus.chosen(),
    )
    with contextlib.ExitStack() as stack:
        trial_workers = [stack.enter_context(Worker(replace(trial, share=i), launch)) for i in range(crew)]
        if deadline and math.isfinite(deadline.left):
            timer = threading.Timer(deadline.left, _kill, [trial_workers])
            stack.callback(timer.cancel)
            timer.start()
        answers = [worker.answer() for worker in trial_workers]
        if deadline and not all(answers):
            deadline.check()
        for worker, answer in zip(trial_workers, answers, strict=True):
            if answer is None:
                raise NlosError(f"{scene}: could not be rehearsed: {worker.last_words()}")
    elapsed = time.monotonic() - begun
    results = [TrialResult(**answer) for answer in answers if answer]
    results = [result for result in results if result.seconds[0] > 0.0]  # with few voxels some workers had none
    engine, work, times = results[0].engine, results[0].work, np.mean([r.seconds for r in results], axis=0)
    shortest = 1e-4  # seconds; a clock is not exact below that
    exact = not traits_of(engine).noisy
    if exact:  # the whole time grows slowly with the accuracy
        power = max(0.0, math.log(max(times[1], shortest) / max(times[0], shortest)) / math.log(work[1] / work[0]))
        fixed, slope, noise = _WRITING, max(float(times[1]), shortest) / work[1] ** power, 0.0
    else:
        power, slope = 1.0, max(float(times[1] - times[0]), shortest) / (work[1] - work[0])
        fixed = max(0.0, float(times[0]) - slope * work[0]) + _WRITING
        noise = math.sqrt(float(np.median([n for r in results for n in r.noise])))
    # Time spent on no picture is Blender's start, awaited two or three times by a sweep: plan, background, workers.
    idle = max(0.0, elapsed - sum(results[0].seconds) * math.ceil(REHEARSED / crew))
    starts = 2.0 if exact else 3.0
    return Measured(engine, results[0].voxels, starts * idle, fixed, slope, power, noise, float(workers or cores))
