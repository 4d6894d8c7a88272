"""Coverage-guided fuzzing of the code that reads files from elsewhere.

Run: ``pip install atheris; python benchmarks/fuzz.py TARGET [-max_total_time=60]`` (libFuzzer's options). Any
exception but NlosError is a fault, and so is an input that takes more than 10 s or 1 GiB.

========  ==================================================================================
exr       pictures
poses     manifests of poses, trajectories' too
toml      scenes, sweeps, sensors and plans
dataset   ``dataset.toml``, and all queries of a data set
features  feature files, as bytes and with their contents changed through HDF5 (`hostile`)
atlas     atlas files, likewise, and an answer from what could be read
bulk      simulated sets: ``bulk.toml``, a part, ``set.h5`` and ``world.npz``, likewise
model     model files: the schema and the arrays inside, and an answer from what could be read
status    state files that runs write
mesh      files of targets, of every kind, through Blender
========  ==================================================================================
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import atheris
import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[k]) for k in (0, 1)]
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

# numba must see the code that it compiles without instrumentation.
_COMPILED = {path.stem for path in Path(__file__).parents[1].glob("generator/transport/*.py")} - {"store", "world"}
with atheris.instrument_imports(
    include=["generator", "classify", "skops"], exclude=[f"generator.transport.{name}" for name in _COMPILED]
):
    from classify.classifiers import models
    from classify.classifiers.names import ALL
    from classify.inference import atlas_build, atlas_file, posterior
    from classify.pictures import feature_table
    from classify.pictures.sensor import Sensor
    from classify.pictures.settings import FeatureSettings
    from generator.files import exr, limits
    from generator.files.pictures import read_picture
    from generator.files.toml import dump_toml, from_dict, read_toml, to_dict
    from generator.jobs import journal
    from generator.model.errors import NlosError
    from generator.model.poses import pose_columns
    from generator.model.presets import preset
    from generator.model.scene import MESH_SUFFIXES, Scene, Target
    from generator.model.settings import Sweep
    from generator.sets import bulk_set, dataset, plan_file, simulated
    from generator.sets.manifest import MANIFEST, POSES, read_poses
    from generator.transport import world_file as worlds

import hostile  # noqa: E402

_FILE = Path(tempfile.mkdtemp(prefix="nlos-fuzz-")) / "input"
_OUTSIDE = _FILE.parent / "outside"
_SOUND: dict[str, bytes] = {}


def read_exr(data: bytes) -> None:
    """Read a picture."""
    _FILE.write_bytes(data)
    with contextlib.suppress(NlosError):
        read_picture(_FILE)


def try_poses(data: bytes) -> None:
    """Read a manifest of poses."""
    _FILE.write_bytes(data)
    with contextlib.suppress(NlosError):
        read_poses(_FILE)


def try_toml(data: bytes) -> None:
    """Read a scene, a sweep, a sensor and a plan."""
    _FILE.write_bytes(data)
    for kind in (Scene, Sweep, Sensor):
        with contextlib.suppress(NlosError):
            from_dict(kind, read_toml(_FILE))
    with contextlib.suppress(NlosError):
        plan_file.read(_FILE, _FILE)


def read_dataset(data: bytes) -> None:
    """Open a data set, and make all queries of it."""
    folder = _FILE.parent / "set"
    folder.mkdir(exist_ok=True)
    chance = atheris.FuzzedDataProvider(data)
    if chance.ConsumeIntInRange(0, 3):
        spoilt = hostile.spoilt_json(chance, _SOUND["dataset"].decode())
        with contextlib.suppress(Exception):  # not every value can be written as TOML
            (folder / MANIFEST).write_text(dump_toml(json.loads(spoilt)))
    else:
        (folder / MANIFEST).write_bytes(data[1:])
    (folder / POSES).write_bytes(_SOUND["poses"])
    with contextlib.suppress(NlosError):
        opened = dataset.Dataset.open(folder, check=False)  # otherwise the seal would reject nearly every input
        queries: list[Callable[[], object]] = [
            lambda: opened.grid.labels,
            lambda: opened.settings["engine"],
            lambda: (opened.target_kind, opened.reference_radiance, opened.planned, opened.records),
            lambda: opened.ambient_background(),
            lambda: opened.sweep,
            lambda: opened.verify(),
            lambda: journal.words(journal.read(folder)),
        ]
        for query in queries:
            with contextlib.suppress(NlosError):
                query()


def read_features(data: bytes) -> None:
    """Read features."""
    _spoil_hdf5("features", data)
    with contextlib.suppress(NlosError):
        table = feature_table.read(_FILE)
        feature_table.check_comparable(table, table, ("a", "b"))
        table.duplicates  # noqa: B018


def read_atlas(data: bytes) -> None:
    """Read an atlas, and locate an object with it."""
    _spoil_hdf5("atlas", data)
    with contextlib.suppress(NlosError):
        atlas = atlas_file.load(_FILE)
        picture = np.repeat(atlas.background[..., None] * 1.01, 3, axis=2).astype(np.float32)
        with np.errstate(all="ignore"):
            posterior.locate(atlas, atlas.code(picture))


def _spoil_hdf5(kind: str, data: bytes) -> None:
    chance = atheris.FuzzedDataProvider(data)
    if chance.ConsumeIntInRange(0, 3):
        _FILE.write_bytes(hostile.spoilt_hdf5(chance, _SOUND[kind], str(_OUTSIDE)))
    else:
        _FILE.write_bytes(_bytes_changed(chance, _SOUND[kind]))


def _bytes_changed(chance: atheris.FuzzedDataProvider, sound: bytes) -> bytes:
    """Return a sound file with bytes changed or cut off; more often at its head, which holds the structure."""
    blob = bytearray(sound)
    for _ in range(chance.ConsumeIntInRange(1, 8)):
        start = chance.ConsumeIntInRange(0, (len(blob) if chance.ConsumeBool() else min(len(blob), 4096)) - 1)
        replacement = chance.ConsumeBytes(chance.ConsumeIntInRange(1, 8))
        blob[start : start + len(replacement)] = replacement
    return bytes(blob[: chance.ConsumeIntInRange(0, len(blob))] if chance.ConsumeIntInRange(0, 9) == 0 else blob)


def read_bulk(data: bytes) -> None:
    """Open a simulated set, and read all of it."""
    folder = _FILE.parent / "bulk"
    sound = _FILE.parent / "sound-bulk"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(sound, folder)
    chance = atheris.FuzzedDataProvider(data)
    part = next(sound.glob("part-*.h5")).name
    name = hostile.pick(
        chance, [bulk_set.MANIFEST, part, part, bulk_set.MASTER, bulk_set.WORLD, bulk_set.WORLD, bulk_set.BACKGROUND]
    )
    content = (sound / name).read_bytes()
    if name == bulk_set.MANIFEST:
        text = hostile.spoilt_json(chance, json.dumps(read_toml(sound / name)))
        with contextlib.suppress(Exception):  # not every value can be written as TOML
            (folder / name).write_text(dump_toml(json.loads(text)))
    elif name.endswith(".h5") and chance.ConsumeIntInRange(0, 3):
        (folder / name).write_bytes(hostile.spoilt_hdf5(chance, content, str(_OUTSIDE)))
    elif name == bulk_set.WORLD and chance.ConsumeIntInRange(0, 3):
        (folder / name).write_bytes(hostile.spoilt_zip(chance, content, hostile.spoilt_npy))
    else:
        (folder / name).write_bytes(_bytes_changed(chance, content))
    with contextlib.suppress(NlosError):
        worlds.load_world(folder / bulk_set.WORLD)
    with contextlib.suppress(NlosError):
        opened = bulk_set.Bulk.open(folder, check=False)
        try:
            with contextlib.suppress(NlosError):
                opened.verify()
            simulated_set = simulated.SimulatedSet(opened)
            simulated_set.background()
            for record in simulated_set.records[:: max(1, len(simulated_set.records) // 8)]:
                simulated_set.picture(record)
        finally:
            opened.close()


def read_model(data: bytes) -> None:
    """Read a model, and get an answer from it."""
    chance = atheris.FuzzedDataProvider(data)
    sound = _SOUND[hostile.pick(chance, [name for name in sorted(_SOUND) if name.startswith("model-")])]
    if chance.ConsumeIntInRange(0, 7):
        spoilt = hostile.spoilt_zip(chance, sound, _spoilt_member, names=["schema.json"] * 8)
    else:
        spoilt = _bytes_changed(chance, sound)
    _FILE.write_bytes(spoilt)
    with contextlib.suppress(NlosError):
        model = models.load(_FILE)
        model.probabilities(np.full((12, 12, 3), 1e-3, dtype=np.float32))


def _spoilt_member(chance: atheris.FuzzedDataProvider, name: str, data: bytes) -> bytes:
    if name.endswith(".npy"):
        return hostile.spoilt_npy(chance, name, data)
    return hostile.spoilt_json(chance, data.decode(errors="replace")).encode()


def read_status(data: bytes) -> None:
    """Read the state of a set whose runs have written nonsense."""
    folder = _FILE.parent / "set"
    file = folder / journal.RUNS / "host-1.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    (folder / MANIFEST).write_text(dump_toml(json.loads(_SOUND["dataset"])))
    (folder / POSES).write_bytes(_SOUND["poses"])
    chance = atheris.FuzzedDataProvider(data)
    raw = chance.ConsumeIntInRange(0, 3) == 0
    file.write_bytes(data[1:] if raw else hostile.spoilt_json(chance, _SOUND["status"].decode()).encode())
    with contextlib.suppress(NlosError):
        state = journal.read(folder)
        json.dumps(state)
        journal.words(state)


def read_mesh(data: bytes) -> None:
    """Import a mesh as the hidden object."""
    from generator.blender.scene import mesh_file

    kind = hostile.pick(atheris.FuzzedDataProvider(data), MESH_SUFFIXES)
    file = _FILE.with_suffix(kind)
    file.write_bytes(data[1:])
    with contextlib.suppress(NlosError):
        mesh_file.read(Target(kind="mesh", size=0.0, albedo=0.5, mesh=str(file)))


TARGETS = {
    "exr": read_exr,
    "poses": try_poses,
    "toml": try_toml,
    "dataset": read_dataset,
    "features": read_features,
    "atlas": read_atlas,
    "bulk": read_bulk,
    "model": read_model,
    "status": read_status,
    "mesh": read_mesh,
}


def seeds(target: str, folder: Path) -> None:
    """Write sound files as the first inputs."""
    folder.mkdir(parents=True, exist_ok=True)
    text = io.StringIO()
    rows = csv.writer(text)
    rows.writerow(pose_columns([]))
    rows.writerow([0, 0, "A", 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 7, "A/0000.exr", "", "", ""])
    _SOUND["poses"] = text.getvalue().encode()
    if target == "exr":
        picture = np.random.default_rng(0).normal(size=(5, 4)).astype(np.float32)
        exr.write(folder / "seed.exr", dict.fromkeys("RGB", picture), {"nlos:label": "A"})
    elif target == "poses":
        (folder / "seed.csv").write_bytes(_SOUND["poses"])
    elif target == "toml":
        (folder / "scene.toml").write_text(dump_toml(to_dict(preset("room"))))
        (folder / "sweep.toml").write_text(dump_toml(to_dict(Sweep())))
        (folder / "sensor.toml").write_text(dump_toml(to_dict(Sensor())))
    elif target == "mesh":
        _seed_meshes(folder)
    else:
        _seed_structured(target)
        rng = np.random.default_rng(0)
        for k in range(50):  # random bytes that the changes are drawn from, not files to read
            (folder / f"seed-{k}").write_bytes(rng.bytes(200))


def _seed_structured(target: str) -> None:
    """Make the sound files that are changed through their formats' own libraries."""
    sample = {
        "format": 1,
        "fingerprint": "0" * 16,
        "sweep": {**to_dict(Sweep()), "scene_sha256": "0" * 64},
        "scene": to_dict(preset("room")),
        "reference_radiance": 1.0,
        "software": {"blender": "none"},
    }
    _SOUND["dataset"] = json.dumps(sample).encode()
    worker = {"pid": 7, "doing": "A/0000.exr", "seconds": 1.0, "done": 3, "memory": 10**8}
    state = journal.State("host", os.getpid(), done=3, total=9, seconds=2.0, failed=["A/0: it"], workers=[worker])
    _SOUND["status"] = json.dumps(vars(state)).encode()
    if target in ("dataset", "status"):
        return
    import classify_helpers

    if target in ("features", "model"):
        features = feature_table.extract(
            classify_helpers.make_dataset(_FILE.parent / "small", n=4), FeatureSettings()
        )
        feature_table.write(_FILE, features)
        _SOUND["features"] = _FILE.read_bytes()
        for name in ALL if target == "model" else ():
            model = models.train(features, name, "paper")
            if name == "RF":  # a hundred trees take the time of thirty smaller models
                model.estimator[-1].estimators_ = model.estimator[-1].estimators_[:3]
            models.save(_FILE, model)
            _SOUND[f"model-{name}"] = _FILE.read_bytes()
        return
    sample = classify_helpers.make_bulk(_FILE.parent / "sound-bulk", pictures=80, resolution=(8, 8))
    if target == "atlas":
        atlas_file.save(_FILE, atlas_build.build(sample, Sensor(frames=10)))
        _SOUND["atlas"] = _FILE.read_bytes()


