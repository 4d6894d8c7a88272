"""Intervals over poses against SciPy's, which are exact or published."""

import math

import numpy as np
import pytest
from scipy import stats

from generator.measure import intervals, student


def test_the_medians_ends_lie_between_order_statistics():
    """The exact interval of whole ranks is the narrowest that holds at least 95 %; the next narrower holds less."""
    values = np.sort(np.random.default_rng(0).normal(size=40))
    value, low, high = intervals.median(values)
    exact = stats.quantile_test(values, q=0.0, p=0.5).confidence_interval(0.95)
    first, last = np.searchsorted(values, exact)
    assert value == np.median(values)
    assert exact.low <= low <= values[first + 1]
    assert values[last - 1] <= high <= exact.high


@pytest.mark.parametrize("count", [9, 90])
def test_the_median_is_held(count):
    rng = np.random.default_rng(1)
    held = sum(
        low <= 1.0 <= high for _, low, high in (intervals.median(np.exp(rng.normal(size=count))) for _ in range(300))
    )
    least, most = stats.binom.ppf([0.001, 0.999], 300, [0.93, 0.97])
    assert least <= held <= most


def test_five_values_have_no_ends_and_one_no_error():
    assert intervals.median(np.arange(5.0)) == (2.0, -math.inf, math.inf)
    assert np.isfinite(intervals.median(np.arange(6.0))).all()
    assert intervals.mean(np.ones(1)) == (1.0, -math.inf, math.inf)


def test_the_mean_is_students():
    values = np.random.default_rng(2).gamma(2.0, size=12)
    exact = stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert intervals.mean(values) == pytest.approx((values.mean(), exact.low, exact.high))


def test_student_without_scipy():
    for freedom in (1, 2, 3, 7, 10, 11, 15, 30, 1000):
        assert student.quantile(freedom) == pytest.approx(stats.t.ppf(0.975, freedom), rel=1e-3)


def test_an_error_of_few_poses_is_held():
    """Poses whose errors differ tenfold, over four rounds of nine: Student's own holds the truth in 93 of 100."""
    held, truth = 0, math.exp(0.25)
    for draw in range(300):
        rng = np.random.default_rng([5, draw])
        value, low, high = intervals.relative(np.exp(rng.normal(size=(4, 9))), np.ones((4, 9)))
        assert low <= value <= high
        held += low <= truth <= high
    least, most = stats.binom.ppf([0.001, 0.999], 300, [0.945, 0.97])
    assert least <= held <= most


def test_a_symmetric_error_has_students_interval():
    """Two rounds are never skewed, and a mean of pairs about it is not."""
    for shape in ((2, 3), (6, 1)):
        square = 1.0 + 0.1 * np.resize([-1.0, 1.0], shape[0])[:, None] * np.ones(shape)
        exact = stats.ttest_1samp(square.mean(axis=1), 0.0).confidence_interval(0.95)
        _, low, high = intervals.relative(square, np.ones(shape))
        assert (max(low, 0.0) ** 2, high**2) == pytest.approx((max(exact.low, 0.0), exact.high))
