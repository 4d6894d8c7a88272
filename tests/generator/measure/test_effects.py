"""What may be left out of a scene, and by how much a picture is then wrong."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import worlds

from generator.measure import effects, scene_plan
from generator.model.deadline import Deadline
from generator.transport import Sphere, Transport, left_out
from generator.transport.left_out import PATCH, SHADOW

FLOOR = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.8)
FAR = worlds.quad((5.0, 8.0, -1.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.1), 0.5)
NAMES = ["floor", "far"]


def ball(room=(FLOOR, FAR), **changes):
    return worlds.world(Sphere(np.zeros(3), 0.15, np.ones(3)), room=room, **changes)


def poses(count, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform((0.6, 0.8, -0.75), (1.2, 1.4, -0.55), size=(count, 3)), np.zeros((count, 3))


def variant(whole, names):
    """The world without some of its room."""

    def without(dropped):
        room = tuple(mesh for mesh, name in zip(whole.room, names, strict=True) if name not in dropped)
        return left_out.without(dataclasses.replace(whole, room=room), dropped)

    return without


def measured(world, names, places, turns, **options):
    return effects.measure(
        variant(world, names), effects.parts(world, names), places, turns, rounds=len(places), **options
    )


@pytest.fixture(scope="module")
def plan():
    return measured(ball(), NAMES, *poses(20, 0), tolerance=0.02)


def test_what_matters_is_needed_and_what_does_not_is_left_out(plan):
    found, dropped, together = plan
    shares = {effect.name: effect.share[0] for effect in found}
    assert list(shares) == sorted(shares, key=lambda name: -shares[name])
    assert shares["far"] < 1e-3 < shares["floor"]
    assert "far" in dropped
    assert "floor" not in dropped
    assert together.share[2] <= 0.02


class Ticking:
    """A clock by which a second passes whenever it is looked at."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        self.now += 1.0
        return self.now


def test_an_unlimited_time_changes_nothing(plan):
    found, dropped, _ = measured(ball(), NAMES, *poses(20, 0), tolerance=0.02, deadline=Deadline(1e6))
    assert [(one.name, one.share) for one in found] == [(one.name, one.share) for one in plan[0]]
    assert dropped == plan[1]


@pytest.mark.parametrize("limit", [1.0, 30.0, 60.0, 100.0])
def test_what_there_is_no_time_for_is_kept_and_not_measured(limit):
    """Each pose costs a second here, whatever was predicted for it."""
    clock = Ticking()
    deadline = Deadline(limit, clock)
    found, dropped, together = measured(ball(), NAMES, *poses(20, 0), tolerance=0.02, deadline=deadline)
    names = [one.name for one in found]
    assert set(names) >= {*NAMES, PATCH, SHADOW}
    unknown = {one.name for one in found if np.isnan(one.share[0])}
    assert not unknown & set(dropped)
    assert (len(unknown) == 4) == (limit <= 30.0), "the whole alone takes 20"
    assert clock.now <= limit + 20.0, "it is looked at now and then besides"
    assert limit > 30.0 or np.isnan(together.share[0])


def test_digits_and_pixels_are_told_and_kept(plan):
    """Half floats hold eleven bits of a picture that the object changes little; half the pixels hold nearly all."""
    shares = {effect.name: effect.share[0] for effect in plan[0] if effect.note}
    assert shares["digits beyond float32"] < 1e-4 < shares["digits beyond float16"]
    assert shares["digits beyond float16"] / shares["digits beyond float32"] == pytest.approx(2.0**13, rel=0.5)
    assert shares["pixels beyond 8 x 8"] < shares["pixels beyond 4 x 4"] < 0.1


