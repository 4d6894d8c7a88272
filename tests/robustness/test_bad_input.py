"""Bad input that looks sound at first: each gives one clear sentence, never a traceback or a wrong answer."""

from __future__ import annotations

from dataclasses import replace

import h5py
import joblib
import numpy as np
import pytest
import skops.io
from classify_helpers import make_dataset

from classify.classifiers import evaluate, models
from classify.classifiers.names import ALL
from classify.cli import main
from classify.pictures import feature_table
from classify.pictures.features import describe
from classify.pictures.settings import FeatureSettings
from generator.model.errors import NlosError


@pytest.fixture(scope="module")
def features(tmp_path_factory):
    return feature_table.extract(make_dataset(tmp_path_factory.mktemp("h") / "d", n=4), FeatureSettings())


@pytest.fixture(autouse=True)
def one_process():
    with joblib.parallel_config(backend="sequential"):
        yield


def first(features, n):
    """The first n pictures of every voxel."""
    keep = np.concatenate([np.flatnonzero(features.labels == label)[:n] for label in np.unique(features.labels)])
    return replace(
        features,
        values=features.values[keep],
        labels=features.labels[keep],
        voxels=features.voxels[keep],
        positions=features.positions[keep],
        rotations=features.rotations[keep],
        files=[features.files[i] for i in keep],
    )


@pytest.mark.parametrize(("n", "folds"), [(3, 3), (4, 2)])
def test_a_search_needs_enough_training_samples(features, n, folds):
    few = first(features, n)
    with pytest.raises(NlosError, match=rf"f: class A has {n} samples.*--hyperparameters paper"):
        evaluate.compare([few], ["f"], classifiers=("SVM",), settings=["tuned"], folds=folds)
    assert evaluate.compare([few], ["f"], classifiers=("LDA",), settings=["paper"], folds=folds)


def test_one_training_sample_a_class_is_too_few(features):
    with pytest.raises(NlosError, match="class A has 2 samples, which leaves 1"):
        evaluate.compare([first(features, 2)], ["f"], classifiers=("LDA",), settings=["paper"], folds=2)


def test_pictures_that_are_all_the_same_are_refused(features):
    same = replace(features, values=np.ones_like(features.values))
    with pytest.raises(NlosError, match="every picture has the same features"):
        evaluate.compare([same], ["f"], classifiers=("LDA",), settings=["paper"], folds=2)
    with pytest.raises(NlosError, match="every picture has the same features"):
        models.train(same, "NB", "tuned")


def test_one_file_is_not_compared_with_itself(features):
    with pytest.raises(NlosError, match="the same file twice"):
        evaluate.compare([features, features], ["f", "f"], classifiers=("LDA",), settings=["paper"], folds=2)


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_seed_must_fit_scikit_learn(features, seed):
    with pytest.raises(NlosError, match="seed"):
        evaluate.compare([features], ["f"], settings=["paper"], folds=2, seed=seed)
    with pytest.raises(NlosError, match="seed"):
        models.train(features, "LDA", "paper", seed=seed)


def test_duplicate_pictures_are_counted_and_told(features, tmp_path, capsys):
    assert features.duplicates == 0
    values = features.values.copy()
    values[1] = values[2] = values[0]
    doubled = replace(features, values=values)
    assert doubled.duplicates == 2
    feature_table.write(tmp_path / "f.h5", doubled)
    arguments = ["compare", str(tmp_path / "f.h5"), "-o", str(tmp_path / "r"), "--folds", "2", "--settings", "paper"]
    assert main.main(arguments) == 0
    assert "2 of 36 pictures" in capsys.readouterr().err
    assert "2 of 36 pictures" in (tmp_path / "r" / "report.html").read_text(encoding="utf-8")


