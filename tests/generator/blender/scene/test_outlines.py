"""What the overlay draws is where the engines have it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from generator.blender.engines import survey
from generator.blender.scene import blend_file, build, outlines, roles
from generator.model.grid import VoxelGrid
from generator.model.presets import preset
from generator.model.settings import Sweep


def built(name):
    scene = blend_file.new_file()
    build.build(scene, preset(name))
    return scene


def test_voxels_are_drawn_edge_by_edge():
    grid = VoxelGrid(lo=(0.0, 1.0, 2.0), hi=(3.0, 3.0, 3.0), shape=(3, 2, 1))
    edges, centres = outlines.voxels(grid)
    ends = edges.reshape(-1, 2, 3)
    assert len(ends) == 3 * 2 + 4 * 2 + 4 * 3, "lines along x, y, z"
    assert_allclose(np.sort(np.ptp(ends, axis=1).max(axis=1)), [1.0] * 12 + [2.0] * 8 + [3.0] * 6)
    assert_allclose((edges.min(axis=0), edges.max(axis=0)), (grid.lo, grid.hi))
    assert_allclose(centres[[0, 2, 5]], [(0.5, 1.5, 2.5), (2.5, 1.5, 2.5), (2.5, 2.5, 2.5)])
    boxes = outlines.boxes(grid).reshape(6, 12, 3, 3)
    area = np.linalg.norm(np.cross(boxes[:, :, 1] - boxes[:, :, 0], boxes[:, :, 2] - boxes[:, :, 0]), axis=2).sum(
        axis=1
    )
    assert_allclose(area / 2.0, 6.0)  # of a unit cube
    assert_allclose(boxes.mean(axis=(1, 2)), centres)


@pytest.mark.parametrize("name", ["room", "tabletop", "corridor"])
def test_patches_are_those_of_the_engines(name):
    scene = built(name)
    rim, patch = outlines.lit_patch(roles.find(scene, "spot")), survey.lit_patch(scene)
    away = rim - patch.centre
    along, across = away @ patch.major / (patch.major @ patch.major), away @ patch.minor / (patch.minor @ patch.minor)
    assert_allclose(along**2 + across**2, 1.0, rtol=1e-4)
    assert_allclose(rim[:, 1], 0.0, atol=1e-6)
    camera = preset(name).camera
    corners = outlines.watched(scene)
    assert_allclose((corners.min(axis=0), corners.max(axis=0))[0][[0, 2]], (camera.x[0], camera.z[0]), atol=1e-5)
    assert_allclose(corners.max(axis=0)[[0, 2]], (camera.x[1], camera.z[1]), atol=1e-5)


def test_light_legs_go_from_the_lamp_to_the_camera():
    scene, described = built("room"), preset("room")
    lamp, w1, target, w2, camera = outlines.legs(scene)
    assert_allclose(lamp, described.spot.location, atol=1e-6)
    assert_allclose(w1, described.spot.aim, atol=1e-5)
    assert_allclose(target, roles.find(scene, "target").location, atol=1e-6)
    assert_allclose(camera, described.camera.location, atol=1e-6)
    assert w2[1] == pytest.approx(0.0, abs=1e-6)
    roles.find(scene, "spot").rotation_euler = (0.0, 0.0, 0.0)  # straight down: it lights no wall
    import bpy

    bpy.context.view_layer.update()
    assert not len(outlines.legs(scene))
    assert not len(outlines.lit_patch(roles.find(scene, "spot")))


def test_sampled_poses_lie_in_their_voxels():
    scene = built("room")
    places = outlines.sampled(scene, Sweep(poses=100, rotation=(15.0, 15.0, 90.0)))
    grid = roles.read_grid(scene)
    assert places.shape == (8 * 9, 3)
    for voxel in range(9):
        lo, hi = grid.bounds(voxel)
        inside = places[voxel::9]
        assert (inside >= lo).all()
        assert (inside <= hi).all()
