"""Refuses to begin a new set, unless forced, if the check finds errors in the scene without rendering."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import bpy

from generator.blender import check
from generator.blender.finding import ERROR, WARNING, Finding
from generator.model.engines import AUTO
from generator.model.errors import NlosError


@dataclass(frozen=True)
class Misgivings:
    """Errors and warnings about a scene, one sentence each.

    Attributes
    ----------
    errors, warnings : list of str
    """

    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def first(self) -> str:
        """First error, and how many more there are; empty if there is none."""
        more = len(self.errors) - 1
        return "".join(self.errors[:1]) + (f" (and {more} more, see nlos-generate check)" if more > 0 else "")

    @property
    def lines(self) -> list[str]:
        """Errors and warnings as ``check`` prints them, to be shown if the set is begun in spite of them."""
        levels = ((ERROR, self.errors), (WARNING, self.warnings))
        return [Finding(level, text).line for level, texts in levels for text in texts]


def look(scene: bpy.types.Scene) -> Misgivings:
    """Return errors and warnings for any engine: one that cannot render the scene raises by itself."""
    return of(check.findings(scene, engine=AUTO))


def of(findings: Sequence[Finding]) -> Misgivings:
    """Return the errors and warnings among findings."""
    return Misgivings(*([f.text for f in findings if f.level == level] for level in (ERROR, WARNING)))


def refuse(found: Misgivings) -> None:
    """Raise NlosError if there is an error among the misgivings."""
    if found.errors:
        raise NlosError(
            f"{bpy.data.filepath or 'scene'}: {found.first}; mend that, or begin the set in spite of it with --force"
        )
