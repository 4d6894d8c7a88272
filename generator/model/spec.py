"""What a scene, a voxel grid and a target are: validated values, to and from TOML.

Lengths are metres, angles degrees, power watts, radiance W/m^2/sr. The frame is Blender's: right-handed, z up.
The relay wall is the plane y = 0 and faces +y; x runs along it.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]
Range = tuple[float, float]
Array = NDArray[np.float64]

ROOM_SURFACES = ("floor", "ceiling", "back", "left", "right")
FACES = {"floor": ("z", 0), "ceiling": ("z", 1), "back": ("y", 1), "left": ("x", 0), "right": ("x", 1)}
"""Across which axis a surface of the room lies, and at which of its ends."""
TARGET_KINDS = ("sheet", "sphere", "mesh")


class NlosError(ValueError):
    """Bad input, told in one sentence: what is wrong, where, and what would be right."""


def _check(ok: bool, message: str) -> None:
    if not ok:
        raise NlosError(message)


@dataclass(frozen=True, kw_only=True)
class Wall:
    """The relay wall: a rectangle in the plane y = 0.

    Attributes
    ----------
    x, z : (float, float)
        Extent, metres.
    albedo : float, optional
        Fraction of light reflected, Lambertian, 0 to 1; None (here and below) if read from a file where the
        material is not plainly Lambertian.
    """

    x: Range
    z: Range
    albedo: float | None = 0.8


@dataclass(frozen=True, kw_only=True)
class Room:
    """The surfaces that close the room, apart from the relay wall.

    Attributes
    ----------
    x, y, z : (float, float)
        Extent, metres; y starts at the relay wall.
    albedo : float
        Of every surface, Lambertian.
    surfaces : tuple of str
        Which of floor, ceiling, back, left, right are there.
    """

    x: Range
    y: Range
    z: Range
    albedo: float | None = 0.8
    surfaces: tuple[str, ...] = ROOM_SURFACES


@dataclass(frozen=True, kw_only=True)
class Partition:
    """The screen in a plane of constant x that hides the object from lamp and camera.

    Attributes
    ----------
    x : float
        Where its plane stands, metres.
    depth : float
        How far it reaches towards +x, metres: 0 is a thin screen, more is a solid corner.
    y, z : (float, float)
        Extent, metres.
    albedo : float
        0 is matt black.
    """

    x: float
    y: Range
    z: Range
    depth: float = 0.0
    albedo: float | None = 0.0


@dataclass(frozen=True, kw_only=True)
class Spot:
    """The spot lamp.

    Attributes
    ----------
    location, aim : (float, float, float)
        The lamp and w1, the centre of the patch that it lights on the relay wall, metres.
    half_angle : float
        Of its cone, degrees.
    power : float
        Blender's watts: radiant intensity I = power / (4 pi) W/sr inside the cone, whatever its angle.
    """

    location: Vector
    aim: Vector
    half_angle: float
    power: float = 1000.0

    @property
    def intensity(self) -> float:
        """Radiant intensity inside the cone, W/sr."""
        return self.power / (4.0 * math.pi)

    def irradiance(self, normal: Vector = (0.0, 1.0, 0.0)) -> float:
        """Irradiance I cos / d^2 at w1 of a surface with that unit normal, W/m^2."""
        to_lamp = np.subtract(self.location, self.aim)
        distance = float(np.linalg.norm(to_lamp))
        return self.intensity * max(0.0, float(to_lamp @ np.asarray(normal))) / distance**3


@dataclass(frozen=True, kw_only=True)
class Camera:
    """The camera and the rectangle of the relay wall that it watches.

    The camera looks straight at the wall; the lens is shifted so that the picture is exactly the watched
    rectangle, without keystone. Facing the wall, the camera's right is -x: column 0 of a picture is the
    largest x, row 0 the largest z.

    Attributes
    ----------
    location : (float, float, float)
        Metres.
    x, z : (float, float)
        The watched rectangle, metres.
    projection : {"perspective", "orthographic"}
    """

    location: Vector
    x: Range
    z: Range
    projection: Literal["perspective", "orthographic"] = "perspective"


@dataclass(frozen=True, kw_only=True)
class VoxelGrid:
    """The hidden volume, cut into equal boxes; x runs fastest, then y, then z.

    Attributes
    ----------
    lo, hi : (float, float, float)
        Opposite corners, metres.
    shape : (int, int, int)
        Number of voxels along x, y, z.
    """

    lo: Vector
    hi: Vector
    shape: tuple[int, int, int] = (3, 3, 1)

    def __post_init__(self) -> None:
        _check(all(n >= 1 for n in self.shape), f"grid.shape: {self.shape} has a count below 1")
        _check(self.n_voxels <= 100_000, f"grid.shape: {self.n_voxels} voxels; at most 100000 can be labelled")
        _check(
            all(math.isfinite(a) and math.isfinite(b) and a < b for a, b in zip(self.lo, self.hi, strict=True)),
            f"grid: lo {self.lo} must lie below hi {self.hi} on every axis",
        )

    @property
    def n_voxels(self) -> int:
        """How many voxels there are."""
        return math.prod(self.shape)

    @property
    def size(self) -> Vector:
        """Edge lengths of one voxel, metres."""
        x, y, z = ((b - a) / n for a, b, n in zip(self.lo, self.hi, self.shape, strict=True))
        return (x, y, z)

    @cached_property
    def labels(self) -> list[str]:
        """A, B, ... Z, AA, AB, ... in voxel order, like the columns of a spreadsheet."""
        return [voxel_label(i) for i in range(self.n_voxels)]

    def cell(self, voxel: int) -> tuple[int, int, int]:
        """Indices of a voxel along x, y, z."""
        nx, ny, _ = self.shape
        return voxel % nx, voxel // nx % ny, voxel // (nx * ny)

    def bounds(self, voxel: int) -> tuple[Array, Array]:
        """Lowest and highest corner of a voxel, each of shape (3,), metres."""
        lo = np.asarray(self.lo) + np.asarray(self.cell(voxel)) * np.asarray(self.size)
        return lo, lo + np.asarray(self.size)

    def voxel(self, place: Array) -> int:
        """Return which voxel a place (3,), metres, is in, or which of those at the rim is next to it."""
        return int(self.voxels(np.asarray(place)[None])[0])

    def voxels(self, places: Array) -> NDArray[np.int64]:
        """Return which voxel each of places (n, 3) is in, as `voxel` does."""
        steps = np.floor((places - self.lo) / np.asarray(self.size)).astype(np.int64)
        i, j, k = np.clip(steps, 0, np.array(self.shape) - 1).T
        number: NDArray[np.int64] = i + self.shape[0] * (j + self.shape[1] * k)
        return number


def voxel_label(index: int) -> str:
    """Return the spreadsheet-style name of a voxel: 0 is A, 25 is Z, 26 is AA."""
    label = ""
    index += 1
    while index:
        index, letter = divmod(index - 1, 26)
        label = chr(ord("A") + letter) + label
    return label


@dataclass(frozen=True, kw_only=True)
class Target:
    """The hidden object.

    Attributes
    ----------
    kind : {"sheet", "sphere", "mesh"}
        A square sheet (two-sided, normal along y when unrotated), a sphere, or a mesh from a file.
    size : float
        Edge of the sheet, diameter of the sphere, longest edge of the mesh's bounding box, metres; for a mesh
        0 keeps the file's own size.
    albedo : float
        Lambertian; 1 is the paper's "perfectly reflecting" sphere.
    mesh : str
        File of a mesh target (.obj, .ply or .stl), else empty.
    """

    kind: Literal["sheet", "sphere", "mesh"] = "sheet"
    size: float = 0.5
    albedo: float | None = 0.9
    mesh: str = ""

    @classmethod
    def named(cls, name: str, scale: float = 1.0) -> Target:
        """Return the sheet (0.5 m, albedo 0.9) or the sphere (radius 0.2 m, albedo 1) to scale, or a mesh file."""
        if name == "sheet":
            return cls(kind="sheet", size=0.5 * scale, albedo=0.9)
        if name == "sphere":
            return cls(kind="sphere", size=0.4 * scale, albedo=1.0)
        _check(
            Path(name).suffix.lower() in MESH_SUFFIXES,
            f"target {name!r}: must be sheet, sphere or a mesh file ({', '.join(MESH_SUFFIXES)})",
        )
        return cls(kind="mesh", size=0.0, albedo=0.9, mesh=name)


MESH_SUFFIXES = (".obj", ".ply", ".stl")


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A whole scene.

    Attributes
    ----------
    preset : str
        The preset it started from.
    ambient : float
        Uniform radiance of the world, W/m^2/sr; 0 is off.
    reflection_order : int
        How many diffuse reflections a picture may hold; three is lamp, w1, object, w2, camera.
    resolution : (int, int)
        Width and height of a picture, pixels.
    """

    preset: str
    wall: Wall
    spot: Spot
    camera: Camera
    grid: VoxelGrid
    target: Target = field(default_factory=Target)
    room: Room | None = None
    partition: Partition | None = None
    ambient: float = 0.0
    reflection_order: int = 3
    resolution: tuple[int, int] = (64, 64)

    def __post_init__(self) -> None:
        for name, value in _leaves(self):
            if isinstance(value, float):
                _check(math.isfinite(value), f"{name}: {value} is not a finite number")
            if name.endswith("albedo") and value is not None:
                _check(0.0 <= value <= 1.0, f"{name}: {value} must lie between 0 and 1")
        for part in ("wall", "room", "partition", "camera"):
            for axis in "xyz":
                extent = getattr(getattr(self, part), axis, None)
                if isinstance(extent, tuple):
                    # Surfaces may be all in one plane, as a floor alone is; what is built of them is another matter.
                    flat = part in ("room", "partition") and extent[0] == extent[1]
                    _check(extent[0] < extent[1] or flat, f"{part}.{axis}: {extent} must run from low to high")
        _check(self.spot.power >= 0, f"spot.power: {self.spot.power} must not be negative")
        _check(
            0 < self.spot.half_angle < 90,
            f"spot.half_angle: {self.spot.half_angle} must lie between 0 and 90 degrees",
        )
        _check(
            self.spot.location[1] > max(0.0, self.spot.aim[1]),
            f"spot.location: {self.spot.location} must lie before the relay wall, farther from it than spot.aim",
        )
        _check(
            self.camera.location[1] > 0.0,
            f"camera.location: {self.camera.location} must lie before the relay wall, with y above 0",
        )
        _check(self.ambient >= 0, f"ambient: {self.ambient} must not be negative")
        _check(self.target.size >= 0, f"target.size: {self.target.size} must not be negative")
        _check(self.target.size > 0 or self.target.kind == "mesh", "target.size: must be above 0")
        _check(
            1 <= self.reflection_order <= 1024,
            f"reflection_order: {self.reflection_order} must be from 1 to 1024",
        )
        _check(
            all(1 <= n <= 65536 for n in self.resolution),
            f"resolution: {self.resolution} must be from 1 to 65536",
        )
        if self.room:
            unknown = set(self.room.surfaces) - set(ROOM_SURFACES)
            _check(
                not unknown,
                f"room.surfaces: {sorted(unknown)} unknown; choose from {', '.join(ROOM_SURFACES)}",
            )
            twice = len(set(self.room.surfaces)) < len(self.room.surfaces)
            _check(not twice, f"room.surfaces: {list(self.room.surfaces)} names a surface twice")

    def check_buildable(self) -> None:
        """Raise NlosError if a surface to be built would have no area; one that is read from a file may lie flat."""
        parts = [("partition", "y"), ("partition", "z")] if self.partition else []
        for surface in self.room.surfaces if self.room else ():
            parts += [("room", axis) for axis in "xyz" if axis != FACES[surface][0]]
        for part, axis in parts:
            low, high = getattr(getattr(self, part), axis)
            _check(low < high, f"{part}.{axis}: {(low, high)} must run from low to high")

    @property
    def reference_radiance(self) -> float:
        """Radiance of the directly lit relay wall at w1, rho/pi I cos/d^2, W/m^2/sr; rho = 1 if unknown."""
        albedo = 1.0 if self.wall.albedo is None else self.wall.albedo
        return albedo / math.pi * self.spot.irradiance()

    def with_ambient(self, radiance: float) -> Scene:
        """Return the scene under uniform ambient light; a closed room loses its ceiling, or none could enter."""
        room = self.room
        if radiance > 0 and room and set(ROOM_SURFACES) <= set(room.surfaces):
            room = replace(room, surfaces=tuple(s for s in room.surfaces if s != "ceiling"))
        return replace(self, ambient=radiance, room=room)


