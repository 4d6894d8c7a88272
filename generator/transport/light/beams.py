"""Light that comes straight from a source: from the lit patch, from lamps, from surfaces that glow.

A source is represented by points, each of which lights a place with normal n at the distance d by

    E = w cos_n cos_s / d^2

(radiance times area, and the source's own cosine; radiant intensity and 1 for a lamp without extent).

A lamp with Blender's soft falloff, of radius r, shines as a disk that faces each place: with D the distance of its
middle, D^2 / (D^2 + r^2) of the light of a ball.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from generator.transport.light.cells import Spots
from generator.transport.prepared import Emission, Setting
from generator.transport.rays import Surfaces

Floats = NDArray[Any]
Numbers = NDArray[np.int64]

_TOUCH = 1e-9
_POINTS, _FEW, _DENSE = 256, 16, 1 << 14
"""Number of points of all that glows, at least one for each triangle; of those near which cells are small; and of
those that cast shadows with an edge."""
_CHUNK = 1 << 18
_BITS = 16
"""Bits of a place along each axis, by which points are put in order."""


class Points(NamedTuple):
    """Points of a source.

    Attributes
    ----------
    places : ndarray of shape (n, 3)
    normals : ndarray of shape (n, 3)
        Unit normals of the surfaces that they are on; zero for a lamp without extent.
    weights : ndarray of shape (n, groups)
    softness : ndarray of shape (n,)
        Radius of a lamp with a soft falloff, else 0.
    """

    places: Floats
    normals: Floats
    weights: Floats
    softness: Floats

    def towards(self, chosen: Numbers, way: Floats, facing: Floats) -> Floats:
        """Return the irradiance per weight of places by chosen points.

        Parameters
        ----------
        chosen : ndarray, int
        way : ndarray of the same shape and 3 more
            From the place to the point.
        facing : ndarray of the same shape
            Product of the place's normal with it.
        """
        normal = self.normals[chosen]
        squared = np.maximum((way * way).sum(axis=-1), 1e-300)
        sent = np.where(normal.any(axis=-1), -(way * normal).sum(axis=-1), np.sqrt(squared))
        lit = (facing > 0.0) & (sent > _TOUCH)
        light = np.where(lit, facing * sent / squared**2, 0.0)
        radius = self.softness[chosen]
        if not radius.any():
            return light
        to_middle = way - radius[..., None] * normal
        squared = (to_middle * to_middle).sum(axis=-1)
        return light * squared / np.maximum(squared + radius**2, 1e-300)


class Beams(Protocol):
    """Light of a source, as it arrives without a reflection in between.

    Attributes
    ----------
    blockers : Surfaces
        What may be in its way, besides the target.
    finest : Points
        The points for places anywhere.
    """

    blockers: Surfaces
    finest: Points

    def points(self, place: Floats, radius: float) -> Points:
        """Return the points that represent the source for places in a ball, of centre (3,) and radius."""


class PatchBeams:
    """Light of the lit patch, of radiance 1 under the lamp.

    Parameters
    ----------
    setting : Setting
    """

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        self.blockers = setting.obstacles.static_blockers
        self.finest = self._of(8)

    def points(self, place: Floats, radius: float) -> Points:
        """As in `Beams`."""
        patch = self._setting.patch
        far = float(np.linalg.norm(place - [patch.x, patch.y, 0.0])) - radius
        ratio = far / math.hypot(patch.major_x, patch.major_y)
        soft = patch.cos_width > 0.0
        return self._of(8 if ratio < 2.0 else 6 if soft else 4 if ratio < 6.0 else 2)

    def _of(self, number: int) -> Points:
        """Return the points of a rule with ``number`` of them along the patch's diameter."""
        x, y, weight = self._setting.whole[number][:, : number**2]
        flat = np.zeros(len(x))
        groups = self._setting.tint.shape[1]
        normals = np.tile([0.0, 0.0, 1.0], (len(x), 1))
        return Points(np.stack([x, y, flat], axis=1), normals, np.repeat(weight[:, None], groups, axis=1), flat)


