"""Runs a worker of the extension in a separate process: a Blender, or for `look_worker` any Python with NumPy.

``blender -b -P child.py -- generator.blender.worker ARGUMENTS``.

The extension is not enabled there, so its modules are loaded from the folder that contains this file.
"""

from __future__ import annotations

import importlib
import os
import sys
import types
from pathlib import Path

_AFTER_THE_WINDOW = 10
"""Added to the process's niceness: where cores are few, Blender's window goes first."""


def main() -> int:
    """Make a package of the folder, run the worker, return its exit code."""
    arguments = sys.argv[sys.argv.index("--") + 1 :]
    if hasattr(os, "nice"):
        os.nice(_AFTER_THE_WINDOW)
    package = types.ModuleType("nlos_lab_child")
    package.__path__ = [str(Path(__file__).resolve().parents[1])]
    sys.modules[package.__name__] = package
    return int(importlib.import_module(f"{package.__name__}.{arguments[0]}").main(arguments[1:]))


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # skips Blender's own shutdown, which the work does not need and which has been seen to crash
