"""The lamp of the engine `patch`: the first reflection, as a light that Cycles samples."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

from generator.blender.engines import survey
from generator.blender.engines.shapes import softener
from generator.blender.scene import geometry, roles
from generator.blender.scene.quiet import Overrides
from generator.transport.world import LitPatch

_LIFT = 1e-3
"""How far in front of the wall the patch lamp hovers, in its own minor radius, lest shadow rays meet the wall."""


@contextlib.contextmanager
def patch_lamp(scene: bpy.types.Scene, found: survey.Survey, order: int) -> Iterator[None]:
    """Put an area lamp in the place of the lit patch, which stands for the first reflection.

    The spot itself stays for the light of order 1, which Cycles finds without noise, if the camera sees the patch.
    What comes from the patch lamp has one reflection behind it already, so it may make one bounce less than the
    scene allows.
    """
    patch, spot = found.patch, roles.find(scene, "spot")
    assert patch is not None
    light = bpy.data.lights.new("NLOS lit patch", "AREA")
    lamp = bpy.data.objects.new("NLOS lit patch", light)
    own = spot.data.copy()  # other lamps may share it, and keep theirs
    try:
        with Overrides() as overrides:
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
                    overrides.set(*softener(obj), 0.0)
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


def _in_view(scene: bpy.types.Scene, patch: LitPatch) -> bool:
    """Whether the camera may see some of the patch, judged by the rectangle around it: a no is sure."""
    if scene.camera.data.dof.use_dof:  # a lens sees past what a pinhole does not
        return True
    turns = np.linspace(0.0, 2.0 * math.pi, 64, endpoint=False)
    rim = [patch.centre + 1.05 * (math.cos(t) * patch.major + math.sin(t) * patch.minor) for t in turns]
    eye = scene.camera.copy()  # which nothing hides: of what the viewport hides Blender does not know the place
    try:
        eye.matrix_world = Matrix(geometry.snapshot(scene).matrices["camera"].tolist())
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
