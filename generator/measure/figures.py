"""Style of all figures: palette, sizes, titles that fit, and files. Opens no window and changes no global state.

Colours are those of Okabe and Ito (2008), which people with any of the common colour vision deficiencies tell apart;
colour maps are perceptually uniform (viridis, cividis) or, for signed values, the diverging RdBu_r of ColorBrewer.
"""

from __future__ import annotations

import functools
import math
import textwrap
from pathlib import Path
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter

from generator.files.writing import atomic
from generator.model.errors import NlosError

BLUE, VERMILION, GREEN, ORANGE, SKY, PURPLE, YELLOW = (
    *("#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#F0E442"),
)
BLACK, GREY, PALE = "#1a1a1a", "#57606a", "#d0d7de"
COLOURS = (BLUE, VERMILION, GREEN, ORANGE, SKY, PURPLE, BLACK, YELLOW)
MARKERS = "osD^vPXh"
"""A marker for each colour, so that series are told apart without it."""
SEQUENTIAL, SHARES, SIGNED = "viridis", "cividis", "RdBu_r"

WIDTH = 8.0
"""Of a figure of several panels, inches: a wider one has texts too small to read where a page shows it whole."""
FORMATS = (".png", ".svg", ".pdf")
_STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.labelsize": 9,
    "axes.prop_cycle": cycler(color=COLOURS),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 10,
    "figure.constrained_layout.use": True,
    "figure.dpi": 130,
    "figure.titlesize": 11,
    "font.family": "sans-serif",
    "font.size": 9,
    "grid.color": "#e4e8ec",
    "grid.linewidth": 0.6,
    "image.cmap": SEQUENTIAL,
    "legend.fontsize": 8,
    "legend.framealpha": 0.85,
    "pdf.fonttype": 42,  # text stays text
    "svg.fonttype": "path",  # looks the same without our font
    "svg.hashsalt": "nlos",  # the same figure is the same file
    "xtick.labelsize": 8,
    "xtick.minor.pad": 4.9,  # labels of short and long ticks stand in one line
    "ytick.labelsize": 8,
    "ytick.minor.pad": 4.9,
}
_PASSES, _FEWEST_LETTERS = 3, 8
_UNDATED: dict[str, dict[str, str | None]] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
_DESCRIPTION = {".png": "Description", ".svg": "Description", ".pdf": "Subject"}

styled = mpl.rc_context(_STYLE)  # type: ignore[arg-type]
"""Decorator of functions that draw: the style holds while they run."""


def subplots(rows: int = 1, columns: int = 1, *, size: tuple[float, float], **how: Any) -> tuple[Figure, Any]:
    """Return a figure of a size, inches, and its axes, an array of shape (rows, columns).

    Parameters
    ----------
    rows, columns : int
    size : (float, float)
        Width and height, inches.
    **how
        Further arguments of `matplotlib.figure.Figure.subplots`.
    """
    figure = Figure(figsize=size)
    return figure, figure.subplots(rows, columns, squeeze=False, **how)


def check_format(path: Path) -> None:
    """Raise NlosError if a file's name does not end in one of `FORMATS`."""
    if path.suffix.lower() not in FORMATS:
        raise NlosError(f"{path}: must end in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, which says its format")


@styled
def save(path: Path, figure: Figure, *, source: str = "") -> list[Path]:
    """Write a figure in the format that its name ends in, by temporary name and rename; return what was written.

    Beside a PNG, the same is written as SVG, for print. Titles and labels longer than their panel are wrapped.

    Parameters
    ----------
    path : Path
    figure : Figure
    source : str
        Where its data come from, to be kept in the file.

    Raises
    ------
    NlosError
        The name ends otherwise, or the file cannot be written.
    """
    check_format(path)
    fit(figure)
    written = [path, path.with_suffix(".svg")] if path.suffix.lower() == ".png" else [path]
    for file in written:
        suffix = file.suffix.lower()
        with atomic(file) as temporary:
            about = {_DESCRIPTION[suffix]: source} if source else {}
            figure.savefig(temporary, format=suffix[1:], metadata={**_UNDATED[suffix], **about})
    return written


def fit(figure: Figure) -> None:
    """Wrap titles to the width of their panel, labels to the length of their axis, and the heading to the figure."""
    parts: list[Any] = [figure, *figure.subfigs]
    for _ in range(_PASSES):  # a wrapped text takes room from its panel
        figure.draw_without_rendering()
        wrapped = [_wrap(heading, part.bbox.width) for part in parts for heading in part.texts]
        for axis in figure.axes:
            width, height = axis.bbox.width, axis.bbox.height
            wrapped += [_wrap(axis.title, width), _wrap(axis.xaxis.label, width)]
            wrapped.append(_wrap(axis.yaxis.label, height, upright=True))
        if not any(wrapped):
            return


def _wrap(text: Text, room: float, *, upright: bool = False) -> bool:
    """Wrap a text to a length, pixels, if it is longer; return whether it was."""
    extent = text.get_window_extent()
    needed = extent.height if upright else extent.width
    words = text.get_text()
    if not words or needed <= room:
        return False
    letters = max(len(line) for line in words.splitlines())
    text.set_text(textwrap.fill(words, max(_FEWEST_LETTERS, int(0.97 * letters * room / needed))))
    return True


def plain_numbers(*axes: Axis) -> None:
    """Write the ticks of logarithmic axes as 0.01 and 300, and not as powers of ten."""
    for axis in axes:
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(FuncFormatter(functools.partial(_between_decades, axis)))


def _between_decades(axis: Axis, value: float, _: object = None) -> str:
    """Return the label of a tick between two powers of ten: the fewer, the more of these the axis holds."""
    low, high = sorted(axis.get_view_interval())
    digit = round(value / 10.0 ** math.floor(math.log10(value)))
    shown = (2, 3, 5) if high < 30.0 * low else (3,) if high < 300.0 * low else ()
    return f"{value:g}" if digit in shown else ""


def outlined(text: Text) -> Text:
    """Make a text legible on any colour: white with a dark outline."""
    text.set(color="white", path_effects=[withStroke(linewidth=2.2, foreground=BLACK)])
    return text


def heat_map(axis: Axes, share: Any, labels: Any, *, names: int = 30, numbers: int = 12) -> None:
    """Draw a confusion matrix in per cent of each row, with names of the classes and numbers while they can be read.

    Without numbers there is a colour bar.

    Parameters
    ----------
    axis : Axes
    share : ndarray of shape (n, n)
        Per cent.
    labels : sequence of str
    names, numbers : int
        Most classes whose names, and whose shares as numbers, are written.
    """
    image = axis.imshow(share, cmap=SHARES, vmin=0.0, vmax=100.0)
    axis.grid(visible=False)
    count = len(labels)
    if count <= names:
        axis.set_xticks(range(count), labels)
        axis.set_yticks(range(count), labels)
    if count <= numbers:
        for row in range(count):
            for column in range(count):
                if share[row, column] >= 0.5:
                    colour = BLACK if share[row, column] > 55.0 else "white"
                    words = f"{share[row, column]:.0f}"
                    axis.text(column, row, words, ha="center", va="center", fontsize=7, color=colour)
    else:
        axis.figure.colorbar(image, ax=axis, shrink=0.8).set_label("% of the pictures of a row")
