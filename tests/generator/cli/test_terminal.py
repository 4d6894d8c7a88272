"""What is said while something takes long: at a terminal a line that changes, in a log a line after some silence."""

from __future__ import annotations

import io
import sys
import time

from generator.cli.terminal import Status


def test_a_log_is_never_silent_for_long(capsys):
    with Status(every=0.1) as status:
        status.tell("rendering: the reference")
        status.progress(3, 27)
        time.sleep(0.5)
        status.tell("done")
    first, *between, last = capsys.readouterr().out.splitlines()
    assert (first, last) == ("rendering: the reference", "done")
    assert 2 <= len(between) <= 5
    assert set(between) == {"... rendering, 3 of 27 pictures, 0:00"}


def test_a_log_of_quick_steps_has_no_more_lines_than_steps(capsys):
    with Status(every=5.0) as status:
        for number in range(3):
            status.tell(f"step {number}")
    assert capsys.readouterr().out.splitlines() == ["step 0", "step 1", "step 2"]


def test_a_terminal_keeps_one_line_and_clears_it(monkeypatch, capsys):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    with Status() as status:
        status.tell("rendering")
        time.sleep(1.5)
    assert capsys.readouterr().out == "rendering\n"
    assert "rendering, 0:01" in screen.getvalue()
    assert "\n" not in screen.getvalue()
    assert screen.getvalue().endswith("\r\x1b[K")
