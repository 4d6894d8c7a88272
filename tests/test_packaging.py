"""What is built, and what is said where Blender is not installed. ``make matrix`` installs it for real."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

NO_BLENDER = "import sys; sys.modules['bpy'] = None; from generator import cli; sys.exit(cli.main(sys.argv[1:]))"


@pytest.mark.parametrize("command", ["scene room -o {}/new.blend", "check {}", "sweep {} -o {}/set --poses 1"])
def test_one_sentence_without_blender(tmp_path: Path, command: str) -> None:
    scene = ROOT / "blend_scenes" / "room.blend"
    words = [word.format(scene if word == "{}" else tmp_path) for word in command.split()]
    done = subprocess.run(
        [sys.executable, "-c", NO_BLENDER, *words], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert done.returncode == 2
    assert done.stderr.startswith("error: this needs Blender's module bpy, which is not installed")
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
