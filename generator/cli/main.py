"""Command line of the generator: argument parsing and words for people; all work is done elsewhere."""

from __future__ import annotations

import argparse
import contextlib
import functools
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from generator.cli import console
from generator.jobs import budget
from generator.jobs.remaining import Remaining
from generator.jobs.sweep import NO_BLENDER, clock
from generator.measure import plan_file
from generator.model import spec
from generator.model.spec import NlosError, Sweep
from generator.sets import audit, links
from generator.sets.dataset import Dataset

if TYPE_CHECKING:
    from generator.jobs.sweep import Outcome
    from generator.sets.bulk import Bulk

_FRAMES = 200

_EXAMPLES = """\
examples:
  nlos-generate scene room --target sphere -o room.blend
  nlos-generate sweep room.blend -o sphere/ --poses 100 --engine patch
  nlos-generate bulk room.blend -o million/ --pictures 1000000
  nlos-generate verify sphere/
"""


def main(argv: list[str] | None = None) -> int:
    """Run ``nlos-generate``.

    Returns
    -------
    int
        The exit code: 0 well, 1 unfinished or faulty, 2 bad input, 130 interrupted, 141 nobody reads on.
    """
    return guarded(lambda: _run(argv))


def _run(argv: list[str] | None) -> int:
    options = _parser().parse_args(argv)
    with links.trusting(getattr(options, "trust_links", False)):
        return int(options.run(options))


def guarded(work: Callable[[], int], interrupted: str = "interrupted; the same command goes on from here") -> int:
    """Run a command and return its exit code.

    Bad input, no Blender, or an output that cannot be written become one sentence and 2, Ctrl-C a word and 130. When
    whoever reads the output has left, as ``head`` does, the command ends without a word and with 141, as one that the
    system ends for it.
    """
    try:
        with console.told_apart():
            return work()
    except console.Unwritable as error:
        if error.unread:
            return 128 + 13  # SIGPIPE's number
        return _refused(f"standard output cannot be written ({error})")
    except NlosError as error:
        return _refused(error)
    except ImportError as error:
        if error.name != "bpy":
            raise
        missing = isinstance(error, ModuleNotFoundError)
        lacking = f"Blender's module bpy does not load, for a system library is missing: {error}"
        return _refused(NO_BLENDER if missing else lacking)
    except KeyboardInterrupt:
        console.complain(f"\n{interrupted}")
        return 130


