"""Tables of measured results: comma-separated text below lines that say where the figures come from.

A file begins with lines ``# field: value``. ``command`` says what makes the table (a line for each command, in their
order), ``machine`` on what, and ``measured`` when, or with which revision. The first line after them has the columns.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

FIELDS = ("command", "machine", "measured")


@dataclass(frozen=True)
class ResultsFile:
    """A table and where it comes from.

    Attributes
    ----------
    commands : tuple of str
        What makes the table, in this order.
    machine, measured : str
        On what, and when or with which revision.
    columns : tuple of str
    rows : tuple of tuple of str
        Each as long as `columns`.
    """

    commands: tuple[str, ...]
    machine: str
    measured: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def selected(self, where: dict[str, str], columns: tuple[str, ...] = ()) -> ResultsFile:
        """Return the rows that hold the given values, and the given columns: all but those of `where` by default.

        Raises
        ------
        ValueError
            If there is no such column or no such row.
        """
        if unknown := [name for name in (*where, *columns) if name not in self.columns]:
            raise ValueError(f"there is no column {unknown[0]!r}; the columns are {', '.join(self.columns)}")
        kept = columns or tuple(name for name in self.columns if name not in where)
        rows = [dict(zip(self.columns, row, strict=True)) for row in self.rows]
        chosen = [row for row in rows if all(row[name] == value for name, value in where.items())]
        if not chosen:
            raise ValueError(f"no row has {', '.join(f'{name} = {value}' for name, value in where.items())}")
        cells = tuple(tuple(row[name] for name in kept) for row in chosen)
        return ResultsFile(self.commands, self.machine, self.measured, kept, cells)


def read(path: Path) -> ResultsFile:
    """Read a file of results.

    Raises
    ------
    ValueError
        If it does not say where its figures come from, or its rows differ in length.
    """
    lines = path.read_text(encoding="utf-8").splitlines()
    head = [line for line in lines if line.startswith("# ")]
    said: dict[str, list[str]] = {name: [] for name in FIELDS}
    for line in head:
        name, _, value = line[2:].partition(": ")
        if name not in said or not value:
            raise ValueError(f"{path.name}: {line!r} is not one of {', '.join(f'# {name}: ...' for name in FIELDS)}")
        said[name].append(value)
    if lacking := [name for name in FIELDS if not said[name]]:
        raise ValueError(f"{path.name}: has no line '# {lacking[0]}: ...'")
    table = list(csv.reader(lines[len(head) :]))
    if len(table) < 2 or lines[: len(head)] != head:
        raise ValueError(f"{path.name}: has no rows below its columns, or lines with # among them")
    if uneven := [row for row in table if len(row) != len(table[0])]:
        raise ValueError(f"{path.name}: {uneven[0]} does not have {len(table[0])} cells")
    machine, measured = (" ".join(said[name]) for name in ("machine", "measured"))
    return ResultsFile(tuple(said["command"]), machine, measured, tuple(table[0]), tuple(map(tuple, table[1:])))
