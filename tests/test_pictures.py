"""Pictures of the pages: drawn from the files in ``docs/data`` as these are now, with texts that can be read."""

from __future__ import annotations

import sys

import pytest
from conftest import ROOT
from figure_texts import misplaced
from PIL import Image

from generator.measure import figures

sys.path.append(str(ROOT / "benchmarks"))
import pictures

FOLDER = ROOT / "docs" / "pictures"
BY_COMMANDS = {"bound-sphere", "detect-sheet", "sensor", "track", "tutorial-differences"}
"""Drawn by a command from an atlas, a walk or a data set, which would be too large to keep."""
DRAWN = sorted(pictures.PICTURES)
in_sources = pytest.mark.skipif(not FOLDER.is_dir(), reason="a source distribution has no pictures")


@in_sources
def test_every_picture_is_drawn_from_a_file_or_by_a_command():
    assert {file.stem for file in FOLDER.glob("*.png")} == {*DRAWN, *BY_COMMANDS}
    pages = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").rglob("*.md"))
    assert [file.name for file in FOLDER.iterdir() if f"pictures/{file.name}" not in pages] == []


@in_sources
@pytest.mark.parametrize("name", DRAWN)
def test_no_file_has_changed_since_its_picture_was_drawn(name):
    file = pictures.DATA / f"{pictures.PICTURES[name].data}.csv"
    with Image.open(FOLDER / f"{name}.png") as picture:
        assert picture.text["Description"] == pictures.source(file), f"python benchmarks/pictures.py {name} -o DIR"


@pytest.mark.parametrize("name", DRAWN)
def test_texts_of_pictures_fit(name):
    file = pictures.DATA / f"{pictures.PICTURES[name].data}.csv"
    figure = pictures.PICTURES[name].draw(pictures.rows(file))
    figures.fit(figure)
    assert misplaced(figure) == []


@pytest.mark.parametrize(
    ("cell", "found"),
    [
        ("3.1 % (2.9 to 3.3)", (3.1, 2.9, 3.3)),
        ("2.562 (-4.6 to 9.7)", (2.562, -4.6, 9.7)),
        ("1e-4 (2e-5 to any)", (1e-4, 2e-5, float("inf"))),
        ("0 %", (0.0, 0.0, 0.0)),
    ],
)
def test_intervals_are_read_as_they_are_written(cell, found):
    assert pictures.interval(cell) == found
