"""The change of a picture by a target, after any number of reflections, by following paths at random.

It has nothing in common with the engine but the description of a world: no cells, no polynomials, no quadrature.
Paths leave a point of the wall; the room with the target and the room without it share each path until it meets the
target.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from generator.model.arrays import rotation_matrix
from generator.transport.compiled import jit_in_place, jit_released
from generator.transport.lit import radiance
from generator.transport.prepared import Setting
from generator.transport.rays import Planes, Surfaces, nearest

SIDE = 4
"""Parts of the picture along a side; as many paths leave places drawn anew in each."""
SPLIT = 4
"""Into how many a path divides where it meets the target, which few do."""


@jit_in_place
def _scatter(normal, way):
    """Draw a direction of cosine density about a unit normal (Duff et al. 2017, listing 2)."""
    u, angle = np.random.random(), 2.0 * math.pi * np.random.random()
    c, s, t = math.sqrt(1.0 - u), math.sqrt(u) * math.cos(angle), math.sqrt(u) * math.sin(angle)
    sign = 1.0 if normal[2] >= 0.0 else -1.0
    a = -1.0 / (sign + normal[2])
    b = normal[0] * normal[1] * a
    way[0] = c * normal[0] + s * (1.0 + sign * normal[0] ** 2 * a) + t * b
    way[1] = c * normal[1] + s * sign * b + t * (sign + normal[1] ** 2 * a)
    way[2] = c * normal[2] - s * sign * normal[0] - t * normal[1]


@jit_in_place
def _light(place, normal, patch, to):
    """Draw a point of the lit patch: write the way there, and return the irradiance from it."""
    r, angle = math.sqrt(np.random.random()), 2.0 * math.pi * np.random.random()
    s, t = r * math.cos(angle), r * math.sin(angle)
    x = patch.x + s * patch.major_x + t * patch.minor_x
    y = patch.y + s * patch.major_y + t * patch.minor_y
    to[0], to[1], to[2] = x - place[0], y - place[1], -place[2]
    facing = normal[0] * to[0] + normal[1] * to[1] + normal[2] * to[2]
    if facing <= 0.0 or place[2] <= 1e-9:
        return 0.0
    area = math.pi * abs(patch.major_x * patch.minor_y - patch.major_y * patch.minor_x)
    squared = to[0] ** 2 + to[1] ** 2 + to[2] ** 2
    return facing * place[2] / squared**2 * area * radiance(x, y, patch)


class Glow(NamedTuple):
    """Emitters: triangles, unit normals, lamps, and after each of them the share of all strength that came so far.

    ``strength`` is the sum over all, of area times radiance and of intensity.
    """

    triangles: np.ndarray
    normals: np.ndarray
    places: np.ndarray
    until: np.ndarray
    strength: float


def glow_of(emission):
    """The emitters of a prepared world, of one colour; or none."""
    if emission is None:
        return Glow(np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), 0.0)
    corners = emission.triangles
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(cross, axis=1)
    strengths = np.concatenate([0.5 * twice * emission.radiance[:, 0], emission.intensity[:, 0]])
    total = strengths.sum()
    return Glow(corners, cross / twice[:, None], emission.places, np.cumsum(strengths) / total, total)


@jit_in_place
def _glowing(place, normal, glow, to):
    """Draw a point of the emitters: write the way there, and return the irradiance from it."""
    chosen = np.searchsorted(glow.until, np.random.random())
    flat = glow.triangles.shape[0]
    u, v = np.random.random(), np.random.random()
    if u + v > 1.0:
        u, v = 1.0 - u, 1.0 - v
    facing, sent, squared = 0.0, 0.0, 0.0
    for r in range(3):
        if chosen < flat:
            a, b, c = glow.triangles[chosen, 0, r], glow.triangles[chosen, 1, r], glow.triangles[chosen, 2, r]
            to[r] = a + u * (b - a) + v * (c - a) - place[r]
            sent -= to[r] * glow.normals[chosen, r]
        else:
            to[r] = glow.places[chosen - flat, r] - place[r]
        facing += to[r] * normal[r]
        squared += to[r] ** 2
    if chosen >= flat:
        sent = math.sqrt(squared)
    return max(0.0, facing) * max(0.0, sent) / squared**2 * glow.strength


@jit_in_place
def _arrive(place, normal, way, far, planes, which):
    """Move to where a ray meets a surface, and turn the normal against it."""
    cosine = 0.0
    for r in range(3):
        place[r] += far * way[r]
        cosine += way[r] * planes.normal[which, r]
    for r in range(3):
        normal[r] = -planes.normal[which, r] if cosine > 0.0 else planes.normal[which, r]


@jit_released
def _walk(place, normal, weight, hits, planes, tint, patch, sky, glow, sign, found):
    """Follow a path in one room, from its vertex number ``hits`` on; add light by its number of reflections."""
    way, to = np.empty(3), np.empty(3)
    order = found.shape[1] - 1
    while hits < order:
        light = _light(place, normal, patch, to)
        if light > 0.0 and hits + 2 <= order and nearest(place, to, planes, 1.0 - 1e-7)[0] < 0:
            found[0, hits + 2] += sign * weight * light
        if glow.strength > 0.0:
            light = _glowing(place, normal, glow, to)
            if light > 0.0 and nearest(place, to, planes, 1.0 - 1e-7)[0] < 0:
                found[2, hits + 1] += sign * weight * light
        _scatter(normal, way)
        which, far = nearest(place, way, planes, np.inf)
        if which < 0:
            found[1, hits + 1] += sign * weight * sky
            return
        _arrive(place, normal, way, far, planes, which)
        weight *= tint[which]
        if weight == 0.0:
            return
        if weight < 0.1:
            if np.random.random() < 0.5:
                return
            weight *= 2.0
        hits += 1


@jit_in_place
def _leave(part, to_wall, place, normal):
    """Draw a place of a part of the picture, on the wall."""
    u, v = (part[0] + np.random.random()) / SIDE, (part[1] + np.random.random()) / SIDE
    scale = to_wall[2, 0] * u + to_wall[2, 1] * v + to_wall[2, 2]
    for r in range(2):
        place[r] = (to_wall[r, 0] * u + to_wall[r, 1] * v + to_wall[r, 2]) / scale
    place[2] = 0.0
    normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0


@jit_released
def _empty(seed, count, part, to_wall, room, tint, patch, sky, glow, found):
    """Follow paths from a part of the picture in the room without the target; add light by reflections."""
    np.random.seed(seed)
    place, normal = np.empty(3), np.empty(3)
    for _ in range(count):
        _leave(part, to_wall, place, normal)
        _walk(place, normal, 1.0, 0, room, tint, patch, sky, glow, 1.0, found)


@jit_released
def _hide(place, normal, weight, hits, room, target, glow, to, found):
    """Take the light of emitters that the target hides from a place."""
    if glow.strength == 0.0 or hits + 1 >= found.shape[1]:
        return
    light = _glowing(place, normal, glow, to)
    shadowed = light > 0.0 and nearest(place, to, target, 1.0 - 1e-7)[0] >= 0
    if shadowed and nearest(place, to, room, 1.0 - 1e-7)[0] < 0:
        found[2, hits + 1] -= weight * light


@jit_released
def _paths(seed, count, part, to_wall, room, both, target, tint, patch, sky, glow, found):
    """Follow paths from a part of the picture; add what the target changes by the number of reflections."""
    np.random.seed(seed)
    order = found.shape[1] - 1
    place, normal, way, to = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    there, facing, start, turned = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for _ in range(count):
        _leave(part, to_wall, place, normal)
        weight = 1.0
        _hide(place, normal, weight, 0, room, target, glow, to, found)
        for hits in range(1, order + 1):
            _scatter(normal, way)
            wall, beyond = nearest(place, way, room, np.inf)
            body, near = nearest(place, way, target, beyond)
            if body >= 0:
                there[:] = place
                _arrive(there, facing, way, near, target, body)
                reflected = weight * tint[room.normal.shape[0] + body]
                start[:], turned[:] = there, facing
                for _ in range(SPLIT if reflected > 0.0 else 0):
                    there[:], facing[:] = start, turned
                    _walk(there, facing, reflected, hits, both, tint, patch, sky, glow, 1.0 / SPLIT, found)
                if wall < 0:
                    found[1, hits] -= weight * sky
                elif tint[wall] > 0.0:
                    for _ in range(SPLIT):
                        there[:] = place
                        _arrive(there, facing, way, beyond, room, wall)
                        kept = weight * tint[wall]
                        _walk(there, facing, kept, hits, room, tint, patch, sky, glow, -1.0 / SPLIT, found)
                break
            if wall < 0:
                break
            _arrive(place, normal, way, beyond, room, wall)
            weight *= tint[wall]
            if weight < 0.1:
                if np.random.random() < 0.5:
                    break
                weight *= 2.0
            light = _light(place, normal, patch, to)
            shadowed = nearest(place, to, target, 1.0 - 1e-7)[0] >= 0
            if light > 0.0 and hits + 2 <= order and shadowed and nearest(place, to, room, 1.0 - 1e-7)[0] < 0:
                found[0, hits + 2] -= weight * light
            _hide(place, normal, weight, hits, room, target, glow, to, found)
    return found


def change(world, position, rotation, count, *, repeats=8, seed=1):
    """Return the mean change of the picture by number of reflections, and its standard error, (3, order + 1) each.

    As `changes` has it.
    """
    found = changes(world, position, rotation, count, repeats=repeats, seed=seed)
    return found.mean(axis=0), found.std(axis=0, ddof=1) / math.sqrt(repeats)


def changes(world, position, rotation, count, *, repeats=8, seed=1):
    """Return the mean change of the picture by number of reflections, in several runs, (repeats, 3, order + 1).

    The first row is of the lamp's light, in units of the lit patch's radiance times pi times the wall's albedo; the
    second of the sky's, in units of its radiance times the wall's albedo; the third of emitters', in units of
    `Emission.colour`. Only flat, grey surfaces.
    """
    setting = Setting(world)
    around, target = setting.around, setting.target
    turn, place = setting.frame.axes @ rotation_matrix(rotation), setting.frame.points(np.asarray(position, float))
    corners = [target.origin, target.origin + target.first, target.origin + target.second]
    moved = np.stack([c @ turn.T + place for c in corners], axis=1)
    far = np.stack([moved[:, 1] + moved[:, 2] - moved[:, 0], moved[:, 2], moved[:, 1]], axis=1)
    every = np.concatenate([moved, far[~target.triangle]])
    placed = Surfaces(every, np.zeros((len(every), 1)))
    tint = np.append(around.tint[:, 0], np.full(len(placed), target.tint[0, 0]))
    both = Planes(*(np.concatenate(pair) for pair in zip(around.planes, placed.planes, strict=True)))

    glow = glow_of(setting.emission)

    def follow(number, part, found):
        sky = float(world.ambient is not None)
        rooms = around.planes, both, placed.planes
        _paths(number, count, part, setting.to_wall, *rooms, tint, setting.patch, sky, glow, found)

    return _repeated(follow, count, world.order, repeats, seed)


def backgrounds(world, count, *, repeats=8, seed=1):
    """Return the mean light of the empty room by number of reflections, in several runs, as `changes` does.

    Without the lit patch itself, where the picture shows it.
    """
    setting = Setting(world)
    glow, around = glow_of(setting.emission), setting.around

    def follow(number, part, found):
        sky, room, tint = float(world.ambient is not None), around.planes, around.tint[:, 0]
        _empty(number, count, part, setting.to_wall, room, tint, setting.patch, sky, glow, found)

    return _repeated(follow, count, world.order, repeats, seed)


def _repeated(follow, count, order, repeats, seed):
    found = np.zeros((repeats, 3, order + 1))
    for repeat in range(repeats):
        for point in range(SIDE**2):
            part = np.array(divmod(point, SIDE), float)
            follow((seed * repeats + repeat) * SIDE**2 + point, part, found[repeat])
    return found / (count * SIDE**2)
