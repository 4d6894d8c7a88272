"""Converts an evaluated Blender scene to the plain arrays that engines need; reports what they cannot honour."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from generator.blender.engines import coincident
from generator.blender.engines.at_rest import refuse_moving
from generator.blender.engines.lit_patch import other_lights, read_lit_patch
from generator.blender.engines.shapes import MULTIPLE, ROUGHNESS, TINT
from generator.blender.engines.surface import Light, Reading, Surface
from generator.blender.engines.watched import read_watched
from generator.blender.scene import geometry, nodes, posing, roles
from generator.blender.scene.quiet import Overrides
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.transport.world import (
    MOST_EMITTERS,
    MOST_SURFACES,
    SMOOTHEST,
    AmbientLight,
    Emitters,
    Gloss,
    LitPatch,
    Mesh,
    Sphere,
    World,
)

_SPHERE_FACES = 80
_SPHERE_ROUND = 1e-3


@dataclass(frozen=True)
class Survey:
    """A scene as each engine needs it, and what each cannot honour, in phrases that name the object.

    Attributes
    ----------
    scene : str
        File of the scene.
    never : list of str
        Reasons why no engine can sweep the scene.
    patch : LitPatch or None
        The lit patch; None if `patch` cannot honour something.
    patch_reasons : list of str
        What `patch` cannot honour, in addition to `never`.
    world : World or None
        Input of `surfel`; None if it cannot honour something.
    surfel_reasons : list of str
        What `surfel` cannot honour, in addition to `never`; includes all of `patch_reasons`.
    lights : list of Light
        All light sources, including the spot.
    kinds : frozenset of str
        Kinds of scattering of all rendered materials (`nodes.kinds`).
    """

    scene: str
    never: list[str]
    patch: LitPatch | None
    patch_reasons: list[str]
    world: World | None
    surfel_reasons: list[str]
    lights: list[Light]
    kinds: frozenset[str]

    @property
    def alone(self) -> bool:
        """Whether the spot is the only light source."""
        return not other_lights(self.lights)

    @property
    def mirrors(self) -> bool:
        """Whether anything but a diffuse surface reflects, so that rays must be able to hit a lamp by chance."""
        return bool(self.kinds - {nodes.DIFFUSE, nodes.TRANSPARENT})

    def reasons(self, engine: str) -> list[str]:
        """Return what an engine cannot honour."""
        by_engine = {"path": [], "patch": self.patch_reasons, "surfel": self.surfel_reasons}
        return list(dict.fromkeys([*self.never, *by_engine[engine]]))

    def check(self, engine: str) -> None:
        """Raise NlosError, naming all reasons and an engine that can, if an engine cannot honour the scene."""
        if self.never:
            raise NlosError(f"{self.scene}: cannot be swept: {'; '.join(self.never)}")
        if reasons := self.reasons(engine):
            alternative = "path" if self.patch_reasons else "patch"
            listed = ", nor that ".join(reasons)
            raise NlosError(
                f"{self.scene}: the engine {engine!r} cannot honour that {listed}; use --engine {alternative}"
            )


def survey(scene: bpy.types.Scene, *, resolution: tuple[int, int] | None = None) -> Survey:
    """Read a scene as a render sees it, for all engines.

    Parameters
    ----------
    scene : bpy.types.Scene
        The target is moved in the process, and put back.
    resolution : (int, int), optional
        Width and height of the pictures; the scene's own if not given.

    Raises
    ------
    NlosError
        A role is missing or played twice, or the scene cannot be read.
    """
    spot, camera, target = (roles.find(scene, role) for role in ("spot", "camera", "target"))
    with Overrides() as overrides:
        size = geometry.shape_pictures(scene, resolution, overrides)
        with posing.put_back(scene):
            reading, never = refuse_moving(scene, target)
        never += _foreign_colours()
        patch, patch_reasons = read_lit_patch(scene, reading)
        watched, view_reasons = read_watched(scene, reading, size)
    reasons = [*patch_reasons, *view_reasons, *reading.reasons]
    walls = [s for s in reading.surfaces if s.role == "relay_wall"]
    sky = None if reading.sky is None else AmbientLight(reading.sky)
    if patch is not None and watched is not None and patch.normal @ watched.normal < 0:
        reasons.append(f"the camera {camera.name!r} and the spot {spot.name!r} stand on opposite sides of the wall")
    order = roles.reflection_order(scene)
    origin = reading.places["target"][:3, 3]
    parts = [s for s in reading.surfaces if s.role == "target"]
    spheres = [_sphere(part, origin) for part in parts]
    bodies = [sphere or _mesh([part], origin) for sphere, part in zip(spheres, parts, strict=True)]
    names = _room(reading)
    room = [_mesh([s for s in reading.surfaces if s.role == "room" and s.name == name]) for name in names]
    for surface in reading.surfaces:
        reasons += surface.flaws
    smooth = [s for s in reading.surfaces if s.smooth and s.role != "target"]
    smooth += [part for sphere, part in zip(spheres, parts, strict=True) if part.smooth and sphere is None]
    reasons += [f"{s.label} is shaded smooth, so that it reflects as if it were curved" for s in smooth]
    reasons += _coincident(reading, patch)
    reasons += _gloss_reasons(reading, parts, order)
    emitters = _emitters(reading)
    if order > 3 or sky is not None or emitters is not None:
        reasons += _too_many([*room, *([_mesh(walls)] if walls else [])])
    if emitters is not None and len(emitters.triangles) > MOST_EMITTERS:
        reasons.append(f"{len(emitters.triangles)} triangles give light, more than {MOST_EMITTERS}")
    if hidden := roles.unseen(scene, target):
        reasons.append(f"the target {target.name!r} {hidden}")
    elif not bodies:
        reasons.append(f"the target {target.name!r} has no surface to reflect light")
    surfel_input = None
    if not (never or reasons) and patch is not None and watched is not None:
        surfel_input = World(
            *(patch, watched, tuple(bodies), tuple(room)),
            order=order,
            ambient=sky,
            wall=_mesh(walls),
            emitters=emitters,
        )
    return Survey(
        scene=bpy.data.filepath or "scene",
        never=list(dict.fromkeys(never)),
        patch=None if patch_reasons else patch,
        patch_reasons=list(dict.fromkeys(patch_reasons)),
        world=surfel_input,
        surfel_reasons=list(dict.fromkeys(reasons)),
        lights=reading.lights,
        kinds=frozenset().union(*reading.kinds.values()),
    )


def _gloss_reasons(reading: Reading, parts: Sequence[Surface], order: int) -> list[str]:
    """Why the light of a glossy target cannot be followed."""
    glossy = [(part, part.gloss[part.gloss[:, TINT:ROUGHNESS].any(axis=1), ROUGHNESS]) for part in parts]
    glossy = [(part, roughness) for part, roughness in glossy if len(roughness)]
    if not glossy:
        return []
    label = glossy[0][0].label
    reasons = []
    smoothest, roughness = min(glossy, key=lambda pair: float(pair[1].min()))
    if roughness.min() < SMOOTHEST:
        reasons.append(
            f"{smoothest.label} has a glossy roughness of {roughness.min():.3g}, and reflections are followed from "
            f"{SMOOTHEST:g} on"
        )
    if order > 3:
        reasons.append(f"{label} is glossy, which is followed up to a reflection order of 3, not {order}")
    for light in other_lights(reading.lights)[:1]:
        reasons.append(f"{label} is glossy, which is followed in the spot's light, and {light.name!r} shines too")
    unseen = [s for s in reading.surfaces if s.role in ("room", "target") and "glossy" in s.unseen_by]
    reasons += [f"{s.label} is not visible to glossy rays, and {label} is glossy" for s in unseen]
    return reasons


def _emitters(reading: Reading) -> Emitters | None:
    """Return what gives light besides the spot and the sky; None if nothing does."""
    triangles, radiance = [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    for surface in reading.surfaces:
        shining = surface.radiance.any(axis=1)
        for faces in (surface.triangles[shining], surface.triangles[shining][:, ::-1]):  # both sides give light
            triangles.append(faces)
            radiance.append(surface.radiance[shining])
    softness = [np.zeros(sum(map(len, triangles)))]
    places, intensity = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for glow in reading.glowing:
        softness.append(np.full(len(glow.triangles), glow.softness))
        triangles.append(glow.triangles)
        radiance.append(np.tile(glow.radiance, (len(glow.triangles), 1)))
        places.append(glow.places)
        intensity.append(np.tile(glow.intensity, (len(glow.places), 1)))
    softness.append(np.zeros(sum(map(len, places))))
    parts = [np.concatenate(part) for part in (triangles, radiance, places, intensity, softness)]
    return Emitters(*parts) if len(parts[0]) + len(parts[2]) else None


def _too_many(meshes: Sequence[Mesh]) -> list[str]:
    """Why light of more than three reflections, or other than the spot's, cannot be followed across surfaces."""
    count = sum(len(mesh.triangles) for mesh in meshes)
    if count <= MOST_SURFACES:
        return []
    return [f"the room has {count} triangles, over which neither other light nor a fourth reflection is followed"]


