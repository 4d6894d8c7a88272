"""The Python that the preferences name: one with NLOS Lab's command line, which Blender's own lacks."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from generator.model.errors import NlosError

EXTENSION = (__package__ or "nlos_lab.session").rpartition(".")[0]
"""Name of the extension, under which Blender keeps its preferences."""


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
            "Answers need a Python with NLOS Lab's command line: make one with 'make setup' in its folder, "
            "and name its .venv/bin/python in Preferences > Add-ons > NLOS Lab"
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


MODEL = "a model, trained by nlos-classify train (.skops)"
ATLAS = "an atlas, made by nlos-classify atlas of pictures with --inside centre"
