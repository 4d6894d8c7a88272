"""Lamps besides the spot, and surfaces that glow: against closed forms, conservation of light, paths at random."""

from dataclasses import replace

import brute_force
import numpy as np
import pytest
import worlds
from worlds import HIGH, WIDE, room

from generator.model.errors import NlosError
from generator.model.quantities import ALL_ORDERS
from generator.sets import bulk_set
from generator.transport import Emitters, Sphere, Transport
from generator.transport.light import change, view
from generator.transport.light.field import LightField
from generator.transport.prepared import Setting
from generator.transport.world_file import load_world, save_world, world_hash

DARK = np.zeros(3)


def emitters(*, panels=(), radiance=1.0, lamps=(), intensity=1.0, softness=0.0):
    """Panels (corner, first edge, second edge) that shine along the product of their edges, and lamps."""
    triangles = [worlds.quad(*panel, 0.0).triangles for panel in panels]
    corners = np.concatenate([np.zeros((0, 3, 3)), *triangles])
    places = np.array(lamps, float).reshape(-1, 3)
    colours = [np.full((len(part), 3), value) for part, value in ((corners, radiance), (places, intensity))]
    return Emitters(corners, colours[0], places, colours[1], np.full(len(corners) + len(places), softness))


def lit_by(glow, **options):
    return replace(room(**options), emitters=glow)


CEILING = ((0.8, 0.7, HIGH - 0.02), (0.0, 0.6, 0.0), (0.6, 0.0, 0.0))
"""A panel under the ceiling that shines down."""
SIDE = ((WIDE - 0.1, 0.5, -0.3), (0.0, 0.0, 0.6), (0.0, 0.6, 0.0))
"""A panel before the side wall, whose light goes past the target to the picture."""
LAMP, BESIDE = (0.6, 1.4, 0.9), (WIDE - 0.2, 0.8, 0.0)
POSE, BETWEEN = ((0.8, 1.1, 0.3), (0.0, 0.0, 30.0)), ((0.7, 0.5, 0.0), (0.0, 0.0, 60.0))


def test_a_lamp_before_a_wall_follows_the_inverse_square():
    """Lambert's cosine law; with a soft falloff, 1 / (d^2 + r^2)."""
    for softness in (0.0, 0.5):
        world = replace(lit_by(emitters(lamps=[LAMP], softness=softness), order=1), room=())
        points, weights = worlds.picture_points(world.watched, 3)
        way = np.array(LAMP) - points
        squared = (way**2).sum(axis=-1)
        expected = 0.8 / np.pi * (way[..., 1] / np.sqrt(squared) / (squared + softness**2)) @ weights
        engine = Transport(world, accuracy=1e-2)
        assert worlds.error(engine._followed("emitters")[..., 0], expected) < 2e-3


def meets_ball(points, way, middle, radius):
    """Whether lines from points (..., 3) along ways (..., 3) come nearer to a place (3,) than a radius."""
    nearest = ((middle - points) * way).sum(axis=-1) / (way**2).sum(axis=-1)
    return np.linalg.norm(points + nearest[..., None] * way - middle, axis=-1) < radius


def test_a_sphere_casts_the_shadow_that_geometry_says():
    """A pixel is dark as far as its points see the lamp behind the sphere."""
    lamp, middle, radius = np.array([0.9, 1.0, 0.4]), np.array([0.4, 0.5, 0.2]), 0.15
    target = Sphere(np.zeros(3), radius, DARK)
    world = replace(lit_by(emitters(lamps=[lamp]), order=1, target=target), room=())
    points, weights = worlds.picture_points(world.watched, 12)
    way = lamp - points
    dark = meets_ball(points, way, middle, radius)
    light = 0.8 / np.pi * way[..., 1] / np.linalg.norm(way, axis=-1) ** 3
    shadow = (dark * light) @ weights
    assert 0.02 < (shadow > 0.0).mean() < 0.9  # its edge is in the picture
    made = Transport(world, accuracy=1e-2).render(middle, DARK)
    assert worlds.error(made.emitted[..., 0], -shadow) < 0.03
    np.testing.assert_allclose(made.pixels, Transport(world).background() + made.emitted, atol=1e-12)


