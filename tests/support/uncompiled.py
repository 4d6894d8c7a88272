"""Runs code in a Python that has no numba, as Blender's own."""

from __future__ import annotations

import subprocess
import sys

_BLOCKED = """
import sys
class NoNumba:
    def find_spec(self, name, *_):
        if name.split(".")[0] == "numba":
            raise ImportError(name)
sys.meta_path.insert(0, NoNumba())
sys.path[:0] = {folders!r}
from generator.transport import compiled
assert not compiled.COMPILED
"""


def run(script, *folders):
    """Run a script that imports from folders; fail with what it says if it fails."""
    code = _BLOCKED.format(folders=[str(folder) for folder in folders]) + script
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
