"""The verbs ``plan`` and ``tradeoff``: what a scene needs, and what accuracy costs."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from generator.cli.answer import Answer, Interval, Table, interval, json_object
from generator.cli.options import (
    Commands,
    add_force_option,
    add_links_option,
    add_setting,
    option,
)
from generator.cli.terminal import Status
from generator.cli.volume import stage
from generator.measure import scene_plan
from generator.model.described import described
from generator.model.errors import NlosError
from generator.model.quantities import fraction, seconds
from generator.model.settings import Sweep


def add_parsers(commands: Commands) -> None:
    """Add the verbs ``tradeoff`` and ``plan`` to a command line."""
    _add_tradeoff(commands)
    _add_plan(commands)


def _add_tradeoff(commands: Commands) -> None:
    parser = commands.add_parser(
        "tradeoff",
        help="measure what a picture costs and how wrong it is, for engines and settings",
        description="Render the same poses by a ladder of engines, samples and accuracies, with and without denoiser "
        "and pairing, and say what each costs on this machine and how far it is from the reference. Interrupt it "
        "at any time: the same command goes on.",
        epilog="example:\n  nlos-generate tradeoff room.blend -o trade/\n  nlos-classify tradeoff trade/ room.atlas",
    )
    parser.add_argument("scene", type=Path, help="the .blend file")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="a data set for each way")
    parser.add_argument("--poses", type=int, default=3, metavar="N", help="per voxel (default: 3)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of all poses and all noise (default: 0)")
    parser.add_argument("--resolution", metavar="R", help="64 or 64x48 (default: the scene's)")
    add_setting(parser, "device")
    parser.add_argument(
        "--time-limit",
        dest="most",
        type=option(seconds),
        default=1200.0,
        metavar="T",
        help="time for all of it: what would end later is left out, and named (default: 20min)",
    )
    parser.add_argument("--workers", type=int, default=0, metavar="W", help="processes (default: one per core)")
    add_force_option(parser)
    add_links_option(parser)
    parser.alias("--most", "--time-limit")
    parser.set_defaults(run=run_tradeoff, answer=Traded)


def _add_plan(commands: Commands) -> None:
    parser = commands.add_parser(
        "plan",
        help="measure what a scene needs modelled, and plan a sweep that models no more",
        description="Leave out one thing after the other - the object's shadow on the room, the extent of the lit "
        "patch, each surface, other lights, materials that are not plain, further reflections - and say by how much "
        "the difference picture is then wrong. What may be left out within a tolerance is left out of the plan, "
        "which sweep --plan follows.",
        epilog="example:\n  nlos-generate plan room.blend --tolerance 1% -o plan/\n"
        "  nlos-generate sweep room.blend -o set/ --plan plan/",
    )
    parser.add_argument("scene", type=Path, help="the .blend file")
    parser.add_argument(
        "--tolerance",
        type=option(fraction),
        default=0.01,
        metavar="A",
        help="error of a difference picture that is allowed, 0.01 or 1%% (default: 1%%)",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="for plan.toml, plan.csv and plan.png")
    parser.add_argument(
        "--poses", type=int, default=scene_plan.POSES, metavar="N", help=f"per voxel (default: {scene_plan.POSES})"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the poses (default: 0)")
    parser.add_argument(
        "--time-limit",
        dest="most",
        type=option(seconds),
        default=scene_plan.MOST,
        metavar="T",
        help="time for all of it: what cannot be measured in it is kept, and named (default: 5min)",
    )
    parser.add_argument(
        "--no-cycles",
        dest="cycles",
        action="store_false",
        help="measure only what surfel models, without noise: what only Cycles models is kept, and takes no time",
    )
    parser.add_argument("--workers", type=int, default=0, metavar="W", help="of the sweep (default: one per core)")
    add_setting(parser, "device")
    add_links_option(parser)
    parser.alias("--most", "--time-limit")
    parser.set_defaults(run=run_plan, answer=Planned)


@json_object
class Way:
    """Cost and error of an engine with its settings."""

    name: str = described("name, which is that of the folder of its data set")
    seconds: float = described("core seconds per picture")
    error: Interval = described("error of a difference picture in the median pose, relative")
    level: Interval = described("share of the reference's light that is there; 1 without bias")


@json_object
class Traded:
    """What accuracy costs."""

    ways: list[Way] = described("the ways to render, the quickest first")
    advice: list[str] = described("which to take, in sentences")
    files: list[Path] = described("files that were written")


@json_object
class Left:
    """An effect that may be left out, or not."""

    name: str = described("name")
    error: Interval = described("error of a difference picture without it, relative")
    gain: float | None = described("factor of pictures per second without it; null if not measured")
    verdict: str = described("needed, left out, or why neither")


@json_object
class Planned:
    """What a scene needs modelled."""

    tolerance: float = described("error of a difference picture that is allowed, relative")
    effects: list[Left] = described("effects, the largest first")
    left_out: list[str] = described("effects that the plan leaves out")
    error: Interval = described("error with all of these left out together, relative")
    settings: dict[str, Any] = described("settings of the sweep that sweep --plan makes")
    predicted: dict[str, float] = described(
        "cost of that sweep: pictures, seconds, bytes, and seconds_full if nothing were left out"
    )
    words: list[str] = described("the plan in sentences")
    files: list[Path] = described("files that were written")


def run_tradeoff(options: argparse.Namespace) -> Answer:
    """Measure what pictures cost and how wrong they are; write the table and the figures."""
    from generator.measure import tradeoff

    if not 1 <= options.poses <= Sweep.poses:
        raise NlosError(f"--poses {options.poses}: must be from 1 to {Sweep.poses}")
    if options.output.exists() and not options.output.is_dir():
        raise NlosError(f"{options.output}: is a file; name a folder")
    device = options.device or Sweep.device
    if device == "gpu":  # now, and not after the rungs of surfel, which need none
        from generator.blender.engines.devices import require_gpu

        require_gpu()
    names = ("poses", "seed", "resolution", "most", "workers", "force")
    with Status() as status:
        costs = tradeoff.run(
            options.scene,
            options.output,
            **{name: getattr(options, name) for name in names},
            device=device,
            tell=status.tell,
            progress=status.progress,
        )
    poses = f"{options.poses} poses a voxel, seed {options.seed}"
    title = f"{options.scene.name}, {poses}, {tradeoff.reference_words(options.output)}"
    with stage("figures"):
        files = tradeoff.write(options.output, costs, title)
    ways = [Way(name=c.name, seconds=c.seconds, error=interval(c.error), level=interval(c.level)) for c in costs]
    advice = tradeoff.advice(costs)
    table = Table(f"{title}; intervals of 95 %", tradeoff.HEADINGS, tradeoff.rows(costs))
    return Answer(Traded(ways=ways, advice=advice, files=files), [table, *advice, *map(str, files)])


def run_plan(options: argparse.Namespace) -> Answer:
    """Measure what a scene needs modelled, and write the plan."""
    begun = time.monotonic()  # loading Blender takes some of the time
    from generator.blender.measure import planning
    from generator.measure import plan_report

    if options.output and options.output.exists() and not options.output.is_dir():
        raise NlosError(f"{options.output}: is a file; name a folder")
    if not 2 <= options.poses <= Sweep.poses:
        raise NlosError(f"--poses {options.poses}: must be from 2 to {Sweep.poses}")
    with Status() as status:
        plan = planning.make(
            options.scene,
            tolerance=options.tolerance,
            count=options.poses,
            seed=options.seed,
            most=options.most - (time.monotonic() - begun),
            workers=options.workers,
            by_cycles=options.cycles,
            device=options.device or Sweep.device,
            tell=status.tell,
        )
    title = f"{options.scene.name}, seed {options.seed}, tolerance {100.0 * options.tolerance:g} %"
    files = plan_report.write(options.output, options.scene, plan, title) if options.output else []
    rows, words = scene_plan.rows(plan), scene_plan.words(plan)
    values = Planned(
        tolerance=plan.tolerance,
        effects=[
            Left(name=effect.name, error=interval(effect.share), gain=effect.gain, verdict=verdict)
            for effect, (_, _, _, verdict) in zip(plan.effects, rows, strict=True)
        ],
        left_out=plan.dropped,
        error=interval(plan.together.share),
        settings=plan.settings,
        predicted=plan.predicted,
        words=words,
        files=files,
    )
    table = Table(f"{title}; intervals of 95 %", scene_plan.HEADINGS, rows)
    device = f" --device {options.device}" if options.device and plan.settings["engine"] != "surfel" else ""
    follow = [f"nlos-generate sweep {options.scene} -o DATASET --plan {options.output}{device}"] if files else []
    return Answer(values, [table, *words, *map(str, files), *follow])
