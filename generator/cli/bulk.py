"""The verb ``bulk``: many small pictures by the noise-free engine."""

from __future__ import annotations

import argparse

from generator.cli.options import chosen_settings, farm_of
from generator.cli.terminal import progress_bar, report


def run_bulk(options: argparse.Namespace) -> int:
    from generator.jobs import bulk
    from generator.sets import bulk_set

    chosen = chosen_settings(options, bulk_set.Settings, pictures=1)
    with progress_bar() as progress:
        outcome = bulk.run(
            *(options.scene, options.output, chosen),
            progress=progress,
            tell=print,
            force=options.force,
            probe=options.probe,
            **farm_of(options),
        )
    return report(outcome.bulk, outcome.rendered, outcome.remaining, outcome.failed)
