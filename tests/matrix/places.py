"""Where a row's Python runs: on this machine, or in a Debian of its own where this machine has no such Python."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "gui"))
import roots

SUITES = {"3.13": "trixie"}
PACKAGES = (
    "python3-venv",
    # What bpy loads.
    *("libx11-6", "libxxf86vm1", "libxfixes3", "libxi6", "libxrender1", "libxkbcommon0"),
    *("libsm6", "libice6", "libgl1", "libegl1"),
)
_PROBE = "import ensurepip, sys, venv; print('{}.{}'.format(*sys.version_info), sys.executable)"
# Some processors need them for right results; all else of the machine's environment stays out.
_KEPT = ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE", "LD_LIBRARY_PATH")


class AbsentError(Exception):
    """There is no place for a row, and why."""


@dataclass
class Place:
    """A Python and a folder for it.

    Parameters
    ----------
    python : str
        How it is called there.
    folder : Path
        As seen from outside.
    root : Path, optional
        The Debian that it lives in.
    """

    python: str
    folder: Path
    root: Path | None = None
    environment: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        kept = {name: os.environ[name] for name in _KEPT if name in os.environ}
        for name in ("home", "tmp", "empty"):
            (self.folder / name).mkdir(exist_ok=True)
        homes = {"HOME": self.inside(self.folder / "home"), "TMPDIR": self.inside(self.folder / "tmp")}
        self.environment = {**roots.environment(), **kept, **homes, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}

    def inside(self, path: Path) -> str:
        """Return what a path is called there."""
        return f"/{path.relative_to(self.root)}" if self.root else str(path)

    def run(self, words: Sequence[str | Path], limit: float) -> subprocess.CompletedProcess[str]:
        """Run a command in the folder ``empty``, from which no source can be imported."""
        command = [self.inside(word) if isinstance(word, Path) else word for word in words]
        command = ["env", "-C", self.inside(self.folder / "empty"), *command]
        return subprocess.run(
            roots.enter(self.root, command) if self.root else command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            env=self.environment,
            timeout=limit,
            check=False,
        )


@contextmanager
def place(version: str, named: str | None, folder: Path, root: Path, log: Path) -> Iterator[Place]:
    """Find or make a place for a Python; what lies there goes with the context where it is not below ``folder``.

    Parameters
    ----------
    version : str
        Such as "3.13".
    named : str, optional
        The Python that the user has named for it.
    folder : Path
        For a row on this machine; must exist.
    root : Path
        Where Debian systems are or go.
    log : Path
        For what making one says.

    Raises
    ------
    AbsentError
        Neither this machine nor a Debian has it.
    """
    found = named or f"python{version}"
    told, executable = _probed(found)
    if told == version:
        yield Place(executable, folder)
        return
    if named:
        raise AbsentError(f"{named} is not Python {version} with venv, but {told}")
    if version not in SUITES:
        raise AbsentError(f"this machine has no python{version}: {told}")
    system = (root / SUITES[version]).resolve()
    with ExitStack() as stack:
        try:
            roots.check_machine(system)
            stack.enter_context(roots.locked(system))
            if not system.exists():
                roots.make(system, SUITES[version], roots.mirror(), log)
            stack.enter_context(roots.mounted(system))
            roots.complete(system, log, PACKAGES)
        except (roots.MissingError, OSError, subprocess.CalledProcessError) as error:
            raise AbsentError(f"this machine has no python{version}, and no Debian that has: {error}") from None
        own = Path(tempfile.mkdtemp(prefix="nlos-matrix-", dir=system / "tmp"))
        stack.callback(shutil.rmtree, own, ignore_errors=True)
        there = Place("/usr/bin/python3", own, system)
        told, _ = _read(there.run([there.python, "-c", _PROBE], 60.0))
        if told != version:
            raise AbsentError(f"Debian {SUITES[version]} has no Python {version}, but {told}")
        yield there


def _probed(python: str) -> tuple[str, str]:
    """Return the version of a Python that can make environments and where it lies, or what is wrong with it."""
    try:
        return _read(
            subprocess.run([python, "-c", _PROBE], capture_output=True, text=True, timeout=60.0, check=False)
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error), ""


def _read(done: subprocess.CompletedProcess[str]) -> tuple[str, str]:
    if done.returncode:
        return (done.stderr.strip() or f"exit code {done.returncode}").splitlines()[-1], ""
    version, _, executable = done.stdout.strip().partition(" ")
    return version, executable
