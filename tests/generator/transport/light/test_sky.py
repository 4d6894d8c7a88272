"""Ambient light as the engine follows it: against closed forms, a conservation law, and Cycles."""

from dataclasses import replace

import brute_force
import numpy as np
import pytest
import worlds

from generator.blender.engines import renderers, survey
from generator.blender.engines.settings import settled
from generator.blender.scene import blend_file, build, geometry, posing
from generator.blender.scene.clearance import clearance
from generator.blender.scene.description import read_scene
from generator.model import poses
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.settings import Sweep
from generator.sets import bulk_set
from generator.sets import simulated as simulations
from generator.sets.dataset import Dataset
from generator.transport import AmbientLight, Emitters, Mesh, Sphere, Transport
from generator.transport.world import MOST_SURFACES
from generator.transport.world_file import load_world, save_world, world_hash


def under_sky(target, *, albedo=worlds.WALL, half=2.0, room=(), radiance=1.0, **changes):
    """A world with a wall of 2 half x 2 half in the plane y = 0, under a uniform sky."""
    wall = worlds.quad((-half, 0.0, -half), (2.0 * half, 0.0, 0.0), (0.0, 0.0, 2.0 * half), albedo)
    made = worlds.world(target, room=room, **changes)
    return replace(made, ambient=AmbientLight(np.full(3, radiance)), wall=wall)


def ball(radius=0.2, albedo=1.0):
    return Sphere(np.zeros(3), radius, np.full(3, albedo))


def changed(world, position, rotation=(0.0, 0.0, 0.0), **options):
    return Transport(world, accuracy=1e-2).difference(position, rotation, **options)[..., 0]


PLACE = (0.8, 1.1, 0.3)


@pytest.mark.parametrize("radius", [0.2, 0.06, 1e-4])
def test_a_sphere_hides_as_much_of_the_sky_as_its_form_factor_says(radius):
    """From an element of a plane, a sphere wholly above it is seen by (r / d)^2 cos: Howell, catalogue, B-43."""
    world = under_sky(ball(radius), order=1)
    points, weights = worlds.picture_points(world.watched, 3)
    away = np.array(PLACE) - points
    far = np.linalg.norm(away, axis=-1)
    hidden = ((radius / far) ** 2 * away[..., 1] / far) @ weights
    assert worlds.error(changed(world, PLACE), -worlds.WALL * hidden) < 0.01


@pytest.mark.parametrize("order", [*(pytest.param(order, marks=pytest.mark.slow) for order in (1, 2)), 3])
def test_what_no_light_reaches_changes_nothing(order):
    """Behind a closed screen, an object is met by no ray from wall or picture: nothing is the sum of no rays."""
    screen = worlds.quad((-3.0, 0.5, -3.0), (6.0, 0.0, 0.0), (0.0, 0.0, 6.0), 0.0)
    engine = None
    for target in (ball(0.06, 0.5), worlds.sheet(0.1, 0.5)):
        engine = Transport(under_sky(target, order=order, room=(screen,)), accuracy=1e-2, like=engine)
        picture = engine.difference(PLACE, (0.0, 0.0, 0.0))
        assert picture.dtype == np.float64
        assert not picture.any()


@pytest.mark.parametrize("size", [0.1, 0.02])
def test_an_object_out_of_the_pictures_sight_darkens_it_by_its_shade(size):
    """A black sphere that a screen hides from the watched wall takes sky from a white board that the wall sees: the
    form factors of wall and board (quadrature) times that of board and sphere (Howell, B-43)."""
    half, centre = 0.15, np.array([-0.6, 1.5, 0.1])
    normal = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    along, up = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0), np.array([0.0, 0.0, 1.0])
    board = worlds.quad(centre - half * (along + up), 2.0 * half * along, 2.0 * half * up, 1.0)
    screen = worlds.quad((0.3, 0.0, -2.0), (0.0, 0.9, 0.0), (0.0, 0.0, 4.0), 0.0)
    world = under_sky(ball(size, 0.0), order=2, room=(board, screen))
    steps = (np.arange(8) + 0.5) / 4.0 - 1.0
    on_board = centre + half * (np.repeat(steps, 8)[:, None] * along + np.tile(steps, 8)[:, None] * up)
    away = np.array(PLACE) - on_board
    far = np.linalg.norm(away, axis=1)
    shade = (size / far) ** 2 * (away @ normal) / far
    points, weights = worlds.picture_points(world.watched, 2)
    way = on_board - points[..., None, :]
    far = np.linalg.norm(way, axis=-1)
    seen = way[..., 1] * -(way @ normal) / (np.pi * far**4) * (2.0 * half) ** 2 / len(on_board)
    expected = -worlds.WALL * ((seen @ shade) @ weights)
    assert worlds.error(changed(world, PLACE), expected) < 0.05


