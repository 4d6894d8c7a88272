"""The background of a paired sweep is of the same world as its pictures, whatever the world."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from nodetrees import WHITE, bare, node, output, tree_of

from generator.blender import sweep_worker
from generator.blender.engines import renderers
from generator.blender.scene import blend_file, roles
from generator.sets.manifest import BACKGROUND, BACKGROUND_AMBIENT


def emission(tree):
    node(tree, "Emission", output(tree, "World").inputs["Surface"], Color=WHITE, Strength=0.3)


def textured(tree):
    sky = node(tree, "Background", output(tree, "World").inputs["Surface"], Strength=0.3)
    node(tree, "TexGradient", sky.inputs["Color"])


def fog(tree):
    """It takes light away, and gives none."""
    node(tree, "VolumeAbsorption", output(tree, "World").inputs["Volume"], Density=0.5)


def fog_under_a_sky(tree):
    fog(tree)
    end = tree.get_output_node("CYCLES")
    node(tree, "Background", end.inputs["Surface"], Color=WHITE, Strength=0.3)


def mixed(tree):
    mix = node(tree, "MixShader", output(tree, "World").inputs["Surface"])
    node(tree, "LightPath", mix.inputs[0])
    node(tree, "Background", mix.inputs[1], Color=WHITE, Strength=0.3)
    node(tree, "Background", mix.inputs[2], Color=WHITE, Strength=0.1)


@pytest.mark.parametrize(
    "build",
    [emission, fog, *(pytest.param(sky, marks=pytest.mark.slow) for sky in (textured, fog_under_a_sky, mixed))],
    ids=lambda f: f.__name__,
)
def test_paired_pictures_have_the_mean_of_those_that_are_not(tmp_path, build):
    scene = bare()
    build(tree_of(scene.world))
    # Light of order 1 on the watched wall makes the background bright: that of another world shows at once.
    roles.find(scene, "spot").location.x = -0.5
    roles.find(scene, "spot").rotation_euler = (-math.pi / 2.0, 0.0, 0.0)
    roles.limit_reflections(scene, 3)
    source = tmp_path / "scene.blend"
    blend_file.save_file(source)
    shining = build is not fog
    means = {}
    for paired in (True, False):
        chosen = {"engine": "path", "samples": 256, "poses": 6, "paired": paired, "resolution": "4x4", "seed": 5}
        made = sweep_worker.plan(blend_file.open_file(source), source, tmp_path / f"{paired}", chosen, probe=False)
        done = []
        batch = dict.fromkeys(range(len(made.poses)), 0)
        sweep_worker.render(sweep_worker.open_scene(made), made, [batch], report=done.extend)
        assert made.background_names == [BACKGROUND] + [BACKGROUND_AMBIENT] * shining
        means[paired] = np.array([made.picture(pose).mean() for pose in done])
        background = float(made.background().mean())
        assert background == pytest.approx(means[paired].mean(), rel=0.2), "the object changes little of it"
    apart = means[True] - means[False]  # of the same poses, each with random numbers of its own
    error = apart.std(ddof=1) / math.sqrt(len(apart))
    assert abs(apart.mean()) <= 5.0 * error + 0.01 * means[False].mean()
    assert error < 0.02 * means[False].mean()


def test_the_world_comes_back():
    scene = bare()
    emission(tree_of(scene.world))
    worlds = {world.name for world in bpy.data.worlds}
    mine = scene.world
    with renderers.opened(scene, "path", resolution=(4, 4)) as renderer:
        dark = renderer.render(samples=4, seed=1, ambient=False)
        bright = renderer.render(samples=4, seed=1)
    assert bright.mean() > dark.mean() + 0.05
    assert scene.world == mine
    assert {world.name for world in bpy.data.worlds} == worlds
