"""The verb ``check``: what is wrong with a scene, before anything is rendered."""

from __future__ import annotations

import argparse
from pathlib import Path

from generator.cli.answer import Answer, json_object
from generator.cli.options import (
    Commands,
    add_engine_options,
    add_links_option,
    add_pose_options,
    add_setting,
    chosen_settings,
)
from generator.model.described import described
from generator.model.engines import AUTO, ENGINES
from generator.model.settings import Sweep


def add_parsers(commands: Commands) -> None:
    """Add the verb ``check`` to a command line."""
    parser = commands.add_parser(
        "check",
        help="say what would spoil a sweep of a scene, and what it will cost",
        description="Look for lines of sight that must not be, voxels that see no light and all else that makes a "
        "sweep worthless, and measure signal, noise, time and disk by a few quick renders. Exit code 1 if "
        "an error is found.",
        epilog="example:\n  nlos-generate check room.blend --engine patch --samples 192",
    )
    parser.add_argument("scene", type=Path, help="the .blend file")
    add_setting(parser, "poses", type=int, metavar="N")
    add_engine_options(parser)
    add_pose_options(parser)
    add_links_option(parser)
    parser.set_defaults(run=run_check, answer=Checked)


@json_object
class Found:
    """A finding."""

    level: str = described("good, note, warning or error")
    text: str = described("one sentence")
    object: str | None = described("name of the object that it is about; null if it is about none")


@json_object
class Checked:
    """What is wrong with a scene."""

    scene: Path = described("the .blend file")
    findings: list[Found] = described("what was found")
    errors: int = described("number of findings that are errors, which stop a sweep")


def run_check(options: argparse.Namespace) -> Answer:
    """Say what would spoil a sweep; the exit code is 1 if there is an error."""
    from generator.blender import check
    from generator.blender.engines import renderers
    from generator.blender.finding import ERROR, WARNING, Finding
    from generator.blender.scene import blend_file

    chosen = chosen_settings(options)
    scene = blend_file.open_file(options.scene)
    findings = check.check_scene(scene, chosen)
    optional = {name for traits in ENGINES.values() for name in traits.settings} & set(chosen)
    if optional and not check.hopeless(findings):
        engine = chosen.get("engine", AUTO)
        engine = renderers.choose(scene)[0] if engine == AUTO else engine
        idle = [name for name in Sweep.idle(engine) if name in optional]
        findings += [Finding(WARNING, f"--{name}: means nothing to the engine {engine!r}") for name in idle]
    values = Checked(
        scene=options.scene,
        findings=[Found(level=f.level, text=f.text, object=f.object or None) for f in findings],
        errors=sum(f.level == ERROR for f in findings),
    )
    lines = [finding.line for finding in findings]
    return Answer(values, lines, code=1 if check.hopeless(findings) else 0)
