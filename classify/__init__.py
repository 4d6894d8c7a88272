"""Learn from pictures of the relay wall: features, classifiers, and answers with their uncertainty.

The public interface: functions take and return arrays, and print nothing. It reads data sets and needs no Blender.

Examples
--------
Simulate a small set of pictures, build an atlas of it, and locate the object of one of the pictures:

>>> import classify, generator
>>> from pathlib import Path
>>> from tempfile import mkdtemp
>>> folder = Path(mkdtemp())
>>> scene = generator.new_scene(generator.preset("room", "sphere"))
>>> generator.save_scene(folder / "room.blend")
>>> settings = {"pictures": 90, "resolution": "8", "accuracy": 0.01}
>>> request = generator.BulkRequest(scene=folder / "room.blend", path=folder / "set", chosen=settings, probe=False)
>>> made = generator.bulk(request)
>>> made.bulk.pictures.shape
(90, 8, 8)
>>> sensor = classify.Sensor()
>>> atlas = classify.build_atlas(made.bulk, sensor)
>>> pictures = generator.open_set(folder / "set")
>>> seen = atlas.code(pictures.picture(pictures.records[4]), pictures.background())
>>> place = classify.locate(atlas, seen)
>>> atlas.grid.labels[int(place.voxels.argmax())] == pictures.records[4].label
True

What a picture can tell at most, over the hidden volume, and in how many pictures an object is found:

>>> limits = classify.bound_map(classify.Synthesis(atlas, made.bulk.world()), across=2)
>>> limits.position.shape
(2, 2)
>>> [detected] = classify.detections(atlas, [1], count=5)
>>> len(detected.found) == atlas.grid.n_voxels
True

Extract features of the same pictures, and train a classifier:

>>> features = classify.extract(pictures, classify.FeatureSettings(set="global"), sensor=sensor)
>>> model = classify.train(features, "KNN", "paper")
>>> sum(model.probabilities(pictures.picture(pictures.records[4])).values())
1.0
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from classify.classifiers.evaluate import compare
    from classify.classifiers.models import Model, train
    from classify.classifiers.models import load as load_model
    from classify.classifiers.models import save as save_model
    from classify.inference.atlas import Atlas
    from classify.inference.atlas_build import build as build_atlas
    from classify.inference.atlas_file import load as load_atlas
    from classify.inference.atlas_file import save as save_atlas
    from classify.inference.bound import over_volume as bound_map
    from classify.inference.bound import reachable as bound
    from classify.inference.detect import Detector, detections, evidence
    from classify.inference.evaluation import run as evaluate
    from classify.inference.posterior import Synthesis, locate
    from classify.inference.sequence import run as track
    from classify.pictures.feature_table import Features, extract
    from classify.pictures.feature_table import read as read_features
    from classify.pictures.feature_table import write as write_features
    from classify.pictures.sensor import Sensor
    from classify.pictures.settings import FeatureSettings

_EXPORTS = {
    "Atlas": "classify.inference.atlas:Atlas",
    "Detector": "classify.inference.detect:Detector",
    "FeatureSettings": "classify.pictures.settings:FeatureSettings",
    "Features": "classify.pictures.feature_table:Features",
    "Model": "classify.classifiers.models:Model",
    "Sensor": "classify.pictures.sensor:Sensor",
    "Synthesis": "classify.inference.posterior:Synthesis",
    "bound": "classify.inference.bound:reachable",
    "bound_map": "classify.inference.bound:over_volume",
    "build_atlas": "classify.inference.atlas_build:build",
    "compare": "classify.classifiers.evaluate:compare",
    "detections": "classify.inference.detect:detections",
    "evaluate": "classify.inference.evaluation:run",
    "evidence": "classify.inference.detect:evidence",
    "extract": "classify.pictures.feature_table:extract",
    "load_atlas": "classify.inference.atlas_file:load",
    "load_model": "classify.classifiers.models:load",
    "locate": "classify.inference.posterior:locate",
    "read_features": "classify.pictures.feature_table:read",
    "save_atlas": "classify.inference.atlas_file:save",
    "save_model": "classify.classifiers.models:save",
    "track": "classify.inference.sequence:run",
    "train": "classify.classifiers.models:train",
    "write_features": "classify.pictures.feature_table:write",
}
__all__ = [
    "Atlas",
    "Detector",
    "FeatureSettings",
    "Features",
    "Model",
    "Sensor",
    "Synthesis",
    "bound",
    "bound_map",
    "build_atlas",
    "compare",
    "detections",
    "evaluate",
    "evidence",
    "extract",
    "load_atlas",
    "load_model",
    "locate",
    "read_features",
    "save_atlas",
    "save_model",
    "track",
    "train",
    "write_features",
]


def __getattr__(name: str) -> Any:
    # Imported on first use, since scikit-learn and the compiler take seconds to load.
    if name in _EXPORTS:
        module, _, attribute = _EXPORTS[name].partition(":")
        return getattr(importlib.import_module(module), attribute)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
