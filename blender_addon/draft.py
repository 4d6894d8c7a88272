"""Conversion between the settings of the panels (the draft) and descriptions of scenes and sweeps."""

import contextlib
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from generator.blender.engines import devices
from generator.blender.engines.settings import with_defaults
from generator.blender.scene.description import read_scene
from generator.blender.scene.words import short, vector
from generator.files.toml import from_dict
from generator.model.engines import AUTO
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.presets import PRESETS, preset
from generator.model.scene import Scene, Target
from generator.model.settings import Sweep

ROOM = preset("room")
PREFERENCES = "preferences"
"""The device of a draft that follows Blender's preferences."""


def sweep_of(settings: Any) -> dict[str, Any]:
    """Return the sweep settings of the draft: those fields of `Sweep` that its engine uses."""
    chosen = {
        "engine": settings.engine,
        "samples": settings.samples,
        "accuracy": settings.accuracy,
        "resolution": list(settings.resolution),
        "poses": settings.poses,
        "seed": settings.seed,
        "inside": settings.inside,
    }
    if device_of(settings) != Sweep.device:
        chosen["device"] = device_of(settings)
    idle = () if settings.engine == AUTO else Sweep.idle(settings.engine)
    if settings.quality != "figures":
        idle = (*idle, "samples", "accuracy")
    return {name: value for name, value in chosen.items() if name not in idle}


def device_of(settings: Any) -> str:
    """Return the device of the draft, ``cpu`` or ``gpu``; that of Blender's preferences if the draft follows them."""
    if settings.device == PREFERENCES:
        return "gpu" if devices.preferred(devices.preferences()) else "cpu"
    return str(settings.device)


def wished(settings: Any) -> dict[str, float]:
    """Return the time (s) or the error that decides on a data set, as in `SweepRequest`; empty if neither does."""
    if settings.quality == "time":
        return {"budget": 60.0 * settings.minutes}
    return {"accuracy": settings.error / 100.0} if settings.quality == "error" else {}


def resolved_sweep(scene: Any) -> Sweep:
    """Return the sweep that the draft describes, as far as it determines the poses.

    Raises
    ------
    NlosError
        The scene or one of the settings cannot be read.
    """
    chosen = sweep_of(scene.nlos)
    if chosen["engine"] == AUTO:  # the choice of engine does not affect the poses
        chosen["engine"] = "patch"
    sweep: Sweep = from_dict(Sweep, with_defaults(read_scene(scene), chosen), "")
    return sweep


def folder(scene: Any) -> Path:
    """Return the data set's folder; raise NlosError as `folder_named` does."""
    return folder_named(scene.nlos.dataset)


def folder_named(name: str) -> Path:
    """Return the folder of a data set by the name in a panel, which may be relative to the open file.

    Raises
    ------
    NlosError
        No folder is named, it is relative to a file that is not saved, or its path cannot be used.
    """
    if not name:
        raise NlosError("Name a folder for the data set")
    if name.startswith("//") and not bpy.data.filepath:
        raise NlosError("Save the file first, or name the data set's folder in full: it lies beside the file")
    path = Path(bpy.path.abspath(name)).absolute()
    try:
        path.exists()
    except OSError as error:
        raise NlosError(f"{path}: is no folder that can be used ({error.strerror})") from None
    return path


def spec_of(settings: Any) -> Scene:
    """Return the scene that the draft describes: the preset with its values replaced by the draft's.

    Raises
    ------
    NlosError
        The values contradict each other, or a mesh target has no file.
    """
    base = preset(settings.preset)
    scene = replace(
        base,
        target=target_of(settings),
        spot=replace(base.spot, power=short(settings.light_power), half_angle=half_angle(settings)),
        grid=grid_of(settings),
        reflection_order=settings.reflection_order,
        resolution=tuple(settings.resolution),
    )
    return scene.with_ambient(short(settings.ambient_radiance) if settings.use_ambient else 0.0)


