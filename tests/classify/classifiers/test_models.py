from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import skops.io
from classify_helpers import make_dataset
from figure_texts import misplaced
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV

from classify.classifiers import evaluate, models
from classify.classifiers.names import NAMES
from classify.intervals import Interval, wilson
from classify.pictures import feature_table
from classify.pictures.settings import FeatureSettings
from classify.report import comparison
from generator.files.pictures import pixel_hash, read_picture
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.presets import preset

QUICK = ("LDA", "SVM", "NB")


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Features of a sheet's and a sphere's data set."""
    folder = tmp_path_factory.mktemp("pair")
    return [
        feature_table.extract(make_dataset(folder / target, target=target, seed=i), FeatureSettings())
        for i, target in enumerate(("sheet", "sphere"))
    ]


@pytest.fixture(scope="module")
def files(pair, tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    for features in pair:
        feature_table.write(folder / f"{features.target}.h5", features)
    return folder


def test_wilson_interval_matches_the_published_example():
    # Newcombe 1998, Statistics in Medicine 17, table I, method 3: 81 of 263 and 15 of 148 and 0 of 20.
    for (r, n), (low, high) in {
        (81, 263): (0.2553, 0.3662),
        (15, 148): (0.0624, 0.1605),
        (0, 20): (0, 0.1611),
    }.items():
        interval = wilson(r, n)
        assert (interval.low, interval.high) == (pytest.approx(low, abs=5e-5), pytest.approx(high, abs=5e-5))


def test_macro_scores_are_scikit_learns():
    from sklearn.metrics import confusion_matrix, precision_recall_fscore_support

    rng = np.random.default_rng(0)
    truth, predicted = rng.integers(0, 5, 300), rng.integers(0, 5, 300)
    confusion = confusion_matrix(truth, predicted)
    expected = precision_recall_fscore_support(truth, predicted, average="macro", zero_division=0)[:3]
    np.testing.assert_allclose(evaluate.macro_scores(confusion.astype(float)), expected)


def test_bootstrap_interval_covers_about_95_percent():
    """Recall of balanced classes is accuracy: its interval must cover the truth 95 times in 100, within chance."""
    rng = np.random.default_rng(1)
    covered = 0
    for trial in range(200):
        confusion = np.array([rng.multinomial(60, [0.7, 0.3]), rng.multinomial(60, [0.3, 0.7])])
        recall = evaluate.intervals(confusion, seed=trial)[1]
        covered += recall.low <= 0.7 <= recall.high
    # 190 expected; 175 or fewer, or all 200, has less than one chance in 10,000.
    assert 175 < covered < 200


def test_positions_are_learnt_and_both_cross_scenarios_are_there(pair):
    results = evaluate.compare(pair, ["a", "b"], classifiers=QUICK, settings=["paper"], folds=4)
    assert len(results) == 4 * len(QUICK)
    assert {r.scenario for r in results} == {"sheet", "sphere", "sheet -> sphere", "sphere -> sheet"}
    best = max(r.accuracy.low for r in results if r.scenario == "sheet")
    assert best > 0.4, "pictures of the closed form tell voxels apart far above chance"
    for r in results:
        assert r.confusion.sum() == 108
        assert r.accuracy.low <= r.accuracy.value <= r.accuracy.high
        for interval in (r.precision, r.recall, r.f1):
            assert 0 <= interval.low <= interval.value + 1e-9
            assert interval.value <= interval.high + 1e-9


def test_the_papers_figures_stand_only_beside_what_it_had(pair):
    sphere = pair[1]
    assert evaluate.target_names([sphere], ["f"]) == ["sphere"]
    several = replace(sphere, labels=np.array([f"{label}+I" for label in sphere.labels]))
    varied = replace(sphere, varied={"target.albedo": np.zeros(len(sphere.labels))})
    assert several.contents == "2 spheres"
    assert replace(several, target="mesh").contents == "2 meshes"
    assert varied.contents == "sphere with varied target.albedo"
    result = evaluate.compare([sphere], ["f"], classifiers=["NB"], settings=["paper"], folds=2)[0]
    assert comparison.paper_row(result)
    for other in (several, varied):
        named = replace(result, train=other.contents, test=other.contents)
        assert comparison.paper_row(named) is None
        assert comparison.text_table([named])[0][2] == "-"


def test_shuffled_labels_are_guessed_at_chance(pair):
    """What leaks from a test fold into training shows as skill where there is none to have."""
    rng = np.random.default_rng(0)
    nonsense = replace(pair[0], labels=rng.permutation(pair[0].labels))
    for r in evaluate.compare([nonsense], ["a"], classifiers=("LDA", "SVM"), folds=6):
        # 108 pictures at 1/9: 25 hits or more have less than one chance in 10,000.
        assert np.trace(r.confusion) < 25, (r.classifier, r.settings)


def test_scaler_and_search_see_the_training_part_only(pair, monkeypatch):
    seen = []
    real = models.MinMaxScaler.fit

    def spy(self, x, y=None):
        seen.append(len(x))
        return real(self, x, y)

    monkeypatch.setattr(models.MinMaxScaler, "fit", spy)
    train = pair[0].values[:90]
    for settings in ("paper", "tuned"):
        evaluate.fit_and_test(
            models.make("KNN", settings, "global", 90),
            train,
            pair[0].labels[:90],
            pair[0].values[90:],
            pair[0].labels[90:],
        )
    assert max(seen) == 90
    assert min(seen) == 60, "the search splits the training part once more"


def test_shared_kernels_choose_what_a_grid_search_chooses(pair):
    """Every candidate has scikit-learn's accuracy, with several best of all, and the fit answers the same."""
    search = models.make("SVM", "tuned", "global", 90)
    plain = GridSearchCV(search.estimator, search.param_grid, cv=search.cv)
    for features in (pair[0], replace(pair[1], values=np.round(pair[1].values, 1))):
        x, y = features.values[:90], features.labels[:90]
        ours, theirs = clone(search).fit(x, y), clone(plain).fit(x, y)
        assert ours.scores_.ravel().tolist() == theirs.cv_results_["mean_test_score"].tolist()
        assert models.chosen(ours) == models.chosen(theirs)
        rest = features.values[90:]
        np.testing.assert_array_equal(
            ours.best_estimator_.decision_function(rest), theirs.best_estimator_.decision_function(rest)
        )


