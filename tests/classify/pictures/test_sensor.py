"""The sensor against the statistics that its standard states."""

from __future__ import annotations

import numpy as np
import pytest
from classify_helpers import make_dataset
from scipy import stats

from classify.pictures.sensor import Camera, Sensor
from generator.model.errors import NlosError


def flat(radiance, pixels=64):
    """A picture of one radiance."""
    return np.full((pixels, pixels, 3), radiance, dtype=np.float32)


@pytest.mark.parametrize("radiance", [1e-20, 3e-4, 1e20])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.9])
def test_mean_and_variance_are_the_linear_models(radiance, share):
    """Photon transfer: mean and variance of many measurements, within their 99.9 % intervals."""
    sensor = Sensor(fill=share).exposed([flat(radiance)])
    rng = np.random.default_rng(1)
    seen = np.stack([sensor.measure(flat(radiance), rng)[..., 0] for _ in range(40)]).astype(float)
    variance, n = sensor.variance(flat(radiance)).mean(), seen.size
    assert abs(seen.mean() / float(np.float32(radiance)) - 1.0) < 3.29 * np.sqrt(variance / n) / radiance + 1e-6
    low, high = stats.chi2.interval(0.999, n - 1)
    assert low <= (n - 1) * seen.var(ddof=1) / variance <= high


def test_averaging_frames_divides_the_variance():
    """And it does so for what is rounded too."""
    sensor = Sensor(frames=9).exposed([flat(1.0)])
    seen = sensor.measure(flat(1.0, 256), np.random.default_rng(2))[..., 0].astype(float)
    low, high = stats.chi2.interval(0.999, seen.size - 1)
    assert low <= (seen.size - 1) * seen.var(ddof=1) / sensor.variance(flat(1.0)).mean() <= high
    assert sensor.variance(flat(1.0)) * 9 == pytest.approx(sensor.variance(flat(1.0), frames=1))


def test_darkness_is_measured_without_bias():
    """The black level leaves room for noise on both sides of zero."""
    sensor = Sensor(exposure=1e4)
    seen = sensor.measure(flat(0.0, 256), np.random.default_rng(3))[..., 0].astype(float)
    assert abs(seen.mean()) < 3.29 * seen.std() / np.sqrt(seen.size)
    assert (seen < 0.0).any()


def test_a_full_well_holds_no_more():
    """Twice as bright as a full well is a full well, and is said to overflow."""
    sensor = Sensor(exposure=10_500.0)
    seen = sensor.measure(flat(2.0), np.random.default_rng(4))
    assert seen.max() <= 1.0
    assert seen.mean() == pytest.approx(1.0, abs=1e-3)
    assert sensor.saturated(flat(2.0)) == 1.0
    assert sensor.saturated(flat(0.5)) == 0.0
    assert np.isfinite(sensor.measure(flat(1e30), np.random.default_rng(4))).all()


def test_without_rounding_or_noise_only_photons_are_left():
    """Bits 0 and no read noise: what remains is a Poisson count."""
    sensor = Sensor(bits=0, read_noise=0.0, exposure=50.0)
    counts = sensor.measure(flat(1.0), np.random.default_rng(5))[..., 0] * 50.0
    assert np.allclose(counts, np.rint(counts), atol=1e-3)


def test_the_fixed_pattern_stays_and_differs_by_specimen():
    """Averaged over many frames, the pattern is what is left, with the spread that was asked for."""
    sensor = Sensor(gain_spread=0.05, offset_spread=30.0, frames=200).exposed([flat(1.0)])
    a, b = (sensor.measure(flat(1.0), np.random.default_rng(k), pattern=1)[..., 0].astype(float) for k in (6, 7))
    other = sensor.measure(flat(1.0), np.random.default_rng(6), pattern=2)[..., 0].astype(float)
    expected = np.hypot(0.05, 30.0 / 8400.0)
    assert a.std() == pytest.approx(expected, rel=0.08)
    assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.99
    assert abs(np.corrcoef(a.ravel(), other.ravel())[0, 1]) < 0.06


