"""Sets of measured pictures, written by hand or by `MeasuredSet.create`."""

from __future__ import annotations

import math

import numpy as np
import pytest

from generator.files.pictures import write_picture
from generator.files.toml import dump_toml, to_dict
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.model.presets import preset
from generator.sets import description
from generator.sets.dataset import Dataset
from generator.sets.measured import MeasuredSet, has_own_noise
from generator.sets.simulated import open_set

SCENE = preset("room", "sphere")
MANIFEST = {"format": 4, "measured": {"noise": True}, "scene": to_dict(SCENE)}
CENTRE = np.mean(SCENE.grid.bounds(4), axis=0)


def by_hand(path, rows, *, manifest=None, columns="file,label,x,y,z"):
    """Write a set as somebody would who has read its page."""
    path.mkdir()
    for row in rows:
        write_picture(path / row.split(",")[0], np.full((4, 4, 3), 0.5, dtype=np.float32), {})
    (path / "dataset.toml").write_text(dump_toml(manifest or MANIFEST))
    (path / "poses.csv").write_text("\n".join([columns, *rows]))
    return path


def test_a_set_written_by_hand_is_read(tmp_path, command):
    place = ",".join(map(str, CENTRE))
    path = by_hand(tmp_path / "set", ["a.exr,,,,", "b/b.exr,C,,,", f"c.exr,,{place}"])
    made = open_set(path)
    assert isinstance(made, MeasuredSet)
    assert has_own_noise(made)
    assert [(r.label, r.voxel, r.placed) for r in made.records] == [("", -1, False), ("C", 2, False), ("E", 4, True)]
    assert made.records[2].rotation == (0.0, 0.0, 0.0)
    assert (made.grid, made.target_kind) == (SCENE.grid, "sphere")
    assert np.allclose(made.picture(made.records[0]), 0.5)
    with pytest.raises(NlosError, match="holds no picture of the empty scene"):
        made.background()
    done = command("generator", "verify", path)
    assert (done.returncode, "has no hashes" in done.stdout) == (0, True)


def test_other_commands_refuse_it_in_a_sentence(tmp_path, command):
    path = by_hand(tmp_path / "set", ["a.exr,,,,"])
    with pytest.raises(NlosError, match="holds measured pictures"):
        Dataset.open(path)
    done = command("generator", "status", path)
    assert (done.returncode, "holds measured pictures" in done.stderr) == (2, True)


FAULTS = {
    "a label that is none": (["a.exr,Z,,,"], {}, "line 2: label 'Z'"),
    "half a position": (["a.exr,,1,,"], {}, "must be three numbers"),
    "a position outside": (["a.exr,,9,9,9"], {}, "outside the hidden volume"),
    "a contradiction": ([f"a.exr,A,{','.join(map(str, CENTRE))}"], {}, "lies in voxel E"),
    "infinity": (["a.exr,,inf,1,1"], {}, "must be finite"),
    "another column": (["a.exr,1"], {"columns": "file,labels"}, "has a column 'labels'"),
    "no column": (["a.exr,1"], {"columns": "picture,label"}, "lacks the column 'file'"),
    "a newer format": (["a.exr,,,,"], {"manifest": {**MANIFEST, "format": 9}}, "reads up to 4"),
    "no word on noise": (["a.exr,,,,"], {"manifest": {**MANIFEST, "measured": {}}}, "measured.noise"),
    "no scene": (["a.exr,A,,,"], {"manifest": {**MANIFEST, "scene": {}}}, "means nothing without a scene"),
    "a scene that is no table": (["a.exr,,,,"], {"manifest": {**MANIFEST, "scene": 1}}, "scene: must be a table"),
    "a grid that is none": (["a.exr,,,,"], {"manifest": {**MANIFEST, "scene": {"grid": {"lo": [0]}}}}, "grid"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_told(fault, tmp_path):
    rows, changes, words = FAULTS[fault]
    with pytest.raises(NlosError, match=words):
        MeasuredSet.open(by_hand(tmp_path / "set", rows, **changes))


def test_a_file_outside_the_set_is_refused(tmp_path):
    path = by_hand(tmp_path / "set", ["a.exr,,,,"])
    for name in ("../a.exr", "/etc/a.exr"):
        (path / "poses.csv").write_text(f"file\n{name}\n")
        with pytest.raises(NlosError, match="must name a file in the set's folder"):
            MeasuredSet.open(path)


def pictures(count, *, fail=False):
    for k in range(count):
        if fail and k == count - 1:
            raise NlosError("the last one is broken")
        unknown = (math.nan, math.nan, math.nan)
        yield PoseRecord(k, -1, "", unknown, unknown, 0, file=f"p/{k}.exr"), np.full((2, 3, 3), k, dtype=np.float32)


def test_it_is_written_whole_or_not_at_all(tmp_path):
    with pytest.raises(NlosError, match="the last one"):
        MeasuredSet.create(tmp_path / "no", {"measured": {"noise": True}}, pictures(3, fail=True), None, {})
    assert not list(tmp_path.iterdir())
    made = MeasuredSet.create(tmp_path / "set", {"measured": {"noise": True}}, pictures(3), None, {})
    assert made.verify() == []
    with pytest.raises(NlosError, match="names no scene"):
        made.grid  # noqa: B018 (the property raises)
    with pytest.raises(NlosError, match="holds other files"):
        MeasuredSet.create(tmp_path / "set", {"measured": {"noise": True}}, pictures(3), None, {})


def test_changes_are_noticed(tmp_path):
    made = MeasuredSet.create(tmp_path / "set", {"measured": {"noise": True, "level": 1.5}}, pictures(2), None, {})
    manifest = made.path / "dataset.toml"
    text = manifest.read_text()
    manifest.write_text(text.replace("level = 1.5", "level = 2.5"))
    with pytest.raises(NlosError, match=r"measured\.level was changed after the set was written"):
        MeasuredSet.open(made.path)
    manifest.write_text(text)
    write_picture(made.path / "p/0.exr", np.ones((2, 3, 3), dtype=np.float32), {})
    assert "its pixels were changed" in made.verify()[0]


def test_a_description_stands_for_its_scene(tmp_path, command, scene_file):
    path = tmp_path / "room.toml"
    done = command("generator", "describe", scene_file, "-o", path, "--resolution", "8")
    assert done.returncode == 0, done.stderr
    found = description.read(path)
    assert found.resolution == (8, 8)
    assert np.allclose(found.watched, (SCENE.camera.x, SCENE.camera.z), atol=1e-6)
    assert found.reference_radiance == pytest.approx(SCENE.reference_radiance, rel=1e-5)
    manifest = {**found.manifest, "format": 4, "measured": {"noise": False}}
    assert description.read(by_hand(tmp_path / "set", ["a.exr,,,,"], manifest=manifest)).scene == found.scene
    with pytest.raises(NlosError, match="describe it first"):
        description.read(scene_file)
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(NlosError, match="lacks the table 'scene'"):
        description.read(tmp_path / "empty.toml")