def spoil(path, name, value):
    with h5py.File(path, "a") as file:
        if name in file:
            del file[name]
            file[name] = value
        else:
            file.attrs[name] = value


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("label", ["Z"] * 36, "label Z"),
        ("voxel", np.arange(3), "differ in length"),
        ("position", np.zeros((3, 3)), "differ in length"),
        ("file", ["x"], "differ in length"),
        ("feature_names", [f"f{i}" for i in range(116)], "feature names"),
        ("reference_radiance", -1.0, "reference radiance"),
        ("reference_radiance", np.nan, "reference radiance"),
    ],
)
def test_inconsistent_features_files_are_refused(features, tmp_path, name, value, words):
    feature_table.write(tmp_path / "f.h5", features)
    spoil(tmp_path / "f.h5", name, value)
    with pytest.raises(NlosError, match=rf"f\.h5: .*{words}"):
        feature_table.read(tmp_path / "f.h5")


@pytest.mark.parametrize("kind", ["external", "virtual"])
def test_features_that_lie_in_another_file_are_not_followed(features, tmp_path, kind):
    """HDF5 can keep a data set's bytes in any file of the machine: such a file is not read."""
    secret = tmp_path / "secret"
    secret.write_bytes(features.values.tobytes())
    feature_table.write(tmp_path / "f.h5", features)
    with h5py.File(tmp_path / "f.h5", "a") as file:
        shape = file["features"].shape
        del file["features"]
        if kind == "external":
            file.create_dataset("features", shape, "f8", external=[(str(secret), 0, h5py.h5f.UNLIMITED)])
        else:
            layout = h5py.VirtualLayout(shape, "f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", shape)
            file.create_virtual_dataset("features", layout)
    with pytest.raises(NlosError, match="features lies in another file"):
        feature_table.read(tmp_path / "f.h5")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"settings": None}, "is not a model file"),
        ({"format": "2"}, "is not a model file"),
        ({"format": 2}, "model format 2"),
        ({"grid": "{"}, "is not a model file"),
        ({"estimator": "no classifier"}, "is not a model file"),
        ({"background": "black"}, "is not a model file"),
    ],
)
def test_broken_model_files_are_named(features, tmp_path, change, words):
    path = tmp_path / "m.skops"
    models.save(path, models.train(features, "LDA", "paper"))
    bundle = skops.io.load(path, trusted=[])
    skops.io.dump({**bundle, **change}, path)
    with pytest.raises(NlosError, match=rf"m\.skops: .*{words}"):
        models.load(path)


def test_a_model_of_other_features_is_refused(features, tmp_path):
    model = models.train(features, "LDA", "paper")
    models.save(tmp_path / "m.skops", replace(model, settings=FeatureSettings(bins=8)))
    with pytest.raises(NlosError, match="116 features, but its settings give 44"):
        models.load(tmp_path / "m.skops")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in ("LR", "LDA", "MLP") else n for n in ALL]
)
def test_every_tuned_model_is_saved_and_loaded(features, tmp_path, name):
    model = models.train(features, name, "tuned")
    models.save(tmp_path / "m.skops", model)
    picture = features.background * np.float32(1.01)
    assert models.load(tmp_path / "m.skops").probabilities(picture) == model.probabilities(picture)


@pytest.mark.parametrize("command", ["features", "compare", "train"])
def test_output_that_cannot_be_written_is_told_before_the_work(tmp_path, capsys, monkeypatch, command):
    monkeypatch.setattr(feature_table, "read", lambda *_: pytest.fail("worked first"))
    monkeypatch.setattr(feature_table, "extract", lambda *_, **__: pytest.fail("worked first"))
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    make_dataset(tmp_path / "d", n=1)
    taken = tmp_path / ("file" if command == "compare" else "folder")
    assert main.main([command, str(tmp_path / "d"), "-o", str(taken)]) == 2
    assert capsys.readouterr().err.startswith(f"error: {taken}: ")


def test_zero_light_has_finite_features():
    picture = np.full((4, 4, 3), 1e20, dtype=np.float32)
    for kind in ("global", "spatial-hog"):
        assert np.isfinite(describe(picture, FeatureSettings(set=kind, input="raw"), reference=0.0)).all()
