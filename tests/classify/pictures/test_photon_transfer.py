"""Figures of cameras against cameras whose figures are known, drawn electron by electron."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from cameras import LEVELS, Bench, Camera, truth
from scipy import stats

from classify.pictures import photon_transfer
from classify.pictures.sensor import Sensor
from generator.model.errors import NlosError


def measured(camera=None, seed=0, count=8, **light):
    """What is found of a camera."""
    bench = Bench(camera or Camera(), np.random.default_rng(seed))
    return photon_transfer.measure(bench.light(count, **light), bench.dark(count))


def changed(change, camera=None, count=6):
    """What is found where every frame is changed on the way."""
    bench = Bench(camera or Camera(), np.random.default_rng(3))
    bursts = [
        [replace(burst, frames=np.stack([change(frame) for frame in burst.frames])) for burst in bursts]
        for bursts in (bench.light(count), bench.dark(count))
    ]
    return photon_transfer.measure(*bursts)


def held(found, camera):
    """Whether each interval holds the truth, by name."""
    linear = [level for level, used in zip(LEVELS, found.linear, strict=True) if used]
    return {
        name: found.intervals[name].low <= value <= found.intervals[name].high
        for name, value in truth(camera, linear).items()
    }


@pytest.mark.parametrize("count", [2, pytest.param(12, marks=pytest.mark.slow)])
def test_intervals_hold_the_truth_of_ten_sensors(count):
    """Of 110 intervals of 95 %, and of ten of each figure, as many as the binomial distribution allows."""
    found = []
    for seed in range(10):
        rng = np.random.default_rng([seed, 1288])
        camera = Camera.drawn(rng)
        bench = Bench(camera, rng)
        found.append(held(photon_transfer.measure(bench.light(count), bench.dark(count), bits=camera.bits), camera))
    total = sum(sum(one.values()) for one in found)
    assert total >= stats.binom.ppf(1e-3, 110, 0.95)
    fewest = stats.binom.ppf(1e-4, 10, 0.95)
    for name in found[0]:
        assert sum(one[name] for one in found) >= fewest, name


def test_figures_are_those_of_the_camera_and_become_a_sensor():
    """And the sensor's frames have the noise of the camera's."""
    camera = Camera(column_noise=0.8)
    found = measured(camera, count=20)
    sensor = found.sensor
    assert found.doubts == []
    for name in ("gain", "read_noise", "full_well", "dark_current", "gain_spread", "row_noise", "column_noise"):
        assert getattr(sensor, name) == pytest.approx(getattr(camera, name), rel=0.08), name
    assert sensor.nonlinearity == pytest.approx(camera.bend, abs=1e-3)
    assert sensor.black_level == pytest.approx(camera.black, abs=0.3)
    assert (sensor.bits, sensor.flicker) == (12, 0.0)
    rng = np.random.default_rng(5)
    picture = np.full((96, 96, 3), 0.4, dtype=np.float32)
    taken = replace(sensor, exposure=camera.full_well, exposure_time=0.04)
    own = np.stack([taken.frame(picture, rng) for _ in range(20)])
    theirs = found.light[LEVELS.index(0.4)]
    assert own.mean() == pytest.approx(theirs.mean.mean(), rel=0.002)
    assert own.var(axis=0, ddof=1).mean() == pytest.approx(theirs.pixel, rel=0.03)


def test_a_sensors_own_frames_give_its_figures_back():
    """`Sensor.frame` and the estimator mean the same by every field."""
    sensor = Sensor(
        gain=0.25,
        black_level=50.0,
        full_well=15_000.0,
        read_noise=4.0,
        gain_spread=0.01,
        offset_spread=5.0,
        dark_current=200.0,
        nonlinearity=0.02,
        row_noise=2.0,
        exposure=15_000.0,
    )
    rng, bursts = np.random.default_rng(7), []
    for light, time in [*((level, 0.1 * level) for level in LEVELS), (0.0, 0.01), (0.0, 1.0)]:
        taken = replace(sensor, exposure_time=time)
        picture = np.full((64, 64, 3), light, dtype=np.float32)
        frames = np.stack([taken.frame(picture, rng, pattern=2) for _ in range(12)]).astype(np.uint16)
        bursts.append(photon_transfer.Burst(name=f"{light}", frames=frames, time=time))
    found = photon_transfer.measure(bursts[: len(LEVELS)], bursts[len(LEVELS) :])
    for name in ("gain", "full_well", "read_noise", "dark_current", "nonlinearity", "row_noise"):
        one = found.intervals[name]
        wide = 0.6 * (one.high - one.low)  # six intervals at once
        assert one.low - wide <= getattr(sensor, name) <= one.high + wide, name


def test_flicker_between_frames_is_corrected_and_told():
    """It would add its square to the variance: at half the well 8,100 electrons squared, of 9,000 photons'."""
    found = measured(count=12, flicker=0.01)
    assert found.intervals["gain"].low <= 0.2 <= found.intervals["gain"].high
    assert found.intervals["gain"].high < 0.22
    assert found.intervals["flicker"].low <= 0.01 <= found.intervals["flicker"].high
    assert [doubt for doubt in found.doubts if "changed by 1" in doubt or "changed by 0.9" in doubt]


