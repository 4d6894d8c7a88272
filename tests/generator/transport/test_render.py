"""The transport engine against quadrature, closed forms and laws; the extremes that must be sound."""

from __future__ import annotations

import functools
import itertools
from dataclasses import replace

import numpy as np
import pytest
import uncompiled
import worlds
from conftest import ROOT
from scipy.spatial.transform import Rotation

from generator.model.arrays import rotation_matrix
from generator.model.errors import NlosError
from generator.transport import Mesh, Sphere, Transport, fields, kernel, picture

POSES = {
    "1 m, parallel": ((0.3, 1.0, 0.1), (0.0, 0.0, 0.0)),
    "30 cm, turned": ((0.2, 0.45, 0.0), (20.0, -35.0, 50.0)),
    "5 cm": ((0.75, 0.05, 0.1), (0.0, 0.0, 0.0)),
    "edge-on from the lit patch": ((0.4, 0.8, 0.1), (0.0, 0.0, 90.0)),
    "edge-on from the watched patch": ((0.6, 1.0, 0.1), (0.0, 0.0, 45.0)),
    "touches the wall": ((0.75, 0.2, 0.1), (0.0, 0.0, 90.0)),
}


@functools.cache
def quadrature(name):
    """The picture of a sheet at a pose; about ten times as accurate as the tightest accuracy asked for here."""
    scene = worlds.world(worlds.sheet())
    # Quadrature that does not know where the sheet's plane cuts the picture or the lit patch needs many points there.
    fine, cells, n = {"30 cm, turned": (16, 4, 24), "edge-on from the lit patch": (3, 2, 80)}.get(name, (3, 4, 24))
    cells = 24 if POSES[name][0][1] < 0.3 else cells
    light = worlds.patch_points(scene.patch, n=n, turns=2 * n)
    return scene, worlds.sheet_picture(scene, *POSES[name], cells=cells, fine=fine, light=light)


@pytest.mark.parametrize("accuracy", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("name", POSES)
def test_error_is_below_what_was_asked(name, accuracy):
    scene, expected = quadrature(name)
    got = Transport(scene, accuracy=accuracy).render(*POSES[name]).added[..., 0]
    assert worlds.error(got, expected) < accuracy


@pytest.mark.slow
def test_a_fine_mesh_is_the_sphere():
    """An inscribed mesh of 100,000 triangles differs from its sphere by its faceting, some 1e-4 of the area."""
    rings = 160
    t, p = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1), indexing="ij")
    x = 0.2 * np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)
    a, b, c, d = x[:-1, :-1], x[1:, :-1], x[1:, 1:], x[:-1, 1:]
    # Inside out on purpose, and at the poles without area.
    triangles = np.concatenate([np.stack([a, c, b], axis=2), np.stack([a, d, c], axis=2)]).reshape(-1, 3, 3)
    assert len(triangles) > 100_000
    mesh = Mesh(triangles, np.full((len(triangles), 3), 1.0))
    pose = ((0.3, 0.7, 0.1), (0.0, 0.0, 0.0))
    ball = Sphere(np.zeros(3), 0.2, np.ones(3))
    got, expected = (Transport(worlds.world(t), accuracy=1e-3).render(*pose).added for t in (mesh, ball))
    assert worlds.error(got, expected) < 2e-3


@pytest.mark.parametrize(
    "place", [pytest.param((0.3, 0.9, 0.1), marks=pytest.mark.slow), (0.75, 0.25, 0.1), (0.75, 0.2, 0.1)]
)
def test_sphere_equals_its_own_cells_refined(place):
    """At 1e-2 to 1e-4 against 1e-5, and turning a sphere changes nothing; far away, near the wall, touching it."""
    ball = worlds.world(Sphere(np.zeros(3), 0.2, np.ones(3)))
    fine = Transport(ball, accuracy=1e-5).render(place, (0, 0, 0)).added
    for accuracy in (1e-2, 1e-3, 1e-4):
        assert worlds.error(Transport(ball, accuracy=accuracy).render(place, (10, 20, 30)).added, fine) < accuracy


@pytest.mark.parametrize("soft", [0.0, 0.6])
@pytest.mark.parametrize("resolution", [(1, 1), (8, 5), (40, 40)])
@pytest.mark.parametrize("accuracy", [1e-2, 1e-4])
def test_the_patch_in_view_is_all_the_light_of_the_lamps_cone(resolution, soft, accuracy):
    """Lit from straight above: flux is intensity times solid angle, however large the pixels."""
    patch = worlds.lit_patch(lamp=(0.4, 3.0, 0.1))
    patch = replace(patch, cos_width=soft * (1.0 - patch.cos_outer))
    view = worlds.watched(x=(0.1, 0.8), z=(-0.3, 0.5), resolution=resolution)
    got = Transport(worlds.world(worlds.sheet(), patch=patch, view=view), accuracy=accuracy).background()
    # Smoothstep is one half, on the mean.
    angle = 2.0 * np.pi * (1.0 - patch.cos_outer - patch.cos_width / 2.0)
    flux = worlds.WALL / np.pi * patch.intensity[0] * angle
    assert got.mean() * 0.7 * 0.8 == pytest.approx(flux, rel=accuracy / 5.0)


