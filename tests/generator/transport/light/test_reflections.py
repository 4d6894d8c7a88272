"""Light of many reflections: against paths followed at random, closed forms, and conservation of light."""

import math
from dataclasses import replace

import brute_force
import numpy as np
import pytest
import worlds
from worlds import HIGH, room

from generator.model.quantities import ALL_ORDERS
from generator.transport import Mesh, Sphere, Transport
from generator.transport.light import cells, change, follow, near, spread, view
from generator.transport.light import lines as light_lines
from generator.transport.light.exchange import _counted, counted_arrays, means_arrays
from generator.transport.light.field import LightField
from generator.transport.prepared import Setting
from generator.transport.rays import Surfaces


def both(world, position, rotation):
    """The engine's mean change after more than three reflections, by the sky, and of the first three of the lamp."""
    engine = Transport(world, accuracy=1e-2)
    rendered = engine.render(position, rotation)
    setting = engine._setting
    lamp = np.pi * setting.factor[0]
    sky = 0.0 if setting.sky is None else rendered.ambient[..., 0].mean() / setting.sky[0]
    exact = (rendered.added - rendered.hidden)[..., 0].mean() / lamp
    return rendered.further[..., 0].mean() / lamp, sky, exact


@pytest.fixture(scope="module")
def five():
    """A room of light of five reflections: what is fixed of it, and its light."""
    setting = Setting(room(order=5))
    return setting, LightField(setting, 5)


POSES = [((0.8, 1.1, 0.3), (0.0, 0.0, 30.0)), ((0.9, 0.4, -0.6), (20.0, 0.0, -40.0))]


@pytest.mark.slow
@pytest.mark.parametrize("pose", POSES)
def test_paths_at_random_say_the_same(pose):
    """Within four standard errors and 1.5 % of the whole change, in a closed room; paths of seven reflections also
    tell what four of them make."""
    mean, error = brute_force.change(room(order=7), *pose, 60000)
    for order in (4, 7):
        further, _, exact = both(room(order=order), *pose)
        level = abs(mean[0, : order + 1]).sum()
        theirs, spread_of_it = mean[0, 4 : order + 1], np.sqrt((error[0, 4 : order + 1] ** 2).sum())
        assert spread_of_it < 0.06 * level  # or the test could not fail
        assert abs(further - theirs.sum()) < 4.0 * spread_of_it + 0.015 * level, order
        assert abs(exact - mean[0, 3]) < 4.0 * error[0, 3] + 0.01 * level, order
        assert abs(theirs).sum() > 10.0 * spread_of_it


@pytest.mark.slow
@pytest.mark.parametrize("pose", POSES)
def test_paths_at_random_say_the_same_under_a_sky(pose):
    """Within four standard errors and 1 % of the change, in a room that is open above."""
    mean, error = brute_force.change(room(order=6, ceiling=False, sky=1.0), *pose, 10000)
    for order in (1, 3, 6):
        further, sky, _ = both(room(order=order, ceiling=False, sky=1.0), *pose)
        for ours, row, first in ((sky, 1, 1), (further, 0, 4)):
            theirs, errors = mean[row, first : order + 1], error[row, first : order + 1]
            level = abs(mean[row, : order + 1]).sum()
            assert abs(ours - theirs.sum()) <= 4.0 * np.sqrt((errors**2).sum()) + 0.01 * level, order


def test_a_wall_alone_sends_the_sky_to_the_target():
    """Without a room, the sky's third reflection is sky, wall, target, wall; against paths at random."""
    world = replace(room(order=3, ceiling=False, sky=1.0), room=())
    pose = ((0.3, 0.5, 0.1), (0.0, 0.0, 0.0))
    mean, error = brute_force.change(world, *pose, 4000)
    _, sky, _ = both(world, *pose)
    level = abs(mean[1]).sum()
    assert mean[1, 3] > 0.1 * level
    assert abs(sky - mean[1, 1:].sum()) < 4.0 * np.sqrt((error[1] ** 2).sum()) + 0.01 * level


