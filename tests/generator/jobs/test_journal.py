"""What a run tells of itself: a log, a state for another shell; and workers that hang."""

from __future__ import annotations

import json
import logging
import os
import shutil
import socket
import sys
import tempfile
import time
from pathlib import Path

import pytest
from conftest import TINY

from generator.jobs import journal, workers
from generator.jobs.protocol import RenderSweep
from generator.jobs.workers import WorkerPool
from generator.model.errors import NlosError

HANG = "import sys, time; print('nlos {}', flush=True); sys.stdin.readline(); time.sleep({})"


def test_a_run_tells_what_it_did(tmp_path, scene_file, command):
    path = tmp_path / "set"
    assert command("generator", "sweep", scene_file, "-o", path, *TINY).returncode == 0
    log = (path / journal.LOG).read_text()
    assert "INFO 9 units to do by 1 workers" in log
    assert "INFO 9 of 9 done, 0 failed" in log
    result = command("generator", "status", path)
    assert result.returncode == 0, result.stderr
    first, second = result.stdout.splitlines()
    assert first == f"{path}: 9 of 9 pictures"
    assert f"on {socket.gethostname()}: ended, 9 of 9 in" in second
    found = json.loads(command("generator", "status", path, "--json").stdout)
    assert (found["planned"], found["done"], found["failed"], found["seconds_left"]) == (9, 9, [], None)


def test_another_shell_sees_workers_at_work(tmp_path, tiny_dataset):
    """Told by a journal that goes on, of a set that lacks two pictures."""
    path = tmp_path / "set"
    shutil.copytree(tiny_dataset, path)
    for name in ("A/0000.exr", "B/0000.exr"):
        (path / name).unlink()
    workers = [{"pid": os.getpid(), "doing": "A/0000.exr", "seconds": 3.0, "done": 4}]
    with journal.Journal(
        path, (1, 4), lambda: (["B/0000.exr: out of memory", "C/0000.exr: was made since"], workers)
    ) as own:
        own.told(1, 5)
        own._write()
        found = journal.read(path)
        assert (found["planned"], found["done"]) == (9, 7)
        assert found["failed"] == ["B/0000.exr: out of memory"]
        run = next(run for run in found["runs"] if run["pid"] == os.getpid())
        assert (run["state"], run["shard"], run["done"], run["total"]) == ("running", "1/4", 1, 5)
        assert run["workers"][0]["memory"] > 2**20
        words = "\n".join(journal.words({**found, "rate": 0.5, "seconds_left": 8.0}))
        assert "7 of 9 pictures, 0.5 a second, about 0:08 left" in words
        assert "A/0000.exr, 3 s; 4 done" in words
        assert "failed: B/0000.exr: out of memory" in words
    assert all(run["state"] == "ended" for run in journal.read(path)["runs"])


def test_a_run_that_died_is_lost(tmp_path, tiny_dataset):
    path = tmp_path / "set"
    shutil.copytree(tiny_dataset, path)
    state = journal.State(socket.gethostname(), 2**22 + 1, done=3, total=9, seconds=10.0)
    (path / journal.RUNS).mkdir(exist_ok=True)
    (path / journal.RUNS / "dead.json").write_text(json.dumps(vars(state)))
    (path / journal.RUNS / "torn.json").write_text("{")
    found = journal.read(path)
    assert "lost" in [run["state"] for run in found["runs"]]
    assert found["rate"] == 0.0


def test_no_data_set_has_no_status(tmp_path, command):
    result = command("generator", "status", tmp_path)
    assert result.returncode == 2
    assert "error: " in result.stderr


def asked(threads):
    return RenderSweep(path=Path(), threads=threads, trust_links=False)


def crew(tmp_path, script, **options):
    log = logging.getLogger(f"test {tmp_path}")
    lines = []
    log.addHandler(logging.Handler())
    log.handlers[0].emit = lambda record: lines.append(record.getMessage())
    log.setLevel(logging.INFO)

    def launch(arguments):
        return [sys.executable, "-c", script]

    return WorkerPool(asked, str, lambda done, total: None, launch=launch, log=log, **options), lines


