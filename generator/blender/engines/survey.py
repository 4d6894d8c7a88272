"""Evaluated Blender scene -> what an engine needs of it, in plain arrays; says what it could not honour."""

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
from generator.blender.engines.reading import MAX_ORDER
from generator.blender.engines.surface import Light, Reading, Surface
from generator.blender.engines.watched import read_watched
from generator.blender.scene import geometry, nodes, posing, roles
from generator.blender.scene.quiet import Overrides
from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.transport.world import AmbientLight, LitPatch, Mesh, Sphere, World

_SPHERE_FACES = 80
_SPHERE_ROUND = 1e-3


@dataclass(frozen=True)
class Survey:
    """What a scene holds for each engine, and what each cannot honour: a phrase each that names the object.

    Attributes
    ----------
    scene : str
        Its file.
    never : list of str
        Why it cannot be swept by any engine.
    patch : LitPatch or None
        None if `patch` cannot honour something.
    patch_reasons : list of str
        What `patch` cannot, besides.
    world : World or None
        What `surfel` needs of it; None if it cannot honour something.
    surfel_reasons : list of str
        What `surfel` cannot, besides; all of `patch_reasons` among it.
    lights : list of Light
        All that give light; the spot too.
    kinds : frozenset of str
        How the materials of all that is rendered send light on (`nodes.kinds`).
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
        """Whether nothing but the spot gives light."""
        return not other_lights(self.lights)

    @property
    def mirrors(self) -> bool:
        """Whether anything but a diffuse surface reflects, so that rays must be able to meet a lamp by chance."""
        return bool(self.kinds - {nodes.DIFFUSE, nodes.TRANSPARENT})

    def reasons(self, engine: str) -> list[str]:
        """Return what an engine cannot honour."""
        more = {"path": [], "patch": self.patch_reasons, "surfel": self.surfel_reasons}
        return list(dict.fromkeys([*self.never, *more[engine]]))

    def check(self, engine: str) -> None:
        """Raise NlosError, naming everything and the engine that can, if an engine cannot honour the scene."""
        if self.never:
            raise NlosError(f"{self.scene}: cannot be swept: {'; '.join(self.never)}")
        if reasons := self.reasons(engine):
            instead = "path" if self.patch_reasons else "patch"
            what = ", nor that ".join(reasons)
            raise NlosError(f"{self.scene}: the engine {engine!r} cannot honour that {what}; use --engine {instead}")


def survey(scene: bpy.types.Scene, *, resolution: tuple[int, int] | None = None, ambient: bool = False) -> Survey:
    """Read a scene as a render sees it, for all engines.

    Parameters
    ----------
    scene : bpy.types.Scene
        The target is moved on the way, and put back.
    resolution : (int, int), optional
        Of the pictures, width and height; the scene's own if not given.
    ambient : bool
        Whether `surfel` may follow uniform ambient light, which is right to a few per cent only; else it is a reason.

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
        patch, patch_reasons = read_lit_patch(scene, reading)
        watched, view_reasons = read_watched(scene, reading, size)
    reasons = [*patch_reasons, *view_reasons, *reading.reasons]
    sky = None
    if reading.sky is not None and ambient:
        walls = [s for s in reading.surfaces if s.role == "relay_wall"]
        sky = AmbientLight(reading.sky, _mesh(walls)) if walls else None
    elif reading.sky is not None:
        [name] = [light.name for light in reading.lights if light.kind == "WORLD"]
        reasons.append(f"the world {name!r} gives ambient light")
    if patch is not None and watched is not None and patch.normal @ watched.normal < 0:
        reasons.append(f"the camera {camera.name!r} and the spot {spot.name!r} stand on opposite sides of the wall")
    order = roles.reflection_order(scene)
    if order > MAX_ORDER:
        reasons.append(f"the reflection order is {order}, and surfel stops at {MAX_ORDER}")
    origin = reading.places["target"][:3, 3]
    parts = [s for s in reading.surfaces if s.role == "target"]
    spheres = [_sphere(part, origin) for part in parts]
    bodies = [sphere or _mesh([part], origin) for sphere, part in zip(spheres, parts, strict=True)]
    named = _room(reading)
    room = [_mesh([s for s in reading.surfaces if s.role == "room" and s.name == name]) for name in named]
    for surface in reading.surfaces:
        reasons += surface.flaws
    bent = [s for s in reading.surfaces if s.smooth and s.role != "target"]
    bent += [part for sphere, part in zip(spheres, parts, strict=True) if part.smooth and sphere is None]
    reasons += [f"{s.label} is shaded smooth, so that it reflects as if it were curved" for s in bent]
    reasons += _coincident(reading, patch)
    if why := roles.unseen(scene, target):
        reasons.append(f"the target {target.name!r} {why}")
    elif not bodies:
        reasons.append(f"the target {target.name!r} has no surface to reflect light")
    whole = None
    if not (never or reasons) and patch is not None and watched is not None:
        whole = World(patch=patch, watched=watched, target=tuple(bodies), room=tuple(room), order=order, ambient=sky)
    return Survey(
        scene=bpy.data.filepath or "scene",
        never=list(dict.fromkeys(never)),
        patch=None if patch_reasons else patch,
        patch_reasons=list(dict.fromkeys(patch_reasons)),
        world=whole,
        surfel_reasons=list(dict.fromkeys(reasons)),
        lights=reading.lights,
        kinds=frozenset().union(*reading.kinds.values()),
    )


