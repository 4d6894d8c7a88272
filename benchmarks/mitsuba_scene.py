"""The reference renderer: a `World` in Mitsuba 3, which shares no code and no author with Cycles or the transport.

Radiance is absolute (W/m^2/sr): nothing is fitted. "spot" traces light from the true lamp and connects it to the
camera; "patch" traces paths from the camera to the lit patch, a disc whose radiance is a texture of the closed form;
"path" traces them to what else gives light, the sky and emitters.
Mitsuba is not a dependency of the project; its LLVM variants need LLVM 17 or later (`apt-get install libllvm19`).
"""

from __future__ import annotations

import math
import os
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from generator.model.arrays import rotation_matrix
from generator.model.errors import NlosError
from generator.model.quantities import ALL_ORDERS
from generator.transport.world import Emitters, LitPatch, Sphere, Watched, World

METHODS = ("patch", "spot", "path")

_LANES = 2**22
"""Paths that one call to Mitsuba traces at once: more would not be faster, but take more memory."""

_PER_PIXEL = 1024
"""Paths per pixel in one call: Mitsuba adds them up in float32, and the sum of 16,384 equal ones was 0.3 % wrong."""

_PINHOLE = 0.5
"""Distance of the pinhole from the wall, in widths of the picture: at 0.1 light tracing is 0.1 % too dark."""

_CERTAIN = 8
"""Reflections after which a path may end by chance (Russian roulette), where all of them count."""

_APART = 1e-4
"""Distance, metres, of a glowing triangle from the surface that it lies on, of which rays would meet either."""

_TEXELS = (128, 256)
"""Texels of the patch's radiance, along the radius and the angle: it is smooth, so that these suffice for 1e-6."""


@cache
def mitsuba(variant: str) -> Any:
    """Return Mitsuba with a variant set, after finding an LLVM that it can use.

    Raises
    ------
    ImportError
        Mitsuba is not installed.
    """
    # Dr.Jit takes the first LLVM it finds, and aborts the process if that is version 15 or 16.
    llvms = [(int(re.sub(r".*?(\d+)(\.\d+)?$", r"\1", p.name)), p) for p in Path("/usr/lib").glob("*/libLLVM*.so.*")]
    usable = sorted((version, str(p)) for version, p in llvms if version >= 17)
    if usable:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", usable[-1][1])
    import mitsuba as mi

    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    return mi


