"""The verbs ``locate``, ``tradeoff``, ``track`` and ``detect``: answers from an atlas."""

from __future__ import annotations

import argparse

from classify.cli.options import check_output, loaded, progress_bar
from generator.cli.terminal import print_table
from generator.model.errors import NlosError


def run_locate(options: argparse.Namespace) -> int:
    import numpy as np

    from classify.classifiers import models
    from classify.inference import evaluation
    from classify.report import page
    from generator.files.writing import write_text
    from generator.sets.simulated import opened

    models.check_seed(options.seed)
    if options.output:
        check_output(options.output, folder=True)
    found = loaded(options)
    dataset = opened(options.dataset, options.count)
    with progress_bar("locating", "pictures") as progress:
        answers = evaluation.run(
            found,
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
        answers.draw(options.output / "answers.png", dataset.target_kind)
        _, count, right, error, held, detected = table[-1]
        lead = [
            f"Of {count} pictures, {right} are put into the right voxel; the position is off by {error} (median).",
            f"The stated 95 % regions hold the truth in {held}.",
            f"Something is found in {detected}; {alarms}.",
        ]
        figures = {"answers.png": "What is taken for what, how far off, and whether the stated uncertainty is true."}
        sources = {"data set": options.dataset, **page.of_atlas(found), "seed of the noise": options.seed}
        tables = [page.Table(title, headings, table)]
        print(page.write(options.output, "Where is the hidden object?", lead, figures, tables, sources))
    return 0


def run_tradeoff(options: argparse.Namespace) -> int:
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
        found = worth.worths(
            options.folder,
            atlas,
            false_alarm=options.false_alarm,
            noises=options.noises,
            seed=options.seed,
            progress=progress,
        )
    table, lead = worth.rows(found), worth.enough(found)
    frames = atlas.sensor.frames
    title = f"{options.folder}: {found[0].count} answers each, {frames} frame{'s' if frames > 1 else ''}"
    print_table(title, worth.HEADINGS, table)
    for line in lead:
        print(line)
    worth.draw(options.folder / "worth.png", found, title)
    drawn = {"worth.png": "Against the time that a picture takes to render, with 95 % intervals."}
    sources = {"pictures": options.folder, **page.of_atlas(atlas), "seed of the noise": options.seed}
    tables = [page.Table(title, worth.HEADINGS, table)]
    print(page.write(options.folder, "What are better pictures worth?", lead, drawn, tables, sources))
    return 0


def run_track(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from classify.inference import sequence
    from classify.report import page
    from generator.files.writing import write_text
    from generator.sets.dataset import Dataset

    models.check_seed(options.seed)
    gaps = [_gap(text) for text in options.gap]
    if options.output:
        check_output(options.output, folder=True)

    def told(so_far: sequence.Pursuit) -> None:
        record, step = so_far.records[-1], so_far.steps[-1]
        x, y, z = step.position
        label = found.grid.labels[step.voxels.argmax()]
        where = f"{label} at {x:.2f}, {y:.2f}, {z:.2f} m" if step.found else "nothing"
        print(f"frame {record.index}: {where} (presence {step.presence:.0%})", flush=True)

    found = loaded(options)
    followed = sequence.run(
        found,
        Dataset.open(options.dataset),
        step=options.step,
        gaps=gaps,
        patience=options.follow,
        seed=options.seed,
        told=told,
    )
    for line in followed.words():
        print(line)
    if options.output:
        write_text(options.output / "track.csv", followed.csv())
        followed.draw(options.output / "track.png", str(options.dataset))
        figures = {"track.png": "The path with its uncertainty, and the error over time."}
        sources = {"trajectory": options.dataset, **page.of_atlas(found), "seed of the noise": options.seed}
        print(page.write(options.output, "How does it move?", followed.words(), figures, [], sources))
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
    from classify.classifiers import models
    from classify.inference import atlas, detect
    from classify.report import page
    from generator.files.writing import csv_text, write_text

    models.check_seed(options.seed)
    if options.count < 1:
        raise NlosError(f"--count {options.count}: must be 1 or more")
    if options.output:
        check_output(options.output, folder=True)
    found = atlas.load(options.atlas)
    most = found.sensor.frames
    exposures = options.exposures or sorted({n for n in (*_LADDER, most) if n <= most})
    with progress_bar("looking", "exposures") as progress:
        made = detect.detections(
            found,
            exposures,
            false_alarm=options.false_alarm,
            count=options.count,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    headings = ["voxel", "from the wall", *(f"{n} frame{'s' if n > 1 else ''}" for n in exposures)]
    table = detect.rows(found, made)
    print_table(f"{options.atlas}: found, at {100.0 * options.false_alarm:g} % false alarms", headings, table)
    if options.output:
        write_text(options.output / "detect.csv", csv_text(headings, table))
        detect.draw(options.output / "detect.png", found, made, options.false_alarm)
        last = made[-1]
        least = min(range(len(last.found)), key=lambda voxel: last.found[voxel].value)
        lead = [
            f"At {100.0 * options.false_alarm:g} % false alarms and {last.frames} frames, something in voxel "
            f"{found.grid.labels[least]} is found least often: {last.found[least].percent()}."
        ]
        figures = {"detect.png": "Left: against exposure, with 95 % intervals. Right: against false alarms."}
        sources = {**page.of_atlas(found), "pictures in each voxel": options.count, "seed": options.seed}
        tables = [page.Table("Found, with its 95 % interval", headings, table)]
        print(page.write(options.output, "Is there something?", lead, figures, tables, sources))
    return 0


_LADDER = [n * 10**k for k in range(7) for n in (1, 3)]
