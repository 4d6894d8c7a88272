"""The verb ``describe``: a scene's figures as text, which all else reads without Blender."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from generator.cli.answer import Answer, json_object
from generator.cli.options import Commands, add_links_option, add_setting
from generator.files.toml import dump_toml
from generator.model.described import described
from generator.model.errors import NlosError
from generator.model.quantities import parse_resolution

if TYPE_CHECKING:
    from generator.sets.description import Description


def add_parsers(commands: Commands) -> None:
    """Add the verb ``describe`` to a command line."""
    parser = commands.add_parser(
        "describe",
        help="write down what a scene holds, for sets that others make",
        description="Write the figures of a scene as TOML: the description that nlos-classify import takes with "
        "--like, and the manifest of a set made by hand begins with.",
        epilog="example:\n  nlos-generate describe room.blend -o room.toml",
    )
    parser.add_argument("scene", type=Path, metavar="FILE", help="a .blend file, or the folder of a data set of it")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.toml", help="(default: print it)")
    add_setting(parser, "resolution", default="the scene's", metavar="64|64x48")
    add_links_option(parser)
    parser.set_defaults(run=run_describe, answer=Figures)


@json_object
class Figures:
    """What a scene holds."""

    path: Path | None = described("the file that was written; null if none was asked for")
    reference_radiance: float = described("radiance of the lit patch at w1, W/m²/sr")
    colour_space: str = described("linear space of the three channels")
    scene: dict[str, Any] = described("every figure of the scene")


def run_describe(options: argparse.Namespace) -> Answer:
    """Write a scene's figures."""
    found = _described(options)
    if options.output is not None:
        if options.output.is_dir():
            raise NlosError(f"{options.output}: is a folder; name a file")
        found.write(options.output)
    values = Figures(
        path=options.output,
        reference_radiance=found.reference_radiance,
        colour_space=found.colour_space,
        scene=found.scene,
    )
    return Answer(values, [str(options.output) if options.output else dump_toml(found.manifest).rstrip()])


def _described(options: argparse.Namespace) -> Description:
    from generator.sets import description

    if options.scene.suffix != ".blend":
        if options.resolution is not None:
            raise NlosError("--resolution: a set's pictures have theirs; leave it out")
        return description.read(options.scene)
    from generator.blender.scene import blend_file
    from generator.blender.scene.description import read_scene
    from generator.blender.sweep_worker import colour_space, described_scene

    size = None if options.resolution is None else parse_resolution(options.resolution)
    scene = blend_file.open_file(options.scene)
    figures = read_scene(scene, size)
    plain = described_scene(scene, figures)["scene"]
    return description.Description(plain, figures.reference_radiance, colour_space())
