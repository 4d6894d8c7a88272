"""The scene's file as an artist would render it: opened in Blender, the target put where a pose says, and F12.

Nothing of `generator.blender.engines` takes part, so that a fault there shows.
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
"""Longer side of the pictures, pixels: radiance is a mean over a pixel, and the fewer there are the more paths has
each."""

_WIDER = (16.0, 11.0, 8.0, 5.6, 4.0, 2.8, 2.0, 1.4)
WIDEST = math.radians(60.0)
"""Half angle of a spot that is widened."""
_DARK = 0.4
"""Least share of the picture that the widened spot may leave without direct light."""


class Plain:
    """The open file as an artist would render it, with the target at a pose.

    Parameters
    ----------
    scene : bpy.types.Scene
        Is changed for good.
    pose : PoseRecord
    size : (int, int)
        Of its pictures, width and height.
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
        scene, begun = self.scene, time.perf_counter()
        scene.cycles.samples, scene.cycles.seed = samples, seed
        with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
            scene.render.filepath = str(Path(folder) / "plain.exr")
            scene.update_tag()
            with quiet():
                bpy.ops.render.render(write_still=True, scene=scene.name)
            pixels = read_picture(Path(scene.render.filepath))[0].astype(np.float64)
        self.seconds = time.perf_counter() - begun
        return pixels

    def widths(self) -> dict[float, Array]:
        """Return full angles, radians, to which the spot may be widened, the widest first.

        Nothing but the wall may be in the wider cone, and most of the picture must stay out of its direct light. Each
        comes with 1 where a pixel (height, width, 1) does, and 0 where not.
        """
        light = self.spot.data
        if light.type != "SPOT" or light.library is not None:
            return {}
        half = light.spot_size / 2.0
        made = {}
        with Overrides() as overrides:
            for name in ("max_bounces", "volume_bounces"):
                overrides.set(self.scene.cycles, name, 0)
            overrides.set(self.scene, "world", None)
            for other in self.scene.objects:
                if other.type == "LIGHT" and other != self.spot:
                    overrides.set(other, "hide_render", True)
            overrides.set(light, "spot_size", light.spot_size)
            for factor in _WIDER if half < WIDEST / 1.2 else ():
                angle = math.atan(min(factor * math.tan(half), math.tan(WIDEST)))
                light.spot_size = 2.0 * angle
                if 2.0 * angle not in made and self._is_clear(angle):
                    dark = _away_from(self._render(64, 0).max(axis=2) > 0.0)
                    if dark.mean() >= _DARK:
                        made[2.0 * angle] = dark[..., None]
        return made

    def _is_clear(self, half: float) -> bool:
        """Whether the lamp sees nothing but the wall where it shines, by what it sees with nothing else there."""
        eye = bpy.data.objects.new("NLOS eye", bpy.data.cameras.new("NLOS eye"))
        place, turn, _ = self.spot.matrix_world.decompose()
        eye.matrix_world = Matrix.LocRotScale(place, turn, None)
        eye.data.angle = 2.0 * half
        eye.data.clip_start = 1e-4 * max(abs(place.y), 1e-6)
        eye.data.clip_end = 1e6 * max(abs(place.y), 1e-6)
        self.scene.collection.objects.link(eye)
        try:
            with Overrides() as overrides:
                overrides.set(self.scene, "camera", eye)
                overrides.set(self.scene.render, "resolution_x", 2 * SIDE)
                overrides.set(self.scene.render, "resolution_y", 2 * SIDE)
                whole = self._render(4, 0)
                for other in self.scene.objects:
                    if other not in (self.wall, self.spot):
                        overrides.set(other, "hide_render", True)
                return bool(whole.any() and np.allclose(whole, self._render(4, 0), rtol=1e-4))
        finally:
            bpy.data.cameras.remove(eye.data)  # takes the object with it


def _away_from(lit: Array) -> Array:
    """Return which pixels (height, width) are neither lit nor next to one that is."""
    padded = np.pad(lit, 1)
    height, width = lit.shape
    near = [padded[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    dark: Array = ~np.any(near, axis=0)
    return dark


def widen(spot: Any, width: float) -> None:
    """Widen a spot to a full angle, radians, unless it is wider; 0 leaves it."""
    if width and spot.type == "LIGHT" and spot.data.type == "SPOT" and spot.data.library is None:
        spot.data.spot_size = max(spot.data.spot_size, width)


def player_of(scene: bpy.types.Scene, role: str) -> Any:
    """Return the object that the file names for a role."""
    player = next(obj for obj in scene.objects if obj.get("nlos_role") == role)
    if player.hide_viewport:  # changes no render, but what Blender knows of its place
        player.hide_viewport = False
        bpy.context.view_layer.update()
    return player


def _put(target: Any, pose: PoseRecord) -> None:
    """Put the target's origin at a pose and turn it, with nothing that would move it again, and its shape kept."""
    shape = target.matrix_world.copy()
    turn = shape.to_quaternion().to_matrix().to_4x4()
    shape.translation = (0.0, 0.0, 0.0)
    shape = turn.inverted() @ shape
    angles = Euler([math.radians(angle) for angle in pose.rotation], "XYZ")
    place = Matrix.Translation(Vector(pose.position)) @ angles.to_matrix().to_4x4() @ shape
    target.animation_data_clear()
    for constraint in list(target.constraints):
        target.constraints.remove(constraint)
    target.delta_location, target.delta_rotation_euler = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    target.delta_rotation_quaternion, target.delta_scale = (1.0, 0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    bpy.context.view_layer.update()
    if target.parent is not None:
        # Only the matrix between a parent and its child holds every shape.
        own = target.matrix_parent_inverse @ target.matrix_basis
        above = target.matrix_world @ own.inverted()
        target.matrix_parent_inverse = above.inverted() @ place @ target.matrix_basis.inverted()
    elif (place.to_scale() - target.scale).length <= 1e-6 * place.to_scale().length:
        target.rotation_mode = "XYZ"
        target.location, target.rotation_euler = pose.position, angles
    else:
        target.matrix_world = place
    bpy.context.view_layer.update()


def _raw_output(scene: bpy.types.Scene, size: tuple[int, int]) -> None:
    """Float32 radiance as Cycles computes it, of a size; unbiased, where the file would have it clamped or cut short.

    What the product says that it replaces in every file is replaced here too, and nothing else.
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
    """Set attributes, as far as this Blender has them."""
    for name, value in values.items():
        if hasattr(owner, name):
            setattr(owner, name, value)
