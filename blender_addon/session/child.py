"""Runs a worker of the extension in a separate Blender process.

``blender -b -P child.py -- generator.blender.worker ARGUMENTS``.

The extension is not enabled there, so its package is loaded from the folder that contains this file.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path


def main() -> int:
    """Load the package, run the worker, return its exit code."""
    arguments = sys.argv[sys.argv.index("--") + 1 :]
    folder = Path(__file__).resolve().parents[1]
    name = "nlos_lab_child"
    spec = importlib.util.spec_from_file_location(
        name, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    assert spec is not None
    assert spec.loader is not None
    package = importlib.util.module_from_spec(spec)
    sys.modules[name] = package
    spec.loader.exec_module(package)
    return int(importlib.import_module(f"{name}.{arguments[0]}").main(arguments[1:]))


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # skips Blender's own shutdown, which the work does not need and which has been seen to crash