AUTO = "auto"
"""The cheapest engine that a scene allows: what a sweep takes where its user names none."""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What a sweep renders: all that decides the pixels of a data set besides the scene itself.

    Attributes
    ----------
    engine : {"path", "patch", "surfel"}
    samples : int
        Camera rays per pixel, of `path` and `patch`.
    device : {"cpu", "gpu"}
        That `path` and `patch` render on. A GPU's pixels are its own to the last bit, so it is part of the settings.
    denoise : bool
        Clean what `path` and `patch` render with Open Image Denoise: smooth, and biased.
    paired : bool
        Render each pose's background with the pose's own noise and keep only the difference of the two on top of
        the common background: unbiased, twice the cost, and a far smaller error where the object changes little.
    resolution : (int, int)
        Width and height, pixels.
    poses : int
        Per voxel.
    seed : int
        Of the sweep; every pose's own follows from it.
    inside : {"whole", "centre"}
        What stays inside the voxel: all of the target, or its origin only.
    rotation : (float, float, float)
        Largest angles about x, y, z, degrees; each is drawn between minus and plus that.
    accuracy : float
        Of `surfel`: root mean square error over the pixels, relative to what the target adds.
    frames : int
        Of a trajectory, one after the other, in place of poses in every voxel; 0 is none.
    pace : float
        Of a trajectory, metres from frame to frame.
    leave_out : tuple of str
        Pieces of the scene (`generator.blender.engines.simplify`) and parts of `surfel` (`transport.partial`) that
        are not modelled.
    """

    engine: Literal["path", "patch", "surfel"] = "patch"
    """Of a sweep that is made; where its user names none, it is the cheapest that the scene allows (`AUTO`)."""
    samples: int = 512
    device: Literal["cpu", "gpu"] = "cpu"
    denoise: bool = False
    paired: bool = True
    resolution: tuple[int, int] = (64, 64)
    poses: int = 100
    seed: int = 0
    inside: Literal["whole", "centre"] = "whole"
    rotation: Vector = (0.0, 0.0, 0.0)
    accuracy: float = 1e-3
    frames: int = 0
    pace: float = 0.03
    leave_out: tuple[str, ...] = ()

    @classmethod
    def idle(cls, engine: str) -> tuple[str, ...]:
        """Return the settings that mean nothing to an engine."""
        return ("samples", "device", "denoise", "paired") if engine == "surfel" else ("accuracy",)

    @property
    def unused(self) -> tuple[str, ...]:
        """The settings that mean nothing here: to the engine, and to a sweep of voxels or a trajectory."""
        kind = ("poses", "inside") if self.frames else ("frames", "pace")
        return (*self.idle(self.engine), *kind, *(() if self.leave_out else ("leave_out",)))

    def __post_init__(self) -> None:
        _check(1e-8 <= self.accuracy <= 0.3, f"accuracy: {self.accuracy:g} must be from 1e-08 to 0.3")
        _check(1 <= self.samples <= 2**24, f"samples: {self.samples} must be from 1 to {2**24}")
        _check(0 <= self.frames <= 1_000_000, f"frames: {self.frames} must be from 1 to 1000000")
        _check(0.0 < self.pace < math.inf, f"pace: {self.pace:g} must be positive, metres from frame to frame")
        _check(1 <= self.poses <= 1_000_000, f"poses: {self.poses} must be from 1 to 1000000")
        _check(0 <= self.seed < 2**63, f"seed: {self.seed} must be from 0 to 2^63 - 1")
        _check(
            all(1 <= n <= 65536 for n in self.resolution), f"resolution: {self.resolution} must be from 1 to 65536"
        )
        _check(all(0 <= a <= 180 for a in self.rotation), f"rotation: {self.rotation} must be from 0 to 180 degrees")


def rotation_rows(angles: Array) -> list[list[Any]]:
    """Return the rows of `rotation_matrix` for three angles, radians, each a number or an array of them."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    return [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]


