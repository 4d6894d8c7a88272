"""Spoilt files of every kind that users hand in: each is refused by a sentence.

Nothing here does harm to whoever opens it without these guards. Limits are lowered until a small, sound file exceeds
them, and what compiled code takes for granted is asked of numbers that it never sees.
"""

from __future__ import annotations

import json
import re
import shutil
import struct
import subprocess
import sys
import zipfile
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import skops.io
from classify_helpers import make_bulk, make_dataset
from conftest import ROOT
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from classify.classifiers import models
from classify.inference import atlas_build, atlas_file, posterior
from classify.pictures import feature_table
from classify.pictures.sensor import Sensor
from classify.pictures.settings import FeatureSettings
from generator.files import limits
from generator.files.toml import dump_toml, merge, read_toml
from generator.model.errors import NlosError
from generator.sets import bulk_set, simulated
from generator.sets.dataset import Dataset
from generator.transport.world_file import load_world


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A folder with a sound file of every kind."""
    folder = tmp_path_factory.mktemp("sound")
    features = feature_table.extract(make_dataset(folder / "set", n=4), FeatureSettings())
    feature_table.write(folder / "f.h5", features)
    for name in ("LDA", "CART", "KNN", "SVM"):
        models.save(folder / f"{name}.skops", models.train(features, name, "paper"))
    made = make_bulk(folder / "bulk", pictures=80, resolution=(8, 8))
    atlas_file.save(folder / "a.atlas", atlas_build.build(made, Sensor(frames=10)))
    made.close()
    return folder


@pytest.fixture
def copied(sound, tmp_path):
    """Return what copies one of the sound files or folders, to be spoilt."""

    def copy(name):
        (shutil.copytree if (sound / name).is_dir() else shutil.copy)(sound / name, tmp_path / name)
        return tmp_path / name

    return copy


def replaced(name, **how):
    def spoil(file):
        del file[name]
        if "link" in how:
            file[name] = how["link"]
        else:
            file.create_dataset(name, **how)

    return spoil


def told(name, value):
    def spoil(file):
        file.attrs[name] = value

    return spoil


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (replaced("label", link=h5py.SoftLink("/file")), "label is a link"),
        (replaced("voxel", link=h5py.ExternalLink("other.h5", "/x")), "voxel is a link"),
        (replaced("features", data=np.zeros((36, 116), "c16")), "features holds complex128"),
        (replaced("voxel", data=np.zeros(36)), "voxel holds float64"),
        (replaced("label", data=np.zeros(36)), "is not a features file"),
        (replaced("features", data=h5py.Empty("f8")), "is not a features file|not tables"),
        (replaced("position", data=np.zeros(36)), "not tables"),
        (replaced("background", data=np.zeros(3)), "background has shape"),
        (replaced("background", data=np.zeros((2, 2, 3), [("a", "f4")])), "background holds"),
        (told("provenance", "7"), "where its features come from"),
        (told("provenance", '{"sensor": []}'), "where its features come from"),
        (told("grid", "[" * 50), "is not a features file"),
        (told("grid", "[]"), "grid: must be a table"),
        (told("settings", "9" * 5000), "is not a features file|must be a table"),
        (told("format", np.zeros(3)), "is not a features file"),
    ],
)
def test_spoilt_features_are_refused(copied, spoil, words):
    path = copied("f.h5")
    with h5py.File(path, "r+") as file:
        spoil(file)
    with pytest.raises(NlosError, match=rf"f\.h5: .*({words})"):
        feature_table.read(path)


def rebuilt(path, change):
    bundle = skops.io.load(path, trusted=sorted(models._TRUSTED))
    change(bundle)
    skops.io.dump(bundle, path)


@pytest.mark.parametrize(
    ("reader", "name"),
    [
        (feature_table.read, "f.h5"),
        (atlas_file.load, "a.atlas"),
        (models.load, "LDA.skops"),
        (load_world, "bulk/world.npz"),
        (lambda path: bulk_set.Bulk.open(path).pictures[0], "bulk"),
    ],
)
def test_what_a_file_claims_is_held_against_its_size(sound, monkeypatch, reader, name):
    """A sound file claims more than a limit of nothing; with the usual one it is read."""
    reader(sound / name)
    monkeypatch.setattr(limits, "MUCH", 0)
    monkeypatch.setattr(limits, "MOST", 0)
    with pytest.raises(NlosError, match="claims"):
        reader(sound / name)


def test_the_limit_is_a_hundred_times_the_size_and_128_mib_at_least():
    assert not limits.exceeds_limit(2**27, 1)
    assert limits.exceeds_limit(2**27 + 1, 2**20)
    assert not limits.exceeds_limit(2**27 + 1, 2**21)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells how much memory a process has")
def test_what_reads_a_file_takes_no_more_memory_than_it_may(copied):
    """Of 40 MB, which are let through and then asked for."""
    with limits.limited(2**24):
        with pytest.raises(MemoryError):
            np.empty(2**31)  # more than a process can have freed in between, and never touched
        np.ones(2**10)
    np.ones(2**22)
    path = copied("f.h5")
    with h5py.File(path, "r+") as file:
        del file["features"]
        file.create_dataset("features", data=np.zeros((40_000, 125)), compression="gzip")
    with pytest.raises(NlosError, match="differ in length"):
        feature_table.read(path)
    # In a process of its own: one that did much else before has room that it need not ask for.
    script = (
        "import sys; from pathlib import Path; from classify.pictures import feature_table\n"
        "feature_table._SPARE, feature_table._COPIES = 2**22, 0\n"
        "try: feature_table.read(Path(sys.argv[1]))\n"
        "except ValueError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", script, path], capture_output=True, text=True, cwd=ROOT, check=True)
    assert re.search(r"is not a features file of this software \(.*([Mm]emory|allocate)", done.stdout), done


def heap(size, *objects):
    """Bytes that begin as a file of HDF5 does, though it is none, and go on with a collection of texts."""
    inside = b"".join(struct.pack("<HHIQ", number, 0, 0, claimed) for number, claimed in objects)
    return b"\x89HDF\r\n\x1a\n" + bytes(5) + b"\x08\x08\0" + b"GCOL\x01\0\0\0" + struct.pack("<Q", size) + inside


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (heap(48, (1, 0), (0, 16)), None),
        (heap(32, (1, 40)), "lie where they cannot"),
        (heap(2**40, (1, 8)), "lie where they cannot"),
        (b"", "is empty"),
        (b"\x89HDF\r\n\x1a\n" + bytes(8), "does not start like"),
        (b"a text of sixteen bytes and more", "does not start like"),
    ],
)
def test_texts_lie_one_behind_the_other(tmp_path, data, words):
    path = tmp_path / "f.h5"
    path.write_bytes(data)
    with pytest.raises(OSError, match=r"[Uu]nable"):  # HDF5 opens none of these
        h5py.File(path)
    if words is None:
        limits.check_heaps(path)
        return
    with pytest.raises(ValueError, match=words):
        limits.check_heaps(path)
    with pytest.raises(NlosError, match=words):
        feature_table.read(path)


@pytest.mark.parametrize(
    ("name", "words"),
    [("CART", "leads nowhere"), ("KNN", "its neighbours"), ("SVM", "support vectors do not fit")],
)
def test_what_compiled_code_takes_for_granted_is_asked_first(sound, name, words):
    """Of sound models: each has its numbers looked at, and none fits pictures of a single feature."""
    found = models.load(sound / f"{name}.skops")
    models._check_inside(found.estimator, int(found.estimator.n_features_in_))
    with pytest.raises(ValueError, match=words):
        models._check_inside(found.estimator, 1)


@pytest.mark.parametrize(
    ("changed", "right"),
    [
        ({}, True),
        ({"children_left": [0, -1, -1]}, False),
        ({"children_right": [3, -1, -1]}, False),
        ({"children_right": [2, 2, -1]}, False),
        ({"feature": [4, -2, -2]}, False),
        ({"feature": [-1, -2, -2]}, False),
        ({"value": np.zeros((2, 1, 2))}, False),
    ],
)
def test_every_way_down_a_tree_ends(changed, right):
    """Plain numbers, which no compiled code sees."""
    whole = {"node_count": 3, "n_outputs": 1, "max_n_classes": 2, "value": np.zeros((3, 1, 2))}
    whole |= {"children_left": [1, -1, -1], "children_right": [2, -1, -1], "feature": [0, -2, -2], **changed}
    tree = SimpleNamespace(**{k: np.array(v) if isinstance(v, list) else v for k, v in whole.items()})
    if right:
        models._check_tree(tree, 4)
        return
    with pytest.raises(ValueError, match=r"leads nowhere|lacks answers"):
        models._check_tree(tree, 4)


def of_another_kernel(bundle):
    bundle["estimator"].calibrated_classifiers_[0].estimator[-1].kernel = "poly"


def of_another_distance(bundle):
    bundle["estimator"][-1].effective_metric_ = "manhattan"


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("SVM", of_another_kernel, "no support vector machine of this software"),
        ("KNN", of_another_distance, "cannot be asked"),
    ],
)
def test_models_are_asked_when_they_are_loaded(copied, name, change, words):
    path = copied(f"{name}.skops")
    rebuilt(path, change)
    with pytest.raises(NlosError, match=words):
        models.load(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a = " + "[" * 50, "is not a TOML file"),
        (".".join(["a"] * 60) + " = 1", "a key in it has too many parts"),
        (".".join(['"a"'] * 60) + " = 1", "a key in it has too many parts"),
        ("[" + " . ".join(["a"] * 60) + "]", "a key in it has too many parts"),
        ("a = " + "9" * 5000, "is not a TOML file"),
    ],
)
def test_toml_that_is_not_ours_is_refused(tmp_path, text, words):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(NlosError, match=words):
        read_toml(path)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (replaced("kinds", data=np.zeros(80)), "kinds holds float64"),
        (replaced("background", data=np.zeros((4, 4, 4))), "differ in length"),
        (replaced("codes", data=np.zeros(3)), "is not an atlas"),
        (replaced("positions", data=np.full((80, 3), 1e6)), "outside its grid"),
        (told("about", '{"targets": 7}'), "does not name its targets"),
        (told("about", "[]"), "is not an atlas"),
        (told("spread", -1.0), "no positive number"),
        (told("left_out", np.nan), "no positive number"),
        (told("sensor", "{}"), None),
    ],
)
def test_spoilt_atlases_are_refused(copied, spoil, words):
    path = copied("a.atlas")
    with h5py.File(path, "r+") as file:
        spoil(file)
    if words is None:
        assert atlas_file.load(path).sensor == Sensor()
        return
    with pytest.raises(NlosError, match=rf"a\.atlas: .*{words}"):
        atlas_file.load(path)


def test_an_atlas_whose_codes_mean_nothing_gives_a_sentence(copied):
    path = copied("a.atlas")
    with h5py.File(path, "r+") as file:
        file["codes"][0] = 9e14
        file["positions"][:] = file["positions"][0]
    found = atlas_file.load(path)
    picture = np.repeat(found.background[..., None], 3, axis=2).astype(np.float32)
    try:
        place = posterior.locate(found, found.code(picture))
    except NlosError:
        return
    assert np.isfinite(place.position).all()


def wide(bundle):
    bundle["estimator"][-1].coef_ = bundle["estimator"][-1].coef_[:, :3]


def flat(bundle):
    bundle["background"] = np.zeros(3, dtype=np.float32)


def dazzling(bundle):
    bundle["background"] = np.full_like(bundle["background"], np.inf)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (wide, "does not answer"),
        (flat, "no background picture"),
        (dazzling, "no background picture"),
    ],
)
def test_models_that_cannot_answer_are_refused(copied, change, words):
    path = copied("LDA.skops")
    rebuilt(path, change)
    with pytest.raises(NlosError, match=words):
        models.load(path)


def test_a_world_of_nonsense_is_refused(copied):
    path = copied("bulk") / bulk_set.WORLD
    with zipfile.ZipFile(path) as archive:
        inside = {name: archive.read(name) for name in archive.namelist()}
    name = next(n for n, data in inside.items() if b"'<f8'" in data)
    for spoilt in (inside[name].replace(b"{", b"("), inside[name].replace(b"'<f8'", b"'|O8'"), b""):
        with zipfile.ZipFile(path, "w") as archive:
            for other, data in {**inside, name: spoilt}.items():
                archive.writestr(other, data)
        with pytest.raises(NlosError, match="is not a world"):
            load_world(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sweep": {"part": 1, "pictures": 10**9}}, "too many"),
        ({"sweep": {"resolution": [60000, 60000]}}, "sweep.resolution was changed"),
        ({"scene": {"grid": 7}}, "scene.grid"),
        ({"scene": {"target": []}}, "scene.target"),
        ({"reference_radiance": float("nan")}, "reference_radiance"),
    ],
)
def test_spoilt_simulated_sets_are_refused(copied, change, words):
    path = copied("bulk")
    meta = merge(read_toml(path / bulk_set.MANIFEST), change)
    (path / bulk_set.MANIFEST).write_text(dump_toml(meta))
    with pytest.raises(NlosError, match=words):
        simulated.open_set(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scene": {"ambient": "dark"}}, "scene.ambient"),
        ({"scene": {"target": 3}}, "scene.target"),
        ({"scene": {"grid": {"lo": 3}}}, "grid.lo"),
        ({"sweep": {"engine": 7}}, "sweep.engine"),
        ({"sweep": {"poses": "many"}}, "sweep.poses"),
        ({"software": 3}, "software"),
        ({"links": ["x"]}, "links"),
        ({"reference_radiance": float("inf")}, "reference_radiance"),
    ],
)
def test_spoilt_manifests_are_refused(copied, change, words):
    path = copied("set")
    meta = merge(read_toml(path / "dataset.toml"), change)
    (path / "dataset.toml").write_text(dump_toml(meta))
    with pytest.raises(NlosError, match=rf"dataset\.toml: .*{words}"):
        Dataset.open(path)


leaf = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
plain = leaf | st.lists(leaf, max_size=3) | st.dictionaries(st.text(max_size=5), leaf | st.lists(leaf), max_size=3)


@given(st.sampled_from(["grid", "settings", "provenance", "target", "format"]), plain)
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_attribute_gives_features_or_a_sentence(sound, tmp_path, name, value):
    path = tmp_path / "f.h5"
    shutil.copy(sound / "f.h5", path)
    with h5py.File(path, "r+") as file:
        file.attrs[name] = json.dumps(value)
    try:
        found = feature_table.read(path)
        feature_table.check_comparable(found, found, ("a", "b"))
    except NlosError:
        pass
