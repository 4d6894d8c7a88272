"""Says what is wrong with a scene before it is rendered for a night: NLOS scenes that are wrong look right."""

from __future__ import annotations

import itertools
import math
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from generator.blender import check
from generator.blender.engines import renderers, survey
from generator.blender.engines.lit_patch import other_lights
from generator.blender.engines.reading import MAX_ORDER, lights
from generator.blender.engines.settings import settled
from generator.blender.engines.surface import Light
from generator.blender.lighting import Beam, Eyes
from generator.blender.scene import adopt, clearance, geometry, replaced, roles
from generator.blender.scene.description import read_scene
from generator.model import poses
from generator.model.arrays import Array
from generator.model.engines import AUTO, ENGINES
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.quantities import byte_size, rough_time
from generator.model.scene import Scene
from generator.model.settings import Sweep

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
"""Where a cone of light is looked at, in its radius."""
_HALF = 0.5
_PROBE_SAMPLES, _PROBES, _PATIENCE = 16, 64, 8.0
"""Of a probe's pictures; how many pairs where another engine can be asked; and for how many seconds at most."""
_SMALL, _ROUGH = 32, 1e-2
"""What `surfel` is asked with, where it only has to say how much the object adds: pixels a side, and accuracy."""
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
        roles.limit_reflections(scene, MAX_ORDER)
    elif fix == "voxels":
        adopt.fit_grid(scene)
    elif fix == "show":
        roles.show(scene, roles.find(scene, "target"))
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
        try:
            found = _frame(scene)
            readable = not hopeless(found)
            found += _settings(scene)
            if readable:
                described = read_scene(scene)
                found += [*_sight(scene, described), *_engine(scene, engine)]
        except NlosError as error:
            found.append(_told(scene, error))
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
    for role in roles.SINGLE_ROLES:
        players, words = roles.players(scene, role), role.replace("_", " ")
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
    wall, target = roles.find(scene, "relay_wall"), roles.find(scene, "target")
    if why := roles.unseen(scene, target):
        found.append(Finding(ERROR, f"The target {target.name!r} {why}", target.name, "show"))
    if not adopt.in_metres(scene):
        unit = scene.unit_settings.scale_length
        text = f"A Blender unit is {unit:g} m here; light, voxels and poses count in metres"
        found.append(Finding(ERROR, text, fix="metres"))
    if not geometry.in_frame(wall, geometry.snapshot(scene)):
        text = f"The relay wall {wall.name!r} is not in the plane y = 0, which the lab's frame starts from"
        found.append(Finding(ERROR, text, wall.name, "align"))
    return found


def _settings(scene: bpy.types.Scene) -> list[Finding]:
    found = []
    if scene.render.engine != "CYCLES":
        found.append(
            Finding(WARNING, "Cycles is not the scene's render engine: F12 shows another picture", fix="reflections")
        )
    order = roles.reflection_order(scene)
    if order < MAX_ORDER:
        text = f"Light makes {order} reflections at most: by way of the hidden object it takes three"
        found.append(Finding(ERROR, text, fix="reflections"))
    elif order > MAX_ORDER:
        text = f"Light makes up to {order} reflections: more than three cost time and wash the signal out"
        found.append(Finding(NOTE, text, fix="reflections"))
    if others := roles.others(scene):
        some = ", ".join(others[:3]) + (f" and {len(others) - 3} more" if len(others) > 3 else "")
        found.append(Finding(NOTE, f"Also rendered, without a role: {some}", others[0]))
    if differing := replaced.replaced(scene):
        usual = [setting.words for setting in differing if replaced.is_default(scene, setting)]
        chosen = [replaced.told(scene, setting) for setting in differing if not replaced.is_default(scene, setting)]
        parts = [f"settings of the file: {', '.join(chosen)}"] if chosen else []
        parts += [f"some of Blender's defaults: {', '.join(usual)}"] if usual else []
        found.append(Finding(NOTE, f"A sweep replaces {'; and '.join(parts)}"))
    return found