def test_the_patch_in_a_slanted_view():
    """Against polar quadrature of the patch, each point by the share of the picture that it takes."""
    keystone = np.array([[1.0, 0.1, 0.0], [0.05, 0.9, 0.0], [0.4, 0.25, 0.8]])
    view = worlds.watched(x=(0.1, 0.8), z=(-0.3, 0.5), resolution=(9, 7))
    slanted = replace(view, to_wall=view.to_wall @ np.linalg.inv(keystone / keystone.sum(axis=1).max()))
    patch = worlds.lit_patch()
    got = Transport(worlds.world(worlds.sheet(), patch=patch, view=slanted), accuracy=1e-5).background()
    points, light = worlds.patch_points(patch)
    plane = slanted.to_wall[[0, 2, 3]]
    far = 1.0 / (np.linalg.inv(plane) @ np.stack([points[:, 0], points[:, 2], np.ones(len(points))]))[2]
    share = np.abs(far) ** 3 / abs(np.linalg.det(plane))
    assert got.mean() == pytest.approx((light * share).sum(), rel=1e-5)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scale_changes_the_picture_by_an_exact_power(scale):
    scene = worlds.world(worlds.sheet())
    position, rotation = POSES["30 cm, turned"]
    here = Transport(scene, accuracy=1e-3).render(position, rotation).added
    patch = worlds.lit_patch(
        radius=0.08 * scale, centre=(0.4 * scale, 0, 0.1 * scale), lamp=(-1.0 * scale, 3.0 * scale, 3.1 * scale)
    )
    view = worlds.watched(x=(-0.8 * scale, 0.0), z=(-0.3 * scale, 0.5 * scale), eye=(-0.5 * scale, 3 * scale, 0))
    there = worlds.world(worlds.sheet(0.4 * scale), patch=patch, view=view)
    scaled = Transport(there, accuracy=1e-3).render(np.multiply(position, scale), rotation).added
    np.testing.assert_allclose(scaled * scale**2, here, rtol=2e-6)


@pytest.mark.parametrize("power", [0.0, 1e-20, 1e20])
def test_power_enters_linearly(power):
    pose = POSES["1 m, parallel"]
    one = Transport(worlds.world(worlds.sheet(), patch=worlds.lit_patch(power=1.0))).pictures([pose[0]], [pose[1]])
    got = Transport(worlds.world(worlds.sheet(), patch=worlds.lit_patch(power=power))).pictures([pose[0]], [pose[1]])
    assert np.isfinite(got).all()
    np.testing.assert_allclose(got, one.astype(float) * power, rtol=1e-6)


def test_albedo_enters_linearly_and_colours_stay_apart():
    pose = POSES["30 cm, turned"]
    grey = Transport(worlds.world(worlds.sheet(albedo=1.0))).render(*pose).added
    sheet = worlds.sheet()
    coloured = Mesh(sheet.triangles, np.tile([0.25, 0.5, 1.0], (2, 1)))
    got = Transport(worlds.world(coloured)).render(*pose).added
    np.testing.assert_allclose(got, grey * [0.25, 0.5, 1.0], rtol=1e-6)


def test_origin_far_away_and_any_frame_change_nothing():
    scene = worlds.world(worlds.sheet())
    position, rotation = np.array(POSES["30 cm, turned"][0]), POSES["30 cm, turned"][1]
    here = Transport(scene, accuracy=1e-6).render(position, rotation).added
    away = np.array([1000.0, -2000.0, 500.0])
    patch, view = scene.patch, scene.watched
    to_wall = view.to_wall.copy()
    to_wall[:3] += np.outer(away, view.to_wall[3])
    moved = replace(
        scene,
        patch=replace(patch, centre=patch.centre + away, lamp=patch.lamp + away),
        watched=replace(view, to_wall=to_wall, eye=view.eye + np.append(away, 0.0)),
    )
    there = Transport(moved, accuracy=1e-6).render(position + away, rotation).added
    np.testing.assert_allclose(there, here, rtol=1e-9)


