"""A glossy target: pictures against sums that share no code with the engine, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import glossy
import numpy as np
import pytest
import uncompiled
import worlds

from generator.model.errors import NlosError
from generator.transport import AmbientLight, Gloss, Mesh, Sphere, Transport, facets, gloss
from generator.transport.world_file import load_world, save_world, world_hash

ROOT = Path(__file__).parents[3]
POSE = ((0.75, 0.9, 0.1), (0.0, 0.0, -5.0))


def slow(case):
    return pytest.param(case, marks=pytest.mark.slow)


def shiny(body, roughness, *, tint=0.8, albedo=0.0, multiple=0.0):
    """A body of one gloss."""
    n = len(body.triangles) if isinstance(body, Mesh) else 1
    rows = Gloss(np.full((n, 3), tint), np.full(n, roughness), np.full((n, 3), multiple))
    return replace(body, albedo=np.full_like(body.albedo, albedo), gloss=rows)


def ball(radius=0.2):
    return Sphere(np.zeros(3), radius, np.ones(3))


def small(pixels=8):
    return worlds.watched(resolution=(pixels, pixels))


@pytest.mark.parametrize("roughness", [0.3, slow(0.5), slow(1.0)])
def test_sheet_against_a_sum_over_its_points(roughness):
    scene = worlds.world(shiny(worlds.sheet(), roughness), view=small(4))
    points = glossy.sheet_points(*POSE, n=24)
    expected = glossy.picture(scene, points, roughness, two_sided=True, tint=0.8, fine=2)
    got = Transport(scene, accuracy=1e-4).render(*POSE)
    assert worlds.error(got.added[..., 0], expected) < 1e-3
    assert worlds.error(Transport(scene, accuracy=1e-2).render(*POSE).added[..., 0], expected) < 1e-2


@pytest.mark.parametrize("roughness", [0.4, slow(0.8)])
def test_sphere_against_a_sum_over_its_points(roughness):
    scene = worlds.world(shiny(ball(), roughness), view=small(4))
    expected = glossy.picture(
        scene, glossy.sphere_points(POSE[0], 0.2, n=40), roughness, two_sided=False, tint=0.8, fine=2
    )
    for accuracy in (1e-3, 1e-2):
        assert worlds.error(Transport(scene, accuracy=accuracy).render(*POSE).added[..., 0], expected) < accuracy


def test_light_that_further_facets_send_on():
    """As Cycles has it, by the cosine of the way to the wall."""
    roughness = 0.8
    again = facets.multiple((0.9, 0.9, 0.9), roughness)[0]

    def factor(cosine):
        share = facets.albedo(roughness**2, np.maximum(cosine, 1e-6))
        return 1.0 + again * (1.0 / share - 1.0)

    scene = worlds.world(shiny(worlds.sheet(), roughness, tint=0.9, multiple=again), view=small(4))
    pose = ((0.75, 0.9, 0.1), (10.0, 0.0, -40.0))
    points = glossy.sheet_points(*pose, n=12)
    expected = glossy.picture(scene, points, roughness, two_sided=True, tint=0.9, factor=factor, fine=2)
    once = glossy.picture(scene, points, roughness, two_sided=True, tint=0.9, fine=2)
    assert expected.mean() > 1.1 * once.mean()
    assert worlds.error(Transport(scene, accuracy=1e-3).render(*pose).added[..., 0], expected) < 1e-3


def test_diffuse_and_glossy_light_add_up():
    views = {"view": small()}
    both = Transport(worlds.world(shiny(worlds.sheet(), 0.5, tint=0.3, albedo=0.6), **views)).render(*POSE)
    plain = Transport(worlds.world(worlds.sheet(albedo=0.6), **views)).render(*POSE)
    shine = Transport(worlds.world(shiny(worlds.sheet(), 0.5, tint=0.3), **views)).render(*POSE)
    np.testing.assert_allclose(both.added, plain.added + shine.added, rtol=1e-6)


def test_colours_and_materials_of_parts():
    """Two sheets side by side, one glossy and tinted: their light adds up, channel by channel."""
    left, right = (worlds.quad((x, 0.0, -0.2), (0.2, 0.0, 0.0), (0.0, 0.0, 0.4), 0.5) for x in (-0.25, 0.05))
    tint = np.array([0.9, 0.5, 0.1])
    shine = Gloss(np.tile(tint, (2, 1)), np.full(2, 0.6), np.zeros((2, 3)))
    left = replace(left, albedo=np.zeros((2, 3)), gloss=shine)
    black = Gloss(np.zeros((2, 3)), np.zeros(2), np.zeros((2, 3)))
    joined = Mesh(
        np.concatenate([left.triangles, right.triangles]),
        np.concatenate([left.albedo, right.albedo]),
        Gloss(*(np.concatenate([getattr(g, k) for g in (shine, black)]) for k in ("tint", "roughness", "multiple"))),
    )
    one, two, both = (
        Transport(worlds.world(body, view=small())).render(*POSE).added for body in (left, right, joined)
    )
    np.testing.assert_allclose(one / one[..., :1], np.broadcast_to(tint / tint[0], one.shape))
    assert worlds.error(both, one + two) < 1e-3


@pytest.mark.parametrize("body", ["sheet", slow("ball")])
def test_behind_a_screen(body):
    """Shadows on both legs, by brute force over pairs."""
    screen = worlds.quad((0.05, 0.5, -0.4), (0.35, 0.0, 0.0), (0.0, 0.0, 0.5), 0.0)
    made = {"sheet": worlds.sheet(), "ball": ball()}[body]
    scene = worlds.world(shiny(made, 0.6), room=[screen], view=small(2))

    def beside(start, end):
        t = (0.5 - start[:, 1]) / (end[:, 1] - start[:, 1])
        at = start + t[:, None] * (end - start)
        return ~((at[:, 0] > 0.05) & (at[:, 0] < 0.4) & (at[:, 2] > -0.4) & (at[:, 2] < 0.1))

    points = glossy.sheet_points(*POSE, n=24) if body == "sheet" else glossy.sphere_points(POSE[0], 0.2, n=60)
    settings = {"two_sided": body == "sheet", "tint": 0.8, "lamps": (5, 10), "fine": 4}
    expected = glossy.picture(scene, points, 0.6, seen=beside, **settings)
    free = glossy.picture(scene, points, 0.6, **settings | {"fine": 2})
    assert 0.05 * free.mean() < expected.mean() < 0.95 * free.mean()
    got = Transport(scene, accuracy=5e-3).render(*POSE)
    assert got.report["visibility"] == "rays"
    assert worlds.error(got.added[..., 0], expected) < 2e-2


def test_horizon_through_the_picture():
    pose = ((0.75, 0.9, 0.1), (0.0, 0.0, 40.0))
    scene = worlds.world(shiny(worlds.sheet(), 0.5), view=small(4))
    points = glossy.sheet_points(*pose, n=10)
    expected = glossy.picture(scene, points, 0.5, two_sided=True, tint=0.8, lamps=(5, 10), fine=10)
    sides = np.sign((worlds.picture_points(scene.watched, 1)[0].reshape(-1, 3) - pose[0]) @ points[1][0])
    assert abs(sides.sum()) < len(sides), "the sheet's plane does not cross the picture"
    assert worlds.error(Transport(scene, accuracy=1e-3).render(*pose).added[..., 0], expected) < 2e-3


def test_what_it_hides_does_not_depend_on_its_gloss():
    room = [worlds.quad((-1.5, 1.5, -1.5), (3.5, 0.0, 0.0), (0.0, 0.0, 3.0), 0.8)]
    shone, plain = (
        Transport(worlds.world(body, room=room, view=small()), accuracy=1e-2).render(*POSE)
        for body in (shiny(worlds.sheet(), 0.5), worlds.sheet())
    )
    assert worlds.error(shone.hidden, plain.hidden) < 1e-2


@pytest.mark.parametrize("beyond", [False, True])
def test_sums_for_the_compiler_and_for_numpy_are_the_same(beyond):
    rng = np.random.default_rng(1)
    wall = rng.uniform(-1.0, 1.0, (2, 9))
    normal = np.array([0.1, -0.3, -1.0])
    element = np.array([0.2, -0.1, 1.3, *(normal / np.linalg.norm(normal)), 0.02])
    nodes = np.stack([rng.uniform(-0.3, 0.3, 5), rng.uniform(-0.3, 0.3, 5), rng.uniform(0.5, 1.0, 5)])
    lamps = np.zeros((6, 5))
    count = gloss.receive(element[:3], element[3:6], nodes, 5, 0.09, lamps)
    totals = []
    for form in (gloss._sent_loops, gloss._sent_arrays):
        ways, total = np.empty((6, 9)), np.empty(9)
        form(wall, element, lamps, count, gloss.Look(0.09, beyond), ways, total)
        totals.append(total)
    assert count == 5
    assert totals[0].any()
    np.testing.assert_allclose(totals[0], totals[1], rtol=1e-12)
    one = gloss.pair(0.3, 0.5, 0.7, 0.2), facets.pairs(*np.array([[0.3], [0.5], [0.7], [0.2]]))[0]
    assert one[0] == pytest.approx(one[1])


def test_files_keep_it(tmp_path):
    plain = worlds.world(worlds.sheet())
    scene = worlds.world(shiny(worlds.sheet(), 0.5, multiple=0.3))
    balls = replace(scene, target=(*scene.target, shiny(ball(), 0.6)))
    for k, world in enumerate((scene, balls)):
        save_world(tmp_path / f"{k}.npz", world)
        again = load_world(tmp_path / f"{k}.npz")
        assert world_hash(again) == world_hash(world) != world_hash(plain)
        assert again.is_glossy
    np.testing.assert_array_equal(again.target[1].gloss.roughness, [0.6])


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: Transport(worlds.world(shiny(ball(), 0.1))), r"roughness of 0\.1, below 0\.2"),
        (lambda: Transport(worlds.world(shiny(ball(), 0.5), order=4, wall=worlds.sheet(4.0))), "three reflections"),
        (
            lambda: Transport(
                worlds.world(shiny(ball(), 0.5), ambient=AmbientLight(np.ones(3)), wall=worlds.sheet(4.0))
            ),
            "a sky or other lamps, make it diffuse",
        ),
        (lambda: Transport(worlds.world(ball(), room=[shiny(worlds.sheet(), 0.5)])), "only the target may be glossy"),
        (lambda: Transport(worlds.world(shiny(ball(), 0.5))).render(*POSE, derivatives=True), "derivatives"),
        (lambda: shiny(ball(), 1.5), "roughness must lie between 0 and 1"),
        (lambda: replace(worlds.sheet(), gloss=shiny(ball(), 0.5).gloss), "gloss must have 2 rows, not 1"),
        (lambda: Gloss(np.ones((2, 3)), np.ones(1), np.ones((1, 3))), r"must have shapes \(n, 3\), \(n,\)"),
    ],
)
def test_refusals(made, words):
    with pytest.raises(NlosError, match=words):
        made()


WITHOUT_NUMBA = """
import numpy as np
from test_gloss import for_the_twin
np.savez({out!r}, *for_the_twin())
"""


def for_the_twin():
    """What a small glossy sheet adds, with nothing in the way and behind a screen."""
    made = []
    for room in ([], [worlds.quad((0.05, 0.5, -0.4), (0.35, 0.0, 0.0), (0.0, 0.0, 0.5), 0.0)]):
        scene = worlds.world(shiny(worlds.sheet(0.1), 0.7, multiple=0.5), room=room, view=small(2))
        made.append(Transport(scene, accuracy=0.1).difference(*POSE, shadows=False))
    return made


def test_without_a_compiler_the_picture_is_the_same(tmp_path):
    out = tmp_path / "plain.npz"
    uncompiled.run(WITHOUT_NUMBA.format(out=str(out)), ROOT, ROOT / "tests" / "support", Path(__file__).parent)
    (free, behind), (free_there, behind_there) = for_the_twin(), np.load(out).values()
    np.testing.assert_allclose(free_there, free, rtol=1e-9)
    assert worlds.error(behind_there, behind) < 0.1
