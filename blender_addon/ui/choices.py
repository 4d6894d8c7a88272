"""The buttons of a finding that has a choice of objects: one of several that play a role keeps it."""

from collections.abc import Iterable
from typing import Any

from generator.blender.finding import FIXES


def draw(layout: Any, fix: str, names: Iterable[str]) -> None:
    """Draw a row for each object, by its full name: a button that selects it, and one that applies the fix to it."""
    column = layout.column(align=True)
    for name in names:
        row = column.row(align=True)
        row.operator("nlos.select", text=name, translate=False, icon="RESTRICT_SELECT_OFF").name = name
        mend = row.operator("nlos.fix", text=FIXES[fix], icon="TOOL_SETTINGS")
        mend.fix, mend.choice = fix, name
