"""Do stated regions hold where the scene is not the one that is stated? Prints and writes a row for each wrong scene.

``python benchmarks/uncertain.py FOLDER -o DIR`` makes, in FOLDER, the scene (a sphere of 30 cm radius in the
corridor, whose corner is matt black), an atlas of it as stated and one with ``--uncertain``, of as many poses; and
for each way in which the true scene may differ a test set, which both atlases answer. A set whose scenes are drawn
from the stated uncertainty is the last row. What is there already is not made again.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
import results

from classify.inference import atlas_build, atlas_file, evaluation
from classify.inference.atlas import Atlas
from classify.pictures.sensor import Sensor
from generator.files.uncertainty_file import write_uncertainty
from generator.model.uncertainty import Uncertainty
from generator.sets.bulk_set import Bulk
from generator.sets.simulated import SimulatedSet

RESULTS = {
    "uncertain": (
        "the truth differs by",
        "frames",
        "atlas",
        "right voxel",
        "within 95 % region",
        "median error",
        "median stated probability, %",
        "misfit warned",
    )
}

LAB = {
    **dict.fromkeys(("spot.aim.x", "spot.aim.z"), 0.02),
    **dict.fromkeys(("camera.view.x", "camera.view.z"), 0.01),
    **dict.fromkeys([f"{part}.location.{axis}" for part in ("spot", "camera") for axis in "xyz"], 0.03),
    **dict.fromkeys(("wall.albedo", "room.albedo"), 0.1),
    "target.albedo": 0.2,
    "target.size": 0.1,
}
"""Standard deviations as a lab would state them."""

ROWS = {
    "nothing": (),
    "target albedo 0.6 for 1.0": ("target.albedo=0.6",),
    "radius +10 %": ("target.size=0.66",),
    "lamp aimed 5 cm aside": ("spot.aim=[0.65, 0.0, 1.5]",),
    "lamp aimed 5 mm aside": ("spot.aim=[0.605, 0.0, 1.5]",),
    "camera's view 2 cm aside": ("camera.x=[-2.38, -0.38]",),
    "room albedo 0.55 for 0.50": ("room.albedo=0.55",),
}
_SCENE = ("target.size=0.6", "room.albedo=0.5", "partition.albedo=0")
_DRAWN = "drawn from what is stated"


def main() -> None:
    """Make what is missing, and answer."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--poses", type=int, default=5000, help="of each atlas")
    parser.add_argument("--count", type=int, default=900, help="pictures of each test set")
    parser.add_argument("--ask", type=int, default=450, help="pictures of each that are answered")
    parser.add_argument("--frames", type=int, nargs="+", default=[1, 10, 100])
    options = parser.parse_args()
    folder = options.folder
    folder.mkdir(parents=True, exist_ok=True)
    stated = folder / "uncertainty.toml"
    write_uncertainty(stated, Uncertainty(names=tuple(LAB), deviation=tuple(LAB.values())))
    known = _set(folder, "known", (), options.poses, seed=0)
    drawn = _set(folder, "drawn", (), options.poses, seed=0, more=("--uncertain", str(stated)))
    tests = {
        name: _set(folder, f"row-{k}", changes, options.count, seed=11)
        for k, (name, changes) in enumerate(ROWS.items())
    }
    tests[_DRAWN] = _set(folder, "row-drawn", (), options.count, seed=13, more=("--uncertain", str(stated)))
    table = []
    for frames in options.frames:
        sensor = Sensor(frames=frames)
        atlases = {"as stated": _atlas(folder, known, sensor), "--uncertain": _atlas(folder, drawn, sensor)}
        for name, bulk in tests.items():
            for kind, atlas in atlases.items():
                row = (name, frames, kind, *_answered(atlas, bulk, options.ask))
                print(*row, sep="; ", flush=True)
                table.append(row)
    results.write(options.output, "uncertain", RESULTS["uncertain"], table)


def _set(
    folder: Path, name: str, changes: tuple[str, ...], count: int, *, seed: int, more: tuple[str, ...] = ()
) -> Bulk:
    """Make a simulated set, or what is missing of it."""
    scene, path = folder / f"{name}.blend", folder / name
    command = [sys.executable, "-m", "generator"]
    if not scene.exists():
        values = [word for value in (*_SCENE, *changes) for word in ("--set", value)]
        subprocess.run([*command, "scene", "corridor", "-o", scene, "--target", "sphere", *values], check=True)
    settings = ("--resolution", "24", "--accuracy", "3e-3", "--inside", "centre", "--no-probe", "--seed", str(seed))
    subprocess.run([*command, "bulk", scene, "-o", path, "--pictures", str(count), *settings, *more], check=True)
    return Bulk.open(path)


def _atlas(folder: Path, bulk: Bulk, sensor: Sensor) -> Atlas:
    path = folder / f"{bulk.path.name}-{sensor.frames}.atlas"
    if not path.exists():
        atlas_file.save(path, atlas_build.build(bulk, sensor))
    return atlas_file.load(path)


def _answered(atlas: Atlas, bulk: Bulk, count: int) -> tuple[str, ...]:
    """Return how good the answers to a test set are, as text."""
    answers = evaluation.run(atlas, SimulatedSet(bulk, count), empty=0)
    *_, (_, _, right, error, held, _) = answers.by_voxel()
    sure = 100.0 * float(np.median([place.voxels.max() for place in answers.places]))
    warnings = ("do not fit", "do not rely", "cannot be relied on")
    doubt = "yes" if any(warning in words for words in answers.doubts for warning in warnings) else "no"
    return right.percent(), held.percent(), error.centimetres(), f"{sure:.0f}", doubt


if __name__ == "__main__":
    main()