@pytest.mark.slow
def test_the_error_is_the_one_at_other_poses_too(plan):
    """What was measured on some poses holds on others, within the interval or a factor of 1.5."""
    some = list(zip(*poses(20, 1), strict=True))
    found, all_dropped, together = plan
    engine = Transport(ball(), accuracy=1e-4)
    wholes = [engine.difference(*pose) for pose in some]
    for effect in (*(e for e in found if not e.note), together):
        dropped = all_dropped if effect is together else [effect.name]
        world, shadows = variant(ball(), NAMES)(dropped)
        other, error = Transport(world, accuracy=1e-4), []
        for pose, whole in zip(some, wholes, strict=True):
            less = other.difference(*pose, shadows=shadows)
            error.append(((less - whole) ** 2).mean() / (whole**2).mean())
        low, high = min(effect.share[1], effect.share[0] / 1.5), max(effect.share[2], 1.5 * effect.share[0])
        # Of what is less than the engine's own error nobody knows how much it is.
        assert low - 1e-3 < np.sqrt(np.mean(error)) < high + 1e-3, effect.name


def test_shadow_and_floor_are_what_the_engine_calls_them():
    place, turn = (1.0, 1.0, 0.0), (0.0, 0.0, 0.0)
    made = Transport(ball(), accuracy=1e-4).render(place, turn)
    wanted = np.sqrt((made.hidden**2).mean() / ((made.added - made.hidden) ** 2).mean())
    got, _, _ = measured(ball(), NAMES, np.array([place]), np.array([turn]), accuracy=1e-4)
    assert {e.name: e.share[0] for e in got}[SHADOW] == pytest.approx(wanted, rel=1e-2)


@pytest.mark.parametrize(("radius", "distance"), [(0.02, 1.2), (0.08, 1.2), (0.05, 1.0)])
def test_a_patch_seen_as_a_point_errs_with_the_square_of_its_size(radius, distance):
    """To second order: light falls on a small ball from points spread over a disc in place of its middle.

    Of the irradiance z^2 / (z^2 + r^2)^2 of a point beside a wall, the mean over a disc of radius R differs from its
    middle's by R^2 / 8 times its Laplacian, -8 / z^4: relative, by R^2 / z^2.
    """
    patch = worlds.lit_patch(radius=radius, centre=(0.4, 0.0, 0.1), lamp=(0.4, 40.0, 3.1))
    place = np.array([[0.4, distance, 0.1]])
    world = worlds.world(Sphere(np.zeros(3), 0.01, np.ones(3)), patch=patch)
    found = [effect for effect in measured(world, [], place, np.zeros((1, 3)), accuracy=1e-5)[0] if not effect.note]
    assert [effect.name for effect in found] == [PATCH]
    assert found[0].share[0] == pytest.approx((radius / distance) ** 2, rel=0.25)


def test_a_vague_effect_keeps_no_clear_one_from_being_left_out(monkeypatch):
    """One round of four shows it, so its interval is wide; what is larger, and the same in all, may go."""
    made = {"": np.ones((4, 2, 2)), "clear": np.full((4, 2, 2), 1.004), "vague": np.ones((4, 2, 2))}
    made["vague"][0] = 1.0055
    monkeypatch.setattr(effects, "differences", lambda variant, dropped, *_: (made["".join(dropped)], 1.0))
    monkeypatch.setattr(
        effects, "Transport", lambda *_, **__: SimpleNamespace(background=lambda: np.zeros((2, 2, 3)))
    )
    found, dropped, _ = effects.measure(
        lambda dropped: (None, True), ["vague", "clear"], np.zeros((4, 3)), np.zeros((4, 3)), rounds=4
    )
    shares = {effect.name: effect.share for effect in found}
    assert shares["vague"][0] < shares["clear"][0] < 0.005 < shares["vague"][2]
    assert dropped == ["clear"]


def test_needed_is_what_lies_above_the_tolerance_with_its_whole_interval():
    """The rest is kept too, but nobody knows whether it had to be."""
    shares = {"large": (0.05, 0.03, 0.07), "vague": (0.015, 0.005, 0.03), "unknown": (np.nan, 0.0, np.inf)}
    found = [scene_plan.Effect(name, share) for name, share in {**shares, "small": (0.001, 0.0, 0.002)}.items()]
    plan = scene_plan.Plan(found, ["small"], found[-1], {"engine": "surfel", "accuracy": 1e-3}, 0.01)
    verdicts = {row[0]: row[-1] for row in scene_plan.rows(plan)}
    kept = "kept to be safe"
    assert verdicts == {"large": "needed", "vague": kept, "unknown": kept, "small": "left out"}
