"""One interface, three engines: Cycles from the true spot (`path`), Cycles from the lit patch (`patch`), and the
three-reflection integral itself (`surfel`).

All give the same scene-linear radiance in the same units; they differ in what they model, in noise and in cost.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

from generator.blender.engines import extract
from generator.blender.scene import nodes, replaced, stage
from generator.model.spec import Array, NlosError, Sweep
from generator.sets.dataset import Picture, read_picture
from generator.transport import Transport, left_out
from generator.transport.compiled import COMPILED
from generator.transport.world import LitPatch

ENGINES = ("path", "patch", "surfel")
GPU_KINDS = ("OPTIX", "CUDA", "HIP", "METAL", "ONEAPI")
"""Cycles' names of what it can reach a GPU through, the quickest first."""

_LIFT = 1e-3
"""How far in front of the wall the patch lamp hovers, in its own minor radius, lest shadow rays meet the wall."""


class Renderer:
    """Renders what the camera sees on the relay wall.

    Made by `opened`, which also puts the scene back as it was.
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
            Of the noise, 0 to 2^31 - 1.
        target : bool
            With the hidden object, or the background without it.
        ambient : bool
            With the world's light, where there is any.

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
        target_parts = stage.target_parts(scene)
        with stage.Overrides() as overrides:
            overrides.set(scene.cycles, "samples", samples)
            overrides.set(scene.cycles, "seed", seed)
            overrides.set(scene.render, "filepath", stage.literal(self._file, rendered=True))
            if not target:
                for part in target_parts:
                    overrides.set(part, "hide_render", True)
            else:
                refuse_hidden(scene)
            dark = [] if ambient else _put_out_the_sky(scene, overrides)
            if samples != self._samples:
                # With persistent data the table that Cycles' random numbers come from stays as long as the most
                # samples so far asked for, so that a picture would depend on those before it. This frees it.
                scene.render.use_persistent_data = False
                scene.render.use_persistent_data = True
                self._samples = samples
            # Cycles also keeps the old samples and seed unless the scene is marked as changed.
            scene.update_tag()
            self._file.unlink(missing_ok=True)
            with stage.quiet():
                bpy.ops.render.render(write_still=True, scene=scene.name)
        if dark:
            bpy.data.batch_remove(dark)
        scene.update_tag()
        pixels, _ = read_picture(self._file)
        if not np.isfinite(pixels).all():
            raise NlosError(f"{bpy.data.filepath}: Cycles rendered NaN or infinite pixels (seed {seed})")
        return pixels


class SurfelRenderer:
    """As `Renderer`, by the three-reflection integral: no samples, no noise.

    Parameters
    ----------
    scene : bpy.types.Scene
    transport : Transport
    shadows : bool
        Less the light of the room that the target keeps from the wall.
    """

    def __init__(self, scene: bpy.types.Scene, transport: Transport, *, shadows: bool = True) -> None:
        self._scene = scene
        self._transport = transport
        self._shadows = shadows

    def render(self, *, samples: int = 0, seed: int = 0, target: bool = True, ambient: bool = True) -> Picture:
        """Render one picture with the target where it stands in the scene; samples and seed change nothing."""
        if not target:
            return self._transport.background(ambient=ambient).astype(np.float32)
        refuse_hidden(self._scene)
        position, turn, _ = Matrix(stage.snapshot(self._scene).matrices["target"].tolist()).decompose()
        return self.at(tuple(position), tuple(math.degrees(angle) for angle in turn.to_euler("XYZ")))

    def difference(self, position: Sequence[float], rotation: Sequence[float]) -> Array:
        """Return what the target at a pose changes of the empty scene, (height, width, 3), W/m^2/sr."""
        return self._transport.difference(position, rotation, shadows=self._shadows)

    def at(self, position: Sequence[float], rotation: Sequence[float]) -> Picture:
        """Render one picture with the target at a pose: metres, and degrees about x, then y, then z."""
        picture: Picture = self.pictures([position], [rotation])[0]
        return picture

    def pictures(self, positions: Sequence[Sequence[float]], rotations: Sequence[Sequence[float]]) -> Picture:
        """Render the pictures of many poses, (n, height, width, 3); each as `at` does, in less time."""
        return self._transport.pictures(positions, rotations, shadows=self._shadows)


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
) -> Iterator[Renderer | SurfelRenderer]:
    """Make a scene ready to be rendered by an engine; on leaving, put it back as it was.

    Parameters
    ----------
    scene : bpy.types.Scene
    engine : {"path", "patch", "surfel"}
    resolution : (int, int)
        Width and height, pixels.
    threads : int
        0 takes all cores. The pixels do not depend on it.
    accuracy : float
        Of `surfel`.
    denoise : bool
        Clean what Cycles renders with Open Image Denoise: smooth, and biased.
    device : {"cpu", "gpu"}
        That Cycles renders on.
    leave_out : sequence of str
        Of `partial.PARTS`, what `surfel` does not model.

    Raises
    ------
    NlosError
        The engine is unknown, or cannot honour something in the scene; or there is no GPU.
    """
    if engine not in ENGINES:
        raise NlosError(f"engine {engine!r}: there is none; choose from {', '.join(ENGINES)}")
    with tempfile.TemporaryDirectory(prefix="nlos-") as folder, stage.Overrides() as overrides:
        stage.hold_camera(scene, overrides)
        _linear_output(scene, overrides)
        _plain_cycles(scene, overrides)
        if device == "gpu" and engine != "surfel":
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
        found = extract.survey(scene, resolution=resolution, ambient=True)
        found.check(engine)
        order = stage.reflection_order(scene)  # as animation has it, now that a render has started once
        if found.world is not None and engine == "surfel":
            world, shadows = left_out.without(found.world, leave_out)
            yield SurfelRenderer(scene, Transport(world, accuracy=accuracy, threads=threads), shadows=shadows)
            return
        with _patch_lamp(scene, found, order) if engine == "patch" else contextlib.nullcontext():
            yield Renderer(scene, Path(folder))


def settings(sweep: Sweep) -> dict[str, Any]:
    """Return what `opened` wants to know of a sweep besides its engine."""
    return {name: getattr(sweep, name) for name in ("resolution", "accuracy", "device", "denoise", "leave_out")}


def use_gpu(overrides: stage.Overrides) -> list[str]:
    """Let Cycles render on the GPUs that Blender's preferences name, or else on all that are found.

    Returns
    -------
    list of str
        Their names.

    Raises
    ------
    NlosError
        There is none.
    """
    preferences = bpy.context.preferences.addons["cycles"].preferences
    preferred = preferences.compute_device_type
    for kind in (preferred, *GPU_KINDS):
        if kind == "NONE":
            continue
        try:
            overrides.set(preferences, "compute_device_type", kind)
        except TypeError:  # not on this system, or not in this Blender
            continue
        with stage.quiet():
            preferences.refresh_devices()
        found = [device for device in preferences.devices if device.type == kind]
        if kind == preferred and any(device.use for device in found):
            return [device.name for device in found if device.use]
        for device in preferences.devices:
            overrides.set(device, "use", device in found)
        if found:
            return [device.name for device in found]
    raise NlosError("device gpu: Cycles finds no GPU on this machine; check its driver, or render with --device cpu")


def refuse_hidden(scene: bpy.types.Scene) -> None:
    """Raise NlosError if the target is not rendered."""
    target = stage.find(scene, "target")
    if why := stage.unseen(scene, target):
        raise NlosError(f"{bpy.data.filepath or 'scene'}: the target {target.name!r} {why}; show it")


def choose(scene: bpy.types.Scene, found: extract.Survey | None = None) -> tuple[str, list[str]]:
    """Return the cheapest engine that is valid for a scene, and why no cheaper one is.

    Parameters
    ----------
    scene : bpy.types.Scene
    found : extract.Survey, optional
        Of the scene; it is surveyed if not given.

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
    found = found or extract.survey(scene)
    found.check("path")
    return next((engine, reasons) for engine, reasons in _by_cost(found))


