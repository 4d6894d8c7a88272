"""What a new set is not begun with unasked: a scene in which the check, short of rendering, finds errors."""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy

from generator.blender import check
from generator.blender.finding import ERROR, WARNING
from generator.model.engines import AUTO
from generator.model.errors import NlosError


@dataclass(frozen=True)
class Misgivings:
    """What is wrong with a scene, or may be, a sentence each.

    Attributes
    ----------
    errors, warnings : list of str
    """

    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def first(self) -> str:
        """The first error, and how many more there are; empty if there is none."""
        more = len(self.errors) - 1
        return "".join(self.errors[:1]) + (f" (and {more} more, see nlos-generate check)" if more > 0 else "")

    @property
    def notes(self) -> list[str]:
        """What is to be said though the set is begun."""
        return [f"note: {text}" for text in [*self.errors, *self.warnings]]


def look(scene: bpy.types.Scene) -> Misgivings:
    """Return what is wrong with a scene, whatever the engine: one that cannot honour it says so itself."""
    found = check.findings(scene, engine=AUTO)
    return Misgivings(*([f.text for f in found if f.level == level] for level in (ERROR, WARNING)))


def refuse(found: Misgivings) -> None:
    """Raise NlosError if there is an error among them."""
    if found.errors:
        raise NlosError(
            f"{bpy.data.filepath or 'scene'}: {found.first}; mend that, or begin the set in spite of it with --force"
        )
