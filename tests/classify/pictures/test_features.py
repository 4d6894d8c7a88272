from __future__ import annotations

import h5py
import numpy as np
import pytest
from classify_helpers import make_dataset
from hypothesis import given, settings
from hypothesis import strategies as st

from classify.pictures import feature_table
from classify.pictures.features import FEATURE_SETS, describe, feature_names, tone_map
from classify.pictures.sensor import Sensor
from classify.pictures.settings import FeatureSettings
from generator.files.pictures import read_picture, write_picture
from generator.model.described import choices_of
from generator.model.errors import NlosError

SETS = ["global", "spatial-hog"]


def gradient(height=24, width=24):
    rows, columns = np.mgrid[0:height, 0:width]
    light = 1e-5 * (1.0 + columns / width + 0.3 * np.sin(rows / 3.0))
    return np.repeat(light[..., None], 3, axis=2).astype(np.float32)


EXTREMES = {
    "black": np.zeros((16, 16, 3)),
    "constant": np.full((16, 16, 3), 1e-5),
    "negative": -gradient(),
    "faint": gradient() * 1e-20,
    "glaring": gradient() * 1e25,
    "half": np.where(np.arange(24)[None, :, None] < 12, 1e20, -1e20) * np.ones((24, 24, 3)),
    "subnormal": np.full((16, 16, 3), 1e-45),
    "pixel": np.full((1, 1, 3), 1e-5),
    "row": gradient(1, 40),
    "column": gradient(40, 1),
    "large": np.tile(gradient(64, 64), (32, 32, 1)),
}


@pytest.mark.parametrize("tone", ["log", "linear"])
@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("extreme", EXTREMES)
def test_every_picture_has_finite_features(extreme, kind, tone):
    picture = EXTREMES[extreme].astype(np.float32)
    settings = FeatureSettings(set=kind, input="raw", tone=tone)
    values = describe(picture, settings, reference=1.0)
    assert values.shape == (len(feature_names(settings)),)
    assert np.isfinite(values).all()


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_nan_is_named_with_its_picture(kind, bad):
    picture = gradient()
    picture[3, 4, 1] = bad
    with pytest.raises(NlosError, match=r"A/0001\.exr: holds 1 NaN or infinite"):
        describe(picture, FeatureSettings(set=kind, input="raw"), reference=1.0, name="A/0001.exr")


def test_background_must_fit():
    with pytest.raises(NlosError, match="24 x 24 pixels, but its background 8 x 8"):
        describe(gradient(), FeatureSettings(), reference=1.0, background=gradient(8, 8))
    with pytest.raises(NlosError, match="need the background"):
        describe(gradient(), FeatureSettings(), reference=1.0)


@given(st.floats(-1e-3, 1e-3), st.floats(-1e-3, 1e-3))
@settings(max_examples=200)
def test_tone_mapping_is_odd_and_monotone(a, b):
    for tone in ("log", "linear"):
        chosen = FeatureSettings(tone=tone)
        one, other, mirrored = tone_map(np.array([a, b, -a]), chosen, 1.0)
        assert mirrored == -one
        assert (one <= other) or a > b
    assert tone_map(np.array([1e-3]), FeatureSettings(), 1.0)[0] == pytest.approx(1.0)


def test_tone_mapping_keeps_the_far_voxels_apart():
    """Signals four decades apart both differ from others 20 % brighter; 8 bits of the brightest lose the faint."""
    light = np.array([1e-7, 1.2e-7, 5e-4, 6e-4])
    log = tone_map(light, FeatureSettings(tone="log"), 1.0)
    linear = np.round(127 * tone_map(light, FeatureSettings(tone="linear"), 1.0))
    assert log[1] - log[0] > 0.012
    assert log[3] - log[2] > 0.012
    assert linear[0] == linear[1] == 0


def test_light_is_averaged_before_it_is_mapped():
    """A chequer of 0 and 2 looks like its mean 1, not like the mean of its shades."""
    fine = np.zeros((64, 64, 3), dtype=np.float32)
    fine[::2, ::2] = fine[1::2, 1::2] = 2e-5
    flat = np.full((64, 64, 3), 1e-5, dtype=np.float32)
    for kind in SETS:
        chosen = FeatureSettings(set=kind, input="raw")
        np.testing.assert_allclose(
            describe(fine, chosen, reference=1.0), describe(flat, chosen, reference=1.0), atol=1e-6
        )


def test_hu_moments_are_those_of_a_square_and_ignore_level_and_place():
    chosen = FeatureSettings(input="raw")
    hu = slice(feature_names(chosen).index("hu_1"), feature_names(chosen).index("hu_7") + 1)

    def at(row, column, level=1e-5):
        picture = np.zeros((32, 32, 3), dtype=np.float32)
        picture[row : row + 8, column : column + 8] = level
        return describe(picture, chosen, reference=1.0)[hu]

    first = at(4, 4)
    np.testing.assert_allclose(at(15, 9), first, atol=1e-4)
    np.testing.assert_allclose(at(4, 4, 1e-12), first, atol=1e-6)
    # A filled square of n x n pixels: eta20 = eta02 = (n^2 - 1) / (12 n^2), so h1 is twice that.
    h1 = 10 ** (first[0]) * 1e-12
    assert h1 == pytest.approx(2 * (64 - 1) / (12 * 64), rel=1e-3)


