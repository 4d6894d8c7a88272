"""Tables in ``docs/data``: where their figures come from, and that what made them would make such a table again."""

from __future__ import annotations

import ast
import fnmatch
import re
import shlex
import sys
from pathlib import Path

import pytest
from conftest import ROOT

import classify.cli.main
import generator.cli.main

sys.path.append(str(ROOT / "docs" / "_ext"))
sys.path.append(str(ROOT / "benchmarks"))
import results
import results_file

DATA = ROOT / "docs" / "data"
POINTS = DATA / "points"
"""Files that a picture is drawn from and that are too long for a page, which links them."""
FILES = sorted(DATA.rglob("*.csv"))
PARSERS = {"nlos-generate": generator.cli.main.parser, "nlos-classify": classify.cli.main.parser}
PAGES = sorted((ROOT / "docs").rglob("*.md"))


def tables(script: Path) -> dict[str, tuple[str, ...]]:
    """`RESULTS` of a script, without running it: the columns of each table that it writes."""
    for node in ast.parse(script.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "RESULTS":
            return dict(ast.literal_eval(node.value))
    return {}


def options(script: Path) -> set[str]:
    """Return the options that a script's parser is given."""
    return {
        argument.value
        for node in ast.walk(ast.parse(script.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "add_argument"
        for argument in node.args
        if isinstance(argument, ast.Constant)
    }


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_the_command_that_is_named_makes_this_table(file):
    found = results_file.read(file)
    makers = []
    for command in found.commands:
        program, *words = shlex.split(command)
        if program == "python":
            script = ROOT / words[0]
            assert script.is_relative_to(ROOT / "benchmarks"), command
            given = {word.partition("=")[0] for word in words[1:] if word.startswith("-")}
            assert given <= options(script), f"{script.name} does not know {given - options(script)}"
            makers += [columns for name, columns in tables(script).items() if fnmatch.fnmatchcase(file.stem, name)]
        else:
            PARSERS[program]().parse_args(words)  # ends the process where it does not know a command or an option
    assert makers or not any(command.startswith("python ") for command in found.commands), "no script writes it"
    assert all(columns == found.columns for columns in makers), makers


def test_every_table_is_on_a_page_and_every_table_of_a_script_is_kept():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert [file.name for file in DATA.glob("*.csv") if f"{{results-table}} {file.stem}\n" not in text] == []
    assert [file.name for file in POINTS.iterdir() if f"data/points/{file.name}>" not in text] == []
    named = [name for script in sorted((ROOT / "benchmarks").glob("*.py")) for name in tables(script)]
    assert named
    kept = [file.stem for file in FILES]
    assert [name for name in named if not fnmatch.filter(kept, name)] == []


def test_what_a_script_writes_is_what_a_page_reads(tmp_path, monkeypatch):
    script = str(ROOT / "benchmarks" / "klein2016.py")
    monkeypatch.setattr(sys, "argv", [script, "-o", str(tmp_path / "out"), "--pixels", "8", "a name"])
    written = results.write(tmp_path / "out", "table", ("of", "share, %"), [("a, b", 1.5), ("c", "2 ± 1")])
    found = results_file.read(written)
    assert found.commands == ("python benchmarks/klein2016.py -o DIR --pixels 8 'a name'",)
    assert "cores of" in found.machine
    assert "revision" in found.measured
    assert (found.columns, found.rows) == (("of", "share, %"), (("a, b", "1.5"), ("c", "2 ± 1")))


HEAD = "# command: make it\n# machine: this one\n# measured: today\n"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("a,b\n1,2\n", "no line '# command"),
        (HEAD.replace("# machine", "# host") + "a\n1\n", "not one of"),
        (HEAD + "a,b\n1\n", "does not have 2 cells"),
        (HEAD + "a,b\n", "no rows"),
    ],
)
def test_a_table_that_does_not_say_where_it_comes_from_is_refused(tmp_path, text, fault):
    file = tmp_path / "table.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=fault):
        results_file.read(file)


def test_a_page_shows_some_rows_and_columns(tmp_path):
    file = tmp_path / "table.csv"
    file.write_text(HEAD + "of,a,b\nx,1,2\ny,3,4\nx,5,6\n", encoding="utf-8")
    found = results_file.read(file)
    assert found.selected({"of": "x"}).rows == (("1", "2"), ("5", "6"))
    assert found.selected({}, ("b", "of")).rows == (("2", "x"), ("4", "y"), ("6", "x"))
    with pytest.raises(ValueError, match="no column 'c'"):
        found.selected({}, ("c",))
    with pytest.raises(ValueError, match="no row has of = z"):
        found.selected({"of": "z"})


def test_directive(tmp_path):
    sphinx = pytest.importorskip("sphinx.application", reason="Sphinx builds the pages")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "table.csv").write_text(HEAD + "of,a\nx,1\ny,2\n", encoding="utf-8")
    page = "Page\n====\n\n.. results-table:: table\n   :where: of = y\n   :caption: Some\n"
    (tmp_path / "index.rst").write_text(page, encoding="utf-8")
    settings = {"extensions": ["results_table"]}
    out = tmp_path / "out"
    app = sphinx.Sphinx(tmp_path, None, out, out, "html", settings, status=None, warningiserror=True)
    app.build()
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "<p>2</p>" in page
    assert "<p>1</p>" not in page
    text = re.sub("<[^>]*>", "", page)
    assert "Some" in text
    assert "table.csv, made by make it on this one; today." in " ".join(text.split())
    assert list(out.glob("_downloads/*/table.csv"))
