"""Checks lines of sight in a scene: those that must be blocked, and those that must be open."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import bpy
import numpy as np

from generator.blender.engines.lit_patch import other_lights
from generator.blender.engines.reading import lights
from generator.blender.engines.surface import Light
from generator.blender.finding import ERROR, GOOD, NOTE, WARNING, Finding
from generator.blender.lighting import Beam, Eyes
from generator.blender.scene import clearance, geometry, nodes, roles
from generator.model.arrays import Array
from generator.model.grid import VoxelGrid
from generator.model.scene import Scene

_LATTICE = np.array([0.1, 0.5, 0.9])
"""Sample points along each edge of a voxel, relative to its length."""
_MOST = 512
"""Most voxels that are checked, evenly spread over the grid: a window waits for the result."""
_MANY = 64
"""With more voxels than this only their centres are checked: a window waits for the result."""
_PIXELS = (np.arange(5) + 0.5) / 5.0
"""Sample points along each edge of the watched patch, relative to its length."""
_RINGS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Radii at which a cone of light is sampled, relative to its own."""
_HALF = 0.5


def parts(scene: bpy.types.Scene, described: Scene) -> Iterator[list[Finding]]:
    """Yield findings about lines of sight, kind by kind: lamp, camera and voxels, wall and voxels, other lights."""
    yield from _Sight(scene, described).parts()