class Prepared:
    """A world in Mitsuba with the target in one pose.

    Parameters
    ----------
    world : World
        Its watched patch is seen straight on, with square pixels; the lamp's edge is hard.
    position, rotation_degrees : (float, float, float)
        The target's pose, as in `generator.model.poses`; metres and degrees.
    method : {"patch", "spot", "path"}
        Of a world whose light takes more than three reflections, "patch" is refused; "spot" renders the lamp's light
        and "path" all other, which add up.
    target : bool
        Whether to include the target; if not, the picture is the background.
    variant : str, optional
        Variant of Mitsuba; the default is the fastest that can represent the world's colours.

    Raises
    ------
    NlosError
        This reference cannot render the world.
    ImportError
        Mitsuba is not installed.
    """

    def __init__(
        self,
        world: World,
        position: Any,
        rotation_degrees: Any,
        *,
        method: str,
        target: bool = True,
        variant: str | None = None,
    ) -> None:
        if method not in METHODS:
            raise NlosError(f"method {method!r}: there is none; choose from {', '.join(METHODS)}")
        self._mi = mi = mitsuba(variant or ("llvm_ad_mono" if _grey(world) else "llvm_ad_rgb"))
        self.resolution = world.watched.resolution
        # Mitsuba also counts the path segment that starts at the lamp; the patch is one reflection already.
        depth = world.order if method == "patch" else world.order + 1
        ends = {"max_depth": depth, "rr_depth": 1000}
        if world.order == ALL_ORDERS:
            ends = {"max_depth": -1, "rr_depth": _CERTAIN}
        content: dict[str, Any] = {
            "type": "scene",
            "integrator": {"type": "ptracer" if method == "spot" else "path", **ends},
            "sensor": _sensor(mi, world.watched),
        }
        if method != "patch" and world.wall is not None:
            content.update(_meshes(mi, "wall", world.wall.triangles, world.wall.albedo))
        elif method != "patch":
            content["wall"] = _wall(mi, world, _rectangle(world, patch=True))
        if method == "spot":
            content["lamp"] = _spot(mi, world.patch)
        elif method == "path":
            if world.ambient is not None:
                content["sky"] = {"type": "constant", "radiance": _rgb(world.ambient.radiance)}
            if world.emitters is not None:
                content.update(_emitters(mi, world.emitters))
        else:
            if world.is_followed_on:
                raise NlosError("method 'patch': only the lamp's first three reflections are followed; use 'spot'")
            if _overlap(world):
                raise NlosError("method 'patch': the camera sees the lit patch; use 'spot'")
            content["lamp"] = _patch(mi, world.patch)
            # No wall behind the patch, so that the patch can lie in the wall's plane itself.
            content["wall"] = _wall(mi, world, _rectangle(world, patch=False))
        for i, mesh in enumerate(world.room):
            content.update(_meshes(mi, f"room{i}", mesh.triangles, mesh.albedo))
        turn, place = rotation_matrix(tuple(rotation_degrees)), np.asarray(position, dtype=float)
        for i, body in enumerate(world.target if target else ()):
            if isinstance(body, Sphere):
                content[f"target{i}"] = {
                    "type": "sphere",
                    "center": [float(c) for c in turn @ body.centre + place],
                    "radius": float(body.radius),
                    "bsdf": _diffuse(body.albedo),
                }
            else:
                content.update(_meshes(mi, f"target{i}", body.triangles @ turn.T + place, body.albedo))
        self._scene = mi.load_dict(content)

    def draw(self, spp: int, seed: int) -> np.ndarray:
        """Render the picture (height, width, 3), float64, W/m^2/sr.

        Parameters
        ----------
        spp : int
            Paths per pixel from the camera, or the same total number from the lamp.
        seed : int
            Seed of the noise. Worlds that differ only in the target share the noise of the paths that miss it.
        """
        width, height = self.resolution
        most = max(1, min(_PER_PIXEL, _LANES // (width * height)))
        passes = math.ceil(spp / most)
        total = np.zeros((height, width, 3))
        seeds = np.random.SeedSequence(seed).generate_state(passes)
        for i in range(passes):
            share = spp * (i + 1) // passes - spp * i // passes
            image = np.array(self._mi.render(self._scene, spp=share, seed=int(seeds[i])), dtype=np.float64)
            total += share / spp * image[..., :3]
        return total


def render(
    world: World,
    position: Any,
    rotation_degrees: Any,
    *,
    method: str,
    spp: int,
    seed: int,
    target: bool = True,
) -> np.ndarray:
    """Render one picture (height, width, 3), float64, W/m^2/sr; see `Prepared` and `Prepared.draw`."""
    return Prepared(world, position, rotation_degrees, method=method, target=target).draw(spp, seed)


def _grey(world: World) -> bool:
    colours = [world.patch.intensity, world.patch.albedo, world.watched.albedo]
    colours += [b.albedo for b in (*world.target, *world.room)]
    colours += [] if world.ambient is None else [world.ambient.radiance]
    colours += [] if world.emitters is None else [world.emitters.radiance, world.emitters.intensity]
    return all(np.ptp(c, axis=-1).max(initial=0.0) == 0.0 for c in colours)


def _rgb(colour: np.ndarray) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(c) for c in colour]}


def _diffuse(albedo: np.ndarray) -> dict[str, Any]:
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": _rgb(albedo)}}


