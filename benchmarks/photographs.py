"""Pictures by Cycles, seen by a camera, imported and answered: what is lost on the way.

Run: ``python benchmarks/photographs.py -o DIR`` (half an hour, most of it the simulated set). A room with twelve
reflections is rendered by Cycles, finer than the atlas' pictures. A camera (``tests/support/wall_camera.py``) takes
it: perspective, vignetting, black level, noise, rounding. `nlos-classify import` gets its files and four corners.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import results

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "support"))
import wall_camera

from classify.cli.main import main as classify
from classify.inference import atlas_build, photographs
from classify.inference.atlas import Atlas
from classify.inference.posterior import holds, locate
from classify.intervals import wilson
from classify.pictures import arrivals
from classify.pictures.frames import read as frames_of
from classify.pictures.recipe import FILE, Recipe
from classify.pictures.sensor import Sensor
from classify.pictures.taken import Taken
from generator.sets.bulk_set import Bulk
from generator.sets.dataset import Dataset
from generator.sets.simulated import open_set

ROOT = Path(__file__).resolve().parents[1]
FINER = 4
CORNERS = np.array([(62.7, 44.3), (340.4, 60.9), (353.6, 316.6), (45.0, 299.4)])
SHAPE = (360, 400)
APART = 7.81
"""Of chi-squared with three degrees of freedom, exceeded once in twenty."""
BRIGHTEST = 250.0
"""Electrons that the brightest pixel of the camera is expected to collect; 130 of them make one of the scene's."""
BACKGROUNDS = 50
CAMERAS = {
    "16-bit PNG": {"top": 65535, "electrons": 0.5, "black": 512.0},
    "8-bit PNG": {"top": 255, "electrons": 1.6, "black": 9.0},
}
RESULTS = {
    "photographs": (
        "camera",
        "frames",
        "pictures",
        "pixel error",
        "of it the same in all",
        "right voxel, without camera (%)",
        "right voxel (%)",
        "truth in 95 % region, without camera (%)",
        "truth in 95 % region (%)",
        "places apart",
    ),
    "photographs-live": (
        "frame (pixels)",
        "file (MB)",
        "read and corrected (ms)",
        "answered (ms)",
        "frames a second of one core",
    ),
}
LIVE = 200


def generate(*words: object) -> None:
    """Run ``nlos-generate`` in a process of its own."""
    subprocess.run([sys.executable, "-m", "generator", *map(str, words)], check=True, cwd=ROOT)


def smooth(picture: np.ndarray) -> np.ndarray:
    """Light of the wall, (height, width): what Cycles leaves of noise is no pattern on it, and is smoothed away."""
    return cv2.GaussianBlur(picture.mean(axis=2, dtype=np.float64), (0, 0), FINER / 2, borderType=cv2.BORDER_REFLECT)


