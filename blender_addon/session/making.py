"""Makes the Python that answers and training need: an environment with the packages that Blender's own Python lacks.

It finds `classify` and `generator` in the extension's folder, so only packages of others are downloaded. Nothing here
uses bpy, and nothing prints.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from generator.model.errors import NlosError

REQUIREMENTS = "requirements.txt"
"""Name of the list of packages in the extension's folder; its copy in an environment says that this one is whole."""
DOWNLOAD_MB, DISK_MB = 240, 860
"""What an environment takes, MB: measured under Linux with Python 3.11 and 3.13."""
ADDON = Path(__file__).resolve().parents[1]

_LINK = "nlos_lab.pth"
_OFFLINE = re.compile(r"connection broken by .*?(?:\[Errno -?\d+\]|:) ?([\w ,.()=-]+)['\"]\)")


def interpreter(folder: Path) -> Path:
    """Return the path of an environment's Python."""
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def is_whole(folder: Path) -> bool:
    """Return whether an environment has been made to the end."""
    return (folder / REQUIREMENTS).is_file()


def is_current(folder: Path) -> bool:
    """Return whether an environment has the packages that this version of the extension asks for."""
    try:
        return (folder / REQUIREMENTS).read_bytes() == (ADDON / REQUIREMENTS).read_bytes()
    except OSError:
        return False


def make(
    folder: Path,
    tell: Callable[[str, float], None],
    stop: threading.Event,
    python: str = "",
) -> Path:
    """Make an environment, in place of one that is there, which stays if that fails or is stopped.

    Parameters
    ----------
    folder : Path
        Where it goes.
    tell : callable
        Called with what is being done, in words, and the share that is done, 0 to 1.
    stop : Event
        Set to end early.
    python : str
        The Python that makes it, whose version it will have; empty for the one that runs this, Blender's own.

    Returns
    -------
    Path
        The environment's Python.

    Raises
    ------
    NlosError
        Python cannot make environments, there is no space, or a package cannot be installed; or it was stopped.
    """
    python = python or sys.executable
    lines = (ADDON / REQUIREMENTS).read_text(encoding="utf-8").splitlines()
    packages = len({line.split("==")[0] for line in lines})
    found: set[str] = set()

    def follow(line: str) -> None:
        kind, _, rest = line.strip().partition(" ")
        if kind == "Collecting":
            found.add(rest.split("==")[0])
            tell(
                f"Downloading {rest.split('==')[0]}, package {len(found)} of {packages}", 0.8 * len(found) / packages
            )
        elif kind == "Installing":
            tell(f"Unpacking {packages} packages, which takes a minute or two", 0.8)

    new = folder.with_name(f"{folder.name}.new")  # an older one stays if this fails
    remove(new)
    try:
        tell("Preparing", 0.0)
        _check(folder, python, stop)
        _run([python, "-I", "-m", "venv", str(new)], stop)
        made, temporary = str(interpreter(new)), new / "temporary"
        temporary.mkdir()
        options = ["--disable-pip-version-check", "--no-input", "--no-cache-dir", "--only-binary", ":all:"]
        install = [made, "-I", "-m", "pip", "install", *options, "--progress-bar", "off", "--retries", "2"]
        _run([*install, "-r", str(ADDON / REQUIREMENTS)], stop, follow, {"TMPDIR": str(temporary)})
        shutil.rmtree(temporary)
        tell("Trying it", 0.95)
        place = _run([made, "-I", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], stop)[-1]
        Path(place, _LINK).write_text(f"{ADDON}\n", encoding="utf-8")
        _run([made, "-I", "-c", "import classify.classifiers.models, classify.cli.main"], stop)
        shutil.copy(ADDON / REQUIREMENTS, new)
        remove(folder)
        new.rename(folder)  # its Python finds its packages from wherever it stands
        return interpreter(folder)
    except OSError as error:
        remove(new)
        raise NlosError(f"{folder}: no environment can be made there ({error.strerror or error})") from None
    except BaseException:
        remove(new)
        raise


def remove(folder: Path) -> None:
    """Remove an environment, if there is one.

    Raises
    ------
    NlosError
        A file of it cannot be removed.
    """
    try:
        if folder.exists():
            shutil.rmtree(folder)
    except OSError as error:
        raise NlosError(f"{error.filename or folder} cannot be removed ({error.strerror or error})") from None


def _check(folder: Path, python: str, stop: threading.Event) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(folder.parent).free / 1e6
    if free < DISK_MB + DOWNLOAD_MB:
        raise NlosError(f"{folder.parent} has {free:.0f} MB free, but {DISK_MB + DOWNLOAD_MB} MB are needed there")
    probe = (
        "import sys, importlib.util; found = [importlib.util.find_spec(n) for n in ('venv', 'ensurepip')]; "
        "print('%d.%d' % sys.version_info[:2], *(['whole'] if all(found) else []))"
    )
    version, *whole = _run([python, "-I", "-c", probe], stop)[-1].split()
    if not whole:
        raise NlosError(
            f"{python} cannot make environments, since it lacks ensurepip; "
            f"install it with: apt-get install python{version}-venv"
        )


def _run(
    command: Sequence[str],
    stop: threading.Event,
    follow: Callable[[str], None] = lambda line: None,
    variables: dict[str, str] | None = None,
) -> list[str]:
    """Run a command, and return the lines that it printed."""
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            env={**os.environ, **(variables or {})},
        )
    except OSError as error:
        raise NlosError(f"{command[0]} cannot be run ({error.strerror or error})") from None

    def watch() -> None:
        while process.poll() is None:
            if stop.wait(0.1):
                process.kill()
                return

    threading.Thread(target=watch, daemon=True, name="nlos environment").start()
    lines: list[str] = []
    with process:
        assert process.stdout is not None
        for line in process.stdout:
            follow(line)
            lines.append(line.rstrip())
    if stop.is_set():
        raise NlosError("Cancelled; what was made so far is removed")
    if process.returncode:
        raise NlosError(reason(lines) or f"{command[0]} ended with exit code {process.returncode}")
    return lines


def reason(lines: Sequence[str]) -> str:
    """Return why pip, or another Python, failed, from the lines that it printed; empty if they do not say."""
    said = [line.strip() for line in lines if line.strip()]
    for line in said:
        if "certificate verify failed" in line.lower():
            return "The certificate of the packages' server is not trusted here; ask who looks after this machine"
        if found := _OFFLINE.search(line):
            return f"The packages' server cannot be reached ({found[1].strip()})"
    errors = [line.removeprefix("ERROR:").strip() for line in said if line.startswith("ERROR:")]
    missing = next((e for e in errors if e.startswith("No matching distribution found for ")), "")
    if missing:
        package = missing.rpartition(" ")[2]
        return f"There is no {package} for Python {sys.version_info[0]}.{sys.version_info[1]} on this machine"
    return (errors or said or [""])[-1]
