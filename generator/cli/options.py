"""Options that several verbs share, and the settings that they choose."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeAlias

from generator.files.toml import from_dict
from generator.model.engines import AUTO, AUTO_HELP, ENGINES
from generator.model.errors import NlosError
from generator.model.quantities import fraction, parse_resolution, parse_shard
from generator.model.settings import Sweep

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""What verbs are added to."""
FRAMES = 200
"""Of a trajectory, if none are named."""


def add_sweep_options(parser: argparse.ArgumentParser, *, frames: bool = False) -> None:
    """Add the options of a sweep, or of a trajectory's frames."""
    default = Sweep()
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DATASET", help="folder of the data set")
    if frames:
        parser.add_argument("--frames", type=int, metavar="N", help=f"in all (default: {FRAMES})")
        parser.add_argument(
            "--pace", type=float, metavar="M", help=f"metres from frame to frame (default: {default.pace:g})"
        )
    else:
        parser.add_argument("--poses", type=int, metavar="N", help=f"per voxel (default: {default.poses})")
    add_engine_options(parser)
    add_pose_options(parser, "of all poses and all noise", inside=not frames)
    parser.add_argument("--shard", default="0/1", metavar="i/n", help="render the i-th of n parts only (from 0)")
    add_force_option(parser)
    add_probe_option(parser)
    add_links_option(parser)


def add_force_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--force``."""
    parser.add_argument(
        "--force",
        action="store_true",
        help="begin a new set in spite of errors that check finds in the scene; the set remembers them",
    )


def add_probe_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--no-probe``."""
    parser.add_argument(
        "--no-probe",
        dest="probe",
        action="store_false",
        help="leave out the check at the start of a new set, which holds the engine against plain Cycles at one pose",
    )


def add_links_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--trust-links``."""
    parser.add_argument(
        "--trust-links",
        action="store_true",
        help="follow what the .blend refers to outside its own folder, and let it write caches",
    )


def option(read: Callable[[str], float]) -> Callable[[str], float]:
    """A reader of a number whose own words are shown when it refuses."""

    def reader(text: str) -> float:
        try:
            return read(text)
        except NlosError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return reader


def add_engine_options(parser: argparse.ArgumentParser) -> None:
    """Add what says how a picture is rendered."""
    default = Sweep()
    parser.add_argument(
        "--engine",
        choices=[AUTO, *ENGINES],
        help="; ".join([*(f"{name}: {of.help}" for name, of in ENGINES.items()), f"{AUTO}: {AUTO_HELP} (default)"]),
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
        type=option(fraction),
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


def add_pose_options(parser: argparse.ArgumentParser, seed: str, *, inside: bool = True) -> None:
    """Add what says where the target is put, and the pictures' size."""
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
    add_sweep_options(parser)
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
        checked["resolution"] = parse_resolution(checked["resolution"])
    if checked.get("engine") == AUTO:
        del checked["engine"]
    from_dict(kind, checked, "--")
    return chosen


def farm_of(options: argparse.Namespace) -> dict[str, Any]:
    """Workers and shard."""
    if options.workers < 0:
        raise NlosError(f"--workers {options.workers}: must be 1 or more, or 0 for one per core")
    return {"workers": options.workers, "shard": parse_shard(options.shard)}