def rotation_matrix(rotation: Vector) -> Array:
    """Return the (3, 3) matrix that turns about x, then y, then z (Blender's XYZ order), angles in degrees."""
    return np.array(rotation_rows(np.radians(rotation)))


def preset(name: str, target: str = "sheet") -> Scene:
    """Return one of the three preset scenes.

    Parameters
    ----------
    name : {"room", "tabletop", "corridor"}
        A room 5 m wide; the synthetic experiment of Klein et al. 2016 (2 m x 2 m of wall seen
        orthographically, a 10 cm square 50 cm from it); an L-shaped corridor at building scale.
    target : str
        "sheet", "sphere" (both to the preset's scale) or the name of a mesh file.

    Raises
    ------
    NlosError
        There is no such preset or target.
    """
    if name == "room":
        x, y, z = (-2.4, 2.6), (0.0, 3.4), (0.0, 2.6)
        return Scene(
            preset=name,
            wall=Wall(x=x, z=z),
            room=Room(x=x, y=y, z=z),
            partition=Partition(x=0.0, y=(1.3, 3.4), z=z),
            spot=Spot(location=(-1.0, 3.0, 1.7), aim=(0.3, 0.0, 1.3), half_angle=1.39),
            camera=Camera(location=(-1.1, 3.0, 1.4), x=(-0.95, 0.05), z=(0.8, 1.8)),
            grid=VoxelGrid(lo=(0.8, 0.4, 0.4), hi=(2.3, 1.9, 2.2)),
            target=Target.named(target),
        )
    if name == "tabletop":
        # Lamp and camera stand between wall and object, as in the paper's synthetic data: they are points
        # that block nothing, and the object hides nothing from them.
        return Scene(
            preset=name,
            wall=Wall(x=(-1.0, 1.0), z=(-1.0, 1.0)),
            spot=Spot(location=(0.0, 0.2, 0.0), aim=(0.0, 0.0, 0.0), half_angle=5.0),
            camera=Camera(location=(0.0, 0.25, 0.0), x=(-1.0, 1.0), z=(-1.0, 1.0), projection="orthographic"),
            grid=VoxelGrid(lo=(-0.3, 0.35, -0.3), hi=(0.3, 0.65, 0.3), shape=(3, 1, 3)),
            target=Target.named(target, 0.2),
        )
    if name == "corridor":
        x, y, z = (-3.0, 14.0), (0.0, 10.0), (0.0, 3.0)
        return Scene(
            preset=name,
            wall=Wall(x=x, z=z),
            room=Room(x=x, y=y, z=z),
            partition=Partition(x=0.0, y=(2.5, 10.0), z=z, depth=14.0, albedo=0.8),
            spot=Spot(location=(-1.8, 8.0, 1.8), aim=(0.6, 0.0, 1.5), half_angle=1.0),
            camera=Camera(location=(-2.0, 8.0, 1.5), x=(-2.4, -0.4), z=(0.5, 2.5)),
            grid=VoxelGrid(lo=(1.5, 0.4, 0.3), hi=(6.0, 2.2, 2.3)),
            target=Target.named(target, 1.2),
        )
    raise NlosError(f"preset {name!r}: there is none; choose from room, tabletop, corridor")


