"""Options that several verbs share, and the settings that they choose."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeAlias

from generator.cli.parser import VerbParser
from generator.files.toml import from_dict
from generator.model.described import choices_of, default_of, words_for
from generator.model.engines import AUTO, AUTO_HELP, ENGINES
from generator.model.errors import NlosError
from generator.model.quantities import fraction, parse_resolution, parse_shard
from generator.model.settings import Sweep

Commands: TypeAlias = "argparse._SubParsersAction[VerbParser]"
"""Subparsers to which verbs are added."""
FRAMES = 200
"""Default number of frames of a trajectory."""


def add_setting(
    parser: argparse._ActionsContainer,
    name: str,
    kind: type = Sweep,
    *,
    flag: str = "",
    default: str | None = None,
    words: str | None = None,
    more: str = "",
    **how: Any,
) -> None:
    """Add an option that sets a field of some settings; its help is the field's description.

    Parameters
    ----------
    parser : argparse.ArgumentParser, or a group of its arguments
    name : str
        Name of the field.
    kind : type
        Dataclass of the settings.
    flag : str, optional
        Name of the option; by default two dashes and that of the field.
    default : str, optional
        Words for the value that is taken if the option is not given; by default the field's default.
    words : str, optional
        Description of the option, if it is not that of the field.
    more : str
        Text to add to the description.
    **how
        Further arguments of `argparse.ArgumentParser.add_argument`.
    """
    value = default_of(kind, name)
    if isinstance(value, bool):
        how["action"] = argparse.BooleanOptionalAction
        value = "on" if value else "off"
    if choices := choices_of(kind, name):
        how["choices"] = choices
    taken = default or (f"{value:g}" if isinstance(value, float) else value)
    text = ((words or words_for(kind, name)) + more).replace("%", "%%")
    flag = flag or f"--{name.replace('_', '-')}"
    parser.add_argument(flag, dest=name, help=f"{text} (default: {taken})", **how)


def add_sweep_options(parser: argparse.ArgumentParser, *, frames: bool = False, goal: bool = False) -> None:
    """Add the options of a sweep, or of a trajectory's frames; with `goal`, the accuracy decides on samples."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DATASET", help="folder of the data set")
    poses = group_of(parser, "poses and pictures")
    if frames:
        words = "of the trajectory, one after the other"
        add_setting(poses, "frames", default=str(FRAMES), words=words, type=int, metavar="N")
        add_setting(poses, "pace", type=float, metavar="M")
    else:
        add_setting(poses, "poses", type=int, metavar="N")
    add_engine_options(parser, goal=goal)
    add_pose_options(parser, inside=not frames)
    if not frames:
        add_vary_option(parser)
    farm_options(parser).add_argument(
        "--shard", default="0/1", metavar="i/n", help="render the i-th of n parts only (from 0)"
    )
    add_force_option(parser)
    add_probe_option(parser)
    add_links_option(parser)


def farm_options(parser: argparse.ArgumentParser) -> argparse._ActionsContainer:
    """Return the group of a parser's options that say where and when is rendered."""
    return group_of(parser, "processes and machines")


def group_of(parser: argparse.ArgumentParser, title: str) -> argparse._ActionsContainer:
    """Return a group of a parser's arguments by its title, made if it is not there."""
    made = (group for group in parser._action_groups if group.title == title)
    return next(made, None) or parser.add_argument_group(title)


def add_force_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--force``."""
    group_of(parser, "checks of the scene").add_argument(
        "--force",
        action="store_true",
        help="begin a new set in spite of errors that check finds in the scene; the set remembers them",
    )


def add_probe_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--no-probe``."""
    group_of(parser, "checks of the scene").add_argument(
        "--no-probe",
        dest="probe",
        action="store_false",
        help="leave out the check at the start of a new set, which holds the engine against plain Cycles at one pose",
    )


def add_links_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--trust-links``."""
    group_of(parser, "checks of the scene").add_argument(
        "--trust-links",
        action="store_true",
        help="follow what the .blend refers to outside its own folder, and let it write caches",
    )


def option(read: Callable[[str], float]) -> Callable[[str], float]:
    """Return a reader of a number for argparse, which shows what `read` says after the text that it refuses."""

    def reader(text: str) -> float:
        try:
            return read(text)
        except NlosError as error:
            raise argparse.ArgumentTypeError(str(error).partition(f"{text!r}: ")[2]) from None

    return reader


def add_engine_options(parser: argparse.ArgumentParser, *, goal: bool = False) -> None:
    """Add the options that say how a picture is rendered."""
    group = group_of(parser, "rendering")
    group.add_argument(
        "--engine",
        choices=[AUTO, *ENGINES],
        help="; ".join(
            [*(f"{name}: {traits.help}" for name, traits in ENGINES.items()), f"{AUTO}: {AUTO_HELP} (default)"]
        ),
    )
    add_setting(group, "samples", type=int, metavar="N")
    add_setting(group, "device")
    more = "; of path and patch too, which then take as many samples as that needs" if goal else ""
    add_setting(group, "accuracy", more=more, type=option(fraction), metavar="A")
    add_setting(group, "denoise")
    add_setting(group, "paired")


def add_pose_options(parser: argparse.ArgumentParser, *, inside: bool = True) -> None:
    """Add the options that say where the target is put, and the size of the pictures."""
    group = group_of(parser, "poses and pictures")
    add_setting(group, "seed", type=int, metavar="N")
    add_setting(group, "resolution", default="the scene's", metavar="64|64x48")
    if inside:
        add_setting(group, "inside")
    free = "15 15 90, and none for a sphere"
    add_setting(group, "rotation", default=free, type=float, nargs=3, metavar=("X", "Y", "Z"))


def add_vary_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--vary`` and ``--targets``."""
    group = group_of(parser, "poses and pictures")
    add_setting(group, "targets", type=int, metavar="N")
    add_setting(group, "vary", default="nothing", more="; repeatable", action="append", metavar="NAME=LOW:HIGH")


def batch_parser() -> argparse.ArgumentParser:
    """Return the parser of the arguments after ``--`` on Blender's command line."""
    parser = VerbParser(
        prog="blender -b scene.blend -P generator/batch.py --",
        description="Render a data set inside Blender, in this one process.",
        default=False,
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
        Stand-ins for fields that have no default, so that the others can be checked if these are not given.

    Raises
    ------
    NlosError
        A value is invalid.
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
    """Return the number of workers and the shard."""
    if options.workers < 0:
        raise NlosError(f"--workers {options.workers}: must be 1 or more, or 0 for one per core")
    return {"workers": options.workers, "shard": parse_shard(options.shard)}