def _engine(scene: bpy.types.Scene, engine: str) -> list[Finding]:
    surveyed = survey.survey(scene)
    if surveyed.never:
        return [Finding(ERROR, f"It cannot be swept: {why}", _named(scene, why)) for why in surveyed.never]
    chosen, _ = renderers.choose(scene, surveyed)
    if engine in (AUTO, chosen):
        return []
    # Whoever asks for `surfel` gets ambient light to a few per cent; nobody is advised to.
    reasons = (survey.survey(scene, ambient=True) if engine == "surfel" else surveyed).reasons(engine)
    if reasons:
        return [
            Finding(ERROR, f"The engine {engine!r} cannot honour that {why}; {chosen!r} can", _named(scene, why))
            for why in reasons
        ]
    by_cost = list(ENGINES)  # the dearest first
    if by_cost.index(chosen) > by_cost.index(engine):
        return [Finding(NOTE, f"The engine {chosen!r} can render this scene too, in less time")]
    return []


def _sight(scene: bpy.types.Scene, described: Scene) -> list[Finding]:
    """Lines of sight that must not be, and those that must."""
    seen, grid = geometry.snapshot(scene), described.grid
    eyes = Eyes.of(scene, seen)
    along = _LATTICE if grid.n_voxels <= _MANY else _LATTICE[1:2]
    u, v, w = np.meshgrid(along, along, along, indexing="ij")
    lattice = np.stack([u.ravel(), v.ravel(), w.ravel()], axis=1)
    looked = np.unique(np.linspace(0, grid.n_voxels - 1, min(grid.n_voxels, _MOST)).astype(int))
    labels = [grid.labels[voxel] for voxel in looked]
    bounds = [grid.bounds(int(voxel)) for voxel in looked]
    points = [lo + lattice * (hi - lo) for lo, hi in bounds]
    found = []
    lamp, camera = roles.find(scene, "spot"), roles.find(scene, "camera")
    at = seen.matrices["spot"][:3, 3]
    starts, corners = geometry.view(scene, camera, seen.matrices["camera"])
    shown = {lamp: eyes.of_lamp(lamp), camera: eyes.rays("camera")}
    for obj, solid, does in zip(
        (lamp, camera), clearance.sights(scene, described.spot, seen), ("shines", "looks"), strict=True
    ):
        passed = shown[obj].passed(*solid.rays(_RINGS))
        direct = [label for label, (lo, hi) in zip(labels, bounds, strict=True) if _any_inside(passed, lo, hi)]
        unhidden = []
        for label, inside in zip(labels, points, strict=True):
            # An orthographic camera sees along parallel rays, each from a place of its own.
            froms = _opposite(starts, corners, inside) if obj == camera else [at] * len(inside)
            if label not in direct and any(map(shown[obj].open, froms, inside)):
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
    if not shown[lamp].open(at, w1):
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
    found += _lights(scene, eyes, watched, dict(zip(labels, zip(bounds, points, strict=True), strict=True)), grid)
    if not any(f.level in (WARNING, ERROR) for f in found):
        found.append(
            Finding(GOOD, f"V{_voxels(labels, grid.labels)[1:]}: hidden from lamp and camera, seen by the wall")
        )
    return found


def _lights(
    scene: bpy.types.Scene, eyes: Eyes, watched: Array, voxels: Mapping[str, Any], grid: VoxelGrid
) -> list[Finding]:
    """What lights there are besides the spot, and what they shine on directly."""
    told: dict[tuple[str, str], list[str]] = {}
    shining: dict[str, list[Light]] = {}
    for light in other_lights(lights(scene)):
        shining.setdefault(light.name, []).append(light)
    for name, alike in shining.items():
        what = _one_light(scene, alike, eyes, watched, voxels, grid.labels)
        if what is not None:
            told.setdefault(what, []).append(name)
    found = []
    for (level, text), names in told.items():
        some = ", ".join(map(repr, names[:3])) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        found.append(Finding(level, f"Light of {some} {text}", names[0] if names[0] in scene.objects else ""))
    return found


