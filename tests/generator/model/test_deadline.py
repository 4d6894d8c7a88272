"""Spans of time by a clock that stands still until it is set."""

from __future__ import annotations

import math

import pytest

from generator.model.deadline import Deadline, Late


def test_a_span_ends_and_can_be_extended():
    now = [10.0]
    deadline = Deadline(4.0, lambda: now[0])
    half = deadline.part(0.5)
    now[0] = 12.5
    assert (deadline.left, half.left) == (1.5, 0.0)
    deadline.check()
    with pytest.raises(Late):
        half.check()
    now[0] = 15.0
    with pytest.raises(Late):
        deadline.check()
    deadline.extend(2.0)
    assert deadline.left == 1.0
    assert Deadline().part(0.3).left == math.inf
