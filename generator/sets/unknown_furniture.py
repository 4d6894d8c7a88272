"""Furniture that nobody knows: boxes on the floor, drawn at random where they leave lamp, camera and target free."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from generator.model.arrays import Array, rotation_matrix
from generator.model.errors import NlosError
from generator.model.uncertainty import Furniture
from generator.sets.unknown_objects import box
from generator.transport.world import Mesh, World

_TRIES = 1000
_APART = 0.02
"""Distance that boxes keep from walls, target and one another, metres."""
_LINES = 24


def unknown_furniture(
    furniture: Furniture, scene: Mapping[str, Any], world: World, place: Array, rng: np.random.Generator
) -> tuple[Mesh, ...]:
    """Return boxes on the floor of a scene's room, turned about the vertical at random.

    Parameters
    ----------
    furniture : Furniture
    scene : mapping
        The scene as plain tables.
    world : World
        Its lamp's cone and its camera's view stay free.
    place : ndarray of shape (3,)
        Position of the target, which the boxes leave free however it is turned, metres.
    rng : Generator

    Raises
    ------
    NlosError
        The scene has no room, or a box finds no place in it.
    """
    room = scene.get("room")
    if not room:
        raise NlosError("uncertain: [furniture] needs a room to stand in, and this scene has none; leave it out")
    radius = max((float(np.linalg.norm(corner)) for corner in _extremes(world)), default=0.0)
    ends = _sight(world)
    taken: list[tuple[Array, float]] = []
    meshes = []
    for _ in range(int(rng.integers(furniture.boxes[0], furniture.boxes[1] + 1))):
        for _ in range(_TRIES):
            lows, highs = np.log(np.array([furniture.width, furniture.width, furniture.height])).T
            edges = np.exp(rng.uniform(lows, highs))
            across = float(np.hypot(*edges[:2])) / 2.0
            low, high = np.array([room["x"], room["y"]], dtype=float).T
            centre = low + rng.uniform(size=2) * (high - low)
            angle, albedo = rng.uniform(0.0, 360.0), rng.uniform(*furniture.albedo)
            fits = bool((np.abs(centre - (low + high) / 2.0) <= (high - low) / 2.0 - across - _APART).all())
            fits = fits and edges[2] < room["z"][1] - room["z"][0]
            fits = fits and not _in_partition(scene, centre, across)
            fits = fits and all(np.hypot(*(centre - c)) > across + r + _APART for c, r in taken)
            middle = np.array([*centre, room["z"][0] + edges[2] / 2.0])
            turn = rotation_matrix((0.0, 0.0, angle))
            if fits and _is_free(middle, edges / 2.0, turn, place, radius, ends):
                taken.append((centre, across))
                made = box(edges, turn, albedo)
                # No light reaches the face that it stands on, and each face costs time.
                seen = made.triangles[:, :, 2].max(axis=1) > 0.0
                meshes.append(Mesh(made.triangles[seen] + middle, made.albedo[seen]))
                break
        else:
            raise NlosError(f"uncertain: a box finds no place in the room in {_TRIES} tries; take smaller or fewer")
    return tuple(meshes)


def _extremes(world: World) -> list[Array]:
    """Return points (of any number) of the target farthest from its origin, or lengths of such."""
    meshes = [corner for body in world.target if isinstance(body, Mesh) for corner in body.triangles.reshape(-1, 3)]
    balls = [body for body in world.target if not isinstance(body, Mesh)]
    return meshes + [np.array([np.linalg.norm(ball.centre) + ball.radius]) for ball in balls]


def _sight(world: World) -> tuple[Array, Array]:
    """Return the ends (n, 3) of lines along which the lamp lights, and the camera sees, the wall."""
    patch, watched = world.patch, world.watched
    turns = np.linspace(0.0, 2.0 * math.pi, _LINES, endpoint=False)[:, None]
    rim = patch.centre + np.cos(turns) * patch.major + np.sin(turns) * patch.minor
    sides = np.linspace(0.0, 1.0, _LINES)
    view = watched.points(np.stack(np.meshgrid(sides, sides), axis=-1).reshape(-1, 2))
    eyes = np.broadcast_to(watched.eye[:3], view.shape) if watched.eye[3] else view + watched.eye[:3]
    starts = np.concatenate([np.broadcast_to(patch.lamp, rim.shape), eyes])
    return starts, np.concatenate([rim, view])


def _in_partition(scene: Mapping[str, Any], centre: Array, across: float) -> bool:
    """Whether a box may reach into the solid partition."""
    partition = scene.get("partition")
    if not partition:
        return False
    x, y = partition["x"], partition["y"]
    inside = x - across - _APART < centre[0] < x + partition["depth"] + across + _APART
    return bool(inside and y[0] - across - _APART < centre[1] < y[1] + across + _APART)


def _is_free(middle: Array, half: Array, turn: Array, place: Array, radius: float, ends: tuple[Array, Array]) -> bool:
    """Whether a box leaves target, lamp's cone and camera's view free; lines against its slabs in its own frame."""
    offset = np.maximum(np.abs((place - middle) @ turn) - half, 0.0)
    if np.linalg.norm(offset) <= radius + _APART:
        return False
    starts, stops = ((points - middle) @ turn for points in ends)
    ways = stops - starts
    size = half + _APART
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (-size - starts) / ways, (size - starts) / ways
    enter = np.nanmax(np.minimum(first, second), axis=1)
    leave = np.nanmin(np.maximum(first, second), axis=1)
    parallel = ((ways == 0.0) & (np.abs(starts) > size)).any(axis=1)
    return not bool(((enter <= leave) & (leave >= 0.0) & (enter <= 1.0) & ~parallel).any())