def test_light_path_is_reversible():
    """Swap a small lit patch and a small watched patch of the same size: the same radiance arrives (Helmholtz)."""
    one, two, half = np.array([0.4, 0.0, 0.1]), np.array([-0.5, 0.0, -0.2]), 2e-3
    pose = ((0.2, 0.6, 0.0), (15.0, 10.0, 30.0))
    levels = []
    for lit, seen in ((one, two), (two, one)):
        lamp = lit + np.array([20.0, 50.0, 30.0])
        patch = worlds.lit_patch(radius=half, centre=lit, lamp=lamp)
        view = worlds.watched(
            x=(seen[0] - half, seen[0] + half),
            z=(seen[2] - half, seen[2] + half),
            resolution=(1, 1),
            eye=(seen[0] - 30.0, 40.0, 30.0),
        )
        levels.append(Transport(worlds.world(worlds.sheet(), patch=patch, view=view), accuracy=1e-6).render(*pose))
    np.testing.assert_allclose(levels[0].added, levels[1].added, rtol=1e-4)


def test_level_falls_with_the_fourth_power_of_distance():
    """A small sheet, parallel to the wall, in front of both patches: 1 / y^4 as y grows beyond all else."""
    near = worlds.watched(x=(-0.05, 0.05), z=(-0.05, 0.05), resolution=(1, 1), eye=(5.0, 3.0, 0.0))
    patch = worlds.lit_patch(radius=0.01, centre=(0.3, 0, 0), lamp=(0.6, 1.5, 0.0))
    transport = Transport(worlds.world(worlds.sheet(0.1), patch=patch, view=near), accuracy=1e-6)
    levels = [transport.render((0.15, y, 0.0), (0, 0, 0)).added.mean() for y in (20.0, 40.0)]
    assert np.log2(levels[0] / levels[1]) == pytest.approx(4.0, abs=0.01)


def test_energy_is_not_made():
    """Of the light that leaves the patch, a white sheet sends less than all onto a huge wall."""
    view = worlds.watched(x=(-40.0, 40.0), z=(-40.0, 40.0), resolution=(64, 64), eye=(0.0, 1.4, 0.0))
    # From behind the wall, so that the sheet is not in the way of so wide a view.
    view = replace(view, albedo=np.ones(3), eye=np.array([0.0, -30.0, 0.0, 1.0]))
    scene = worlds.world(worlds.sheet(1.0, albedo=1.0), view=view)
    got = Transport(scene, accuracy=1e-3).render((0.8, 0.5, 0.1), (0, 0, 0)).added[..., 0]
    received = np.pi * got.sum() * (80.0 / 64) ** 2
    _, power = worlds.patch_points(scene.patch)
    sent = np.pi * power.sum()
    assert 0.1 * sent < received < sent


@pytest.mark.parametrize("pose", [POSES["1 m, parallel"], ((0.7, 0.6, 0.0), (4.0, -3.0, 10.0))], ids=["1 m", "60 cm"])
def test_derivatives_are_finite_differences(pose):
    transport = Transport(worlds.world(worlds.sheet()), accuracy=1e-8)
    position, rotation = np.array(pose[0]), np.array(pose[1])
    rendered = transport.render(position, rotation, derivatives=True)
    np.testing.assert_allclose(rendered.derivatives[6], rendered.added, rtol=1e-7)

    def moved(k, step):
        if k < 3:
            return transport.render(position + step * np.eye(3)[k], rotation).added
        # Turned about a world axis, after the pose's own rotation: back to Euler angles.
        c, s = np.cos(step), np.sin(step)
        turn = np.eye(3)
        i, j = (k - 3 + 1) % 3, (k - 3 + 2) % 3
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        m = turn @ rotation_matrix(tuple(rotation))
        angles = np.degrees([np.arctan2(m[2, 1], m[2, 2]), np.arcsin(-m[2, 0]), np.arctan2(m[1, 0], m[0, 0])])
        return transport.render(position, angles).added

    for k in range(6):
        h = 2e-2

        def slope(step, k=k):
            return (moved(k, step) - moved(k, -step)) / (2.0 * step)

        # Richardson: the errors of the second and the fourth order cancel.
        a, b, c = slope(h), slope(h / 2), slope(h / 4)
        expected = (64 * c - 20 * b + a) / 45.0
        assert worlds.error(rendered.derivatives[k], expected) < 1e-6, k


@pytest.mark.slow
def test_where_a_sheets_own_plane_meets_the_wall():
    """A kink of the picture and a jump of its derivatives, along a line through the pixels."""
    scene = worlds.world(worlds.sheet(), view=worlds.watched(resolution=(8, 8)))
    transport = Transport(scene, accuracy=1e-7)
    position, rotation = np.array([0.5, 0.6, 0.15]), np.array([8.0, -12.0, 33.0])
    got = transport.render(position, rotation, derivatives=True)
    assert got.report["panels"] < 40
    expected = worlds.sheet_picture(scene, position, rotation, fine=40)
    assert worlds.error(got.added[..., 0], expected) < 1e-4
    for k in range(3):
        there, back = (transport.render(position + step * np.eye(3)[k], rotation).added for step in (1e-4, -1e-4))
        assert worlds.error(got.derivatives[k], (there - back) / 2e-4) < 1e-4
    for k in range(3):
        turns = (
            Rotation.from_rotvec(step * np.eye(3)[k]) * Rotation.from_euler("xyz", rotation, degrees=True)
            for step in (1e-4, -1e-4)
        )
        there, back = (transport.render(position, turn.as_euler("xyz", degrees=True)).added for turn in turns)
        assert worlds.error(got.derivatives[3 + k], (there - back) / 2e-4) < 1e-4


