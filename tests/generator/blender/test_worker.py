"""What a worker's process loads."""

from __future__ import annotations

import subprocess
import sys

from conftest import ROOT

from generator.jobs.protocol import PlanSweep

SCRIPT = """
import sys
from generator.blender import worker

assert worker.main(sys.argv[1:]) == 0
print("numba" in sys.modules)
"""


def test_a_worker_of_cycles_does_not_load_the_compiler(tmp_path, scene_file):
    chosen = {"engine": "patch", "resolution": "8", "poses": 1}
    request = PlanSweep(scene=scene_file, path=tmp_path / "set", chosen=chosen, probe=False, trust_links=False)
    command = [sys.executable, "-c", SCRIPT, *request.arguments[1:]]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "False"
