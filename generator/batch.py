"""Render a data set inside Blender: ``blender -b scene.blend -P generator/batch.py -- -o DATASET [options]``.

Takes the options of ``nlos-generate sweep`` except ``--workers``: one Blender renders one shard in its own process.
Start several with ``--shard 0/4``, ``--shard 1/4`` ... on as many machines as there are. Nothing needs to be
installed besides Blender.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

if __name__ == "__main__":  # Blender does not put the package of a script on the path
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import bpy

from generator.blender import sweep_worker
from generator.cli import volume
from generator.cli.answer import Answer, give
from generator.cli.options import batch_parser, chosen_settings
from generator.cli.parser import check_volume
from generator.cli.rendered import report
from generator.cli.terminal import LineProgress, guarded
from generator.jobs import sweep
from generator.jobs.request import SweepRequest
from generator.model.errors import NlosError
from generator.model.quantities import parse_shard
from generator.sets.dataset import Dataset


class Here:
    """Plans and renders in this Blender (`generator.jobs.local.Here`)."""

    def plan(self, request: SweepRequest, tell: Callable[[str], None]) -> None:
        """Make the data set from the scene that is open."""
        scene = bpy.context.scene
        options = {"force": request.force, "probe": request.probe, "tell": tell}
        sweep_worker.plan(scene, request.scene, request.path, request.chosen, **options)  # type: ignore[arg-type]

    def render(self, dataset: Dataset, batches: Sequence[Sequence[int]], done: Callable[[int], None]) -> None:
        """Render batches of poses, with the data set's own scene."""
        sweep_worker.check_blender(dataset)
        scene = sweep_worker.open_scene(dataset)
        batches_with_samples = (dict.fromkeys(batch, 0) for batch in batches)
        sweep_worker.render(scene, dataset, batches_with_samples, report=lambda poses: done(len(poses)))


def run(arguments: list[str]) -> int:
    """Render one shard of the open scene; return the exit code."""
    options = batch_parser().parse_args(arguments)
    check_volume(options)
    options.run = render
    return give(options)


def render(options: argparse.Namespace) -> Answer:
    """Render the shard that the options name, or what is missing of it."""
    if not bpy.data.filepath:
        raise NlosError("no scene is open; start with: blender -b scene.blend -P generator/batch.py -- ...")
    request = SweepRequest(
        scene=Path(bpy.data.filepath),
        path=options.output,
        chosen=chosen_settings(options),
        shard=parse_shard(options.shard),
        force=options.force,
        probe=options.probe,
        trust_links=options.trust_links,
    )
    outcome = sweep.run(request, progress=LineProgress(), tell=volume.note, here=Here())
    return report(outcome.dataset, outcome.rendered, outcome.remaining, outcome.failed)


def main() -> None:
    """Run as Blender's ``-P`` script, and end Blender with an exit code that tells success or failure."""
    sys.exit(guarded(lambda: run(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])))


if __name__ == "__main__":
    main()
