"""What ``locate`` and ``track`` answer about pictures of a camera, of which the truth may not be known."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from classify.cli.options import progress_bar
from generator.cli import console
from generator.model.errors import NlosError

if TYPE_CHECKING:
    from classify.inference.atlas import Atlas
    from classify.inference.photographs import Answers, Tracked
    from classify.inference.tracker import Step
    from generator.model.poses import PoseRecord
    from generator.sets.readable import PictureSet

T = TypeVar("T")


@dataclass(frozen=True)
class Told(Generic[T]):
    """Answers, the lines that tell them, and the files that were written."""

    answers: T
    lines: list[str]
    files: list[Path]


_FEW = 20
"""Pictures up to which each gets a line."""


def locate(options: argparse.Namespace, atlas: Atlas, dataset: PictureSet) -> Told[Answers]:
    """Answer each picture, and say how often answers are right as far as that is known."""
    from classify.inference import photographs

    if options.watch is not None:
        return _watch(options, atlas, dataset)
    if options.patience is not None:
        raise NlosError("--patience: means nothing without --watch")
    with progress_bar("locating", "pictures") as progress:
        answers = photographs.answers(
            atlas,
            dataset,
            false_alarm=options.false_alarm,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    return _told(options, answers, answers.lines() if len(answers.found) <= _FEW else [])


def _watch(options: argparse.Namespace, atlas: Atlas, dataset: PictureSet) -> Told[Answers]:
    """Answer pictures as they come into a folder."""
    from classify.inference import photographs
    from classify.pictures import arrivals
    from classify.pictures.recipe import FILE, Recipe

    if options.patience is not None and not options.patience > 0.0:
        raise NlosError(f"--patience {options.patience:g}: must be positive, seconds")
    recipe = Recipe.load(dataset.path / FILE)

    def told(name: str, found: photographs.Found) -> None:
        print(f"{name}: {found.words(atlas.grid.labels)}", flush=True)

    answers = photographs.live(
        atlas,
        dataset,
        recipe,
        arrivals.come(options.watch, options.patience, complain=console.complain),
        false_alarm=options.false_alarm,
        seed=options.seed,
        told=told,
        complain=console.complain,
    )
    if not answers.found:
        raise NlosError(f"{options.watch}: no picture came")
    return _told(options, answers, [])


def _told(options: argparse.Namespace, answers: Answers, lines: list[str]) -> Told[Answers]:
    from generator.files.writing import write_text

    lines.append(f"something is found in {answers.detected().percent()} of {len(answers.found)} pictures")
    if accuracy := answers.accuracy():
        lines.append(f"right voxel in {accuracy.percent()} of those whose voxel is known")
    error, covered = answers.error(), answers.covered()
    if error and covered:
        lines.append(f"off by {error.centimetres()} (median), within the 95 % region {covered.percent()}")
    lines += [f"an answer takes {1000.0 * answers.seconds:.1f} ms (median)", *answers.doubts]
    files: list[Path] = []
    if options.output:
        files = [options.output / "answers.csv"]
        write_text(files[0], answers.csv())
        lines.append(str(files[0]))
    return Told(answers, lines, files)


def track(
    options: argparse.Namespace,
    atlas: Atlas,
    dataset: PictureSet,
    report: Callable[[PoseRecord, Step], None],
) -> Told[Tracked]:
    """Follow the object from picture to picture."""
    from classify.inference import photographs
    from generator.files.writing import write_text

    if options.gap or options.follow:
        raise NlosError("--gap and --follow: are for rendered trajectories, and these pictures were taken")

    tracked = photographs.track(atlas, dataset, step=options.step, seed=options.seed, told=report)
    found = sum(step.found for step in tracked.steps)
    lines = [f"something is there in {found} of {len(tracked.steps)} frames"]
    errors = tracked.errors
    if len(errors):
        middle = 100.0 * float(np.median(errors))
        lines.append(f"median error of the position {middle:.2f} cm, over {len(errors)} frames")
    lines += tracked.doubts
    files: list[Path] = []
    if options.output:
        files = [options.output / "track.csv"]
        write_text(files[0], tracked.csv())
    return Told(tracked, [*lines, *map(str, files)], files)
