"""The verb ``features``."""

from __future__ import annotations

import argparse

from classify.cli.options import check_output, progress_bar, sensor_of


def run_features(options: argparse.Namespace) -> int:
    from classify.classifiers import models
    from classify.pictures import feature_table
    from classify.pictures.features import FeatureSettings
    from generator.sets.simulated import opened

    settings = FeatureSettings(
        set=options.set,
        input=options.input,
        tone=options.tone,
        floor=options.floor,
        ceiling=options.ceiling,
        size=options.size,
    )
    models.check_seed(options.seed)
    sensor = None if options.sensor is None and options.frames is None else sensor_of(options)
    dataset = opened(options.dataset, options.count)
    check_output(options.output)
    with progress_bar("describing", "pictures") as progress:
        features = feature_table.extract(
            dataset,
            settings,
            partial=options.partial,
            sensor=sensor,
            seed=options.seed,
            progress=lambda done, total: progress(done, total, ""),
        )
    feature_table.write(options.output, features)
    n, d = features.values.shape
    missing = "" if n == dataset.planned else f" (of {dataset.planned} planned)"
    print(f"{options.output}: {n} pictures{missing}, {d} features each ({settings.set}, {settings.input})")
    return 0
