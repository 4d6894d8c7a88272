"""The check at the start of a sweep: does the chosen engine render the file as plain Cycles does?

Both render one pose. The reference is `plain_cycles.Plain`. The engine's pictures are a data set of that pose in a
temporary folder, made as the sweep would make it.

Plain Cycles finds the small lit patch only by chance, so it is noisy. More of its paths find a wider patch, so both
render the scene a second time with the spot's cone as wide as the scene allows.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from generator.blender.plain_cycles import SIDE, WIDEST, Plain, player_of, widen
from generator.blender.scene import blend_file
from generator.files.toml import from_dict, to_dict
from generator.measure import agreement
from generator.measure.agreement import Figure
from generator.model import poses
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.model.quantities import radiance
from generator.model.settings import BACKGROUND_FACTOR, Sweep
from generator.sets.dataset import Dataset

LIMITS = (2.0, 10.0, 60.0)
"""Most seconds of the check: always granted; up to the sweep's own time; up to `_SHARE` of the sweep's time."""
_SHARE = 0.05

PRECISE = (0.01, 0.05)
"""Relative standard errors of the background and of the target's change below which the comparison ends."""

TOLERANCES = (0.02, 0.05)
"""Relative differences from Cycles that are allowed in these two: more than the 1 % to which engines agree."""
_AMBIENT, _LEFT_OUT = 0.1, 0.5
"""Allowed in addition: in both for `surfel` under ambient light; in each one if the sweep leaves something out."""

_SAME = {"cpu": 1e-3, "gpu": 3e-2}
"""Relative change that rounding may make to `path` with the same random numbers. A GPU rounds differently."""

_COPIES, _SAMPLES = 8, 64
"""Number of pictures of the pose by `patch`, and samples of each; the background has 16 times as many."""
_PATH_SAMPLES = 16
_FIRST, _MOST = 256, 2**16
"""Samples of the first picture by plain Cycles, and most samples of any."""
_ROUNDS = 12
"""Number of rounds into which the time is divided."""

_VAGUE = 1.0
"""Relative half width of an interval beyond which a figure is not reported."""

Found = tuple[list[Figure], float]
"""Figures of a view, and the full angle of its spot, radians, or 0 for the angle in the file."""

Draw = Callable[[bpy.types.Scene, Dataset, Sequence[Mapping[int, int]]], None]
"""Renders poses of a data set: `generator.blender.sweep_worker.render`."""


@dataclass
class _View:
    """The scene with one width of the spot: pictures by both renderers.

    Attributes
    ----------
    width : float
        Full angle of the spot, radians; 0 keeps the angle in the file.
    engine : ndarray of shape (1 or 2, height, width, 3)
        Background and change by the target, W/m^2/sr.
    peak : float
        Highest radiance of the directly lit wall, W/m^2/sr.
    dark : ndarray of shape (height, width, 1)
        Mask that the pictures are multiplied by: a widened spot may light what the camera sees, many times brighter
        than the rest, and the edge of that light would dominate the noise.
    """

    width: float
    engine: Array
    peak: float
    dark: Array | float = 1.0
    total: Array = field(init=False)
    samples: int = 0

    def __post_init__(self) -> None:
        self.engine = self.engine * self.dark
        self.total = np.zeros_like(self.engine)

    def add(self, pictures: Array, samples: int) -> None:
        self.total += samples * pictures * self.dark
        self.samples += samples

    def figures(self, tolerances: Sequence[float]) -> list[Figure]:
        return agreement.compare(
            self.total / self.samples, self.engine, samples=self.samples, peak=self.peak, tolerances=tolerances
        )