def _foreign_colours() -> list[str]:
    """Return why a scene in a project of Blender 5.3 cannot be swept: its copy in a set would have other colours."""
    if getattr(getattr(bpy.data, "colorspace", None), "ocio_config_source", "") != "PROJECT":
        return []
    project: Any = bpy.data.project  # type: ignore[attr-defined]
    return [
        f"its colours follow the OpenColorIO configuration of the project {project.root_path}, which a data set does "
        "not keep; give the project Blender's own configuration, or take the scene out of it"
    ]


def _coincident(reading: Reading, patch: LitPatch | None) -> list[str]:
    """Return phrases that name coincident surfaces: Cycles sees one, but a sum over surfaces counts both."""
    reasons = []
    moving = [s for s in reading.surfaces if s.role == "target"]
    static = [s for s in reading.surfaces if s.role != "target"]
    for group in (moving, static):
        if not group:
            continue
        triangles = np.concatenate([s.triangles for s in group])
        owner = np.repeat(np.arange(len(group)), [len(s.triangles) for s in group])
        pairs = coincident.overlapping(triangles)
        if group is static and patch is not None:
            sealed = np.concatenate([_sealed(s, patch.centre) for s in static])
            pairs = pairs[~sealed[pairs].any(axis=1)]
        for a, b in np.unique(owner[pairs], axis=0):
            first, second = group[a], group[b]
            phrase = f"parts of {first.label} lie" if a == b else f"{first.label} and {second.label} lie"
            reasons.append(f"{phrase} on one another, so that their light would count twice")
    return list(dict.fromkeys(reasons))