def test_one_pixel_is_the_mean_of_many():
    pose = POSES["30 cm, turned"]
    levels = [
        Transport(worlds.world(worlds.sheet(), view=worlds.watched(resolution=(n, n))), accuracy=1e-5).render(*pose)
        for n in (1, 64)
    ]
    assert levels[0].added.mean() == pytest.approx(levels[1].added.mean(), rel=1e-5)


@pytest.mark.parametrize(
    ("position", "rotation", "words"),
    [
        ((0.75, 0.1, 0.1), (0, 0, 90), "reaches through the relay wall"),
        ((0.75, 0.0, 0.1), (0, 0, 0), "lies in the relay wall"),
        ((0.26, 0.3, 0.4), (0, 0, 0), "stands in the spot's cone"),
        ((-0.4, 0.5, 0.1), (0, 0, 0), "between the camera and the relay wall"),
        ((-0.5, 0.2, 0.1), (0, 0, 90), "between the camera and the relay wall"),
        ((np.nan, 0.5, 0.1), (0, 0, 0), "not finite"),
    ],
)
def test_impossible_poses_are_refused(position, rotation, words):
    transport = Transport(worlds.world(worlds.sheet()))
    with pytest.raises(NlosError, match=words):
        transport.render(position, rotation)


def test_accuracy_out_of_reach_is_refused():
    with pytest.raises(NlosError, match=r"accuracy: 1e-12 must lie between 1e-08 and 0\.3"):
        Transport(worlds.world(worlds.sheet()), accuracy=1e-12)


SCREEN = worlds.quad((0.2, 0.3, -2.0), (0.0, 2.0, 0.0), (0.0, 0.0, 4.0), 0.0)
"""A black screen in the plane x = 0.2, from 0.3 m before the wall."""


def behind_screen(start, end):
    """Whether pairs of points see each other past SCREEN."""
    t = (0.2 - start[:, 0]) / (end[:, 0] - start[:, 0])
    y = start[:, 1] + t * (end[:, 1] - start[:, 1])
    return ~((t > 0) & (t < 1) & (y > 0.3))


def test_target_in_the_screens_shadow_adds_nothing():
    scene = worlds.world(worlds.sheet(0.2), room=[SCREEN])
    got = Transport(scene).render((0.0, 1.8, -1.6), (0, 0, 0))
    assert not got.added.any()
    assert not got.hidden.any()


def test_target_half_behind_the_screen():
    """Against quadrature with the screen tested pair by pair, good to about 2e-3 here."""
    scene = worlds.world(worlds.sheet(), room=[SCREEN], view=worlds.watched(resolution=(8, 8)))
    pose = ((0.75, 0.7, 0.1), (0.0, 0.0, 20.0))
    expected = worlds.sheet_picture(scene, *pose, cells=20, n=4, fine=10, seen=behind_screen)
    free = worlds.sheet_picture(scene, *pose, fine=2)
    assert 0.05 * free.mean() < expected.mean() < 0.95 * free.mean()
    got = Transport(scene, accuracy=2e-3).render(*pose)
    assert got.report["visibility"] == "polygons"
    assert worlds.error(got.added[..., 0], expected) < 5e-3


