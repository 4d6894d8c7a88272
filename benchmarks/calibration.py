"""Calibration of rooms that are off by what a laboratory does not know: errors beside the deviations that it states.

``python benchmarks/calibration.py --rooms 50 -o DIR``: rooms of random sizes, each off by draws of `BEFORE` from what
the fit is given. The truth is rendered by the engine at a tenth of the fit's error, seen by the default sensor: one
background and three pictures of a sphere at places measured to a centimetre, 100 frames each.
"""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import results
from scipy.stats import kstest

from classify.calibration.fit import Calibration, fit
from classify.calibration.predicted import Placed, Predicted
from classify.pictures.sensor import Sensor
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.scene import Camera, Partition, Room, Scene, Spot, Target, Wall
from generator.transport import Transport, World
from generator.transport.parameters import OFFSETS, with_parameters

RESULTS = {
    "calibration": (
        "value",
        "deviation before",
        "deviation stated (median)",
        "error (rms)",
        "mean of z",
        "standard deviation of z",
        "p (Kolmogorov and Smirnov)",
    ),
    "calibration-fits": (
        "rooms",
        "fitted to",
        "noise by the verdict",
        "p of all verdicts (Kolmogorov and Smirnov)",
        "variance left (median)",
        "slopes computed",
        "seconds (median)",
    ),
}
BEFORE = {
    **{f"spot.location.{axis}": 0.03 for axis in "xyz"},
    **{f"spot.aim.{axis}": 0.02 for axis in "xz"},
    "spot.half_angle": 0.05,
    "spot.power": 0.1,
    **{f"camera.view.{axis}": 0.01 for axis in "xz"},
    "wall.albedo": 0.1,
    "room.albedo": 0.1,
    "target.albedo": 0.2,
    "target.size": 0.1,
    "black": 0.005,
    "vignetting": 0.05,
    **{f"place.{k}.{axis}": 0.01 for k in (1, 2, 3) for axis in "xyz"},
}
"""Standard deviations of what is off, in the units of `OFFSETS`."""

_FRAMES = 100


def room(seed: int) -> World:
    """Return a random room of the shape of the preset ``room``, with a sphere."""
    import generator  # processes that are started from one with Blender cannot load it again
    from generator.blender.engines import survey

    rng = np.random.default_rng([seed, 25])
    x, y = (-rng.uniform(2.0, 3.0), rng.uniform(2.4, 3.2)), (0.0, rng.uniform(3.2, 4.5))
    z = (0.0, rng.uniform(2.4, 3.0))
    left = rng.uniform(-1.0, -0.9)
    aim = (rng.uniform(0.15, 0.35), 0.0, rng.uniform(1.1, 1.5))
    scene = Scene(
        preset="custom",
        wall=Wall(x=x, z=z, albedo=rng.uniform(0.55, 0.75)),
        room=Room(x=x, y=y, z=z, albedo=rng.uniform(0.4, 0.7)),
        partition=Partition(x=0.0, y=(1.5, y[1]), z=z),
        spot=Spot(
            location=(rng.uniform(-1.4, -1.0), y[1] - 0.3, rng.uniform(1.4, 2.0)),
            aim=aim,
            half_angle=rng.uniform(1.0, 1.8),
        ),
        camera=Camera(location=(-1.1, y[1] - 0.3, 1.4), x=(left, left + 0.9), z=(0.8, 1.7)),
        grid=VoxelGrid(lo=(0.8, 0.5, 0.5), hi=(2.2, 1.9, 2.0)),
        target=Target(kind="sphere", size=rng.uniform(0.3, 0.5), albedo=rng.uniform(0.4, 0.7)),
        resolution=(24, 24),
    )
    return survey.surfel_world(generator.new_scene(scene))


