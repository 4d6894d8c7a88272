"""What ``locate`` and ``track`` answer about pictures of a camera, of which the truth may not be known."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from classify.cli.options import progress_bar
from generator.cli.answer import Answer, Interval, interval
from generator.model.errors import NlosError

if TYPE_CHECKING:
    from classify.inference.atlas import Atlas
    from classify.inference.tracker import Step
    from generator.model.poses import PoseRecord
    from generator.sets.readable import PictureSet

_FEW = 20
"""Pictures up to which each gets a line."""


def locate(options: argparse.Namespace, atlas: Atlas, dataset: PictureSet) -> Answer:
    """Answer each picture, and say how often answers are right as far as that is known."""
    from classify.cli.locate import Located, Location
    from classify.inference import photographs
    from generator.files.writing import write_text

    with progress_bar("locating", "pictures") as progress:
        answers = photographs.answers(
            atlas,
            dataset,
            false_alarm=options.false_alarm,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    seconds = float(np.median([found.seconds for found in answers.found]))
    lines = answers.lines() if len(answers.found) <= _FEW else []
    lines.append(f"something is found in {answers.detected().percent()} of {len(answers.found)} pictures")
    if accuracy := answers.accuracy():
        lines.append(f"right voxel in {accuracy.percent()} of those whose voxel is known")
    error, covered = answers.error(), answers.covered()
    if error and covered:
        lines.append(f"off by {error.centimetres()} (median), within the 95 % region {covered.percent()}")
    lines += [f"an answer takes {1000.0 * seconds:.1f} ms (median)", *answers.doubts]
    files: list[Path] = []
    if options.output:
        files = [options.output / "answers.csv"]
        write_text(files[0], answers.csv())
        lines.append(str(files[0]))
    values = Located(
        quality=[],
        accuracy=_or_none(accuracy),
        error=_or_none(error),
        covered=_or_none(covered),
        false_alarms=None,
        seconds=seconds,
        level=answers.level,
        mismatch=answers.mismatch,
        doubts=list(answers.doubts),
        answers=[
            Location(
                file=record.file,
                truth=record.label or None,
                label=answers.labels[found.place.voxels.argmax()],
                probability=float(found.place.voxels.max()),
                true_position=list(record.position) if record.placed else None,
                position=found.place.position.tolist(),
                deviation=np.sqrt(np.diag(found.place.covariance)).tolist(),
                evidence=found.evidence,
                detected=found.detected,
                misfit=found.misfit,
            )
            for record, found in zip(answers.records, answers.found, strict=True)
        ],
        files=files,
    )
    return Answer(values, lines, 1 if answers.doubts else 0)


def track(options: argparse.Namespace, atlas: Atlas, dataset: PictureSet) -> Answer:
    """Follow the object from picture to picture."""
    from classify.cli.locate import Frame, frame_words
    from classify.cli.locate import Tracked as Values
    from classify.inference import photographs
    from generator.files.writing import write_text

    if options.gap or options.follow:
        raise NlosError("--gap and --follow: are for rendered trajectories, and these pictures were taken")

    def report(record: PoseRecord, step: Step) -> None:
        print(frame_words(record.index, step, atlas.grid.labels), flush=True)

    tracked = photographs.track(atlas, dataset, step=options.step, told=report)
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
    values = Values(
        frames=[
            Frame(
                frame=record.index,
                there=None,
                presence=step.presence,
                label=atlas.grid.labels[step.voxels.argmax()],
                position=step.position.tolist(),
                deviation=np.sqrt(np.diag(step.covariance)).tolist(),
                covariance=step.covariance.tolist(),
                true_position=list(record.position) if record.placed else None,
            )
            for record, step in zip(tracked.records, tracked.steps, strict=True)
        ],
        error=None,
        trajectory_error=float(np.sqrt((errors**2).mean())) if len(errors) else None,
        accuracy=None,
        covered=None,
        presence=None,
        found_again=[],
        atlas_covered=None,
        words=lines,
        files=files,
    )
    return Answer(values, [*lines, *map(str, files)], 1 if tracked.doubts else 0)


def _or_none(value: object) -> Interval | None:
    return None if value is None else interval(value)