_LENGTHS = ("wall", "room", "partition", "spot.location", "camera", "grid")
_NOT_READ = ("preset", "target.mesh", "spot.aim", "camera.projection", "room.surfaces")
"""What a file does not say, or says in other words."""


def unlike(wanted: Scene, got: Scene) -> str:
    """Return the first figure that Blender could not take as it was wanted, in words; empty if there is none.

    Its numbers have 24 bits and an end, and some of its settings narrower ones: a spot's cone has 1 degree at least.
    """
    found: dict[str, list[Any]] = {}
    for name, value in _leaves(got):
        found.setdefault(name, []).append(value)
    flat = [f"room.{axis}" for axis in "xyz" if len(set(found.get(f"room.{axis}", ()))) == 1]  # as of a floor alone
    near = 1e-6 * max(abs(v) for name in ("wall.x", "wall.z", "camera.location") for v in found[name])
    for name, value in _leaves(wanted):
        if name in _NOT_READ or name not in found:
            continue
        other = found[name].pop(0)
        if not isinstance(value, float) or name in flat or (name == "target.size" and not value):
            continue
        if not math.isclose(other, value, rel_tol=2e-3, abs_tol=near if name.startswith(_LENGTHS) else 0.0):
            return f"{name}: {value:g} becomes {other:g} in Blender"
    return ""