class EmitterBeams:
    """Light of surfaces that glow, and of lamps.

    Parameters
    ----------
    emission : Emission
    blockers : Surfaces
        All that can be in the way of this light, but the target.

    Attributes
    ----------
    spots : Spots
        Some of the points.
    dense : Points
        Many points: shadows of few would be those of so many lamps without extent. Those with numbers that are near
        each other are near each other.
    """

    def __init__(self, emission: Emission, blockers: Surfaces) -> None:
        self.blockers = blockers
        self.finest, self.dense = _spread(emission, _POINTS), _along_a_curve(_spread(emission, _DENSE))
        few = _spread(emission, _FEW)
        size = np.sqrt(few.weights.max(axis=1) / np.maximum(1e-300, emission.radiance.max(initial=0.0)))
        self.spots = Spots(few.places, few.normals, np.where(few.normals.any(axis=1), size, 0.0))

    def points(self, place: Floats, radius: float) -> Points:
        """As in `Beams`."""
        return self.finest


def arriving(beams: Beams, points: Points, places: Floats, normals: Floats, chosen: Numbers) -> Floats:
    """Return the irradiance of places (n, 3) with normals (n, 3), per weight, from chosen points (n, k) of a source.

    Surfaces of the room hide it, the target does not.

    Returns
    -------
    light : ndarray of shape (n, k)
    """
    way = points.places[chosen] - places[:, None]
    light = points.towards(chosen, way, np.einsum("nkc,nc->nk", way, normals))
    if len(beams.blockers):
        row, column = np.nonzero(light)
        hidden = beams.blockers.blocked(points.places[chosen[row, column]], places[row])
        light[row[hidden], column[hidden]] = 0.0
    return light


def irradiance(beams: Beams, points: Points, places: Floats, normals: Floats) -> Floats:
    """Return the irradiance of places (n, 3) with normals (n, 3) from all points of a source, (n, groups)."""
    count = len(points.places)
    step = max(1, _CHUNK // count)
    light = np.empty((len(places), points.weights.shape[1]))
    for k in range(0, len(places), step):
        some = slice(k, k + step)
        chosen = np.tile(np.arange(count), (len(places[some]), 1))
        light[some] = arriving(beams, points, places[some], normals[some], chosen) @ points.weights
    return light


def _area(triangles: Floats) -> Floats:
    sides = triangles[:, 1:] - triangles[:, :1]
    area: Floats = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return area


def _spread(emission: Emission, number: int) -> Points:
    """Return about ``number`` points, at least one for each triangle: the centres of equal parts of the triangles."""
    area = _area(emission.triangles)
    sides = emission.triangles[:, 1:] - emission.triangles[:, :1]
    normals = np.cross(sides[:, 0], sides[:, 1]) / (2.0 * area[:, None])
    share = number * area / max(float(area.sum()), 1e-300)
    cuts = np.maximum(1, np.rint(np.sqrt(share))).astype(np.int64)
    soft, of_places = np.split(emission.softness, [len(area)])
    found = [(emission.places, np.zeros_like(emission.places), emission.intensity, of_places)]
    for n in np.unique(cuts):
        some = np.flatnonzero(cuts == n)
        uv = _centres(int(n))
        places = emission.triangles[some, 0][:, None] + np.einsum("kc,tcx->tkx", uv, sides[some])
        strength = emission.radiance * area[:, None] / n**2
        found.append(
            (places.reshape(-1, 3), *(np.repeat(part[some], n**2, axis=0) for part in (normals, strength, soft)))
        )
    return Points(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _along_a_curve(points: Points) -> Points:
    """Return points in the order of their bits, those of all axes in turn (Morton 1966)."""
    low = points.places.min(axis=0)
    size = max(float((points.places.max(axis=0) - low).max()), 1e-300)
    steps = ((points.places - low) * ((1 << _BITS) - 1) / size).astype(np.int64)
    code = np.zeros(len(steps), dtype=np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            code |= (steps[:, axis] >> bit & 1) << (3 * bit + axis)
    order = np.argsort(code, kind="stable")
    return Points(*(part[order] for part in points))


def _centres(n: int) -> Floats:
    """Return the centres (n^2, 2), along two sides of a triangle, of the n^2 equal triangles that it is cut into."""
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    upright, inverted = i + j < n, i + j < n - 1
    up = np.stack([i, j], axis=1)[upright] + 1.0 / 3.0
    down = np.stack([i, j], axis=1)[inverted] + 2.0 / 3.0
    centres: Floats = np.concatenate([up, down]) / n
    return centres
