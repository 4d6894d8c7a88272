"""The verbs ``locate``, ``tradeoff``, ``track`` and ``detect``: answers from an atlas."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from classify.cli.options import (
    RAW,
    Commands,
    add_atlas_options,
    add_false_alarm,
    add_seed,
    check_output,
    loaded,
    progress_bar,
)
from generator.cli.terminal import print_table
from generator.model.errors import NlosError


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
        formatter_class=RAW,
    )
    parser.add_argument("atlas", type=Path, metavar="FILE.atlas")
    parser.add_argument(
        "dataset", type=Path, help="folder of a data set, or a simulated one; its pictures are clean, noise is added"
    )
    parser.add_argument(
        "--count",
        type=int,
        default=0,
        metavar="N",
        help="take the first N pictures of a simulated set (default: all)",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="for report.html and answers.csv")
    add_seed(parser, "of the sensor's noise")
    add_false_alarm(parser)
    add_atlas_options(parser, voxels=True)
    parser.set_defaults(run=run_locate)


def _add_tradeoff(commands: Commands) -> None:
    parser = commands.add_parser(
        "tradeoff",
        help="say what better pictures are worth",
        description="Answer the pictures that nlos-generate tradeoff rendered in every way, through the atlas' "
        "sensor: from which samples on the sensor's noise decides, and rendering no longer.",
        epilog="example:\n  nlos-generate tradeoff room.blend -o trade/\n  nlos-classify tradeoff trade/ room.atlas",
        formatter_class=RAW,
    )
    parser.add_argument("folder", type=Path, help="of nlos-generate tradeoff")
    parser.add_argument("atlas", type=Path, metavar="FILE.atlas")
    parser.add_argument("--noises", type=int, default=5, metavar="N", help="looks at each picture (default: 5)")
    add_seed(parser, "of the sensor's noise")
    add_false_alarm(parser)
    add_atlas_options(parser)
    parser.set_defaults(run=run_tradeoff)


def _add_track(commands: Commands) -> None:
    parser = commands.add_parser(
        "track",
        help="follow an object that moves, frame by frame",
        description="Follow a known object through the frames of a trajectory, as the atlas' sensor would have seen "
        "them: where it is after each, how sure, and how far from the truth.",
        epilog="example:\n  nlos-generate trajectory room.blend -o walk/ --frames 200 --engine surfel\n"
        "  nlos-classify track room.atlas walk/ -o track/ --gap 80:110",
        formatter_class=RAW,
    )
    parser.add_argument(
        "atlas", type=Path, metavar="FILE.atlas", help="of poses that fill the volume: --inside centre"
    )
    parser.add_argument("dataset", type=Path, help="folder of the trajectory")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="for report.html, track.csv and track.png"
    )
    parser.add_argument(
        "--step",
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
    parser.set_defaults(run=run_track)


def _add_detect(commands: Commands) -> None:
    parser = commands.add_parser(
        "detect",
        help="say how often an object is found, against exposure and distance",
        description="Say how often the atlas' object is found at a chosen rate of false alarms, voxel by voxel and "
        "for several exposures: where and how long one has to look.",
        epilog="example:\n  nlos-classify atlas simulated/ -o room.atlas --frames 1000 --sensor long.toml\n"
        "  nlos-classify detect room.atlas -o detect/ --exposures 1 10 100 1000",
        formatter_class=RAW,
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
    parser.set_defaults(run=run_detect)


def run_locate(options: argparse.Namespace) -> int:
    """Locate the hidden object of each picture, and print how often the answers are right."""
    import numpy as np

    from classify.classifiers import models
    from classify.inference import evaluation
    from classify.report import page
    from generator.files.writing import write_text
    from generator.sets.simulated import open_set

    models.check_seed(options.seed)
    if options.output:
        check_output(options.output, folder=True)
    atlas = loaded(options)
    dataset = open_set(options.dataset, options.count)
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
    print_table(title, headings, table)
    alarms = f"in empty scenes, something is found in {answers.false_alarms().percent()}"
    print(alarms)
    print(f"an answer takes {1000.0 * float(np.median(answers.seconds)):.1f} ms (median)")
    if answers.level != 1.0:
        print(
            f"exposed {answers.level:.3g} times as long as the atlas, so that the empty scene is as bright as there: "
            "right if the relay wall, the lamp or the camera is another, wrong if the room is"
        )
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
        print(page.write(options.output, "Where is the hidden object?", lead, figures, tables, sources))
    return 0


def run_tradeoff(options: argparse.Namespace) -> int:
    """Print how far better pictures improve the answers."""
    from classify.classifiers import models
    from classify.inference import worth
    from classify.report import page

    models.check_seed(options.seed)
    if options.noises < 1:
        raise NlosError(f"--noises {options.noises}: must be 1 or more")
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
    print_table(title, worth.HEADINGS, table)
    for line in lead:
        print(line)
    worth.draw(options.folder / "worth.png", results, title)
    figures = {"worth.png": "Against the time that a picture takes to render, with 95 % intervals."}
    sources = {"pictures": options.folder, **page.of_atlas(atlas), "seed of the noise": options.seed}
    tables = [page.Table(title, worth.HEADINGS, table)]
    print(page.write(options.folder, "What are better pictures worth?", lead, figures, tables, sources))
    return 0


def run_track(options: argparse.Namespace) -> int:
    """Track the object through the frames of a trajectory."""
    from classify.classifiers import models
    from classify.inference import sequence
    from classify.report import page
    from generator.files.writing import write_text
    from generator.sets.dataset import Dataset

    models.check_seed(options.seed)
    gaps = [_gap(text) for text in options.gap]
    if options.output:
        check_output(options.output, folder=True)

    def report(so_far: sequence.TrackedSequence) -> None:
        record, step = so_far.records[-1], so_far.steps[-1]
        x, y, z = step.position
        label = atlas.grid.labels[step.voxels.argmax()]
        place = f"{label} at {x:.2f}, {y:.2f}, {z:.2f} m" if step.found else "nothing"
        print(f"frame {record.index}: {place} (presence {step.presence:.0%})", flush=True)

    atlas = loaded(options)
    tracked = sequence.run(
        atlas,
        Dataset.open(options.dataset),
        step=options.step,
        gaps=gaps,
        patience=options.follow,
        seed=options.seed,
        told=report,
    )
    for line in tracked.words():
        print(line)
    if options.output:
        write_text(options.output / "track.csv", tracked.csv())
        tracked.draw(options.output / "track.png", options.dataset.name)
        figures = {"track.png": "The path with its uncertainty, and the error over time."}
        sources = {"trajectory": options.dataset, **page.of_atlas(atlas), "seed of the noise": options.seed}
        print(page.write(options.output, "How does it move?", tracked.words(), figures, [], sources))
    return 0


def _gap(text: str) -> tuple[int, int]:
    first, _, last = text.partition(":")
    try:
        gap = (int(first), int(last))
    except ValueError:
        gap = (0, 0)
    if not 0 <= gap[0] < gap[1]:
        raise NlosError(f"--gap {text!r}: must read FROM:TO, two frames, for example 80:110")
    return gap


def run_detect(options: argparse.Namespace) -> int:
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
    print_table(f"{options.atlas}: found, at {100.0 * options.false_alarm:g} % false alarms", headings, table)
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
        print(page.write(options.output, "Is there something?", lead, figures, tables, sources))
    return 0


_LADDER = [n * 10**k for k in range(7) for n in (1, 3)]