def _leaves(value: Any, prefix: str = "") -> list[tuple[str, Any]]:
    """Every plain figure inside nested dataclasses and tuples, with its dotted name."""
    if is_dataclass(value) and not isinstance(value, type):
        return [
            leaf
            for f in fields(value)
            for leaf in _leaves(getattr(value, f.name), f"{prefix}.{f.name}" if prefix else f.name)
        ]
    if isinstance(value, tuple):
        return [leaf for item in value for leaf in _leaves(item, prefix)]
    return [(prefix, value)]


def from_dict(cls: type, data: Mapping[str, Any], where: str = "") -> Any:
    """Build a dataclass of this module from plain TOML values.

    Raises
    ------
    NlosError
        A field is unknown, missing or of the wrong type; the message names it with its dotted path.
    """
    _check(isinstance(data, Mapping), f"{where.rstrip('. ') or 'scene'}: must be a table")
    hints = get_type_hints(cls)
    known = {f.name for f in fields(cls)}
    for key in data:
        _check(key in known, f"{where}{key}: no such field; known are {', '.join(sorted(known))}")
    try:
        return cls(**{key: _convert(hints[key], value, f"{where}{key}") for key, value in data.items()})
    except TypeError as error:
        raise NlosError(f"{where or 'scene'}: {error}") from None