def _matrix(mi: Any, x: np.ndarray, y: np.ndarray, z: np.ndarray, origin: np.ndarray) -> Any:
    matrix = np.eye(4)
    matrix[:3] = np.stack([x, y, z, origin], axis=1)
    return mi.ScalarTransform4f(matrix)


def _axes(watched: Watched) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the picture's top left corner on the wall and its edges to the right and down, metres."""
    to_wall = watched.to_wall / watched.to_wall[3, 2]
    if np.abs(to_wall[3, :2]).max() > 1e-6:  # Blender keeps 24 bits
        raise NlosError("watched: the camera must look straight at the wall")
    corner, right, down = to_wall[:3, 2], to_wall[:3, 0], to_wall[:3, 1]
    width, height = (float(np.linalg.norm(v)) for v in (right, down))
    pixels = watched.resolution
    upright = np.abs(np.cross(-down, -watched.normal) / height + right / width).max()
    if upright > 1e-6 or abs(width / pixels[0] * pixels[1] / height - 1.0) > 1e-6:
        raise NlosError("watched: the picture must be an upright rectangle with square pixels, not mirrored")
    return corner, right, down


def _sensor(mi: Any, watched: Watched) -> dict[str, Any]:
    """Return a pinhole camera close to the wall: for a Lambertian wall, only the points that a pixel covers matter.

    Mitsuba cannot trace light to an orthographic camera. So close to the wall, nothing gets in the way.
    """
    corner, right, down = _axes(watched)
    width = float(np.linalg.norm(right))
    distance = _PINHOLE * width
    if not watched.eye[3]:  # an orthographic camera may stand before the target
        distance = min(distance, float(np.linalg.norm(watched.eye[:3])))
    eye = corner + right / 2.0 + down / 2.0 + distance * watched.normal
    return {
        "type": "perspective",
        "to_world": _matrix(mi, -right / width, -down / np.linalg.norm(down), -watched.normal, eye),
        "fov": math.degrees(2.0 * math.atan(width / 2.0 / distance)),
        "fov_axis": "x",
        "near_clip": 1e-2 * distance,
        "far_clip": 1e2 * distance,
        "film": {
            "type": "hdrfilm",
            "width": watched.resolution[0],
            "height": watched.resolution[1],
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "independent"},
    }


def _spot(mi: Any, patch: LitPatch) -> dict[str, Any]:
    """Return the true lamp. With two equal angles, Mitsuba's spot has a hard edge, and its intensity is in W/sr."""
    if patch.cos_width > 0.0:
        raise NlosError("patch: the lamp must have a hard edge (blend 0)")
    half = math.degrees(math.acos(patch.cos_outer))
    across = np.cross(patch.axis, np.eye(3)[int(np.argmin(np.abs(patch.axis)))])
    across /= np.linalg.norm(across)
    return {
        "type": "spot",
        "to_world": _matrix(mi, across, np.cross(patch.axis, across), patch.axis, patch.lamp),
        "intensity": _rgb(patch.intensity),
        "cutoff_angle": half,
        "beam_width": half,
    }


def _patch(mi: Any, patch: LitPatch) -> dict[str, Any]:
    """Return the lit patch as a disc; its texture's axes are the radius and the angle."""
    if patch.cos_width > 0.0:
        raise NlosError("patch: the lamp must have a hard edge (blend 0)")
    across, around = ((np.arange(n) + 0.5) / n for n in _TEXELS)
    turn = 2.0 * math.pi * around[:, None, None]
    points = patch.centre + across[None, :, None] * (np.cos(turn) * patch.major + np.sin(turn) * patch.minor)
    distance = np.linalg.norm(points - patch.lamp, axis=-1)
    radiance = patch.albedo / math.pi * patch.intensity * (patch.height / distance**3)[..., None]
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(radiance.astype(np.float32)), "raw": True, "wrap_mode": "clamp"}
    normal = np.cross(patch.major, patch.minor)
    minor = patch.minor if normal @ patch.normal > 0.0 else -patch.minor
    return {
        "type": "disk",
        "to_world": _matrix(mi, patch.major, minor, patch.normal, patch.centre),
        "emitter": {"type": "area", "radiance": texture},
    }