def test_shadow_on_a_panel_behind():
    """A panel behind the sheet: panel alone, minus panel seen past the sheet, by brute force on both legs."""
    panel = worlds.quad((-1.5, 1.5, -1.5), (3.5, 0.0, 0.0), (0.0, 0.0, 3.0), 0.8)
    scene = worlds.world(worlds.sheet(), room=[panel], view=worlds.watched(resolution=(4, 4)))
    place, half = np.array([0.15, 0.9, 0.1]), 0.2

    def past_sheet(start, end):
        t = (place[1] - start[:, 1]) / (end[:, 1] - start[:, 1])
        at = start + t[:, None] * (end - start)
        return ~((t > 0) & (t < 1) & (np.abs(at[:, 0] - place[0]) < half) & (np.abs(at[:, 2] - place[2]) < half))

    n = 240
    # One random point in each cell: a regular grid would be biased by edges that run along it.
    u, v = (np.stack(np.meshgrid(np.arange(n), np.arange(n))) + np.random.default_rng(0).uniform(size=(2, n, n))) / n
    points = np.stack([u.ravel() * 3.5 - 1.5, np.full(n * n, 1.5), v.ravel() * 3.0 - 1.5], axis=1)
    area = 3.5 * 3.0 / n**2
    light, power = worlds.patch_points(scene.patch, n=3, turns=8)
    bare, past = np.zeros(n * n), np.zeros(n * n)
    for spot, share in zip(light, power, strict=True):
        way = points - spot
        term = share * way[:, 1] ** 2 / (way**2).sum(axis=1) ** 2
        bare += term
        past += term * past_sheet(np.broadcast_to(spot, points.shape), points)
    wall, weights = worlds.picture_points(scene.watched, 2)
    expected, background = [], []
    for spot in wall.reshape(-1, 3):
        way = points - spot
        term = way[:, 1] ** 2 / (way**2).sum(axis=1) ** 2 * area
        background.append((term * bare).sum())
        expected.append((term * (bare - past * past_sheet(np.broadcast_to(spot, points.shape), points))).sum())
    factor = 0.8 / np.pi * 0.8 / np.pi
    expected = factor * np.reshape(expected, wall.shape[:3]) @ weights
    background = factor * np.reshape(background, wall.shape[:3]) @ weights
    transport = Transport(scene, accuracy=2e-3)
    assert worlds.error(transport.background()[..., 0], background) < 2e-3
    got = transport.render(place, (0, 0, 0))
    assert 0.01 * background.mean() < expected.mean() < background.mean()
    # The random points' own error, from other seeds: 0.1 % of the shadow.
    assert worlds.error(got.hidden[..., 0], expected) < 4e-3


def test_folded_sheet_hides_itself():
    """A V whose one side is dark to the patch and partly hidden: both its sides, one at a time, by brute force."""
    a, b, c, d = (0.0, 0.0, -0.2), (0.0, 0.0, 0.2), (0.3, -0.3, 0.2), (0.3, -0.3, -0.2)
    left = [(-x, y, z) for x, y, z in (c, d)]
    fold = Mesh(
        np.array([[a, b, c], [a, c, d], [a, b, left[0]], [a, left[0], left[1]]], dtype=float), np.full((4, 3), 0.9)
    )
    few = Transport(worlds.world(fold), accuracy=2e-3)
    # Halved again and again the same surface is more than a handful, and goes to Embree.
    triangles = fold.triangles
    for _ in range(3):
        p, q, r = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        pq, qr, rp = (p + q) / 2, (q + r) / 2, (r + p) / 2
        triangles = np.concatenate(
            [np.stack(t, axis=1) for t in ((p, pq, rp), (pq, q, qr), (rp, qr, r), (pq, qr, rp))]
        )
    many = Transport(worlds.world(Mesh(triangles, np.full((len(triangles), 3), 0.9))), accuracy=2e-3)
    pose = ((0.75, 0.7, 0.1), (0.0, 0.0, 25.0))
    one, two = few.render(*pose), many.render(*pose)
    open_sides = sum(
        Transport(worlds.world(Mesh(fold.triangles[part], np.full((2, 3), 0.9)))).render(*pose).added
        for part in (slice(0, 2), slice(2, 4))
    )
    assert one.added.mean() < 0.99 * open_sides.mean(), "it hides nothing of itself"
    assert worlds.error(one.added, two.added) < 1e-2


def test_loops_and_arrays_are_one_kernel():
    rng = np.random.default_rng(0)
    for dtype, tolerance in ((np.float32, 2e-5), (np.float64, 1e-12)):
        for count in (0, 1, 6, 7):
            a, b = rng.uniform(-1, 1, (2, 20)).astype(dtype)
            elements = rng.uniform(0.2, 1.0, (6, 9)).astype(dtype)
            elements[5] *= -1
            loops, arrays = np.zeros(20, dtype), np.zeros(20, dtype)
            kernel._radiance_loops(a, b, elements, count, 0.0, loops)
            kernel._radiance_arrays(a, b, elements, count, 0.0, arrays)
            np.testing.assert_allclose(loops, arrays, rtol=tolerance)
            compiled = np.zeros(20, dtype)
            kernel.radiance(a, b, elements, count, 0.0, compiled)
            np.testing.assert_allclose(compiled, arrays, rtol=tolerance)
    x, n, nodes = np.array([0.1, 0.2, 0.5]), np.array([0.6, 0.0, -0.8]), rng.uniform(0, 1, (3, 10))
    assert kernel._irradiance_loops(x, n, nodes, 9) == pytest.approx(kernel._irradiance_arrays(x, n, nodes, 9))


WITHOUT_NUMBA = """
import numpy as np, worlds
from generator.transport import Transport
panel = worlds.quad((-1.5, 1.5, -1.5), (3.5, 0.0, 0.0), (0.0, 0.0, 3.0), 0.8)
scene = worlds.world(worlds.sheet(), room=[panel], view=worlds.watched(resolution=(4, 4)))
made = Transport(scene, accuracy=1e-2).render((0.15, 0.9, 0.1), (0.0, 0.0, 10.0))
np.savez({out!r}, added=made.added, hidden=made.hidden)
"""


