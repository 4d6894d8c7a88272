"""The verb ``scene``: build a scene file."""

from __future__ import annotations

import argparse
from pathlib import Path

from generator.cli.options import Commands, add_setting
from generator.files.toml import dump_toml, from_dict, merge, read_toml, set_field, to_dict
from generator.model.errors import NlosError
from generator.model.presets import PRESETS, preset
from generator.model.scene import Scene, unlike


def add_parsers(commands: Commands) -> None:
    """Add the verb ``scene`` to a command line."""
    parser = commands.add_parser(
        "scene",
        help="build a scene and save it as a .blend file",
        description="Build a preset scene and save it as a .blend file, which Blender can open and edit. "
        "Every figure can be changed: see them with --show, change one with --set, or many with --config.",
        epilog="example:\n  nlos-generate scene room --target sphere --set spot.power=500 -o room.blend",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "preset", choices=list(PRESETS), help="; ".join(f"{name}: {of.words}" for name, of in PRESETS.items())
    )
    parser.add_argument(
        "--target", default="sheet", metavar="sheet|sphere|FILE", help="the hidden object (default: sheet)"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.blend", help="where to save it")
    parser.add_argument("--config", type=Path, metavar="FILE.toml", help="figures that replace the preset's")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="one figure, e.g. grid.shape=[3,3,3]; repeatable",
    )
    add_setting(parser, "ambient", Scene, default="the preset's", type=float, metavar="RADIANCE")
    parser.add_argument("--show", action="store_true", help="print every figure as TOML (to edit, for --config)")
    parser.set_defaults(run=run_scene)


def run_scene(options: argparse.Namespace) -> int:
    """Build a preset scene with the requested changes, and save or show it."""
    fields = to_dict(preset(options.preset, options.target))
    if options.config:
        fields = merge(fields, read_toml(options.config))
    for assignment in options.set:
        set_field(fields, assignment)
    scene: Scene = from_dict(Scene, fields)
    if options.ambient is not None:
        scene = scene.with_ambient(options.ambient)
    if options.show:
        print(dump_toml(to_dict(scene)), end="")
    if options.output is None:
        if not options.show:
            raise NlosError("nothing to do: name a file to save with -o FILE.blend, or print the figures with --show")
        return 0
    if options.output.suffix != ".blend":
        raise NlosError(f"{options.output}: a scene file must end in .blend")
    from generator.blender import misgivings
    from generator.blender.scene import blend_file, build
    from generator.blender.scene.description import read_scene

    blender_scene = blend_file.new_file()
    build.build(blender_scene, scene)
    if deviation := unlike(scene, read_scene(blender_scene)):  # a sweep reads the scene from the file
        raise NlosError(f"{deviation}; take a figure that it can hold")
    blend_file.save_file(options.output)
    for note in misgivings.look(blender_scene).notes:
        print(note)
    print(
        f"{options.output}: {options.preset} with a {scene.target.kind}, voxels {scene.grid.labels[0]} to "
        f"{scene.grid.labels[-1]}, {scene.resolution[0]} x {scene.resolution[1]} pixels"
    )
    return 0
