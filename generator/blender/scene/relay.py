"""The relay plane: of all faces of the relay wall, the plane that the spot lamp's axis meets first.

The relay wall may be any object: a sheet, a slab, one mesh that holds floor, walls and ceiling. The plane is the wall
that the light is reflected by; all other faces of the object reflect and hide as those of any other object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from generator.blender.scene import geometry, roles
from generator.blender.scene.words import file_name
from generator.model.arrays import Array
from generator.model.errors import NlosError

SLACK = 1e-4
"""Largest distance of a face's corners from its plane, in units of the lamp's distance: n-gons are never quite
plane."""
_TILT = 1e-3
"""Largest angle between a face and its plane, radians."""
_IN_FRAME = 1e-5
"""Largest distance of the relay plane from y = 0, in units of its own size."""


@dataclass(frozen=True)
class RelayPlane:
    """A plane that some of the faces of a relay wall lie in.

    Attributes
    ----------
    point : ndarray of shape (3,)
        Centre of these faces' bounding box, on the plane, metres.
    normal : ndarray of shape (3,)
        Unit normal, towards the lamp.
    faces : ndarray of shape (n,), bool
        Which of the wall's triangles lie in it.
    corners : ndarray of shape (m, 3, 3)
        Those triangles, metres.
    hit : ndarray of shape (3,)
        Where the lamp's axis meets one of them.
    """

    point: Array
    normal: Array
    faces: NDArray[np.bool_]
    corners: Array
    hit: Array

    @property
    def in_frame(self) -> bool:
        """Whether it is the plane y = 0, with the lamp at y > 0."""
        points = self.corners.reshape(-1, 3)
        flat = points - np.outer((points - self.point) @ self.normal, self.normal)
        return bool(self.normal[1] > 0.0 and np.abs(flat[:, 1]).max() <= _IN_FRAME * np.ptp(points, axis=0).max())


def crossings(triangles: Array, origin: Array, way: Array) -> Array:
    """Return how far along a ray each of the triangles (n, 3, 3) is, in units of the length of ``way``; infinite if
    the ray misses it (Moeller and Trumbore 1997)."""
    a = triangles[:, 0] - origin
    first, second = triangles[:, 1] - origin - a, triangles[:, 2] - origin - a
    normals = np.cross(first, second)
    slope = normals @ way
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (normals * a).sum(axis=1) / slope
        across = np.cross(way, a)
        u, v = -(across * second).sum(axis=1) / slope, (across * first).sum(axis=1) / slope
        meets = (slope != 0) & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (distance > 0)
    return np.where(meets, distance, math.inf)


def plane_met(triangles: Array, origin: Array, way: Array) -> RelayPlane | None:
    """Return the plane of those triangles (n, 3, 3) that a ray of unit direction meets first; None if it meets none.
    Which way faces are turned is of no account."""
    distances = crossings(triangles, origin, way)
    nearest = int(distances.argmin()) if len(distances) else 0
    if not len(distances) or math.isinf(distances[nearest]):
        return None
    hit, slack = origin + distances[nearest] * way, SLACK * float(distances[nearest])
    sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    doubled = np.linalg.norm(sides, axis=1)
    normals = sides / np.where(doubled > 0.0, doubled, 1.0)[:, None]
    parallel = (doubled > 0.0) & (np.linalg.norm(np.cross(normals, normals[nearest]), axis=1) <= _TILT)

    def within(face: int) -> NDArray[np.bool_]:
        faces: NDArray[np.bool_] = parallel.copy()
        heights = (triangles[parallel] - triangles[face, 0]) @ normals[face]
        faces[parallel] = (np.abs(heights) <= slack).all(axis=1)
        return faces

    # The largest face tells the plane best: the normal of a sliver is rounded.
    level = parallel & (np.abs(((hit - triangles[:, 0]) * normals).sum(axis=1)) <= slack)
    faces = within(int(np.where(level, doubled, -1.0).argmax()))
    if not faces[nearest]:
        faces = within(nearest)
    towards = np.sign(sides[faces] @ normals[nearest])
    normal = (towards[:, None] * sides[faces]).sum(axis=0)
    normal = normal / np.linalg.norm(normal)
    if normal @ way > 0.0:
        normal = -normal
    corners = triangles[faces]
    mean = np.average(corners.mean(axis=1), axis=0, weights=doubled[faces])
    points = corners.reshape(-1, 3)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    # Projected onto the plane: the centre of a slanted wall's bounding box may lie off it.
    return RelayPlane(centre - ((centre - mean) @ normal) * normal, normal, faces, corners, hit)


def find(scene: bpy.types.Scene, seen: geometry.Snapshot) -> RelayPlane:
    """Return the relay plane of a scene.

    Raises
    ------
    NlosError
        A role is missing or played twice, the relay wall is not rendered, or the axis of the spot lamp misses it.
    """
    wall, lamp = roles.find(scene, "relay_wall"), roles.find(scene, "spot")
    shapes = seen.of([wall])
    if not shapes:
        raise NlosError(
            f"{file_name()}: the relay wall {wall.name!r} {roles.unseen(scene, wall) or 'has no surface'}"
        )
    matrix = seen.matrices["spot"]
    origin, axis = matrix[:3, 3], -matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    plane = plane_met(_triangles(shapes), origin, axis)
    if plane is None:
        raise NlosError(
            f"{file_name()}: the spot {lamp.name!r} does not point at the relay wall {wall.name!r}: its axis meets "
            "none of its faces; aim it at the one that the camera looks at"
        )
    return plane


def refuse_hidden_from_lamp(scene: bpy.types.Scene, seen: geometry.Snapshot) -> None:
    """Raise NlosError if the axis of the spot lamp meets something else before the relay wall."""
    lamp, wall = roles.find(scene, "spot"), roles.find(scene, "relay_wall")
    light: Any = lamp.data
    blockers = getattr(getattr(lamp, "light_linking", None), "blocker_collection", None)
    if lamp.type != "LIGHT" or not light.use_shadow or blockers is not None:
        return
    matrix = seen.matrices["spot"]
    first = _first(scene, seen, matrix[:3, 3], -matrix[:3, 2], "shadow")
    if first is not None and first.owner != wall:
        raise NlosError(
            f"{file_name()}: the spot {lamp.name!r} shines on {first.name!r} before it meets the relay wall "
            f"{wall.name!r}; clear its way, or make {first.name!r} the relay wall"
        )


def refuse_unwatched(scene: bpy.types.Scene, seen: geometry.Snapshot, plane: RelayPlane) -> None:
    """Raise NlosError if what the camera sees in the middle of its picture is not the relay plane."""
    camera, lamp, wall = (roles.find(scene, role) for role in ("camera", "spot", "relay_wall"))
    starts, ways = geometry.corner_rays(scene, camera, seen.matrices["camera"])
    start, way = starts.mean(axis=0), ways.mean(axis=0)
    forward = -seen.matrices["camera"][:3, 2] / np.linalg.norm(seen.matrices["camera"][:3, 2])
    way = way / (way @ forward)
    start = start + camera.data.clip_start * way  # whatever is nearer is not rendered
    first = _first(scene, seen, start, way, "camera")
    if first is None:
        raise NlosError(
            f"{file_name()}: the camera {camera.name!r} does not look at the relay wall {wall.name!r}: in the middle "
            f"of its picture there is nothing; {_turned(camera)} the face that the spot lights"
        )
    if first.owner != wall:
        raise NlosError(
            f"{file_name()}: the camera {camera.name!r} looks at {first.name!r}, not at the relay wall {wall.name!r} "
            f"that the spot {lamp.name!r} lights; clear its way, or turn it"
        )
    triangles = _triangles(seen.of([wall]))
    watched = int(crossings(triangles, start, way).argmin())
    if plane.faces[watched]:
        return
    a, b, c = triangles[watched]
    normal = np.cross(b - a, c - a)
    angle = math.degrees(math.acos(min(1.0, abs(float(normal @ plane.normal / np.linalg.norm(normal))))))
    away = abs(float((a - plane.point) @ plane.normal))
    how = f"{away:.3g} m apart" if angle < math.degrees(_TILT) else f"at {angle:.3g} degrees to one another"
    raise NlosError(
        f"{file_name()}: the spot {lamp.name!r} lights one face of the relay wall {wall.name!r} and the camera "
        f"{camera.name!r} looks at another, {how}; both must look at faces in one plane"
    )


def _turned(camera: bpy.types.Object) -> str:
    if camera.data.type == "ORTHO":  # what it sees is as wide as its scale, and beside it by its shift
        return "lower its Orthographic Scale, or move it before"
    return "turn it to"


def _triangles(shapes: Sequence[geometry.Shape]) -> Array:
    """Return the triangles of surfaces in the world, (n, 3, 3)."""
    triangles: Array = np.concatenate([shape.placed[shape.triangles] for shape in shapes])
    return triangles


def _first(
    scene: bpy.types.Scene, seen: geometry.Snapshot, origin: Array, way: Array, kind: str
) -> geometry.Shape | None:
    """Return the first surface along a ray, of the relay wall and of what stops rays of a kind ("camera", "shadow").

    The target is no such surface, for it will be elsewhere.
    """
    wall, parts = roles.find(scene, "relay_wall"), roles.target_parts(scene)
    nearest, found = math.inf, None
    for shape in seen.shapes:
        if shape.owner in parts:
            continue
        instanced = bpy.data.objects.get(shape.name)
        stops = shape.opaque and all(
            getattr(obj, f"visible_{kind}") for obj in (shape.owner, instanced) if obj is not None
        )
        if not stops and shape.owner != wall:
            continue
        distance = float(crossings(shape.placed[shape.triangles], origin, way).min(initial=math.inf))
        if distance < nearest:
            nearest, found = distance, shape
    return found
