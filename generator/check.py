"""Says what is wrong with a scene before it is rendered for a night: NLOS scenes that are wrong look right."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Vector

from generator import adopt, clearance, engines, extract, poses, spec, stage
from generator.spec import Array, NlosError, Sweep

GOOD, NOTE, WARNING, ERROR = "good", "note", "warning", "error"

_LATTICE = np.array([0.1, 0.5, 0.9])
"""Where voxels are looked at, in their edges."""
_MOST = 512
"""Of more than these, so many, evenly spread: a window waits for it."""
_MANY = 64
"""Of more voxels the middle has to do: a window waits for it."""
_PIXELS = (np.arange(5) + 0.5) / 5.0
"""Where the watched patch is, in its edges."""
_RINGS = (0.0, 0.25, 0.5, 0.75, 1.0)
_STEPS = np.linspace(0.0, 1.0, 200)
"""Where a cone of light is looked at: in its radius, and along it."""
_SHORT = 1e-4
"""What a ray leaves out at both ends, in its length: there it meets what it starts from."""
_HALF = 0.5
_PROBE_SAMPLES, _PROBES, _PATIENCE = 16, 64, 8.0
"""Of a probe's pictures; how many pairs of them at most; and for how many seconds."""
_BYTES_PER_VALUE = 3.7
"""Of a float32 in a compressed EXR file: noise hardly packs."""


@dataclass(frozen=True)
class Finding:
    """One thing found.

    Attributes
    ----------
    level : {"good", "note", "warning", "error"}
        An error stops a sweep, or makes it worthless; a warning may.
    text : str
        One sentence.
    object : str
        The object it names, else empty.
    fix : str
        What `mend` can do about it, else empty.
    """

    level: str
    text: str
    object: str = ""
    fix: str = ""


FIXES = {
    "metres": "Convert to Metres",
    "align": "Align to Wall",
    "reflections": "Allow Three",
    "voxels": "Fit Voxels",
    "show": "Show",
}


def mend(scene: bpy.types.Scene, fix: str) -> None:
    """Do what a finding proposes.

    Raises
    ------
    NlosError
        There is no such remedy, or it cannot be done here.
    """
    if fix == "metres":
        adopt.to_metres(scene)
    elif fix == "align":
        adopt.align(scene)
    elif fix == "reflections":
        stage.limit_reflections(scene, extract.MAX_ORDER)
    elif fix == "voxels":
        adopt.fit_grid(scene)
    elif fix == "show":
        stage.show(scene, stage.find(scene, "target"))
    else:
        raise NlosError(f"fix {fix!r}: there is none; choose from {', '.join(FIXES)}")


def findings(scene: bpy.types.Scene, *, engine: str = "patch") -> list[Finding]:
    """Return all that is found without rendering: errors first.

    Parameters
    ----------
    scene : bpy.types.Scene
    engine : {"path", "patch", "surfel", "auto"}
        What is going to render it.
    """
    found = _roles(scene)
    if not found:
        found = _frame(scene)
    if not hopeless(found):
        try:
            described = stage.read(scene)
        except NlosError as error:
            found.append(_told(scene, error))
        else:
            found += [*_settings(scene, described), *_sight(scene, described), *_engine(scene, engine)]
    order = [ERROR, WARNING, NOTE, GOOD]
    return sorted(found, key=lambda f: order.index(f.level))


def hopeless(found: Sequence[Finding]) -> bool:
    """Whether an error is among what was found."""
    return any(f.level == ERROR for f in found)


def _told(scene: bpy.types.Scene, error: NlosError) -> Finding:
    """An error's sentence, without the file's name before it, as a finding."""
    text = str(error).removeprefix(f"{bpy.data.filepath or 'scene'}: ")
    fix = "voxels" if "voxel grid" in text else ""
    return Finding(ERROR, text, _named(scene, text), fix)


def _named(scene: bpy.types.Scene, text: str) -> str:
    """The first object that a sentence names."""
    return next((name for name in re.findall(r"'([^']*)'", text) if name in scene.objects), "")


def _roles(scene: bpy.types.Scene) -> list[Finding]:
    found = []
    for role in stage.SINGLE_ROLES:
        players, words = stage.players(scene, role), role.replace("_", " ")
        if not players:
            found.append(Finding(ERROR, f"No object is the {words}: select yours and adopt it, or build a preset"))
        elif len(players) > 1:
            names = ", ".join(o.name for o in players)
            found.append(
                Finding(ERROR, f"{len(players)} objects are the {words}: {names}; adopt one", players[0].name)
            )
    return found


