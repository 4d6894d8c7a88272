"""A world prepared for summing: in the wall's own frame and unit, surfaces as cells and as obstacles of rays."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.model.arrays import Array
from generator.model.errors import NlosError
from generator.transport import elements, gloss
from generator.transport.faces import Faces
from generator.transport.lit import Patch, chord_rules, whole_rules
from generator.transport.obstacles import SUNK, Obstacles
from generator.transport.rays import Surfaces
from generator.transport.world import SMOOTHEST, Emitters, Mesh, Sphere, Watched, World

Floats = NDArray[Any]


_whole_rules = lru_cache(maxsize=4)(whole_rules)
"""A set of many targets has one patch, and its rules take longer than a picture."""


class Frame:
    """The wall's own frame and unit: origin in the middle of the watched patch, third axis the wall's normal.

    The unit is half the watched patch's diagonal. All scenes then have the same size, so scenes of millimetres or of
    kilometres neither over- nor underflow, and coordinates keep their digits wherever the scene is.
    """

    def __init__(self, watched: Watched) -> None:
        corners = watched.points(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]))
        self.origin = watched.points(np.array([0.5, 0.5]))
        self.unit = float(np.linalg.norm(corners - self.origin, axis=1).max())
        first = corners[1] - corners[0]
        first = first - (first @ watched.normal) * watched.normal
        first /= np.linalg.norm(first)
        self.axes = np.stack([first, np.cross(watched.normal, first), watched.normal])

    def points(self, world: Array) -> Array:
        """Return in this frame the points (..., 3) of the world's frame, metres."""
        local: Array = (world - self.origin) @ self.axes.T / self.unit
        return local

    def directions(self, world: Array) -> Array:
        """Return in this frame the directions (..., 3) of the world's frame; lengths are kept."""
        local: Array = world @ self.axes.T
        return local


class Emission(NamedTuple):
    """Light besides that of the spot and of the sky, in the wall's frame and unit.

    Attributes
    ----------
    triangles : ndarray of shape (n, 3, 3)
        Surfaces that give light, on the side from which their corners run counter-clockwise.
    radiance : ndarray of shape (n, groups)
    places : ndarray of shape (m, 3)
        Lamps without extent.
    intensity : ndarray of shape (m, groups)
    softness : ndarray of shape (n + m,)
        Radius of lamps with a soft falloff, of triangles and then of places.
    colour : ndarray of shape (3,)
        Radiance of the watched wall, W/m^2/sr, per unit of irradiance by these.
    """

    triangles: Floats
    radiance: Floats
    places: Floats
    intensity: Floats
    softness: Floats
    colour: Floats


class Setting:
    """A world in its wall's own frame.

    Attributes
    ----------
    frame : Frame
    resolution : (int, int)
    patch : lit.Patch
        Lit patch, of radiance 1 under the lamp.
    whole, chords : ndarray
        Quadrature rules of the patch (`lit.whole_rules`, `lit.chord_rules`).
    to_wall : ndarray of shape (3, 3)
        Projective map from (u, v, 1) to the wall's two axes.
    wall_radiance, factor : ndarray of shape (3,)
        Radiance, W/m^2/sr, of the lit patch under the lamp; and radiance per unit of the sums over the target.
    channel : list of int
        Group of albedos that each colour channel uses; there is one group if all surfaces are grey, and all emitters
        of one colour.
    flat, balls : ndarray
        The target's cells, in its own frame.
    tint : ndarray of shape (cells, groups)
        Albedo of the target's cells.
    shine : gloss.Shine or None
        Glossy reflection of the target's cells; None if none is glossy.
    faces : Faces
    target : Surfaces
        Surfaces of the target that rays can meet, in its own frame.
    convex : bool
        Whether the target is one convex body or one flat sheet, so that no part of it hides another.
    outward : ndarray of shape (surfaces,), bool, or None
        Whether the normal of each flat surface of the target leads out of a solid; None if not all are parts of one.
    room, around : Surfaces
        Surfaces of the room: without the relay wall, and with it if light is followed on (`World.is_followed_on`).
    sky : ndarray of shape (3,) or None
        Radiance, W/m^2/sr, of the watched wall where the whole sky lights it; None without a sky.
    emission : Emission or None

    Raises
    ------
    NlosError
        The target has no surface; or light is followed on, and the world has no relay wall.
    room_cells : ndarray
    obstacles : Obstacles
    """

    def __init__(self, world: World) -> None:
        watched, lit = world.watched, world.patch
        frame = self.frame = Frame(watched)
        self.resolution = watched.resolution
        numbers = (
            *frame.points(lit.centre)[:2],
            *frame.directions(lit.major)[:2] / frame.unit,
            *frame.directions(lit.minor)[:2] / frame.unit,
            *frame.points(lit.lamp)[:2],
            lit.height / frame.unit,
            *frame.directions(lit.axis),
            lit.cos_outer,
            lit.cos_width,
        )
        self.patch = Patch(*map(float, numbers))
        self.whole, self.chords = _whole_rules(self.patch), chord_rules()
        self.to_wall = np.concatenate(
            [
                frame.axes[:2] @ (watched.to_wall[:3] - np.outer(frame.origin, watched.to_wall[3])),
                frame.unit * watched.to_wall[3:],
            ]
        )
        self.wall_radiance = lit.albedo * lit.intensity / (math.pi * lit.height**2)
        self.factor = self.wall_radiance * watched.albedo / math.pi**2

        _refuse_gloss(world)
        self.flat, self.balls, tint, kept = elements.cells(world.target)
        self.flat[:, elements.ORIGIN : elements.LOW] /= frame.unit
        self.balls[:, elements.ORIGIN : elements.FIRST] /= frame.unit
        self.balls[:, elements.RADIUS] /= frame.unit
        if not len(self.flat) + len(self.balls):
            raise NlosError("the target has no surface")
        room = _joined([Mesh(frame.points(m.triangles), m.albedo) for m in world.room])
        if not world.is_followed_on:
            room = _before_the_wall(room)
        around = [room]
        if world.is_followed_on:
            if world.wall is None:
                raise NlosError("world: lacks the relay wall, which light of the sky or of a fourth reflection needs")
            around.append(Mesh(frame.points(world.wall.triangles), world.wall.albedo))
        self.sky = None if world.ambient is None else world.ambient.radiance * watched.albedo
        glosses = [gloss.rows_of(body) for body in world.target]
        albedos = np.concatenate(
            [tint, *(m.albedo for m in around), *(g.tint for g in glosses), *(g.multiple for g in glosses)]
        )
        is_grey = (albedos == albedos[:, :1]).all()
        emitters = world.emitters
        self.channel = [0, 0, 0] if is_grey and (emitters is None or _of_one_colour(emitters)) else [0, 1, 2]
        channels = sorted(set(self.channel))
        self.emission = None if emitters is None else _emission(emitters, frame, watched.albedo, channels)
        self.tint = np.ascontiguousarray(tint[:, channels])
        self.shine = gloss.shine(world.target, kept, channels) if world.is_glossy else None
        self.faces = Faces(self.flat, len(self.balls), self.to_wall, self.patch)
        self.room = Surfaces(room.triangles, room.albedo[:, channels])
        joined = _joined(around)
        self.around = Surfaces(joined.triangles, joined.albedo[:, channels])
        self.room_cells = elements.cells((room,))[0]
        # A room is seen from inside, even if it is a closed solid.
        self.room_cells[:, elements.SIDED] = 0.0

        meshes = _joined([Mesh(b.triangles / frame.unit, b.albedo) for b in world.target if isinstance(b, Mesh)])
        spheres = [np.append(b.centre, b.radius) / frame.unit for b in world.target if isinstance(b, Sphere)]
        self.target = Surfaces(meshes.triangles, meshes.albedo[:, channels], np.reshape(spheres, (-1, 4)))
        one_sided = bool(self.flat[:, elements.SIDED].all())
        self.convex = len(world.target) == 1 and (one_sided or len(self.flat) == 1)
        self.outward = None
        if one_sided and len(self.flat) == len(self.target.origin):  # the same surfaces: cells are turned outwards
            first, second = (
                self.flat[:, elements.FIRST : elements.SECOND],
                self.flat[:, elements.SECOND : elements.LOW],
            )
            self.outward = (np.cross(first, second) * self.target.normal).sum(axis=1) > 0.0
        eye = watched.eye
        self.obstacles = Obstacles(
            self.room,
            self.target,
            self.to_wall,
            self.patch,
            np.append(frame.points(eye[:3]) if eye[3] else frame.directions(eye[:3]) / frame.unit, eye[3]),
        )


