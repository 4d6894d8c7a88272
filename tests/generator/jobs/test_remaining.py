"""The time that is left: silent after one picture, right once it is said."""

from __future__ import annotations

import json

import pytest

from generator.cli.terminal import LineProgress
from generator.jobs import journal
from generator.jobs.remaining import Remaining


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def told(finished, total):
    """Return what is said after each of the pictures that are finished at some times."""
    clock = Clock()
    remaining, said = Remaining(clock), []
    for done, clock.now in enumerate(finished, start=1):
        said.append(remaining.told(done, total))
    return said


@pytest.mark.parametrize("start", [0.0, 5.0, 60.0])
@pytest.mark.parametrize("each", [0.1, 2.0, 600.0])
def test_one_worker_with_a_slow_start(start, each):
    total = 2000
    said = told([start + each * k for k in range(1, total + 1)], total)
    assert said[:3] == [None, None, None], "the start was taken for a picture's time"
    for done, left in enumerate(said, start=1):
        if left is not None:
            assert left == pytest.approx(each * (total - done), rel=1e-6, abs=1e-6)
    assert said[-1] == 0.0


def test_many_workers_whose_first_pictures_come_at_once():
    """64 pictures within a second, then as many every 100 s: a rate of the first burst is wrong by 100 times."""
    total, each, crew = 6400, 100.0, 64
    finished = [each * (1 + k // crew) + k % crew / crew for k in range(total)]
    for done, left in enumerate(told(finished, total), start=1):
        if left is not None:
            assert left == pytest.approx((total - done) * each / crew, rel=0.6, abs=2.0 * each), done


def test_nothing_is_said_of_what_stands_still():
    clock = Clock()
    remaining = Remaining(clock)
    for clock.now in range(1, 100):
        assert remaining.told(0, 10) is None
        assert Remaining(clock).told(1, 10) is None


def test_the_first_line_says_no_time(capsys):
    show = LineProgress(every=0.0)
    show(0, 900)
    show(1, 900)
    assert capsys.readouterr().out.splitlines() == ["0 of 900 pictures", "1 of 900 pictures"]


@pytest.mark.parametrize(
    ("fields", "rate"),
    [
        ({"done": 1, "seconds": 13.0, "first": 1, "first_seconds": 13.0}, 0.0),
        ({"done": 3, "seconds": 40.0, "first": 1, "first_seconds": 13.0}, 0.0),
        ({"done": 28, "seconds": 40.0, "first": 1, "first_seconds": 13.0}, 1.0),
        ({"done": 28, "seconds": 56.0, "state": journal.ENDED}, 0.5),
        ({"done": 28, "seconds": 56.0}, 0.0),  # of an older version
    ],
)
def test_status_says_no_rate_before_it_is_known(fields, rate):
    state = journal.State("here", 1, total=900, **fields)
    assert state.rate == pytest.approx(rate)
    assert journal.State.read(json.dumps(vars(state))) == state
