"""Scene, wall, lamp, camera and target as validated values.

Lengths are metres, angles degrees, power watts, radiance W/m^2/sr. The frame is Blender's: right-handed, z up.
The relay wall is the plane y = 0 and faces +y; x runs along it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from generator.model.arrays import Range, Vector
from generator.model.described import check_ranges, described, documented
from generator.model.errors import NlosError, instead, require
from generator.model.grid import VoxelGrid
from generator.model.quantities import ALL_ORDERS

ROOM_SURFACES = ("floor", "ceiling", "back", "left", "right")
FACES = {"floor": ("z", 0), "ceiling": ("z", 1), "back": ("y", 1), "left": ("x", 0), "right": ("x", 1)}
"""Axis that a surface of the room is normal to, and the end of the room's extent that it lies at (0 low, 1 high)."""


@documented
@dataclass(frozen=True, kw_only=True)
class Wall:
    """The relay wall: a rectangle in the plane y = 0."""

    x: Range = described("extent, metres")
    z: Range = described("extent, metres")
    albedo: float | None = described(
        "fraction of light reflected, Lambertian, 0 to 1; None (here and below) if read from a file where the "
        "material is not plainly Lambertian",
        0.8,
    )


@documented
@dataclass(frozen=True, kw_only=True)
class Room:
    """The surfaces that close the room, apart from the relay wall."""

    x: Range = described("extent, metres")
    y: Range = described("extent, metres, which starts at the relay wall")
    z: Range = described("extent, metres")
    albedo: float | None = described("of every surface, Lambertian", 0.8)
    surfaces: tuple[str, ...] = described("which of floor, ceiling, back, left, right are there", ROOM_SURFACES)


@documented
@dataclass(frozen=True, kw_only=True)
class Partition:
    """The screen in a plane of constant x that hides the object from lamp and camera."""

    x: float = described("where its plane stands, metres")
    y: Range = described("extent, metres")
    z: Range = described("extent, metres")
    depth: float = described("how far it reaches towards +x, metres: 0 is a thin screen, more is a solid corner", 0.0)
    albedo: float | None = described("0 is matt black", 0.0)


@documented
@dataclass(frozen=True, kw_only=True)
class Spot:
    """The spot lamp."""

    location: Vector = described("the lamp, metres")
    aim: Vector = described("w1, the centre of the patch that it lights on the relay wall, metres")
    half_angle: float = described(
        "between the lamp's axis and the edge of its cone, degrees: how wide a patch of wall it lights"
    )
    power: float = described(
        "power of the spot lamp, Blender's watts: its radiant intensity is power / (4 pi) W/sr inside the cone, "
        "whatever the cone's angle",
        1000.0,
    )

    @property
    def intensity(self) -> float:
        """Radiant intensity inside the cone, W/sr."""
        return self.power / (4.0 * math.pi)

    def irradiance(self, normal: Vector = (0.0, 1.0, 0.0)) -> float:
        """Irradiance I cos / d^2 at w1 of a surface with that unit normal, W/m^2."""
        to_lamp = np.subtract(self.location, self.aim)
        distance = float(np.linalg.norm(to_lamp))
        return self.intensity * max(0.0, float(to_lamp @ np.asarray(normal))) / distance**3


@documented
@dataclass(frozen=True, kw_only=True)
class Camera:
    """The camera and the rectangle of the relay wall that it watches.

    The camera looks straight at the wall; the lens is shifted so that the picture is exactly the watched
    rectangle, without keystone. Facing the wall, the camera's right is -x: column 0 of a picture is the
    largest x, row 0 the largest z.
    """

    location: Vector = described("where it stands, metres")
    x: Range = described("of the watched rectangle, metres")
    z: Range = described("of the watched rectangle, metres")
    projection: Literal["perspective", "orthographic"] = described("how it looks at it", "perspective")


