"""The verb ``check``: what is wrong with a scene, before anything is rendered."""

from __future__ import annotations

import argparse
from pathlib import Path

from generator.cli.options import (
    Commands,
    add_engine_options,
    add_links_option,
    add_pose_options,
    add_setting,
    chosen_settings,
)


def add_parsers(commands: Commands) -> None:
    """Add the verb ``check`` to a command line."""
    parser = commands.add_parser(
        "check",
        help="say what would spoil a sweep of a scene, and what it will cost",
        description="Look for lines of sight that must not be, voxels that see no light and all else that makes a "
        "sweep worthless, and measure signal, noise, time and disk by a few quick renders. Exit code 1 if "
        "an error is found.",
        epilog="example:\n  nlos-generate check room.blend --engine patch --samples 192",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scene", type=Path, help="the .blend file")
    add_setting(parser, "poses", type=int, metavar="N")
    add_engine_options(parser)
    add_pose_options(parser)
    add_links_option(parser)
    parser.set_defaults(run=run_check)


def run_check(options: argparse.Namespace) -> int:
    """Print what would spoil a sweep; return 1 if there is an error."""
    from generator.blender import check
    from generator.blender.scene import blend_file

    chosen = chosen_settings(options)
    findings = check.check_scene(blend_file.open_file(options.scene), chosen)
    for finding in findings:
        print(f"{finding.level}: {finding.text}")
    return 1 if check.hopeless(findings) else 0