def _sealed(surface: Surface, source: Array) -> Array:
    """Which triangles (n,) of a closed surface face away from a point (3,), such as the bottom of a cupboard."""
    a, b, c = (surface.triangles[:, i] - source for i in range(3))
    volumes = (np.cross(a, b) * c).sum(axis=1)
    # Six times the signed volume: a negative sum means an inverted surface; single signs tell the point's side.
    faces_away = volumes * np.sign(volumes.sum()) > 0.0
    return faces_away if surface.closed else np.zeros(len(a), dtype=bool)


def lit_patch(scene: bpy.types.Scene) -> LitPatch:
    """Return the lit patch of a scene; raise NlosError if it has none in closed form.

    Raises
    ------
    NlosError
        As `Survey.check` for the engine `patch`.
    """
    result = survey(scene)
    result.check("patch")
    assert result.patch is not None
    return result.patch


def surfel_world(scene: bpy.types.Scene, *, resolution: tuple[int, int] | None = None) -> World:
    """Return the input of the engine `surfel` for a scene, if it can render the scene.

    Raises
    ------
    NlosError
        As `Survey.check` for the engine `surfel`.
    """
    result = survey(scene, resolution=resolution)
    result.check("surfel")
    assert result.world is not None
    return result.world


def world(scene: bpy.types.Scene, *, resolution: tuple[int, int] | None = None) -> tuple[World | None, list[str]]:
    """Return the input of the engine `surfel` for a scene, or None, and what it cannot honour; see `survey`."""
    result = survey(scene, resolution=resolution)
    return result.world, result.reasons("surfel")


