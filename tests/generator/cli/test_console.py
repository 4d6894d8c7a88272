"""Commands whose output nobody reads any more, or cannot be written: quiet, or one sentence; no traceback."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys

import pytest
from conftest import ROOT, TINY

from classify.cli import main as classify_cli
from generator.cli import main as generate_cli
from generator.cli.terminal import guarded

GONE, FULL = 141, "error: standard output cannot be written (No space left on device)\n"
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


def verbs(module):
    [commands] = module.parser()._subparsers._group_actions
    return sorted(commands.choices)


def run(arguments, where):
    """Run with standard output as a pipe that nobody reads (gone), on a full disk (full), or closed."""
    with contextlib.ExitStack() as stack:
        if where == "gone":
            ours, output = os.pipe()
            os.close(ours)
            stack.callback(os.close, output)
        else:
            output = stack.enter_context(open("/dev/full", "w"))
        shut = (lambda: os.close(1)) if where == "closed" else None
        return subprocess.run(
            [sys.executable, *map(str, arguments)],
            stdout=output,
            stderr=subprocess.PIPE,
            text=True,
            env=ENVIRONMENT,
            timeout=120,
            check=False,
            preexec_fn=shut,
        )


def told(arguments, where):
    done = run(arguments, where)
    return done.returncode, done.stderr


class Broken(io.StringIO):
    """A stream that takes nothing; as a reader that left, or a full disk, refuses at the end what was held back."""

    def __init__(self, error):
        super().__init__()
        self.error = error

    def flush(self):
        raise self.error


@pytest.mark.parametrize("module", [generate_cli, classify_cli])
def test_every_verb_is_quiet_when_nobody_reads_and_says_so_when_the_disk_is_full(module, monkeypatch, capsys):
    """In this process: two dozen interpreters would take half a minute."""
    assert len(verbs(module)) > 8
    for verb in verbs(module):
        for error, code, words in ((BrokenPipeError(), GONE, ""), (OSError(28, "No space left on device"), 2, FULL)):
            monkeypatch.setattr(sys, "stdout", Broken(error))
            assert module.main([verb, "--help"]) == code
            assert capsys.readouterr().err == words, verb
            monkeypatch.undo()


@pytest.mark.slow
def test_a_command_that_ends_by_itself(tmp_path, scene_file, tiny_dataset):
    scene = ["-m", "generator.cli", "scene", "room", "--show"]
    assert told(scene, "gone") == (GONE, "")
    assert told(scene, "full") == (2, FULL)
    # Blender must not take another file for the standard output that is not there.
    saved = tmp_path / "closed.blend"
    assert told([*scene, "--set", "resolution=[8,8]", "-o", saved], "closed") == (0, "")
    check = ["-m", "generator.cli", "check", saved, "--engine", "surfel", "--poses", "1"]
    assert told(check, "closed") == (0, "")
    assert told(check, "gone") == (GONE, "")
    features = ["-m", "classify.cli", "features", tiny_dataset, "-o", tmp_path / "f.h5"]
    assert told(features, "gone") == (GONE, "")
    assert told(features, "full") == (2, FULL)


def test_a_sweep_whose_progress_nobody_reads_ends_and_goes_on_later(tmp_path, scene_file):
    """Progress is printed by the threads that feed the workers: their failure must end the command, not a thread."""
    sweep = ["-m", "generator.cli", "sweep", scene_file, "-o", tmp_path / "set", *TINY]
    assert told(sweep, "gone") == (GONE, "")
    assert told(sweep, "full") == (2, FULL)
    last = subprocess.run([sys.executable, *map(str, sweep)], capture_output=True, env=ENVIRONMENT, check=False)
    assert last.returncode == 0
    assert b"finished" in last.stdout
    assert len(list((tmp_path / "set").glob("?/*.exr"))) == 9


def test_batch_inside_blender(tmp_path, scene_file):
    code = (
        f"import bpy, runpy, sys; sys.argv = ['blender', '--', '-o', sys.argv[1], *{TINY[:-2]!r}];"
        f"bpy.ops.wm.open_mainfile(filepath={str(scene_file)!r});"
        f"runpy.run_path({str(ROOT / 'generator' / 'batch.py')!r}, run_name='__main__')"
    )
    assert told(["-c", code, tmp_path / "a"], "gone") == (GONE, "")
    assert told(["-c", code, tmp_path / "b"], "full") == (2, FULL)


def test_blender_says_nothing_of_its_own(scene_file, command):
    done = command("generator", "check", scene_file, "--engine", "path", "--poses", "1", "--samples", "1")
    assert all(line.startswith(("good:", "note:", "warning:", "error:")) for line in done.stdout.splitlines())


def test_other_files_on_a_full_disk_are_not_taken_for_the_output(capsys):
    def work():
        raise OSError(28, "No space left on device", "picture.exr")

    assert guarded(work) == 70
    told = capsys.readouterr().err
    assert "standard output" not in told
    assert "No space left on device: 'picture.exr'" in told


def test_an_error_is_told_by_the_exit_code_where_standard_error_is_full():
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "generator.cli", "status", "/nowhere"], stderr=full, env=ENVIRONMENT, check=False
        )
    assert done.returncode == 2
