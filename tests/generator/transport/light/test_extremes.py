"""Light of all reflections, a sky and emitters where numbers are extreme."""

from dataclasses import replace

import numpy as np
import pytest
import worlds
from worlds import room

from generator.model.quantities import ALL_ORDERS
from generator.transport import Emitters, Transport

POSE = ((0.8, 1.1, 0.3), (0.0, 0.0, 30.0))


def lit(**options):
    """A room that is open above, with a sky, a panel and a lamp, and all reflections."""
    panel = worlds.quad((1.4, 0.5, -0.3), (0.0, 0.0, 0.6), (0.0, 0.6, 0.0), 0.0).triangles
    glow = Emitters(panel, np.full((2, 3), 0.01), np.array([[0.6, 1.4, 0.9]]), np.full((1, 3), 0.01), np.zeros(3))
    return replace(room(**{"order": ALL_ORDERS, "ceiling": False, "sky": 0.01, **options}), emitters=glow)


@pytest.fixture(scope="module")
def usual():
    return Transport(lit(), accuracy=3e-2).render(*POSE)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_scale_changes_nothing(usual, factor):
    """A scene of millimetres and one of kilometres give the same picture, if lamps are as much stronger."""
    found = Transport(worlds.scaled(lit(), factor), accuracy=3e-2).render(factor * np.array(POSE[0]), POSE[1])
    for name in ("further", "ambient", "emitted"):
        np.testing.assert_allclose(getattr(found, name), getattr(usual, name), rtol=1e-5, atol=1e-10)


@pytest.mark.slow
def test_one_pixel_is_the_mean_of_many(usual):
    """Both err by what was asked for, relative to all parts of the change."""
    found = Transport(lit().seen_by(1, 1), accuracy=3e-2).render(*POSE)
    names = ("further", "ambient", "emitted")
    exact = (usual.added - usual.hidden).mean()
    most = 2.0 * 3e-2 * np.linalg.norm([exact, *(getattr(usual, name).mean() for name in names)])
    for name in names:
        assert getattr(found, name).mean() == pytest.approx(getattr(usual, name).mean(), abs=most)


@pytest.mark.slow
def test_black_surfaces_send_nothing():
    """In a black room, light after the third reflection has met nothing but target and wall: a few per cent."""
    dark = replace(lit(), room=tuple(replace(m, albedo=np.zeros_like(m.albedo)) for m in lit().room))
    engine = Transport(dark, accuracy=3e-2)
    made = engine.render(*POSE)
    assert np.isfinite(made.pixels).all()
    assert abs(made.further).mean() < 0.1 * abs(made.added).mean()
    assert abs(made.emitted).mean() < engine._followed("emitters").mean()


@pytest.mark.slow
def test_a_target_at_the_wall():
    """Black, beside the picture: it hides a little of the light that reaches its part of the wall, and no more."""
    engine = Transport(lit(target=worlds.sheet(0.3, 0.0)), accuracy=3e-2)
    most = 0.05 * (engine._followed("sky") + engine._followed("emitters")).max()
    for height in (1e-6, 1e-2):
        made = engine.render((0.8, height, 0.3), (0.0, 0.0, 0.0))
        assert np.isfinite(made.pixels).all()
        assert abs(made.ambient + made.emitted).max() < most, height
        assert (made.ambient + made.emitted).mean() < 0.0, height


@pytest.mark.slow
@pytest.mark.parametrize("albedo", [0.99, 1.0])
def test_a_room_that_hardly_takes_light(albedo):
    """With a sky above it, light leaves after some reflections, even if all surfaces are white."""
    made = [Transport(lit(albedo=albedo, order=order), accuracy=3e-2).render(*POSE) for order in (60, ALL_ORDERS)]
    for name in ("further", "ambient", "emitted"):
        assert worlds.error(getattr(made[0], name), getattr(made[1], name)) < 0.05