def smaller(picture: np.ndarray) -> np.ndarray:
    """Means over blocks of pixels of that light."""
    grey = smooth(picture)
    height, width = grey.shape
    return grey.reshape(height // FINER, FINER, width // FINER, FINER).mean(axis=(1, 3))


def rows(folder: Path, atlas: Atlas, cycles: Path, pixels: int) -> list[tuple[object, ...]]:
    """Return the table's rows; the camera's files go into a folder."""
    rendered = Dataset.open(cycles)
    empty = smooth(rendered.background())
    light = [smooth(rendered.picture(record)) for record in rendered.records]
    table = []
    for name, kind in CAMERAS.items():
        camera = wall_camera.Camera(CORNERS, SHAPE, **kind)
        camera.exposure = BRIGHTEST / max(map(np.max, light))
        for frames in (1, 3):
            files = folder / f"{name.partition('-')[0]}-{frames}"
            taken(files, camera, empty, light, rendered, frames)
            given = [f"{files}/shots", "--background", f"{files}/empty", "--dark", f"{files}/dark"]
            given += ["--flat", f"{files}/flat", "--like", str(cycles), "--resolution", str(pixels)]
            given += [
                "--corners",
                *map(str, CORNERS.ravel()),
                "--labels",
                f"{files}/labels.csv",
                "--burst",
                str(frames),
            ]
            given += [
                "--electrons",
                str(camera.electrons),
                "--read-noise",
                str(camera.read_noise),
                "-o",
                f"{files}/set",
            ]
            if classify(["import", *given]):
                raise SystemExit(1)
            table.append((name, frames, len(light), *compared(files / "set", atlas, rendered)))
            print(*table[-1], sep=", ", flush=True)
    return table


def taken(
    files: Path,
    camera: wall_camera.Camera,
    empty: np.ndarray,
    light: list[np.ndarray],
    rendered: Dataset,
    frames: int,
) -> None:
    """Take all pictures that a camera has to take."""
    rng = np.random.default_rng(frames)
    camera.take(files / "empty", camera.light(empty), rng, BACKGROUNDS)
    camera.take(files / "dark", np.zeros(camera.shape), rng, BACKGROUNDS)
    camera.take(files / "flat", camera.light(np.full_like(empty, max(map(np.max, light)))), rng, BACKGROUNDS)
    lines = ["file,x,y,z"]
    for number, (record, picture) in enumerate(zip(rendered.records, light, strict=True)):
        for path in camera.take(files / "shots" / f"{number:03d}", camera.light(picture), rng, frames):
            lines.append(f"{number:03d}/{path.name},{','.join(map(str, record.position))}")
    (files / "labels.csv").write_text("\n".join(lines))


def compared(path: Path, atlas: Atlas, rendered: Dataset) -> tuple[object, ...]:
    """Return how an imported set differs from the rendered one."""
    made = open_set(path)
    seen = Taken(made, atlas.background)
    ours = atlas.seen_by(seen.sensor)
    level = float(
        (smaller(rendered.background()) * atlas.background).sum() / (smaller(rendered.background()) ** 2).sum()
    )
    spread = np.sqrt(seen.sensor.variance(seen.background()))
    clean_empty = np.repeat(level * smaller(rendered.background())[..., None], 3, axis=2)
    errors, places, wanted, rng = [], [], [], np.random.default_rng(9)
    for record, source in zip(made.records, rendered.records, strict=True):
        picture = seen.picture(record)
        clean = np.repeat(level * smaller(rendered.picture(source))[..., None], 3, axis=2)
        errors.append((picture - clean)[..., 0] / spread)
        places.append(locate(ours, ours.code(picture, seen.background())))
        wanted.append(locate(ours, ours.code(seen.sensor.measure(clean.astype(np.float32), rng), clean_empty)))
    truth = [record.position for record in rendered.records]
    voxels = np.array([record.voxel for record in rendered.records])

    def right(found: list) -> float:
        return 100.0 * float(np.mean(np.array([place.voxels.argmax() for place in found]) == voxels))

    def inside(found: list) -> str:
        held = wilson(sum(holds(place, t) for place, t in zip(found, truth, strict=True)), len(truth))
        return held.percent().replace(" %", "")

    apart = 0
    for place, other in zip(places, wanted, strict=True):
        offset = place.position - other.position
        apart += float(offset @ np.linalg.pinv(place.covariance + other.covariance) @ offset) > APART
    return (
        f"{np.std(errors):.2f}",
        f"{np.mean(errors, axis=0).std():.2f}",
        f"{right(wanted):.0f}",
        f"{right(places):.0f}",
        inside(wanted),
        inside(places),
        apart,
    )


def live(folder: Path, atlas: Atlas, path: Path, cycles: Path) -> list[tuple[object, ...]]:
    """Return how long frames of several sizes take that come into a folder."""
    made, rendered, table = open_set(path), Dataset.open(cycles), []
    picture = smooth(rendered.picture(rendered.records[0]))
    for times in (1, 3):
        shape, corners = tuple(times * size for size in SHAPE), times * (CORNERS + 0.5) - 0.5
        camera = wall_camera.Camera(corners, shape, **CAMERAS["16-bit PNG"])
        camera.exposure = BRIGHTEST / picture.max()
        light, rng = camera.light(picture), np.random.default_rng(0)
        frames = [file.read_bytes() for file in camera.take(folder / f"source-{times}", light, rng, 10)]
        empty = camera.light(smooth(rendered.background()))
        camera.take(folder / f"empty-{times}", empty, rng, 10)
        given = [f"{folder}/source-{times}", "--background", f"{folder}/empty-{times}", "--like", str(cycles)]
        given += ["--resolution", str(made.picture(made.records[0]).shape[1]), "--black", str(camera.black)]
        given += ["--electrons", str(camera.electrons), "--corners", *map(str, corners.ravel())]
        if classify(["import", *given, "-o", f"{folder}/set-{times}"]):
            raise SystemExit(1)
        table.append((f"{shape[1]} x {shape[0]}", *_timed(folder, atlas, folder / f"set-{times}", frames)))
        print(*table[-1], sep=", ", flush=True)
    return table


def _timed(folder: Path, atlas: Atlas, path: Path, frames: list[bytes]) -> tuple[object, ...]:
    """Answer frames that lie in a folder, in one thread, and measure its processor time."""
    watched = folder / f"{path.name}-watched"
    watched.mkdir()
    for number in range(LIVE):
        (watched / f"{number}.png").write_bytes(frames[number % len(frames)])
    given = open_set(path), Recipe.load(path / FILE)
    told: list[float] = []
    photographs.live(
        atlas, *given, arrivals.come(watched, 0.2), told=lambda name, found: told.append(time.thread_time())
    )
    each = 1000.0 * (told[-1] - told[0]) / (LIVE - 1)
    reading = time.thread_time()
    for number in range(LIVE):
        given[1](list(frames_of(watched / f"{number}.png")))
    reading = 1000.0 * (time.thread_time() - reading) / LIVE
    return f"{len(frames[0]) / 1e6:.1f}", f"{reading:.1f}", f"{each - reading:.1f}", f"{1000.0 / each:.0f}"


def main() -> None:
    """Make the sets, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the table, and for all files")
    parser.add_argument("--atlas", type=int, default=3600, help="simulated pictures")
    parser.add_argument("--poses", type=int, default=2, help="pictures by Cycles, a voxel")
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--pixels", type=int, default=24)
    options = parser.parse_args()
    folder = options.output.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    scene, pixels = folder / "room.blend", options.pixels
    if not scene.exists():
        generate("scene", "room", "--target", "sphere", "--set", "reflection_order=12", "-o", scene)
    generate(
        *("bulk", scene, "-o", folder / "bulk", "--pictures", options.atlas, "--resolution", pixels),
        *("--accuracy", "1e-2", "--inside", "centre"),
    )
    generate(
        *("sweep", scene, "-o", folder / "cycles", "--engine", "patch", "--poses", options.poses, "--seed", 5),
        *("--samples", options.samples, "--resolution", FINER * pixels, "--inside", "centre", "--no-probe"),
    )
    atlas = atlas_build.build(Bulk.open(folder / "bulk"), Sensor(full_well=1e6, bits=0, read_noise=20.0, frames=10))
    with tempfile.TemporaryDirectory(dir=folder) as files:
        table = rows(Path(files), atlas, folder / "cycles", pixels)
        results.write(options.output, "photographs", RESULTS["photographs"], table)
        timed = live(Path(files), atlas, Path(files, "16-1", "set"), folder / "cycles")
        results.write(options.output, "photographs-live", RESULTS["photographs-live"], timed)


if __name__ == "__main__":
    main()