def test_haralick_of_a_constant_picture_is_one_certain_pair():
    chosen = FeatureSettings(input="raw")
    values = dict(zip(feature_names(chosen), describe(EXTREMES["constant"], chosen, reference=1.0), strict=True))
    assert values["haralick_angular_second_moment"] == pytest.approx(1.0)
    assert values["haralick_contrast"] == 0.0
    assert values["haralick_entropy"] == pytest.approx(0.0, abs=1e-9)


def test_histogram_shares_add_up_to_one_per_channel():
    chosen = FeatureSettings(input="raw")
    for picture in EXTREMES.values():
        values = describe(picture.astype(np.float32), chosen, reference=1.0)
        assert values[: 3 * chosen.bins].sum() == pytest.approx(3.0)


def test_features_survive_hdf5(tmp_path):
    dataset = make_dataset(tmp_path / "d", n=2)
    features = feature_table.extract(dataset, FeatureSettings())
    feature_table.write(tmp_path / "f.h5", features)
    back = feature_table.read(tmp_path / "f.h5")
    np.testing.assert_array_equal(back.values, features.values)
    np.testing.assert_array_equal(back.labels, features.labels)
    np.testing.assert_array_equal(back.positions, [r.position for r in dataset.records])
    assert (back.names, back.settings, back.grid) == (features.names, features.settings, dataset.grid)
    assert back.provenance["sweep"]["engine"] == "patch"
    assert set("ABCDEFGHI") == set(back.labels)


def test_features_files_from_elsewhere_are_refused(tmp_path):
    features = feature_table.extract(make_dataset(tmp_path / "d", n=1), FeatureSettings())
    feature_table.write(tmp_path / "f.h5", features)
    with h5py.File(tmp_path / "f.h5", "a") as file:
        file.attrs["format"] = 2
    with pytest.raises(NlosError, match="features format 2"):
        feature_table.read(tmp_path / "f.h5")
    with h5py.File(tmp_path / "f.h5", "a") as file:
        file.attrs["format"] = 1
        del file["voxel"]
        file["voxel"] = h5py.ExternalLink("other.h5", "/voxel")
    with pytest.raises(NlosError, match="is a link to somewhere else"):
        feature_table.read(tmp_path / "f.h5")
    (tmp_path / "text.h5").write_text("hello")
    with pytest.raises(NlosError, match="is not a features file"):
        feature_table.read(tmp_path / "text.h5")


def test_an_unfinished_data_set_is_taken_only_when_asked(tmp_path):
    dataset = make_dataset(tmp_path / "d", n=2, skip=3)
    with pytest.raises(NlosError, match="only 15 of 18 pictures"):
        feature_table.extract(dataset, FeatureSettings())
    assert len(feature_table.extract(dataset, FeatureSettings(), partial=True).values) == 15


def test_a_picture_altered_after_rendering_is_refused(tmp_path):
    dataset = make_dataset(tmp_path / "d", n=1)
    file = tmp_path / "d" / dataset.records[2].file
    pixels, header = read_picture(file)
    write_picture(file, pixels * 2, header)
    with pytest.raises(NlosError, match=r"C/0000\.exr: its pixels differ"):
        feature_table.extract(dataset, FeatureSettings())


def test_features_of_what_a_sensor_saw(tmp_path, command):
    """The same seed sees the same noise; sets that different sensors saw are not compared."""
    dataset = make_dataset(tmp_path / "d", n=2)
    clean, noisy, again = (
        feature_table.extract(dataset, FeatureSettings(), sensor=sensor, seed=4)
        for sensor in (None, Sensor(), Sensor())
    )
    assert not np.array_equal(clean.values, noisy.values)
    assert np.array_equal(noisy.values, again.values)
    assert noisy.provenance["sensor"]["exposure"] > 0.0
    many = feature_table.extract(dataset, FeatureSettings(), sensor=Sensor(frames=9))
    with pytest.raises(NlosError, match="were seen by different sensors"):
        feature_table.check_comparable(noisy, many, ("a.h5", "b.h5"))
    feature_table.check_comparable(noisy, again, ("a.h5", "b.h5"))
    del again.provenance["sensor"]["dark_current"]  # a file from before there was one
    feature_table.check_comparable(noisy, again, ("a.h5", "b.h5"))
    done = command("classify", "features", tmp_path / "d", "-o", tmp_path / "f.h5", "--sensor", "default")
    assert done.returncode == 0, done.stderr
    assert feature_table.read(tmp_path / "f.h5").provenance["sensor"]["frames"] == 1
    done = command("classify", "features", tmp_path / "d", "-o", tmp_path / "g.h5", "--frames", 0)
    assert (done.returncode, (tmp_path / "g.h5").exists()) == (2, False)
    assert "sensor.frames: 0 must be 1 or more" in done.stderr


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("frame = 9", "frame: no such field; "),
        ("[sensors]\nframes = 9", "sensors: no such field; "),
        ("[sensor]\nframe = 9", "frame: no such field; "),
        ("bits = 12.5", "bits: 12.5 must be a whole number"),
        ("bits = 99", "sensor.bits: 99 must be from 1 to 32"),
    ],
)
def test_a_file_of_a_sensor_is_named_where_it_is_wrong(tmp_path, command, text, words):
    file = tmp_path / "long.toml"
    file.write_text(text)
    make_dataset(tmp_path / "d", n=1)
    done = command("classify", "features", tmp_path / "d", "-o", tmp_path / "f.h5", "--sensor", file)
    assert (done.returncode, (tmp_path / "f.h5").exists()) == (2, False)
    assert done.stderr.startswith(f"error: {file}: {words}")


def test_every_set_that_can_be_chosen_is_there():
    assert set(FEATURE_SETS) == set(choices_of(FeatureSettings, "set"))