def test_without_a_compiler_the_picture_is_the_same(tmp_path):
    out = str(tmp_path / "plain.npz")
    uncompiled.run(WITHOUT_NUMBA.format(out=out), ROOT, ROOT / "tests" / "support")
    panel = worlds.quad((-1.5, 1.5, -1.5), (3.5, 0.0, 0.0), (0.0, 0.0, 3.0), 0.8)
    scene = worlds.world(worlds.sheet(), room=[panel], view=worlds.watched(resolution=(4, 4)))
    here = Transport(scene, accuracy=1e-2).render((0.15, 0.9, 0.1), (0.0, 0.0, 10.0))
    there = np.load(out)
    np.testing.assert_allclose(there["added"], here.added, rtol=1e-5)
    # Shadows are refined in another way there: each to the accuracy that was asked.
    assert worlds.error(there["hidden"], here.hidden) < 2e-2


def test_pictures_do_not_depend_on_the_batch_or_the_threads():
    scene = worlds.world(worlds.sheet(), view=worlds.watched(resolution=(8, 8)))
    rng = np.random.default_rng(3)
    places, turns = rng.uniform((0.6, 0.5, -0.3), (1.2, 1.4, 0.5), (7, 3)), rng.uniform(-20, 20, (7, 3))
    together = Transport(scene, threads=2).pictures(places, turns)
    apart = [Transport(scene, threads=1).pictures([p], [t])[0] for p, t in zip(places, turns, strict=True)]
    np.testing.assert_array_equal(together, apart)


def test_panels_share_all_of_their_light_among_pixels():
    rule = picture.Rule(5)
    rng = np.random.default_rng(1)
    values = rng.uniform(size=(1, 1, len(rule.places)))
    for box in ((0.0, 1.0, 0.0, 1.0), (0.25, 0.5, 0.5, 0.75), (1 / 3, 0.4, 0.1, 0.9)):
        out = np.zeros((1, 1, 7, 9))
        everywhere = np.array([[0.0, 0.0, 1.0]])
        picture.deposit(out, np.array([0]), np.array([box]), rule.coefficients(values), everywhere)
        area = (box[1] - box[0]) * (box[3] - box[2])
        assert out.mean() == pytest.approx(area * float(values[0, 0, :25] @ rule.weights), rel=1e-12)


def test_a_part_counts_on_one_side_of_its_line_only():
    rule, fine = picture.Rule(6), 400
    width, height = 5, 4
    box, line = np.array([0.1, 0.85, 0.05, 0.9]), np.array([0.7, -0.6, -0.13])

    def light(u, v):
        return 1.0 + u**3 * v**2 - 2.0 * u * v**4

    places = box[0::2] + rule.places * (box[1::2] - box[0::2])
    held = rule.coefficients(light(*places.T)[None, None])
    out = np.zeros((1, 1, height, width))
    picture.deposit(out, np.array([0]), box[None], held, line[None])
    u, v = np.meshgrid(
        (np.arange(width * fine) + 0.5) / (width * fine), (np.arange(height * fine) + 0.5) / (height * fine)
    )
    inside = (u > box[0]) & (u < box[1]) & (v > box[2]) & (v < box[3]) & (u * line[0] + v * line[1] + line[2] > 0.0)
    expected = (light(u, v) * inside).reshape(height, fine, width, fine).mean(axis=(1, 3))
    np.testing.assert_allclose(out[0, 0], expected, atol=3.0 / fine)
    # All of it together is known to far more digits: both sides are the whole.
    both = np.zeros((1, 1, height, width))
    for side in (line, -line):
        picture.deposit(both, np.array([0]), box[None], held, side[None])
    whole = np.zeros((1, 1, height, width))
    picture.deposit(whole, np.array([0]), box[None], held, np.array([[0.0, 0.0, 1.0]]))
    np.testing.assert_allclose(both, whole, rtol=1e-12, atol=1e-15)


def closed_room(albedo=0.8):
    """Floor, ceiling, back and sides of a room behind the wall y = 0, and a screen that stands in it."""
    x, y, z = (-1.2, 2.0), 1.6, (-1.0, 1.2)
    wide, deep, tall = (x[1] - x[0], 0, 0), (0, y, 0), (0, 0, z[1] - z[0])
    low, right = (x[0], 0, z[0]), (x[1], 0, z[0])
    made = [quad_of(low, wide, deep), quad_of((x[0], 0, z[1]), wide, deep), quad_of((x[0], y, z[0]), wide, tall)]
    made += [quad_of(low, deep, tall), quad_of(right, deep, tall), quad_of((0.2, 0.9, z[0]), (0, y - 0.9, 0), tall)]
    return [worlds.quad(*sides, albedo) for sides in made]