class _Sight:
    """A scene, and the sample points of its voxels."""

    def __init__(self, scene: bpy.types.Scene, described: Scene) -> None:
        self._scene, self._described = scene, described
        self._seen, self._grid = geometry.snapshot(scene), described.grid
        self._eyes = Eyes.of(scene, self._seen)
        grid = self._grid
        ticks = _LATTICE if grid.n_voxels <= _MANY else _LATTICE[1:2]
        u, v, w = np.meshgrid(ticks, ticks, ticks, indexing="ij")
        lattice = np.stack([u.ravel(), v.ravel(), w.ravel()], axis=1)
        checked = np.unique(np.linspace(0, grid.n_voxels - 1, min(grid.n_voxels, _MOST)).astype(int))
        self._labels = [grid.labels[voxel] for voxel in checked]
        self._bounds = [grid.bounds(int(voxel)) for voxel in checked]
        self._points = [lo + lattice * (hi - lo) for lo, hi in self._bounds]
        self._lamp, self._camera = roles.find(scene, "spot"), roles.find(scene, "camera")
        _, self._corners = geometry.view(scene, self._camera, self._seen.matrices["camera"])
        self._shown = {self._lamp: self._eyes.of_lamp(self._lamp), self._camera: self._eyes.rays("camera")}
        s, t = np.meshgrid(_PIXELS, _PIXELS)
        weights = np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=-1).reshape(-1, 4)
        self._watched = weights @ self._corners

    def parts(self) -> Iterator[list[Finding]]:
        """Yield all findings about lines of sight, kind by kind."""
        voxels = dict(zip(self._labels, zip(self._bounds, self._points, strict=True), strict=True))
        corner, unhidden = self._around_the_corner()
        lamp = [*corner, *self._lit()]
        yield lamp
        patches = self._open()
        yield patches
        lights = _lights(self._scene, self._eyes, self._watched, voxels, self._grid)
        yield lights
        if not any(f.level in (WARNING, ERROR) for f in (*lamp, *patches, *lights)):
            results = []
            hidden = [label for label in self._labels if label not in unhidden]
            beside = [label for label in self._labels if label in unhidden]
            for labels, how in (
                (hidden, "hidden from lamp and camera, seen by the wall"),
                (beside, "seen by the wall, while lamp and camera point elsewhere"),
            ):
                if labels:
                    subject = f"V{_voxels(labels, self._grid.labels)[1:]}"
                    results.append(Finding(GOOD, f"{subject}: {how}"))
            yield results

    def _around_the_corner(self) -> tuple[list[Finding], set[str]]:
        """Return findings about voxels that lamp or camera point at or are not hidden from, and the latter voxels."""
        results, unhidden_from_any = [], set[str]()
        labels = self._grid.labels
        solids = clearance.sights(self._scene, self._described.spot, self._seen)
        for obj, solid, role, verb in zip(
            (self._lamp, self._camera), solids, ("spot", "camera"), ("shines", "looks"), strict=True
        ):
            eyes, start = self._shown[obj], self._seen.matrices[role][:3, 3]
            beam_points = eyes.passed(*solid.rays(_RINGS))
            beam_points = beam_points[
                _inside(beam_points, np.asarray(self._grid.lo), np.asarray(self._grid.hi))
            ]  # few
            direct = [
                label
                for label, (lo, hi) in zip(self._labels, self._bounds, strict=True)
                if _any_inside(beam_points, lo, hi)
            ]
            unhidden = []
            for label, points in zip(self._labels, self._points, strict=True):
                if label not in direct and eyes.clear(np.tile(start, (len(points), 1)), points).any():
                    unhidden.append(label)
            if direct:
                text = (
                    f"{obj.name!r} {verb} straight into {_voxels(direct, labels)}: nothing is around the corner "
                    "there; turn it away, or lay the voxels elsewhere"
                )
                results.append(Finding(ERROR, text, obj.name, "voxels"))
            unhidden_from_any.update(unhidden)
            if unhidden:
                voxels = _voxels(unhidden, labels)
                text = f"Nothing hides {voxels} from {obj.name!r}, which only happens to point elsewhere"
                results.append(Finding(NOTE, text, obj.name))
        return results, unhidden_from_any

    def _lit(self) -> list[Finding]:
        """Return findings about whether the lamp lights the wall, and does so outside the watched patch."""
        results, lamp = [], self._lamp
        w1, camera = np.asarray(self._described.spot.aim), self._described.camera
        if camera.x[0] <= w1[0] <= camera.x[1] and camera.z[0] <= w1[2] <= camera.z[1]:
            text = f"{lamp.name!r} lights the watched patch itself, which outshines the hidden object"
            text += " thousands of times; aim it at another part of the wall, or the camera"
            results.append(Finding(WARNING, text, lamp.name))
        if between := self._shown[lamp].between(self._seen.matrices["spot"][:3, 3], w1):
            text = f"{between!r} stands between {lamp.name!r} and the wall that it lights; move it, or aim elsewhere"
            results.append(Finding(ERROR, text, between if between in self._scene.objects else lamp.name))
        return results

    def _open(self) -> list[Finding]:
        """Return findings about voxels that the lit or the watched patch does not see."""
        results, partly_open = [], []
        w1 = np.asarray(self._described.spot.aim)
        for label, points in zip(self._labels, self._points, strict=True):
            lit_share = self._eyes.share(points, w1[None])
            open_share = float((lit_share * self._eyes.share(points, self._watched)).mean())
            if open_share == 0.0:
                patch = "the lit patch" if not lit_share.any() else "the watched patch"
                text = f"Voxel {label} does not see {patch}: what stands there stays unseen; lay the voxels elsewhere"
                results.append(Finding(ERROR, text, fix="voxels"))
            elif open_share < _HALF:
                partly_open.append(f"{label} {open_share:.0%}")
        if partly_open:
            text = "Of the ways from the lit patch by way of a voxel to the watched patch, few are open"
            remedy = "move what stands between, or lay the voxels elsewhere"
            results.append(Finding(WARNING, f"{text}: {', '.join(partly_open)}; {remedy}"))
        return results


