"""The Python that the preferences name: one with NLOS Lab's command line, which Blender's own lacks."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import bpy

from generator.model.errors import NlosError

from . import making

EXTENSION = (__package__ or "nlos_lab.session").rpartition(".")[0]
"""Name of the extension, under which Blender keeps its preferences."""
TEST = "import classify.classifiers.models, sys; print('.'.join(map(str, sys.version_info[:3])))"
"""Prints the version of a Python that can read and train models."""
_PATIENCE = 120.0
"""Seconds within which a Python process must start, import its modules and answer."""
A_DAY = 86400.0
"""Seconds for what is long, and has its own button to end it."""

_is_made: bool | None = None


def named() -> str:
    """Return the path of the Python in the preferences; empty if none is set."""
    addon = bpy.context.preferences.addons.get(EXTENSION)
    return str(bpy.path.abspath(addon.preferences.python)) if addon else ""


def python() -> str:
    """Return the path of the Python in the preferences.

    Raises
    ------
    NlosError
        No path is set, or it is not that of a file.
    """
    path = named()
    if not path:
        raise NlosError(
            "Answers need a Python with scikit-learn: press Make Environment here or in Preferences > Add-ons > "
            "NLOS Lab, or name there the one that 'make setup' made (.venv/bin/python)"
        )
    if not os.path.isfile(path):  # false as well for a name that no file can have
        raise NlosError(f"{path} (Preferences > Add-ons > NLOS Lab) is no file; name the Python of an environment")
    return path


def chosen(path: str, what: str) -> Path:
    """Return a file that was chosen; ``what`` it should be, in words.

    Raises
    ------
    NlosError
        None is chosen, or it is not there.
    """
    if not path:
        raise NlosError(f"Choose {what}")
    found = Path(bpy.path.abspath(path)).absolute()
    if not os.path.isfile(found):  # false as well for a name that no file can have
        raise NlosError(f"{found} is no such file; choose {what}")
    return found


MODEL = "a model (.skops), which Train makes"
ATLAS = "an atlas, made by nlos-classify atlas in a shell, of a set with Data Set > Inside > Its Centre"


def own() -> Path:
    """Return the folder of the environment that the extension makes; it outlives the extension's updates.

    Raises
    ------
    NlosError

    Raises
    ------
    NlosError
        Blender keeps no such folder, as for an add-on that is no extension.
    """
    try:
        return Path(bpy.utils.extension_path_user(EXTENSION, path="environment"))
    except ValueError as error:
        raise NlosError(f"Blender has no folder for what the extension makes ({error})") from None


def is_made() -> bool:
    """Return whether the extension's own environment is there, as was seen last: panels ask while drawn."""
    return look() if _is_made is None else _is_made


def look() -> bool:
    """Look whether the extension's own environment is there."""
    global _is_made
    try:
        _is_made = making.is_whole(own())
    except NlosError:
        _is_made = False
    return _is_made


def name(path: str) -> None:
    """Set the Python in the preferences, which Blender saves when it ends."""
    bpy.context.preferences.addons[EXTENSION].preferences.python = path
    bpy.context.preferences.is_dirty = True


def run(
    arguments: list[str],
    stop: threading.Event,
    tell: Callable[[str], None] = lambda line: None,
    patience: float = _PATIENCE,
    doubtful: bool = False,
) -> str:
    """Run a Python command, isolated from Blender's modules, and return its output; kill it once ``stop`` is set.

    Parameters
    ----------
    arguments : list of str
        The Python, and what it is to run.
    stop : Event
    tell : callable
        Called in another thread with each line of its error output.
    patience : float
        Seconds that it may take.
    doubtful : bool
        Whether it tells by exit code 1 that its output is an answer in doubt.

    Raises
    ------
    NlosError
        The command cannot be started, takes too long, or fails; then with the last line of its error output.
    """
    try:
        # -E ignores Blender's PYTHONPATH and PYTHONHOME. -P would exclude the current folder, but needs Python 3.11.
        process = subprocess.Popen(
            [arguments[0], "-E", *arguments[1:]],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            errors="replace",
            cwd=str(Path(arguments[0]).parent),
            start_new_session=True,
        )
    except OSError as error:
        raise NlosError(f"{arguments[0]} cannot be run ({error.strerror or error})") from None
    output: list[str] = []
    errors: list[str] = []

    def listen() -> None:
        for line in process.stderr or ():
            if line.strip():
                errors.append(line.strip())
                tell(line.strip())

    def read() -> None:
        output.extend(process.stdout or ())

    readers = [threading.Thread(target=work, daemon=True) for work in (listen, read)]
    for reader in readers:
        reader.start()
    deadline = time.monotonic() + patience
    while process.poll() is None and not stop.is_set() and time.monotonic() < deadline:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.2)
    if process.poll() is None:
        _kill(process)
        raise NlosError(
            "Cancelled" if stop.is_set() else f"{arguments[0]} did not answer within {patience:.0f} seconds"
        )
    for reader in readers:
        reader.join(10.0)  # a process that it left running may hold its output open
    if process.returncode and not (doubtful and process.returncode == 1 and output):
        raise NlosError(errors[-1].removeprefix("error: ") if errors else f"exit code {process.returncode}")
    return "".join(output)


def _kill(process: subprocess.Popen[str]) -> None:
    """End a process that leads a session, and those that it started."""
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.wait()
