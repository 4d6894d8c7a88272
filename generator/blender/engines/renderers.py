"""Opens an engine for a scene: Cycles from the true spot (`path`), Cycles from the lit patch (`patch`), or the
three-reflection integral itself (`surfel`).

All give the same scene-linear radiance in the same units; they differ in what they model, in noise and in cost.
"""

from __future__ import annotations

import contextlib
import importlib.util
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import bpy

from generator.blender.engines import survey
from generator.blender.engines.cycles import CyclesRenderer, linear_output, plain_cycles
from generator.blender.engines.devices import use_gpu
from generator.blender.engines.patch_lamp import patch_lamp
from generator.blender.engines.renderer import Renderer
from generator.blender.scene import geometry, roles
from generator.blender.scene.quiet import Overrides
from generator.model.engines import ENGINES
from generator.model.errors import NlosError
from generator.model.settings import Sweep
from generator.transport import left_out


@contextlib.contextmanager
def opened(
    scene: bpy.types.Scene,
    engine: str,
    *,
    resolution: tuple[int, int],
    threads: int = 0,
    accuracy: float = 1e-3,
    denoise: bool = False,
    device: str = "cpu",
    leave_out: Sequence[str] = (),
) -> Iterator[Renderer]:
    """Prepare a scene to be rendered by an engine; restore it when the context is left.

    Parameters
    ----------
    scene : bpy.types.Scene
    engine : {"path", "patch", "surfel"}
    resolution : (int, int)
        Width and height, pixels.
    threads : int
        0 uses all cores. The pixels do not depend on it.
    accuracy : float
        Accuracy of `surfel`.
    denoise : bool
        Denoise the pictures of Cycles with Open Image Denoise: smooth, but biased.
    device : {"cpu", "gpu"}
        Device that Cycles renders on.
    leave_out : sequence of str
        Those of `left_out.PARTS` that `surfel` leaves out.

    Raises
    ------
    NlosError
        The engine is unknown, or cannot honour something in the scene; or there is no GPU.
    """
    if engine not in ENGINES:
        raise NlosError(f"engine {engine!r}: there is none; choose from {', '.join(ENGINES)}")
    with tempfile.TemporaryDirectory(prefix="nlos-") as folder, Overrides() as overrides:
        geometry.hold_camera(scene, overrides)
        linear_output(scene, overrides)
        plain_cycles(scene, overrides)
        if device == "gpu" and ENGINES[engine].noisy:
            use_gpu(overrides)
            overrides.set(scene.cycles, "device", "GPU")
        if denoise:
            overrides.set(scene.cycles, "use_denoising", True)
            overrides.set(scene.cycles, "denoiser", "OPENIMAGEDENOISE")
        overrides.set(scene.render, "resolution_x", resolution[0])
        overrides.set(scene.render, "resolution_y", resolution[1])
        overrides.set(scene.render, "threads_mode", "FIXED" if threads else "AUTO")
        if threads:
            overrides.set(scene.render, "threads", threads)
        surveyed = survey.survey(scene, resolution=resolution)
        surveyed.check(engine)
        order = roles.reflection_order(scene)  # after a render has started, which applies animation
        if surveyed.world is not None and engine == "surfel":
            # Imported here, since it loads numba, for which Cycles need not wait (a fifth of a second).
            from generator.blender.engines.surfel import SurfelRenderer
            from generator.transport import Transport

            world, shadows = left_out.without(surveyed.world, leave_out)
            yield SurfelRenderer(scene, Transport(world, accuracy=accuracy, threads=threads), shadows=shadows)
            return
        with patch_lamp(scene, surveyed, order) if engine == "patch" else contextlib.nullcontext():
            yield CyclesRenderer(scene, Path(folder))


def settings(sweep: Sweep) -> dict[str, Any]:
    """Return the keyword arguments of `opened` for a sweep, except the engine."""
    return {name: getattr(sweep, name) for name in ("resolution", "accuracy", "device", "denoise", "leave_out")}


def choose(scene: bpy.types.Scene, found: survey.Survey | None = None) -> tuple[str, list[str]]:
    """Return the cheapest engine that is valid for a scene, and why no cheaper one is.

    Parameters
    ----------
    scene : bpy.types.Scene
    found : Survey, optional
        Survey of the scene; made if not given.

    Returns
    -------
    engine : {"surfel", "patch", "path"}
    reasons : list of str
        What the cheaper engines cannot honour, a phrase each that names the object; empty for `surfel`.

    Raises
    ------
    NlosError
        A role is missing or played twice, or no engine can sweep the scene.
    """
    found = found or survey.survey(scene)
    found.check("path")
    return next((engine, reasons) for engine, reasons in _by_cost(found))


def _by_cost(found: survey.Survey) -> Iterator[tuple[str, list[str]]]:
    """Yield the engines that can honour a scene, the cheapest first, each with what the one before cannot honour."""
    cheaper: list[str] = []
    for engine in reversed(ENGINES):
        reasons = found.reasons(engine) or (_unfit(found) if engine == "surfel" else [])
        if not reasons:
            yield engine, cheaper
        cheaper = reasons


def lacking(found: survey.Survey) -> list[str]:
    """Return why `surfel` cannot run here although it can render a scene: what its rays need is not installed."""
    from generator.transport.rays import FEW  # here, as in `opened`

    triangles = 0 if found.world is None else sum(len(mesh.triangles) for mesh in found.world.room)
    if triangles <= 2 * FEW or importlib.util.find_spec("embreex") is not None:  # two may be one surface
        return []
    return [f"surfel needs Embree for the {triangles} triangles around the target, and this Python has no embreex"]


def _unfit(found: survey.Survey) -> list[str]:
    """Why `surfel` is not the cheapest engine although it can render a scene: Blender's own Python lacks packages."""
    if found.world is None or not found.world.room:
        return []
    from generator.transport.compiled import COMPILED  # here, as in `opened`

    if missing := lacking(found):
        return missing
    if COMPILED:
        return []
    return ["surfel takes minutes for a room's own light in Blender's own Python, which has no numba"]
