"""HTML report of answers: conclusions, figures, tables, and the sources of all of them."""

from __future__ import annotations

import base64
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import jinja2

from classify.inference.atlas import Atlas
from generator.files.writing import write_text


@dataclass(frozen=True)
class Table:
    """A table of the page: its title, its headings, and its rows of cells."""

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]


def write(
    folder: Path,
    title: str,
    lead: Sequence[str],
    figures: Mapping[str, str],
    tables: Sequence[Table],
    sources: Mapping[str, object],
) -> Path:
    """Write ``report.html``, which needs no other file, to a temporary file that is then renamed.

    Parameters
    ----------
    folder : Path
    title : str
    lead : sequence of str
        Conclusions, one sentence each.
    figures : mapping of str to str
        File names of figures in the folder, and the caption of each.
    tables : sequence of Table
    sources : mapping
        Sources of the results by name; the command line is added.

    Returns
    -------
    Path
        Path of the page.
    """
    loader = jinja2.FileSystemLoader(Path(__file__).parent / "templates")
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    name = Path(sys.argv[0]).name
    command = " ".join(map(shlex.quote, ["nlos-classify" if name == "__main__.py" else name, *sys.argv[1:]]))
    text = environment.get_template("page.html").render(
        title=title,
        lead=lead,
        figures=[
            {"caption": caption, "data": base64.b64encode((folder / name).read_bytes()).decode()}
            for name, caption in figures.items()
        ],
        tables=tables,
        sources={**sources, "command": command},
    )
    write_text(folder / "report.html", text)
    return folder / "report.html"


def of_atlas(atlas: Atlas) -> dict[str, object]:
    """Return the facts about an atlas that a report states."""
    sensor = ", ".join(f"{name} {value:g}" for name, value in asdict(atlas.sensor).items() if value)
    return {
        "simulated sets": ", ".join(atlas.about["sets"]),
        "objects looked for": ", ".join(atlas.about["targets"])
        + (", of unknown size and albedo" if atlas.unknown else ""),
        "poses": len(atlas.codes),
        "sensor": sensor,
    }
