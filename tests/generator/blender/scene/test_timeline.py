"""An animated target's poses are those of the frames, with all that moves it; other changes are refused by name."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from generator.blender.scene import build, roles, timeline
from generator.model import poses
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.settings import Sweep

CENTRE = Vector((1.4, 1.2, 1.3))


@pytest.fixture
def scene():
    made = build.new_scene(preset("room", "sheet"))
    made.frame_start, made.frame_end, made.frame_step = 1, 9, 1
    made.frame_set(1)
    return made


def keyed(obj, name="location", values=((1.2, 1.2, 1.3), (1.6, 1.4, 1.3)), frames=(1, 9)):
    for frame, value in zip(frames, values, strict=True):
        if name.startswith("["):
            obj[name[2:-2]] = value
        else:
            setattr(obj, name, value)
        obj.keyframe_insert(name, frame=frame)


def matrices(scene, frames):
    """The target's matrices as the dependency graph evaluates them."""
    found = []
    for frame in frames:
        scene.frame_set(frame)
        target = roles.find(scene, "target").evaluated_get(bpy.context.evaluated_depsgraph_get())
        found.append(np.array(target.matrix_world))
    return found


def by_keys(scene, target):
    keyed(target)
    keyed(target, "rotation_euler", ((0.0, 0.1, 0.3), (0.2, 0.0, 2.9)))


def by_a_parent(scene, target):
    empty = bpy.data.objects.new("Cart", None)
    scene.collection.objects.link(empty)
    empty.location, empty.rotation_euler = CENTRE, (0.0, 0.0, 0.4)
    target.parent, target.location = empty, (0.1, 0.0, 0.0)
    empty.scale = (0.5, 0.5, 0.5)
    keyed(empty, values=(CENTRE, CENTRE + Vector((0.2, 0.1, 0.0))))


def by_a_constraint(scene, target):
    lead = bpy.data.objects.new("Lead", None)
    scene.collection.objects.link(lead)
    keyed(lead)
    constraint = target.constraints.new("COPY_LOCATION")
    constraint.target, constraint.influence = lead, 0.7


def by_a_driver(scene, target):
    driver = target.driver_add("location", 0).driver
    driver.type = "SCRIPTED"
    driver.expression = "1.2 + 0.03 * frame"
    target.location.y, target.location.z = 1.2, 1.3


def by_a_custom_property(scene, target):
    target["way"] = 0.0
    keyed(target, '["way"]', (0.0, 0.4))
    driver = target.driver_add("location", 0).driver
    variable = driver.variables.new()
    variable.name, variable.targets[0].id, variable.targets[0].data_path = "way", target, '["way"]'
    driver.expression = "1.2 + way"
    target.location.y, target.location.z = 1.2, 1.3


@pytest.mark.parametrize("moved", [by_keys, by_a_parent, by_a_constraint, by_a_driver, by_a_custom_property])
@pytest.mark.parametrize("frames", [(), (2, 8, 3)])
def test_poses_are_those_of_the_frames(scene, moved, frames):
    target = roles.find(scene, "target")
    moved(scene, target)
    expected = matrices(scene, range(*((frames[0], frames[1] + 1, frames[2]) if frames else (1, 10))))
    read = timeline.take(scene, frames)
    assert read.frames == (frames or (1, 9, 1))
    assert read.fps == 24.0
    for (place, turn), matrix in zip(read.poses, expected, strict=True):
        np.testing.assert_allclose(place, matrix[:3, 3], atol=1e-6)
        size = np.linalg.norm(matrix[:3, :3], axis=0)
        x, y, z = map(math.radians, turn)
        rotation = Matrix.Rotation(z, 3, "Z") @ Matrix.Rotation(y, 3, "Y") @ Matrix.Rotation(x, 3, "X")
        np.testing.assert_allclose(np.array(rotation) * size, matrix[:3, :3], atol=1e-5)
    scene.frame_set(9)  # it stands at the first, and nothing moves it any more
    still = np.array(target.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world)
    np.testing.assert_allclose(still, expected[0], atol=1e-5)
    assert target.parent is None
    assert not target.constraints


