"""What is read of a scene: surfaces, lights, and the reasons against an engine."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from generator.model.arrays import Array

EDGE = 1e-4
"""Look just inside the picture, in its own width: it may end where the wall ends."""


CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Of a picture: top left, top right, bottom right, bottom left."""


FLAT = 1e-5
"""A surface is plane if it leaves its plane by less, in units of its own size."""


@dataclass(frozen=True)
class Surface:
    """A rendered surface: its triangles (n, 3, 3) in the world, metres, with albedos (n, 3)."""

    name: str
    label: str
    role: str
    triangles: Array
    albedo: Array
    closed: bool
    smooth: bool
    faces: int
    seen: bool
    flaws: tuple[str, ...]
    kinds: frozenset[str] = frozenset()
    unseen_by: frozenset[str] = frozenset()
    """Kinds of rays that pass it by."""
    softened: bool = False
    """Whether Cycles lets lamps shine around its corners, which are round in the shading only."""


@dataclass(frozen=True)
class Light:
    """Something that gives light in a render.

    Attributes
    ----------
    name : str
        Of the object, or of the world.
    kind : {"POINT", "SUN", "SPOT", "AREA", "SURFACE", "VOLUME", "WORLD"}
    role : str
        "spot" or "target" of a surface that moves with it, "relay_wall", or "room".
    instance : bool
        One more of an object that an instancer repeats: collection, geometry nodes, particles.
    matrix : ndarray of shape (4, 4)
        Where it stands, metres; a lamp shines along its -z.
    power : float
        Of a lamp, watts (a sun's is W/m^2); NaN of the rest.
    corners : ndarray of shape (n, 3, 3)
        Triangles of a surface that glows, in the world, metres; empty of the rest.
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
        """Whether it is the spot of the scene itself, and no copy."""
        return self.role == "spot" and not self.instance


@dataclass
class Reading:
    """The scene as a render sees it.

    Attributes
    ----------
    surfaces : list of _Surface
        All that are rendered.
    places : dict of str to ndarray of shape (4, 4)
        Where the objects with a role stand.
    reasons : list of str
        What else there is that `surfel` cannot honour.
    layers : list of str
        What only plain Cycles does to a whole picture: view layers, materials that depend on Blender's version.
    sky : ndarray of shape (3,) or None
        Radiance of a world that shines alike from everywhere, if it does.
    lights : list of Light
        All that give light.
    volumes : list of str
        What is filled with a volume, a phrase each.
    kinds : dict of str to frozenset of str
        Of each object that is rendered, how its materials send light on (`nodes.kinds`).
    """

    surfaces: list[Surface] = field(default_factory=list)
    places: dict[str, Array] = field(default_factory=dict)
    reasons: list[str] = field(default_factory=list)
    layers: list[str] = field(default_factory=list)
    sky: Array | None = None
    lights: list[Light] = field(default_factory=list)
    volumes: list[str] = field(default_factory=list)
    kinds: dict[str, frozenset[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Shape:
    """The mesh of an object in its own frame; many instances may share it."""

    corners: Array
    albedo: Array
    closed: bool
    lean: float
    faces: int
    flaws: tuple[str, ...]
    kinds: frozenset[str]
    glowing: Any
    """Which of the triangles give light, (n,), bool."""
    fire: bool
    """Whether a volume inside gives light."""