def _by_cost(found: extract.Survey) -> Iterator[tuple[str, list[str]]]:
    """Engines that can honour a scene, the cheapest first, each with what the one before it cannot."""
    cheaper: list[str] = []
    for engine in reversed(ENGINES):
        reasons = found.reasons(engine) or (_uncompiled(found) if engine == "surfel" else [])
        if not reasons:
            yield engine, cheaper
        cheaper = reasons


def _uncompiled(found: extract.Survey) -> list[str]:
    """Why `surfel`, which can render a scene, is not the cheapest: Blender's own Python has no compiler for it."""
    if COMPILED or found.world is None or not found.world.room:
        return []
    return ["surfel takes minutes for a room's own light where numba is missing"]


def _linear_output(scene: bpy.types.Scene, overrides: stage.Overrides) -> None:
    """Let the renderer's own float32 radiance be what is written."""
    # Another format has other depths, codecs and colour spaces: assigning it changes them.
    overrides.keep(scene.render.image_settings, "media_type", "file_format", "color_mode", "color_depth")
    _replace(scene, overrides, replaced.OUTPUT)


def _plain_cycles(scene: bpy.types.Scene, overrides: stage.Overrides) -> None:
    """Let Cycles be unbiased, and its noise follow from seed and samples alone."""
    _replace(scene, overrides, replaced.SAMPLING)