def move_lamp(scene):
    keyed(roles.find(scene, "spot"), values=((0.0, 2.0, 1.3), (0.1, 2.0, 1.3)))


def dim_lamp(scene):
    lamp = roles.find(scene, "spot").data
    keyed(lamp, "energy", (100.0, 50.0))


def move_camera(scene):
    keyed(roles.find(scene, "camera"), "rotation_euler", ((1.0, 0.0, 0.0), (1.1, 0.0, 0.0)))


def move_wall(scene):
    wall = next(o for o in scene.objects if o.get(roles.ROLE) == "room")
    start = wall.location.copy()
    keyed(wall, values=(start, start + Vector((0.0, 0.02, 0.0))))


def paint(scene):
    wall = roles.find(scene, "relay_wall")
    colour = wall.material_slots[0].material.node_tree.nodes["Diffuse BSDF"].inputs["Color"]
    for frame, grey in ((1, 0.8), (9, 0.4)):
        colour.default_value = (grey, grey, grey, 1.0)
        colour.keyframe_insert("default_value", frame=frame)


def hide_wall(scene):
    wall = next(o for o in scene.objects if o.get(roles.ROLE) == "room")
    keyed(wall, "hide_render", (False, True), frames=(1, 5))


def grow(scene):
    keyed(roles.find(scene, "target"), "scale", ((1.0, 1.0, 1.0), (1.2, 1.0, 1.0)))


def by_driver(scene):
    driver = roles.find(scene, "spot").data.driver_add("energy").driver
    driver.type = "SCRIPTED"
    driver.expression = "100 + frame"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (move_lamp, "'Spot' moves from frame 1 to frame"),
        (dim_lamp, "energy of 'Spot' changes"),
        (by_driver, "energy of 'Spot' changes"),
        (move_camera, "'Camera' moves"),
        (move_wall, "is another or elsewhere from frame 1"),
        (hide_wall, "from frame 1 to frame 5"),
        (paint, "default_value of '.*' changes"),
        (grow, "'Target' changes its shape or size"),
    ],
)
def test_what_else_changes_is_refused_by_name(scene, change, words):
    keyed(roles.find(scene, "target"))
    change(scene)
    with pytest.raises(NlosError, match=words):
        timeline.take(scene)


def test_keyframes_that_change_nothing_are_no_fault(scene):
    keyed(roles.find(scene, "target"))
    lamp = roles.find(scene, "spot")
    place = tuple(lamp.location)
    keyed(lamp, values=(place, place))
    keyed(lamp.data, "energy", (70.0, 70.0))
    assert len(timeline.take(scene).poses) == 9


def test_a_target_at_rest_and_frames_that_are_none_are_refused(scene):
    with pytest.raises(NlosError, match="'Target' stands still from frame 1 to frame 9; give it keyframes"):
        timeline.take(scene)
    keyed(roles.find(scene, "target"))
    with pytest.raises(NlosError, match="stands still from frame 20 to frame 30"):
        timeline.take(scene, (20, 30, 1))
    for frames in ((9, 1, 1), (1, 9, 0), (1, 9)):
        with pytest.raises(NlosError, match="must be the first frame, the last one and a step"):
            timeline.take(scene, frames)


def test_a_frame_where_it_cannot_stand_is_named():
    grid = preset("room", "sheet").grid
    inside = tuple(np.mean([grid.lo, grid.hi], axis=0))
    outside = (inside[0], grid.hi[1] + 0.1, inside[2])
    sweep = Sweep(frames=2, timeline=(10, 15, 5))
    still = (0.0, 0.0, 0.0)
    records = poses.along(grid, sweep, [(inside, still), (inside, still)])
    assert [record.file for record in records] == ["frames/00000.exr", "frames/00001.exr"]
    with pytest.raises(NlosError, match=r"frame 15: the target, at .* m, is outside the hidden voxels"):
        poses.along(grid, sweep, [(inside, still), (outside, still)])
    with pytest.raises(NlosError, match=r"frame 10: .* cuts a surface"):
        poses.along(grid, sweep, [(inside, still)] * 2, lambda *_: False)
