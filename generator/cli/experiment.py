"""The verb ``experiment``: the light's path, taken apart."""

from __future__ import annotations

import argparse
import math

from generator.cli.terminal import LineProgress
from generator.model.errors import NlosError


def run_experiment(options: argparse.Namespace) -> int:
    from generator.blender.measure import experiment_report
    from generator.blender.scene import blend_file

    for name, least in (("resolution", 1), ("samples", 1), ("repeats", 1)):
        if getattr(options, name) < least:
            raise NlosError(f"--{name} {getattr(options, name)}: must be {least} or more")
    if not 0.0 <= options.ambient < math.inf:
        raise NlosError(f"--ambient {options.ambient:g}: must be 0, which is dark, or more")
    if options.output.exists() and not options.output.is_dir():
        raise NlosError(f"{options.output}: is a file; name a folder")
    if options.scene:  # as it is lit
        places: dict[str, experiment_report.Open] = {
            options.scene.stem: lambda _: blend_file.open_file(options.scene)
        }
        options.ambient = 0.0
    else:
        places = experiment_report.presets()
    settings = {"pixels": options.resolution, "samples": options.samples, "repeats": options.repeats}
    every = experiment_report.run(
        options.number, options.output, places, settings, ambient=options.ambient, progress=LineProgress("pictures")
    )
    for line in every:
        print(line, flush=True)
    return 0
