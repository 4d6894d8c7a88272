"""The check at the start of a sweep: does the chosen engine render what the file says, as plain Cycles does?

One pose, by both. The reference is `plain_cycles.Plain`. The engine's side is a data set of that pose in a temporary
folder, made as the sweep would make it.

Plain Cycles must find the small lit patch by chance, and is noisy. More of its paths find a wider one, so both render
the scene a second time with the spot's cone as wide as the scene lets it be.
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
from generator.model.settings import BACKGROUND_FACTOR, Sweep
from generator.sets.dataset import Dataset

LIMITS = (2.0, 10.0, 60.0)
"""Seconds: what a short sweep may be checked for, a longer one, and the longest, of which that is `_SHARE`."""
_SHARE = 0.05

PRECISE = (0.01, 0.05)
"""Standard errors of the background and of the target's change, relative, below which nothing more is asked."""

TOLERANCES = (0.02, 0.05)
"""By which engines may differ from Cycles in the two: more than the 1 % to which they agree."""
_AMBIENT, _LEFT_OUT = 0.1, 0.5
"""Likewise of `surfel` under ambient light, and of one that was told to leave something out."""

_SAME = {"cpu": 1e-3, "gpu": 3e-2}
"""Of `path`, with the same random numbers: what rounding may change, relative. A GPU rounds in other ways."""

_COPIES, _SAMPLES = 8, 64
"""Pictures of the pose by `patch`, and samples of each; the background has 16 times as many."""
_PATH_SAMPLES = 16
_FIRST, _MOST = 256, 2**16
"""Samples of the first picture by plain Cycles, and of any."""
_ROUNDS = 12
"""That the time is divided into."""

_VAGUE = 1.0
"""Half an interval, relative, beyond which a figure is not worth telling."""

Found = tuple[list[Figure], float]
"""What a view shows, and the full angle of its spot, radians, or 0 where that is the file's."""

Draw = Callable[[bpy.types.Scene, Dataset, Sequence[Mapping[int, int]]], None]
"""Renders poses of a data set: `generator.blender.sweep_worker.render`."""


