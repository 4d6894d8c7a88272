"""Writes a table of results as ``docs/data`` has them: below lines that say which command made it, on what and when.

A script names its tables in ``RESULTS``, their columns by their names; ``tests/test_results.py`` holds the files in
``docs/data`` against it.
"""

from __future__ import annotations

import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from generator.files.writing import csv_text, write_text
from generator.jobs.workers import available_cores

_ROOT = Path(__file__).resolve().parents[1]


def write(folder: Path, name: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Path:
    """Write a table into a folder; return its path.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    name : str
        Of the file, without ``.csv``.
    columns : sequence of str
    rows : iterable of sequence
        Each as long as `columns`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    head = f"# command: {command(folder)}\n# machine: {machine()}\n# measured: {now()}\n"
    path = folder / f"{name}.csv"
    write_text(path, head + csv_text(columns, rows))
    return path


def command(folder: Path) -> str:
    """Return the command line that runs, with DIR for the folder of the results."""
    words = ["python"]
    for number, word in enumerate(sys.argv):
        path = Path(word).resolve()
        if number and not word.startswith("-") and path.is_relative_to(folder.resolve()):
            words.append(Path("DIR", path.relative_to(folder.resolve())).as_posix())
        else:
            words.append(path.relative_to(_ROOT).as_posix() if not number and path.is_relative_to(_ROOT) else word)
    return shlex.join(words)


def machine() -> str:
    """Return the cores, the processor and the versions that times and pictures depend on."""
    told = [f"{available_cores()} cores of {_processor()}", f"Python {platform.python_version()}"]
    for package in ("bpy", "numba"):
        try:
            told.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            told.append(f"no {package}")
    return ", ".join(told)


def now() -> str:
    """Return the day, and the revision of the sources where git knows it."""
    command = ["git", "-C", str(_ROOT), "describe", "--always", "--dirty"]
    try:
        revision = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        revision = "unknown"
    return f"{time.strftime('%Y-%m-%d')}, revision {revision}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
