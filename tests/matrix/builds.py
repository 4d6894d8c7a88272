"""Wheel, sdist and extension, built in surroundings that differ, and what must be in them."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import time
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

PACKAGES = ("generator", "classify", "blender_addon")
SOURCES = (*PACKAGES, "blend_scenes", "tests", "benchmarks")
BESIDE = (".gitignore", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "Makefile", "README.md")
SETTINGS = ("constraints.txt", "pyproject.toml")
PAGES = (".md", ".py", ".css", ".ipynb", ".csv")
"""Of the documentation; its pictures would be ten times the rest."""

# What asks for the time while an archive is packed asks one of these.
CLOCK = """
import time
then, gmtime, localtime = time.time, time.gmtime, time.localtime
time.time = lambda: then() + {ahead}
time.gmtime = lambda seconds=None: gmtime(time.time() if seconds is None else seconds)
time.localtime = lambda seconds=None: localtime(time.time() if seconds is None else seconds)
"""


@dataclass(frozen=True)
class Surroundings:
    """What a build must not depend on."""

    umask: int
    zone: str
    ahead: int
    """Of the clock, in seconds."""
    hash_seed: str
    language: str

    def environment(self, folder: Path, **more: str) -> dict[str, str]:
        """Return the environment of a build; its clock is written into a folder."""
        folder.mkdir(exist_ok=True)
        (folder / "sitecustomize.py").write_text(CLOCK.format(ahead=self.ahead), encoding="utf-8")
        mine = {"PYTHONPATH": str(folder), "PYTHONHASHSEED": self.hash_seed, "TZ": self.zone, "LC_ALL": self.language}
        return {**os.environ, **mine, **more}


HERE = Surroundings(0o022, "UTC", 0, "1", "C.UTF-8")
THERE = Surroundings(0o077, "Pacific/Kiritimati", 400 * 86400, "2", "C")


def tracked(root: Path) -> list[str]:
    """Return the files that git knows, also where they have been changed since the last commit."""
    told = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True).stdout
    return sorted(name for name in told.split("\0") if name and (root / name).is_file())


def committed(root: Path) -> str:
    """Return when the last commit was made, in seconds since 1970."""
    asked = ["git", "log", "-1", "--format=%ct"]
    return subprocess.run(asked, cwd=root, capture_output=True, text=True, check=True).stdout.strip()


def copied(root: Path, folder: Path, around: Surroundings) -> Path:
    """Copy the tree as a clone would lay it there: with other dates, and permissions by the umask."""
    for name in tracked(root):
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(root / name, target)
        target.chmod((0o777 if os.access(root / name, os.X_OK) else 0o666) & ~around.umask)
        then = time.time() - 86400 + around.ahead
        os.utime(target, (then, then))
    return folder


def archives(tree: Path, made: Path, around: Surroundings, *kinds: str, **more: str) -> dict[str, Path]:
    """Build sdist and wheel of a tree, or only the kinds named; return them by kind.

    Raises
    ------
    subprocess.CalledProcessError
        What was said is in its ``stderr``.
    """
    flags = [word for kind in kinds for word in ("-t", kind)]
    _run([sys.executable, "-m", "hatchling", "build", *flags, "-d", str(made)], tree, around, **more)
    ends = {"sdist": "*.tar.gz", "wheel": "*.whl"}
    return {kind: next(made.glob(ends[kind])) for kind in kinds or ends}


def extension(tree: Path, made: Path, around: Surroundings, **more: str) -> Path:
    """Build the extension of a tree."""
    _run([sys.executable, "-m", "blender_addon.packaging.build", "-o", str(made)], tree, around, **more)
    return next(made.glob("*.zip"))


def unpacked(sdist: Path, folder: Path) -> Path:
    """Unpack an sdist; return the tree."""
    folder.mkdir()
    subprocess.run(["tar", "-xf", str(sdist), "-C", str(folder)], check=True)
    [tree] = folder.iterdir()
    return tree


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def faults(made: Mapping[str, Path], names: list[str]) -> list[str]:
    """Return what sdist and wheel hold too much or too little.

    Parameters
    ----------
    made : mapping
        The archives by kind.
    names : list of str
        The files that git knows.
    """
    found = []
    if "wheel" in made:
        inside = set(zipfile.ZipFile(made["wheel"]).namelist())
        whole = made["wheel"].name.rsplit("-", 3)[0] + ".dist-info/"
        own = {whole + name for name in ("METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE")}
        found += _differences("wheel", inside, own | {name for name in names if name.startswith(_below(PACKAGES))})
    if "sdist" in made:
        with tarfile.open(made["sdist"]) as archive:
            inside = {name.partition("/")[2] for name in archive.getnames()}
        pages = {name for name in names if name.startswith("docs/") and name.endswith(PAGES)}
        sources = {name for name in names if name.startswith(_below(SOURCES))}
        found += _differences("sdist", inside, {"PKG-INFO", *BESIDE, *SETTINGS} | pages | sources)
    return found


def _below(folders: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{folder}/" for folder in folders)


def _differences(kind: str, inside: set[str], wanted: set[str]) -> list[str]:
    lacking = [f"the {kind} lacks {name}" for name in sorted(wanted - inside)]
    return lacking + [f"the {kind} should not hold {name}" for name in sorted(inside - wanted)]


def _run(command: list[str], tree: Path, around: Surroundings, **more: str) -> None:
    environment = around.environment(tree.parent / "clock", **more)
    subprocess.run(command, cwd=tree, env=environment, umask=around.umask, capture_output=True, text=True, check=True)
