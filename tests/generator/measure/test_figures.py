"""The style of figures: texts that fit, files in the formats asked for, nothing global changed."""

from __future__ import annotations

import matplotlib as mpl
import pytest
from figure_texts import misplaced

from generator.measure import figures
from generator.model.errors import NlosError

LONG = "the error of a difference picture, relative to the light of all others"


@figures.styled
def drawn():
    figure, [axes] = figures.subplots(1, 2, size=(6.0, 3.0))
    for axis in axes:
        axis.set_title(LONG)
        axis.set_ylabel(LONG)
    figure.suptitle(f"{LONG}, {LONG}")
    return figure


def test_long_titles_are_wrapped_and_fit():
    figure = drawn()
    assert misplaced(figure), "else this test could not fail"
    figures.fit(figure)
    assert misplaced(figure) == []


@pytest.mark.parametrize(
    ("name", "files"), [("a.png", {"a.png", "a.svg"}), ("a.svg", {"a.svg"}), ("a.pdf", {"a.pdf"})]
)
def test_the_name_says_the_format_and_a_png_has_an_svg_beside_it(tmp_path, name, files):
    contents = []
    for _ in range(2):
        written = figures.save(tmp_path / name, drawn())
        assert {path.name for path in written} == files == {path.name for path in tmp_path.iterdir()}
        contents.append([path.read_bytes() for path in written])
    assert contents[0] == contents[1], "the same figure is the same file"


def test_other_formats_are_refused(tmp_path):
    with pytest.raises(NlosError, match=r"a\.jpg: must end in \.png, \.svg or \.pdf"):
        figures.save(tmp_path / "a.jpg", drawn())
    assert not list(tmp_path.iterdir())


def test_the_style_of_others_is_left_alone():
    before = dict(mpl.rcParams)
    drawn()
    assert dict(mpl.rcParams) == before


def test_series_are_told_apart_without_colour():
    assert len(set(figures.MARKERS)) == len(figures.COLOURS) == len(set(figures.COLOURS))