def _rectangle(world: World, *, patch: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return middle and half edges of the needed part of the wall: the watched part and, with ``patch``, the lit."""
    corner, right, down = _axes(world.watched)
    low, high = np.zeros(2), np.ones(2)
    if patch:
        low, high = np.minimum(low, _extent(world)[0]), np.maximum(high, _extent(world)[1])
    # A ray through the very edge of the picture must hit the wall.
    low, high = low - 1e-4, high + 1e-4
    middle = (low + high) / 2.0
    half = (high - low) / 2.0
    return corner + middle[0] * right + middle[1] * down, half[0] * right, half[1] * down


def _extent(world: World) -> tuple[np.ndarray, np.ndarray]:
    """Return the range of the lit patch in picture coordinates."""
    corner, right, down = _axes(world.watched)
    axes = np.stack([right / (right @ right), down / (down @ down)])
    patch = world.patch
    middle = axes @ (patch.centre - corner)
    reach = np.hypot(axes @ patch.major, axes @ patch.minor)
    return middle - reach, middle + reach


def _overlap(world: World) -> bool:
    low, high = _extent(world)
    return bool((low < 1.0 + 1e-3).all() and (high > -1e-3).all())


def _wall(mi: Any, world: World, rectangle: tuple[np.ndarray, np.ndarray, np.ndarray]) -> dict[str, Any]:
    middle, right, down = rectangle
    normal = world.watched.normal * math.sqrt(np.linalg.norm(right) * np.linalg.norm(down))
    return {
        "type": "rectangle",
        # Right-handed: the two frames of a mirrored rectangle disagree, and light tracing misses it.
        "to_world": _matrix(mi, right, -down, normal, middle),
        "bsdf": _diffuse(world.watched.albedo),
    }


def _emitters(mi: Any, emitters: Emitters) -> dict[str, Any]:
    """Return glowing surfaces, which reflect nothing themselves, and lamps without extent."""
    if emitters.softness.any():
        raise NlosError("emitters: Mitsuba has no lamp with a soft falloff")
    sides = emitters.triangles[:, 1:] - emitters.triangles[:, :1]
    normals = np.cross(sides[:, 0], sides[:, 1])
    lifted = emitters.triangles + _APART * (normals / np.linalg.norm(normals, axis=1, keepdims=True))[:, None]
    found = _meshes(mi, "glow", lifted, emitters.radiance, glowing=True)
    for i, (place, intensity) in enumerate(zip(emitters.places, emitters.intensity, strict=True)):
        found[f"point{i}"] = {
            "type": "point",
            "position": [float(c) for c in place],
            "intensity": _rgb(intensity),
        }
    return found


def _meshes(
    mi: Any, name: str, triangles: np.ndarray, values: np.ndarray, *, glowing: bool = False
) -> dict[str, Any]:
    """Return one mesh for every colour: an albedo, or a radiance on the side from which corners run
    counter-clockwise."""
    meshes = {}
    colours, colour_index = np.unique(values, axis=0, return_inverse=True)
    for i, colour in enumerate(colours):
        corners = triangles[colour_index.reshape(-1) == i].reshape(-1, 3)
        properties = mi.Properties()
        if glowing:
            properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": _rgb(np.zeros(3))})
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": _rgb(colour)})
        else:
            properties["bsdf"] = mi.load_dict(_diffuse(colour))
        mesh = mi.Mesh(f"{name}-{i}", len(corners), len(corners) // 3, props=properties)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = corners.astype(np.float32).ravel()
        parameters["faces"] = np.arange(len(corners), dtype=np.uint32)
        parameters.update()
        meshes[f"{name}_{i}"] = mesh
    return meshes
