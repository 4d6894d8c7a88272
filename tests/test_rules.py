"""Rules of the project that no type checker knows."""

from __future__ import annotations

import ast
import subprocess
import sys

import pytest
from conftest import ROOT

PACKAGES = ("generator", "classify", "blender_addon")
ROOMS = (
    "generator.model",
    "generator.files",
    "generator.transport",
    "generator.sets",
    "generator.jobs",
    "generator.measure",
    "generator.blender.scene",
    "generator.blender.engines",
    "generator.blender.measure",
    "generator.blender",
    "generator.cli",
    "generator",
    "classify.intervals",
    "classify.tail",
    "classify.pictures",
    "classify.calibration",
    "classify.classifiers",
    "classify.inference",
    "classify.report",
    "classify.cli",
    "classify",
    "blender_addon.session",
    "blender_addon.draft",
    "blender_addon.view",
    "blender_addon.operators",
    "blender_addon.ui",
    "blender_addon.handlers",
    "blender_addon",
    "blender_addon.packaging",
)
"""From the ground up: each imports only those before it. A folder inside a room that is not named is part of it."""
WITH_BLENDER = ("generator.blender", "generator.batch", "blender_addon")


def name_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(p): p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))}
SOURCES = [p for name, p in MODULES.items() if not name.startswith("blender_addon")]


def room(module):
    while module not in ROOMS:
        module = module.rpartition(".")[0]
    return module


def imports(path):
    """Modules of ours that a module imports, each with whether it does so when it is run: else for types only."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    idle = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    package = name_of(path).split(".")[: None if path.name == "__init__.py" else -1]
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom):
            continue
        base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
        base = ".".join(filter(None, [base, node.module]))
        for alias in node.names:
            found = f"{base}.{alias.name}" if f"{base}.{alias.name}" in MODULES else base
            if found in MODULES and found != name_of(path):
                yield found, node not in idle


@pytest.mark.parametrize("module", MODULES)
def test_a_room_imports_only_rooms_below_it(module):
    for other, _ in imports(MODULES[module]):
        assert ROOMS.index(room(other)) <= ROOMS.index(room(module)), f"{module} imports {other}, which is above it"


def test_modules_do_not_import_one_another_in_circles():
    needs = {module: {other for other, runs in imports(path) if runs} for module, path in MODULES.items()}
    while free := [module for module, others in needs.items() if not others]:
        needs = {module: others - set(free) for module, others in needs.items() if module not in free}
    assert not needs, f"in or behind a circle: {sorted(needs)}"


@pytest.mark.parametrize("module", MODULES)
def test_what_is_public_is_documented(module):
    tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), "the module itself"
    for node in tree.body:
        bodies = node.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_") else []
        for item in (node, *bodies):
            if isinstance(item, ast.FunctionDef | ast.ClassDef) and not item.name.startswith("_"):
                setter = any(ast.unparse(d).endswith(".setter") for d in item.decorator_list)
                assert setter or ast.get_docstring(item), f"{module}.{item.name}, line {item.lineno}"


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


@pytest.mark.parametrize("module", [m for m in MODULES if not m.startswith(WITH_BLENDER)])
def test_only_the_blender_rooms_import_bpy(module):
    tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
    named = [a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names]
    named += [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert not {name.partition(".")[0] for name in named} & {"bpy", "mathutils", "bmesh"}


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
