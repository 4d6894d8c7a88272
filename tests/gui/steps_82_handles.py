"""Faces of the voxel grid are dragged by their arrows: one undo step a drag, the panel follows, Esc takes it back."""

from __future__ import annotations

import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d
from helpers import call, check, click, module, point, redraw, screenshot, tab, view3d, xdotool
from mathutils import Vector


def grid():
    return module("generator.blender.scene.roles").read_grid(bpy.context.scene)


def told(wanted):
    """Whether the panel has the corners of a grid."""
    settings = bpy.context.scene.nlos
    pairs = zip((*settings.grid_lo, *settings.grid_hi), (*wanted.lo, *wanted.hi), strict=True)
    return all(abs(a - b) < 1e-5 for a, b in pairs)


def arrow(axis, side):
    """The middle of a face's arrow in the window, and how the mouse moves along it: both in pixels."""
    found = grid()
    place = Vector([(a + b) / 2.0 for a, b in zip(found.lo, found.hi, strict=True)])
    place[axis] = (found.lo, found.hi)[side][axis]
    outward = Vector()
    outward[axis] = (-1.0, 1.0)[side]
    with view3d() as (area, region):
        view = area.spaces.active.region_3d
        start = location_3d_to_region_2d(region, view, place)
        way = (location_3d_to_region_2d(region, view, place + 0.1 * outward) - start).normalized()
        return start + 20.0 * way + Vector((region.x, region.y)), way


def drag(axis, side, pixels, key=""):
    start, way = arrow(axis, side)
    yield from point(*start)
    yield 0.3
    yield from xdotool("mousedown", 1)
    for share in (0.3, 0.6, 1.0):
        yield from point(*(start + share * pixels * way))
        yield 0.1
    if key:
        yield from xdotool("key", key)
        yield 0.2
    else:
        yield from screenshot(f"82-drag-{'xyz'[axis]}{side}")
    yield from xdotool("mouseup", 1)
    yield 0.3


def selects_behind():
    """Without its button there are no arrows, and a click where one would be selects what is there."""
    before, (start, _) = grid(), arrow(2, 1)
    target = module("generator.blender.scene.roles").find(bpy.context.scene, "target")
    place = target.location.copy()
    target.location = [(a + b) / 2.0 for a, b in zip(before.lo, before.hi, strict=True)]
    target.location.z = before.hi[2]
    with view3d():
        for obj in bpy.context.scene.objects:
            obj.select_set(False)
    redraw()
    yield 0.5
    yield from click(*start)
    yield 0.5
    with view3d():
        check(target.select_get(), "a click where an arrow would be selects the object there")
    check(grid() == before, "and leaves the voxels alone")
    target.location = place


def dragged():
    settings = bpy.context.scene.nlos
    settings.preset = "room"
    call(bpy.ops.nlos.build_scene)
    bpy.context.window_manager.nlos.overlay = True
    with view3d() as (area, _):
        area.spaces.active.show_region_ui = False
        view = area.spaces.active.region_3d
        view.view_location, view.view_distance = (1.0, 1.0, 1.0), 6.0
        view.view_rotation = Vector((-0.6, 1.0, -0.7)).to_track_quat("-Z", "Y")
    redraw()
    yield 1.0
    yield from selects_behind()
    bpy.context.window_manager.nlos.show_handles = True
    redraw()
    yield 0.5
    yield from screenshot("82-handles")
    for axis, side in ((0, 1), (0, 0), (2, 1), (1, 1)):
        before = grid()
        yield from drag(axis, side, 60)
        after = grid()
        out = (after.hi[axis] - before.hi[axis]) if side else (before.lo[axis] - after.lo[axis])
        check(out > 0.05, f"the face {'xyz'[axis]}{side} goes outwards: {out:.3f} m")
        check(after.shape == before.shape, "the counts stay")
        check(told(after), "the panel's figures follow")
        call(bpy.ops.ed.undo)
        yield 0.3
        check(grid() == before, f"one undo takes the drag back: {grid()}, {before}")
        check(told(before), "in the panel too")
        call(bpy.ops.ed.redo)
        yield 0.3
        check(grid() == after, "redo brings it again")


def stopped():
    before = grid()
    yield from drag(0, 1, 80, key="Escape")
    check(grid() == before, f"Esc takes it back: {grid()}")
    yield from drag(2, 1, -600)
    after = grid()
    check(0.0 < after.hi[2] - after.lo[2] < 0.01, f"a face never passes the opposite one: {after}")
    call(bpy.ops.ed.undo)
    yield 0.3
    check(grid() == before, "and that is undone")
    bpy.context.window_manager.nlos.show_handles = False
    bpy.context.window_manager.nlos.overlay = False
    redraw()
    yield from screenshot("82-off")
    yield from tab("NLOS")


STEPS = [dragged, stopped]