@pytest.mark.parametrize("albedo", [0.5, 0.99])
def test_a_closed_room_keeps_its_light(albedo):
    """Each reflection leaves the albedo's share, whatever the shape; all together leave 1 / (1 - albedo)."""
    field = LightField(Setting(room(albedo=albedo, order=ALL_ORDERS, screen=False)), ALL_ORDERS)
    source = field.sources["lamp"]
    area = field.cells.area
    flux = np.array([(level[:-1, 0] * area).sum() for level in source.levels])
    np.testing.assert_allclose(flux[1:] / flux[:-1], albedo, rtol=1e-3)
    total = flux.sum() + (source.rest[:-1, 0] * area).sum()
    assert total / flux[0] == pytest.approx(1.0 / (1.0 - albedo), rel=2e-2 if albedo > 0.9 else 1e-3)


def test_a_target_like_the_room_keeps_its_light_too():
    """In a closed room of one albedo, a target of that albedo neither adds nor takes light."""
    world = room(albedo=0.8, order=5, screen=False, target=worlds.sheet(0.6, 0.8))
    setting = Setting(world)
    field = LightField(setting, 5)
    changes = change.LightChange(setting, field, 1e-2)
    low = np.array([POSES[0][0][0], POSES[0][0][1], 0.35 - HIGH])
    pose = changes._pose(setting.frame.axes, setting.frame.points(low))
    samples = changes._sampled(change._LINES)
    lines = changes._through(samples, pose)
    shade = changes._shade(field.sources["lamp"].beams, samples, pose)
    arriving, taken = shade.lit, shade.taken
    # What falls on the target is missing behind it.
    assert pose.near.there
    np.testing.assert_allclose(pose.near.parted(taken)[0].sum(), -(arriving.T @ changes._area).sum(), rtol=1e-6)
    even = np.full((field.cells.count + 1, light_lines.SETS), 0.3)
    level = pose.near.joined(even, 0.0 * even, 0.0 * even, np.zeros((len(pose.near.owner), light_lines.SETS)))
    as_bright = np.full((changes._count, light_lines.SETS), 0.3)
    added = light_lines.leaving(lines, level, as_bright, 1)
    assert abs(added).max() < 1e-12  # as bright as each other: nothing changes
    received = light_lines.received(lines, level, as_bright, 1)
    np.testing.assert_allclose(received, 0.3 * samples.received, rtol=1e-12)


@pytest.mark.slow
def test_all_reflections_are_the_limit_of_many():
    pose = POSES[0]
    several = [Transport(room(order=order), accuracy=3e-2).difference(*pose) for order in (6, 40, ALL_ORDERS)]
    assert worlds.error(several[0], several[2]) > 0.02
    assert worlds.error(several[1], several[2]) < 0.01


@pytest.mark.slow
def test_the_end_of_a_long_series_is_a_geometric_one():
    """With an albedo of 0.97 in a closed room, a hundredth of the light is left after 150 reflections."""
    several = [Transport(room(albedo=0.97, order=n), accuracy=3e-2).difference(*POSES[0]) for n in (400, ALL_ORDERS)]
    assert worlds.error(several[0], several[1]) < math.hypot(3e-2, 3e-2)


@pytest.mark.parametrize("albedo", [0.5, 0.97])
@pytest.mark.parametrize("order", [pytest.param(400, marks=pytest.mark.slow), ALL_ORDERS])
def test_even_light_in_a_closed_room_is_worth_a_geometric_series(albedo, order):
    """Irradiance 1 everywhere makes rho + rho^2 + ... = rho / (1 - rho) on the wall, and as much on all of it."""
    field = LightField(Setting(room(albedo=albedo, order=order, screen=False)), order, 3e-2)
    light = field.shown(np.ones((field.cells.count, 1)), order)
    expected = field.points.fit @ np.full((len(field.points.places), 1), albedo / (1.0 - albedo))
    np.testing.assert_allclose(light, expected, atol=1e-3 * expected.max())


def test_three_reflections_are_as_they_were():
    pose = POSES[0]
    engines = [Transport(room(order=order), accuracy=1e-3) for order in (3, 4)]
    three, four = (engine.render(*pose) for engine in engines)
    np.testing.assert_array_equal(three.added, four.added)
    np.testing.assert_array_equal(three.hidden, four.hidden)
    assert not three.further.any()
    background = engines[1].background()
    np.testing.assert_allclose(four.pixels - four.further - background, four.added - four.hidden, atol=1e-12)


