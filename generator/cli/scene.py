"""The verb ``scene``: build a scene file."""

from __future__ import annotations

import argparse
import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from generator.cli.answer import Answer, json_object
from generator.cli.options import Commands, add_links_option, add_setting
from generator.files.toml import dump_toml, from_dict, merge, read_toml, set_field, to_dict
from generator.model.described import described
from generator.model.errors import NlosError
from generator.model.presets import PRESETS, preset
from generator.model.quantities import ALL_ORDERS
from generator.model.scene import Scene, Target, unlike


def add_parsers(commands: Commands) -> None:
    """Add the verb ``scene`` to a command line."""
    parser = commands.add_parser(
        "scene",
        help="build a scene and save it as a .blend file",
        description="Build a preset scene and save it as a .blend file, which Blender can open and edit. "
        "Every figure can be changed: see them with --show, change one with --set, or many with --config.",
        epilog="example:\n  nlos-generate scene room --target sphere --set spot.power=500 -o room.blend",
    )
    parser.add_argument(
        "preset", choices=list(PRESETS), help="; ".join(f"{name}: {of.words}" for name, of in PRESETS.items())
    )
    parser.add_argument(
        "--target", metavar="sheet|sphere|FILE", help="the hidden object (default: that of --config, or else sheet)"
    )
    for name in ("unit", "up"):
        add_setting(parser, name, Target, flag=f"--target-{name}")
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
    add_links_option(parser)
    parser.set_defaults(run=run_scene, answer=Built)


@json_object
class Built:
    """A scene that was built or shown."""

    path: Path | None = described("the .blend file; null if only shown")
    figures: dict[str, Any] = described("every figure of the scene, by the names that --set takes")
    voxels: list[str] = described("labels of the voxels")
    target_size: list[float] | None = described(
        "width, depth and height of a target from a file, metres; null if it is of no file, or nothing was built"
    )
    target_file: dict[str, Any] | None = described(
        "how that file was read: name, unit and up as asked for, metres_per_unit and up_axis as taken; else null"
    )
    notes: list[str] = described("errors and warnings of the check without rendering, as check prints them")


def run_scene(options: argparse.Namespace) -> Answer:
    """Build a preset scene with the requested changes, and save or show it."""
    scene = _chosen(options)
    figures, voxels = to_dict(scene), list(scene.grid.labels)
    shown = [dump_toml(figures).rstrip("\n")] if options.show else []
    if options.output is None:
        if not options.show:
            raise NlosError("nothing to do: name a file to save with -o FILE.blend, or print the figures with --show")
        shown_only = Built(path=None, figures=figures, voxels=voxels, target_size=None, target_file=None, notes=[])
        return Answer(shown_only, shown)
    if options.output.suffix != ".blend":
        raise NlosError(f"{options.output}: a scene file must end in .blend")
    from generator.blender import misgivings
    from generator.blender.finding import WARNING, Finding
    from generator.blender.scene import blend_file, build, mesh_file
    from generator.blender.scene.description import read_scene

    found = mesh_file.read(scene.target) if scene.target.kind == "mesh" else None
    blender_scene = blend_file.new_file()
    build.build(blender_scene, scene, found)
    if deviation := unlike(scene, read_scene(blender_scene)):  # a sweep reads the scene from the file
        raise NlosError(f"{deviation}; take a figure that it can hold")
    blend_file.save_file(options.output)
    notes, told = misgivings.look(blender_scene).lines, []
    if found is not None:
        told = [f"target: {found.words}"]
        notes += [Finding(WARNING, text).line for text in [found.warning(scene.grid)] if text]
    last = (
        f"{options.output}: {options.preset} with a {scene.target.kind}, voxels {voxels[0]} to {voxels[-1]}, "
        f"{scene.resolution[0]} x {scene.resolution[1]} pixels"
    )
    values = Built(
        path=options.output,
        figures=figures,
        voxels=voxels,
        target_size=None if found is None else list(found.size),
        target_file=None if found is None else mesh_file.described(found),
        notes=notes,
    )
    return Answer(values, [*shown, *notes, *told, last])


def _chosen(options: argparse.Namespace) -> Scene:
    """Return the scene that the options describe: what they name themselves wins over the file of ``--config``."""
    assigned = [assignment.partition("=")[0].strip() for assignment in options.set]
    for flag, value, names in (
        ("target", options.target, ("target.kind", "target.mesh")),
        ("target-unit", options.unit, ("target.unit",)),
        ("target-up", options.up, ("target.up",)),
        ("ambient", options.ambient, ("ambient",)),
    ):
        for name in names:
            if value is not None and name in assigned:
                raise NlosError(f"--{flag} and --set {name}: say the same thing twice; leave one out")
    fields = to_dict(preset(options.preset, options.target or "sheet"))
    if options.config:
        given = read_toml(options.config)
        if given.get("preset") in set(PRESETS) - {options.preset}:
            raise NlosError(
                f"{options.config}: has the figures of the preset {given['preset']!r}, and {options.preset!r} is "
                f"asked for; name {given['preset']!r}, or take the figure 'preset' out of the file"
            )
        given_target = given.get("target")
        if options.target and isinstance(given_target, dict):
            same = {name: given_target.get(name, fields["target"][name]) for name in ("kind", "mesh")}
            if any(fields["target"][name] != value for name, value in same.items()):
                given = {name: value for name, value in given.items() if name != "target"}  # of another object
        fields = merge(fields, given)
    before = copy.deepcopy(fields)
    for assignment in options.set:
        set_field(fields, assignment)
    if isinstance(fields.get("target"), dict):
        fields["target"].update(
            {name: value for name in ("unit", "up") if (value := getattr(options, name)) is not None}
        )
    if fields["reflection_order"] == "all":
        fields["reflection_order"] = ALL_ORDERS
    try:
        scene: Scene = from_dict(Scene, fields)
    except NlosError as error:
        if options.config and _fault(before) == str(error):  # no --set made it
            raise NlosError(f"{options.config}: {error}") from None
        raise
    if scene.target.mesh and scene.target.kind != "mesh":
        raise NlosError(f"target.mesh: means nothing to a {scene.target.kind}; set target.kind=mesh too")
    return scene if options.ambient is None else scene.with_ambient(options.ambient)


def _fault(fields: Mapping[str, Any]) -> str:
    """Return what is wrong with a scene as plain tables; empty if nothing is."""
    try:
        from_dict(Scene, fields)
    except NlosError as error:
        return str(error)
    return ""
