"""What a check finds in a scene."""

from __future__ import annotations

from dataclasses import dataclass

GOOD, NOTE, WARNING, ERROR = "good", "note", "warning", "error"


@dataclass(frozen=True)
class Finding:
    """One thing found.

    Attributes
    ----------
    level : {"good", "note", "warning", "error"}
        An error stops a sweep, or makes it worthless; a warning may.
    text : str
        One sentence.
    object : str
        The object it names, else empty.
    fix : str
        What `mend` can do about it, else empty.
    """

    level: str
    text: str
    object: str = ""
    fix: str = ""


FIXES = {
    "metres": "Convert to Metres",
    "align": "Align to Wall",
    "reflections": "Allow Three",
    "voxels": "Fit Voxels",
    "show": "Show",
}
"""What `check.mend` can do, by the name that a finding gives it, and what the panel calls it."""
