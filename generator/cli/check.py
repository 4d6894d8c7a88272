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
from generator.model.errors import NlosError
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
    parser.add_argument(
        "--mend",
        nargs="*",
        metavar="FIX",
        help="mend the scene, then check it, and save it by -o: all that can be mended of errors and warnings, or "
        "these of metres, align, reflections, voxels, show, keep=OBJECT, whatever they are offered for",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE.blend",
        help="where --mend saves the scene; may be the scene itself",
    )
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
    mended: list[str] = described("fixes that --mend has applied, in that order")
    refused: dict[str, str] = described("why other fixes could not be applied, by fix")
    saved: Path | None = described("the .blend file of the mended scene; null if nothing was mended")


def run_check(options: argparse.Namespace) -> Answer:
    """Say what would spoil a sweep; the exit code is 1 if there is an error."""
    from generator.blender import check
    from generator.blender.engines import renderers
    from generator.blender.finding import ERROR, FIXES, WARNING, Finding
    from generator.blender.scene import blend_file

    chosen = chosen_settings(options)
    if (options.mend is None) != (options.output is None):
        raise NlosError("--mend and -o FILE.blend: give both, to mend the scene and to save it, or none")
    if options.output is not None and options.output.suffix != ".blend":
        raise NlosError(f"{options.output}: a scene file must end in .blend")
    scene = blend_file.open_file(options.scene)
    mended: list[str] = []
    refused: dict[str, str] = {}
    if options.mend is not None:
        mended, refused = check.mend_all(scene, chosen, options.mend)
        if mended:
            blend_file.save_file(options.output)
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
        mended=mended,
        refused=refused,
        saved=options.output if mended else None,
    )
    lines = [finding.line for finding in findings]
    if options.mend is not None:
        told = [f"mended: {fix} ({FIXES[fix]})" for fix in mended]
        told += [
            f"not mended: {fix}: {why}{' as keep=OBJECT' if fix == 'keep' else ''}" for fix, why in refused.items()
        ]
        idle = [fix for fix in options.mend if fix.partition("=")[0] not in (*mended, *refused)]
        told += [f"not mended: {fix}: nothing calls for it" for fix in idle]
        last = (
            f"{options.output}: {len(mended)} mended" if mended else f"{options.output}: not written, for nothing was"
        )
        lines = [*told, *lines, f"{last}{'' if mended else ' mended'}"]
    return Answer(values, lines, code=1 if check.hopeless(findings) else 0)