@documented
@dataclass(frozen=True, kw_only=True)
class Target:
    """The hidden object."""

    kind: Literal["sheet", "sphere", "mesh"] = described(
        "a square sheet (two-sided, its normal along y when unrotated), a sphere, or a mesh from a file", "sheet"
    )
    size: float = described(
        "edge of the sheet, diameter of the sphere, longest edge of the mesh's bounding box, metres; for a mesh, 0 "
        "keeps the file's own size",
        0.5,
    )
    albedo: float | None = described(
        "fraction of the light that the target reflects, alike in all directions (Lambertian); 1 is the paper's "
        "perfectly reflecting sphere",
        0.9,
    )
    mesh: str = described("file of a mesh target (OBJ, PLY, STL, glTF, USD, FBX or .blend), else empty", "")
    unit: Literal["auto", "m", "cm", "mm", "inch"] = described(
        "what a length of 1 in a mesh file is; auto is what the file states, and metres for OBJ, PLY and STL, which "
        "state nothing",
        "auto",
    )
    up: Literal["auto", "X", "Y", "Z"] = described(
        "axis of a mesh file that points up; auto is what the file states, else Y for OBJ, and Z for PLY and STL",
        "auto",
    )
    gloss: float = described(
        "share of what the target reflects that is glossy, 0 to 1: Blender's Glossy BSDF, Multiscatter GGX", 0.0
    )
    roughness: float = described("roughness of the glossy share, 0 to 1, as Blender has it", 0.5)

    @classmethod
    def named(cls, name: str, scale: float = 1.0) -> Target:
        """Return the sheet (0.5 m, albedo 0.9) or the sphere (radius 0.2 m, albedo 1) to scale, or a mesh file."""
        if name == "sheet":
            return cls(kind="sheet", size=0.5 * scale, albedo=0.9)
        if name == "sphere":
            return cls(kind="sphere", size=0.4 * scale, albedo=1.0)
        if Path(name).suffix.lower() not in MESH_SUFFIXES:
            near = instead(name, ("sheet", "sphere")).removeprefix("choose from sheet, sphere")
            mesh = f"must be sheet, sphere or a mesh file ({', '.join(MESH_SUFFIXES)})"
            raise NlosError(f"target {name!r}: {mesh}{near and '; '}{near}")
        return cls(kind="mesh", size=0.0, albedo=0.9, mesh=name)


MESH_SUFFIXES = (
    *(".obj", ".ply", ".stl", ".gltf", ".glb", ".fbx"),
    *(".usd", ".usda", ".usdc", ".usdz", ".blend"),
)
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
"""Metres in each unit of length that a mesh file may be in."""


