"""Worlds that differ a little from one another: what a person knows of a room only approximately.

The names, and what an offset of each means, are those of `OFFSETS`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from generator.model.arrays import Array
from generator.model.errors import NlosError, instead
from generator.transport.cone import patch_lit
from generator.transport.world import Body, LitPatch, Mesh, Sphere, Watched, World

OFFSETS = {
    **{f"spot.location.{axis}": "metres" for axis in "xyz"},
    **{f"spot.aim.{axis}": "metres" for axis in "xz"},
    "spot.half_angle": "degrees",
    "spot.power": "relative",
    **{f"camera.location.{axis}": "metres" for axis in "xyz"},
    **{f"camera.view.{axis}": "metres" for axis in "xz"},
    "wall.albedo": "absolute",
    "room.albedo": "absolute",
    "target.albedo": "absolute",
    "target.size": "relative",
    "ambient": "relative",
}
"""What an offset can be of, and its unit; "relative" is a share of the world's own value.

As the fields of a `generator.model.scene.Scene` do, ``spot.location`` leaves the lit point (``spot.aim``) in place,
and ``camera.location`` leaves the watched rectangle, which ``camera.view`` moves along the wall.
"""

_RIM = 64
"""Points of the outline of the lit patch, and of the watched rectangle, from which the view is tested."""


def with_parameters(world: World, offsets: Mapping[str, float]) -> World:
    """Return a world with some of its values changed.

    Albedos of surfaces that differ are changed by one factor, so that their mean (over colour channels and area;
    black surfaces, which stay black, do not count) changes by the offset.

    Parameters
    ----------
    world : World
    offsets : mapping
        What is added to values, by names and in units of `OFFSETS`.

    Raises
    ------
    NlosError
        There is no such value; an offset is not finite; a value would leave its range (an albedo 0 to 1, a power, a
        size); the lamp's cone or the camera's view would no longer lie on the wall, or something would stand in it.

    Examples
    --------
    >>> moved = with_parameters(world, {"spot.aim.x": 0.02, "wall.albedo": -0.05})        # doctest: +SKIP
    """
    for name, value in offsets.items():
        if name not in OFFSETS:
            raise NlosError(f"{name!r} is nothing of a scene that can be off; {instead(name, OFFSETS.keys())}")
        if not math.isfinite(value):
            raise NlosError(f"{name}: {value} is not a finite number")
    given = {name: float(value) for name, value in offsets.items() if value}
    changed = _ambient(_room(_wall(world, given), given), given)
    changed = replace(
        changed,
        patch=_lit(changed.patch, given),
        watched=_watched(changed.watched, given),
        target=_target(changed.target, given),
    )
    _refuse_out_of_sight(changed, given)
    return changed


def _vector(offsets: Mapping[str, float], name: str) -> Array:
    """Return the offset of a place or of a point on the wall, (3,)."""
    return np.array([offsets.get(f"{name}.{axis}", 0.0) for axis in "xyz"])


def _factor(offsets: Mapping[str, float], name: str) -> float:
    """Return the factor on a value whose offset is relative."""
    factor = 1.0 + offsets.get(name, 0.0)
    if not factor > 0.0:
        raise NlosError(f"{name}: {offsets[name]:+g} of its value leaves nothing of it; take an offset above -1")
    return factor


def _lit(patch: LitPatch, offsets: Mapping[str, float]) -> LitPatch:
    power = _factor(offsets, "spot.power")
    moves = {name for name in offsets if name.startswith(("spot.location", "spot.aim", "spot.half_angle"))}
    if not moves:
        return replace(patch, intensity=power * patch.intensity)
    aim = patch.lamp + patch.height / float(-patch.axis @ patch.normal) * patch.axis
    shift = _vector(offsets, "spot.aim")
    aim = aim + shift - (shift @ patch.normal) * patch.normal
    lamp = patch.lamp + _vector(offsets, "spot.location")
    way = aim - lamp
    axis = way / np.linalg.norm(way)
    half_angle = math.acos(patch.cos_outer) + math.radians(offsets.get("spot.half_angle", 0.0))
    if not half_angle > 0.0:
        raise NlosError(f"spot.half_angle: {offsets['spot.half_angle']:+g} degrees leave no cone")
    if not (lamp - aim) @ patch.normal > 0.0:
        raise NlosError("spot.location: the lamp would stand behind the relay wall")
    moved = patch_lit(
        *(lamp, axis, aim, patch.normal),
        half_angle=half_angle,
        blend=patch.cos_width / (1.0 - patch.cos_outer),
        intensity=power * patch.intensity,
        albedo=patch.albedo,
    )
    if moved is None:
        raise NlosError("spot.location: the lamp would graze the wall, so that its patch has no edge")
    return moved


def _watched(watched: Watched, offsets: Mapping[str, float]) -> Watched:
    shift = _vector(offsets, "camera.view")
    shift = shift - (shift @ watched.normal) * watched.normal
    to_wall = watched.to_wall.copy()
    to_wall[:3] += np.outer(shift, to_wall[3])
    step, eye = _vector(offsets, "camera.location"), watched.eye.copy()
    if eye[3]:
        eye[:3] += step
        if not (eye[:3] - watched.points(np.array([0.5, 0.5]))) @ watched.normal > 0.0:
            raise NlosError("camera.location: the camera would stand behind the relay wall")
    else:  # only how far an orthographic camera is from the wall matters
        away = eye[:3] / np.linalg.norm(eye[:3])
        eye[:3] += (step @ away) * away
        if not eye[:3] @ away > 0.0:
            raise NlosError("camera.location: the camera would stand behind the relay wall")
    return replace(watched, to_wall=to_wall, eye=eye)


def _wall(world: World, offsets: Mapping[str, float]) -> World:
    if "wall.albedo" not in offsets:
        return world
    factor = _albedo_factor("wall.albedo", float(world.watched.albedo.mean()), offsets)
    wall = world.wall
    return replace(
        world,
        patch=replace(world.patch, albedo=_reflecting("wall.albedo", factor * world.patch.albedo)),
        watched=replace(world.watched, albedo=_reflecting("wall.albedo", factor * world.watched.albedo)),
        wall=None if wall is None else replace(wall, albedo=_reflecting("wall.albedo", factor * wall.albedo)),
    )


def _room(world: World, offsets: Mapping[str, float]) -> World:
    if "room.albedo" not in offsets:
        return world
    factor = _albedo_factor("room.albedo", mean_albedo(world.room), offsets)
    room = [replace(mesh, albedo=_reflecting("room.albedo", factor * mesh.albedo)) for mesh in world.room]
    return replace(world, room=tuple(room))


def _target(target: tuple[Body, ...], offsets: Mapping[str, float]) -> tuple[Body, ...]:
    size = _factor(offsets, "target.size")
    factor = 1.0
    if "target.albedo" in offsets:
        if any(body.gloss is not None for body in target):
            raise NlosError("target.albedo: cannot be off where the target is glossy; leave it out")
        factor = _albedo_factor("target.albedo", mean_albedo(target), offsets)

    def body(old: Body) -> Body:
        albedo = _reflecting("target.albedo", factor * old.albedo)
        if isinstance(old, Sphere):
            return replace(old, centre=size * old.centre, radius=size * old.radius, albedo=albedo)
        return replace(old, triangles=size * old.triangles, albedo=albedo)

    return tuple(map(body, target))


def _ambient(world: World, offsets: Mapping[str, float]) -> World:
    if "ambient" not in offsets:
        return world
    if world.ambient is None:
        raise NlosError("ambient: the scene has no ambient light that could be off; give it some, or leave it out")
    radiance = _factor(offsets, "ambient") * world.ambient.radiance
    return replace(world, ambient=replace(world.ambient, radiance=radiance))


def mean_albedo(bodies: tuple[Body, ...]) -> float:
    """Return the mean albedo of surfaces over colour channels and area, without black ones; 0 if all are black."""
    areas, albedos = [np.zeros(0)], [np.zeros(0)]
    for body in bodies:
        if isinstance(body, Mesh):
            a, b, c = np.moveaxis(body.triangles, 1, 0)
            areas.append(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0)
            albedos.append(body.albedo.mean(axis=1))
        else:
            areas.append(np.array([4.0 * math.pi * body.radius**2]))
            albedos.append(np.array([body.albedo.mean()]))
    area, albedo = np.concatenate(areas), np.concatenate(albedos)
    area = np.where(albedo > 0.0, area, 0.0)
    return float(area @ albedo / area.sum()) if area.any() else 0.0


def _albedo_factor(name: str, mean: float, offsets: Mapping[str, float]) -> float:
    if not mean > 0.0:
        raise NlosError(f"{name}: there is no surface that reflects and could be off; leave it out")
    factor = (mean + offsets[name]) / mean
    if factor < 0.0:
        raise NlosError(f"{name}: {mean:g} {offsets[name]:+g} is below 0")
    return factor


def _reflecting(name: str, albedo: Array) -> Array:
    highest = float(albedo.max(initial=0.0))
    if highest > 1.0 + 1e-6:
        raise NlosError(f"{name}: a surface would reflect {highest:.4g} of the light, more than all; take less")
    return np.minimum(albedo, 1.0)


def _refuse_out_of_sight(world: World, offsets: Mapping[str, float]) -> None:
    """Raise NlosError if the lamp's cone or the camera's view leaves the wall or meets the room, by its outline."""
    patch, watched = world.patch, world.watched
    turns = np.arange(_RIM)[:, None] * (2.0 * math.pi / _RIM)
    t = np.linspace(0.0, 1.0, _RIM // 4 + 1)[:, None]
    edge = np.concatenate([np.hstack(side) for side in ((t, 0 * t), (t, 0 * t + 1), (0 * t, t), (0 * t + 1, t))])
    view = watched.points(1e-5 + (1.0 - 2e-5) * edge)
    eyes = np.broadcast_to(watched.eye[:3], view.shape) if watched.eye[3] else view + watched.eye[:3]
    rim = patch.centre + 0.999 * (np.cos(turns) * patch.major + np.sin(turns) * patch.minor)
    lamps = np.broadcast_to(patch.lamp, rim.shape)
    for name, what, starts, ends in (
        ("spot", "the lamp's cone", lamps, rim),
        ("camera", "the camera's view", eyes, view),
    ):
        if not any(one.startswith(name) for one in offsets):
            continue
        if world.wall is not None and not _met(world.wall.triangles, starts, ends, 1.0 + 1e-3).all():
            raise NlosError(f"{name}: {what} would leave the relay wall")
        if any(_met(mesh.triangles, starts, ends, 1.0 - 1e-3).any() for mesh in world.room):
            raise NlosError(f"{name}: something of the room would stand in {what}")


def _met(triangles: Array, starts: Array, ends: Array, farthest: float) -> Array:
    """Return which lines (n,) from starts to ends (n, 3) meet a triangle of (m, 3, 3), up to ``farthest`` of their
    length (Moeller and Trumbore 1997)."""
    ways = ends - starts
    a = triangles[:, 0] - starts[:, None]
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normals = np.cross(first, second)
    slope = ways @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (a * normals).sum(axis=2) / slope
        across = np.cross(ways[:, None], a)
        u, v = -(across * second).sum(axis=2) / slope, (across * first).sum(axis=2) / slope
        met = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (distance > 0.0) & (distance < farthest)
    return np.asarray((met & (slope != 0.0)).any(axis=1))
