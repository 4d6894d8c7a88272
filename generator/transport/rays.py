"""Which surface a ray meets first, and whether anything stands between two points.

A few surfaces are tested one by one, exactly, in NumPy; larger meshes are tested by Embree (through embreex), whose
single precision moves a shadow's edge by a millionth of the scene.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.model.errors import NlosError
from generator.transport.compiled import COMPILED, jit_inlined, jit_released
from generator.transport.elements import TRIANGLE, merge_parallelograms

Floats = NDArray[Any]
Flags = NDArray[np.bool_]

FEW = 32
"""Largest number of surfaces that are tested one by one."""

_NEAR = 1e-6
_NEAR_EMBREE = 1e-4


class Planes(NamedTuple):
    """Flat surfaces as compiled functions take them; see `Surfaces`.

    Attributes
    ----------
    normal, level, origin, dual, triangle : ndarray
    rows : ndarray of shape (m, 13)
        Normal (3) and level; for each of the two dual vectors, it (3) and its product with the origin; and 1 for a
        triangle, 0 else. A row is read from one place in memory.
    """

    normal: Floats
    level: Floats
    origin: Floats
    dual: Floats
    triangle: Flags
    rows: Floats


class Surfaces:
    """Triangles and spheres that rays can meet.

    Parameters
    ----------
    triangles : ndarray of shape (n, 3, 3)
    tint : ndarray of shape (n, groups)
        Albedo; two triangles that form a parallelogram of one tint become one surface.
    spheres : ndarray of shape (s, 4)
        Centre and radius.

    Attributes
    ----------
    normal : ndarray of shape (m, 3)
        Unit normal of each flat surface.
    tint : ndarray of shape (m, groups)
        Albedo of each flat surface.
    area : ndarray of shape (m,)
    """

    def __init__(self, triangles: Floats, tint: Floats, spheres: Floats | None = None) -> None:
        self.spheres = np.zeros((0, 4)) if spheres is None else spheres
        origin, first, second, kind, kept = merge_parallelograms(triangles, tint)
        cross = np.cross(first, second)
        area = np.linalg.norm(cross, axis=1, keepdims=True)
        self.origin, self.first, self.second = origin, first, second
        self.triangle = kind == TRIANGLE
        self.normal, self.tint = cross / area, tint[kept]
        # Dual vectors: a point p of the plane lies at (u, v) = ((p - origin) . across, (p - origin) . along).
        self.dual = np.stack([np.cross(second, self.normal), np.cross(self.normal, first)], axis=1) / area[:, None]
        self.level = (origin * self.normal).sum(axis=1)
        self.area = area[:, 0] * np.where(self.triangle, 0.5, 1.0)
        self._embree = None
        if len(origin) > FEW:
            self._embree = _embree_scene(origin, first, second, self.triangle)

    def __len__(self) -> int:
        return len(self.origin) + len(self.spheres)

    @property
    def planes(self) -> Planes:
        """The flat surfaces as a record."""
        offsets = (self.dual * self.origin[:, None]).sum(axis=2)
        parts = (
            self.normal,
            self.level,
            self.dual[:, 0],
            offsets[:, 0],
            self.dual[:, 1],
            offsets[:, 1],
            self.triangle,
        )
        rows = np.column_stack([part.astype(np.float64) for part in parts])
        return Planes(self.normal, self.level, self.origin, self.dual, self.triangle, rows)

    @property
    def few(self) -> bool:
        """Whether rays are tested against the surfaces one by one."""
        return self._embree is None

    @property
    def extent(self) -> float:
        """Length of the longest edge of the box around all surfaces."""
        low, high = self.box
        return float((high - low).max())

    @property
    def reach(self) -> float:
        """Distance of the farthest corner from the origin."""
        corners = np.linalg.norm(np.concatenate(self.corners()), axis=1)
        balls = np.linalg.norm(self.spheres[:, :3], axis=1) + self.spheres[:, 3]
        return float(max(corners.max(initial=0.0), balls.max(initial=0.0)))

    def samples(self) -> Floats:
        """Return points (n, 3) spread over the flat surfaces."""
        u, v = (g.ravel()[:, None, None] for g in np.meshgrid(*2 * [np.linspace(0.05, 0.95, 7)]))
        return (self.origin + u * self.first + v * self.second).reshape(-1, 3)

    @property
    def box(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner (3,) of the box around all surfaces."""
        around = [self.spheres[:, :3] - self.spheres[:, 3:], self.spheres[:, :3] + self.spheres[:, 3:]]
        points = np.concatenate([*self.corners(), *around])
        return points.min(axis=0), points.max(axis=0)

    def corners(self) -> list[Floats]:
        """Return the corners of the flat surfaces, arrays of shape (n, 3)."""
        far = self.origin + self.first + self.second
        return [self.origin, self.origin + self.first, self.origin + self.second, far[~self.triangle]]

    def outlines(self) -> list[Floats]:
        """Return the corners (3 or 4, 3) of each flat surface, in order around it."""
        one, other = self.origin + self.first, self.origin + self.second
        around = np.stack([self.origin, one, one + self.second, other], axis=1)
        return [np.delete(a, 2, axis=0) if t else a for a, t in zip(around, self.triangle, strict=True)]

    def at(self, which: NDArray[np.int64], uv: Floats) -> Floats:
        """Return places (n, 3) on flat surfaces (n,), at points (n, 2) of the unit square, spread by area."""
        u, v = uv.T
        rest = np.sqrt(np.maximum(0.0, 1.0 - u))
        triangle = self.triangle[which]
        u, v = np.where(triangle, 1.0 - rest, u), np.where(triangle, v * rest, v)
        places: Floats = self.origin[which] + u[:, None] * self.first[which] + v[:, None] * self.second[which]
        return places

    def distance(self, points: Floats) -> Floats:
        """Return the distance (n,) of points (n, 3) from the nearest of the surfaces."""
        offset = points[:, None] - self.spheres[:, :3]
        gaps = np.maximum(np.linalg.norm(offset, axis=2) - self.spheres[:, 3], 0.0)
        found: Floats = gaps.min(axis=1, initial=np.inf)
        if not len(self.origin):
            return found
        offset = points[:, None] - self.origin
        u, v = np.einsum("mij,nmj->inm", self.dual, offset)
        inside = (u >= 0.0) & (v >= 0.0) & np.where(self.triangle, u + v <= 1.0, (u <= 1.0) & (v <= 1.0))
        above = np.where(inside, np.abs(np.einsum("nmj,mj->nm", offset, self.normal)), np.inf)
        last = np.where(self.triangle[:, None], self.second - self.first, self.second)
        across = np.where(self.triangle[:, None], 0.0, self.second)
        for start, edge in ((0.0, self.first), (0.0, self.second), (self.first, last), (across, self.first)):
            way = offset - start
            along = np.clip(np.einsum("nmj,mj->nm", way, edge) / (edge * edge).sum(axis=1), 0.0, 1.0)
            above = np.minimum(above, np.linalg.norm(way - along[..., None] * edge, axis=2))
        return np.minimum(found, above.min(axis=1))

    def subset(self, keep: Flags) -> Surfaces:
        """Return the flat surfaces selected by ``keep``, and all spheres."""
        part = object.__new__(Surfaces)
        part.spheres = self.spheres
        for name in ("origin", "first", "second", "triangle", "normal", "tint", "dual", "level", "area"):
            setattr(part, name, getattr(self, name)[keep])
        part._embree = None
        if keep.sum() > FEW:
            part._embree = (
                self._embree if keep.all() else _embree_scene(part.origin, part.first, part.second, part.triangle)
            )
        return part

    def first_hit(self, start: Floats, way: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Follow rays to the first flat surface.

        Parameters
        ----------
        start, way : ndarray of shape (n, 3)

        Returns
        -------
        which : ndarray of shape (n,)
            Index of the surface, -1 for none.
        far : ndarray of shape (n,)
            Distance in units of ``way``, infinite for none.
        """
        if self._embree is not None:
            scene, owner = self._embree
            low = np.float32(_NEAR_EMBREE)
            origin = (start + low * way).astype(np.float32)
            hits = scene.run(origin, way.astype(np.float32), output=1)
            primitive = np.asarray(hits["primID"], dtype=np.int64)
            which = np.where(primitive >= 0, owner[primitive], -1)
            return which, np.where(primitive >= 0, hits["tfar"].astype(float) + low, np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            return _first_hit(start, way, self.planes)

    def blocked(self, start: Floats, end: Floats) -> Flags:
        """Return whether something other than their own surface stands between points (n, 3) and (n, 3)."""
        if self._embree is not None:
            scene, _ = self._embree
            way = (end - start) * (1.0 - 2.0 * _NEAR_EMBREE)
            origin = start + _NEAR_EMBREE * (end - start)
            hit = scene.run(
                origin.astype(np.float32),
                way.astype(np.float32),
                dists=np.ones(len(way), np.float32),
                query="OCCLUDED",
            )
            blocked: Flags = np.asarray(hit) >= 0
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                blocked = _blocked(start, end, self.planes)
        if len(self.spheres):
            blocked |= _blocked_by_spheres(start, end, self.spheres)
        return blocked


class Placed:
    """Surfaces rotated and moved: rays are transformed to their frame, rather than surfaces to the frame of the rays.

    Parameters
    ----------
    surfaces : Surfaces
    turn, at : ndarray of shape (3, 3) and (3,)
    """

    def __init__(self, surfaces: Surfaces, turn: Floats, at: Floats) -> None:
        self._surfaces, self._turn, self._at = surfaces, turn, at

    def __len__(self) -> int:
        return len(self._surfaces)

    def blocked(self, start: Floats, end: Floats) -> Flags:
        """As `Surfaces.blocked`."""
        return self._surfaces.blocked((start - self._at) @ self._turn, (end - self._at) @ self._turn)


def _embree_scene(origin: Floats, first: Floats, second: Floats, triangle: Flags) -> tuple[Any, NDArray[np.int64]]:
    """Return an Embree scene, and the index of the surface that each of its triangles belongs to."""
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError:
        raise NlosError(
            f"the scene has {len(origin)} surfaces, and ray tests on more than {FEW} need Embree, which this Python "
            "lacks (pip install embreex); the engine 'patch' does without"
        ) from None
    corners = np.stack([origin, origin + first, origin + second], axis=1)
    parallelogram = ~triangle
    halves = np.stack([origin + first + second, origin + second, origin + first], axis=1)[parallelogram]
    scene = EmbreeScene()
    TriangleMesh(scene, np.concatenate([corners, halves]).astype(np.float32))
    return scene, np.concatenate([np.arange(len(origin)), np.flatnonzero(parallelogram)])


@jit_inlined
def nearest(start: Floats, way: Floats, planes: Planes, most: float) -> tuple[int, float]:
    """Return the first surface that a ray, start (3,) and way (3,), meets before ``most``, -1 for none, and where."""
    which, far, rows = -1, most, planes.rows
    s0, s1, s2, w0, w1, w2 = start[0], start[1], start[2], way[0], way[1], way[2]
    for k in range(rows.shape[0]):
        steep = w0 * rows[k, 0] + w1 * rows[k, 1] + w2 * rows[k, 2]
        height = rows[k, 3] - (s0 * rows[k, 0] + s1 * rows[k, 1] + s2 * rows[k, 2])
        # Compared before the division, which most surfaces then need not: they lie behind, or farther away.
        if steep < 0.0:
            steep, height = -steep, -height
        if height <= _NEAR * steep or height >= far * steep:
            continue
        t = height / steep
        p0, p1, p2 = s0 + t * w0, s1 + t * w1, s2 + t * w2
        u = p0 * rows[k, 4] + p1 * rows[k, 5] + p2 * rows[k, 6] - rows[k, 7]
        if u < 0.0 or u > 1.0:
            continue
        v = p0 * rows[k, 8] + p1 * rows[k, 9] + p2 * rows[k, 10] - rows[k, 11]
        if v < 0.0 or v + rows[k, 12] * u > 1.0:
            continue
        which, far = k, t
    return which, far


def _first_hit_loops(start: Floats, way: Floats, planes: Planes) -> tuple[NDArray[np.int64], Floats]:
    """Return the first surface that each ray meets, -1 for none, and its distance."""
    which, far = np.empty(start.shape[0], dtype=np.int64), np.empty(start.shape[0])
    for k in range(start.shape[0]):
        which[k], far[k] = nearest(start[k], way[k], planes, np.inf)
    return which, far


def _first_hit_arrays(start: Floats, way: Floats, planes: Planes) -> tuple[NDArray[np.int64], Floats]:
    """NumPy form of `_first_hit_loops`."""
    which = np.full(start.shape[0], -1, dtype=np.int64)
    far = np.full(start.shape[0], np.inf)
    for k in range(planes.normal.shape[0]):
        t, inside = _on_plane(start, way, planes, k)
        meets = (t > _NEAR) & (t < far) & inside
        far = np.where(meets, t, far)
        which = np.where(meets, k, which)
    return which, far


_first_hit = jit_released(_first_hit_loops) if COMPILED else _first_hit_arrays


def _on_plane(start: Floats, way: Floats, planes: Planes, k: int) -> tuple[Floats, Flags]:
    """Return where rays (n, 3) meet the plane of a surface, and whether that is on the surface."""
    n, d = planes.normal[k], planes.dual[k]
    t = (planes.level[k] - start @ n) / (way @ n)
    place = start + t[:, None] * way - planes.origin[k]
    u, v = place @ d[0], place @ d[1]
    most = u + v if planes.triangle[k] else np.maximum(u, v)
    return t, (np.minimum(u, v) >= 0.0) & (most <= 1.0)


def _blocked_loops(start: Floats, end: Floats, planes: Planes) -> Flags:
    """Return whether surfaces stand between points (n, 3)."""
    blocked = np.empty(start.shape[0], dtype=np.bool_)
    for k in range(start.shape[0]):
        blocked[k] = nearest(start[k], end[k] - start[k], planes, 1.0 - _NEAR)[0] >= 0
    return blocked


def _blocked_arrays(start: Floats, end: Floats, planes: Planes) -> Flags:
    """NumPy form of `_blocked_loops`."""
    blocked = np.zeros(start.shape[0], dtype=np.bool_)
    for k in range(planes.normal.shape[0]):
        t, inside = _on_plane(start, end - start, planes, k)
        blocked |= (t > _NEAR) & (t < 1.0 - _NEAR) & inside
    return blocked


_blocked = jit_released(_blocked_loops) if COMPILED else _blocked_arrays


@jit_released
def _blocked_by_spheres(start: Floats, end: Floats, spheres: Floats) -> Flags:
    """Return whether spheres stand between points. A sphere hides none of its own points, even if rounded inwards."""
    blocked = np.zeros(start.shape[0], dtype=np.bool_)
    w0, w1, w2 = end[:, 0] - start[:, 0], end[:, 1] - start[:, 1], end[:, 2] - start[:, 2]
    length = w0 * w0 + w1 * w1 + w2 * w2
    for k in range(spheres.shape[0]):
        c0, c1, c2 = spheres[k, 0] - start[:, 0], spheres[k, 1] - start[:, 1], spheres[k, 2] - start[:, 2]
        along = (c0 * w0 + c1 * w1 + c2 * w2) / length
        aside = c0 * c0 + c1 * c1 + c2 * c2 - along * along * length
        half = np.sqrt(np.maximum(0.0, spheres[k, 3] ** 2 - aside) / length)
        enters, leaves = np.maximum(along - half, _NEAR), np.minimum(along + half, 1.0 - _NEAR)
        blocked |= (half > 0.0) & (leaves - enters > 1e-5 * half) & (leaves > enters)
    return blocked