def _replace(scene: bpy.types.Scene, overrides: stage.Overrides, settings: Sequence[replaced.Setting]) -> None:
    for setting in settings:
        for owner, name in replaced.places(scene, setting):
            overrides.set(owner, name, setting.value)


@contextlib.contextmanager
def _patch_lamp(scene: bpy.types.Scene, found: extract.Survey, order: int) -> Iterator[None]:
    """Put an area lamp in the place of the lit patch, which stands for the first reflection.

    The spot itself stays for the light of order 1, which Cycles finds without noise, if the camera sees the patch.
    What comes from the patch lamp has one reflection behind it already, so it may make one bounce less than the
    scene allows.
    """
    patch, spot = found.patch, stage.find(scene, "spot")
    assert patch is not None
    light = bpy.data.lights.new("NLOS lit patch", "AREA")
    lamp = bpy.data.objects.new("NLOS lit patch", light)
    own = spot.data.copy()  # other lamps may share it, and keep theirs
    try:
        with stage.Overrides() as overrides:
            overrides.set(spot, "data", own)
            own.cycles.max_bounces = 0
            seen = _in_view(scene, patch)
            if not seen:
                overrides.set(spot, "hide_render", True)
            if order < 2:
                yield
                return
            if found.alone:
                # Only the wall sees the spot itself, and it is flat: that the patch lamp might shine around what is
                # round in the shading only would be light that no reflection brings.
                for obj in bpy.data.objects:
                    overrides.set(*extract.softener(obj), 0.0)
                # After the patch lamp's last bounce there is nothing left to find.
                overrides.set(scene.cycles, "max_bounces", order - 2)
            if found.alone and not seen:  # with one lamp there is nothing to choose among
                overrides.set(scene.cycles, "use_light_tree", False)
            _shape_lamp(lamp, patch)
            light.cycles.max_bounces = order - 2
            # A mirror shows the lamp only to rays that meet it by chance. They are not held to the limit above,
            # but to that of the scene, which is as low if there is no other light.
            light.cycles.use_multiple_importance_sampling = found.alone and found.mirrors
            lamp.visible_camera = False
            scene.collection.objects.link(lamp)
            yield
    finally:
        bpy.data.lights.remove(light)  # takes the object with it
        bpy.data.lights.remove(own)


def _put_out_the_sky(scene: bpy.types.Scene, overrides: stage.Overrides) -> list[bpy.types.World]:
    """Put worlds without light in the place of those of a scene, and return them."""
    dark = []
    for owner, name in stage.worlds_of(scene):
        dark.append(nodes.darkened(getattr(owner, name)))
        overrides.set(owner, name, dark[-1])
    return dark


