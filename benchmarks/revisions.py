"""Do two revisions make the same data, to the bit: pictures, features, atlases, models and answers?

``python benchmarks/revisions.py BEFORE -o FOLDER`` checks out the revision BEFORE into FOLDER, runs the same commands
with it and with this tree, and compares their files and output. Then this tree continues and uses files of BEFORE: an
interrupted data set, an atlas and a model. The exit code is 1 if anything differs.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
CHAIN = (
    "generate scene room --target sphere -o room.blend",
    "generate scene tabletop --ambient 0.5 --show -o tabletop.blend",
    "generate sweep room.blend -o surfel --engine surfel --poses 3 --resolution 16 --workers 1 --no-probe",
    "generate sweep room.blend -o patch --engine patch --samples 64 --poses 2 --resolution 8 --workers 2 --no-probe",
    "generate sweep tabletop.blend -o path --engine path --samples 16 --poses 1 --resolution 8 --no-probe",
    "generate trajectory room.blend -o walk --engine surfel --frames 12 --resolution 16 --workers 1 --no-probe",
    "generate bulk room.blend -o bulk --pictures 900 --resolution 16 --workers 2 --no-probe",
    "generate bulk room.blend -o unknown --pictures 90 --unknown --resolution 16 --workers 1 --no-probe",
    "generate verify surfel",
    "generate verify bulk",
    "classify features surfel -o global.h5 --set global",
    "classify features bulk -o hog.h5 --set spatial-hog --frames 100 --sensor default",
    "classify features bulk -o physics.h5 --set physics --frames 100 --sensor default",
    "classify train hog.h5 -o model.skops --classifier SVM",
    "classify compare physics.h5 -o report",
    "classify predict model.skops surfel/A/0000.exr --background surfel/background.exr",
    "generate bulk room.blend -o filled --pictures 450 --inside centre --resolution 16 --workers 2 --no-probe",
    "classify atlas filled -o room.atlas --frames 10",
    "classify locate room.atlas surfel --frames 1",
    "classify detect room.atlas --exposures 1 10 --count 50",
    "classify bound room.atlas filled --frames 1 --count 50",
    "classify track room.atlas walk --frames 10",
)
"""Commands to compare, without the check at the start of sweeps, whose samples depend on the time available."""
LATER = (
    "classify predict model.skops surfel/A/0000.exr --background surfel/background.exr",
    "classify locate room.atlas surfel --frames 1",
    "classify track room.atlas walk --frames 10",
    "generate verify surfel",
    "generate verify bulk",
)
"""Commands that this tree runs on the files that BEFORE has written."""
TIMES = re.compile(r"\d+(?::\d\d)+|[\d.]+(?:e-?\d+)? (?:m?s|min|h|core seconds)\b")
PROGRESS = re.compile(r"^(?:\d+ of \d+ .*|.* is compiled for this machine .*)\n", re.MULTILINE)


def run(tree: Path, folder: Path, line: str) -> str:
    """Run a command with a tree's sources; return its output without times and progress."""
    kind, *words = line.split()
    package = {"generate": "generator", "classify": "classify"}[kind]
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    command = [sys.executable, "-m", f"{package}.cli", *words]
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if result.returncode:
        raise SystemExit(f"{tree}: {line}: code {result.returncode}\n{result.stdout}{result.stderr}")
    return TIMES.sub("(time)", PROGRESS.sub("", result.stdout))


def tables(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the arrays and attributes of an HDF5 file by name, except the versions of software."""
    with h5py.File(path) as file:
        names: list[str] = []
        file.visit(names.append)
        for name in ["/", *names]:
            if isinstance(file[name], h5py.Dataset):
                yield name, file[name][()]
            yield from ((f"{name}@{key}", value) for key, value in file[name].attrs.items() if key != "software")


def differing(one: Path, other: Path) -> Iterator[str]:
    """Yield descriptions of what differs between two folders of results."""
    names = {p.relative_to(f) for f in (one, other) for p in f.rglob("*") if p.is_file() and ".runs" not in p.parts}
    for name in sorted(names):
        a, b = one / name, other / name
        if not (a.exists() and b.exists()):
            yield f"{name}: is in one only"
        elif name.suffix in (".blend", ".txt", ".png", ".html") or name.name in ("dataset.toml", "bulk.toml"):
            continue  # Blender's files hold addresses and logs hold times; `verify` checks the manifests
        elif name.suffix == ".exr":
            from generator.files.pictures import read_picture

            if not np.array_equal(read_picture(a)[0], read_picture(b)[0]):
                yield f"{name}: other pixels"
        elif name.suffix in (".h5", ".atlas"):
            first, second = dict(tables(a)), dict(tables(b))
            if set(first) != set(second) or not all(np.array_equal(first[k], second[k]) for k in first):
                keys = [k for k in first.keys() | second.keys() if not np.array_equal(first.get(k), second.get(k))]
                yield f"{name}: other {', '.join(sorted(keys)[:5])}"
        elif name.suffix == ".csv" and untimed(a) != untimed(b):
            yield f"{name}: other rows"


def untimed(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table, without the columns of durations."""
    with path.open(newline="", encoding="utf-8") as file:
        return [{k: v for k, v in row.items() if "second" not in k} for row in csv.DictReader(file)]


def main() -> int:
    """Compare this tree with a revision."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("before", help="revision to compare with")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the results; must be new")
    options = parser.parse_args()
    options.output.mkdir(parents=True)
    output = options.output.resolve()
    tree = output / "tree"
    subprocess.run(["git", "worktree", "add", "--detach", "--quiet", tree, options.before], cwd=ROOT, check=True)
    try:
        return _compare(tree, output)
    finally:
        subprocess.run(["git", "worktree", "remove", "--force", tree], cwd=ROOT, check=True)


def _compare(tree: Path, output: Path) -> int:
    faults = []
    for name in ("before", "after"):
        (output / name).mkdir()
    for line in CHAIN:
        printed = [run(t, output / name, line) for t, name in ((tree, "before"), (ROOT, "after"))]
        same = printed[0] == printed[1]
        print(f"{'same' if same else 'DIFFERS'}: {line}", flush=True)
        faults += [] if same else [line]
        for scene in (output / "before").glob("*.blend"):  # one for both: Blender's files differ from save to save,
            shutil.copy(scene, output / "after")  # and a sensor's noise follows from the data set
        if not same:
            print("--- before\n" + printed[0] + "--- after\n" + printed[1], flush=True)
    faults += (differences := list(differing(output / "before", output / "after")))
    print("\n".join(differences) or "same: every picture, table, atlas and model")
    later = output / "later"
    shutil.copytree(output / "before", later)
    for line in LATER:
        same = run(tree, output / "before", line) == run(ROOT, later, line)
        print(f"{'same' if same else 'DIFFERS'}: {line}, of what the revision before has left", flush=True)
        faults += [] if same else [line]
    for picture in sorted((later / "patch").glob("?/*.exr"))[::2]:
        picture.unlink()
    run(ROOT, later, "generate sweep room.blend -o patch --no-probe")
    faults += (differences := list(differing(output / "before" / "patch", later / "patch")))
    print("\n".join(differences) or "same: half of a data set of the revision before, rendered by this one")
    print(f"{len(faults)} differ")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