def _seed_meshes(folder: Path) -> None:
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    head = ["ply", "format ascii 1.0", "element vertex 3", *(f"property float {a}" for a in "xyz"), "element face 1"]
    head += ["property list uchar int vertex_indices", "end_header"]
    lines = [" ".join(map(str, c)) for c in corners]
    (folder / "a").write_bytes(b"\x01" + "\n".join([*head, *lines, "3 0 1 2", ""]).encode())
    binary = np.array(corners, "<f4").tobytes() + b"\x03" + np.arange(3, dtype="<i4").tobytes()
    text = "\n".join([*head, ""]).replace("ascii", "binary_little_endian").encode()
    (folder / "b").write_bytes(b"\x01" + text + binary)
    text = "".join(f"v {line}\n" for line in lines) + "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\n"
    (folder / "c").write_bytes(b"\x00" + text.encode())
    facet = np.zeros(1, dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    facet["v"] = corners
    (folder / "d").write_bytes(b"\x02" + bytes(80) + np.array([1], "<u4").tobytes() + facet.tobytes())
    text = "solid a\nfacet normal 0 0 1\nouter loop\n" + "".join(f"vertex {line}\n" for line in lines)
    (folder / "e").write_bytes(b"\x02" + (text + "endloop\nendfacet\nendsolid a\n").encode())


def main() -> None:
    """Fuzz one of the readers."""
    target = sys.argv.pop(1) if len(sys.argv) > 1 else ""
    if target not in TARGETS:
        sys.exit(f"usage: {sys.argv[0]} {'|'.join(TARGETS)} [libFuzzer's options]")
    _OUTSIDE.write_bytes(b"none of its business")
    limits.MUCH = hostile.LIMIT
    corpus = _FILE.parent / "corpus"
    seeds(target, corpus)
    flags = ["-timeout=10", "-rss_limit_mb=1024", "-max_len=65536"]
    if target not in ("exr", "poses", "toml", "mesh"):
        flags += ["-reduce_inputs=0", "-len_control=0", "-max_len=400"]  # drawn from: shorter is no better
    atheris.Setup([*sys.argv, *flags, str(corpus)], TARGETS[target])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