def _in_view(scene: bpy.types.Scene, patch: LitPatch) -> bool:
    """Whether the camera may see some of the patch, judged by the rectangle around it: a no is sure."""
    if scene.camera.data.dof.use_dof:  # a lens sees past what a pinhole does not
        return True
    turns = np.linspace(0.0, 2.0 * math.pi, 64, endpoint=False)
    rim = [patch.centre + 1.05 * (math.cos(t) * patch.major + math.sin(t) * patch.minor) for t in turns]
    eye = scene.camera.copy()  # which nothing hides: of what the viewport hides Blender does not know the place
    try:
        eye.matrix_world = Matrix(stage.snapshot(scene).matrices["camera"].tolist())
        seen = np.array([world_to_camera_view(scene, eye, Vector(p)) for p in rim], dtype=np.float64)
    finally:
        bpy.data.objects.remove(eye)
    behind = seen[:, 2] <= 0.0
    if behind.any() and not behind.all():
        return True
    low, high = seen.min(axis=0), seen.max(axis=0)
    return bool(not behind.all() and low[0] < 1.0 and high[0] > 0.0 and low[1] < 1.0 and high[1] > 0.0)


def _shape_lamp(lamp: bpy.types.Object, patch: LitPatch) -> None:
    light: Any = lamp.data
    major, minor = (float(np.linalg.norm(v)) for v in (patch.major, patch.minor))
    light.shape = "ELLIPSE"
    light.size, light.size_y = 2.0 * major, 2.0 * minor
    # Cycles' area lamp of power P has radiance P / (pi A), here 1; the nodes multiply it.
    light.energy = math.pi * math.pi * major * minor
    light.color = (1.0, 1.0, 1.0)
    light.spread = math.pi
    x, z = patch.major / major, -patch.normal  # a lamp shines along its -z
    frame = np.eye(4)
    frame[:3, 0], frame[:3, 1], frame[:3, 2] = x, np.cross(z, x), z
    frame[:3, 3] = patch.centre + _LIFT * minor * patch.normal
    lamp.matrix_world = Matrix(frame.tolist())
    _radiance_nodes(light, patch)


def _radiance_nodes(light: Any, patch: LitPatch) -> None:
    """Radiance of the patch, point by point (`LitPatch`), as shader nodes."""
    if light.node_tree is None or (bpy.app.version < (5, 2) and not light.use_nodes):
        light.use_nodes = True
    tree = light.node_tree
    tree.nodes.clear()

    def node(kind: str, **settings: Any) -> Any:
        made = tree.nodes.new(kind)
        for key, value in settings.items():
            setattr(made, key, value)
        return made

    def vector(operation: str, a: Any, b: Any = None) -> Any:
        made = node("ShaderNodeVectorMath", operation=operation)
        tree.links.new(a, made.inputs[0])
        if b is not None:
            made.inputs[1].default_value = tuple(float(v) for v in b)
        return made.outputs["Value" if operation in ("LENGTH", "DOT_PRODUCT") else "Vector"]

    def math_node(operation: str, a: Any, b: Any) -> Any:
        made = node("ShaderNodeMath", operation=operation)
        for socket, value in zip(made.inputs, (a, b), strict=False):
            if isinstance(value, float):
                socket.default_value = value
            else:
                tree.links.new(value, socket)
        return made.outputs[0]

    way = vector("SUBTRACT", node("ShaderNodeNewGeometry").outputs["Position"], patch.lamp)
    distance = vector("LENGTH", way)
    # In units of the height the ratio is near 1 at any scale; its cube never leaves float32's range.
    ratio = math_node("DIVIDE", patch.height, distance)
    strength = math_node("POWER", ratio, 3.0)
    if patch.cos_width > 0:
        cosine = math_node("DIVIDE", vector("DOT_PRODUCT", way, patch.axis), distance)
        fade = node("ShaderNodeMapRange", interpolation_type="SMOOTHSTEP")
        fade.inputs["From Min"].default_value = patch.cos_outer
        fade.inputs["From Max"].default_value = patch.cos_outer + patch.cos_width
        tree.links.new(cosine, fade.inputs["Value"])
        strength = math_node("MULTIPLY", strength, fade.outputs[0])
    peak = patch.albedo / math.pi * patch.intensity / patch.height**2
    brightest = float(peak.max())
    emission = node("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (*(float(p) / brightest if brightest else 0.0 for p in peak), 1.0)
    tree.links.new(math_node("MULTIPLY", strength, brightest), emission.inputs["Strength"])
    tree.links.new(emission.outputs["Emission"], node("ShaderNodeOutputLight").inputs["Surface"])