def quad_of(*sides):
    return sides


TARGETS = {
    "sheet": worlds.sheet(),
    "ball": Sphere(np.array([0.02, 0.0, -0.03]), 0.2, np.full(3, 0.9)),
    "wedge": Mesh(
        np.concatenate(
            [worlds.sheet().triangles, worlds.quad((0.2, 0, -0.2), (0, -0.3, 0), (0, 0, 0.4), 1).triangles]
        ),
        np.full((4, 3), 0.9),
    ),
}
IN_THE_ROOM = ((0.9, 0.7, 0.1), (8.0, -5.0, 20.0))


@pytest.mark.parametrize("name", TARGETS)
def test_polygons_and_rays_are_one_shadow(name, monkeypatch):
    scene = worlds.world(TARGETS[name], room=closed_room(), view=worlds.watched(resolution=(8, 8)))
    cut, traced = Transport(scene, accuracy=1e-3), Transport(scene, accuracy=1e-2)
    traced._fields.few = False
    one, two = cut.render(*IN_THE_ROOM), traced.render(*IN_THE_ROOM)
    background = cut.background()
    monkeypatch.setattr(fields, "_CUT_ROOM", 0)
    assert 0.0 < worlds.error(traced.background(), background) < 1e-2
    assert 0.1 * one.added.mean() < one.hidden.mean()
    level = np.sqrt(max((one.added**2).mean(), (one.hidden**2).mean()))
    for a, b in ((one.added, two.added), (one.hidden, two.hidden)):
        assert np.sqrt(((a - b) ** 2).mean()) < 1e-2 * level


@pytest.mark.parametrize("name", TARGETS)
def test_shadows_to_the_accuracy_that_is_asked(name):
    """Ten times finer polygons, rules and panels: what they agree in is not theirs to choose."""
    scene = worlds.world(TARGETS[name], room=closed_room())
    fine = Transport(scene, accuracy=2e-5).render(*IN_THE_ROOM)
    level = np.sqrt(max((fine.added**2).mean(), (fine.hidden**2).mean()))
    for accuracy in (1e-2, 1e-3, 2e-4):
        got = Transport(scene, accuracy=accuracy).render(*IN_THE_ROOM)
        wrong = (got.added - got.hidden) - (fine.added - fine.hidden)
        assert np.sqrt((wrong**2).mean()) < accuracy * level


@pytest.mark.parametrize("name", ["sheet", "ball"])
def test_derivatives_of_shadows_are_finite_differences(name):
    """On a piece of wall so small that nothing on it has to be drawn; a ball's outline is a polygon that turns."""
    view = worlds.watched(x=(-0.4, -0.4 + 1e-3), z=(0.1, 0.1 + 1e-3), resolution=(1, 1))
    scene, accuracy = worlds.world(TARGETS[name], room=closed_room(), view=view), 1e-6 if name == "sheet" else 1e-5
    transport, finer = Transport(scene, accuracy=accuracy), Transport(scene, accuracy=accuracy / 4.0)
    position, rotation = np.array(IN_THE_ROOM[0]), np.array(IN_THE_ROOM[1])
    got = transport.render(position, rotation, derivatives=True)

    def hidden(k, step):
        if k < 3:
            return finer.render(position + step * np.eye(3)[k], rotation).pixels.mean()
        return finer.render(position, rotation + np.degrees(step) * np.eye(3)[2]).pixels.mean()

    for k in (0, 1, 2, 5):
        a, b = ((hidden(k, step) - hidden(k, -step)) / (2.0 * step) for step in (2e-3, 1e-3))
        expected = (4.0 * b - a) / 3.0
        scale = np.abs(got.derivatives[:6].mean(axis=(1, 2, 3))).max()
        assert got.derivatives[k].mean() == pytest.approx(
            expected, abs=(1e-6 if name == "sheet" else 1e-4) * scale
        ), k


def isometry(scene, matrix):
    """A whole world turned or mirrored, its target included."""
    mesh = scene.target[0]
    four = np.eye(4)
    four[:3, :3] = matrix
    return replace(
        scene,
        patch=replace(
            scene.patch,
            **{k: matrix @ getattr(scene.patch, k) for k in ("centre", "major", "minor", "normal", "lamp", "axis")},
        ),
        watched=replace(
            scene.watched,
            to_wall=four @ scene.watched.to_wall,
            eye=four @ scene.watched.eye,
            normal=matrix @ scene.watched.normal,
        ),
        target=(replace(mesh, triangles=mesh.triangles @ matrix.T),),
        room=tuple(replace(m, triangles=m.triangles @ matrix.T) for m in scene.room),
    )


