"""Draws sentences on as many lines as they need, since Blender's labels do not wrap."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import blf

from ..session import wording

_BESIDE, _ICON = 74.0, 22.0
"""Width beside a text in a panel, for tabs, margins and a box, and of an icon: pixels at a scale of 1."""
_LEAST = 60.0


def sentence(context: Any, layout: Any, text: str, icon: str = "NONE") -> None:
    """Draw a sentence, in the panels' words, on as many lines as the region is narrow."""
    system = context.preferences.system
    points = context.preferences.ui_styles[0].widget.points
    region = context.region
    left, right = (region.view2d.region_to_view(x, 0.0)[0] for x in (0, region.width))  # Ctrl and the wheel zoom it
    room = (right - left) / system.ui_scale - _BESIDE - (_ICON if icon != "NONE" else 0.0)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for line in lines(wording.shown(text), max(_LEAST, room), lambda words: _width(words, points)):
        column.label(text=line, icon=icon, translate=False)
        icon = "BLANK1" if icon != "NONE" else "NONE"


def lines(text: str, room: float, width: Callable[[str], float]) -> list[str]:
    """Return a text in lines of which none is wider than ``room``; a word that is, such as a path, is cut.

    Parameters
    ----------
    text : str
    room : float
    width : callable
        Width of a text, in the units of ``room``.
    """
    found: list[str] = []
    line = ""
    for word in text.split():
        if width(f"{line} {word}".lstrip()) <= room:
            line = f"{line} {word}".lstrip()
            continue
        if line:
            found.append(line)
        while width(word) > room and len(word) > 1:
            fits = next((n for n in range(len(word) - 1, 1, -1) if width(word[:n]) <= room), 1)
            found.append(word[:fits])
            word = word[fits:]
        line = word
    return [*found, line] if line or not found else found


@lru_cache(maxsize=20_000)
def _width(text: str, points: float) -> float:
    blf.size(0, points)
    return float(blf.dimensions(0, text)[0])