def test_a_data_set_is_seen_alike_every_time(tmp_path):
    """A picture's noise follows from seed, voxel and index; order does not matter, the clean file does not change."""
    data = make_dataset(tmp_path / "set", n=2)
    camera, again = Camera(data, Sensor(), seed=3), Camera(data, Sensor(), seed=3)
    first, last = data.records[0], data.records[-1]
    a = camera.picture(first), camera.picture(last), camera.background()
    b = again.background(), again.picture(last), again.picture(first)
    assert all(np.array_equal(x, y) for x, y in zip(a, reversed(b), strict=True))
    assert not np.array_equal(a[0], Camera(data, Sensor(), seed=4).picture(first))
    brightest = max(float(data.picture(r).max()) for r in data.records)
    assert camera.sensor.exposure * brightest == pytest.approx(0.8 * 10_500.0, rel=1e-6)
    again = type(data).open(data.path)
    assert np.array_equal(again.picture(first), data.picture(first))


def test_noise_is_that_of_what_a_set_shows_and_not_of_its_scene_file(tmp_path):
    """Blender saves a scene as other bytes each time; two targets of one description must not share noise."""

    def noise(name, **more):
        data = make_dataset(tmp_path / name, n=2, **more)
        camera = Camera(data, Sensor(exposure=1e8))
        return camera.background() - camera.empty()

    first = noise("first")
    assert np.array_equal(first, noise("saved again", saved="another"))
    assert not np.array_equal(first, noise("another seed", seed=1))
    assert not np.array_equal(first, noise("another target", noise=2e-5))


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"frames": 0}, "sensor.frames: 0 must be 1 or more"),
        ({"full_well": 0.0}, "sensor.full_well: 0 must be positive"),
        ({"read_noise": -1.0}, "sensor.read_noise: -1 must not be negative"),
        ({"exposure": float("inf")}, "sensor.exposure: inf is not a finite number"),
        ({"bits": 40}, "sensor.bits: 40 must be from 1 to 32"),
        ({"bits": 1, "read_noise": 1e4}, "sensor.bits: 1 are too few"),
        ({"drift": -1.0}, "sensor.drift: -1 must be above -1"),
    ],
)
def test_what_no_sensor_has_is_one_sentence(fields, words):
    """Bad fields are refused by name."""
    with pytest.raises(NlosError, match=words):
        Sensor(**fields)


def test_no_light_gives_no_exposure():
    """Zero light is one clear sentence."""
    with pytest.raises(NlosError, match="cannot follow from pictures without light"):
        Sensor().exposed([flat(0.0)])
    with pytest.raises(NlosError, match="is not chosen yet"):
        Sensor().measure(flat(1.0), np.random.default_rng(0))


@pytest.mark.parametrize("electrons", [0.0, 2.0, 30.0, 3000.0])
def test_stabilised_light_has_unit_noise_about_a_known_mean(electrons):
    """From darkness to a full well: variance 1, and the mean that is foretold."""
    sensor = Sensor(exposure=1.0, frames=2)
    rng = np.random.default_rng(8)
    seen = np.array([sensor.stabilised(sensor.measure(flat(electrons), rng)) for _ in range(10)])
    expected = sensor.stabilised_mean(flat(electrons)).mean()
    assert seen.mean() == pytest.approx(expected, abs=0.012 + 3.29 / np.sqrt(seen.size))
    assert seen.var() == pytest.approx(1.0, abs=0.08)


def test_what_overflows_is_taken_for_full():
    """Light beyond the full well is no evidence of anything but a full well."""
    sensor = Sensor(exposure=10_500.0)
    assert np.array_equal(sensor.stabilised_mean(flat(3.0)), sensor.stabilised_mean(flat(1.0)))


def test_two_data_sets_share_no_noise(tmp_path):
    """Or what is trained on the pictures of one would know the other's noise by heart."""
    sets = [make_dataset(tmp_path / str(seed), n=2, seed=seed, noise=0.0) for seed in (0, 1)]
    sensor = Sensor(exposure=1e7)
    noise = []
    for one in sets:
        camera = Camera(one, sensor, seed=0)
        again = Camera(one, sensor, seed=0)
        record = one.records[3]
        assert np.array_equal(camera.picture(record), again.picture(record))
        noise.append((camera.picture(record) - one.picture(record)).mean(axis=2).ravel())
    assert abs(np.corrcoef(*noise)[0, 1]) < 4.0 / np.sqrt(len(noise[0]))