def _before_the_wall(room: Mesh) -> Mesh:
    """Return those triangles, in the wall's frame, that reach before its plane: the lamp's light meets no others."""
    reaches = room.triangles[:, :, 2].max(axis=1, initial=-math.inf) > SUNK
    return Mesh(room.triangles[reaches], room.albedo[reaches])


def _refuse_gloss(world: World) -> None:
    """Raise NlosError if something is glossy whose light is not followed."""
    if any(mesh.gloss is not None for mesh in (*world.room, *([world.wall] if world.wall else []))):
        raise NlosError("world: only the target may be glossy, not the room or the relay wall; leave their gloss out")
    if not world.is_glossy:
        return
    if world.is_followed_on:
        raise NlosError(
            "world: a glossy target's light is followed over three reflections of the spot's light; with more "
            "reflections, a sky or other lamps, make it diffuse"
        )
    rows = [body.gloss for body in world.target if body.gloss is not None]
    least = min(float(row.roughness[row.tint.any(axis=1)].min(initial=1.0)) for row in rows)
    if least < SMOOTHEST:
        raise NlosError(
            f"world: the target has a glossy roughness of {least:g}, below {SMOOTHEST:g}, where quadrature "
            "cannot follow its reflections"
        )


def _of_one_colour(emitters: Emitters) -> bool:
    """Whether all emitters differ in strength only."""
    colours = np.concatenate([emitters.radiance, emitters.intensity])
    strongest = colours[colours.max(axis=1).argmax()]
    expected = colours.max(axis=1, keepdims=True) * strongest / strongest.max()
    return bool(np.allclose(colours, expected, rtol=1e-6, atol=0.0))


def _emission(emitters: Emitters, frame: Frame, albedo: Array, channels: list[int]) -> Emission:
    """Return emitters in the wall's frame, the strongest of strength 1.

    If there is one group, its strength is that of the strongest channel.
    """
    intensity = emitters.intensity / frame.unit**2
    colours = np.concatenate([emitters.radiance, intensity])
    strength, colour = colours, np.full(3, colours.max())
    if len(channels) == 1:
        strength, colour = colours.max(axis=1, keepdims=True), colours.max(axis=0)
    radiance, intensity = np.split(strength / colour.max(), [len(emitters.radiance)])
    triangles, places = frame.points(emitters.triangles), frame.points(emitters.places)
    softness = emitters.softness / frame.unit
    return Emission(triangles, radiance, places, intensity, softness, colour * albedo / math.pi)


def _joined(meshes: list[Mesh]) -> Mesh:
    return Mesh(
        np.concatenate([np.zeros((0, 3, 3)), *(m.triangles for m in meshes)]),
        np.concatenate([np.zeros((0, 3)), *(m.albedo for m in meshes)]),
    )
