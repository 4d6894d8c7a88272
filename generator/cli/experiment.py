"""The verb ``experiment``: the paper's experiments 1 to 3."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from generator.cli.answer import Answer, json_object
from generator.cli.options import Commands, add_links_option, add_setting
from generator.cli.terminal import LineProgress
from generator.cli.volume import note
from generator.model.described import described
from generator.model.engines import traits_of
from generator.model.errors import NlosError
from generator.model.settings import Sweep


def add_parsers(commands: Commands) -> None:
    """Add the verb ``experiment`` to a command line."""
    parser = commands.add_parser(
        "experiment",
        help="the paper's experiments 1 to 3: what a movement or a turn of the object changes",
        description="Move a sphere (1) or a square sheet (2) along x, y and z, or turn both about them (3), and show "
        "what that changes: difference pictures with their amplification, the change per centimetre or degree, and "
        "the paper's claims, tested. Without a scene of your own: on the tabletop and in the room, dark and under "
        "ambient light.",
        epilog="example:\n  nlos-generate experiment 2 -o experiment-2/",
    )
    parser.add_argument("number", type=int, choices=[1, 2, 3], help="of the experiment, as in the paper")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="for tables and pictures")
    parser.add_argument("--scene", type=Path, metavar="FILE.blend", help="take this one, as it is lit")
    parser.add_argument(
        "--ambient",
        type=float,
        metavar="A",
        help="ambient light on the wall, in units of the object's own signal; 0 leaves it out (default: 1; of a "
        "scene of your own, as it is lit)",
    )
    parser.add_argument("--resolution", type=int, default=64, metavar="N", help="pixels a side (default: 64)")
    parser.add_argument(
        "--samples", type=int, metavar="N", help=f"of Cycles, under ambient light (default: {_SAMPLES})"
    )
    parser.add_argument(
        "--repeats", type=int, metavar="N", help=f"of Cycles, with other noise, for intervals (default: {_REPEATS})"
    )
    add_setting(parser, "device")
    add_links_option(parser)
    parser.set_defaults(run=run_experiment, answer=Measured)


_SAMPLES, _REPEATS = 128, 8


@json_object
class Change:
    """Change of the signal, root mean square relative to that at rest, per metre or (experiment 3) per degree."""

    axis: str = described("x, y or z: moved along it, or turned about it")
    change: float | None = described(
        "change of the signal, relative, per metre, or in experiment 3 per degree; null where noise drowns it"
    )
    margin: float | None = described("distance to the upper end of its 95 % interval; 0 where there is no noise")


@json_object
class Place:
    """What was measured with an object at a place."""

    target: str = described("sphere or sheet")
    place: str = described("scene, and how it is lit")
    engine: str = described("engine that rendered it")
    changes: list[Change] = described("change along or about each axis")
    words: str = described("the same in a sentence, with the paper's claim")


@json_object
class Measured:
    """What a movement or a turn of the object changes."""

    experiment: int = described("number of the experiment")
    results: list[Place] = described("results, place by place")
    files: list[Path] = described("tables and figures that were written")


def run_experiment(options: argparse.Namespace) -> Answer:
    """Write an experiment's tables and pictures."""
    from generator.blender.engines.devices import require_gpu
    from generator.blender.measure import experiment_report
    from generator.blender.scene import blend_file

    for name in ("resolution", "samples", "repeats"):
        if (value := getattr(options, name)) is not None and value < 1:
            raise NlosError(f"--{name} {value}: must be 1 or more")
    if options.scene and options.ambient is not None:
        raise NlosError("--ambient: is for the presets; a scene of your own is taken as it is lit, so leave it out")
    ambient = 1.0 if options.ambient is None else options.ambient
    if not 0.0 <= ambient < math.inf:
        raise NlosError(f"--ambient {ambient:g}: must be 0, which is dark, or more")
    if options.output.exists() and not options.output.is_dir():
        raise NlosError(f"{options.output}: is a file; name a folder")
    places = experiment_report.presets()
    if options.scene:  # keeps the scene's own light
        places, ambient = {options.scene.stem: lambda _: blend_file.open_file(options.scene)}, 0.0
    settings = {
        "pixels": options.resolution,
        "samples": options.samples or _SAMPLES,
        "repeats": options.repeats or _REPEATS,
        "device": options.device or Sweep.device,
    }
    if settings["device"] == "gpu":
        require_gpu()
    results, files = [], []
    for part in experiment_report.run(
        options.number, options.output, places, settings, ambient=ambient, progress=LineProgress("pictures")
    ):
        print(part.words, flush=True)
        files += [part.file] if part.file else []
        if found := part.result:
            changes = [
                Change(axis=axis, change=change, margin=margin)
                for axis, (change, margin) in zip("xyz", found.changes(), strict=True)
            ]
            place = Place(
                target=found.target, place=part.place, engine=found.engine, changes=changes, words=part.words
            )
            results.append(place)
    if not any(traits_of(result.engine).noisy for result in results):
        for name in ("samples", "repeats", "device"):
            if getattr(options, name) is not None:
                note(f"--{name}: means nothing to surfel, which rendered everything")
    return Answer(Measured(experiment=options.number, results=results, files=files))
