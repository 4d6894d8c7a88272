"""Intervals hold the truth as often as they say, also where pictures share something: 300 draws of each.

All cases, and more draws: benchmarks/interval_coverage.py.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal, stats

from classify import intervals
from classify.classifiers.evaluate import as_best, rivals

DRAWS = 300
MEDIAN = stats.norm.ppf(0.75)


def held(draw, truth):
    """How many intervals of 300 hold the truth."""
    found = [draw(np.random.default_rng([11, k])) for k in range(DRAWS)]
    return sum(i.low <= truth <= i.high for i in found)


def within(count, low=0.93, high=0.975):
    """Whether that many of 300 are 93 to 97.5 %, up to what happens once in a thousand."""
    least, most = stats.binom.ppf([0.001, 0.999], DRAWS, [low, high])
    return least <= count <= most


def shared(rng, groups, correlation):
    """Normal variables with a correlation within groups."""
    common = rng.normal(size=groups.max() + 1)[groups]
    return np.sqrt(correlation) * common + np.sqrt(1.0 - correlation) * rng.normal(size=len(groups))


def walk(rng, count, correlation=0.82):
    """Normal variables, each correlated with the one before as the errors of a tracked walk are."""
    steps = np.sqrt(1.0 - correlation**2) * rng.normal(size=count + 100)
    return signal.lfilter([1.0], [1.0, -correlation], steps)[100:]


@pytest.mark.parametrize("correlation", [0.0, 0.3])
def test_pictures_that_share_a_background(correlation):
    groups = np.arange(900) % 50

    def true(rng):
        return shared(rng, groups, correlation) < stats.norm.ppf(0.9)

    assert within(held(lambda rng: intervals.share(true(rng), groups), 0.9))
    assert within(held(lambda rng: intervals.median(np.abs(shared(rng, groups, correlation)), groups), MEDIAN))
    if correlation:
        assert held(lambda rng: intervals.share(true(rng)), 0.9) < 0.8 * DRAWS, "as if they were independent"


def test_false_alarms_that_share_a_background():
    """One in a hundred; as many background frames as frames make the correlation a half."""
    groups, threshold = np.arange(1000) % 50, stats.norm.isf(0.01)
    assert within(held(lambda rng: intervals.exceedance(shared(rng, groups, 0.5), threshold, groups), 0.01))
    none = intervals.exceedance(np.random.default_rng(0).normal(size=1000), 9.0, groups)
    assert (none.value, none.low) == (0.0, 0.0)
    assert 0.003 < none.high < 0.01


def test_few_pictures_whose_answers_nearly_agree():
    groups = np.tile(np.arange(27), 5)
    assert within(held(lambda rng: intervals.share(shared(rng, groups, 0.9) < stats.norm.ppf(0.9), groups), 0.9))


@pytest.mark.parametrize(("count", "right"), [(100, 0.9), (400, 0.98)])
def test_a_walk_with_one_error_that_lasts(count, right):
    """Every walk in fifteen has none, and must not be taken for a proof that there is none."""
    found = held(lambda rng: intervals.share_of_walk(walk(rng, count) < stats.norm.ppf(right)), right)
    assert within(found, 0.95, 0.985)


@pytest.mark.parametrize("count", [40, 200])
def test_frames_of_a_walk(count):
    assert within(held(lambda rng: intervals.share_of_walk(walk(rng, count) < 0.0), 0.5), 0.92, 0.98)
    assert within(held(lambda rng: intervals.median_of_walk(np.abs(walk(rng, count))), MEDIAN), 0.92, 0.98)
    assert held(lambda rng: intervals.share(walk(rng, count) < 0.0), 0.5) < 0.7 * DRAWS, "as if independent"


def test_nothing_wrong_is_not_certainty():
    for found in (
        intervals.share_of_walk(np.ones(100, dtype=bool)),
        intervals.share(np.ones(100, dtype=bool), np.arange(100) % 10),
        intervals.share(np.ones(100, dtype=bool)),
    ):
        assert found.value == found.high == 1.0
        assert 0.75 < found.low < 0.99


def test_five_lengths_have_no_upper_end():
    found = intervals.median(np.array([0.01, 0.02, 0.03, 0.04, 0.05]))
    assert (found.value, found.low) == (0.03, 0.0)
    assert found.centimetres() == "3.00 cm (0.00 to any)"


def test_groups_of_one_are_independent_pictures():
    right = np.arange(20) < 13
    assert intervals.share(right, np.arange(20)) == intervals.share(right)


def test_two_classifiers_differ_where_the_same_pictures_say_so():
    def draw(rng):
        common = np.sqrt(0.7) * rng.normal(size=900)
        one, other = (common + np.sqrt(0.3) * rng.normal(size=900) < 1.0 for _ in range(2))
        return intervals.paired_difference(one, other)

    assert within(held(draw, 0.0))
    right = np.arange(900) % 10 < 8
    better = right | (np.arange(900) % 50 == 9)  # 2 % more, and never less
    slightly = right | (np.arange(900) == 9)
    results = [
        SimpleNamespace(effect=1.0, scenario="sheet", right=r) for r in (better, right, slightly, better.copy())
    ]
    results.append(SimpleNamespace(effect=1.0, scenario="sphere", right=better))
    assert rivals(results, results[0])[0] is results[3]
    assert len(rivals(results, results[0])) == 1, "neither is worse, nor of another scenario"
    assert rivals(results[1:3], results[2])[0] is results[1]


def test_the_best_of_many_is_chosen_by_the_same_pictures():
    """Fourteen that are equally good: none is told apart, and the best's interval holds what all of them reach."""
    told, covered, plain = 0, 0, 0
    for draw in range(DRAWS):
        rng = np.random.default_rng([13, draw])
        common = np.sqrt(0.7) * rng.normal(size=200)
        right = common + np.sqrt(0.3) * rng.normal(size=(14, 200)) < stats.norm.ppf(0.7)
        results = [SimpleNamespace(effect=1.0, scenario="sheet", right=r) for r in right]
        best = results[right.mean(axis=1).argmax()]
        told += len(rivals(results, best)) < 13
        covered += (found := as_best(best.right, among=14)).low <= 0.7 <= found.high
        alone = intervals.share(best.right)
        plain += alone.low <= 0.7 <= alone.high
    assert within(DRAWS - told, 0.95, 0.99)
    assert within(covered, 0.95, 0.985)
    assert plain < 0.9 * DRAWS, "as if it had not been chosen"
