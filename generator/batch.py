"""Render a data set inside Blender: ``blender -b scene.blend -P generator/batch.py -- -o DATASET [options]``.

Takes the options of ``nlos-generate sweep`` but for ``--workers``: one Blender renders one shard, here and now. Start
several with ``--shard 0/4``, ``--shard 1/4`` ... on as many machines as there are. Needs nothing installed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

if __name__ == "__main__":  # a script given to Blender finds its package only by its own place
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import bpy

from generator.blender import sweep_worker
from generator.cli.options import batch_parser, chosen_settings
from generator.cli.terminal import LineProgress, guarded, summary
from generator.jobs import sweep
from generator.jobs.workers import in_batches
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.model.quantities import parse_shard
from generator.model.settings import AUTO
from generator.sets import links
from generator.sets.dataset import Dataset
from generator.sets.resume import check_same


def run(arguments: list[str]) -> int:
    """Render the open scene's shard; return the exit code."""
    options = batch_parser().parse_args(arguments)
    with links.trusting(options.trust_links):
        return _run(options)


def _run(options: argparse.Namespace) -> int:
    chosen = chosen_settings(options)
    shard = parse_shard(options.shard)
    source, path = Path(bpy.data.filepath), Path(options.output)
    if not bpy.data.filepath:
        raise NlosError("no scene is open; start with: blender -b scene.blend -P generator/batch.py -- ...")
    if Dataset.exists(path):
        dataset = Dataset.open(path)
        check_same(dataset, source, chosen)
    else:
        dataset = sweep_worker.plan(
            bpy.context.scene, source, path, chosen, force=options.force, probe=options.probe, tell=print
        )
        if chosen.get("engine", AUTO) == AUTO:
            print(sweep.engine_words(dataset, chosen))
        if words := sweep.start_words(dataset):
            print(words, flush=True)
    sweep_worker.check_blender(dataset)
    pending = sweep.pending_positions(dataset, shard)
    scene = sweep_worker.open_scene(dataset)
    show = LineProgress()
    show(0, len(pending))
    done = 0

    def report(made: list[PoseRecord]) -> None:
        nonlocal done
        done += len(made)
        show(done, len(pending))

    try:
        batches = in_batches(pending, sweep.batch_size(dataset))
        sweep_worker.render(scene, dataset, (dict.fromkeys(batch, 0) for batch in batches), report=report)
    finally:
        sweep.gather(dataset, shard, pending)
    remaining = sum(not pose.done for pose in dataset.poses)
    print(summary(dataset, rendered=done, remaining=remaining))
    return 0


def main() -> None:
    """Run as Blender's ``-P`` script, and leave Blender with an exit code that says how it went."""
    sys.exit(guarded(lambda: run(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])))


if __name__ == "__main__":
    main()