@pytest.mark.slow
def test_poses_in_the_shade_of_a_corridor():
    """A small sphere in or beside a corridor: from most places no part of the watched wall sees it."""
    grey = preset("corridor", "sphere").with_ambient(0.01)
    grey = replace(
        grey,
        resolution=(8, 8),
        wall=replace(grey.wall, albedo=0.5),
        room=replace(grey.room, albedo=0.5),
        partition=replace(grey.partition, albedo=0.5),
        target=replace(grey.target, size=0.12, albedo=0.5),
        grid=replace(grey.grid, lo=(0.2, 2.0, 0.3), hi=(1.4, 8.5, 2.3)),
    )
    scene = blend_file.new_file()
    build.build(scene, grey)
    engine = Transport(survey.surfel_world(scene), accuracy=1e-2)
    axes = engine._setting.frame.axes
    level, unseen = np.zeros(40), np.zeros(40, dtype=bool)
    for number, spot in enumerate(np.random.default_rng(0).uniform(grey.grid.lo, grey.grid.hi, (40, 3))):
        pose = axes, engine._setting.frame.points(spot)
        unseen[number] = spot[1] > 2.5
        level[number] = abs(engine._change.followed(*pose)["sky"].picture).mean()
    assert unseen.sum() >= 20
    # The corridor's inner corner is walled off, and open only to the sky: nothing that stands there changes anything.
    assert level[unseen].max() == 0.0 < level[~unseen].min()
    assert level[~unseen].max() < engine._followed("sky").mean() / engine._setting.sky[0]


def test_the_background_is_the_whole_sky_less_what_a_floor_hides():
    """Of each pixel, by the form factor of an element and a rectangle at right angles to it, its corner below it."""
    whole = Transport(under_sky(ball(), order=1), accuracy=1e-2).background()
    assert whole.mean() == pytest.approx(worlds.WALL, rel=1e-6)  # the lit patch is out of view
    side = 3.0
    floor = worlds.quad((-side, 0.0, -1.0), (2.0 * side, 0.0, 0.0), (0.0, side, 0.0), 0.0)
    world = under_sky(ball(), order=3, room=(floor,))
    points, weights = worlds.picture_points(world.watched, 3)
    high, far = points[..., 2] + 1.0, np.hypot(points[..., 2] + 1.0, side)

    def share(wide):
        return (np.arctan(wide / high) - high / far * np.arctan(wide / far)) / (2.0 * np.pi)

    hidden = (share(side - points[..., 0]) + share(side + points[..., 0])) @ weights
    background = Transport(world, accuracy=1e-2).background()[..., 0]
    assert worlds.error(background, worlds.WALL * (1.0 - hidden)) < 2e-3


@pytest.mark.parametrize("size", [0.3, 1.2])
def test_a_window_lights_the_wall_as_its_outline_says(size):
    """Lambert's formula: a polygon of radiance 1 sends 1/2 sum over edges of the angle times the cosine of the edge's
    plane. A screen hides none of it from the nearest part of the wall."""
    world, corners = worlds.windowed(size, order=1)
    world = replace(world, room=world.room[:4] + world.room[5:])
    points, weights = worlds.picture_points(world.watched, 2)
    ways = corners - points[..., None, :]
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    ahead = np.roll(ways, -1, axis=-2)
    normal = np.cross(ways, ahead)
    sine = np.linalg.norm(normal, axis=-1)
    light = np.abs((np.arctan2(sine, (ways * ahead).sum(axis=-1)) * normal[..., 1] / sine).sum(axis=-1)) / 2.0
    engine = Transport(world, accuracy=1e-2)
    assert worlds.error(engine.background()[..., 0], worlds.WALL / np.pi * light @ weights) < 0.01


