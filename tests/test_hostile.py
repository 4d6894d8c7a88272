"""Files made to harm, of every kind that users hand in: each is refused by a sentence, in little time and memory.

What `benchmarks/fuzz.py` found is kept here.
"""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
import sys
import zipfile

import h5py
import numpy as np
import pytest
import skops.io
from classify_helpers import make_bulk, make_dataset
from conftest import ROOT
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from classify import atlas, localise, models, store
from classify.features import FeatureSettings
from generator import bulk, simulated, spec
from generator.dataset import Dataset
from generator.sensor import Sensor
from generator.spec import NlosError
from generator.transport.store import load_world


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A folder with a sound file of every kind."""
    folder = tmp_path_factory.mktemp("sound")
    features = store.extract(make_dataset(folder / "set", n=4), FeatureSettings())
    store.write(folder / "f.h5", features)
    for name in ("LDA", "CART", "KNN", "SVM"):
        models.save(folder / f"{name}.skops", models.train(features, name, "paper"))
    made = make_bulk(folder / "bulk", pictures=80, resolution=(8, 8))
    atlas.save(folder / "a.atlas", atlas.build(made, Sensor(frames=10)))
    made.close()
    return folder


@pytest.fixture
def copied(sound, tmp_path):
    """Return what copies one of the sound files or folders, to be spoilt."""

    def copy(name):
        (shutil.copytree if (sound / name).is_dir() else shutil.copy)(sound / name, tmp_path / name)
        return tmp_path / name

    return copy


SCRIPT = """
import json, sys, time
from pathlib import Path
from classify import atlas, models, store
from generator import bulk, spec
from generator.transport.store import load_world

def most():
    return 1024 * int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])

for reader, path in json.loads(sys.argv[1]):
    Path("/proc/self/clear_refs").write_text("5")
    begun, said = time.perf_counter(), ""
    try:
        eval(reader)(Path(path))
    except ValueError as error:
        said = str(error)
    print(json.dumps([path, time.perf_counter() - begun, most(), said]), flush=True)
