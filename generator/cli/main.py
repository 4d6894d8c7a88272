"""Command line of the generator: argument parsing and words for people; all work is done elsewhere."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from generator.cli.bulk import run_bulk
from generator.cli.check import run_check
from generator.cli.experiment import run_experiment
from generator.cli.inspect import run_status, run_verify
from generator.cli.options import (
    add_engine_options,
    add_force_option,
    add_links_option,
    add_pose_options,
    add_probe_option,
    add_sweep_options,
    option,
)
from generator.cli.plan import run_plan, run_tradeoff
from generator.cli.scene import run_scene
from generator.cli.sweep import run_sweep, run_trajectory
from generator.cli.terminal import guarded
from generator.measure import plan_file
from generator.model.quantities import fraction, seconds
from generator.model.settings import Sweep
from generator.sets import links

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
    scene.set_defaults(run=run_scene)

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
    add_sweep_options(sweep)
    sweep.add_argument(
        "--workers", type=int, default=0, metavar="W", help="processes (default: one per core; on a GPU four)"
    )
    sweep.add_argument(
        "--budget",
        type=option(seconds),
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
    sweep.set_defaults(run=run_sweep)

    trajectory = commands.add_parser(
        "trajectory",
        help="render a data set of a target that moves: frame after frame, for track",
        description="As sweep does, but the target walks through the voxels, straight from one random pose to the "
        "next, and its pictures are frames, one after the other.",
        epilog="example:\n  nlos-generate trajectory room.blend -o walk/ --frames 200 --pace 0.03 --engine surfel",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    trajectory.add_argument("scene", type=Path, help="the .blend file")
    add_sweep_options(trajectory, frames=True)
    trajectory.add_argument(
        "--workers", type=int, default=0, metavar="W", help="processes (default: one per core; on a GPU four)"
    )
    trajectory.set_defaults(run=run_trajectory)

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
    add_pose_options(bulk, "of all poses")
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
    add_force_option(bulk)
    add_probe_option(bulk)
    add_links_option(bulk)
    bulk.set_defaults(run=run_bulk)

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
    add_engine_options(checked)
    add_pose_options(checked, "of all poses and all noise")
    add_links_option(checked)
    checked.set_defaults(run=run_check)

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
    add_links_option(experiment)
    experiment.set_defaults(run=run_experiment)

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
        type=option(seconds),
        default=600.0,
        metavar="T",
        help="leave out what would take longer, judged by the cheaper (default: 10min)",
    )
    trade.add_argument("--workers", type=int, default=0, metavar="W", help="processes (default: one per core)")
    add_force_option(trade)
    add_links_option(trade)
    trade.set_defaults(run=run_tradeoff)

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
        type=option(fraction),
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
        type=option(seconds),
        default=180.0,
        metavar="T",
        help="time for what only Cycles models, which has noise (default: 3min)",
    )
    plan.add_argument("--workers", type=int, default=0, metavar="W", help="of the sweep (default: one per core)")
    add_links_option(plan)
    plan.set_defaults(run=run_plan)

    verify = commands.add_parser(
        "verify",
        help="re-read a whole data set and list what is wrong",
        description="Re-read every picture and compare it with the manifest; exit code 1 if anything is wrong.",
    )
    verify.add_argument("dataset", type=Path)
    verify.set_defaults(run=run_verify)

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
    status.set_defaults(run=run_status)
    return parser


if __name__ == "__main__":
    sys.exit(main())
