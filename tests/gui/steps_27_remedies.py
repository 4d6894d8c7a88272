"""The look names what is in its way, with a button that selects it, and draws once it is mended; Fit Voxels."""

from __future__ import annotations

import bpy
from helpers import call, check, looked, module, panel_picture, press, redraw, screenshot, tab, until


def _spoilt(scene, roughness, radius):
    roles = module("generator.blender.scene.roles")
    material = roles.find(scene, "target").data.materials[0]
    material.node_tree.nodes["Diffuse BSDF"].inputs["Roughness"].default_value = roughness
    roles.find(scene, "spot").data.shadow_soft_size = radius
    return material.name


def reasons():
    bpy.context.scene.nlos.preset = "room"
    call(bpy.ops.nlos.build_scene)
    live = module("view.live")
    material = _spoilt(bpy.context.scene, 0.5, 0.1)
    bpy.context.window_manager.nlos.look = True
    yield from tab("NLOS")
    yield from until(live.reasons, "the look says what is in its way")
    texts = " ".join(finding.text for finding in live.reasons())
    check("set the lamp's Radius to 0" in texts and repr(material) in texts, texts)
    yield from panel_picture("NLOS_PT_look", "27-reasons")
    yield from press('nlos.select(name="Spot"')
    check(bpy.context.view_layer.objects.active.name == "Spot", "its button selects the lamp")
    _spoilt(bpy.context.scene, 0.0, 0.0)
    yield from until(lambda: live.pictures() and not live.reasons(), "mended, the look draws", 60.0)
    bpy.context.window_manager.nlos.look = False


def fitted():
    grid = tuple(bpy.context.scene["nlos_grid_hi"])
    yield from panel_picture("NLOS_PT_voxels", "27-voxels")
    call(bpy.ops.nlos.fix, fix="voxels")
    yield from looked()
    check(tuple(bpy.context.scene["nlos_grid_hi"]) != grid, "Fit Voxels lays them anew")
    texts = [finding.text for finding in module("session.state").findings]
    check(any("hidden from lamp and camera" in text for text in texts), f"hidden: {texts}")
    bpy.context.window_manager.nlos.overlay = True
    redraw()
    yield 0.5
    yield from screenshot("27-fitted")
    bpy.context.window_manager.nlos.overlay = False
    bpy.context.scene.nlos.preset = "room"  # with its own voxels
    call(bpy.ops.nlos.build_scene)


STEPS = [reasons, fitted]