@documented
@dataclass(frozen=True, kw_only=True)
class Scene:
    """A whole scene."""

    preset: str = described("the preset that it started from")
    wall: Wall
    spot: Spot
    camera: Camera
    grid: VoxelGrid
    target: Target = field(default_factory=Target)
    room: Room | None = None
    partition: Partition | None = None
    ambient: float = described(
        "uniform ambient light: radiance of the surroundings, W/m²/sr; 0 is off, and a closed room loses its ceiling "
        "for it, so that light can enter",
        0.0,
    )
    reflection_order: int = described(
        "how many diffuse reflections light may make on its way; three are: wall, hidden object, wall again; 1024, "
        "or 'all' where it is typed, stands for all",
        3,
        lo=1,
        hi=ALL_ORDERS,
    )
    resolution: tuple[int, int] = described(
        "width and height of a picture, pixels, which must be square on the wall", (64, 64), lo=1, hi=65536
    )

    def __post_init__(self) -> None:
        for name, value in _leaves(self):
            if isinstance(value, float):
                require(math.isfinite(value), f"{name}: {value} is not a finite number")
            if name.endswith("albedo") and value is not None:
                require(0.0 <= value <= 1.0, f"{name}: {value} must lie between 0 and 1")
        for part in ("wall", "room", "partition", "camera"):
            for axis in "xyz":
                extent = getattr(getattr(self, part), axis, None)
                if isinstance(extent, tuple):
                    # All surfaces of a file may lie in one plane, as a floor alone does (see `check_buildable`).
                    flat = part in ("room", "partition") and extent[0] == extent[1]
                    require(extent[0] < extent[1] or flat, f"{part}.{axis}: {extent} must run from low to high")
        require(self.spot.power >= 0, f"spot.power: {self.spot.power} must not be negative")
        require(
            0 < self.spot.half_angle < 90,
            f"spot.half_angle: {self.spot.half_angle} must lie between 0 and 90 degrees",
        )
        require(
            self.spot.location[1] > max(0.0, self.spot.aim[1]),
            f"spot.location: {self.spot.location} must lie before the relay wall, farther from it than spot.aim",
        )
        require(
            self.camera.location[1] > 0.0,
            f"camera.location: {self.camera.location} must lie before the relay wall, with y above 0",
        )
        require(self.ambient >= 0, f"ambient: {self.ambient} must not be negative")
        for name in ("gloss", "roughness"):
            value = getattr(self.target, name)
            require(0.0 <= value <= 1.0, f"target.{name}: {value:g} must lie between 0 and 1")
        for name, known in (("unit", ("auto", *UNITS)), ("up", ("auto", "X", "Y", "Z"))):
            value = getattr(self.target, name)
            require(value in known, f"target.{name}: {value!r} must be one of {', '.join(known)}")
            require(
                value == "auto" or self.target.kind == "mesh", f"target.{name}: means nothing to a {self.target.kind}"
            )
        require(self.target.size >= 0, f"target.size: {self.target.size} must not be negative")
        require(self.target.size > 0 or self.target.kind == "mesh", "target.size: must be above 0")
        check_ranges(self)
        if self.room:
            unknown = set(self.room.surfaces) - set(ROOM_SURFACES)
            require(
                not unknown,
                f"room.surfaces: {sorted(unknown)} unknown; choose from {', '.join(ROOM_SURFACES)}",
            )
            twice = len(set(self.room.surfaces)) < len(self.room.surfaces)
            require(not twice, f"room.surfaces: {list(self.room.surfaces)} names a surface twice")

    def check_buildable(self) -> None:
        """Raise NlosError if a surface to be built would have no area; one that is read from a file may lie flat."""
        parts = [("partition", "y"), ("partition", "z")] if self.partition else []
        for surface in self.room.surfaces if self.room else ():
            parts += [("room", axis) for axis in "xyz" if axis != FACES[surface][0]]
        for part, axis in parts:
            low, high = getattr(getattr(self, part), axis)
            require(low < high, f"{part}.{axis}: {(low, high)} must run from low to high")

    @property
    def reference_radiance(self) -> float:
        """Radiance of the directly lit relay wall at w1, rho/pi I cos/d^2, W/m^2/sr; rho = 1 if unknown."""
        albedo = 1.0 if self.wall.albedo is None else self.wall.albedo
        return albedo / math.pi * self.spot.irradiance()

    def with_ambient(self, radiance: float) -> Scene:
        """Return the scene under uniform ambient light; a closed room loses its ceiling, so that light can enter."""
        room = self.room
        if radiance > 0 and room and set(ROOM_SURFACES) <= set(room.surfaces):
            room = replace(room, surfaces=tuple(s for s in room.surfaces if s != "ceiling"))
        return replace(self, ambient=radiance, room=room)


_LENGTHS = ("wall", "room", "partition", "spot.location", "camera", "grid")
_NOT_READ = ("preset", "target.mesh", "spot.aim", "camera.projection", "room.surfaces")
"""Values that a ``.blend`` file does not hold, or holds in another form."""


def unlike(wanted: Scene, got: Scene) -> str:
    """Return a phrase on the first value that Blender could not store as it was wanted; empty if there is none.

    Blender's numbers have 24 bits and a finite range, and some settings a narrower one: a spot's cone has 1 degree at
    least.
    """
    values: dict[str, list[Any]] = {}
    for name, value in _leaves(got):
        values.setdefault(name, []).append(value)
    flat = [f"room.{axis}" for axis in "xyz" if len(set(values.get(f"room.{axis}", ()))) == 1]  # as for a lone floor
    tolerance = 1e-6 * max(abs(v) for name in ("wall.x", "wall.z", "camera.location") for v in values[name])
    for name, value in _leaves(wanted):
        if name in _NOT_READ or name not in values:
            continue
        got_value = values[name].pop(0)
        if not isinstance(value, float) or name in flat or (name == "target.size" and not value):
            continue
        if not math.isclose(got_value, value, rel_tol=2e-3, abs_tol=tolerance if name.startswith(_LENGTHS) else 0.0):
            return f"{name}: {value:g} becomes {got_value:g} in Blender"
    return ""


def _leaves(value: Any, prefix: str = "") -> list[tuple[str, Any]]:
    """Return every plain value inside nested dataclasses and tuples, with its dotted name."""
    if is_dataclass(value) and not isinstance(value, type):
        return [
            leaf
            for f in fields(value)
            for leaf in _leaves(getattr(value, f.name), f"{prefix}.{f.name}" if prefix else f.name)
        ]
    if isinstance(value, tuple):
        return [leaf for item in value for leaf in _leaves(item, prefix)]
    return [(prefix, value)]