class Case:
    """A room as it is thought to be, and what is measured of the one that is.

    Attributes
    ----------
    world : World
    places : list of Placed
    off : dict of str to float
        By how much the truth differs.
    measured : ndarray of shape (4, height, width)
    """

    def __init__(self, seed: int, world: World, accuracy: float, order: int = 3) -> None:
        rng = np.random.default_rng([seed, 26])
        self.world = world
        self.places = [Placed(tuple(rng.uniform((0.9, 0.6, 0.6), (2.0, 1.8, 1.9)))) for _ in range(3)]
        while True:
            self.off = {name: deviation * rng.normal() for name, deviation in BEFORE.items()}
            try:
                truth = with_parameters(self.world, {n: v for n, v in self.off.items() if n in OFFSETS})
                break
            except NlosError:  # an albedo above 1
                continue
        finer = accuracy / 10.0 if order == 3 else accuracy
        engine = Transport(replace(truth, order=order), accuracy=finer)
        empty = engine.background()
        pictures = [empty]
        for k, place in enumerate(self.places, start=1):
            moved = [p + self.off[f"place.{k}.{axis}"] for p, axis in zip(place.position, "xyz", strict=True)]
            pictures.append(empty + engine.difference(moved, place.rotation))
        self._seen(rng, np.stack(pictures).mean(axis=3))

    def _seen(self, rng: np.random.Generator, clean: np.ndarray) -> None:
        """Measure clean pictures (4, height, width)."""
        height, width = clean.shape[1:]
        u, v = np.meshgrid(np.arange(width) - (width - 1) / 2.0, np.arange(height) - (height - 1) / 2.0)
        shade = 1.0 - self.off["vignetting"] * (u**2 + v**2) / (0.25 * (width**2 + height**2))
        shaded = [np.repeat((shade * picture)[..., None], 3, axis=2) for picture in clean]
        self.sensor = Sensor(frames=_FRAMES).exposed(shaded)
        black = self.off["black"] * float(Transport(self.world, accuracy=1e-3).background().mean())
        self.measured = np.stack([self.sensor.measure(one, rng).mean(axis=2) for one in shaded]).astype(float) + black

    def variance(self, pictures: np.ndarray) -> np.ndarray:
        """Variance of the noise of expected pictures (4, height, width)."""
        return np.stack([self.sensor.variance(np.repeat(one[..., None], 3, axis=2)) for one in pictures])

    def fitted(self, accuracy: float) -> tuple[Calibration, float]:
        """Fit the room; return also how many seconds that took."""
        start = time.perf_counter()
        found = fit(Predicted(self.world, self.places, accuracy=accuracy), self.measured, self.variance, BEFORE)
        return found, time.perf_counter() - start


def calibrated(case: tuple[int, World, float, int]) -> tuple[dict[str, float], Calibration, float]:
    """Fit the room of a seed, a world, an accuracy and reflections; return also what is off, and the seconds."""
    room_of = Case(*case)
    found, took = room_of.fitted(case[2])
    print(f"room {case[0]}: {took:.1f} s, {found.steps} slopes, p {found.verdict.p:.3g}", flush=True)
    return room_of.off, found, took


def main() -> None:
    """Calibrate rooms, and write the two tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=50)
    parser.add_argument("--accuracy", type=float, default=1e-3, help="of the fit's engine; a tenth for truth")
    parser.add_argument("--unmodelled", type=int, default=5, help="rooms of all reflections, fitted with three")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=600.0, help="after which no more rooms are waited for")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    options = parser.parse_args()
    fits, seconds, z = [], [], {name: [] for name in BEFORE}
    errors: dict[str, list[float]] = {name: [] for name in BEFORE}
    seeds = [(seed, 3) for seed in range(options.rooms)] + [(1000 + k, 12) for k in range(options.unmodelled)]
    # All of them first: while Blender opens a file, it has its own module __main__, and nothing can be pickled.
    cases = [(seed, room(seed), options.accuracy, order) for seed, order in seeds]
    until, made = time.monotonic() + 60.0 * options.minutes, []
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        for future in [pool.submit(calibrated, case) for case in cases]:
            try:
                made.append(future.result(timeout=max(0.0, until - time.monotonic())))
            except TimeoutError:
                pool.shutdown(wait=False, cancel_futures=True)
                break
    right, wrong = made[: options.rooms], made[options.rooms :]
    for off, found, took in right:
        fits.append(found)
        seconds.append(took)
        for name, deviation in zip(found.names, found.deviations, strict=True):
            errors[name].append(found.value(name) - off[name])
            z[name].append(errors[name][-1] / deviation)
    rows = []
    for number, name in enumerate(BEFORE):
        stated = float(np.median([found.deviations[number] for found in fits]))
        rms = float(np.sqrt(np.mean(np.square(errors[name]))))
        rows.append([name, f"{BEFORE[name]:g}", f"{stated:.2g}", f"{rms:.2g}", *_shape(z[name])])
    rows.append(["all", "", "", "", *_shape([value for values in z.values() for value in values])])
    results.write(options.output, "calibration", RESULTS["calibration"], rows)
    told = [_told("three reflections", fits, seconds)]
    if wrong:
        told.append(_told("twelve reflections", [found for _, found, _ in wrong], [took for *_, took in wrong]))
    results.write(options.output, "calibration-fits", RESULTS["calibration-fits"], told)


def _shape(z: list[float]) -> list[str]:
    values = np.array(z)
    return [f"{values.mean():+.2f}", f"{values.std(ddof=1):.2f}", f"{kstest(values, 'norm').pvalue:.2g}"]


def _told(what: str, fits: list[Calibration], seconds: list[float]) -> list[object]:
    verdicts = [found.verdict for found in fits]
    p = [one for v in verdicts for one in (v.p_chi_squared, v.p_neighbours, v.p_blocks)]
    left = float(np.median([v.chi_squared / v.freedom for v in verdicts]))
    steps = float(np.mean([found.steps for found in fits]))
    noise = sum(v.is_noise for v in verdicts)
    uniform, times = f"{kstest(p, 'uniform').pvalue:.2g}", f"{np.median(seconds):.0f}"
    return [len(fits), what, f"{noise} of {len(fits)}", uniform, f"{left:.3f}", f"{steps:.1f}", times]


if __name__ == "__main__":
    main()