def run(
    stored: Path,
    source: Path,
    known: Collection[Path],
    meta: Mapping[str, Any],
    pose: PoseRecord,
    pictures: int,
    draw: Draw,
) -> dict[str, Any]:
    """Render a pose by plain Cycles and by a sweep's engine, and say how well they agree.

    Parameters
    ----------
    stored : Path
        Scene file of the data set; afterwards another file is open.
    source : Path
        File that plain Cycles renders.
    known : collection of Path
        Files elsewhere that both scene files may refer to.
    meta : mapping
        Manifest of the data set.
    pose : PoseRecord
    pictures : int
        Number of pictures of the whole sweep, which limits the time of the check.
    draw : callable
        Renders poses of a data set; see `Draw`.

    Returns
    -------
    dict
        Entry of the manifest: both numbers, their intervals, the time, and a line for people.

    Raises
    ------
    NlosError
        The two differ by more than their noise.
    """
    start = time.perf_counter()
    sweep: Sweep = from_dict(Sweep, {k: v for k, v in meta["sweep"].items() if k in _FIELDS}, "")
    sweep, pose = replace(sweep, vary=(), targets=1), replace(pose, values=(), others=())  # of the file itself
    check = _Check(stored, source, known, meta, sweep, pose, draw)
    compared = check.exact() if sweep.engine == "path" else check.noisy(pictures)
    for figures, width in compared:
        if (worst := agreement.worst(figures)).differs:
            raise NlosError(_complaint(source, check, worst, width))
    seconds = time.perf_counter() - start
    (first, _), (last, width) = compared[0], compared[-1]
    return {
        "words": _words(check, (first[0], last[1]), width, seconds),
        "seconds": round(seconds, 2),
        "voxel": pose.label,
        **{name: _numbers(figure) for name, figure in (("background", first[0]), ("difference", last[1]))},
        **({"spot_angle": round(math.degrees(width), 3)} if width else {}),
    }


_FIELDS = frozenset(Sweep.__dataclass_fields__)