@pytest.mark.parametrize(
    "matrix", [np.diag([-1.0, 1.0, 1.0]), rotation_matrix((20.0, -130.0, 70.0))], ids=["mirrored", "turned"]
)
def test_mirrored_and_turned_worlds_look_the_same(matrix):
    turned = replace(TARGETS["sheet"], triangles=TARGETS["sheet"].triangles @ rotation_matrix(IN_THE_ROOM[1]).T)
    scene = worlds.world(turned, room=closed_room())
    here, there = Transport(scene, accuracy=1e-4), Transport(isometry(scene, matrix), accuracy=1e-4)
    position = np.array(IN_THE_ROOM[0])
    one, two = here.render(position, (0, 0, 0)), there.render(matrix @ position, (0, 0, 0))
    for name in ("pixels", "added", "hidden"):
        np.testing.assert_allclose(getattr(two, name), getattr(one, name), rtol=1e-5)


@pytest.mark.parametrize("name", TARGETS)
def test_light_path_through_a_room_is_reversible(name):
    """Swap a small lit patch and a small watched patch, with a target, its shadows and a screen between them."""
    one, two, half = np.array([0.5, 0.0, 0.1]), np.array([-0.3, 0.0, -0.2]), 2e-3
    levels = []
    for lit, seen in ((one, two), (two, one)):
        patch = worlds.lit_patch(radius=half, centre=lit, lamp=lit + np.array([-0.3, 1.5, 0.9]))
        span = {"x": (seen[0] - half, seen[0] + half), "z": (seen[2] - half, seen[2] + half)}
        view = worlds.watched(**span, resolution=(1, 1), eye=(seen[0] - 0.4, 1.5, 0.9))
        scene = worlds.world(TARGETS[name], room=closed_room(), patch=patch, view=view)
        _, power = worlds.patch_points(scene.patch)
        got = Transport(scene, accuracy=1e-4).render(*IN_THE_ROOM)
        levels.append(np.array([got.pixels.mean(), got.added.mean(), got.hidden.mean()]) / power.sum())
    np.testing.assert_allclose(levels[0], levels[1], rtol=5e-4)


@pytest.mark.parametrize("deep", [0.25, 1.6])
def test_a_closed_white_room_returns_no_more_than_it_gets(deep):
    """All of the relay wall of a closed room is watched; what it receives is no more than what left the patch."""
    x, z = (-1.0, 1.0), (-1.0, 1.0)
    wide, tall, into = (2.0, 0, 0), (0, 0, 2.0), (0, deep, 0)
    corner = (x[0], 0, z[0])
    sides = [(corner, wide, into), ((x[0], 0, z[1]), wide, into), (corner, into, tall), ((x[1], 0, z[0]), into, tall)]
    room = [worlds.quad(*side, 1.0) for side in [*sides, ((x[0], deep, z[0]), wide, tall)]]
    view = worlds.watched(x=x, z=z, resolution=(24, 24))
    # From a camera so close to the wall that nothing can stand in its view.
    view = replace(view, albedo=np.ones(3), eye=np.array([0.0, 1e-3, 0.0, 0.0]))
    patch = worlds.lit_patch(centre=(-0.6, 0.0, 0.1), lamp=(-0.9, 1.0, 0.1))
    scene = worlds.world(worlds.sheet(0.3, albedo=1.0), room=room, view=view, patch=patch)
    transport = Transport(scene, accuracy=1e-3)
    direct = Transport(replace(scene, order=1)).background()
    got = transport.render((0.4, deep / 2.0, 0.1), (0, 0, 0))
    _, power = worlds.patch_points(scene.patch)
    received = [np.pi * (p - direct)[..., 0].sum() * (2.0 / 24) ** 2 for p in (transport.background(), got.pixels)]
    share = np.array(received) / (np.pi * power.sum())
    # The shallow room's back is nearly all that patch and wall see.
    assert (share < 1.0).all()
    assert (share > (0.75 if deep < 1.0 else 0.1)).all()


def test_the_background_does_not_depend_on_the_target():
    """A target of many faces once had the background traced by rays: minutes in place of milliseconds."""
    panel = worlds.quad((-1.5, 1.5, -1.5), (3.5, 0.0, 0.0), (0.0, 0.0, 3.0), 0.8)
    edges = np.linspace(-0.2, 0.2, 151)
    bent = np.array([[(x, 0.0, -0.2), (y, 0.0, -0.2), (y, 0.0, 0.2)] for x, y in itertools.pairwise(edges)])
    bent[..., 1] = 0.3 * bent[..., 0] ** 2  # so that no two are of one plane
    many = Mesh(bent, np.full((len(bent), 3), 0.9))
    view = worlds.watched(resolution=(4, 4))
    backgrounds = [
        Transport(worlds.world(target, room=[panel], view=view), accuracy=1e-2).background()
        for target in (worlds.sheet(), many)
    ]
    np.testing.assert_array_equal(*backgrounds)
    assert backgrounds[0].min() > 0.0
