"""What is wrong is found, named, selected and mended; objects of one's own take part."""

from __future__ import annotations

import bpy
import mathutils
from helpers import WORK, call, check, looked, module, press, redraw, roles, screenshot, scroll, tab, until, view3d


def fresh():
    """A room of its own for the steps that follow, by File > New."""
    result = call(bpy.ops.nlos.new_room)
    check(result == {"FINISHED"}, f"File > New > NLOS Room: {result}")
    yield 1.0
    check(set(roles()) >= {"relay_wall", "spot", "camera", "target"}, f"a room stands there: {roles()}")
    check(bpy.context.window_manager.nlos.overlay, "the overlay is on")
    with view3d("UI") as (area, region):
        check(area.spaces.active.show_region_ui, "the sidebar is open")
        check(region.active_panel_category == "NLOS", f"at its tab: {region.active_panel_category}")
    differs = module("view.differs")
    yield from until(lambda: differs.found() == ([], []), "no setting differs from what was built")
    yield from screenshot("20-new-room")
    yield from tab("NLOS")


def check_a_sound_scene():
    state, levels = module("session.state"), module("generator.blender.check")
    bpy.context.scene.nlos.samples, bpy.context.scene.nlos.resolution = 16, (32, 32)
    result = call(bpy.ops.nlos.check)
    yield from looked()
    check(result == {"FINISHED"}, f"the check runs: {result}")
    check(state.checking, "signal and noise are measured beside")
    yield from until(lambda: not state.checking, "they are measured", 120.0)
    texts = [f.text for f in state.findings]
    check(not levels.hopeless(state.findings), f"the preset is sound: {texts}")
    check(any("adds" in text for text in texts), f"the signal's share is told: {texts}")
    check(any("on disk" in text for text in texts), f"time and disk are told: {texts}")
    yield from scroll(100)
    yield from scroll(-18)
    yield from screenshot("20-check")


def check_names_selects_and_mends():
    state = module("session.state")
    scene = bpy.context.scene
    roles = module("generator.blender.scene.roles")
    roles.limit_reflections(scene, 2)
    roles.find(scene, "target").hide_render = True
    with view3d():
        bpy.ops.ed.undo_push(message="spoilt")
    call(bpy.ops.nlos.check)
    yield from looked()
    found = {f.fix: f for f in state.findings if f.fix}
    check({"reflections", "show"} <= set(found), f"both faults are found: {[f.text for f in state.findings]}")
    redraw()
    yield from screenshot("20-faults")
    yield from press(f'nlos.select(name="{found["show"].object}"')
    active = bpy.context.view_layer.objects.active
    check(active and active.name == found["show"].object, f"its button selects it: {active}")
    for fix in ("reflections", "show"):
        result = call(bpy.ops.nlos.fix, fix=fix)
        yield from looked()
        check(result == {"FINISHED"}, f"{fix} is mended: {result}")
    check(not [f for f in state.findings if f.fix in found], "and found no more")
    call(bpy.ops.ed.undo)
    yield 0.3
    check(roles.find(scene := bpy.context.scene, "target").hide_render, "undo takes back one remedy")
    check(roles.reflection_order(scene) == 3, "and not the other")
    call(bpy.ops.ed.redo)
    yield 0.3


def own_objects():
    call(bpy.ops.mesh.primitive_monkey_add, size=0.5, location=(1.5, 1.2, 1.2))
    result = call(bpy.ops.nlos.adopt, role="target")
    check(result == {"FINISHED"}, f"a monkey can be the target: {result}")
    name = bpy.context.object.name
    check(roles()["target"] == [name], f"and nobody else is: {roles()}")
    call(bpy.ops.ed.undo)
    yield 0.3
    check(roles()["target"] != [name], "undo gives the part back")
    call(bpy.ops.ed.redo)
    yield 0.3
    check(roles()["target"] == [name], "redo takes it again")
    words = call(bpy.ops.nlos.adopt, role="spot")
    check("no spot lamp" in str(words), f"a monkey cannot be the lamp: {words}")
    for _ in range(2):
        call(bpy.ops.ed.undo)
    yield 0.3