def test_an_object_before_a_window_darkens_the_room():
    """Against paths at random to a surface in the window, as bright as the sky; four standard errors and 1 %."""
    world, corners = worlds.windowed(0.6)
    pose = ((1.1, 1.1, 0.3), (0.0, 0.0, 80.0))
    triangles = corners[[[0, 2, 1], [0, 3, 2]]]  # towards the room
    none = np.zeros((0, 3))
    glow = Emitters(triangles, np.ones((2, 3)), none, none, np.zeros(2))
    mean, error = brute_force.change(replace(world, ambient=None, emitters=glow), *pose, 2000)
    made = Transport(world, accuracy=1e-2).render(*pose).ambient[..., 0].mean() * np.pi / worlds.WALL
    expected, off, level = mean[2].sum(), np.sqrt((error[2] ** 2).sum()), abs(mean[2]).sum()
    assert 4.0 * off < 0.03 * level  # or the test could not fail
    assert abs(made - expected) < 4.0 * off + 0.01 * level


def test_a_white_body_is_as_bright_as_the_sky_it_hides():
    """The white furnace: with nothing else there, nobody sees it."""
    small = {"half": 0.05, "view": worlds.watched(x=(-0.04, 0.04), z=(-0.04, 0.04))}
    hidden = changed(under_sky(ball(), order=1, **small), PLACE)
    both = changed(under_sky(ball(), order=2, **small), PLACE)
    assert abs(both).max() < 0.01 * abs(hidden).max()
    sheet = worlds.sheet(0.4, 1.0)
    hidden = changed(under_sky(sheet, order=1, **small), PLACE, (0.0, 0.0, 40.0))
    both = changed(under_sky(sheet, order=2, **small), PLACE, (0.0, 0.0, 40.0))
    assert abs(both).max() < 0.01 * abs(hidden).max()


def test_what_a_black_body_sends_is_nothing():
    world = under_sky(ball(albedo=0.0))
    assert not changed(world, PLACE, shadows=False).any()
    assert changed(world, PLACE).max() < 0.0


def test_pictures_differences_and_backgrounds_agree():
    world = under_sky(ball(albedo=0.6), room=(worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.7),))
    engine, dark = (Transport(w, accuracy=1e-2) for w in (world, replace(world, ambient=None)))
    rendered = engine.render(PLACE, (0.0, 0.0, 0.0))
    rest = rendered.pixels - engine.background() - rendered.added + rendered.hidden
    np.testing.assert_allclose(rest, rendered.ambient, atol=1e-12)
    lamp = dark.difference(PLACE, (0.0, 0.0, 0.0))
    np.testing.assert_allclose(engine.difference(PLACE, (0.0, 0.0, 0.0)), lamp + rendered.ambient, atol=1e-12)
    np.testing.assert_allclose(engine.pictures([PLACE], [(0.0, 0.0, 0.0)])[0], rendered.pixels, rtol=1e-5)
    np.testing.assert_allclose(engine.background(ambient=False), dark.background(), atol=1e-12)
    other = Transport(replace(world, target=(ball(0.1),)), accuracy=1e-2, like=engine)
    fresh = Transport(replace(world, target=(ball(0.1),)), accuracy=1e-2)
    np.testing.assert_array_equal(*(e.pictures([PLACE], [(0.0, 0.0, 0.0)]) for e in (other, fresh)))


def test_derivatives_of_the_sky_that_a_sphere_hides_are_those_of_its_form_factor():
    """Howell's B-43 again, for a sphere that moves along the wall."""
    radius, step = 0.1, 1e-3
    world = under_sky(ball(radius), order=1)
    points, weights = worlds.picture_points(world.watched, 3)

    def hidden(place):
        away = place - points
        far = np.linalg.norm(away, axis=-1)
        return -worlds.WALL * (((radius / far) ** 2 * away[..., 1] / far) @ weights)

    slopes = Transport(world, accuracy=1e-2).render(PLACE, (0.0, 0.0, 0.0), derivatives=True).derivatives[..., 0]
    for axis in range(3):
        moves = [np.array(PLACE) + sign * step * np.eye(3)[axis] for sign in (1.0, -1.0)]
        expected = (hidden(moves[0]) - hidden(moves[1])) / (2.0 * step)
        assert worlds.error(slopes[axis], expected) < 0.03


@pytest.mark.slow
def test_size_and_brightness_change_nothing_else():
    floor = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.7)
    world = under_sky(ball(albedo=0.6), room=(floor,))
    usual = Transport(world, accuracy=1e-2).render(PLACE, (0.0, 0.0, 0.0)).ambient
    for factor in (1e-3, 1e3):
        bright = replace(worlds.scaled(world, factor), ambient=AmbientLight(np.full(3, 1e20)))
        found = Transport(bright, accuracy=1e-2).render(factor * np.array(PLACE), (0.0, 0.0, 0.0)).ambient
        assert worlds.error(found, 1e20 * usual) < 1e-6, factor