@dataclass
class _Check:
    stored: Path
    source: Path
    known: Collection[Path]
    meta: Mapping[str, Any]
    sweep: Sweep
    pose: PoseRecord
    draw: Draw

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures: the sweep's, scaled down."""
        width, height = self.sweep.resolution
        factor = SIDE / max(width, height)
        return max(1, round(width * factor)), max(1, round(height * factor))

    def plain(self) -> Plain:
        return Plain(blend_file.open_file(self.source, self.known), self.pose, self.size)

    def noisy(self, pictures: int) -> list[Found]:
        """Compare with an engine whose noise is independent: in the scene as it is, and with a wider spot."""
        widths = self.plain().widths()
        views, seconds = self._by_engine(widths)
        limit = self._limit(pictures * seconds)
        plain, start = self.plain(), time.perf_counter()
        narrow = plain.spot.data.spot_size if widths else 0.0
        samples, number = _FIRST, 0
        while True:
            for view in views:
                if widths:
                    plain.spot.data.spot_size = view.width or narrow
                seed = poses.noise_seed(self.sweep.seed, -1 - number)
                number += 1
                background = plain.render(samples, seed, target=False)
                change = [plain.render(samples, seed) - background] if len(view.engine) > 1 else []
                view.add(np.array([background, *change]), samples)
            compared = [(view.figures(self.tolerances), view.width) for view in views]
            elapsed = time.perf_counter() - start
            round_time = elapsed / views[0].samples * samples
            if any(agreement.worst(figures).differs for figures, _ in compared) or elapsed + round_time > limit:
                return compared
            if all(f.precision < precise for f, precise in zip(compared[-1][0][:2], PRECISE, strict=True)):
                return compared
            samples = int(min(max(samples * limit / _ROUNDS / round_time, _FIRST), _MOST))

    def _by_engine(self, widths: Mapping[float, Array]) -> tuple[list[_View], float]:
        """Return the engine's views of the scene, as it is and with a wider spot, and the seconds of a picture."""
        scene = blend_file.open_file(self.stored, self.known)
        pictures, seconds = self._drawn(scene)
        views = [_View(0.0, pictures, self._peak(wide=False))]
        spot = player_of(scene, "spot").data
        narrow = spot.spot_size if widths else 0.0
        for width, dark in widths.items():
            spot.spot_size = width
            with contextlib.suppress(NlosError):  # too wide for the engine; try the next angle
                pictures, wide_seconds = self._drawn(scene)
                views.append(_View(width, pictures, self._peak(wide=True), dark))
                seconds = min(seconds, wide_seconds)  # the first time may include one-off work, as compiling
                break
        if widths:
            spot.spot_size = narrow
        if len(views) > 1:
            views[0].engine = views[0].engine[:1]  # the wide view measures the target's change in less time
            views[0].total = views[0].total[:1]
        ratio = math.prod(self.sweep.resolution) / math.prod(self.size)
        return views, seconds * ratio * (1.0 if self.sweep.engine == "surfel" else self.sweep.samples / _SAMPLES)

    def _limit(self, seconds: float) -> float:
        """Return how many seconds plain Cycles may take, from those that the sweep takes."""
        short, middle, longest = LIMITS
        return max(short, min(middle, seconds), min(longest, _SHARE * seconds))

    def _peak(self, *, wide: bool) -> float:
        """Return the highest radiance of the directly lit wall: where the lamp aims, or nearest to a wide cone."""
        spot, wall = (self.meta["scene"][name] for name in ("spot", "wall"))
        distance = abs(spot["location"][1]) if wide else math.dist(spot["location"], spot["aim"])
        return float((wall.get("albedo") or 1.0) * spot["power"]) / (4.0 * math.pi**2 * max(distance, 1e-30) ** 2)

    @property
    def tolerances(self) -> tuple[float, float]:
        """Relative errors, of background and change, that the engine and its settings are documented to have."""
        background, change = TOLERANCES
        if self.sweep.engine == "surfel":
            background, change = background + 2.0 * self.sweep.accuracy, change + 2.0 * self.sweep.accuracy
            if float(self.meta["scene"].get("ambient", 0.0)) > 0.0:
                background, change = background + _AMBIENT, change + _AMBIENT
        if self.sweep.leave_out:
            background, change = background + _AMBIENT, change + _LEFT_OUT
        return background, change

    def _drawn(self, scene: bpy.types.Scene) -> tuple[Array, float]:
        """Return background and difference (2, height, width, 3) of a data set of the pose, and seconds a picture."""
        sweep = self.sweep
        copies, samples = (_COPIES, _SAMPLES) if sweep.engine == "patch" else (1, _PATH_SAMPLES)
        small = replace(sweep, resolution=self.size, samples=samples, denoise=False, poses=copies, frames=0)
        settings = {k: v for k, v in to_dict(small).items() if k not in small.unused}
        meta = {**self.meta, "sweep": {**settings, "scene_sha256": self.meta["sweep"]["scene_sha256"]}}
        records = [replace(self.pose, index=k, seed=self._seed(k), file=f"{k:04d}.exr") for k in range(copies)]
        with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
            dataset = Dataset.create(Path(folder) / "set", meta, records)
            self.draw(scene, dataset, [{k: 0} for k in range(copies)])
            dataset.gather()
            background = dataset.background().astype(np.float64)
            mean = np.mean([dataset.picture(pose).astype(np.float64) for pose in dataset.poses], axis=0)
        return np.array([background, mean - background]), float(np.mean([pose.seconds for pose in dataset.poses]))

    def _seed(self, copy: int) -> int:
        return poses.noise_seed(self.sweep.seed, 1 + copy)

    def path_agrees(self) -> bool:
        """Whether `path` renders the same as plain Cycles."""
        try:
            by_path = replace(self, sweep=replace(self.sweep, engine="path", leave_out=()))
            return not any(agreement.worst(figures).differs for figures, _ in by_path.exact())
        except NlosError:
            return False

    def exact(self) -> list[Found]:
        """Compare `path`, which is Cycles too: with the same random numbers its pictures are the same.

        With the file's own spot few paths find light; a wide spot lights the whole wall.
        """
        return [self._exactly(width) for width in (0.0, 2.0 * WIDEST)]

    def _exactly(self, width: float) -> Found:
        scene = blend_file.open_file(self.stored, self.known)
        widen(player_of(scene, "spot"), width)
        engine, _ = self._drawn(scene)
        plain = self.plain()
        widen(plain.spot, width)
        empty = plain.render(BACKGROUND_FACTOR * _PATH_SAMPLES, poses.noise_seed(self.sweep.seed, 0), target=False)
        with_target, without = (plain.render(_PATH_SAMPLES, self._seed(0), target=target) for target in (True, False))
        figures = []
        for name, reference, rendered in zip(
            agreement.WHAT, (empty, with_target - (without if self.sweep.paired else empty)), engine, strict=True
        ):
            # With equal noise the difference of every pixel counts, so take root mean squares, not means.
            scale, difference = (float(np.sqrt((picture**2).mean())) for picture in (reference, reference - rendered))
            rounding = 1e-6 * float(np.abs(empty).max())
            same = difference <= _SAME[self.sweep.device] * scale + rounding
            figures.append(
                Figure(name, "", "", float(reference.mean()), float(rendered.mean()), 0.0, math.inf, same=same)
            )
        return figures, width


