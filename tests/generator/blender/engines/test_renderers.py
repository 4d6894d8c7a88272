"""Absolute radiance against closed forms and quadrature; the two engines against each other. No fitted factor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import radiometry

from generator.blender.engines import renderers
from generator.blender.scene import blend_file, build, posing, roles
from generator.model.presets import preset
from generator.model.scene import Spot, Target, Wall

ENGINES = ["path", "patch", "surfel"]
PATH_IS_SLOW = pytest.param("path", marks=pytest.mark.slow)


def render(scene, engine, *, samples, seeds, target=True, pose=None):
    """Independent renders (n, height, width), first channel."""
    blender = blend_file.new_file()
    build.build(blender, scene)
    if pose:
        posing.move_target(blender, *pose)
    with renderers.opened(blender, engine, resolution=scene.resolution) as renderer:
        return np.array(
            [renderer.render(samples=samples, seed=s, target=target)[..., 0] for s in seeds], dtype=np.float64
        )


def assert_same_mean(renders, expected, *, within, sigmas=4.0):
    """The mean picture level equals the expected one, at 4 standard errors, and those are small enough to matter."""
    levels = renders.mean(axis=(1, 2))
    error = levels.std(ddof=1) / np.sqrt(len(levels))
    assert sigmas * error < within * expected, f"too noisy to tell: {error / expected:.2%} of the level"
    assert abs(levels.mean() - expected) < sigmas * error + 1e-3 * expected, (
        f"{levels.mean():.6g} +- {error:.2g} against {expected:.6g}"
    )


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("order", [1, 3])
def test_directly_lit_wall_has_the_inverse_square_radiance(engine, order):
    # The spot covers all that the camera sees, so every pixel has a closed form.
    spot = Spot(location=(-0.4, 0.9, 0.2), aim=(-0.5, 0.0, 0.0), half_angle=44.0, power=100.0)
    wall = Wall(x=(-4.0, 4.0), z=(-4.0, 4.0))
    scene = radiometry.bare_scene(spot=spot, wall=wall, reflection_order=order)
    fine = radiometry.pixel_centres(scene, (160, 160))
    expected = scene.wall.albedo / np.pi * radiometry.spot_irradiance(spot, fine)
    assert expected.min() > 0
    expected = expected.reshape(16, 10, 16, 10).mean(axis=(1, 3))
    picture = render(scene, engine, samples=256, seeds=[0], target=False)[0]
    assert np.abs(picture.mean() / expected.mean() - 1) < 1e-3
    # Rays are spread over the pixel: its noise is the slope across it over the root of the samples.
    assert np.abs(picture / expected - 1).max() < 5e-3


@pytest.mark.slow
def test_soft_edged_spot_keeps_its_falloff_in_the_patch_engine():
    scene = radiometry.bare_scene()
    blender = blend_file.new_file()
    build.build(blender, scene)
    posing.move_target(blender, (0.0, 1.2, 0.0), (0.0, 0.0, 0.0))
    roles.find(blender, "spot").data.spot_blend = 0.6
    levels = {}
    for engine, samples in (("path", 8192), ("patch", 256)):
        with renderers.opened(blender, engine, resolution=(16, 16)) as renderer:
            renders = np.array([renderer.render(samples=samples, seed=s)[..., 0].mean() for s in range(6)])
        levels[engine] = renders.mean(), renders.std(ddof=1) / np.sqrt(len(renders))
    (path, path_error), (patch, patch_error) = levels["path"], levels["patch"]
    error = np.hypot(path_error, patch_error)
    assert 4 * error < 0.08 * path  # a hard edge would give twice as much
    assert abs(path - patch) < 4 * error + 1e-3 * path


@pytest.mark.parametrize("engine", [PATH_IS_SLOW, "patch"])
def test_reflection_orders_switch_on_one_by_one(engine):
    """Wall and floor alone: light on the floor is order 2, back on the wall order 3, there again order 5."""
    room = radiometry.floor_room(-0.6)
    scene = radiometry.bare_scene(room=room)
    samples = {"path": 4096, "patch": 256}[engine]
    levels = {}
    for order in range(1, 6):
        levels[order] = render(
            replace(scene, reflection_order=order), engine, samples=samples, seeds=range(6), target=False
        )
    # The spot lights no pixel that the camera sees, and the wall cannot see itself.
    assert levels[1].max() == 0.0
    assert levels[2].max() < 1e-6 * levels[3].mean()
    elements, area = radiometry.midpoints(2, -0.6, room.x, room.y, 120)
    expected = radiometry.third_order(scene, elements, (0, 0, 1), area, room.albedo).mean()
    assert_same_mean(levels[3], expected, within=0.03)
    # Order 4 would have to leave the floor for the floor: nothing.
    np.testing.assert_allclose(levels[4].mean(), levels[3].mean(), rtol=0.02)
    assert levels[5].mean() > 1.005 * levels[3].mean()


def test_order_two_reaches_what_only_order_two_can():
    """The camera looks at the floor, which the spot lights by way of the wall: one closed sum."""
    scene = radiometry.bare_scene(room=radiometry.floor_room(-0.6), reflection_order=2)
    centre = (0.4, 0.7, -0.6)
    for order in (1, 2):
        blender = blend_file.new_file()
        build.build(blender, replace(scene, reflection_order=order))
        camera = roles.find(blender, "camera")
        camera.location, camera.rotation_euler = (centre[0], centre[1], 0.5), (0.0, 0.0, 0.0)
        camera.data.ortho_scale, camera.data.shift_x, camera.data.shift_y = 0.02, 0.0, 0.0
        with renderers.opened(blender, "patch", resolution=(8, 8)) as renderer:
            got = renderer.render(samples=1024, seed=3, target=False)[..., 0].mean()
        if order == 1:
            assert got == 0.0
    lit, area = radiometry.midpoints(1, 0.0, (-0.2, 1.0), (-0.6, 0.6), 400)
    radiance = scene.wall.albedo / np.pi * radiometry.spot_irradiance(scene.spot, lit)
    irradiance = radiometry.transfer(np.array([centre]), (0, 0, 1), lit, (0, 1, 0), radiance, area)[0]
    np.testing.assert_allclose(got, scene.room.albedo / np.pi * irradiance, rtol=5e-3)


@pytest.mark.parametrize("engine", [PATH_IS_SLOW, "patch", "surfel"])
def test_sheet_gives_the_three_reflection_integral(engine):
    scene = radiometry.bare_scene()
    at = (0.1, 1.1, 0.1)
    elements, area = radiometry.midpoints(1, at[1], (at[0] - 0.2, at[0] + 0.2), (at[2] - 0.2, at[2] + 0.2), 16)
    expected = radiometry.third_order(scene, elements, (0, -1, 0), area, scene.target.albedo, n_patch=480)
    samples = {"path": 16384, "patch": 1024, "surfel": 0}[engine]
    renders = render(scene, engine, samples=samples, seeds=range(8), pose=(at, (0.0, 0.0, 0.0)))
    assert_same_mean(renders, expected.mean(), within=0.04)
    # The picture's shape too: left and right half, each at its own level.
    for half in (np.s_[:, :8], np.s_[:, 8:]):
        assert_same_mean(renders[(slice(None), *half)], expected[half].mean(), within=0.06)


@pytest.mark.parametrize("target", [pytest.param("sheet", marks=pytest.mark.slow), "sphere"])
def test_engines_agree_in_the_room(target):
    """Shadows, partition and room included; a wide spot, because only then does `path` converge."""
    scene = preset("room", target)
    scene = replace(scene, spot=replace(scene.spot, half_angle=6.0), resolution=(16, 16))
    pose = ((1.05, 0.65, 1.3), (0.0, 0.0, 30.0 if target == "sheet" else 0.0))
    levels = {}
    for engine, samples in (("path", 1024), ("patch", 256)):
        levels[engine] = render(scene, engine, samples=samples, seeds=range(8), pose=pose).mean(axis=(1, 2))
    path, patch = levels["path"], levels["patch"]
    error = np.hypot(path.std(ddof=1), patch.std(ddof=1)) / np.sqrt(len(path))
    assert 4 * error < 0.02 * patch.mean(), "too noisy to tell"
    assert abs(path.mean() - patch.mean()) < 4 * error
    surfel = render(scene, "surfel", samples=0, seeds=[0], pose=pose).mean()
    error = patch.std(ddof=1) / np.sqrt(len(patch))
    assert abs(surfel - patch.mean()) < 4 * error + 1e-3 * surfel


def test_mirror_target_is_refused_by_neither_but_lamp_shapes_by_patch():
    from generator.model.errors import NlosError

    blender = blend_file.new_file()
    build.build(blender, radiometry.bare_scene())
    roles.find(blender, "spot").data.shadow_soft_size = 0.1
    with (
        pytest.raises(NlosError, match=r"radius of 0\.1 m.*--engine path"),
        renderers.opened(blender, "patch", resolution=(8, 8)),
    ):
        pass
    with renderers.opened(blender, "path", resolution=(8, 8)):
        pass


def test_white_target_keeps_energy():
    """A sphere of albedo 1 sends back no more than it catches: its picture is linear in albedo."""
    levels = []
    for albedo in (0.5, 1.0):
        scene = radiometry.bare_scene(target=Target(kind="sphere", size=0.3, albedo=albedo))
        levels.append(render(scene, "patch", samples=256, seeds=[1], pose=((0.1, 1.1, 0.1), (0, 0, 0)))[0].mean())
    np.testing.assert_allclose(levels[1] / levels[0], 2.0, rtol=1e-3)
