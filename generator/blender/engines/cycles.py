"""Rendering by Cycles: the engines `path` and `patch`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np

from generator.blender.engines.renderer import Shot
from generator.blender.scene import blend_file, materials, nodes, posing, replaced, roles
from generator.blender.scene.quiet import Overrides, quiet
from generator.blender.scene.roles import refuse_hidden
from generator.files.pictures import Picture, read_picture
from generator.model.arrays import Array
from generator.model.errors import NlosError


class CyclesRenderer:
    """Renders by Cycles: the engines `path` and `patch`, which differ in the lamp of the scene.

    Parameters
    ----------
    scene : bpy.types.Scene
        Prepared by `generator.blender.engines.renderers.opened`.
    folder : Path
        Folder of the temporary picture file.
    """

    def __init__(self, scene: bpy.types.Scene, folder: Path) -> None:
        self._scene = scene
        self._file = folder / "render.exr"
        self._samples = 0

    def render(self, *, samples: int, seed: int, target: bool = True, ambient: bool = True) -> Picture:
        """Render one picture.

        Parameters
        ----------
        samples : int
            Camera rays per pixel.
        seed : int
            Seed of the noise, 0 to 2^31 - 1.
        target : bool
            Whether the hidden object is rendered; the background without it if not.
        ambient : bool
            Whether the world's light, if there is any, is rendered.

        Returns
        -------
        ndarray of shape (height, width, 3), float32
            Radiance, W/m^2/sr; row 0 is the top.

        Raises
        ------
        NlosError
            Cycles failed, or left a picture with NaN or infinite pixels.
        """
        scene = self._scene
        target_parts = roles.target_parts(scene)
        with Overrides() as overrides:
            overrides.set(scene.cycles, "samples", samples)
            overrides.set(scene.cycles, "seed", seed)
            overrides.set(scene.render, "filepath", blend_file.literal(self._file, rendered=True))
            if not target:
                for part in target_parts:
                    overrides.set(part, "hide_render", True)
            else:
                refuse_hidden(scene)
            dark_worlds = [] if ambient else _put_out_the_sky(scene, overrides)
            if samples != self._samples:
                # With persistent data, Cycles' table of random numbers keeps the length of the largest sample count
                # so far, so that a picture would depend on earlier ones. This frees the table.
                scene.render.use_persistent_data = False
                scene.render.use_persistent_data = True
                self._samples = samples
            # Cycles also keeps the old samples and seed unless the scene is marked as changed.
            scene.update_tag()
            self._file.unlink(missing_ok=True)
            with quiet():
                bpy.ops.render.render(write_still=True, scene=scene.name)
        if dark_worlds:
            bpy.data.batch_remove(dark_worlds)
        scene.update_tag()
        pixels, _ = read_picture(self._file)
        if not np.isfinite(pixels).all():
            raise NlosError(f"{bpy.data.filepath}: Cycles rendered NaN or infinite pixels (seed {seed})")
        return pixels

    def difference(self, shot: Shot) -> Array:
        """Return what the target at a pose changes, by two renders with equal noise, (height, width, 3), W/m^2/sr."""
        posing.move_target(self._scene, shot.position, shot.rotation)
        picture = self.render(samples=shot.samples, seed=shot.seed).astype(np.float64)
        change: Array = picture - self.render(samples=shot.samples, seed=shot.seed, target=False)
        return change

    def pictures(self, shots: Sequence[Shot], background: Picture | None = None) -> list[Picture]:
        """Render pictures of many poses, (height, width, 3) each; the target stays at the last pose.

        With a background, each pose is also rendered without the target, and only the difference is added to the
        background: a control variate of weight 1, as rays that never meet the target are the same in both and cancel.
        """
        pictures = []
        for shot in shots:
            posing.move_target(self._scene, shot.position, shot.rotation)
            pixels = self.render(samples=shot.samples, seed=shot.seed)
            if background is not None and background.any():
                own_background = self.render(samples=shot.samples, seed=shot.seed, target=False)
                pixels = pixels + (background - own_background)
            pictures.append(pixels)
        return pictures


def linear_output(scene: bpy.types.Scene, overrides: Overrides) -> None:
    """Make Blender write the renderer's own float32 radiance."""
    # Formats differ in depths, codecs and colour spaces: assigning a format changes these too.
    overrides.keep(scene.render.image_settings, "media_type", "file_format", "color_mode", "color_depth")
    replaced.replace(scene, overrides, replaced.OUTPUT)


def plain_cycles(scene: bpy.types.Scene, overrides: Overrides) -> None:
    """Make Cycles unbiased, with noise that follows from seed and samples alone."""
    replaced.replace(scene, overrides, replaced.SAMPLING)


def _put_out_the_sky(scene: bpy.types.Scene, overrides: Overrides) -> list[bpy.types.World]:
    """Replace the worlds of a scene by copies without light, and return the copies."""
    dark_worlds = []
    for owner, name in materials.worlds_of(scene):
        dark_worlds.append(nodes.darkened(getattr(owner, name)))
        overrides.set(owner, name, dark_worlds[-1])
    return dark_worlds
