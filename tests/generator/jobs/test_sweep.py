"""Data sets: killed and resumed, refused and verified."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, TINY
from processes import start, wait_for_pictures

from generator.files.pictures import read_picture
from generator.jobs import local, workers
from generator.jobs.protocol import RenderSweep
from generator.jobs.request import SweepRequest
from generator.sets.dataset import Dataset

SLOW = ("--engine", "patch", "--poses", "2", "--samples", "48", "--resolution", "24", "--no-probe")


def pixels_of(path):
    dataset = Dataset.open(path)
    assert len(dataset.records) == dataset.planned
    return {pose.file: dataset.picture(pose) for pose in dataset.records}


def asked(threads):
    return RenderSweep(path=Path(), threads=threads, trust_links=False)


@pytest.mark.slow
def test_killed_twice_and_resumed_with_other_workers_gives_the_same_pixels(tmp_path, scene_file, command):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert command("generator", "sweep", scene_file, "-o", whole, *SLOW, "--workers", "1").returncode == 0
    for pictures, count in ((2, "1"), (7, "2")):
        process = start(scene_file, killed, *SLOW, "--workers", count)
        wait_for_pictures(killed, pictures, process)
        process.send_signal(signal.SIGKILL)
        process.wait()
    made = len(list(killed.glob("?/*.exr")))
    assert 7 <= made < 18, "killed too late to show anything"
    last = command("generator", "sweep", scene_file, "-o", killed, *SLOW, "--workers", "2")
    assert last.returncode == 0, last.stderr
    a, b = pixels_of(whole), pixels_of(killed)
    assert a.keys() == b.keys()
    for file in a:
        np.testing.assert_array_equal(a[file], b[file])
    np.testing.assert_array_equal(Dataset.open(whole).background(), Dataset.open(killed).background())


def test_shards_make_the_same_set(tmp_path, scene_file, tiny_dataset, command):
    for shard in ("1/2", "0/2"):
        result = command("generator", "sweep", scene_file, "-o", tmp_path / "s", *TINY, "--shard", shard)
        assert result.returncode == 0, result.stderr
    a, b = pixels_of(tiny_dataset), pixels_of(tmp_path / "s")
    for file in a:
        np.testing.assert_array_equal(a[file], b[file])


def test_blender_batch_script_makes_the_same_set(tmp_path, scene_file, tiny_dataset):
    """As ``blender -b scene.blend -P generator/batch.py -- ...`` does it: the file open, the script run in place."""
    script = (
        "import sys, runpy, bpy;"
        f"bpy.ops.wm.open_mainfile(filepath={str(scene_file)!r});"
        f"sys.argv = ['blender', '-b', 's', '-P', 'batch.py', '--', '-o', {str(tmp_path / 'b')!r}, *{TINY[:-2]!r}];"
        f"runpy.run_path({str(ROOT / 'generator' / 'batch.py')!r}, run_name='__main__')"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    a, b = pixels_of(tiny_dataset), pixels_of(tmp_path / "b")
    for file in a:
        np.testing.assert_array_equal(a[file], b[file])


def test_ctrl_c_leaves_a_set_that_goes_on(tmp_path, scene_file, command):
    path = tmp_path / "set"
    process = start(scene_file, path, *SLOW, "--workers", "1")
    wait_for_pictures(path, 2, process)
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 130
    dataset = Dataset.open(path)
    assert 2 <= len(dataset.records) < dataset.planned, "the manifest knows what is done"
    assert not list(path.rglob("*.tmp"))


def test_a_finished_set_is_left_alone(tmp_path, scene_file, tiny_dataset, command):
    before = {p: p.stat().st_mtime_ns for p in tiny_dataset.rglob("*.exr")}
    result = command("generator", "sweep", scene_file, "-o", tiny_dataset)
    assert result.returncode == 0
    assert "finished, nothing to do" in result.stdout
    assert {p: p.stat().st_mtime_ns for p in tiny_dataset.rglob("*.exr")} == before


def test_other_settings_are_refused_by_name(scene_file, tiny_dataset, command):
    result = command("generator", "sweep", scene_file, "-o", tiny_dataset, "--samples", "5", "--seed", "3")
    assert result.returncode == 2
    assert "samples is 64 there and 5 here; seed is 0 there and 3 here" in result.stderr


def test_another_scene_is_refused(tmp_path, tiny_dataset, command):
    command("generator", "scene", "tabletop", "-o", tmp_path / "other.blend")
    result = command("generator", "sweep", tmp_path / "other.blend", "-o", tiny_dataset)
    assert result.returncode == 2
    assert "not the scene it was rendered from" in result.stderr


def test_the_noise_of_no_two_poses_is_the_same(tmp_path, scene_file, command):
    """Unpaired, the pictures of a room differ by the target and by noise; equal noise would correlate them."""
    path = tmp_path / "noise"
    small = ("--poses", "1", "--samples", "2", "--resolution", "24", "--workers", "1")
    options = ("--engine", "patch", "--no-paired", *small)
    assert command("generator", "sweep", scene_file, "-o", path, *options).returncode == 0
    other = tmp_path / "other"
    assert command("generator", "sweep", scene_file, "-o", other, *options, "--seed", "1").returncode == 0

    def noise(path):
        pictures = np.array([p[..., 0] for p in pixels_of(path).values()], dtype=np.float64)
        # What a pixel has beyond its neighbours is noise at two samples.
        rough = pictures[:, 1:-1, 1:-1] - (pictures[:, :-2, 1:-1] + pictures[:, 2:, 1:-1]) / 2
        return rough.reshape(len(pictures), -1)

    both = np.concatenate([noise(path), noise(other)])
    correlation = np.corrcoef(both)[np.triu_indices(len(both), 1)]
    # 484 pixels, 153 pairs: chance alone stays below 5 standard deviations of 1/sqrt(484).
    assert np.abs(correlation).max() < 5 / np.sqrt(both.shape[1])


def test_paired_noise_is_unbiased_and_smaller(scene_file):
    """The control variate changes no mean and shrinks the error of the difference."""
    from generator.blender.engines import renderers
    from generator.blender.scene import blend_file, posing

    scene = blend_file.open_file(scene_file)
    posing.move_target(scene, (2.05, 1.65, 1.3), (0.0, 0.0, 45.0))
    seeds = range(1, 9)
    with renderers.opened(scene, "patch", resolution=(16, 16)) as renderer:
        reference = renderer.render(samples=4096, seed=100, target=False)[..., 0].astype(float)
        plain = np.array([renderer.render(samples=64, seed=s)[..., 0] for s in seeds], dtype=float)
        own = np.array([renderer.render(samples=64, seed=s, target=False)[..., 0] for s in seeds], dtype=float)
    raw, paired = plain - reference, plain - own
    assert paired.std(axis=0).mean() < 0.6 * raw.std(axis=0).mean()
    gap = (raw - paired).mean(axis=(1, 2))
    assert abs(gap.mean()) < 4 * gap.std(ddof=1) / np.sqrt(len(gap)) + reference.mean() * 1e-3


def test_ambient_set_has_two_backgrounds(tmp_path, command):
    scene = tmp_path / "a.blend"
    assert command("generator", "scene", "room", "--ambient", "0.01", "-o", scene).returncode == 0

    result = command("generator", "sweep", scene, "-o", tmp_path / "a", *TINY)
    assert result.returncode == 0, result.stderr
    dataset = Dataset.open(tmp_path / "a")
    dark, _ = read_picture(tmp_path / "a" / "background.exr")
    assert dataset.background().mean() > dark.mean() > 0
    assert not dataset.verify()


def copied(tiny_dataset, tmp_path):
    shutil.copytree(tiny_dataset, tmp_path / "copy")
    return tmp_path / "copy"


def test_verify_finds_what_was_done_to_a_set(tmp_path, tiny_dataset, command):
    path = copied(tiny_dataset, tmp_path)
    good = command("generator", "verify", path)
    assert (good.returncode, good.stdout.splitlines()[-1]) == (0, f"{path}: 9 poses, 0 faults")
    cut = path / "B" / "0000.exr"
    cut.write_bytes(cut.read_bytes()[:-20])
    (path / "C" / "0000.exr").unlink()
    shutil.copy(path / "D" / "0000.exr", path / "E" / "0000.exr")
    bad = command("generator", "verify", path)
    assert bad.returncode == 1
    for label in "BC":
        assert f"{label}/0000.exr: missing or broken" in bad.stdout
    assert "E/0000.exr: is a picture of label D, not E" in bad.stdout
    assert bad.stdout.splitlines()[-1].endswith("3 faults")


def test_what_was_spoilt_is_rendered_again(tmp_path, scene_file, tiny_dataset, command):
    path = copied(tiny_dataset, tmp_path)
    for label in "BC":
        (path / label / "0000.exr").write_bytes(b"nonsense")
    (path / "background.exr").unlink()
    result = command("generator", "sweep", scene_file, "-o", path)
    assert result.returncode == 0, result.stderr
    assert "2 of them rendered now" in result.stdout
    a, b = pixels_of(tiny_dataset), pixels_of(path)
    for file in a:
        np.testing.assert_array_equal(a[file], b[file])


def test_a_worker_that_dies_is_replaced_and_a_hopeless_pose_is_listed(tmp_path, tiny_dataset, monkeypatch):
    """The first worker process dies on its first pose; one pose kills every worker."""
    from generator.jobs import local
    from generator.jobs.workers import TRIES

    path = copied(tiny_dataset, tmp_path)
    for label in "AB":
        (path / label / "0000.exr").unlink()
    script = tmp_path / "worker.py"
    script.write_text(
        "import os, runpy, sys\n"
        "lines = sys.stdin\n"
        "class Deadly:\n"
        "    def __iter__(self):\n"
        "        for line in lines:\n"
        "            if int(line) == 0: print('out of memory', file=sys.stderr, flush=True); os._exit(9)\n"
        "            yield line\n"
        "sys.stdin = Deadly()\n"
        "runpy.run_module('generator.blender.worker', run_name='__main__')\n"
    )
    real = subprocess.Popen
    started = []

    def popen(arguments, **options):
        if "generator.blender.worker" in arguments:
            started.append(arguments)
            arguments = [arguments[0], str(script), *arguments[3:]]
        return real(arguments, **options)

    monkeypatch.setattr(workers.subprocess, "Popen", popen)
    outcome = local.run(SweepRequest(scene=tiny_dataset / "scene.blend", path=path, workers=1))
    assert outcome.failed == ["A/0000.exr: out of memory (exit code 9)"]
    assert (outcome.rendered, outcome.remaining) == (1, 1)
    assert len(started) == TRIES + (1 if len(started) > TRIES else 0)


def test_a_hidden_target_is_refused_before_anything_is_written(tmp_path, scene_file, command):
    from generator.blender.scene import blend_file, roles

    scene = blend_file.open_file(scene_file)
    roles.find(scene, "target").hide_render = True
    spoilt = tmp_path / "hidden.blend"
    blend_file.save_file(spoilt)
    for engine in ("path", "patch", "surfel"):
        result = command("generator", "sweep", spoilt, "-o", tmp_path / "set", "--engine", engine)
        assert result.returncode == 2
        assert "hidden from renders" in result.stderr
        assert not (tmp_path / "set").exists()


@pytest.mark.slow
def test_a_run_can_be_stopped_and_gone_on_with(tmp_path, scene_file):
    from generator.jobs import local

    stop, path = threading.Event(), tmp_path / "set"
    chosen = {"engine": "patch", "poses": 20, "samples": 512, "resolution": [4, 4]}

    def progress(done, total):
        if done == 2:
            stop.set()

    outcome = local.run(
        SweepRequest(scene=scene_file, path=path, chosen=chosen, workers=1, probe=False), progress=progress, stop=stop
    )
    assert 2 <= outcome.rendered < 100
    assert outcome.remaining == 180 - outcome.rendered
    assert not outcome.failed
    assert all("not rendered yet" in fault for fault in Dataset.open(path).verify())
    again = local.run(SweepRequest(scene=path / "scene.blend", path=path, workers=2))
    assert again.rendered == outcome.remaining
    assert not again.dataset.verify()


def test_one_hopeless_unit_fails_alone_of_its_batch(monkeypatch):
    from generator.jobs.workers import WorkerPool

    class Mortal:
        pid, done = 1, 0

        def __init__(self, arguments, launch):
            self.batch = ()

        def begin(self, what):
            pass

        def look(self):
            return {"doing": "", "seconds": 0.0}

        def send(self, batch):
            self.batch = [int(word) for word in batch.split()]

        def answer(self):
            return None if 3 in self.batch else {"done": True}

        def last_words(self):
            return "out of memory"

        def kill(self):
            pass

        def stop(self):
            pass

    monkeypatch.setattr(workers, "Worker", Mortal)
    told = []
    crew = WorkerPool(asked, str, lambda done, total: told.append((done, total)))
    crew.work(range(64), 1, batch=8)
    assert crew.failed == ["3: out of memory"]
    assert told[1] == (8, 64), "the others go on in batches"
    assert told[-1] == (63, 64)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("sweep", "nowhere.blend", "-o", "x"), "nowhere.blend: no such scene file"),
        (("sweep", "{scene}", "-o", "{scene}"), "is a file; name a folder"),
        (("sweep", "{scene}", "-o", "/dev/null/x"), "/dev/null"),
        (("sweep", "{scene}", "-o", "{foreign}"), "holds other files"),
        (("sweep", "{scene}", "-o", "x", "--shard", "4/4"), "--shard"),
        (("sweep", "{scene}", "-o", "x", "--samples", "0"), "samples: 0 must be"),
        (("sweep", "{scene}", "-o", "x", "--resolution", "big"), "resolution"),
        (("sweep", "{scene}", "-o", "x", "--workers", "-1"), "--workers"),
        (("sweep", "{newer}/scene.blend", "-o", "{newer}"), "format 4; this software reads up to 3"),
        (("verify", "{foreign}"), "is not a data set"),
        (("scene", "room", "-o", "room.txt"), "must end in .blend"),
        (("scene", "room", "--target", "cube", "-o", "x.blend"), "sheet, sphere or a mesh file"),
        (("scene", "room", "-o", "/dev/null/x.blend"), "/dev/null/x.blend: cannot be written"),
        (("scene", "room"), "nothing to do"),
        (("scene", "room", "--config", "no.toml", "-o", "x.blend"), "no.toml: cannot be read"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(tmp_path, scene_file, tiny_dataset, command, arguments, words):
    foreign, newer = tmp_path / "foreign", tmp_path / "newer"
    foreign.mkdir()
    (foreign / "holiday.jpg").touch()
    shutil.copytree(tiny_dataset, newer)
    manifest = newer / "dataset.toml"
    manifest.write_text(manifest.read_text().replace("format = 2", "format = 4"))
    before = sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*"))
    names = {"scene": scene_file, "foreign": foreign, "newer": newer}
    result = command("generator", *(a.format(**names) for a in arguments), cwd=tmp_path)
    assert result.returncode == 2, result.stdout + result.stderr
    assert result.stderr.count("\n") == 1, result.stderr
    assert result.stderr.startswith("error: ")
    assert words in result.stderr
    assert sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*")) == before, "something was left behind"


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        ("bpy.data.objects.remove(bpy.data.objects['Target'])", "no object is the target"),
        ("bpy.context.collection.objects.link(bpy.data.objects['Target'].copy())", "2 objects are the target"),
        ("bpy.data.objects['Spot'].data.shadow_soft_size = 0.1", "has a radius of 0.1 m"),
    ],
)
def test_a_bad_scene_is_refused_before_anything_is_written(tmp_path, scene_file, command, spoil, words):
    bad = tmp_path / "bad.blend"
    script = (
        f"import bpy; bpy.ops.wm.open_mainfile(filepath={str(scene_file)!r}); {spoil};"
        f"bpy.ops.wm.save_as_mainfile(filepath={str(bad)!r})"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    result = command("generator", "sweep", bad, "-o", tmp_path / "x", "--engine", "patch")
    assert result.returncode == 2
    assert words in result.stderr
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "x").exists()


def test_a_text_file_is_no_scene(tmp_path, command):
    (tmp_path / "fake.blend").write_text("hello")
    result = command("generator", "sweep", tmp_path / "fake.blend", "-o", tmp_path / "x")
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    assert "fake.blend: is not a scene" in result.stderr


@pytest.mark.parametrize("arguments", [("--help",), ("scene", "--help"), ("sweep", "--help"), ("verify", "--help")])
def test_help_is_there(command, arguments):
    result = command("generator", *arguments)
    assert result.returncode == 0
    assert "usage: nlos-generate" in result.stdout


def test_a_share_reads_its_own_pictures_and_the_last_leaves_the_manifest_whole(tmp_path, tiny_dataset, monkeypatch):
    """A thousand shares that all read everything would read a million pictures a thousand times."""
    path = tmp_path / "set"
    shutil.copytree(tiny_dataset, path)
    looked = []
    inspect = Dataset.inspect
    monkeypatch.setattr(Dataset, "inspect", lambda self, pose: looked.append(pose.file) or inspect(self, pose))
    dataset = Dataset.open(path)
    own = [pose.file for pose in dataset.poses[1::3]]
    assert local.pending_positions(dataset, (1, 3)) == []
    assert looked == own, "what others have gathered is believed"
    (path / own[0]).write_bytes(b"torn")
    assert local.pending_positions(Dataset.open(path), (1, 3)) == [1], "but its own pictures are not"
    assert not Dataset.open(path).poses[1].done

    late, early = Dataset.open(path), Dataset.open(path)
    shutil.copy(tiny_dataset / own[0], path / own[0])
    looked.clear()
    assert local.gather(early, (1, 3), [1]) == []
    assert looked == [own[0]]
    # One that ends at the same time overwrites the manifest by what it knew; whoever ends last mends that.
    late.write_manifest()
    assert not Dataset.open(path).poses[1].done
    assert local.gather(Dataset.open(path), (2, 3), []) == []
    assert Dataset.open(path).poses == Dataset.open(tiny_dataset).poses