def test_one_classifier_is_cross_validated_as_in_a_comparison(pair):
    told = []
    alone = evaluate.cross_validated(
        pair[0], "LDA", "paper", most_folds=4, seed=2, progress=lambda done, total, what: told.append((done, total))
    )
    [among] = evaluate.compare(pair[:1], ["a"], classifiers=["LDA"], settings=["paper"], folds=4, seed=2)
    np.testing.assert_array_equal(alone.right, among.right)
    assert (alone.accuracy, alone.folds, alone.train) == (among.accuracy, among.folds, among.train)
    assert told == [(done, 4) for done in range(5)]
    rarest = min(np.unique(pair[0].labels, return_counts=True)[1])
    assert len(evaluate.cross_validated(pair[0], "NB", "paper", most_folds=10**6).folds) == rarest


def test_results_follow_from_the_seed(pair):
    first, again = (
        evaluate.compare(pair[:1], ["a"], classifiers=("RF",), settings=["paper"], folds=3, seed=5) for _ in range(2)
    )
    np.testing.assert_array_equal(first[0].confusion, again[0].confusion)


@pytest.mark.parametrize("name", NAMES)
def test_every_model_is_saved_and_loaded_with_equal_probabilities(pair, tmp_path, name):
    model = models.train(pair[0], name, "paper")
    models.save(tmp_path / "m.skops", model)
    loaded = models.load(tmp_path / "m.skops")
    picture = pair[0].background * np.float32(1.01)
    a, b = model.probabilities(picture), loaded.probabilities(picture)
    assert a == b
    assert list(a) == list("ABCDEFGHI")
    assert sum(a.values()) == pytest.approx(1.0)
    assert loaded.about["samples"]["A"] == 12


class Stranger:
    """A type that no model of ours has."""

    def __init__(self):
        self.number = 7


def test_a_model_file_with_an_unknown_type_is_not_loaded(tmp_path):
    skops.io.dump({"format": 1, "estimator": Stranger()}, tmp_path / "m.skops")
    with pytest.raises(NlosError, match=r"unknown type .*Stranger"):
        models.load(tmp_path / "m.skops")


@pytest.mark.parametrize("content", [b"hello", b""])
def test_a_file_that_is_no_model_is_named(tmp_path, content):
    (tmp_path / "m.skops").write_bytes(content)
    with pytest.raises(NlosError, match=r"m\.skops: is not a model file"):
        models.load(tmp_path / "m.skops")


def test_pictures_of_two_objects_are_learnt_by_the_voxels_of_both(pair, tmp_path):
    """Pairs of voxels are classes as voxels are; maps show each voxel, and no pair has a relative position."""
    one = pair[0]
    names = {"A": "A+B", "B": "A+C", "C": "B+C"}
    rows = np.isin(one.labels, list(names))
    chosen = {name: getattr(one, name)[rows] for name in ("values", "voxels", "positions", "rotations")}
    labels = np.array([names[label] for label in one.labels[rows]])
    files = [file for file, taken in zip(one.files, rows, strict=True) if taken]
    pairs = replace(one, labels=labels, files=files, **chosen)
    feature_table.write(tmp_path / "pairs.h5", pairs)
    results = evaluate.compare([feature_table.read(tmp_path / "pairs.h5")], ["a"], classifiers=["LDA"], folds=3)
    assert all(result.labels == ["A+B", "A+C", "B+C"] for result in results)
    assert {words for *_, words in comparison.confusions(results[0], one.grid)} <= {""}
    page = comparison.write(tmp_path / "report", results, [pairs], ["a.h5"], 3)
    assert "A+C" in page.read_text()
    model = models.train(pairs, "LDA", "paper")
    models.save(tmp_path / "pairs.skops", model)
    assert models.load(tmp_path / "pairs.skops").estimator.classes_.tolist() == ["A+B", "A+C", "B+C"]


