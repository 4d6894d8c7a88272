"""While nothing is answered yet, the panel says what is waited for, and for how long."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("bpy", exc_type=ImportError)

from blender_addon.view import live_answer


def told(monkeypatch: pytest.MonkeyPatch, about: str, *, ended: bool = False, **fields: Any) -> list[str]:
    resident: Any = SimpleNamespace(about=about, ended=ended, words="It has ended")
    monkeypatch.setattr(live_answer, "_live", live_answer._Live(resident=resident, **fields))
    return live_answer.words()


def test_each_wait_has_its_words(monkeypatch: pytest.MonkeyPatch) -> None:
    now = time.monotonic()
    [starting] = told(monkeypatch, "", begun=now - 7.5)
    assert "starts and reads the model: 7 s" in starting
    assert live_answer.waits()
    assert told(monkeypatch, "It answers")[1] == "Waiting for the first whole picture of the look"
    assert told(monkeypatch, "It answers", asked=3, answered=2, at=now - 4.5)[1] == "Waiting for the answer: 4 s"
    assert told(monkeypatch, "It answers", asked=3, answered=2, at=now) == ["It answers"]
    assert told(monkeypatch, "It answers", asked=3, answered=3, words=["doubt"]) == ["It answers", "doubt"]
    assert told(monkeypatch, "", ended=True) == ["It has ended"]
