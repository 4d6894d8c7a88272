"""Voxels are laid where the object can be: within walls, off all else, hidden from lamp and camera."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from generator.blender import check
from generator.blender.finding import ERROR
from generator.blender.scene import adopt, build, clearance, geometry, roles
from generator.blender.scene.description import read_scene
from generator.model.presets import preset


def room(name: str = "room") -> bpy.types.Scene:
    scene = bpy.context.scene
    for obj in list(scene.objects):
        bpy.data.objects.remove(obj)
    build.build(scene, preset(name))
    return scene


def box(name: str, low: tuple[float, ...], high: tuple[float, ...]) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    mesh.from_pydata(
        corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    )
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def inside(scene: bpy.types.Scene) -> list[str]:
    """Names of what reaches into the voxels, by corners and by points along edges."""
    grid, found = roles.read_grid(scene), []
    for shape in clearance.others(scene, geometry.snapshot(scene)):
        ends = shape.placed[shape.triangles]
        shares = np.linspace(0.0, 1.0, 41)[:, None, None, None]
        points = (ends + shares * (np.roll(ends, 1, axis=1) - ends)).reshape(-1, 3)
        if ((points > grid.lo) & (points < grid.hi)).all(axis=1).any():
            found.append(shape.name)
    return found


@pytest.mark.parametrize("name", ["room", "corridor"])
def test_they_stay_within_the_room_and_hidden(name):
    scene = room(name)
    grid = adopt.fit_grid(scene)
    assert not inside(scene)
    assert not [f for f in check.findings(scene, engine="auto") if f.level == ERROR]
    assert any("hidden from lamp and camera" in f.text for f in check.findings(scene, engine="auto"))
    target = roles.find(scene, "target").matrix_world.translation
    assert all(low < at < high for low, at, high in zip(grid.lo, target, grid.hi, strict=True))
    for sight in clearance.sights(scene, read_scene(scene).spot):
        assert not sight.holds(
            np.array([[x, y, z] for x in _ends(grid, 0) for y in _ends(grid, 1) for z in _ends(grid, 2)])
        )


def _ends(grid, axis):
    return grid.lo[axis], grid.hi[axis]


def test_they_keep_off_what_stands_there():
    scene = room("tabletop")
    x, y, z = roles.find(scene, "target").matrix_world.translation
    before = adopt.fit_grid(scene)
    box("Cupboard", (x + 0.15, y - 0.1, z - 0.1), (x + 0.2, y + 0.1, z + 0.1))
    box("Vase", (x, y + 0.1, z), (x + 0.02, y + 0.12, z + 0.02))  # smaller than the voxels, and within them
    after = adopt.fit_grid(scene)
    assert not inside(scene)
    assert after.hi[0] < x + 0.15 < before.hi[0]
    assert after.lo[0] < before.lo[0]  # what is lost there is won on the other side, as far as there is room


def test_a_target_that_stands_on_its_origin_has_voxels_too():
    scene = room()
    target = roles.find(scene, "target")
    scene.objects["Floor"].location.z += target.location.z - 0.4
    bpy.context.view_layer.update()
    adopt.fit_grid(scene)
    assert not inside(scene)


def test_without_walls_they_are_as_large_as_is_wanted():
    scene = room("tabletop")
    grid = adopt.fit_grid(scene)
    assert grid.shape == (3, 3, 1)
    edge = 1.25 * 2.0 * np.linalg.norm(geometry.hull(scene), axis=1).max()
    assert np.allclose(np.subtract(grid.hi, grid.lo), edge * np.array([3, 3, 1]), atol=2e-3)
