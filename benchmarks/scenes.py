"""Worlds made by hand from a spec, which the benchmarks render without Blender and independently of it."""

from __future__ import annotations

import math

import numpy as np

from generator.model.errors import NlosError
from generator.model.scene import ROOM_SURFACES, Camera, Scene, Spot, Target
from generator.transport.world import Body, LitPatch, Mesh, Sphere, Watched, World


def world_from_spec(scene: Scene, target: tuple[Body, ...] | None = None) -> World:
    """Return the world of a spec.

    Parameters
    ----------
    scene : Scene
    target : tuple of Sphere or Mesh, optional
        Bodies in place of the spec's own target.

    Raises
    ------
    NlosError
        The target is a mesh file, or a material is not Lambertian.
    """
    room = []
    if scene.room:
        extent = {"x": scene.room.x, "y": scene.room.y, "z": scene.room.z}
        faces = dict(zip(ROOM_SURFACES, (("z", 0), ("z", 1), ("y", 1), ("x", 0), ("x", 1)), strict=True))
        for surface in scene.room.surfaces:
            axis, end = faces[surface]
            room.append(_quad({**extent, axis: (extent[axis][end],) * 2}, _albedo(scene.room.albedo)))
    if scene.partition:
        screen = scene.partition
        reach = (screen.x, screen.x + screen.depth)
        room.append(_quad({"x": (screen.x,) * 2, "y": screen.y, "z": screen.z}, _albedo(screen.albedo)))
        if screen.depth > 0.0:
            room.append(_quad({"x": reach, "y": (screen.y[0],) * 2, "z": screen.z}, _albedo(screen.albedo)))
    return World(
        patch=lit_patch(scene.spot, _albedo(scene.wall.albedo)),
        watched=watched(scene.camera, _albedo(scene.wall.albedo), scene.resolution),
        target=target or bodies(scene.target),
        room=tuple(room),
        order=scene.reflection_order,
    )


def lit_patch(spot: Spot, albedo: np.ndarray) -> LitPatch:
    """Return the ellipse where a cone meets the plane y = 0; Dandelin's theorem on its foci is not needed.

    The plane through lamp, axis and normal contains the major axis. At the depth of the ellipse's centre along the
    axis, the cone's radius is that depth times the tangent of the half angle, which gives the minor axis.
    """
    lamp, aim = np.array(spot.location), np.array(spot.aim)
    axis = (aim - lamp) / np.linalg.norm(aim - lamp)
    normal = np.array([0.0, 1.0, 0.0])
    half = math.radians(spot.half_angle)
    tilt = math.acos(-axis[1])
    along = axis + normal * math.cos(tilt)
    along = along / np.linalg.norm(along) if tilt > 1e-9 else np.array([1.0, 0.0, 0.0])
    foot = lamp * (1.0, 0.0, 1.0)
    ends = [foot + lamp[1] * math.tan(tilt + sign * half) * along for sign in (-1.0, 1.0)]
    centre = (ends[0] + ends[1]) / 2.0
    depth = float((centre - lamp) @ axis)
    offset = float(np.linalg.norm(centre - lamp - depth * axis))
    return LitPatch(
        centre=centre,
        major=(ends[1] - ends[0]) / 2.0,
        minor=math.sqrt((depth * math.tan(half)) ** 2 - offset**2) * np.cross(normal, along),
        normal=normal,
        lamp=lamp,
        axis=axis,
        height=float(lamp[1]),
        intensity=np.full(3, spot.intensity),
        albedo=albedo,
        cos_outer=math.cos(half),
        cos_width=0.0,
    )


def watched(camera: Camera, albedo: np.ndarray, resolution: tuple[int, int]) -> Watched:
    """Return the watched rectangle: column 0 is the largest x, row 0 the largest z."""
    (x0, x1), (z0, z1) = camera.x, camera.z
    to_wall = np.array([[x0 - x1, 0.0, x1], [0.0, 0.0, 0.0], [0.0, z0 - z1, z1], [0.0, 0.0, 1.0]])
    orthographic = camera.projection == "orthographic"
    return Watched(
        to_wall=to_wall,
        eye=np.array([0.0, 1.0, 0.0, 0.0] if orthographic else [*camera.location, 1.0]),
        normal=np.array([0.0, 1.0, 0.0]),
        albedo=albedo,
        resolution=resolution,
    )


def bodies(target: Target) -> tuple[Body, ...]:
    """Return the sheet or the sphere of a spec."""
    if target.kind == "sphere":
        return (Sphere(centre=np.zeros(3), radius=target.size / 2.0, albedo=_albedo(target.albedo)),)
    if target.kind == "sheet":
        h = target.size / 2.0
        return (_quad({"x": (-h, h), "y": (0.0, 0.0), "z": (-h, h)}, _albedo(target.albedo)),)
    raise NlosError("target.kind: a mesh file needs Blender to be read")


def box(size: float, albedo: float) -> Mesh:
    """Return a cube without the face at the smallest y: five sides, which see each other."""
    h = (-size / 2.0, size / 2.0)
    sides = [{"x": h, "y": h, "z": h, axis: (end, end)} for axis in "xyz" for end in h if (axis, end) != ("y", h[0])]
    quads = [_quad(side, _albedo(albedo)) for side in sides]
    return Mesh(np.concatenate([q.triangles for q in quads]), np.concatenate([q.albedo for q in quads]))


def moved(body: Body, by: tuple[float, float, float]) -> Body:
    """Return a body shifted in the target's frame."""
    if isinstance(body, Sphere):
        return Sphere(body.centre + by, body.radius, body.albedo)
    return Mesh(body.triangles + np.asarray(by), body.albedo)


def icosphere(radius: float, subdivisions: int = 4) -> np.ndarray:
    """Return triangles (n, 3, 3) of a geodesic sphere, scaled to the true sphere's area, as `build` does."""
    golden = (1.0 + math.sqrt(5.0)) / 2.0
    corners = [np.roll((0.0, a, b * golden), k) for k in range(3) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    points = np.array(corners)
    near = np.linalg.norm(points[:, None] - points[None], axis=-1) < 2.1
    trios = [(i, j, k) for i in range(12) for j in range(i) for k in range(j)]
    faces = [t for t in trios if near[np.ix_(t, t)].all()]
    triangles = points[np.array(faces)]
    for _ in range(subdivisions):
        a, b, c = np.moveaxis(triangles, 1, 0)
        ab, bc, ca = a + b, b + c, c + a
        ab, bc, ca = (m / np.linalg.norm(m, axis=1, keepdims=True) * np.linalg.norm(points[0]) for m in (ab, bc, ca))
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(p, axis=1) for p in parts])
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(cross, axis=1).sum() / 2.0
    return triangles * radius * math.sqrt(4.0 * math.pi / area)


def _albedo(value: float | None) -> np.ndarray:
    if value is None:
        raise NlosError("albedo: must be known")
    return np.full(3, value)


def _quad(extent: dict[str, tuple[float, float]], albedo: np.ndarray) -> Mesh:
    """Return a rectangle that spans the two axes along which its extent is not empty."""
    flat = next(i for i, axis in enumerate("xyz") if extent[axis][0] == extent[axis][1])
    a, b = (i for i in range(3) if i != flat)
    corners = np.zeros((4, 3))
    corners[:, flat] = extent["xyz"[flat]][0]
    corners[:, a] = np.array(extent["xyz"[a]])[[0, 1, 1, 0]]
    corners[:, b] = np.array(extent["xyz"[b]])[[0, 0, 1, 1]]
    return Mesh(corners[[[0, 1, 2], [0, 2, 3]]], np.tile(albedo, (2, 1)))
