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
            assert tutorial.alike(kind, shown, printed), f"{source}the page shows\n{shown}and it prints\n{printed}"


def test_the_readme_shows_what_the_tutorial_shows():
    """So that its commands are run too."""
    readme = (tutorial.ROOT / "README.md").read_text(encoding="utf-8")
    shown, run = (
        {source: printed for block, source, printed in tutorial.parts(page) if block.startswith("console")}
        for page in (readme, tutorial.PAGE.read_text(encoding="utf-8"))
    )
    assert len(shown) == 5
    assert shown == {source: run[source] for source in shown}


def test_a_page_is_all_its_parts():
    page = tutorial.PAGE.read_text(encoding="utf-8")
    assert "".join(source + shown for _, source, shown in tutorial.parts(page)) == page


@pytest.mark.parametrize(
    ("kind", "shown", "printed", "expected"),
    [
        ("console", "9 pictures, 1.00 %\n", "9  pictures, 1.04 %\n", True),
        ("console", "9 pictures, 1.00 %\n", "9 pictures, 1.10 %\n", False),
        ("console", "9 pictures\n", "8 pictures\n", False),
        ("console", "check, [...]\n", "check, 5.4 s: well\n", True),
        ("console", "check, [...]\n", "chuck, 5.4 s: well\n", False),
        ("console", "one\n", "one\ntwo\n", False),
        ("console random", "A: A  A 98.4% D 1.6%\n", "A: A  A 91.1% C 8.9%\n", True),
        ("console random", "A: A  A 98.4% D 1.6%\n", "A: D  D 91.1% C 8.9%\n", False),
        ("console random", "│ all │ 36 │ 91.7 % │\n", "│ all │ 36 │ 80.6 % │\n", True),
        ("console random", "│ all │ 36 │ 91.7 % │\n", "│ all │ 36 │ 30.6 % │\n", False),
    ],
)
def test_what_counts_as_alike(kind, shown, printed, expected):
    assert tutorial.alike(kind, shown, printed) is expected
