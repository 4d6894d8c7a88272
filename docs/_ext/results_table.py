"""Directive ``results-table``: a file of ``docs/data`` as a table, and below it where its figures come from.

In a page::

    ```{results-table} reproduction
    :where: trained on = sheet; tested on = sheet
    :columns: classifier; tuned, accuracy
    :caption: Sheet
    ```

shows those rows of ``docs/data/reproduction.csv``. ``where`` and ``columns`` may be left out, and so may ``caption``;
``source: hide`` leaves out what is below the table, for a page that shows several parts of one file.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, ClassVar

import results_file
from docutils import nodes
from docutils.parsers.rst import directives
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

_MOST_UNBROKEN = 6
"""Columns of a table whose intervals fit on one line across a page."""


def _list(argument: str | None) -> tuple[str, ...]:
    return tuple(part.strip() for part in (argument or "").split(";") if part.strip())


def _conditions(argument: str | None) -> dict[str, str]:
    return {name.strip(): value.strip() for name, _, value in (part.partition("=") for part in _list(argument))}


class ResultsTable(SphinxDirective):
    """Shows a file of results."""

    required_arguments = 1
    option_spec: ClassVar[dict[str, Any]] = {
        "where": _conditions,
        "columns": _list,
        "caption": directives.unchanged,
        "source": lambda argument: directives.choice(argument, ("hide",)),
    }

    def run(self) -> list[nodes.Node]:
        """Return the table and the paragraph below it."""
        file = Path(self.env.srcdir, "data", f"{self.arguments[0]}.csv")
        self.env.note_dependency(str(file))
        try:
            whole = results_file.read(file)
            shown = whole.selected(self.options.get("where", {}), self.options.get("columns", ()))
        except (OSError, ValueError) as error:
            raise self.error(f"results-table: {error}") from None
        table = nodes.table("", *self._caption(), _group(shown), classes=["results"])
        return [table] if "source" in self.options else [table, *self._source(whole, file.name)]

    def _caption(self) -> list[nodes.Node]:
        return [nodes.title("", "", *self.parse_inline(text)[0])] if (text := self.options.get("caption")) else []

    def _source(self, results: results_file.ResultsFile, name: str) -> list[nodes.Node]:
        link = addnodes.download_reference("", name, reftarget=f"/data/{name}", refdoc=self.env.docname)
        link["refdomain"], link["reftype"], link["refexplicit"], link["refwarn"] = "", "download", False, False
        source = nodes.paragraph("", "", link, nodes.Text(", made "), classes=["results-source"])
        place = nodes.Text(f"on {results.machine}; {results.measured}")
        if len(results.commands) == 1:
            source += [
                nodes.Text("by "),
                nodes.literal("", results.commands[0]),
                nodes.Text(" "),
                place,
                nodes.Text("."),
            ]
            return [source]
        source += [place, nodes.Text(", by")]
        commands = "\n".join(results.commands)
        return [source, nodes.literal_block(commands, commands, language="bash", classes=["results-source"])]


def _group(results: results_file.ResultsFile) -> nodes.tgroup:
    shown = _unbroken if len(results.columns) <= _MOST_UNBROKEN else str
    head, *body = (
        nodes.row("", *(nodes.entry("", nodes.paragraph("", shown(text))) for text in row))
        for row in (results.columns, *results.rows)
    )
    columns = (nodes.colspec(colwidth=1) for _ in results.columns)
    return nodes.tgroup("", *columns, nodes.thead("", head), nodes.tbody("", *body), cols=len(results.columns))


def _unbroken(text: str) -> str:
    """Return a cell whose short parts, intervals and units are kept on one line."""
    if len(text) <= 12:
        return text.replace(" ", "\N{NO-BREAK SPACE}")
    kept = re.sub(r"\([^()]{1,20}\)", lambda part: part[0].replace(" ", "\N{NO-BREAK SPACE}"), text)
    return re.sub(r"(\d) (?=%|(?:cm|s|ms)\b)", "\\1\N{NO-BREAK SPACE}", kept)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("results-table", ResultsTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