def room_names(scene: bpy.types.Scene) -> list[str]:
    """Return the names of the objects that `world` calls the room, in its order."""
    with Overrides(), posing.put_back(scene):
        return _room(refuse_moving(scene, roles.find(scene, "target"))[0])


def _room(reading: Any) -> list[str]:
    return list(dict.fromkeys(s.name for s in reading.surfaces if s.role == "room"))


# --------------------------------------------------------------------------------------------------------------------
# Bodies for the integral
# --------------------------------------------------------------------------------------------------------------------


def _mesh(surfaces: Sequence[Surface], origin: Any = 0.0) -> Mesh:
    return Mesh(
        triangles=np.concatenate([s.triangles for s in surfaces]) - origin,
        albedo=np.concatenate([s.albedo for s in surfaces]),
        gloss=_gloss(np.concatenate([s.gloss for s in surfaces])),
    )


def _gloss(rows: Array) -> Gloss | None:
    """Return gloss (n, GLOSS) as the engine takes it; None if nothing is glossy."""
    if not rows[:, TINT:ROUGHNESS].any():
        return None
    return Gloss(rows[:, TINT:ROUGHNESS], rows[:, ROUGHNESS], rows[:, MULTIPLE:])


def _sphere(surface: Surface, origin: Array) -> Sphere | None:
    """Return the sphere that a finely tessellated ball approximates, with the mesh's own area; else None."""
    look = np.column_stack([surface.albedo, surface.gloss])
    if not surface.closed or surface.faces < _SPHERE_FACES or np.ptp(look, axis=0).any():
        return None
    gloss = _gloss(surface.gloss[:1])
    # Faces that turn the light by more than the facets' slopes spread it are seen one by one.
    if gloss is not None and math.sqrt(4.0 * math.pi / surface.faces) > gloss.roughness[0] ** 2:
        return None
    corners = np.unique((surface.triangles - origin).reshape(-1, 3), axis=0)
    middle = corners.mean(axis=0)
    offsets = corners - middle
    squared = (offsets**2).sum(axis=1)
    # |x - c|^2 = r^2 is linear in c and in r^2 - c^2.
    system = np.column_stack([2.0 * offsets, np.full(len(offsets), math.sqrt(squared.max()))])
    shift = np.linalg.lstsq(system, squared, rcond=None)[0][:3]
    centre = middle + shift
    distances = np.linalg.norm(offsets - shift, axis=1)
    mean = float(distances.mean())
    if np.abs(distances - mean).max() > _SPHERE_ROUND * mean:
        return None
    local = surface.triangles - origin - centre
    sides = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
    doubled = np.linalg.norm(sides, axis=1)
    # A truncated ball has its corners on the sphere too, but its flat face is not near it.
    if (np.abs((sides * local[:, 0]).sum(axis=1)) < 0.85 * mean * doubled).any():
        return None
    radius = math.sqrt(doubled.sum() / 2.0 / (4.0 * math.pi))
    if not 0.85 * mean < radius < (1.0 + _SPHERE_ROUND) * mean:  # larger, for example: two balls in one
        return None
    return Sphere(centre=centre, radius=radius, albedo=surface.albedo[0], gloss=gloss)
