"""Answers one after another agree with those of the command line about the very same picture."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import worlds
from classify_helpers import make_bulk, make_seen

from classify.classifiers.models import load
from classify.inference import answerer, atlas_build, atlas_file
from classify.pictures.sensor import Camera, Sensor
from generator.files.pictures import write_picture
from generator.model.errors import NlosError

FLOOR = worlds.quad((-2.0, 0.0, -1.0), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), 0.5)
DIM = Sensor(full_well=300.0, bits=10)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A bulk set of a sphere above a floor."""
    return make_bulk(tmp_path_factory.mktemp("bulk") / "set", pictures=400, room=(FLOOR,))


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """A data set of the same scene at other poses."""
    folder = tmp_path_factory.mktemp("seen")
    return make_seen(folder / "data", make_bulk(folder / "bulk", pictures=40, room=(FLOOR,), seed=3), poses=3)


@pytest.fixture(scope="module")
def models(tmp_path_factory, simulated, command):
    """Models of the clean pictures and of those that the default sensor and a dim one took, by name."""
    folder = tmp_path_factory.mktemp("models")
    (folder / "dim.toml").write_text("full_well = 300.0\nbits = 10\nframes = 2\n")
    plain = ("--classifier", "NB", "--hyperparameters", "paper")
    for name, seen_by in (("clean", None), ("default", "default"), ("dim", folder / "dim.toml")):
        table, sensor = folder / f"{name}.h5", ("--sensor", seen_by) if seen_by else ()
        assert command("classify", "features", simulated.path, "-o", table, *sensor).returncode == 0
        assert command("classify", "train", table, "-o", folder / f"{name}.skops", *plain).returncode == 0
    return {name: folder / f"{name}.skops" for name in ("clean", "default", "dim")}


@pytest.fixture(scope="module")
def atlas(tmp_path_factory, simulated):
    path = tmp_path_factory.mktemp("atlas") / "a.atlas"
    atlas_file.save(path, atlas_build.build(simulated, DIM))
    return path


def scene(dataset, **changes):
    """The scene of a data set."""
    known = {"background": dataset.background(), "grid": dataset.grid, "target": "sphere", "colour_space": "Rec.709"}
    return answerer.Seen(**{**known, **changes})


def larger(picture, factor=2):
    """The picture with each pixel cut into several of the same light."""
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


@pytest.mark.parametrize("name", ["clean", "default", "dim"])
def test_predict_says_the_same_of_the_same_picture(name, models, seen, command, tmp_path):
    asked = answerer.opened(models[name])
    asked.look_at(scene(seen))
    for record in seen.records[::5]:
        found = asked.answer(seen.picture(record) - seen.background())
        files = [tmp_path / f"{kind}.exr" for kind in ("picture", "background")]
        for file, picture in zip(files, (found.picture, found.background), strict=True):
            write_picture(file, picture, {"colour_space": "Rec.709"})
        said = command("classify", "predict", models[name], files[0], "--background", files[1], "--json")
        [expected] = json.loads(said.stdout)["answers"]
        assert found.probability == pytest.approx(expected["probability"], abs=1e-12)
    assert asked.doubts == []


def test_a_model_sees_what_its_own_sensor_takes(models, seen):
    """Clean pictures stay clean; else noise is as large as the sensor's formula says, and the same each time."""
    record = seen.records[0]
    clean = seen.picture(record)
    for name in models:
        asked = answerer.opened(models[name])
        asked.look_at(scene(seen))
        one, same = (asked.answer(clean - seen.background()) for _ in range(2))
        np.testing.assert_array_equal(one.picture, same.picture)
        off = one.picture.mean(axis=2) - clean.mean(axis=2)
        if name == "clean":
            np.testing.assert_allclose(one.picture, clean, rtol=1e-5, atol=1e-12)
            assert "without a sensor's noise" in asked.words
            continue
        sensor = asked._sensor
        assert (sensor.full_well, sensor.frames) == {"default": (10_500.0, 1), "dim": (300.0, 2)}[name]
        ratio = (off**2 / sensor.variance(clean)).mean()  # a chi-square mean of 256 pixels
        assert abs(ratio - 1.0) < 5.0 * np.sqrt(2.0 / off.size), ratio
        assert f"{sensor.exposure:.3g} electrons" in asked.words