@pytest.mark.slow
def test_derivatives_are_those_of_the_pictures():
    """Against differences of pictures, relative to the largest of the same kind: shifts, turns."""
    world = room(order=5, ceiling=False, sky=0.02)
    position, rotation = (np.array(part) for part in POSES[0])
    engine = Transport(world, accuracy=2e-2)
    slopes = engine.render(position, rotation, derivatives=True).derivatives
    sizes = np.sqrt((slopes**2).mean(axis=(1, 2, 3)))
    step = 0.08
    for axis in range(3):
        move = step * np.eye(3)[axis]
        found = (engine.difference(position + move, rotation) - engine.difference(position - move, rotation)) / (
            2 * step
        )
        assert np.sqrt(((found - slopes[axis]) ** 2).mean()) < 0.1 * sizes[:3].max()
    turn = np.array([0.0, 0.0, 4.0])
    found = engine.difference(position, rotation + turn) - engine.difference(position, rotation - turn)
    assert np.sqrt(((found / np.radians(8.0) - slopes[5]) ** 2).mean()) < 0.1 * sizes[3:6].max()


@pytest.mark.parametrize("count", [256, 4096])
def test_lines_are_a_net(count):
    """In the first two dimensions, each of the equal boxes of any shape holds as many points (Sobol 1967)."""
    points = spread.sobol(count, 4)
    for k in range(5):
        boxes = np.histogram2d(points[:, 0], points[:, 1], bins=(1 << k, 16 >> k), range=[[0, 1], [0, 1]])[0]
        assert (boxes == count / 16).all()


def test_cells_end_where_another_surface_touches():
    """A screen on a floor leaves light on one side; a cell on both would carry it through."""
    setting = Setting(room(order=4))
    made = cells.Cells(setting.around, 0.4, np.zeros(3), 1.0, np.zeros((0, 1)))
    every = np.arange(made.count)
    ends = [made.places(every, np.tile(end, (made.count, 1)))[0] for end in ((0.0, 0.0), (1.0, 1.0))]
    world = [setting.frame.origin + setting.frame.unit * end @ setting.frame.axes for end in ends]
    low, high = np.minimum(*world), np.maximum(*world)
    behind = low[:, 1] > 0.8 - 1e-6
    across = (low[:, 0] < 0.1 - 1e-6) & (high[:, 0] > 0.1 + 1e-6)
    floor = (abs(low[:, 2] + HIGH) < 1e-6) & (high[:, 2] < -HIGH + 1e-6)
    assert floor.sum() > 20
    assert not (across & behind & floor).any()
    assert made.area.sum() == pytest.approx(2.0 * setting.around.area.sum())


