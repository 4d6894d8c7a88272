"""Bulk sets: the sweep's poses in HDF5, killed and resumed, shared out, refused, read and verified."""

from __future__ import annotations

import errno
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import ROOT

from classify.pictures.leak import shared_poses
from generator import transport
from generator.cli import main as cli
from generator.files.toml import to_dict
from generator.model import poses
from generator.model.arrays import rotation_matrix
from generator.model.errors import NlosError
from generator.model.presets import preset
from generator.model.settings import Sweep
from generator.sets import bulk_part, bulk_set
from generator.sets.bulk_set import Bulk
from generator.sets.bulk_settings import Settings
from generator.sets.dataset import Dataset
from generator.transport.world import LitPatch, Mesh, Sphere, Watched, World
from generator.transport.world_file import load_world, save_world, world_hash

GRID = preset("room").grid
SHEET = np.array([(x, 0.0, z) for x in (-0.2, 0.2) for z in (-0.2, 0.2)])
GREY = np.array([0.8, 0.8, 0.8])
RED = np.array([0.8, 0.1, 0.1])


def small_world(albedo=GREY):
    triangles = np.arange(18.0).reshape(2, 3, 3)
    mesh = Mesh(triangles=triangles, albedo=np.tile(albedo, (2, 1)))
    x, y, z = np.eye(3)
    patch = LitPatch(0.3 * x, 0.1 * x, 0.1 * z, y, 3.0 * y, -y, 3.0, 80.0 * np.ones(3), GREY, 0.99, 0.0)
    watched = Watched(np.eye(4, 3), np.array([0.0, 3.0, 0.0, 1.0]), y, GREY, (8, 8))
    return World(patch, watched, (Sphere(x, 0.2, albedo), mesh), (mesh,), order=2)


class Fake:
    """Stands in for the renderer: each pose has a picture of its own, and no two are alike."""

    def __init__(self, colour=(1.0, 1.0, 1.0), delay=0.0):
        self.colour = np.asarray(colour, dtype=np.float32)
        self.delay = delay

    def pictures(self, numbers, positions, rotations):
        assert numbers.tolist() == list(range(numbers[0], numbers[0] + len(positions)))
        time.sleep(self.delay)
        level = positions @ [1.0, 2.0, 4.0] + rotations @ [0.1, 0.2, 0.4]
        ramp = np.arange(1, 65, dtype=np.float32).reshape(8, 8)
        grey = level.astype(np.float32)[:, None, None] * ramp
        return grey[..., None] * self.colour


def new_set(path, *, world=None, **settings):
    plan = Settings(**{"pictures": 40, "resolution": (8, 8), "part": 7, "seed": 5, **settings})
    path.mkdir()
    meta = {"scene": to_dict(preset("room")), "reference_radiance": 1.5, "software": {"blender": "none"}}
    background = np.full((8, 8, 3), 0.25, dtype=np.float32)
    return Bulk.create(path, plan, meta, world or small_world(), background, "0" * 64)


def sampler(found):
    return poses.Sampler(found.grid, found.plan.sweep, SHEET)


def render_missing(path, delay=0.0):
    """Make all parts that are missing, as a worker does but with the stand-in; run by killed processes too."""
    found = Bulk.open(path)
    for number in found.missing():
        found.part(number).write(sampler(found).draw, Fake(delay=delay))
    found.finish()
    return Bulk.open(path)


@pytest.fixture
def whole(tmp_path):
    return render_missing(new_set(tmp_path / "set").path)


def hashes(found):
    def told(number):
        with h5py.File(found.part_path(number)) as file:
            return file.attrs["sha256"]

    return [told(number) for number in range(found.parts)]


# Made of the stand-in


def test_the_poses_are_a_sweeps(whole):
    sweep = replace(whole.plan.sweep, poses=5)
    planned = poses.plan(GRID, sweep, SHEET)[: whole.planned]
    assert [tuple(p) for p in whole.positions] == [p.position for p in planned]
    assert [tuple(r) for r in whole.rotations] == [p.rotation for p in planned]
    assert whole.voxels.tolist() == [p.voxel for p in planned]
    assert whole.labels.tolist() == [p.label for p in planned]


