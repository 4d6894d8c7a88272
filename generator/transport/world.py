"""Scenes as plain arrays: lit patch, watched patch, target, room.

Lengths are metres in the world's frame (any right-handed frame: nothing here assumes that the wall is y = 0), colours
are three channels, albedos 0 to 1. All surfaces reflect from both sides, and all are Lambertian; a target may be
glossy as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from generator.model.arrays import Array
from generator.model.errors import NlosError

MOST_SURFACES = 2000
"""Most surfaces of room and wall over which light is followed besides the spot's first three reflections."""

SMOOTHEST = 0.2
"""Least roughness of a glossy target: quadrature points grow with its inverse fourth power."""

MOST_EMITTERS = 1000
"""Most triangles that give light."""


@dataclass(frozen=True)
class LitPatch:
    """The part of the relay wall that the spot lights, as a Lambertian emitter.

    A circular cone cuts a plane in an ellipse (as long as the cone does not reach the plane's horizon), so the
    outline is exact; its radiance at a point p is

        L(p) = albedo / pi * intensity * height / |p - lamp|^3 * falloff(angle off the axis)

    Attributes
    ----------
    centre : ndarray of shape (3,)
        Centre of the ellipse (not w1, which is where the axis meets the wall), metres.
    major, minor : ndarray of shape (3,)
        Semi-axes, metres.
    normal : ndarray of shape (3,)
        Wall normal, towards the lamp; unit length.
    lamp, axis : ndarray of shape (3,)
        The lamp's position, metres, and unit direction.
    height : float
        Distance of the lamp from the wall's plane, metres.
    intensity : ndarray of shape (3,)
        Radiant intensity per colour channel, W/sr.
    albedo : ndarray of shape (3,)
        Albedo of the wall, per colour channel.
    cos_outer, cos_width : float
        The falloff is smoothstep((cos - cos_outer) / cos_width); cos_width = 0 is a hard edge.
    """

    centre: Array
    major: Array
    minor: Array
    normal: Array
    lamp: Array
    axis: Array
    height: float
    intensity: Array
    albedo: Array
    cos_outer: float
    cos_width: float


@dataclass(frozen=True)
class Watched:
    """The part of the relay wall that the camera sees, and how the picture maps onto it.

    Attributes
    ----------
    to_wall : ndarray of shape (4, 3)
        The projective map from the picture to the wall: the homogeneous wall point is ``to_wall @ (u, v, 1)`` with u
        from 0 (left edge) to 1 (right edge) and v from 0 (top edge) to 1 (bottom edge); its last component is
        positive all over the picture.
    eye : ndarray of shape (4,)
        The camera's centre of projection (x, y, z) and 1; or, if it is orthographic, the vector from the wall to the
        camera's plane, metres, and 0.
    normal : ndarray of shape (3,)
        Wall normal, towards the camera; unit length.
    albedo : ndarray of shape (3,)
        Albedo of the wall, per colour channel.
    resolution : (int, int)
        Width and height of the picture, pixels.
    """

    to_wall: Array
    eye: Array
    normal: Array
    albedo: Array
    resolution: tuple[int, int]

    def points(self, uv: Array) -> Array:
        """Return the wall points (..., 3), metres, of picture coordinates (..., 2)."""
        homogeneous = np.concatenate([uv, np.ones_like(uv[..., :1])], axis=-1) @ self.to_wall.T
        wall: Array = homogeneous[..., :3] / homogeneous[..., 3:]
        return wall


@dataclass(frozen=True)
class Gloss:
    """Glossy reflection by microfacets (`facets.pairs`), which a surface has beside its diffuse reflection.

    Attributes
    ----------
    tint : ndarray of shape (n, 3)
        Reflectivity of the facets, of each triangle, or of the one sphere, and per colour channel.
    roughness : ndarray of shape (n,)
        Blender's roughness, 0 to 1, the square root of the width of the facets' slopes.
    multiple : ndarray of shape (n, 3)
        Mean reflectivity of the further facets that light meets before it leaves (`facets.multiple`); 0 leaves that
        light out.
    """

    tint: Array
    roughness: Array
    multiple: Array

    def __post_init__(self) -> None:
        n = len(self.roughness)
        if self.tint.shape != (n, 3) or self.multiple.shape != (n, 3) or self.roughness.shape != (n,):
            shapes = ", ".join(str(values.shape) for values in (self.tint, self.roughness, self.multiple))
            raise NlosError(
                f"gloss: tint, roughness and multiple must have shapes (n, 3), (n,) and (n, 3), not {shapes}"
            )
        if not ((self.roughness >= 0.0) & (self.roughness <= 1.0)).all():
            raise NlosError("gloss: roughness must lie between 0 and 1")


@dataclass(frozen=True)
class Sphere:
    """A sphere of a target.

    Attributes
    ----------
    centre : ndarray of shape (3,)
        Centre in the target's own frame, metres.
    radius : float
        Radius, metres.
    albedo : ndarray of shape (3,)
    gloss : Gloss of one row, optional
    """

    centre: Array
    radius: float
    albedo: Array
    gloss: Gloss | None = None

    def __post_init__(self) -> None:
        if self.gloss is not None and len(self.gloss.roughness) != 1:
            raise NlosError(f"sphere: gloss must have one row, not {len(self.gloss.roughness)}")


