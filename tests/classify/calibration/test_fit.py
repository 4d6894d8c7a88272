"""The fit against the closed form of a linear model, drawn worlds, and pictures of the engine itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import worlds
from scipy.stats import kstest

from classify.calibration.fit import fit
from classify.calibration.predicted import Placed, Predicted
from classify.pictures.sensor import Sensor
from generator.model.errors import NlosError
from generator.transport import AmbientLight, Mesh, Sphere, Transport
from generator.transport.parameters import with_parameters


class Linear:
    """Pictures that are linear in what is off."""

    def __init__(self, rng, names=3, shape=(2, 8, 9)):
        self.names = tuple(f"v{k}" for k in range(names))
        self.limits = {}
        self.zero, self.parts = rng.normal(size=shape), rng.normal(size=(names, *shape))

    def pictures(self, offsets):
        return self.zero + sum(offsets.get(n, 0.0) * part for n, part in zip(self.names, self.parts, strict=True))

    def bounds(self, name):
        return self.limits.get(name, (-np.inf, np.inf))

    def slopes(self, offsets, deviations):
        return np.stack([self.parts[self.names.index(name)] for name in deviations])


def white(noise):
    return lambda pictures: np.full(pictures.shape, noise**2)


def test_a_linear_model_has_the_posterior_of_its_closed_form():
    rng = np.random.default_rng(1)
    model, noise = Linear(rng), 3.0
    correlation = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, -0.3], [0.0, -0.3, 1.0]])
    before = {"v0": 0.5, "v1": 0.2, "v2": 1.0}
    prior = correlation * np.outer(*2 * [list(before.values())])
    measured = model.zero + noise * rng.normal(size=model.zero.shape)
    found = fit(model, measured, white(noise), before, correlation=correlation)
    design = model.parts.reshape(3, -1).T
    expected = prior - prior @ design.T @ np.linalg.solve(
        design @ prior @ design.T + noise**2 * np.eye(144), design @ prior
    )
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-8, atol=1e-12)
    mean = expected @ design.T @ (measured - model.zero).ravel() / noise**2
    np.testing.assert_allclose(found.offsets, mean, rtol=1e-6)


def test_what_would_be_impossible_is_held_at_its_bound_and_the_rest_is_fitted():
    """With v0 at its bound, the others are those of the closed form in which it is known."""
    rng = np.random.default_rng(4)
    model, before = Linear(rng), {"v0": 1.0, "v1": 1.0, "v2": 1.0}
    measured = model.pictures({"v0": 0.8, "v1": -0.5, "v2": 0.3})
    model.limits = {"v0": (-1.0, 0.4)}
    found = fit(model, measured, white(0.5), before)
    design, left = model.parts[1:].reshape(2, -1).T, (measured - model.pictures({"v0": 0.4})).ravel()
    expected = np.linalg.solve(design.T @ design / 0.25 + np.eye(2), design.T @ left / 0.25)
    assert found.settled
    assert found.value("v0") == 0.4
    np.testing.assert_allclose(found.offsets[1:], expected, rtol=1e-6)


def test_a_white_object_is_fitted_although_no_albedo_is_above_1():
    world = room()
    world = with_parameters(world, {"target.albedo": 0.35})
    off = {"target.albedo": 0.04, "spot.aim.x": 0.03, "room.albedo": -0.2}
    picture = Predicted(with_parameters(world, off), PLACES, accuracy=1e-4).pictures({})
    noise = 1e-3 * picture
    before = {"target.albedo": 0.2, "spot.aim.x": 0.02, "room.albedo": 0.1, "target.size": 0.1}
    found = fit(Predicted(world, PLACES), picture, lambda p: noise**2, before)
    assert found.settled
    assert found.value("spot.aim.x") == pytest.approx(0.03, abs=4.0 * found.deviations[1])
    assert np.abs(found.residuals).max() < 3.0


def test_stated_deviations_and_p_values_are_those_of_repeated_draws():
    """The smoothest model is the hardest: it takes up what the tests for structure look for."""
    rng, noise = np.random.default_rng(2), 1.0
    model = Linear(rng, shape=(2, 16, 16))
    ramp = np.linspace(-1.0, 1.0, 16)
    model.parts = np.stack([np.ones((2, 16, 16)), 0 * model.zero + ramp, 0 * model.zero + ramp[:, None]])
    before = {"v0": 0.3, "v1": 0.01, "v2": 0.3}
    z, p = [], {"p_chi_squared": [], "p_neighbours": [], "p_blocks": []}
    for _ in range(400):
        true = {name: deviation * rng.normal() for name, deviation in before.items()}
        measured = model.pictures(true) + noise * rng.normal(size=model.zero.shape)
        found = fit(model, measured, white(noise), before)
        z += [
            (found.value(name) - value) / d for (name, value), d in zip(true.items(), found.deviations, strict=True)
        ]
        for name, values in p.items():
            values.append(getattr(found.verdict, name))
    assert found.undetermined == ("v1",)
    assert kstest(z, "norm").pvalue > 1e-3
    assert min(kstest(values, "uniform").pvalue for values in p.values()) > 1e-3


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda z: z + 0.3 * np.sin(np.arange(32) / 10.0), "something differs"),
        (lambda z: 1.15 * z, "measure the sensor"),
        (lambda z: 0.85 * z, "measure the sensor"),
        (lambda z: z + 0.5 * np.roll(z, 1, axis=2), "something differs"),
    ],
)
def test_what_is_no_noise_is_told(spoil, words):
    rng = np.random.default_rng(3)
    model = Linear(rng, shape=(2, 32, 32))
    noise = rng.normal(size=model.zero.shape)
    before = dict.fromkeys(model.names, 1.0)
    assert fit(model, model.zero + noise, white(1.0), before).verdict.is_noise
    verdict = fit(model, model.zero + spoil(noise), white(1.0), before).verdict
    assert not verdict.is_noise
    assert words in verdict.words


def room(**changes):
    """A small world with a floor, and a wall that light comes back to."""
    base = worlds.world(Sphere(np.zeros(3), 0.2, np.full(3, 0.6)))
    a, b, c, d = np.array([[-2.0, 0.0, -1.0], [2.0, 0.0, -1.0], [2.0, 3.2, -1.0], [-2.0, 3.2, -1.0]])
    floor = Mesh(np.array([[a, b, c], [a, c, d]]), np.full((2, 3), 0.5))
    e, f, g, h = np.array([[-2.0, 0.0, -1.2], [2.0, 0.0, -1.2], [2.0, 0.0, 2.0], [-2.0, 0.0, 2.0]])
    wall = Mesh(np.array([[e, f, g], [e, g, h]]), np.tile(base.watched.albedo, (2, 1)))
    lit = replace(base.patch, albedo=np.full(3, 0.7))
    watched = replace(base.watched, albedo=np.full(3, 0.7), resolution=(6, 6))
    wall = replace(wall, albedo=np.full((2, 3), 0.7))
    return replace(base, patch=lit, watched=watched, room=(floor,), wall=wall, **changes)


OFF = {
    "spot.location.x": 0.05,
    "spot.aim.x": 0.02,
    "spot.half_angle": 0.1,
    "spot.power": 0.1,
    "camera.view.z": 0.01,
    "wall.albedo": -0.05,
    "room.albedo": 0.07,
    "target.albedo": -0.1,
    "target.size": 0.1,
}
PLACES = [Placed((0.5, 0.9, 0.2)), Placed((0.9, 0.7, 0.0))]


@pytest.mark.parametrize(
    "changes", [{}, pytest.param({"order": 4, "ambient": AmbientLight(np.full(3, 1e-3))}, marks=pytest.mark.slow)]
)
def test_predicted_pictures_are_those_of_the_changed_world(changes):
    world, off = room(**changes), {**OFF, **({"ambient": 0.2} if changes else {})}
    predicted = Predicted(world, PLACES, accuracy=1e-3)
    predicted.pictures({})
    camera = {"level": 0.1, "black": 0.02, "vignetting": 0.2, "place.2.y": 0.03}
    got = predicted.pictures({**off, **camera})
    engine = Transport(with_parameters(world, off), accuracy=1e-3)
    expected = [engine.background(), *(engine.render(p.position, p.rotation).pixels for p in PLACES[:1])]
    expected.append(engine.render((0.9, 0.73, 0.0), (0.0, 0.0, 0.0)).pixels)
    u = (np.arange(6) + 0.5) / 3.0 - 1.0
    shade = 1.1 * (1.0 - 0.2 * (u**2 + u[:, None] ** 2) / 2.0)
    usual = Transport(world, accuracy=1e-3).background().mean()
    np.testing.assert_allclose(got, shade * np.mean(expected, axis=3) + 0.02 * usual, rtol=2e-3)


def test_a_room_is_found_within_what_is_stated_and_the_lamps_place_is_not_determined():
    """Four rooms that are off by draws of what is stated: 4 times 12 values, whose z are of a standard normal."""
    before = {
        "spot.location.x": 0.03,
        "spot.aim.x": 0.02,
        "spot.aim.z": 0.02,
        "spot.power": 0.1,
        "camera.view.x": 0.01,
        "wall.albedo": 0.05,
        "target.albedo": 0.1,
        "target.size": 0.05,
        "camera.location.y": 0.03,
        **{f"place.1.{axis}": 0.01 for axis in "xyz"},
    }
    world, z = room(), []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        off = {name: deviation * rng.normal() for name, deviation in before.items()}
        truth = with_parameters(world, {n: v for n, v in off.items() if not n.startswith("place")})
        engine = Transport(truth, accuracy=1e-4)
        moved = [p + off[f"place.1.{axis}"] for p, axis in zip(PLACES[0].position, "xyz", strict=True)]
        clean = [engine.background(), engine.background() + engine.difference(moved, (0.0, 0.0, 0.0))]
        sensor = Sensor(frames=100).exposed(clean)
        measured = np.stack([sensor.measure(one, rng).mean(axis=2, dtype=float) for one in clean])
        found = fit(
            Predicted(world, PLACES[:1], accuracy=1e-3),
            measured,
            lambda p, sensor=sensor: np.stack([sensor.variance(np.repeat(x[..., None], 3, axis=2)) for x in p]),
            before,
        )
        assert found.verdict.p > 1e-3
        assert {"spot.location.x", "camera.location.y"} <= set(found.undetermined)
        assert found.deviations[1] < 0.01
        z += [(found.value(n) - off[n]) / d for n, d in zip(found.names, found.deviations, strict=True)]
    assert kstest(z, "norm").pvalue > 1e-3
    assert np.abs(z).max() < 4.0


def test_what_cannot_be_fitted_is_said():
    predicted = Predicted(room(), accuracy=1e-2)
    picture = predicted.pictures({})
    for before, words in (
        ({"place.1.x": 0.1}, "nothing that these pictures could tell"),
        ({"wall.albedo": 0.0}, "must be above 0"),
        ({}, "nothing to fit"),
        ({"spot.half_angle": 500.0}, "state a smaller deviation"),
    ):
        with pytest.raises(NlosError, match=words):
            fit(predicted, picture, white(1.0), before)
    with pytest.raises(NlosError, match="have shape"):
        fit(predicted, picture[:, 1:], white(1.0), {"wall.albedo": 0.1})
