"""The verbs ``locate``, ``tradeoff``, ``track`` and ``detect``: answers from an atlas."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from classify.cli import photographs
from classify.cli.options import (
    add_atlas_options,
    add_false_alarm,
    add_seed,
    check_output,
    loaded,
    progress_bar,
)
from generator.cli.answer import Answer, Interval, Table, interval, json_object
from generator.cli.options import Commands
from generator.cli.volume import stage
from generator.model.described import described
from generator.model.errors import NlosError

if TYPE_CHECKING:
    from classify.inference.evaluation import Evaluation
    from classify.inference.photographs import Answers
    from classify.inference.photographs import Tracked as Followed
    from classify.inference.tracker import Step
    from generator.model.poses import PoseRecord


def add_parsers(commands: Commands) -> None:
    """Add the verbs ``locate``, ``tradeoff``, ``track`` and ``detect`` to a command line."""
    _add_locate(commands)
    _add_tradeoff(commands)
    _add_track(commands)
    _add_detect(commands)


def _add_locate(commands: Commands) -> None:
    parser = commands.add_parser(
        "locate",
        help="say whether there is something, in which voxel, and where",
        description="Find a known object in every picture of a data set, as the atlas' sensor would have seen it, "
        "and say how often voxel, position and presence are right.",
        epilog="example:\n  nlos-classify locate room.atlas sphere/ -o answers/",
    )
    parser.add_argument("atlas", type=Path, metavar="FILE.atlas")
    parser.add_argument(
        "dataset",
        type=Path,
        metavar="SET",
        help="folder of a data set, or a simulated one, whose clean pictures get noise; or of nlos-classify import, "
        "whose pictures have theirs",
    )
    parser.add_argument(
        "--count",
        type=int,
        default=0,
        metavar="N",
        help="take the first N pictures of a simulated set (default: all)",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="for report.html and answers.csv")
    parser.add_argument(
        "--watch",
        type=Path,
        metavar="FOLDER",
        help="in place of the set's pictures, answer those that a camera puts into this folder, treated as those of "
        "the set were by nlos-classify import",
    )
    parser.add_argument(
        "--patience",
        type=float,
        metavar="S",
        help="with --watch: end when nothing has come for S seconds (default: when interrupted)",
    )
    add_seed(parser, "of the sensor's noise")
    add_false_alarm(parser)
    add_atlas_options(parser, voxels=True)
    parser.set_defaults(run=run_locate, answer=Located)


def _add_tradeoff(commands: Commands) -> None:
    parser = commands.add_parser(
        "tradeoff",
        help="say what better pictures are worth",
        description="Answer the pictures that nlos-generate tradeoff rendered in every way, through the atlas' "
        "sensor: from which samples on the sensor's noise decides, and rendering no longer.",
        epilog="example:\n  nlos-generate tradeoff room.blend -o trade/\n  nlos-classify tradeoff trade/ room.atlas",
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="of nlos-generate tradeoff")
    parser.add_argument("atlas", type=Path, metavar="FILE.atlas")
    parser.add_argument(
        "--noise-draws",
        dest="noises",
        type=int,
        default=5,
        metavar="N",
        help="draws of the sensor's noise for each picture (default: 5)",
    )
    add_seed(parser, "of the sensor's noise")
    add_false_alarm(parser)
    add_atlas_options(parser)
    parser.alias("--noises", "--noise-draws")
    parser.set_defaults(run=run_tradeoff, answer=Worths)


def _add_track(commands: Commands) -> None:
    parser = commands.add_parser(
        "track",
        help="follow an object that moves, frame by frame",
        description="Follow a known object through the frames of a trajectory, as the atlas' sensor would have seen "
        "them: where it is after each, how sure, and how far from the truth.",
        epilog="example:\n  nlos-generate trajectory room.blend -o walk/ --frames 200 --engine surfel\n"
        "  nlos-classify track room.atlas walk/ -o track/ --gap 80:110",
    )
    parser.add_argument(
        "atlas", type=Path, metavar="FILE.atlas", help="of poses that fill the volume: --inside centre"
    )
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="folder of the trajectory")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="for report.html, track.csv and track.png"
    )
    parser.add_argument(
        "--process-noise",
        dest="step",
        type=float,
        default=0.06,
        metavar="M",
        help="standard deviation of its walk along each axis from frame to frame, metres: about twice its pace if it "
        "keeps its way for a while (default: 0.06)",
    )
    parser.add_argument(
        "--gap",
        action="append",
        default=[],
        metavar="FROM:TO",
        help="take the object away for these frames; repeatable",
    )
    parser.add_argument(
        "--follow",
        type=float,
        default=0.0,
        metavar="S",
        help="while the trajectory is being rendered: wait S seconds for the next frame (default: 0)",
    )
    add_seed(parser, "of the sensor's noise")
    add_atlas_options(parser)
    parser.alias("--step", "--process-noise")
    parser.set_defaults(run=run_track, answer=Tracked)


def _add_detect(commands: Commands) -> None:
    parser = commands.add_parser(
        "detect",
        help="say how often an object is found, against exposure and distance",
        description="Say how often the atlas' object is found at a chosen rate of false alarms, voxel by voxel and "
        "for several exposures: where and how long one has to look.",
        epilog="example:\n  nlos-classify atlas simulated/ -o room.atlas --frames 1000 --sensor long.toml\n"
        "  nlos-classify detect room.atlas -o detect/ --exposures 1 10 100 1000",
    )
    parser.add_argument("atlas", type=Path, metavar="FILE.atlas")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="for report.html, detect.csv and detect.png"
    )
    parser.add_argument(
        "--exposures",
        type=int,
        nargs="+",
        metavar="N",
        help="frames averaged, no more than the atlas was made for (default: 1, 3, 10, ... up to these)",
    )
    add_false_alarm(parser)
    parser.add_argument("--count", type=int, default=300, metavar="N", help="pictures in each voxel (default: 300)")
    add_seed(parser, "of poses and noise")
    parser.set_defaults(run=run_detect, answer=Detections)


@json_object
class Quality:
    """How good the answers in a voxel are."""

    voxel: str = described("its label; all for all together")
    pictures: int = described("pictures whose object stands there")
    accuracy: Interval = described("share of these that are put into the right voxel")
    error: Interval = described("median distance of the position from the true one, metres")
    covered: Interval = described("share of these whose true position lies in the stated 95 % region")
    detected: Interval = described("share of these in which an object is found")


@json_object
class Location:
    """The answer to a picture."""

    file: str = described("the picture")
    truth: str | None = described("voxel in which the object stands; null if that is not known")
    label: str = described("the most probable voxel")
    probability: float = described("probability of that voxel")
    true_position: list[float] | None = described("where the object stands, metres; null if that is not known")
    position: list[float] = described("where it is found, metres")
    deviation: list[float] = described("standard deviation of that along x, y and z, metres")
    evidence: float = described("logarithm of how much likelier an object is than an empty scene")
    detected: bool = described("whether an object is found")
    misfit: float = described("probability that a picture of the atlas' scene and object fits it as badly")


@json_object
class Located:
    """Where the hidden objects are."""

    quality: list[Quality] = described("how good the answers are, voxel by voxel, and last in all")
    accuracy: Interval | None = described(
        "of pictures of a camera: share of those whose voxel is known that are put into it; null if there is none"
    )
    error: Interval | None = described(
        "of pictures of a camera: median distance from known positions, metres; null if there is none"
    )
    covered: Interval | None = described(
        "of pictures of a camera: share of known positions in the stated 95 % region; null if there is none"
    )
    false_alarms: Interval | None = described(
        "share of empty scenes in which something is found; null of pictures of a camera"
    )
    seconds: float = described("median time of an answer, seconds")
    level: float = described("factor on the exposure that makes the empty scene as bright as that of the atlas")
    mismatch: float | None = described("difference in shape of the two empty scenes; null of a rendered set")
    doubts: list[str] = described("what speaks against these answers, in sentences")
    answers: list[Location] = described("answers, picture by picture")
    files: list[Path] = described("files that were written")


@json_object
class WayWorth:
    """What a way to render is worth."""

    name: str = described("name of the way")
    seconds: float = described("core seconds per picture")
    accuracy: Interval = described("share of pictures that are put into the right voxel")
    error: Interval = described("median error of the position, metres")
    detected: Interval = described("share of pictures in which an object is found")
    answers: int = described("answers: pictures times draws of the sensor's noise")


@json_object
class Worths:
    """What better pictures are worth."""

    ways: list[WayWorth] = described("the ways to render, the reference first")
    words: list[str] = described("from which on rendering longer is worth nothing, in sentences")
    files: list[Path] = described("files that were written")


@json_object
class Frame:
    """Where the object is after a frame."""

    frame: int = described("number of the frame")
    there: bool | None = described("whether the object was in it; in a gap it was not; null if that is not known")
    presence: float = described("probability that there is an object")
    label: str = described("the most probable voxel, if there is an object")
    position: list[float] = described("where it is then, metres")
    deviation: list[float] = described("standard deviation of that along x, y and z, metres")
    covariance: list[list[float]] = described("covariance of the position, m^2: its 95 % region is an ellipsoid")
    true_position: list[float] | None = described("where the object stands, metres; null if that is not known")


@json_object
class Tracked:
    """How an object moves; of pictures of a camera, what follows from the truth is null."""

    frames: list[Frame] = described("answers, frame by frame")
    error: Interval | None = described("median distance of the position from the true one, metres")
    trajectory_error: float | None = described("root mean square of these distances, metres")
    accuracy: Interval | None = described("share of frames in which the voxel is right")
    covered: Interval | None = described("share of frames whose true position lies in the 95 % region")
    presence: Interval | None = described("share of frames in which presence is told rightly")
    found_again: list[int | None] = described("frames until it was found again, gap by gap; null if it was not")
    atlas_covered: Interval | None = described(
        "share of the atlas' own poses, left out of it, that the 95 % region holds after 20 frames"
    )
    words: list[str] = described("the same in sentences")
    files: list[Path] = described("files that were written")


@json_object
class VoxelDetection:
    """How often an object is found in a voxel."""

    voxel: str = described("its label")
    distance: float = described("distance of its middle from the relay wall, metres")
    detected: list[Interval] = described("share of pictures in which the object is found, exposure by exposure")


@json_object
class Detections:
    """How often an object is found."""

    false_alarm: float = described("share of empty scenes in which something is found too")
    frames: list[int] = described("exposures: frames averaged for a picture")
    voxels: list[VoxelDetection] = described("results, voxel by voxel")
    files: list[Path] = described("files that were written")


def run_locate(options: argparse.Namespace) -> Answer:
    """Locate the hidden object of each picture, and print how often the answers are right."""
    from classify.classifiers import models
    from classify.inference import evaluation
    from classify.report import page
    from generator.files.writing import write_text
    from generator.sets.measured import MeasuredSet
    from generator.sets.simulated import open_set

    models.check_seed(options.seed)
    if options.output:
        check_output(options.output, folder=True)
    atlas = loaded(options)
    dataset = open_set(options.dataset, options.count)
    if MeasuredSet.exists(options.dataset):
        return _of_photographs(photographs.locate(options, atlas, dataset))
    if options.watch is not None:
        raise NlosError(f"--watch: {options.dataset} was not made by nlos-classify import, which says how")
    with progress_bar("locating", "pictures") as progress:
        answers = evaluation.run(
            atlas,
            dataset,
            false_alarm=options.false_alarm,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    title = f"{options.dataset}, each with its 95 % interval"
    headings = ("voxel", "pictures", "right voxel", "median error", "within 95 % region", "detected")
    table = answers.rows()
    alarms = f"in empty scenes, something is found in {answers.false_alarms().percent()}"
    text: list[str | Table] = [
        Table(title, headings, table),
        alarms,
        f"an answer takes {1000.0 * float(np.median(answers.seconds)):.1f} ms (median)",
    ]
    text.extend(answers.doubts)
    files: list[Path] = []
    if options.output:
        write_text(options.output / "answers.csv", answers.csv())
        answers.draw(
            options.output / "answers.png",
            f"{options.dataset.name}: {len(answers.records)} pictures of a {dataset.target_kind}",
        )
        _, count, right, error, held, detected = table[-1]
        lead = [
            f"Of {count} pictures, {right} are put into the right voxel; the position is off by {error} (median).",
            f"The stated 95 % regions hold the truth in {held}.",
            f"Something is found in {detected}; {alarms}.",
        ]
        figures = {"answers.png": "What is taken for what, how far off, and whether the stated uncertainty is true."}
        sources = {"data set": options.dataset, **page.of_atlas(atlas), "seed of the noise": options.seed}
        tables = [page.Table(title, headings, table)]
        with stage("report"):
            page_file = page.write(options.output, "Where is the hidden object?", lead, figures, tables, sources)
        files = [options.output / "answers.csv", options.output / "answers.png", page_file]
        text.append(str(page_file))
    values = Located(
        quality=_quality(answers),
        accuracy=None,
        error=None,
        covered=None,
        false_alarms=interval(answers.false_alarms()),
        seconds=float(np.median(answers.seconds)),
        level=answers.level,
        mismatch=None,
        doubts=list(answers.doubts),
        answers=_locations(answers),
        files=files,
    )
    return Answer(values, text)


def _of_photographs(told: photographs.Told[Answers]) -> Answer:
    answers = told.answers
    values = Located(
        quality=[],
        accuracy=_or_none(answers.accuracy()),
        error=_or_none(answers.error()),
        covered=_or_none(answers.covered()),
        false_alarms=None,
        seconds=answers.seconds,
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
        files=told.files,
    )
    return Answer(values, told.lines, 1 if answers.doubts else 0)


def _of_walk(told: photographs.Told[Followed], labels: Sequence[str]) -> Answer:
    tracked = told.answers
    errors = tracked.errors
    values = Tracked(
        frames=[
            Frame(
                frame=record.index,
                there=None,
                presence=step.presence,
                label=labels[int(step.voxels.argmax())],
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
        words=told.lines,
        files=told.files,
    )
    return Answer(values, told.lines, 1 if tracked.doubts else 0)


def _or_none(value: object) -> Interval | None:
    return None if value is None else interval(value)


def _quality(answers: Evaluation) -> list[Quality]:
    return [
        Quality(
            voxel=label,
            pictures=count,
            accuracy=interval(accuracy),
            error=interval(error),
            covered=interval(covered),
            detected=interval(detected),
        )
        for label, count, accuracy, error, covered, detected in answers.by_voxel()
    ]


def _locations(answers: Evaluation) -> list[Location]:
    return [
        Location(
            file=record.file,
            truth=record.label,
            label=answers.labels[place.voxels.argmax()],
            probability=float(place.voxels.max()),
            true_position=list(record.position),
            position=place.position.tolist(),
            deviation=np.sqrt(np.diag(place.covariance)).tolist(),
            evidence=float(evidence),
            detected=bool(evidence > answers.detector.threshold),
            misfit=float(misfit),
        )
        for record, place, evidence, misfit in zip(
            answers.records, answers.places, answers.evidence, answers.misfits, strict=True
        )
    ]


def run_tradeoff(options: argparse.Namespace) -> Answer:
    """Print how far better pictures improve the answers."""
    from classify.classifiers import models
    from classify.inference import worth
    from classify.report import page
    from generator.measure import figures

    models.check_seed(options.seed)
    if options.noises < 1:
        raise NlosError(f"--noise-draws {options.noises}: must be 1 or more")
    if not options.folder.is_dir():
        raise NlosError(f"{options.folder}: no such folder")
    atlas = loaded(options)
    with progress_bar("answering", "ways to render") as progress:
        results = worth.worths(
            options.folder,
            atlas,
            false_alarm=options.false_alarm,
            noises=options.noises,
            seed=options.seed,
            progress=progress,
        )
    table, lead = worth.rows(results), worth.enough(results)
    frames = atlas.sensor.frames
    title = f"{options.folder}: {results[0].count} answers each, {frames} frame{'s' if frames > 1 else ''}"
    figures.save(options.folder / "worth.png", worth.draw(results, title))
    captions = {"worth.png": "Against the time that a picture takes to render, with 95 % intervals."}
    sources = {"pictures": options.folder, **page.of_atlas(atlas), "seed of the noise": options.seed}
    tables = [page.Table(title, worth.HEADINGS, table)]
    report = page.write(options.folder, "What are better pictures worth?", lead, captions, tables, sources)
    ways = [
        WayWorth(
            name=way.name,
            seconds=way.seconds,
            accuracy=interval(way.accuracy),
            error=interval(way.error),
            detected=interval(way.detected),
            answers=way.count,
        )
        for way in results
    ]
    values = Worths(ways=ways, words=lead, files=[options.folder / "worth.png", report])
    return Answer(values, [Table(title, worth.HEADINGS, table), *lead, str(report)])


def run_track(options: argparse.Namespace) -> Answer:
    """Track the object through the frames of a trajectory."""
    from classify.classifiers import models
    from classify.inference import sequence
    from classify.report import page
    from generator.files.writing import write_text
    from generator.sets.dataset import Dataset
    from generator.sets.measured import MeasuredSet

    models.check_seed(options.seed)
    gaps = [_gap(text) for text in options.gap]
    if options.output:
        check_output(options.output, folder=True)

    def report(so_far: sequence.TrackedSequence) -> None:
        record, step = so_far.records[-1], so_far.steps[-1]
        print(frame_words(record.index, step, atlas.grid.labels), flush=True)

    atlas = loaded(options)
    if MeasuredSet.exists(options.dataset):

        def report_one(record: PoseRecord, step: Step) -> None:
            print(frame_words(record.index, step, atlas.grid.labels), flush=True)

        measured = MeasuredSet.open(options.dataset)
        return _of_walk(photographs.track(options, atlas, measured, report_one), atlas.grid.labels)
    dataset = Dataset.open(options.dataset)
    for first, last in gaps:
        if first >= dataset.planned:
            raise NlosError(f"--gap {first}:{last}: begins after the last of the {dataset.planned} frames")
    tracked = sequence.run(
        atlas,
        dataset,
        step=options.step,
        gaps=gaps,
        patience=options.follow,
        seed=options.seed,
        told=report,
    )
    text, files = tracked.words(), []
    if options.output:
        write_text(options.output / "track.csv", tracked.csv())
        tracked.draw(options.output / "track.png", options.dataset.name)
        figures = {"track.png": "The path with its uncertainty, and the error over time."}
        sources = {"trajectory": options.dataset, **page.of_atlas(atlas), "seed of the noise": options.seed}
        page_file = page.write(options.output, "How does it move?", tracked.words(), figures, [], sources)
        files = [options.output / "track.csv", options.output / "track.png", page_file]
        text.append(str(page_file))
    values = Tracked(
        frames=[
            Frame(
                frame=record.index,
                there=there,
                presence=step.presence,
                label=atlas.grid.labels[step.voxels.argmax()],
                position=step.position.tolist(),
                deviation=np.sqrt(np.diag(step.covariance)).tolist(),
                covariance=step.covariance.tolist(),
                true_position=list(record.position),
            )
            for record, step, there in zip(tracked.records, tracked.steps, tracked.there, strict=True)
        ],
        error=interval(tracked.error()),
        trajectory_error=tracked.trajectory_error(),
        accuracy=interval(tracked.voxels()),
        covered=interval(tracked.held()),
        presence=interval(tracked.told()),
        found_again=tracked.reacquired(),
        atlas_covered=interval(tracked.atlas_covered),
        words=tracked.words(),
        files=files,
    )
    return Answer(values, text)


def frame_words(frame: int, step: Step, labels: Sequence[str]) -> str:
    """Return where an object is after a frame, in a line."""
    x, y, z = step.position
    place = f"{labels[int(step.voxels.argmax())]} at {x:.2f}, {y:.2f}, {z:.2f} m" if step.found else "nothing"
    return f"frame {frame}: {place} (presence {step.presence:.0%})"


def _gap(text: str) -> tuple[int, int]:
    first, _, last = text.partition(":")
    try:
        gap = (int(first), int(last))
    except ValueError:
        gap = (0, 0)
    if not 0 <= gap[0] < gap[1]:
        raise NlosError(f"--gap {text!r}: must read FROM:TO, two frames, for example 80:110")
    return gap


def run_detect(options: argparse.Namespace) -> Answer:
    """Print how often an object is found, at a given rate of false alarms."""
    from classify.classifiers import models
    from classify.inference import atlas_file, detect
    from classify.report import page
    from generator.files.writing import csv_text, write_text

    models.check_seed(options.seed)
    if options.count < 1:
        raise NlosError(f"--count {options.count}: must be 1 or more")
    if options.output:
        check_output(options.output, folder=True)
    atlas = atlas_file.load(options.atlas)
    most_frames = atlas.sensor.frames
    exposures = options.exposures or sorted({n for n in (*_LADDER, most_frames) if n <= most_frames})
    with progress_bar("looking", "exposures") as progress:
        detections = detect.detections(
            atlas,
            exposures,
            false_alarm=options.false_alarm,
            count=options.count,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    headings = ["voxel", "from the wall", *(f"{n} frame{'s' if n > 1 else ''}" for n in exposures)]
    table = detect.rows(atlas, detections)
    title = f"{options.atlas}: found, at {100.0 * options.false_alarm:g} % false alarms"
    text: list[str | Table] = [Table(title, headings, table)]
    files: list[Path] = []
    if options.output:
        write_text(options.output / "detect.csv", csv_text(headings, table))
        detect.draw(options.output / "detect.png", atlas, detections, options.false_alarm)
        last = detections[-1]
        shares = [interval.value for interval in last.found]
        hardest = int(np.nanargmin(shares))  # a voxel without poses has no share
        lead = [
            f"At {100.0 * options.false_alarm:g} % false alarms and {last.frames} frames, something in voxel "
            f"{atlas.grid.labels[hardest]} is found least often: {last.found[hardest].percent()}."
        ]
        figures = {"detect.png": "Left: against exposure, with 95 % intervals. Right: against false alarms."}
        sources = {**page.of_atlas(atlas), "pictures in each voxel": options.count, "seed": options.seed}
        tables = [page.Table("Found, with its 95 % interval", headings, table)]
        page_file = page.write(options.output, "Is there something?", lead, figures, tables, sources)
        files = [options.output / "detect.csv", options.output / "detect.png", page_file]
        text.append(str(page_file))
    voxels = [
        VoxelDetection(
            voxel=label,
            distance=float(np.mean(atlas.grid.bounds(voxel), axis=0)[1]),
            detected=[interval(detection.found[voxel]) for detection in detections],
        )
        for voxel, label in enumerate(atlas.grid.labels)
    ]
    values = Detections(false_alarm=options.false_alarm, frames=list(exposures), voxels=voxels, files=files)
    return Answer(values, text)


_LADDER = [n * 10**k for k in range(7) for n in (1, 3)]
