"""Scenes to start from, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from generator.model.errors import NlosError, instead
from generator.model.grid import VoxelGrid
from generator.model.scene import Camera, Partition, Room, Scene, Spot, Target, Wall


@dataclass(frozen=True)
class Preset:
    """A scene to start from.

    Attributes
    ----------
    title, words : str
        Name and description, for people.
    make : callable
        Returns the scene, given its own name and that of its target.
    """

    title: str
    words: str
    make: Callable[[str, str], Scene]


def preset(name: str, target: str = "sheet") -> Scene:
    """Return one of the preset scenes.

    Parameters
    ----------
    name : str
        A name in `PRESETS`.
    target : str
        "sheet", "sphere" (both to the preset's scale) or the name of a mesh file.

    Raises
    ------
    NlosError
        There is no such preset or target.
    """
    if name not in PRESETS:
        raise NlosError(f"preset {name!r}: there is none; {instead(name, PRESETS.keys())}")
    return PRESETS[name].make(name, target)


def _room(name: str, target: str) -> Scene:
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


def _tabletop(name: str, target: str) -> Scene:
    """Return the synthetic experiment of Klein et al. 2016."""
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


def _corridor(name: str, target: str) -> Scene:
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


PRESETS = {
    "room": Preset("Room", "a room 5 m wide with a matt black partition that hides the object", _room),
    "tabletop": Preset(
        "Tabletop", "2 m x 2 m of wall seen orthographically, a small object half a metre from it", _tabletop
    ),
    "corridor": Preset(
        "Corridor", "an L-shaped corridor at building scale; the object is behind the corner", _corridor
    ),
}
