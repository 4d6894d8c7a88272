"""Rules of the project that no type checker knows."""

from __future__ import annotations

import ast
import subprocess
import sys

import pytest
from conftest import ROOT

SOURCES = sorted(p for package in ("generator", "classify") for p in (ROOT / package).rglob("*.py"))
NEEDS_BLENDER = {
    *(
        "adopt",
        "batch",
        "bulkworker",
        "check",
        "clearance",
        "engines",
        "experiments",
        "extract",
        "laboratory",
        "lighting",
        "misgivings",
        "nodes",
        "outlines",
        "planning",
        "probing",
        "references",
        "rehearsal",
        "replaced",
        "simplify",
        "stage",
        "startcheck",
        "worker",
    )
}


def calls(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func)


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: f"{p.parent.name}.{p.stem}")
def test_data_follow_from_the_seed_alone(path):
    """No global random generator, no names or numbers from the clock or the machine in what reaches the data."""
    forbidden = {
        "time.time",
        "datetime.now",
        "datetime.utcnow",
        "datetime.today",
        "os.urandom",
        "uuid.uuid4",
        "random",
    }
    if path.stem == "journal":  # tells people what goes on, and makes no data
        forbidden.remove("time.time")
    tree = ast.parse(path.read_text(encoding="utf-8"))
    used = set(calls(tree))
    assert not used & forbidden
    seeded = ("np.random.default_rng", "np.random.SeedSequence")
    legacy = {c for c in used if c.startswith("np.random.") and not c.startswith(seeded)}
    assert not legacy
    assert "np.random.default_rng()" not in path.read_text(encoding="utf-8"), "a generator without a seed"


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: f"{p.parent.name}.{p.stem}")
def test_bpy_stays_where_it_is_needed(path):
    if path.parent.name == "generator" and path.stem in NEEDS_BLENDER:
        return
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imports = {
        name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module or ""] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names])
    }
    assert not imports & {"bpy", "mathutils", "bmesh"}


def test_coordinator_and_classifier_run_without_blender():
    script = (
        "import sys\n"
        "class NoBlender:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name.split('.')[0] in ('bpy', 'mathutils'): raise ImportError(name)\n"
        "sys.meta_path.insert(0, NoBlender())\n"
        "import generator.jobs.local, generator.sets.bulk_set, generator.cli, classify.cli\n"
    )
    result = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
