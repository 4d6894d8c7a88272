"""A target as the picture's points see it: its light in place of what is behind it.

A target that is not near is summed over points of its surface: the same ones for all points of the picture, so that
the sum is as smooth there as the light. A target that is near is met by lines into the cone around it.

Each sum has two forms, loops for numba and arrays for NumPy; tests check that they agree to rounding.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.transport.compiled import jit_in_place, jit_released
from generator.transport.light.cells import Cells, Grid, Hits, locate, meet_sphere, summed
from generator.transport.light.near import Near, mark
from generator.transport.light.spread import around
from generator.transport.rays import Surfaces, nearest

Floats = NDArray[Any]
Numbers = NDArray[np.int64]

_BEFORE = 1.0 - 1e-6
"""Share of the way to a point on which something may hide it."""


class Pose(NamedTuple):
    """Pose of the target, the ball around it, centre (3,) and radius, and small cells of the room near it."""

    turn: Floats
    place: Floats
    centre: Floats
    radius: float
    near: Near


class Eye(NamedTuple):
    """Points of the picture (n, 3), and points of the unit square (n, k, 2) for lines from each to the target."""

    places: Floats
    spread: Floats


class Skin(NamedTuple):
    """Points of the target's surface, in its own frame.

    Attributes
    ----------
    places, normals : ndarray of shape (n, 3)
    part : ndarray of shape (n,), int
        Cell that each is in.
    area : ndarray of shape (n,)
    hides : bool
        Whether one point may hide another that faces the same way.
    """

    places: Floats
    normals: Floats
    part: Numbers
    area: Floats
    hides: bool


class Sums(NamedTuple):
    """Light that the wall sees, summed over reflections; columns are sets times groups.

    Attributes
    ----------
    room : ndarray of shape (rows, columns)
        Radiosity of the room's cells and the sky, as `near.Near` lists them.
    body : ndarray of shape (target's cells, columns)
        Radiosity of the target's.
    coefficients : ndarray of shape (coefficients, columns)
        Picture of what the changed room sends.
    """

    room: Floats
    body: Floats
    coefficients: Floats


@jit_in_place
def _nothing(sky: int, corners: Numbers, shares: Floats) -> None:
    """Write what a ray is interpolated between that meets no surface: the sky alone."""
    for c in range(5):
        corners[c], shares[c] = sky, 1.0 if c == 0 else 0.0


@jit_in_place
def _replace(weight: float, cell: int, corners: Numbers, shares: Floats, sums: Sums, light: Floats) -> None:
    """Add to ``light`` (columns,) that of a cell of the target in place of the room's behind it."""
    for g in range(light.shape[0]):
        hidden = 0.0
        for c in range(5):
            hidden += shares[c] * sums.room[corners[c], g]
        light[g] += weight * (sums.body[cell, g] - hidden)


@jit_released
def look(eye: Eye, pose: Pose, body: Grid, room: Grid, sums: Sums, light: Floats) -> None:
    """Add to ``light`` (points, columns) what lines into the cone around the target meet, less what is behind it."""
    rays = eye.spread.shape[1]
    axis, way, start, turned, moved = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    corners, shares = np.zeros(5, dtype=np.int64), np.zeros(5)
    unused, none = np.zeros(4, dtype=np.int64), np.zeros(4)
    for p in range(eye.places.shape[0]):
        far = 0.0
        for r in range(3):
            start[r] = eye.places[p, r]
            axis[r] = pose.centre[r] - start[r]
            far += axis[r] * axis[r]
        far = math.sqrt(far)
        cone = -1.0
        if far > pose.radius:
            cone = math.sqrt(1.0 - (pose.radius / far) ** 2)
        x, y, z = axis[0] / far, axis[1] / far, axis[2] / far
        sign = 1.0 if z >= 0.0 else -1.0
        a = -1.0 / (sign + z)
        b = x * y * a
        for k in range(rays):
            cosine = 1.0 - (1.0 - cone) * eye.spread[p, k, 0]
            angle = 2.0 * math.pi * eye.spread[p, k, 1]
            sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
            u, v = sine * math.cos(angle), sine * math.sin(angle)
            way[0] = cosine * x + u * (1.0 + sign * x * x * a) + v * b
            way[1] = cosine * y + u * sign * b + v * (sign + y * y * a)
            way[2] = cosine * z - u * sign * x - v * y
            if way[2] <= 0.0:
                continue
            for r in range(3):
                turned[r], moved[r] = 0.0, 0.0
                for t in range(3):
                    turned[r] += pose.turn[t, r] * way[t]
                    moved[r] += pose.turn[t, r] * (start[t] - pose.place[t])
            which, near = nearest(moved, turned, body.planes, np.inf)
            ball, near = meet_sphere(moved, turned, body, near)
            if which < 0 and ball < 0:
                continue
            wall, beyond = nearest(start, way, room.planes, np.inf)
            if beyond <= near:
                continue
            cell = ball if ball >= 0 else locate(moved, turned, which, near, body, unused, none)
            weight = way[2] * 2.0 * (1.0 - cone) / rays
            if wall >= 0:
                locate(start, way, wall, beyond, room, corners, shares)
                mark(start, way, wall, beyond, room.planes, pose.near, corners, shares)
            else:
                _nothing(pose.near.rows - 1, corners, shares)
            _replace(weight, cell, corners, shares, sums, light[p])


def look_arrays(eye: Eye, pose: Pose, body: Cells, room: Cells, sums: Sums) -> Floats:
    """NumPy form of `look`, and for surfaces that are too many to be tested one by one; returns the light."""
    points, rays = eye.spread.shape[:2]
    offset = pose.centre - eye.places
    far = np.sqrt(np.einsum("ni,ni->n", offset, offset))
    sine = pose.radius / np.maximum(far, pose.radius)
    cone = np.repeat(np.where(far > pose.radius, np.sqrt(1.0 - sine**2), -1.0), rays)
    axis = np.repeat(offset / np.maximum(far, 1e-300)[:, None], rays, axis=0)
    spread = eye.spread.reshape(-1, 2)
    way = around(axis, 1.0 - (1.0 - cone) * spread[:, 0], 2.0 * math.pi * spread[:, 1])
    rows = np.flatnonzero(way[:, 2] > 0.0)
    way, owner = way[rows], rows // rays
    start = eye.places[owner]
    front = body.meet((start - pose.place) @ pose.turn, way @ pose.turn)
    met = np.flatnonzero(front.cell < body.count)
    behind = room.meet(start[met], way[met])
    free = behind.far > front.far[met]
    met = met[free]
    behind = pose.near.marked(Hits(*(part[free] for part in behind)), start[met], way[met], room)
    hidden = behind.of(sums.room)
    weight = way[met, 2] * 2.0 * (1.0 - cone[rows[met]]) / rays
    return summed(owner[met], weight[:, None] * (sums.body[front.cell[met]] - hidden), points)


@jit_released
def look_at(places: Floats, pose: Pose, skin: Skin, body: Grid, room: Grid, sums: Sums, light: Floats) -> None:
    """Add to ``light`` (places, columns) what the target's surface sends to places (n, 3), less what it hides."""
    way, start, turned, moved = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    corners, shares = np.zeros(5, dtype=np.int64), np.zeros(5)
    on, facing = np.empty((len(skin.area), 3)), np.empty((len(skin.area), 3))
    for k in range(len(skin.area)):
        for r in range(3):
            on[k, r], facing[k, r] = pose.place[r], 0.0
            for t in range(3):
                on[k, r] += pose.turn[r, t] * skin.places[k, t]
                facing[k, r] += pose.turn[r, t] * skin.normals[k, t]
    for p in range(places.shape[0]):
        for r in range(3):
            start[r] = places[p, r]
        for k in range(len(skin.area)):
            squared, sent = 0.0, 0.0
            for r in range(3):
                way[r] = on[k, r] - start[r]
                squared += way[r] * way[r]
                sent -= way[r] * facing[k, r]
            if way[2] <= 0.0 or sent <= 0.0:
                continue
            if skin.hides:
                for r in range(3):
                    turned[r], moved[r] = 0.0, 0.0
                    for t in range(3):
                        turned[r] += pose.turn[t, r] * way[t]
                        moved[r] += pose.turn[t, r] * (start[t] - pose.place[t])
                if nearest(moved, turned, body.planes, _BEFORE)[0] >= 0:
                    continue
                if meet_sphere(moved, turned, body, _BEFORE)[0] >= 0:
                    continue
            wall, beyond = nearest(start, way, room.planes, np.inf)
            if beyond <= 1.0:
                continue
            weight = way[2] * sent / (math.pi * squared * squared) * skin.area[k]
            cell = skin.part[k]
            if wall >= 0:
                locate(start, way, wall, beyond, room, corners, shares)
                mark(start, way, wall, beyond, room.planes, pose.near, corners, shares)
            else:
                _nothing(pose.near.rows - 1, corners, shares)
            _replace(weight, cell, corners, shares, sums, light[p])


def look_at_arrays(places: Floats, pose: Pose, skin: Skin, target: Surfaces, room: Cells, sums: Sums) -> Floats:
    """NumPy form of `look_at`; returns the light."""
    on, facing = skin.places @ pose.turn.T + pose.place, skin.normals @ pose.turn.T
    way = (on - places[:, None]).reshape(-1, 3)
    point, spot = np.divmod(np.arange(len(way)), len(on))
    sent = -np.einsum("ni,ni->n", way, facing[spot])
    some = np.flatnonzero((way[:, 2] > 0.0) & (sent > 0.0))
    if skin.hides:
        start = (places[point[some]] - pose.place) @ pose.turn
        some = some[~target.blocked(start, start + _BEFORE * way[some] @ pose.turn)]
    way, sent, point, spot = way[some], sent[some], point[some], spot[some]
    squared = np.einsum("ni,ni->n", way, way)
    far = np.sqrt(squared)
    direction = way / far[:, None]
    behind = room.meet(places[point], direction)
    free = behind.far > far
    behind = Hits(*(part[free] for part in behind))
    hidden = pose.near.marked(behind, places[point[free]], direction[free], room).of(sums.room)
    weight = (way[:, 2] * sent / (math.pi * squared**2) * skin.area[spot])[free]
    return summed(point[free], weight[:, None] * (sums.body[skin.part[spot[free]]] - hidden), len(places))
