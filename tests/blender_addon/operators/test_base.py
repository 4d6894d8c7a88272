"""Of long work there is one at a time, which can be cancelled; bad input is a sentence in the words of the panels."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("bpy", exc_type=ImportError)

from blender_addon.operators import base
from generator.model.errors import NlosError


class _OfWork:
    busy, idle = "It goes on", "It does not"
    work: Any = None
    said_by_poll = ""
    reports: tuple[Any, ...] = ()

    @classmethod
    def job(cls) -> Any:
        return _OfWork.work

    @classmethod
    def poll_message_set(cls, text: str) -> None:
        _OfWork.said_by_poll = text

    def report(self, kinds: set[str], text: str) -> None:
        _OfWork.reports = (*_OfWork.reports, (kinds, text))


class Begins(_OfWork, base.Alone, base.Told):
    """Begins the work."""

    def act(self, context: Any) -> None:
        """Refuse where the context says so."""
        if context:
            raise NlosError(context)


class Ends(_OfWork, base.Cancels):
    """Ends it."""

    said = "It ends"


@pytest.mark.parametrize(("work", "goes_on"), [(None, False), (base.Job("x"), True), ("over", False)])
def test_one_at_a_time(work: Any, goes_on: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if work == "over":
        work = base.Job("done")
        work.running = False
    monkeypatch.setattr(_OfWork, "work", work)
    assert (Begins.poll(None), _OfWork.said_by_poll) == (not goes_on, "It goes on")
    assert (Ends.poll(None), _OfWork.said_by_poll) == (goes_on, "It does not")


def test_it_is_cancelled_and_bad_input_told(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = []
    monkeypatch.setattr(_OfWork, "reports", ())
    monkeypatch.setattr(_OfWork, "work", SimpleNamespace(running=True, cancel=lambda: ended.append(True)))
    assert Ends().execute(None) == {"FINISHED"}
    assert ended == [True]
    assert Begins().execute("") == {"FINISHED"}
    assert Begins().execute("no room; use --engine path") == {"CANCELLED"}
    told = "no room; take the engine path (Rendering > Settings)"
    assert _OfWork.reports == (({"INFO"}, "It ends"), ({"ERROR"}, told))