def test_flicker_while_rows_are_read_is_told():
    """Bands of one per cent that move from frame to frame."""
    rng, bench = np.random.default_rng(4), Bench(Camera(), np.random.default_rng(3))
    rows = np.arange(96)[:, None]
    light = []
    for burst in bench.light(2):
        plain, frames = bench.gains, []
        for _ in range(6):
            bench.gains = plain * (1.0 + 0.01 * np.sin(0.3 * rows + rng.uniform(0.0, 6.3)))
            frames.append(bench.frame(10.0 * burst.time * 18_000.0, burst.time))
        bench.gains = plain
        light.append(replace(burst, frames=np.stack(frames)))
    found = photon_transfer.measure(light, bench.dark(6))
    assert any("the light flickers while rows are read out" in doubt for doubt in found.doubts)
    assert found.intervals["gain"].value == pytest.approx(0.2, rel=0.02)


def test_uneven_light_changes_no_figure():
    """Vignetting of a third, and a slope."""
    y, x = np.mgrid[-1:1:96j, -1:1:96j]
    camera = Camera()
    bench = Bench(camera, np.random.default_rng(6), light=1.0 - 0.16 * (x**2 + y**2) + 0.1 * x)
    found = photon_transfer.measure(bench.light(8), bench.dark(8))
    assert found.doubts == []
    assert found.intervals["gain_spread"].value == pytest.approx(camera.gain_spread, rel=0.06)
    assert found.intervals["gain"].value == pytest.approx(camera.gain, rel=0.01)
    assert found.intervals["full_well"].value == pytest.approx(camera.full_well, rel=0.01)


def test_saturation_that_is_not_reached_everywhere_is_no_full_well():
    """A dark half keeps the mean of the brightest burst below the well, and is told as an edge."""
    light = np.where(np.arange(96) < 40, 0.4, 1.0) * np.ones((96, 1))
    bench = Bench(Camera(), np.random.default_rng(8), light=light)
    found = photon_transfer.measure(bench.light(8), bench.dark(8))
    assert found.intervals["full_well"].high == np.inf
    assert any("no burst is saturated" in doubt for doubt in found.doubts)
    assert any("edges" in doubt for doubt in found.doubts)
    assert found.intervals["gain"].value == pytest.approx(0.2, rel=0.02)


def test_a_converter_that_ends_before_the_well_is_the_full_well():
    """Ten bits of 0.2 grey levels an electron hold 4,800 of 18,000 electrons."""
    found = measured(Camera(bits=10), levels=(0.02, 0.04, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2, 0.24, 0.5))
    assert found.intervals["full_well"].value == pytest.approx((1023 - 64) / 0.2, rel=0.02)
    assert found.sensor.bits == 10


def test_noise_below_rounding_is_a_limit():
    """EMVA 1288: 0.40 grey levels where the variance of the dark noise is below 0.24."""
    camera = Camera(gain=0.08, read_noise=3.0, row_noise=0.3, full_well=2500.0, bits=8, black=12.3, dark_current=2.0)
    found = measured(camera)
    one = found.intervals["read_noise"]
    assert (one.low, one.value) == (0.0, pytest.approx(0.40 / found.line[1]))
    assert one.high > camera.read_noise
    assert any("hidden by rounding" in doubt for doubt in found.doubts)
    assert found.intervals["gain"].value == pytest.approx(0.08, rel=0.03)


def test_twelve_bits_in_sixteen_are_read_as_twelve():
    """Left aligned values are multiples of 16."""
    found = changed(lambda frame: frame * np.uint16(16))
    assert found.sensor.bits == 12
    assert found.sensor.gain == pytest.approx(0.2, rel=0.02)


