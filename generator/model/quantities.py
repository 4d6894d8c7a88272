"""Times, sizes and shares, parsed from text and formatted as text."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from generator.model.errors import NlosError


def parse_resolution(text: str, aspect: float = 1.0) -> tuple[int, int]:
    """Return width and height from ``64`` (the height follows from the aspect) or ``64x48``.

    Raises
    ------
    NlosError
        The text is neither.
    """
    width, cross, height = text.lower().partition("x")
    try:
        return int(width), int(height) if cross else max(1, round(int(width) / aspect))
    except ValueError:
        raise NlosError(f"resolution {text!r}: must read 64 or 64x48") from None


Progress = Callable[[int, int], None]
"""Called with (done, total): how many pictures of this run are done, and how many there are to do."""
ALL_ORDERS = 1024
"""The reflection order that stands for all reflections: Cycles follows no more."""
ROUNDING = 2.0**-24
"""Largest rounding error of a float32, of which pictures are made, relative to its value."""
NO_CHANGE = f"the object makes no change above the rounding of float32 ({100.0 * ROUNDING:.1g} % of a pixel)"
"""What is known of an object whose picture is that of the empty scene."""


def order_words(order: int) -> str:
    """Return a reflection order as words: "up to 6 reflections", "all reflections"."""
    return "all reflections" if order >= ALL_ORDERS else f"up to {order} reflections"


def clock(seconds: float) -> str:
    """Return a remaining time in minutes and seconds, with hours if there are any: 1:05 or 2:00:07."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"


def rough_time(seconds: float) -> str:
    """Return a time in a rough form: 40 s, 5 min, 2.5 h."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def byte_size(count: float) -> str:
    """Return a size in MB or GB."""
    return f"{count / 1e6:.3g} MB" if count < 1e9 else f"{count / 1e9:.3g} GB"


def radiance(value: float, digits: int = 3) -> str:
    """Return a radiance, W/m^2/sr, with its sign and the prefix that reads best: 437 µW/m²/sr, 1.2 mW/m²/sr."""
    size = float(f"{abs(value):.{digits - 1}e}")
    prefix, unit = next(((p, u) for p, u in _PREFIXES if size >= u), _PREFIXES[-1])
    return f"{'-' if value < 0.0 else ''}{round(size / unit, 9):g} {prefix}W/m²/sr" if size else "0 W/m²/sr"


_PREFIXES = (("", 1.0), ("m", 1e-3), ("µ", 1e-6), ("n", 1e-9), ("p", 1e-12))
_UNITS = {"": 1.0, "s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0, "d": 86400.0}


def seconds(text: str) -> float:
    """Return a time in seconds: 90, 90s, 10min, 1.5h, 2d.

    Raises
    ------
    NlosError
        The text is not a positive time.
    """
    match = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*([a-z]*)\s*", text)
    if not match or match[2] not in _UNITS or float(match[1]) <= 0.0:
        raise NlosError(f"time {text!r}: must read like 90s, 10min, 1.5h or 2d")
    return float(match[1]) * _UNITS[match[2]]


def fraction(text: str) -> float:
    """Return a relative accuracy: 0.01 or 1%.

    Raises
    ------
    NlosError
        The text is not a number between 0 and 1.
    """
    number, percent, rest = text.strip().partition("%")
    try:
        value = float(number) / (100.0 if percent else 1.0)
    except ValueError:
        value = math.nan
    if rest or not 0.0 < value < 1.0:
        raise NlosError(f"accuracy {text!r}: must be between 0 and 1, or read like 1%")
    return value


def percent(share: float) -> str:
    """Return a share in per cent, with two digits."""
    return f"{100.0 * share:.2g} %"


def parse_shard(text: str) -> tuple[int, int]:
    """Return i and n of ``i/n``."""
    index, _, count = text.partition("/")
    try:
        shard = (int(index), int(count))
    except ValueError:
        shard = (0, 0)
    if not 0 <= shard[0] < shard[1]:
        raise NlosError(f"--shard {text!r}: must read i/n with i from 0 to n - 1, for example 0/4")
    return shard