@contextlib.contextmanager
def withdrawn(path: Path, name: str) -> Iterator[None]:
    """Delete a file, and the folders that were made for it, if the body of the ``with`` statement fails."""
    new_folders = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        yield
    except BaseException:
        (path / name).unlink(missing_ok=True)
        for folder in new_folders:
            with contextlib.suppress(OSError):  # another process has put files into it
                folder.rmdir()
        raise


def _numbers(figure: Figure) -> list[float]:
    """Return for the manifest both numbers, plain Cycles' first, and half the 95 % interval of their difference."""
    return [float(f"{x:.6g}") for x in (figure.plain, figure.engine, 1.96 * figure.error)]


def _spread(figure: Figure) -> str:
    """Return the uncertainty of a figure as text."""
    return f"± {radiance(1.96 * figure.error, 2)}"


def _wide(width: float) -> str:
    return f", with the spot widened to {math.degrees(width):.3g} degrees to find more light" if width else ""


def _words(check: _Check, figures: Sequence[Figure], width: float, seconds: float) -> str:
    """Return the result as a line for people."""
    start = f"start check, {seconds:.1f} s: in voxel {check.pose.label} plain Cycles and {check.sweep.engine} "
    if all(figure.same for figure in figures):
        return start + "give the same pixels"
    parts = []
    for figure in figures:
        if 1.96 * figure.precision > _VAGUE:
            parts.append(f"{figure.what} too noisy to compare in this time")
        else:
            parts.append(f"{figure.what} {radiance(figure.plain)} and {radiance(figure.engine)} {_spread(figure)}")
    comparable = any("too noisy" not in part for part in parts)
    verdict = "agree within the noise: " if comparable else "were compared: "
    return f"{start}{verdict}{'; '.join(parts)}{_wide(width)}"


def _complaint(source: Path, check: _Check, bad: Figure, width: float) -> str:
    """Return an error message with both numbers, and with what the user can do."""
    engine, label = check.sweep.engine, check.pose.label
    where = f"{bad.what} of {bad.where}" if bad.where else bad.what
    where += f" in {bad.colour}" if bad.colour else ""
    noise = "with the same random numbers, pixel for pixel unlike" if bad.same is False else _spread(bad)
    advice = "take --engine path, which agrees" if engine != "path" and check.path_agrees() else "mend the scene"
    return (
        f"{source}: the engine {engine!r} does not render what Cycles makes of this file: at the first pose, in "
        f"voxel {label}, the {where} is {radiance(bad.plain)} by plain Cycles and {radiance(bad.engine)} by "
        f"{engine!r} ({noise}{_wide(width)}); nothing is kept; {advice}, or render it all the same with --no-probe"
    )