def target_of(settings: Any) -> Target:
    """Return the target that the draft describes.

    Raises
    ------
    NlosError
        A mesh target has no file, or one of a kind that is not known.
    """
    target = Target(kind=settings.target_kind, size=short(settings.target_size), albedo=short(settings.target_albedo))
    if target.kind != "mesh":
        return target
    if not settings.target_mesh:
        raise NlosError("target: choose a mesh file (OBJ, PLY, STL, glTF, USD, FBX or .blend)")
    mesh = Target.named(bpy.path.abspath(settings.target_mesh)).mesh
    return replace(target, mesh=mesh, unit=settings.target_unit, up=settings.target_up)


_BUILT = (
    *("preset", "target_kind", "target_size", "target_albedo", "target_unit", "target_up"),
    *("use_ambient", "ambient_radiance"),
)
_APPLIED = (
    "light_power",
    "light_half_angle",
    "grid_counts",
    "grid_lo",
    "grid_hi",
    "reflection_order",
    "resolution",
)
_CLOSE = 1e-4
"""Relative difference below which two figures are the same: Blender keeps single precision."""


def differing(settings: Any, scene: Scene) -> tuple[list[str], list[str]]:
    """Return the settings of the draft that differ from a scene: those that Apply writes, and those of Build."""
    target, spot, grid, ambient = scene.target, scene.spot, scene.grid, scene.ambient
    there = {
        "preset": scene.preset if scene.preset in PRESETS else settings.preset,
        "target_kind": target.kind,
        "target_size": 0.0 if target.kind == "mesh" and not settings.target_size else target.size,
        "target_unit": target.unit if target.kind == "mesh" else settings.target_unit,
        "target_up": target.up if target.kind == "mesh" else settings.target_up,
        "target_albedo": settings.target_albedo if target.albedo is None else target.albedo,
        "use_ambient": ambient > 0.0,
        "ambient_radiance": ambient if ambient > 0.0 and settings.use_ambient else settings.ambient_radiance,
        "light_power": spot.power,
        "light_half_angle": math.radians(spot.half_angle),
        "grid_counts": grid.shape,
        "grid_lo": grid.lo,
        "grid_hi": grid.hi,
        "reflection_order": scene.reflection_order,
        "resolution": scene.resolution,
    }
    return tuple(  # type: ignore[return-value]
        [name for name in names if not _same(getattr(settings, name), there[name])] for names in (_APPLIED, _BUILT)
    )


def _same(one: Any, other: Any) -> bool:
    if isinstance(other, str | bool):
        return bool(one == other)
    pairs = zip(one, other, strict=True) if hasattr(other, "__len__") else [(one, other)]
    return all(math.isclose(a, b, rel_tol=_CLOSE, abs_tol=1e-6) for a, b in pairs)


def grid_of(settings: Any) -> VoxelGrid:
    """Return the draft's voxel grid.

    Raises
    ------
    NlosError
        The lower corner is not below the upper one.
    """
    return VoxelGrid(lo=vector(settings.grid_lo), hi=vector(settings.grid_hi), shape=tuple(settings.grid_counts))


def half_angle(settings: Any) -> float:
    """Return the half angle of the lamp's cone, degrees."""
    return short(math.degrees(settings.light_half_angle))


def follow(scene: Any) -> None:
    """Set what of the draft describes the scene to what it is after a change, unless the scene cannot be read."""
    settings = scene.nlos
    resolution = tuple(settings.resolution)
    with contextlib.suppress(NlosError):
        fill(settings, read_scene(scene))
        settings.resolution = resolution  # of data sets, which the file's render need not have


def fill(settings: Any, scene: Scene, *, target: bool = True) -> None:
    """Set the draft to a scene's values; its settings for rendering are kept.

    Parameters
    ----------
    settings : NlosSettings
    scene : Scene
        An unknown preset name or an albedo of None leaves the draft's value unchanged.
    target : bool
        Whether to copy the target's values too.
    """
    known = scene.preset in PRESETS
    if known and settings.preset != scene.preset:
        settings.preset = scene.preset  # also sets the preset's values, so it comes first
    if target:
        settings.target_kind = scene.target.kind
        settings.target_size = scene.target.size
        settings.target_unit, settings.target_up = scene.target.unit, scene.target.up
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