def test_without_exposure_times_the_gain_is_found_and_linearity_is_not():
    """Brightness alone: a lamp that is moved."""
    bench = Bench(Camera(bend=0.0), np.random.default_rng(9))
    light = [replace(burst, time=np.nan) for burst in bench.light(8)]
    found = photon_transfer.measure(light, [replace(burst, time=np.nan) for burst in bench.dark(8, (0.05,))])
    assert found.intervals["gain"].value == pytest.approx(0.2, rel=0.02)
    assert "nonlinearity" not in found.intervals
    assert "dark_current" not in found.intervals
    assert any("linearity is not measured" in doubt for doubt in found.doubts)


def test_a_photometer_gives_the_quantum_efficiency():
    """Electrons over photons, counted by hand with the constants of the SI."""
    bench = Bench(Camera(), np.random.default_rng(10))
    photon = 6.62607015e-34 * 299_792_458.0 / 600e-9
    # 180,000 electrons a second; at an efficiency of 0.6 they are of this irradiance.
    irradiance = 180_000.0 / 0.6 * photon / (3e-6) ** 2
    light = [replace(burst, irradiance=irradiance) for burst in bench.light(8)]
    found = photon_transfer.measure(light, bench.dark(8), pixel_size=3e-6, wavelength=600e-9)
    one = found.intervals["quantum_efficiency"]
    assert one.value == pytest.approx(0.6, rel=0.01)
    assert one.low < 0.6 < one.high
    assert found.sensor.quantum_efficiency == one.value


def gamma(frame):
    """As screens want it, in 8 bits."""
    return (255.0 * (frame / 4095.0) ** (1.0 / 2.2) + 0.5).astype(np.uint8)


def compressed(frame):
    """Through JPEG."""
    return cv2.imdecode(cv2.imencode(".jpg", (frame / 16).astype(np.uint8))[1], cv2.IMREAD_GRAYSCALE)


def mosaic(frame):
    """Behind red, green and blue filters, each with its own share of the light above black."""
    share = np.tile([[0.5, 1.0], [1.0, 0.7]], (48, 48))
    return (64.0 + (frame - 64.0) * share).astype(np.uint16)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (gamma, "variance of the noise does not grow in line with the signal"),
        (compressed, "all its frames are the same|correlated"),
        (lambda frame: cv2.GaussianBlur(frame, (3, 3), 0.6), "noise of neighbouring pixels is correlated"),
        (mosaic, "every second pixel differs by 6.%, as with a mosaic"),
        (lambda frame: np.maximum(frame.astype(int) - 64, 0).astype(np.uint16), "of its values are zero"),
        (lambda frame: frame[:20], "96 x 20 pixels are too few"),
    ],
)
def test_what_is_no_linear_converters_is_refused(change, words):
    """In a sentence that says what it is."""
    with pytest.raises(NlosError, match=words):
        changed(change)


def test_too_little_is_refused():
    """Levels, frames, darkness."""
    bench = Bench(Camera(), np.random.default_rng(0), shape=(32, 32))
    light, dark = bench.light(2), bench.dark(2)
    with pytest.raises(NlosError, match="--dark: name one or more bursts"):
        photon_transfer.measure(light, [])
    with pytest.raises(NlosError, match="2 levels of light are too few"):
        photon_transfer.measure(light[:2], dark)
    with pytest.raises(NlosError, match="holds one frame"):
        photon_transfer.measure([*light, replace(light[0], frames=light[0].frames[:1])], dark)
    with pytest.raises(NlosError, match="frames of another size"):
        photon_transfer.measure(light, [replace(dark[0], frames=dark[0].frames[:, 1:])])
    with pytest.raises(NlosError, match="no brighter than the dark ones"):
        photon_transfer.measure(dark, light[-3:])
    with pytest.raises(NlosError, match="levels of light lie above the noise of rounding and below 70%"):
        photon_transfer.measure(light[-4:], dark)
    with pytest.raises(NlosError, match="--bits 8: the frames hold grey levels up to"):
        photon_transfer.measure(light, dark, bits=8)


def test_a_sum_of_mean_squares_has_its_interval():
    """Of a difference of two variances, drawn 2,000 times."""
    rng = np.random.default_rng(11)
    hits = 0
    for _ in range(2000):
        square, own = 3.0 * rng.chisquare(20) / 20, rng.chisquare(200) / 200
        found = photon_transfer.squares([(1.0, square, 20.0), (-1.0, own, 200.0)])
        hits += found.low <= 2.0 <= found.high
    low, high = stats.binom.interval(0.999, 2000, 0.95)
    assert low <= hits <= high
