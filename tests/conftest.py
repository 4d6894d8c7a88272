"""Shared by all tests: scenes built once, and commands run as a user runs them."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

# Tests run on all cores already: threads of matrix products would only wait for each other. The processes of
# pytest-xdist and those that tests start inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from classify.cli.main import main as classify_main
from generator.cli.main import main as generate_main

ROOT = Path(__file__).resolve().parents[1]
MAINS = {"generator": (generate_main, "nlos-generate"), "classify": (classify_main, "nlos-classify")}
LEAVES_TRACES = {"scene", "check", "describe", "experiment", "plan", "--jobs"}
"""Verbs that load Blender into their own process, where they replace the scene that a test has open; and submitit,
which leaves log files open."""


@pytest.fixture(scope="session")
def command():
    """Run ``nlos-generate`` or ``nlos-classify``; return its exit code and what it printed.

    It is run by its ``main`` in this process: an interpreter of its own would take longer than most tests. With
    ``process=True`` it is run as a user runs it, and so is always what would leave traces here. The check at the
    start of a set takes seconds, and most tests are of something else: ``probe=True`` has it made.
    """

    def run(module, *arguments, probe=False, process=False, cwd=None):
        arguments = [*map(str, arguments)]
        if module == "generator" and arguments[0] in ("sweep", "trajectory", "bulk") and not probe:
            arguments.append("--no-probe")
        if process or (module == "generator" and LEAVES_TRACES.intersection(arguments)):
            return in_a_process(module, arguments, cwd)
        return in_this_process(module, arguments, cwd)

    return run


def in_a_process(module, arguments, cwd):
    return subprocess.run(
        [sys.executable, "-m", f"{module}.cli", *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def in_this_process(module, arguments, cwd):
    main, name = MAINS[module]
    output, errors = io.StringIO(), io.StringIO()
    with contextlib.ExitStack() as stack, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [name, *arguments])
        stack.enter_context(contextlib.redirect_stdout(output))
        stack.enter_context(contextlib.redirect_stderr(errors))
        stack.enter_context(contextlib.chdir(cwd or os.getcwd()))
        try:
            code = main(arguments)
        except SystemExit as exit:  # by argparse
            code = exit.code
    return subprocess.CompletedProcess(arguments, code, output.getvalue(), errors.getvalue())


@pytest.fixture(scope="session")
def scene_file(tmp_path_factory, command):
    """The room preset with its sheet, as a file."""
    path = tmp_path_factory.mktemp("scene") / "room.blend"
    result = command("generator", "scene", "room", "-o", path)
    assert result.returncode == 0, result.stderr
    return path


TINY = ("--engine", "patch", "--poses", "1", "--samples", "64", "--resolution", "8", "--no-probe", "--workers", "1")


@pytest.fixture(scope="session")
def tiny_dataset(tmp_path_factory, scene_file, command):
    """A finished data set: one pose a voxel, 8 x 8 pixels. Copy it before changing it."""
    path = tmp_path_factory.mktemp("dataset") / "tiny"
    result = command("generator", "sweep", scene_file, "-o", path, *TINY, process=True)
    assert result.returncode == 0, result.stderr
    return path


@pytest.fixture
def drawn(monkeypatch):
    """The figures that a test saves, in order."""
    from generator.measure import figures

    save, found = figures.save, []

    def keep(path, figure, **further):
        found.append(figure)
        return save(path, figure, **further)

    monkeypatch.setattr(figures, "save", keep)
    return found