def test_every_picture_is_its_poses(whole):
    wanted = Fake().pictures(np.arange(40), whole.positions, whole.rotations)[..., 0]
    assert whole.pictures.shape == (40, 8, 8)
    np.testing.assert_array_equal(whole.pictures[:], wanted)
    np.testing.assert_array_equal(np.asarray(whole.pictures), wanted)
    for which in (slice(5, 23), slice(3, 40, 9), slice(30, 5, -4), slice(9, 9), [33, 2, -1, 2], [], 17, -40):
        np.testing.assert_array_equal(whole.pictures[which], wanted[which])
    np.testing.assert_array_equal(whole.pictures[whole.voxels == 3], wanted[whole.voxels == 3])
    for which in (40, -41, [40], [[1]], [0.5], "all"):
        with pytest.raises(IndexError):
            whole.pictures[which]


def test_one_file_shows_all_parts_wherever_one_stands(whole, tmp_path, monkeypatch):
    other = render_missing(new_set(tmp_path / "other", seed=6).path)
    # HDF5 looks for a part that is missing in the current directory too, where parts of another set may lie.
    monkeypatch.chdir(other.path)
    with h5py.File(whole.path / "set.h5") as file:
        np.testing.assert_array_equal(file["pictures"][:], whole.pictures[:])
        np.testing.assert_array_equal(file["position"][:], whole.positions)
        np.testing.assert_array_equal(file["voxel"][:], whole.voxels)
        np.testing.assert_array_equal(file["index"][:], np.arange(40) // 9)
        np.testing.assert_array_equal(file["background"][:], whole.background)
        assert file["label"].asstr()[:].tolist() == GRID.labels
        assert file["pictures"].attrs["units"] == "W/m^2/sr"
        assert file.attrs["fingerprint"] == whole.meta["fingerprint"]
        assert tuple(file.attrs["grid_shape"]) == GRID.shape
    whole.part_path(2).unlink()
    with h5py.File(whole.path / "set.h5") as file:
        assert np.isnan(file["pictures"][14:21]).all(), "what is missing must not look like pictures"
        assert np.isfinite(file["pictures"][:14]).all()


def test_a_set_can_be_moved(whole, tmp_path):
    pictures = whole.pictures[:]
    moved = whole.path.rename(tmp_path / "elsewhere")
    np.testing.assert_array_equal(Bulk.open(moved).pictures[:], pictures)
    with h5py.File(moved / "set.h5") as file:
        np.testing.assert_array_equal(file["pictures"][:], pictures)


def test_reading_one_picture_opens_one_part(whole, monkeypatch):
    opened = []
    real = h5py.File

    def file(path, *arguments, **options):
        opened.append(Path(path).name)
        return real(path, *arguments, **options)

    monkeypatch.setattr(bulk_part.h5py, "File", file)
    found = Bulk.open(whole.path)
    assert len(found.pictures) == 40
    found.pictures[16]
    found.pictures[17]
    assert opened == [whole.part_path(2).name]


def test_few_parts_are_open_at_a_time(tmp_path, monkeypatch):
    monkeypatch.setattr(bulk_set, "OPENED", 3)
    found = render_missing(new_set(tmp_path / "set", part=1).path)
    found.pictures[:], found.pictures[::-1]
    descriptors = Path("/proc/self/fd")
    if not descriptors.is_dir():
        pytest.skip("this system does not list open files")
    opened = [os.readlink(fd) for fd in descriptors.iterdir() if fd.is_symlink()]
    assert sum(name.startswith(str(found.path / "part-")) for name in opened) == 3


def test_a_reader_can_be_sent_to_other_processes(whole):
    whole.pictures[0]
    copy = pickle.loads(pickle.dumps(whole))
    np.testing.assert_array_equal(copy.pictures[11:30], whole.pictures[11:30])


def test_colours_are_kept_where_there_are_any(tmp_path):
    found = new_set(tmp_path / "set", world=small_world(RED), pictures=9)
    for number in found.missing():
        found.part(number).write(sampler(found).draw, Fake(colour=(1.0, 0.5, 0.25)))
    assert found.pictures.shape == (9, 8, 8, 3)
    np.testing.assert_array_equal(found.pictures[4][..., 1], 0.5 * found.pictures[4][..., 0])


def test_compressed_pictures_are_the_same(whole, tmp_path):
    packed = render_missing(new_set(tmp_path / "packed", compress=True).path)
    np.testing.assert_array_equal(packed.pictures[:], whole.pictures[:])
    assert hashes(packed) == hashes(whole)
    assert not packed.verify()


def test_size_of_parts():
    def part(pictures, side, channels=1):
        return Settings(pictures=pictures, resolution=(side, side)).with_part(channels).part

    for pictures, side in ((1, 1), (100, 8), (10_000, 64), (1_000_000, 64), (10_000_000, 64), (1000, 2048)):
        parts = -(-pictures // part(pictures, side))
        assert parts <= 512, "more could not be open at once"
        assert part(pictures, side) * side * side * 4 <= 1024**3
    assert part(1_000_000, 64) * 64 * 64 * 4 <= 64 * 1024**2
    assert part(10_000, 64) < 200, "workers have something to share"
    assert part(10**9, 2048, 3) * 2048 * 2048 * 12 <= 1024**3, "a worker's memory goes before the number of files"
    assert Settings(pictures=5, part=3).with_part(1).part == 3


def test_killed_in_the_middle_and_resumed_gives_the_same_pixels(whole, tmp_path):
    path = new_set(tmp_path / "killed").path
    for parts in (1, 4):
        folders = [str(ROOT / folder) for folder in ("", "tests", "tests/support", "tests/generator/sets")]
        code = f"import sys; sys.path[:0] = {folders!r}; import test_bulk_set; "
        code += f"test_bulk_set.render_missing({str(path)!r}, delay=0.3)"
        process = subprocess.Popen([sys.executable, "-c", code])
        wait_for_parts(path, parts, process)
        process.send_signal(signal.SIGKILL)
        process.wait()
    found = Bulk.open(path)
    assert 4 <= found.parts - len(found.missing()) < found.parts, "killed too late to show anything"
    (path / f".{found.part_path(5).name}.123.tmp").write_bytes(b"of a process that was killed")
    found = render_missing(path)
    assert hashes(found) == hashes(whole)
    np.testing.assert_array_equal(found.pictures[:], whole.pictures[:])
    assert not list(path.glob("*.tmp"))


def wait_for_parts(path, count, process, timeout=120):
    end = time.monotonic() + timeout
    while len(list(path.glob("part-*.h5"))) < count:
        assert time.monotonic() < end, "no parts appear"
        assert process.poll() is None, "it ended before it was killed"
        time.sleep(0.02)


def test_an_unfinished_set_can_be_read_as_far_as_it_goes(tmp_path):
    found = new_set(tmp_path / "set")
    found.part(0).write(sampler(found).draw, Fake())
    assert found.missing() == [1, 2, 3, 4, 5]
    assert np.isfinite(found.pictures[:7]).all()
    with pytest.raises(NlosError, match=r"part-.*-000001\.h5: is not there yet; run the same command again"):
        found.pictures[7]


def cut_short(path):
    path.write_bytes(path.read_bytes()[:-100])


def of_another_set(path):
    with h5py.File(path, "r+") as file:
        file.attrs["fingerprint"] = "another"


def of_another_shape(path):
    with h5py.File(path, "r+") as file:
        del file["pictures"]
        file["pictures"] = np.zeros((7, 8, 9), np.float32)


def linked_elsewhere(path):
    with h5py.File(path, "r+") as file:
        del file["pictures"]
        file["pictures"] = h5py.ExternalLink("part-000000.h5", "pictures")


def lost_column(path):
    with h5py.File(path, "r+") as file:
        del file["voxel"]


@pytest.mark.parametrize("spoil", [cut_short, of_another_set, of_another_shape, linked_elsewhere, lost_column])
def test_what_was_spoilt_is_found_and_made_again(whole, spoil):
    before = whole.pictures[:]
    whole.close()
    spoil(whole.part_path(3))
    found = Bulk.open(whole.path)
    assert found.missing() == [3]
    (fault,) = found.verify()
    assert fault.startswith(str(whole.part_path(3)))
    assert "\n" not in fault
    with pytest.raises(NlosError, match="part-"):
        found.pictures[21]
    np.testing.assert_array_equal(render_missing(whole.path).pictures[:], before)


def test_verify_finds_changed_pixels_and_lost_files(whole, capsys):
    assert cli.main(["verify", str(whole.path)]) == 0
    assert capsys.readouterr().out == f"{whole.path}: 40 pictures in 6 parts, 0 faults\n"
    with h5py.File(whole.part_path(1), "r+") as file:
        file["pictures"][0, 0, 0] += 1.0
    with h5py.File(whole.part_path(2), "r+") as file:
        file["rotation"][0, 0] += 1.0
    (whole.path / "world.npz").unlink()
    (whole.path / "background.exr").write_bytes(b"nonsense")
    assert cli.main(["verify", str(whole.path)]) == 1
    out = capsys.readouterr().out
    for words in ("world.npz: no such file", "background.exr: is not a whole", "4 faults"):
        assert words in out
    assert out.count("contents differ from their hash") == 2
    (whole.path / "set.h5").unlink()
    assert "set.h5" not in "".join(whole.verify()), "it is not there before the parts are sound"


def test_pictures_that_cannot_be_are_refused(tmp_path):
    found = new_set(tmp_path / "set")
    draw = sampler(found).draw
    for renderer, words in (
        (Fake(colour=(1.0, 1.0, np.nan)), "picture 0 holds NaN"),
        (Fake(colour=(1.0, 1.0, 0.5)), "the scene is grey, but the renderer made coloured pictures"),
        (Fake(colour=(1.0, 1.0)), r"the renderer made \(7, 8, 8, 2\)"),
    ):
        with pytest.raises(NlosError, match=words):
            found.part(0).write(draw, renderer)
    assert found.missing() == list(range(6))


def test_a_full_disk_is_one_sentence(tmp_path, monkeypatch):
    found = new_set(tmp_path / "set")

    def full(self, data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(NlosError, match=r"part-.*-000000\.h5: cannot be written \(No space left on device\)$"):
        found.part(0).write(sampler(found).draw, Fake())
    monkeypatch.undo()
    assert not list(found.path.glob("*.tmp"))
    assert not list(found.path.glob("*.h5"))


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() == 0, reason="root may write anywhere")
def test_an_unwritable_folder_is_one_sentence(tmp_path):
    found = new_set(tmp_path / "set")
    found.path.chmod(0o500)
    with pytest.raises(NlosError, match="cannot be written"):
        found.part(0).write(sampler(found).draw, Fake())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("format = 3", "format = 6"), "has bulk format 6; this software reads up to 5"),
        (("format = 3", ""), "lacks the field 'format'"),
        (("channels = 1", "channels = 2"), "channels 1 or 3"),
        (("channels = 1", ""), "lacks the field 'channels'"),
        (("part = 7", "part = 0"), "sweep.part must be 1 or more"),
        (("pictures = 40", "pictures = -1"), "bulk.toml: pictures: -1 must be from 1"),
        (("format", "form = at"), "is not a TOML file"),
    ],
)
def test_a_broken_manifest_is_one_sentence(whole, change, words):
    manifest = whole.path / "bulk.toml"
    manifest.write_text(manifest.read_text().replace(*change))
    with pytest.raises(NlosError) as caught:
        Bulk.open(whole.path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_world_comes_back_as_it_was(tmp_path):
    world = small_world()
    save_world(tmp_path / "w.npz", world)
    back = load_world(tmp_path / "w.npz")
    assert world_hash(back) == world_hash(world)
    assert (back.order, back.watched.resolution, back.target[0].radius) == (2, (8, 8), 0.2)
    assert [type(body) for body in back.target] == [Sphere, Mesh]
    np.testing.assert_array_equal(back.room[0].triangles, world.room[0].triangles)
    assert world_hash(replace(world, room=())) != world_hash(world)
    bare = replace(world, room=())
    save_world(tmp_path / "bare.npz", bare)
    assert load_world(tmp_path / "bare.npz").room == ()


@pytest.mark.parametrize("content", [b"", b"nonsense", b"PK\x03\x04 half"])
def test_what_is_no_world_is_one_sentence(tmp_path, content):
    (tmp_path / "w.npz").write_bytes(content)
    with pytest.raises(NlosError, match="is not a world of this software"):
        load_world(tmp_path / "w.npz")
    np.savez(tmp_path / "v.npz", order=np.array(3))
    with pytest.raises(NlosError, match="is not a world of this software"):
        load_world(tmp_path / "v.npz")


def test_nothing_pickled_is_read(tmp_path):
    np.savez(tmp_path / "w.npz", order=np.array([print], dtype=object))
    with pytest.raises(NlosError, match="is not a world of this software"):
        load_world(tmp_path / "w.npz")


def test_another_world_is_refused(whole):
    save_world(whole.path / "world.npz", small_world(RED))
    with pytest.raises(NlosError, match="is not the world that this set was begun with"):
        whole.world()


# By the command line


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nowhere.blend", "-o", "x", "--pictures", "9"), "nowhere.blend: no such scene file"),
        (("{scene}", "-o", "x"), "say how many pictures it shall hold with --pictures N"),
        (("{scene}", "-o", "{scene}", "--pictures", "9"), "is a file; name a folder"),
        (("{scene}", "-o", "{foreign}", "--pictures", "9"), "holds other files"),
        (("{scene}", "-o", "/dev/null/x", "--pictures", "9"), "/dev/null"),
        (("{scene}", "-o", "x", "--pictures", "0"), "pictures: 0 must be"),
        (("{scene}", "-o", "x", "--pictures", "9", "--accuracy", "1e-9"), "1e-09 must be from 1e-08 to 0.3"),
        (("{scene}", "-o", "x", "--accuracy", "40%"), "accuracy: 0.4 must be from 1e-08 to 0.3"),
        (("{scene}", "-o", "x", "--pictures", "9", "--part", "-1"), "part: -1 must be"),
        (("{scene}", "-o", "x", "--pictures", "9", "--seed", "-1"), "seed: -1 must be"),
        (("{scene}", "-o", "x", "--pictures", "9", "--resolution", "big"), "resolution"),
        (("{scene}", "-o", "x", "--pictures", "9", "--shard", "2/2"), "--shard"),
        (("{scene}", "-o", "x", "--pictures", "9", "--workers", "-1"), "--workers"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(tmp_path, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    scene, foreign = tmp_path / "scene.blend", tmp_path / "foreign"
    scene.touch()
    foreign.mkdir()
    (foreign / "holiday.jpg").touch()
    before = sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*"))
    assert cli.main(["bulk", *(a.format(scene=scene, foreign=foreign) for a in arguments)]) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert words in told
    assert told.count("\n") == 1
    assert sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*")) == before, "something was left behind"


def test_what_a_killed_plan_leaves_is_no_obstacle(tmp_path):
    for name in ("scene.blend", "world.npz", ".background.exr.77.tmp"):
        (tmp_path / name).touch()
    bulk_set.check_free(tmp_path)
    (tmp_path / "thesis.pdf").touch()
    with pytest.raises(NlosError, match="holds other files"):
        bulk_set.check_free(tmp_path)


TINY = ("--pictures", "30", "--part", "4", "--resolution", "8", "--accuracy", "0.01", "--no-probe")


@pytest.fixture(scope="module")
def tiny_bulk(tmp_path_factory, scene_file, command):
    """A finished set from the command line. Copy it before changing it."""
    path = tmp_path_factory.mktemp("bulk") / "tiny"
    result = command("generator", "bulk", scene_file, "-o", path, *TINY, "--workers", "2")
    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines()[-1] == f"{path}: 30 of 30 pictures, 30 of them rendered now; finished"
    return path


def test_command_line_makes_a_sound_set(tiny_bulk, command):
    result = command("generator", "verify", tiny_bulk)
    assert (result.returncode, result.stdout) == (0, f"{tiny_bulk}: 30 pictures in 8 parts, 0 faults\n")
    found = Bulk.open(tiny_bulk)
    assert found.pictures.shape == (30, 8, 8), "the preset is grey"
    assert found.pictures[:].min() > 0.0


def test_poses_are_not_those_of_a_sweep(tiny_bulk, tiny_dataset, tmp_path, scene_file, command):
    """One seed, zero where none is named, must not give a set to learn from and one to test on the same poses."""
    planned = Dataset.open(tiny_dataset).poses
    swept = np.array([p.position for p in planned])
    found = Bulk.open(tiny_bulk)
    assert (found.plan.seed, found.plan.stream) == (Dataset.open(tiny_dataset).sweep.seed, "bulk")
    assert shared_poses(swept, found.positions) == 0
    same = command("generator", "bulk", scene_file, "-o", tmp_path / "same", *TINY, "--stream", "sweep")
    assert same.returncode == 0, same.stderr
    found = Bulk.open(tmp_path / "same")
    assert shared_poses(swept, found.positions[:9]) == 9
    again = command("generator", "bulk", scene_file, "-o", tmp_path / "same", *TINY, "--stream", "bulk")
    assert again.returncode == 2
    assert "stream is sweep there and bulk here" in again.stderr


def test_pictures_can_be_computed_again_without_blender(tiny_bulk):
    found = Bulk.open(tiny_bulk)
    again = transport.Transport(found.world(), accuracy=found.plan.accuracy)
    pictures = again.pictures(found.positions[20:], found.rotations[20:])
    np.testing.assert_array_equal(pictures[..., 0], found.pictures[20:])
    np.testing.assert_array_equal(again.background().astype(np.float32), found.background)


@pytest.mark.slow
def test_shards_make_the_same_set(tmp_path, tiny_bulk, scene_file, command):
    for shard, words in (("1/2", "14 of 30 pictures, 14 of them rendered now; 16 remain"), ("0/2", "finished")):
        result = command("generator", "bulk", scene_file, "-o", tmp_path / "s", *TINY, "--shard", shard)
        assert result.returncode == 0, result.stderr
        assert words in result.stdout
    assert hashes(Bulk.open(tmp_path / "s")) == hashes(Bulk.open(tiny_bulk))


@pytest.mark.slow
def test_coordinator_and_workers_killed_and_resumed(tmp_path, tiny_bulk, scene_file, command):
    path = tmp_path / "killed"
    arguments = [sys.executable, "-m", "generator.cli", "bulk", str(scene_file), "-o", str(path), *TINY]
    process = subprocess.Popen(
        [*arguments, "--workers", "1"], stdout=subprocess.DEVNULL, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    wait_for_parts(path, 1, process)
    process.send_signal(signal.SIGKILL)
    process.wait()
    result = command("generator", "bulk", scene_file, "-o", path)
    assert result.returncode == 0, result.stderr
    assert hashes(Bulk.open(path)) == hashes(Bulk.open(tiny_bulk))


def test_a_finished_set_is_left_alone_and_a_lost_master_comes_back(tmp_path, tiny_bulk, scene_file, command):
    path = shutil.copytree(tiny_bulk, tmp_path / "copy")
    (path / "set.h5").unlink()
    before = {p: p.stat().st_mtime_ns for p in path.glob("part-*")}
    result = command("generator", "bulk", scene_file, "-o", path)
    assert (result.returncode, "finished, nothing to do" in result.stdout) == (0, True)
    assert {p: p.stat().st_mtime_ns for p in path.glob("part-*")} == before
    assert not Bulk.open(path).verify()


def test_other_settings_and_scenes_are_refused_by_name(tmp_path, tiny_bulk, scene_file, command):
    result = command("generator", "bulk", scene_file, "-o", tiny_bulk, "--seed", "3", "--pictures", "31")
    assert result.returncode == 2
    assert "pictures is 30 there and 31 here; seed is 0 there and 3 here" in result.stderr
    command("generator", "scene", "tabletop", "-o", tmp_path / "other.blend")
    result = command("generator", "bulk", tmp_path / "other.blend", "-o", tiny_bulk)
    assert result.returncode == 2
    assert "not the scene it was rendered from" in result.stderr


def test_a_scene_that_the_engine_cannot_honour_is_refused(tmp_path, scene_file, command):
    bad = tmp_path / "bad.blend"
    script = (
        f"import bpy; bpy.ops.wm.open_mainfile(filepath={str(scene_file)!r});"
        "bpy.data.objects['Spot'].data.shadow_soft_size = 0.1;"
        f"bpy.ops.wm.save_as_mainfile(filepath={str(bad)!r})"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    result = command("generator", "bulk", bad, "-o", tmp_path / "x", *TINY)
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    assert "which cannot honour that the spot" in result.stderr
    assert "use nlos-generate sweep" in result.stderr
    assert not (tmp_path / "x").exists()


# How poses are drawn, fast


def drawn_as_defined(grid, voxel, index, sweep, hull, is_free):
    """Poses by their definition, try after try: what the first data sets were made with."""
    rng = np.random.default_rng([sweep.seed, voxel, index])
    lo, hi = grid.bounds(voxel)
    limits = np.asarray(sweep.rotation)
    for _ in range(102_400):
        rotation = rng.uniform(-limits, limits)
        reach = hull @ rotation_matrix(tuple(rotation)).T if sweep.inside == "whole" else np.zeros((1, 3))
        low, high = lo - reach.min(axis=0), hi - reach.max(axis=0)
        room = high - low + 1e-6 * (hi - lo)
        keep, where = rng.uniform(), rng.uniform(size=3)
        if (room < 0).any() or (limits.any() and keep > np.prod(room / (hi - lo)) / (1 + 1e-6) ** 3):
            continue
        pose = (tuple(low + where * np.maximum(high - low, 0.0)), tuple(rotation))
        if is_free(*pose):
            return pose
    raise AssertionError("no pose")


@pytest.mark.parametrize("inside", ["whole", "centre"])
@pytest.mark.parametrize("rotation", [(15.0, 15.0, 90.0), (0.0, 0.0, 180.0), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("points", [SHEET * 1.2, np.random.default_rng(1).normal(size=(500, 3)) * 0.04])
def test_poses_drawn_fast_are_those_of_the_definition(inside, rotation, points):
    sweep = Sweep(seed=11, inside=inside, rotation=rotation)

    def is_free(position, rotation):
        return position[2] < 1.2

    fast = poses.Sampler(GRID, sweep, points, is_free)
    for number in range(25):
        wanted = drawn_as_defined(GRID, number % 9, number, sweep, points, is_free)
        assert fast.draw(number % 9, number) == wanted


def test_poses_are_drawn_fast_enough_for_a_million():
    draw = partial(poses.Sampler(GRID, Sweep(rotation=(15.0, 15.0, 90.0)), SHEET * 1.25).draw, 4)
    start = time.process_time()
    for index in range(100):
        draw(index)
    # By the definition it takes 6 ms; a quarter of one is usual, and a busy machine takes more.
    assert (time.process_time() - start) / 100 < 3e-3
