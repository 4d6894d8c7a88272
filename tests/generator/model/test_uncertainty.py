"""What is not known exactly: how it is written, and that its draws have the stated joint distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from generator.files.toml import to_dict
from generator.files.uncertainty_file import plain_values, read_uncertainty, write_uncertainty
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.uncertainty import NAMES, RELATIVE, Furniture, Uncertainty, mean_of, offsets
from generator.transport.parameters import OFFSETS

SCENE = to_dict(preset("corridor", "sphere"))
TEXT = 'version = 1\nnames = ["spot.aim.x", "target.size"]\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TEXT, "deviation: has 0 values for 2 names"),
        (TEXT + "deviation = [0.02, 0.0]", "that of target.size is 0; it must be above 0"),
        (TEXT.replace("size", "siz") + "deviation = [0.02, 0.1]", r"did you mean target\.size\?"),
        (TEXT.replace("target.size", "spot.aim.x") + "deviation = [0.02, 0.1]", "spot.aim.x is given twice"),
        (TEXT + "deviation = [0.02, 0.1]\ncorrelation = [[1.0, 0.2]]", "must be 2 rows of 2 values"),
        (TEXT + "deviation = [0.02, 0.1]\ncorrelation = [[1.0, 0.2], [0.3, 1.0]]", "must be symmetric"),
        (TEXT + "deviation = [0.02, 0.1]\ncorrelation = [[1.0, 1.2], [1.2, 1.0]]", "is of no joint distribution"),
        (TEXT.replace("1", "2") + "deviation = [0.02, 0.1]", "version: 2 must be one of 1"),
        ("version = 1", "nothing is uncertain"),
        ("[furniture]\nboxes = [3, 1]", r"furniture.boxes: \[3, 1\] must run from low to high"),
        ("[furniture]\nalbedo = [0.2, 1.5]", r"albedo: \(0.2, 1.5\) must be from 0 to 1|must be from 0 to 1"),
        ("[furniture]\nboxs = [1, 3]", r"furniture.boxs: no such field"),
    ],
)
def test_what_cannot_be_is_one_sentence(tmp_path, text, words):
    path = tmp_path / "uncertainty.toml"
    path.write_text(text)
    with pytest.raises(NlosError, match=words) as raised:
        read_uncertainty(path)
    assert str(raised.value).startswith(str(path))
    assert "\n" not in str(raised.value)


def test_a_file_is_read_as_it_was_written(tmp_path):
    covariance = np.array([[4e-4, 1e-3], [1e-3, 0.01]])
    known = Uncertainty.of_covariance(["spot.aim.x", "target.size"], covariance)
    np.testing.assert_allclose(known.covariance, covariance, rtol=1e-12)
    for one in (known, Uncertainty(furniture=Furniture(boxes=(1, 2)))):
        write_uncertainty(tmp_path / "u.toml", one)
        assert read_uncertainty(tmp_path / "u.toml") == one
        assert plain_values(one)["version"] == 1


def test_the_names_are_those_of_worlds():
    assert set(NAMES) == set(OFFSETS)
    assert set(RELATIVE) == {name for name, unit in OFFSETS.items() if unit == "relative"}


def test_draws_are_jointly_normal_about_the_scene():
    covariance = np.array([[4e-4, 2e-4, 0.0], [2e-4, 4e-4, 5e-4], [0.0, 5e-4, 0.0025]])
    names = ["spot.aim.x", "camera.view.z", "target.size"]
    stated = Uncertainty.of_covariance(names, covariance)
    drawn = [stated.draw(SCENE, 3, voxel, index) for voxel in range(9) for index in range(200)]
    rows = np.array([[offsets(SCENE, values)[name] for name in names] for values in drawn])
    white = np.linalg.solve(np.linalg.cholesky(covariance), rows.T)
    assert stats.kstest(white.ravel(), "norm").pvalue > 1e-3
    assert np.abs(np.cov(white) - np.eye(3)).max() < 0.15
    assert stated.draw(SCENE, 3, 4, 5) == stated.draw(SCENE, 3, 4, 5)
    others = [stated.draw(SCENE, *place) for place in ((4, 4, 5), (3, 5, 5), (3, 4, 6))]
    others += [stated.draw(SCENE, 3, 4, 5, stream=1), stated.draw(SCENE, 3, 4, 5, attempt=1)]
    assert len({stated.draw(SCENE, 3, 4, 5), *others}) == 6


def test_what_is_not_physical_is_drawn_again():
    """The preset's sphere reflects all light, so its albedo can only be less: half of a normal distribution."""
    stated = Uncertainty(names=("target.albedo",), deviation=(0.2,))
    drawn = np.array([stated.draw(SCENE, 0, 0, index)[0][1] for index in range(1000)])
    assert drawn.max() <= 1.0
    assert stats.kstest((1.0 - drawn) / 0.2, "halfnorm").pvalue > 1e-3
    hopeless = Uncertainty(names=("room.albedo", "wall.albedo"), deviation=(1e6, 1e6))
    with pytest.raises(NlosError, match="none that is physical"):
        hopeless.draw(SCENE, 0, 0, 0)


def test_a_scene_without_a_value_is_refused():
    scene = {**SCENE, "target": {"kind": "mesh", "size": 1.0}}
    with pytest.raises(NlosError, match=r"target\.albedo has no single value"):
        Uncertainty(names=("target.albedo",), deviation=(0.1,)).check(scene)
    assert mean_of(SCENE, "camera.view.x") == pytest.approx(-1.4)
    assert mean_of(SCENE, "target.size") == 1.0