def _frame(scene: bpy.types.Scene) -> list[Finding]:
    found = []
    wall, target = stage.find(scene, "relay_wall"), stage.find(scene, "target")
    if why := stage.unseen(scene, target):
        found.append(Finding(ERROR, f"The target {target.name!r} {why}", target.name, "show"))
    if not adopt.in_metres(scene):
        unit = scene.unit_settings.scale_length
        text = f"A Blender unit is {unit:g} m here; light, voxels and poses count in metres"
        found.append(Finding(ERROR, text, fix="metres"))
    if not stage.in_frame(wall, stage.snapshot(scene)):
        text = f"The relay wall {wall.name!r} is not in the plane y = 0, which the lab's frame starts from"
        found.append(Finding(ERROR, text, wall.name, "align"))
    return found


def _settings(scene: bpy.types.Scene, described: spec.Scene) -> list[Finding]:
    found = []
    if scene.render.engine != "CYCLES":
        found.append(
            Finding(WARNING, "Cycles is not the scene's render engine: F12 shows another picture", fix="reflections")
        )
    order = described.reflection_order
    if order < extract.MAX_ORDER:
        text = f"Light makes {order} reflections at most: by way of the hidden object it takes three"
        found.append(Finding(ERROR, text, fix="reflections"))
    elif order > extract.MAX_ORDER:
        text = f"Light makes up to {order} reflections: more than three cost time and wash the signal out"
        found.append(Finding(NOTE, text, fix="reflections"))
    if others := stage.others(scene):
        some = ", ".join(others[:3]) + (f" and {len(others) - 3} more" if len(others) > 3 else "")
        found.append(Finding(NOTE, f"Also rendered, without a role: {some}", others[0]))
    return found


def _engine(scene: bpy.types.Scene, engine: str) -> list[Finding]:
    chosen, reasons = engines.choose(scene)
    if engine == engines.AUTO:
        engine = chosen
    rank = engines.ENGINES.index
    found = []
    if rank(engine) > rank(chosen):
        for reason in reasons:
            text = f"The engine {engine!r} cannot honour that {reason}; {chosen!r} can"
            found.append(Finding(ERROR, text, _named(scene, reason)))
    elif rank(chosen) > rank(engine):
        found.append(Finding(NOTE, f"The engine {chosen!r} can render this scene too, in less time"))
    return found


class _Eyes:
    """What sees what past everything but the target.

    Parameters
    ----------
    scene : bpy.types.Scene
    """

    def __init__(self, scene: bpy.types.Scene) -> None:
        self._trees = clearance.obstacles(scene)

    def open(self, start: Array, end: Array) -> bool:
        """Whether nothing stands between two points, each of shape (3,)."""
        way = end - start
        length = float(np.linalg.norm(way))
        if length == 0.0:
            return True
        origin, unit = Vector(start + _SHORT * way), Vector(way / length)
        reach = (1.0 - 2.0 * _SHORT) * length
        return all(tree.ray_cast(origin, unit, reach)[0] is None for tree in self._trees)

    def passed(self, starts: Array, ends: Array) -> Array:
        """Return points along rays from starts (n, 3) to ends (n, 3), as far as nothing is in the way, (m, 3)."""
        found = []
        for start, end in zip(starts, ends, strict=True):
            origin, way = Vector(start), Vector(end - start)
            length = way.length
            hits = [tree.ray_cast(origin, way.normalized(), length)[3] for tree in self._trees]
            reach = min([hit for hit in hits if hit is not None], default=length) / (length or 1.0)
            found.append(start + reach * _STEPS[:, None] * (end - start))
        every: Array = np.concatenate(found)
        return every

    def share(self, starts: Array, ends: Array) -> Array:
        """Return the open share of the ways from each of starts (n, 3) to ends (m, 3), (n,)."""
        return np.array([np.mean([self.open(a, b) for b in ends]) for a in starts])