def room_of_one_mesh():
    """Floor, ceiling and walls joined to one object, which is then the relay wall, and moved away."""
    state, players = module("session.state"), module("generator.blender.scene.roles")
    call(bpy.ops.wm.save_as_mainfile, filepath=str(WORK / "whole20.blend"))
    scene = bpy.context.scene
    for obj in scene.objects:
        obj.select_set(obj.get("nlos_role") in ("relay_wall", "room"))
    bpy.context.view_layer.objects.active = players.find(scene, "relay_wall")
    call(bpy.ops.object.join)
    yield 0.3
    check(not players.players(scene, "room"), "the room is one object")
    lamp = players.find(scene, "spot")
    empty = bpy.data.objects.new("Aim", None)
    empty.location = (0.3, 0.0, 1.3)
    scene.collection.objects.link(empty)
    track = lamp.constraints.new("TRACK_TO")
    track.target, track.track_axis, track.up_axis = empty, "TRACK_NEGATIVE_Z", "UP_Y"
    turn = mathutils.Matrix.Translation((1.0, 2.0, 0.0)) @ mathutils.Matrix.Rotation(1.0, 4, "Z")
    for obj in [o for o in scene.objects if o.parent is None]:
        obj.matrix_basis = turn @ obj.matrix_basis
    bpy.context.view_layer.update()
    call(bpy.ops.nlos.check)
    yield from looked()
    found = [f.fix for f in state.findings if f.fix]
    check(found == ["align"], f"its lit face is to be aligned: {[f.text for f in state.findings]}")
    result = call(bpy.ops.nlos.fix, fix="align")
    yield from looked()
    check(result == {"FINISHED"}, f"it is aligned: {result}")
    levels = module("generator.blender.check")
    texts = [f.text for f in state.findings]
    check(not levels.hopeless([f for f in state.findings if "voxel" not in f.text.lower()]), f"and sound: {texts}")
    redraw()
    yield from screenshot("20-joined")
    call(bpy.ops.wm.open_mainfile, filepath=str(WORK / "whole20.blend"))
    yield 1.0
    yield from tab("NLOS")


def states_without_a_scene():
    """Nothing there, nothing right: a sentence, never a traceback."""
    call(bpy.ops.wm.save_as_mainfile, filepath=str(WORK / "room20.blend"))
    call(bpy.ops.wm.read_homefile, use_empty=True)
    yield 1.0
    yield from tab("NLOS")
    for operator in ("apply", "read_scene", "render_wall", "experiment"):
        words = call(getattr(bpy.ops.nlos, operator))
        check("no object is the" in str(words), f"{operator} of an empty scene: {words}")
    call(bpy.ops.nlos.check)
    yield from looked()
    check(
        "No object is the relay wall" in module("session.state").findings[0].text, "the check names what is missing"
    )
    words = call(bpy.ops.nlos.adopt, role="target")
    check("no object is selected" in str(words), f"adopt nothing: {words}")
    words = call(bpy.ops.nlos.sweep_start)
    check("Save the file first" in str(words), f"a data set beside no file: {words}")
    session = bpy.context.window_manager.nlos
    session.look = session.overlay = True
    yield 1.0
    check("no object is the" in module("view.live").words(), f"the look of nothing: {module('view.live').words()}")
    yield from screenshot("20-empty")
    session.look = session.overlay = False
    call(bpy.ops.wm.open_mainfile, filepath=str(WORK / "room20.blend"))
    yield 1.0
    yield from tab("NLOS")


STEPS = [
    fresh,
    check_a_sound_scene,
    check_names_selects_and_mends,
    own_objects,
    room_of_one_mesh,
    states_without_a_scene,
]
