"""The notebooks: stored without outputs, and written against the public face alone. The site's build runs them."""

from __future__ import annotations

import ast
import importlib
import json
import re
import sys

import pytest
from conftest import ROOT

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
PUBLIC = ("generator", "classify")
IMPORTABLE = {*PUBLIC, "numpy", "matplotlib", *sys.stdlib_module_names} - {"subprocess", "os", "sys", "importlib"}
KEYS = {"markdown": {"cell_type", "id", "metadata", "source"}}
KEYS["code"] = KEYS["markdown"] | {"execution_count", "outputs"}


def test_there_are_three():
    assert [path.name[:2] for path in NOTEBOOKS] == ["01", "02", "03"]


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def notebook(request):
    return json.loads(request.param.read_text(encoding="utf-8"))


def test_follows_the_format(notebook):
    assert notebook["nbformat"] == 4
    assert notebook["nbformat_minor"] >= 5
    assert notebook["metadata"]["kernelspec"]["name"] == "python3"
    cells = notebook["cells"]
    assert all(set(cell) == KEYS[cell["cell_type"]] for cell in cells)
    assert all(isinstance(cell["source"], list) for cell in cells)
    assert len({cell["id"] for cell in cells}) == len(cells)
    assert cells[0]["cell_type"] == "markdown"
    assert cells[0]["source"][0].startswith("# ")


def test_holds_no_outputs(notebook):
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert code
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code), (
        "clear them: jupyter nbconvert --clear-output --inplace docs/notebooks/*.ipynb"
    )


def test_uses_the_public_face_alone(notebook):
    # A magic (%, !) is no Python, and raises a SyntaxError here.
    trees = [ast.parse("".join(c["source"])) for c in notebook["cells"] if c["cell_type"] == "code"]
    for node in (node for tree in trees for node in ast.walk(tree)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
            assert {name.partition(".")[0] for name in names} <= IMPORTABLE, names
            assert not any(name.startswith(tuple(f"{package}." for package in PUBLIC)) for name in names), names
        elif isinstance(node, ast.ImportFrom):
            assert str(node.module).partition(".")[0] in IMPORTABLE - set(PUBLIC), node.module
        elif isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_"), node.attr
            if isinstance(node.value, ast.Name) and node.value.id in PUBLIC:
                assert node.attr in importlib.import_module(node.value.id).__all__, node.attr


def test_names_no_machine(notebook):
    text = "".join(line for cell in notebook["cells"] for line in cell["source"])
    assert not re.search(r"(?<![\w.])/(tmp|work|home|root|Users|var|opt)\b|[A-Z]:\\", text)