def _sight(scene: bpy.types.Scene, described: spec.Scene) -> list[Finding]:
    """Lines of sight that must not be, and those that must."""
    eyes, grid = _Eyes(scene), described.grid
    along = _LATTICE if grid.n_voxels <= _MANY else _LATTICE[1:2]
    u, v, w = np.meshgrid(along, along, along, indexing="ij")
    lattice = np.stack([u.ravel(), v.ravel(), w.ravel()], axis=1)
    looked = np.unique(np.linspace(0, grid.n_voxels - 1, min(grid.n_voxels, _MOST)).astype(int))
    labels = [grid.labels[voxel] for voxel in looked]
    bounds = [grid.bounds(int(voxel)) for voxel in looked]
    points = [lo + lattice * (hi - lo) for lo, hi in bounds]
    found = []
    lamp, camera = stage.find(scene, "spot"), stage.find(scene, "camera")
    at = stage.numbers(lamp.matrix_world.translation)
    starts, corners = stage.view(scene, camera)
    for obj, solid, does in zip(
        (lamp, camera), clearance.sights(scene, described.spot), ("shines", "looks"), strict=True
    ):
        passed = eyes.passed(*solid.rays(_RINGS))
        direct = [label for label, (lo, hi) in zip(labels, bounds, strict=True) if _any_inside(passed, lo, hi)]
        unhidden = []
        for label, inside in zip(labels, points, strict=True):
            # An orthographic camera sees along parallel rays, each from a place of its own.
            froms = (
                _opposite(starts, corners, inside) if obj == camera else [lamp.matrix_world.translation] * len(inside)
            )
            if label not in direct and any(eyes.open(np.array(a), b) for a, b in zip(froms, inside, strict=True)):
                unhidden.append(label)
        if direct:
            which = _voxels(direct, grid.labels)
            text = f"{obj.name!r} {does} straight into {which}: nothing is around the corner there"
            found.append(Finding(ERROR, text, obj.name))
        if unhidden:
            which = _voxels(unhidden, grid.labels)
            text = f"Nothing hides {which} from {obj.name!r}, which only happens to point elsewhere"
            found.append(Finding(NOTE, text, obj.name))
    w1 = np.asarray(described.spot.aim)
    camera_spec = described.camera
    if camera_spec.x[0] <= w1[0] <= camera_spec.x[1] and camera_spec.z[0] <= w1[2] <= camera_spec.z[1]:
        text = f"{lamp.name!r} lights the watched patch itself, which outshines the hidden object thousands of times"
        found.append(Finding(WARNING, text, lamp.name))
    if not eyes.open(at, w1):
        found.append(Finding(ERROR, f"Something stands between {lamp.name!r} and the wall that it lights", lamp.name))
    s, t = np.meshgrid(_PIXELS, _PIXELS)
    weights = np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=-1).reshape(-1, 4)
    watched = weights @ corners
    low = []
    for label, inside in zip(labels, points, strict=True):
        lights = eyes.share(inside, w1[None])
        reach = float((lights * eyes.share(inside, watched)).mean())
        if reach == 0.0:
            what = "the lit patch" if not lights.any() else "the watched patch"
            text = f"Voxel {label} does not see {what}: what stands there stays unseen"
            found.append(Finding(ERROR, text))
        elif reach < _HALF:
            low.append(f"{label} {reach:.0%}")
    if low:
        text = (
            f"Of the ways from the lit patch by way of a voxel to the watched patch, few are open: {', '.join(low)}"
        )
        found.append(Finding(WARNING, text))
    if not any(f.level in (WARNING, ERROR) for f in found):
        found.append(
            Finding(GOOD, f"V{_voxels(labels, grid.labels)[1:]}: hidden from lamp and camera, seen by the wall")
        )
    return found


def _any_inside(points: Array, lo: Array, hi: Array) -> bool:
    return bool(((points > lo) & (points < hi)).all(axis=1).any())


def _opposite(starts: Array, corners: Array, points: Array) -> Array:
    """Where a camera's rays to points start; its corner rays go from starts (4, 3) to corners (4, 3)."""
    if np.ptp(starts, axis=0).max() == 0.0:
        return np.tile(starts[0], (len(points), 1))
    along = corners[0] - starts[0]
    ahead = (points - starts[0]) @ along / (along @ along)
    origins: Array = points - ahead[:, None] * along
    return origins


def _voxels(labels: Sequence[str], every: Sequence[str]) -> str:
    if len(labels) == 1:
        return f"voxel {labels[0]}"
    first = every.index(labels[0])
    in_a_row = len(labels) > 3 and list(labels) == list(every[first : first + len(labels)])
    shown = f"{labels[0]} to {labels[-1]}" if in_a_row else ", ".join(labels)
    return f"voxels {shown}"


def places(scene: bpy.types.Scene, sweep: Sweep) -> list[Finding]:
    """Return the voxel, if there is one, in which the target finds no place."""
    described = stage.read(scene)
    is_free = clearance.clearance(scene, described, engine=sweep.engine)
    sampler = poses.Sampler(described.grid, sweep, stage.hull(scene), is_free)
    for voxel in range(described.grid.n_voxels):
        try:
            sampler.draw(voxel, 0)
        except NlosError as error:
            return [Finding(ERROR, str(error), stage.find(scene, "target").name, "voxels")]
    return []


