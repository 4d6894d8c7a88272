"""Build NLOS scenes in Blender, sweep a hidden object through its voxels and render what the wall shows.

Public interface: arrays in, arrays out, nothing printed. Functions that need Blender load its module `bpy` at first
use; reading data sets does not need it.

Examples
--------
>>> import generator
>>> scene = generator.new_scene(generator.preset("room", "sphere"))
>>> pictures, background = generator.render(scene, [(1.6, 1.2, 1.3)], engine="surfel", resolution=(8, 8))
>>> pictures.shape
(1, 8, 8, 3)
>>> bool((pictures[0] >= background).mean() > 0.5)
True
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from generator.blender.check import check_scene as check
    from generator.blender.finding import Finding
    from generator.blender.render_poses import render
    from generator.blender.scene.blend_file import open_file as open_scene
    from generator.blender.scene.blend_file import save_file as save_scene
    from generator.blender.scene.build import new_scene
    from generator.jobs.bulk import run as bulk
    from generator.jobs.request import BulkRequest, SweepRequest
    from generator.jobs.sweep import run as sweep
    from generator.model.errors import NlosError
    from generator.model.presets import preset
    from generator.model.scene import Scene
    from generator.sets.simulated import open_set

_EXPORTS = {
    "BulkRequest": "generator.jobs.request:BulkRequest",
    "Finding": "generator.blender.finding:Finding",
    "NlosError": "generator.model.errors:NlosError",
    "Scene": "generator.model.scene:Scene",
    "SweepRequest": "generator.jobs.request:SweepRequest",
    "bulk": "generator.jobs.bulk:run",
    "check": "generator.blender.check:check_scene",
    "new_scene": "generator.blender.scene.build:new_scene",
    "open_scene": "generator.blender.scene.blend_file:open_file",
    "open_set": "generator.sets.simulated:open_set",
    "preset": "generator.model.presets:preset",
    "render": "generator.blender.render_poses:render",
    "save_scene": "generator.blender.scene.blend_file:save_file",
    "sweep": "generator.jobs.sweep:run",
}
__all__ = [
    "BulkRequest",
    "Finding",
    "NlosError",
    "Scene",
    "SweepRequest",
    "bulk",
    "check",
    "new_scene",
    "open_scene",
    "open_set",
    "preset",
    "render",
    "save_scene",
    "sweep",
]


def __getattr__(name: str) -> Any:
    # Blender takes seconds to load, and not every installation has it.
    if name in _EXPORTS:
        module, _, attribute = _EXPORTS[name].partition(":")
        return getattr(importlib.import_module(module), attribute)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