"""
"""Reads files in a process of its own, and tells of each the seconds, the bytes at most, and what was said."""


def huge(file):
    del file["features"]
    file.create_dataset("features", (2**31, 4), "f8", chunks=(64, 4))


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
        (huge, "claims 687.* bytes in"),
        (replaced("label", link=h5py.SoftLink("/label")), "label is a link"),
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
        (told("grid", "[" * 100_000), "is not a features file"),
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
        store.read(path)


def long_text(path, where):
    """A text that claims gigabytes: HDF5 asks for as much memory before it looks for the text."""
    with h5py.File(path) as file:
        at, length = file["label"].id.get_offset(), len(file.attrs["grid"].encode())
    data = bytearray(path.read_bytes())
    if where == "attribute":
        at = data.index(struct.pack("<I", length))
        while int.from_bytes(data[at + 4 : at + 12], "little") > len(data):
            at = data.index(struct.pack("<I", length), at + 1)
    data[at : at + 4] = struct.pack("<I", 2**31)
    path.write_bytes(data)


def many_texts(path):
    """Texts that all lie in one place of the file, three gigabytes in all."""
    with h5py.File(path, "r+") as file:
        for name in ("label", "file"):
            del file[name]
        file.create_dataset("label", data=["x" * 60_000], dtype=h5py.string_dtype())
        file.create_dataset("file", (50_000,), dtype=h5py.string_dtype())
        file["file"][0] = "y"
        first, second = (file[name].id.get_offset() for name in ("label", "file"))
    data = bytearray(path.read_bytes())
    data[second : second + 16 * 50_000] = data[first : first + 16] * 50_000
    path.write_bytes(data)


def endless(path):
    """Free room between texts that takes no room: HDF5 goes on from there to there."""
    data = bytearray(path.read_bytes())
    at = data.index(b"GCOL\x01") + 16
    while int.from_bytes(data[at : at + 2], "little"):
        at += 16 + -(-int.from_bytes(data[at + 8 : at + 16], "little") // 8) * 8
    data[at + 8 : at + 16] = bytes(8)
    path.write_bytes(data)


def zeros_in(path, name, head=b""):
    """An archive one of whose files is half a gigabyte of zeros."""
    with zipfile.ZipFile(path) as archive:
        inside = {other: archive.read(other) for other in archive.namelist() if other.endswith(".json")}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for other, data in {**inside, name: head + bytes(2**29)}.items():
            archive.writestr(other, data)


def rebuilt(path, change):
    bundle = skops.io.load(path, trusted=sorted(models._TRUSTED))
    change(bundle)
    skops.io.dump(bundle, path)


def in_a_loop(bundle):
    bundle["estimator"][-1].tree_.children_left[0] = 0


def out_of_bounds(bundle):
    bundle["estimator"][-1].tree_.feature[0] = 10**8


def vectors_that_are_not_there(bundle):
    machine = bundle["estimator"].calibrated_classifiers_[0].estimator[-1]
    machine._n_support = machine._n_support + 10**5


def of_no_class(bundle):
    bundle["estimator"][-1]._y = bundle["estimator"][-1]._y + 10**6


def narrow(bundle):
    bundle["estimator"][-1]._fit_X = bundle["estimator"][-1]._fit_X[:, :2].copy()


TOML = {
    "lists": "a = " + "[" * 100_000,
    "tables": "a = " + "{a = " * 5000,
    "key": ".".join(["a"] * 300_000) + " = 1",
    "quoted": ".".join(['"a"'] * 200_000) + " = 1",
    "table": "[" + " . ".join(["a"] * 200_000) + "]",
    "digits": "a = " + "9" * 900_000,
}
"""Some 300 000 parts of a key cost tomllib tens of gigabytes."""


def test_bombs_take_neither_time_nor_memory(sound, tmp_path):
    """Nor does compiled code stray, by numbers in a model, where nothing is; for that would end the process."""
    made = []

    def bomb(reader, source, name, change, words):
        path = tmp_path / name
        if source:
            shutil.copy(sound / source, path)
        change(path)
        made.append((reader, path, words))

    for where in ("dataset", "attribute"):
        bomb("store.read", "f.h5", f"{where}.h5", lambda path, w=where: long_text(path, w), "is not a features file")
    bomb("store.read", "f.h5", "many.h5", many_texts, "is not a features file")
    bomb("atlas.load", "a.atlas", "endless.atlas", endless, "is not an atlas file")
    for change in (of_no_class, narrow):
        name = f"{change.__name__}.skops"
        bomb("models.load", "KNN.skops", name, lambda path, c=change: rebuilt(path, c), "its neighbours")
    for change in (in_a_loop, out_of_bounds):
        name = f"{change.__name__}.skops"
        bomb("models.load", "CART.skops", name, lambda path, c=change: rebuilt(path, c), "leads nowhere")
    bomb(
        *("models.load", "SVM.skops", "v.skops", lambda path: rebuilt(path, vectors_that_are_not_there)),
        "support vectors do not fit",
    )
    bomb("models.load", "LDA.skops", "zeros.skops", lambda path: zeros_in(path, "1.npy"), "claims")
    bomb("load_world", "bulk/world.npz", "zeros.npz", lambda path: zeros_in(path, "order.npy"), "claims")
    for name, text in TOML.items():
        bomb("spec.read_toml", "", f"{name}.toml", lambda path, t=text: path.write_text(t), "is not a TOML file")
    assert max(path.stat().st_size for _, path, _ in made) < 1_000_000
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT, json.dumps([(reader, str(path)) for reader, path, _ in made])],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    lines = list(map(json.loads, result.stdout.splitlines()))
    assert len(lines) == len(made), (lines[-1:], result.returncode, result.stderr[-500:])
    for (_, _, words), (path, seconds, most, said) in zip(made, lines, strict=True):
        assert words in said, (path, said)
        assert seconds < 10.0, path
        assert most < 2**30, path


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
        assert atlas.load(path).sensor == Sensor()
        return
    with pytest.raises(NlosError, match=rf"a\.atlas: .*{words}"):
        atlas.load(path)


def test_an_atlas_whose_codes_mean_nothing_gives_a_sentence(copied):
    path = copied("a.atlas")
    with h5py.File(path, "r+") as file:
        file["codes"][0] = 9e14
        file["positions"][:] = file["positions"][0]
    found = atlas.load(path)
    picture = np.repeat(found.background[..., None], 3, axis=2).astype(np.float32)
    try:
        place = localise.locate(found, found.code(picture))
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
    path = copied("bulk") / bulk.WORLD
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
    meta = spec.merge(spec.read_toml(path / bulk.MANIFEST), change)
    (path / bulk.MANIFEST).write_text(spec.dump_toml(meta))
    with pytest.raises(NlosError, match=words):
        simulated.opened(path)


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
    meta = spec.merge(spec.read_toml(path / "dataset.toml"), change)
    (path / "dataset.toml").write_text(spec.dump_toml(meta))
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
        found = store.read(path)
        store.check_comparable(found, found, ("a", "b"))
    except NlosError:
        pass