def test_a_shadow_in_a_corner_of_the_picture_is_as_deep_as_geometry_says():
    """A ball hides part of a panel from a few pixels; points of wall and panel, each with each, tell how much."""
    corner, first, second = (np.array(part) for part in SIDE)
    normal = np.cross(first, second)
    radius = 0.06
    world = replace(lit_by(emitters(panels=[SIDE]), order=1, target=Sphere(np.zeros(3), radius, DARK)), room=())
    points, weights = worlds.picture_points(world.watched, 8)
    middle = 0.75 * (points[0, 0].mean(axis=0) + np.array([-0.12, 0.0, 0.08])) + 0.25 * (
        corner + (first + second) / 2.0
    )
    x, w = np.polynomial.legendre.leggauss(48)
    x, w = (x + 1.0) / 2.0, w / 2.0
    shadow = np.zeros(points.shape[:2])
    for along, one in zip(x, w, strict=True):
        for across, other in zip(x, w, strict=True):
            way = corner + along * first + across * second - points
            dark = meets_ball(points, way, middle, radius)
            light = way[..., 1] * np.maximum(0.0, -way @ normal) / np.linalg.norm(way, axis=-1) ** 4
            shadow += one * other * (dark * light) @ weights
    shadow *= 0.8 / np.pi
    assert 0.01 < (shadow > 0.0).mean() < 0.5
    made = Transport(world, accuracy=1e-2).render(middle, DARK).emitted[..., 0]
    assert worlds.error(made, -shadow) < 0.02


@pytest.mark.parametrize("name", [pytest.param("panel", marks=pytest.mark.slow), "lamp"])
def test_a_closed_room_receives_what_is_sent(name):
    """pi L A of a Lambertian panel, 4 pi I of a lamp."""
    glow = emitters(panels=[CEILING]) if name == "panel" else emitters(lamps=[LAMP])
    setting = Setting(lit_by(glow, albedo=0.8, order=2, screen=False))
    field = LightField(setting, 2)
    sent = np.pi * 0.36 if name == "panel" else 4.0 * np.pi
    received = (field.sources["emitters"].levels[0][:-1, 0] * field.cells.area).sum() / 0.8
    assert received * setting.frame.unit**2 * setting.emission.colour[0] * np.pi / 0.8 == pytest.approx(
        sent, rel=2e-2
    )


PLACES = {
    "panel": (emitters(panels=[CEILING]), POSE, 40000),
    "lamp": (emitters(lamps=[LAMP]), POSE, 40000),
    "panel behind the target": (emitters(panels=[SIDE]), BETWEEN, 10000),
    "lamp behind the target, near a wall": (emitters(lamps=[BESIDE]), BETWEEN, 20000),
}
"""Emitters, pose, and number of paths: of emitters behind the target, fewer tell the change to 2 %."""


@pytest.mark.slow
@pytest.mark.parametrize("name", PLACES)
def test_paths_at_random_say_the_same(name):
    """Within four standard errors and 1.5 % of the change, up to one reflection, three and eight.

    A path of eight reflections also tells what fewer of them make.
    """
    glow, pose, count = PLACES[name]
    longest = lit_by(glow, order=8)
    changes, errors = brute_force.change(longest, *pose, count)
    runs = brute_force.backgrounds(longest, 10000)[:, 2]
    for order in (1, 3, 8):
        mean, spread = changes[2, : order + 1], errors[2, : order + 1]
        engine = Transport(replace(longest, order=order), accuracy=1e-2)
        unit = engine._setting.emission.colour[0]
        level, off = abs(mean).sum(), 4.0 * np.sqrt((spread**2).sum())
        assert off <= 0.2 * level
        found = engine.render(*pose).emitted[..., 0].mean() / unit
        assert abs(found - mean.sum()) <= off + 0.015 * level, order
        empty = runs[:, : order + 1].sum(axis=1)
        lit = engine._followed("emitters")[..., 0].mean() / unit
        error = empty.std() / empty.mean() / np.sqrt(len(empty) - 1.0)
        assert abs(lit / empty.mean() - 1.0) < 4.0 * error + 0.01, order


@pytest.mark.slow
def test_colours_add_up():
    """Two emitters of two colours are the sum of each alone; the albedos are grey."""
    red, blue = np.array([1.0, 0.2, 0.0]), np.array([0.0, 0.5, 2.0])
    panel, lamp = emitters(panels=[CEILING]), emitters(lamps=[LAMP])
    panel = replace(panel, radiance=np.tile(red, (2, 1)))
    lamp = replace(lamp, intensity=blue[None])
    joined = replace(panel, places=lamp.places, intensity=lamp.intensity, softness=np.zeros(3))
    engines = [Transport(lit_by(glow, order=4), accuracy=1e-2) for glow in (panel, lamp, joined)]
    one, other, both = (engine.background() for engine in engines)
    dark = Transport(room(order=4)).background()
    np.testing.assert_allclose(both, one + other - dark, rtol=1e-3)  # a lamp has cells made smaller near it
    one, other, both = (engine.render(*POSE).emitted for engine in engines)
    assert worlds.error(both, one + other) < 0.03


