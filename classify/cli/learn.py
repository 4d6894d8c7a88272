"""The verbs ``compare``, ``learning-curve``, ``train`` and ``predict``: classifiers."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from classify.classifiers.names import ALL, NAMES
from classify.cli.options import add_seed, check_output, progress_bar
from generator.cli import console
from generator.cli.answer import Answer, Interval, Table, interval, json_object
from generator.cli.options import Commands
from generator.cli.parser import VerbParser, hide_alias
from generator.cli.volume import stage
from generator.model.described import described
from generator.model.errors import NlosError

if TYPE_CHECKING:
    from classify.classifiers.evaluate import Result
    from classify.classifiers.models import Model
    from generator.files.pictures import Picture


def add_parsers(commands: Commands) -> None:
    """Add the verbs ``compare``, ``train``, ``learning-curve`` and ``predict`` to a command line."""
    _add_compare(commands)
    _add_train(commands)
    _add_learning_curve(commands)
    _add_predict(commands)
    hide_alias(commands, "learn", "learning-curve")


def _add_compare(commands: Commands) -> None:
    parser = commands.add_parser(
        "compare",
        help="compare classifiers on one or two sets of features",
        description=f"Compare {', '.join(NAMES)}, by the paper's settings and tuned: each set cross-validated, and "
        "with two also trained on one and tested on the other.",
        epilog="example:\n  nlos-classify compare sheet.h5 sphere.h5 -o report/",
    )
    parser.add_argument("features", type=Path, nargs="+", metavar="FILE.h5", help="one or two")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="for tables, figures and page"
    )
    parser.add_argument("--folds", type=int, default=10, metavar="N", help="default: 10")
    add_seed(parser, "of folds and classifiers")
    _hyperparameters(parser, ["paper", "tuned", "both"], "both")
    parser.set_defaults(run=run_compare, answer=Comparison)


def _add_train(commands: Commands) -> None:
    parser = commands.add_parser(
        "train",
        help="train one classifier on all of a set, and save it",
        description="Train one classifier on all of a set, and save it with what it needs to read a picture.",
        epilog="example:\n  nlos-classify train sheet.h5 -o sheet.skops --classifier SVM",
    )
    parser.add_argument("features", type=Path, metavar="FILE.h5")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.skops")
    parser.add_argument(
        "--classifier", default="SVM", choices=ALL, metavar="NAME", help=f"one of {', '.join(ALL)} (default: SVM)"
    )
    add_seed(parser, "of the order of the pictures and of the classifiers")
    _hyperparameters(parser, ["paper", "tuned"], "tuned")
    parser.add_argument(
        "--cross-validate",
        action="store_true",
        help="also say how often it is right: in ten folds of the set, fewer where a voxel has fewer pictures",
    )
    parser.set_defaults(run=run_train, answer=Trained)


def _add_learning_curve(commands: Commands) -> None:
    parser = commands.add_parser(
        "learning-curve",
        help="say what more pictures to train on are worth",
        description="Train classifiers on more and more pictures of a set, and say how often each is right and how "
        "long it took: on a fifth of the set that is held out, or on another set.",
        epilog="example:\n  nlos-classify features simulated/ -o simulated.h5 --features physics --sensor default\n"
        "  nlos-classify learning-curve simulated.h5 --test sphere.h5 -o learned/ --classifiers RF SVM MLP",
    )
    parser.add_argument("features", type=Path, metavar="FILE.h5", help="to train on")
    parser.add_argument("--test", type=Path, metavar="FILE.h5", help="other pictures to test on")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="for report.html, learn.csv and learn.png"
    )
    parser.add_argument(
        "--classifiers",
        nargs="+",
        choices=ALL,
        metavar="NAME",
        help=f"some of {', '.join(ALL)} (default: all but MLP)",
    )
    parser.add_argument(
        "--train-sizes",
        dest="counts",
        type=int,
        nargs="+",
        metavar="N",
        help="numbers of pictures (default: 30, 100, 300, ... and all)",
    )
    add_seed(parser, "of the order of the pictures and of the classifiers")
    _hyperparameters(parser, ["paper", "tuned"], "paper")
    parser.alias("--counts", "--train-sizes")
    parser.set_defaults(run=run_learning_curve, answer=Curves)


def _add_predict(commands: Commands) -> None:
    parser = commands.add_parser(
        "predict",
        help="say in which voxel the object stands, picture by picture",
        description="Say for each picture in which voxel the object stands, and how probable each voxel is.",
        epilog="example:\n  nlos-classify predict sheet.skops sheet/E/0007.exr --json",
    )
    parser.add_argument("model", type=Path, metavar="FILE.skops")
    parser.add_argument(
        "pictures", type=Path, nargs="+", metavar="PICTURE.exr|SET", help="pictures, or one data set of them"
    )
    parser.add_argument(
        "--background",
        type=Path,
        metavar="FILE.exr",
        help="picture without the object (default: the training scene's)",
    )
    parser.set_defaults(run=run_predict, answer=Predictions)


def _hyperparameters(parser: VerbParser, choices: list[str], default: str) -> None:
    parser.add_argument(
        "--hyperparameters",
        dest="settings",
        choices=choices,
        default=default,
        help=f"those of the paper, or tuned by a search with cross-validation (default: {default})",
    )
    parser.alias("--settings", "--hyperparameters")


@json_object
class Compared:
    """A classifier in a scenario."""

    train: str = described("target of the pictures that it was trained on")
    test: str = described("target of the pictures that it was tested on")
    classifier: str = described("its name")
    hyperparameters: str = described("paper or tuned")
    accuracy: Interval = described("share of pictures that it puts into the right voxel")
    precision: Interval = described("mean over the voxels")
    recall: Interval = described("mean over the voxels")
    f1: Interval = described("mean over the voxels")
    folds: list[float] = described("accuracy of each fold; one entry where all of one set was tested")
    voxels: list[str] = described("labels of the voxels, in the order of the confusion matrix")
    confusion: list[list[int]] = described("pictures: a row for each true voxel, a column for each predicted one")
    train_seconds: float = described("mean time of a fit, with its search, seconds")
    predict_seconds: float = described("time per picture, seconds")
    unconverged: int = described("fits that ended at their iteration limit")


@json_object
class Comparison:
    """How good classifiers are."""

    results: list[Compared] = described("results of each scenario and classifier")
    duplicates: list[int] = described("pictures of each set with exactly the features of another")
    report: Path = described("page that was written")


@json_object
class CurvePoint:
    """A classifier that was trained on a number of pictures."""

    classifier: str = described("its name")
    train_size: int = described("pictures that it was trained on")
    accuracy: Interval = described("share of pictures that it puts into the right voxel")
    train_seconds: float = described("time of the fit, seconds")
    predict_seconds: float = described("time per picture, seconds")
    bytes: int = described("size of the trained model")
    converged: bool = described("whether the fit converged")


@json_object
class Curves:
    """What more pictures to train on are worth."""

    points: list[CurvePoint] = described("results, by classifier and number of pictures")
    words: list[str] = described("the best and its rivals, in sentences")
    report: Path = described("page that was written")


@json_object
class Trained:
    """A model that was trained."""

    path: Path = described("the model")
    classifier: str = described("its name")
    hyperparameters: str = described("paper or tuned")
    chosen: dict[str, str] = described("what the search chose; empty without one")
    accuracy: Interval | None = described(
        "share of pictures that it puts into the right voxel; null if not asked for"
    )
    folds: int = described("folds of the cross-validation that the accuracy is of; 0 if not asked for")


@json_object
class Prediction:
    """The answer to a picture."""

    picture: str = described("the picture")
    label: str = described("the most probable voxel")
    probability: dict[str, float] = described("probability of each voxel")
    misfit: float | None = described(
        "probability that a picture like those of the training is as far from them; null if the model does not tell"
    )


@json_object
class Predictions:
    """In which voxel the object stands."""

    answers: list[Prediction] = described("answers, picture by picture")
    doubts: list[str] = described("what speaks against these answers, in sentences; exit code 1 if anything does")


def run_compare(options: argparse.Namespace) -> Answer:
    """Compare classifiers, and write the report."""
    from classify.classifiers import evaluate, models
    from classify.pictures import feature_table
    from classify.report import comparison

    if len(options.features) > 2:
        raise NlosError(f"compare: takes one or two features files, not {len(options.features)}")
    if options.folds < 2:
        raise NlosError(f"--folds {options.folds}: must be 2 or more")
    check_output(options.output, folder=True)
    sets = [feature_table.read(path) for path in options.features]
    names = [str(path) for path in options.features]
    for features, name in zip(sets, names, strict=True):
        if features.duplicates:
            console.complain(
                f"warning: {name}: {features.duplicates} of {len(features.values)} pictures have exactly the "
                "features of another; where both sides of a fold hold one, accuracy is flattered"
            )
    chosen: list[models.Settings] = ["paper", "tuned"] if options.settings == "both" else [options.settings]
    with progress_bar("comparing", "classifiers") as progress:
        results = evaluate.compare(
            sets, names, settings=chosen, folds=options.folds, seed=options.seed, progress=progress
        )
    with stage("report"):
        page = comparison.write(options.output, results, sets, names, options.folds)
    table = Table(
        "accuracy with its 95 % interval",
        ("scenario", "classifier", "paper's", "its settings, here", "tuned, here"),
        comparison.text_table(results),
    )
    unconverged = sum(r.unconverged for r in results)
    lines = [f"{unconverged} fits ended at their iteration limit, before they converged"] if unconverged else []
    values = Comparison(
        results=[_compared(result) for result in results],
        duplicates=[features.duplicates for features in sets],
        report=page,
    )
    return Answer(values, [table, *lines, str(page)])


def _compared(result: Result) -> Compared:
    return Compared(
        train=result.train,
        test=result.test,
        classifier=result.classifier,
        hyperparameters=result.settings,
        accuracy=interval(result.accuracy),
        precision=interval(result.precision),
        recall=interval(result.recall),
        f1=interval(result.f1),
        folds=result.folds,
        voxels=result.labels,
        confusion=result.confusion.tolist(),
        train_seconds=result.train_seconds,
        predict_seconds=result.predict_seconds,
        unconverged=result.unconverged,
    )


def run_learning_curve(options: argparse.Namespace) -> Answer:
    """Draw learning curves."""
    from classify.classifiers import curves, evaluate
    from classify.pictures import feature_table
    from classify.report import page
    from generator.files.writing import csv_text, write_text

    check_output(options.output, folder=True)
    train = feature_table.read(options.features)
    test = feature_table.read(options.test) if options.test else None
    with progress_bar("learning", "fits") as progress:
        points = curves.curves(
            train,
            test,
            classifiers=options.classifiers or tuple(NAMES),
            settings=options.settings,
            counts=options.counts or (),
            seed=options.seed,
            names=(str(options.features), str(options.test)),
            progress=progress,
        )
    table = curves.rows(points)
    tested_on = options.test or f"{100 * curves.HELD_OUT:.0f} % of it, held out"
    title = f"{options.features}, tested on {tested_on}"
    best = max(points, key=lambda point: point.accuracy.value)
    accuracy = f"{evaluate.as_best(best.right, among=len(points)).percent()}, as best of {len(points)}"
    lead = [f"{best.classifier} on {best.count} pictures is right most often: {accuracy}."]
    if rivals := curves.rivals(points, best):
        lead.append(f"Not told apart from it by these pictures: {', '.join(rivals)}.")
    write_text(options.output / "learn.csv", csv_text(curves.HEADINGS, table))
    curves.draw(options.output / "learn.png", points, title)
    plots = {"learn.png": "Accuracy with its 95 % interval, against the number of pictures and the time of training."}
    sources = {"trained on": options.features, "tested on": options.test or "a part held out", "seed": options.seed}
    tables = [page.Table(title, curves.HEADINGS, table)]
    report = page.write(options.output, "What are more pictures worth?", lead, plots, tables, sources)
    found = [
        CurvePoint(
            classifier=point.classifier,
            train_size=point.count,
            accuracy=interval(point.accuracy),
            train_seconds=point.train_seconds,
            predict_seconds=point.predict_seconds,
            bytes=point.size,
            converged=not point.unconverged,
        )
        for point in points
    ]
    text: list[str | Table] = [Table(title, curves.HEADINGS, table), " ".join(lead), str(report)]
    return Answer(Curves(points=found, words=lead, report=report), text)


def run_train(options: argparse.Namespace) -> Answer:
    """Train a classifier, and save it."""
    from classify.classifiers import models
    from classify.pictures import feature_table

    check_output(options.output)
    features = feature_table.read(options.features)
    tested = None
    if options.cross_validate:
        from classify.classifiers import evaluate

        with progress_bar("cross-validating", "folds") as progress:
            tested = evaluate.cross_validated(
                features, options.classifier, options.settings, seed=options.seed, progress=progress
            )
    with stage("training"):
        model = models.train(features, options.classifier, options.settings, seed=options.seed)
        models.save(options.output, model)
    found = {str(name): str(value) for name, value in model.about["chosen"].items()}
    chosen = ", ".join(f"{name} = {value}" for name, value in found.items())
    values = Trained(
        path=options.output,
        classifier=options.classifier,
        hyperparameters=options.settings,
        chosen=found,
        accuracy=interval(tested.accuracy) if tested else None,
        folds=len(tested.folds) if tested else 0,
    )
    line = f"{options.output}: {options.classifier}, {options.settings} settings{f' ({chosen})' if chosen else ''}"
    accuracy = [f"right voxel: {tested.accuracy.percent()}, in {len(tested.folds)} folds"] if tested else []
    return Answer(values, [line, *accuracy])


def _pictures(
    paths: list[Path], read: Callable[[Path], Picture], model: Model
) -> tuple[Iterable[tuple[Path, Picture]], Picture | None]:
    """Return pictures with their names, and the empty scene if they are a data set."""
    if not any(path.is_dir() for path in paths):
        return ((path, read(path)) for path in paths), None
    if len(paths) > 1:
        raise NlosError(f"predict: takes pictures, or one data set; {len(paths)} were named")
    import numpy as np

    from classify.pictures.taken import level_of
    from generator.sets.measured import has_own_noise
    from generator.sets.readable import check_colours
    from generator.sets.simulated import open_set

    dataset = open_set(paths[0])
    if dataset.own_backgrounds:
        raise NlosError(f"{paths[0]}: has a background a picture; name pictures and a --background")
    empty, level = dataset.background(), np.float32(1.0)
    check_colours(paths[0], dataset.colour_space, model.colour_space, "the model")
    if has_own_noise(dataset):
        level = np.float32(level_of(*(p.mean(axis=2, dtype=np.float64) for p in (empty, model.background)))[0])
    pictures = ((dataset.path / record.file, dataset.picture(record) * level) for record in dataset.records)
    return pictures, empty * level


def run_predict(options: argparse.Namespace) -> Answer:
    """Print the voxel that a model predicts for each picture."""
    import numpy as np

    from classify import tail
    from classify.classifiers import models
    from generator.files.pictures import COLOUR_SPACE, read_picture
    from generator.sets.readable import check_colours

    model = models.load(options.model)

    def read(path: Path) -> Picture:
        pixels, header = read_picture(path)
        check_colours(path, header.get("colour_space", COLOUR_SPACE), model.colour_space, str(options.model))
        return pixels

    pictures, background = _pictures(options.pictures, read, model)
    background = read(options.background) if options.background else background
    if background is not None and model.settings.input == "raw":
        console.complain("note: --background: means nothing to this model, whose features are of the raw picture")
    doubts = [] if background is None else models.doubts(model, background)
    found, lines = [], []
    for path, picture in pictures:
        voxels, misfit = model.judged(picture, background=background, name=str(path))
        likely = sorted(voxels.items(), key=lambda item: -item[1])
        found.append(Prediction(picture=str(path), label=likely[0][0], probability=voxels, misfit=misfit))
        shown = "  ".join(f"{voxel} {p:.1%}" for voxel, p in likely if p >= 5e-4)
        unlike = misfit is not None and misfit < tail.RARE
        lines.append(f"{path}: {likely[0][0]}   {shown}{f'   (unlike the training: {misfit:.1g})' if unlike else ''}")
    known = np.array([answer.misfit for answer in found if answer.misfit is not None])
    rare, surprising = tail.more_than_chance(known)
    if surprising:
        several = f"{rare} of {len(found)} pictures are" if len(found) > 1 else "the picture is"
        doubts.append(
            f"{several} unlike all that {options.model} was trained on, as {tail.RARE:.0%} would be by chance; do "
            "not rely on such answers"
        )
    return Answer(Predictions(answers=found, doubts=doubts), [*lines, *doubts], 1 if doubts else 0)
