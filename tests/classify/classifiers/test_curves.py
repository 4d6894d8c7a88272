"""Learning curves: what they count, and what they refuse."""

from __future__ import annotations

from dataclasses import replace

import joblib
import numpy as np
import pytest
from classify_helpers import make_dataset
from figure_texts import misplaced
from scipy.stats import norm

from classify.classifiers import curves
from classify.cli import main
from classify.pictures import feature_table
from classify.pictures.settings import FeatureSettings
from generator.model.errors import NlosError


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    return feature_table.extract(make_dataset(tmp_path_factory.mktemp("l") / "d", n=4), FeatureSettings())


@pytest.fixture(autouse=True)
def one_process():
    with joblib.parallel_config(backend="sequential"):
        yield


def two_clouds(rendered, count, seed, distance=2.0):
    """Features of two classes, normal in five directions and a distance apart in one."""
    rng = np.random.default_rng(seed)
    second = np.arange(count) % 2 == 1
    values = rng.normal(size=(count, 5))
    values[:, 0] += distance * second
    places = {"positions": rng.random((count, 3)), "rotations": np.zeros((count, 3))}
    kept = {"labels": np.where(second, "B", "A"), "voxels": second.astype(int), "values": values, **places}
    provenance = {**rendered.provenance, "fingerprint": str(seed)}
    return replace(rendered, **kept, files=[str(i) for i in range(count)], provenance=provenance)


def test_a_classifier_learns_what_can_be_known(rendered):
    points = curves.curves(
        two_clouds(rendered, 3000, 0), two_clouds(rendered, 4000, 1), classifiers=["LDA", "MLP"], counts=[10, 3000]
    )
    assert [(p.classifier, p.count) for p in points] == [("LDA", 10), ("MLP", 10), ("LDA", 3000), ("MLP", 3000)]
    best = norm.cdf(1.0)  # of two normal variables 2 apart
    for point in points[2:]:
        assert abs(point.accuracy.value - best) < 0.025  # four standard errors of 4000 answers
    assert points[0].accuracy.value < points[2].accuracy.value - 0.02
    assert len(curves.rows(points)) == 4
    assert all(1_000 < point.size < 1_000_000 for point in points)


def test_what_was_learnt_is_not_tested_on(rendered):
    """The same poses, seen again with other noise, say nothing of other poses."""
    train, test = two_clouds(rendered, 300, 0), two_clouds(rendered, 400, 1)
    positions = test.positions.copy()
    positions[7] = train.positions[3]
    with pytest.raises(NlosError, match=r"b\.h5: 1 of its 400 poses are also in a\.h5"):
        curves.curves(train, replace(test, positions=positions), classifiers=["LDA"], names=("a.h5", "b.h5"))


def test_fewer_are_among_the_more_and_have_all_classes(rendered):
    features = two_clouds(rendered, 100, 2)
    order, held = curves._order(features, 0, hold=True)
    assert len(held) == 20
    assert sorted([*order, *held]) == list(range(100))
    for count in (2, 10, 50):
        assert (features.labels[order[:count]] == "A").sum() == count // 2


@pytest.mark.parametrize(
    ("counts", "words"),
    [([3], "3 pictures: training set has 80 to train on, and 2 classes need 2 each"), ([81], "81 pictures")],
)
def test_numbers_that_cannot_be(rendered, counts, words):
    with pytest.raises(NlosError, match=words):
        curves.curves(two_clouds(rendered, 100, 3), counts=counts)


def test_a_set_is_not_tested_on_itself(rendered):
    features = two_clouds(rendered, 100, 4)
    with pytest.raises(NlosError, match="shows the pictures of training set"):
        curves.curves(features, features)


def test_from_the_shell(rendered, tmp_path, capsys, drawn):
    feature_table.write(tmp_path / "a.h5", rendered)
    out = tmp_path / "learned"
    command = ["learn", str(tmp_path / "a.h5"), "-o", str(out), "--classifiers", "NB", "KNN", "--counts", "18", "27"]
    assert main.main(command) == 0
    told = capsys.readouterr().out
    assert "is right most often" in told
    assert "of it, held out" in " ".join(told.split())
    assert {p.name for p in out.iterdir()} == {"learn.csv", "learn.png", "learn.svg", "report.html"}
    assert misplaced(drawn[0]) == []
    assert (out / "learn.csv").read_text().splitlines()[0] == ",".join(curves.HEADINGS).replace(
        "answer, each", '"answer, each"'
    )
    with pytest.raises(SystemExit, match="2"):
        main.main([*command[:4], "--classifiers", "GPT"])
    assert "--classifiers 'GPT': there is none; choose from LR" in capsys.readouterr().err