def test_a_worker_that_hangs_is_ended_and_its_unit_listed(tmp_path):
    """Three tries of half a second each; the run goes on and comes to an end."""
    one, lines = crew(tmp_path, HANG.format('{"ready": true}', 3600), patience=(0.5, 0.5))
    begun = time.monotonic()
    one.work([7], 1)
    assert time.monotonic() - begun < 60.0
    assert one.failed[0].startswith("7: ")
    assert sum("said nothing for" in line for line in lines) == 3
    assert any("given up after 3 tries" in line for line in lines)


def test_a_worker_that_is_killed_leaves_nothing_behind(tmp_path, monkeypatch):
    """Not in the folder for temporary files either, where Blender and its renders write."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    script = (
        "import os, sys, pathlib, tempfile; print('nlos {\"ready\": true}', flush=True); sys.stdin.readline();"
        "pathlib.Path(tempfile.mkdtemp(), 'left').write_text('x'); os.kill(os.getpid(), 9)"
    )
    one, _ = crew(tmp_path, script)
    one.work([1, 2], 1)
    assert len(one.failed) == 2
    assert not [p for p in Path(tmp_path).iterdir() if p.is_dir()]


def test_workers_that_all_die_at_once_end_the_run(tmp_path):
    """A machine without memory, or a Blender that cannot start: no use in trying every picture three times."""
    one, _ = crew(tmp_path, "import sys; sys.exit('no memory')")
    with pytest.raises(NlosError, match="50 workers in a row ended before one picture was done: no memory"):
        one.work(range(200), 2)


def test_old_runs_are_forgotten_and_running_ones_are_not(tmp_path, tiny_dataset):
    path = tmp_path / "set"
    shutil.copytree(tiny_dataset, path)
    folder = path / journal.RUNS
    old = {"gone": journal.ENDED, "silent": journal.RUNNING, "at-work": journal.RUNNING}
    now = time.time()
    for name in (*old, *(f"later-{k}" for k in range(journal._KEPT))):
        state = journal.State(name, 1, state=old.get(name, journal.ENDED))
        (folder / f"{name}-1.json").write_text(json.dumps(vars(state)))
        age = {"gone": 900.0, "silent": 2 * journal._FORGOTTEN, "at-work": 600.0}.get(name, 0.0)
        os.utime(folder / f"{name}-1.json", (now - age, now - age))
    (folder / "nonsense.json").write_text("[")
    os.utime(folder / "nonsense.json", (1.0, 1.0))
    with journal.Journal(path, (0, 1), lambda: ([], [])):
        pass
    left = {file.name for file in folder.iterdir()}
    assert "at-work-1.json" in left
    assert not {"gone-1.json", "silent-1.json", "nonsense.json"} & left
    assert len(left) == journal._KEPT + 1


@pytest.mark.parametrize(
    "spoil",
    [
        {"failed": 3},
        {"failed": [["A"]]},
        {"seconds": float("nan")},
        {"seconds": {}},
        {"total": 10**400},
        {"workers": 7},
        {"workers": [{"pid": 1}]},
        {"host": []},
    ],
)
def test_nonsense_about_a_run_is_no_run(tmp_path, tiny_dataset, spoil):
    path = tmp_path / "set"
    shutil.copytree(tiny_dataset, path)
    before = len(journal.read(path)["runs"])
    state = {**vars(journal.State("host", 1, done=1, total=2, seconds=1.0)), **spoil}
    (path / journal.RUNS / "host-1.json").write_text(json.dumps(state))
    (path / journal.RUNS / "host-2.json").write_text("[" * 50)
    found = journal.read(path)
    assert len(found["runs"]) == before
    assert journal.words(found)


def test_no_worker_comes_after_all_are_stopped(monkeypatch):
    made = []
    monkeypatch.setattr(workers, "Worker", lambda *_: made.append(1))
    crew = WorkerPool(asked, str, lambda done, total: None)
    crew._stopped.set()
    assert crew._start(1) is None
    crew.work([1, 2], 2, first="the background")
    assert not made