@dataclass(frozen=True)
class Probe:
    """What a few quick renders tell of a sweep; see `probe`.

    Attributes
    ----------
    engine : str
    share : float
        Mean of the difference picture, of the picture's.
    signal_to_noise : float
        Root mean square of the difference picture over that of its noise, at the sweep's samples; for `surfel`, over
        that of the error asked for.
    seconds : float
        That the sweep takes on all cores, without starting Blender.
    bytes : float
        That its pictures take on disk.
    """

    engine: str
    share: float
    signal_to_noise: float
    seconds: float
    bytes: float

    def findings(self) -> list[Finding]:
        """Return it in sentences."""
        if self.signal_to_noise == 0.0 or (self.share == 0.0 and not np.isfinite(self.signal_to_noise)):
            return [
                Finding(ERROR, f"The object changes nothing in the pictures of {self.engine!r}, where it stands now")
            ]
        signal = f"The object adds {self.share:.2%} to the picture"
        enough = self.signal_to_noise >= 3.0
        noise = f"its difference stands {self.signal_to_noise:.3g} times above the noise of {self.engine!r}"
        advice = "" if enough else "; more samples, a brighter lamp or the engine surfel would mend that"
        cost = f"A sweep takes about {_clock(self.seconds)} and {_size(self.bytes)} on disk"
        return [Finding(GOOD if enough else WARNING, f"{signal}; {noise}{advice}"), Finding(NOTE, cost)]


def probe(scene: bpy.types.Scene, sweep: Sweep) -> Probe:
    """Measure what a sweep's pictures will be like, with the target where it stands.

    Pairs of pictures with and without the target, with few samples and noise of their own: what their differences
    share is signal, where they differ is noise, whose mean square falls with the samples. So many pairs, and no more
    than some seconds, as tell the signal from the noise.

    Parameters
    ----------
    scene : bpy.types.Scene
    sweep : Sweep

    Raises
    ------
    NlosError
        The engine cannot honour something in the scene.
    """
    voxels = stage.read(scene).grid.n_voxels
    pictures = sweep.poses * voxels
    few = min(_PROBE_SAMPLES, sweep.samples)
    with engines.opened(scene, sweep.engine, **engines.settings(sweep)) as renderer:
        exact = isinstance(renderer, engines.SurfelRenderer)
        renderer.render(samples=few, seed=0)  # what is made once is no part of a picture's time
        if not exact:
            renderer.render(samples=few, seed=0, target=False)
        differences, level, start = [], 0.0, time.perf_counter()
        for seed in range(1, _PROBES + 1):
            picture = renderer.render(samples=few, seed=seed).astype(np.float64)
            begun = time.perf_counter()
            differences.append((picture - renderer.render(samples=few, seed=seed, target=False)).mean(axis=2))
            level += float(picture.mean())
            seconds = ((begun if exact else time.perf_counter()) - start) / seed
            signal, noise, sure = _signal(np.array(differences))
            if exact or sure or time.perf_counter() - start > _PATIENCE:
                break
    if not exact:
        noise *= few / sweep.samples
        seconds *= sweep.samples / few * (1.0 if sweep.paired else 0.5)
    ratio = 1.0 / sweep.accuracy if exact else float(np.sqrt(signal / noise)) if noise > 0.0 else np.inf
    return Probe(
        engine=sweep.engine,
        share=float(np.sum([d.mean() for d in differences])) / level if level else 0.0,
        signal_to_noise=ratio,
        seconds=seconds * pictures,
        bytes=_BYTES_PER_VALUE * 3.0 * sweep.resolution[0] * sweep.resolution[1] * pictures,
    )


def _signal(pictures: Array) -> tuple[float, float, bool]:
    """Return mean squares of what pictures (n, height, width) share, and of a picture's noise; whether it is sure.

    The mean of n pictures has a n-th of the noise, which its square is too large by.
    """
    n = len(pictures)
    if n < 2:
        return float((pictures**2).mean()), 0.0, False
    noise = float(pictures.var(axis=0, ddof=1).mean())
    left = noise / n
    signal = float((pictures.mean(axis=0) ** 2).mean()) - left
    return max(signal, 0.0), noise, signal > 6.0 * left * np.sqrt(2.0 / pictures[0].size)


def _clock(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def _size(count: float) -> str:
    return f"{count / 1e6:.3g} MB" if count < 1e9 else f"{count / 1e9:.3g} GB"