def _coincident(reading: Reading, patch: LitPatch | None) -> list[str]:
    """Name surfaces that lie on one another, of which Cycles sees one and a sum over surfaces both."""
    reasons = []
    moving = [s for s in reading.surfaces if s.role == "target"]
    still = [s for s in reading.surfaces if s.role != "target"]
    for together in (moving, still):
        if not together:
            continue
        triangles = np.concatenate([s.triangles for s in together])
        owner = np.repeat(np.arange(len(together)), [len(s.triangles) for s in together])
        pairs = coincident.overlapping(triangles)
        if together is still and patch is not None:
            sealed = np.concatenate([_sealed(s, patch.centre) for s in still])
            pairs = pairs[~sealed[pairs].any(axis=1)]
        for a, b in np.unique(owner[pairs], axis=0):
            one, other = together[a], together[b]
            what = f"parts of {one.label} lie" if a == b else f"{one.label} and {other.label} lie"
            reasons.append(f"{what} on one another, so that their light would count twice")
    return list(dict.fromkeys(reasons))


def _sealed(surface: Surface, source: Array) -> Array:
    """Which triangles (n,) of a closed surface face away from a point (3,): a cupboard's foot, say."""
    a, b, c = (surface.triangles[:, i] - source for i in range(3))
    volumes = (np.cross(a, b) * c).sum(axis=1)
    # Six times the signed volume: negative ones are inside out. Those of single faces say on which side the point is.
    faces_away = volumes * np.sign(volumes.sum()) > 0.0
    return faces_away if surface.closed else np.zeros(len(a), dtype=bool)


def lit_patch(scene: bpy.types.Scene) -> LitPatch:
    """Return the lit patch of a scene, or say why it has none in closed form.

    Raises
    ------
    NlosError
        `Survey.check` of the engine `patch`.
    """
    found = survey(scene)
    found.check("patch")
    assert found.patch is not None
    return found.patch


def surfel_world(scene: bpy.types.Scene, *, resolution: tuple[int, int] | None = None) -> World:
    """Return what the engine `surfel` needs of a scene, ambient light too, or say why it cannot render it.

    Raises
    ------
    NlosError
        `Survey.check` of the engine `surfel`.
    """
    found = survey(scene, resolution=resolution, ambient=True)
    found.check("surfel")
    assert found.world is not None
    return found.world


def world(
    scene: bpy.types.Scene, *, resolution: tuple[int, int] | None = None, ambient: bool = False
) -> tuple[World | None, list[str]]:
    """Return what the engine `surfel` needs of a scene, or None, and what it cannot honour; see `survey`."""
    found = survey(scene, resolution=resolution, ambient=ambient)
    return found.world, found.reasons("surfel")


def room_names(scene: bpy.types.Scene) -> list[str]:
    """Return the names of the objects that `world` calls the room, in its order."""
    with Overrides(), posing.put_back(scene):
        return _room(refuse_moving(scene, roles.find(scene, "target"))[0])


def _room(reading: Any) -> list[str]:
    return list(dict.fromkeys(s.name for s in reading.surfaces if s.role == "room"))


# --------------------------------------------------------------------------------------------------------------------
# Reading the scene as a render sees it
# --------------------------------------------------------------------------------------------------------------------


def _mesh(surfaces: Sequence[Surface], origin: Any = 0.0) -> Mesh:
    return Mesh(
        triangles=np.concatenate([s.triangles for s in surfaces]) - origin,
        albedo=np.concatenate([s.albedo for s in surfaces]),
    )


def _sphere(surface: Surface, origin: Array) -> Sphere | None:
    """Return the sphere that a finely tessellated ball stands for: the one with the mesh's own area; else None."""
    if not surface.closed or surface.faces < _SPHERE_FACES or np.ptp(surface.albedo, axis=0).any():
        return None
    corners = np.unique((surface.triangles - origin).reshape(-1, 3), axis=0)
    middle = corners.mean(axis=0)
    around = corners - middle
    squared = (around**2).sum(axis=1)
    # |x - c|^2 = r^2 is linear in c and in r^2 - c^2.
    system = np.column_stack([2.0 * around, np.full(len(around), math.sqrt(squared.max()))])
    shift = np.linalg.lstsq(system, squared, rcond=None)[0][:3]
    centre = middle + shift
    distances = np.linalg.norm(around - shift, axis=1)
    mean = float(distances.mean())
    if np.abs(distances - mean).max() > _SPHERE_ROUND * mean:
        return None
    local = surface.triangles - origin - centre
    sides = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
    doubled = np.linalg.norm(sides, axis=1)
    # A ball cut off flat has its corners on the sphere too; its faces are not near it.
    if (np.abs((sides * local[:, 0]).sum(axis=1)) < 0.85 * mean * doubled).any():
        return None
    radius = math.sqrt(doubled.sum() / 2.0 / (4.0 * math.pi))
    if not 0.85 * mean < radius < (1.0 + _SPHERE_ROUND) * mean:  # two balls in one
        return None
    return Sphere(centre=centre, radius=radius, albedo=surface.albedo[0])


# --------------------------------------------------------------------------------------------------------------------
# The lit patch
# --------------------------------------------------------------------------------------------------------------------


# --------------------------------------------------------------------------------------------------------------------
# The watched patch
# --------------------------------------------------------------------------------------------------------------------


# --------------------------------------------------------------------------------------------------------------------
# What is in the way: exactly, not by probing
# --------------------------------------------------------------------------------------------------------------------
