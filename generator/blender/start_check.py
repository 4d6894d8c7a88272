"""The check at the start of a sweep: does the chosen engine render what the file says, as plain Cycles does?

One pose, by both. The reference is the scene's file opened in Blender, the target put where the pose says, and F12:
nothing of `generator.blender.engines.renderers` takes part, so that a fault there, or in what is read out of the
scene, shows. The engine's side is a data set of that pose in a temporary folder, made as the sweep would make it.

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
from mathutils import Euler, Matrix, Vector

from generator.blender.scene import blend_file
from generator.blender.scene.quiet import Overrides, quiet
from generator.files.pictures import read_picture
from generator.files.toml import from_dict, to_dict
from generator.measure import agreement
from generator.measure.agreement import Figure
from generator.model import poses
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.model.settings import BACKGROUND_FACTOR, Sweep
from generator.sets.dataset import Dataset

SIDE = 16
"""Longer side of the pictures, pixels: radiance is a mean over a pixel, and the fewer there are the more paths has
each."""

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

_WIDER = (16.0, 11.0, 8.0, 5.6, 4.0, 2.8, 2.0, 1.4)
_WIDEST = math.radians(60.0)
"""Half angle of a spot that is widened."""
_DARK = 0.4
"""Least share of the picture that the widened spot may leave without direct light."""

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


class Plain:
    """The open file as an artist would render it, with the target at a pose.

    Parameters
    ----------
    scene : bpy.types.Scene
        Is changed for good.
    pose : PoseRecord
    size : (int, int)
        Of its pictures, width and height.
    """

    def __init__(self, scene: bpy.types.Scene, pose: PoseRecord, size: tuple[int, int]) -> None:
        self.scene = scene
        self.target, self.spot, self.camera, self.wall = (
            _player(scene, role) for role in ("target", "spot", "camera", "relay_wall")
        )
        self.seconds = 0.0
        for marker in scene.timeline_markers:
            marker.camera = None
        scene.camera = self.camera
        _put(self.target, pose)
        _raw_output(scene, size)

    def render(self, samples: int, seed: int, *, target: bool = True) -> Array:
        """Return one picture, (height, width, 3), W/m^2/sr."""
        hidden = [] if target else [self.target, *self.target.children_recursive]
        with Overrides() as overrides:
            for part in hidden:
                overrides.set(part, "hide_render", True)
            return self._render(samples, seed)

    def _render(self, samples: int, seed: int) -> Array:
        scene, begun = self.scene, time.perf_counter()
        scene.cycles.samples, scene.cycles.seed = samples, seed
        with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
            scene.render.filepath = str(Path(folder) / "plain.exr")
            scene.update_tag()
            with quiet():
                bpy.ops.render.render(write_still=True, scene=scene.name)
            pixels = read_picture(Path(scene.render.filepath))[0].astype(np.float64)
        self.seconds = time.perf_counter() - begun
        return pixels

    def widths(self) -> dict[float, Array]:
        """Return full angles, radians, to which the spot may be widened, the widest first.

        Nothing but the wall may be in the wider cone, and most of the picture must stay out of its direct light. Each
        comes with 1 where a pixel (height, width, 1) does, and 0 where not.
        """
        light = self.spot.data
        if light.type != "SPOT" or light.library is not None:
            return {}
        half = light.spot_size / 2.0
        made = {}
        with Overrides() as overrides:
            for name in ("max_bounces", "volume_bounces"):
                overrides.set(self.scene.cycles, name, 0)
            overrides.set(self.scene, "world", None)
            for other in self.scene.objects:
                if other.type == "LIGHT" and other != self.spot:
                    overrides.set(other, "hide_render", True)
            overrides.set(light, "spot_size", light.spot_size)
            for factor in _WIDER if half < _WIDEST / 1.2 else ():
                angle = math.atan(min(factor * math.tan(half), math.tan(_WIDEST)))
                light.spot_size = 2.0 * angle
                if 2.0 * angle not in made and self._is_clear(angle):
                    dark = _away_from(self._render(64, 0).max(axis=2) > 0.0)
                    if dark.mean() >= _DARK:
                        made[2.0 * angle] = dark[..., None]
        return made

    def _is_clear(self, half: float) -> bool:
        """Whether the lamp sees nothing but the wall where it shines, by what it sees with nothing else there."""
        eye = bpy.data.objects.new("NLOS eye", bpy.data.cameras.new("NLOS eye"))
        place, turn, _ = self.spot.matrix_world.decompose()
        eye.matrix_world = Matrix.LocRotScale(place, turn, None)
        eye.data.angle = 2.0 * half
        eye.data.clip_start = 1e-4 * max(abs(place.y), 1e-6)
        eye.data.clip_end = 1e6 * max(abs(place.y), 1e-6)
        self.scene.collection.objects.link(eye)
        try:
            with Overrides() as overrides:
                overrides.set(self.scene, "camera", eye)
                overrides.set(self.scene.render, "resolution_x", 2 * SIDE)
                overrides.set(self.scene.render, "resolution_y", 2 * SIDE)
                whole = self._render(4, 0)
                for other in self.scene.objects:
                    if other not in (self.wall, self.spot):
                        overrides.set(other, "hide_render", True)
                return bool(whole.any() and np.allclose(whole, self._render(4, 0), rtol=1e-4))
        finally:
            bpy.data.cameras.remove(eye.data)  # takes the object with it


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
        spot = _player(scene, "spot").data
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
        return [self._exactly(width) for width in (0.0, 2.0 * _WIDEST)]

    def _exactly(self, width: float) -> Found:
        scene = blend_file.open_file(self.stored, self.known)
        _widen(_player(scene, "spot"), width)
        engine, _ = self._drawn(scene)
        plain = self.plain()
        _widen(plain.spot, width)
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


def _away_from(lit: Array) -> Array:
    """Return which pixels (height, width) are neither lit nor next to one that is."""
    padded = np.pad(lit, 1)
    height, width = lit.shape
    near = [padded[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    dark: Array = ~np.any(near, axis=0)
    return dark


def _widen(spot: Any, width: float) -> None:
    if width and spot.type == "LIGHT" and spot.data.type == "SPOT" and spot.data.library is None:
        spot.data.spot_size = max(spot.data.spot_size, width)


def _player(scene: bpy.types.Scene, role: str) -> Any:
    """Return the object that the file names for a role."""
    player = next(obj for obj in scene.objects if obj.get("nlos_role") == role)
    if player.hide_viewport:  # changes no render, but what Blender knows of its place
        player.hide_viewport = False
        bpy.context.view_layer.update()
    return player


def _put(target: Any, pose: PoseRecord) -> None:
    """Put the target's origin at a pose and turn it, with nothing that would move it again, and its shape kept."""
    shape = target.matrix_world.copy()
    turn = shape.to_quaternion().to_matrix().to_4x4()
    shape.translation = (0.0, 0.0, 0.0)
    shape = turn.inverted() @ shape
    angles = Euler([math.radians(angle) for angle in pose.rotation], "XYZ")
    place = Matrix.Translation(Vector(pose.position)) @ angles.to_matrix().to_4x4() @ shape
    target.animation_data_clear()
    for constraint in list(target.constraints):
        target.constraints.remove(constraint)
    target.delta_location, target.delta_rotation_euler = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    target.delta_rotation_quaternion, target.delta_scale = (1.0, 0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    bpy.context.view_layer.update()
    if target.parent is not None:
        # Only the matrix between a parent and its child holds every shape.
        own = target.matrix_parent_inverse @ target.matrix_basis
        above = target.matrix_world @ own.inverted()
        target.matrix_parent_inverse = above.inverted() @ place @ target.matrix_basis.inverted()
    elif (place.to_scale() - target.scale).length <= 1e-6 * place.to_scale().length:
        target.rotation_mode = "XYZ"
        target.location, target.rotation_euler = pose.position, angles
    else:
        target.matrix_world = place
    bpy.context.view_layer.update()


def _raw_output(scene: bpy.types.Scene, size: tuple[int, int]) -> None:
    """Float32 radiance as Cycles computes it, of a size; unbiased, where the file would have it clamped or cut short.

    What the product says that it replaces in every file is replaced here too, and nothing else.
    """
    render, image, cycles = scene.render, scene.render.image_settings, scene.cycles
    _set(image, media_type="IMAGE")
    _set(image, file_format="OPEN_EXR", color_mode="RGB", color_depth="32", exr_codec="ZIP")
    _set(image, color_management="FOLLOW_SCENE")
    width, height = size
    _set(render, engine="CYCLES", resolution_x=width, resolution_y=height, resolution_percentage=100)
    _set(render, pixel_aspect_x=1.0, pixel_aspect_y=1.0, use_border=False, use_stamp=False, use_file_extension=False)
    _set(render, use_compositing=False, use_sequencer=False, use_freestyle=False, use_multiview=False)
    _set(render, use_motion_blur=False, use_simplify=False, film_transparent=False, use_persistent_data=False)
    _set(render, use_overwrite=True, use_placeholder=False, threads_mode="AUTO", dither_intensity=0.0)
    _set(cycles, device="CPU", use_adaptive_sampling=False, use_denoising=False, time_limit=0.0, use_guiding=False)
    _set(cycles, sample_clamp_direct=0.0, sample_clamp_indirect=0.0, blur_glossy=0.0, light_sampling_threshold=0.0)
    _set(cycles, caustics_reflective=True, caustics_refractive=True, use_fast_gi=False, film_exposure=1.0)
    _set(cycles, pixel_filter_type="BOX", use_animated_seed=False, sampling_pattern="TABULATED_SOBOL")
    _set(cycles, use_sample_subset=False, sample_offset=0)
    for layer in scene.view_layers:
        _set(layer, samples=0)


def _set(owner: Any, **values: Any) -> None:
    """Set attributes, as far as this Blender has them."""
    for name, value in values.items():
        if hasattr(owner, name):
            setattr(owner, name, value)


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