def test_a_world_keeps_its_sky_in_a_file(tmp_path):
    dark = worlds.world(ball())
    for number, world in enumerate((dark, under_sky(ball(), radiance=0.3))):
        save_world(tmp_path / f"{number}.npz", world)
        assert world_hash(load_world(tmp_path / f"{number}.npz")) == world_hash(world)
    assert load_world(tmp_path / "0.npz").ambient is None
    assert load_world(tmp_path / "1.npz").ambient.radiance[0] == 0.3
    for change in ({"radiance": np.array([0.3, np.nan, 0.3])}, {"radiance": np.zeros(2)}):
        save_world(tmp_path / "2.npz", replace(world, ambient=replace(world.ambient, **change)))
        with pytest.raises(NlosError, match="radiance must be"):
            load_world(tmp_path / "2.npz")
    coloured = replace(dark, ambient=AmbientLight(np.array([0.1, 0.2, 0.3])), wall=under_sky(ball()).wall)
    assert (bulk_set.is_grey(dark), bulk_set.is_grey(coloured)) == (True, False)


def test_too_many_surfaces_are_refused():
    floor = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.7)
    moved = np.arange(MOST_SURFACES + 1)[:, None, None, None] * np.array([0.0, 1e-3, 1e-3])
    many = Mesh((floor.triangles + moved).reshape(-1, 3, 3), np.tile(floor.albedo, (len(moved), 1)))
    with pytest.raises(NlosError, match=r"of the sky: .* surfaces are more than"):
        Transport(under_sky(ball(), room=(many,)), accuracy=1e-2)


@pytest.mark.slow
def test_from_the_shell(tmp_path, command):
    """A set under ambient light, by `bulk` and by `sweep`, and what can be known of it."""
    scene, simulated, atlas = tmp_path / "lit.blend", tmp_path / "simulated", tmp_path / "lit.atlas"
    few = ("--target", "sphere", "--set", "resolution=[16,16]", "--ambient", "0.0008")
    assert command("generator", "scene", "room", *few, "-o", scene).returncode == 0
    asked = ("--pictures", "90", "--accuracy", "1e-2")
    assert command("generator", "bulk", scene, "-o", simulated, *asked).returncode == 0
    assert command("classify", "atlas", simulated, "-o", atlas).returncode == 0
    told = command("classify", "bound", atlas, simulated, "--count", "45")
    assert (told.returncode, "right voxel" in told.stdout, "Cramer" in told.stdout) == (0, True, True)
    swept = command("generator", "sweep", scene, "-o", tmp_path / "swept", "--engine", "surfel", "--poses", "1")
    assert swept.returncode == 0, swept.stderr
    one, other = Dataset.open(tmp_path / "swept"), simulations.open_set(simulated)
    assert worlds.error(one.background(), other.background()) < 0.01
    assert worlds.error(one.ambient_background(), other.ambient_background()) < 0.02


@pytest.mark.parametrize("kind", [pytest.param("sphere", marks=pytest.mark.slow), "sheet"])
def test_cycles_sees_the_same(kind):
    """In the preset room under a sky that outshines the lamp; by slope over poses, four standard errors and 5 %."""
    scene = blend_file.new_file()
    build.build(scene, replace(preset("room", kind).with_ambient(1.0), resolution=(12, 12)))
    described = read_scene(scene)
    sweep, _ = settled(scene, described, {"engine": "patch", "poses": 2, "seed": 4})
    planned = poses.plan(described.grid, sweep, geometry.hull(scene), clearance(scene, described, engine="patch"))
    engine = Transport(survey.surfel_world(scene), accuracy=1e-2)
    products = []
    with renderers.opened(scene, "patch", **{**renderers.settings(Sweep()), "resolution": (12, 12)}) as renderer:
        for pose in planned:
            posing.move_target(scene, pose.position, pose.rotation)
            seen, empty = (renderer.render(samples=192, seed=pose.seed, target=there) for there in (True, False))
            expected = engine.difference(pose.position, pose.rotation).mean(axis=2)
            products.append((((seen - empty).mean(axis=2) * expected).mean(), (expected**2).mean()))
    ours, squares = np.array(products).T
    slope = ours.sum() / squares.sum()
    error = np.sqrt(((ours - slope * squares) ** 2).sum()) / squares.sum()
    assert error < 0.1  # or the test could not fail
    assert abs(slope - 1.0) < 4.0 * error + 0.05
    assert engine.background().mean() == pytest.approx(empty.mean(), rel=0.05)
