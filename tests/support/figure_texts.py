"""Looks for texts of a figure that are cut off or reach beyond their panel."""

from __future__ import annotations

from matplotlib.text import Text

_SLACK = 2.0
"""Pixels."""


def misplaced(figure):
    """Return the texts that leave the figure, and the titles and labels that are longer than their axis."""
    figure.draw_without_rendering()
    page = figure.bbox.padded(_SLACK)
    found, ticks = [], _ticks(figure)
    for text in figure.findobj(Text):
        if not (text.get_visible() and text.get_text().strip()):
            continue
        if text in ticks:
            continue
        box = text.get_window_extent()
        if not (page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0 and box.y1 <= page.y1):
            found.append(f"leaves the figure: {text.get_text()!r}")
    for axis in figure.axes:
        if axis.title.get_window_extent().width > axis.bbox.width + _SLACK:
            found.append(f"wider than its panel: {axis.title.get_text()!r}")
        if axis.yaxis.label.get_window_extent().height > axis.bbox.height + _SLACK:
            found.append(f"longer than its axis: {axis.yaxis.label.get_text()!r}")
    return found


def _ticks(figure):
    """Labels of ticks, which may lie outside of the range of their axis and are not drawn then."""
    axes = [line for axis in figure.axes for line in (axis.xaxis, axis.yaxis)]
    return {label for line in axes for label in line.get_ticklabels(which="both")}