def test_collinear_duplicate_and_many_features_are_borne():
    """More features than samples, each twice: every classifier still fits and answers."""
    rng = np.random.default_rng(0)
    labels = np.repeat(["A", "B"], 6)
    half = rng.normal(size=(12, 40)) + (labels == "B")[:, None]
    values = np.hstack([half, half, np.zeros((12, 5))])
    for name in NAMES:
        for settings in ("paper", "tuned"):
            fitted = models.make(name, settings, "global", 12).fit(values, labels)
            assert set(fitted.predict(values)) <= {"A", "B"}


def test_report_is_one_page_that_needs_nothing_else(pair, tmp_path):
    results = evaluate.compare(pair, ["<i>.h5", "b.h5"], classifiers=QUICK, settings=["paper"], folds=3)
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "mine.txt").write_text("keep")
    page = comparison.write(tmp_path / "report", results, pair, ["<i>.h5", "b.h5"], 3)
    text = page.read_text()
    assert "<i>.h5" not in text, "names are escaped"
    assert "&lt;i&gt;.h5" in text
    assert 'src="http' not in text
    assert "href=" not in text
    assert text.count("data:image/png;base64,") == 5
    assert "not reported" in text
    assert (tmp_path / "report" / "mine.txt").read_text() == "keep"
    rows = (tmp_path / "report" / "results.csv").read_text().splitlines()
    assert len(rows) == 1 + len(results)


def test_report_of_many_voxels(tmp_path, drawn):
    grid = VoxelGrid(lo=(0.8, 0.4, 0.4), hi=(2.3, 1.9, 2.2), shape=(4, 3, 3))
    features = feature_table.extract(make_dataset(tmp_path / "d", n=4, grid=grid), FeatureSettings())
    results = evaluate.compare([features], ["d"], classifiers=("NB",), settings=["paper"], folds=3)
    page = comparison.write(tmp_path / "r", results, [features], ["d"], 3)
    assert "AJ" in page.read_text()
    assert len(drawn) == 2
    assert [words for figure in drawn for words in misplaced(figure)] == []
    assert {"comparison.svg", "confusion-sheet.svg"} <= {p.name for p in (tmp_path / "r").iterdir()}


def test_confused_voxels_are_told_by_how_they_lie():
    confusion = np.zeros((9, 9), dtype=int)
    confusion[6, 7], confusion[0, 3], confusion[2, 4] = 5, 3, 1
    interval = Interval(0, 0, 0)
    result = evaluate.Result(
        "a",
        "a",
        "NB",
        "paper",
        list("ABCDEFGHI"),
        confusion,
        np.zeros(0, dtype=bool),
        [0.0],
        *[interval] * 4,
        train_seconds=0,
        predict_seconds=0,
    )
    pairs = comparison.confusions(result, preset("room").grid)
    assert pairs[0] == ("G", "H", 5, "1 voxel apart along the wall")
    assert pairs[1] == ("A", "D", 3, "1 voxel apart in distance from the wall")
    assert pairs[2][3] == "1 voxel apart along the wall and 1 voxel apart in distance from the wall"


