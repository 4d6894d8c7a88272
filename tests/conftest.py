"""Shared by all tests: scenes built once, and commands run as a user runs them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def command():
    """Run ``nlos-generate`` or ``nlos-classify`` in a process of its own; return what it did.

    The check at the start of a set takes seconds, and most tests are of something else: ``probe=True`` has it made.
    """

    def run(module, *arguments, probe=False, **options):
        if module == "generator" and arguments[0] in ("sweep", "trajectory", "bulk") and not probe:
            arguments = (*arguments, "--no-probe")
        return subprocess.run(
            [sys.executable, "-m", f"{module}.cli", *map(str, arguments)],
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            **options,
        )

    return run


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
    result = command("generator", "sweep", scene_file, "-o", path, *TINY)
    assert result.returncode == 0, result.stderr
    return path
