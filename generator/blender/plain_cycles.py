"""Renders the scene's file as an artist would: opened in Blender, the target moved to a pose, and F12.

Uses nothing of `generator.blender.engines`, so that a fault there becomes visible.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

from generator.blender.scene.quiet import Overrides, quiet
from generator.files.pictures import read_picture
from generator.model.arrays import Array
from generator.model.poses import PoseRecord

SIDE = 16
"""Longer side of the pictures, pixels. Radiance is a mean over a pixel, so with fewer pixels each one has more
paths."""

_WIDER = (16.0, 11.0, 8.0, 5.6, 4.0, 2.8, 2.0, 1.4)
WIDEST = math.radians(60.0)
"""Largest half angle to which a spot is widened, radians."""
_DARK = 0.4
"""Least share of the picture that must stay without direct light of the widened spot."""


class Plain:
    """The open file as an artist would render it, with the target at a pose.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene of the open file; it is changed permanently.
    pose : PoseRecord
    size : (int, int)
        Width and height of the pictures, pixels.
    """

    def __init__(self, scene: bpy.types.Scene, pose: PoseRecord, size: tuple[int, int]) -> None:
        self.scene = scene
        self.target, self.spot, self.camera, self.wall = (
            player_of(scene, role) for role in ("target", "spot", "camera", "relay_wall")
        )
        self.seconds = 0.0
        for marker in scene.timeline_markers:
            marker.camera = None
        scene.camera = self.camera
        _put(self.target, pose)
        _raw_output(scene, size)

    def render(self, samples: int, seed: int, *, target: bool = True) -> Array:
        """Return one picture, (height, width, 3), W/m^2/sr."""
        hidden = [] if target else [self.target, *self.target.children_recursive]
        with Overrides() as overrides:
            for part in hidden:
                overrides.set(part, "hide_render", True)
            return self._render(samples, seed)

    def _render(self, samples: int, seed: int) -> Array:
        scene, start = self.scene, time.perf_counter()
        scene.cycles.samples, scene.cycles.seed = samples, seed
        with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
            scene.render.filepath = str(Path(folder) / "plain.exr")
            scene.update_tag()
            with quiet():
                bpy.ops.render.render(write_still=True, scene=scene.name)
            pixels = read_picture(Path(scene.render.filepath))[0].astype(np.float64)
        self.seconds = time.perf_counter() - start
        return pixels

    def widths(self) -> dict[float, Array]:
        """Return full angles, radians, to which the spot may be widened, the widest first.

        Nothing but the wall may be in the wider cone, and enough of the picture must stay out of its direct light.
        Each angle comes with a mask (height, width, 1): 1 where a pixel stays out of the light, else 0.
        """
        light = self.spot.data
        if light.type != "SPOT" or light.library is not None:
            return {}
        half_angle = light.spot_size / 2.0
        masks = {}
        with Overrides() as overrides:
            for name in ("max_bounces", "volume_bounces"):
                overrides.set(self.scene.cycles, name, 0)
            overrides.set(self.scene, "world", None)
            for obj in self.scene.objects:
                if obj.type == "LIGHT" and obj != self.spot:
                    overrides.set(obj, "hide_render", True)
            overrides.set(light, "spot_size", light.spot_size)
            for factor in _WIDER if half_angle < WIDEST / 1.2 else ():
                angle = math.atan(min(factor * math.tan(half_angle), math.tan(WIDEST)))
                light.spot_size = 2.0 * angle
                if 2.0 * angle not in masks and self._is_clear(angle):
                    mask = _away_from(self._render(64, 0).max(axis=2) > 0.0)
                    if mask.mean() >= _DARK:
                        masks[2.0 * angle] = mask[..., None]
        return masks

    def _is_clear(self, half: float) -> bool:
        """Whether the cone holds nothing but the wall: hiding all else changes nothing in a picture from the lamp."""
        camera = bpy.data.objects.new("NLOS eye", bpy.data.cameras.new("NLOS eye"))
        position, rotation, _ = self.spot.matrix_world.decompose()
        camera.matrix_world = Matrix.LocRotScale(position, rotation, None)
        camera.data.angle = 2.0 * half
        camera.data.clip_start = 1e-4 * max(abs(position.y), 1e-6)
        camera.data.clip_end = 1e6 * max(abs(position.y), 1e-6)
        self.scene.collection.objects.link(camera)
        try:
            with Overrides() as overrides:
                overrides.set(self.scene, "camera", camera)
                overrides.set(self.scene.render, "resolution_x", 2 * SIDE)
                overrides.set(self.scene.render, "resolution_y", 2 * SIDE)
                picture = self._render(4, 0)
                for obj in self.scene.objects:
                    if obj not in (self.wall, self.spot):
                        overrides.set(obj, "hide_render", True)
                return bool(picture.any() and np.allclose(picture, self._render(4, 0), rtol=1e-4))
        finally:
            bpy.data.cameras.remove(camera.data)  # also removes the object


def _away_from(lit: Array) -> Array:
    """Return which pixels (height, width) are neither lit nor next to a lit one."""
    padded = np.pad(lit, 1)
    height, width = lit.shape
    neighbours = [padded[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    dark: Array = ~np.any(neighbours, axis=0)
    return dark


def widen(spot: Any, width: float) -> None:
    """Widen a spot to a full angle, radians, unless it is wider; 0 leaves it unchanged."""
    if width and spot.type == "LIGHT" and spot.data.type == "SPOT" and spot.data.library is None:
        spot.data.spot_size = max(spot.data.spot_size, width)


def player_of(scene: bpy.types.Scene, role: str) -> Any:
    """Return the object that the file names for a role."""
    player = next(obj for obj in scene.objects if obj.get("nlos_role") == role)
    if player.hide_viewport:  # changes no render, but Blender does not update its matrices
        player.hide_viewport = False
        bpy.context.view_layer.update()
    return player


def _put(target: Any, pose: PoseRecord) -> None:
    """Move and rotate the target to a pose, keep its shape, and remove whatever would move it again."""
    shape, scale = target.matrix_world.copy(), [s * d for s, d in zip(target.scale, target.delta_scale, strict=True)]
    rotation = shape.to_quaternion().to_matrix().to_4x4()
    shape.translation = (0.0, 0.0, 0.0)
    shape = rotation.inverted() @ shape
    angles = Euler([math.radians(angle) for angle in pose.rotation], "XYZ")
    matrix = Matrix.Translation(Vector(pose.position)) @ angles.to_matrix().to_4x4() @ shape
    target.animation_data_clear()
    for constraint in list(target.constraints):
        target.constraints.remove(constraint)
    target.delta_location, target.delta_rotation_euler = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    target.delta_rotation_quaternion, target.delta_scale = (1.0, 0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    bpy.context.view_layer.update()
    if target.parent is not None:
        # Only the parent inverse matrix can hold any shape, shear included.
        local = target.matrix_parent_inverse @ target.matrix_basis
        parent = target.matrix_world @ local.inverted()
        target.matrix_parent_inverse = parent.inverted() @ matrix @ target.matrix_basis.inverted()
    else:  # by its own figures, for a matrix does not say which axes a negative scale belongs to
        target.rotation_mode = "XYZ"
        target.location, target.rotation_euler, target.scale = pose.position, angles, scale
    bpy.context.view_layer.update()


def _raw_output(scene: bpy.types.Scene, size: tuple[int, int]) -> None:
    """Set up float32 output of a size, as Cycles computes radiance: unbiased, even if the file clamps or limits it.

    Replaces exactly the settings that the product is documented to replace in every file.
    """
    render, image, cycles = scene.render, scene.render.image_settings, scene.cycles
    _set(image, media_type="IMAGE")
    _set(image, file_format="OPEN_EXR", color_mode="RGB", color_depth="32", exr_codec="ZIP")
    _set(image, color_management="FOLLOW_SCENE")
    width, height = size
    _set(render, engine="CYCLES", resolution_x=width, resolution_y=height, resolution_percentage=100)
    _set(render, pixel_aspect_x=1.0, pixel_aspect_y=1.0, use_border=False, use_stamp=False, use_file_extension=False)
    _set(render, use_compositing=False, use_sequencer=False, use_freestyle=False, use_multiview=False)
    _set(render, use_motion_blur=False, use_simplify=False, film_transparent=False, use_persistent_data=False)
    _set(render, use_overwrite=True, use_placeholder=False, threads_mode="AUTO", dither_intensity=0.0)
    _set(cycles, device="CPU", use_adaptive_sampling=False, use_denoising=False, time_limit=0.0, use_guiding=False)
    _set(cycles, sample_clamp_direct=0.0, sample_clamp_indirect=0.0, blur_glossy=0.0, light_sampling_threshold=0.0)
    _set(cycles, caustics_reflective=True, caustics_refractive=True, use_fast_gi=False, film_exposure=1.0)
    _set(cycles, pixel_filter_type="BOX", use_animated_seed=False, sampling_pattern="TABULATED_SOBOL")
    _set(cycles, use_sample_subset=False, sample_offset=0)
    for layer in scene.view_layers:
        _set(layer, samples=0)


def _set(owner: Any, **values: Any) -> None:
    """Set those of the attributes that this version of Blender has."""
    for name, value in values.items():
        if hasattr(owner, name):
            setattr(owner, name, value)
