"""What was learnt is not tested on."""

import numpy as np
import pytest

from classify.pictures.leak import refuse_shared, shared_poses
from generator.model.errors import NlosError


def positions(seed, n=50):
    return np.random.default_rng(seed).random((n, 3))


def test_shared_poses_are_counted():
    first, other = positions(0), positions(1)
    assert shared_poses(first, other) == 0
    assert shared_poses(first, first[::5] + 1e-9) == 10
    assert shared_poses(first, first + 1e-5) == 0
    none = np.zeros((0, 3))
    assert shared_poses(none, other) == shared_poses(other, none) == 0


def test_the_refusal_names_both():
    places = positions(2)
    with pytest.raises(NlosError, match=r"b: 7 of its 50 poses are also in a, .* another --seed"):
        refuse_shared(places[:7], places, "a", "b")
    refuse_shared(places[:25], places[25:], "a", "b")