def test_commands_from_data_set_to_answer(tmp_path, command):
    make_dataset(tmp_path / "sheet", n=6)
    make_dataset(tmp_path / "sphere", target="sphere", n=6, seed=1)
    for target in ("sheet", "sphere"):
        done = command("classify", "features", target, "-o", f"{target}.h5", cwd=tmp_path)
        last = done.stdout.splitlines()[-1]
        assert last == f"{target}.h5: 54 pictures, 116 features each (global, difference)", done.stderr
    done = command(
        "classify",
        "compare",
        "sheet.h5",
        "sphere.h5",
        "-o",
        "report",
        "--folds",
        "3",
        "--settings",
        "paper",
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "report/report.html"
    assert "trained on sheet, tested on sphere" in done.stdout
    done = command("classify", "train", "sheet.h5", "-o", "m.skops", "--classifier", "LDA", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    done = command(
        "classify", "train", "sheet.h5", "-o", "m.skops", "--classifier", "LDA", "--cross-validate", cwd=tmp_path
    )
    assert "right voxel: " in done.stdout, done.stderr
    assert "in 6 folds" in done.stdout
    pictures = [f"sheet/{v}/0000.exr" for v in "AEI"]
    done = command("classify", "predict", "m.skops", *pictures, "--json", cwd=tmp_path, process=True)
    answers = json.loads(done.stdout)["answers"]
    assert [a["picture"] for a in answers] == pictures
    assert sum(a["label"] == p[6] for a, p in zip(answers, pictures, strict=True)) >= 2
    assert answers[0]["label"] == max(answers[0]["probability"], key=answers[0]["probability"].get)
    done = command("classify", "predict", "m.skops", pictures[0], cwd=tmp_path)
    assert done.stdout.startswith(f"{pictures[0]}: {answers[0]['label']}   ")


def with_nan(path):
    """Put a NaN into a picture of a data set, hash and all, as a broken renderer would."""
    from generator.files import exr

    file = path / "A" / "0000.exr"
    pixels, header = read_picture(file)
    pixels[0, 0, 0] = np.nan
    header["pixel_hash"] = pixel_hash(pixels)
    exr.write(file, {c: pixels[..., i] for i, c in enumerate("RGB")}, {f"nlos:{k}": v for k, v in header.items()})
    manifest = path / "poses.csv"
    rows = manifest.read_text().splitlines()
    cells = rows[1].split(",")
    cells[11] = header["pixel_hash"]
    manifest.write_text("\n".join([rows[0], ",".join(cells), *rows[2:]]) + "\n")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("features", "nowhere", "-o", "x.h5"), "is not a data set"),
        (("features", "newer", "-o", "x.h5"), "format 99"),
        (("features", "nan", "-o", "x.h5"), "A/0000.exr: holds 1 NaN"),
        (("features", "cut", "-o", "x.h5"), "A/0000.exr: is not a whole EXR picture"),
        (("features", "good", "-o", "/dev/null/x.h5"), "/dev/null/x.h5: cannot be written"),
        (("features", "good", "-o", "x.h5", "--floor", "2"), "0 < floor < ceiling"),
        (("compare", "nowhere.h5", "-o", "x"), "no such features file"),
        (("compare", "good.h5", "other.h5", "-o", "x", "--folds", "2"), "different voxel grids"),
        (("compare", "good.h5", "hog.h5", "-o", "x", "--folds", "2"), "different feature settings (set is global"),
        (("compare", "good.h5", "-o", "x"), "class A has 2 samples, fewer than the 10 folds"),
        (("compare", "good.h5", "-o", "x", "--folds", "1"), "--folds 1"),
        (("compare", "good.h5", "good.h5", "good.h5", "-o", "x"), "one or two"),
        (("train", "good.h5", "-o", "x.skops", "--classifier", "GPT"), "classifier 'GPT': there is none"),
        (("train", "good.h5", "-o", "x.skops"), "class A has 2 samples"),
        (("predict", "nowhere.skops", "good/A/0000.exr"), "no such model file"),
        (("predict", "good.h5", "good/A/0000.exr"), "is not a model file"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(tmp_path, command, arguments, words, broken):
    for source in broken.iterdir():
        (shutil.copytree if source.is_dir() else shutil.copy)(source, tmp_path / source.name)
    before = sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*"))
    result = command("classify", *arguments, cwd=tmp_path)
    assert result.returncode == 2, result.stdout + result.stderr
    assert result.stderr.count("\n") == 1, result.stderr
    assert result.stderr.startswith("error: ")
    assert words in result.stderr
    assert sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*")) == before, "something was left behind"


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    """Data sets and features with one fault each, and a good one."""
    folder = tmp_path_factory.mktemp("broken")
    good = make_dataset(folder / "good", n=2)
    for name in ("newer", "nan", "cut"):
        shutil.copytree(folder / "good", folder / name)
    manifest = folder / "newer" / "dataset.toml"
    manifest.write_text(re.sub(r"^format = \d+", "format = 99", manifest.read_text(), flags=re.MULTILINE))
    with_nan(folder / "nan")
    cut = folder / "cut" / "A" / "0000.exr"
    cut.write_bytes(cut.read_bytes()[:-9])
    other = VoxelGrid(lo=(0.8, 0.4, 0.4), hi=(2.3, 1.9, 2.2), shape=(3, 3, 2))
    feature_table.write(folder / "good.h5", feature_table.extract(good, FeatureSettings()))
    feature_table.write(folder / "hog.h5", feature_table.extract(good, FeatureSettings(set="spatial-hog")))
    feature_table.write(
        folder / "other.h5", feature_table.extract(make_dataset(folder / "o", n=2, grid=other), FeatureSettings())
    )
    return folder


@pytest.mark.parametrize("arguments", [(), ("features",), ("compare",), ("train",), ("predict",)])
def test_help_is_there(command, arguments):
    result = command("classify", *arguments, "--help")
    assert result.returncode == 0
    assert "example" in result.stdout