def test_locate_says_the_same_of_the_same_picture(atlas, seen, command):
    said = command("classify", "locate", atlas, seen.path, "--json")
    assert said.returncode == 0, said.stderr
    asked = answerer.opened(atlas)
    asked.look_at(scene(seen))
    camera = Camera(seen, asked._sensor, 0)
    [expected, *_] = json.loads(said.stdout)["answers"]
    [record] = [record for record in seen.records if record.file == expected["file"]]
    probability, place, misfit = asked.measured_answer(camera.picture(record), camera.background())
    assert max(probability, key=probability.get) == expected["label"]
    assert max(probability.values()) == pytest.approx(expected["probability"], abs=1e-12)
    np.testing.assert_allclose(place.position, expected["position"], atol=1e-12)
    assert misfit == pytest.approx(expected["misfit"], rel=1e-9)


def test_an_atlas_finds_what_it_is_shown(atlas, seen):
    """Stated probabilities are true: about as many voxels are right as these say."""
    asked = answerer.opened(atlas)
    asked.look_at(scene(seen))
    found = [asked.answer(seen.picture(record) - seen.background()) for record in seen.records]
    right = [max(f.probability, key=f.probability.get) == r.label for f, r in zip(found, seen.records, strict=True)]
    stated = [max(f.probability.values()) for f in found]
    spread = np.sqrt(sum(p * (1.0 - p) for p in stated)) + 1.0
    assert abs(sum(right) - sum(stated)) < 3.0 * spread
    assert sum(stated) > 0.5 * len(stated)


def test_larger_pictures_are_averaged_and_smaller_ones_refused(models, atlas, seen):
    change = seen.picture(seen.records[0]) - seen.background()
    for path in (models["default"], atlas):
        asked = answerer.opened(path)
        asked.look_at(scene(seen))
        expected = asked.answer(change)
        asked.look_at(scene(seen, background=larger(seen.background())))
        found = asked.answer(larger(change))
        assert found.probability == pytest.approx(expected.probability, abs=1e-6)
        for size in ((8, 8), (32, 16)):
            with pytest.raises(NlosError, match=r"16 x 16 pixels, and the look has \d+ x \d+; set the look to 16"):
                asked.look_at(scene(seen, background=np.ones((*size, 3), np.float32)))


def test_what_does_not_fit_is_refused_or_doubted(models, atlas, seen):
    grid = seen.grid
    nearly = replace(grid, lo=tuple(np.float32(x).item() for x in grid.lo))
    for path in (models["clean"], atlas):
        asked = answerer.opened(path)
        asked.look_at(scene(seen, grid=nearly))
        for other in (replace(grid, shape=(4, 1, 1)), replace(grid, hi=(1.6, 1.7, 0.6))):
            with pytest.raises(NlosError, match="has other voxels than this scene"):
                asked.look_at(scene(seen, grid=other))
        with pytest.raises(NlosError, match="linear ACEScg"):
            asked.look_at(scene(seen, colour_space="ACEScg"))
        slope = np.linspace(0.5, 1.5, 16, dtype=np.float32)[:, None]
        asked.look_at(scene(seen, background=seen.background() * slope, target="sheet"))
        scene_doubt, target_doubt = asked.doubts
        assert "do not rely on these answers" in scene_doubt
        assert "sheet" in target_doubt


def test_what_is_no_model_is_refused_in_a_sentence(tmp_path, models):
    empty, broken = tmp_path / "empty.skops", tmp_path / "broken.skops"
    empty.write_bytes(b"")
    broken.write_bytes(models["clean"].read_bytes()[:3000])
    for path in (empty, broken, tmp_path / "absent.skops"):
        with pytest.raises(NlosError, match=rf"{path.name}: (is not a|no such) model"):
            answerer.opened(path)
    with pytest.raises(NlosError, match="is not an atlas"):
        answerer.opened(models["clean"].with_suffix(".h5"))


@pytest.mark.parametrize(
    ("sweep", "words"),
    [
        (
            {"engine": "patch", "samples": 256},
            "the noise of rendering, 256 samples of 'patch', which the look's do not",
        ),
        ({"engine": "path"}, "the noise of rendering, 'path', which"),
        ({"engine": "surfel", "accuracy": 1e-3}, ""),
        ({"engine": "of another time"}, ""),
        (None, ""),
    ],
)
def test_noise_that_only_the_training_had_is_told(sweep, words, models, seen):
    model = load(models["clean"])
    model.about["provenance"]["sweep"] = sweep
    asked = answerer.ByModel(models["clean"], model)
    asked.look_at(scene(seen))
    assert len(asked.doubts) == bool(words)
    assert words in "".join(asked.doubts)
