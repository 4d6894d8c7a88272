"""Lamps besides the spot and glowing surfaces: as Cycles renders them, or refused by name."""

from __future__ import annotations

import math
from dataclasses import replace

import bpy
import numpy as np
import pytest
from nodetrees import WHITE, node, output, tree_of

from generator.blender.engines import renderers, simplify, survey
from generator.blender.scene import blend_file, build
from generator.model.presets import preset
from generator.model.settings import Sweep
from generator.transport import Transport

SIZE, ROUNDS = (8, 8), 6
STRENGTH = 3.0


def built(order=2):
    scene = blend_file.new_file()
    build.build(scene, replace(preset("room"), resolution=SIZE, reflection_order=order))
    return scene


def lamp(kind, **settings):
    """A lamp under the ceiling, which shines down if it has a direction."""
    lamp = bpy.data.objects.new("Bulb", bpy.data.lights.new("Bulb", kind))
    lamp.data.energy, lamp.location = 1.0, (1.2, 1.6, 2.2)
    lamp.scale = (settings.pop("scale", 1.0),) * 3
    for name, value in settings.items():
        setattr(lamp.data, name, value)
    bpy.context.scene.collection.objects.link(lamp)
    return lamp


def panel(*, share=1.0):
    """A square just below the ceiling, of which ``share`` glows and the rest of the shader is missing."""
    mesh = bpy.data.meshes.new("Panel")
    mesh.from_pydata([(-0.3, -0.3, 0), (0.3, -0.3, 0), (0.3, 0.3, 0), (-0.3, 0.3, 0)], [], [(0, 1, 2, 3)])
    made = bpy.data.objects.new("Panel", mesh)
    made.location = (1.2, 1.6, 2.5)
    material = bpy.data.materials.new("Glow")
    tree = tree_of(material)
    mix = node(tree, "MixShader", output(tree).inputs["Surface"])
    mix.inputs[0].default_value = share
    node(tree, "Emission", mix.inputs[2], Color=WHITE, Strength=STRENGTH)
    mesh.materials.append(material)
    bpy.context.scene.collection.objects.link(made)
    return made


FOLLOWED = {
    "point": lambda: lamp("POINT", shadow_soft_size=0.0),
    "ball": lambda: lamp("POINT", shadow_soft_size=0.2, use_soft_falloff=False),
    "soft ball": lambda: lamp("POINT", shadow_soft_size=0.2),
    "scaled ball": lambda: lamp("POINT", shadow_soft_size=0.2, use_soft_falloff=False, scale=0.5),
    "square": lambda: lamp("AREA", size=0.5),
    "scaled square": lambda: lamp("AREA", size=0.25, scale=2.0),
    "rectangle": lambda: lamp("AREA", shape="RECTANGLE", size=0.6, size_y=0.2),
    "ellipse": lambda: lamp("AREA", shape="ELLIPSE", size=0.2, size_y=0.6),
    "panel": panel,
    "half a panel": lambda: panel(share=0.5),
}


QUICK = ("rectangle",)


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in FOLLOWED])
def test_a_lamp_lights_the_wall_as_cycles_renders_it(name):
    """Its light after two reflections; Student's t with five degrees of freedom, one false alarm in 10,000."""
    scene = built()
    FOLLOWED[name]()
    engine = Transport(survey.surfel_world(scene), accuracy=1e-2)
    ours = engine._followed("emitters").mean()
    simplify.without_light(scene)
    with renderers.opened(scene, "path", **{**renderers.settings(Sweep()), "resolution": SIZE}) as renderer:
        theirs = [renderer.render(samples=512, seed=seed, target=False).mean() for seed in range(ROUNDS)]
    error = np.std(theirs, ddof=1) / math.sqrt(ROUNDS)
    assert error < 0.01 * ours
    assert abs(np.mean(theirs) - ours) < 9.7 * error + 0.005 * ours


def moving():
    lamp("POINT").parent = bpy.data.objects["Target"]


def in_view():
    made = lamp("AREA", size=0.2)
    made.location, made.rotation_euler = (-0.45, 0.5, 1.3), (math.pi / 2.0, 0.0, 0.0)
    made.visible_camera = True  # which a lamp is not by default


REFUSED = {
    "a narrow area": (lambda: lamp("AREA", spread=1.0), "is an area lamp whose spread is not 180 degrees"),
    "a sun": (lambda: lamp("SUN"), "is a sun lamp"),
    "no shadow": (lambda: lamp("POINT", use_shadow=False), "casts no shadows"),
    "on the target": (moving, "moves with the target"),
    "in the camera's view": (in_view, "the lamp 'Bulb' stands between the camera"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_lamp_that_cannot_be_followed_is_named(name):
    scene = built()
    edit, words = REFUSED[name]
    edit()
    bpy.context.view_layer.update()
    _, reasons = survey.world(scene)
    assert [r for r in reasons if "the lamp 'Bulb'" in r and words in r], reasons
