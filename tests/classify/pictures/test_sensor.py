"""The sensor against the statistics that its standard states."""

from __future__ import annotations

from dataclasses import replace

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
        ({"dark_current": -1.0}, "sensor.dark_current: -1 must not be negative"),
        ({"dark_current": 2e4, "exposure_time": 1.0}, "20000 electrons a second fill the well of 10500"),
        ({"vignetting": 1.0}, "sensor.vignetting: 1 must be from 0 to below 1"),
        ({"nonlinearity": 0.6}, "sensor.nonlinearity: 0.6 must lie between -0.45 and 0.45"),
        ({"quantum_efficiency": 1.2}, "sensor.quantum_efficiency: 1.2 must be at most 1"),
        ({"bits": 8, "black_level": 300.0}, "sensor.bits: 8 are too few"),
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


def seen(sensor, picture, count=200, seed=1):
    """Measurements, (count, height, width)."""
    rng = np.random.default_rng(seed)
    return np.stack([sensor.measure(picture, rng)[..., 0] for _ in range(count)]).astype(float)


EVERYTHING = {
    "dark_current": 40.0,
    "exposure_time": 2.0,
    "gain": 0.3,
    "black_level": 61.5,
    "nonlinearity": 0.04,
    "row_noise": 3.0,
    "column_noise": 2.0,
    "vignetting": 0.4,
    "flicker": 0.01,
}


CASES = {
    **{
        name: {name: EVERYTHING[name]} for name in ("gain", "nonlinearity", "row_noise", "column_noise", "vignetting")
    },
    "flicker": {"flicker": EVERYTHING["flicker"]},
    "dark charge": {name: EVERYTHING[name] for name in ("dark_current", "exposure_time")},
    "all": EVERYTHING,
}


@pytest.mark.parametrize("fields", CASES.values(), ids=CASES)
def test_mean_and_variance_hold_with_every_further_term(fields):
    """What is known of a camera is undone, and what cannot be is in the variance."""
    sensor = Sensor(exposure=8000.0, **fields)
    pictures = seen(sensor, flat(0.6, 24), 400)
    shared = 0.25 if "flicker" in fields else 0.03  # 400 draws of it, and not one for each pixel
    assert pictures.mean() == pytest.approx(0.6, rel=5e-3 if "flicker" in fields else 1e-3)
    ratio = pictures.var(axis=0, ddof=1).mean() / sensor.variance(flat(0.6, 24)).mean()
    assert ratio == pytest.approx(1.0, abs=shared)


def test_frames_are_what_a_converter_gives_and_stand_for_their_radiance():
    """Whole numbers in its range, whose mean gives back the light."""
    sensor = Sensor(exposure=8000.0, bits=12, **EVERYTHING)
    picture = flat(0.5, 48)
    rng = np.random.default_rng(3)
    frames = np.stack([sensor.frame(picture, rng) for _ in range(100)])
    assert np.array_equal(frames, np.rint(frames))
    assert frames.min() >= 0
    assert frames.max() <= 4095
    assert sensor.radiance(frames.mean(axis=0)).mean() == pytest.approx(0.5, rel=3e-3)
    dark = np.stack([sensor.frame(flat(0.0, 48), rng) for _ in range(100)])
    assert dark.mean() == pytest.approx(61.5 + 0.3 * 80.0, abs=0.1)  # black level, and the gain times the dark charge


def test_the_black_level_of_a_gain_leaves_room_for_the_noise():
    """Eight standard deviations of it, in grey levels."""
    dark = Sensor(gain=0.4, read_noise=5.0, exposure=1.0).frame(flat(0.0), np.random.default_rng(0))
    assert dark.mean() == pytest.approx(16.0, abs=0.15)
    assert dark.min() > 0


def test_rows_share_noise():
    """The variance of a row's mean is the row noise's, and little of the pixels'."""
    sensor = Sensor(row_noise=6.0, exposure=8000.0)
    pictures = seen(sensor, flat(0.1))
    rows = pictures.mean(axis=2).var(axis=0, ddof=1).mean()
    pixels = Sensor(exposure=8000.0).variance(flat(0.1)).mean() / 64
    assert rows == pytest.approx((6.0 / 8000.0) ** 2 + pixels, rel=0.05)
    columns = pictures.mean(axis=1).var(axis=0, ddof=1).mean()
    assert columns == pytest.approx((6.0 / 8000.0) ** 2 / 64 + pixels, rel=0.1)


def test_shared_noise_is_the_covariance_that_measurements_have():
    """Patterns and single pixels together explain how pixels vary together."""
    sensor = Sensor(row_noise=8.0, column_noise=5.0, flicker=0.02, exposure=8000.0, vignetting=0.3)
    picture = np.linspace(0.05, 0.5, 5 * 4).reshape(5, 4)[..., None].repeat(3, axis=2).astype(np.float32)
    pictures = seen(sensor, picture, 20_000).reshape(-1, 20)
    shared = sensor.shared(picture).reshape(-1, 20)
    assert len(shared) == sensor.shared_count((5, 4)) == 10
    alone = Sensor(exposure=8000.0, vignetting=0.3).variance(picture).ravel()
    expected = shared.T @ shared + np.diag(alone)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs(np.cov(pictures.T) - expected).max() < 5.0 / np.sqrt(20_000) * scale.max()
    assert Sensor(exposure=1.0).shared(picture).shape == (0, 5, 4)


