"""The estimate of the error of a room's cells: against much smaller cells, and what is said of it."""

import numpy as np
import pytest
from worlds import HIGH, room

from generator.measure import light_check
from generator.transport import Transport
from generator.transport.light import change, field

CLEAR, LYING, REFUSED = (
    ((0.8, 1.1, 0.3), (0.0, 0.0, 30.0)),
    ((0.9, 0.8, 0.02 - HIGH), (90.0, 0.0, 20.0)),
    ((0.8, 0.0, 0.3), (0.0, 0.0, 0.0)),
)


@pytest.fixture(scope="module")
def usual():
    """An engine with cells as they are."""
    return Transport(room(order=6), accuracy=1e-2)


@pytest.fixture(scope="module")
def half():
    """An engine with cells of half the size."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(field, "_CELL", field._CELL / 2.0)
        return Transport(room(order=6), accuracy=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("pose", [CLEAR, LYING])
def test_the_estimate_is_of_the_size_of_the_error(usual, half, pose):
    """Against cells of half the size; the lines' own error is in the difference too."""
    made, fine = (engine.render(*pose) for engine in (usual, half))
    parts = (fine.added - fine.hidden, fine.further)
    size = np.sqrt(sum((part**2).mean() for part in parts))
    error = np.sqrt(((made.further - fine.further) ** 2).mean()) / size
    estimate = usual.light_error(*pose)
    assert 0.0 < estimate < 0.2
    assert error < 2.0 * estimate + 1e-2


def test_the_error_by_lines_is_told_where_the_most_of_them_do_not_settle_it(usual, monkeypatch):
    """And is of the size of the difference from more lines."""
    settled = usual.render(*CLEAR)
    assert settled.report["lines_error"] <= change._SURE * usual.accuracy
    monkeypatch.setattr(change, "_LINES", 1 << 11)
    monkeypatch.setattr(change, "_MOST_LINES", 1 << 11)
    made = usual.render(*CLEAR)
    assert made.report["lines"] == {"lamp": 1 << 11}
    size = np.sqrt(((made.added - made.hidden) ** 2).mean() + (made.further**2).mean())
    off = np.sqrt(((made.further - settled.further) ** 2).mean()) / size
    assert change._SURE * usual.accuracy < made.report["lines_error"] < usual.light_error(*CLEAR)
    assert made.report["lines_error"] / 4.0 < off < 4.0 * made.report["lines_error"]


def test_some_poses_are_looked_at_and_those_that_are_refused_are_left_out():
    engine = Transport(room(order=4), accuracy=3e-2)
    found = light_check.look(engine, [REFUSED, *[CLEAR] * 9, *[REFUSED] * 8])
    assert found["poses"] == 4
    assert found["median"] == found["worst"] == pytest.approx(engine.light_error(*CLEAR))
    assert found["asked"] == 3e-2
    assert found["words"].startswith("light check: at 4 poses light of many reflections errs by ")
    assert found["words"].endswith("asked: 3 %")


def test_nothing_is_said_where_no_light_is_followed_from_cell_to_cell():
    assert light_check.look(Transport(room(order=3), accuracy=1e-2), [CLEAR]) == {}
    assert light_check.look(Transport(room(order=4), accuracy=3e-2), [REFUSED]) == {}
    assert Transport(room(order=3), accuracy=1e-2).light_error(*CLEAR) == 0.0
