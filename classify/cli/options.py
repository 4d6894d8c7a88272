"""Options that several verbs share."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from generator.cli import volume
from generator.cli.terminal import LineProgress, left_words
from generator.jobs.remaining import Remaining
from generator.model.errors import NlosError

if TYPE_CHECKING:
    from classify.inference.atlas import Atlas
    from classify.pictures.sensor import Sensor


def add_sensor_options(parser: argparse.ArgumentParser, otherwise: str = "by the default sensor") -> None:
    """Add the options for the camera's sensor and its frames."""
    parser.add_argument(
        "--sensor",
        metavar="default|FILE.toml",
        help="see the pictures through a camera's sensor; the file is one of nlos-classify sensor, or names some of "
        "the fields of classify.Sensor. The default has a full well of 10,500 electrons, the brightest pixel at "
        f"80 %% of it, a read noise of 2.5, 12 bits (without it: {otherwise})",
    )
    parser.add_argument("--frames", type=int, metavar="N", help="that the sensor averages for a picture (default: 1)")
    parser.add_argument(
        "--exposure-time",
        type=float,
        metavar="S",
        help="of a frame, seconds, in which dark charge collects (default: 0)",
    )


def add_atlas_options(parser: argparse.ArgumentParser, *, voxels: bool = False) -> None:
    """Add the options that `loaded` reads: the frames, and the voxels."""
    parser.add_argument(
        "--frames", type=int, metavar="N", help="to average, no more than the atlas was made for (default: as many)"
    )
    if voxels:
        parser.add_argument(
            "--voxels",
            type=int,
            nargs=3,
            metavar=("NX", "NY", "NZ"),
            help="cut the volume into others than the scene's; for sets with --inside centre, which leave no gaps",
        )


def add_false_alarm(parser: argparse.ArgumentParser) -> None:
    """Add ``--false-alarm``."""
    parser.add_argument(
        "--false-alarm", type=float, default=0.01, metavar="P", help="share of empty scenes (default: 0.01)"
    )


def add_seed(parser: argparse.ArgumentParser, words: str, default: int | None = 0) -> None:
    """Add ``--seed``; ``words`` names what it seeds."""
    parser.add_argument("--seed", type=int, default=default, metavar="N", help=f"{words} (default: 0)")


def sensor_of(options: argparse.Namespace) -> Sensor:
    """Return the sensor that the options ask for."""
    from dataclasses import replace

    from classify.pictures import sensor_file
    from classify.pictures.sensor import Sensor

    sensor = Sensor()
    if options.sensor not in (None, "default"):
        sensor = sensor_file.read(Path(options.sensor))
    own = {name: getattr(options, name, None) for name in ("frames", "exposure_time")}
    return replace(sensor, **{name: value for name, value in own.items() if value is not None})


def check_output(path: Path, *, folder: bool = False) -> None:
    """Raise NlosError before the work starts if its result cannot be written."""
    if path.exists() and path.is_dir() != folder:
        raise NlosError(f"{path}: is a {'file' if folder else 'folder'}; name a {'folder' if folder else 'file'}")
    existing = next(p for p in [path, *path.absolute().parents] if p.exists())
    if not (path.exists() or existing.is_dir()) or not os.access(existing, os.W_OK):
        raise NlosError(f"{path}: cannot be written")


@contextlib.contextmanager
def progress_bar(what: str, unit: str) -> Iterator[Callable[[int, int, str], None]]:
    """Yield a function that shows the progress: as a bar, or as lines in a log."""
    with volume.stage(what):
        if volume.current().quiet or not sys.stderr.isatty():
            lines = LineProgress(unit)  # says nothing if it is to be quiet
            yield lambda done, total, now: lines(done, total)
            return
        with _bar(what) as show:
            yield show


@contextlib.contextmanager
def _bar(what: str) -> Iterator[Callable[[int, int, str], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    remaining = Remaining()
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)

        def show(done: int, total: int, now: str) -> None:
            left = left_words(remaining.told(done, total))
            bar.update(task, completed=done, total=total, description=f"{now or what}{left}")

        yield show


def loaded(options: argparse.Namespace) -> Atlas:
    """Return the named atlas, for the frames and divided into the voxels that the options ask for."""
    from classify.inference import atlas_file

    atlas = atlas_file.load(options.atlas)
    atlas = atlas if options.frames is None else atlas.at(options.frames)
    voxels = getattr(options, "voxels", None)
    return atlas if voxels is None else atlas.cut(tuple(voxels))
