"""What was learnt is not tested on."""

import numpy as np
import pytest

from classify.pictures.leak import refuse_shared, shared_poses
from generator.model.errors import NlosError


def poses(seed, n=50):
    rng = np.random.default_rng(seed)
    return rng.random((n, 3)), 90.0 * rng.random((n, 3))


def test_shared_poses_are_counted():
    (first, turns), other = poses(0), poses(1)
    assert shared_poses((first, turns), other) == 0
    assert shared_poses((first, turns), (first[::5] + 1e-9, turns[::5])) == 10
    moved = turns.copy()
    moved[0] += 0.01
    assert shared_poses((first, turns), (first, moved)) == 49, "another rotation is another pose"
    none = np.zeros((0, 3)), np.zeros((0, 3))
    assert shared_poses(none, other) == shared_poses(other, none) == 0


def test_the_refusal_names_both():
    (first, turns) = poses(2)
    with pytest.raises(NlosError, match=r"b: 7 of its 50 poses are also in a, .* another --seed"):
        refuse_shared((first[:7], turns[:7]), (first, turns), "a", "b")
    refuse_shared((first[:25], turns[:25]), (first[25:], turns[25:]), "a", "b")