def _refused(why: object) -> int:
    console.complain(f"error: {why}")
    return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="nlos-generate",
        description="Build scenes with an object hidden around the corner, and render what a wall shows of it.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    scene = commands.add_parser(
        "scene",
        help="build a scene and save it as a .blend file",
        description="Build a preset scene and save it as a .blend file, which Blender can open and edit. "
        "Every figure can be changed: see them with --show, change one with --set, or many with --config.",
        epilog="example:\n  nlos-generate scene room --target sphere --set spot.power=500 -o room.blend",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    scene.add_argument("preset", choices=["room", "tabletop", "corridor"])
    scene.add_argument(
        "--target", default="sheet", metavar="sheet|sphere|FILE", help="the hidden object (default: sheet)"
    )
    scene.add_argument("-o", "--output", type=Path, metavar="FILE.blend", help="where to save it")
    scene.add_argument("--config", type=Path, metavar="FILE.toml", help="figures that replace the preset's")
    scene.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="one figure, e.g. grid.shape=[3,3,3]; repeatable",
    )
    scene.add_argument(
        "--ambient",
        type=float,
        metavar="RADIANCE",
        help="uniform ambient light, W/m^2/sr; a closed room loses its ceiling, so that light can enter",
    )
    scene.add_argument("--show", action="store_true", help="print every figure as TOML (to edit, for --config)")
    scene.set_defaults(run=_scene)

    sweep = commands.add_parser(
        "sweep",
        help="render a data set: the target at many poses in every voxel",
        description="Move the target through its voxels and render what the camera sees of the relay wall. "
        "Interrupt it at any time: the same command goes on where it stopped. What is left out "
        "follows from the data set, if there is one, else from the scene.",
        epilog="example:\n  nlos-generate sweep room.blend -o sheet/ --poses 100 --engine patch --samples 512",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    sweep.add_argument("scene", type=Path, help="the .blend file")
    _add_sweep_options(sweep)
    sweep.add_argument(
        "--workers", type=int, default=0, metavar="W", help="processes (default: one per core; on a GPU four)"
    )
    sweep.add_argument(
        "--budget",
        type=_told(budget.seconds),
        metavar="T",
        help="90s, 10min, 2h: take the engine, and the samples or accuracy, with which a new set ends in that time, "
        "measured on this scene and machine",
    )
    sweep.add_argument(
        "--plan", type=Path, metavar="PLAN", help="model what nlos-generate plan found needed, and no more"
    )
    sweep.add_argument(
        "--jobs", type=int, metavar="N", help="render as an array of N jobs on a cluster that shares the folder"
    )
    sweep.add_argument(
        "--cluster", choices=["slurm", "local", "debug"], default="slurm", help="of --jobs (default: slurm)"
    )
    sweep.add_argument(
        "--job",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="of --jobs, an option of submitit, e.g. slurm_partition=gpu or timeout_min=120; repeatable",
    )
    sweep.set_defaults(run=_sweep)

    trajectory = commands.add_parser(
        "trajectory",
        help="render a data set of a target that moves: frame after frame, for track",
        description="As sweep does, but the target walks through the voxels, straight from one random pose to the "
        "next, and its pictures are frames, one after the other.",
        epilog="example:\n  nlos-generate trajectory room.blend -o walk/ --frames 200 --pace 0.03 --engine surfel",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    trajectory.add_argument("scene", type=Path, help="the .blend file")
    _add_sweep_options(trajectory, frames=True)
    trajectory.add_argument(
        "--workers", type=int, default=0, metavar="W", help="processes (default: one per core; on a GPU four)"
    )
    trajectory.set_defaults(run=_trajectory)

    bulk = commands.add_parser(
        "bulk",
        help="make a very large set: up to millions of pictures in a few hundred HDF5 files",
        description="As sweep does, with the engine surfel, but straight into HDF5: set.h5 shows all pictures as one "
        "array. Interrupt it at any time: the same command goes on where it stopped. What is left out "
        "follows from the set, if there is one, else from the scene.",
        epilog="example:\n  nlos-generate bulk room.blend -o million/ --pictures 1000000 --resolution 64",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    bulk.add_argument("scene", type=Path, help="the .blend file")
    bulk.add_argument("-o", "--output", type=Path, required=True, metavar="SET", help="folder of the set")
    bulk.add_argument("--pictures", type=int, metavar="N", help="in all voxels together; needed for a new set")
    _add_pose_options(bulk, "of all poses")
    bulk.add_argument("--accuracy", type=float, metavar="A", help="relative error of a picture (default: 0.001)")
    bulk.add_argument(
        "--compress",
        action=argparse.BooleanOptionalAction,
        help="smaller files, several times slower to write and to read (default: off)",
    )
    bulk.add_argument(
        "--unknown",
        action=argparse.BooleanOptionalAction,
        help="at every pose another box or sheet in place of the target, for an object that nobody knows",
    )
    bulk.add_argument("--part", type=int, metavar="N", help="pictures per file (default: about 64 MiB)")
    bulk.add_argument("--shard", default="0/1", metavar="i/n", help="make the i-th of n shares only (from 0)")
    bulk.add_argument("--workers", type=int, default=0, metavar="W", help="processes (default: one per core)")
    _add_force_option(bulk)
    _add_probe_option(bulk)
    _add_links_option(bulk)
    bulk.set_defaults(run=_bulk)

    checked = commands.add_parser(
        "check",
        help="say what would spoil a sweep of a scene, and what it will cost",
        description="Look for lines of sight that must not be, voxels that see no light and all else that makes a "
        "sweep worthless, and measure signal, noise, time and disk by a few quick renders. Exit code 1 if "
        "an error is found.",
        epilog="example:\n  nlos-generate check room.blend --engine patch --samples 192",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    checked.add_argument("scene", type=Path, help="the .blend file")
    checked.add_argument("--poses", type=int, metavar="N", help=f"per voxel (default: {Sweep().poses})")
    _add_engine_options(checked)
    _add_pose_options(checked, "of all poses and all noise")
    _add_links_option(checked)
    checked.set_defaults(run=_check)

    experiment = commands.add_parser(
        "experiment",
        help="the paper's experiments 1 to 3: what a movement or a turn of the object changes",
        description="Move a sphere (1) or a square sheet (2) along x, y and z, or turn both about them (3), and show "
        "what that changes: difference pictures with their amplification, the change per centimetre or degree, and "
        "the paper's claims, tested. Without a scene of your own: on the tabletop and in the room, dark and under "
        "ambient light.",
        epilog="example:\n  nlos-generate experiment 2 -o experiment-2/",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    experiment.add_argument("number", type=int, choices=[1, 2, 3])
    experiment.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="for tables and pictures"
    )
    experiment.add_argument("--scene", type=Path, metavar="FILE.blend", help="take this one, as it is lit")
    experiment.add_argument(
        "--ambient",
        type=float,
        default=1.0,
        metavar="A",
        help="ambient light on the wall, in units of the object's own signal; 0 leaves it out (default: 1)",
    )
    experiment.add_argument("--resolution", type=int, default=64, metavar="N", help="pixels a side (default: 64)")
    experiment.add_argument(
        "--samples", type=int, default=128, metavar="N", help="of Cycles, under ambient light (default: 128)"
    )
    experiment.add_argument(
        "--repeats", type=int, default=8, metavar="N", help="with other noise, for intervals (default: 8)"
    )
    _add_links_option(experiment)
    experiment.set_defaults(run=_experiment)

    trade = commands.add_parser(
        "tradeoff",
        help="measure what a picture costs and how wrong it is, for engines and settings",
        description="Render the same poses by a ladder of engines, samples and accuracies, with and without denoiser "
        "and pairing, and say what each costs on this machine and how far it is from the reference. Interrupt it "
        "at any time: the same command goes on.",
        epilog="example:\n  nlos-generate tradeoff room.blend -o trade/\n  nlos-classify tradeoff trade/ room.atlas",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    trade.add_argument("scene", type=Path, help="the .blend file")
    trade.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="a data set for each way")
    trade.add_argument("--poses", type=int, default=3, metavar="N", help="per voxel (default: 3)")
    trade.add_argument("--seed", type=int, default=0, metavar="N", help="of all poses and all noise (default: 0)")
    trade.add_argument("--resolution", metavar="R", help="64 or 64x48 (default: the scene's)")
    trade.add_argument(
        "--most",
        type=_told(budget.seconds),
        default=600.0,
        metavar="T",
        help="leave out what would take longer, judged by the cheaper (default: 10min)",
    )
    trade.add_argument("--workers", type=int, default=0, metavar="W", help="processes (default: one per core)")
    _add_force_option(trade)
    _add_links_option(trade)
    trade.set_defaults(run=_tradeoff)

    plan = commands.add_parser(
        "plan",
        help="measure what a scene needs modelled, and plan a sweep that models no more",
        description="Leave out one thing after the other - the object's shadow on the room, the extent of the lit "
        "patch, each surface, other lights, materials that are not plain, further reflections - and say by how much "
        "the difference picture is then wrong. What may be left out within a tolerance is left out of the plan, "
        "which sweep --plan follows.",
        epilog="example:\n  nlos-generate plan room.blend --tolerance 1% -o plan/\n"
        "  nlos-generate sweep room.blend -o set/ --plan plan/",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    plan.add_argument("scene", type=Path, help="the .blend file")
    plan.add_argument(
        "--tolerance",
        type=_told(budget.fraction),
        default=0.01,
        metavar="A",
        help="error of a difference picture that is allowed, 0.01 or 1%% (default: 1%%)",
    )
    plan.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="for plan.toml, plan.csv and plan.png")
    plan.add_argument(
        "--poses", type=int, default=plan_file.POSES, metavar="N", help=f"per voxel (default: {plan_file.POSES})"
    )
    plan.add_argument("--seed", type=int, default=0, metavar="N", help="of the poses (default: 0)")
    plan.add_argument(
        "--most",
        type=_told(budget.seconds),
        default=180.0,
        metavar="T",
        help="time for what only Cycles models, which has noise (default: 3min)",
    )
    plan.add_argument("--workers", type=int, default=0, metavar="W", help="of the sweep (default: one per core)")
    _add_links_option(plan)
    plan.set_defaults(run=_plan)

    verify = commands.add_parser(
        "verify",
        help="re-read a whole data set and list what is wrong",
        description="Re-read every picture and compare it with the manifest; exit code 1 if anything is wrong.",
    )
    verify.add_argument("dataset", type=Path)
    verify.set_defaults(run=_verify)

    status = commands.add_parser(
        "status",
        help="say how far a data set is and what its runs are doing, from another shell",
        description="Say how many pictures are done, at what rate and until when, what failed, and what each worker "
        "of each run is doing, on this machine and on others that share the folder. What happened to them is in "
        "DATASET/log.txt.",
        epilog="example:\n  nlos-generate status sphere/ --json",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    status.add_argument("dataset", type=Path)
    status.add_argument("--json", action="store_true", help="for programs")
    status.set_defaults(run=_status)
    return parser


def _add_sweep_options(parser: argparse.ArgumentParser, *, frames: bool = False) -> None:
    default = Sweep()
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DATASET", help="folder of the data set")
    if frames:
        parser.add_argument("--frames", type=int, metavar="N", help=f"in all (default: {_FRAMES})")
        parser.add_argument(
            "--pace", type=float, metavar="M", help=f"metres from frame to frame (default: {default.pace:g})"
        )
    else:
        parser.add_argument("--poses", type=int, metavar="N", help=f"per voxel (default: {default.poses})")
    _add_engine_options(parser)
    _add_pose_options(parser, "of all poses and all noise", inside=not frames)
    parser.add_argument("--shard", default="0/1", metavar="i/n", help="render the i-th of n parts only (from 0)")
    _add_force_option(parser)
    _add_probe_option(parser)
    _add_links_option(parser)


def _add_force_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--force",
        action="store_true",
        help="begin a new set in spite of errors that check finds in the scene; the set remembers them",
    )


def _add_probe_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--no-probe",
        dest="probe",
        action="store_false",
        help="leave out the check at the start of a new set, which holds the engine against plain Cycles at one pose",
    )


def _add_links_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--trust-links",
        action="store_true",
        help="follow what the .blend refers to outside its own folder, and let it write caches",
    )


def _told(read: Callable[[str], float]) -> Callable[[str], float]:
    """A reader of a number whose own words are shown when it refuses."""

    def reader(text: str) -> float:
        try:
            return read(text)
        except NlosError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return reader


def _add_engine_options(parser: argparse.ArgumentParser) -> None:
    default = Sweep()
    parser.add_argument(
        "--engine",
        choices=["auto", "path", "patch", "surfel"],
        help="path: Cycles from the spot lamp, any scene, very noisy; "
        "patch: the lit patch as an emitter, same picture, far less noise; "
        "surfel: the integral itself, plain diffuse scenes, no noise, far faster, ambient light to a few per cent; "
        "auto: the cheapest that the scene allows, and says why (default)",
    )
    parser.add_argument(
        "--samples", type=int, metavar="N", help=f"rays per pixel, of path and patch (default: {default.samples})"
    )
    parser.add_argument(
        "--device",
        choices=["cpu", "gpu"],
        help=f"that path and patch render on; gpu takes what Cycles finds (default: {default.device})",
    )
    parser.add_argument(
        "--accuracy",
        type=_told(budget.fraction),
        metavar="A",
        help=f"error relative to what the object changes, 0.01 or 1%%, of surfel (default: {default.accuracy:g}); "
        "with sweep, of path and patch too, which then take as many samples as that needs",
    )
    parser.add_argument(
        "--denoise",
        action=argparse.BooleanOptionalAction,
        help="clean what path and patch render with Open Image Denoise: smooth, and biased (default: off)",
    )
    parser.add_argument(
        "--paired",
        action=argparse.BooleanOptionalAction,
        help="render each pose's background with the pose's own noise, which then cancels; twice the time, "
        "far less noise in the difference (default: on)",
    )


def _add_pose_options(parser: argparse.ArgumentParser, seed: str, *, inside: bool = True) -> None:
    default = Sweep()
    parser.add_argument("--seed", type=int, metavar="N", help=f"{seed} (default: {default.seed})")
    parser.add_argument("--resolution", metavar="R", help="64 or 64x48 (default: the scene's)")
    if inside:
        parser.add_argument(
            "--inside",
            choices=["whole", "centre"],
            help=f"what of the target must lie in its voxel (default: {default.inside})",
        )
    parser.add_argument(
        "--rotation",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="largest angles, degrees (default: 15 15 90, and none for a sphere)",
    )


def batch_parser() -> argparse.ArgumentParser:
    """Return the parser of what stands behind ``--`` on Blender's command line."""
    parser = argparse.ArgumentParser(
        prog="blender -b scene.blend -P generator/batch.py --",
        description="Render a data set inside Blender, in this one process.",
    )
    _add_sweep_options(parser)
    return parser


def chosen_settings(options: argparse.Namespace, kind: type = Sweep, **needed: Any) -> dict[str, Any]:
    """Return the fields of `Sweep`, or of another kind of settings, that the user named on the command line.

    Parameters
    ----------
    options : argparse.Namespace
    kind : type
        A dataclass with a field ``resolution``.
    **needed
        Stand-ins for fields that have no default, so that the others can be checked where these are not named.

    Raises
    ------
    NlosError
        One of them cannot be.
    """
    names = [f.name for f in fields(kind)]
    chosen = {name: getattr(options, name) for name in names if getattr(options, name, None) is not None}
    checked = {**needed, **chosen}
    if "resolution" in checked:
        checked["resolution"] = spec.parse_resolution(checked["resolution"])
    if checked.get("engine") == spec.AUTO:
        del checked["engine"]
    spec.from_dict(kind, checked, "--")
    return chosen


def parse_shard(text: str) -> tuple[int, int]:
    """Return i and n of ``i/n``."""
    index, _, count = text.partition("/")
    try:
        shard = (int(index), int(count))
    except ValueError:
        shard = (0, 0)
    if not 0 <= shard[0] < shard[1]:
        raise NlosError(f"--shard {text!r}: must read i/n with i from 0 to n - 1, for example 0/4")
    return shard


def summary(dataset: Dataset | Bulk, *, rendered: int, remaining: int) -> str:
    """Return the last line of a sweep or of a bulk set."""
    done = dataset.planned - remaining
    state = f"{dataset.path}: {done} of {dataset.planned} pictures"
    if rendered == 0 and remaining == 0:
        return f"{state}; the data set is finished, nothing to do"
    return f"{state}, {rendered} of them rendered now" + (f"; {remaining} remain" if remaining else "; finished")


class LineProgress:
    """Progress as plain lines, at most one every few seconds, for logs."""

    def __init__(self, what: str = "pictures", every: float = 10.0) -> None:
        self._what = what
        self._every = every
        self._remaining = Remaining()
        self._last = -every

    def __call__(self, done: int, total: int) -> None:
        now, left = time.monotonic(), self._remaining.told(done, total)
        if total == 0 or (now - self._last < self._every and done < total):
            return
        self._last = now
        print(f"{done} of {total} {self._what}{left_words(left if done < total else None)}", flush=True)


def left_words(left: float | None) -> str:
    """Return the time that is left as the end of a line; nothing while it cannot be told."""
    return "" if left is None else f", about {clock(left)} left"


def print_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; what its first column repeats is written once, and ends with a line."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading, no_wrap=True)
    repeated = len({row[0] for row in rows}) < len(rows)
    last = ""
    for first, *cells in rows:
        if repeated and last and first != last:
            table.add_section()
        table.add_row("" if first == last else first, *cells)
        last = first
    console = Console()
    # In a log or a pipe the table must not be squeezed into 80 columns.
    Console(width=None if console.is_terminal else 160).print(table)


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    if not sys.stderr.isatty():
        yield LineProgress()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    remaining = Remaining()
    columns = (TextColumn("rendering"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=None)

        def show(done: int, total: int) -> None:
            left = left_words(remaining.told(done, total)).removeprefix(", ")
            bar.update(task, completed=done, total=total, description=left)

        yield show


def _scene(options: argparse.Namespace) -> int:
    plain = spec.to_dict(spec.preset(options.preset, options.target))
    if options.config:
        plain = spec.merge(plain, spec.read_toml(options.config))
    for assignment in options.set:
        spec.set_field(plain, assignment)
    scene: spec.Scene = spec.from_dict(spec.Scene, plain)
    if options.ambient is not None:
        scene = scene.with_ambient(options.ambient)
    if options.show:
        print(spec.dump_toml(spec.to_dict(scene)), end="")
    if options.output is None:
        if not options.show:
            raise NlosError("nothing to do: name a file to save with -o FILE.blend, or print the figures with --show")
        return 0
    if options.output.suffix != ".blend":
        raise NlosError(f"{options.output}: a scene file must end in .blend")
    from generator.blender import misgivings
    from generator.blender.scene import stage

    made = stage.new_file()
    stage.build(made, scene)
    if words := spec.unlike(scene, stage.read(made)):  # what the file says is what a sweep will go by
        raise NlosError(f"{words}; take a figure that it can hold")
    stage.save_file(options.output)
    for note in misgivings.look(made).notes:
        print(note)
    print(
        f"{options.output}: {options.preset} with a {scene.target.kind}, voxels {scene.grid.labels[0]} to "
        f"{scene.grid.labels[-1]}, {scene.resolution[0]} x {scene.resolution[1]} pixels"
    )
    return 0


def _sweep(options: argparse.Namespace) -> int:
    from generator.jobs import sweep

    limit, accuracy, planned = getattr(options, "budget", None), None, getattr(options, "plan", None)
    if planned and limit:
        raise NlosError("--budget: a plan has its own accuracy; leave --plan or --budget out")
    if limit and options.shard != "0/1":
        raise NlosError("--budget: is one machine's; leave --shard out, or name the samples")
    if limit or (options.engine in ("path", "patch") and not getattr(options, "frames", None)):
        accuracy, options.accuracy = options.accuracy, None  # decides on settings, and is none itself
    chosen, pace = chosen_settings(options), None
    if planned:
        chosen = plan_file.followed(planned, options.scene, chosen)
    if limit and Dataset.exists(options.output):
        print(f"{options.output}: goes on as it was begun; --budget is for new sets")
    elif limit or (accuracy and not Dataset.exists(options.output)):
        choice = budget.choose(
            options.scene,
            chosen,
            budget=limit or math.inf,
            accuracy=accuracy or 0.0,
            workers=options.workers,
            tell=functools.partial(print, flush=True),
            force=options.force,
        )
        chosen, pace = choice.settings, choice.pace
    farm = _farm(options)
    with _progress() as progress:
        if getattr(options, "jobs", None) is not None:
            outcome = _jobs(options, chosen, progress, paced=pace is not None)
        else:
            outcome = sweep.run(
                options.scene,
                options.output,
                chosen,
                progress=progress,
                tell=print,
                pace=pace,
                force=options.force,
                probe=options.probe,
                **farm,
            )
    if planned:
        plan_file.keep(planned, options.output)
    return _report(outcome.dataset, outcome.rendered, outcome.remaining, outcome.failed)


def _jobs(
    options: argparse.Namespace, chosen: dict[str, Any], progress: Callable[[int, int], None], *, paced: bool
) -> Outcome:
    from generator.jobs import cluster

    if options.jobs < 1:
        raise NlosError(f"--jobs {options.jobs}: must be 1 or more")
    if paced or options.shard != "0/1":
        raise NlosError("--jobs: shares the poses out itself, at one setting; leave out --shard and --budget")
    return cluster.run(
        options.scene,
        options.output,
        chosen,
        executor=options.cluster,
        shares=options.jobs,
        workers=options.workers,
        options=dict(map(_job_option, options.job)),
        progress=progress,
        tell=functools.partial(print, flush=True),
        force=options.force,
        probe=options.probe,
    )


def _job_option(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not (equals and name.isidentifier()):
        raise NlosError(f"--job {text!r}: must read NAME=VALUE, for example timeout_min=120")
    return name, int(value) if value.isdecimal() else value


def _tradeoff(options: argparse.Namespace) -> int:
    from generator.measure import tradeoff

    if not 1 <= options.poses <= Sweep.poses:
        raise NlosError(f"--poses {options.poses}: must be from 1 to {Sweep.poses}")
    if options.output.exists() and not options.output.is_dir():
        raise NlosError(f"{options.output}: is a file; name a folder")
    names = ("poses", "seed", "resolution", "most", "workers", "force")
    found = tradeoff.run(
        options.scene,
        options.output,
        **{name: getattr(options, name) for name in names},
        tell=functools.partial(print, flush=True),
    )
    title = f"{options.scene.name}, {options.poses} poses a voxel, seed {options.seed}"
    print_table(f"{title}; intervals of 95 %", tradeoff.HEADINGS, tradeoff.rows(found))
    for line in tradeoff.advice(found):
        print(line)
    for path in tradeoff.write(options.output, found, title):
        print(path)
    return 0


def _plan(options: argparse.Namespace) -> int:
    from generator.blender.measure import planning

    if options.output and options.output.exists() and not options.output.is_dir():
        raise NlosError(f"{options.output}: is a file; name a folder")
    if not 2 <= options.poses <= Sweep.poses:
        raise NlosError(f"--poses {options.poses}: must be from 2 to {Sweep.poses}")
    found = planning.make(
        options.scene,
        tolerance=options.tolerance,
        count=options.poses,
        seed=options.seed,
        most=options.most,
        workers=options.workers,
        tell=functools.partial(print, flush=True),
    )
    title = f"{options.scene.name}, seed {options.seed}, tolerance {100.0 * options.tolerance:g} %"
    print_table(f"{title}; intervals of 95 %", plan_file.HEADINGS, plan_file.rows(found))
    for line in plan_file.words(found):
        print(line)
    if options.output:
        for path in plan_file.write(options.output, options.scene, found, title):
            print(path)
        print(f"nlos-generate sweep {options.scene} -o DATASET --plan {options.output}")
    return 0


def _trajectory(options: argparse.Namespace) -> int:
    if options.frames is None:
        known = Dataset.open(options.output).settings if Dataset.exists(options.output) else {}
        options.frames = known.get("frames", _FRAMES)
    if options.frames < 1:
        raise NlosError(f"--frames {options.frames}: must be 1 or more")
    return _sweep(options)


def _bulk(options: argparse.Namespace) -> int:
    from generator.sets import bulk

    chosen = chosen_settings(options, bulk.Settings, pictures=1)
    with _progress() as progress:
        outcome = bulk.run(
            *(options.scene, options.output, chosen),
            progress=progress,
            tell=print,
            force=options.force,
            probe=options.probe,
            **_farm(options),
        )
    return _report(outcome.bulk, outcome.rendered, outcome.remaining, outcome.failed)


def _check(options: argparse.Namespace) -> int:
    from generator.blender import check, worker
    from generator.blender.scene import stage

    chosen = chosen_settings(options)
    found = worker.check_scene(stage.open_file(options.scene), chosen)
    for finding in found:
        print(f"{finding.level}: {finding.text}")
    return 1 if check.hopeless(found) else 0


def _experiment(options: argparse.Namespace) -> int:
    from generator.blender.measure import experiment_report
    from generator.blender.scene import stage

    for name, least in (("resolution", 1), ("samples", 1), ("repeats", 1)):
        if getattr(options, name) < least:
            raise NlosError(f"--{name} {getattr(options, name)}: must be {least} or more")
    if not 0.0 <= options.ambient < math.inf:
        raise NlosError(f"--ambient {options.ambient:g}: must be 0, which is dark, or more")
    if options.output.exists() and not options.output.is_dir():
        raise NlosError(f"{options.output}: is a file; name a folder")
    if options.scene:  # as it is lit
        places: dict[str, experiment_report.Open] = {options.scene.stem: lambda _: stage.open_file(options.scene)}
        options.ambient = 0.0
    else:
        places = experiment_report.presets()
    settings = {"pixels": options.resolution, "samples": options.samples, "repeats": options.repeats}
    every = experiment_report.run(
        options.number, options.output, places, settings, ambient=options.ambient, progress=LineProgress("pictures")
    )
    for line in every:
        print(line, flush=True)
    return 0


def _farm(options: argparse.Namespace) -> dict[str, Any]:
    """Workers and shard."""
    if options.workers < 0:
        raise NlosError(f"--workers {options.workers}: must be 1 or more, or 0 for one per core")
    return {"workers": options.workers, "shard": parse_shard(options.shard)}


def _report(dataset: Dataset | Bulk, rendered: int, remaining: int, failed: list[str]) -> int:
    for failure in failed:
        console.complain(f"failed: {failure}")
    if isinstance(dataset, Dataset) and (words := audit.words(dataset)):
        console.complain(words)
    print(summary(dataset, rendered=rendered, remaining=remaining))
    return 1 if failed else 0


def _status(options: argparse.Namespace) -> int:
    import json

    from generator.jobs import journal

    found = journal.read(options.dataset)
    print(json.dumps(found, indent=1) if options.json else "\n".join(journal.words(found)))
    return 0


def _verify(options: argparse.Namespace) -> int:
    from generator.sets.bulk import Bulk

    if Bulk.exists(options.dataset):
        bulk = Bulk.open(options.dataset, check=False)
        faults = bulk.verify()
        for fault in faults:
            print(fault)
        print(f"{options.dataset}: {bulk.planned} pictures in {bulk.parts} parts, {len(faults)} faults")
        return 1 if faults else 0
    dataset = Dataset.open(options.dataset, check=False)
    faults = dataset.verify()
    for fault in faults:
        print(fault)
    if words := audit.unchecked(dataset):
        print(f"note: {words}")
    print(f"{options.dataset}: {dataset.planned} poses, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