def _lights(
    scene: bpy.types.Scene, eyes: Eyes, watched: Array, voxels: Mapping[str, Any], grid: VoxelGrid
) -> list[Finding]:
    """Return findings about the lights other than the spot, and what they shine on directly."""
    names_by_verdict: dict[tuple[str, str], list[str]] = {}
    lights_by_name: dict[str, list[Light]] = {}
    for light in other_lights(lights(scene)):
        lights_by_name.setdefault(light.name, []).append(light)
    for name, instances in lights_by_name.items():
        verdict = _one_light(scene, instances, eyes, watched, voxels, grid.labels)
        if verdict is not None:
            names_by_verdict.setdefault(verdict, []).append(name)
    results = []
    for (level, text), names in names_by_verdict.items():
        listed = ", ".join(map(repr, names[:3])) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        text = f"Light of {listed} {text}"
        if level in (WARNING, ERROR):
            text += f"; {_darkened(scene, names[0])}"
        results.append(Finding(level, text, names[0] if names[0] in scene.objects else ""))
    return results


def _darkened(scene: bpy.types.Scene, name: str) -> str:
    """Return how an object would give no light."""
    obj = scene.objects.get(name)
    materials = [slot.material for slot in obj.material_slots if slot.material is not None] if obj else []
    glowing = list(dict.fromkeys(repr(material.name) for material in materials if nodes.glows(material)))
    if glowing:
        return f"take the emission out of its material {' and '.join(glowing)}, or hide it from renders"
    return "hide it from renders, or shade it from there"


def _one_light(
    scene: bpy.types.Scene,
    alike: Sequence[Light],
    eyes: Eyes,
    watched: Array,
    voxels: Mapping[str, Any],
    every: Sequence[str],
) -> tuple[str, str] | None:
    """Return level and text of the finding about the instances of one light; None if they light nothing here."""
    wall, target = roles.find(scene, "relay_wall"), roles.find(scene, "target")
    if alike[0].kind == "WORLD":
        layers = [layer for layer in scene.view_layers if layer.use]
        visible = scene.world is None or scene.world.cycles_visibility.diffuse
        if not visible or not any(layer.use_sky for layer in layers):
            return None
        return NOTE, "is in every picture and in its background; World > Surface > Strength 0 leaves it out"
    if alike[0].role == "target":
        return WARNING, "moves with the hidden object, which is then seen without the lit patch"
    if alike[0].role == "relay_wall":
        return WARNING, "comes from the relay wall itself, and outshines what it reflects"
    beams = [Beam(light, eyes) for light in alike]
    voxels_around = [
        label
        for label, ((lo, hi), _) in voxels.items()
        if any(
            _any_inside(beam.points, lo, hi) for light, beam in zip(alike, beams, strict=True) if light.kind != "SUN"
        )
    ]
    lit = [
        label
        for label, ((lo, hi), points) in voxels.items()
        if any(beam.meets(target, points) or beam.passes(target, lo, hi) for beam in beams)
    ]
    lights_patch = any(beam.meets(wall, watched) for beam in beams)
    if voxels_around and lit:
        return ERROR, f"comes from within {_voxels(voxels_around, every)}, where the hidden object is looked for"
    receivers = [*(["the watched patch"] if lights_patch else []), *([_voxels(lit, every)] if lit else [])]
    if lights_patch:
        return WARNING, f"falls directly on {' and '.join(receivers)}, and outshines what the hidden object adds"
    if lit:
        return WARNING, f"falls directly on {receivers[0]}: the object is seen there not by the lit patch alone"
    if not any(beam.counts for beam in beams):
        return None
    return NOTE, "is in the scene too, hidden from the watched patch and from the voxels"


def _any_inside(points: Array, lo: Array, hi: Array) -> bool:
    return bool(_inside(points, lo, hi).any())


def _inside(points: Array, lo: Array, hi: Array) -> Array:
    within: Array = ((points > lo) & (points < hi)).all(axis=1)
    return within


def _voxels(labels: Sequence[str], every: Sequence[str]) -> str:
    if len(labels) == 1:
        return f"voxel {labels[0]}"
    first = every.index(labels[0])
    in_a_row = len(labels) > 3 and list(labels) == list(every[first : first + len(labels)])
    listed = f"{labels[0]} to {labels[-1]}" if in_a_row else ", ".join(labels)
    return f"voxels {listed}"