def _one_light(
    scene: bpy.types.Scene,
    alike: Sequence[Light],
    eyes: Eyes,
    watched: Array,
    voxels: Mapping[str, Any],
    every: Sequence[str],
) -> tuple[str, str] | None:
    """What is to be said of the lights that are the same object, instanced; None if they light nothing here."""
    wall, target = roles.find(scene, "relay_wall"), roles.find(scene, "target")
    if alike[0].kind == "WORLD":
        layers = [layer for layer in scene.view_layers if layer.use]
        shows = scene.world is None or scene.world.cycles_visibility.diffuse
        if not shows or not any(layer.use_sky for layer in layers):
            return None
        return NOTE, "of the world is in every picture, and in its background"
    if alike[0].role == "target":
        return WARNING, "moves with the hidden object, which is then seen without the lit patch"
    if alike[0].role == "relay_wall":
        return WARNING, "comes from the relay wall itself, and outshines what it reflects"
    beams = [Beam(light, eyes) for light in alike]
    holding = [
        label
        for label, ((lo, hi), _) in voxels.items()
        if any(
            _any_inside(beam.points, lo, hi) for light, beam in zip(alike, beams, strict=True) if light.kind != "SUN"
        )
    ]
    into = [
        label
        for label, ((lo, hi), inside) in voxels.items()
        if any(beam.meets(target, inside) or beam.passes(target, lo, hi) for beam in beams)
    ]
    onto = any(beam.meets(wall, watched) for beam in beams)
    if holding and into:
        return ERROR, f"comes from within {_voxels(holding, every)}, where the hidden object is looked for"
    lit = [*(["the watched patch"] if onto else []), *([_voxels(into, every)] if into else [])]
    if onto:
        return WARNING, f"falls directly on {' and '.join(lit)}, and outshines what the hidden object adds"
    if into:
        return WARNING, f"falls directly on {lit[0]}: the object is seen there not by the lit patch alone"
    if not any(beam.counts for beam in beams):
        return None
    return NOTE, "is in the scene too, hidden from the watched patch and from the voxels"


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
    described = read_scene(scene)
    is_free = clearance.clearance(scene, described, engine=sweep.engine)
    sampler = poses.Sampler(described.grid, sweep, geometry.hull(scene), is_free)
    for voxel in range(described.grid.n_voxels):
        try:
            sampler.draw(voxel, 0)
        except NlosError as error:
            return [Finding(ERROR, str(error), roles.find(scene, "target").name, "voxels")]
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
        that of the error asked for. NaN if the pictures do not tell.
    seconds : float
        That the sweep takes on all cores, without starting Blender.
    bytes : float
        That its pictures take on disk.
    error : float
        Standard error of the share, where it was not told from the noise; else 0.
    missed : int
        Samples taken, if the object changed none of them; else 0.
    exact : bool
        Whether the share is known without noise, from the engine `surfel`.
    other : bool
        Whether `surfel` can render the scene as well.
    """

    engine: str
    share: float
    signal_to_noise: float
    seconds: float
    bytes: float
    error: float = 0.0
    missed: int = 0
    exact: bool = False
    other: bool = False

    def findings(self) -> list[Finding]:
        """Return it in sentences."""
        cost = f"A sweep takes about {rough_time(self.seconds)} and {byte_size(self.bytes)} on disk"
        return [self._signal(), Finding(NOTE, cost)]

    def _signal(self) -> Finding:
        if self.exact and self.signal_to_noise == 0.0:
            return Finding(ERROR, "The object changes nothing in the pictures, where it stands now")
        more = " or the engine 'surfel'" if self.other and self.engine != "surfel" else ""
        missed = f"none of {self.missed:,} samples of {self.engine!r} met it"
        if self.missed and not self.exact:
            # Three in n is what, with 95 %, is not exceeded by what was met in none of n tries.
            text = (
                f"What the object adds to the picture is not known: {missed}, nor do more than {3 / self.missed:.1g}"
            )
            return Finding(WARNING, f"{text} of all (95 %); take more")
        if self.error:
            low, high = self.share - 2.0 * self.error, self.share + 2.0 * self.error
            text = f"The object adds {_share(low)} to {_share(high)} to the picture (95 %)"
            return Finding(WARNING, f"{text}, which the noise of {self.engine!r} hides; more samples would tell")
        adds = f"The object adds {_share(self.share)} to the picture"
        if self.missed:
            return Finding(WARNING, f"{adds}, but {missed}; take many more{more}")
        stands = f"its difference stands {self.signal_to_noise:.3g} times above the noise of {self.engine!r}"
        if self.signal_to_noise >= 3.0:
            return Finding(GOOD, f"{adds}; {stands}")
        return Finding(WARNING, f"{adds}; {stands}; more samples{more} would mend that")


def probe(scene: bpy.types.Scene, sweep: Sweep) -> Probe:
    """Measure what a sweep's pictures will be like, with the target where it stands.

    Pairs of pictures with and without the target, with few samples and noise of their own: what their differences
    share is signal, where they differ is noise, whose mean square falls with the samples. So many pairs, and no more
    than some seconds, as tell the signal from the noise. Where they do not, the signal is `surfel`'s, if that can
    render the scene.

    Parameters
    ----------
    scene : bpy.types.Scene
    sweep : Sweep

    Raises
    ------
    NlosError
        The engine cannot honour something in the scene.
    """
    voxels = read_scene(scene).grid.n_voxels
    pictures = sweep.poses * voxels
    few = min(_PROBE_SAMPLES, sweep.samples)
    exact = not sweep.noisy
    other = exact or not survey.survey(scene, ambient=True).reasons("surfel")
    with renderers.opened(scene, sweep.engine, **renderers.settings(sweep)) as renderer:
        renderer.render(samples=few, seed=0)  # what is made once is no part of a picture's time
        if not exact:
            renderer.render(samples=few, seed=0, target=False)
        differences, level, start = [], 0.0, time.perf_counter()
        for seed in itertools.count(1):
            picture = renderer.render(samples=few, seed=seed).astype(np.float64)
            begun = time.perf_counter()
            differences.append((picture - renderer.render(samples=few, seed=seed, target=False)).mean(axis=2))
            level += float(picture.mean())
            seconds = ((begun if exact else time.perf_counter()) - start) / seed
            signal, noise, sure = _signal(np.array(differences))
            if exact or sure or (other and seed >= _PROBES) or time.perf_counter() - start > _PATIENCE:
                break
    shares = np.array([d.mean() for d in differences]) / (level / len(differences) or 1.0)
    share, error, missed = float(shares.mean()), 0.0, 0
    if not exact:
        noise *= few / sweep.samples
        seconds *= sweep.samples / few * (1.0 if sweep.paired else 0.5)
        missed = 0 if np.any(differences) else few * picture[..., 0].size * len(differences)
    if not exact and not sure and other:
        share, signal = _exactly(scene, sweep.resolution)
    elif not exact and not sure:
        error = float(shares.std(ddof=1) / np.sqrt(len(shares))) if len(shares) > 1 else abs(share)
    told = exact or (other and not sure)
    if exact:
        ratio = 1.0 / sweep.accuracy if signal else 0.0
    elif told and not signal:
        ratio = 0.0
    else:
        ratio = float(np.sqrt(signal / noise)) if noise > 0.0 else math.nan
    return Probe(
        engine=sweep.engine,
        share=share,
        signal_to_noise=ratio,
        seconds=seconds * pictures,
        bytes=_BYTES_PER_VALUE * 3.0 * sweep.resolution[0] * sweep.resolution[1] * pictures,
        error=error,
        missed=missed,
        exact=told,
        other=other,
    )


def _exactly(scene: bpy.types.Scene, resolution: tuple[int, int]) -> tuple[float, float]:
    """What the object changes by the engine `surfel`: mean, of the picture's, and mean square of the difference."""
    longer = max(1.0, max(resolution) / _SMALL)
    size = (max(1, round(resolution[0] / longer)), max(1, round(resolution[1] / longer)))
    with renderers.opened(scene, "surfel", resolution=size, accuracy=_ROUGH) as renderer:
        picture = renderer.render(samples=0, seed=0).astype(np.float64).mean(axis=2)
        difference = picture - renderer.render(samples=0, seed=0, target=False).mean(axis=2)
    level = float(picture.mean())
    return (float(difference.mean()) / level if level else 0.0), float((difference**2).mean())


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


def _share(share: float) -> str:
    """A share in per cent, with two digits that say something."""
    return f"{share:.2%}" if abs(share) >= 1e-3 or share == 0.0 else f"{100.0 * share:.2g} %"


def check_scene(scene: bpy.types.Scene, chosen: Mapping[str, Any]) -> list[check.Finding]:
    """Return what is to be said of a scene before a sweep with the settings that the user chose."""
    found = check.findings(scene, engine=chosen.get("engine", AUTO))
    if check.hopeless(found):
        return found
    sweep, _ = settled(scene, read_scene(scene), chosen)
    found += check.places(scene, sweep)
    return found if check.hopeless(found) else [*found, *check.probe(scene, sweep).findings()]