def test_vignetting_darkens_corners_and_is_undone_at_the_cost_of_noise():
    """Corners keep their radiance, and get the noise of what is left of the light."""
    sensor = Sensor(vignetting=0.5, exposure=8000.0)
    picture = flat(0.8, 33)
    assert sensor.electrons(picture)[0, 0] == pytest.approx(0.5 * 8000.0 * 0.8)
    assert sensor.electrons(picture)[16, 16] == pytest.approx(8000.0 * 0.8)
    pictures = seen(sensor, picture, 500)
    assert pictures[:, 0, 0].mean() == pytest.approx(0.8, abs=4.0 * pictures[:, 0, 0].std() / np.sqrt(500))
    ratio = sensor.variance(picture)[0, 0] / sensor.variance(picture)[16, 16]
    assert ratio == pytest.approx(2.0, rel=0.01)
    dim = sensor.exposed([picture]).electrons(picture).max()
    assert replace(sensor, exposure=0.0).exposed([picture]).electrons(picture).max() == pytest.approx(0.8 * 10_500.0)
    assert dim <= 8000.0


def test_blur_spreads_a_point_and_loses_no_light():
    """A Gaussian of the stated deviation."""
    sensor = Sensor(blur=1.2, exposure=1.0)
    picture = np.zeros((31, 31, 3), dtype=np.float32)
    picture[15, 15] = 1000.0
    electrons = sensor.electrons(picture)
    y = np.arange(31) - 15
    assert electrons.sum() == pytest.approx(1000.0, rel=1e-4)
    assert np.sqrt((electrons.sum(axis=1) * y**2).sum() / electrons.sum()) == pytest.approx(1.2, rel=0.02)
    stabilised = sensor.stabilised_mean(picture)
    assert np.allclose(stabilised, Sensor(exposure=1.0).stabilised_mean(electrons[..., None]))
    assert np.allclose(stabilised, sensor.stabilised_mean(electrons[..., None], measured=True))


def test_flicker_changes_whole_frames():
    """All pixels of a frame together, by the stated share."""
    sensor = Sensor(flicker=0.05, exposure=8000.0)
    levels = seen(sensor, flat(0.5), 2000).mean(axis=(1, 2))
    low, high = stats.chi2.interval(0.999, 1999)
    assert low <= 1999 * levels.var(ddof=1) / (0.05 * 0.5) ** 2 <= high * 1.01


def test_dark_charge_adds_noise_and_stabilised_light_knows_it():
    """Unit noise about the stated mean, with dark charge and vignetting."""
    sensor = Sensor(exposure=1.0, frames=2, dark_current=30.0, exposure_time=1.5, vignetting=0.3)
    rng = np.random.default_rng(8)
    for electrons in (0.0, 40.0, 4000.0):
        taken = np.array([sensor.stabilised(sensor.measure(flat(electrons), rng)) for _ in range(10)])
        taken -= sensor.stabilised_mean(flat(electrons))
        assert taken.mean() == pytest.approx(0.0, abs=0.012 + 3.29 / np.sqrt(taken.size))
        assert taken.var() == pytest.approx(1.0, abs=0.05)


def test_the_exposure_follows_from_the_optics():
    """Of a wall of 1 W/m^2/sr: electrons counted by hand, with Planck's constant and the speed of light of the SI."""
    optics = {"quantum_efficiency": 0.6, "pixel_size": 5e-6, "f_number": 2.0, "exposure_time": 0.01}
    sensor = Sensor(**optics, wavelength=600e-9).exposed([])
    joules = np.pi / 17.0 * 25e-12 * 0.01
    photons = joules / (6.62607015e-34 * 299_792_458.0 / 600e-9)
    assert sensor.exposure == pytest.approx(0.6 * photons, rel=1e-6)


def test_the_slope_is_the_derivative_of_the_stabilised_mean():
    """By a difference quotient, which the bias of the root changes a little."""
    sensor = Sensor(exposure=8000.0, vignetting=0.3, dark_current=10.0, exposure_time=1.0)
    low, high = (sensor.stabilised_mean(flat(0.3 + step)) for step in (-1e-3, 1e-3))
    assert np.allclose((high - low) / 2e-3, sensor.stabilised_slope(flat(0.3)), rtol=2e-3)


@pytest.mark.parametrize("bits", [0, 12])
def test_terms_that_are_left_out_change_no_bit(bits):
    """The camera as it was before there were further terms, written out: sets that were seen keep their noise."""
    sensor = Sensor(exposure=8000.0, frames=3, offset_spread=4.0, bits=bits)
    picture = np.random.default_rng(0).uniform(-0.01, 1.0, size=(9, 7, 3)).astype(np.float32)
    rng, total = np.random.default_rng(5), np.zeros((9, 7))
    gain, offset = np.random.default_rng([2, 1288]).normal(size=(2, 9, 7))
    expected = np.maximum(np.asarray(picture, dtype=np.float64).mean(axis=2), 0.0) * 8000.0
    expected = expected * np.maximum(1.0 + 0.0 * gain, 0.0)
    noise = np.hypot(2.5, 4.0)
    black = np.ceil(8.0 * noise * 4095.0 / (10_500.0 + 8.0 * noise))
    step = 10_500.0 / (4095.0 - black)
    for _ in range(3):
        electrons = np.minimum(rng.poisson(expected), 10_500.0) + 4.0 * offset + rng.normal(scale=2.5, size=(9, 7))
        levels = np.clip(np.rint(electrons / step + black), 0.0, 4095.0)
        total += (levels - black) * step if bits else electrons
    seen = sensor.measure(picture, np.random.default_rng(5), pattern=2)
    assert np.array_equal(seen, (total / 3 / 8000.0)[..., None].repeat(3, axis=2).astype(np.float32))
    light = np.maximum(np.asarray(picture, dtype=np.float64).mean(axis=2), 0.0) * 8000.0
    variance = (light + 2.5**2 + (step if bits else 0.0) ** 2 / 12.0) / 3 / 8000.0**2
    assert np.array_equal(sensor.variance(picture), variance)