@dataclass
class _View:
    """The scene with one width of the spot: what either renderer has shown of it.

    Attributes
    ----------
    width : float
        Full angle of the spot, radians; 0 leaves it as it is.
    engine : ndarray of shape (1 or 2, height, width, 3)
        Background, and what the target changes, W/m^2/sr.
    peak : float
        Most radiance of the directly lit wall, W/m^2/sr.
    dark : ndarray of shape (height, width, 1)
        What the pictures are multiplied by: a widened spot may light what the camera sees, many times brighter than
        the rest, and the edge of that light would be all noise there is.
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
        The data set's scene; this leaves another file open.
    source : Path
        The file that plain Cycles renders.
    known : collection of Path
        Files elsewhere that both may refer to.
    meta : mapping
        The data set's manifest.
    pose : PoseRecord
    pictures : int
        Of the whole sweep, which tells how long the check may take.
    draw : callable

    Returns
    -------
    dict
        Of the manifest: both numbers, their intervals, the time, and a line for people.

    Raises
    ------
    NlosError
        They differ by more than their noise.
    """
    begun = time.perf_counter()
    sweep: Sweep = from_dict(Sweep, {k: v for k, v in meta["sweep"].items() if k in _FIELDS}, "")
    checked = _Check(stored, source, known, meta, sweep, pose, draw)
    found = checked.exact() if sweep.engine == "path" else checked.noisy(pictures)
    for figures, width in found:
        if (bad := agreement.worst(figures)).differs:
            raise NlosError(_complaint(source, checked, bad, width))
    seconds = time.perf_counter() - begun
    (first, _), (last, width) = found[0], found[-1]
    return {
        "words": _words(checked, (first[0], last[1]), width, seconds),
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
        """Of the pictures: the sweep's, made small."""
        width, height = self.sweep.resolution
        factor = SIDE / max(width, height)
        return max(1, round(width * factor)), max(1, round(height * factor))

    def plain(self) -> Plain:
        return Plain(blend_file.open_file(self.source, self.known), self.pose, self.size)

    def noisy(self, pictures: int) -> list[Found]:
        """Compare with an engine whose noise is its own: in the scene as it is, and with a wider spot."""
        widths = self.plain().widths()
        views, seconds = self._by_engine(widths)
        limit = self._limit(pictures * seconds)
        plain, begun = self.plain(), time.perf_counter()
        narrow = plain.spot.data.spot_size if widths else 0.0
        samples, number = _FIRST, 0
        while True:
            for view in views:
                if widths:
                    plain.spot.data.spot_size = view.width or narrow
                seed = poses.noise_seed(self.sweep.seed, -1 - number)
                number += 1
                empty = plain.render(samples, seed, target=False)
                both = [plain.render(samples, seed) - empty] if len(view.engine) > 1 else []
                view.add(np.array([empty, *both]), samples)
            found = [(view.figures(self.tolerances), view.width) for view in views]
            took = time.perf_counter() - begun
            a_round = took / views[0].samples * samples
            if any(agreement.worst(figures).differs for figures, _ in found) or took + a_round > limit:
                return found
            if all(f.precision < enough for f, enough in zip(found[-1][0][:2], PRECISE, strict=True)):
                return found
            samples = int(min(max(samples * limit / _ROUNDS / a_round, _FIRST), _MOST))

    def _by_engine(self, widths: Mapping[float, Array]) -> tuple[list[_View], float]:
        """What the engine makes of the scene, as it is and with a wider spot; and the seconds of a picture."""
        scene = blend_file.open_file(self.stored, self.known)
        drawn, seconds = self._drawn(scene)
        views = [_View(0.0, drawn, self._peak(wide=False))]
        spot = player_of(scene, "spot").data
        narrow = spot.spot_size if widths else 0.0
        for width, dark in widths.items():
            spot.spot_size = width
            with contextlib.suppress(NlosError):  # not so wide, then
                drawn, again = self._drawn(scene)
                views.append(_View(width, drawn, self._peak(wide=True), dark))
                seconds = min(seconds, again)  # the first may have waited for what is compiled and made once
                break
        if widths:
            spot.spot_size = narrow
        if len(views) > 1:
            views[0].engine = views[0].engine[:1]  # the wide one shows what the target changes in less time
            views[0].total = views[0].total[:1]
        more = math.prod(self.sweep.resolution) / math.prod(self.size)
        return views, seconds * more * (1.0 if self.sweep.engine == "surfel" else self.sweep.samples / _SAMPLES)

    def _limit(self, seconds: float) -> float:
        """How long plain Cycles may take, where the sweep takes that long."""
        short, middle, longest = LIMITS
        return max(short, min(middle, seconds), min(longest, _SHARE * seconds))

    def _peak(self, *, wide: bool) -> float:
        """Most radiance of the directly lit wall: where the lamp aims, or at its foot if the cone is wide."""
        spot, wall = (self.meta["scene"][name] for name in ("spot", "wall"))
        away = abs(spot["location"][1]) if wide else math.dist(spot["location"], spot["aim"])
        return float((wall.get("albedo") or 1.0) * spot["power"]) / (4.0 * math.pi**2 * max(away, 1e-30) ** 2)

    @property
    def tolerances(self) -> tuple[float, float]:
        """By how much the engine may be wrong by its own account."""
        empty, change = TOLERANCES
        if self.sweep.engine == "surfel":
            empty, change = empty + 2.0 * self.sweep.accuracy, change + 2.0 * self.sweep.accuracy
            if float(self.meta["scene"].get("ambient", 0.0)) > 0.0:
                empty, change = empty + _AMBIENT, change + _AMBIENT
        if self.sweep.leave_out:
            empty, change = empty + _AMBIENT, change + _LEFT_OUT
        return empty, change

    def _drawn(self, scene: bpy.types.Scene) -> tuple[Array, float]:
        """Background and difference, (2, height, width, 3), of a data set of the one pose; and seconds a picture."""
        sweep = self.sweep
        copies, samples = (_COPIES, _SAMPLES) if sweep.engine == "patch" else (1, _PATH_SAMPLES)
        small = replace(sweep, resolution=self.size, samples=samples, denoise=False, poses=copies, frames=0)
        settings = {k: v for k, v in to_dict(small).items() if k not in small.unused}
        meta = {**self.meta, "sweep": {**settings, "scene_sha256": self.meta["sweep"]["scene_sha256"]}}
        some = [replace(self.pose, index=k, seed=self._seed(k), file=f"{k:04d}.exr") for k in range(copies)]
        with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
            dataset = Dataset.create(Path(folder) / "set", meta, some)
            self.draw(scene, dataset, [{k: 0} for k in range(copies)])
            dataset.gather()
            empty = dataset.background().astype(np.float64)
            mean = np.mean([dataset.picture(pose).astype(np.float64) for pose in dataset.poses], axis=0)
        return np.array([empty, mean - empty]), float(np.mean([pose.seconds for pose in dataset.poses]))

    def _seed(self, copy: int) -> int:
        return poses.noise_seed(self.sweep.seed, 1 + copy)

    def path_agrees(self) -> bool:
        """Whether `path` renders what plain Cycles does."""
        try:
            other = replace(self, sweep=replace(self.sweep, engine="path", leave_out=()))
            return not any(agreement.worst(figures).differs for figures, _ in other.exact())
        except NlosError:
            return False

    def exact(self) -> list[Found]:
        """Compare `path`, which is Cycles too: with the same random numbers its pictures are the same.

        In the file's own light few paths find any; a wide spot lights the whole wall.
        """
        return [self._exactly(width) for width in (0.0, 2.0 * WIDEST)]

    def _exactly(self, width: float) -> Found:
        scene = blend_file.open_file(self.stored, self.known)
        widen(player_of(scene, "spot"), width)
        engine, _ = self._drawn(scene)
        plain = self.plain()
        widen(plain.spot, width)
        empty = plain.render(BACKGROUND_FACTOR * _PATH_SAMPLES, poses.noise_seed(self.sweep.seed, 0), target=False)
        posed, own = (plain.render(_PATH_SAMPLES, self._seed(0), target=target) for target in (True, False))
        made = []
        for what, one, other in zip(
            agreement.WHAT, (empty, posed - (own if self.sweep.paired else empty)), engine, strict=True
        ):
            # Every difference counts where the noise is the same, so root mean squares, not means.
            size, apart = (float(np.sqrt((x**2).mean())) for x in (one, one - other))
            rounding = 1e-6 * float(np.abs(empty).max())
            same = apart <= _SAME[self.sweep.device] * size + rounding
            made.append(Figure(what, "", "", float(one.mean()), float(other.mean()), 0.0, math.inf, same=same))
        return made, width


@contextlib.contextmanager
def withdrawn(path: Path, name: str) -> Iterator[None]:
    """Take a file away again, and the folders that were made for it, if what follows fails."""
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        yield
    except BaseException:
        (path / name).unlink(missing_ok=True)
        for folder in made:
            with contextlib.suppress(OSError):  # somebody else's things are in it by now
                folder.rmdir()
        raise


def _numbers(figure: Figure) -> list[float]:
    """Plain Cycles' number, the engine's, and half the 95 % interval of their difference, for the manifest."""
    return [float(f"{x:.6g}") for x in (figure.plain, figure.engine, 1.96 * figure.error)]


def _spread(figure: Figure) -> str:
    """Return by how much a figure is uncertain."""
    return f"± {1.96 * figure.error:.2g}"


def _wide(width: float) -> str:
    return f", with the spot widened to {math.degrees(width):.3g} degrees to find more light" if width else ""


def _words(check: _Check, figures: Sequence[Figure], width: float, seconds: float) -> str:
    """Return a line for people."""
    start = f"start check, {seconds:.1f} s: in voxel {check.pose.label} plain Cycles and {check.sweep.engine} "
    if all(figure.same for figure in figures):
        return start + "give the same pixels"
    parts = []
    for figure in figures:
        if 1.96 * figure.precision > _VAGUE:
            parts.append(f"{figure.what} too noisy to compare in this time")
        else:
            parts.append(f"{figure.what} {figure.plain:.3g} and {figure.engine:.3g} {_spread(figure)}")
    known = any("too noisy" not in part for part in parts)
    agree = "agree within the noise: " if known else "were compared: "
    return f"{start}{agree}{'; '.join(parts)} W/m^2/sr{_wide(width)}"


def _complaint(source: Path, check: _Check, bad: Figure, width: float) -> str:
    """Return a sentence with both numbers, and what can be done."""
    engine, label = check.sweep.engine, check.pose.label
    where = f"{bad.what} of {bad.where}" if bad.where else bad.what
    where += f" in {bad.colour}" if bad.colour else ""
    noise = "with the same random numbers, pixel for pixel unlike" if bad.same is False else _spread(bad)
    instead = "take --engine path, which agrees" if engine != "path" and check.path_agrees() else "mend the scene"
    return (
        f"{source}: the engine {engine!r} does not render what Cycles makes of this file: at the first pose, in "
        f"voxel {label}, the {where} is {bad.plain:.3g} W/m^2/sr by plain Cycles and {bad.engine:.3g} by {engine!r} "
        f"({noise}{_wide(width)}); nothing is kept; {instead}, or render it all the same with --no-probe"
    )
