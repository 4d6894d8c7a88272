"""The lamp of the engine `patch`: the first reflection as a light that Cycles samples."""

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
from generator.blender.engines.lit_patch import LIFT
from generator.blender.engines.shapes import softener
from generator.blender.scene import geometry, roles
from generator.blender.scene.quiet import Overrides
from generator.transport.world import LitPatch


@contextlib.contextmanager
def patch_lamp(scene: bpy.types.Scene, found: survey.Survey, order: int) -> Iterator[None]:
    """Put an area lamp at the lit patch, in place of the first reflection.

    The spot itself stays for the light of order 1, which Cycles renders without noise, if the camera sees the patch.
    Light from the patch lamp has already been reflected once, so it may make one bounce less than the scene
    allows.
    """
    patch, spot = found.patch, roles.find(scene, "spot")
    assert patch is not None
    light = bpy.data.lights.new("NLOS lit patch", "AREA")
    lamp = bpy.data.objects.new("NLOS lit patch", light)
    spot_light = spot.data.copy()  # other lamps may share the original
    try:
        with Overrides() as overrides:
            overrides.set(spot, "data", spot_light)
            spot_light.cycles.max_bounces = 0
            in_view = _in_view(scene, patch)
            if not in_view:
                overrides.set(spot, "hide_render", True)
            if order < 2:
                yield
                return
            if found.alone:
                # The offset lets lamps shine around corners that only the shading rounds. Light of the patch lamp
                # must not, for no reflection does; the spot itself lights only the wall, which is flat.
                for obj in bpy.data.objects:
                    overrides.set(*softener(obj), 0.0)
                # After the last bounce of the patch lamp's light no other light is left to be found.
                overrides.set(scene.cycles, "max_bounces", order - 2)
            if found.alone and not in_view:  # a single lamp needs no light tree
                overrides.set(scene.cycles, "use_light_tree", False)
            _shape_lamp(lamp, patch)
            light.cycles.max_bounces = order - 2
            # A mirror shows the lamp only to rays that hit it by chance. They obey not the lamp's limit of bounces
            # above but the scene's, which is as low if there is no other light.
            light.cycles.use_multiple_importance_sampling = found.alone and found.mirrors
            lamp.visible_camera = False
            scene.collection.objects.link(lamp)
            yield
    finally:
        bpy.data.lights.remove(light)  # removes the object too
        bpy.data.lights.remove(spot_light)


def _in_view(scene: bpy.types.Scene, patch: LitPatch) -> bool:
    """Whether the camera may see part of the patch, judged by its bounding rectangle; False is certain."""
    if scene.camera.data.dof.use_dof:  # a lens sees more than a pinhole
        return True
    turns = np.linspace(0.0, 2.0 * math.pi, 64, endpoint=False)
    rim = [patch.centre + 1.05 * (math.cos(t) * patch.major + math.sin(t) * patch.minor) for t in turns]
    # A copy, which is visible: Blender does not update the transform of objects that the viewport hides.
    camera = scene.camera.copy()
    try:
        camera.matrix_world = Matrix(geometry.snapshot(scene).matrices["camera"].tolist())
        projected = np.array([world_to_camera_view(scene, camera, Vector(p)) for p in rim], dtype=np.float64)
    finally:
        bpy.data.objects.remove(camera)
    behind = projected[:, 2] <= 0.0
    if behind.any() and not behind.all():
        return True
    low, high = projected.min(axis=0), projected.max(axis=0)
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
    frame[:3, 3] = patch.centre + LIFT * minor * patch.normal
    lamp.matrix_world = Matrix(frame.tolist())
    _radiance_nodes(light, patch)


def _radiance_nodes(light: Any, patch: LitPatch) -> None:
    """Build shader nodes that give the patch's radiance point by point (`LitPatch`)."""
    if light.node_tree is None or (bpy.app.version < (5, 2) and not light.use_nodes):
        light.use_nodes = True
    tree = light.node_tree
    tree.nodes.clear()

    def node(kind: str, **settings: Any) -> Any:
        new_node = tree.nodes.new(kind)
        for key, value in settings.items():
            setattr(new_node, key, value)
        return new_node

    def vector(operation: str, a: Any, b: Any = None) -> Any:
        new_node = node("ShaderNodeVectorMath", operation=operation)
        tree.links.new(a, new_node.inputs[0])
        if b is not None:
            new_node.inputs[1].default_value = tuple(float(v) for v in b)
        return new_node.outputs["Value" if operation in ("LENGTH", "DOT_PRODUCT") else "Vector"]

    def math_node(operation: str, a: Any, b: Any) -> Any:
        new_node = node("ShaderNodeMath", operation=operation)
        for socket, value in zip(new_node.inputs, (a, b), strict=False):
            if isinstance(value, float):
                socket.default_value = value
            else:
                tree.links.new(value, socket)
        return new_node.outputs[0]

    ray = vector("SUBTRACT", node("ShaderNodeNewGeometry").outputs["Position"], patch.lamp)
    distance = vector("LENGTH", ray)
    # In units of the height the ratio is near 1 at any scale; its cube never leaves float32's range.
    ratio = math_node("DIVIDE", patch.height, distance)
    strength = math_node("POWER", ratio, 3.0)
    if patch.cos_width > 0:
        cosine = math_node("DIVIDE", vector("DOT_PRODUCT", ray, patch.axis), distance)
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