@dataclass(frozen=True)
class Mesh:
    """Triangles, of a target in the target's own frame (scaled, not rotated), or of a room in the world's frame.

    Attributes
    ----------
    triangles : ndarray of shape (n, 3, 3)
        Corner by corner, metres. Orientation does not matter.
    albedo : ndarray of shape (n, 3)
        Per triangle and colour channel.
    gloss : Gloss of n rows, optional
        Of a target.
    """

    triangles: Array
    albedo: Array
    gloss: Gloss | None = None

    def __post_init__(self) -> None:
        if self.triangles.ndim != 3 or self.triangles.shape[1:] != (3, 3):
            raise NlosError(f"mesh: triangles must have shape (n, 3, 3), not {self.triangles.shape}")
        if self.albedo.shape != (len(self.triangles), 3):
            raise NlosError(f"mesh: albedo must have shape ({len(self.triangles)}, 3), not {self.albedo.shape}")
        if not np.isfinite(self.triangles).all():
            raise NlosError("mesh: a corner is not finite")
        if self.gloss is not None and len(self.gloss.roughness) != len(self.triangles):
            raise NlosError(f"mesh: gloss must have {len(self.triangles)} rows, not {len(self.gloss.roughness)}")


Body = Sphere | Mesh


@dataclass(frozen=True)
class AmbientLight:
    """Light of equal radiance from all directions in which there is no surface.

    Attributes
    ----------
    radiance : ndarray of shape (3,)
        Radiance per colour channel, W/m^2/sr.
    """

    radiance: Array


@dataclass(frozen=True)
class Emitters:
    """Surfaces that give light, and lamps besides the spot.

    Surfaces that also reflect or hide light are in the room as well.

    Attributes
    ----------
    triangles : ndarray of shape (n, 3, 3)
        Corner by corner, metres. Light leaves on the side from which they run counter-clockwise, with equal radiance
        in all directions.
    radiance : ndarray of shape (n, 3)
        Per triangle and colour channel, W/m^2/sr.
    places : ndarray of shape (m, 3)
        Positions of lamps without extent, metres.
    intensity : ndarray of shape (m, 3)
        Radiant intensity of each, per colour channel, in all directions, W/sr.
    softness : ndarray of shape (n + m,)
        Radius, metres, of round lamps with Blender's soft falloff, else 0; for triangles, then for places.
    """

    triangles: Array
    radiance: Array
    places: Array
    intensity: Array
    softness: Array

    def __post_init__(self) -> None:
        for name, values, shape in (
            ("triangles", self.triangles, (len(self.triangles), 3, 3)),
            ("radiance", self.radiance, (len(self.triangles), 3)),
            ("places", self.places, (len(self.places), 3)),
            ("intensity", self.intensity, (len(self.places), 3)),
            ("softness", self.softness, (len(self.triangles) + len(self.places),)),
        ):
            if values.shape != shape:
                raise NlosError(f"emitters: {name} must have shape {shape}, not {values.shape}")
            if not np.isfinite(values).all():
                raise NlosError(f"emitters: {name} must be finite")
            if name != "triangles" and name != "places" and (values < 0.0).any():
                raise NlosError(f"emitters: {name} must not be negative")
        if not (self.radiance.any() or self.intensity.any()):
            raise NlosError("emitters: give no light; leave them out")


@dataclass(frozen=True)
class World:
    """All of a scene that is relevant to its light.

    Attributes
    ----------
    patch : LitPatch
    watched : Watched
    target : tuple of Sphere or Mesh
        The hidden object; its parts move together.
    room : tuple of Mesh
        All other surfaces except the relay wall: they reflect, and they hide what is behind them.
    order : int
        Largest number of reflections that a picture includes; `ALL_ORDERS` for all.
    ambient : AmbientLight, optional
    wall : Mesh, optional
        The whole relay wall, which reflects and blocks all light but that of the lamp's first three reflections.
    emitters : Emitters, optional
        Light besides that of the spot and of the sky.
    """

    patch: LitPatch
    watched: Watched
    target: tuple[Body, ...]
    room: tuple[Mesh, ...] = ()
    order: int = 3
    ambient: AmbientLight | None = None
    wall: Mesh | None = None
    emitters: Emitters | None = None

    @property
    def is_followed_on(self) -> bool:
        """Whether there is light besides the spot's first three reflections."""
        return self.order > 3 or self.ambient is not None or self.emitters is not None

    @property
    def is_glossy(self) -> bool:
        """Whether any part of the target is glossy."""
        return any(body.gloss is not None for body in self.target)

    def seen_by(self, width: int, height: int) -> World:
        """Return the world with a picture of ``width`` by ``height`` pixels."""
        return replace(self, watched=replace(self.watched, resolution=(width, height)))
