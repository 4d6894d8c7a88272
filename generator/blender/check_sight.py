"""Lines of sight in a scene: those that must not be, and those that must."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import bpy
import numpy as np

from generator.blender.engines.lit_patch import other_lights
from generator.blender.engines.reading import lights
from generator.blender.engines.surface import Light
from generator.blender.finding import ERROR, GOOD, NOTE, WARNING, Finding
from generator.blender.lighting import Beam, Eyes
from generator.blender.scene import clearance, geometry, roles
from generator.model.arrays import Array
from generator.model.grid import VoxelGrid
from generator.model.scene import Scene

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


def findings(scene: bpy.types.Scene, described: Scene) -> list[Finding]:
    """Return what is found about what sees what: lamp, camera and voxels, wall and voxels, other lights."""
    return _Sight(scene, described).findings()


class _Sight:
    """A scene, and the points of its voxels that are looked at."""

    def __init__(self, scene: bpy.types.Scene, described: Scene) -> None:
        self._scene, self._described = scene, described
        self._seen, self._grid = geometry.snapshot(scene), described.grid
        self._eyes = Eyes.of(scene, self._seen)
        grid = self._grid
        along = _LATTICE if grid.n_voxels <= _MANY else _LATTICE[1:2]
        u, v, w = np.meshgrid(along, along, along, indexing="ij")
        lattice = np.stack([u.ravel(), v.ravel(), w.ravel()], axis=1)
        looked = np.unique(np.linspace(0, grid.n_voxels - 1, min(grid.n_voxels, _MOST)).astype(int))
        self._labels = [grid.labels[voxel] for voxel in looked]
        self._bounds = [grid.bounds(int(voxel)) for voxel in looked]
        self._points = [lo + lattice * (hi - lo) for lo, hi in self._bounds]
        self._lamp, self._camera = roles.find(scene, "spot"), roles.find(scene, "camera")
        self._starts, self._corners = geometry.view(scene, self._camera, self._seen.matrices["camera"])
        self._shown = {self._lamp: self._eyes.of_lamp(self._lamp), self._camera: self._eyes.rays("camera")}
        s, t = np.meshgrid(_PIXELS, _PIXELS)
        weights = np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=-1).reshape(-1, 4)
        self._watched = weights @ self._corners

    def findings(self) -> list[Finding]:
        """Return what is found."""
        voxels = dict(zip(self._labels, zip(self._bounds, self._points, strict=True), strict=True))
        found = [*self._around_the_corner(), *self._lit(), *self._open()]
        found += _lights(self._scene, self._eyes, self._watched, voxels, self._grid)
        if not any(f.level in (WARNING, ERROR) for f in found):
            words = f"V{_voxels(self._labels, self._grid.labels)[1:]}"
            found.append(Finding(GOOD, f"{words}: hidden from lamp and camera, seen by the wall"))
        return found

    def _around_the_corner(self) -> list[Finding]:
        """Voxels that lamp or camera point at, and those that are not hidden from them."""
        found = []
        at, every = self._seen.matrices["spot"][:3, 3], self._grid.labels
        solids = clearance.sights(self._scene, self._described.spot, self._seen)
        for obj, solid, does in zip((self._lamp, self._camera), solids, ("shines", "looks"), strict=True):
            shown = self._shown[obj]
            passed = shown.passed(*solid.rays(_RINGS))
            direct = [
                label
                for label, (lo, hi) in zip(self._labels, self._bounds, strict=True)
                if _any_inside(passed, lo, hi)
            ]
            unhidden = []
            for label, inside in zip(self._labels, self._points, strict=True):
                # An orthographic camera sees along parallel rays, each from a place of its own.
                is_camera = obj == self._camera
                froms = _opposite(self._starts, self._corners, inside) if is_camera else [at] * len(inside)
                if label not in direct and any(map(shown.open, froms, inside)):
                    unhidden.append(label)
            if direct:
                text = (
                    f"{obj.name!r} {does} straight into {_voxels(direct, every)}: nothing is around the corner there"
                )
                found.append(Finding(ERROR, text, obj.name))
            if unhidden:
                which = _voxels(unhidden, every)
                text = f"Nothing hides {which} from {obj.name!r}, which only happens to point elsewhere"
                found.append(Finding(NOTE, text, obj.name))
        return found

    def _lit(self) -> list[Finding]:
        """Whether the lamp lights the wall, and beside the watched patch."""
        found, lamp = [], self._lamp
        w1, camera = np.asarray(self._described.spot.aim), self._described.camera
        if camera.x[0] <= w1[0] <= camera.x[1] and camera.z[0] <= w1[2] <= camera.z[1]:
            text = f"{lamp.name!r} lights the watched patch itself, which outshines the hidden object"
            found.append(Finding(WARNING, f"{text} thousands of times", lamp.name))
        if not self._shown[lamp].open(self._seen.matrices["spot"][:3, 3], w1):
            text = f"Something stands between {lamp.name!r} and the wall that it lights"
            found.append(Finding(ERROR, text, lamp.name))
        return found

    def _open(self) -> list[Finding]:
        """Voxels that the lit or the watched patch does not see."""
        found, low = [], []
        w1 = np.asarray(self._described.spot.aim)
        for label, inside in zip(self._labels, self._points, strict=True):
            lights = self._eyes.share(inside, w1[None])
            reach = float((lights * self._eyes.share(inside, self._watched)).mean())
            if reach == 0.0:
                what = "the lit patch" if not lights.any() else "the watched patch"
                found.append(Finding(ERROR, f"Voxel {label} does not see {what}: what stands there stays unseen"))
            elif reach < _HALF:
                low.append(f"{label} {reach:.0%}")
        if low:
            text = "Of the ways from the lit patch by way of a voxel to the watched patch, few are open"
            found.append(Finding(WARNING, f"{text}: {', '.join(low)}"))
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
