"""Coverage-guided fuzzing of what reads files from elsewhere: pictures, manifests, plans, sensors, scenes as TOML.

Run: ``pip install atheris; python benchmarks/fuzz.py exr|poses|toml [-max_total_time=60]`` (libFuzzer's options).
Anything but a sentence (NlosError) is a find, and so is an input that takes more than 10 s or 1 GiB.
"""

from __future__ import annotations

import contextlib
import csv
import io
import sys
import tempfile
from pathlib import Path

import atheris
import numpy as np

with atheris.instrument_imports(include=["generator"]):
    from generator import dataset, exr, plans, spec
    from generator.sensor import Sensor

_FILE = Path(tempfile.mkdtemp(prefix="nlos-fuzz-")) / "input"


def read_exr(data: bytes) -> None:
    """Read a picture."""
    _FILE.write_bytes(data)
    with contextlib.suppress(spec.NlosError):
        dataset.read_picture(_FILE)


def read_poses(data: bytes) -> None:
    """Read a manifest of poses."""
    _FILE.write_bytes(data)
    with contextlib.suppress(spec.NlosError):
        dataset._read_poses(_FILE)


def read_toml(data: bytes) -> None:
    """Read a scene, a sweep, a sensor and a plan."""
    _FILE.write_bytes(data)
    for kind in (spec.Scene, spec.Sweep, Sensor):
        with contextlib.suppress(spec.NlosError):
            spec.from_dict(kind, spec.read_toml(_FILE))
    with contextlib.suppress(spec.NlosError):
        plans.read(_FILE, _FILE)


TARGETS = {"exr": read_exr, "poses": read_poses, "toml": read_toml}


def seeds(target: str, folder: Path) -> None:
    """Write sound files to begin with."""
    folder.mkdir(parents=True, exist_ok=True)
    if target == "exr":
        picture = np.random.default_rng(0).normal(size=(5, 4)).astype(np.float32)
        exr.write(folder / "seed.exr", dict.fromkeys("RGB", picture), {"nlos:label": "A"})
    elif target == "poses":
        text = io.StringIO()
        rows = csv.writer(text)
        rows.writerow(dataset._COLUMNS)
        rows.writerow([0, 0, "A", 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 7, "A/0000.exr", "", "", ""])
        (folder / "seed.csv").write_text(text.getvalue())
    else:
        (folder / "scene.toml").write_text(spec.dump_toml(spec.to_dict(spec.preset("room"))))
        (folder / "sweep.toml").write_text(spec.dump_toml(spec.to_dict(spec.Sweep())))
        (folder / "sensor.toml").write_text(spec.dump_toml(spec.to_dict(Sensor())))


def main() -> None:
    """Fuzz one of the readers."""
    target = sys.argv.pop(1) if len(sys.argv) > 1 else ""
    if target not in TARGETS:
        sys.exit(f"usage: {sys.argv[0]} {'|'.join(TARGETS)} [libFuzzer's options]")
    corpus = _FILE.parent / "corpus"
    seeds(target, corpus)
    atheris.Setup([*sys.argv, "-timeout=10", "-rss_limit_mb=1024", "-max_len=65536", str(corpus)], TARGETS[target])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
