"""Settings of the panels, as descriptions of scenes and sweeps."""

import math
from dataclasses import replace
from typing import Any

import bpy

from generator.blender.engines.settings import with_defaults
from generator.blender.scene.description import read_scene
from generator.blender.scene.words import short, vector
from generator.files.toml import from_dict
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.presets import PRESETS, preset
from generator.model.scene import Scene, Target
from generator.model.settings import Sweep

ROOM = preset("room")


def sweep_of(settings: Any) -> dict[str, Any]:
    """Return what the draft says of a sweep: fields of `Sweep`, those that mean something to its engine."""
    chosen = {
        "engine": settings.engine,
        "samples": settings.samples,
        "accuracy": settings.accuracy,
        "resolution": list(settings.resolution),
        "poses": settings.poses,
        "seed": settings.seed,
        "inside": settings.inside,
    }
    idle = () if settings.engine == "auto" else Sweep.idle(settings.engine)
    if settings.quality != "figures":
        idle = ("samples", "accuracy")
    return {name: value for name, value in chosen.items() if name not in idle}


def wished(settings: Any) -> dict[str, float]:
    """Return the time and error that decide on a data set, as `SweepRequest` takes them; nothing if none does."""
    if settings.quality == "time":
        return {"budget": 60.0 * settings.minutes}
    return {"accuracy": settings.error / 100.0} if settings.quality == "error" else {}


def resolved_sweep(scene: Any) -> Sweep:
    """Return the sweep that the draft describes, as far as it decides the poses.

    Raises
    ------
    NlosError
        The scene cannot be read, or a figure cannot be.
    """
    chosen = sweep_of(scene.nlos)
    if chosen["engine"] == "auto":  # which it will be decides nothing about them
        chosen["engine"] = "patch"
    made: Sweep = from_dict(Sweep, with_defaults(read_scene(scene), chosen), "")
    return made


def spec_of(settings: Any) -> Scene:
    """Return the scene that the draft describes: the preset with the draft's figures in place of its own.

    Raises
    ------
    NlosError
        The figures contradict each other, or a mesh target has no file.
    """
    kind, mesh = settings.target_kind, ""
    if kind == "mesh":
        if not settings.target_mesh:
            raise NlosError("target: choose a mesh file (OBJ, PLY or STL)")
        mesh = Target.named(bpy.path.abspath(settings.target_mesh)).mesh
    base = preset(settings.preset)
    wanted = replace(
        base,
        target=Target(kind=kind, size=short(settings.target_size), albedo=short(settings.target_albedo), mesh=mesh),
        spot=replace(base.spot, power=short(settings.light_power), half_angle=half_angle(settings)),
        grid=grid_of(settings),
        reflection_order=settings.reflection_order,
        resolution=tuple(settings.resolution),
    )
    return wanted.with_ambient(short(settings.ambient_radiance) if settings.use_ambient else 0.0)


def grid_of(settings: Any) -> VoxelGrid:
    """Return the draft's voxel grid.

    Raises
    ------
    NlosError
        A corner is not below the other.
    """
    return VoxelGrid(lo=vector(settings.grid_lo), hi=vector(settings.grid_hi), shape=tuple(settings.grid_counts))


def half_angle(settings: Any) -> float:
    """Return the half angle of the lamp's cone, degrees."""
    return short(math.degrees(settings.light_half_angle))


def fill(settings: Any, scene: Scene, *, target: bool = True) -> None:
    """Set the draft to a scene's figures; what it says on rendering stays.

    Parameters
    ----------
    settings : NlosSettings
    scene : Scene
        A preset of no known name and albedos of None leave the draft's own.
    target : bool
        The target's figures too.
    """
    known = scene.preset in PRESETS
    if known and settings.preset != scene.preset:
        settings.preset = scene.preset  # fills in the preset's figures, so it comes first
    if target:
        settings.target_kind = scene.target.kind
        settings.target_size = scene.target.size
        if scene.target.albedo is not None:
            settings.target_albedo = scene.target.albedo
    settings.light_power = scene.spot.power
    settings.light_half_angle = math.radians(scene.spot.half_angle)
    settings.use_ambient = scene.ambient > 0
    if scene.ambient > 0:
        settings.ambient_radiance = scene.ambient
    settings.grid_counts = scene.grid.shape
    settings.grid_lo, settings.grid_hi = scene.grid.lo, scene.grid.hi
    settings.reflection_order = scene.reflection_order
    settings.resolution = scene.resolution
