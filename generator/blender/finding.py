"""Findings of the check of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

GOOD, NOTE, WARNING, ERROR = "good", "note", "warning", "error"


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes
    ----------
    level : {"good", "note", "warning", "error"}
        An error stops a sweep, or makes it worthless; a warning may.
    text : str
        One sentence.
    object : str
        Name of the object that it is about; else empty.
    fix : str
        Key of `FIXES` that `check.mend` can apply; else empty.
    choices : sequence of str
        Full names of the objects of which the fix needs one; empty if it needs none.
    """

    level: str
    text: str
    object: str = ""
    fix: str = ""
    choices: Sequence[str] = ()

    @property
    def line(self) -> str:
        """The finding as commands print it."""
        return f"{self.level}: {self.text}"


FIXES = {
    "metres": "Convert to Metres",
    "align": "Align to Wall",
    "reflections": "Allow Three",
    "voxels": "Fit Voxels",
    "show": "Show",
    "keep": "Keep This One",
}
"""Fixes that `check.mend` can apply, by the name that a finding gives, with the label of the panel's button."""