@pytest.mark.slow
def test_all_reflections_and_derivatives_of_emitters():
    world = lit_by(emitters(panels=[SIDE]), order=ALL_ORDERS)
    made = Transport(world, accuracy=3e-2).render(*BETWEEN, derivatives=False)
    assert (
        worlds.error(made.emitted, Transport(replace(world, order=40), accuracy=3e-2).render(*BETWEEN).emitted) < 0.01
    )
    free = replace(lit_by(emitters(panels=[SIDE]), order=2), room=())
    engine = Transport(free, accuracy=1e-2)
    position, step = np.array(BETWEEN[0]), 0.1  # which smooths the shadow's edge as the engine's own step does
    slopes = engine.render(*BETWEEN, derivatives=True).derivatives
    moves = [engine.render(position + sign * step * np.eye(3)[1], BETWEEN[1]).pixels for sign in (1.0, -1.0)]
    assert worlds.error(slopes[1], (moves[0] - moves[1]) / (2.0 * step)) < 0.1


@pytest.mark.slow
def test_points_of_the_target_and_lines_to_it_show_the_same():
    """Two ways to see a target from the wall: over its surface, in both forms, and into the cone around it."""
    field = LightField(Setting(room(order=5)), 5)
    for target in (worlds.sheet(0.6, 0.9), Sphere(np.zeros(3), 0.3, np.full(3, 0.5))):
        setting = Setting(room(order=5, target=target))
        changes = change.LightChange(setting, field, 1e-2)
        pose = changes._pose(setting.frame.axes, setting.frame.points(np.array(POSE[0])))
        smooth = np.append(1.0 + np.repeat(field.middles[:, :1], 4, axis=1), np.ones((1, 4)), axis=0)
        small = np.full((len(pose.near.owner), 4), 0.1)
        sums = view.Sums(
            pose.near.joined(smooth, np.zeros_like(smooth), np.zeros_like(smooth), small),
            np.full((len(changes._part), 4), 3.0),
            np.zeros((64, 4)),
        )
        points, eye = changes._eye(3)
        cuts = changes._cuts(pose)
        over = changes._looked_at(eye, pose, sums, cuts)
        arrays = view.look_at_arrays(eye.places, pose, changes._skin(cuts), setting.target, field.cells, sums)
        np.testing.assert_allclose(over, arrays, rtol=1e-8, atol=1e-12)
        lines = points.fit @ changes._looked(eye, pose, sums)
        assert worlds.error(points.fit @ over, lines) < 0.06  # of single places; and of the whole picture:
        np.testing.assert_allclose((points.fit @ over)[0], lines[0], rtol=1e-2)


def test_a_lamp_inside_the_target_is_refused():
    target = Sphere(np.zeros(3), 0.3, np.full(3, 0.5))
    engine = Transport(lit_by(emitters(lamps=[LAMP]), order=2, target=target), accuracy=3e-2)
    with pytest.raises(NlosError, match=r"pose \(0.6, 1.3, 0.9\): the target may enclose a lamp"):
        engine.difference((LAMP[0], LAMP[1] - 0.1, LAMP[2]), DARK)
    assert engine.difference((LAMP[0], LAMP[1] - 0.4, LAMP[2]), DARK).any()


def test_emitters_are_kept_in_files(tmp_path):
    world = lit_by(emitters(panels=[CEILING], lamps=[LAMP]), order=2)
    save_world(tmp_path / "world.npz", world)
    kept = load_world(tmp_path / "world.npz")
    np.testing.assert_array_equal(kept.emitters.triangles, world.emitters.triangles)
    assert world_hash(kept) == world_hash(world) != world_hash(replace(world, emitters=None))
    assert bulk_set.is_grey(world)
    coloured = replace(world.emitters, intensity=np.array([[1.0, 0.5, 0.0]]))
    assert not bulk_set.is_grey(replace(world, emitters=coloured))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"radiance": np.full((2, 3), -1.0)}, "must not be negative"),
        ({"radiance": np.ones((1, 3))}, "must have shape"),
        ({"places": np.full((1, 3), np.nan)}, "must be finite"),
        ({"radiance": np.zeros((2, 3)), "intensity": np.zeros((1, 3))}, "give no light"),
    ],
)
def test_emitters_that_cannot_be_are_refused(changes, words):
    with pytest.raises(NlosError, match=words):
        replace(emitters(panels=[CEILING], lamps=[LAMP]), **changes)
