"""Data that are read from a scene: surfaces, lights, and the reasons against an engine."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from generator.model.arrays import Array

EDGE = 1e-4
"""Tests stay this far inside the picture, in units of its width: it may end where the wall ends."""


CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Corners of a picture: top left, top right, bottom right, bottom left."""


@dataclass(frozen=True)
class Surface:
    """A rendered surface: its triangles (n, 3, 3) in the world, metres; their albedos (n, 3), the radiance (n, 3) of
    their own light, W/m^2/sr, and their gloss (n, 7) (`shapes.TINT` and so on)."""

    name: str
    label: str
    role: str
    triangles: Array
    albedo: Array
    radiance: Array
    gloss: Array
    closed: bool
    smooth: bool
    faces: int
    seen: bool
    flaws: tuple[str, ...]
    kinds: frozenset[str] = frozenset()
    unseen_by: frozenset[str] = frozenset()
    """Kinds of rays to which it is invisible."""
    softened: bool = False
    """Whether Cycles lets lamps shine around its corners, which are round in the shading only."""


@dataclass(frozen=True)
class Light:
    """A light source in a render.

    Attributes
    ----------
    name : str
        Name of the object or of the world.
    kind : {"POINT", "SUN", "SPOT", "AREA", "SURFACE", "VOLUME", "WORLD"}
    role : str
        "spot", "target" if it moves with the target, "relay_wall", or "room".
    instance : bool
        Whether an instancer makes it from an object: collection, geometry nodes, particles.
    matrix : ndarray of shape (4, 4)
        Transform to the world, metres; a lamp shines along its -z.
    power : float
        Power of a lamp, watts (of a sun, W/m^2); NaN otherwise.
    corners : ndarray of shape (n, 3, 3)
        Triangles of an emitting surface, in the world, metres; empty otherwise.
    """

    name: str
    kind: str
    role: str
    instance: bool
    matrix: Array
    power: float = math.nan
    corners: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))

    @property
    def is_spot(self) -> bool:
        """Whether it is the scene's spot itself, and not an instance of it."""
        return self.role == "spot" and not self.instance


@dataclass(frozen=True)
class Glow:
    """Light of a lamp: from triangles (n, 3, 3), on the side of their normals, or from places (m, 3) without extent.

    Attributes
    ----------
    radiance : ndarray of shape (3,)
        Of the triangles, W/m^2/sr.
    intensity : ndarray of shape (3,)
        Of each place, W/sr.
    softness : float
        Radius, metres, of a lamp with a soft falloff, else 0.
    seen : bool
        Whether the camera may see it.
    """

    name: str
    triangles: Array
    radiance: Array
    places: Array
    intensity: Array
    softness: float
    seen: bool


@dataclass
class Reading:
    """The scene as a render sees it.

    Attributes
    ----------
    surfaces : list of Surface
        All rendered surfaces.
    places : dict of str to ndarray of shape (4, 4)
        Transforms to the world of the objects with a role.
    reasons : list of str
        What else `surfel` cannot honour.
    layers : list of str
        What only plain Cycles can honour in a picture: view layers, materials that depend on Blender's version.
    sky : ndarray of shape (3,) or None
        Radiance of a world with uniform light, else None.
    lights : list of Light
        All light sources.
    glowing : list of Glow
        Those lamps besides the spot that `surfel` can follow.
    volumes : list of str
        Phrases that name what is filled with a volume.
    kinds : dict of str to frozenset of str
        Kinds of scattering of each rendered object's materials (`nodes.kinds`).
    """

    surfaces: list[Surface] = field(default_factory=list)
    places: dict[str, Array] = field(default_factory=dict)
    reasons: list[str] = field(default_factory=list)
    layers: list[str] = field(default_factory=list)
    sky: Array | None = None
    lights: list[Light] = field(default_factory=list)
    glowing: list[Glow] = field(default_factory=list)
    volumes: list[str] = field(default_factory=list)
    kinds: dict[str, frozenset[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Shape:
    """The mesh of an object in its own frame, n triangles; many instances may share it."""

    corners: Array
    slots: Any
    """Index of each triangle's material, (n,), by which materials are known below."""
    albedo: Array
    radiance: Array
    gloss: Array
    closed: bool
    lean: Array
    """Angle between the normals of each triangle's corners and its own, radians, (n,)."""
    faces: int
    flaws: dict[int, str]
    kinds: dict[int, frozenset[str]]
    glowing: frozenset[int]
    """Materials whose surface emits light."""
    fire: frozenset[int]
    """Materials whose volume emits light, and whose surface does not."""