def _convert(hint: Any, value: Any, where: str) -> Any:
    origin, args = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return None if value is None else _convert(args[0], value, where)
    if is_dataclass(hint) and isinstance(hint, type):
        _check(isinstance(value, Mapping), f"{where}: must be a table")
        return from_dict(hint, value, f"{where}.")
    if origin is tuple:
        _check(isinstance(value, list | tuple), f"{where}: must be a list")
        if len(args) == 2 and args[1] is Ellipsis:
            return tuple(_convert(args[0], item, where) for item in value)
        _check(len(value) == len(args), f"{where}: must hold {len(args)} values, not {len(value)}")
        return tuple(_convert(arg, item, where) for arg, item in zip(args, value, strict=True))
    if origin is Literal:
        _check(value in args, f"{where}: {value!r} must be one of {', '.join(map(str, args))}")
        return value
    if hint is float:
        _check(
            isinstance(value, int | float) and not isinstance(value, bool),
            f"{where}: {value!r} must be a number",
        )
        return float(value)
    if hint is int:
        _check(
            isinstance(value, int) and not isinstance(value, bool),
            f"{where}: {value!r} must be a whole number",
        )
        return value
    _check(isinstance(value, hint), f"{where}: {value!r} must be of type {hint.__name__}")
    return value


def to_dict(value: Any) -> dict[str, Any]:
    """Return a dataclass of this module as plain values, leaving out what is None (TOML has no null)."""
    plain: dict[str, Any] = _without_none(asdict(value))
    return plain


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return value


def parse_resolution(text: str, aspect: float = 1.0) -> tuple[int, int]:
    """Return width and height from ``64`` (the height follows from the aspect) or ``64x48``.

    Raises
    ------
    NlosError
        It is neither.
    """
    width, cross, height = text.lower().partition("x")
    try:
        return int(width), int(height) if cross else max(1, round(int(width) / aspect))
    except ValueError:
        raise NlosError(f"resolution {text!r}: must read 64 or 64x48") from None


def set_field(data: dict[str, Any], assignment: str) -> None:
    """Set one figure of a plain scene from ``dotted.name=value``, where value is TOML.

    Raises
    ------
    NlosError
        It is not an assignment, or the value is not TOML.
    """
    name, equals, text = assignment.partition("=")
    keys = name.strip().split(".")
    _check(bool(equals) and all(keys), f"--set {assignment!r}: must read NAME=VALUE, for example spot.power=500")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    for key in keys[:-1]:
        data = data.setdefault(key, {})
        _check(isinstance(data, dict), f"--set {assignment!r}: {key} is not a table")
    data[keys[-1]] = value


def merge(base: dict[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``base`` with the values of ``over`` laid on top, table by table."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = merge(below, value) if isinstance(below, dict) and isinstance(value, Mapping) else value
    return merged


_DEEP = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){50}""")
"""A key of more parts than any of ours: tomllib of Python 3.11 took gigabytes for some."""


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    NlosError
        The file is missing or is not TOML.
    """
    try:
        text = path.read_text(encoding="utf-8")
        if _DEEP.search(text):
            raise ValueError("a key in it has too many parts")
        return tomllib.loads(text)
    except OSError as error:
        raise NlosError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise NlosError(f"{path}: is not a TOML file ({error})") from None


def dump_toml(data: Mapping[str, Any], prefix: str = "") -> str:
    """Return plain values as TOML text; tables come after the keys of their parent."""
    lines = [f"{_key(key)} = {_value(value)}" for key, value in data.items() if not isinstance(value, Mapping)]
    for key, value in data.items():
        if isinstance(value, Mapping):
            name = f"{prefix}{_key(key)}"
            lines += ["", f"[{name}]", dump_toml(value, f"{name}.")]
    return "\n".join(lines).rstrip() + ("\n" if not prefix else "")


def _key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() and key.isascii() else _json(key)


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    return _json(value)


def _json(value: Any) -> str:
    # JSON's strings, numbers and booleans are TOML's too, but for DEL, which TOML wants escaped.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