def test_compiled_and_array_forms_agree(five):
    """Blender has no numba: both forms of each sum give the same."""
    rng = np.random.default_rng(0)
    setting, field = five
    changes = change.LightChange(setting, field, 1e-2)
    pose = changes._pose(setting.frame.axes, setting.frame.points(np.array(POSES[1][0])))
    lines = changes._through(changes._sampled(1 << 10), pose)
    assert pose.near.there
    level = rng.random((pose.near.length, light_lines.SETS))
    body = rng.random((changes._count, light_lines.SETS))
    for form, arrays in (
        (light_lines.received, light_lines.received_arrays),
        (light_lines.leaving, light_lines.leaving_arrays),
    ):
        np.testing.assert_allclose(form(lines, level, body, 1), arrays(lines, level, body, 1), rtol=1e-9, atol=1e-12)
    start, way = rng.uniform(-0.5, 0.5, (500, 3)) + np.array([0.0, 0.0, 1.0]), rng.normal(size=(500, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    met = field.cells.meet(start, way)
    which, far = setting.around.first_hit(start, way)
    cell, corners, shares = np.full(500, field.cells.count), np.full((500, 4), field.cells.count), np.zeros((500, 4))
    shares[:, 0] = 1.0
    cells._locate(start, way, which, far, field.cells.grid, cell, corners, shares)
    np.testing.assert_array_equal(met.cell, cell)
    np.testing.assert_allclose(met.of(level), cells._interpolated_arrays(level, corners, shares), rtol=1e-9)
    _, eye = changes._eye(change._FIRST_LINES)
    sums = view.Sums(
        level, np.append(body, np.zeros((1, light_lines.SETS)), axis=0), np.zeros((64, light_lines.SETS))
    )
    light = np.zeros((144, light_lines.SETS))
    view.look(eye, pose, changes._body.grid, field.cells.grid, sums, light)
    np.testing.assert_allclose(
        light, view.look_arrays(eye, pose, changes._body, field.cells, sums), rtol=1e-8, atol=1e-12
    )


def test_light_that_varies_evenly_is_interpolated_exactly_up_to_the_edges(five):
    """Cells that are no whole number of an edge, parts that end where a screen stands, and a room's corners."""
    _, field = five
    rng = np.random.default_rng(3)
    way = rng.normal(size=(2000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    start = np.tile([0.4, 0.0, 0.9], (2000, 1))
    met = field.cells.meet(start, way)
    found = met.cell < field.cells.count
    values = np.append(field.middles @ [1.0, -2.0, 0.5], 0.0)[:, None]
    places = start + met.far[:, None] * way
    np.testing.assert_allclose(met.of(values)[found, 0], places[found] @ [1.0, -2.0, 0.5], atol=1e-12)
    assert found.sum() > 1000


@pytest.mark.parametrize(
    ("position", "rotation"),
    [((0.6, 1.0, 0.3 - HIGH), (0, 0, 30)), ((0.6, 1.0, -HIGH), (90, 0, 0)), ((0.6, 1.0, 0.5 - HIGH), (0, 0, 0))],
    ids=["on its edge", "lying", "above it"],
)
def test_small_cells_cover_what_is_near_and_are_smallest_where_it_touches(position, rotation):
    world = room(albedo=0.8, order=5, screen=False, target=worlds.sheet(0.6, 0.8))
    engine = Transport(world, accuracy=1e-2)
    setting, changes = engine._setting, engine._change
    pose = changes._pose(*engine._placed(position, rotation))
    small = pose.near
    around = setting.around
    for i in np.flatnonzero(small.first >= 0):
        whole = around.area[i] * (small.number[i] * small.step[i]).prod()
        assert small.area[small.owner == i].sum() == pytest.approx(whole, rel=1e-12)
    rng = np.random.default_rng(0)
    way = rng.normal(size=(4000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    start = np.tile(pose.centre + 1e-3 * around.normal[0], (4000, 1))
    hits = changes._field.cells.meet(start, way)
    marked = small.marked(hits, start, way, changes._field.cells)
    some = np.flatnonzero(marked.shares[:, 4] > 0.0)
    assert len(some) > 200
    leaf = marked.corners[some, 4] - 2 * small.rows
    size = np.sqrt(small.area[leaf, 0])
    places = ((start + hits.far[:, None] * way)[some] - pose.place) @ pose.turn
    gap = setting.target.distance(places)
    clear = gap > 1e-6
    # A cell is as large as a third of its distance allows, which may be one size of it more than the place's.
    most = np.maximum(near._FINEST * pose.radius, near._SHARP * (gap + 2.0 * size))
    assert (size[clear] <= 1.5 * most[clear]).all()
    corners, shares = np.zeros(5, dtype=np.int64), np.zeros(5)
    for k in some[:50]:
        surface = changes._field.cells.sides(hits.cell[k : k + 1])[0][0]
        near.mark(start[k], way[k], surface, hits.far[k], around.planes, small, corners, shares)
        assert corners[4] == marked.corners[k, 4]


def test_the_distance_of_points_from_surfaces():
    quad = np.array([[[0, 0, 0], [2, 0, 0], [2, 1, 0]], [[0, 0, 0], [2, 1, 0], [0, 1, 0]]], dtype=float)
    alone = np.array([[[5, 0, 0], [6, 0, 0], [5, 1, 0]]], dtype=float)
    made = Surfaces(np.concatenate([quad, alone]), np.zeros((3, 1)), np.array([[0.0, 0.0, 9.0, 1.0]]))
    assert len(made.origin) == 2
    points = np.array([[1, 0.5, 0.3], [-3, 0.5, 4], [3, 2, 0], [6, 1, 0], [5.2, 0.2, -1], [0, 0, 7], [0, 0, 9.5]])
    expected = [0.3, math.sqrt(34.25) - 1.0, math.sqrt(2.0), math.sqrt(0.5), 1.0, 1.0, 0.0]
    np.testing.assert_allclose(made.distance(points), expected, atol=1e-12)


@pytest.mark.parametrize("largest", [0.05, 0.9, -1.7])
def test_a_fixed_point_is_found_even_where_steps_lead_away_from_it(largest):
    rng = np.random.default_rng(2)
    basis = np.linalg.qr(rng.normal(size=(40, 40)))[0]
    matrix = basis @ np.diag(np.append(largest, rng.uniform(-0.05, 0.05, 39))) @ basis.T
    right = rng.normal(size=(40, 2))
    found = follow.fixed_point(lambda x: matrix @ x + right, np.zeros((40, 2)), np.ones((40, 1)))
    expected = np.linalg.solve(np.eye(40) - matrix, right)
    assert np.abs(found - expected).sum() < 5e-3 * np.abs(expected).sum()
    arguments = found, right, np.abs(right[:, :1])
    for one, other in zip(follow.weighted(*arguments), follow.weighted_arrays(*arguments), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_light_is_exchanged_the_same_in_both_forms(five):
    """Loops and arrays; and what irradiance is worth is what radiosity is worth, but for noise."""
    _, field = five
    exchange, n = field._exchange, field.cells.count
    values = 1.0 + np.random.default_rng(1).random((n, 3))
    np.testing.assert_allclose(exchange.received(values), means_arrays(values, exchange._met), rtol=1e-12)
    smooth = (1.0 + field.middles) * field._is_reached[:, None]
    worth = field.cells.area[:, None] * smooth[:, 1:2]
    one, other = (worth * exchange.received(smooth[:, :1])).sum(), (smooth[:, :1] * exchange.sent(worth)).sum()
    assert one == pytest.approx(other, rel=2e-3)
    lit = np.flatnonzero(field._is_reached & (field.middles[:, 2] < 0.5))
    few = np.zeros((n, 1))
    few[lit] = 1.0
    assert (worth * exchange.spread(few)).sum() == pytest.approx((worth * exchange.received(few)).sum(), rel=2e-3)
    counted = counted_arrays(values[:50], exchange._met[:50], n)
    np.testing.assert_allclose(_counted(values[:50], exchange._met[:50], n), counted, rtol=1e-12)


def test_rays_from_cells_are_the_same_in_both_forms(five):
    """Loops and arrays, from both sides of surfaces."""
    _, field = five
    some, points = np.flatnonzero(field._is_reached)[::97], spread.lattice(16, 4)
    moved = spread.shifts(4, some)
    at = ((points + moved[:, None]) % 1.0).reshape(-1, 4)
    places, normals = field.cells.places(np.repeat(some, 16), at[:, 2:])
    starts, ways = field.cells.fans(some, points, moved)
    np.testing.assert_allclose(starts, places, atol=1e-12)
    np.testing.assert_allclose(ways, spread.hemisphere(normals, at[:, :2]), atol=1e-12)


def test_sides_that_no_light_reaches_take_no_room(five):
    """A room's outer sides share one number, and are black; all other cells are where they were."""
    setting, field = five
    every = cells.Cells(setting.around, 0.035, np.zeros(3), 1.0, np.zeros((0, 1)))
    assert field.cells.count < 0.65 * every.count
    lit = np.zeros(every.count, dtype=bool)
    lit[: every.count // 2] = True
    fewer, old = every.only(lit)
    np.testing.assert_array_equal(fewer.area, every.area[old])
    for found, expected in zip(fewer.extents(), every.extents(), strict=True):
        np.testing.assert_array_equal(found, expected[old])
    rng = np.random.default_rng(3)
    start, way = np.tile([0.6, 0.6, 0.1], (2000, 1)), rng.normal(size=(2000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    few, all_met = fewer.meet(start, way).cell, every.meet(start, way).cell
    kept = lit[all_met[all_met < every.count]]
    assert 0.1 < kept.mean() < 0.9
    met = few[all_met < every.count]
    np.testing.assert_array_equal(old[met[kept]], all_met[all_met < every.count][kept])
    assert not fewer.tint[met[~kept]].any()


def test_a_target_that_no_light_reaches_changes_nothing():
    """A sheet in a closed black box."""
    low, high = np.array([0.4, 0.7, -0.1]), np.array([1.2, 1.5, 0.7])
    x, y, z = np.diag(high - low)
    corners = ((low, x, y), (low, x, z), (low, y, z), (high, -x, -y), (high, -x, -z), (high, -y, -z))
    box = tuple(worlds.quad(*corner, 0.0) for corner in corners)
    world = room(order=5, sky=0.01, ceiling=False)
    made = Transport(replace(world, room=(*world.room, *box)), accuracy=3e-2).render(*POSES[0])
    for part in (made.added, made.hidden, made.further, made.ambient):
        assert not part.any()


def test_cells_near_a_surface_keep_the_light_of_a_target_that_lies_on_it():
    """A sheet of the wall's albedo on the wall changes nothing; its shadow is all behind it, where nobody sees it."""
    world = room(albedo=0.8, order=5, ceiling=False, target=worlds.sheet(0.6, 0.8))
    position, rotation = (0.6, 1.0, -HIGH + 0.01), (90.0, 0.0, 0.0)
    engine = Transport(world, accuracy=1e-2)
    far, on = engine.render((0.6, 1.0, 0.0), rotation), engine.render(position, rotation)
    whole, moved = (part.added - part.hidden + part.further for part in (far, on))
    assert np.abs(moved).mean() < 0.05 * np.abs(whole).mean()


@pytest.mark.slow
def test_coarse_cells_are_enough_for_light_that_has_gone_far(monkeypatch):
    """At a pose that touches the floor, light followed from cell to cell, however far, says the same within 1e-4 of
    the change's parts."""
    engine, pose = Transport(room(order=ALL_ORDERS), accuracy=1e-2), ((0.75, 0.55, -HIGH + 0.302), (0.0, 0.0, 20.0))
    usual = engine.render(*pose)

    def evened(self, radiosity):
        every = np.ones(self.cells.count, dtype=bool)
        found = self.received(radiosity, every)
        for _ in range(60):
            before, found = found, self.received(radiosity + self.tint * found, every)
            if np.abs(found - before).max() < 1e-4 * np.abs(found).max():
                break
        return found

    monkeypatch.setattr(LightField, "evened", evened)
    finer = engine.render(*pose)
    off = np.sqrt(((usual.further - finer.further) ** 2).mean())
    parts = [(part**2).mean() for part in (usual.added - usual.hidden, usual.further)]
    assert off < 1e-4 * np.sqrt(sum(parts))


def ball_of_triangles(radius, cuts, albedo):
    """A ball of 8 * 4^cuts triangles, of the area of the sphere."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    triangles = np.array([[axes[i], axes[1 + j], axes[2 + k]] for i in (0, 3) for j in (0, 3) for k in (0, 3)])
    for _ in range(cuts):
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        ab, bc, ca = (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0
        parts = [np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        triangles = np.concatenate(parts)
        triangles /= np.linalg.norm(triangles, axis=2, keepdims=True)
    area = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    ).sum()
    triangles = triangles * radius * np.sqrt(8.0 * np.pi / area)
    return Mesh(triangles, np.full((len(triangles), 3), albedo))


@pytest.mark.slow
def test_a_fine_mesh_is_followed_by_parts(monkeypatch):
    """A ball of 512 triangles changes what the sphere of its area does, where lines are too many to make noise."""
    monkeypatch.setattr(change, "_LINES", 1 << 17)
    whole, cut = Sphere(np.zeros(3), 0.3, np.full(3, 0.8)), ball_of_triangles(0.3, 3, 0.8)
    one = Transport(room(order=5, target=whole), accuracy=1e-2)
    other = Transport(room(order=5, target=cut), accuracy=1e-2, like=one)
    assert other._change._count < other._change._body.count
    round_one, flat = (engine.render((0.8, 1.1, 0.3), (0.0, 0.0, 0.0)).further for engine in (one, other))
    assert worlds.error(flat, round_one) < 0.03
