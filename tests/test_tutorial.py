"""The tutorial's commands, run one after the other, print what the page shows."""

from __future__ import annotations

import pytest
import tutorial


@pytest.mark.slow
def test_commands_print_what_the_page_shows(tmp_path, monkeypatch):
    pytest.importorskip("bpy", reason="the tutorial builds a scene", exc_type=ImportError)
    monkeypatch.chdir(tmp_path)
    shell = tutorial.Shell()
    for kind, source, shown in tutorial.parts(tutorial.PAGE.read_text(encoding="utf-8")):
        if kind != "text":
            printed = shell.run(kind, source)
            assert tutorial.alike(shown, printed), f"{source}the page shows\n{shown}and it prints\n{printed}"


def test_the_readme_shows_what_the_tutorial_shows():
    """So that its commands are run too."""
    readme = (tutorial.ROOT / "README.md").read_text(encoding="utf-8")
    shown, run = (
        {source: printed for block, source, printed in tutorial.parts(page) if block == "console"}
        for page in (readme, tutorial.PAGE.read_text(encoding="utf-8"))
    )
    assert len(shown) == 5
    assert shown == {source: run[source] for source in shown}


def test_a_page_is_all_its_parts():
    page = tutorial.PAGE.read_text(encoding="utf-8")
    assert "".join(source + shown for _, source, shown in tutorial.parts(page)) == page


@pytest.mark.parametrize(
    ("shown", "printed", "expected"),
    [
        ("9 pictures, 1.00 %\n", "9  pictures, 1.04 %\n", True),
        ("9 pictures, 1.00 %\n", "9 pictures, 1.10 %\n", False),
        ("9 pictures\n", "8 pictures\n", False),
        ("check, [...]\n", "check, 5.4 s: well\n", True),
        ("check, [...]\n", "chuck, 5.4 s: well\n", False),
        ("one\n", "one\ntwo\n", False),
        ("A: A  A 98.4% D 1.6%\n", "A: D  D 98.4% A 1.6%\n", False),
    ],
)
def test_what_counts_as_alike(shown, printed, expected):
    assert tutorial.alike(shown, printed) is expected
