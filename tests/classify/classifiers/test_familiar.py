"""What a classifier has learnt from is familiar to it, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from classify.classifiers.familiar import FEWEST, Familiar
from classify.tail import Tail, more_than_chance


def drawn(count, seed, *, features=40, voxels=9):
    """Features on a curved surface of three dimensions, with noise, as those of pictures are."""
    shape = np.random.default_rng(0).normal(size=(6, features))
    rng = np.random.default_rng(seed)
    places = rng.uniform(size=(count, 3))
    curved = np.concatenate([places, places**2], axis=1) @ shape
    return curved + 0.05 * rng.normal(size=curved.shape), np.floor(places[:, 0] * voxels).astype(int).astype(str)


def test_probabilities_are_true():
    """For pictures like those of the training, each is as rare as it says."""
    familiar = Familiar.of(*drawn(4000, 1))
    found = np.array([familiar.probability(row) for row in drawn(500, 2)[0]])
    assert stats.kstest(found, "uniform").pvalue > 1e-4
    assert not more_than_chance(found, 1e-4)[1]


@pytest.mark.parametrize("change", [lambda x: 1.5 * x, lambda x: x[:, ::-1], np.sqrt, lambda x: x + 1.0])
def test_what_it_has_not_seen_is_told(change):
    familiar = Familiar.of(*drawn(900, 1))
    with np.errstate(invalid="ignore"):
        others = np.nan_to_num(change(drawn(200, 2)[0]))
    found = np.array([familiar.probability(row) for row in others])
    assert np.mean(found < 0.01) > 0.5
    assert more_than_chance(found, 1e-4)[1]


def test_what_is_familiar_is_kept():
    familiar = Familiar.of(*drawn(200, 1))
    again = Familiar.from_arrays(familiar.arrays(), 40)
    row = drawn(1, 2)[0][0]
    assert again.probability(row) == familiar.probability(row)
    for name, value in familiar.arrays().items():
        for broken in (value * np.nan, *([] if name == "known" else [value[..., :-1]])):
            with pytest.raises(ValueError, match="familiar"):
                Familiar.from_arrays({**familiar.arrays(), name: broken}, 40)


def test_of_few_pictures_nothing_is_said():
    assert Familiar.of(*drawn(FEWEST - 1, 1)) is None


def test_constant_features_are_no_trouble():
    """Features that never vary, and pictures that are all the same within a voxel."""
    values, labels = drawn(100, 1)
    values[:, :5] = 3.0
    assert 0.0 <= Familiar.of(values, labels).probability(values[0]) <= 1.0
    same = np.repeat(np.eye(4), 25, axis=0)
    found = Familiar.of(same, np.repeat(list("ABCD"), 25)).probability(same[0])
    assert 0.0 <= found <= 1.0


def test_a_tail_goes_on_beyond_what_was_observed():
    """Against the exponential distribution, whose tail is known."""
    tail = Tail(np.random.default_rng(0).exponential(size=5000))
    for value in (1.0, 3.0, 6.0, 9.0):
        assert np.log10(tail.exceeded(value)) == pytest.approx(-value / np.log(10.0), abs=0.6)
    assert tail.exceeded(-1.0) == 1.0
